"""What the result keeps for the figures: the backbone, its loops, and the steps' verdicts."""

import numpy as np
import pytest

from jbw.results.run import RunSummary
from jbw.study.summary import steps_group
from jbw.verification.backbone import NUM_AMPLITUDES, backbone_group

# The paper's joint, twice: a band of no width.
DRAWS = {"omega_n": 2 * np.pi * 18.8, "zeta": 0.00444, "alpha": 497.40, "delta": 340.21}
DRAWS = {name: np.full(2, value) for name, value in {**DRAWS, "gamma": 32.84}.items()}
Y_PEAK = 6.4e-3
LAWS = ("bouc_wen",)


@pytest.fixture(scope="module")
def group():
    return backbone_group(DRAWS, Y_PEAK, LAWS)


def marched(y_peak, size=400, cycles=40):
    """Z along the last of some cycles, by Runge and Kutta's fourth order in y."""
    alpha, delta, gamma = (DRAWS[name][0] for name in ("alpha", "delta", "gamma"))

    def slope(z, sense):
        return alpha - gamma * sense * z - delta * abs(z)

    y = y_peak * np.cos(np.linspace(0, 2 * np.pi, size + 1))
    z = np.zeros(size + 1)
    for _ in range(cycles):
        z[0] = z[-1]
        for i, dy in enumerate(np.diff(y)):
            sense = np.sign(dy)
            a = slope(z[i], sense)
            b = slope(z[i] + dy / 2 * a, sense)
            c = slope(z[i] + dy / 2 * b, sense)
            z[i + 1] = z[i] + dy / 6 * (a + 2 * b + 2 * c + slope(z[i] + dy * c, sense))
    return y, z


def test_the_loops_are_those_of_the_equation(group):
    y, z = marched(Y_PEAK)
    half = group["loop_y"].values[-1][:64]
    expected = np.interp(-half, -y[:201], z[:201])
    # Straight lines between 200 points of a half loop: curvature times the step's square, 1e-3.
    np.testing.assert_allclose(group["loop_z"].values[1, -1][:64], expected, atol=2e-3 * z.max())
    whole = group["loop_z"].values[1, -1]
    np.testing.assert_allclose(whole[64:], -whole[:64], rtol=1e-12)
    slip = whole - 497.40 * group["loop_y"].values[-1]
    np.testing.assert_allclose(group["loop_slip"].values[1, -1], slip, rtol=1e-9, atol=1e-12)


def test_the_curves_start_at_the_stuck_joint_and_bend(group):
    assert group.sizes["amplitude"] == NUM_AMPLITUDES
    assert group["amplitude"].values[-1] == pytest.approx(1.25 * Y_PEAK)
    frequency, damping = group["frequency"].values[1], group["damping"].values[1]
    small = backbone_group(DRAWS, 1e-9, LAWS)
    assert small["frequency"].values[1, 0] == pytest.approx(18.8, rel=1e-7)
    assert small["damping"].values[1, 0] == pytest.approx(0.00444, rel=1e-5)
    assert np.all(np.diff(frequency) < 0)
    assert np.all(np.diff(damping) > 0)
    # Energy of the marched loop, in the damping of the amplitude next to it.
    y, z = marched(group["amplitude"].values[31])
    lost = abs(np.trapezoid(z, y))
    omega = 2 * np.pi * frequency[31]
    added = lost / (2 * np.pi * omega**2 * y.max() ** 2)
    # The trapezoids of 400 steps leave 1e-4 of the area.
    assert damping[31] == pytest.approx(0.00444 * DRAWS["omega_n"][0] / omega + added, rel=1e-3)


def test_there_is_none_without_a_joint_or_a_displacement():
    assert backbone_group(DRAWS, 0.0, LAWS) is None
    assert backbone_group(DRAWS, np.nan, LAWS) is None
    linear = {name: DRAWS[name] for name in ("omega_n", "zeta")}
    assert backbone_group(linear, Y_PEAK, LAWS) is None


def test_a_step_is_as_good_as_its_worst_parameter(tmp_path):
    parameters = {
        "alpha": {"ess_bulk": 812.0, "r_hat": 1.004},
        "delta": {"ess_bulk": 90.5, "r_hat": 1.02},
        "held": {"ess_bulk": None, "r_hat": None},
    }
    record = {
        "main": "joint",
        "steps": {
            "linear": {"parameters": {"zeta": {"mean": 0.004}}, "statements": []},
            "joint": {
                "verdict": {"status": "failed"},
                "parameters": parameters,
                "wall_time_s": 12.5,
            },
        },
    }
    found = steps_group(RunSummary.read(record))
    joint = found.sel(step="joint")
    assert (joint["verdict"].item(), float(joint["ess"]), float(joint["r_hat"])) == (
        "failed", 90.5, 1.02,
    )  # fmt: skip
    assert np.isnan(found.sel(step="linear")["ess"])
    path = tmp_path / "steps.nc"
    found.to_netcdf(path, engine="h5netcdf")
    assert found.attrs == {"main": "joint"}
