"""Force response curves against shooting, closed forms and continuation."""

import numpy as np
import pytest
from joints import GOLDEN, joint
from scipy.optimize import brentq, minimize_scalar

import jbw
from jbw.errors import ConfigError, ModelError
from jbw.forced.curves import exact_points, force_ratio, peaks, resonance
from jbw.forced.equivalent import equivalent_motion
from jbw.forced.sweeps import base_gain, level_that_holds, swept, whole_curve
from jbw.oscillator.laws import laws_named
from jbw.oscillator.oscillator import Oscillator, oscillator_of
from jbw.oscillator.parameters import Scales

TAU = 2 * np.pi
SINE = GOLDEN["sine"]
CASES = {
    "bouc_wen_weak": "bouc_wen", "bouc_wen_folded": "bouc_wen", "iwan4": "iwan4",
    "jenkins": "jenkins",
}  # fmt: skip


def resonant(case, num_harmonics):
    motion = equivalent_motion(joint(CASES[case]), num_harmonics)
    return motion, resonance(motion, np.array([[SINE[case]["level"]]]))


@pytest.mark.parametrize("case", CASES)
def test_one_harmonic_has_the_peaks_widths_and_jumps_of_shooting(case):
    # |Y3/Y1| is below 5e-4 in every case: one harmonic misses its square and its coupling.
    _, found = resonant(case, 1)
    golden = SINE[case]
    peak_hz = found.peak.omega[0, 0] / TAU
    assert peak_hz == pytest.approx(golden["peak"]["hz"], rel=1e-5)
    assert found.peak.y[0, 0] == pytest.approx(golden["peak"]["Y1"], rel=1e-3)
    assert not found.peak.isolated[0, 0]
    if not golden["folds"]:
        assert np.isnan(found.jump_up[0, 0])
        assert np.isnan(found.jump_down[0, 0])
        # The golden half-power points are those of the largest displacement, which has the third
        # harmonic in it.
        assert found.half_power[0, 0] / TAU == pytest.approx(golden["half_power_hz"], rel=1e-5)
        assert found.quality[0, 0] == pytest.approx(golden["Q_half_power"], rel=1e-3)
        return
    low, high = golden["folds"]  # a softening curve: up where the frequency rises, down below
    assert found.jump_up[0, 0] / TAU == pytest.approx(high["hz"], rel=3e-6)
    assert found.jump_down[0, 0] / TAU == pytest.approx(low["hz"], rel=3e-6)
    assert found.y_up[0, 0] == pytest.approx(high["Y1"], rel=1e-3)
    assert found.y_down[0, 0] == pytest.approx(low["Y1"], rel=1e-3)
    assert np.isnan(found.quality[0, 0])  # withheld between folds


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_eight_harmonics_have_the_largest_displacement_of_shooting(case):
    """The golden peak is that of the largest displacement, found here by a parabola."""
    motion, found = resonant(case, 8)
    golden = SINE[case]["peak"]
    place = np.linspace(-0.02, 0.02, 8)[None, None]  # without the peak itself
    near = exact_points(motion, found.peak, place)
    largest = (near.y * motion.shapes(near.y, near.omega)[0])[0, 0]
    fitted = np.polynomial.Polynomial.fit(place[0, 0], np.log(largest), 4)
    # The maximum nearest to the peak of the first harmonic.
    top = min(fitted.deriv().roots(), key=abs).real
    frequency = np.polynomial.Polynomial.fit(place[0, 0], near.omega[0, 0], 4)(top)
    # The maximum is flat: with Q = 41 an error of 1e-11 in it moves its frequency by 5e-8.
    flat = 1e-7 if case == "iwan4" else 1.2e-8
    assert frequency / TAU == pytest.approx(golden["hz"], rel=flat)
    assert np.exp(fitted(top)) == pytest.approx(golden["y_max"], rel=1e-6)
    for fold, jump in zip(SINE[case]["folds"], (found.jump_down, found.jump_up), strict=False):
        assert jump[0, 0] / TAU == pytest.approx(fold["hz"], rel=1e-7)


def test_folds_begin_at_the_golden_level():
    """The onset is known to 1e-3 of the level."""
    motion = equivalent_motion(joint("bouc_wen"))
    onset = SINE["bouc_wen_onset_of_folding"]["level"]
    found = resonance(motion, onset * np.array([[0.997, 1.003]]))
    assert np.isfinite(found.jump_up).tolist() == [[False, True]]


def test_a_linear_curve_has_its_closed_form():
    omega_n, zeta, level = 120.0, np.array([0.01, 0.2]), 0.3
    found = resonance(equivalent_motion(Oscillator(omega_n, zeta)), np.full((2, 1), level))
    peak = omega_n * np.sqrt(1 - 2 * zeta**2)
    # Roundoff of a square root at a smooth extreme.
    assert found.peak.omega[:, 0] == pytest.approx(peak, rel=1e-9)
    highest = level / (2 * zeta * omega_n**2 * np.sqrt(1 - zeta**2))
    assert found.peak.y[:, 0] == pytest.approx(highest, rel=1e-9)
    split = 2 * zeta * np.sqrt(1 - zeta**2)
    ends = omega_n * np.sqrt(1 - 2 * zeta**2 + np.outer([-1, 1], split))
    assert found.half_power[:, 0].T == pytest.approx(ends, rel=1e-9)


def test_a_stiffening_spring_jumps_as_its_cubic_equation():
    """Duffing's curve by one harmonic is a cubic in Y^2: at a jump two of its roots are one."""
    omega_n, zeta, cubic, level = 100.0, 0.01, 4e9, 2.0
    spring = oscillator_of({"omega_n": omega_n, "zeta": zeta, "cubic": cubic}, ("cubic",))
    found = resonance(equivalent_motion(spring), np.array([[level]]))

    def amplitudes(omega):
        """Roots Y^2 of ((w0^2 - w^2) + 3/4 k Y^2)^2 Y^2 + (c w Y)^2 = A^2."""
        a, b, c = 0.75 * cubic, omega_n**2 - omega**2, 2 * zeta * omega_n * omega
        roots = np.roots([a**2, 2 * a * b, b**2 + c**2, -(level**2)])
        return np.sqrt(roots[np.abs(roots.imag) < 1e-6 * np.abs(roots)].real)

    up, down = found.jump_up[0, 0], found.jump_down[0, 0]
    assert omega_n < up < down  # it stiffens: a falling sweep jumps up, a rising one down
    for jump, inward in ((up, 1), (down, -1)):
        assert len(amplitudes(jump * (1 + inward * 1e-7))) == 3
        assert len(amplitudes(jump * (1 - inward * 1e-7))) == 1
    grid = np.linspace(0.95, 1.3, 101) * omega_n
    motion = equivalent_motion(spring)
    for upward, pick in ((True, max), (False, min)):
        sweep = np.abs(swept(motion, peaks(motion, np.array([[level]])), grid, upward=upward))[0, 0]
        expected = [pick(amplitudes(omega)) for omega in grid]
        # The table between amplitudes, times the slope at a resonance.
        assert sweep == pytest.approx(expected, rel=1e-4)


def test_a_quadratic_drag_has_its_closed_loop_and_its_force_rises_as_that_says():
    """A drag c |v| v loses 8 c omega^2 Y / 3 pi: its slope by frequency counts as viscous."""
    omega_n, zeta, drag, level = 100.0, 0.01, 40.0, 2.0
    theta = {"omega_n": omega_n, "zeta": zeta, "quadratic_damping": drag}
    motion = equivalent_motion(oscillator_of(theta, ("quadratic_damping",)))
    y, omega, lost = 5e-3, 103.0, 8 * drag / (3 * np.pi)
    loops = motion.loops(np.array([[y]]), np.array([[omega]]))
    viscous = 2 * zeta * omega_n + 2 * lost * omega * y
    expected = omega_n**2, -lost * omega**2 * y, viscous, 0.0, -lost * omega**2, 2 * lost * omega
    # Central differences of a product of powers below the third have roundoff over 1e-4 alone.
    assert np.ravel(loops) == pytest.approx(expected, rel=1e-9, abs=1e-6)
    side = np.array([[-1.0, 1.0]])
    point = exact_points(motion, peaks(motion, np.array([[level]])), side)
    damping = 2 * zeta * omega_n * point.omega + lost * point.omega**2 * point.y
    squares = (omega_n**2 - point.omega**2) ** 2 + damping**2
    assert point.y * np.sqrt(squares) == pytest.approx(level, rel=1e-9)
    rise = 1.0 + damping * lost * point.omega**2 * point.y / squares
    assert point.rise == pytest.approx(rise, rel=1e-9)


def test_stability_is_that_of_the_branch_between_the_jumps():
    motion, found = resonant("bouc_wen_folded", 1)
    curve = whole_curve(motion, found.peak, (TAU * 19, TAU * 20.5))
    between = (curve.y > found.y_up[..., None]) & (curve.y < found.y_down[..., None])
    below = curve.omega < found.peak.omega[..., None]
    assert np.array_equal(~curve.stable, between & below)
    assert np.any(~curve.stable)


@pytest.mark.slow
def test_strong_softening_beside_a_spring_needs_its_higher_harmonics():
    """The full balance at the frequency of the peak, the library's reference, has its amplitude."""
    theta = {
        "omega_n": 125.0, "zeta": 0.02, "alpha": 9000.0, "delta": 600.0, "gamma": 300.0,
        "cubic": 1e9,
    }  # fmt: skip
    spring, level = oscillator_of(theta, ("bouc_wen", "cubic")), 4.0
    one, eight = (peaks(equivalent_motion(spring, n), np.array([[level]])) for n in (1, 8))
    omega = eight.omega[0, 0] * np.array([0.999, 1.0, 1.001])
    beside, top, above = np.abs(np.asarray(jbw.steady_state(spring, omega, level, 8))[:, 0])
    # Both stop at 1e-8 of their residuals.
    assert eight.y[0, 0] == pytest.approx(top, rel=1e-7)
    assert max(beside, above) < top
    assert abs(one.y[0, 0] / top - 1) > 5e-3  # so that the harmonics are tested at all


@pytest.mark.slow
@pytest.mark.parametrize(("law", "level"), [("iwan4", 0.5), ("iwan4", 2.0), ("jenkins", 1.0)])
def test_the_full_balance_peaks_there_in_macroslip(law, level):
    """Beyond what the golden cases reach: the whole joint slips."""
    motion = equivalent_motion(joint(law), 8)
    found = peaks(motion, np.array([[level]]))
    omega = found.omega[0, 0] * np.array([0.999, 1.0, 1.001])
    below, top, above = np.abs(np.asarray(jbw.steady_state(joint(law), omega, level, 8))[:, 0])
    # Both stop at 1e-8 of their residuals.
    assert found.y[0, 0] == pytest.approx(top, rel=1e-7)
    assert max(below, above) < top


def test_the_held_level_gives_the_curve_back():
    motion, found = resonant("iwan4", 1)
    peak = found.peak
    held = level_that_holds(motion, peak.y, peak.omega)
    assert held == pytest.approx(peak.level, rel=1e-9)


def test_a_moving_base_drives_the_golden_motion():
    golden = SINE["base_bouc_wen"]
    motion = equivalent_motion(joint("bouc_wen"))
    found = peaks(motion, np.array([[golden["base_acceleration"]]]))
    assert found.omega[0, 0] / TAU == pytest.approx(golden["hz"], rel=1e-5)
    assert found.y[0, 0] == pytest.approx(golden["relative_y_max"], rel=1e-3)
    ratio = force_ratio(motion.loops(found.y, found.omega), found.omega)
    gain = np.abs(base_gain(ratio, found.omega))[0, 0]
    assert gain == pytest.approx(golden["transmissibility_first_harmonic"], rel=1e-3)


def test_a_linear_base_has_its_closed_transmissibility():
    golden = SINE["base_linear"]
    zeta, ratio = golden["zeta"], np.array([1.0, np.sqrt(2.0)])
    force = 1 - ratio**2 + 2j * zeta * ratio
    expected = [golden["transmissibility_at_1"], golden["transmissibility_at_sqrt2"]]
    assert np.abs(base_gain(force, ratio)) == pytest.approx(expected, rel=1e-12)
    fine = golden["ratio_of_largest_transmissibility"]
    largest = np.abs(base_gain(1 - fine**2 + 2j * zeta * fine, np.array(fine)))
    assert largest == pytest.approx(golden["largest_transmissibility"], rel=1e-12)


def test_what_cannot_have_a_curve_is_refused():
    with pytest.raises(ModelError, match="peak"):
        peaks(equivalent_motion(Oscillator(120.0, 0.75)), np.array([[1.0]]))
    with pytest.raises(ConfigError, match="num_harmonics"):
        equivalent_motion(joint("bouc_wen"), 0)


def prior_mean(law):
    """Parameters of a law in the middle of its prior, by logarithms where positive."""
    bounds = law.prior(Scales(125.0, 0.005, 1e-3))
    return {
        name: np.sqrt(low * high) if low > 0 else 0.5 * (low + high)
        for name, (low, high) in bounds.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["bouc_wen_nu", "masing_power", "masing_exponential", "quadratic_damping", "stop"]
)
def test_any_law_peaks_where_scipy_finds_the_least_force(name):
    """SciPy minimises the force of an amplitude over frequency, and finds the amplitude by halving.

    Each evaluation asks the law for its loop at that frequency itself.
    """
    (law,) = laws_named((name,))
    spring = oscillator_of({"omega_n": 125.0, "zeta": 0.005} | prior_mean(law), (name,))
    level = 0.1

    def least(y):
        def force(omega):
            loop = spring.loop(y, omega)
            viscous = 2 * spring.zeta * spring.omega_n * omega
            return y * np.hypot(spring.k + loop.stiffness - omega**2, viscous + loop.damping)

        return minimize_scalar(force, bounds=(100.0, 200.0), options={"xatol": 1e-9})

    found = peaks(equivalent_motion(spring), np.array([[level]]))
    y = brentq(lambda y: least(y).fun - level, 0.5 * found.y[0, 0], 2 * found.y[0, 0], xtol=1e-12)
    assert found.y[0, 0] == pytest.approx(y, rel=1e-7)
    # A minimum is known to the root of roundoff.
    assert found.omega[0, 0] == pytest.approx(least(y).x, rel=1e-7)
