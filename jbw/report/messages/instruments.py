"""Messages on attached shakers, and on stated errors of clocks and sensors."""

from collections.abc import Sequence

from jbw.report.messages.message import percent

NOT_INCLUDED = (
    "`fs_std` and `gain_std` are not included: the tests have responses or sources of several "
    "kinds, and no single parameter is scaled by their calibrations. Identify the tests of each "
    "kind in a separate campaign."
)
LEFT_OUT = (
    "Intervals exclude the errors of the recorder's clock and of its sensors' calibration, "
    "which no record shows: state them by `fs_std` and `gain_std` under [campaign] to include them."
)
BESIDE_MATRICES = (
    "Intervals exclude the errors of the recorder's clock and of its sensors' calibration, "
    "which no record shows, and the errors of the model's mode shapes."
)


def with_shaker(drive: str) -> str:
    """Return the sentence that omega_n and zeta include the mass of a shaker's armature."""
    return (
        f"Every test is driven by {drive}, so that omega_n and zeta are those of the structure "
        "together with the armature of its shaker."
    )


def mode_with_shaker(drive: str, loaded: str, unloaded: str) -> str:
    """Return the sentence on frequency and damping with a shaker and without."""
    return (
        f"With the shaker, driven by {drive}, the mode has {loaded}; without the shaker it has "
        f"{unloaded}."
    )


def attachment(test: str, share: float, added: float, *, at_drive_point: bool) -> str:
    """Return the sentence on how a shaker's attachment changes the mode, and its added mass."""
    doubled = (
        " (doubled, because the drive point is measured by the response channel)"
        if at_drive_point
        else ""
    )
    return (
        f"The attachment of the shaker was determined from test `{test}`. The effect of the "
        "attachment on omega_n and zeta is predicted, with a standard deviation of "
        f"{percent(share, '.0f')} of this effect{doubled}. The attachment changes the modal "
        f"mass by {percent(added, '+.2f')}. The joint's share of the stiffness changes by as much; "
        "this change is neglected."
    )


def heavy(limit: float) -> str:
    """Return the remedy for a shaker that adds too much to the modal mass."""
    return (
        f"A shaker that adds more than {percent(limit, '.0f')} of the modal mass matters: fit "
        "the tests of each drive separately, or move the shaker to where the mode moves less."
    )


def mode_moves(before: tuple[float, float], after: tuple[float, float]) -> str:
    """Return frequency [Hz] and damping ratio of a mode as text, without and with a shaker."""
    modes = (f"{hz:.4g} Hz ({percent(zeta, '.2f')})" for hz, zeta in (before, after))
    return " to ".join(modes)


def shaker_reading(
    name: str,
    gain: float,
    attachment: tuple[float, float, float],
    residual: tuple[float, float],
    moved: str,
) -> str:
    """Return the sentence on an identified shaker: its gain, its delay and its attachment.

    Its gain [N/V], the attachment's mass [kg], damping [N s/m] and stiffness [N/m], the residual
    of the force with and without the attachment, and how the modes move.
    """
    mass, damping, stiffness = attachment
    with_attachment, by_gain = (percent(share, ".1f") for share in residual)
    return (
        f"{name}: the shaker gives {gain:.4g} N/V and is attached by {mass:.3g} kg, "
        f"{damping:.3g} N s/m and {stiffness:.4g} N/m; the residual is {with_attachment} of the "
        f"force ({by_gain} with its gain alone). When the structure is driven by voltage, its "
        f"modes move from {moved}."
    )


def of_clock(error: float) -> str:
    """Return the clause on the relative error of the clock."""
    return f"the clock ({error:.2g})"


def included(errors: Sequence[str], missing: Sequence[str]) -> str:
    """Return the sentence that says which instrument errors the intervals include."""
    listed = ", ".join(errors) or "none"
    not_stated = f"; not stated: {', '.join(missing)}" if missing else ""
    return (
        f"Stated errors that the intervals include: {listed}{not_stated}. Bands of predictions are "
        "for measurements with the same instruments."
    )
