"""Messages on the fit to a kind of test: its mode, its residual, variation of records."""

from jbw.report.messages.message import percent

COMPILING = "compile the simulation of sweeps"


def with_shaker(drive: str, loaded: str, predicted: str, unloaded: str) -> str:
    """Return the sentence on frequency and damping with the shaker and without the shaker."""
    return (
        f"With the shaker, driven by {drive}, the mode has {loaded}; the properties of the shaker "
        f"predict {predicted}. Without the shaker it has {unloaded}."
    )


def frequencies_scatter(count: int, scatter: float) -> str:
    """Return the sentence on how much natural frequencies vary between records [Hz]."""
    return (
        f"The natural frequencies of the {count} records vary by {scatter:.2g} Hz (standard "
        "deviation), which the interval of omega_n includes."
    )


def correlated(share: float) -> str:
    """Return the sentence on the fraction of residual values that count as independent."""
    return (
        f"The residuals are correlated; therefore only {percent(share, '.0f')} of the values of a "
        "record count as independent."
    )


def left_of_motion(errors: str) -> str:
    """Return the sentence on each mode's residual, relative to its motion."""
    return (
        "RMS residual of the free decays at the best fit, divided by the rms of their motion: "
        f"{errors}."
    )


def moves_joint(mode: int, hz: float, h: float, p: float) -> str:
    """Return the sentence on the joint's motion h in a mode and its force p on the mode."""
    return (
        f"At the optimum, mode {mode} ({hz:.4g} Hz) moves the joint h = {h:.3g} times as much as "
        f"the first mode does, and the joint's force acts p = {p:.3g} times as strongly on mode "
        f"{mode} as on the first mode."
    )


def sign_of_motion(growth: float, *, is_clear: bool) -> str:
    """Return the sentence on whether the fit determines the sign of h, with chi-square."""
    if is_clear:
        return f"The sign of h is determined: the other sign raises chi-square by {growth:.3g}."
    return (
        f"The sign of h is not determined: the other sign changes chi-square by only {growth:.2g}."
    )


def too_deep(label: str, count: int) -> str:
    """Return the sentence on how often the force of nested loops may be approximate."""
    return (
        f"{label}: the motion has more nested loops than the law can remember. The force may be "
        f"approximate {count} times, each time until a larger loop closes."
    )
