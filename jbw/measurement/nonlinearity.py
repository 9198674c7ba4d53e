r"""What a test's records say by themselves of nonlinearity and of noise, in sentences.

How far repeats scatter and whether as noise or as another joint, harmonics by order along a sweep,
distortion beside noise of multisines, the coherence of random noise. What frequency and damping do
against the amplitude is `jbw look`'s to say. Of repeats,

$$d_k = \bar d + a_k\,\bar d + b_k\,\dot{\bar d} + c_k\,t\,\dot{\bar d} + e_k$$

A gain that moves, a trigger that comes late and a natural frequency that shifts each change a
record along one of three directions; what is left is noise. Where the directions explain more than
chance, the repeats differ, and no averaging makes their scatter smaller than that.
"""

import warnings
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import f as f_distribution

from jbw.errors import DataError
from jbw.measurement.channels import channel
from jbw.measurement.distortion import (
    best_linear_approximation,
    detection_lines,
    largest_share,
    swept_harmonics,
)
from jbw.measurement.kinds import Kind
from jbw.measurement.records import INPUTS, RESPONSES, Record
from jbw.measurement.spectra import frf
from jbw.quantities import Motion
from jbw.report.messages import look as messages

MOST_SAMPLES = 2**23  # of a test's channels together: more are not held in memory to be compared
SAME_SOURCE = 0.1  # scatter of the source over its size: above it, repeats are none of each other
ABOVE_NOISE = 5.0  # standard deviations of a harmonic
ORDERS = {2: "second", 3: "third", 5: "fifth"}
BY_CHANCE = 1e-3  # probability below which repeats are said to differ
SHAPES = 3  # directions along which repeats differ by other than noise


class Stated(Protocol):
    """What is stated of a test, by a campaign's table or by the test as it was loaded."""

    @property
    def name(self) -> str:
        """Its short name."""
        ...

    @property
    def traits(self) -> Kind:
        """What a test of its kind is."""
        ...

    @property
    def periods(self) -> int:
        """Whole periods in a record."""
        ...

    @property
    def settle(self) -> float:
        """Time to discard at its start [s]."""
        ...


def seen_in(test: Stated, records: Sequence[Record]) -> list[str]:
    """Sentences on a test whose records are in SI and without a fault; none where it says nothing.

    `records` are of one length and sampling frequency, or nothing is said.
    """
    traits = test.traits
    shapes = {(record.num_samples, record.fs) for record in records}
    if traits.is_curve or len(shapes) != 1 or not all(record.valid.all() for record in records):
        return []
    driven = traits.is_driven and any(role in records[0].channels for role in INPUTS)
    role = next(filter(records[0].channels.__contains__, RESPONSES), None)
    if not driven or role is None:
        return []
    fs = records[0].fs
    u = np.stack([record.channels[record.source] for record in records])
    y = np.stack([record.channels[role] for record in records])
    sentences: list[str] = []
    try:
        if traits.is_periodic and test.periods > 1:
            sentences += _multisine(test, u, y, fs)
        elif traits.is_broadband:
            sentences += _noise(u, y, fs, role)
        else:
            sentences += _repeats(u, y)
            sentences += _sweep(u, y, fs) if traits.is_transient else []
    except DataError as error:  # too short, say: it is for `jbw identify` to refuse
        sentences.append(messages.not_assessed(str(error).splitlines()[0]))
    return [f"{test.name}: {sentence}" for sentence in sentences]


def _same_source(u: NDArray[np.float64]) -> bool:
    """Whether the source was repeated."""
    mean = u.mean(axis=0)
    return float(np.std(u - mean)) <= SAME_SOURCE * float(np.std(mean))


def _repeats(u: NDArray[np.float64], y: NDArray[np.float64]) -> Iterator[str]:
    if len(y) < 2 or not _same_source(u):
        return
    scatter = repeatability(y)
    how = messages.AS_NOISE
    if scatter.differ:
        how = messages.more_than_noise(scatter.noise, scatter.p, scatter.size)
    yield messages.repeats(len(y), scatter.scatter, scatter.floor, how)


def _sweep(u: NDArray[np.float64], y: NDArray[np.float64], fs: float) -> Iterator[str]:
    together = (u, y) if _same_source(u) else (u[:1], y[:1])
    harmonics = swept_harmonics(*together, fs)
    shares = {order: largest_share(harmonics, order) for order in ORDERS}
    shown = [
        messages.harmonic(ORDERS[order], share, hz)
        for order, (share, error, hz) in shares.items()
        if np.isfinite(share) and share > ABOVE_NOISE * error
    ]
    noise = max((error for _, error, _ in shares.values()), default=0.0)
    yield messages.harmonics(shown, noise)


def _multisine(
    test: Stated, u: NDArray[np.float64], y: NDArray[np.float64], fs: float
) -> Iterator[str]:
    """Distortion beside noise, by periods, by realisations and by the lines left unexcited."""
    size, rest = divmod(u.shape[1], test.periods)
    skipped = int(np.ceil(test.settle * fs / size - 1e-6))
    if rest or skipped >= test.periods:
        return
    steady = (x[:, skipped * size :].reshape(len(x), -1, size) for x in (u, y))
    (u, y), is_repeated = steady, _same_source(u)
    if is_repeated:  # repeats of one realisation are further periods of it
        u, y = (x.reshape(1, -1, size) for x in (u, y))
    best = best_linear_approximation(u, y, fs)
    gain = np.sqrt(np.mean(np.abs(best.h) ** 2))
    noise, distortion = (
        np.sqrt(np.mean(std**2)) / gain for std in (best.noise_std, best.distortion_std)
    )
    if np.isfinite(noise) and best.num_realisations > 1:
        yield messages.distortion(noise, distortion, best.num_realisations)
    elif np.isfinite(noise):
        yield messages.noise_of_periods(noise, best.num_periods)
    idle = detection_lines(u[0], y[0])
    shares = {"even": (idle.even, idle.num_even), "odd": (idle.odd, idle.num_odd)}
    present = [(name, share) for name, (share, count) in shares.items() if count]
    if present:
        yield messages.idle_lines(present, idle.noise)


def _noise(
    u: NDArray[np.float64], y: NDArray[np.float64], fs: float, role: Motion
) -> Iterator[str]:
    yield messages.coherence_of_noise(*coherence_at_resonance(u, y, fs, role))


def coherence_at_resonance(
    u: NDArray[np.float64], y: NDArray[np.float64], fs: float, role: Motion
) -> tuple[float, float]:
    """Frequency of the strongest response [Hz], and the mean coherence about it.

    About it are the lines whose power is within a quarter of the largest; `u` and `y` have the
    shape (repeat, time), `role` is the response's.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the window, which is Step 2's to choose
        estimate = frf(u, y, fs, response=role)
    power = np.abs(estimate.h) ** 2 * estimate.input_spectrum
    near = power > power.max() / 4
    return float(estimate.freq[np.argmax(power)]), float(np.mean(estimate.coherence[near]))


class Repeatability(NamedTuple):
    """Scatter of repeats of one test, over the root mean square of their mean."""

    scatter: float  # of one repeat, all of it
    noise: float  # of one repeat, what no change of size, time or pace explains
    size: float  # standard deviation of the size
    p: float  # probability of so much along the three directions by noise alone
    num_repeats: int

    @property
    def differ(self) -> bool:
        """Whether the repeats differ by more than noise."""
        return self.p < BY_CHANCE

    @property
    def floor(self) -> float:
        """What the mean leaves to be seen: an effect below it is none."""
        return self.scatter / self.num_repeats**0.5


def repeatability(y: ArrayLike) -> Repeatability:
    """Scatter of repeats of one excitation, shape (repeat, time), begun together.

    Raises:
        DataError: NaN, fewer than two repeats, or a dead channel.
    """
    rows = channel(y, "y")
    if rows.ndim != 2 or len(rows) < 2 or rows.shape[1] <= SHAPES:
        raise DataError(
            f"Channel `y` must hold two repeats of more than {SHAPES} samples, (repeat, time), but "
            f"has the shape {rows.shape}.",
            remedy="Measure the test again, with nothing changed.",
        )
    count, length = rows.shape
    mean = rows.mean(axis=0)
    power = float(np.mean(mean**2))
    if power == 0:
        raise DataError("Channel `y` is constant.", why="It shows no response.")
    slope, t = np.gradient(mean), np.linspace(-1.0, 1.0, length)
    basis = np.linalg.qr(np.column_stack([mean, slope, t * slope]))[0]
    deviations = rows - mean
    along = deviations @ basis
    explained = float(np.sum(along**2))
    rest = max(float(np.sum(deviations**2)) - explained, 0.0)
    degrees = SHAPES * (count - 1), (length - SHAPES) * (count - 1)
    noise = rest / degrees[1]
    # Coloured noise has more power where the response has: its own band is what it is judged by.
    ratio = explained / degrees[0] / max(_in_band(deviations, mean), noise, 1e-300)
    return Repeatability(
        scatter=float(np.sqrt(np.sum(deviations**2) / ((count - 1) * length) / power)),
        noise=float(np.sqrt(noise / power)),
        size=float(np.std(along[:, 0], ddof=1) / np.sqrt(length * power)),
        p=float(f_distribution.sf(ratio, degrees[0], max(_lines(mean) * (count - 1), 1))),
        num_repeats=count,
    )


def _band(mean: np.ndarray) -> np.ndarray:
    """Lines that hold the response: those of a hundredth of its largest amplitude."""
    size = np.abs(np.fft.rfft(mean))
    return size > 0.01 * size.max()


def _lines(mean: np.ndarray) -> int:
    return 2 * int(np.sum(_band(mean)))


def _in_band(deviations: np.ndarray, mean: np.ndarray) -> float:
    """Variance a sample of noise as strong everywhere as the median line of the response's band."""
    band = _band(mean)
    power = np.sum(np.abs(np.fft.rfft(deviations))[:, band] ** 2, axis=0) / (len(deviations) - 1)
    # Median over mean of a chi-square of 2 k degrees of freedom, by Wilson and Hilferty.
    k = len(deviations) - 1
    return float(np.median(power) / deviations.shape[1] / (1 - 1 / (9 * k)) ** 3)
