"""Properties of one draw of a joint for other programs: linear part, curves, loops, materials."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.oscillator.laws.masing import Masing
from jbw.oscillator.laws.sliders import Sliders, lost_by, sliders_of
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.parameters import Material
from jbw.oscillator.steady.backbone import backbone
from jbw.verification.predicted import carry
from jbw.verification.predictive_basis import Draws, Laws

PARTS = (0.25, 0.5, 1.0)  # amplitudes of the loops, relative to the largest displacement
NUM_PHASES = 100  # number of points on half a loop
REACH = 2.0  # range of the sliders that represent a law, relative to the largest displacement
# number of points of a skeleton curve in addition to its origin, because Ansys accepts twenty in
# all
NUM_POINTS = 19

Table = dict[str, NDArray[np.float64]]


def linear_parts(theta: Mapping[str, float], laws: Laws, mass: float) -> dict[str, float]:
    """Return the linear part of a joint: modal mass [kg], spring [N/m] and dashpot [N s/m]."""
    joint = oscillator_of(theta, laws)
    dashpot = 2.0 * mass * theta["zeta"] * theta["omega_n"]
    return {"mass": mass, "spring": mass * float(joint.k), "dashpot": dashpot}


# -- curves ----------------------------------------------------------------------------------------
def skeletons(draws: Draws, y_max: float, laws: Laws, mass: float) -> list[Table]:
    """Return each draw's force-displacement curve, with equivalent spring and dashpot.

    `tip_force_n` is at the tips of steady loops, `virgin_force_n` on the first loading from rest;
    both are of spring and laws without dampers. `stiffness_n_m` and `damping_ns_m` are a spring and
    a dashpot with the resonance and the loss of the whole joint at that amplitude.
    """
    y = y_max * np.arange(1, NUM_POINTS + 1) / NUM_POINTS
    columns = carry(_skeleton, draws, jnp.asarray(y), laws)
    names = ("tip_force_n", "virgin_force_n", "stiffness_n_m", "damping_ns_m")
    return [
        {
            "displacement_m": y,
            **dict(zip(names, (mass * np.asarray(x) for x in forces), strict=True)),
        }
        for forces in zip(*columns, strict=True)
    ]


def _skeleton(
    theta: Mapping[str, jax.Array], y: Float[Array, " point"], laws: Laws
) -> tuple[Float[Array, " point"], ...]:
    joint = oscillator_of(theta, laws)
    slow = joint.undamaged

    def forces(at: Array) -> tuple[Array, Array]:
        tip = slow.force(at, 0.0, slow.at_tip(at))
        virgin = slow.force(at, 0.0, slow.move(0.0 * at, slow.at_rest(), at))
        return slow.k * at + tip, slow.k * at + virgin  # pyright: ignore[reportReturnType]

    curve = backbone(joint, y)
    return (*jax.vmap(forces)(y), curve.omega**2, 2.0 * curve.zeta * curve.omega)


def static_loops(one: Draws, y_max: float, laws: Laws, mass: float) -> Table:
    """Return steady loops of slow motion: force of the spring and the laws without dampers [N]."""
    peaks = y_max * np.asarray(PARTS)
    half = peaks[:, None] * np.cos(np.linspace(0.0, np.pi, NUM_PHASES + 1)[:-1])
    down = carry(_force_unloading, one, jnp.asarray(peaks), jnp.asarray(half), laws)[0]
    even = carry(_even_force, one, jnp.asarray(half), laws)[0]
    # The loading curve is the unloading curve rotated about the origin, unless a force is even. The
    # end of the loading curve closes the loop.
    y = np.concatenate([half, -half, half[:, :1]], axis=1)
    force = np.concatenate([down, 2.0 * even - down, down[:, :1]], axis=1)
    around = np.repeat(peaks, y.shape[1])
    return {"y_peak_m": around, "displacement_m": y.ravel(), "force_n": mass * force.ravel()}


def _force_unloading(
    theta: Mapping[str, jax.Array], peaks: jax.Array, y: jax.Array, laws: Laws
) -> jax.Array:
    """Return the force of the spring and all laws during unloading from each peak [N/kg]."""
    joint = oscillator_of(theta, laws).undamaged
    return joint.k * y + jax.vmap(joint.force_unloading)(peaks, y)  # pyright: ignore[reportReturnType]


def _even_force(theta: Mapping[str, jax.Array], y: jax.Array, laws: Laws) -> jax.Array:
    """Return the part of the force that is an even function of displacement [N/kg]."""
    springs = (law for law in oscillator_of(theta, laws).laws if law.is_even)
    return sum((law.force(y, 0.0, ()) for law in springs), 0.0 * y)  # pyright: ignore[reportReturnType]


# -- materials -------------------------------------------------------------------------------------
def materials_of(
    theta: Mapping[str, float], laws: Laws, mass: float, y_max: float
) -> tuple[Material, ...]:
    """Return OpenSees materials for the spring and all laws; empty if one of them has no material.

    Masing laws are represented by sliders up to `REACH` times the largest displacement.
    """
    joint = oscillator_of(theta, laws)
    if not joint.laws:
        return ()
    materials = [Material("Elastic", (mass * float(joint.k),))]
    for law in joint.laws:
        conversions = law.convert(theta["omega_n"], theta["zeta"], mass).values()
        law_materials = next(
            (conversion.materials for conversion in conversions if conversion.materials), ()
        )
        if law.depth:
            sliders = sliders_of(law, REACH * y_max)  # pyright: ignore[reportArgumentType]
            law_materials = _in_parallel(sliders, mass)
        if not law_materials:
            return ()
        materials += law_materials
    return tuple(materials)


def _in_parallel(sliders: Sliders, mass: float) -> tuple[Material, ...]:
    """Return OpenSees materials for a law's sliders and for its spring that never slips."""
    pairs = zip(sliders.stiffness, sliders.slip, strict=True)
    slipping = (Material("ElasticPP", (mass * float(k), float(slip))) for k, slip in pairs)
    return Material("Elastic", (mass * sliders.spring,)), *slipping


def error_of_sliders(law: Masing, y_max: float) -> float:
    """Return the sliders' largest relative error of loss per cycle, at 10 to 100 % of `y_max`."""
    peaks = y_max * np.linspace(0.1, 1.0, 10)
    exact = np.pi * peaks**2 * np.asarray(jax.vmap(lambda y: law.loop(y).damping)(peaks))
    return float(np.max(np.abs(lost_by(sliders_of(law, REACH * y_max), peaks) / exact - 1.0)))
