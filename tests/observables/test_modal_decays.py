"""Free decays of two modes with one joint, beside DOP853 and beside closed forms."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from modal_decays import (
    BAND,
    FS,
    HELD,
    HZ,
    OMEGA,
    STARTS,
    STATED,
    TRUTH,
    ZETA,
    free_velocity,
    modal_decay_test,
)

from jbw.campaign.settings import Identify, Structured
from jbw.errors import ConfigError, DataError
from jbw.identification.assemble import assemble, measured
from jbw.identification.coordinates import box_of
from jbw.identification.stated_modes import modes_of
from jbw.measurement.envelopes import bands_of
from jbw.measurement.records import Record, Test
from jbw.observables.dataset import Dataset, log_likelihood
from jbw.observables.decay import matched
from jbw.observables.drives import told_by
from jbw.observables.modal_decays import ModalDecays
from jbw.observables.modes import Modes
from jbw.observables.noise import silenced

MODES = Modes(HZ)
SETTINGS = Identify.of({"offsets": "none"})


def point(**changes):
    return {name: jnp.asarray(value) for name, value in {**TRUTH, **HELD, **changes}.items()}


def assembled(test, structure=STATED):
    return assemble(measured((test,), SETTINGS, structure=structure, report=lambda _: None))


def sizes(data):
    return np.linalg.norm(np.asarray(data.mean), axis=1)


@pytest.fixture(scope="module")
def clean():
    """Two of the impacts, without noise."""
    return ModalDecays.of(modal_decay_test(STARTS[:2], noise=0.0, settle=0.25), modes=MODES)


def test_records_are_matched_but_for_how_an_impact_began(clean):
    found = matched(point(), clean)
    left = np.sqrt(np.asarray(found.misfit)) / sizes(clean)
    # After a quarter of a second the joint still remembers its start, which no loop of one
    # amplitude holds; that is below a thousandth of the motion, and the solver's steps leave less.
    assert np.all(left < 5e-4)
    assert np.all(np.abs(found.entry.shift) < 1e-6 * OMEGA[0])
    # The state at the first sample, of the same equations: q, q' over the stated frequency.
    first = free_velocity(STARTS[0])[round(0.25 * FS)]
    _, _, v_1, v_2 = np.asarray(found.entry.state)[0] * 2 * np.pi * np.array([*HZ, *HZ])
    assert v_1 + v_2 == pytest.approx(first, rel=1e-3, abs=1e-3 * 2e-3 * OMEGA[0])
    # Modes that move the joint the other way round are told apart from these.
    other = matched(point(sign_2=1.0), clean)
    assert np.all(np.asarray(other.misfit) > 4 * np.asarray(found.misfit))


def test_a_record_that_ends_early_is_matched_as_if_alone():
    test = modal_decay_test(STARTS[:2], noise=1e-3, settle=0.25)
    first, second = test.records
    velocity = first.channels["velocity"]
    ended = replace(first, channels={"velocity": velocity[: round(0.6 * len(velocity))]})
    both, alone = (
        ModalDecays.of(replace(test, records=records), modes=MODES)
        for records in ((ended, second), (ended,))
    )
    found, expected = matched(point(), both), matched(point(), alone)
    assert both.lengths[1] > both.lengths[0] == alone.lengths[0]
    assert float(found.misfit[0]) == pytest.approx(float(expected.misfit[0]), rel=1e-6)
    np.testing.assert_allclose(found.precision[0], expected.precision[0], rtol=1e-6)


def test_linear_modes_decay_in_closed_form():
    t = np.arange(round(3.0 * FS)) / FS
    roots = -ZETA * OMEGA + 1j * OMEGA * np.sqrt(1 - ZETA**2)
    starts = np.array([[2e-3 * np.exp(0.4j), 1e-3 * np.exp(-2j)], [1e-3, -2e-3j]])
    shifts = np.array([0.0, 3e-5])  # of all frequencies, and with them of the rates
    velocity = [
        np.real(sum(a * s * (1 + shift) * np.exp(s * (1 + shift) * t)
                    for a, s in zip(row, roots, strict=True)))
        for row, shift in zip(starts, shifts, strict=True)
    ]  # fmt: skip
    records = tuple(Record(FS, {"velocity": v}, {"velocity": "m/s"}) for v in velocity)
    test = Test("decay", records, "linear", band_hz=BAND)
    data = ModalDecays.of(test, modes=MODES, laws=())
    theta = {name: x for name, x in point().items() if name not in ("shape_2", "coupling_2")}
    found = matched(theta, data)
    left = np.sqrt(np.asarray(found.misfit)) / sizes(data)
    # Differences by the start, of 1e-6, are exact of linear motion but for rounding; a shift turns
    # the phase and leaves the rates alone: 3e-5 of the damping over the record.
    assert left[0] < 1e-9
    assert left[1] < 3e-5
    shift = np.asarray(found.entry.shift) / OMEGA[0]
    np.testing.assert_allclose(shift, shifts, atol=2e-7)
    # Re a and Re(a s) over the stated frequencies, of the first record.
    a, s = starts[0], roots
    expected = [*a.real, *(np.real(a * s) / (2 * np.pi * np.array(HZ)))]
    np.testing.assert_allclose(np.asarray(found.entry.state)[0], expected, rtol=1e-7, atol=1e-10)
    # First values are of the modes' own envelopes, straight lines through them.
    told = data.shown().first_values()
    assert told["omega_n"] == pytest.approx(OMEGA[0], rel=1e-4)
    assert told["omega_2"] == pytest.approx(OMEGA[1], rel=1e-4)
    assert told["zeta"] == pytest.approx(ZETA[0], rel=0.03)
    assert told["zeta_2"] == pytest.approx(ZETA[1], rel=0.03)


@pytest.mark.release  # test_contract.py has those of every kind
def test_derivatives_are_those_of_central_differences():
    """Of Q, with the start at its best: exact where that has been found."""
    data = ModalDecays.of(modal_decay_test(STARTS[:1], settle=0.25), modes=MODES)
    theta = point()
    data = data.with_fitted_noise(theta, {})

    @jax.jit
    def total(changed):
        found = data.matches({**theta, **changed})
        return jnp.sum(jnp.log(found.misfit))

    free = {name: theta[name] for name in TRUTH}
    slope = jax.jit(jax.grad(total))(free)
    for name, value in free.items():
        step = 1e-6 * value if name.startswith("omega") else 1e-4 * value
        ahead, behind = (total({**free, name: value + s * step}) for s in (1, -1))
        numeric = (ahead - behind) / (2 * step)
        # The size of what is left is what the log misfit's slope is known to: 1e-4 of it a
        # standard deviation, which is 1e-4 of frequencies and per cents of the joint's.
        unit = 1e-6 if name.startswith("omega") else 1e-2
        np.testing.assert_allclose(
            slope[name] * value * unit, numeric * value * unit, rtol=5e-3, atol=2e-5
        )


def test_a_likelihood_knows_no_gain():
    data = assembled(modal_decay_test(STARTS[:2]))
    part, known = data.parts
    assert isinstance(part, ModalDecays)
    assert known.names == ("shape_2", "coupling_2")
    assert {"gain", "gain_ratio_2"} <= data.held.keys()
    bounds = box_of(SETTINGS, data, told_by(data.parts))
    assert set(bounds.names) == set(TRUTH)
    here, doubled = (
        float(jnp.sum(log_likelihood(theta, Dataset.of(data.parts))))
        for theta in (point(), point(gain_ratio_2=2.0))
    )
    assert here == pytest.approx(doubled, rel=1e-12)


@pytest.mark.release  # test_contract.py has this of other kinds
def test_a_record_that_does_not_count_says_nothing(clean):
    (silent,) = silenced(clean.groups.labels[:1], Dataset.of([clean])).parts
    assert np.all(np.asarray(silent.weighted(point())[0])[0] == 0.0)
    assert float(silent.estimate(point(), 0).log_density[0]) == 0.0


def test_bands_leave_room_for_the_filters_of_others():
    test = replace(modal_decay_test(STARTS[:1]), band_hz=(95.0, 290.0))
    bands = bands_of((122.0, 243.0), test)
    np.testing.assert_allclose(bands, [(95.0, 149.0), (196.0, 290.0)])
    with pytest.raises(DataError, match=r"all modes of .* 95 to 290 Hz, but 300 Hz is outside"):
        bands_of((122.0, 300.0), test)
    with pytest.raises(DataError, match="needs `band`"):
        bands_of(MODES.hz, replace(test, band_hz=None))


def test_a_drive_point_is_refused_of_decays_alone():
    structure = Structured(modes=HZ, driving_point=True)
    with pytest.raises(DataError, match="driving_point needs driven tests"):
        assembled(modal_decay_test(STARTS[:1]), structure)


def test_decays_stand_beside_tests_of_a_measured_force_alone():
    free = modal_decay_test(STARTS[:1])
    v = free.records[0].channels["velocity"]
    record = Record(FS, {"force": v, "velocity": v}, {"force": "N", "velocity": "m/s"})
    swept = Test("sweep", (record,), "sweep", 1.0)
    assert modes_of(STATED, (free, swept), SETTINGS) == MODES
    fed = replace(swept, drive="voltage")
    with pytest.raises(ConfigError, match="driven by force and voltage"):
        modes_of(STATED, (free, fed), SETTINGS)
