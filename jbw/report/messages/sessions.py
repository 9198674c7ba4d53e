"""Sessions and runs whose natural frequency and damping differ."""

from collections.abc import Mapping, Sequence

from jbw.report.messages.message import percent

OF_EACH_RUN = "Each run has offsets of omega_n and zeta of its own in the likelihood."
SHARED_DAMPING = (
    "Each level has its own omega_n in the likelihood. All share zeta, which no repeats of one "
    "level show to scatter: damping that changes with level is the law's to explain."
)


def differ(p: float, offsets_hz: Mapping[str, float], likelihood: str) -> str:
    """That natural frequencies differ between runs, their offsets [Hz], and the likelihood."""
    listed = ", ".join(f"{name} {offset:+.3g} Hz" for name, offset in offsets_hz.items())
    return (
        f"The natural frequency differs from run to run by more than chance (p = {p:.1g}): "
        f"{listed}. {likelihood}"
    )


def of_each_level(scatter: float) -> str:
    """That levels have natural frequencies of their own, and by how much zeta scatters."""
    return (
        "Each level has its own omega_n in the likelihood, and zeta scatters between levels by "
        f"{percent(scatter, '.1f')} of itself, as it does between repeats of one level."
    )


def scatter(hz: tuple[float, float, float], sessions: str) -> str:
    """A standard deviation with its interval [Hz], over runs or assemblies."""
    low, middle, high = hz
    return f"{middle:.2g} Hz [{low:.2g}, {high:.2g}] over {sessions}"


def population_mean(scatters: Sequence[str]) -> str:
    """That the posterior's natural frequency is a mean of a population, and its scatter."""
    return (
        "The natural frequency of the posterior is the population's mean; it scatters by "
        f"{' and '.join(scatters)} (standard deviation, 99 % interval)."
    )
