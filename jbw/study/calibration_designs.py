"""What is calibrated when no campaign is given: short tests of the virtual rig, a poor laser.

Noise of 1 mm/s, twenty times the rig's, leaves posteriors that are not points and a ridge of alpha
and delta a hundredth as thick as it is long.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw import rig
from jbw.identification.paper.kernel import KernelData
from jbw.inference.space.box import Box, box
from jbw.measurement.spectra import FRF
from jbw.observables.records import Records
from jbw.observables.repeated import repeats
from jbw.oscillator.excitation import sampled, sweep
from jbw.rig.presets import PRIOR, PROBING_HZ, TRUTH

GAIN = rig.LABORATORY.gain
REPEATS = 8
KERNEL_NOISE = 2.5e-10  # m^-2 s^6, of one repeat of 64 s: what 1 mm/s leaves
Y_PEAK = (7.00e-4, 7.10e-4, 7.25e-4, 7.30e-4, 7.40e-4)  # m, at 9 N/kg
VELOCITY_NOISE = 1e-3  # m/s
LEVELS = (0.05, 0.20)  # V
FS, BURST, LENGTH = 256.0, 1.75, 512  # Hz, s, samples
SWEPT_HZ = (10.0, 28.0)
FADE = 0.25  # s at both ends: what starts at full size is not band-limited
LINES_HZ = (16.0, 21.6, 0.05)  # first, last, spacing
LINE_NOISE = 0.01  # of the largest line, both components together


class SweepDesign(NamedTuple):
    """Sweeps, and what is known of them.

    Attributes:
        records: Inputs, repeats and sampling.
        noise_std: Noise of one sample of one repeat, level by level.
        held: Parameters that are not inferred.
        prior: Box of those that are.
    """

    records: Records
    noise_std: Float[Array, " level"]
    held: dict[str, float]
    prior: Box


class KernelDesign(NamedTuple):
    """Probing tones.

    Attributes:
        data: Frequencies, displacements, noise of one repeat.
        num_repeats: Repeats at every frequency.
        prior: Box of zeta, alpha and delta.
    """

    data: KernelData
    num_repeats: int
    prior: Box


def probing(num_repeats: int = REPEATS) -> KernelDesign:
    """Five probing tones and the paper's boxes.

    Args:
        num_repeats: Repeats at each tone.
    """
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
    return KernelDesign(data, num_repeats, box({n: PRIOR[n] for n in ("zeta", "alpha", "delta")}))


def sweeping(num_repeats: int = 4) -> Records:
    """Two sweeps of 2 s through the resonance.

    Args:
        num_repeats: Repeats of each.
    """
    t = np.arange(LENGTH) / FS
    rise = np.where(t < FADE, (1 - np.cos(np.pi * t / FADE)) / 2, 1.0)
    source = [rise * sampled(sweep(a, *SWEPT_HZ, BURST, fade=FADE), FS, LENGTH) for a in LEVELS]
    count, size = len(LEVELS), np.full(len(LEVELS), LENGTH)
    return Records(
        source=jnp.stack(source),
        mean=jnp.zeros((count, LENGTH)),
        repeats=repeats(
            within=np.ones(count),
            num_repeats=np.full(count, num_repeats),
            sizes=size,
            longest=LENGTH,
            labels=tuple(f"sweep_{level:.2f}V" for level in LEVELS),
            runs=("",) * count,
            scale=np.ones(count),
        ),
        origin=jnp.zeros((count, 0)),
        fs=FS,
        substeps=2,
    )


def opening() -> SweepDesign:
    """Gamma alone from both sweeps, in the paper's box."""
    held = {name: value for name, value in truth().items() if name != "gamma"}
    noise = jnp.full(len(LEVELS), 5 * VELOCITY_NOISE)
    return SweepDesign(sweeping(), noise, held, box({"gamma": PRIOR["gamma"]}))


def joint() -> SweepDesign:
    """All parameters from both sweeps: the paper's boxes, 1 % about omega_n, 5 % about the gain."""
    omega_n = truth()["omega_n"]
    bounds = {"omega_n": (0.99 * omega_n, 1.01 * omega_n), **PRIOR}
    bounds["gain"] = (0.95 * GAIN, 1.05 * GAIN)
    noise = jnp.full(len(LEVELS), 2 * VELOCITY_NOISE)
    return SweepDesign(sweeping(), noise, {}, box(bounds))


def lines() -> tuple[FRF, Box]:
    """Lines of an FRF about the resonance without leakage, and the prior of Step 2."""
    first, last, spacing = LINES_HZ
    freq = np.arange(first, last, spacing)
    omega_n, zeta = truth()["omega_n"], truth()["zeta"]
    peak = GAIN / (2 * zeta * omega_n**2)
    one, zero = np.ones_like(freq), np.zeros(len(freq), complex)
    found = FRF(
        freq=freq, h=zero, coherence=one, variance=(LINE_NOISE * peak) ** 2 * one,
        input_spectrum=one, output_spectrum=one, num_averages=1.0, num_segments=1,
        num_repeats=1, nperseg=round(FS / spacing), noverlap=0, fs=FS, window="boxcar",
        estimator="h1", response="displacement",
    )  # fmt: skip
    bounds = {"omega_n": (0.98 * omega_n, 1.02 * omega_n), "zeta": PRIOR["zeta"]}
    return found, box({**bounds, "gain": (0.9 * GAIN, 1.1 * GAIN)})


def truth() -> dict[str, float]:
    """Parameters of the rig, the paper's Table 1, with its gain."""
    names = ("omega_n", "zeta", "alpha", "delta", "gamma")
    return {**{name: float(getattr(TRUTH, name)) for name in names}, "gain": GAIN}
