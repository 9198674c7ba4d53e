"""Step 2 for a campaign: the FRF of its most linear noise test, fitted repeat by repeat."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr

from jbw.identification.linear import LineFit, PooledFit, Residuals, line_fit, pool
from jbw.identification.modal import ModalFit, fit_modes, in_order, line_of, model_lines
from jbw.measurement.channels import lines_within
from jbw.measurement.delays import on_time
from jbw.measurement.faults.fault import told_together
from jbw.measurement.records import Test, steady
from jbw.measurement.resonances import driven_band
from jbw.measurement.spectra import FRF, frf
from jbw.paper.kernels import h1
from jbw.quantities import BY_NAME, derivative_order, gain_unit, per

NAMES = ("omega_n", "zeta", "gain")


@dataclass(frozen=True)
class LinearStep:
    """The result of Step 2, the fit of spectral lines in the linear regime."""

    test: Test  # the noise or multisine test
    fits: tuple[LineFit, ...]  # line fits, one per repeat
    pooled: PooledFit
    frf: FRF  # FRF of all repeats together
    y_rms: float  # rms displacement of the test [m], where the result applies
    # modes in the band, the joint's mode first; None if not requested
    modal: ModalFit | None = None

    @property
    def natural_hz(self) -> float:
        """The natural frequency [Hz]."""
        return self.pooled.omega_n / (2 * np.pi)

    @property
    def source_unit(self) -> str:
        """The unit of the source, such as V."""
        record = self.test.records[0]
        return record.units[record.source]


class TriedStep(NamedTuple):
    """The result of a line fit (Step 2), with warnings that are issued when it is used."""

    step: LinearStep
    doubts: tuple[Warning | str, ...]

    def taken_up(self) -> LinearStep:
        """Return the result of the line fit (Step 2), after issuing its stored warnings."""
        for doubt in self.doubts:
            warnings.warn(doubt, stacklevel=2)
        return self.step


def tried_step(
    test: Test, gain: float | None = None, modes: int | Sequence[float] = ()
) -> TriedStep:
    """Perform the line fit of a test (Step 2), and store its warnings for later.

    It raises the errors of `linear_step`.
    """
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        step = linear_step(test, gain, modes)
    return TriedStep(step, tuple(doubt.message for doubt in doubts))


def linear_step(
    test: Test, gain: float | None = None, modes: int | Sequence[float] = ()
) -> LinearStep:
    """Fit natural frequency, damping and gain to a noise or multisine test.

    A multisine is used in whole periods, which do not leak: its lines vary by noise alone. `gain`
    is fixed if the campaign states it [N/kg per unit of the input]. With `modes`, as in
    `fit_modes`, the joint's mode is fitted together with its neighbours.
    """
    periodic = steady(test)
    test, size = (test, None) if periodic is None else periodic
    modes = _within(test.band_hz, modes)
    window = "hann" if size is None else "boxcar"
    fs, response = test.records[0].fs, test.records[0].response
    band = test.band_hz or driven_band(test.records[0])
    how = {"response": response, "band": band, "window": window, "nperseg": size}
    timely = on_time(test).records
    u = np.stack([(gain or 1.0) * record.channels[record.source] for record in timely])
    y = np.stack([record.channels[response] for record in timely])
    with told_together(test.name, len(test.records)):
        estimates = (
            frf(one_u, one_y, record.fs, **how)
            for one_u, one_y, record in zip(u, y, timely, strict=True)
        )
        modal = None
        if modes:
            together = frf(u, y, fs, **how)
            modal = _joint_first(_modes_of(test, together, modes), counted=isinstance(modes, int))
            frequencies = list(modal.omega / (2 * np.pi))
            fits = tuple(line_of(_modes_of(test, estimate, frequencies)) for estimate in estimates)
        else:
            terms: Residuals = _terms_of(test, "none")
            fits = tuple(
                line_fit(estimate, test.band_hz, residuals=terms) for estimate in estimates
            )
            together = frf(u, y, fs, **how)
    pooled = pool(fits)
    rms = float(np.sqrt(np.mean(y**2)))
    power = derivative_order(response)
    return LinearStep(test, fits, pooled, together, rms / pooled.omega_n**power, modal)


def _within(
    band_hz: tuple[float, float] | None, modes: int | Sequence[float]
) -> int | Sequence[float]:
    """Return the modes that lie in the band of a test."""
    if isinstance(modes, int) or band_hz is None:
        return modes
    return [freq for freq in modes if band_hz[0] <= freq <= band_hz[1]]


def _modes_of(test: Test, estimate: FRF, modes: int | Sequence[float]) -> ModalFit:
    return fit_modes(estimate, modes, test.band_hz, residuals=_terms_of(test, "both"))


def _terms_of(test: Test, usual: Residuals) -> Residuals:
    """Return the residual terms of modes outside the band, as the test states."""
    if test.residuals == "own":
        return "both"
    return usual if test.residuals == "auto" else test.residuals


def _joint_first(fit: ModalFit, *, counted: bool) -> ModalFit:
    """Return fitted modes with the joint's mode (highest peak, or first listed) in first place."""
    if not counted:
        return fit
    peak = np.abs(fit.residues[:, 0]) / (fit.zeta * fit.omega**2)
    return in_order(fit, np.argsort(-peak, kind="stable"))


def units_of(step: LinearStep) -> dict[str, str]:
    """Return the units of a line fit's quantities (Step 2) by name; that of the gain varies."""
    return {name: BY_NAME[name].unit for name in NAMES} | {"gain": gain_unit(step.source_unit)}


def linear_dataset(step: LinearStep) -> xr.Dataset:
    """Return the line fit (Step 2) as labelled arrays: fits by repeat, and the FRF in the band."""
    pooled = step.pooled
    keep = lines_within(step.frf.freq, step.fits[0].band_hz)
    freq, h = step.frf.freq[keep], step.frf.h[keep]
    if step.modal is None:
        model = pooled.gain * np.asarray(jax.jit(h1)(2 * np.pi * freq, pooled.omega_n, pooled.zeta))
    else:
        model = model_lines(step.modal, 2 * np.pi * freq)[0]
    units = units_of(step)
    variables: dict = {}
    std = np.sqrt(np.diag(pooled.covariance))
    attrs: dict = {"test": step.test.name, "y_rms": step.y_rms}
    for i, name in enumerate(NAMES):
        unit = {"units": units[name]}
        variables[name] = ("repeat", [fit.theta[i] for fit in step.fits], unit)
        variables[f"{name}_sd"] = ("repeat", [fit.std[i] for fit in step.fits], unit)
        attrs[f"pooled_{name}"] = float(pooled.mean[i])
        attrs[f"pooled_{name}_sd"] = float(std[i])
        attrs[f"cv_{name}"] = float(pooled.cv[i])
    receptance = per("m", step.source_unit)
    for prefix, value in (("h", h), ("fit", model)):
        variables[f"{prefix}_magnitude"] = ("freq", np.abs(value), {"units": receptance})
        variables[f"{prefix}_phase"] = ("freq", np.angle(value), {"units": "rad"})
    variables["coherence"] = ("freq", step.frf.coherence[keep], {"units": "1"})
    return xr.Dataset(variables, {"freq": ("freq", freq, {"units": "Hz"})}, attrs)


def modes_dataset(step: LinearStep) -> xr.Dataset | None:
    """Return modes and stabilisation diagram of Step 2 as labelled arrays; None for one mode."""
    fit = step.modal
    if fit is None:
        return None
    num, unit = len(fit.omega), gain_unit(step.source_unit)
    std = fit.std
    keep = lines_within(step.frf.freq, fit.band_hz)
    freq = step.frf.freq[keep]
    model = model_lines(fit, 2 * np.pi * freq)[0]
    receptance = {"units": per("m", step.source_unit)}
    variables: dict = {
        "omega": ("mode", fit.omega, {"units": "rad/s"}),
        "omega_sd": ("mode", std[:num], {"units": "rad/s"}),
        "zeta": ("mode", fit.zeta, {"units": "1"}),
        "zeta_sd": ("mode", std[num : 2 * num], {"units": "1"}),
        "residue": ("mode", fit.residues[:, 0], {"units": unit}),
        "residue_sd": ("mode", std[2 * num :], {"units": unit}),
        "covariance": (("value", "other"), fit.covariance, {"units": "1"}),
        "h_magnitude": ("freq", np.abs(step.frf.h[keep]), receptance),
        "fit_magnitude": ("freq", np.abs(model), receptance),
    }
    if fit.diagram is not None:
        variables |= {
            "pole_order": ("pole", fit.diagram.order, {"units": "1"}),
            "pole_omega": ("pole", fit.diagram.omega, {"units": "rad/s"}),
            "pole_zeta": ("pole", fit.diagram.zeta, {"units": "1"}),
            "pole_is_stable": ("pole", fit.diagram.is_stable, {"units": "1"}),
        }
    attrs = {"test": step.test.name, "misfit": float(fit.misfit[0])}
    return xr.Dataset(variables, {"freq": ("freq", freq, {"units": "Hz"})}, attrs)
