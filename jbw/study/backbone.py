"""The backbone of the posterior, and the loops that bend it, as the report draws them."""

from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float

from jbw.observables.joint import JOINT, joint_of
from jbw.oscillator.backbone import backbone
from jbw.oscillator.hysteresis import hysteresis_map, steady_loop
from jbw.prediction import QUANTILES, Draws, band

NUM_AMPLITUDES = 40
BEYOND = 1.25  # times the largest fitted displacement: how far the curves go on
PARTS = (0.25, 0.5, 1.0)  # of the largest fitted displacement: the loops
NUM_PHASES = 64  # of half a loop


def backbone_group(draws: Draws, y_peak: float) -> xr.Dataset | None:
    r"""Natural frequency and equivalent damping against amplitude, and three steady loops.

    $$Z(y) = M\!\left(Z_{max},\, y - Y\right) \text{ on the way down}, \qquad Z(-y) = -Z(y)$$

    where M moves the hysteretic force along a monotone path.

    Args:
        draws: Parameters of the joint, one value a draw.
        y_peak: Largest displacement among what was fitted [m].

    Returns:
        Bands over (quantile, amplitude) and (quantile, loop, phase); None where the draws lack a
        parameter of the joint, or no displacement is known.

    Reference:
        Eq. (2), its steady loop.
    """
    if not set(JOINT) <= set(draws) or not 0.0 < y_peak < np.inf:
        return None
    amplitude = np.linspace(0.0, BEYOND * y_peak, NUM_AMPLITUDES + 1)[1:]
    omega, zeta = map(np.asarray, _curves(draws, jnp.asarray(amplitude)))
    peaks = y_peak * np.asarray(PARTS)
    angle = np.linspace(0.0, np.pi, NUM_PHASES + 1)[:-1]
    half = peaks[:, None] * np.cos(angle)
    falling = np.asarray(_unloading(draws, jnp.asarray(peaks), jnp.asarray(half)))
    y, z = np.concatenate([half, -half], -1), np.concatenate([falling, -falling], -1)
    slip = z - draws["alpha"][:, None, None] * y
    curves, loops = ("quantile", "amplitude"), ("quantile", "loop", "phase")
    force = {"units": "N kg-1", "long_name": "hysteretic force"}
    return xr.Dataset(
        {
            "frequency": (curves, band(omega / (2 * np.pi)), {"units": "Hz"}),
            "damping": (curves, band(zeta), {"units": "1"}),
            "loop_y": (("loop", "phase"), y, {"units": "m"}),
            "loop_z": (loops, band(z), force),
            "loop_slip": (loops, band(slip), {**force, "long_name": "Z less that without slip"}),
            "stuck": ("quantile", band(draws["alpha"]), {"units": "s-2", "long_name": "alpha"}),
        },
        {"amplitude": ("amplitude", amplitude, {"units": "m"}), "quantile": list(QUANTILES)},
        {"y_fitted": float(y_peak)},
    )


@jax.jit
def _curves(
    draws: Mapping[str, Array], amplitude: Float[Array, " amplitude"]
) -> tuple[Array, Array]:
    def one(theta: Mapping[str, Array]) -> tuple[Array, Array]:
        found = backbone(joint_of(theta), amplitude)
        return found.omega, found.zeta

    return jax.vmap(one)(draws)


@jax.jit
def _unloading(
    draws: Mapping[str, Array], peaks: Float[Array, " loop"], y: Float[Array, "loop phase"]
) -> Float[Array, "draw loop phase"]:
    def one(theta: Mapping[str, Array]) -> Array:
        joint = joint_of(theta)
        top = steady_loop(joint, peaks).z_max
        return jax.vmap(partial(hysteresis_map, joint))(top, y - peaks[:, None])

    return jax.vmap(one)(draws)
