"""Drives side by side: which parameters each takes, and what a shaker's attachment foretells."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jbw.campaign.settings import Identify
from jbw.errors import ConfigError
from jbw.identification.attachments import require_one_unit
from jbw.identification.coordinates import box_of
from jbw.identification.run_effects import shifts_of, with_offsets
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.space.box import box
from jbw.measurement.records import Record, Test, drive_of
from jbw.observables import dataset
from jbw.observables.attachment import Foretold
from jbw.observables.dataset import Dataset
from jbw.observables.drives import attached, of_drive, parts_of, plain, told_by
from jbw.observables.line_fit import LineReading

ALONE, FED = (118.0, 0.010, 0.5), (119.5, 0.017, 14.0)  # omega_n, zeta, gain
STD = np.array([0.01, 2e-4, 0.01])
THETA = dict(zip(("omega_n", "zeta", "gain"), ALONE, strict=True)) | dict(
    zip(("omega_n_voltage", "zeta_voltage", "gain_voltage"), FED, strict=True)
)


def reading(mean, drive, run="", shift=(0.0, 0.0)):
    """A line fit of a structure without a joint, of a run that lies elsewhere."""
    moved = np.add(mean, (*shift, 0.0))
    found = LineReading.of(moved, np.diag(STD**2), 1e-6, run, laws=())
    return replace(found, drive=drive)


def record(**units):
    channels = {role: np.zeros(8) for role in units}
    return Record(8.0, channels, units)


@pytest.mark.parametrize(
    ("drives", "others"),
    [
        (("voltage",), ()),
        (("voltage", ""), ()),  # a loop beside: as in every campaign of one drive
        (("force", "none"), ()),  # the structure alone, either way
        (("voltage", "force"), ("voltage",)),
        (("none", "voltage"), ("voltage",)),
        (("current", "voltage"), ("current",)),
        (("current", "voltage", "none"), ("voltage", "current")),
    ],
)
def test_the_structure_alone_has_the_plain_names_else_the_first_drive(drives, others):
    parts = [reading(ALONE, drive) for drive in drives]
    assert attached(parts) == others
    assert len(parts_of("", parts)) == len(drives) - len(others)


def test_parameters_of_another_drive_stand_in_for_the_plain_ones():
    assert of_drive(THETA, "force") is THETA  # nothing is copied where there is nothing to change
    own = of_drive(THETA, "voltage")
    assert tuple(own[name] for name in ("omega_n", "zeta", "gain")) == FED
    assert [plain(n) for n in ("omega_n_voltage", "zeta_current", "omega_n")] == [
        "omega_n",
        "zeta",
        "omega_n",
    ]


@pytest.mark.parametrize(
    ("kind", "units", "drive", "expected"),
    [
        ("sweep", {"input": "V", "velocity": "m/s"}, "", "voltage"),
        ("sweep", {"input": "A", "velocity": "m/s"}, "", "current"),
        ("sweep", {"input": "N/kg", "velocity": "m/s"}, "", "force"),
        ("sweep", {"force": "N", "velocity": "m/s"}, "", "force"),
        ("sweep", {"input": "V", "force": "N", "velocity": "m/s"}, "", "voltage"),
        ("sweep", {"input": "V", "force": "N", "velocity": "m/s"}, "force", "force"),
        ("decay", {"velocity": "m/s"}, "", "none"),
        ("decay", {"velocity": "m/s"}, "voltage", "voltage"),
        ("loop", {"displacement": "m", "restoring_force": "N"}, "", ""),
    ],
)
def test_a_drive_follows_from_role_and_unit_unless_it_is_stated(kind, units, drive, expected):
    assert drive_of(Test(kind, (record(**units),), drive=drive)) == expected


def test_the_drive_chooses_between_two_recorded_sources():
    both = record(input="V", force="N", acceleration="m/s^2")
    assert both.source == "input"
    (own,) = Test("sweep", (both,), drive="force").records
    assert own.source == "force"


def test_one_gain_does_not_serve_two_units():
    tests = [
        Test("sweep", (record(force="N", velocity="m/s"),), name="a"),
        Test("sweep", (record(input="N/kg", velocity="m/s"),), name="b"),
        Test("sweep", (record(input="V", velocity="m/s"),), name="c"),
    ]
    require_one_unit(tests[::2])
    with pytest.raises(ConfigError, match="driven by force must have their source in one unit"):
        require_one_unit(tests)


def test_every_drive_begins_where_it_was_read_and_has_bounds_of_its_own():
    data = Dataset.of([reading(ALONE, "force"), reading(FED, "voltage")])
    first = told_by(data.parts)
    assert first == pytest.approx(THETA)
    settings = Identify.of({"prior": {"zeta_voltage": [0.01, 0.02]}})
    prior = box_of(settings, data, first)
    bounds = dict(zip(prior.names, zip(prior.lower, prior.upper, strict=True), strict=True))
    assert bounds["omega_n_voltage"] == pytest.approx((0.97 * 119.5, 1.03 * 119.5))
    assert bounds["omega_n"] == pytest.approx((0.97 * 118.0, 1.03 * 118.0))
    assert bounds["zeta_voltage"] == (0.01, 0.02)
    assert "gain_voltage" in bounds
    with pytest.raises(ConfigError, match="zeta_voltage"):
        box_of(settings, Dataset.of([reading(FED, "voltage")]), told_by([reading(FED, "")]))


@pytest.fixture(scope="module")
def days():
    """Three days, on each of which both drives shift alike."""
    shifts = np.array([[-0.3, 0.001], [0.1, -0.002], [0.2, 0.001]])
    parts = [
        reading(mean, drive, f"day {i}", shift)
        for i, shift in enumerate(shifts)
        for mean, drive in ((ALONE, "force"), (FED, "voltage"))
    ]
    data = Dataset.of(parts)
    bounds = {name: (0.8 * x, 1.2 * x) for name, x in THETA.items()}
    return data, costly_fit(dataset.stacked, box(bounds), data, starts=THETA), shifts


def test_both_drives_tell_of_one_shift_of_their_run(days):
    data, best, shifts = days
    assert best.theta == pytest.approx(THETA, rel=1e-6)  # the shifts have no mean
    found = shifts_of(best, tuple(best.theta), data)
    assert found.runs == ("day 0", "day 1", "day 2")
    np.testing.assert_allclose(found.offset, shifts, rtol=1e-5)
    # Two readings of each day's: weak motion's own margin is nothing without a joint.
    np.testing.assert_allclose(found.std, np.tile(STD[:2] / np.sqrt(2), (3, 1)), rtol=1e-6)


def test_offsets_of_runs_serve_every_drive(days):
    data, best, _ = days
    wide = with_offsets(best, shifts_of(best, tuple(best.theta), data), data)
    rows = dataset.residual({name: jnp.asarray(x) for name, x in best.theta.items()}, wide)
    # Scatters a hundred times the errors take out what shifts, in either drive.
    for label in data.labels:
        assert np.abs(rows[label]).max() < 0.02


def test_what_is_foretold_is_a_normal_density_of_the_changes():
    mean, std = np.array([1.2, 0.006]), np.array([0.4, 0.002])
    part = Foretold.of(mean, std, "voltage", "day 0", laws=())
    data = Dataset.of([reading(ALONE, "force", "day 0"), part])
    theta = {name: jnp.asarray(x) for name, x in THETA.items()}
    change = np.array([1.5, 0.007])
    terms = dataset.log_likelihood(theta, data)
    expected = stats.norm.logpdf(change, mean, std) - stats.norm.logpdf(mean, mean, std)
    assert float(terms[data.labels.index("shaker by voltage")]) == pytest.approx(expected.sum())
    np.testing.assert_allclose(
        dataset.residual(theta, data)["shaker by voltage"], (mean - change) / std, rtol=1e-9
    )


def test_what_is_foretold_says_nothing_of_the_runs(days):
    data, best, _ = days
    part = Foretold.of(np.array([1.4, 0.0065]), np.array([0.4, 0.002]), "voltage", "day 0", laws=())
    more = replace(data, parts=(*data.parts, part))
    found = costly_fit(dataset.stacked, box({n: (0.8 * x, 1.2 * x) for n, x in THETA.items()}),
                       more, starts=best.theta)  # fmt: skip
    names = tuple(found.theta)
    before, after = shifts_of(best, names, data), shifts_of(found, names, more)
    np.testing.assert_allclose(after.std, before.std, rtol=1e-6)
