"""Reference models: oscillators without hysteresis, fitted to the same tests as the joint."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jbw.identification.floors import REACH
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.space.box import bounds_about, box
from jbw.observables.dataset import (
    Dataset,
    best_offsets,
    largest_displacement,
    stacked,
    with_directions,
)
from jbw.observables.drives import of_drive, used_by
from jbw.observables.noise import evenly
from jbw.observables.observable import OFFSETS, Observable
from jbw.observables.residual_terms import bounds, neighbours_of
from jbw.oscillator.modes.assembled import is_assembled

LAWS: dict[str, tuple[str, ...]] = {"linear": (), "cubic": ("cubic",)}
FREELY = 1e3  # factor on the variation between runs, so large that it hardly restricts the fit
# largest force of the cubic spring at the largest displacement, relative to the linear force
STIFFEST = 10.0


class Reference(NamedTuple):
    """A reference model: an oscillator without hysteresis.

    Attributes:
        parameters: Parameters by name.
        laws: Names of its laws.
        runs: Offsets of omega_n and zeta of each run, if the joint's runs have offsets.
    """

    parameters: dict[str, float]
    laws: tuple[str, ...]
    runs: Mapping[str, Float[np.ndarray, " own"]] = MappingProxyType({})


def of_run(
    references: Mapping[str, Reference], run: str | None, drive: str = ""
) -> dict[str, tuple[dict[str, float], tuple[str, ...]]]:
    """Return the parameters and laws of each reference model in a run; for `run=None`, a new run.

    Parameters of a drive with separate ones are returned under their plain names.
    """
    oscillators = {}
    for name, reference in references.items():
        # A new run has no offset.
        offset = zip(OFFSETS, reference.runs.get(run or "", ()), strict=False)
        theta = of_drive(reference.parameters, drive)
        shifted = {key: theta[key] + float(b) for key, b in offset}
        oscillators[name] = {**theta, **shifted}, reference.laws
    return oscillators


def references(
    data: Dataset, known: Mapping[str, float], kinds: Sequence[str] = ("linear",)
) -> dict[str, Reference]:
    r"""Fit a linear and a cubic oscillator to all fitted tests, with minimum relative error.

    $$\min \sum_i |d_i - m_i|^2 / |d_i|^2, \qquad
      \ddot y + 2\zeta\omega_n\dot y + \omega_n^2 y + \lambda_3 y^3 = g u$$

    with lambda_3 = 0 for the linear one, starting from omega_n, zeta and gain of the joint. Every
    group of data counts by its relative error, so that no level is fitted at the expense of others.
    Line fits are omitted, and so are free decays if there are other tests: their errors are of
    another kind. If runs have separate omega_n and zeta with the joint, they have them here too.
    """
    y_peak = largest_displacement(data, known["omega_n"])
    terms = bounds(known["omega_n"], neighbours_of(known))
    known = {name: value for name, value in known.items() if name in {*REACH, *terms}}
    even = [evenly(part) for part in data.parts]
    parts = [part for part in even if part is not None]
    parts = parts or [part for part in data.parts if part.own_shifts]
    if not parts:
        return {}
    of_model = is_assembled(data.held)
    held = {name: float(value) for name, value in data.held.items() if of_model or name in REACH}
    forced: list[Any] = [part for part in parts if part.is_prescribed]
    by_kind: dict[str, Reference] = {}
    for kind in kinds:
        if len(forced) == len(parts):
            by_kind[kind] = _spring(forced, known | held, kind)
        else:
            start = by_kind.get("linear") or Reference(dict(known), LAWS[kind])
            by_kind[kind] = _fitted(parts, held, start, y_peak, kind, data)
    return by_kind


def _fitted(
    parts: Sequence[Observable],
    held: Mapping[str, float],
    before: Reference,
    y_peak: float,
    kind: str,
    joint: Dataset,
) -> Reference:
    """Fit one kind of oscillator with least relative error; use run offsets if the joint has them.

    The fit starts from a simpler oscillator that it contains, with its offsets, so it cannot be
    worse.
    """
    estimates = before.parameters
    free = [name for name in used_by(parts, estimates) if name not in held]
    within = {name: bounds_about(estimates[name], *REACH[name]) for name in free}
    terms = bounds(estimates["omega_n"], neighbours_of(estimates))
    within |= {name: terms[name] for name in terms if name in estimates}
    start = {name: estimates[name] for name in within}
    if kind == "cubic":
        most = STIFFEST * estimates["omega_n"] ** 2 / y_peak**2
        within["cubic"], start["cubic"] = (-most, most), 0.0
    data = Dataset.of([replace(part, laws=LAWS[kind]) for part in parts], held)
    # The error is quoted to two digits, so a closer optimum is not needed.
    close = {"max_evaluations": 40, "tolerance": 1e-6}
    theta = start
    if not before.runs:
        theta = costly_fit(stacked, box(within), data, starts=start, **close).theta
    estimates = {name: estimates[name] for name in REACH if name in estimates}
    if not joint.has_offsets:
        return Reference({**estimates, **held, **theta}, LAWS[kind])
    data = replace(
        data, scatters=joint.scatters, scatter=jax.device_put(FREELY * np.asarray(joint.scatter))
    )
    offsets = before.runs
    for _ in range(2):  # The second round is linearised about the run offsets of the first round.
        data = with_directions(theta, data, offsets)
        theta = costly_fit(stacked, box(within), data, starts=theta, **close).theta
        offsets = best_offsets(theta, data)
    return Reference({**estimates, **held, **theta}, LAWS[kind], offsets)


def _spring(forced: Sequence[Any], estimates: Mapping[str, float], kind: str) -> Reference:
    """Fit a linear or cubic spring to loops of prescribed motion, with minimum relative error.

    The minimum is that of sum_i |g F_i - omega_n^2 y_i - lambda_3 y_i^3|^2 / |g F_i|^2.
    """
    y = np.concatenate([np.asarray(part.compared(part.displacement)) for part in forced])
    measured = np.concatenate([np.asarray(part.compared(part.mean)) for part in forced])
    force = estimates["gain"] * measured
    scale = np.linalg.norm(force, axis=1, keepdims=True)
    reach = np.abs(y).max()
    columns = [y, reach * (y / reach) ** 3][: 2 if kind == "cubic" else 1]
    design = np.stack([(column / scale).ravel() for column in columns], axis=1)
    stiffness = np.linalg.lstsq(design, (force / scale).ravel())[0]
    parameters = {**estimates, "omega_n": float(np.sqrt(max(stiffness[0], 0.0)))}
    if kind == "cubic":
        parameters["cubic"] = float(stiffness[1] / reach**2)
    return Reference(parameters, LAWS[kind])
