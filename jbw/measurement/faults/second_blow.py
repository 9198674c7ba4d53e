"""A decay that jumps to another state, because of a second blow or missing samples."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.faults.hypothesis import Facts, Hypothesis
from jbw.measurement.readings.decay import DecayCause, DecayFits
from jbw.measurement.spans import left_out_from
from jbw.report.messages import decay_faults as messages
from jbw.report.messages.message import FaultText

PLACES = 60  # candidate places of a jump
APART = 0.1  # smallest distance between the two tried times, relative to the record's length
LOUD = 6.0  # Only envelopes above this multiple of the noise are searched.
LEAST = 0.05  # smallest jump that is reported: of ln a and the phase [rad] combined
GREW = 0.2  # largest jump of ln a that missing samples can cause
GROWTH = (-1.5, 8.0)  # range of plausible jumps of ln a
ENDS = 0.02  # fraction of the record at either end in which a jump cannot be seen


class SecondBlow(Hypothesis):
    """A jump of a decay from one state to another: time, jumps of log amplitude and phase."""

    name = "second blow"

    def causes(self, fits: Any, basis: str) -> Iterator[DecayCause]:
        """Yield jumps at the two times at which the log envelope changes most."""
        if isinstance(fits, DecayFits):
            yield from map(DecayCause, _places(fits))

    def matters(self, values: Reals, fits: Any) -> bool:
        """Return whether a jump is inside the record and changes the motion by at least 5 %."""
        place, growth, turn = values
        size = np.hypot(growth, np.angle(np.exp(1j * turn)))
        return ENDS < place < 1 - ENDS and GROWTH[0] < growth < GROWTH[1] and size > LEAST

    def fault(self, values: Reals, fits: Any, facts: Facts) -> FaultText:
        """Return the text on a jump: time, size, and a remedy that keeps what precedes it."""
        place, growth, turn = values
        signal = fits.signal
        at = facts.settle_s + signal.begins + float(place) * float(signal.time[-1])
        remedy = left_out_from(facts.record, at)
        jump = float(abs(np.exp(growth + 1j * turn) - 1))
        return messages.second_blow(at, jump, remedy, grows=bool(growth > GREW))


def _places(fits: DecayFits) -> list[Reals]:
    """Return starting values of jumps, for the times at which a step best explains ln amplitude."""
    signal, linear = fits.signal, fits.fits["linear"].theta
    size, count = signal.size, len(signal.z)
    loud = np.flatnonzero(size > LOUD * max(signal.tail, 1e-4 * size.max()))
    count = int(loud[-1]) + 1 if loud.size else count
    if count <= 30:
        return []
    time, z = signal.time[:count], signal.z[:count]
    turned = z * np.exp(-1j * linear[3] * fits.scale * time)
    logs = np.log(np.abs(z) + 1e-300) + 1j * np.unwrap(np.angle(turned))
    weight = np.minimum(size[:count], size[count // 2])
    powers = np.vander(time / time[-1], 4, increasing=True)
    smooth, _ = np.linalg.qr(powers * weight[:, None])
    left = logs * weight - smooth @ (smooth.T @ (logs * weight))
    found = []
    for at in np.unique(np.linspace(0.03 * count, 0.97 * count, PLACES).astype(int)):
        step = signal.filtered_step(float(time[at]))[:count] * weight
        step = step - smooth @ (smooth.T @ step)
        power = float(step @ step)
        jump = complex(step @ left) / power if power > 1e-12 else 0j
        found.append((abs(jump) ** 2 * power, int(at), jump))
    found.sort(key=lambda row: -row[0])
    others = [row for row in found if abs(row[1] - found[0][1]) > APART * count]
    return [
        np.array([time[at] / signal.time[-1], jump.real, jump.imag])
        for _, at, jump in found[:1] + others[:1]
    ]
