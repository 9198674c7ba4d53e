"""The messages on a run's folder and its interruption."""

RESTORE = "Restore it, or begin a new run in another folder: jbw identify CAMPAIGN --out DIR."
REPEAT = "Free some space, and repeat the command: it goes on with the parts that are kept."
KEPT = "Its finished parts are kept: the same command goes on with them."


def going_on(parts: int) -> str:
    """Return the message that a command continues from finished parts of a killed process."""
    return f"Going on with {parts} finished parts of the same command"


def stopping(*, waits: bool) -> str:
    """Return the message after an interruption; `waits` if a chunk of draws is saved first."""
    when = " when this chunk of draws is saved" if waits else ""
    return f"Stopping{when}; again to leave at once."


def damaged_checkpoint(name: str, folder: str, *, has_earlier: bool) -> str:
    """Return the message that a checkpoint is damaged, and what is used instead."""
    then = "the one before it is used" if has_earlier else "its chains start again"
    return f"A checkpoint of {name} in {folder} is damaged: {then}."


def another_machine(before: str, processors_before: str, now: str, processors_now: str) -> str:
    """Return the message that a run goes on on another machine than it began on."""
    return (
        f"The run began on {before} ({processors_before} processors) and "
        f"continues on {now} ({processors_now}): its draws may differ in the last digits, and "
        "chains whose start differs begin again."
    )
