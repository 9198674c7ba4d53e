"""Response records under a measured input (sweeps, noise): reduction, prediction, likelihood."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.errors import DataError
from jbw.measurement.records import Test
from jbw.observables.joint import joint_of
from jbw.observables.repeats import OFFSETS, Repeats, repeats
from jbw.observables.runs import run_of
from jbw.observables.spectral_lines import Lines, in_band, lines_of, values_of
from jbw.oscillator.response import Response, simulate

LETTER = {"displacement": "y", "velocity": "v", "acceleration": "a"}


class Records(eqx.Module):
    """Repeats of several levels, each reduced to its sufficient statistics.

    Attributes:
        source: Mean measured input of each level [V, N or N/kg].
        mean: Mean measured response of each level [m, m/s or m/s^2].
        repeats: Their repeats, a group a level.
        origin: omega_n [rad/s] and zeta of each level's own run, where runs have offsets: where the
            prediction is made and linearised in them. A record follows the phase for so many
            periods that no line through the common omega_n reaches another day's.
        fs: Sampling frequency [Hz]; static.
        response: displacement, velocity or acceleration; static.
        substeps: Steps of the solver between samples; static.
        periodic: Whether each record is one period of a steady motion; static.
        lines: First line of the records' spectra that is compared, and the one after the last;
            None compares the samples. Other modes then only act on the rest; static.
    """

    source: Float[Array, "level time"]
    mean: Float[Array, "level time"]
    repeats: Repeats
    origin: Float[Array, "level own"]
    fs: float = eqx.field(static=True)
    response: str = eqx.field(static=True, default="velocity")
    substeps: int = eqx.field(static=True, default=2)
    periodic: bool = eqx.field(static=True, default=False)
    lines: Lines | None = eqx.field(static=True, default=None)


def reduce(tests: Sequence[Test], *, substeps: int = 2, periodic: bool = False) -> Records:
    """Sufficient statistics of the repeats of each test.

    Args:
        tests: One test a level, all of one length, sampling frequency, response and band; of equal
            inputs in all repeats. With a band, only its lines of the spectrum are compared.
        substeps: Steps of the solver between samples.
        periodic: Whether each record is one period of a steady motion.

    Returns:
        The reduced records.

    Raises:
        DataError: If lengths, sampling frequencies, responses or bands differ.
    """
    forms = {form_of(test) for test in tests}
    if len(forms) != 1:
        raise DataError(
            "Tests reduced together must share sampling frequency, response, length and band, but "
            f"found {sorted(forms)}.",
            remedy="Reduce them apart, or cut the records to one length.",
        )
    fs, response, length, *band_hz = forms.pop()
    lines = lines_of(band_hz, length, fs)
    sources = [np.stack([r.channels[r.source] for r in t.records]) for t in tests]
    responses = [
        np.stack([advance(r.channels[response], t.delay, fs) for r in t.records]) for t in tests
    ]
    responses = [in_band(r, lines) for r in responses]
    means = np.stack([r.mean(axis=0) for r in responses])
    # In a band, the scatter over time is that over its lines.
    within = [np.sum((r - m) ** 2) for r, m in zip(responses, means, strict=True)]
    size = length if lines is None else 2 * (lines[1] - lines[0])
    return Records(
        source=jnp.asarray(np.stack([s.mean(axis=0) for s in sources])),
        mean=jnp.asarray(means),
        repeats=repeats(
            within=np.array(within),
            num_repeats=np.array([len(r) for r in responses]),
            sizes=np.full(len(tests), size),
            longest=size,
            labels=tuple(test.name for test in tests),
            runs=tuple(run_of(test) for test in tests),
            scale=np.sqrt(np.sum(means**2, axis=1) / size),
        ),
        origin=jnp.zeros((len(tests), 0)),
        fs=fs,
        response=response,
        substeps=substeps,
        periodic=periodic,
        lines=lines,
    )


def form_of(test: Test) -> tuple[float, str, int, *tuple[float, ...]]:
    """Sampling frequency, response, length and band, which tests reduced together must share."""
    record = test.records[0]
    return record.fs, record.response, record.num_samples, *(test.band_hz or ())


def advance(samples: np.ndarray, delay: float, fs: float) -> np.ndarray:
    r"""Undo a channel's delay by the phase of its spectrum.

    $$x(t + \tau) \leftrightarrow X(\omega)\,e^{+j\omega\tau}$$

    Args:
        samples: Samples of one channel, at rest at both ends.
        delay: Lag tau behind the input channel [s].
        fs: Sampling frequency [Hz].

    Returns:
        The samples, `delay` seconds earlier.
    """
    if delay == 0.0:
        return samples
    omega = 2 * np.pi * np.fft.rfftfreq(len(samples), 1 / fs)
    return np.fft.irfft(np.fft.rfft(samples) * np.exp(1j * omega * delay), len(samples))


def response_to(
    theta: Mapping[str, Array],
    source: Float[Array, " time"],
    fs: float,
    *,
    response: str = "velocity",
    substeps: int = 2,
    periodic: bool = False,
) -> Float[Array, " time"]:
    """Response of the joint to a measured input, from rest or steady.

    Args:
        theta: The joint's five parameters and `gain` [N/kg per unit of the input].
        source: Measured input [unit of the input].
        fs: Sampling frequency [Hz].
        response: displacement, velocity or acceleration.
        substeps: Steps of the solver between samples.
        periodic: Whether the input is one period of a steady test.

    Returns:
        Displacement [m], velocity [m/s] or acceleration [m/s^2].

    Reference:
        Eqs. (1), (2).
    """
    motion = motion_under(theta, source, fs, substeps=substeps, periodic=periodic)
    return getattr(motion, LETTER[response])


def motion_under(
    theta: Mapping[str, Array],
    source: Float[Array, " time"],
    fs: float,
    *,
    substeps: int = 2,
    periodic: bool = False,
) -> Response:
    """Motion of the joint under a measured input, as of `response_to`.

    The input between its samples is the band-limited one that the sampling saw.
    """
    return simulate(
        joint_of(theta),
        theta["gain"] * source,
        fs,
        hold="band_limited",
        substeps=substeps,
        periodic=periodic,
    )


def predict(theta: Mapping[str, Array], data: Records) -> Float[Array, "level time"]:
    """Response of every level to its mean measured input, at its own origin where it has one.

    Args:
        theta: The joint's five parameters and `gain`.
        data: The reduced records.

    Returns:
        Predicted response, in the unit of the measured one.
    """

    def one(level: tuple[Array, Array]) -> Float[Array, " time"]:
        source, origin = level
        own = dict(zip(OFFSETS, origin, strict=False))  # none where runs have no offsets
        return response_to(
            {**theta, **own},
            source,
            data.fs,
            response=data.response,
            substeps=data.substeps,
            periodic=data.periodic,
        )

    # One level after another, not as lanes: alone, the solver skips the work of rare events.
    return jax.lax.map(one, (data.source, data.origin))


def compare(theta: Mapping[str, Array], data: Records) -> Float[Array, "level value"]:
    r"""Mean measured response of every level less its prediction, where they are compared.

    $$d - m(o) - J^T (\theta - o)$$

    where the level has an origin o of omega_n and zeta.
    """
    left = values_of(data.mean - predict(theta, data), data.lines)
    if not data.origin.shape[1]:
        return left
    away = jnp.stack([theta[name] for name in OFFSETS]) - data.origin
    return left - jnp.einsum("lo,lov->lv", away, data.repeats.directions)


def squares(theta: Mapping[str, Array], data: Records) -> Float[Array, " level"]:
    r"""Sum of squared residuals of all repeats, level by level.

    $$Q = \sum_k |d_k - m|^2 = K\,|\bar d - m|^2 + S$$
    """
    misfit = jnp.sum(compare(theta, data) ** 2, axis=-1)
    return data.repeats.num_repeats * misfit + data.repeats.within
