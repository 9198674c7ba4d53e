"""What each joint would do in a candidate test: its information, its peak displacement."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jbw.campaign.settings import DEFAULT_LAWS
from jbw.observables.dataset import Dataset
from jbw.observables.harmonic_groups import NUM_HARMONICS
from jbw.observables.records import Records
from jbw.observables.samples import response_to
from jbw.observables.steady import Points
from jbw.oscillator.excitation import sampled, sweep
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.steady.cycle import steady_state
from jbw.oscillator.steady.waveform import synthesis
from jbw.planning.beliefs import Beliefs
from jbw.planning.information import fisher
from jbw.planning.plan import Candidate, Noise, Sweep, Tones

SUBSTEPS = 1  # the exact step at the samples: derivatives to a few parts in a thousand
NUM_PHASES = 256  # of a period, where its peak is looked for


@dataclass(frozen=True)
class Prospect:
    """A candidate at every joint that is held possible.

    Attributes:
        candidate: The test.
        information: Fisher information of one repeat, joint by joint; zero where not found.
        y_peak: Peak displacement [m]; NaN where no response was found.
    """

    candidate: Candidate
    information: Float[np.ndarray, " joint parameter parameter"]
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
        data = [sweep_evidence(candidate, noise, longest, beliefs.laws)] * beliefs.num_joints
    else:
        motions = [_motion(candidate, theta, beliefs.laws) for theta, _ in beliefs.each()]
        y_peak = np.array([_crest(motion) for motion in motions])
        data = [tones_evidence(candidate, motion, noise, beliefs.laws) for motion in motions]
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
    each = [
        _displacement(_arrays(theta), source, candidate.fs, beliefs.laws)
        for theta, _ in beliefs.each()
    ]
    return np.max(np.abs(np.array(each)), axis=1)


def _motion(
    candidate: Tones, theta: Mapping[str, float], laws: tuple[str, ...]
) -> Complex[np.ndarray, "tone harmonic"]:
    """Odd harmonics of the steady displacement [m], NaN where they were not found."""
    omega = 2 * np.pi * jnp.array(candidate.frequencies_hz)
    return np.asarray(_steady(_arrays(theta), omega, jnp.asarray(candidate.level), laws))


def _crest(motion: Complex[np.ndarray, "tone harmonic"]) -> float:
    """Largest displacement of all tones [m]."""
    phase = jnp.linspace(0.0, 2 * np.pi, NUM_PHASES, endpoint=False)
    return float(np.max(np.abs([synthesis(jnp.asarray(q), phase) for q in motion])))


def sweep_evidence(
    candidate: Sweep, noise: Noise, longest: int = 0, laws: tuple[str, ...] = DEFAULT_LAWS
) -> tuple[Dataset, Float[Array, " value"]]:
    """A sweep's record, as the identification would reduce it, and which of it is measured.

    The information does not depend on the response that is measured, so that it is left at zero.

    Args:
        candidate: The sweep.
        noise: Noise of the response channel.
        longest: Samples to fill the record up to.
        laws: Laws of the joint.
    """
    source = _source(candidate, longest)
    planned = Records.design(
        source, candidate.fs, response=noise.response, noise_std=noise.std, substeps=SUBSTEPS,
        laws=laws,
    )  # fmt: skip
    kept = np.arange(len(source)) < candidate.num_samples
    return Dataset.of([planned]), jnp.asarray(kept, float)


def tones_evidence(
    candidate: Tones,
    motion: Complex[np.ndarray, "tone harmonic"],
    noise: Noise,
    laws: tuple[str, ...] = DEFAULT_LAWS,
) -> tuple[Dataset, Float[Array, " value"]]:
    r"""Harmonics of steady tones, as the identification would read them; all of it is measured.

    Real and imaginary parts of a harmonic read from N samples have the variance
    $2\sigma^2 / N$ each.

    Args:
        candidate: The tones.
        motion: Odd harmonics of the steady displacement [m].
        noise: Noise of the response channel.
        laws: Laws of the joint.
    """
    omega = 2 * np.pi * np.array(candidate.frequencies_hz)
    planned = Points.design(
        omega,
        candidate.level,
        motion,
        response=noise.response,
        noise_std=noise.std,
        num_samples=candidate.num_samples,
        laws=laws,
    )
    return Dataset.of([planned]), jnp.ones(2 * planned.position.size * omega.size)


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


@partial(jax.jit, static_argnames=("fs", "laws"))
def _displacement(
    theta: Mapping[str, Array], source: Float[Array, " time"], fs: float, laws: tuple[str, ...]
) -> Float[Array, " time"]:
    return response_to(theta, source, fs, laws=laws, response="displacement", substeps=SUBSTEPS)


@partial(jax.jit, static_argnames="laws")
def _steady(
    theta: Mapping[str, Array],
    omega: Float[Array, " tone"],
    level: Float[Array, ""],
    laws: tuple[str, ...],
) -> Complex[Array, "tone harmonic"]:
    """Harmonics of the steady motion, NaN where they were not found."""
    return steady_state(oscillator_of(theta, laws), omega, theta["gain"] * level, NUM_HARMONICS)


def _arrays(values: Mapping[str, float]) -> dict[str, Array]:
    return {name: jnp.asarray(float(value)) for name, value in values.items()}
