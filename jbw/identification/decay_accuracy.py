"""What the verdict on decays needs beside the chains: coloured residuals, misfit, solver error."""

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray as xr

from jbw.identification.accuracy import COLOURED, solver_change, solver_error, thinned
from jbw.inference.verdict import Finding
from jbw.observables.decay import Decays
from jbw.observables.decay_entry import Match
from jbw.observables.decay_likelihood import matches
from jbw.observables.evidence import evidence
from jbw.observables.joint import PRODUCTS

MISFIT = 0.05  # of a record: more is another motion than the model's


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


def solver_finding(posterior: xr.Dataset, data: Decays) -> Finding | None:
    """As `jbw.identification.accuracy.solver_finding`.

    Args:
        posterior: Draws.
        data: The reduced decays.
    """
    error = solver_change(thinned(posterior, PRODUCTS), evidence([data]))
    return None if error is None else solver_error(error)
