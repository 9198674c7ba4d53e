"""Equivalent frequency and damping: how much the joint takes and adds, in words.

Whether an interval of alpha or gamma contains zero says little: a joint may be known to be there,
and to do nothing that matters.
"""

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float

from jbw.identification.accuracy import thinned
from jbw.inference.posterior.finding import Finding
from jbw.inference.posterior.summary import QUANTILES
from jbw.inference.posterior.verdict import bands_finding
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.oscillator import oscillator_of
from jbw.quantities import OSCILLATOR

NUM_DRAWS = 200
SHARES = (0.1, 0.3, 1.0)  # of the largest amplitude: where the response is looked at


class Effects(NamedTuple):
    """What the joint does at one amplitude, a value a draw.

    Attributes:
        frequency: Relative change of the natural frequency [-].
        damping: Damping ratio added, over zeta [-].
    """

    frequency: Float[np.ndarray, " draw"]
    damping: Float[np.ndarray, " draw"]


def effects(
    posterior: xr.Dataset,
    held: Mapping[str, float],
    y_peak: float,
    laws: tuple[str, ...] = ("bouc_wen",),
) -> Effects | None:
    r"""What the joint does to frequency and damping at an amplitude, from its steady loop.

    $$\frac{\Delta\omega}{\omega_n} = \sqrt{\frac{k + k_{eq}}{\omega_n^2}} - 1, \qquad
      \frac{\Delta\zeta}{\zeta} = \frac{E}{2\pi\,\zeta\,\omega^2 Y^2}$$

    Args:
        posterior: Draws of the laws' parameters and whatever of omega_n, zeta was sampled.
        held: The parameters that were not.
        y_peak: Amplitude Y [m].
        laws: Names of the laws of the joint.

    Returns:
        The effects; None where there is no damping to compare with, or no motion.

    Reference:
        Equivalent stiffness and damping of the steady loop of Eq. (2).
    """
    joint = _names(laws)
    names = tuple(name for name in joint if name in posterior)
    theta = {**held, **thinned(posterior, names, NUM_DRAWS)}
    if not (laws and _complete(theta, joint, y_peak)) or not np.all(theta["zeta"]):
        return None
    alone = {name: jnp.broadcast_to(theta[name], len(theta[names[0]])) for name in joint}
    shift, added = _effects(alone, y_peak, laws)
    return Effects(np.asarray(shift), np.asarray(added / alone["zeta"]))


def response_finding(
    posterior: xr.Dataset,
    held: Mapping[str, float],
    y_peak: float,
    laws: tuple[str, ...] = ("bouc_wen",),
) -> Finding | None:
    r"""Whether chains agree on what response bands are made of, from every draw.

    $$\omega(Y) = \sqrt{k + k_{eq}}, \qquad \zeta(Y) = \zeta + \frac{E}{2\pi\,\omega^2 Y^2}$$

    Args:
        posterior: Draws of the laws' parameters and whatever of omega_n, zeta was sampled.
        held: The parameters that were not.
        y_peak: Largest amplitude fitted [m]; looked at from a tenth of it upwards.
        laws: Names of the laws of the joint.

    Returns:
        The finding; None where there is no motion, or a parameter is missing.
    """
    joint = _names(laws)
    theta = {**held, **{name: posterior[name].values for name in joint if name in posterior}}
    if not _complete(theta, joint, y_peak):
        return None
    alone = dict(zip(joint, np.broadcast_arrays(*(theta[name] for name in joint)), strict=True))
    flat = {name: jnp.asarray(values.ravel()) for name, values in alone.items()}
    shape = alone["omega_n"].shape
    seen = {}
    for share in SHARES:
        shift, added = _effects(flat, share * y_peak, laws)
        place = f"at {share * y_peak:.2g} m"
        seen[f"the natural frequency {place}"] = (1 + shift) * flat["omega_n"]
        seen[f"the damping {place}"] = flat["zeta"] + added
    return bands_finding({name: np.asarray(one).reshape(shape) for name, one in seen.items()})


def _names(laws: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters of the oscillator with these laws."""
    own = [quantity.name for quantity in OSCILLATOR if quantity.name != "gain"]
    return (*own, *(quantity.name for quantity in quantities_of(laws)))


def _complete(
    theta: Mapping[str, float | np.ndarray], names: tuple[str, ...], y_peak: float
) -> bool:
    return set(names) <= set(theta) and y_peak > 0


@partial(jax.jit, static_argnames="laws")
def _effects(
    theta: Mapping[str, Array], y_peak: float, laws: tuple[str, ...]
) -> tuple[Float[Array, " draw"], Float[Array, " draw"]]:
    """Relative change of the natural frequency, and damping ratio added."""
    joint = oscillator_of(theta, laws)
    loop = joint.loop(y_peak)
    square = joint.k + loop.stiffness
    return jnp.sqrt(square) / joint.omega_n - 1, loop.damping / (2 * square)


def effects_sentence(found: Effects, y_peak: float) -> str:
    """What the joint does, in words."""
    shift, added = (np.quantile(one, QUANTILES) for one in found)
    return (
        f"At {y_peak:.3g} m, the largest displacement fitted, the joint changes the natural "
        f"frequency by {_share(shift)} and adds {_share(added)} of zeta to the damping."
    )


def _share(quantiles: Float[np.ndarray, "3"]) -> str:
    low, middle, high = (f"{x:.0f}" if abs(x) >= 100 else f"{x:.2g}" for x in 100 * quantiles)
    return f"{middle} % [{low}, {high}]"
