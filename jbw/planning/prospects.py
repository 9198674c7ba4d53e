"""The predicted information and peak displacement of a candidate test for each drawn joint."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jbw.inference.lanes import LANES, at_points, num_cores
from jbw.measurement.records import Record, Test
from jbw.observables.controlled import ControlledPoints
from jbw.observables.dataset import Dataset, stacked
from jbw.observables.groups import changed
from jbw.observables.records import Records
from jbw.observables.steady import Points, planned_motion
from jbw.oscillator.excitation import sampled, sweep
from jbw.oscillator.steady.waveform import synthesis
from jbw.parts import Parts, unkept
from jbw.planning.beliefs import Beliefs
from jbw.planning.plan import Candidate, PlannedBackbone, PlannedSweep, PlannedTones, ResponseNoise
from jbw.quantities import UNIT_OF, Motion
from jbw.report.messages import planning
from jbw.verification.in_time import responses_at

# A planned test as data for the model, with a mask that is 1 for each measured value.
Design = tuple[Dataset, Float[np.ndarray, " value"]]
SUBSTEPS = 1  # One step per sample gives derivatives accurate to a few parts in a thousand.
RELATIVE_STEP = 1e-5  # step of finite differences; their error is the step squared / damping ratio
NUM_PHASES = 256  # number of points of a period among which its peak is searched


@dataclass(frozen=True)
class Prospect:
    """The information and peak displacement of a candidate test for every drawn joint."""

    candidate: Candidate
    # Fisher information of one repeat; zero if the model has no solution for that joint
    information: Float[np.ndarray, " joint parameter parameter"]
    # peak displacement [m]; NaN if the model has no solution for that joint
    y_peak: Float[np.ndarray, " joint"]

    @property
    def num_lost(self) -> int:
        """The number of drawn joints for which the model has no solution."""
        return int(np.sum(~np.isfinite(self.y_peak)))


def prospects(
    candidates: Sequence[Candidate],
    beliefs: Beliefs,
    noise: ResponseNoise,
    report: Callable[[str], None] = lambda _: None,
    parts: Parts = unkept,
) -> tuple[Prospect, ...]:
    """Return, for every drawn joint, information and peak displacement of candidate tests.

    The results of each candidate are stored in `parts`, so that an interrupted plan can continue.

    `parts` stores the prospect of each candidate.
    """
    # All sweeps are padded to the longest one, because each new length needs a new compilation. The
    # padding does not count as data.
    sweeps = [candidate for candidate in candidates if isinstance(candidate, PlannedSweep)]
    longest = max((candidate.num_samples for candidate in sweeps), default=0)
    report(planning.TIMING)
    firsts = {type(candidate): candidate for candidate in reversed(candidates)}
    kinds, rest = (Prospect, *firsts), (beliefs, noise, longest)
    timed = {
        form: parts(f"timed {form.__name__}", partial(_timed, first, *rest), *kinds)
        for form, first in firsts.items()
    }
    seconds_of_form = {form: seconds for form, (seconds, _) in timed.items()}
    report(cost_sentence(candidates, seconds_of_form, beliefs))
    predicted = []
    for i, candidate in enumerate(candidates):
        report(f"{i + 1}/{len(candidates)} {candidate}, input {candidate.level:g}")
        if firsts[type(candidate)] is candidate:
            predicted.append(timed[type(candidate)][1])
        else:
            predicted.append(parts(f"candidate {i}", partial(_prospect, candidate, *rest), *kinds))
    return tuple(predicted)


def _timed(
    candidate: Candidate, beliefs: Beliefs, noise: ResponseNoise, longest: int
) -> tuple[float, Prospect]:
    """Return the computing time of a candidate test, without compilation [s], and its results."""
    _prospect(candidate, beliefs, noise, longest)
    began = perf_counter()
    prospect = _prospect(candidate, beliefs, noise, longest)
    return perf_counter() - began, prospect


def cost_sentence(
    candidates: Sequence[Candidate], seconds_of_form: Mapping[type, float], beliefs: Beliefs
) -> str:
    """Return the sentence on a plan's computing time, estimated from one test of each kind."""
    seconds = sum(seconds_of_form[type(candidate)] for candidate in candidates)
    return planning.cost(len(candidates), beliefs.num_joints, seconds)


def _prospect(
    candidate: Candidate, beliefs: Beliefs, noise: ResponseNoise, longest: int
) -> Prospect:
    if isinstance(candidate, PlannedSweep):
        y_peak = peak_displacements(candidate, beliefs, longest)
        planned = _planned_sweep(candidate, beliefs.laws, noise.response, longest)
        groups = changed(planned.groups, noise_std=np.full(1, noise.std))
        data = Dataset.of([replace(planned, groups=groups)])
        # The sweep is padded to the longest one; the padding contains no information.
        is_measured = np.arange(planned.mean.shape[1]) < candidate.num_samples
        mask = is_measured.astype(float)
        information = fisher(beliefs.joints, beliefs.names, beliefs.scale, data, mask)
        return _found(candidate, information, y_peak)
    if isinstance(candidate, PlannedBackbone):
        y_peak, designs = _backbone_designs(candidate, beliefs, noise)
    else:
        y_peak, designs = _tones_designs(candidate, beliefs, noise)
    of_joints = []
    for i, design in enumerate(designs):
        one = {name: values[i : i + 1] for name, values in beliefs.joints.items()}
        of_joints.append(fisher(one, beliefs.names, beliefs.scale[i : i + 1], *design))
    return _found(candidate, np.concatenate(of_joints), y_peak)


def _found(
    candidate: Candidate,
    information: Float[np.ndarray, "joint parameter parameter"],
    y_peak: Float[np.ndarray, " joint"],
) -> Prospect:
    """Return the results of a candidate test, with zero information if a joint has no solution."""
    lost = ~np.isfinite(information).all(axis=(1, 2)) | ~np.isfinite(y_peak)
    information[lost], y_peak[lost] = 0.0, np.nan
    return Prospect(candidate, information, y_peak)


def peak_displacements(
    candidate: PlannedSweep, beliefs: Beliefs, longest: int = 0
) -> Float[np.ndarray, " joint"]:
    """Return each joint's peak displacement [m] in a sweep; not finite if the motion diverges."""
    joints = {name: np.asarray(values, float) for name, values in beliefs.joints.items()}
    data = _planned_sweep(candidate, beliefs.laws, "displacement", longest)
    return responses_at(joints, replace(data, depth=None, residuals="none"))[1]


def _planned_sweep(
    candidate: PlannedSweep, laws: tuple[str, ...], response: str, longest: int
) -> Records:
    """Return the record of a planned sweep; its response is zero."""
    played = sweep(
        candidate.level, candidate.start_hz, candidate.stop_hz, candidate.burst,
        fade=candidate.fade,
    )  # fmt: skip
    # Silence at the end makes all sweeps as long as the longest one.
    source = np.asarray(sampled(played, candidate.fs, max(candidate.num_samples, longest)))
    channels = {"input": source, response: np.zeros_like(source)}
    units = {"input": "V", response: UNIT_OF[response]}
    test = Test("sweep", (Record(candidate.fs, channels, units),), name="planned")
    return Records.of([test], laws=laws, substeps=SUBSTEPS)


def _tones_designs(
    candidate: PlannedTones, beliefs: Beliefs, noise: ResponseNoise
) -> tuple[Float[np.ndarray, " joint"], list[Design]]:
    """Return, for each joint, the peak displacement [m] and planned harmonics of steady tones."""
    omega, level = 2 * np.pi * np.array(candidate.frequencies_hz), jnp.asarray(candidate.level)
    phase = jnp.linspace(0.0, 2 * np.pi, NUM_PHASES, endpoint=False)
    y_peak, designs = [], []
    for theta in beliefs.joint_by_joint():
        motion = np.asarray(_steady(theta, jnp.asarray(omega), level, beliefs.laws))
        y_peak.append(np.max(np.abs([synthesis(jnp.asarray(q), phase) for q in motion])))
        planned = Points.design(
            omega, candidate.level, motion, response=noise.response, noise_std=noise.std,
            num_samples=candidate.num_samples, laws=beliefs.laws,
        )  # fmt: skip
        num_values = 2 * planned.position.size * omega.size
        designs.append((Dataset.of([planned]), np.ones(num_values)))
    return np.array(y_peak), designs


def _backbone_designs(
    candidate: PlannedBackbone, beliefs: Beliefs, noise: ResponseNoise
) -> tuple[Float[np.ndarray, " joint"], list[Design]]:
    """Return, for each joint, the peak displacement [m] and planned points of a backbone."""
    amplitudes = np.array(candidate.amplitudes)
    designs = []
    for theta in beliefs.joint_by_joint():
        planned = ControlledPoints.design(
            theta, amplitudes, response=cast("Motion", noise.response), noise_std=noise.std,
            num_samples=candidate.num_samples, laws=beliefs.laws,
        )  # fmt: skip
        designs.append((Dataset.of([planned]), np.ones(2 * amplitudes.size)))
    return np.full(beliefs.num_joints, amplitudes.max()), designs


def fisher(
    theta: Mapping[str, Float[np.ndarray, " joint"]],
    names: tuple[str, ...],
    scale: Float[np.ndarray, "joint parameter"],
    data: Dataset,
    is_measured: Float[np.ndarray, " value"],
) -> Float[np.ndarray, "joint parameter parameter"]:
    r"""Return, for each joint, a test's Fisher information on relative changes of the parameters.

    $$F = J^T J, \qquad J = \partial r / \partial x, \qquad \theta_i = \theta_{0,i} + s_i x_i$$

    where r is the residual in standard errors, whose derivative does not depend on the measured
    values, and s, the `scale`, is the parameter itself if it is positive, so that the standard
    deviations of x are coefficients of variation. The unknown noise, which the identification
    integrates out, costs no accuracy of the parameters at this order. `is_measured` is 1 for
    measured values, 0 for padding. Derivatives are differences,

    $$J \approx \frac{r(h) - r(-h)}{2 h}$$

    computed by the program of the predictions: a program with derivatives through time takes
    several times as long to compile.
    """
    count, size = scale.shape
    away = RELATIVE_STEP * np.concatenate([np.eye(size), -np.eye(size)])
    joints_at_once = max(1, num_cores() * LANES // len(away))
    information = []
    for first in range(0, count, joints_at_once):
        some = slice(first, first + joints_at_once)
        points = {
            name: np.repeat(np.asarray(values, float)[some], len(away))
            for name, values in theta.items()
        }
        for i, name in enumerate(names):
            points[name] = points[name] + np.outer(scale[some, i], away[:, i]).ravel()
        rows = np.asarray(at_points(stacked, points, data)) * is_measured
        ahead, behind = np.moveaxis(rows.reshape(-1, 2, size, rows.shape[1]), 1, 0)
        slope = (ahead - behind) / (2 * RELATIVE_STEP)
        information.append(slope @ np.swapaxes(slope, 1, 2))
    return np.concatenate(information)


_steady = jax.jit(planned_motion, static_argnames="laws")
