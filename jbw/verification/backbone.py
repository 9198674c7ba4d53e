"""The backbone of the posterior, and the loops that bend it, as the report draws them."""

from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float

from jbw.oscillator.law import Law
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.steady.backbone import backbone
from jbw.verification.bands import QUANTILES, band
from jbw.verification.draws import Draws, Laws, parameter_names

NUM_AMPLITUDES = 40
CARRIED_ON = 1.25  # times the largest fitted displacement: how far the curves go on
PARTS = (0.25, 0.5, 1.0)  # of the largest fitted displacement: the loops
NUM_PHASES = 64  # of half a loop


def backbone_group(draws: Draws, y_peak: float, laws: Laws) -> xr.Dataset | None:
    r"""Natural frequency and equivalent damping against amplitude, and three steady loops.

    The loops are of the force Z of those laws that have a memory: down from the tip by the laws'
    own moves, and up again as its mirror,

    $$Z(y), \; -Y < y < Y \text{ on the way down}, \qquad Z(-y) = -Z(y)$$

    Args:
        draws: Parameters of the joint, one value a draw.
        y_peak: Largest displacement among what was fitted [m].
        laws: Laws of the joint.

    Returns:
        Bands over (quantile, amplitude) and (quantile, loop, phase); None where the draws lack a
        parameter of the joint, or no displacement is known.

    Reference:
        Eq. (2), its steady loop.
    """
    needed = set(parameter_names(laws)) - {"gain"}
    if not needed <= set(draws) or not 0.0 < y_peak < np.inf:
        return None
    amplitude = np.linspace(0.0, CARRIED_ON * y_peak, NUM_AMPLITUDES + 1)[1:]
    omega, zeta = map(np.asarray, _curves(draws, jnp.asarray(amplitude), laws))
    peaks = y_peak * np.asarray(PARTS)
    angle = np.linspace(0.0, np.pi, NUM_PHASES + 1)[:-1]
    half = peaks[:, None] * np.cos(angle)
    falling, stuck = map(np.asarray, _unloading(draws, jnp.asarray(peaks), jnp.asarray(half), laws))
    y, z = np.concatenate([half, -half], -1), np.concatenate([falling, -falling], -1)
    slip = z - stuck[:, None, None] * y
    curves, loops = ("quantile", "amplitude"), ("quantile", "loop", "phase")
    force = {"units": "N/kg", "long_name": "hysteretic force"}
    return xr.Dataset(
        {
            "frequency": (curves, band(omega / (2 * np.pi)), {"units": "Hz"}),
            "damping": (curves, band(zeta), {"units": "1"}),
            "loop_y": (("loop", "phase"), y, {"units": "m"}),
            "loop_z": (loops, band(z), force),
            "loop_slip": (loops, band(slip), {**force, "long_name": "Z less that without slip"}),
            "stuck": (
                "quantile",
                band(stuck),
                {"units": "1/s^2", "long_name": "stiffness of Z without slip"},
            ),
        },
        {"amplitude": ("amplitude", amplitude, {"units": "m"}), "quantile": list(QUANTILES)},
        {"y_fitted": float(y_peak)},
    )


@partial(jax.jit, static_argnames="laws")
def _curves(
    draws: Mapping[str, Array], amplitude: Float[Array, " amplitude"], laws: Laws
) -> tuple[Array, Array]:
    def one(theta: Mapping[str, Array]) -> tuple[Array, Array]:
        found = backbone(oscillator_of(theta, laws), amplitude)
        return found.omega, found.zeta

    return jax.vmap(one)(draws)


@partial(jax.jit, static_argnames="laws")
def _unloading(
    draws: Mapping[str, Array],
    peaks: Float[Array, " loop"],
    y: Float[Array, "loop phase"],
    laws: Laws,
) -> tuple[Float[Array, "draw loop phase"], Float[Array, " draw"]]:
    """Force of the laws with a memory on the way down from each peak, and their stiffness."""

    def along(law: Law, peak: Array, y: Float[Array, " phase"]) -> Float[Array, " phase"]:
        top = law.at_tip(peak)
        return jax.vmap(lambda to: law.force(to, -1.0, law.move(peak, top, to - peak)))(y)  # pyright: ignore[reportReturnType]

    def one(theta: Mapping[str, Array]) -> tuple[Array, Array]:
        hysteretic = [
            law for law in oscillator_of(theta, laws).laws if jax.tree.leaves(law.at_rest())
        ]
        force, stiffness = jnp.zeros_like(y), jnp.zeros(())
        for law in hysteretic:
            force += jax.vmap(partial(along, law))(peaks, y)
            stiffness += law.stiffness()
        return force, stiffness

    return jax.vmap(one)(draws)
