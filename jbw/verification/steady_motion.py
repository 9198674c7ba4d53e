"""Steady motion in time beside the model's: forced loops, periods of multisines, loops of tones."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from jbw.measurement.loops import differentiate, enclosed_area, integrate, mean_cycle
from jbw.measurement.records import Record, Test, periods
from jbw.observables.loops import Loops
from jbw.observables.observable import prediction
from jbw.observables.records import Records
from jbw.observables.samples import advance, in_band, motion_under, noise_share
from jbw.quantities import UNIT_OF, derivative_order
from jbw.verification.bands import QUANTILES, band, errors, gaussian_band
from jbw.verification.predicted import Predicted, Source, carry, noise_of, of_repeats
from jbw.verification.predictive_basis import Draws, Laws, count_of

MOST_POINTS = 2048  # of a loop, kept for drawing
NUM_POINTS = 512  # of a cycle
BAND = (0.5, 20.0)  # of the tone: where a record is integrated and differentiated
FORCE, LENGTH = {"units": "N/kg"}, {"units": "m"}


def _carried(source: Source, data: Loops | Records) -> tuple[Any, dict[str, Any]]:
    """What every draw predicts of the data, and what the other oscillators do."""
    return source.carried(lambda draws, laws: carry(prediction, draws, replace(data, laws=laws)))


def predict_loop(source: Source, test: Test) -> Predicted:
    r"""Restoring force along a prescribed displacement beside that of the model.

    The energy lost is the work of the force over the record after `settle`,

    $$W = \int F\,\mathrm{d}y$$

    Returns:
        Forces over (point) and (quantile, point), work over (quantile); attributes as of
        `jbw.verification.bands.errors`.
    """
    data = Loops.of([test], laws=source.basis.laws)
    forces, others = _carried(source, data)
    noise = noise_of(source.basis, test, of_repeats(data.repeats))
    noise_std = source.std(noise, len(test.records))
    counted = data.compared(0)
    y, measured = (np.asarray(x[0])[counted] for x in (data.displacement, data.mean))
    model = forces[:, 0, counted]
    others = {name: one[0, counted] for name, one in others.items()}
    shown = slice(None, None, -(-len(y) // MOST_POINTS))
    newton, joule, dims = {"units": "N"}, {"units": "J"}, ("quantile", "point")
    variables = {
        "displacement": ("point", y[shown], LENGTH),
        "measured_force": ("point", measured[shown], newton),
        "model_force": (dims, band(model)[:, shown], newton),
        "measured_work": ((), trapezoid(measured, y), joule),
        "model_work": ("quantile", band(trapezoid(model, y, axis=-1)), joule),
    }
    if noise_std is not None:
        variables["predictive_force"] = (dims, gaussian_band(model, noise_std)[:, shown], newton)
    variables |= {f"{n}_force": ("point", one[shown], newton) for n, one in others.items()}
    facts = {"level": test.level, "level_unit": "m", "kind": test.kind}
    attrs = facts | errors(measured, model, others, noise_std)
    peak = np.full(count_of(source.draws), float(jnp.max(jnp.abs(data.displacement))))
    return Predicted(xr.Dataset(variables, {"quantile": list(QUANTILES)}, attrs), peak, noise)


def predict_periods(source: Source, test: Test) -> Predicted:
    """Steady response over one period of a multisine beside that of the model.

    Returns:
        Response over (time) and (quantile, time); amplitude spectra over (freq), in the test's
        band, of the measured response, the model's median, the error it leaves, and the other
        oscillators' errors; attributes as of `jbw.verification.bands.errors`.
    """
    cut = periods(test) or test
    data = Records.of([cut], laws=source.basis.laws, substeps=source.basis.substeps, periodic=True)
    responses, others = _carried(source, data)
    noise = noise_of(source.basis, test, of_repeats(data.repeats))
    noise_std = source.std(noise, len(cut.records))
    measured, model = np.asarray(data.mean[0]), in_band(responses[:, 0], data.lines)
    others = {name: in_band(one[0], data.lines) for name, one in others.items()}
    size, record = len(measured), cut.records[0]
    unit = {"units": UNIT_OF[data.response], "long_name": data.response}
    variables: dict[str, Any] = {
        "measured": ("time", measured, unit),
        "model_band": (("quantile", "time"), band(model), unit),
    }
    if noise_std is not None:
        noise_std *= noise_share(data.lines, size)
        predictive = gaussian_band(model, noise_std)
        variables["predictive_band"] = (("quantile", "time"), predictive, unit)
    freq = np.fft.rfftfreq(size, 1 / data.fs)
    low, high = cut.band_hz or (freq[1], freq[-1])
    keep = (freq >= low) & (freq <= high)
    median = np.median(model, axis=0)
    spectra = {"measured": measured, "model": median, "error": measured - median}
    spectra |= {f"{name}_error": measured - one for name, one in others.items()}
    for name, x in spectra.items():
        amplitudes = 2 * np.abs(np.fft.rfft(x)) / size
        variables[f"{name}_spectrum"] = ("freq", amplitudes[keep], unit)
    coords = {
        "time": ("time", np.arange(size) / data.fs, {"units": "s"}),
        "freq": ("freq", freq[keep], {"units": "Hz"}),
        "quantile": list(QUANTILES),
    }
    attrs = {
        "level": cut.level,
        "level_unit": record.units[record.source],
        "kind": cut.kind,
        "response": data.response,
        **errors(measured, model, others, noise_std),
    }
    # One period of a steady motion is integrated line by line.
    omega = 2 * np.pi * freq[1:]
    lines = np.fft.rfft(responses[:, 0])[:, 1:] / (1j * omega) ** derivative_order(data.response)
    y = np.fft.irfft(np.pad(lines, ((0, 0), (1, 0))), size)
    return Predicted(xr.Dataset(variables, coords, attrs), np.abs(y).max(axis=-1), noise)


def loop_validation(test: Test, draws: Draws, laws: Laws) -> xr.Dataset:
    r"""Measured loops of a tone against the bands of the model.

    Measured: y by drift-free integration, a by differentiation in a stated band, and
    $F = g V - a - 2\zeta\omega_n v$ with the gain and the damping of every draw, so that the band
    of a measured loop carries them. Predicted: the same force on the steady cycle of every draw
    under the measured input. Both with and without the viscous part.

    Returns:
        Loops over (phase) and (quantile, phase), areas over (quantile), one set for
        $k y$ and the laws' forces and one, named `*_viscous`, with $2\zeta\omega_n v$ added.

    Reference:
        Section 4 (validation), Eq. (1).
    """
    omega, record = 2 * np.pi * test.tones_hz[0], test.records[0]
    cycles = [_cycles(record, test, omega) for record in test.records]
    cycle = {name: np.mean([one[name] for one in cycles], axis=0) for name in cycles[0]}
    fs = NUM_POINTS * omega / (2 * np.pi)
    y, v, a = carry(_steady_cycle, draws, jnp.asarray(cycle["u"]), fs, laws)
    drive = draws["gain"][:, None] * cycle["u"]
    viscosity = (2 * draws["zeta"] * draws["omega_n"])[:, None]
    bands, energy = ("quantile", "phase"), {"units": "J/kg"}
    variables = {
        "measured_y": ("phase", cycle["y"], LENGTH),
        "model_y": (bands, band(y), LENGTH),
    }
    for suffix, damping in (("", viscosity), ("_viscous", np.zeros_like(viscosity))):
        force = drive - cycle["a"] - damping * cycle["v"]
        model = drive - a - damping * v
        measured_area = enclosed_area(np.broadcast_to(cycle["y"], force.shape), force)
        variables |= {
            f"measured_force{suffix}": ("phase", np.median(force, axis=0), FORCE),
            f"measured_force_band{suffix}": (bands, band(force), FORCE),
            f"model_force{suffix}": (bands, band(model), FORCE),
            f"measured_area{suffix}": ("quantile", band(measured_area), energy),
            f"model_area{suffix}": ("quantile", band(enclosed_area(y, model)), energy),
        }
    phase = 2 * np.pi * np.arange(NUM_POINTS) / NUM_POINTS
    return xr.Dataset(
        variables,
        {"phase": ("phase", phase, {"units": "rad"}), "quantile": list(QUANTILES)},
        {
            "level": test.level,
            "level_unit": record.units[record.source],
            "tone_hz": test.tones_hz[0],
            "num_repeats": len(test.records),
        },
    )


def _cycles(record: Record, test: Test, omega: float) -> dict[str, NDArray[np.float64]]:
    """One cycle of input, displacement, velocity and acceleration, phase counted from the input."""
    fs, (low, high) = record.fs, (part * omega / (2 * np.pi) for part in BAND)
    keep = slice(round(test.settle * fs), None)
    x = advance(record.channels[record.response], test.delay, fs)[keep]
    y, v, a = _kinematics(x, fs, (low, min(high, 0.4 * fs)), record.response)
    # The first and last periods of the band's lower edge are doubtful after integration.
    inner = slice(round(2 * fs / low), -round(2 * fs / low))
    source = record.channels[record.source][keep][inner]
    y, u = mean_cycle(y[inner], source, fs, omega, NUM_POINTS)
    v, a = mean_cycle(v[inner], a[inner], fs, omega, NUM_POINTS)
    turn = np.angle(np.fft.rfft(u)[1])
    cycles = {"y": y, "u": u, "v": v, "a": a}
    return {name: _shifted(cycle, turn) for name, cycle in cycles.items()}


def _kinematics(
    x: NDArray[np.float64], fs: float, band_hz: tuple[float, float], response: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Displacement, velocity and acceleration from the one that was measured."""
    up, down = partial(differentiate, fs=fs, band=band_hz), partial(integrate, fs=fs, band=band_hz)
    match response:
        case "displacement":
            v = up(x)
            return x, v, up(v)
        case "velocity":
            return down(x), x, up(x)
        case _:
            v = down(x)
            return down(v), v, x


def _shifted(cycle: NDArray[np.float64], turn: float) -> NDArray[np.float64]:
    """A periodic cycle with its phase counted from where `turn` was."""
    spectrum = np.fft.rfft(cycle)
    return np.fft.irfft(spectrum * np.exp(-1j * turn * np.arange(len(spectrum))), len(cycle))


def _steady_cycle(
    theta: Mapping[str, Array], source: Float[Array, " phase"], fs: float, laws: Laws
) -> tuple[Float[Array, " phase"], ...]:
    cycle = motion_under(theta, source, fs, laws=laws, substeps=1, periodic=True)
    return cycle.y, cycle.v, cycle.a
