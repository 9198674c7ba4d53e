"""Plans: before any test from ranges, after a run from its posterior."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from jbw.errors import ConfigError
from jbw.planning.beliefs import Beliefs, after, before
from jbw.planning.combining import combine
from jbw.planning.description import Description
from jbw.planning.information import covariance
from jbw.planning.plan import Plan, Wish, expected, ordered, row
from jbw.planning.proposals import Grid, Reach, displacement_for, propose, sampling_for
from jbw.planning.prospects import Noise, prospect
from jbw.planning.runs import noise_of, rig_of

WANTED = ("alpha", "delta", "gamma")
CV = 0.05
NUM_JOINTS = 16
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
    description: Description | None = None,
    tree: xr.DataTree | None = None,
    *,
    report: Callable[[str], None] = _silent,
) -> Plan:
    """Plan tests of a joint: which level, rate, tones and repeats a wished CV takes.

    Args:
        description: What is guessed, wanted and possible; defaults beside a run.
        tree: A run's result, as `posterior.nc` holds it; None before any test.
        report: Called with one sentence at every candidate.

    Returns:
        The plan.

    Raises:
        ConfigError: Neither a description nor a run, or a run that does not tell the noise, which
            the description leaves out too.
        DataError: The run's posterior lacks a parameter of the joint.
    """
    description = description or Description({})
    ground = _before(description) if tree is None else _after(description, tree)
    wish = _wish(description, ground)
    reach = Reach(ground.fs, ground.aim, wish.max_input)
    candidates = propose(description.grids or EVERY_KIND, ground.beliefs, reach)
    found = []
    for i, candidate in enumerate(candidates):
        level = f"{candidate.level:g} {wish.input_unit}"
        report(f"{i + 1}/{len(candidates)} {candidate}, {level}")
        found.append(prospect(candidate, ground.beliefs, ground.noise))
    rows = [row(one, ground.beliefs, wish) for one in found]
    admitted = [one for one, judged in zip(found, rows, strict=True) if judged.within_limits]
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
    held = {"gain": description.gain or 1.0}
    beliefs = after(tree, held=held, num_joints=settings.get("joints", NUM_JOINTS))
    inferred, given = "gain" in beliefs.names, description.input_unit
    unit = (rig.input_unit or "unit of the input") if inferred else (given or "N/kg")
    made = f"Made at {beliefs.num_joints} draws of the run's posterior, which counts as known."
    return _Ground(
        beliefs=beliefs,
        noise=noise_of(description.noise, rig),
        fs=settings.get("fs") or rig.fs or _sampling(beliefs),
        aim=settings.get("max_displacement") or rig.y_peak or displacement_for(beliefs),
        input_unit=unit,
        notes=(made,) if inferred or given else (made, PER_KILOGRAM),
    )


def _sampling(beliefs: Beliefs) -> float:
    return sampling_for(float(np.median(beliefs.joints["omega_n"])) / (2 * np.pi))


def _wish(description: Description, ground: _Ground) -> Wish:
    settings = description.settings
    wanted = settings.get("wanted", WANTED)
    limits: dict[str, Any] = {key: settings[key] for key in LIMITS if key in settings}
    return Wish(
        wanted=tuple(name for name in ground.beliefs.names if name in wanted),
        cv=settings.get("cv", CV),
        input_unit=ground.input_unit,
        **limits,
    )
