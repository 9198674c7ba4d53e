r"""Whether the noise of a measured drive makes more error at a resonance than the response's own.

A fit takes the drive as it was measured. White noise of that channel passes the resonance and
stands in the predicted response as an error that no residual shows to be one, as narrow as the
resonance, over the noise of the response's channel,

$$r = |H|^2_{max}\, S_u / S_y$$

Two repeats tell both noises by their difference on the lines that the drive leaves empty.
"""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.checks.faults import Fault, doubt
from jbw.measurement.records import INPUTS, Record
from jbw.report.messages import record_faults as messages

EMPTY = 0.1  # of the largest line of the drive: lines below it are not driven
FEWEST_EMPTY = 32  # lines that a median is taken of
HALF = 0.5  # of the largest power: the lines of the resonance
MEASURED = 0.5  # of what the drive's noise would make of the response, if the structure felt it
ONE_DRIVE = 0.1  # of the drive's power: repeats that differ by more had no drive in common
MORE = 1.0  # r from which the noise is named


def noisy_drive(first: Record, second: Record) -> Iterator[Fault]:
    """Yield the doubt that the drive of two repeats was measured too roughly."""
    if not set(INPUTS) & first.channels.keys():
        return
    role, y = first.source, first.response
    if not {role, y} <= second.channels.keys() or first.fs != second.fs:
        return
    u, x = ([record.channels[name] for record in (first, second)] for name in (role, y))
    if len(u[0]) != len(u[1]) or not all(np.all(np.isfinite(samples)) for samples in (*u, *x)):
        return
    ratio = passed_on(np.stack(u), np.stack(x))
    if ratio > MORE:
        yield doubt(role, *messages.noisy_drive(role, ratio**0.5, y))


def passed_on(u: Reals, y: Reals) -> float:
    """Return the ratio r of two repeats of drive and response, (repeat, time).

    Zero where the drives are not one, where they leave too few lines empty, and where the response
    moved with what differs in the drive, which is no noise of its channel then.
    """
    if np.mean((u[1] - u[0]) ** 2) > ONE_DRIVE * np.mean(u**2):
        return 0.0
    drive, response = np.abs(np.fft.rfft(u.mean(axis=0))), np.abs(np.fft.rfft(y.mean(axis=0)))
    of_drive, of_response = (
        np.abs(np.fft.rfft(repeats[1] - repeats[0])) ** 2 for repeats in (u, y)
    )
    empty = drive < EMPTY * drive.max()
    if np.sum(empty) < FEWEST_EMPTY:
        return 0.0
    noise, response_noise = np.median(of_drive[empty]), np.median(of_response[empty])
    peak = ~empty & (response**2 > HALF * np.max(response[~empty] ** 2))
    gain = np.sum(response[peak] ** 2) / np.sum(drive[peak] ** 2)
    passed = gain * noise
    if response_noise <= 0 or np.mean(of_response[peak]) > response_noise + MEASURED * passed:
        return 0.0
    return float(passed / response_noise)
