"""Recognition of the kind of test from samples, or from a table of frequency and amplitude."""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from scipy.stats import spearmanr

from jbw.campaign.roles import MOST_SAMPLES, Channel
from jbw.measurement.channels import Reals
from jbw.measurement.faults.responses import LOCKED
from jbw.measurement.files.tree import Leaf, load
from jbw.measurement.records import INPUTS, RESPONSES, si_of

PARTS = 16  # number of sections into which a record is divided; each has a spectrum
LEAST = 64  # smallest number of samples in a section
# In a tone's section, more than this fraction of the power is near the strongest spectral line.
ONE_LINE = 0.9
# In a section of noise, less than this fraction of the power is near the strongest spectral line.
NO_LINE = 0.35
# largest ratio of amplitudes between sections of a steady tone, without the first quarter
STEADY = 1.2
FALLS = 0.5  # largest rms of a decay's last quarter, relative to its strongest quarter
# smallest shift of the strongest spectral line during a sweep, as a multiple of the line spacing
MOVES = 3
FEWEST = 4  # smallest number of points of a response curve in a table
FOLLOWS = 0.9  # smallest rank correlation between amplitude and frequency or force along a backbone
GROWS = 2.0  # smallest ratio of the largest to the smallest amplitude or force along a backbone
SHIFTS = 0.3  # largest relative range of frequency along a backbone
SAME = 1e-6  # largest relative change of a frequency that counts as constant


def course_of(x: Reals) -> Literal["tones", "noise", "sweep"] | None:
    """Return whether a source is a steady tone, noise or a sweep; None if that is unclear."""
    x = x[np.isfinite(x)]
    size = len(x) // PARTS
    if size < LEAST or not np.ptp(x):
        return None
    parts = x[: size * PARTS].reshape(PARTS, size)
    parts = parts - parts.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(parts * np.hanning(size), axis=1)) ** 2
    heard = power.sum(axis=1) > 1e-4 * power.sum(axis=1).max()
    peaks = power.argmax(axis=1)
    line_power = [row[max(at - 2, 0) : at + 3].sum() for row, at in zip(power, peaks, strict=True)]
    share = np.array(line_power)[heard] / power.sum(axis=1)[heard]
    if np.median(share) < NO_LINE:
        return "noise"
    line_bins = peaks[heard]
    rms = parts.std(axis=1)[PARTS // 4 :]
    if np.all(share > ONE_LINE) and np.ptp(line_bins) <= 1 and rms.max() < STEADY * rms.min():
        return "tones"
    steps = np.diff(line_bins)
    one_way = max(np.sum(steps >= 0), np.sum(steps <= 0)) >= 0.8 * len(steps)
    return "sweep" if np.ptp(line_bins) >= MOVES and one_way else None


def falls(x: Reals) -> bool:
    """Return whether samples decay: the last quarter's rms is below half of the largest one."""
    x = x[np.isfinite(x)]
    if len(x) < 8:
        return False
    x = x - x.mean()
    rms = [float(part.std()) for part in np.array_split(x, 4)]
    return rms[-1] < FALLS * max(rms)


def controlled_kind(roles: Mapping[str, Channel], series: Mapping[str, Leaf]) -> str:
    """Return the kind of test of a table of frequencies and amplitudes; an empty text if unclear.

    A constant phase indicates a backbone, as do a frequency and a force that change with the
    amplitude. Frequencies that are constant or go back indicate points of S-curves or of folded
    curves.
    """
    response = next((role for role in RESPONSES if role in roles), "")
    source = next((role for role in INPUTS if role in roles), "")
    if not response or "frequency" not in roles or "time" in roles:
        return ""
    columns = {role: _column(roles[role], series) for role in roles}
    hz, y, force = columns["frequency"], columns[response], columns.get(source)
    columns_read = [x for x in (hz, y, force) if x is not None]
    if hz is None or y is None or len({len(x) for x in columns_read}) > 1 or len(hz) < FEWEST:
        return ""
    if not all(np.all(x > 0) for x in columns_read):
        return ""
    phase = columns.get("phase")
    steps = np.diff(hz)
    goes_back = np.any(steps > SAME * hz.max()) and np.any(steps < -SAME * hz.max())
    stays = np.mean(np.abs(steps) < SAME * hz.max()) > 0.5
    if phase is not None:
        radians = np.unwrap(phase * si_of("phase", roles["phase"].unit or "rad")[0])
        if np.ptp(radians) < LOCKED and not stays:
            return "backbone"
        return "curve" if goes_back or stays else ""
    if force is not None and stays:
        return "curve"
    driven = y if force is None else force
    if y.max() < GROWS * y.min() or driven.max() < GROWS * driven.min():
        return ""
    together = float(np.asarray(spearmanr(y, hz if force is None else force))[0])
    shifts = 0 < np.ptp(hz) < SHIFTS * hz.max()
    return "backbone" if shifts and abs(together) > FOLLOWS else ""


def _column(channel: Channel, series: Mapping[str, Leaf]) -> Reals | None:
    """Return a column of finite real numbers; None if it has other values or too many."""
    leaf = series.get(channel.path)
    if leaf is None or max(leaf.shape, default=0) > MOST_SAMPLES:
        return None
    values = np.ravel(np.asarray(load(leaf)))
    if np.iscomplexobj(values) or not np.issubdtype(values.dtype, np.number):
        return None
    finite = values.astype(float)
    return finite if np.isfinite(finite).all() else None
