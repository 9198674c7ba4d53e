import warnings

import numpy as np
import pytest
from scipy import signal

from jbw.errors import ConfigError, DataError
from jbw.measurement.records import Record, Test
from jbw.measurement.spectra import averaged, frf, half_power_bandwidth

OMEGA_N, GAIN, FS = 2 * np.pi * 18.8, 60.0, 128.0


def receptance(omega, zeta):
    return GAIN / (OMEGA_N**2 - omega**2 + 2j * zeta * OMEGA_N * omega)


def stationary(rng, duration, zeta, *, order=0, noise_std=0.0, delay=0.0, periodic=False):
    """White noise of the whole band and the exact response of the continuous oscillator.

    Made in the frequency domain over twice the duration, then cut, so that neither is periodic.
    """
    kept = int(duration * FS)
    num = kept if periodic else 2 * kept
    spectrum = rng.standard_normal(num // 2 + 1) + 1j * rng.standard_normal(num // 2 + 1)
    spectrum[[0, -1]] = 0
    omega = 2 * np.pi * np.fft.rfftfreq(num, 1 / FS)
    response = spectrum * receptance(omega, zeta) * (1j * omega) ** order
    u = np.fft.irfft(spectrum, num)[:kept]
    y = np.fft.irfft(response * np.exp(-1j * omega * delay), num)[:kept]
    scale = 0.05 / np.std(u)
    return scale * u, scale * y + noise_std * rng.standard_normal(kept)


@pytest.mark.parametrize("estimator", ["h1", "h2"])
@pytest.mark.parametrize("response", ["displacement", "velocity", "acceleration"])
def test_periodic_record_gives_the_analytic_receptance(response, estimator):
    order = ["displacement", "velocity", "acceleration"].index(response)
    rng = np.random.default_rng(1)
    u, y = stationary(rng, 32, 0.00444, order=order, delay=0.003, periodic=True)
    found = frf(
        np.tile(u, 3), np.tile(y, 3), FS, response=response, window="boxcar", window_s=32,
        delay=0.003, estimator=estimator, band=(5, 40),
    )  # fmt: skip
    # Whole periods: no leakage; single lines of the noise are weak, hence not 1e-13.
    np.testing.assert_allclose(found.h, receptance(found.omega, 0.00444), rtol=1e-9)
    assert np.all(found.coherence > 1 - 1e-9)
    assert found.freq[0] == 5
    assert found.freq[-1] == 40


def recorded(rng, size=8192, fs=FS, **others):
    u, y = rng.standard_normal((2, size))
    return Record(fs, {"force": u, "velocity": y, "drive_point": u - y, **others}, {}, "hit.csv")


def test_channels_of_records_are_named_in_place_of_their_samples():
    rng = np.random.default_rng(4)
    records = tuple(recorded(rng) for _ in range(3))
    u, y, x = (np.stack([r.channels[name] for r in records]) for name in records[0].channels)
    cases = [
        (frf(records[1], "force", "velocity"), frf(u[1], y[1], FS, response="velocity")),
        (frf(records, "force", "velocity"), frf(u, y, FS, response="velocity")),
        (frf(records, "force", "drive_point"), frf(u, x, FS, response="acceleration")),
        (
            frf(Test("noise", records, "a", delay=0.01), "force", "velocity", window_s=2.0),
            frf(u, y, FS, response="velocity", window_s=2.0, delay=0.01),
        ),
        (
            frf(Test("noise", records, "a", delay=0.01), "force", "velocity", delay=0.0),
            frf(u, y, FS, response="velocity"),
        ),
    ]
    for found, expected in cases:
        np.testing.assert_array_equal(found.h, expected.h)
        assert found.response == expected.response


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        (lambda rng: (recorded(rng), "input", "velocity"), "hit.csv has no channel 'input'"),
        (lambda rng: (recorded(rng), "force", "velocty"), "must name a motion, but is 'velocty'"),
        (lambda rng: (recorded(rng), "force", "acceleration"), "no channel 'acceleration'"),
        (lambda rng: ([recorded(rng), recorded(rng, fs=64.0)], "force", "velocity"), "64, 128 Hz"),
        (lambda rng: ([recorded(rng), recorded(rng, 9000)], "force", "velocity"), "8192 to 9000"),
        (lambda rng: ([], "force", "velocity"), "none Hz"),
    ],
)
def test_channels_that_are_not_there_are_refused(asked, text):
    with pytest.raises((DataError, ConfigError), match=text):
        frf(*asked(np.random.default_rng(5)))


def test_a_lagging_response_has_negative_phase():
    u, y = stationary(np.random.default_rng(2), 64, 0.05)
    found = frf(u, y, FS, band=(17, 21))
    assert np.all(found.h.imag < 0)
    lagged = frf(u[1:], u[:-1], FS, window_s=4, band=(1, 30))
    # One sample of lag, against one of 512 in the window.
    np.testing.assert_allclose(np.angle(lagged.h), -lagged.omega / FS, atol=0.05)
    undone = frf(u[1:], u[:-1], FS, window_s=4, band=(1, 30), delay=1 / FS)
    np.testing.assert_allclose(np.angle(undone.h), 0, atol=0.05)


@pytest.mark.parametrize(("window", "repeats"), [("hann", 1), ("hann", 3), ("boxcar", 1)])
def test_variance_is_the_mean_square_error(window, repeats):
    rng = np.random.default_rng(3)
    ratio = []
    for _ in range(60):
        pairs = [stationary(rng, 96, 0.05, noise_std=5e-5) for _ in range(repeats)]
        u, y = (np.array(x) for x in zip(*pairs, strict=True))
        # A boxcar on a random record leaks far, which the coherence sees as noise: no bias here
        # because the response is then divided by a smooth receptance.
        found = frf(u, y, FS, window=window, window_s=6, band=(5, 40))
        ratio.append(np.abs(found.h - receptance(found.omega, 0.05)) ** 2 / found.variance)
    # Away from the peak, where the window's smearing is no part of the error; 150 lines of about
    # 100 independent ones and 60 records: 3 %, and the estimate of a variance of 1/(K-1).
    away = np.abs(found.freq - 18.8) > 4
    assert np.mean(np.array(ratio)[:, away]) == pytest.approx(1, abs=0.1)


@pytest.mark.filterwarnings("ignore:The .* hann window resolves")
def test_effective_averages_of_half_overlapping_hann_windows():
    u, y = stationary(np.random.default_rng(4), 128, 0.05)
    found = frf(u, y, FS, window_s=2)
    # Welch (1967): the correlation at half a window is 1/6, so K -> N / (1 + 2/36).
    num = found.num_segments
    assert num == 127
    assert found.num_averages == pytest.approx(num / (1 + 2 / 36 * (num - 1) / num), rel=1e-3)


def test_default_window_gives_sixteen_segments():
    u, y = stationary(np.random.default_rng(5), 512, 0.00444)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = frf(u, y, FS)
    assert found.num_segments >= 16
    assert found.window_s > 55


def test_short_window_warns_with_numbers():
    u, y = stationary(np.random.default_rng(6), 256, 0.00444)
    with pytest.warns(UserWarning, match=r"8 s hann window resolves 0.18 Hz.*damping 0\.[5-9]"):
        frf(u, y, FS, window_s=8)


def test_half_power_bandwidth_of_an_oscillator():
    freq = np.linspace(15, 22, 20001)
    width = half_power_bandwidth(freq, receptance(2 * np.pi * freq, 0.00444))
    # 2 zeta f_n up to relative order zeta.
    assert width == pytest.approx(2 * 0.00444 * 18.8, rel=1e-3)


def test_agrees_with_scipy():
    u, y = stationary(np.random.default_rng(7), 64, 0.05, noise_std=1e-4)
    found = frf(u, y, FS, nperseg=512, estimator="h2")
    _, coherence = signal.coherence(u, y, FS, nperseg=512)
    np.testing.assert_allclose(found.coherence, coherence[1:], rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda u, y: (np.where(np.arange(u.size) == 7, np.nan, u), y, {}), "first is sample 7"),
        (lambda u, y: (u, y[:-1], {}), r"\(2048,\) and \(2047,\)"),
        (lambda u, y: (0 * u + 1, y, {}), "`u` is constant"),
        (lambda u, y: (u, y, {"window_s": 12}), "Measure 18 s"),
        (lambda u, y: (u, y, {"window_s": 40}), "fit in the record"),
        (lambda u, y: (u, y, {"band": (9, 5)}), "increasing pair"),
        (lambda u, y: (u, y, {"band": (9.01, 9.02)}), "must contain a spectral line"),
        (lambda u, y: (u, y, {"response": "speed"}), "displacement, velocity, acceleration"),
        (lambda u, y: (u, y, {"window": "kaiser"}), "hann or boxcar"),
        (lambda u, y: (u, y, {"estimator": "h3"}), "h1 or h2"),
        (lambda u, y: (u, y, {"overlap": 1.0}), "0.9"),
        (lambda u, y: (u, y, {"window_s": 2, "nperseg": 256}), "not both"),
        (lambda u, y: (["a"], y, {}), "real numbers"),
    ],
)
def test_bad_input_is_refused(change, text):
    rng = np.random.default_rng(8)
    u, y, options = change(rng.standard_normal(2048), rng.standard_normal(2048))
    with pytest.raises((DataError, ConfigError), match=text):
        frf(u, y, FS, **options)


@pytest.mark.parametrize("window", ["hann", "boxcar"])
@pytest.mark.parametrize("nperseg", [64, 65])
def test_averaged_spectra_are_those_of_scipy(window, nperseg):
    u, y = np.random.default_rng(3).normal(1.0, 2.0, (2, 3, 500))
    how = dict(fs=FS, window=window, nperseg=nperseg, noverlap=nperseg // 3)
    expected = [signal.csd(*pair, detrend="constant", **how) for pair in ((u, u), (y, y), (u, y))]
    freq, *found = averaged(u, y, **how)
    np.testing.assert_allclose(freq, expected[0][0], rtol=1e-15)
    for ours, (_, theirs) in zip(found, expected, strict=True):
        # Rounding of sums of 64 terms; at frequency zero only that is left of a mean taken out.
        np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-14)
