"""The messages on identified quantities: directions, parameter grades, ties, profiles, starts."""

from collections.abc import Mapping, Sequence

from jbw.report.messages.message import listed, percent

GRADES = {
    "known": "Identified (coefficient of variation): {}.",
    "roughly": "Roughly identified: {}.",
    "hardly": "Poorly identified: {}.",
    "unknown": "Not identified beyond the prior: {}.",
}
STABLE = (
    "The prior bounds do not affect the result: bounds a tenth closer move no mean by 0.1 of its \
standard deviation."
)
ONE_START = "The fit had one start, which explained the data."


def directions(learnt: int, total: int) -> str:
    """Return the sentence on how many parameter directions the data constrain beyond the prior."""
    return (
        f"The data constrain {learnt} of {total} directions of the parameters more than the prior."
    )


def grade(kind: str, parameters: Sequence[str]) -> str:
    """Return the message on the parameters of one grade, each with its error."""
    return GRADES[kind].format(listed(parameters))


def with_error(name: str, value: float, sd: float, ratio: float) -> str:
    """Return a parameter with its coefficient of variation, or its error if that is above 1."""
    return f"{name} ({percent(ratio) if ratio < 1 else f'{value:.2g} +- {sd:.2g}'})"


def tie(product: str, times: float) -> str:
    """Return the message that a product is better identified than its factors."""
    size = f"{times:.0f}" if times >= 10 else f"{times:.2g}"
    return f"{product} is {size} times more certain than its factors, which trade off."


def undetermined(names: Sequence[str]) -> str:
    """Return the message on parameters that no data of a test determine."""
    return f"the data do not determine {listed(names)}"


def determined(combinations: Sequence[str], *, logs: bool) -> str:
    """Return the clause on products (or sums) that are determined while their factors are not."""
    noun = ("product" if logs else "combination") + ("s" if len(combinations) > 1 else "")
    verb = "are" if len(combinations) > 1 else "is"
    return f"only the {noun} {listed(combinations)} {verb} determined"


def follows_bound(name: str, shift: float, bound: str) -> str:
    """Return a parameter with the shift of its mean due to a bound, in standard deviations."""
    size = "beyond its draws" if shift == float("inf") else f"{shift:.2g} standard deviations"
    return f"{name} ({size}, {bound})"


def box_sensitivity(moves: Sequence[str]) -> str:
    """Return the message on means that follow the prior's bounds, or that none does."""
    if not moves:
        return STABLE
    return (
        f"The prior bounds affect the mean of {listed(moves)}: this is its shift for a bound a "
        f"tenth closer. State bounds that you can defend in [identify.prior], or measure with more "
        f"motion."
    )


def profile_interval(name: str, ends: Sequence[str]) -> str:
    """Return the message on both ends of the interval of a profile."""
    return f"The 99 % profile interval of {name} is {' to '.join(ends)}."


def profile_limit(name: str, limit: float, side: str) -> str:
    """Return the message on the one end that a profile has, "above" or "below"."""
    other = "below" if side == "above" else "above"
    return f"The profile of {name} bounds it {side} by {limit:.5g} at 99 %, and not {other}."


def profile_open(name: str, bounds: tuple[float, float], rise: float, *, flat: bool) -> str:
    """Return the message that the profile of a parameter has no end within the prior."""
    shape = "flat" if flat else "open on both sides"
    low, high = bounds
    return (
        f"The profile of {name} is {shape}: chi-square rises by {rise:.2g} at most between the "
        f"prior bounds {low:.4g} and {high:.4g}, because other parameters compensate."
    )


def profile_refused(name: str, count: int) -> str:
    """Return the message on how many points of a profile could not be solved."""
    return f"The profile of {name} is missing {count} points where the model cannot be solved."


def better_fit(gain: float) -> str:
    """Return the message that a profile found a better fit than the fit had."""
    return (
        f"The profiles found a better fit, chi-square lower by {gain:.3g}: the fit had not "
        "converged."
    )


def waterfall(total: int, near: int) -> str:
    """Return the message on how many starts of the fit found its optimum."""
    if total == 1:
        return ONE_START
    if near == 1:
        return (
            f"Only one of {total} starts of the fit reached the lowest cost: a lower one may exist."
        )
    return f"{near} of {total} starts of the fit ended within 1 % of the lowest cost."


def costs(shown: Sequence[str]) -> str:
    """Return the sentence on the final costs of the fit from all starts."""
    if len(set(shown)) == 1:
        return f"All {len(shown)} starts of the fit ended at a cost of {shown[0]}."
    return f"Costs from the starts of the fit, lowest first: {', '.join(shown)}."


COLUMNS: Mapping[str, str] = {
    "direction_text": "combination",
    "direction_information": "information over the prior's",
    "direction_ratio": "standard deviation over the prior's, by the fit",
    "loadings": "share of each parameter, in prior standard deviations",
    "cost": "cost reached from a start",
    "relative": "standard deviation over value, by the fit",
    "ratio": "standard deviation over the prior's, by the fit",
    "contraction": (
        "1 less the variance of the draws over the prior's, of logarithms of what is positive"
    ),
    "shift": (
        "largest move of the mean by a tenth less of the prior's range, in posterior standard "
        "deviations"
    ),
    "profile_value": "value held",
    "profile_chi_square": "rise of chi-square, the others free",
    "profile_interval": "99 % interval by the profile",
}
"""Variables of the group `identifiability` of posterior.nc."""

CONTRACTION = (
    "1 less the variance of the draws over the prior's, of logarithms where values are positive; "
    "100 % is identified, 0 % is the prior"
)
FOLLOWS = (
    "the largest move of the posterior mean when a tenth of the prior's range is cut off at either "
    "end; a parameter that is its prior moves by 0.17"
)
OF_THE_FIT = "The fit's numbers come from its derivatives and hold near it."
