"""Faults of the clocks of drive and response: what, why and remedy."""

from jbw.report.messages.message import FaultText, number, percent


def lost_block(at_s: float, jump_s: float, keep: str) -> FaultText:
    """Return the message that the response's lag jumps [s]; the remedy keeps the part before."""
    ahead = "ahead of" if jump_s < 0 else "behind"
    return FaultText(
        f"At {at_s:.3g} s the response jumps by {abs(jump_s):.3g} s {ahead} the drive: one of the "
        "channels lost a block of samples.",
        "After the lost samples, response and drive belong to different times.",
        f"{keep}, or export the record again.",
    )


def another_clock(slope: float, change_s: float | None = None) -> FaultText:
    """Return the message that two clocks differ [s/s], with the resulting change of lag [s]."""
    fast = "fast" if slope > 0 else "slow"
    lag = "the lag between the two channels"
    change = "" if change_s is None else f": {lag} changes by {change_s:.2g} s along the record"
    return FaultText(
        f"The clock of the response runs {number(abs(1e6 * slope), '.2g')} ppm {fast} compared "
        f"with that of the drive{change}.",
        "With two clocks the phase drifts along the record, and a fit mistakes the drift for "
        "damping and stiffness.",
        f"Put under [[test]]: `clock_ppm = {1e6 * slope:.3g}`, which resamples the response, or "
        "record both channels with one clock.",
    )


def another_delay(lag_s: float, stated_s: float | None = None) -> FaultText:
    """Return the message that a response lags behind the drive [s], unlike the stated delay."""
    way = "lags behind" if lag_s > 0 else "leads"
    stated = "" if stated_s is None else f"; the campaign states a delay of {stated_s:g} s"
    return FaultText(
        f"The response {way} the drive by {abs(lag_s):.2g} s{stated}.",
        "A fit mistakes a lag for damping, and a lead for negative damping; the signal of an "
        "AC-coupled sensor leads.",
        f"Put under [[test]]: `delay = {lag_s:.3g}`, or correct the phase of the channels.",
    )


def drop_off(share: float, noise: float) -> FaultText:
    """Return the message that the drive drops at the resonance, with the noise-to-drive ratio."""
    return FaultText(
        f"At the resonance the drive falls to {share:.2g} times its usual level, and "
        f"{percent(noise, '.0f')} of the measured drive is then noise.",
        "A fit mistakes noise for a part of the drive, and finds too much damping.",
        "Measure the drive with a more sensitive sensor, or hold the level of the drive through "
        "the resonance.",
    )
