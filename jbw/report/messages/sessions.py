"""Messages on sessions and runs whose natural frequency and damping differ."""

from collections.abc import Mapping, Sequence

from jbw.report.messages.message import percent

OF_EACH_RUN = "In the likelihood each run has separate offsets of omega_n and zeta."
SHARED_DAMPING = (
    "In the likelihood each level has a separate omega_n, but all levels share zeta, because "
    "no repeats of one level show that zeta varies. The law must explain damping that changes "
    "with level."
)


def differ(p: float, offsets_hz: Mapping[str, float], likelihood: str) -> str:
    """Return the sentence that natural frequency differs between runs, with p and offsets [Hz]."""
    listed = ", ".join(f"{name} {offset:+.3g} Hz" for name, offset in offsets_hz.items())
    return (
        f"The natural frequency differs from run to run by more than chance (p = {p:.1g}): "
        f"{listed}. {likelihood}"
    )


def of_each_level(scatter: float) -> str:
    """Return the sentence on natural frequency at each level, and zeta's variation with level."""
    return (
        "In the likelihood each level has a separate omega_n, and zeta varies between levels "
        f"by {percent(scatter, '.1f')} of its value, as it does between repeats of one level."
    )


def scatter(hz: tuple[float, float, float], sessions: str) -> str:
    """Return a standard deviation between runs or assemblies with its interval [Hz], as text."""
    low, middle, high = hz
    return f"{middle:.2g} Hz [{low:.2g}, {high:.2g}] over {sessions}"


def population_mean(scatters: Sequence[str]) -> str:
    """Return the sentence that the natural frequency is a mean over sessions, with its sd."""
    return (
        "The natural frequency of the posterior is the mean over the population; the natural "
        f"frequencies vary around it by {' and '.join(scatters)} (standard deviation [99 % "
        "interval])."
    )
