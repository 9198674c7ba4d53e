"""Every key of a plan file: its check and its meaning; and the example that `jbw plan` prints."""

from typing import Any

from jbw.campaign.keys import Key
from jbw.campaign.values import (
    a_whole_number,
    non_negative,
    number,
    positive,
    positive_list,
    rising_pair,
    some_of,
    text,
)
from jbw.units import FACTORS, quantity_of

Range = tuple[float, float]
PARAMETERS = ("omega_n", "zeta", "alpha", "delta", "gamma")
MOTIONS = ("displacement", "velocity", "acceleration")


def a_range(value: Any) -> Range:
    """A number that is not zero, or [lower, upper] of one sign."""
    if not isinstance(value, list):
        value = [value, value]
    elif len(value) != 2:
        raise ValueError(f"must be a number or [lower, upper], but is {value!r}.")
    low, high = number(value[0]), number(value[1])
    if not (low * high > 0 and low <= high):
        raise ValueError(
            f"must be a number other than 0, or [lower, upper] of one sign with lower < upper, "
            f"but is {value}; bound it away from zero."
        )
    return low, high


def a_positive_range(value: Any) -> Range:
    """A positive number, or [lower, upper] of such."""
    low, high = a_range(value)
    if low < 0:
        raise ValueError(f"must be positive, but is {value}.")
    return low, high


def a_share(value: Any) -> Range:
    """A positive range below one: the rest is the stiffness beside the joint."""
    low, high = a_positive_range(value)
    if high >= 1:
        raise ValueError(
            f"must lie between 0 and 1, a part of the stiffness, but reaches {high:g}."
        )
    return low, high


def a_motion_unit(value: Any) -> str:
    """A unit of displacement, velocity or acceleration."""
    quantity_of(text(value), MOTIONS)
    return value


def a_fraction(value: Any) -> float:
    """A number above 0 and below 1."""
    if not 0 < number(value) < 1:
        raise ValueError(f"must lie between 0 and 1, 0.05 for 5 %, but is {value}.")
    return float(value)


JOINT_KEYS = {
    "natural_hz": Key(a_positive_range, "natural frequency at small amplitude [Hz]"),
    "omega_n": Key(a_positive_range, "the same [rad/s], instead"),
    "zeta": Key(a_positive_range, "viscous damping ratio [-]"),
    "share": Key(a_share, "the joint's share of the stiffness, alpha / omega_n^2 [-]"),
    "alpha": Key(a_positive_range, "stiffness of the joint [1/s^2], instead"),
    "delta": Key(a_range, "softening [1/m]; the joint slides where it moves by 1/delta"),
    "gamma": Key(a_range, "opening of the loop [1/m]"),
}
PLAN = {
    **JOINT_KEYS,
    "gain": Key(a_positive_range, "force per modal mass for one volt [N/kg/V]"),
    "modal_mass": Key(a_positive_range, "[kg], where the input is a force in N"),
    "noise": Key(positive, "standard deviation of a sample of the response, in noise_unit"),
    "noise_unit": Key(a_motion_unit, "its unit, which says what is measured"),
    "fs": Key(positive, "sampling frequency [Hz]"),
    "wanted": Key(some_of(*PARAMETERS), "parameters to be known"),
    "cv": Key(a_fraction, "their wished coefficient of variation [-]"),
    "max_input": Key(positive, "largest input [V, N or N/kg]"),
    "max_displacement": Key(positive, "largest displacement [m]"),
    "max_repeats": Key(a_whole_number(1), "most repeats of a test"),
    "joints": Key(a_whole_number(2), "how many joints are drawn from the ranges"),
    "seed": Key(a_whole_number(0), "of the draws"),
}
LEVELS = Key(positive_list, "peaks of the input [V, N or N/kg]")
DWELL = Key(positive, "time on each frequency [s]")
SETTLE = Key(non_negative, "of that, the first part, which is discarded [s]")
SWEEP = {
    "levels": LEVELS,
    "span": Key(rising_pair, "first and last frequency [Hz]"),
    "rates": Key(positive_list, "sweep rates [Hz/s]"),
    "rest": Key(non_negative, "free decay recorded behind the burst [s]"),
}
TONES = {
    "levels": LEVELS,
    "frequencies": Key(positive_list, "tones, each alone [Hz]"),
    "dwell": DWELL,
    "settle": SETTLE,
}
STEPPED = {**TONES, "frequencies": Key(positive_list, "steps, in turn [Hz]")}
TABLES = {"plan": PLAN, "sweep": SWEEP, "tones": TONES, "stepped": STEPPED}


EXAMPLE = f"""\
# What is guessed of the joint before any test, what is wanted, what could be measured.
# A range [lower, upper] is where a value may lie; a single value is known to a factor of two
# (natural_hz to a tenth). Keys marked as defaults can be left out.

[plan]
natural_hz = [18.6, 19.0]     # at small amplitude [Hz]; a tap shows it
delta = [270.0, 410.0]        # softening [1/m]; the joint slides where it moves by 1/delta
noise = 50.0                  # standard deviation of a sample of the response
noise_unit = "um/s"           # default m/s; {", ".join(u for q in MOTIONS for u in FACTORS[q])}
zeta = [0.0035, 0.0055]       # viscous damping ratio [-]; default [0.002, 0.01]
share = [0.02, 0.06]          # of the stiffness, alpha / omega_n^2; default [0.01, 0.1]
gamma = [15.0, 60.0]          # opening of the loop [1/m]; default 0.05 to 0.3 of delta
gain = 15.0                   # [N/kg/V], or modal_mass [kg] for an input in N; without: N/kg
wanted = ["alpha", "delta", "gamma"]  # default
cv = 0.05                     # wished coefficient of variation; default 0.05
max_input = 1.0               # [V, N or N/kg]; default: no limit
max_displacement = 0.005      # [m]; default: no limit, and levels aim at 1/delta
# fs = 1024.0                 # default: a power of two, 40 samples a period or more [Hz]
# max_repeats = 1000          # default
# joints = 16                 # drawn from the ranges, default; every number is the worst of ten
# seed = 0                    # default

# Without any of the tables below all three kinds are tried, as the joint calls for.
[sweep]
# levels = [0.05, 0.1, 0.2]   # peaks of the input; default: to move by parts of max_displacement
# span = [9.4, 28.2]          # [Hz]; default 0.5 to 1.5 of the natural frequency
# rates = [1.8, 0.44]         # [Hz/s]; default: 200 and 800 periods in a sweep
# rest = 16.0                 # free decay recorded behind it [s]; default: to a thousandth

[tones]                       # steady, near a third of the natural frequency
# levels = [0.6]
# frequencies = [5.0, 5.5, 6.0, 6.5, 6.75]
# dwell = 20.0                # on each of them [s]
# settle = 16.0               # of which is discarded [s]

[stepped]                     # a stepped sine about the resonance, with the same keys
"""
