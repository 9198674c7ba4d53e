"""Titles of tables, notes on their columns, and remarks in their cells."""

from collections.abc import Sequence

from jbw.report.messages.message import listed

FROM_TRUTH = (
    "distance of the posterior mean from the true value in standard deviations, bold beyond 2.58"
)
KL = "information that the data add to the prior, in nats"
R_HAT = "R-hat: if it is above 1.01 (bold), the chains disagree"
TESTS = "Tests: fitted and held out"
HELD_OUT_BEFORE = "Tests that were held out from the earlier fit"
ACROSS_KINDS = "Each kind of test, predicted from the other kinds"
ROUTES = "Steps 2 to 4 of Teloli et al. and the joint posterior of all parameters"
LOOPS = "Areas of the hysteresis loops"
CYCLES = "Force loops, cycle by cycle"
MODES_IN_STICK = "Modes with fully stuck joints"
JOINTS = (
    "Each joint's share of the energy, losses and softening in every mode, at the mode's largest "
    "motion and in the mode shape at that motion"
)
WITHHELD = "withheld"  # cell of a test whose band is not shown
MATRIX_B = (
    "Matrix B: how far each joint softens each swept mode, each row divided by its largest value"
)

# headings of columns in two lines
ERROR = "RMS error /\nrms of the record"
OWN_FREQUENCY = "RMS error with the\nrecord's own frequency"
HALF_WIDTH = "half width of the band /\nrms of the record"
CUT_LESS_JOINT = "(cut - joint) /\njoint sd"
MODEL_AREA = "model [mJ/kg]\n99 % parameter band"
FIRST_OF_AMPLITUDE = "stiffness / stiffness of first\ncycle of equal amplitude"
SD_OVER_VALUE = "sd / value,\nby the fit"
SD_OVER_PRIOR = "sd / prior's,\nby the fit"
PROFILE_INTERVAL = "99 % interval\nof the profile"

SPECTRUM = "Information spectrum: combinations of parameters, best determined first"
COHERENCE = "lowest coherence of a test at the resonance"
COHERENCE_NOTE = "a coherence near 1 needs records without noise that last longer than the decay"
VARIATION_NOTE = (
    "variation between repeats; compare it with the standard deviations in the table of parameters"
)
HARMONIC = "largest third harmonic of the source"
HARMONIC_NOTE = "as a fraction of Y(3ω); the measured input is used to remove this harmonic"


def rests_on(parameters: Sequence[str]) -> str:
    """Return the remark on parameters that only one kind of test identifies."""
    return f"only the kind of test in this row identifies {listed(parameters)}"


def beyond(reach: float) -> str:
    """Return the remark on a test that exceeds the fitted displacement."""
    return f"the motion of the test is {reach:.2g} times the largest fitted displacement"


def laws(campaign: str) -> str:
    """Return the title of the table that compares laws."""
    return f"Laws of the joint: {campaign}"


def counted(count: int, noun: str) -> str:
    """Return a count with its noun in singular or plural."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
