"""Messages of `jbw status`."""

import shlex
from collections.abc import Mapping, Sequence

MOST_NAMES = 8  # number of runs that a sentence names


def numbers(done: int, failed: int, left: int) -> str:
    """Return how many campaigns are identified, have failed, and are left to be identified."""
    campaigns = "campaign is" if done == 1 else "campaigns are"
    return f"{done} {campaigns} identified, {failed} failed, {left} left."


def verdicts(counts: Mapping[str, int]) -> str:
    """Return how many runs have each verdict."""
    listed = ", ".join(f"{verdict} {number}" for verdict, number in sorted(counts.items()))
    return f"Verdicts: {listed}."


def going_on(since: str, left: str | None) -> str:
    """Return when the last campaign ended, and how long the others take at the same rate."""
    rest = "" if left is None else f"; the campaigns that are left take about {left}"
    return f"The last change was {since} ago{rest}."


def repeat(command: str) -> str:
    """Return the command that continues the runs if its process has ended."""
    return f"If the command no longer runs, repeat it to continue: {command}"


def begun(names: Sequence[str]) -> str:
    """Return the names of runs that have begun and have no result."""
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return f"Begun, without a result yet: {', '.join(names[:MOST_NAMES])}{more}."


def of_the_fit(folder: str) -> str:
    """Return the message that a single run has the result of its fit, without posterior draws."""
    return (
        f"The run in {folder} has the result of its fit. To sample the posterior: jbw resume "
        f"{shlex.quote(folder)}"
    )


def interrupted(folder: str) -> str:
    """Return the message that a single run has no result yet."""
    return (
        f"The run in {folder} has no result yet. If its command no longer runs, continue it: jbw "
        f"resume {shlex.quote(folder)}"
    )


def no_runs(folder: str) -> tuple[str, str]:
    """Return the error and its remedy for a folder without runs."""
    what = f"The folder {folder} contains no runs of `jbw identify`."
    return what, "Name the folder that was given as --out; it is `runs` by default."
