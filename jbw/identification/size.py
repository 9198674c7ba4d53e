"""The size of a fit, reported before it starts: its solver steps and their time."""

from collections.abc import Callable
from typing import Any

import numpy as np

from jbw.observables.dataset import Dataset
from jbw.observables.samples import loudest_hz
from jbw.oscillator.modes.assembled import is_assembled, num_modes
from jbw.quantities import joints_of
from jbw.report.messages import stages

# Time of one solver step [ns] for each joint: for the laws of the joint, and for each mode that the
# joint moves. Accurate to 15 % for one or two Bouc-Wen joints and 1 to 14 modes on one core.
LAWS_NS, MODE_NS = 9.0, 4.3
EVALUATIONS = 5000  # number of evaluations of the model in a usual first fit
LONG_S = 120.0  # time of a fit [s] from which a lower sampling rate is proposed
# The proposed rate has this number of samples per period of the strongest motion.
PER_PERIOD = 40


def announced(
    report: Callable[[str], Any], stage: Callable[[int, int], str], data: Dataset
) -> None:
    """Report the start of a fit with its size; if it will take long, report how to shorten it."""
    counts = [_solver_steps(part) for part in data.parts]
    report(stage(len(data.labels), sum(counts)))
    evaluation_s = 1e-9 * sum(counts) * _step_ns(data)
    if EVALUATIONS * evaluation_s < LONG_S:
        return
    largest = data.parts[int(np.argmax(counts))]
    rate = _lower_rate(largest)
    report(stages.long_fit(EVALUATIONS * evaluation_s, largest.groups.labels, rate))


def _solver_steps(part: Any) -> int:
    """Return the number of solver steps for one prediction of a data part; 0 without laws."""
    held = getattr(part, "held", None)  # the input of records over time; free decays have none
    num_samples = getattr(part, "num_samples", 0) if held is None else held.samples.size
    return num_samples * (part.substeps or 0) if part.laws else 0


def _step_ns(data: Dataset) -> float:
    """Return the time of one solver step of all modes and joints [ns]."""
    names, laws = data.held, next((part.laws for part in data.parts if part.laws), ())
    modes = next((len(part.modes.hz) for part in data.parts if part.modes is not None), 1)
    if is_assembled(names):
        modes = num_modes(names)
    return max(len(joints_of(laws)), 1) * (LAWS_NS + MODE_NS * modes)


def _lower_rate(part: Any) -> float | None:
    """Return a sampling rate [Hz] that halves the work or better; None if the rate is low."""
    if getattr(part, "held", None) is None:
        return None
    hz = loudest_hz(np.asarray(part.mean), part.fs)
    rate = float(np.ceil(PER_PERIOD * hz))
    return rate if 2 * rate <= part.fs else None
