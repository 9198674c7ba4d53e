import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jbw.errors import JbwError
from jbw.oscillator.laws.hysteresis import steady_loop
from jbw.oscillator.oscillator import BoucWen
from jbw.paper.coefficients import Smoothing, closed_loop_stiffness, smoothing
from jbw.paper.kernels import (
    cubic_kernel,
    cubic_stiffness,
    h1,
    h3,
    softened_receptance,
    third_harmonic,
)
from jbw.paper.polynomial import (
    PolynomialOscillator,
    cubic_oscillator,
    kernel_1,
    kernel_2,
    kernel_3,
)

OMEGA_N = 2 * np.pi * 18.8
JOINT = BoucWen(OMEGA_N, 0.00444, 497.40, 340.21, 32.84)
FREQUENCIES = 2 * np.pi * np.array([5.0, 5.5, 6.0, 6.5, 6.75])
# The golden kernels are good to 1e-13, most of it from omega_0^2 - omega^2 near resonance.
GOLDEN_RTOL = 1e-13


def as_complex(pair):
    return complex(*pair)


def probed_system(case):
    omega_0, zeta = case["omega0"], case["zeta"]
    return PolynomialOscillator(
        2 * zeta * omega_0, omega_0**2, case.get("rho", 0.0), case["lambda3"]
    )


def test_kernels_match_golden(golden):
    for case in golden["volterra_H"]["cases"]:
        system, w = probed_system(case), case["w"]
        cubic = PolynomialOscillator(system.damping, system.stiffness, 0.0, system.lambda_3)
        found = [
            h1(w[0], case["omega0"], case["zeta"]),
            kernel_1(system, w[0]),
            kernel_2(system, w[0], w[1]),
            kernel_3(system, *w),
            kernel_3(cubic, *w),
        ]
        names = ["H1", "H1", "H2_ab", "H3", "H3_cubic_only"]
        expected = [as_complex(case[name]) for name in names]
        np.testing.assert_allclose(found, expected, rtol=GOLDEN_RTOL)


def test_leading_diagonal_of_the_paper_matches_golden(golden):
    case = golden["bayes"]["eq31_model"]
    joint = BoucWen(case["omega_n"], case["zeta"], case["alpha"], case["delta"], 32.84)
    omega = 2 * np.pi * np.array(case["f_hz"])
    expected = np.array([as_complex(pair) for pair in case["H3"]])
    from_lambda = cubic_kernel(omega, joint.omega_n, joint.zeta, np.array(case["lambda3"]))
    np.testing.assert_allclose(from_lambda, expected, rtol=GOLDEN_RTOL)
    printed = h3(joint, omega, np.array(case["Y"]), variant="printed")
    np.testing.assert_allclose(printed, expected, rtol=1e-12)


def test_the_paper_kernel_does_not_move_along_the_ridge(golden):
    case = golden["bayes"]["ridge"]
    joints = BoucWen(OMEGA_N, 0.00444, jnp.array(case["alpha"]), jnp.array(case["delta"]), 32.84)
    along = h3(joints, FREQUENCIES[2], case["Y"], variant="printed")
    assert np.ptp(np.abs(along)) < 1e-12 * np.abs(along[0])


@pytest.mark.parametrize("variant", ["least_squares", "chebyshev"])
def test_h3_projects_the_loop_it_is_given(variant):
    y_peak = np.array([0.00077, 0.00079, 0.00080, 0.00082, 0.00083])
    lambda_3 = smoothing(JOINT, y_peak, variant=variant).lambda_3
    expected = -lambda_3 * h1(FREQUENCIES, OMEGA_N, JOINT.zeta) ** 3
    expected = expected * h1(3 * FREQUENCIES, OMEGA_N, JOINT.zeta)
    np.testing.assert_allclose(h3(JOINT, FREQUENCIES, y_peak, variant=variant), expected)


def test_chebyshev_kernel_gives_the_in_phase_third_harmonic_of_the_loop():
    # y = Y cos(theta) in lambda_3 y^3 has the third harmonic lambda_3 Y^3 / 4.
    y_peak = 0.0008
    lambda_3 = smoothing(JOINT, y_peak, variant="chebyshev").lambda_3
    third = steady_loop(JOINT, y_peak).z_3
    assert lambda_3 * y_peak**3 / 4 == pytest.approx(float(third.real), rel=1e-9)


def test_h3_defaults_to_least_squares_and_rejects_unknown_variants():
    default = h3(JOINT, FREQUENCIES, 0.0008)
    np.testing.assert_array_equal(default, h3(JOINT, FREQUENCIES, 0.0008, variant="least_squares"))
    with pytest.raises(JbwError, match="variant"):
        h3(JOINT, FREQUENCIES, 0.0008, variant="quintic")


def test_cubic_oscillator_is_equation_26():
    polynomial = Smoothing(*map(jnp.asarray, (0.1, 480.0, 7.0, -6.7e7)))
    system = cubic_oscillator(JOINT, polynomial)
    assert system.damping == pytest.approx(2 * 0.00444 * OMEGA_N, rel=1e-15)
    assert system.stiffness == pytest.approx(OMEGA_N**2 - 497.40 + 480.0, rel=1e-15)
    assert system.rho == 0.0
    assert system.lambda_3 == -6.7e7


def test_third_harmonic_matches_the_true_oscillator(golden):
    checked = 0
    for case in golden["true_oscillator_steady"]["cases"]:
        if case["A"] > 10.0 or not 4.9 < case["f_hz"] < 7.0:
            continue
        joint = BoucWen(*(case[n] for n in ("omega_n", "zeta", "alpha", "delta", "gamma")))
        y_3 = third_harmonic(joint, 2 * np.pi * case["f_hz"], as_complex(case["Y1"]))
        ratio = complex(y_3) / as_complex(case["Y3"])
        # The formula's own error, stated in its docstring; 6.25 Hz is a third of omega_n.
        at_resonance = abs(case["f_hz"] - 6.25) < 0.1
        modulus, degrees = (0.012, 5.0) if at_resonance else (0.006, 0.3)
        assert abs(abs(ratio) - 1) < 1.05 * modulus
        assert abs(np.angle(ratio, deg=True)) < 1.05 * degrees
        checked += 1
    assert checked >= 5


def test_cubic_stiffness_inverts_the_kernel():
    kernel = cubic_kernel(FREQUENCIES, OMEGA_N, 0.00444, -6.7e7)
    # Four receptances in and out: their roundings, some of them near resonance.
    np.testing.assert_allclose(
        cubic_stiffness(kernel, FREQUENCIES, OMEGA_N, 0.00444), -6.7e7, rtol=1e-12
    )


def test_softened_receptance_is_that_of_less_stiffness():
    omega, softening = 3 * FREQUENCIES, 86.0
    by_hand = 1 / (OMEGA_N**2 - softening - omega**2 + 2j * 0.00444 * OMEGA_N * omega)
    # 1/H1 is known to a rounding of omega_n^2, over 1e2 of it near resonance.
    np.testing.assert_allclose(
        softened_receptance(omega, OMEGA_N, 0.00444, softening), by_hand, rtol=1e-12
    )


def test_closed_loop_stiffness_golden(golden):
    for case in golden["lambda"]["cases"]:
        alpha, delta, gamma, y_peak = (case[n] for n in ("alpha", "delta", "gamma", "Y"))
        printed = closed_loop_stiffness(alpha, delta, y_peak)
        corrected = closed_loop_stiffness(alpha, delta, y_peak, gamma)
        # A difference of two terms, each good to a rounding.
        size = 1e-14 * alpha * (delta**2 + gamma**2 + abs(delta) / y_peak)
        np.testing.assert_allclose(printed, case["paper_eq24_25"][3], rtol=0, atol=size)
        np.testing.assert_allclose(corrected, case["taylor_L2_with_y0_zero"][3], rtol=0, atol=size)


def test_kernels_are_differentiable_in_the_joint():
    # Reference: lambda_3 of (25) is linear in alpha, so d|H3|/d(alpha) = |H3| / alpha.
    def modulus(joint):
        return jnp.abs(h3(joint, FREQUENCIES[2], 0.0008, variant="printed"))

    slope = jax.jit(jax.grad(modulus))(JOINT).alpha
    assert float(slope) == pytest.approx(float(modulus(JOINT)) / JOINT.alpha, rel=1e-12)
    step = 1e-3

    def third(gamma):
        joint = BoucWen(OMEGA_N, 0.00444, 497.40, 340.21, gamma)
        return third_harmonic(joint, FREQUENCIES[2], 8e-4 - 2e-6j).real

    difference = (third(32.84 + step) - third(32.84 - step)) / (2 * step)
    # Central difference: truncation step^2, rounding 1e-16 / step.
    _, slope = jax.jvp(third, (32.84,), (1.0,))
    assert float(slope) == pytest.approx(float(difference), rel=1e-6)
