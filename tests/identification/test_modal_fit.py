"""Several modes in Step 2: closed forms, scatter over many records, and one mode as before."""

from dataclasses import replace

import numpy as np
import pytest
from tiers import represented_by

from jbw.errors import ConfigError, DataError
from jbw.identification import modal
from jbw.identification.linear import line_fit
from jbw.identification.modal import fit_modes, line_of
from jbw.measurement.spectra import frf

FS = 128.0
OMEGA = 2 * np.pi * np.array([17.6, 18.8, 23.0])
ZETA = np.array([0.006, 0.00444, 0.008])
RESIDUES = np.array([[40.0, 25.0], [60.0, -45.0], [30.0, 50.0]])  # mode, output
UPPER = np.array([1e-3, -5e-4])
ORDERS = (1, 2)  # a velocity and an acceleration
RESPONSES = ("displacement", "velocity", "acceleration")

pytestmark = [
    pytest.mark.filterwarnings("ignore:The .* hann window resolves"),
    pytest.mark.filterwarnings("ignore:.*is smaller than the line spacing"),
]


def receptances(omega, modes, upper=UPPER):
    """The sum of modes written out, one row an output."""
    squares = (
        OMEGA[:modes, None] ** 2
        - omega**2
        + 2j * ZETA[:modes, None] * np.outer(OMEGA[:modes], omega)
    )
    return RESIDUES[:modes].T @ (1 / squares) + upper[:, None]


def measured(rng, duration, modes=2, noise_std=(1e-4, 1e-2), upper=UPPER, periodic=False):
    """White noise and the exact responses of continuous modes, cut from a longer record."""
    kept = int(duration * FS)
    num = kept if periodic else 2 * kept
    spectrum = rng.standard_normal(num // 2 + 1) + 1j * rng.standard_normal(num // 2 + 1)
    spectrum[[0, -1]] = 0
    omega = 2 * np.pi * np.fft.rfftfreq(num, 1 / FS)
    turned = (1j * omega) ** np.array(ORDERS)[:, None]
    u = np.fft.irfft(spectrum, num)[:kept]
    y = np.fft.irfft(spectrum * receptances(omega, modes, upper) * turned, num)[:, :kept]
    scale = 0.05 / np.std(u)
    noise = np.array(noise_std)[:, None] * rng.standard_normal(y.shape)
    return scale * u, scale * y + noise


def estimates(u, y, **how):
    return [frf(u, one, FS, response=RESPONSES[p], **how) for one, p in zip(y, ORDERS, strict=True)]


def truth(modes):
    return np.concatenate([OMEGA[:modes], ZETA[:modes], RESIDUES[:modes].ravel()])


@pytest.mark.parametrize("modes", [[17.5, 18.9, 23.2], [23.0, 17.6, 18.8], 3, ()])
def test_noise_free_periods_give_the_modes_back(modes):
    u, y = measured(np.random.default_rng(1), 32, modes=3, noise_std=(0, 0), periodic=True)
    found = estimates(np.tile(u, 3), np.tile(y, 3), window="boxcar", window_s=32, overlap=0)
    fit = fit_modes(found, modes, (14.0, 27.0), residuals="upper")
    order = np.argsort(fit.omega)
    # Lines of whole periods hold no error but round-off, 1e-16 over the damping's share.
    np.testing.assert_allclose(fit.omega[order], OMEGA, rtol=1e-9)
    np.testing.assert_allclose(fit.zeta[order], ZETA, rtol=1e-6)
    np.testing.assert_allclose(fit.residues[order], RESIDUES, rtol=1e-6)
    np.testing.assert_allclose(fit.upper, UPPER, rtol=1e-5)
    assert np.all(fit.misfit < 1e-7)
    if modes == [23.0, 17.6, 18.8]:  # as they were asked for
        assert list(order) == [1, 2, 0]


@pytest.mark.parametrize("residuals", ["none", "both"])
def test_one_mode_of_one_output_is_the_line_fit(residuals):
    u, y = measured(np.random.default_rng(2), 512, modes=2)
    estimate = estimates(u, y)[0]
    fit = fit_modes(estimate, [18.8], (18.2, 22.0), residuals=residuals)
    line = line_fit(estimate, (18.2, 22.0), residuals=residuals)
    own = line_of(fit)
    # One optimum, reached from two starts: the differences of the Jacobian leave some 1e-6.
    np.testing.assert_allclose(own.theta, line.theta, atol=1e-4 * line.std.min(), rtol=1e-8)
    np.testing.assert_allclose(own.covariance, line.covariance, rtol=1e-4)
    np.testing.assert_allclose([own.upper, own.lower], [line.upper, line.lower], rtol=1e-4)
    assert (own.dof, own.num_lines, own.smeared) == (line.dof, line.num_lines, line.smeared)


def test_a_neighbour_no_longer_biases_the_damping():
    u, y = measured(np.random.default_rng(3), 1024, modes=2)
    fit = fit_modes(estimates(u, y), [17.6, 18.8], (15.0, 22.0), residuals="upper")
    z = (fit.theta - truth(2)) / fit.std
    assert np.all(np.abs(z) < 4)
    assert fit.chi_square / fit.dof == pytest.approx(1, abs=0.3)
    alone = line_fit(estimates(u, y)[0], (15.0, 22.0), residuals="upper")
    assert abs(alone.zeta - ZETA[1]) > 10 * alone.std[1]


# Leakage alone, which both outputs share; sensor noise beside it; noise far above it.
@pytest.mark.release  # test_linear.py has errors over many records
@pytest.mark.parametrize(
    ("noise_std", "window_s"),
    represented_by(((1e-3, 0.1), 32), ((5e-5, 5e-3), 16), ((2e-2, 2.0), 16)),
)
def test_one_covariance_is_that_of_many_records(noise_std, window_s):
    rng = np.random.default_rng(4)
    z, squares = [], []
    for _ in range(60):
        u, y = measured(rng, 512, noise_std=noise_std)
        fit = fit_modes(
            estimates(u, y, window_s=window_s), [17.6, 18.8], (15.0, 22.0), residuals="upper"
        )
        off = fit.theta - truth(2)
        z.append(off / fit.std)
        squares.append(off @ np.linalg.solve(fit.covariance, off))
    # 60 records: the deviation of z is known to 9 %, its mean to 0.13. Far below the leakage the
    # noise is read too high, and frequencies and residues err to the safe side, as of one mode.
    spread = np.std(z, axis=0)
    assert np.all(np.abs(np.mean(z, axis=0)) < 0.55)
    assert np.all((spread > (0.7 if noise_std[0] > 1e-4 else 0.4)) & (spread < 1.3))
    # The eight together: chi-square of eight degrees has the mean 8, known to 0.5.
    assert np.mean(squares) < 10.0
    assert np.mean(squares) > (6.0 if noise_std[0] > 1e-4 else 2.0)


def test_outputs_share_what_leaks():
    """A second output of one mode, without noise, tells nothing new: leakage is common to both."""
    u, y = measured(np.random.default_rng(5), 512, modes=1, noise_std=(0, 0), upper=np.zeros(2))
    both = estimates(u, y, window_s=16)
    one = fit_modes(both[:1], [17.6], (15.0, 21.0), residuals="none")
    two = fit_modes(both, [17.6], (15.0, 21.0), residuals="none")
    # Independent outputs would leave 0.71 of the deviations; what is read as noise of the sensors,
    # though there is none, is each output's own and takes a little off.
    ratio = two.std[:2] / one.std[:2]
    assert np.all((ratio > 0.8) & (ratio < 1.05))


def test_bad_input_is_named():
    u, y = measured(np.random.default_rng(6), 256)
    found = estimates(u, y, window_s=16)
    with pytest.raises(ConfigError, match=r"Every mode must lie in the band.*names 30 Hz"):
        fit_modes(found, [18.8, 30.0], (15.0, 22.0))
    with pytest.raises(DataError, match="more values than unknowns"):
        fit_modes(found[:1], [18.15, 18.25, 18.35], (18.1, 18.4))
    with pytest.raises(DataError, match=r"must stay apart, but they (passed|ended)"):
        fit_modes(found, [18.7, 18.8, 18.9], (18.0, 22.0))
    with pytest.raises(ConfigError, match="`modes` must be at least 1, but is 0"):
        fit_modes(found, 0, (15.0, 22.0))
    with pytest.raises(ConfigError, match="must not repeat"):
        fit_modes(found, [18.8, 18.8], (15.0, 22.0))
    with pytest.raises(DataError, match="lines to look for"):
        fit_modes(found, 2, (18.0, 19.0))
    with pytest.raises(ConfigError, match="at least one FRF, but is empty"):
        fit_modes([])
    with pytest.raises(ConfigError, match="FRF 2 differs from the first FRF in `nperseg`"):
        fit_modes([found[0], replace(found[1], nperseg=7)])
    with pytest.raises(ConfigError, match="none, upper or both"):
        fit_modes(found, residuals="all")


def test_fewer_stable_modes_than_asked_for_are_named(monkeypatch):
    u, y = measured(np.random.default_rng(6), 256)
    found = estimates(u, y, window_s=16)
    whole = modal.stabilisation
    monkeypatch.setattr(
        modal, "stabilisation", lambda *a: replace(whole(*a), groups=whole(*a).groups[:2])
    )
    with pytest.raises(
        DataError, match=r"must show 3 modes, as stated by `modes`, .*are only: .* \(Hz\)"
    ):
        fit_modes(found, 3, (15.0, 22.0))


def test_modes_that_miss_the_peaks_are_refused_and_both_remedies_mend_it():
    """Lines of 16 s smear the second mode so that a pole of noise is stabler than it."""
    size = 2**15
    drive = np.fft.rfft(np.random.default_rng(0).standard_normal(size))
    omega = 2 * np.pi * np.fft.rfftfreq(size, 1 / FS)
    zeta = np.array([0.006, 0.005])
    shapes = [
        1 / (w**2 - omega**2 + 2j * z * w * omega) for w, z in zip(OMEGA[:2], zeta, strict=True)
    ]
    u, *y = (np.fft.irfft(drive * h, size) for h in (1.0, *(RESIDUES[:2].T @ shapes)))
    short, long = ([frf(u, one, FS, window_s=w) for one in y] for w in (16.0, 41.0))
    with pytest.raises(DataError, match=r"is \d+ % of that output") as refused:
        fit_modes(short, 2, band=(15.0, 22.0))
    assert "frequencies of the peaks" in str(refused.value.remedy)
    for fit in (
        fit_modes(short, [17.6, 18.8], band=(15.0, 22.0)),
        fit_modes(long, 2, band=(15.0, 22.0)),
    ):
        # Without noise; what leaks through the windows is some hundredth of a half width.
        np.testing.assert_allclose(fit.omega, OMEGA[:2], rtol=0.01 * 0.005)
        np.testing.assert_allclose(fit.zeta, zeta, rtol=0.01)
