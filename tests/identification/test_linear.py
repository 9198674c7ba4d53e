import numpy as np
import pytest
from tiers import represented_by

from jbw.errors import ConfigError, DataError
from jbw.identification.line_method import LineFit, in_band, line_fit_start
from jbw.identification.linear import line_fit, pool
from jbw.identification.windowed import receptance, smeared
from jbw.measurement.spectra import frf

OMEGA_N, ZETA, GAIN, FS = 2 * np.pi * 18.8, 0.00444, 60.0, 128.0
TRUTH = np.array([OMEGA_N, ZETA, GAIN])
RESPONSES = ("displacement", "velocity", "acceleration")

pytestmark = [
    pytest.mark.filterwarnings("ignore:The .* hann window resolves"),
    pytest.mark.filterwarnings("ignore:.*is smaller than the line spacing"),
]


def oscillator(omega, zeta):
    return GAIN / (OMEGA_N**2 - omega**2 + 2j * zeta * OMEGA_N * omega)


def stationary(rng, duration, *, zeta=ZETA, order=0, noise_std=0.0, extra=0.0, periodic=False):
    """White noise and the exact response of the continuous oscillator, cut from a longer record."""
    kept = int(duration * FS)
    num = kept if periodic else 2 * kept
    spectrum = rng.standard_normal(num // 2 + 1) + 1j * rng.standard_normal(num // 2 + 1)
    spectrum[[0, -1]] = 0
    omega = 2 * np.pi * np.fft.rfftfreq(num, 1 / FS)
    response = spectrum * (oscillator(omega, zeta) + extra) * (1j * omega) ** order
    u, y = (np.fft.irfft(x, num)[:kept] for x in (spectrum, response))
    scale = 0.05 / np.std(u)
    return scale * u, scale * y + noise_std * rng.standard_normal(kept)


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("window_s", [2.0, 8.0, 60.0])
def test_smeared_receptance_is_the_convolution_with_the_window(order, window_s):
    omega = 2 * np.pi * np.array([14.0, 18.7, 18.8, 20.0])
    # |W|^2 of the Hann window, by its transform, on a grid fine against both peaks.
    bins = np.arange(-400 * 64, 400 * 64 + 1) / 64 + 1e-7
    power = (np.sinc(bins) / (1 - bins**2)) ** 2
    near = omega[:, None] + 2 * np.pi * bins / window_s
    h = oscillator(near, 0.02) * (1j * near) ** order
    found = smeared(omega, OMEGA_N, 0.02, GAIN, window_s, order)
    # The part of |W|^2 beyond 400 bins is 1e-12, times the growth of omega^order.
    np.testing.assert_allclose(found, h @ power / power.sum(), rtol=1e-6)


def test_receptance_is_the_limit_of_a_long_window():
    omega = 2 * np.pi * np.linspace(15, 22, 50)
    found = smeared(omega, *TRUTH, 1e5, 0)
    np.testing.assert_allclose(found, receptance(omega, *TRUTH), rtol=1e-4)


@pytest.mark.parametrize("window", ["hann", "boxcar"])
def test_noise_free_periodic_record_gives_the_truth(window):
    u, y = stationary(np.random.default_rng(1), 32, periodic=True)
    found = frf(np.tile(u, 3), np.tile(y, 3), FS, window=window, window_s=32, overlap=0)
    if window == "boxcar":
        fit, start = line_fit(found), line_fit_start(in_band(found, None))
        np.testing.assert_allclose(fit.theta, TRUTH, rtol=1e-6)
        np.testing.assert_allclose(start, TRUTH, rtol=1e-6)
        assert np.all(fit.std < 1e-6 * TRUTH)
    else:  # a Hann window on a periodic record mixes neighbouring lines even so
        with pytest.raises(ConfigError, match="estimator h1 with a Hann"):
            line_fit(frf(u, y, FS, window_s=8, estimator="h2"), smear=True)


def test_short_window_reads_damping_too_high_unless_smearing_is_modelled():
    rng = np.random.default_rng(2)
    u, y = (np.array(x) for x in zip(*[stationary(rng, 512) for _ in range(8)], strict=True))
    found = frf(u, y, FS, window_s=8)
    as_seen, fit = line_fit(found, smear=False), line_fit(found)
    near = frf(u, y, FS, window_s=8, band=(17, 21))
    peak = np.abs(near.h).max() / (GAIN / (2 * ZETA * OMEGA_N**2))
    assert ZETA / peak > 0.0065  # the damping that the height of the peak tells
    assert as_seen.zeta > 0.0055
    assert abs(fit.zeta - ZETA) < 4 * fit.std[1]
    assert fit.std[1] < 0.003 * ZETA
    assert fit.smeared
    assert not as_seen.smeared


# Sensor noise: none to speak of (leakage rules), between, and far above the leakage.
@pytest.mark.parametrize(
    ("order", "noise_std", "window_s"),
    represented_by((1, 1e-3, 32), (1, 5e-5, 8), (0, 1e-3, 16), (2, 5e-2, 30)),
)
@pytest.mark.slow
def test_errors_are_calibrated(order, noise_std, window_s):
    rng = np.random.default_rng(3)
    fits = []
    for _ in range(60):
        u, y = stationary(rng, 512, order=order, noise_std=noise_std)
        estimate = frf(u, y, FS, window_s=window_s, response=RESPONSES[order])
        fits.append(line_fit(estimate, (17.0, 20.5)))
    z = np.array([(fit.theta - TRUTH) / fit.std for fit in fits])
    # 60 records: the standard deviation of z is known to 9 %, its mean to 0.13.
    assert np.all(np.abs(z.mean(axis=0)) < 0.5)
    assert np.all((z.std(axis=0) > 0.7) & (z.std(axis=0) < 1.3))
    assert np.mean([fit.chi_square / fit.dof for fit in fits]) == pytest.approx(1, abs=0.1)
    pooled = pool(fits)
    assert np.all(np.abs(pooled.mean - TRUTH) < 4 * np.sqrt(np.diag(pooled.covariance)))
    np.testing.assert_allclose(pooled.scatter_ratio, 1, atol=0.7)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise_std", "window_s"), represented_by((1e-3, 16), (5e-5, 16), (1e-3, 8), (0.1, 16))
)
def test_errors_are_calibrated_over_many_records(noise_std, window_s):
    rng = np.random.default_rng(4)
    z = []
    for _ in range(200):
        u, y = stationary(rng, 512, order=1, noise_std=noise_std)
        fit = line_fit(frf(u, y, FS, window_s=window_s, response="velocity"), (15.0, 22.5))
        z.append((fit.theta - TRUTH) / fit.std)
    spread = np.std(z, axis=0)
    assert 0.85 < spread[1] < 1.2  # 200 records: 5 %
    # Far below the leakage the noise is read too high, and these two err to the safe side.
    assert np.all((spread > (0.85 if noise_std > 1e-4 else 0.5)) & (spread < 1.2))


def test_residual_terms_carry_a_mode_above():
    upper = 2e-3
    u, y = stationary(np.random.default_rng(5), 512, extra=upper)
    estimate = frf(u, y, FS)
    fit = line_fit(estimate, residuals="both")
    assert abs(fit.zeta - ZETA) < 5 * fit.std[1]
    assert fit.upper + fit.lower / OMEGA_N**2 == pytest.approx(upper, rel=0.05)
    assert line_fit(estimate).chi_square / fit.dof > 3 * fit.chi_square / fit.dof


def fit_of(theta, std):
    return LineFit(
        *theta, covariance=np.diag(np.square(std)), upper=0, lower=0, chi_square=1.0, dof=1,
        num_lines=2, band_hz=(1, 2), smeared=True,
    )  # fmt: skip


def test_pooling():
    offsets = np.array([-1.0, 0.0, 1.0])
    fits = [
        fit_of([100 + x, 0.01 + 1e-2 * 1e-3 * x, 5.0 + 1e-3 * x], [1, 1e-5, 1e-4]) for x in offsets
    ]
    pooled = pool(fits)
    np.testing.assert_allclose(pooled.mean, [100, 0.01, 5.0])
    np.testing.assert_allclose(pooled.cv, [0.01, 1e-3, 2e-4], rtol=1e-9)
    np.testing.assert_allclose(pooled.scatter_ratio, [1, 1, 100], rtol=1e-9)
    # The gain alone scatters ten times as its errors say, and is widened by it.
    np.testing.assert_allclose(
        np.sqrt(np.diag(pooled.covariance)), np.array([1, 1e-5, 1e-3]) / np.sqrt(3), rtol=1e-9
    )
    assert np.isnan(pool(fits[:1]).cv).all()
    np.testing.assert_allclose(pool(fits[:1]).covariance, fits[0].covariance)
    with pytest.raises(DataError, match="At least one fit"):
        pool([])


@pytest.mark.fault(24)
def test_damping_finer_than_the_lines_warns():
    u, y = stationary(np.random.default_rng(6), 512, zeta=0.001)
    estimate = frf(u, y, FS, window_s=16)
    with pytest.warns(UserWarning, match=r"smaller than the line spacing .*\+-0\.0"):
        fit = line_fit(estimate)
    assert abs(fit.zeta - 0.001) < 4 * fit.std[1]


@pytest.mark.fault(18)
def test_short_record_says_how_much_longer():
    u, y = stationary(np.random.default_rng(7), 16, noise_std=3e-3)
    with pytest.warns(UserWarning, match="times longer"):
        line_fit(frf(u, y, FS, window_s=4), (16, 22))


def test_bad_input_is_refused():
    u, y = stationary(np.random.default_rng(8), 256, noise_std=1e-6)
    estimate = frf(u, y, FS)
    with pytest.raises(DataError, match="resonance that loses energy"):
        line_fit(frf(y, u, FS), (17, 21))  # swapped channels
    with pytest.raises(DataError, match="at least 4 lines"):
        line_fit(estimate, (18.8, 18.85))
    with pytest.raises(ConfigError, match="increasing pair"):
        line_fit(estimate, (21, 17))
    with pytest.raises(ConfigError, match="none, upper or both"):
        line_fit(estimate, residuals="all")
