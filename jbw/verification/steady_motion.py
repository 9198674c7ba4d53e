"""Comparison of steady motion in the time domain: force loops, multisines, loops under a tone."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from scipy.integrate import trapezoid

from jbw.measurement.channels import lines_within
from jbw.measurement.delays import on_time
from jbw.measurement.loops import differentiate, enclosed_area, integrate, mean_cycles
from jbw.measurement.records import Record, Test, periods
from jbw.observables.groups import compared
from jbw.observables.loops import Loops
from jbw.observables.samples import band_limited, motion_under
from jbw.oscillator.hold import HeldInput
from jbw.quantities import derivative_order
from jbw.verification.bands import QUANTILE_AXIS, band, errors, gaussian_band
from jbw.verification.groups import groups_of
from jbw.verification.in_time import compare_in_time, followed, reduced
from jbw.verification.predicted import Predicted, Source, carry
from jbw.verification.predictive_basis import Draws, Laws, count_of

MOST_POINTS = 2048  # largest number of stored points of a loop
NUM_POINTS = 512  # number of points in a cycle
BAND = (0.5, 20.0)  # band of the integration and differentiation, relative to the tone's frequency
FORCE, LENGTH = {"units": "N/kg"}, {"units": "m"}


def predict_loop(source: Source, test: Test) -> Predicted:
    """Predict the force along a prescribed displacement, and the work W = int F dy."""
    (data,) = Loops.reduce([test], laws=source.basis.laws)
    (force,) = groups_of(source, test, data)
    force = force._replace(
        model=beside_load_cell(data, force.measured, force.model),
        others={
            name: beside_load_cell(data, force.measured, reference[None])[0]
            for name, reference in force.others.items()
        },
    )
    y = np.asarray(data.displacement[0])[compared(data.groups, 0)]
    shown = slice(None, None, -(-len(y) // MOST_POINTS))
    of_record = test.records[0].units
    length = {"units": of_record.get("displacement", "m")}
    newton = {"units": of_record.get("restoring_force", "N")}
    joule, dims = {"units": "J"}, ("quantile", "point")
    variables = {
        "displacement": ("point", y[shown], length),
        "measured_force": ("point", force.measured[shown], newton),
        "model_force": (dims, band(force.model)[:, shown], newton),
        "measured_work": ((), trapezoid(force.measured, y), joule),
        "model_work": ("quantile", band(trapezoid(force.model, y, axis=-1)), joule),
    }
    if force.std is not None:
        predictive = gaussian_band(force.model, force.std)
        variables["predictive_force"] = (dims, predictive[:, shown], newton)
    variables |= {
        f"{n}_force": ("point", reference[shown], newton) for n, reference in force.others.items()
    }
    attrs = {"level": test.level, "level_unit": length["units"], "kind": test.kind}
    attrs |= errors(force.measured, force.model, force.others, force.std)
    peak = np.full(count_of(source.draws), float(np.abs(data.displacement).max()))
    dataset = xr.Dataset(variables, {"quantile": QUANTILE_AXIS}, attrs)
    return Predicted(dataset, peak, force.noise)


def beside_load_cell(
    data: Loops, measured: Float[np.ndarray, " time"], model: Float[np.ndarray, "draw time"]
) -> Float[np.ndarray, "draw time"]:
    """Add a load cell's fitted offset and drift to predicted forces, as the test states."""
    columns = np.asarray(data.groups.spanned)[0][:, compared(data.groups, 0)]
    residual = measured - np.median(model, axis=0)
    return model + (residual @ columns.T) @ columns


def predict_periods(source: Source, test: Test) -> Predicted:
    """Predict the steady response to a multisine over one period, and its spectrum in a band."""
    cut = periods(test) or test
    data = reduced(source.basis, cut, periodic=True)
    motion = followed(source, cut, data)
    dataset, model, others = compare_in_time(source, motion, num_repeats=len(cut.records))
    measured, unit = dataset["measured"].values, dataset["measured"].attrs
    freq = np.fft.rfftfreq(len(measured), 1 / data.fs)
    keep = lines_within(freq, cut.band_hz or (freq[1], freq[-1]))
    median = np.median(model, axis=0)
    spectra = {"measured": measured, "model": median, "error": measured - median}
    spectra |= {f"{name}_error": measured - reference for name, reference in others.items()}
    variables = {
        f"{name}_spectrum": ("freq", (2 * np.abs(np.fft.rfft(x)) / len(x))[keep], unit)
        for name, x in spectra.items()
    }
    in_frequency = xr.Dataset(variables, {"freq": ("freq", freq[keep], {"units": "Hz"})})
    dataset = dataset.assign(in_frequency).assign_attrs(kind=cut.kind)
    return Predicted(dataset, motion.peak, motion.noise)


def loop_validation(test: Test, draws: Draws, laws: Laws) -> xr.Dataset:
    r"""Compare the hysteresis loops measured under a tone with the bands of the model.

    The measured force is $F = g V - a - 2\zeta\omega_n v$ (Eq. (1)) with gain and damping of every
    draw, so that its band includes their uncertainty. The predicted force is the same expression on
    the steady cycle under the measured input. One set is for $k y$ and the laws' forces; in
    `*_viscous`, $2\zeta\omega_n v$ is added.
    """
    omega, record = 2 * np.pi * test.tones_hz[0], test.records[0]
    cycles = [_cycles(record, test, omega) for record in test.records]
    own_y, u, own_v, own_a = np.mean(cycles, axis=0)
    fs = NUM_POINTS * omega / (2 * np.pi)
    y, v, a = carry(_steady_cycle, draws, band_limited(u, periodic=True), fs, laws)
    drive = draws["gain"][:, None] * u
    viscosity = (2 * draws["zeta"] * draws["omega_n"])[:, None]
    bands, energy = ("quantile", "phase"), {"units": "J/kg"}
    variables = {
        "measured_y": ("phase", own_y, LENGTH),
        "model_y": (bands, band(y), LENGTH),
    }
    for suffix, damping in (("", viscosity), ("_viscous", np.zeros_like(viscosity))):
        force = drive - own_a - damping * own_v
        model = drive - a - damping * v
        measured_area = enclosed_area(np.broadcast_to(own_y, force.shape), force)
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
        {"phase": ("phase", phase, {"units": "rad"}), "quantile": QUANTILE_AXIS},
        {
            "level": test.level,
            "level_unit": record.units[record.source],
            "tone_hz": test.tones_hz[0],
            "num_repeats": len(test.records),
        },
    )


def _cycles(record: Record, test: Test, omega: float) -> Float[np.ndarray, "4 phase"]:
    """Return a cycle of displacement, input, velocity and acceleration; the input has phase 0."""
    fs, (low, high) = record.fs, (part * omega / (2 * np.pi) for part in BAND)
    test = on_time(replace(test, records=(record,)))
    (record,) = test.records
    keep = slice(round(test.settle * fs), None)
    x = record.channels[record.response][keep]
    order, band_hz = derivative_order(record.response), (low, min(high, 0.4 * fs))
    motions = [x]
    for _ in range(order):
        motions.insert(0, integrate(motions[0], fs, band_hz))
    for _ in range(2 - order):
        motions.append(differentiate(motions[-1], fs, band_hz))
    y, v, a = motions
    # After integration, the first and last two periods of the lowest frequency are unreliable.
    inner = slice(round(2 * fs / low), -round(2 * fs / low))
    source = record.channels[record.source][keep][inner]
    channels = np.stack([y[inner], source, v[inner], a[inner]])
    cycles = mean_cycles(channels, fs, omega, NUM_POINTS)
    spectra = np.fft.rfft(cycles)
    turn = np.exp(-1j * np.angle(spectra[1, 1]) * np.arange(NUM_POINTS // 2 + 1))
    return np.fft.irfft(spectra * turn, NUM_POINTS)


def _steady_cycle(
    theta: Mapping[str, Array], source: HeldInput, fs: float, laws: Laws
) -> tuple[Float[Array, " phase"], ...]:
    cycle = motion_under(theta, source, fs, laws=laws, substeps=1)
    return cycle.y, cycle.v, cycle.a
