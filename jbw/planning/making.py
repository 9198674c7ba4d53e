"""Plans: before any test from ranges, after a run from its posterior."""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from jbw.errors import ConfigError
from jbw.planning.beliefs import Beliefs, after, before
from jbw.planning.description import Description, read_description
from jbw.planning.information import covariance
from jbw.planning.judge import combine, expected, ordered, row
from jbw.planning.plan import Noise, Plan, Wish
from jbw.planning.proposals import Grid, Reach, displacement_for, propose, sampling_for
from jbw.planning.prospects import prospects
from jbw.quantities import UNIT_OF, in_dialect

ADMITTED = ("ok", "too few")  # alone; together they may meet the wish
EVERY_KIND = {"sweep": Grid(), "tones": Grid(), "stepped": Grid()}
NOISE_ALONE = (
    "Noise alone is counted: a joint that changes from day to day or does not follow the model is "
    "known less well. Spreads beyond 30 % tell the order of magnitude only."
)
PER_KILOGRAM = (
    "The run holds no gain, so inputs are in N/kg; give gain or modal_mass in a file of --limits "
    "to have them in V or N."
)
UNKNOWN_REACH = (
    "The run does not tell its largest displacement, so levels aim at {:.3g} m, where the joint "
    "slides; give "
    "max_displacement in a file of --limits."
)
RESPONSE_OF = {unit: response for response, unit in UNIT_OF.items()}
INPUT_UNITS = ("V", "N", "N/kg")


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
        num_joints=settings.joints,
        seed=settings.seed,
        laws=description.laws,
    )
    drawn = f"Made at {beliefs.num_joints} joints drawn from the ranges, which count as known."
    return _Ground(
        beliefs=beliefs,
        noise=description.noise,
        fs=settings.fs or _sampling(beliefs),
        aim=settings.max_displacement or displacement_for(beliefs),
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
    beliefs = after(tree, held=held, num_joints=settings.joints)
    unit = (description.input_unit or rig.input_unit or "input's unit") if told else "N/kg"
    notes = [f"Made at {beliefs.num_joints} draws of the run's posterior, which counts as known."]
    notes += [] if told else [PER_KILOGRAM]
    aim = settings.max_displacement or rig.y_peak
    if aim is None:
        aim = displacement_for(beliefs)
        notes.append(UNKNOWN_REACH.format(aim))
    return _Ground(
        beliefs=beliefs,
        noise=noise_of(description.noise, rig),
        fs=settings.fs or rig.fs or _sampling(beliefs),
        aim=aim,
        input_unit=unit,
        notes=tuple(notes),
    )


def _sampling(beliefs: Beliefs) -> float:
    return sampling_for(float(np.median(beliefs.joints["omega_n"])) / (2 * np.pi))


def _wish(description: Description, ground: _Ground) -> Wish:
    settings, names = description.settings, ground.beliefs.names
    asked = settings.wanted or ground.beliefs.law_names
    if not set(asked) & set(names):
        raise ConfigError(
            f"Key `wanted` must name parameters that are inferred, but has {', '.join(asked)}.",
            remedy=f"Choose among {', '.join(names)}.",
        )
    return Wish(
        wanted=tuple(name for name in names if name in asked),
        cv=settings.cv,
        max_repeats=settings.max_repeats,
        max_displacement=settings.max_displacement or np.inf,
        max_input=settings.max_input or np.inf,
        input_unit=ground.input_unit,
    )


@dataclass(frozen=True)
class Rig:
    """The rig that a run was measured on, as far as the run tells.

    Attributes:
        noise: Of the response; None where the run fitted no record in time.
        fs: Sampling frequency [Hz]; None where the run keeps no record.
        input_unit: Unit of the input; None where it is not told.
        y_peak: Largest displacement that was fitted [m]; None where it is not told.
        held: Parameters that were not inferred, such as a known gain.
    """

    noise: Noise | None
    fs: float | None
    input_unit: str | None
    y_peak: float | None
    held: Mapping[str, float]


def rig_of(tree: xr.DataTree) -> Rig:
    """What a run tells of its rig.

    Args:
        tree: The result, as `posterior.nc` holds it.
    """
    tests = list(_tests(tree))
    y_peak = float(tree.attrs.get("y_peak", 0.0))
    units = [str(test.attrs.get("level_unit", "")) for test in tests]
    seen = json.loads(str(tree.attrs.get("tests", "{}")))
    units += [str(facts.get("source", "")) for facts in seen.values()]
    rates = [
        1 / float(np.median(np.diff(test["time"])))
        for test in tests
        if test.sizes.get("time", 0) > 1
    ]
    return Rig(
        noise=_noise(tree["posterior"].to_dataset()),
        fs=float(f"{np.median(rates):.10g}") if rates else None,
        input_unit=next((unit for unit in units if unit in INPUT_UNITS), None),
        y_peak=y_peak if y_peak > 0 else None,
        held=json.loads(str(tree.attrs.get("held", "{}"))),
    )


def _tests(tree: xr.DataTree) -> Iterator[xr.Dataset]:
    if "verification" in tree.children:
        for node in tree["verification"].subtree:
            yield node.to_dataset()


def _noise(posterior: xr.Dataset) -> Noise | None:
    """Median over levels and draws of the noise of a sample.

    That of free decays, which were filtered, and that of harmonics are none of a sample.
    """
    for name, values in posterior.data_vars.items():
        response = RESPONSE_OF.get(in_dialect(str(values.attrs.get("units", ""))))
        sampled = str(values.dims[-1]).startswith("level")
        if str(name).startswith("noise_std") and sampled and response is not None:
            return Noise(float(values.median()), response)
    return None


def noise_of(given: Noise | None, rig: Rig) -> Noise:
    """The noise as given, else as the run tells it.

    Raises:
        ConfigError: Neither does.
    """
    noise = given or rig.noise
    if noise is None:
        raise ConfigError(
            "Key `noise` must be given beside this run, which fitted no record in time, "
            "but it is not.",
            why="Without the noise of a sample nothing can be said of a further record.",
            remedy="Write [plan] with noise and noise_unit into a file and add: --limits FILE",
        )
    return noise
