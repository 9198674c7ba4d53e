"""Plans: before any test from ranges, after a run from its posterior."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jbw.errors import ConfigError
from jbw.planning.beliefs import Beliefs, after, before
from jbw.planning.combining import combine
from jbw.planning.description import Description, read_description
from jbw.planning.information import covariance
from jbw.planning.plan import Plan, Wish, expected, ordered, row
from jbw.planning.proposals import Grid, Reach, displacement_for, propose, sampling_for
from jbw.planning.prospects import Noise, prospects
from jbw.planning.runs import noise_of, rig_of

WANTED = ("alpha", "delta", "gamma")
CV = 0.05
NUM_JOINTS = 16
ADMITTED = ("ok", "too few")  # alone; together they may meet the wish
EVERY_KIND = {"sweep": Grid(), "tones": Grid(), "stepped": Grid()}
LIMITS = ("max_repeats", "max_displacement", "max_input")
NOISE_ALONE = (
    "Noise alone is counted: a joint that changes from day to day or does not follow the model is "
    "known less well. Spreads beyond 30 % tell the order of magnitude only."
)
PER_KILOGRAM = (
    "The run holds no gain, so inputs are in N/kg; give gain or modal_mass in a file of --limits "
    "to have them in V or N."
)
UNKNOWN_REACH = (
    "The run does not tell its largest displacement, so levels aim at 1/delta = {:.3g} m; give "
    "max_displacement in a file of --limits."
)


@dataclass(frozen=True)
class _Ground:
    """What a plan is made on."""

    beliefs: Beliefs
    noise: Noise
    fs: float
    aim: float
    input_unit: str
    notes: tuple[str, ...]


def _silent(_: str) -> None:
    """Say nothing."""


def plan_tests(
    description: Description | str | Path | None = None,
    tree: xr.DataTree | None = None,
    *,
    report: Callable[[str], None] = _silent,
) -> Plan:
    """Plan tests of a joint: which level, rate, tones and repeats a wished CV takes.

    Args:
        description: What is guessed, wanted and possible, or its plan file; defaults beside a run,
            which tells the joint itself.
        tree: A run's result, as `posterior.nc` holds it; None before any test.
        report: Called with one sentence at every candidate.

    Returns:
        The plan.

    Raises:
        ConfigError: A plan file against the schema, neither a description nor a run, a run that
            does not tell the noise, which the description leaves out too, nothing wanted that is
            inferred, or a gain beside a run that inferred it.
        DataError: The run's posterior lacks a parameter of the joint.
    """
    if isinstance(description, str | Path):
        description = read_description(Path(description), of_run=tree is not None)
    description = description or Description({})
    ground = _before(description) if tree is None else _after(description, tree)
    wish = _wish(description, ground)
    reach = Reach(ground.fs, ground.aim, wish.max_input)
    candidates = propose(description.grids or EVERY_KIND, ground.beliefs, reach)
    found = prospects(candidates, ground.beliefs, ground.noise, report)
    rows = [row(one, ground.beliefs, wish) for one in found]
    admitted = [one for one, judged in zip(found, rows, strict=True) if judged.status in ADMITTED]
    known = np.sqrt(np.diag(covariance(ground.beliefs.precision)))
    return Plan(
        rows=ordered(rows),
        combination=combine(admitted, ground.beliefs, wish),
        wish=wish,
        num_joints=ground.beliefs.num_joints,
        before=expected(known[None], ground.beliefs, wish),
        notes=(*ground.notes, NOISE_ALONE),
    )


def _before(description: Description) -> _Ground:
    if not description.ranges or description.noise is None:
        raise ConfigError(
            "A plan needs a description of the joint and its noise, or a run, but has neither.",
            remedy="Write one with: jbw plan --example > plan.toml",
        )
    settings = description.settings
    inferred = "gain" in description.ranges
    beliefs = before(
        description.ranges,
        held={} if inferred else {"gain": description.gain or 1.0},
        num_joints=settings.get("joints", NUM_JOINTS),
        seed=settings.get("seed", 0),
    )
    drawn = f"Made at {beliefs.num_joints} joints drawn from the ranges, which count as known."
    return _Ground(
        beliefs=beliefs,
        noise=description.noise,
        fs=settings.get("fs") or _sampling(beliefs),
        aim=settings.get("max_displacement") or displacement_for(beliefs),
        input_unit=description.input_unit or "N/kg",
        notes=(drawn,),
    )


def _after(description: Description, tree: xr.DataTree) -> _Ground:
    settings, rig = description.settings, rig_of(tree)
    inferred = "gain" in tree["posterior"].data_vars
    if inferred and description.gain is not None:
        raise ConfigError(
            "Keys `gain` and `modal_mass` must be left out beside this run, which inferred the "
            f"gain, but one gives {description.gain:g}.",
            remedy="Leave it out; levels are in the unit of the run's input.",
        )
    held = {**rig.held, **({} if description.gain is None else {"gain": description.gain})}
    told = inferred or "gain" in held
    held.setdefault("gain", 1.0)
    beliefs = after(tree, held=held, num_joints=settings.get("joints", NUM_JOINTS))
    unit = (description.input_unit or rig.input_unit or "input's unit") if told else "N/kg"
    notes = [f"Made at {beliefs.num_joints} draws of the run's posterior, which counts as known."]
    notes += [] if told else [PER_KILOGRAM]
    aim = settings.get("max_displacement") or rig.y_peak
    if aim is None:
        aim = displacement_for(beliefs)
        notes.append(UNKNOWN_REACH.format(aim))
    return _Ground(
        beliefs=beliefs,
        noise=noise_of(description.noise, rig),
        fs=settings.get("fs") or rig.fs or _sampling(beliefs),
        aim=aim,
        input_unit=unit,
        notes=tuple(notes),
    )


def _sampling(beliefs: Beliefs) -> float:
    return sampling_for(float(np.median(beliefs.joints["omega_n"])) / (2 * np.pi))


def _wish(description: Description, ground: _Ground) -> Wish:
    settings, names = description.settings, ground.beliefs.names
    asked = settings.get("wanted", WANTED)
    if not set(asked) & set(names):
        raise ConfigError(
            f"Key `wanted` must name parameters that are inferred, but has {', '.join(asked)}.",
            remedy=f"Choose among {', '.join(names)}.",
        )
    limits: dict[str, Any] = {key: settings[key] for key in LIMITS if key in settings}
    return Wish(
        wanted=tuple(name for name in names if name in asked),
        cv=settings.get("cv", CV),
        input_unit=ground.input_unit,
        **limits,
    )
