"""The messages on the fit of a kind of test: its mode, its residual, its scatter."""

from jbw.report.messages.message import percent

COMPILING = "compile what sweeps are solved by"


def with_shaker(drive: str, loaded: str, predicted: str, unloaded: str) -> str:
    """Return the sentence on frequency and damping with a shaker (also predicted), and without."""
    return (
        f"Driven by {drive} the mode lies at {loaded}, predicted {predicted} by the shaker; the "
        f"structure alone at {unloaded}."
    )


def frequencies_scatter(count: int, scatter: float) -> str:
    """Return the sentence on the standard deviation of natural frequency between records [Hz]."""
    return (
        f"The natural frequencies of the {count} records scatter by {scatter:.2g} Hz, which the "
        "interval of omega_n includes."
    )


def correlated(share: float, count: int) -> str:
    """Return the message on the share of values that count as independent."""
    return (
        f"Residuals are correlated: {percent(share, '.0f')} of the {count} values of a record "
        "are counted as independent."
    )


def left_of_motion(errors: str) -> str:
    """Return the message on residuals by mode, over their rms."""
    return f"Residual of the free decays at the optimum, over their rms: {errors}."


def moves_joint(mode: int, hz: float, h: float, p: float) -> str:
    """Return the sentence on a mode's joint motion h and share p of its force, at the optimum."""
    return (
        f"Mode {mode}, at {hz:.4g} Hz, moves the joint by h = {h:.3g} and takes p = {p:.3g} of its "
        "force at the optimum, relative to the first mode."
    )


def sign_of_motion(growth: float, *, is_clear: bool) -> str:
    """Return the sentence on whether the fit determines the sign of h, with chi-square."""
    if is_clear:
        return f"The other sign of h fits worse, chi-square by {growth:.3g}."
    return f"The other sign of h fits as well, chi-square differs by {growth:.2g}: it is not known."


def too_deep(label: str, count: int) -> str:
    """Return the message on how often the force of nested loops may have been a guess."""
    return (
        f"{label}: the motion nests more loops than the law remembers; {count} times its force may "
        "be approximate until a larger loop closes."
    )
