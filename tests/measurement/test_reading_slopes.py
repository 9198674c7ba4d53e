"""Derivatives of the fits of decays and sweeps are those of SciPy's central differences."""

import numpy as np
import pytest
from scipy.integrate import odeint
from scipy.optimize import least_squares
from scipy.signal import chirp, lfilter

from jbw.measurement.faults.hypotheses import HYPOTHESES
from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.readings import decay, sweep
from jbw.measurement.readings.decay import fit_decay
from jbw.measurement.readings.slow_flow import BASES
from jbw.measurement.readings.sweep import fit_sweep, sweep_signal

FS, HZ, SECONDS = 400.0, 30.0, 15.0
WITH_A_MODE = {h.name: h for h in HYPOTHESES if type(h).causes is not Hypothesis.causes}
CAUSES = {"none": None, **{n: h for n, h in WITH_A_MODE.items() if n != "second blow"}}


def swept(order):
    """A linear mode of 30 Hz and 1 % damping, whose response lacks 3 ms in the middle."""
    t = np.arange(round(SECONDS * FS)) / FS
    drive = chirp(t, 20.0, SECONDS, 40.0)
    pole = 2 * np.pi * HZ * (-0.01 + 1j)
    ringing = np.imag(pole**order * np.exp(pole * t)) / np.imag(pole) / FS
    response = lfilter(ringing, 1.0, np.append(drive, np.zeros(len(t))))[: len(t)]
    rng = np.random.default_rng(7)
    return drive, np.roll(response, 1) + 1e-3 * np.abs(response).max() * rng.standard_normal(len(t))


@pytest.mark.parametrize("name", CAUSES)
@pytest.mark.parametrize(("order", "lag_s", "is_force"), [(0, 0.0, True), (2, 2e-3, False)])
def test_slopes_of_a_sweep_are_those_of_differences(name, order, lag_s, is_force, monkeypatch):
    u, y = swept(order)
    signal = sweep_signal(u, y, FS, (25.0, 35.0), order, lag_s=lag_s, is_force=is_force)
    fits = sweep.fit_bases(signal)
    basis = "linear" if name not in ("none", "steady line") else "power"
    cause = None if name == "none" else next(iter(CAUSES[name].causes(fits, basis)))
    assert_slopes(fit_sweep, sweep, fits, basis, cause, monkeypatch, 1e-4)


@pytest.mark.parametrize("name", ["none", "steady line", "second mode"])
@pytest.mark.parametrize("basis", BASES)
def test_slopes_of_a_decay_are_those_of_differences(name, basis, monkeypatch):
    """Of a mode that softens, by a steady slow flow: sigma = 2 + 3 r / s, omega less 4 r / s."""
    t = np.arange(6000) / 2000.0
    flow = odeint(
        lambda s, _: [-(2 + 3 * np.exp(s[0])), 2 * np.pi * 60 - 4 * np.exp(s[0])], [0, 0], t
    )
    x = np.exp(flow[:, 0]) * np.cos(flow[:, 1]) + 1e-3 * np.random.default_rng(3).standard_normal(
        6000
    )
    fits = decay.fit_bases(decay.decay_signal(x, 2000.0, (45.0, 75.0), 0))
    if basis not in fits.fits:
        power = fits.fits["power"].theta
        terms = BASES[basis].terms
        more = np.zeros(terms - 2)
        theta = np.concatenate([power[:4], more, power[4:6], more, power[6:]])
        fits.fits[basis] = fit_decay(fits.signal, basis, theta, fits.scale, fits.weight)
    cause = None if name == "none" else next(iter(CAUSES[name].causes(fits, basis)))
    # Interpolated between 160 knots, 0.6 % at most: a sixteenth of that between four times as many.
    assert_slopes(fit_decay, decay, fits, basis, cause, monkeypatch, 1e-2)


def assert_slopes(fit, module, fits, basis, cause, monkeypatch, error):
    """Compare the derivatives at the end of a fit, each within an error over its own size."""
    seen = []

    def compared(fun, start, jac, **options):
        """What SciPy finds by our slopes, and by its own differences at the same place."""
        found = least_squares(fun, start, jac, **options)
        options |= {"max_nfev": 1}
        seen.append((found.jac, least_squares(fun, found.x, "3-point", **options).jac))
        return found

    monkeypatch.setattr(module, "least_squares", compared)
    fit(fits.signal, basis, fits.fits[basis].theta, fits.scale, fits.weight, cause)
    ((ours, differences),) = seen
    # A forward step of 1e-7 of a cause's value: of 30 lines, each of one turn, 2e-5 of the slope.
    for column in range(ours.shape[1]):
        scale = np.abs(differences[:, column]).max()
        assert np.abs(ours[:, column] - differences[:, column]).max() < error * scale
