"""The texts of the brief, a summary on one page for decision makers."""

USE = {
    "ok": "The numbers on this page can be used.",
    "usable": "The numbers on this page can be used together with the stated model discrepancy.",
    "failed": "Do not use the numbers on this page.",
}
PROVISIONAL = "The numbers are provisional: some checks could not be made."
MODES = "Modes at small motion, with the joint fully stuck"
MEASURED = "Measured frequency and damping, found without a model of the joint"
FOOT = (
    "Intervals: 99 %. Model error: largest RMS residual of a record, divided by the record's "
    "rms. All details: report.html."
)


def heading(day: str, law: str, version: str) -> str:
    """Return the line below the title of the brief: date, law and version of jbw."""
    return f"Bolted joint, brief of {day}. Model: {law}. jbw {version}."


def levels(*, several_modes: bool) -> str:
    """Return the title of the table of frequency and damping against amplitude."""
    of_mode = " of the first mode" if several_modes else ""
    return f"Frequency and damping{of_mode} against amplitude, with 99 % intervals"


def more_findings(count: int) -> str:
    """Return the line that counts the findings for which the page has no space."""
    return f"{count} more findings are in report.html."


def more_lines(count: int) -> str:
    """Return the line that counts the rows of a table for which the page has no space."""
    return f"and {count} more lines: see report.html"
