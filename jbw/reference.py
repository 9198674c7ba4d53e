"""Oscillators without hysteresis fitted to the same tests: what a joint must do better than."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from jbw.inference.box import box
from jbw.inference.costly_fit import costly_fit
from jbw.observables.decay import Decays
from jbw.observables.evidence import Evidence, Repeated, evidence, residual
from jbw.observables.linear import LineReading
from jbw.observables.loops import Loops
from jbw.observables.response import Records

# A joint that carries a millionth of a newton per kg at most; none at all has no derivatives.
SILENT = {"alpha": 1e-6, "delta": 1.0, "gamma": 1.0, "cubic": 0.0}
REACH = {"omega_n": (0.5, 1.5), "zeta": (1e-2, 1e2), "gain": (0.1, 10.0)}  # of the joint's own
STIFFEST = 10.0  # times omega_n^2 at the largest displacement: bound of the cubic stiffness
Oscillator = dict[str, float]


def references(
    data: Evidence, known: Mapping[str, float], y_peak: float, kinds: Sequence[str] = ("linear",)
) -> dict[str, Oscillator]:
    r"""The linear and the cubic oscillator that come closest to all fitted tests.

    $$\min \sum_i |d_i - m_i|^2 / |d_i|^2, \qquad
      \ddot y + 2\zeta\omega_n\dot y + \omega_n^2 y + \lambda_3 y^3 = g u$$

    with lambda_3 = 0 for the linear one. Every group of data counts by its relative error, so that
    no level is fitted at the others' expense. Line fits are left out, and so are free decays beside
    other tests: they have errors of another kind.

    Args:
        data: What the joint posterior was made from.
        known: omega_n, zeta and gain of the joint, from which the fit starts.
        y_peak: Largest displacement measured [m].
        kinds: Which, among linear and cubic.

    Returns:
        By kind, the parameters of a joint that carries no force, and the gain; empty where nothing
        else than line fits was fitted.
    """
    parts = [_evenly(part) for part in data.parts if not isinstance(part, LineReading | Decays)]
    parts = parts or [part for part in data.parts if isinstance(part, Decays)]
    if not parts:
        return {}
    held = {name: float(value) for name, value in data.held.items() if name in REACH} | SILENT
    found = {}
    forced = [part for part in parts if isinstance(part, Loops)]
    for kind in kinds:
        if len(forced) == len(parts):
            spring = _spring(forced, held.get("gain", known["gain"]), kind)
            found[kind] = {**known, **held, **spring}
        else:
            start = found.get("linear", known)
            found[kind] = _fitted(evidence(parts, held), start, y_peak, kind)
    return found


def _fitted(data: Evidence, known: Mapping[str, float], y_peak: float, kind: str) -> Oscillator:
    """The oscillator of one kind with the least relative error."""
    free = [name for name in REACH if name not in data.held and name in known]
    bounds = {name: (REACH[name][0] * known[name], REACH[name][1] * known[name]) for name in free}
    start = {name: known[name] for name in free}
    held = {name: float(value) for name, value in data.held.items()}
    if kind == "cubic":
        most = STIFFEST * known["omega_n"] ** 2 / y_peak**2
        bounds["cubic"], start["cubic"] = (-most, most), 0.0
        held.pop("cubic")
    # An error quoted to two digits needs no closer optimum.
    best = costly_fit(
        residual, box(bounds), evidence(data.parts, held),
        starts=start, max_evaluations=40, tolerance=1e-6,
    )  # fmt: skip
    return held | best.theta


def _spring(forced: Sequence[Loops], gain: float, kind: str) -> Oscillator:
    r"""Spring that comes closest to prescribed-displacement loops, by linear least squares.

    $$\min \sum_i \frac{|g F_i - \omega_n^2 y_i - \lambda_3 y_i^3|^2}{|g F_i|^2}$$
    """
    y = np.concatenate([np.asarray(part.counted * part.displacement) for part in forced])
    force = gain * np.concatenate([np.asarray(part.counted * part.mean) for part in forced])
    scale = np.linalg.norm(force, axis=1, keepdims=True)
    reach = np.abs(y).max()
    columns = [y, reach * (y / reach) ** 3][: 2 if kind == "cubic" else 1]
    design = np.stack([(column / scale).ravel() for column in columns], axis=1)
    stiffness = np.append(np.linalg.lstsq(design, (force / scale).ravel())[0], 0.0)
    omega_n = float(np.sqrt(max(stiffness[0], 0.0)))
    return {"omega_n": omega_n, "cubic": float(stiffness[1] / reach**2)}


def _evenly(part: Repeated) -> Repeated:
    """A part whose groups count by their relative errors, whatever their noise and offsets."""
    own = part.repeats
    scale = jnp.sqrt(jnp.sum(jnp.abs(part.mean) ** 2, axis=1))
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
