"""Messages on how well quantities are identified: combinations, grades, profiles, starts."""

from collections.abc import Mapping, Sequence

from jbw.report.messages.message import listed, percent

GRADES = {
    "known": "Identified (coefficient of variation): {}.",
    "roughly": "Roughly identified: {}.",
    "hardly": "Poorly identified: {}.",
    "unknown": "Not identified by the data, only limited by the prior: {}.",
}
STABLE = (
    "The prior bounds do not affect the result: if a tenth of the prior's range is cut off, every "
    "mean moves by less than 0.1 of its standard deviation."
)
ONE_START = "The fit was started from one point, and its result explains the data."


def directions(learnt: int, total: int) -> str:
    """Return the sentence on how many combinations of parameters the data constrain."""
    return (
        f"The data constrain {learnt} of {total} combinations of the parameters more tightly than "
        "the prior does."
    )


def grade(kind: str, parameters: Sequence[str]) -> str:
    """Return the sentence on parameters of one grade of accuracy, with the error of each."""
    return GRADES[kind].format(listed(parameters))


def with_error(name: str, value: float, sd: float, ratio: float) -> str:
    """Return a parameter with its relative error, or with value and error if this exceeds 1."""
    return f"{name} ({percent(ratio) if ratio < 1 else f'{value:.2g} +- {sd:.2g}'})"


def tie(product: str, times: float) -> str:
    """Return the sentence that a product of parameters is better identified than the factors."""
    size = f"{times:.0f}" if times >= 10 else f"{times:.2g}"
    return (
        f"{product} is {size} times more certain than each of its factors, because errors of the "
        "factors compensate each other."
    )


def undetermined(names: Sequence[str]) -> str:
    """Return the clause on parameters that the data do not determine."""
    return f"the data do not determine {listed(names)}"


def determined(combinations: Sequence[str], *, logs: bool) -> str:
    """Return the clause on products (or sums) that are determined while their factors are not."""
    noun = ("product" if logs else "combination") + ("s" if len(combinations) > 1 else "")
    verb = "are" if len(combinations) > 1 else "is"
    return f"only the {noun} {listed(combinations)} {verb} determined"


def follows_bound(name: str, shift: float, bound: str) -> str:
    """Return a parameter with the shift of its mean by a prior bound, in standard deviations."""
    size = (
        "further than any posterior draw"
        if shift == float("inf")
        else f"by {shift:.2g} standard deviations"
    )
    return f"{name} ({size}, {bound})"


def box_sensitivity(moves: Sequence[str]) -> str:
    """Return the sentence on posterior means that depend on prior bounds, if there are any."""
    if not moves:
        return STABLE
    return (
        "The prior bounds affect the result: if a tenth of the prior's range is cut off at a "
        f"bound, these means move: {listed(moves)}. State bounds that you can justify in "
        "[identify.prior], or measure at larger motion."
    )


def profile_interval(name: str, ends: Sequence[str]) -> str:
    """Return the sentence on a parameter's profile interval with both ends."""
    return f"The 99 % interval of {name} by its profile likelihood is {' to '.join(ends)}."


def profile_limit(name: str, limit: float, side: str) -> str:
    """Return the sentence on a profile interval with one end, "above" or "below" a value."""
    other = "below" if side == "above" else "above"
    return (
        f"The profile likelihood limits {name} from {side}, at {limit:.5g} (99 %), but not from "
        f"{other}."
    )


def profile_open(name: str, bounds: tuple[float, float], rise: float, *, flat: bool) -> str:
    """Return the sentence that a parameter's profile interval has no end within the prior."""
    shape = "flat" if flat else "open on both sides"
    low, high = bounds
    return (
        f"The profile likelihood of {name} is {shape}: between the prior bounds, {low:.4g} and "
        f"{high:.4g}, chi-square rises by at most {rise:.2g}, because other parameters compensate."
    )


def profile_refused(name: str, count: int) -> str:
    """Return the sentence on points of a profile at which the model could not be solved."""
    points = "1 point" if count == 1 else f"{count} points"
    return (
        f"The profile likelihood of {name} lacks {points}, at which the model could not be solved: "
        f"narrow the prior of {name}, or raise `substeps`."
    )


def better_fit(gain: float) -> str:
    """Return the sentence that a profile found a better optimum than the fit."""
    return (
        "The fit had not converged: the profile likelihoods contain a better fit, whose "
        f"chi-square is lower by {gain:.3g}."
    )


def waterfall(total: int, near: int) -> str:
    """Return the sentence on how many starts of the fit reached the optimum."""
    if total == 1:
        return ONE_START
    if near == 1:
        return (
            f"Only 1 of {total} starts of the fit reached the lowest cost. A better fit may exist: "
            "identify again with another `seed`."
        )
    number = f"All {total}" if near == total else f"{near} of {total}"
    return f"{number} starts of the fit ended within 1 % of the lowest cost."


def costs(shown: Sequence[str]) -> str:
    """Return the sentence on the final costs of the fit from all starts."""
    if len(set(shown)) == 1:
        number = {1: "The only start", 2: "Both starts"}.get(len(shown), f"All {len(shown)} starts")
        return f"{number} of the fit ended at a cost of {shown[0]}."
    failed = " (none: the fit failed)" if "none" in shown else ""
    return f"Final costs of the fit from its starts, lowest first{failed}: {', '.join(shown)}."


COLUMNS: Mapping[str, str] = {
    "direction_text": "combination",
    "direction_information": "inverse variance of the posterior / that of the prior",
    "direction_ratio": "posterior standard deviation / that of the prior, from the fit",
    "loadings": "share of each parameter in the combination, in prior standard deviations",
    "cost": "lowest cost that the fit reached from a start",
    "relative": "standard deviation / value, from the fit",
    "ratio": "posterior standard deviation / that of the prior, from the fit",
    "contraction": (
        "1 minus posterior variance / prior variance, in logarithms of positive parameters"
    ),
    "shift": (
        "largest move of the mean when a tenth of the prior's range is cut off, in posterior "
        "standard deviations"
    ),
    "profile_value": "fixed value",
    "profile_chi_square": "rise of chi-square when the other parameters are fitted",
    "profile_interval": "99 % interval from the profile likelihood",
}
"""Variables of the group `identifiability` of posterior.nc."""

CONTRACTION = (
    "1 minus posterior variance / prior variance, in logarithms of positive "
    "parameters; 100 %: identified by the data, 0 %: unchanged from the prior"
)
FOLLOWS = (
    "largest move of the posterior mean, in standard deviations, when a tenth of the prior's "
    "range is cut off at either end; the mean of a parameter that the data do not constrain "
    "moves by 0.17"
)
OF_THE_FIT = "The numbers from the fit follow from its derivatives and are valid near its optimum."
