"""Random vibration against closed forms, the golden Monte Carlo and an independent one."""

import json
from pathlib import Path

import numpy as np
import pytest
from joints import BOUC_WEN, GOLDEN, joint
from scipy.integrate import quad

from jbw.errors import ConfigError, ModelError
from jbw.forced.equivalent import equivalent_motion
from jbw.forced.profiles import profile_of, read_profile
from jbw.forced.random import random_response
from jbw.oscillator.oscillator import Oscillator, oscillator_of

# Made by `benchmarks/random_motion.py`, without jbw.
MONTE_CARLO = json.loads((Path(__file__).parents[1] / "golden_random.json").read_text())
ONE = np.ones((1, 1))
TAU = 2 * np.pi


def flat(density, band=(5.0, 80.0)):
    return lambda freq_hz: np.where((freq_hz > band[0]) & (freq_hz < band[1]), density, 0.0)


def rms_in_band(response, order=0, band=(5.0, 80.0)):
    freq_hz = np.linspace(*band, 20001)
    return np.sqrt(np.trapezoid(response.spectrum(freq_hz, order)[0], freq_hz))


def test_a_linear_joint_has_miles_rms():
    golden = GOLDEN["random"]["linear"]
    joint_alone = Oscillator(TAU * golden["hz"], golden["zeta"])
    found = random_response(equivalent_motion(joint_alone), flat(golden["psd"]), ONE)
    assert found.rms()[0] == pytest.approx(golden["rms_y_white"], rel=1e-9)
    assert found.frequency_hz[0] == pytest.approx(golden["hz"], rel=1e-12)
    assert found.damping[0] == pytest.approx(golden["zeta"], rel=1e-9)
    # The golden number of the band, by the trapezium rule over 0.1 of the half-power width.
    assert rms_in_band(found) == pytest.approx(golden["rms_y_5_80Hz"], rel=1e-6)
    assert rms_in_band(found, 1) == pytest.approx(golden["rms_v_5_80Hz"], rel=1e-6)
    freq_hz = np.linspace(5.0, 80.0, 20001)
    absolute = np.trapezoid(found.base_spectrum(freq_hz)[0], freq_hz)
    assert np.sqrt(absolute) == pytest.approx(golden["rms_absolute_acceleration_5_80Hz"], rel=1e-6)


def test_a_point_on_a_moving_base_has_the_spectrum_of_its_transmissibility():
    """A participation p and a motion s of the point: |1 + p s w^2 H|^2 of the base's density."""
    omega_n, zeta, p, s = TAU * 20, 0.01, 2.0, 0.7
    found = random_response(equivalent_motion(Oscillator(omega_n, zeta)), flat(0.01), p * ONE)
    freq_hz = np.linspace(6.0, 70.0, 9)
    omega = TAU * freq_hz
    gain = 1 + p * s * omega**2 / (omega_n**2 - omega**2 + 2j * zeta * omega_n * omega)
    expected = 0.01 * np.abs(gain) ** 2
    assert found.base_spectrum(freq_hz, p, s)[0] == pytest.approx(expected, rel=1e-9)


def test_a_spring_without_a_loop_has_its_exact_density():
    """The density of a Duffing oscillator is exp(-4 c V(y) / G)."""
    omega_n, zeta, cubic, density = 100.0, 0.01, 4e9, 0.3
    spring = oscillator_of({"omega_n": omega_n, "zeta": zeta, "cubic": cubic}, ("cubic",))
    found = random_response(equivalent_motion(spring), flat(density, (1.0, 1e3)), ONE)

    def moment(power):
        rate = 4 * 2 * zeta * omega_n / density
        reach = 30 * np.sqrt(density / (8 * zeta * omega_n**3))
        return quad(
            lambda y: y**power * np.exp(-rate * (omega_n**2 * y**2 / 2 + cubic * y**4 / 4)),
            0, reach, epsabs=0, epsrel=1e-12,
        )[0]  # fmt: skip

    # What is cut off of the density at exp(-30).
    assert found.rms()[0] == pytest.approx(np.sqrt(moment(2) / moment(0)), rel=1e-9)
    assert found.rms(1)[0] ** 2 == pytest.approx(density / (8 * zeta * omega_n), rel=1e-9)


def test_the_golden_monte_carlo_of_bouc_wen():
    golden = GOLDEN["random"]["bouc_wen_moderate"]
    found = random_response(equivalent_motion(joint("bouc_wen")), flat(golden["psd"]), ONE)
    for order, name in enumerate(("rms_y", "rms_v")):
        mean, error = golden[name]
        assert rms_in_band(found, order) == pytest.approx(mean, abs=max(3 * error, 3e-3 * mean))
    assert found.frequency_hz[0] == pytest.approx(golden["mean_crossing_hz"], rel=2e-3)
    spectrum = np.array(golden["psd_y_one_sided"])
    # Welch's lines of 0.2 Hz are a Hann window wide, so that the peak is left out.
    away = np.abs(spectrum[:, 0] - 19.93) > 0.3
    freq_hz, mean, error = spectrum[away].T
    assert np.abs(found.spectrum(freq_hz)[0] - mean) == pytest.approx(0, abs=np.max(4 * error))
    assert np.all(np.abs(found.spectrum(freq_hz)[0] - mean) < 4 * error + 0.02 * mean)


@pytest.mark.parametrize("law", ["bouc_wen", "jenkins", "iwan4"])
@pytest.mark.parametrize("level", [0, 1, 2], ids=["weak", "moderate", "strong"])
def test_an_independent_monte_carlo(law, level):
    """Weak, moderate and strong motion, 2 million periods each."""
    golden = MONTE_CARLO[law][level]
    found = random_response(equivalent_motion(joint(law)), flat(golden["psd"]), ONE)
    for order, name in enumerate(("rms_y", "rms_v")):
        mean, error = golden[name]
        assert rms_in_band(found, order) == pytest.approx(mean, abs=max(3 * error, 3e-3 * mean))


def test_the_monte_carlo_itself_has_the_closed_form_of_a_linear_joint():
    golden = MONTE_CARLO["linear"][0]
    assert golden["rms_y"][0] == pytest.approx(golden["closed_form"], abs=3 * golden["rms_y"][1])


def test_weak_motion_of_bouc_wen_has_its_limits():
    r"""$\zeta_{eq} = \zeta + \alpha\gamma s / (\sqrt{2\pi}\,\omega^2)$ at small rms s."""
    density = 1e-6
    found = random_response(equivalent_motion(joint("bouc_wen")), flat(density), ONE)
    rms, alpha, omega_n = found.rms()[0], BOUC_WEN["alpha"], BOUC_WEN["omega_n"]
    added = alpha * BOUC_WEN["gamma"] * rms / (np.sqrt(TAU) * omega_n**2)
    viscous = BOUC_WEN["zeta"] * omega_n / (TAU * found.frequency_hz[0])
    # Terms of the next order: delta s = 2e-3 of what is added.
    assert found.damping[0] - viscous == pytest.approx(added, rel=5e-3)


def test_the_largest_displacement_grows_with_the_duration():
    """A linear joint's peaks are Rayleigh's: exp(-Y^2 / 2 s^2) of them lie above Y."""
    found = random_response(equivalent_motion(Oscillator(TAU * 20, 0.01)), flat(0.01), ONE)
    rms = found.rms()[0]
    rate = found.exceeded()[0]
    rayleigh = 20.0 * np.exp(-0.5 * (found.y[0] / rms) ** 2)
    inside = found.y[0] < 4 * rms
    # The density is cut off at exp(-30).
    assert rate[inside] == pytest.approx(rayleigh[inside], rel=1e-6)
    largest = [found.largest(duration)[0] / rms for duration in (60.0, 600.0)]
    expected = [np.sqrt(2 * np.log(2 * 20 * t / np.log(2))) for t in (60.0, 600.0)]
    assert largest == pytest.approx(expected, rel=5e-3)


def test_what_averaging_cannot_answer_is_refused():
    with pytest.raises(ModelError, match="power"):
        random_response(equivalent_motion(Oscillator(TAU * 2, 0.01)), flat(1.0), ONE)
    with pytest.raises(ModelError, match="broad"):
        random_response(equivalent_motion(Oscillator(TAU * 20, 0.01)), flat(1.0, (19.9, 30)), ONE)
    with pytest.raises(ModelError, match="damping"):
        random_response(equivalent_motion(Oscillator(TAU * 20, 0.1)), flat(1.0), ONE)


def test_a_profile_of_slopes_is_that_of_its_breakpoints(tmp_path):
    rows = [("20-80", "+3 dB/oct"), ("80-350", "0.04"), ("350-2000", "-3 dB/oct")]
    profile = profile_of(rows, "g^2/Hz")
    assert profile.at(np.array([80.0, 200.0, 350.0])) == pytest.approx(0.04)
    assert profile.at(np.array([40.0]))[0] == pytest.approx(0.04 / 10**0.3, rel=1e-12)
    assert profile.at(np.array([700.0]))[0] == pytest.approx(0.04 / 10**0.3, rel=1e-12)
    assert profile.at(np.array([10.0, 3e3])).tolist() == [0.0, 0.0]
    areas = quad(lambda f: float(profile.at(np.array(f))), 20, 2000, points=(80, 350), limit=200)[0]
    assert profile.rms == pytest.approx(np.sqrt(areas), rel=1e-7)
    path = tmp_path / "profile.csv"
    path.write_text("frequency [Hz], density [g²/Hz]\n20, 0.01\n80, 0.04\n")
    read = read_profile(path)
    assert read.in_unit("m/s^2").density == pytest.approx(np.array([0.01, 0.04]) * 9.80665**2)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("20, 0.01\n80, 0.04\n", "unit"),
        ("f [Hz], G [g^2/Hz]\n20, -1\n", "positive"),
        ("f [Hz], G [g^2/Hz]\n20-80, 3 dB/oct\n", "two densities"),
        ("f [Hz], G [g^2/Hz]\n20\n", "two columns"),
    ],
)
def test_a_wrong_profile_is_refused(tmp_path, text, match):
    path = tmp_path / "profile.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=match):
        read_profile(path)


def test_a_profile_of_another_quantity_is_refused():
    with pytest.raises(ConfigError, match=r"\(N\)\^2/Hz"):
        profile_of([("20", "1"), ("80", "1")], "g^2/Hz").in_unit("N")
