"""Messages on several units of one joint: variation, trends with torque, reliability."""

from collections.abc import Mapping, Sequence

from jbw.report.messages.message import listed, percent

Interval = Mapping[str, float]
"""`median`, `q005` and `q995`."""


def interval(row: Interval) -> str:
    """Return a median with its 99 % interval as text."""
    return f"{row['median']:.2g} [{row['q005']:.2g}, {row['q995']:.2g}]"


def mostly_prior(num_units: int, free: int, *, trend: bool) -> str:
    """Return the message that the prior dominates the variation between units or about a trend."""
    about = f"about a trend ({free} degrees of freedom)" if trend else "between units"
    return f"{num_units} units do not determine the variation {about}: the prior dominates it."


def wide_intervals(num_units: int, free: int) -> str:
    """Return the message that intervals are wide because few degrees of freedom remain."""
    return (
        f"With {num_units} units there are only {free} degrees of freedom, so that the "
        "intervals are wide."
    )


def not_converged(r_hat: float, divergences: int) -> str:
    """Return the message that no number of the population may be used."""
    return (
        f"The sampler did not converge (R-hat {r_hat:.3f}, {divergences} divergences): do not use "
        "these results."
    )


def failed_runs(failed: Sequence[str], num_units: int) -> str:
    """Return the message that some pooled units come from runs that failed."""
    return (
        f"The population includes {len(failed)} of {num_units} units whose runs failed: "
        f"{listed(failed)}. Repair these runs (jbw explain), or remove them."
    )


def confounded(correlation: float) -> str:
    """Return the message that torque and order of tightening changed together."""
    way = "rose together" if correlation > 0 else "changed in opposite directions"
    return (
        f"Torque and tightening number {way} (correlation {correlation:.2f}): the data "
        "determine only the combined effect of both, and the prior divides it between them."
    )


def no_logarithm(name: str, units: Sequence[str]) -> str:
    """Return the message that a parameter is not pooled because some units lack positive values."""
    return (
        f"{name} is unknown or not positive in {listed(units)}. It is therefore not part of the "
        "population, and every unit keeps the prior of its own run for this parameter."
    )


def trend(name: str, slope: Interval, *, rises: bool) -> str:
    """Return the sentence on a parameter that changes with torque."""
    way = "rises" if rises else "falls"
    return f"{name} {way} with torque to the power {interval(slope)}."


def ratio_trend(name: str, slope: Interval, *, depends: bool) -> str:
    """Return the sentence on whether a ratio of parameters changes with torque."""
    answer = "it depends on torque" if depends else "no dependence on torque is detected"
    return f"The exponent of torque in {name} is {interval(slope)}: {answer}."


def scatter(rows: Sequence[tuple[str, float, float]]) -> str:
    """Return the sentence on standard deviations between sessions of a unit and between units."""
    parts = (
        f"{name} varies by {percent(sessions)} between sessions of a unit and by {percent(units)} "
        "between units"
        for name, sessions, units in rows
    )
    return f"Standard deviations: {'; '.join(parts)}."


def outliers(units: Sequence[str]) -> str:
    """Return the message on units that do not fit the population."""
    return f"These units do not belong to the population: {', '.join(units)}."


def weighed(count: int, num_units: int, least: float) -> str:
    """Return the sentence on the number of units that reweighted draws represent."""
    return (
        f"{count} of {num_units} units are represented by reweighted draws of their posterior; "
        f"the effective sample size is at least {percent(least, '.0f')} of the draws."
    )


def approximated(units: Sequence[str]) -> str:
    """Return the sentence on units that a normal approximation represents."""
    return f"The posterior of {listed(units)} is represented by a normal approximation."


def weak(names: Sequence[str], times: float) -> str:
    """Return the message on parameters whose pooling relies on normal posteriors of the units."""
    return (
        f"For {listed(names)} the error of a single unit is more than {times:g} times the "
        "variation between units: the result depends on the normal approximation of the unit's "
        "posterior."
    )


def saturates(names: Sequence[str], torque: Interval) -> str:
    """Return the sentence on parameters for which the user requested saturation with torque."""
    return (
        f"{listed(names)} follows a curve that saturates with torque, as the input requests; "
        f"the saturation torque is {interval(torque)} N m. Only very different torques "
        "distinguish this curve from a power law."
    )


def wrench(name: str, error: float, added: float, attenuation: float) -> str:
    """Return the sentence on how the wrench's error affects the powers of torque."""
    return (
        f"If a wrench sets the torque with an error of {percent(error, '.0f')}, the exponents "
        f"are unbiased, and {name} varies by {percent(added)} because of the wrench. If the "
        "torque is measured with that error, every exponent is about "
        f"{percent(attenuation, '.1g')} too small."
    )


def scatter_stage(num_units: int) -> str:
    """Return the progress message of the first stage: variation between units."""
    return f"Population of {num_units} units: variation between units"


def sampling_stage(num_units: int, num_weighed: int) -> str:
    """Return the progress message of the second stage: sampling of the population."""
    return f"Population of {num_units} units, {num_weighed} of them represented by draws: NUTS"


def without_stage(number: int, total: int) -> str:
    """Return the progress message of the check whether a unit belongs to the population."""
    return f"Fit of the population without a doubtful unit: {number} of {total}"


def one_stage(num_units: int, num_samples: int) -> str:
    """Return the progress message for the joint posterior of all units."""
    return f"All records of {num_units} units at once: NUTS, one chain of {num_samples} samples"


WRITE_FLEET = "Write the fleet file with this version of jbw: jbw collect RUNS --out fleet.nc."
NEW_UNIT = "Frequency and damping of a new unit"
BAND = "interval with 99 % of new units"
EVERY_UNIT = "Every unit: median [99 % interval]"


def heading(num_units: int) -> str:
    """Return the heading of the page of a fleet."""
    return f"{num_units} units identified by jbw, and their population."


def caption(*, trend: bool) -> str:
    """Return the caption of the figure on the page of a fleet."""
    against = " against torque" if trend else ""
    return (
        f"Every unit{against} with its 99 % interval, and the band that contains 99 % of new "
        "units. A square marks a unit that does not belong to the population."
    )


def table_title(num_units: int) -> str:
    """Return the title of the table of a population."""
    return f"Population of {num_units} units: median [99 % interval]"
