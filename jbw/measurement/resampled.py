r"""Samples of one clock at the instants of another: band-limited interpolation.

$$x(\tau) = \sum_n x_n\,\mathrm{sinc}(\tau - n)\,w(\tau - n)$$

with Kaiser's window w over 64 samples, which keeps what lies below nine tenths of half the sampling
rate to some 1e-6. Beyond the ends a record goes on as its mirror image through the end.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jbw.measurement.channels import Reals
from jbw.measurement.records import RESPONSES, Record

REACH = 32  # samples to either side
BETA = 10.0  # of Kaiser's window
CHUNK = 1 << 14  # samples interpolated at once
MILLION = 1e6
OF_RESPONSE = (*RESPONSES, "drive_point")  # roles that the response's recorder samples


def interpolated(x: Float[np.ndarray, " time"], place: Float[np.ndarray, " at"]) -> Reals:
    """Values of a sampled band-limited signal at places counted in samples."""
    before, after = 2 * x[0] - x[REACH:0:-1], 2 * x[-1] - x[-2 : -REACH - 2 : -1]
    padded = np.concatenate([before, x, after])
    offsets = np.arange(1 - REACH, REACH + 1)
    found = []
    for first in range(0, len(place), CHUNK):
        at = place[first : first + CHUNK]
        whole = np.floor(at).astype(int)
        away = (at - whole)[:, None] - offsets
        inside = np.clip(1 - (away / REACH) ** 2, 0.0, None)
        weight = np.sinc(away) * np.i0(BETA * np.sqrt(inside)) / np.i0(BETA)
        rows = padded[whole[:, None] + offsets + REACH]
        # Their sum is one but for the window's ripple: a constant stays what it is.
        found.append(np.sum(weight * rows, axis=1) / np.sum(weight, axis=1))
    return np.concatenate(found)


def on_one_clock(record: Record, clock_ppm: float) -> Record:
    r"""A record whose responses, sampled by a clock that runs fast, are as its drive's has them.

    Sample n of the fast clock was taken at $n / (1 + \epsilon)$ of the other. What one of them
    has beyond the other's end is cut off.

    Args:
        record: With a response and a source.
        clock_ppm: By how many millionths that runs fast; negative where it is slow.
    """
    if not clock_ppm:
        return record
    ratio = 1 + clock_ppm / MILLION
    kept = min(record.num_samples, int(np.floor((record.num_samples - 1) / ratio)) + 1)
    place = np.arange(kept) * ratio
    channels = {
        role: interpolated(x, place) if role in OF_RESPONSE else x[:kept]
        for role, x in record.channels.items()
    }
    said = f"response on that of the drive, by {clock_ppm:g} ppm"
    return replace(record, channels=channels, provenance={**record.provenance, "clock": said})
