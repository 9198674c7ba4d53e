"""The joint's effect on frequency and damping at an amplitude, with sentences on it.

Whether an interval of alpha or gamma contains zero says little: a joint may be clearly detected and
yet have no effect that matters.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Float

from jbw.inference.lanes import FIT_LANES, at_points
from jbw.inference.posterior.finding import Amendment, Finding, usable_within
from jbw.inference.posterior.summary import QUANTILES, evenly_spaced, shape_of
from jbw.inference.posterior.verdict import bands_finding
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.steady.backbone import backbone
from jbw.quantities import DEFAULT_LAWS, OSCILLATOR, are_at_joints
from jbw.report.messages import effects as messages

NUM_DRAWS = 200
NUM_AMPLITUDES = 20  # number of amplitudes that one program evaluates
DAMPING = "quadratic_damping"  # law with damping and without hysteresis
# An effect is determined if the half width of its interval / its value is below this.
KNOWN = 0.2
# amplitudes at which the chains' responses are compared, relative to the largest fitted amplitude
SHARES = (0.1, 0.3, 1.0)


class Effects(NamedTuple):
    """The joint's effect: relative frequency change, and added damping ratio divided by zeta."""

    frequency: Float[np.ndarray, " draw"]
    damping: Float[np.ndarray, " draw"]


def effects(
    posterior: xr.Dataset,
    held: Mapping[str, Any],
    y_peak: float,
    laws: tuple[str, ...] = DEFAULT_LAWS,
) -> Effects | None:
    r"""Return the change of frequency and damping that the joint causes at an amplitude Y [m].

    $$\frac{\Delta\omega}{\omega_n} = \sqrt{\frac{k + k_{eq}}{\omega_n^2}} - 1, \qquad
      \frac{\Delta\zeta}{\zeta} = \frac{E}{2\pi\,\zeta\,\omega^2 Y^2}$$

    `held` contains the parameters that were not sampled. None without a law, without damping to
    compare with, or without motion.

    Reference:
        Equivalent stiffness and damping of the steady loop of Eq. (2).
    """
    theta = _joint_draws(posterior, held, laws)
    if theta is None or not (laws and y_peak > 0 and np.all(theta["zeta"])):
        return None
    keep = evenly_spaced(posterior, NUM_DRAWS)
    thinned = {name: values[keep] for name, values in theta.items()}
    shift, added = _effects(thinned, [y_peak], laws)
    return Effects(shift[:, 0], added[:, 0] / thinned["zeta"])


def only_damps(found: Effects) -> bool:
    """Return whether the joint certainly (99 %) adds damping without changing the frequency."""
    low, _, high = np.quantile(found.frequency, QUANTILES)
    return bool(low <= 0.0 <= high and np.quantile(found.damping, QUANTILES[0]) > 0.0)


def hysteresis_finding(
    found: Effects, y_peak: float, laws: Sequence[str], *, misses: bool
) -> Finding | None:
    """Return the finding of no hysteresis if the joint only adds damping.

    Hysteresis that adds damping reduces stiffness. None if hysteresis is found, or if damping by
    the square of the velocity is among the laws.
    """
    if DAMPING in laws or not only_damps(found):
        return None
    values = {
        "y": 1e3 * y_peak,
        "damping": np.quantile(found.damping, QUANTILES).tolist(),
        "frequency": np.quantile(found.frequency, QUANTILES).tolist(),
    }
    status, change = "failed" if misses else "usable", float(np.median(found.frequency))
    return Finding("no_hysteresis", status, values, change, {"law": DAMPING})


def response_finding(
    posterior: xr.Dataset,
    held: Mapping[str, Any],
    y_peak: float,
    laws: tuple[str, ...] = DEFAULT_LAWS,
) -> Finding | None:
    r"""Check whether chains agree on frequency and damping at given amplitudes, from all draws.

    $$\omega(Y) = \sqrt{k + k_{eq}}, \qquad \zeta(Y) = \zeta + \frac{E}{2\pi\,\omega^2 Y^2}$$

    from a tenth of the largest fitted amplitude, `y_peak` [m], upwards. None without motion or if a
    parameter is missing.
    """
    theta = _joint_draws(posterior, held, laws)
    if theta is None or y_peak <= 0:
        return None
    peaks, responses = [share * y_peak for share in SHARES], {}
    for y, shift, added in zip(
        peaks, *map(np.transpose, _effects(theta, peaks, laws)), strict=True
    ):
        responses[messages.frequency_at(y)] = (1 + shift) * theta["omega_n"]
        responses[messages.damping_at(y)] = theta["zeta"] + added
    shape = shape_of(posterior)
    return bands_finding({name: np.reshape(values, shape) for name, values in responses.items()})


def _joint_draws(
    posterior: xr.Dataset, held: Mapping[str, Any], laws: tuple[str, ...]
) -> dict[str, Float[np.ndarray, " draw"]] | None:
    """Return every draw of the oscillator's parameters; None if one is missing."""
    table = [*OSCILLATOR, *quantities_of(laws)]
    names = [quantity.name for quantity in table if quantity.name != "gain"]
    sampled = {name: posterior[name].values.ravel() for name in names if name in posterior}
    theta = {**held, **sampled}
    if not set(names) <= set(theta):
        return None
    # With several joints, the draws also need the fixed numbers of the reduced model.
    if are_at_joints(laws):
        names += [name for name in held if name not in names]
    return dict(zip(names, np.broadcast_arrays(*(theta[name] for name in names)), strict=True))


def _effects(
    theta: Mapping[str, np.ndarray], y_peak: Sequence[float], laws: tuple[str, ...]
) -> tuple[Float[np.ndarray, "draw amplitude"], Float[np.ndarray, "draw amplitude"]]:
    """Return the relative change of natural frequency and the added damping ratio of each draw."""
    omega, zeta, _ = backbones_at(theta, np.asarray(y_peak, float), laws)
    share = omega / theta["omega_n"][:, None]
    return share - 1, zeta - theta["zeta"][:, None] / share


def backbones_at(
    theta: Mapping[str, Float[np.ndarray, " point"]],
    y_peak: Float[np.ndarray, " amplitude"],
    laws: tuple[str, ...],
) -> tuple[Float[np.ndarray, "point amplitude"], ...]:
    """Return frequency [rad/s], damping and force [N/kg] of `jbw.backbone` at many points.

    One program per set of laws serves all numbers of points and of amplitudes.
    """
    if not are_at_joints(laws):  # At joints the numbers of the reduced model are needed, too.
        needed = {quantity.name for quantity in (*OSCILLATOR, *quantities_of(laws))} - {"gain"}
        theta = {name: values for name, values in theta.items() if name in needed}
    padded = np.pad(y_peak, (0, -len(y_peak) % NUM_AMPLITUDES), "edge").reshape(-1, NUM_AMPLITUDES)
    lots = jax.device_put([*padded])
    parts = [at_points(_backbone, theta, (lot, laws), lanes=FIT_LANES) for lot in lots]
    joined = (np.concatenate(some, axis=1) for some in zip(*parts, strict=True))
    return tuple(rows[:, : len(y_peak)] for rows in joined)


def _backbone(theta: Mapping[str, Array], seen: tuple[Array, tuple[str, ...]]) -> tuple[Array, ...]:
    y_peak, laws = seen
    curve = backbone(oscillator_of(theta, laws), y_peak)
    return curve.omega, curve.zeta, curve.amplitude


def within_response(
    posterior: xr.Dataset,
    held: Mapping[str, Any],
    y_peak: float,
    laws: tuple[str, ...] = DEFAULT_LAWS,
) -> Amendment | None:
    """Return an amendment that rates parameters usable if the data determine their effect.

    The effect is determined if the 99 % intervals of frequency and damping at the largest fitted
    displacement are narrow. Parameters that are open there change no response up to that
    displacement.
    """
    theta = _joint_draws(posterior, held, laws)
    if theta is None or not laws or y_peak <= 0:
        return None
    shift, added = _effects(theta, [y_peak], laws)
    spans = []
    for values in (shift[:, 0], theta["zeta"] + added[:, 0]):
        low, middle, high = np.quantile(values, QUANTILES)
        spans.append(float((high - low) / (2 * abs(middle))))
    if not all(span <= KNOWN for span in spans):
        return None
    return usable_within(("unidentified",), messages.known_together(y_peak, *spans))


def effects_sentence(found: Effects, y_peak: float) -> str:
    """Return the sentence on the joint's effect on frequency and damping."""
    shift, added = (np.quantile(values, QUANTILES).tolist() for values in found)
    return messages.of_joint(y_peak, shift, added)
