"""All parameters set to update: the joint posterior of everything that was measured."""

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Key

from jbw.identification.accuracy import (
    NUM_DRAWS,
    SHIFT,
    halved,
    residual_finding,
    solver_change,
    solver_finding,
)
from jbw.identification.coordinates import box_of, by_products, product_box, products_of
from jbw.identification.drawing import sample_joint, stuck
from jbw.identification.effects import effects, effects_sentence
from jbw.identification.leaving_out import (
    consistency_finding,
    leave_one_out,
    left_out_dataset,
    left_out_sentence,
)
from jbw.identification.noise import with_derived
from jbw.identification.runs import runs_dataset, runs_sentence
from jbw.identification.shifts import (
    recentred,
    sentence_of,
    shifts_of,
    wanted,
    with_offsets,
)
from jbw.identification.starts import fit_from, inside, largest_displacement, linear_look
from jbw.identification.step import Step, finished
from jbw.identification.worth import counted_by_label, worth_by_label
from jbw.inference.box import Box
from jbw.inference.costly_fit import costly_fit
from jbw.inference.fitting import Fit
from jbw.inference.keeping import Keep, nowhere
from jbw.observables.decay import Decays
from jbw.observables.evidence import Evidence, residual
from jbw.observables.linear import READ, LineReading
from jbw.observables.weighing import (
    error_by_label,
    left_by_label,
    with_fitted_noise,
    with_worth,
)

MOST_SUBSTEPS = 16


def joint_step(
    key: Key[Array, ""],
    data: Evidence,
    earlier: Mapping[str, Step],
    settings: Mapping[str, Any],
    *,
    keep: Keep = nowhere,
) -> tuple[Step, Evidence]:
    """Joint posterior of all parameters of the joint, the gain and the noise.

    Args:
        key: Random key.
        data: What was measured.
        earlier: The paper's steps, when they were run.
        settings: The campaign's [identify] table.
        keep: Where the chains outlive the process.

    Returns:
        The step "joint", its posterior with the noise by group and the products alpha*delta and
        alpha*gamma besides the parameters; and the evidence as it was sampled: with the offsets
        of the runs, the worth of coloured residuals, and the solver's steps that it took.

    Reference:
        Eq. (37), with every parameter set to update.
    """
    started = perf_counter()
    keys = jax.random.split(key, 5)
    known = {**linear_look(data), **_means(earlier)}
    prior = box_of(settings, data, known)
    first = fit_from(keys[0], data, prior, known)
    chi_square = explained(first, data)
    prior, best, data, words = settled(keys[1], data, prior, first, settings)
    best = replace(best, waterfall=first.waterfall)  # the later fits have one start
    posterior = sample_joint(keys[2], data, prior, best, settings, keep("joint"))
    draws = posterior["posterior"].to_dataset()
    left = left_by_label(best.residual, data)
    looks = (
        residual_finding(left, counted_by_label(data), error_by_label(left, data)),
        solver_finding(draws, data),
    )
    findings = [finding for finding in looks if finding is not None]
    complete = with_derived(keys[3], posterior, data)
    if (runs := runs_dataset(keys[4], draws, prior.names, data)) is not None:
        complete["runs"] = xr.DataTree(runs)
        words.append(runs_sentence(runs))
    held = {n: float(v) for n, v in data.held.items()}
    y_peak = largest_displacement(data, best.theta.get("omega_n", held.get("omega_n", 1.0)))
    if (found := effects(complete["posterior"].to_dataset(), held, y_peak)) is not None:
        words.append(effects_sentence(found, y_peak))
    if (left_out := leave_one_out(best, prior, data)) is not None:
        findings.append(consistency_finding(left_out))
        complete["leave_one_out"] = xr.DataTree(left_out_dataset(left_out))
        words.append(left_out_sentence(left_out))
    step = finished(
        "joint",
        complete,
        prior,
        best,
        started,
        findings=findings,
        statements=words,
        held=held,
        chi_square=chi_square,
    )
    words = stuck(step.posterior, step.verdict)
    return replace(step, statements=(*step.statements, *words)), data


def _means(earlier: Mapping[str, Step]) -> dict[str, float]:
    """Posterior means of the paper's steps, which are where to start."""
    found: dict[str, float] = {}
    for step in ("third_order_nuts", "opening_nuts"):
        if step in earlier:
            group = earlier[step].posterior["posterior"]
            found |= {str(n): float(v.mean()) for n, v in group.data_vars.items()}
    return found


def explained(first: Fit, data: Evidence) -> tuple[float, int] | None:
    """Chi-square of a fit over the groups whose noise is known from repeats, and its degrees."""
    rows, position = [], 0
    for part in data.parts:
        if isinstance(part, Decays):
            continue
        sizes, counted, width = np.array([len(READ)]), np.array([True]), len(READ)
        if not isinstance(part, LineReading):
            sizes = np.asarray(part.repeats.size)
            counted = np.asarray(part.repeats.num_repeats) > 1
            width = part.repeats.directions.shape[-1]
        block = first.residual[position : position + len(sizes) * width].reshape(-1, width)
        rows += list(zip(np.sum(block[counted] ** 2, axis=1), sizes[counted], strict=True))
        position += block.size
    if not rows:
        return None
    total, count = (sum(column) for column in zip(*rows, strict=True))
    return float(total), max(int(count) - len(first.x), 1)


def settled(
    key: Key[Array, ""],
    data: Evidence,
    prior: Box,
    first: Fit,
    settings: Mapping[str, Any],
) -> tuple[Box, Fit, Evidence, list[str]]:
    """Noise, worth and offsets as the first fit shows them, coordinates and steps that they take.

    Args:
        key: Random key.
        data: What was measured.
        prior: The box.
        first: The first fit.
        settings: The campaign's [identify] table.

    Returns:
        The box and the fit in the coordinates to sample in, the evidence, and what was found, in
        words.
    """
    data = weighed(first, data, settings)
    best = again(first, prior, data)
    words = []
    shifts = shifts_of(best, prior.names, data)
    if shifts is not None and wanted(shifts, settings):
        data = with_offsets(best, shifts, data)
        best = again(best, prior, data)
        data = recentred(best, data)
        best = again(best, prior, data)
        data = weighed(best, data, settings)
        best = again(best, prior, data)
        words.append(sentence_of(shifts))
    if by_products(best, settings):
        prior = product_box(prior, best.theta, settings)
        best = again(best, prior, data, theta=products_of(best.theta))
        words.append(
            "The data know alpha, delta and gamma by their products alone: alpha*delta and "
            "alpha*gamma are sampled, and alpha's share of the stiffness beside them."
        )
    if "substeps" not in settings:
        finer = refined(key, data, prior, best)
        if finer is not data:
            data, best = finer, again(best, prior, finer)
    return prior, best, data, words


def weighed(best: Fit, data: Evidence, settings: Mapping[str, Any]) -> Evidence:
    """The evidence with the noise that a fit leaves, and as many values as that is worth."""
    left = with_fitted_noise(left_by_label(best.residual, data), data)
    if settings.get("model_error", "auto") == "none":
        return left
    return with_worth(worth_by_label(best, data), left)


def again(
    best: Fit, prior: Box, data: Evidence, *, theta: Mapping[str, float] | None = None
) -> Fit:
    """The fit again, from where it ended."""
    start = inside(theta or best.theta, prior)
    return costly_fit(residual, prior, data, starts=start)


def refined(key: Key[Array, ""], data: Evidence, prior: Box, best: Fit) -> Evidence:
    """The evidence with so many steps of the solver that halving them would not matter.

    Args:
        key: Random key of draws from the fit's Gaussian.
        data: The evidence.
        prior: The box.
        best: The fit.
    """
    white = np.asarray(jax.random.normal(key, (NUM_DRAWS, len(best.theta))))
    draws = list(best.theta.values()) + white @ np.linalg.cholesky(best.covariance).T
    theta = inside(dict(zip(best.theta, draws.T, strict=True)), prior)
    for _ in range(int(np.log2(MOST_SUBSTEPS)) - 1):
        change = solver_change(theta, data)
        if change is None or np.std(change) < SHIFT:
            break
        data = halved(data) or data
    return data
