"""Free decays of one mode, reduced to their envelopes in a band."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jbw.errors import DataError
from jbw.measurement.demodulation import BandFilter, Reading, band_filter, demodulate, read_decay
from jbw.measurement.records import Test

LETTER = {"displacement": "y", "velocity": "v", "acceleration": "a"}
LEAST_VALUES = 16  # of an envelope: a decay of five parameters and three of its own
HEADROOM = 1.02  # of the strongest record, where the simulated decay begins
SPARE = 1.3  # times the duration that the measured rates ask for
WINDOW = 0.25  # s, of a reading of frequency and damping


class Decays(eqx.Module):
    """Envelopes of several decays of one mode, and how the model is brought to the same form.

    Attributes:
        envelope: Envelope of each record about the band's centre [m/s for velocities], peak.
        noise_std: Noise of each record, of the real and of the imaginary part, for fits.
        shift_std: Scatter of the records' natural frequencies [rad/s], for fits.
        worth: Independent values that one of the envelope's is worth, at most 1.
        y_start: Displacement that the simulated decay begins from [m].
        taps: The band's filter as the model's samples meet it.
        rotation: Turn of the carrier between two values of the envelope.
        step_s: Time between two values [s]; static.
        stride: Samples of the model between two values; static.
        fs: Sampling frequency of the model [Hz]; static.
        num_samples: Samples of the simulated decay; static.
        response: displacement, velocity or acceleration; static.
        substeps: Steps of the solver between samples; static.
        names: Name of each record; static.
    """

    envelope: Complex[Array, "record step"]
    noise_std: Float[Array, " record"]
    shift_std: Float[Array, ""]
    worth: Float[Array, ""]
    y_start: Float[Array, ""]
    taps: Complex[Array, " tap"]
    rotation: Complex[Array, ""]
    step_s: float = eqx.field(static=True)
    stride: int = eqx.field(static=True)
    fs: float = eqx.field(static=True)
    num_samples: int = eqx.field(static=True)
    response: str = eqx.field(static=True, default="velocity")
    substeps: int = eqx.field(static=True, default=1)
    names: tuple[str, ...] = eqx.field(static=True, default=())


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


def reduce(test: Test, *, substeps: int = 1) -> Decays:
    """Envelopes of the decays of a test, cut to the shortest.

    Args:
        test: Decays of one mode; `settle` is left out at their beginning.
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
    order = list(LETTER).index(test.records[0].response)
    y_start, duration = _course(envelope, chosen, order)
    turn = 2 * np.pi * chosen.centre_hz / chosen.fs
    taps = chosen.taps[:: chosen.stride]
    n = np.arange(len(taps)) * chosen.stride
    return Decays(
        envelope=jnp.asarray(envelope),
        noise_std=jnp.asarray(0.01 * np.sqrt(np.mean(np.abs(envelope) ** 2, axis=1))),
        shift_std=jnp.asarray(1e-4 * 2 * np.pi * chosen.centre_hz),
        worth=jnp.asarray(1.0),
        y_start=jnp.asarray(y_start),
        taps=jnp.asarray(2 * taps / taps.sum() * np.exp(-1j * turn * n)),
        rotation=jnp.asarray(np.exp(-1j * turn * chosen.step)),
        step_s=chosen.step_s,
        stride=chosen.step // chosen.stride,
        fs=chosen.fs / chosen.stride,
        num_samples=round(duration * chosen.fs / chosen.stride) + len(taps),
        response=test.records[0].response,
        substeps=substeps,
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
