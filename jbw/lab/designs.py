"""The tests that a calibration simulates: those of a campaign, or short ones on the virtual rig.

The rig's tests have a poor laser: noise of 1 mm/s, twenty times the rig's, leaves posteriors with a
finite width, and a ridge of alpha and delta whose thickness is a hundredth of its length.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jbw import rig
from jbw.campaign.load import Campaign
from jbw.campaign.tables import force_per_unit, gain_of
from jbw.errors import DataError
from jbw.identification.assemble import measured_in
from jbw.identification.linear_step import LinearStep, linear_step
from jbw.identification.paper import step3, step4
from jbw.identification.paper.kernel import KernelData
from jbw.identification.procedure import Report, posterior_of
from jbw.identification.selection import linear_test, probing_tests, sweep_tests
from jbw.inference.space.box import Box, box
from jbw.measurement.records import Record, Test, drive_of
from jbw.measurement.spectra import FRF
from jbw.observables.dataset import Dataset
from jbw.observables.groups import changed
from jbw.observables.records import Records
from jbw.oscillator.excitation import sampled, sweep
from jbw.oscillator.oscillator import as_oscillator
from jbw.report.messages import stages
from jbw.rig.presets import PRIOR, PROBING_HZ, TRUTH

GAIN = rig.LABORATORY.gain
REPEATS = 8
# noise of the third-order kernel for one repeat of 64 s with a laser noise of 1 mm/s [m^-2 s^6]
KERNEL_NOISE = 2.5e-10
Y_PEAK = (7.00e-4, 7.10e-4, 7.25e-4, 7.30e-4, 7.40e-4)  # displacements at a force of 9 N/kg [m]
VELOCITY_NOISE = 1e-3  # noise of the measured velocity [m/s]
LEVELS = (0.05, 0.20)  # levels of the source [V]
# sampling frequency [Hz], length of the sweep [s], number of samples
FS, BURST, LENGTH = 256.0, 1.75, 512
SWEPT_HZ = (10.0, 28.0)
# length of the fades at both ends [s], because a sweep with an abrupt start is not band-limited
FADE = 0.25
LINES_HZ = (16.0, 21.6, 0.05)  # first and last spectral line, and their spacing [Hz]
LINE_NOISE = 0.01  # noise of a complex spectral line, relative to the largest line


class Design[Data: KernelData | Records](NamedTuple):
    """The prior and the tests that a calibration simulates; measured tests give only inputs."""

    data: Data
    prior: Box  # prior of the inferred parameters
    held: Mapping[str, float] = {}


def probing(num_repeats: int = REPEATS) -> Design[KernelData]:
    """Return tests for zeta, alpha and delta: five tones, with the prior ranges of Teloli et al."""
    size = len(PROBING_HZ)
    data = KernelData(
        omega=2 * np.pi * jnp.array(PROBING_HZ),
        mean=jnp.zeros(size, complex),
        within=jnp.zeros(size),
        num_repeats=jnp.full(size, float(num_repeats)),
        noise_std=jnp.full(size, KERNEL_NOISE),
        y_peak=jnp.array(Y_PEAK),
        omega_n=jnp.asarray(float(TRUTH.omega_n)),
    )
    return Design(data, box({name: PRIOR[name] for name in step3.NAMES}))


def _sweeping(noise_std: float) -> Records:
    """Return four repeats of two 2 s sweeps through the resonance, with given noise."""
    t = np.arange(LENGTH) / FS
    rise = np.where(t < FADE, (1 - np.cos(np.pi * t / FADE)) / 2, 1.0)
    tests = []
    for level in LEVELS:
        u = rise * np.asarray(sampled(sweep(level, *SWEPT_HZ, BURST, fade=FADE), FS, LENGTH))
        channels = {"input": u, "velocity": np.zeros(LENGTH)}
        record = Record(FS, channels, {"input": "V", "velocity": "m/s"})
        tests.append(Test("sweep", (record,) * 4, f"sweep_{level:.2f}V", level=level))
    records = Records.of(tests)
    groups = changed(records.groups, noise_std=np.full(len(LEVELS), noise_std))
    return replace(records, groups=groups)


def opening() -> Design[Records]:
    """Return tests for gamma alone: two sweeps, with the prior range of Teloli et al."""
    held = {name: value for name, value in truth().items() if name not in step4.NAMES}
    prior = box({name: PRIOR[name] for name in step4.NAMES})
    return Design(_sweeping(5 * VELOCITY_NOISE), prior, held)


def joint() -> Design[Records]:
    """Return tests for all parameters: two sweeps, with the prior ranges of Teloli et al.

    The prior ranges of omega_n extend 1 % to both sides, those of the gain 5 %.

    The other boxes extend 1 % about omega_n and 5 % about the gain.
    """
    omega_n = truth()["omega_n"]
    bounds = {"omega_n": (0.99 * omega_n, 1.01 * omega_n), **PRIOR}
    bounds["gain"] = (0.95 * GAIN, 1.05 * GAIN)
    return Design(_sweeping(2 * VELOCITY_NOISE), box(bounds))


def lines() -> tuple[FRF, Box]:
    """Return FRF lines near the resonance, and the prior of omega_n, zeta and gain."""
    first, last, spacing = LINES_HZ
    freq = np.arange(first, last, spacing)
    omega_n, zeta = truth()["omega_n"], truth()["zeta"]
    peak = GAIN / (2 * zeta * omega_n**2)
    unit, zero = np.ones_like(freq), np.zeros(len(freq), complex)
    frf = FRF(
        freq=freq, h=zero, coherence=unit, variance=(LINE_NOISE * peak) ** 2 * unit,
        input_spectrum=unit, output_spectrum=unit, num_averages=1.0, num_segments=1,
        num_repeats=1, nperseg=round(FS / spacing), noverlap=0, fs=FS, window="boxcar",
        estimator="h1", response="displacement",
    )  # fmt: skip
    bounds = {"omega_n": (0.98 * omega_n, 1.02 * omega_n), "zeta": PRIOR["zeta"]}
    return frf, box({**bounds, "gain": (0.9 * GAIN, 1.1 * GAIN)})


def truth() -> dict[str, float]:
    """Return the rig's parameters: Table 1 of Teloli et al. and the gain of the virtual rig."""
    parameters = as_oscillator(TRUTH).parameters()
    return {**{name: float(value) for name, value in parameters.items()}, "gain": GAIN}


def probing_of(campaign: Campaign, report: Report) -> Design[KernelData]:
    """Return the part of a campaign that Step 3 (kernel fit) uses: tones, noise and prior."""
    report(stages.design(3))
    fitted = _kernel_fit(campaign, _linear(campaign))
    counts = np.unique(np.asarray(fitted.data.num_repeats)).astype(int)
    if len(counts) > 1:
        raise DataError(
            "Step 3 can be calibrated only if all tones have the same number of repeats, but the "
            f"tones have {counts}.",
            remedy="Exclude repeats until all tones have the same number of repeats.",
        )
    return Design(fitted.data, fitted.box)


def opening_of(campaign: Campaign, report: Report) -> Design[Records]:
    """Return the inputs of Step 4 (gamma): sweeps, prior and the results of Steps 2 and 3."""
    report(stages.design(4))
    sweeps = sweep_tests(campaign.tests, campaign.settings)
    if sweeps is None:
        raise DataError(
            "Step 4 needs sweeps, which the campaign lacks.",
            remedy="Add a test of kind `sweep` to the campaign.",
        )
    linear = _linear(campaign)
    means = _kernel_fit(campaign, linear).fit.theta
    records = Records.of(sweeps.fitted, substeps=campaign.settings.substeps)
    key, pooled = jax.random.key(0), linear.pooled
    _, _, prior, held = step4.fit_opening(key, records, pooled, means, campaign.settings)
    return Design(_timed(records), prior, held)


def joint_of(campaign: Campaign, report: Report) -> Design[Records]:
    """Return a campaign's sweeps and prior for the joint posterior, or raise an error."""
    seen = measured_in(campaign, report)
    posterior = posterior_of("joint", seen, report=report)
    data = posterior.data
    parts = [p for p in data.parts if isinstance(p, Records)] if isinstance(data, Dataset) else []
    if len(parts) != 1:
        raise DataError(
            "Calibration of the joint posterior needs sweeps with the same channels and length, "
            f"but the campaign has {len(parts)} groups of sweeps with the same channels and "
            "length.",
            remedy="Keep only one of these groups in the campaign, or calibrate without a "
            "campaign.",
        )
    held = {name: float(value) for name, value in data.held.items()}
    return Design(_timed(parts[0]), posterior.box, held)


def _linear(campaign: Campaign) -> LinearStep:
    noise = linear_test(campaign.tests)
    if noise is None:
        raise DataError("Steps 3 and 4 need a noise test for Step 2, which the campaign lacks.")
    gain = gain_of(force_per_unit(campaign), drive_of(noise))
    return linear_step(noise, gain, campaign.settings.modes)


def _kernel_fit(campaign: Campaign, linear: LinearStep) -> step3.KernelFit:
    probing = probing_tests(campaign.tests, linear.natural_hz)
    return step3.fit_kernel(jax.random.key(0), probing, linear.pooled, campaign.settings)


def _timed(records: Records) -> Records:
    """Return the records if they can be simulated: time data from rest with several repeats."""
    wrong = {
        "a band": records.lines is not None,
        "whole periods": records.held.periodic,
        "one repeat": bool(np.any(np.asarray(records.groups.num_repeats) < 2)),
        "runs with offsets": records.groups.origin.shape[1] > 0,
        "accelerations": records.response == "acceleration",
    }
    named = [name for name, is_wrong in wrong.items() if is_wrong]
    if named:
        raise DataError(
            f"Sweeps with {named[0]} cannot be simulated for a calibration.",
            remedy="Leave these sweeps out of the campaign, or calibrate without a campaign.",
        )
    return records
