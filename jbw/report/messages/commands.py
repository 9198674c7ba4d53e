"""The messages that commands print in addition to their tables."""

from collections.abc import Sequence

from jbw.quantities import Quantity
from jbw.report.messages.message import capital

MISSING_FACTS = (
    "Please state the facts that the records do not contain, one by one. Enter keeps the value in "
    "brackets."
)
NO_NAME = "Parameters, columns and words are explained too, for example: jbw explain ESS"


def parameter_explained(quantity: Quantity, laws: Sequence[str]) -> str:
    """Return the meaning, symbol, unit and laws of a parameter."""
    unit = "" if quantity.unit == "1" else f" [{quantity.unit}]"
    of_laws = f" Parameter of the law {', '.join(laws)}." if laws else ""
    return f"{capital(quantity.meaning)}, {quantity.symbol}{unit}.{of_laws}"


def law_explained(summary: str, parameters: Sequence[str], law: str) -> str:
    """Return the meaning of a law, its parameters, and the campaign line that selects the law."""
    return (
        f"{summary}\nParameters: {', '.join(parameters)}.\n"
        f'In a campaign: [joint] laws = ["{law}"]. To compare laws: jbw laws.'
    )


def nothing_called(name: str, nearest: str) -> str:
    """Return the message that a name is unknown, with the most similar known name."""
    guess = f" Did you mean '{nearest}'?" if nearest else ""
    return f"There is no explanation of '{name}'.{guess} For a list of all findings: jbw explain"


SHORT = {
    "demo": "Run the demonstration: measure a virtual rig and identify its joint.",
    "init": "Write a commented campaign file for a folder of records.",
    "check": "Check a campaign, channel by channel.",
    "look": "Measure frequency and damping without a model of the joint, in a minute.",
    "identify": "Identify the joint; --quick makes only the fit, within seconds.",
    "resume": "Continue a run that was interrupted, or made by --quick.",
    "identifiability": "Show which parameters the data identify, before sampling.",
    "laws": "Compare how well laws of the joint describe the data.",
    "report": "Write the one-file report of a finished run.",
    "predict": "Predict measured or planned tests from a run.",
    "export": "Export a run's joint to other programs, or as an FMU.",
    "diff": "Compare runs of different assemblies, torques or days.",
    "plan": "Plan tests that determine the parameters to a given accuracy.",
    "status": "Show how far the runs of several campaigns are.",
    "collect": "Collect finished runs of several units into one fleet.",
    "population": "Show how the units of a fleet vary, and depend on torque.",
    "watch": "Monitor new records for a change of the joint.",
    "explain": "Explain a finding, parameter, column or word.",
    "docs": "Open the documentation, without a network.",
    "sbc": "Test on simulated data whether intervals contain the true value.",
    "compare": "Compare samplers on the posterior of one run.",
    "schema": "Print a file's JSON Schema, for editors.",
    "completion": "Print the script that completes commands in a shell.",
    "more": "List the other commands.",
}
"""The line of each command in `jbw --help` and `jbw more`."""
MORE = "For other commands, such as the demonstration: jbw more"

FAULT = "Please report this error. To see where it occurs, set JBW_TRACEBACK=1 and run again."
RUN_FOLDER = "CAMPAIGN-run, or `runs` for several campaigns"


def one_at_a_time(first: str, second: str) -> str:
    """Return the message that a command was given two campaigns."""
    return f"Name one campaign at a time, not both {first} and {second}."


def identifying(number: int) -> str:
    """Return the stage of the identification of several campaigns."""
    return f"Identifying {number} campaigns"


def no_command(name: str, nearest: str) -> str:
    """Return the message that a command does not exist, with the most similar command."""
    guess = f" Did you mean '{nearest}'?" if nearest else ""
    return f"No such command '{name}'.{guess}"


def identify_again(folder: str) -> str:
    """Return the remedy that names the command for identifying a run's campaign again."""
    return f"jbw identify CAMPAIGN.toml --out {folder}"


def saved(folder: str, quoted: str) -> str:
    """Return the message on how to continue an interrupted run."""
    return f"Saved in {folder}. To continue: jbw resume {quoted}"


def draw_posterior(folder: str) -> str:
    """Return the hint after a quick result: how to sample the posterior and write a report."""
    return f" samples the posterior; to write a report: jbw report {folder}"


def or_export(folder: str) -> str:
    """Return the hint after a good result: the command for exporting the joint."""
    return f", or to use the joint in other programs: jbw export {folder}"


def or_plan(folder: str) -> str:
    """Return the hint after a failed result: the command for planning further tests."""
    return f", or to plan further tests: jbw plan {folder}"


def finished(folder: str, page: str) -> str:
    """Return the message that a run is finished, and where its report is (`page`, if written)."""
    where = f": see {page}" if page else f"; to write its report: jbw report {folder}"
    return f"The run in folder `{folder}` is finished{where}."


def without_model(campaign: str) -> str:
    """Return the title of the table of frequency and damping without a model of the joint."""
    return f"Campaign {campaign}: frequency and damping, measured without a model of the joint"


def sampler_distances(reference: str) -> str:
    """Return the title of the table that compares samplers with a reference sampler."""
    return (
        f"Distances of the posterior means from those of sampler {reference}, in Monte Carlo "
        "standard errors"
    )


def condition_number(value: str) -> str:
    """Return the sentence on the condition number of the matrix B of the swept modes."""
    return (
        f"Condition number of the matrix B: {value}. If each joint has a separate law, noise is "
        "amplified by up to this factor."
    )


def two_numbers(value: str) -> str:
    """Return the message that the value of an option must be two frequencies."""
    return f"{value} must be two numbers in Hz with a colon, as in 10:25."
