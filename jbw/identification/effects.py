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
from jbw.inference.finding import Finding
from jbw.inference.summary import QUANTILES
from jbw.inference.verdict import bands_finding
from jbw.observables.joint import JOINT, joint_of
from jbw.oscillator.hysteresis import steady_loop

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
    if not _complete(theta, y_peak) or not np.all(theta["zeta"]):
        return None
    alone = {name: jnp.broadcast_to(theta[name], len(theta[names[0]])) for name in JOINT}
    shift, added = _effects(alone, y_peak)
    return Effects(np.asarray(shift), np.asarray(added / alone["zeta"]))


def response_finding(
    posterior: xr.Dataset, held: Mapping[str, float], y_peak: float
) -> Finding | None:
    r"""Whether chains agree on what response bands are made of, from every draw.

    $$\omega(Y) = \sqrt{k + k_{eq}}, \qquad \zeta(Y) = \zeta + \frac{E}{2\pi\,\omega^2 Y^2}$$

    Args:
        posterior: Draws of alpha, delta, gamma and whatever of omega_n, zeta was sampled.
        held: The parameters that were not.
        y_peak: Largest amplitude fitted [m]; looked at from a tenth of it upwards.

    Returns:
        The finding; None where there is no motion, or a parameter is missing.
    """
    theta = {**held, **{name: posterior[name].values for name in JOINT if name in posterior}}
    if not _complete(theta, y_peak):
        return None
    alone = dict(zip(JOINT, np.broadcast_arrays(*(theta[name] for name in JOINT)), strict=True))
    flat = {name: jnp.asarray(values.ravel()) for name, values in alone.items()}
    shape = alone["omega_n"].shape
    seen = {}
    for share in SHARES:
        shift, added = _effects(flat, share * y_peak)
        place = f"at {share * y_peak:.2g} m"
        seen[f"the natural frequency {place}"] = (1 + shift) * flat["omega_n"]
        seen[f"the damping {place}"] = flat["zeta"] + added
    return bands_finding({name: np.asarray(one).reshape(shape) for name, one in seen.items()})


def _complete(theta: Mapping[str, float | np.ndarray], y_peak: float) -> bool:
    return set(JOINT) <= set(theta) and y_peak > 0


@jax.jit
def _effects(
    theta: Mapping[str, Array], y_peak: float
) -> tuple[Float[Array, " draw"], Float[Array, " draw"]]:
    """Relative change of the natural frequency, and damping ratio added."""
    joint = joint_of(theta)
    loop = steady_loop(joint, y_peak)
    square = joint.k + loop.k_eq
    added = loop.energy / (2 * jnp.pi * square * y_peak**2)
    return jnp.sqrt(square) / joint.omega_n - 1, added


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
