"""Numbers that remedies suggest for a campaign file: draws, prior bounds, samplers."""

from collections.abc import Iterable
from math import ceil, floor, log10
from typing import Any

from jbw.report.messages.remedies import put

Bounds = tuple[float, float]

# largest factor by which more draws are suggested; beyond it, another sampler is suggested
MOST = 20.0
# distance of a new bound from the smallest value, as a fraction of the old bound's distance
NEARER = 0.1
NUM_WARMUP = 500  # number of warm-up steps suggested for a sampler without a stated number


def other_sampler(now: str = "") -> str:
    """Return the name of another sampler that may succeed where one has failed."""
    return "tempered_smc" if now == "nuts" else "nuts"


def more_draws(num_samples: int, least: float, target: float, sampler: str = "") -> dict[str, Any]:
    """Return the number of draws per chain that gives a required effective sample size.

    The count is None if that were more than twenty times as many, because such chains hardly move;
    then another sampler is suggested.
    """
    times = target / least if least > 0 else float("inf")
    count = None
    if times <= MOST:
        step = 10 ** max(floor(log10(num_samples)) - 1, 0)
        count = step * ceil(max(times, 1.5) * num_samples / step)
    return {"num_samples": count, "sampler": other_sampler(sampler)}


def wider(bounds: Bounds, sides: Iterable[str], least: float | None = None) -> Bounds:
    """Return bounds with twice the range, widened on given sides; positive bounds stay positive."""
    low, high = bounds
    span = high - low
    end = 0.0 if least is None and low > 0.0 else least
    if "lower" in sides:
        lower_end = low - span
        low = lower_end if end is None else max(lower_end, end + NEARER * (low - end))
    return low, high + span if "upper" in sides else high


def put_bounds(name: str, bounds: Bounds) -> str:
    """Return the prior's line of a campaign file, with bounds rounded outwards to three digits."""
    low, high = bounds
    digits = 2 - floor(log10(high - low))
    scale = 10.0**digits
    ends = floor(low * scale) / scale, ceil(high * scale) / scale
    least = ends[0] if ends[0] > 0 or low <= 0 else low
    return put("identify.prior", name, [float(f"{end:.12g}") for end in (least, ends[1])])
