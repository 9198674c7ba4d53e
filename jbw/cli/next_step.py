"""What to type after a failure, where the error itself does not say."""

import shlex
from collections.abc import Sequence

OF_CAMPAIGNS = ("identify", "identifiability", "compare", "predict")
OF_RUNS = ("report", "predict", "export", "compare", "plan", "resume")


def next_command(arguments: Sequence[str], told: str) -> str | None:
    """The command that brings the user on after an error.

    Args:
        arguments: The command line that failed, without the program's name.
        told: The error's text.

    Returns:
        One command; None where the text names one already.
    """
    if "jbw " in told or not arguments:
        return None
    command, rest = arguments[0], arguments[1:]
    campaign = next((word for word in rest if word.endswith(".toml")), None)
    if command == "check" and campaign:
        return f"jbw check {shlex.quote(campaign)}, after the change"
    if command in OF_CAMPAIGNS and campaign:
        return f"jbw check {shlex.quote(campaign)}"
    folder = next((word for word in rest if not word.startswith("-")), None)
    if command in OF_RUNS and folder:
        return f"jbw identify CAMPAIGN.toml --out {shlex.quote(folder)}"
    return f"jbw {command} --help"
