"""A change of readings as one of torque: closed forms, a fleet of known trend, and refusals."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from decays import BAND, FS, SETTLE
from scipy.stats import t as student

import jbw
from jbw.measurement.records import Record, Test
from jbw.population.coordinates import Pooled
from jbw.population.population import Population
from jbw.population.prior import CovariateDesign
from jbw.watch import readings
from jbw.watch.detection import ReferenceReadings
from jbw.watch.statement import PLACES, Trend, as_plain, sentence, state, torque_after, words_of

SLOPE = np.array([0.8, -0.4])  # of frequency [Hz] and ln zeta on ln torque
COVARIANCE = np.array([[4e-4, 1e-4], [1e-4, 9e-4]])
STEP = PLACES[1] - PLACES[0]


def known(num_draws=50, slope=SLOPE):
    return Trend(8.0, np.tile(slope, (num_draws, 1)), 4.0, 12.0)


def test_many_references_and_one_slope_leave_weighted_least_squares():
    """Of a known covariance, x is normal about g'Wd / g'Wg, with the expectation N(0, 1) in it."""
    num, away = 4, np.array([-0.21, 0.13])
    torque = torque_after(away, ReferenceReadings(10**6, np.zeros(2), COVARIANCE), num, known())
    weight = np.linalg.inv(COVARIANCE / num)
    precision = SLOPE @ weight @ SLOPE + 1.0
    middle, reach = SLOPE @ weight @ away / precision, 2.5758293 / np.sqrt(precision)
    # Quantiles of a sum over places; a covariance of 1e6 readings is known to 1e-3.
    for value, expected in (
        (torque.after, middle), (torque.low, middle - reach), (torque.high, middle + reach),
    ):  # fmt: skip
        assert np.log(value / 8.0) == pytest.approx(expected, abs=STEP)
    assert (torque.before, torque.explained, torque.inside) == (8.0, True, True)


def test_few_references_leave_students_t():
    """t of n0 - 1 degrees of freedom and the scale (1 + q / (n0 - 1)) / g'Wg about the same."""
    num, references, away = 1, 8, 1e-2 * np.array([-2.1, 1.3])
    scale = 1e-2 * COVARIANCE * 0.01  # narrow, so that what is expected does not matter
    torque = torque_after(away, ReferenceReadings(references, np.zeros(2), scale), num, known())
    weight = np.linalg.inv(scale * (1 / num + 1 / references))
    precision = SLOPE @ weight @ SLOPE
    middle = SLOPE @ weight @ away / precision
    misfit = (away - SLOPE * middle) @ weight @ (away - SLOPE * middle)
    reach = student.ppf(0.995, 7) * np.sqrt((1 + misfit / 7) / precision)
    assert np.log(torque.after / 8.0) == pytest.approx(middle, abs=STEP)
    assert np.log(torque.low / 8.0) == pytest.approx(middle - reach, abs=STEP)
    assert np.log(torque.high / 8.0) == pytest.approx(middle + reach, abs=STEP)


def test_without_a_trend_nothing_is_learnt():
    """The interval is that of what was expected: factors of exp(2.58) either way."""
    reference = ReferenceReadings(20, np.zeros(2), COVARIANCE)
    torque = torque_after(np.array([-0.2, 0.1]), reference, 1, known(slope=np.zeros(2)))
    assert np.log([torque.low / 8.0, torque.high / 8.0]) == pytest.approx([-2.576, 2.576], abs=1e-2)


def test_what_no_torque_explains_is_said():
    reference = ReferenceReadings(20, np.zeros(2), COVARIANCE)
    torque = torque_after(np.array([-0.4, -0.4]), reference, 1, known())  # lower and less damped
    assert not torque.explained
    far = torque_after(1.5 * SLOPE, reference, 1, known())
    assert not far.inside
    assert far.after > 8.0


def test_an_alarm_is_stated_as_a_torque():
    rng = np.random.default_rng(1)
    root = np.linalg.cholesky(COVARIANCE)
    references = rng.standard_normal((20, 2)) @ root.T
    x = np.log(6.1 / 8.0)
    watched = rng.standard_normal((4, 2)) @ root.T + SLOPE * x
    watch_state = state(references, watched, 1e-3, trend=known())
    assert watch_state.change is not None
    assert watch_state.change.torque is not None
    assert watch_state.change.torque.low < 6.1 < watch_state.change.torque.high
    statement = sentence(watch_state, [f"hit {i}" for i in range(4)], 20)
    assert words_of(watch_state.change.torque) in statement
    plain = json.loads(json.dumps(as_plain(watch_state)))
    assert plain["change"]["torque"]["before"] == 8.0
    assert "torque" not in as_plain(state(references, watched, 1e-3))["change"]


# Of a fleet of cubic springs: powers of torque, and the peak that its units were driven to.
POWER = {"omega_n": 0.02, "zeta": -0.3, "cubic": -1.0}
MEANS = {"omega_n": 2 * np.pi * 20.0, "zeta": 2e-3, "cubic": 2e6}
Y_PEAK = 5e-3


def a_fleet(status="ok", y_peak=Y_PEAK):
    """A fleet and its population, both known exactly."""
    logs = np.log([list(MEANS.values())])
    draws = xr.DataArray(logs, dims=("draw", "parameter"), coords={"parameter": list(MEANS)})
    units = {f"/{name}": xr.Dataset({"draws": draws}) for name in "ab"}
    root = xr.Dataset(coords={"unit": list("ab")}, attrs={"laws": json.dumps(["cubic"])})
    fleet = xr.DataTree.from_dict({"/": root, **units})
    for name, peak in zip("ab", (2 * y_peak, y_peak), strict=True):
        fleet[name].attrs["y_peak"] = peak
    design = CovariateDesign(("mean", "torque"), np.ones((2, 2)), 5.0)
    line = np.stack([logs[0], list(POWER.values())], axis=-1)[None, None]
    fleet_population = Population(
        Pooled(tuple(MEANS), logs, np.zeros((1, 3, 3)), np.eye(3), tuple(MEANS), np.zeros((0, 3))),
        design,
        SimpleNamespace(),
        {"line": line, "tau": np.zeros((1, 1, 3)), "scatter": 1e-30 * np.eye(3)[None, None]},
        {"status": status, "torque": [4.0, 12.0]},
    )
    return fleet, fleet_population


@pytest.fixture
def trend_at(monkeypatch):
    """The trend by such a fleet, of readings of a velocity."""

    def found(torque=8.0, amplitudes=(0.3, 0.2), **of_fleet):
        fleet, population = a_fleet(**of_fleet)
        monkeypatch.setattr(readings, "population_of", lambda fleet, report: population)
        record = Record(FS, {"velocity": np.zeros(4096)}, {"velocity": "m/s"}, "hit")
        test = Test("decay", (record,), "impacts", band_hz=BAND, settle=SETTLE)
        return readings.trend_of(fleet, torque, amplitudes, test, report=said.append)

    said: list[str] = []
    found.said = said
    return found


def duffing(torque, amplitude):
    """Frequency [Hz] and ln zeta of a cubic spring: omega^2 = omega_n^2 + 3/4 lambda Y^2."""
    at = {name: mean * (torque / 5.0) ** POWER[name] for name, mean in MEANS.items()}
    omega = at["omega_n"]
    for _ in range(50):
        omega = np.sqrt(at["omega_n"] ** 2 + 0.75 * at["cubic"] * (amplitude / omega) ** 2)
    return omega / (2 * np.pi), np.log(at["zeta"] * at["omega_n"] / omega)


def test_slopes_are_those_of_the_fleets_own_joints(trend_at):
    fleet_trend = trend_at()
    (f_8, z_8), (g_8, w_8) = (duffing(8.0, amplitude) for amplitude in (0.3, 0.2))
    (f_9, z_9), (g_9, w_9) = (duffing(8.8, amplitude) for amplitude in (0.3, 0.2))
    expected = np.array([f_9 - f_8, z_9 - z_8, g_9 - f_9 - (g_8 - f_8), w_9 - w_8]) / np.log(1.1)
    # Three steps of the velocity to a displacement, each a hundredth of the one before.
    assert np.allclose(fleet_trend.slopes, expected, rtol=1e-3, atol=1e-5)
    assert (fleet_trend.least, fleet_trend.most, fleet_trend.torque) == (4.0, 12.0, 8.0)
    # 0.1 of ln preload over the sd 0.55 of ln torque: 0.01 / (0.302 + 0.01).
    assert "slopes are about 3 % too small" in trend_at.said[-1]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"torque": None}, "does not state the torque of its joint"),
        ({"status": "not assessed"}, "status of the population is not assessed"),
        (
            {"amplitudes": (1.0, 0.3)},
            r"displacement of 0\.00796 m, .* up to this displacement: 0\.005 m",
        ),
        ({"y_peak": np.nan}, "some units state no displacement"),
    ],
)
def test_a_trend_that_is_not_known_is_refused(trend_at, wrong, message):
    with pytest.raises(jbw.DataError, match=message):
        trend_at(**wrong)
