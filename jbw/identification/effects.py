"""How much the joint does: what it takes from the frequency and adds to the damping, in words.

Whether an interval of alpha or gamma contains zero says little: a joint may be known to be there,
and to do nothing that matters.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float

from jbw.identification.accuracy import thinned
from jbw.inference.summary import QUANTILES
from jbw.observables.joint import JOINT, joint_of
from jbw.oscillator.hysteresis import steady_loop

NUM_DRAWS = 200


class Effects(NamedTuple):
    """What the joint does at one amplitude, a value a draw.

    Attributes:
        frequency: Relative change of the natural frequency [-].
        damping: Damping ratio added, over zeta [-].
    """

    frequency: Float[np.ndarray, " draw"]
    damping: Float[np.ndarray, " draw"]


def effects(posterior: xr.Dataset, held: Mapping[str, float], y_peak: float) -> Effects | None:
    r"""What the joint does to frequency and damping at an amplitude, from its steady loop.

    $$\frac{\Delta\omega}{\omega_n} = \sqrt{\frac{k + k_{eq}}{\omega_n^2}} - 1, \qquad
      \frac{\Delta\zeta}{\zeta} = \frac{E}{2\pi\,\zeta\,\omega^2 Y^2}$$

    Args:
        posterior: Draws of alpha, delta, gamma and whatever of omega_n, zeta was sampled.
        held: The parameters that were not.
        y_peak: Amplitude Y [m].

    Returns:
        The effects; None where there is no damping to compare with, or no motion.

    Reference:
        Equivalent stiffness and damping of the steady loop of Eq. (2).
    """
    names = tuple(name for name in JOINT if name in posterior)
    theta = {**held, **thinned(posterior, names, NUM_DRAWS)}
    if not set(JOINT) <= set(theta) or not np.all(theta["zeta"]) or not y_peak > 0:
        return None
    alone = {name: jnp.broadcast_to(theta[name], len(theta[names[0]])) for name in JOINT}
    frequency, damping = _effects(alone, y_peak)
    return Effects(np.asarray(frequency), np.asarray(damping))


@jax.jit
def _effects(
    theta: Mapping[str, Array], y_peak: float
) -> tuple[Float[Array, " draw"], Float[Array, " draw"]]:
    joint = joint_of(theta)
    loop = steady_loop(joint, y_peak)
    square = joint.k + loop.k_eq
    added = loop.energy / (2 * jnp.pi * square * y_peak**2)
    return jnp.sqrt(square) / joint.omega_n - 1, added / joint.zeta


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
