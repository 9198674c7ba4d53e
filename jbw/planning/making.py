"""Plans: before any test from ranges, after a run from its posterior."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import xarray as xr

from jbw.errors import ConfigError
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.modes.parameters import NAMES
from jbw.planning.beliefs import Beliefs, after, before, modes_of
from jbw.planning.description import Description, read_description
from jbw.planning.judge import combine, covariance, expected, ordered, row
from jbw.planning.plan import MeasurementPlan, ResponseNoise, Wish
from jbw.planning.proposals import Reach, default_grids, displacement_for, propose, sampling_for
from jbw.planning.prospects import prospects
from jbw.quantities import UNIT_OF, in_dialect
from jbw.report.messages import planning

ADMITTED = ("ok", "too few")  # alone; together they may meet the wish
RESPONSE_OF = {unit: response for response, unit in UNIT_OF.items()}
INPUT_UNITS = ("V", "N", "N/kg")


def plan_tests(
    description: Description | str | Path | None = None,
    tree: xr.DataTree | None = None,
    *,
    report: Callable[[str], None] = lambda sentence: None,
) -> MeasurementPlan:
    """Plan tests of a joint: which level, rate, tones and repeats a wished CV takes.

    Args:
        description: What is guessed, wanted and possible, or its plan file; defaults beside a run,
            which tells the joint itself.
        tree: A run's result, as `posterior.nc` holds it; None before any test.
        report: Called with one sentence at every candidate.

    Raises:
        ConfigError: A plan file against the schema, neither a description nor a run, a run that
            does not tell the noise, which the description leaves out too, nothing wanted that is
            inferred, or a gain beside a run that inferred it.
        DataError: The run's posterior lacks a parameter of the joint.
    """
    if isinstance(description, str | Path):
        description = read_description(Path(description), of_run=tree is not None)
    description = description or Description({})
    settings, rig = description.settings, Rig()
    if tree is None:
        beliefs, noise, unit = _before(description)
        notes = [planning.drawn_from_ranges(beliefs.num_joints)]
    else:
        rig = rig_of(tree)
        beliefs, noise, unit = _after(description, rig, tree)
        notes = [planning.drawn_from_run(beliefs.num_joints)]
        notes += [planning.PER_KILOGRAM] if unit is None else []
    wish, aim = _wish(description, beliefs, unit or "N/kg"), settings.max_displacement or rig.y_peak
    if aim is None:
        aim = displacement_for(beliefs)
        notes += [] if tree is None else [planning.unknown_reach(aim)]
    natural_hz = max(float(np.median(mode.omega)) for mode in modes_of(beliefs.joints)) / (
        2 * np.pi
    )
    reach = Reach(settings.fs or rig.fs or sampling_for(natural_hz), aim, wish.max_input)
    grids = description.grids or default_grids(beliefs)
    predicted = prospects(propose(grids, beliefs, reach), beliefs, noise, report)
    rows = [row(prospect, beliefs, wish) for prospect in predicted]
    admitted = [
        prospect
        for prospect, judged in zip(predicted, rows, strict=True)
        if judged.status in ADMITTED
    ]
    prior_sd = np.sqrt(np.diag(covariance(beliefs.precision)))
    return MeasurementPlan(
        rows=ordered(rows),
        combination=combine(admitted, beliefs, wish),
        wish=wish,
        num_joints=beliefs.num_joints,
        before=expected(prior_sd[None], beliefs, wish),
        notes=(*notes, planning.NOISE_ALONE),
    )


def _before(description: Description) -> tuple[Beliefs, ResponseNoise, str | None]:
    """Beliefs from the description, noise, and unit of the input where it is told."""
    if not description.ranges or description.noise is None:
        raise ConfigError(
            "A plan needs a description of the joint and its noise, or a run, but has neither.",
            remedy=planning.WRITE_PLAN,
        )
    beliefs = before(
        description.ranges,
        held={} if "gain" in description.ranges else {"gain": description.gain or 1.0},
        num_joints=description.settings.joints,
        seed=description.settings.seed,
        laws=description.laws,
    )
    return beliefs, description.noise, description.input_unit


def _after(
    description: Description, rig: "Rig", tree: xr.DataTree
) -> tuple[Beliefs, ResponseNoise, str | None]:
    """Beliefs from a run, noise, and unit of the input where the gain is known."""
    inferred = "gain" in tree["posterior"].data_vars
    if inferred and description.gain is not None:
        raise ConfigError(
            "Keys `gain` and `modal_mass` must be left out beside this run, which inferred the "
            f"gain, but one gives {description.gain:g}.",
            remedy="Leave it out; levels are in the unit of the run's input.",
        )
    noise = description.noise or rig.noise
    if noise is None:
        raise ConfigError(
            "Key `noise` must be given beside this run, which fitted no record in time, "
            "but it is not.",
            why="Without the noise of a sample nothing can be said of a further record.",
            remedy="Write [plan] with noise and noise_unit into a file and add: --limits FILE",
        )
    held = {**rig.held, **({} if description.gain is None else {"gain": description.gain})}
    beliefs = after(tree, held={"gain": 1.0, **held}, num_joints=description.settings.joints)
    unit = description.input_unit or rig.input_unit or "input's unit"
    return beliefs, noise, unit if inferred or "gain" in held else None


def _wish(description: Description, beliefs: Beliefs, input_unit: str) -> Wish:
    settings, names = description.settings, beliefs.names
    sizes = {name for mode_names in NAMES for name in (mode_names.shape, mode_names.coupling)}
    usual = [quantity.name for quantity in quantities_of(beliefs.laws)]
    requested = settings.wanted or [*usual, *(name for name in names if name in sizes)]
    if not set(requested) & set(names):
        raise ConfigError(
            f"Key `wanted` must name parameters that are inferred, but has {', '.join(requested)}.",
            remedy=f"Choose among {', '.join(names)}.",
        )
    return Wish(
        wanted=tuple(name for name in names if name in requested),
        cv=settings.cv,
        max_repeats=settings.max_repeats,
        max_displacement=settings.max_displacement or np.inf,
        max_input=settings.max_input or np.inf,
        input_unit=input_unit,
    )


@dataclass(frozen=True)
class Rig:
    """The rig that a run was measured on; None where the run does not tell."""

    noise: ResponseNoise | None = None  # of a sample of the response
    fs: float | None = None  # [Hz]
    input_unit: str | None = None
    y_peak: float | None = None  # largest displacement that was fitted [m]
    # Parameters that were not inferred, such as a known gain.
    held: Mapping[str, float] = field(default_factory=dict)


def rig_of(tree: xr.DataTree) -> Rig:
    """What a run tells of its rig, from its result, as `posterior.nc` holds it."""
    verified = "verification" in tree.children
    tests = [node.to_dataset() for node in tree["verification"].subtree] if verified else []
    seen = json.loads(str(tree.attrs.get("tests", "{}")))
    units = [str(test.attrs.get("level_unit", "")) for test in tests]
    units += [str(facts.get("source", "")) for facts in seen.values()]
    rates = [
        1 / float(np.median(np.diff(test["time"])))
        for test in tests
        if test.sizes.get("time", 0) > 1
    ]
    y_peak = float(tree.attrs.get("y_peak", 0.0))
    return Rig(
        noise=_noise(tree["posterior"].to_dataset()),
        fs=float(f"{np.median(rates):.10g}") if rates else None,
        input_unit=next((unit for unit in units if unit in INPUT_UNITS), None),
        y_peak=y_peak if y_peak > 0 else None,
        held=json.loads(str(tree.attrs.get("held", "{}"))),
    )


def _noise(posterior: xr.Dataset) -> ResponseNoise | None:
    """Median over levels and draws of the noise of a sample."""
    # That of free decays, which were filtered, and that of harmonics are none of a sample.
    for name, values in posterior.data_vars.items():
        response = RESPONSE_OF.get(in_dialect(str(values.attrs.get("units", ""))))
        sampled = str(values.dims[-1]).startswith("level")
        if str(name).startswith("noise_std") and sampled and response is not None:
            return ResponseNoise(float(values.median()), response)
    return None
