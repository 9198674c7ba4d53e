"""Messages on predictions under other loads: content of bands, extrapolation, units, names."""

import re
from collections.abc import Iterator
from typing import Any

from jbw.report.messages.message import length, listed

DOWNWARD, OF_SPECTRUM = "downward sweep, 99 % band", "natural frequency, Q = 10"
PARAMETERS = "the uncertainty of the parameters"
HERTZ, NUMBER, METRE = {"units": "Hz"}, {"units": "1"}, {"units": "m"}


def sine(level: float, unit: str) -> str:
    """Return the words for a sine load at a level."""
    return f"A sine of {level:g} {unit}"


def limit(value: float, unit: str) -> str:
    """Return the words for a response that a notched sine keeps at a limit."""
    return f"A response held at {value:g} {unit}"


def random(rms: float, unit: str) -> str:
    """Return the words for a random load with its rms."""
    return f"A random profile of {rms:.3g} {unit} rms"


def shock(unit: str, pulse: Any) -> str:
    """Return the words for a shock with its peak and duration."""
    return f"A shock of {max(abs(pulse.samples)):.3g} {unit} over {1e3 * pulse.duration:.3g} ms"


def warnings_of(what: str, y: float, reach: float, most: float, why: str) -> Iterator[str]:
    """Yield warnings on a prediction under a load: extrapolation, and why a band is withheld."""
    if reach > most:
        yield (
            f"{what} moves the joint by {length(y)}, {reach:.2g} times the largest fitted "
            "displacement. No fitted test shows that the joint's law is valid at this "
            "displacement. Add a test of that level to the campaign and identify again."
        )
    if why:
        yield f"{what} has no 99 % band, because {why}. Fit a test of the same level."


def threshold_beyond(what: str, mechanism: str, y: float, rests: str) -> str:
    """Return the warning that a load begins a mechanism of the law that no fitted test reached."""
    return (
        f"{what} moves the joint beyond {length(y)}, where {mechanism} begins. No fitted test "
        f"reached this displacement, so that {rests} may follow from the prior alone. Add a test "
        "of that level to the campaign and identify again."
    )


ONE_DRAW = "one draw, `jax.tree.map(lambda x: x[0], study.joints())`"
WITH_ALL_MODES = f"Follow all branches and modes of {ONE_DRAW}, by `jbw.response_curve`."


def isolated(what: str, share: float) -> str:
    """Return the warning that response curves have a branch that is not connected to the rest."""
    return (
        f"{what} has a second branch of larger motion in {100 * share:.3g} % of the draws, which a "
        "slow sweep from rest does not reach but a shock may. The prediction follows the main "
        "branch. Stay below this level, or compute both branches by `jbw.steady_state`."
    )


def internal_resonance(what: str, own_hz: float, other_hz: float) -> str:
    """Return the warning that the harmonics of a mode's motion also move another mode."""
    return (
        f"{what} moves the mode at {own_hz:.4g} Hz, whose harmonics also move the mode at "
        f"{other_hz:.4g} Hz, near an odd multiple. The prediction balances all modes with 8 "
        f"harmonics and follows one branch. {WITH_ALL_MODES}"
    )


def units_of_resonance(unit: str, name: str) -> dict[str, dict[str, str]]:
    """Return the attributes (unit and long name) of the variables of a resonance."""
    return {
        "frequency": {**HERTZ, "long_name": "frequency of the peak"},
        "peak": {"units": unit, "long_name": f"peak {name}"},
        "displacement": {**METRE, "long_name": "peak displacement"},
        "quality": {**NUMBER, "long_name": "Q; not given where the response curve folds"},
        "half_power_width": {**HERTZ, "long_name": "half-power width"},
        "jump_up": {**HERTZ, "long_name": "frequency of the jump to the upper branch"},
        "jump_down": {**HERTZ, "long_name": "frequency of the jump to the lower branch"},
        "folds": {**NUMBER, "long_name": "share of draws whose response curve folds"},
        "reach": {**NUMBER, "long_name": "displacement / largest fitted displacement"},
        "withheld": {**NUMBER, "long_name": "band withheld: 1 if no band can be stated, else 0"},
    }


def units_of_random(unit: str, name: str) -> dict[str, dict[str, str]]:
    """Return the attributes (unit and long name) of the variables of a random response."""
    return {
        "rms": {"units": unit, "long_name": f"rms {name}"},
        "sine": {"units": unit, "long_name": f"amplitude of the {name} at the sine"},
        "displacement": {**METRE, "long_name": "rms displacement"},
        "largest_displacement": {**METRE, "long_name": "largest displacement"},
        "peak_factor": {**NUMBER, "long_name": "largest displacement / its rms"},
        "frequency": {**HERTZ, "long_name": "rate of upward crossings of zero"},
        "damping": {**NUMBER, "long_name": "equivalent damping ratio"},
        "psd": {"units": f"({unit})^2/Hz", "long_name": f"spectral density of the {name}"},
    }


LOADS_OR_TESTS = (
    "Predict other loads (--response, --psd, --shock) and tests (--campaign, --test, --sweep, "
    "--stepped, --tone) by separate commands."
)
BASE_NEEDS = "Option --base needs a load: --response, --psd or --shock."
RESPONSE_NEEDS = "Option --response needs --level, and --notch needs --response and --level."


SINE_NEEDS = "Option --sine needs --psd, the random vibration to which the sine is added."


def no_sine(text: str) -> str:
    """Return the message that a text is not a sine's frequency and amplitude."""
    return f"A sine must be one frequency [Hz] and one amplitude, such as 30:2g, not {text!r}."


def no_quantity(text: str) -> str:
    """Return the message that a text is no number with a unit."""
    return f"Each value must be a number with or without a unit, such as 0.1 or 2g, not {text!r}."


def bare_level(unit: str) -> str:
    """Return the message that the level of a planned test must not have a unit."""
    return (
        "State --level of a sweep, of steps or of a tone in the unit of the run's source, "
        f"not in {unit}."
    )


def in_bands(*, scatters: bool, misses: bool) -> str:
    """Return the list of uncertainties in the bands; `scatters` and `misses` add one each."""
    parts = [PARAMETERS]
    parts += ["the variation between runs"] if scatters else []
    parts += ["the model discrepancy"] if misses else []
    return f"{listed(parts)}, but no measurement noise"


def contains(
    band: str, num_draws: int, drive: str, participation: float = 1.0, shape: float = 1.0, **_: Any
) -> str:  # fmt: skip
    """Return the sentence on what the bands contain, and on the participation of a moving base."""
    said = f"The 99 % bands contain {band} ({num_draws} draws)."
    if drive != "base":
        return said
    return (
        f"{said} The mode has the participation factor {participation:.4g} and the "
        f"shape {shape:g}; to change them, use --participation and --shape."
    )


def in_report(run: str) -> str:
    """Return the message that the run's report can show these predictions."""
    return f"To show the prediction on the report's page: jbw report {run}"


def earlier_posterior(run: str) -> str:
    """Return the message that predictions were made with an earlier posterior of the run."""
    return (
        f"{run}/predictions contains predictions under other loads that were made with an "
        "earlier posterior of this run. Repeat these predictions with `jbw predict`."
    )


def unreadable_loads(run: str) -> str:
    """Return the message for saved predictions that cannot be read."""
    return (
        f"The predictions under other loads in {run}/predictions cannot be read. Repeat "
        "these predictions with `jbw predict`."
    )


def heading(name: str) -> str:
    """Return the heading of a prediction's figure."""
    return f"{name[:1].upper()}{name[1:]}."


def slug_of(name: str) -> str:
    """Return the file name of a prediction, without suffix."""
    return re.sub(r"[^\w.-]+", "_", name)
