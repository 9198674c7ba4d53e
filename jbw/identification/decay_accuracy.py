"""What the verdict on decays needs beside the chains: coloured residuals, misfit, solver error."""

from collections.abc import Mapping
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Complex, Float

from jbw.identification.accuracy import COLOURED, NUM_DRAWS, SHIFT
from jbw.inference.verdict import Finding
from jbw.observables.decay import Decays
from jbw.observables.decay_entry import Match
from jbw.observables.decay_likelihood import log_likelihood, matches

LEAST_WORTH = 8  # independent values of a record, below which nothing could be integrated out
MISFIT = 0.05  # of a record: more is another motion than the model's


def worth_of(residual: Complex[np.ndarray, "record step"]) -> float:
    r"""Share of independent values among correlated ones.

    $$1/w = 1 + 2 \sum_{k \ge 1} \rho_k$$

    with the correlation over all records, summed until it first falls below zero.

    Args:
        residual: What a fit leaves of every record.

    Returns:
        w, at most 1.
    """
    size = residual.shape[1]
    unit = residual / np.linalg.norm(residual, axis=1, keepdims=True)
    rho = np.array(
        [np.mean(np.sum((unit[:, k:] * np.conj(unit[:, : size - k])).real, axis=1))
         for k in range(1, size // 2)]
    )  # fmt: skip
    positive = np.concatenate([rho, [-1.0]])
    total = float(np.sum(positive[: np.argmax(positive < 0)]))
    return float(np.clip(1 / (1 + 2 * total), LEAST_WORTH / size, 1.0))


def matched(theta: Mapping[str, float], data: Decays) -> Match:
    """Every record matched at one point of the parameters."""
    return _matched({name: jnp.asarray(value) for name, value in theta.items()}, data)


_matched = eqx.filter_jit(matches)


def frequency_scatter(theta: Mapping[str, float], data: Decays) -> float:
    """Root mean square of the records' shifts of natural frequency [rad/s]."""
    return float(jnp.sqrt(jnp.mean(matched(theta, data).entry.shift ** 2)))


def residual_finding(theta: Mapping[str, float], data: Decays) -> Finding:
    """Whether what is left of the envelopes is white, as noise alone would be.

    Args:
        theta: The optimum.
        data: The reduced decays.

    Returns:
        A finding whose number is the lag-one correlation over all records.
    """
    left = np.asarray(matched(theta, data).residual)
    unit = left / np.linalg.norm(left, axis=1, keepdims=True)
    lag_one = float(np.mean(np.sum((unit[:, 1:] * np.conj(unit[:, :-1])).real, axis=1)))
    ok = lag_one < COLOURED
    return Finding(
        "coloured_residual",
        "ok" if ok else "failed",
        f"The residuals have a lag-one correlation of {lag_one:.2f}; the likelihood counts "
        f"{float(data.worth):.0%} of the values as independent ones.",
        lag_one,
        "" if ok else "The model does not follow the decays to their noise; hold records out.",
    )


def shape_finding(theta: Mapping[str, float], data: Decays) -> Finding:
    """How much of the worst record the model leaves.

    Args:
        theta: The optimum.
        data: The reduced decays.

    Returns:
        A finding whose number is the residual over the record, root mean squares.
    """
    misfit = np.asarray(matched(theta, data).misfit)
    share = np.sqrt(misfit / np.sum(np.abs(np.asarray(data.envelope)) ** 2, axis=1))
    worst = int(np.argmax(share))
    ok = share[worst] < MISFIT
    return Finding(
        "misfit",
        "ok" if ok else "failed",
        f"The best decay leaves {share[worst]:.2%} of fitted record {worst + 1}, the worst; it "
        f"must be less than {MISFIT:.0%}.",
        float(share[worst]),
        "" if ok else "Doubt the band (a second mode), `settle`, or the law of the joint.",
    )


def solver_finding(posterior: xr.Dataset, data: Decays) -> Finding:
    r"""Whether the solver's step could have moved the posterior, by sd(Delta log likelihood).

    Args:
        posterior: Draws.
        data: The reduced decays.

    Returns:
        As `jbw.identification.accuracy.solver_finding`.
    """
    finer = replace(data, substeps=2 * data.substeps)
    total = posterior.sizes["chain"] * posterior.sizes["draw"]
    keep = np.unique(np.linspace(0, total - 1, min(NUM_DRAWS, total)).round().astype(int))
    names = ("omega_n", "zeta", "softening", "opening", "share")
    theta = {name: jnp.asarray(posterior[name].values.ravel()[keep]) for name in names}
    change = np.asarray(_log_likelihoods(theta, finer) - _log_likelihoods(theta, data))
    shift = float(np.std(change))
    ok = shift < SHIFT
    return Finding(
        "solver_error",
        "ok" if ok else "failed",
        f"Halving the solver's step moves no posterior mean by more than {shift:.2g} standard "
        f"deviations; it must be below {SHIFT:g}.",
        shift,
        "" if ok else "Set `substeps` in [identify] to twice its value.",
    )


@eqx.filter_jit
def _log_likelihoods(theta: Mapping[str, Array], data: Decays) -> Float[Array, " draw"]:
    return jax.lax.map(lambda one: jnp.sum(log_likelihood(one, data)), dict(theta), batch_size=8)
