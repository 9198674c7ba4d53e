"""Samples that are clipped at an extreme of their channel, or that have a constant offset.

A constant offset is no motion of a structure that starts from rest.
"""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.channels import Reals, noise_of
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.suspect import Misfit, Suspect, as_columns, in_time
from jbw.measurement.records import RESPONSES, Record
from jbw.measurement.spans import kept_part
from jbw.report.messages import record_faults as messages
from jbw.report.messages import response_faults
from jbw.report.messages.message import FaultText, first_of

CLIP_RUN = 3  # consecutive equal samples at the extreme
# Noise alone hardly ever makes a flat peak fall by more than this number of the standard deviations
# of the noise.
BEYOND_NOISE = 4.0
# Noise may hide a crest whose height is below this number of standard deviations of the noise.
FLATTENED = 2.0
NO_CHANCE = 6  # smallest number of equal samples in a flat peak that noise cannot explain
# Number of converter steps: an unclipped signal has peaks up to this far below its extreme.
NEAR_TOP = 8.0
SAME = 1e-9  # Values that differ by less than this fraction of the range differ only by round-off.
# smallest ratio of the number of samples at both extremes to the number at two other levels
MORE_OFTEN = 2.0
# Smallest excess of samples at both extremes that counts as clipping. The excess at an extreme is
# the number of samples at this extreme, minus one, minus the number of samples near this extreme.
PILED = 3
# number of samples used to count levels, because sorting a very long record is slow
LEVELS_FROM = 2**20
CLIPPED_SHARE = 1e-3  # largest fraction of clipped samples with which a sweep can still be fitted
# largest ratio of a response's mean to its standard deviation; a larger ratio shows an offset of
# the channel
OFFSET = 1.0


class Clipping(Hypothesis):
    """The fault that responses are limited to their largest measured magnitude."""

    name = "clipping"

    def suspects(self, misfit: Misfit) -> Iterator[Suspect]:
        """Yield clipping as a possible cause: predictions are cut at the largest measurement."""
        cut, count, total = {}, 0, 0
        for label, spectrum in in_time(misfit.spectra).items():
            model, most = spectrum.values - spectrum.residual, np.max(np.abs(spectrum.values))
            beyond = np.count_nonzero(np.abs(model) > most)
            if beyond:
                cut[label] = as_columns(np.clip(model, -most, most) - model)
                count, total = count + beyond, total + len(model)
        if cut:
            text = messages.clipped(count / total, f"in {', '.join(cut)}")
            yield Suspect(cut, lambda _: text)


def clipped(record: Record, role: str, levels: Reals) -> Iterator[Fault]:
    """Yield a fault for samples clipped at an extreme: runs of equal samples, or equal peaks."""
    x, fs = record.channels[role], record.fs
    step, noise, runs = float(np.diff(levels).min()), noise_of(x), []
    shortest = 1 if role in RESPONSES and _piles_up(x, step) else CLIP_RUN
    for extreme in (x.max(), x.min()):
        at = np.flatnonzero(x == extreme)
        for run in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
            start, stop = int(run[0]), int(run[-1]) + 1
            if stop - start >= shortest and _is_no_crest(x, start, stop, step, noise):
                runs.append((start, stop))
    if not runs:
        return
    share = sum(stop - start for start, stop in runs) / len(x)
    listed = first_of([f"{start / fs:.3f}-{stop / fs:.3f} s" for start, stop in sorted(runs)])
    spoilt = np.zeros(len(x), bool)
    for start, stop in runs:
        spoilt[start:stop] = True
    text = messages.clipped(share, f"at {listed}", kept_part(record, spoilt))
    yield Fault("error" if share > CLIPPED_SHARE else "warning", role, *text)


def _is_no_crest(x: Reals, start: int, stop: int, step: float, noise: float) -> bool:
    r"""Return whether a flat peak is too flat to be the crest of a smooth signal with noise.

    A parabola that stays within one converter step for n samples is lower, n samples further, by at
    most $((3n - 1) / (n - 1))^2$ steps; rounding adds one step, and noise flattens a sharper crest.
    Noise larger than a step makes no six samples equal. A peak of fewer than three samples, of
    those that pile up, always counts.
    """
    size = stop - start
    by = size if size >= CLIP_RUN else 1
    outside = [x[i] for i in (start - by, stop - 1 + by) if 0 <= i < len(x)]
    fall = max((float(abs(value - x[start])) for value in outside), default=0.0)
    if size < CLIP_RUN:
        return fall > 2 * step
    if size >= NO_CHANCE and noise > step:
        return True
    of_parabola = ((3 * size - 1) / (size - 1)) ** 2
    return fall > (1 + of_parabola) * (step + FLATTENED * noise) + BEYOND_NOISE * noise


def _piles_up(x: Reals, step: float) -> bool:
    """Return whether single peaks reach the same extreme value more often than by chance.

    A steady sine has more samples near its crest than on it, and a record that repeats itself has
    equal samples at every level.
    """
    ends = beyond = 0
    for depth in (x.max() - x, x - x.min()):
        count = np.count_nonzero(depth == 0)
        near = np.count_nonzero(depth < NEAR_TOP * step) - count
        ends, beyond = ends + count, beyond + max(count - 1 - near, 0)
    if beyond < PILED:
        return False
    span, middle = np.ptp(x), (x.max() + x.min()) / 2
    # The quiet end of a record, which has few levels, is omitted.
    some = x[np.abs(x - middle) > span / 4][:LEVELS_FROM]
    # Values that differ only by round-off count as one level.
    levels = np.unique(np.round(some / (SAME * span)))
    return bool(ends > 2 * MORE_OFTEN * len(some) / len(levels))


class Offset(Hypothesis):
    """The fault that responses have a constant offset."""

    name = "offset of the response"

    def suspects(self, misfit: Misfit) -> Iterator[Suspect]:
        """Yield columns of a constant offset for each data group compared sample by sample."""
        groups = in_time(misfit.spectra)
        units = zip(groups.items(), np.eye(len(groups)), strict=True)
        columns = {n: np.tile(unit, (len(s.values), 1)) for (n, s), unit in units}

        def text(offsets: Reals) -> FaultText:
            shares = np.abs(offsets) / [np.std(s.values) for s in groups.values()]
            largest = int(np.argmax(shares))
            return response_faults.offset(float(shares[largest]), f" of {list(groups)[largest]}")

        if groups:
            yield Suspect(columns, text)


def offset(record: Record) -> Iterator[Fault]:
    """Yield a warning if the mean of a response exceeds its standard deviation."""
    x = record.channels[record.response]
    if abs(np.mean(x)) > OFFSET * np.std(x):
        yield doubt(record.response, *response_faults.offset(abs(np.mean(x)) / np.std(x)))
