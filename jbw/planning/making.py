"""Plans of tests: from ranges before any test, from the posterior after a run.

Candidate tests are compared by the expected information of one repeat and by the number of repeats
that reaches the wanted coefficient of variation (CV); then tests are combined. Parameters enter as
relative changes, so that standard deviations are CVs.
"""

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.linalg import eigh

from jbw.errors import ConfigError
from jbw.inference.fit.identifiability import weak_direction
from jbw.inference.posterior.summary import posterior_draws
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.modes.parameters import NAMES
from jbw.parts import Parts, unkept
from jbw.planning.beliefs import Beliefs, after, before, modes_of
from jbw.planning.description import Description, read_description
from jbw.planning.plan import (
    CandidateRow,
    Chosen,
    Combination,
    Expected,
    MeasurementPlan,
    ResponseNoise,
    Wish,
)
from jbw.planning.proposals import Reach, default_grids, displacement_for, propose, sampling_for
from jbw.planning.prospects import Prospect, prospects
from jbw.quantities import UNIT_OF, in_dialect
from jbw.report.messages import planning
from jbw.results.attributes import DrawnPosterior, PredictedTest, StoredVariable

ADMITTED = ("ok", "too few")  # statuses that candidate tests of a combination may have
RESPONSE_OF = {unit: response for response, unit in UNIT_OF.items()}
INPUT_UNITS = ("V", "N", "N/kg")
STATUSES = ("ok", "too few", "not predicted", "not feasible")
Matrices = Float[np.ndarray, "... parameter parameter"]


def plan_tests(
    description: Description | str | Path | None = None,
    tree: xr.DataTree | None = None,
    *,
    report: Callable[[str], None] = lambda sentence: None,
    parts: Parts = unkept,
) -> MeasurementPlan:
    """Plan tests of a joint: level, rate, tones and repeats that give the wanted accuracy (CV).

    Args:
        description: Guesses, wishes and limits, or their plan file; if a run is given, which
            describes the joint, None for defaults.
        tree: A run's result, as in `posterior.nc`; None before any test.
        report: Function that is called with one sentence at every candidate.
        parts: Storage of every candidate's prospect, so that an interrupted plan continues.

    Raises:
        ConfigError: The plan file is invalid, there is neither a description nor a run, neither of
            them states the noise, no wanted parameter is inferred, or a gain is given although the
            run inferred it.
        DataError: The run's posterior lacks a parameter of the joint.

    Examples:
        Plan the repeats that determine alpha, delta and gamma to 10 %:

        >>> import jbw; jbw.enable_x64()
        >>> from pathlib import Path
        >>> size = Path("plan.toml").write_text('''
        ... [plan]
        ... natural_hz = 18.8
        ... delta = [270.0, 410.0]
        ... noise = 5e-5
        ... gain = 15.0
        ... cv = 0.1
        ... joints = 2
        ... [tones]
        ... levels = [0.6]
        ... frequencies = [5.5, 6.5]
        ... ''')
        >>> (row,) = jbw.plan_tests("plan.toml").rows
        >>> print(row.test, row.repeats, row.status)
        tones 5.5 6.5 Hz, 19 s each 357 ok
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
    predicted = prospects(propose(grids, beliefs, reach), beliefs, noise, report, parts)
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
    """Return drawn joints, noise and the input's unit from a plan file alone."""
    if not description.ranges or description.noise is None:
        raise ConfigError(
            "A plan needs a description of the joint and its noise, or a run, but neither is "
            "given.",
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
    """Return drawn joints, noise and the input's unit from a run and a plan file."""
    inferred = "gain" in tree["posterior"].data_vars
    if inferred and description.gain is not None:
        raise ConfigError(
            "Keys `gain` and `modal_mass` must be left out for this run, which inferred the "
            f"gain, but one of them gives {description.gain:g}.",
            remedy="Leave `gain` and `modal_mass` out; levels are in the unit of the run's input.",
        )
    noise = description.noise or rig.noise
    if noise is None:
        raise ConfigError(
            "Key `noise` must be given for this run, which fitted no record over time.",
            why="Without the noise of a sample, a new record cannot be predicted.",
            remedy="Write a file with [plan], noise and noise_unit, and add: --limits FILE",
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
    """The test rig of a run; values that the run does not state are None."""

    noise: ResponseNoise | None = None  # noise of the response
    fs: float | None = None  # sampling frequency [Hz]
    input_unit: str | None = None
    y_peak: float | None = None  # largest fitted displacement [m]
    # values of parameters that were not inferred, such as a known gain
    held: Mapping[str, float] = field(default_factory=dict)


def rig_of(tree: xr.DataTree) -> Rig:
    """Return a run's rig from its result, as stored in `posterior.nc`."""
    verified = "verification" in tree.children
    tests = [node.to_dataset() for node in tree["verification"].subtree] if verified else []
    stored = DrawnPosterior.of(tree)
    units = [PredictedTest.of(test).level_unit for test in tests]
    units += [str(facts.get("source", "")) for facts in stored.tests.values()]
    rates = [
        1 / float(np.median(np.diff(test["time"])))
        for test in tests
        if test.sizes.get("time", 0) > 1
    ]
    return Rig(
        noise=_noise(posterior_draws(tree)),
        fs=float(f"{np.median(rates):.10g}") if rates else None,
        input_unit=next((unit for unit in units if unit in INPUT_UNITS), None),
        y_peak=stored.y_peak or None,
        held=stored.held,
    )


def _noise(posterior: xr.Dataset) -> ResponseNoise | None:
    """Return the noise of one sample, the median over levels and draws; None if unknown."""
    # Omit the noise of free decays (which are filtered) and of harmonics, because it is not the
    # noise of one sample.
    for name, values in posterior.data_vars.items():
        response = RESPONSE_OF.get(in_dialect(StoredVariable.of(values).units))
        sampled = str(values.dims[-1]).startswith("level")
        if str(name).startswith("noise_std") and sampled and response is not None:
            return ResponseNoise(float(values.median()), response)
    return None


# Information f_k along each eigenvector, relative to the prior's information, and the prior
# variance w_ik^2 of the parameters along this eigenvector.
InformationModes = tuple[Float[np.ndarray, "joint mode"], Float[np.ndarray, "joint parameter mode"]]


def modes(precision: Matrices, information: Matrices) -> InformationModes:
    """Return information f_k and prior variances w_ik^2 along the eigenvectors of F w = f P w.

    The modes make the prior P and the information F of one repeat diagonal.
    """
    values, vectors = zip(
        *(eigh(fisher_matrix, precision) for fisher_matrix in information), strict=True
    )
    return np.maximum(values, 0.0), np.square(vectors)


def spread(eigenmodes: InformationModes, repeats: float) -> Float[np.ndarray, "joint parameter"]:
    """Return coefficients of variation after R repeats, CV_i^2 = sum_k w_ik^2 / (1 + R f_k)."""
    values, shares = eigenmodes
    return np.sqrt(np.sum(shares / (1.0 + repeats * values[..., None, :]), axis=-1))


def covariance(precision: Matrices) -> Matrices:
    """Return the inverse of an information matrix; parameters are scaled for accuracy."""
    scale = 1 / np.sqrt(np.diagonal(precision, axis1=-2, axis2=-1))
    both = scale[..., :, None] * scale[..., None, :]
    return both * np.linalg.inv(both * precision)


def worst_decile(values: Float[np.ndarray, " joint *n"]) -> Float[np.ndarray, "*n"]:
    """Return the value that nine out of ten joints do not exceed."""
    return np.quantile(values, 0.9, axis=0, method="inverted_cdf")


def repeats_needed(
    eigenmodes: InformationModes, positions: list[int], cv: float, most: int
) -> int | None:
    """Return the fewest repeats that give the CV for nine joints in ten; None if above `most`."""

    def enough(repeats: int) -> bool:
        return bool(np.all(worst_decile(spread(eigenmodes, repeats))[positions] <= cv))

    # Bisection finds the number, because the CV decreases with every repeat.
    repeats = 1 + bisect_left(range(1, most + 1), True, key=enough)
    return repeats if repeats <= most else None


def information_gain(
    precision: Matrices, information: Matrices, positions: Sequence[int] | None = None
) -> Float[np.ndarray, "*joint"]:
    r"""Return the information gain that a test is expected to give, for a near-Gaussian posterior.

    $$I_w = \tfrac12 \left(\log\det \Sigma_{ww} - \log\det \Sigma'_{ww}\right), \qquad
      \Sigma = P^{-1}, \quad \Sigma' = (P + F)^{-1}$$

    P is the existing information, F that of the test. The gain [nats] concerns the parameters at
    the `positions`, with the others unknown; all parameters if None.
    """
    chosen = list(range(precision.shape[-1]) if positions is None else positions)
    before, after = (
        np.linalg.slogdet(covariance(p)[..., chosen, :][..., chosen])[1]
        for p in (precision, precision + information)
    )
    return 0.5 * (before - after)


def row(prospect: Prospect, beliefs: Beliefs, wish: Wish) -> CandidateRow:
    """Return a candidate test's row in the plan: repeats, accuracy, information."""
    candidate, information = prospect.candidate, prospect.information
    positions = [beliefs.names.index(name) for name in wish.wanted]
    eigenmodes = modes(beliefs.precision, information)
    repeats = repeats_needed(eigenmodes, positions, wish.cv, wish.max_repeats)
    planned_repeats = repeats or wish.max_repeats
    y_peak = prospect.y_peak[np.isfinite(prospect.y_peak)]
    y_peak = y_peak if y_peak.size else np.array([np.nan])
    largest = float(np.max(y_peak))
    exceeded, lost = [], []
    status = "too few" if repeats is None else "ok"
    if largest > wish.max_displacement:
        exceeded.append(planning.too_far(largest, wish.max_displacement))
    if candidate.level > wish.max_input:
        exceeded.append(planning.too_strong(wish.max_input, wish.input_unit))
    if prospect.num_lost:
        lost = [planning.no_response(prospect.num_lost, beliefs.num_joints)]
        status = "not predicted"
    if exceeded:
        status = "not feasible"
    return CandidateRow(
        test=str(candidate),
        level=candidate.level,
        y_peak=float(np.median(y_peak)),
        y_peak_largest=largest,
        repeats=repeats,
        seconds_each=candidate.seconds,
        seconds=None if repeats is None else repeats * candidate.seconds,
        cv=expected(spread(eigenmodes, planned_repeats), beliefs, wish),
        information_gain=float(np.mean(information_gain(beliefs.precision, information))),
        status=status,
        notes=(
            *exceeded,
            *lost,
            *_undetermined(beliefs, beliefs.precision + planned_repeats * information, positions),
        ),
    )


def expected(
    spreads: Float[np.ndarray, "joint parameter"], beliefs: Beliefs, wish: Wish
) -> dict[str, Expected]:
    """Return each wanted parameter's expected CV: its median and ninth decile over the joints."""
    worst, middle = worst_decile(spreads), np.median(spreads, axis=0)
    return {
        name: Expected(float(middle[i]), float(worst[i]))
        for i, name in enumerate(beliefs.names)
        if name in wish.wanted
    }


def _undetermined(
    beliefs: Beliefs, precision: Matrices, positions: Sequence[int]
) -> tuple[str, ...]:
    """Return a sentence on parameters that the tests determine only in combination, if any."""
    # Use the joint for which the accuracy of the wanted parameters is the median of all joints.
    remaining = covariance(precision)
    poorest = np.max(np.diagonal(remaining, axis1=1, axis2=2)[:, list(positions)], axis=1)
    i = int(np.argsort(poorest)[len(poorest) // 2])
    mean = {name: float(beliefs.joints[name][i]) for name in beliefs.names}
    units = np.outer(beliefs.scale[i], beliefs.scale[i])
    direction = weak_direction(mean, units * remaining[i], beliefs.box)
    return () if direction is None else (direction.text,)


def ordered(rows: Sequence[CandidateRow]) -> tuple[CandidateRow, ...]:
    """Return the rows sorted by status, then by measuring time, then by information."""

    def place(candidate: CandidateRow) -> tuple[int, float, float]:
        seconds = candidate.seconds_each * (candidate.repeats or 1)
        return STATUSES.index(candidate.status), seconds, -candidate.information_gain

    return tuple(sorted(rows, key=place))


def combine(prospects: Sequence[Prospect], beliefs: Beliefs, wish: Wish) -> Combination:
    """Return a combination of tests that reaches the wanted accuracy; add repeats one by one."""
    # Each step adds the repeat with the largest information gain on the wanted parameters per
    # second of measurement, averaged over the joints. At the end, unnecessary repeats are removed,
    # the longest first.
    positions = [beliefs.names.index(name) for name in wish.wanted]
    seconds = np.array([prospect.candidate.seconds for prospect in prospects])
    counts = np.zeros(len(prospects), int)
    start = np.broadcast_to(beliefs.precision, (beliefs.num_joints, *beliefs.precision.shape))

    def precision_after(counts: np.ndarray) -> Matrices:
        return start + sum(n * p.information for n, p in zip(counts, prospects, strict=True))

    def spread_of(counts: np.ndarray) -> Float[np.ndarray, "joint parameter"]:
        return np.sqrt(np.diagonal(covariance(precision_after(counts)), axis1=-2, axis2=-1))

    def met(counts: np.ndarray) -> bool:
        return bool(np.all(worst_decile(spread_of(counts))[positions] <= wish.cv))

    while prospects and counts.sum() < wish.max_repeats and not met(counts):
        precision = precision_after(counts)
        gains = [np.mean(information_gain(precision, p.information, positions)) for p in prospects]
        counts[int(np.argmax(gains / seconds))] += 1
    is_met = met(counts)
    for i in np.argsort(-seconds, kind="stable") if is_met else ():
        fewer = counts - (np.arange(len(counts)) == i)
        while counts[i] and met(fewer):
            counts, fewer = fewer, fewer - (np.arange(len(counts)) == i)
    return Combination(
        tests=tuple(
            Chosen(str(p.candidate), p.candidate.level, int(n))
            for n, p in zip(counts, prospects, strict=True)
            if n
        ),
        seconds=float(counts @ seconds),
        cv=expected(spread_of(counts), beliefs, wish),
        met=is_met,
        notes=_undetermined(beliefs, precision_after(counts), positions),
    )
