"""Force loops under a prescribed displacement, against scipy on the law itself."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jbw.campaign.load import load_campaign
from jbw.errors import DataError
from jbw.measurement.records import Record, Test, is_sampled
from jbw.observables.groups import beside_own
from jbw.observables.loops import Loops, blocks_of, together

FS = 256.0
THETA = {"omega_n": 60.0, "zeta": 0.0, "alpha": 2000.0, "delta": 90.0, "gamma": 150.0}
MASS = 1.7


def theta(**changes):
    return {n: jnp.asarray(v) for n, v in {**THETA, "gain": 1 / MASS, **changes}.items()}


def displacement(t):
    return 0.01 * np.sin(2 * np.pi * 0.5 * t) * (0.3 + 0.1 * t)


def measured(seconds=4.0):
    """Force by a stock integrator along the displacement as straight lines between samples."""
    t = np.arange(round(seconds * FS)) / FS
    y = displacement(t)
    z, values = 0.0, [0.0]
    for dy in np.diff(y):
        s = np.sign(dy)

        def rate(_, z, s=s):
            return s * (2000.0 - 150.0 * s * z - 90.0 * np.abs(z))

        z = solve_ivp(rate, (0, abs(dy)), [z], rtol=1e-11, atol=1e-13).y[0, -1]
        values.append(z)
    return y, MASS * ((60.0**2 - 2000.0) * y + np.array(values))


def test_force_follows_the_law_of_the_joint():
    y, force = measured()
    record = Record(FS, {"displacement": y, "restoring_force": force},
                    {"displacement": "m", "restoring_force": "N"})  # fmt: skip
    (data,) = Loops.reduce([Test("loop", (record, record), "loop", 0.01)])
    left = np.asarray(data.misfit(theta()))
    # scipy's tolerance over a thousand steps.
    assert np.abs(left).max() < 1e-8 * np.abs(force).max()


def test_what_settles_is_predicted_but_not_compared():
    y, force = measured()
    record = Record(FS, {"displacement": y, "restoring_force": force + (np.arange(len(y)) < 256)},
                    {"displacement": "m", "restoring_force": "N"})  # fmt: skip
    (data,) = Loops.reduce([Test("loop", (record,), "loop", 0.01, settle=1.0)])
    left = np.asarray(data.misfit(theta()))
    assert np.abs(left).max() < 1e-8 * np.abs(force).max()
    assert float(data.groups.size[0]) == len(y) - 256


def test_tests_of_unlike_lengths_stand_side_by_side():
    tests = []
    for seconds in (2.0, 3.0):
        y, force = measured(seconds)
        record = Record(FS, {"displacement": y, "restoring_force": force},
                        {"displacement": "m", "restoring_force": "N"})  # fmt: skip
        tests.append(Test("loop", (record,), f"{seconds}", 0.01))
    (data,) = Loops.reduce(tests)
    assert np.abs(np.asarray(data.misfit(theta()))).max() < 1e-6
    np.testing.assert_array_equal(data.groups.size, [512, 768])


def test_repeats_of_unlike_lengths_are_refused():
    records = tuple(
        Record(FS, {"displacement": np.ones(n), "restoring_force": np.ones(n)}, {})
        for n in (10, 11)
    )
    with pytest.raises(DataError, match="must have equal lengths"):
        Loops.reduce([Test("loop", records, "loop", 0.01)])


def test_neighbours_of_a_long_record_are_averaged_and_peaks_kept():
    cycle = 20_000
    y = np.sin(2 * np.pi * np.arange(3 * cycle) / cycle)
    size = together(y)
    # A sine moves by 2 pi / N at its fastest.
    assert size == int(6e-3 * cycle / (2 * np.pi))
    few = blocks_of(y, size)
    # The mean over an angle a about a peak is 1 - a^2 / 24; blocks need not be centred on it.
    assert np.max(few) > 1 - (2 * np.pi * size / cycle) ** 2
    assert together(y[:8000]) == 1
    assert together(np.zeros(20_000)) == 1


@pytest.mark.parametrize("kind", ["exact", "offset", "drift"])
def test_the_zero_of_a_load_cell_is_fitted_beside_the_joint(kind):
    """An offset leaves nothing, a drift too; both cost what they are where none is stated."""
    y, force = measured()
    zero = {"exact": 0.0, "offset": 5.0, "drift": 5.0 - 3.0 * np.arange(len(y)) / FS}[kind]
    record = Record(FS, {"displacement": y, "restoring_force": force + zero},
                    {"displacement": "m", "restoring_force": "N"})  # fmt: skip
    (data,) = Loops.reduce([Test("loop", (record,), "loop", 0.01, settle=1.0, load_cell=kind)])
    left = beside_own(data.misfit(theta()), data.groups)
    assert np.abs(np.asarray(left)).max() < 1e-7 * np.abs(force).max()
    taken = {"exact": 0, "offset": 1, "drift": 2}[kind]
    assert float(data.groups.num_counted[0]) == len(y) - 256 - taken
    if kind != "exact":
        (plain,) = Loops.reduce([Test("loop", (record,), "loop", 0.01, settle=1.0)])
        assert np.abs(np.asarray(plain.misfit(theta()))).max() > 1.0


def test_samples_of_a_loop_need_no_time(tmp_path):
    """A law knows no rate: samples are counted, and so do `settle` and `span`."""
    y, force = measured(2.0)
    table = np.stack([1e3 * y, force], axis=1)
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="displacement,force", comments="")
    (tmp_path / "campaign.toml").write_text("""
[[test]]
kind = "loop"
files = "a.csv"
channels = { displacement = "displacement", restoring_force = "force" }
units = { displacement = "mm", restoring_force = "N" }
settle = 10
""")
    (test,) = load_campaign(tmp_path / "campaign.toml").tests
    assert test.records[0].fs == 1.0
    assert not is_sampled(test.records[0])
    (data,) = Loops.reduce([test])
    assert float(data.groups.size[0]) == len(y) - 10
    left = np.asarray(data.misfit(theta()))
    assert np.abs(left).max() < 1e-8 * np.abs(force).max()
