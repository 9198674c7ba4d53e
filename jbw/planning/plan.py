"""From candidates to a plan: repeats for the wished CV, one row a test, and a combination."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from jbw.inference.identifiability import weak_direction
from jbw.planning.beliefs import Beliefs
from jbw.planning.information import (
    Matrices,
    covariance,
    information_gain,
    modes,
    repeats_needed,
    spread,
    worst_decile,
)
from jbw.planning.prospects import Prospect

STATUSES = ("ok", "too few", "not predicted", "not feasible")


@dataclass(frozen=True)
class Wish:
    """What is wanted, and the limits.

    Attributes:
        wanted: Parameters to be known.
        cv: Their wished coefficient of variation [-].
        max_repeats: Most repeats of one test.
        max_displacement: Largest displacement admitted [m].
        max_input: Largest input admitted [V, N or N/kg].
        input_unit: Unit of levels: V, N or N/kg.
    """

    wanted: tuple[str, ...]
    cv: float
    max_repeats: int = 1000
    max_displacement: float = np.inf
    max_input: float = np.inf
    input_unit: str = "N/kg"


@dataclass(frozen=True)
class Expected:
    """Coefficient of variation of a parameter over the joints held possible [-].

    Attributes:
        median: At half of the joints or more.
        worst_decile: At nine joints in ten or more; the wish is judged by it.
    """

    median: float
    worst_decile: float


@dataclass(frozen=True)
class Row:
    """One candidate.

    Attributes:
        test: The test in words.
        level: Peak of the input [V, N or N/kg].
        y_peak: Predicted peak displacement [m], median over joints.
        y_peak_largest: The largest over joints [m].
        repeats: Repeats that the wish takes; None where no admitted number suffices.
        seconds_each: Measuring time of one repeat [s].
        seconds: Measuring time of all repeats [s]; None without a number of repeats.
        cv: Expected spread after these repeats, or after the most admitted, by parameter.
        information_gain: Expected of one repeat, mean over joints [nats].
        status: "ok"; "too few", where no admitted number of repeats suffices; "not feasible",
            where a joint exceeds the largest displacement or input; or "not predicted", where no
            response was found at some joint.
        notes: What stands against the test, or stays undetermined, in words.
    """

    test: str
    level: float
    y_peak: float
    y_peak_largest: float
    repeats: int | None
    seconds_each: float
    seconds: float | None
    cv: dict[str, Expected]
    information_gain: float
    status: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Chosen:
    """A test of a combination.

    Attributes:
        test: The test in words.
        level: Peak of the input [V, N or N/kg].
        repeats: How many.
    """

    test: str
    level: float
    repeats: int


@dataclass(frozen=True)
class Combination:
    """Tests to make together.

    Attributes:
        tests: The tests.
        seconds: Measuring time [s].
        cv: Expected spread after all of them.
        met: Whether the wish is met.
        notes: What stays undetermined, in words.
    """

    tests: tuple[Chosen, ...]
    seconds: float
    cv: dict[str, Expected]
    met: bool
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """Candidates by measuring time, those that meet the wish within the limits first.

    Attributes:
        rows: The candidates.
        combination: Tests that meet the wish together.
        wish: What was asked.
        num_joints: Joints that every number was made at.
        before: Expected spread before any of these tests, by parameter.
        notes: What was assumed.
    """

    rows: tuple[Row, ...]
    combination: Combination
    wish: Wish
    num_joints: int
    before: dict[str, Expected]
    notes: tuple[str, ...] = field(default=())


def row(prospect: Prospect, beliefs: Beliefs, wish: Wish) -> Row:
    """A candidate judged: repeats, spread, gain and limits.

    Args:
        prospect: The candidate at every joint.
        beliefs: What is known before it.
        wish: What is wanted.
    """
    candidate, information = prospect.candidate, prospect.information
    wanted = [beliefs.names.index(name) for name in wish.wanted]
    found = modes(beliefs.precision, information)
    repeats = repeats_needed(found, wanted, wish.cv, wish.max_repeats)
    made = repeats or wish.max_repeats
    known = np.isfinite(prospect.y_peak)
    largest = float(np.max(prospect.y_peak[known], initial=0.0)) if known.any() else float("nan")
    exceeded = _exceeded(candidate.level, largest, wish)
    lost = (
        [f"no response found at {prospect.num_lost} of {len(known)} joints"]
        if prospect.num_lost
        else []
    )
    weak = undetermined(beliefs, beliefs.precision + made * information, wanted)
    return Row(
        test=str(candidate),
        level=candidate.level,
        y_peak=float(np.median(prospect.y_peak[known])) if known.any() else float("nan"),
        y_peak_largest=largest,
        repeats=repeats,
        seconds_each=candidate.seconds,
        seconds=None if repeats is None else repeats * candidate.seconds,
        cv=expected(spread(found, made), beliefs, wish),
        information_gain=float(np.mean(information_gain(beliefs.precision, information))),
        status=_status(exceeded, lost, repeats),
        notes=(*exceeded, *lost, *([] if weak is None else [weak])),
    )


def _exceeded(level: float, y_peak: float, wish: Wish) -> list[str]:
    """The limits that a test would break."""
    told = []
    if y_peak > wish.max_displacement:
        told.append(f"peak displacement {y_peak:.3g} m exceeds {wish.max_displacement:g} m")
    if level > wish.max_input:
        told.append(f"input exceeds {wish.max_input:g} {wish.input_unit}")
    return told


def _status(exceeded: list[str], lost: list[str], repeats: int | None) -> str:
    if exceeded:
        return "not feasible"
    if lost:
        return "not predicted"
    return "too few" if repeats is None else "ok"


def expected(
    spreads: Float[np.ndarray, "joint parameter"], beliefs: Beliefs, wish: Wish
) -> dict[str, Expected]:
    """Median and worst decile over joints of the spread of the wanted parameters."""
    worst, middle = worst_decile(spreads), np.median(spreads, axis=0)
    return {
        name: Expected(float(middle[i]), float(worst[i]))
        for i, name in enumerate(beliefs.names)
        if name in wish.wanted
    }


def undetermined(beliefs: Beliefs, precision: Matrices, wanted: Sequence[int]) -> str | None:
    """Which combination of parameters is all that the tests determine; None where all are.

    Told at the joint whose wanted parameters are known as well as at half of the joints.

    Args:
        beliefs: The joints, and the box that the tests are measured against.
        precision: Information after the tests, joint by joint.
        wanted: Positions of the wanted parameters.
    """
    left = covariance(precision)
    poorest = np.max(np.diagonal(left, axis1=1, axis2=2)[:, list(wanted)], axis=1)
    i = int(np.argsort(poorest)[len(poorest) // 2])
    mean = {name: float(beliefs.joints[name][i]) for name in beliefs.names}
    units = np.outer(beliefs.scale[i], beliefs.scale[i])
    found = weak_direction(mean, units * left[i], beliefs.box)
    return None if found is None else found.text


def ordered(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Rows by status, then by measuring time, then by what they tell."""

    def place(one: Row) -> tuple[int, float, float]:
        seconds = one.seconds_each * (one.repeats or 1)
        return STATUSES.index(one.status), seconds, -one.information_gain

    return tuple(sorted(rows, key=place))
