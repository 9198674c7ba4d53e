"""Remedies of findings, as the line to put into the campaign file, with its number."""

import json
from collections.abc import Iterable
from math import ceil, floor, log10
from typing import Any

Bounds = tuple[float, float]

MOST = 20.0  # times the draws: where more would be needed, another sampler is
NEARER = 0.1  # of a bound's distance from the parameter's least value
NUM_WARMUP = 500  # of a sampler that states none


def put(table: str, key: str, value: Any) -> str:
    """A sentence with the line of a campaign file that states a value: `[table]`'s key = value."""
    return f"Put under [{table}]: `{key} = {json.dumps(value)}`."


def other_sampler(now: str = "") -> str:
    """The line of a sampler that copes where another did not."""
    return put("identify", "sampler", "tempered_smc" if now == "nuts" else "nuts")


def more_draws(num_samples: int, least: float, target: float, sampler: str = "") -> str:
    """The line of the draws a chain that raise the least effective number of draws to a target.

    Another sampler where that would be more than twenty times as many: those chains do not move.
    """
    times = target / least if least > 0 else float("inf")
    if not times <= MOST:
        return f"More draws are no way out. {other_sampler(sampler)}"
    step = 10 ** max(floor(log10(num_samples)) - 1, 0)
    count = step * ceil(max(times, 1.5) * num_samples / step)
    return f"Draw more. {put('identify', 'num_samples', count)}"


def wider(bounds: Bounds, sides: Iterable[str], least: float | None = None) -> Bounds:
    """Bounds twice as far apart to the sides, above the least value; what is positive stays so."""
    low, high = bounds
    span = high - low
    end = 0.0 if least is None and low > 0.0 else least
    if "lower" in sides:
        lower_end = low - span
        low = lower_end if end is None else max(lower_end, end + NEARER * (low - end))
    return low, high + span if "upper" in sides else high


def put_bounds(name: str, bounds: Bounds) -> str:
    """The line of a prior, its bounds rounded outwards to three digits of their distance."""
    low, high = bounds
    digits = 2 - floor(log10(high - low))
    scale = 10.0**digits
    ends = floor(low * scale) / scale, ceil(high * scale) / scale
    least = ends[0] if ends[0] > 0 or low <= 0 else low
    return put("identify.prior", name, [float(f"{end:.12g}") for end in (least, ends[1])])
