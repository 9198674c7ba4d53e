"""The compared samples of records, or their spectral lines in a band, and their simulation."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jbw.errors import DataError
from jbw.measurement.channels import whole_down, whole_up
from jbw.observables.residual_terms import added_response, taken
from jbw.oscillator.batch import filled_up
from jbw.oscillator.deepening import OF_SEVERAL_MODES, with_depth
from jbw.oscillator.hold import HeldInput, held, namespace
from jbw.oscillator.law import laws_in
from jbw.oscillator.modes.parameters import (
    at_points,
    gain_ratios,
    has_further_modes,
    modal_structure_of,
    model_of,
    modes_apart,
    seen_by_points,
)
from jbw.oscillator.modes.structure import Structure, by_joint
from jbw.oscillator.oscillator import Oscillator, oscillator_of
from jbw.oscillator.response import simulate, simulate_apart
from jbw.quantities import DEFAULT_LAWS, LETTER_OF

# default number of solver steps per period, until a fit shows how many are needed
STEPS_A_PERIOD = 50.0
# index of the first compared line of a spectrum, and of the line after the last
Lines = tuple[int, int]


def lines_of(band_hz: Sequence[float], length: int, fs: float) -> Lines | None:
    """Return the index range (start, stop) of a band's spectral lines; raise if it is empty."""
    if not band_hz:
        return None
    first, last = whole_up(band_hz[0] * length / fs), whole_down(band_hz[1] * length / fs)
    lines = max(first, 1), min(last, (length - 1) // 2) + 1
    if lines[1] <= lines[0]:
        raise DataError(
            "Key `band` must contain a spectral line of the records, which lie "
            f"{fs / length:.3g} Hz apart up to {fs / 2:g} Hz, but is {list(band_hz)}.",
            remedy="Widen `band`, or leave `band` out.",
        )
    return lines


def in_band(samples: np.ndarray, lines: Lines | None) -> np.ndarray:
    """Return samples along the last axis, restricted to the spectral lines of a band."""
    if lines is None:
        return samples
    spectrum = np.fft.rfft(samples)
    masked = np.zeros_like(spectrum)
    masked[..., lines[0] : lines[1]] = spectrum[..., lines[0] : lines[1]]
    return np.fft.irfft(masked, samples.shape[-1])


def noise_share(lines: Lines | None, length: int) -> float:
    """Return the share of white noise that lies in a band, as a ratio of standard deviations."""
    return 1.0 if lines is None else float(np.sqrt(2 * (lines[1] - lines[0]) / length))


def values_of(samples: Float[Array | np.ndarray, "*batch time"], lines: Lines | None) -> Any:
    r"""Return the samples, or a band's lines $\sqrt{2/N}\,(\mathrm{Re}\,X_n, \mathrm{Im}\,X_n)$."""
    if lines is None:
        return samples
    xp = namespace(samples)
    spectrum = xp.fft.rfft(samples)[..., lines[0] : lines[1]]
    scale = np.sqrt(2 / samples.shape[-1])
    return scale * xp.concatenate([spectrum.real, spectrum.imag], axis=-1)


def loudest_hz(means: Float[np.ndarray, "level time"], fs: float) -> float:
    """Return the frequency [Hz] at which all responses together have the most power."""
    power = np.sum(np.abs(np.fft.rfft(means)) ** 2, axis=0)
    return float(np.fft.rfftfreq(means.shape[1], 1 / fs)[np.argmax(power)])


def substeps_for(hz: float, fs: float, least: int) -> int:
    """Return the number of solver steps per sample, a power of two: about 50 per period."""
    steps = max(STEPS_A_PERIOD * hz / fs, least)
    return 2 ** whole_up(float(np.log2(steps)))


def band_limited(
    source: Float[np.ndarray | Array, "*level time"], *, periodic: bool = False
) -> HeldInput:
    """Interpolate a measured input between its samples as a band-limited signal."""
    return held(source, "band_limited", periodic=periodic)


@eqx.filter_jit
def _models(
    theta: Mapping[str, Array], laws: tuple[str, ...], depth: int | None
) -> Oscillator | Structure:
    def model(point: Mapping[str, Array]) -> Oscillator | Structure:
        if not has_further_modes(point):
            return with_depth(oscillator_of(point, laws), depth)
        structure = at_points(point, modal_structure_of(point, laws))
        # `jbw.simulate` starts with this number of load reversals if several modes move.
        deep = None if depth is None else max(depth, OF_SEVERAL_MODES)
        return with_depth(by_joint(structure), deep)

    return jax.vmap(model)(dict(theta))


def models_at(
    theta: Mapping[str, Float[np.ndarray, " point"]],
    laws: tuple[str, ...],
    *,
    depth: int | None = None,
) -> Oscillator | Structure | None:
    """Return the models at many parameter points, repeated to fill a batch of the solver.

    They are oscillators, or structures with an axis of joints and one output per measured point.
    Their laws remember `depth` reversals. None is returned if a law needs a stock solver.
    """
    models = _models(jax.device_put(filled_up(dict(theta))), laws, depth)
    several = isinstance(models, Structure)
    suited = (law.stepped and not (several and law.feels_rate) for law in laws_in(models.laws))
    return models if all(suited) else None


def joints_at(
    theta: Mapping[str, Float[np.ndarray, " point"]], laws: tuple[str, ...]
) -> Oscillator | None:
    """Return oscillators at many parameter points as `models_at` does; None for several modes."""
    if has_further_modes(theta):
        return None
    return models_at(theta, laws)  # pyright: ignore[reportReturnType]


def motion_under(
    theta: Mapping[str, Array],
    source: HeldInput,
    fs: float,
    *,
    laws: tuple[str, ...] = DEFAULT_LAWS,
    substeps: int = 2,
    depth: int | None = None,
    every_point: bool = False,
) -> Any:
    """Return the motion of the joint by eqs. (1), (2) under a measured input, from rest or steady.

    If theta has several modes (`jbw.oscillator.modes.parameters`), the motion is that of the
    structure's output or, with `every_point`, of its outputs at all points along a first axis.

    The `source` is that of `band_limited`; theta also contains the `gain` [N/kg per unit of the
    input]. `substeps` are solver steps between samples; `depth` is the number of reversals that
    Masing laws remember.
    """
    force = source.times(theta["gain"])
    if (apart := modes_apart(theta, laws)) is not None:
        deep = [with_depth(oscillator, depth) for oscillator in apart]
        seen = seen_by_points(theta, len(deep))
        c = seen if every_point else seen[0]
        return simulate_apart(deep, gain_ratios(theta), c, force, fs, substeps=substeps)
    model = with_depth(model_of(theta, laws), depth)
    if every_point and isinstance(model, Structure):
        model = at_points(theta, model)
    return simulate(model, force, fs, substeps=substeps)


def response_to(
    theta: Mapping[str, Array],
    source: HeldInput,
    fs: float,
    *,
    response: str = "velocity",
    residuals: str = "none",
    **options: Any,
) -> Float[Array, "*point time"]:
    """Return the displacement [m], velocity [m/s] or acceleration [m/s^2] under a measured input.

    The contribution of modes outside the band is included if theta has it and `residuals` asks for
    it. With additional points theta has none, because a term of the first point does not hold
    there.
    """
    motion = motion_under(theta, source, fs, **options)
    return response_of(motion, theta, source, fs, response=response, residuals=residuals)


def response_of(
    motion: Any,
    theta: Mapping[str, Array],
    source: HeldInput,
    fs: float,
    *,
    response: str,
    residuals: str,
) -> Float[Array, "*point time"]:
    """Return a sensor's response to a given motion under an input, including residual terms."""
    sensed = getattr(motion, LETTER_OF[response])
    return sensed + response_of_terms(theta, source, fs, response=response, residuals=residuals)


def response_of_terms(
    theta: Mapping[str, Array], source: HeldInput, fs: float, *, response: str, residuals: str
) -> Any:  # Float[Array, " time"] | float
    """Return the response of those residual terms in theta that a test includes; 0 without any."""
    if not (terms := taken(theta, residuals)):
        return 0.0
    added = added_response(terms, source.samples, fs, response=response, periodic=source.periodic)
    return theta["gain"] * added
