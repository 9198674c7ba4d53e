"""Envelopes of free decays in a band: read from records, and predicted from the joint."""

from collections.abc import Sequence
from typing import ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jbw.errors import DataError
from jbw.measurement.demodulation import BandFilter, Reading, band_filter, demodulate, read_decay
from jbw.measurement.records import Test
from jbw.observables.observable import Observable, Theta
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.response import simulate
from jbw.quantities import LETTER_OF, derivative_order

LEAST_VALUES = 16  # of an envelope: a decay of five parameters and three of its own
HEADROOM = 1.02  # of the strongest record, where the simulated decay begins
SPARE = 1.3  # times the duration that the measured rates ask for
WINDOW = 0.25  # s, of a reading of frequency and damping


def filter_of(test: Test) -> BandFilter:
    """The filter of a test's band.

    Raises:
        DataError: If the test states no band.
    """
    if test.band_hz is None:
        raise DataError(
            f"Test `{test.name}` needs `band`: the frequencies around the one mode of the joint.",
            why="A free decay shows every mode at once.",
            remedy="Give band = [lowest, highest] in Hz, without any other mode.",
        )
    return band_filter(test.band_hz, test.records[0].fs)


def envelopes(test: Test) -> list[np.ndarray]:
    """Envelope of every record of a test, at the full sampling rate, after `settle`."""
    chosen, found = filter_of(test), []
    for record in test.records:
        skipped = round(test.settle * record.fs)
        found.append(demodulate(record.channels[record.response][skipped:], chosen)[1])
    return found


def readings(test: Test) -> list[Reading]:
    """Frequency and damping along every record of a test."""
    chosen = filter_of(test)
    return [
        read_decay(one[:: chosen.step], chosen.step_s, chosen.centre_hz, WINDOW)
        for one in envelopes(test)
    ]


class Envelopes(Observable):
    """Envelopes of several decays of one mode, and how the model is brought to the same form.

    Attributes:
        envelope: Envelope of each record about the band's centre [m/s for velocities], peak.
        noise_std: Noise of each record, of the real and of the imaginary part, for fits.
        shift_std: Scatter of the records' natural frequencies [rad/s], for fits.
        fraction: Fraction of the envelopes' values that count as independent.
        y_start: Displacement that the simulated decay begins from [m].
        taps: The band's filter as the model's samples meet it.
        rotation: Turn of the carrier between two values of the envelope.
        step_s: Time between two values [s]; static.
        stride: Samples of the model between two values; static.
        fs: Sampling frequency of the model [Hz]; static.
        num_samples: Samples of the simulated decay; static.
        response: displacement, velocity or acceleration; static.
        substeps: Steps of the solver between samples; static.
        centre_hz: Middle of the band [Hz]; static.
        names: Name of each record; static.
    """

    kinds: ClassVar[tuple[str, ...]] = ("decay",)

    envelope: Complex[Array, "record step"]
    noise_std: Float[Array, " record"]
    shift_std: Float[Array, ""]
    fraction: Float[Array, ""]
    y_start: Float[Array, ""]
    taps: Complex[Array, " tap"]
    rotation: Complex[Array, ""]
    step_s: float = eqx.field(static=True)
    stride: int = eqx.field(static=True)
    fs: float = eqx.field(static=True)
    num_samples: int = eqx.field(static=True)
    response: str = eqx.field(static=True, default="velocity")
    substeps: int = eqx.field(static=True, default=1)
    centre_hz: float = eqx.field(static=True, default=0.0)
    names: tuple[str, ...] = eqx.field(static=True, default=())

    @classmethod
    def reduce(
        cls,
        tests: Sequence[Test],
        *,
        laws: tuple[str, ...] = ("bouc_wen",),
        substeps: int | None = None,
    ) -> tuple[Self, ...]:
        """Envelopes of the decays of each test."""
        return tuple(cls.of(test, laws=laws, substeps=substeps or 1) for test in tests)

    @classmethod
    def of(cls, test: Test, *, laws: tuple[str, ...] = ("bouc_wen",), substeps: int = 1) -> Self:
        """Envelopes of the decays of a test, cut to the shortest.

        Args:
            test: Decays of one mode; `settle` is left out at their beginning.
            laws: Names of the laws of the joint.
            substeps: Steps of the solver between samples.

        Returns:
            The reduced decays; noise and scatter are first guesses.

        Raises:
            DataError: No band, records too short, or fewer than 16 independent values in one.
        """
        chosen = filter_of(test)
        found = [one[:: chosen.step] for one in envelopes(test)]
        length = min(map(len, found))
        if length < LEAST_VALUES:
            raise DataError(
                f"Test `{test.name}` leaves {length} independent values of its shortest record; "
                f"at least {LEAST_VALUES} are needed.",
                remedy="Widen `band`, shorten `settle`, or drop short records with `exclude`.",
            )
        envelope = np.stack([one[:length] for one in found])
        order = derivative_order(test.records[0].response)
        y_start, duration = _course(envelope, chosen, order)
        turn = 2 * np.pi * chosen.centre_hz / chosen.fs
        taps = chosen.taps[:: chosen.stride]
        n = np.arange(len(taps)) * chosen.stride
        return cls(
            laws=laws,
            envelope=jnp.asarray(envelope),
            noise_std=jnp.asarray(0.01 * np.sqrt(np.mean(np.abs(envelope) ** 2, axis=1))),
            shift_std=jnp.asarray(1e-4 * 2 * np.pi * chosen.centre_hz),
            fraction=jnp.asarray(1.0),
            y_start=jnp.asarray(y_start),
            taps=jnp.asarray(2 * taps / taps.sum() * np.exp(-1j * turn * n)),
            rotation=jnp.asarray(np.exp(-1j * turn * chosen.step)),
            step_s=chosen.step_s,
            stride=chosen.step // chosen.stride,
            fs=chosen.fs / chosen.stride,
            num_samples=round(duration * chosen.fs / chosen.stride) + len(taps),
            response=test.records[0].response,
            substeps=substeps,
            centre_hz=chosen.centre_hz,
            names=tuple(f"{test.name} {i + 1}" for i in range(len(test.records))),
        )


def _course(envelope: np.ndarray, chosen: BandFilter, order: int) -> tuple[float, float]:
    """Where the simulated decay begins, and how long it lasts, so that every record lies on it."""
    size = np.log(np.abs(envelope))
    strongest = int(np.argmax(size[:, 0]))
    edge = min(8, envelope.shape[1] // 2)
    first, last = (
        max(float(row[0] - row[-1]) / ((edge - 1) * chosen.step_s), 1e-6)
        for row in (size[strongest, :edge], size[strongest, -edge:])
    )
    # The filter eats the first of the simulated decay, at a rate that may be twice the measured.
    lead = chosen.half / chosen.fs
    start = HEADROOM * np.exp(size[strongest, 0] + 2 * first * lead)
    weakest = size[:, 0].min()
    reached = np.flatnonzero(size[strongest] <= weakest)
    wait = (
        reached[0] * chosen.step_s
        if reached.size
        else size.shape[1] * chosen.step_s + (size[strongest, -1] - weakest) / last
    )
    omega = 2 * np.pi * chosen.centre_hz
    return float(start) / omega**order, SPARE * (wait + size.shape[1] * chosen.step_s)


def decay_of(theta: Theta, data: Envelopes) -> Complex[Array, " step"]:
    r"""Logarithm of the envelope of the joint's free decay, through the band's filter.

    Begun at rest at its greatest displacement, its memory on the steady loop of that amplitude.

    Args:
        theta: The joint's parameters.
        data: The reduced decays.

    Returns:
        log |X| + j arg X at steps of `step_s`, the phase without jumps.

    Reference:
        Eqs. (1), (2) with u = 0.
    """
    joint = oscillator_of(theta, data.laws)
    start = (data.y_start, jnp.zeros(()), joint.at_tip(data.y_start))
    free = simulate(
        joint,
        jnp.zeros(data.num_samples),
        data.fs,
        hold="zero",
        initial=start,
        substeps=data.substeps,
    )
    kernel = jnp.stack([data.taps.real, data.taps.imag])[:, None, :]
    x = getattr(free, LETTER_OF[data.response])[None, None, :]
    parts = jax.lax.conv_general_dilated(x, kernel, (data.stride,), "VALID")[0]
    envelope = jax.lax.complex(parts[0], parts[1])
    turns = jnp.angle(envelope[1:] * jnp.conj(envelope[:-1]) * data.rotation)
    phase = jnp.concatenate([jnp.zeros(1), jnp.cumsum(turns)])
    return jax.lax.complex(jnp.log(jnp.abs(envelope)), phase)
