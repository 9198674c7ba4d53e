r"""Check whether noise of a measured drive causes larger errors at a resonance than response noise.

A fit takes the measured drive as exact. White noise of the drive channel passes the resonance and
appears in the predicted response as an error that no residual reveals, as narrow as the resonance.
Its ratio to the noise of the response's channel is

$$r = |H|^2_{max}\, S_u / S_y$$

Two repeats determine both noises from their difference on lines that the drive does not excite.
"""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.records import INPUTS, Record
from jbw.report.messages import record_faults as messages

EMPTY = 0.1  # Lines below this fraction of the drive's largest line count as not driven.
FEWEST_EMPTY = 32  # smallest number of lines for a median
HALF = 0.5  # Lines above this fraction of the largest power belong to the resonance.
# If more than this fraction of the difference between two drives appears in the response, the
# structure responded to it.
MEASURED = 0.5
# largest difference of power between the drives of two repeats, relative to the drive's power
ONE_DRIVE = 0.1
MORE = 1.0  # smallest ratio r that is reported


def noisy_drive(first: Record, second: Record) -> Iterator[Fault]:
    """Yield a warning if noise of the drive, seen in two repeats, exceeds the response's noise."""
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
    """Return the ratio r of drive noise to response noise at the resonance, from two repeats.

    The ratio is zero in three cases: the drives of the repeats differ; they leave too few lines
    without excitation; or the response followed the difference of the drives, which is then a real
    force and no noise of the drive's channel.
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
