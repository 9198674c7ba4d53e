"""What each joint would do in a candidate test: its information, its peak displacement."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jbw.measurement.channels import derivative_order
from jbw.measurement.records import Record, Test
from jbw.observables import harmonics
from jbw.observables.evidence import Evidence, evidence
from jbw.observables.harmonics import NUM_HARMONICS, Group
from jbw.observables.joint import joint_of
from jbw.observables.response import reduce, response_to
from jbw.observables.steady import ORDERS
from jbw.oscillator.excitation import sampled, sweep
from jbw.oscillator.steady import steady_state
from jbw.oscillator.waveform import synthesis
from jbw.planning.beliefs import Beliefs
from jbw.planning.candidates import Candidate, Sweep, Tones
from jbw.planning.information import fisher

SUBSTEPS = 1  # the exact step at the samples: derivatives to a few parts in a thousand
NUM_PHASES = 256  # of a period, where its peak is looked for
SI_UNITS = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}
LABEL = "candidate"  # one name for all: labels are static, and each new one would compile anew


@dataclass(frozen=True)
class Noise:
    """Noise of the response channel.

    Attributes:
        std: Standard deviation of a sample [m, m/s or m/s^2].
        response: displacement, velocity or acceleration.
    """

    std: float
    response: str


@dataclass(frozen=True)
class Prospect:
    """A candidate at every joint that is held possible.

    Attributes:
        candidate: The test.
        information: Fisher information of one repeat, joint by joint; zero where not found.
        y_peak: Peak displacement [m]; NaN where no response was found.
    """

    candidate: Candidate
    information: Float[np.ndarray, "joint parameter parameter"]
    y_peak: Float[np.ndarray, " joint"]

    @property
    def num_lost(self) -> int:
        """Joints for which no response was found."""
        return int(np.sum(~np.isfinite(self.y_peak)))


def prospects(
    candidates: Sequence[Candidate],
    beliefs: Beliefs,
    noise: Noise,
    report: Callable[[str], None] = lambda _: None,
) -> tuple[Prospect, ...]:
    """Information and peak displacement of candidates at every joint.

    Records of sweeps are filled up to the length of the longest, for each new length would be
    compiled anew; what fills them up is not counted.

    Args:
        candidates: The tests.
        beliefs: The joints held possible.
        noise: Noise of the response channel.
        report: Called with one sentence at every candidate.
    """
    sweeps = [one for one in candidates if isinstance(one, Sweep)]
    longest = max((one.num_samples for one in sweeps), default=0)
    found = []
    for i, candidate in enumerate(candidates):
        report(f"{i + 1}/{len(candidates)} {candidate}, input {candidate.level:g}")
        found.append(_prospect(candidate, beliefs, noise, longest))
    return tuple(found)


def _prospect(candidate: Candidate, beliefs: Beliefs, noise: Noise, longest: int) -> Prospect:
    if isinstance(candidate, Sweep):
        y_peak = peak_displacements(candidate, beliefs, longest)
        data = [sweep_evidence(candidate, noise, longest)] * beliefs.num_joints
    else:
        motions = [_motion(candidate, theta) for theta, _ in beliefs.each()]
        y_peak = np.array([_crest(motion) for motion in motions])
        data = [tones_evidence(candidate, motion, noise) for motion in motions]
    information = np.array(
        [
            fisher(_arrays(theta), beliefs.names, jnp.asarray(scale), told, kept)
            for (theta, scale), (told, kept) in zip(beliefs.each(), data, strict=True)
        ]
    )
    lost = ~np.isfinite(information).all(axis=(1, 2)) | ~np.isfinite(y_peak)
    information[lost], y_peak[lost] = 0.0, np.nan
    return Prospect(candidate, information, y_peak)


def peak_displacements(
    candidate: Sweep, beliefs: Beliefs, longest: int = 0
) -> Float[np.ndarray, " joint"]:
    """Peak displacement of every joint under a sweep [m]; not finite where it diverges.

    Args:
        candidate: The sweep.
        beliefs: The joints held possible.
        longest: Samples to fill the record up to.
    """
    source = jnp.asarray(_source(candidate, longest))
    each = [_displacement(_arrays(theta), source, candidate.fs) for theta, _ in beliefs.each()]
    return np.max(np.abs(np.array(each)), axis=1)


def _motion(candidate: Tones, theta: Mapping[str, float]) -> Complex[np.ndarray, "tone harmonic"]:
    """Odd harmonics of the steady displacement [m], NaN where they were not found."""
    omega = 2 * np.pi * jnp.array(candidate.frequencies_hz)
    return np.asarray(_steady(_arrays(theta), omega, jnp.asarray(candidate.level)))


def _crest(motion: Complex[np.ndarray, "tone harmonic"]) -> float:
    """Largest displacement of all tones [m]."""
    phase = jnp.linspace(0.0, 2 * np.pi, NUM_PHASES, endpoint=False)
    return float(np.max(np.abs([synthesis(jnp.asarray(q), phase) for q in motion])))


def sweep_evidence(
    candidate: Sweep, noise: Noise, longest: int = 0
) -> tuple[Evidence, Float[Array, " value"]]:
    """A sweep's record, as the identification would reduce it, and which of it is measured.

    The information does not depend on the response that is measured, so that it is left at zero.

    Args:
        candidate: The sweep.
        noise: Noise of the response channel.
        longest: Samples to fill the record up to.
    """
    source = _source(candidate, longest)
    channels = {"input": source, noise.response: np.zeros_like(source)}
    units = {"input": "V", noise.response: SI_UNITS[noise.response]}
    test = Test("sweep", (Record(candidate.fs, channels, units),), name=LABEL)
    records = reduce([test], substeps=SUBSTEPS)
    known = replace(records.repeats, noise_std=jnp.full(1, noise.std))
    kept = np.arange(len(source)) < candidate.num_samples
    return evidence([replace(records, repeats=known)]), jnp.asarray(kept, float)


def tones_evidence(
    candidate: Tones, motion: Complex[np.ndarray, "tone harmonic"], noise: Noise
) -> tuple[Evidence, Float[Array, " value"]]:
    r"""Harmonics of steady tones, as the identification would read them; all of it is measured.

    Real and imaginary parts of a harmonic read from N samples have the variance
    $2\sigma^2 / N$ each.

    Args:
        candidate: The tones.
        motion: Odd harmonics of the steady displacement [m].
        noise: Noise of the response channel.
    """
    omega = 2 * np.pi * np.array(candidate.frequencies_hz)
    load = candidate.level * np.tile(np.arange(NUM_HARMONICS) == 0, (len(omega), 1)) + 0j
    groups = [_group(order, omega, load, motion, noise.response) for order in ORDERS]
    points = harmonics.gather(groups)
    std = noise.std * np.sqrt(2 / candidate.num_samples)
    known = replace(points.repeats, noise_std=jnp.full(len(groups), std))
    kept = jnp.ones(2 * len(groups) * len(omega))
    return evidence([replace(points, repeats=known)]), kept


def _group(
    order: int,
    omega: Float[np.ndarray, " tone"],
    load: Complex[np.ndarray, "tone harmonic"],
    motion: Complex[np.ndarray, "tone harmonic"],
    response: str,
) -> Group:
    factor = (1j * order * omega) ** derivative_order(response)
    return Group(
        label=LABEL,
        run=LABEL,
        omega=omega,
        load=load,
        motion=motion,
        order=order,
        values=factor * motion[:, order // 2],
        factor=factor,
        within=0.0,
        num_repeats=1,
    )


def _source(candidate: Sweep, longest: int) -> Float[np.ndarray, " time"]:
    """Samples of the input, with silence behind them up to so many."""
    played = sweep(
        candidate.level,
        candidate.start_hz,
        candidate.stop_hz,
        candidate.burst,
        fade=candidate.fade,
    )
    size = max(candidate.num_samples, longest)
    return np.asarray(sampled(played, candidate.fs, size))


@partial(jax.jit, static_argnames="fs")
def _displacement(
    theta: Mapping[str, Array], source: Float[Array, " time"], fs: float
) -> Float[Array, " time"]:
    return response_to(theta, source, fs, response="displacement", substeps=SUBSTEPS)


@jax.jit
def _steady(
    theta: Mapping[str, Array], omega: Float[Array, " tone"], level: Float[Array, ""]
) -> Complex[Array, "tone harmonic"]:
    """Harmonics of the steady motion, NaN where they were not found."""
    return steady_state(joint_of(theta), omega, theta["gain"] * level, NUM_HARMONICS)


def _arrays(values: Mapping[str, float]) -> dict[str, Array]:
    return {name: jnp.asarray(float(value)) for name, value in values.items()}
