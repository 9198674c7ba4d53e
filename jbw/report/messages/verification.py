"""Messages on tests compared with predictions: coverage of bands, limits of predictions."""

from jbw.report.messages.message import length, percent

EVERY_TEST = "Comparison of every test with the model, and with oscillators without hysteresis"
WITHOUT_HYSTERESIS = "The fit of the oscillators without hysteresis"
FREE_DECAYS = "Comparison of free decays: frequency and damping against amplitude"
DECAYS_COMPARED = "The comparison of the free decays with the model"
DECAY_CURVES = "The frequency and damping of the free decays against amplitude"
STIFFNESS = "stiffness of the restoring force Z without slip"
MISSED = "sd of the law's error"
SLIP = "restoring force Z minus its value without slip"
FORCE_PHASE = "phase by which the force leads the displacement"
SOURCE_UNIT = "unit of the run's source"
ERROR_ALONE = (
    "noise not known: the band contains the uncertainty of the parameters and the model discrepancy"
)
OWN = "noise of this test, as fitted"
ALIKE = "median of the fitted tests of the test's kind"
REPEATS = "variation between the test's repeats"
UNKNOWN = "noise not known: the band contains only the uncertainty of the parameters"
LEFT_OUT = "noise left out, as requested: the band contains only the uncertainty of the parameters"


def comparison_of(test: str, quantity: str) -> str:
    """Return the subject of a sentence that explains why a comparison is missing."""
    return f"The comparison of the {quantity}test `{test}` with the model"


def extrapolated(test: str, y: float, ratio: float, fitted: float) -> str:
    """Return the warning that a prediction extends beyond the fitted displacements [m]."""
    return (
        f"Test `{test}` is predicted to reach {length(y)}, {ratio:.2g} times the largest fitted "
        f"displacement ({length(fitted)}). No fitted test shows that the joint follows the law "
        "there: the bands may be far too narrow. Add a test of that level to the campaign and "
        "identify again."
    )


def away_from_mode(test: str, share: float) -> str:
    """Return the warning that a test hardly drives the identified mode."""
    return (
        f"Only {percent(share)} of the input power of test `{test}` lies within 25 % of the "
        "natural frequency. The test hardly moves the identified mode, and other modes may "
        "dominate its response. Choose a test with a frequency range around the mode."
    )


def without_terms(test: str, terms: str) -> str:
    """Return the warning on residual terms that a prediction of a new unit omits."""
    return (
        f"Test `{test}` is predicted without {terms}, which differ between the units of the "
        "population. Its bands do not include the response of other modes."
    )
