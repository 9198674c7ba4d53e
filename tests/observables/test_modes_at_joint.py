"""Several modes that meet in one joint: what records say of them, and what is known before."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from two_modes import FS, JOINT, SHAPES, STATED, at_two_points, swept, truth, truth_at_wing

from jbw.campaign.settings import Identify, Structured
from jbw.errors import ConfigError, DataError
from jbw.identification.assemble import assemble, measured
from jbw.identification.coordinates import box_of
from jbw.identification.stated_modes import modes_of
from jbw.inference.space.box import bounds_by_name
from jbw.measurement.records import Record, Test
from jbw.observables.dataset import log_likelihood
from jbw.observables.drives import told_by
from jbw.observables.modal_readings import MotionSpectra, read_modes
from jbw.observables.modes import LABEL, Modes, ModesAtJoint
from jbw.oscillator.modes.assembled import held_numbers, seen_by
from jbw.oscillator.modes.parameters import structure_of
from jbw.rig.integrator import GRID, specimen_of
from jbw.rig.structure import Assembled, modal_truth, move

SETTINGS = Identify.of({"offsets": "none", "fit_repeats": 2, "substeps": 4})


@pytest.fixture(scope="module")
def campaign():
    return swept(["low_2", "high_2"], duration=2.0)


@pytest.fixture(scope="module")
def data(campaign):
    seen = measured(campaign.tests, SETTINGS, structure=STATED, report=lambda _: None)
    return assemble(seen)


def point(**changes):
    return {name: jnp.asarray(value) for name, value in {**truth(), **changes}.items()}


def test_records_of_the_rig_are_predicted_to_their_noise(data):
    (records, known) = data.parts
    left = np.asarray(records.mean - records.predict(point()))
    size = np.linalg.norm(np.asarray(records.mean), axis=1)
    # Of the mean of two repeats of 1 %, over 512 samples: within 3 sd of its own scatter; the
    # solver's steps, four a sample, leave 1e-4 of it.
    np.testing.assert_allclose(np.linalg.norm(left, axis=1) / size, 0.01 / np.sqrt(2), rtol=0.1)
    assert data.labels == ("low_2", "high_2", LABEL)
    assert known.groups.runs == ("low_2",)
    # Another sign of the shape is far off: the strongest sweeps have harmonics at the other mode.
    wrong = np.asarray(records.mean - records.predict(point(sign_2=1.0)))
    assert np.max(np.linalg.norm(wrong, axis=1) / size) > 0.05


@pytest.mark.release  # test_traced_numbers.py has those of a structure
def test_gradients_are_those_of_central_differences(data):
    theta = {name: value for name, value in point().items() if name not in data.held}
    held = {**data.held, "sign_2": jnp.asarray(-1.0)}
    data = data.__class__(data.parts, held, data.scatters, data.scatter)

    @jax.jit
    def total(theta):
        return jnp.sum(log_likelihood(theta, data))

    slope = jax.jit(jax.grad(total))(theta)
    for name, value in theta.items():
        # Some 1e-4 of what the parameter is known to: the third derivative is small, and rounding
        # of the sum, 1e-12 of 1e4, too.
        step = 1e-6 * value
        numeric = (total({**theta, name: value + step}) - total({**theta, name: value - step})) / (
            2 * step
        )
        np.testing.assert_allclose(slope[name] * value, numeric * value, rtol=2e-3, atol=0.05)


def test_where_the_output_is_the_drive_point_no_coupling_is_unknown():
    """By reciprocity: mass-normalised shapes that push and see alike give p = h b."""
    modes = modal_truth(SHAPES._replace(output=SHAPES.drive))
    theta = {name: value for name, value in point().items() if name != "coupling_2"}
    theta |= {"gain_ratio_2": jnp.asarray(modes["b"][1] / modes["b"][0])}
    theta |= {"shape_2": jnp.asarray(abs(modes["h"][1])), "sign_2": jnp.sign(modes["h"][1])}
    found = structure_of(theta, ("bouc_wen",))
    np.testing.assert_allclose(found.h, modes["h"], rtol=1e-14)
    np.testing.assert_allclose(found.p, modes["p"], rtol=1e-14)


def test_a_coupling_is_what_the_joint_does_to_the_mode_alone():
    """kappa = |p| h^2 of the rig's shapes, and h p > 0."""
    modes, found = modal_truth(SHAPES), structure_of(point(), ("bouc_wen",))
    np.testing.assert_allclose(found.h, modes["h"], rtol=1e-14)
    np.testing.assert_allclose(found.p, modes["p"], rtol=1e-14)
    np.testing.assert_allclose(found.b * truth()["gain"], modes["b"], rtol=1e-14)


def test_sizes_are_lognormal_over_their_box():
    modes = Modes((18.8, 57.2))
    part = ModesAtJoint.of(modes, (), "run")
    theta = {"shape_2": jnp.asarray(0.4), "coupling_2": jnp.asarray(3.0)}
    ends = np.exp(3 * 1.5), np.exp(3 * 2.0)
    expected = stats.lognorm.logpdf(0.4, 1.5) + np.log(ends[0] - 1 / ends[0])
    expected += stats.lognorm.logpdf(3.0, 2.0) + np.log(ends[1] - 1 / ends[1])
    np.testing.assert_allclose(part.estimate(theta, 0).log_density, [expected], rtol=1e-12)
    np.testing.assert_allclose(part.weighted(theta)[0], [[np.log(0.4) / 1.5, np.log(3.0) / 2.0]])
    # A prior that the campaign states takes their place.
    assert ModesAtJoint.of(modes, ("shape_2",), "run").names == ("coupling_2",)


def test_first_values_are_read_near_every_mode(data):
    found, true = told_by(data.parts), truth()
    # Of a softening joint, by one line: per cents of frequency, tens of damping.
    for name in ("omega_n", "omega_2"):
        assert found[name] == pytest.approx(true[name], rel=0.04)
    assert found["gain_ratio_2"] == pytest.approx(true["gain_ratio_2"], rel=0.3)
    assert found["shape_2"] == found["coupling_2"] == 1.0


def test_the_box_keeps_modes_apart(data):
    bounds = bounds_by_name(box_of(SETTINGS, data, told_by(data.parts)))
    assert set(truth()) - {"sign_2"} == set(bounds)
    assert bounds["omega_n"][1] < bounds["omega_2"][0]
    near = Modes((18.8, 20.0)).windows_hz
    assert near[0][1] == near[1][0] == pytest.approx(19.4)


@pytest.mark.parametrize(
    ("stated", "free", "held"),
    [
        ({}, ("shape_2", "coupling_2"), {"sign_2": 1.0}),
        ({"driving_point": True}, ("shape_2",), {"sign_2": 1.0}),
        ({"joint_shape": (1.0, -0.8)}, ("coupling_2",), {"sign_2": -1.0, "shape_2": 0.8}),
        (
            {"joint_shape": (2.0, -1.6), "driving_point": True},
            (),
            {"sign_2": -1.0, "shape_2": 0.8},
        ),
    ],
)
def test_what_is_measured_at_the_joint_is_not_asked_of_it(campaign, stated, free, held):
    structure = Structured(modes=(18.8, 57.2), **stated)
    modes = modes_of(structure, campaign.tests, SETTINGS)
    assert modes.free == free
    assert modes.held == pytest.approx(held)


def test_one_mode_is_none(campaign):
    assert modes_of(None, campaign.tests, SETTINGS) is None
    assert modes_of(Structured(modes=(18.8,)), campaign.tests, SETTINGS) is None


def test_a_mode_that_nothing_drives_is_refused(campaign):
    structure = Structured(modes=(18.8, 90.0))
    with pytest.raises(DataError, match="must drive the mode at 90 Hz"):
        assemble(measured(campaign.tests, SETTINGS, structure=structure, report=lambda _: None))


def test_a_mode_above_half_the_sampling_frequency_is_refused(campaign):
    with pytest.raises(ConfigError, match=r"131 Hz must lie below half .* is sampled at 256"):
        modes_of(Structured(modes=(18.8, 131.0)), campaign.tests, SETTINGS)


def test_bounds_within_which_modes_change_places_are_refused(campaign):
    settings = Identify.of({"prior": {"omega_n": (100.0, 400.0)}})
    with pytest.raises(ConfigError, match="`omega_n` must end below `omega_2`"):
        modes_of(STATED, campaign.tests, settings)


@pytest.mark.parametrize(
    ("stated", "name"),
    [({"driving_point": True}, "coupling_2"), ({"joint_shape": (1, 2)}, "shape_2")],
)
def test_bounds_of_what_is_known_are_refused(campaign, stated, name):
    structure = Structured(modes=(18.8, 57.2), **stated)
    settings = Identify.of({"prior": {name: (0.1, 1.0)}})
    with pytest.raises(
        ConfigError, match=f"`{name}` must be an unknown parameter, but `{next(iter(stated))}`"
    ):
        modes_of(structure, campaign.tests, settings)


def test_a_drive_point_has_gains_of_one_sign(campaign):
    """A response turned round within one mode's tests: no square of a shape is negative."""
    low, high = campaign.tests
    turned = tuple(
        replace(one, channels={**one.channels, "velocity": -one.channels["velocity"]})
        for one in high.records
    )
    tests = low, replace(high, records=turned)
    structure = Structured(modes=(18.8, 57.2), driving_point=True)
    with pytest.raises(DataError, match=r"57.2 Hz must have a gain of the first mode's sign"):
        assemble(measured(tests, SETTINGS, structure=structure, report=lambda _: None))


def test_tests_of_two_drives_are_refused(campaign):
    low, high = campaign.tests
    with pytest.raises(ConfigError, match="driven by force and voltage"):
        modes_of(STATED, (low, replace(high, drive="voltage")), SETTINGS)


@pytest.mark.slow
def test_a_multisine_is_predicted_as_steady_motion():
    """Of both bands at once, from rest until 12 periods of 2 s have gone: e^-17 is left."""
    num, rng = 512, np.random.default_rng(0)
    freq = np.arange(1, num // 2) * FS / num
    freq = freq[((freq > 15) & (freq < 23)) | ((freq > 52) & (freq < 62))]
    phase = rng.uniform(0, 2 * np.pi, freq.size)

    def source(points):
        t = points[:, None] / (GRID * FS)
        return 0.05 * np.sum(np.cos(2 * np.pi * freq * t + phase), axis=1)

    assembled = Assembled(SHAPES, specimen_of(JOINT).forces)
    motion = move(assembled, lambda i, j: source(np.arange(i, j)), 14 * num, FS)
    force = source(GRID * np.arange(12 * num, 14 * num))
    velocity = motion.velocity[12 * num :]
    velocity += 1e-3 * np.std(velocity) * rng.standard_normal(2 * num)
    record = Record(FS, {"force": force, "velocity": velocity}, {"force": "N", "velocity": "m/s"})
    test = Test("multisine", (record,), name="multisine", periods=2)
    part = assemble(measured((test,), SETTINGS, structure=STATED, report=lambda _: None)).parts[0]
    left = np.linalg.norm(part.mean - part.predict(point())) / np.linalg.norm(part.mean)
    # Of the mean of two periods of 512 samples.
    assert left == pytest.approx(1e-3 / np.sqrt(2), rel=0.15)


@pytest.fixture(scope="module")
def two_points():
    """The same sweeps as seen at two points."""
    return at_two_points(["low_2", "high_2"], duration=2.0)


def test_a_motion_is_seen_at_every_point(two_points):
    structure = two_points.structure
    data = assemble(
        measured(two_points.tests, SETTINGS, structure=structure, report=lambda _: None)
    )
    records, _ = data.parts
    assert records.points == ("", "wing", "", "wing")
    assert records.moved == (0, 0, 2, 2)  # two motions are solved, and no more
    left = np.asarray(records.mean - records.predict(point(**truth_at_wing())))
    size = np.linalg.norm(np.asarray(records.mean), axis=1)
    # As at one point: of the mean of two repeats of 1 %.
    np.testing.assert_allclose(np.linalg.norm(left, axis=1) / size, 0.01 / np.sqrt(2), rtol=0.1)
    told = told_by(data.parts)
    for name, true in truth_at_wing().items():  # ratios of gains of one motion: noise alone
        assert told[name] == pytest.approx(true, rel=0.05)
    assert set(truth_at_wing()) < set(bounds_by_name(box_of(SETTINGS, data, told)))
    # What modes outside of the band add at a point is that point's own.
    assert records.residuals == "own"


def test_tests_of_several_modes_have_constants_of_their_own(two_points):
    """At one point too: what a mode above adds differs from band to band."""
    one = replace(two_points, tests=tuple(t for t in two_points.tests if not t.point))
    structure = one.structure.model_copy(update={"points": ()})
    chosen = measured(one.tests, SETTINGS, structure=structure, report=lambda _: None).chosen
    assert {test.residuals for test in chosen} == {"own"}
    alone = measured(one.tests, SETTINGS, laws=(), report=lambda _: None).chosen
    assert {test.residuals for test in alone} == {"auto"}


def test_modes_that_overlap_are_read_together():
    """Two modes half a per cent apart in frequency times ten: each alone would read both."""
    omega, zeta, gains = 2 * np.pi * np.array([7.3, 6.9]), [0.004, 0.008], [[2.0, 0.5], [1.0, -1.5]]
    line = 2 * np.pi * np.arange(5.5, 9.0, 0.01)
    modal = [1 / (w**2 - line**2 + 2j * z * w * line) for w, z in zip(omega, zeta, strict=True)]
    seen = {name: g @ np.array(modal) + 1e-4 for name, g in zip(("", "a"), gains, strict=True)}
    modes = Modes((7.2, 6.95), points=("a",))
    found = read_modes(modes, [MotionSpectra(line, np.ones(len(line), complex), seen)])
    # Closed form: to the optimiser's tolerance, 1e-8 of the misfit, by the condition of the fit.
    assert found["omega_n"] == pytest.approx(omega[0], rel=1e-6)
    assert found["zeta_2"] == pytest.approx(zeta[1], rel=1e-4)
    assert [found["gain"], found["gain_ratio_2"]] == pytest.approx(gains[0], rel=1e-4)
    assert [found["point_2_1"], found["point_2_2"]] == pytest.approx(gains[1], rel=1e-4)


def test_a_mode_is_read_off_what_passes_through_it_and_no_harmonic():
    """A shaker's force has harmonics: the third of a first mode's sweep reaches into a window."""
    omega, zeta, gains = 2 * np.pi * np.array([18.8, 57.2]), [0.006, 0.01], [0.7, 0.9]
    line = 2 * np.pi * np.arange(14.0, 64.0, 0.25)
    modal = [
        g / (w**2 - line**2 + 2j * z * w * line) for g, w, z in zip(gains, omega, zeta, strict=True)
    ]
    low = np.where(line < 2 * np.pi * 24, 1.0, np.where(line < 2 * np.pi * 55.8, 0.2, 0.0)) + 0j
    # Its response to the harmonic is that of a joint that slips, and no linear one.
    weak = np.where(line < 2 * np.pi * 24, low * sum(modal), 1e-6 * np.sin(line))
    high = np.where(line > 2 * np.pi * 50, 1.0, 0.0) + 0j
    motions = [
        MotionSpectra(line, low, {"": weak}),
        MotionSpectra(line, high, {"": high * sum(modal)}),
    ]
    found = read_modes(Modes((18.8, 57.2)), motions)
    # What the other mode adds is a constant and 1/omega^2 but for a part in ten thousand.
    assert found["omega_2"] == pytest.approx(omega[1], rel=1e-4)
    assert found["zeta_2"] == pytest.approx(zeta[1], rel=1e-3)
    assert found["omega_n"] == pytest.approx(omega[0], rel=1e-4)
    # Where nothing else drives it, the harmonic is better than nothing.
    assert "omega_2" in read_modes(Modes((18.8, 57.2)), motions[:1])


def test_points_that_cannot_be_meant_are_refused(two_points):
    def seen(tests=two_points.tests, **stated):
        structure = two_points.structure.model_copy(update=stated)
        return assemble(measured(tests, SETTINGS, structure=structure, report=lambda _: None))

    with pytest.raises(ConfigError, match="must name `wing`, where test `low_2 at wing`"):
        seen(points=())
    shared = [replace(test, residuals="upper") for test in two_points.tests]
    with pytest.raises(ConfigError, match="`residuals` must be own, none or auto"):
        seen(shared)
    with pytest.raises(DataError, match=r"must drive the mode at 57.2 Hz .* measured at `wing`"):
        seen([test for test in two_points.tests if test.name != "high_2 at wing"])


def test_points_are_in_the_order_of_their_names_in_programs_and_outside():
    """JAX sorts the names of parameters, so a later name must not take an earlier row."""
    c = {"": np.array([1.0, 2.0]), "tip": np.array([3.0, 4.0]), "end": np.array([5.0, 6.0])}
    ones = np.ones(2)
    held = held_numbers(1e2 * ones, 1e-2 * ones, {"a": ones}, {"a": 1e6}, ones, c)
    theta = {name: jnp.asarray(value) for name, value in held.items()}
    expected = np.stack([c[""], c["end"], c["tip"]])
    np.testing.assert_array_equal(seen_by(theta), expected)
    np.testing.assert_array_equal(jax.jit(seen_by)(theta), expected)
