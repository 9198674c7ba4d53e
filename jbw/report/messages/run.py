"""Messages on a run's folder and its interruption."""

RESTORE = "Restore the file, or begin a new run in another folder: jbw identify CAMPAIGN --out DIR."
REPEAT = "Free some space and repeat the command; it continues with the saved parts."
KEPT = "The finished parts are saved; repeat the command to continue with them."


def going_on(parts: int) -> str:
    """Return the message that a command continues from partial results of an earlier process."""
    saved = "1 saved part" if parts == 1 else f"{parts} saved parts"
    return f"Continuing with {saved} of an earlier run of this command"


def stopping(*, waits: bool) -> str:
    """Return the message after an interruption; `waits` means that draws are saved first."""
    when = " as soon as this chunk of draws is saved" if waits else ""
    return f"Stopping{when}; interrupt again to stop at once."


def damaged_checkpoint(name: str, folder: str, *, has_earlier: bool) -> str:
    """Return the message that a checkpoint is damaged, and what is used instead."""
    then = "the previous checkpoint is used" if has_earlier else "its chains start again"
    return f"A checkpoint of {name} in {folder} is damaged: {then}."


def another_machine(before: str, processors_before: str, now: str, processors_now: str) -> str:
    """Return the message that a run continues on another machine."""
    return (
        f"The run began on {before} ({processors_before} processors) and continues on {now} "
        f"({processors_now} processors): its draws may differ in the last digits, and chains "
        "that would start differently begin again."
    )
