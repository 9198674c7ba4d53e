"""What a test's records say by themselves of nonlinearity and of noise, in sentences.

How far repeats scatter and whether as noise, harmonics by order along a sweep, distortion beside
noise of multisines, the coherence of random noise. What frequency and damping do against the
amplitude is `jbw look`'s to say.
"""

import warnings
from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.measurement.distortion import best_linear_approximation, detection_lines
from jbw.measurement.kinds import Kind
from jbw.measurement.records import INPUTS, RESPONSES, Record
from jbw.measurement.repeatability import repeatability
from jbw.measurement.spectra import frf
from jbw.measurement.swept_harmonics import largest_share, swept_harmonics
from jbw.quantities import Motion

MOST_SAMPLES = 2**23  # of a test's channels together: more are not held in memory to be compared
SAME_SOURCE = 0.1  # scatter of the source over its size: above it, repeats are none of each other
ABOVE_NOISE = 5.0  # standard deviations of a harmonic
ORDERS = {2: "second", 3: "third", 5: "fifth"}


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
    shapes = {(one.num_samples, one.fs) for one in records}
    if traits.is_curve or len(shapes) != 1 or not all(one.valid.all() for one in records):
        return []
    driven = traits.is_driven and any(role in records[0].channels for role in INPUTS)
    role = next(filter(records[0].channels.__contains__, RESPONSES), None)
    if not driven or role is None:
        return []
    fs = records[0].fs
    u = np.stack([one.channels[one.source] for one in records])
    y = np.stack([one.channels[role] for one in records])
    said: list[str] = []
    try:
        if traits.is_periodic and test.periods > 1:
            said += _multisine(test, u, y, fs)
        elif traits.is_broadband:
            said += _noise(u, y, fs, role)
        else:
            said += _repeats(u, y)
            said += _sweep(u, y, fs) if traits.is_transient else []
    except DataError as error:  # too short, say: it is for `jbw identify` to refuse
        said.append(f"not told: {str(error).splitlines()[0]}")
    return [f"{test.name}: {one}" for one in said]


def _same_source(u: NDArray[np.float64]) -> bool:
    """Whether the source was repeated."""
    mean = u.mean(axis=0)
    return float(np.std(u - mean)) <= SAME_SOURCE * float(np.std(mean))


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %"


def _repeats(u: NDArray[np.float64], y: NDArray[np.float64]) -> Iterator[str]:
    if len(y) < 2 or not _same_source(u):
        return
    found = repeatability(y)
    how = "as noise does"
    if found.differ:
        how = (
            f"more than noise of {_percent(found.noise)} does: size, start or pace differ (p = "
            f"{found.p:.0e}), the size by {_percent(found.size)}"
        )
    yield (
        f"{len(y)} repeats scatter by {_percent(found.scatter)} of the response, {how}; their mean "
        f"shows no effect below {_percent(found.floor)}."
    )


def _sweep(u: NDArray[np.float64], y: NDArray[np.float64], fs: float) -> Iterator[str]:
    together = (u, y) if _same_source(u) else (u[:1], y[:1])
    found = swept_harmonics(*together, fs)
    shares = {order: largest_share(found, order) for order in ORDERS}
    shown = [
        f"the {ORDERS[order]} {_percent(share)} at {hz:.4g} Hz"
        for order, (share, error, hz) in shares.items()
        if np.isfinite(share) and share > ABOVE_NOISE * error
    ]
    noise = max((error for _, error, _ in shares.values()), default=0.0)
    if shown:
        told = ", ".join(shown)
        yield f"harmonics over the largest response: {told}; residual of the fit {_percent(noise)}."
    else:
        yield f"no harmonic exceeds the residual of the fit, {_percent(noise)} of the response."


def _multisine(
    test: Stated, u: NDArray[np.float64], y: NDArray[np.float64], fs: float
) -> Iterator[str]:
    """Distortion beside noise, by periods, by realisations and by the lines left unexcited."""
    size, rest = divmod(u.shape[1], test.periods)
    skipped = int(np.ceil(test.settle * fs / size - 1e-6))
    if rest or skipped >= test.periods:
        return
    steady = (x[:, skipped * size :].reshape(len(x), -1, size) for x in (u, y))
    (u, y), again = steady, _same_source(u)
    if again:  # repeats of one realisation are further periods of it
        u, y = (x.reshape(1, -1, size) for x in (u, y))
    found = best_linear_approximation(u, y, fs)
    gain = np.sqrt(np.mean(np.abs(found.h) ** 2))
    noise, distortion = (
        np.sqrt(np.mean(one**2)) / gain for one in (found.noise_std, found.distortion_std)
    )
    if np.isfinite(noise) and found.num_realisations > 1:
        yield (
            f"of the best linear approximation noise makes {_percent(noise)}; nonlinear distortion "
            f"is {_percent(distortion)} of it in one of {found.num_realisations} realisations."
        )
    elif np.isfinite(noise):
        yield (
            f"noise makes {_percent(noise)} of the response's mean over {found.num_periods} "
            "periods."
        )
    idle = detection_lines(u[0], y[0])
    shares = {"even": (idle.even, idle.num_even), "odd": (idle.odd, idle.num_odd)}
    told = [f"{name} lines {_percent(share)}" for name, (share, count) in shares.items() if count]
    if told:
        yield (
            f"lines without excitation, over those with it: {', '.join(told)}; noise "
            f"{_percent(idle.noise)}."
        )


def _noise(
    u: NDArray[np.float64], y: NDArray[np.float64], fs: float, role: Motion
) -> Iterator[str]:
    hz, coherence = coherence_at_resonance(u, y, fs, role)
    yield (
        f"coherence at the resonance ({hz:.4g} Hz) is {coherence:.3f}; what it lacks of 1 is "
        "noise, a window too short, or distortion."
    )


def coherence_at_resonance(
    u: NDArray[np.float64], y: NDArray[np.float64], fs: float, role: Motion
) -> tuple[float, float]:
    """Frequency of the strongest response [Hz], and the mean coherence about it.

    About it are the lines whose power is within a quarter of the largest; `u` and `y` have the
    shape (repeat, time), `role` is the response's.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the window, which is Step 2's to choose
        found = frf(u, y, fs, response=role)
    power = np.abs(found.h) ** 2 * found.input_spectrum
    near = power > power.max() / 4
    return float(found.freq[np.argmax(power)]), float(np.mean(found.coherence[near]))
