"""The best linear oscillator of the same tests: what a model without a joint leaves unexplained."""

from collections.abc import Mapping
from dataclasses import replace

import jax.numpy as jnp

from jbw.inference.box import box
from jbw.inference.costly_fit import costly_fit
from jbw.observables.decay import Decays
from jbw.observables.evidence import Evidence, Repeated, evidence, residual
from jbw.observables.harmonics import Points
from jbw.observables.linear import LineReading
from jbw.observables.loops import Loops
from jbw.observables.response import Records

# A joint that carries a millionth of a newton per kg at most; none at all has no derivatives.
SILENT = {"alpha": 1e-6, "delta": 1.0, "gamma": 1.0, "cubic": 0.0}
REACH = {"omega_n": (0.5, 1.5), "zeta": (1e-2, 1e2), "gain": (0.1, 10.0)}  # of the joint's own


def linear_reference(data: Evidence, known: Mapping[str, float]) -> dict[str, float] | None:
    r"""The linear oscillator that comes closest to all fitted tests.

    $$\min_{\omega_n, \zeta, g} \sum_i |d_i - m_i|^2 / |d_i|^2, \qquad Z = 0$$

    Every group of data counts by its relative error, so that no level is fitted at the others'
    expense. Line fits and free decays are left out: they have errors of another kind.

    Args:
        data: What the joint posterior was made from.
        known: omega_n, zeta and gain of the joint, from which the fit starts.

    Returns:
        Parameters of a joint that carries no force, and the gain; None where nothing else than
        line fits and decays was fitted.
    """
    parts = [_evenly(part) for part in data.parts if not isinstance(part, LineReading | Decays)]
    if not parts:
        return None
    held = {name: float(value) for name, value in data.held.items() if name in REACH} | SILENT
    free = [name for name in REACH if name not in held]
    forced = [part for part in parts if isinstance(part, Loops)]
    if len(forced) == len(parts):
        return {**known, **held, "omega_n": _spring(forced[0], held.get("gain", known["gain"]))}
    bounds = {name: (REACH[name][0] * known[name], REACH[name][1] * known[name]) for name in free}
    start = {name: known[name] for name in free}
    # An error quoted to two digits needs no closer optimum.
    best = costly_fit(
        residual, box(bounds), evidence(parts, held),
        starts=start, max_evaluations=20, tolerance=1e-6,
    )  # fmt: skip
    return held | best.theta


def _spring(loops: Loops, gain: float) -> float:
    r"""Natural frequency of the spring that comes closest to prescribed-displacement loops.

    $$\omega_n^2 = g\, \sum_i \frac{F_i \cdot y_i}{|F_i|^2} \Big/ \sum_i
      \frac{y_i \cdot y_i}{|F_i|^2}$$
    """
    y = loops.counted * loops.displacement
    weight = 1 / jnp.sum(loops.mean**2, axis=-1, keepdims=True)
    stiffness = gain * jnp.sum(weight * loops.mean * y) / jnp.sum(weight * y**2)
    return float(jnp.sqrt(jnp.maximum(stiffness, 0.0)))


def _evenly(part: Repeated) -> Repeated:
    """A part whose groups count by their relative errors, whatever their noise and offsets."""
    own = part.repeats
    squares = jnp.sum(jnp.abs(part.mean) ** 2, axis=1)
    parts = 2 if isinstance(part, Points) else 1
    scale = jnp.sqrt(squares * parts / own.size)
    silent = jnp.where(scale > 0, scale, 1.0)
    even = replace(
        own,
        noise_std=silent,
        num_values=own.size,
        directions=jnp.zeros_like(own.directions[:, :0]),
    )
    if isinstance(part, Records):
        return replace(part, repeats=even, origin=part.origin[:, :0])
    return replace(part, repeats=even)
