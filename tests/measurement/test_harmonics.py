import numpy as np
import pytest
from scipy import signal

from jbw.errors import ConfigError, DataError
from jbw.measurement.harmonics import harmonics
from jbw.measurement.probing import peak_displacement, third_order_kernel

FS = 1024.0
AMPLITUDES = np.array([1 + 0.2j, 0.01j, 3e-3 - 1e-3j, 1e-5, 1e-6j])


def tones(t, omega, amplitudes, order=0):
    """Re sum Y_n exp(j n omega t), differentiated `order` times."""
    n = np.arange(1, len(amplitudes) + 1)
    scaled = np.asarray(amplitudes) * (1j * n * omega) ** order
    return (scaled @ np.exp(1j * np.outer(n * omega, t))).real


def time(num_samples):
    return np.arange(num_samples) / FS


@pytest.mark.parametrize("response", ["displacement", "velocity", "acceleration"])
def test_off_bin_tones_are_exact(response):
    order = ["displacement", "velocity", "acceleration"].index(response)
    omega, t = 2 * np.pi * 5.03, time(8192)
    y = tones(t, omega, AMPLITUDES, order) + 0.3 + 0.05 * t
    found = harmonics(y, FS, omega, 5, response=response)
    np.testing.assert_allclose(found.amplitudes, AMPLITUDES, rtol=0, atol=1e-12)
    assert found.cycles == pytest.approx(40.24)
    assert found.off_bin == pytest.approx(0.24)
    assert found.residual_std < 1e-11


def test_start_delay_and_other_tones():
    omega, other, t = 2 * np.pi * 5.03, 2 * np.pi * 7.9, time(8192)
    y = tones(t - 0.004, omega, AMPLITUDES) + 0.5 * np.sin(other * t)
    found = harmonics(y, FS, omega, 5, start=1.5, delay=0.004, also=(other,))
    # Phases stay those of the first sample whatever was discarded.
    np.testing.assert_allclose(found.amplitudes, AMPLITUDES, rtol=0, atol=1e-12)


def test_refined_frequency():
    omega, t = 2 * np.pi * 5.03, time(8192)
    found = harmonics(tones(t, omega, AMPLITUDES), FS, 1.0005 * omega, 5, refine=True)
    # The halves are fitted with the wrong frequency until it converges.
    assert found.omega == pytest.approx(omega, rel=1e-10)


def test_white_noise_reaches_the_cramer_rao_bound():
    omega, t, std = 2 * np.pi * 5.03, time(1024), 0.01
    y = tones(t, omega, AMPLITUDES) + std * np.random.default_rng(1).standard_normal((3000, 1024))
    found = harmonics(y, FS, omega, 5)
    error = np.mean(np.abs(found.amplitudes - AMPLITUDES) ** 2, axis=0)
    # Bound 2 std^2 / N per component; 3000 repeats give it to 2 %.
    np.testing.assert_allclose(error, 4 * std**2 / 1024, rtol=0.1)
    np.testing.assert_allclose(found.variance.mean(axis=0), error, rtol=0.1)
    assert found.residual_std.mean() == pytest.approx(std, rel=0.01)


def test_covariance_follows_coloured_noise():
    omega, t = 2 * np.pi * 20.03, time(16384)
    rng = np.random.default_rng(2)
    noise = signal.lfilter([1], [1, -0.95], rng.standard_normal((600, 16884)))[:, 500:]
    y = tones(t, omega, AMPLITUDES, 1) + noise
    found = harmonics(y, FS, omega, 5, response="velocity")
    error = np.mean(np.abs(found.amplitudes - AMPLITUDES) ** 2, axis=0)
    # 64 bins, 4 Hz, in which the red spectrum hardly bends; 600 repeats give 4 %.
    np.testing.assert_allclose(found.variance.mean(axis=0), error, rtol=0.15)


def test_transient_warns():
    omega, t = 2 * np.pi * 5.03, time(8192)
    y = tones(t, omega, AMPLITUDES) * (1 + 0.1 * np.exp(-t / 2))
    with pytest.warns(UserWarning, match=r"first harmonic at 5.03 Hz changes by"):
        found = harmonics(y, FS, omega, 5)
    assert found.drift > 0.01


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"fs": 30.0}, "Harmonic 3 of 5 Hz lies at 15 Hz"),
        ({"y": np.ones(300)}, "must last 0.4 s"),
        ({"start": 1.8}, "two periods after the 1.8 s"),
        ({"y": np.full(2048, np.inf)}, "2048 of 2048"),
        ({"y": np.ones(2048, complex)}, "real numbers"),
        ({"omega": -1.0}, "`omega` must be positive"),
        ({"num_harmonics": 0}, "`num_harmonics`"),
        ({"fs": 0.0}, "`fs` must be positive"),
        ({"also": (2 * np.pi * 5.00001,)}, "distinguished"),
    ],
)
def test_bad_input_is_refused(options, text):
    given = {"y": np.ones(2048), "fs": FS, "omega": 2 * np.pi * 5, "num_harmonics": 3} | options
    with pytest.raises((DataError, ConfigError), match=text):
        harmonics(**given)


def as_complex(pair):
    return complex(*pair)


def steady(case, num_samples, repeats=1, seed=0, noise_std=0.0):
    """Input and displacement of a golden steady state, with noise on the displacement."""
    omega = 2 * np.pi * case["f_hz"] if "f_hz" in case else case["w"]
    odd = [as_complex(case[name]) for name in ("Y1", "Y3", "Y5")]
    t = time(num_samples)
    y = tones(t, omega, [odd[0], 0, odd[1], 0, odd[2]])
    noise = noise_std * np.random.default_rng(seed).standard_normal((repeats, num_samples))
    return omega, t, case["A"] * np.cos(omega * t), y + noise, odd


@pytest.mark.parametrize("family", ["true_oscillator_steady", "cubic_equivalent_steady"])
def test_kernel_of_golden_steady_states(golden, family):
    for case in golden[family]["cases"]:
        omega, _, u, y, odd = steady(case, 8192)
        if 7 * omega > np.pi * FS:
            continue
        found = third_order_kernel(u, y[0], FS, omega)
        expected = 4 * odd[1] / case["A"] ** 3
        # Rounding of a fit of 8192 samples of size |Y1|, over |Y3|.
        np.testing.assert_allclose(found.h3, [expected], rtol=1e-15 * 1e4 * abs(odd[0] / odd[1]))
        if "H3_exp" in case:
            np.testing.assert_allclose(found.mean, as_complex(case["H3_exp"]), rtol=1e-9)
        if "ymax" in case and case["f_hz"] < 6:
            # The golden peak holds orders above five, which Y5 / 10 bounds here.
            np.testing.assert_allclose(found.y_peak, case["ymax"], atol=abs(odd[2]) / 5)


def test_kernel_takes_the_source_and_the_phase_out(golden):
    case = golden["true_oscillator_steady"]["cases"][0]
    omega, t, _, _, odd = steady(case, 8192)
    amplitude, u_3, h1_3omega = case["A"] * np.exp(0.7j), 0.01 * np.exp(2j), 2.0e-4 - 1e-4j
    u = tones(t, omega, [amplitude, 0, u_3])
    joint = [odd[0] * np.exp(0.7j), 0, odd[1] * np.exp(2.1j), 0, odd[2] * np.exp(3.5j)]
    joint[2] += h1_3omega * u_3
    y = tones(t - 0.002, omega, joint, order=1)
    options = {"response": "velocity", "delay": 0.002}
    found = third_order_kernel(u, y, FS, omega, h1_3omega=h1_3omega, **options)
    np.testing.assert_allclose(found.h3, as_complex(case["H3_exp"]), rtol=1e-9)
    np.testing.assert_allclose(found.u_3, u_3, rtol=1e-9)
    assert found.source == "removed"
    assert found.source_ratio == pytest.approx(abs(h1_3omega * u_3 / odd[1]), rel=1e-6)
    assert any("adds" in note for note in found.notes)
    kept = third_order_kernel(u, y, FS, omega, **options)
    assert kept.source == "measured"
    assert abs(kept.mean / as_complex(case["H3_exp"]) - 1) > 0.5
    blind = third_order_kernel(None, y, FS, omega, amplitude=amplitude, **options)
    assert blind.source == "unmeasured"
    assert np.isnan(blind.source_ratio)
    assert "does not allow a conclusion" in blind.notes[0]


def test_kernel_scatter_and_covariance(golden):
    case = golden["true_oscillator_steady"]["cases"][0]
    std = 1e-6
    omega, _, u, y, _ = steady(case, 4096, repeats=400, seed=3, noise_std=std)
    found = third_order_kernel(np.broadcast_to(u, y.shape), y, FS, omega)
    expected = 4 / case["A"] ** 3 * std * np.sqrt(2 / 4096)  # Cramer-Rao, per component
    assert found.std == pytest.approx(expected, rel=0.1)  # 400 repeats: 2.5 %
    assert found.std_expected == pytest.approx(expected, rel=0.1)
    assert found.covariance[0, 0] == pytest.approx(expected**2 / 400, rel=0.2)
    assert abs(found.mean - as_complex(case["H3_exp"])) < 4 * expected * np.sqrt(2 / 400)
    assert found.above_noise


def test_third_harmonic_below_the_noise_is_flagged(golden):
    case = golden["true_oscillator_steady"]["cases"][0]
    num_samples = 4096
    y_3 = abs(as_complex(case["Y3"]))
    std = y_3 / 0.3 * np.sqrt(num_samples / 2)  # signal-to-noise ratio 0.3 per component
    omega, _, u, y, _ = steady(case, num_samples, repeats=8, seed=4, noise_std=std)
    found = third_order_kernel(np.broadcast_to(u, y.shape), y, FS, omega)
    assert not found.above_noise
    assert any("does not stand above the noise" in note for note in found.notes)


def test_kernel_refusals():
    omega, t = 2 * np.pi * 5, time(4096)
    y = np.cos(omega * t)
    with pytest.raises(DataError, match="neither `u` nor `amplitude`"):
        third_order_kernel(None, y, FS, omega)
    with pytest.raises(DataError, match="Harmonic 3 of 5 Hz"):
        third_order_kernel(y, y, 30.0, omega)
    noise = np.random.default_rng(5).standard_normal(4096)
    with pytest.raises(DataError, match="no tone at 5 Hz"):
        third_order_kernel(1e-3 * y + noise, y, FS, omega)
    with pytest.raises(DataError, match="one shape"):
        third_order_kernel(y[:-1], y, FS, omega)


def test_peak_displacement_of_two_harmonics():
    found = harmonics(tones(time(4096), 31.0, [1.0, 0, 0.05]), FS, 31.0, 3)
    assert peak_displacement(found) == pytest.approx(1.05, rel=1e-5)
