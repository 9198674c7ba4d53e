"""The messages that the commands print in addition to their tables."""

from collections.abc import Sequence

from jbw.quantities import Quantity
from jbw.report.messages.message import capital

MISSING_FACTS = (
    "Facts that the records do not state, line by line; Enter keeps the value in brackets."
)
NO_NAME = "It explains parameters, columns and words too, such as: jbw explain ESS"


def parameter_explained(quantity: Quantity, laws: Sequence[str]) -> str:
    """Return the meaning, symbol, unit and laws of a parameter."""
    unit = "" if quantity.unit == "1" else f" [{quantity.unit}]"
    of_laws = f" Parameter of the law {', '.join(laws)}." if laws else ""
    return f"{capital(quantity.meaning)}, {quantity.symbol}{unit}.{of_laws}"


def nothing_called(name: str, nearest: str) -> str:
    """Return the message that a name is not explained, with the nearest that is."""
    guess = f" Did you mean '{nearest}'?" if nearest else ""
    return f"Nothing is called '{name}'.{guess} All findings: jbw explain"


SHORT = {
    "demo": "Measure the virtual rig and identify it, start to finish.",
    "init": "Write a commented campaign file for a folder of records.",
    "check": "Check a campaign, channel by channel.",
    "look": "Say what the records show without any model, in a minute.",
    "identify": "Identify the joint; --quick ends with the fit, in seconds.",
    "resume": "Continue a run that was killed, interrupted or quick.",
    "identifiability": "Say which parameters the data identify, before sampling.",
    "laws": "Compare laws of the joint and say which the data distinguish.",
    "report": "Write the one-file report of a finished run.",
    "predict": "Predict tests from a run, measured or planned.",
    "export": "Write a run's joint for other programs, FMUs among them.",
    "diff": "Compare runs: assemblies, torques, days.",
    "plan": "Say which tests reach a given accuracy.",
    "collect": "Collect finished runs of several units in one fleet.",
    "population": "Say how the units of a fleet scatter, and depend on torque.",
    "watch": "Say of every further record whether the joint has changed.",
    "explain": "Explain a finding, parameter, column or word.",
    "docs": "Open the documentation, without a network.",
    "sbc": "Calibrate a step by simulation: ranks of simulated truths.",
    "compare": "Compare samplers on one posterior of a run.",
    "schema": "Print a file's JSON Schema, for editors.",
    "completion": "Print what completes jbw in a shell.",
    "more": "List the other commands.",
}
"""The line of each command in `jbw --help` and `jbw more`."""
MORE = "Other commands, the demonstration among them: jbw more"

FAULT = "Set JBW_TRACEBACK=1 and run again to see where; please report it."
RUN_FOLDER = "CAMPAIGN-run, or runs for several,"


def one_at_a_time(first: str, second: str) -> str:
    """Return the message that a command was given two campaigns."""
    return f"One campaign at a time: {first} and {second} are two."


def no_command(name: str, nearest: str) -> str:
    """Return the message that a command is misspelt, with the nearest one."""
    guess = f" Did you mean '{nearest}'?" if nearest else ""
    return f"No such command '{name}'.{guess}"


def identify_again(folder: str) -> str:
    """Return the message on the command that makes a run's folder."""
    return f"jbw identify CAMPAIGN.toml --out {folder}"


def saved(folder: str, quoted: str) -> str:
    """Return the message on how to continue an interrupted run."""
    return f"Saved in {folder}; continue: jbw resume {quoted}"


def draw_posterior(folder: str) -> str:
    """Return the hint after a quick answer: how to draw the posterior and write a report."""
    return f" draws the posterior; a page: jbw report {folder}"


def or_export(folder: str) -> str:
    """Return the message on what else a good result is for."""
    return f", or for other programs: jbw export {folder}"


def or_plan(folder: str) -> str:
    """Return the message on what else may be done after a result that fails."""
    return f", or what to measure: jbw plan {folder}"


def finished(folder: str, page: str) -> str:
    """Return the message that a run is finished, and where its report is (`page`, if written)."""
    where = f"see {page}" if page else f"only its report is missing, jbw report {folder}"
    return f"The run in {folder} is finished: {where}."


def without_model(campaign: str) -> str:
    """Return the title of the table of readings that need no model of the joint."""
    return f"Campaign {campaign}, read without a model of the joint"


def sampler_distances(reference: str) -> str:
    """Return the title of the table that compares samplers with a reference sampler."""
    return f"Distances in Monte Carlo standard errors from {reference}"


def condition_number(value: str) -> str:
    """Return the sentence on the condition number of the matrix B of the swept modes."""
    return (
        f"Condition number of B: {value}. It multiplies the noise where each joint has a law of "
        "its own."
    )


def two_numbers(value: str) -> str:
    """Return the message that a range of frequencies is misspelt."""
    return f"{value} must be two numbers in Hz with a colon, as in 10:25."
