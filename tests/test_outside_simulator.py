"""The integrator of `benchmarks/outside` against closed forms, SciPy and golden transients."""

import json
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import scipy.signal
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from outside.plants import LAWS, draw_plant, kappa, masing, steady_truth, stuck, truth_of
from outside.records import KINDS, sound
from outside.simulator import Plant, force_along, free_decay, library, march

pytestmark = pytest.mark.skipif(library() is None, reason="needs a C compiler")
GOLDEN = json.loads(Path(__file__).with_name("golden_laws.json").read_text())
OMEGA_N, ZETA, FS = (GOLDEN["conventions"][name] for name in ("omega_n", "zeta", "fs"))


def test_a_linear_decay_is_its_closed_form():
    zeta, per_period = 0.01, 20.0
    y, v, a, *_ = free_decay(Plant(zeta=zeta), 2000, per_period, (1.0, 0.5))
    t = np.arange(2000) * 2 * np.pi / per_period
    w = np.sqrt(1 - zeta**2)
    exact = np.exp(-zeta * t) * (np.cos(w * t) + (0.5 + zeta) / w * np.sin(w * t))
    # RK4 turns h^4 / 120 too little a radian: 1.2e-8 of the 63 radians that the motion lasts.
    np.testing.assert_allclose(y, exact, atol=1e-6)
    np.testing.assert_allclose(a, -y - 2 * zeta * v, atol=1e-14)  # the equation itself


def test_a_linear_sweep_is_that_of_scipy():
    zeta, per_period, substeps, count = 0.02, 16.0, 12, 4000
    s = np.arange(count) / count
    u = np.sin(2 * np.pi * 250 * (0.7 * s + 0.3 * s**2))
    n = np.arange(count)
    fine = np.interp(np.arange(2 * substeps * (count - 1) + 1) / (2 * substeps), n, u)
    second = {"omega_2": 1.3, "zeta_2": 0.01, "gain_2": 0.7}
    found = march(Plant(zeta=zeta, **second), fine, per_period / (2 * np.pi), substeps)
    for rows, w, z, gain in ((found[:2], 1.0, zeta, 1.0), (found[3:5], 1.3, 0.01, 0.7)):
        system = scipy.signal.lti(
            [[0, 1], [-w * w, -2 * z * w]], [[0], [gain]], np.eye(2), [[0], [0]]
        )
        # Both take the drive as straight between samples, `lsim` exactly; h^4 / 120 over the
        # some 50 radians that the motion remembers.
        _, exact, _ = scipy.signal.lsim(system, u, n * 2 * np.pi / per_period)
        np.testing.assert_allclose(rows.T, exact, atol=3e-6 * np.abs(exact).max())


# The slope of |Z|^0.6 is infinite at zero, which costs order: it takes more steps.
@pytest.mark.parametrize(("nu", "substeps"), [(1.0, 9), (0.6, 36)])
def test_bouc_wen_is_that_of_a_stock_solver(nu, substeps):
    plant = Plant(zeta=0.01, alpha=0.2, delta=0.4, gamma=0.3, nu=nu)

    def rate(t, x):
        y, v, z = x
        size = abs(z) ** nu
        dz = plant.alpha * v - plant.gamma * abs(v) * np.sign(z) * size - plant.delta * v * size
        return [v, 0.05 * np.sin(0.95 * t) - 0.02 * v - 0.8 * y - z, dz]

    per_period, count = 20.0, 400
    fs = per_period / (2 * np.pi)
    t = np.arange(2 * substeps * (count - 1) + 1) / (2 * substeps * fs)
    y, v, *_ = march(plant, 0.05 * np.sin(0.95 * t), fs, substeps)
    times = np.arange(count) / fs
    exact = solve_ivp(rate, (0, times[-1]), [0, 0, 0], "DOP853", times, rtol=1e-11, atol=1e-12)
    # Second order where velocity or force change sign: (2 pi / 180)^2 / 12 of alpha's share.
    np.testing.assert_allclose(y, exact.y[0], atol=2e-5 * np.abs(y).max())
    np.testing.assert_allclose(v, exact.y[1], atol=2e-5 * np.abs(v).max())


def golden_plants():
    """Return the laws of the golden file with the error that each may have."""
    common = {"omega_n": OMEGA_N, "zeta": ZETA}
    many = 900  # sliders: their error falls as 1 / number^2

    def iwan(case):
        phi_max = case["derived"]["phi_max"]
        edges = phi_max * (np.arange(many + 1) / many) ** 3
        chi, c = case["chi"], case["derived"]["R"]
        springs = c * np.diff(edges ** (1 + chi)) / (1 + chi)
        forces = c * np.diff(edges ** (2 + chi)) / (2 + chi)
        lump = case["derived"]["S"]
        return Plant(
            **common, springs=(*springs, lump), forces=(*forces, lump * phi_max)
        )  # fmt: skip

    def jenkins(case):
        springs = np.array(case["alpha"])
        return Plant(**common, springs=tuple(springs), forces=tuple(springs * case["phi"]))

    def bouc_wen(case):
        return Plant(**common, **{name: case[name] for name in ("alpha", "delta", "gamma", "nu")})

    gap = GOLDEN["gap_series_bouc_wen"]
    lugre = GOLDEN["lugre"]
    # Kinks and reversals within a step cost h^2; the last column is what 24 steps a sample leave.
    return {
        "jenkins": (jenkins(GOLDEN["jenkins"]), 2e-5),
        "jenkins_array": (jenkins(GOLDEN["jenkins_array"]), 2e-5),
        "iwan4_a": (iwan(GOLDEN["iwan4_a"]), 2e-5),
        "iwan4_b": (iwan(GOLDEN["iwan4_b"]), 2e-5),
        "iwan4_a_plus_cubic": (
            replace(iwan(GOLDEN["iwan4_a"]), cubic=GOLDEN["iwan4_a_plus_cubic"]["k3"]), 2e-5,
        ),
        "bouc_wen_1": (bouc_wen(GOLDEN["bouc_wen_1"]), 1e-5),
        "bouc_wen_05": (bouc_wen(GOLDEN["bouc_wen_05"]), 1e-5),
        "bouc_wen_2": (bouc_wen(GOLDEN["bouc_wen_2"]), 1e-5),
        "gap_series_bouc_wen": (
            Plant(**common, gap=gap["gap_half_width"], gap_alpha=gap["alpha"],
                  gap_delta=gap["delta"], gap_gamma=gap["gamma"]), 2e-5,
        ),
        "lugre": (
            Plant(**common, sigma_0=lugre["sigma0"], sigma_1=lugre["sigma1"],
                  sigma_2=lugre["sigma2"], coulomb=lugre["F_c"], static=lugre["F_s"],
                  stribeck=lugre["v_s"]), 2e-5,
        ),
    }  # fmt: skip


@pytest.mark.parametrize("name", golden_plants() if library() else [])
def test_a_transient_is_the_event_located_one(name):
    plant, tolerance = golden_plants()[name]
    conventions, substeps = GOLDEN["conventions"], 24
    n = np.arange(conventions["N"])
    t = n / FS
    u = conventions["A"] * np.sin(2 * np.pi * 1.9 * t) * (
        np.sin(2 * np.pi * 17 * t) + 0.6 * np.sin(2 * np.pi * 41 * t + 0.7)
    )  # fmt: skip
    fine = np.interp(np.arange(2 * substeps * (len(n) - 1) + 1) / (2 * substeps), n, u)
    y, v, *_ = march(plant, fine, FS, substeps)
    for found, key in ((y, "y"), (v, "v")):
        exact = np.array(GOLDEN[name]["transient"][key])
        error = np.max(np.abs(found[conventions["indices"]] - exact)) / np.max(np.abs(exact))
        assert error < tolerance, key


def test_sliders_of_static_and_kinetic_friction_follow_the_path():
    case, many = GOLDEN["iwan5_static_kinetic"], 1000
    top, chi = case["derived"]["phi_max"], case["chi"]
    edges = top * (np.arange(many + 1) / many) ** 2
    springs = case["derived"]["R"] * np.diff(edges ** (1 + chi)) / (1 + chi)
    slips = (edges[1:] + edges[:-1]) / 2
    lump = case["derived"]["S"]
    plant = Plant(
        omega_n=np.sqrt(springs.sum() + lump), springs=(*springs, lump),
        forces=(*(springs * slips), lump * top), kinetic=case["theta"],
    )  # fmt: skip
    turns = GOLDEN["path"]["turning_points"]
    steps = 2000  # of each move; a slider's force jumps within one
    moves = [np.linspace(a, b, 2 * steps + 1)[1:] for a, b in pairwise(turns)]
    y = np.concatenate([[turns[0]], *moves])
    force = force_along(plant, y, np.zeros_like(y), 1.0, 1)
    at = np.arange(1, 2 * len(moves) + 1) * steps // 2
    # A bin of sliders and a step each hold 1e-3 of the force, and some jump at once.
    np.testing.assert_allclose(force[at], case["path_force"], atol=3e-3 * case["FS_static"])


def test_a_jenkins_loop_encloses_its_closed_form():
    k, slip, top = 0.3, 0.4, 1.0
    plant = Plant(springs=(k,), forces=(k * slip,))
    quarter = 1000  # half steps, so that corners of the loop are samples
    wave = np.concatenate([np.linspace(0, 1, quarter + 1), np.linspace(1, -1, 2 * quarter + 1)[1:],
                           np.linspace(-1, 1, 2 * quarter + 1)[1:]])  # fmt: skip
    force = force_along(plant, top * wave, np.zeros_like(wave), 1.0, 1)
    y = top * wave[::2]
    last = slice(quarter // 2, None)
    energy = np.trapezoid(force[last], y[last])
    assert energy == pytest.approx(4 * k * slip * (top - slip), rel=1e-12)  # corners are samples
    np.testing.assert_allclose(force[quarter // 2], (1 - k) * top + k * slip, rtol=1e-12)


def test_equivalent_stiffness_is_that_of_a_jenkins_element():
    k, slip, top = 0.3, 0.4, 1.0
    plant = Plant(springs=(k,), forces=(k * slip,))
    c = np.arccos(1 - 2 * slip / top)
    exact = 1 - k + k / np.pi * (c - np.sin(2 * c) / 2) + 4j * k * slip * (top - slip) / np.pi
    # 2048 points of a force with corners: (2 pi / 2048)^2.
    assert kappa(plant, top) == pytest.approx(exact, abs=1e-5)


@pytest.mark.parametrize(
    ("plant", "slope"),
    [
        # d zeta = 4 / (3 pi) c Y, and 3/8 c Y^2, of small damping (frequency is one).
        (Plant(zeta=2e-3, quadratic_damping=2e-3), lambda y: 4 / (3 * np.pi) * 2e-3 * y),
        (Plant(zeta=2e-3, cubic_damping=2e-3), lambda y: 3 / 8 * 2e-3 * y**2),
    ],
)
@pytest.mark.parametrize("find", [truth_of, steady_truth])
def test_the_truth_of_nonlinear_damping_is_its_slow_flow(plant, slope, find):
    truth = find(plant, 1.0)
    amplitude = np.array([0.2, 0.5, 1.0])
    _, zeta = truth.at(amplitude, 0)
    # Second order in damping, and half a period to either side: 1e-4 of it; cubes are curved.
    np.testing.assert_allclose(zeta, plant.zeta + slope(amplitude), rtol=1e-3)


@pytest.mark.parametrize("find", [truth_of, steady_truth])
def test_the_truth_of_a_cubic_spring_is_its_backbone(find):
    truth = find(Plant(zeta=1e-3, cubic=0.01), 1.0)
    amplitude = np.array([0.2, 0.5, 1.0])
    omega, zeta = truth.at(amplitude, 0)
    # Second order in the change of 0.4 %: (3/8 * 0.01)^2 = 1.4e-5.
    np.testing.assert_allclose(omega, 1 + 3 / 8 * 0.01 * amplitude**2, atol=2e-5)
    # Of an acceleration the same motion is read at omega^2 times the amplitude.
    by_acceleration = truth.at(amplitude * omega**2, 2)
    np.testing.assert_allclose(by_acceleration[0], omega, rtol=2e-8)  # zeta^2 times the slope
    np.testing.assert_allclose(by_acceleration[1], zeta, rtol=1e-6)


def test_sliders_hold_the_stiffness_of_their_density():
    plant = masing(lambda slip: slip**-0.5, 2.0, 0.25)
    assert stuck(plant) == pytest.approx(1.0)
    assert plant.springs[-1] == pytest.approx(0.25)


@pytest.mark.parametrize("law", LAWS)
def test_every_law_dissipates_and_is_as_strong_as_it_was_asked(law):
    rng = np.random.default_rng(3)
    plant = draw_plant(rng, law, 0.01, strong=False)
    change = kappa(plant, 1.0) - 1
    # Weak: at most a tenth of the damping of 1 %.
    assert max(abs(change.real), abs(change.imag)) / 2 < 1.01e-3
    assert change.imag > -1e-6  # no law gives energy, to the corners of a sampled loop


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_draws_the_same_record(kind):
    first, again = (sound(np.random.default_rng(5), kind) for _ in range(2))
    for role, x in first.channels.items():
        np.testing.assert_array_equal(x, again.channels[role])
    assert first.plant == again.plant
    assert all(np.isfinite(x).all() for x in first.channels.values())
