"""Where the posterior of free decays starts: its box, its least-squares fit, the noise found."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from jbw.identification.coordinates import SHARE
from jbw.identification.decay_accuracy import matched
from jbw.identification.decay_reading import FirstReading
from jbw.identification.priors import stated
from jbw.identification.worth import worth_of
from jbw.inference.box import Box, box, from_unit
from jbw.inference.costly_fit import costly_fit
from jbw.inference.fitting import Fit
from jbw.observables.decay import Decays
from jbw.observables.decay_likelihood import residual, shift_errors

NUM_STARTS = 3
MOST_EVALUATIONS = 30  # of a start


def decay_box(settings: Mapping[str, Any], reading: FirstReading) -> Box:
    """Box about the first reading; a campaign's bounds on alpha, delta, gamma are carried over.

    Args:
        settings: The campaign's [identify] table.
        reading: Frequency and damping against amplitude.

    Returns:
        The box of omega_n, zeta, softening, opening and share.
    """
    floor = 0.01 / reading.y_peak  # a joint that does next to nothing
    bounds = {
        "omega_n": (0.99 * reading.omega_n, 1.01 * reading.omega_n),
        "zeta": (0.02 * reading.zeta_range[0], 2.0 * reading.zeta_range[1]),
        "softening": (0.0, 4.0 * max(reading.softening, floor)),
        "opening": (0.0, 4.0 * max(reading.opening, floor)),
        "share": SHARE,
    }
    given = stated(settings)
    for known in ("omega_n", "zeta"):
        bounds[known] = given.get(known, bounds[known])
    omega_n = bounds["omega_n"]
    if "alpha" in given:
        bounds["share"] = (given["alpha"][0] / omega_n[1] ** 2, given["alpha"][1] / omega_n[0] ** 2)
    for product, factor in (("softening", "delta"), ("opening", "gamma")):
        if factor in given:
            corners = np.outer(bounds["share"], given[factor])
            bounds[product] = (float(corners.min()), float(corners.max()))
    return box(bounds)


def fit_decay(
    key: Key[Array, ""], data: Decays, prior: Box, reading: FirstReading
) -> tuple[Fit, Decays]:
    """Least squares from the reading and many shares, twice: the first one finds the noise.

    Args:
        key: Random key of the starts.
        data: The reduced decays.
        prior: The box.
        reading: Where to start.

    Returns:
        The fit, and the data with the noise of every record, the scatter of their frequencies and
        the worth of a value, as the first fit leaves them.
    """
    drawn = from_unit(jax.random.uniform(key, (NUM_STARTS, len(prior.names))), prior)
    starts = {
        "omega_n": np.full(NUM_STARTS, reading.omega_n),
        "zeta": np.full(NUM_STARTS, reading.zeta),
        "softening": np.full(NUM_STARTS, reading.softening),
        "opening": np.full(NUM_STARTS, reading.opening),
        "share": np.asarray(drawn["share"]),
    }
    inside = {
        name: np.clip(starts[name], prior.lower[i], prior.upper[i])
        for i, name in enumerate(prior.names)
    }
    options = {"starts": inside, "max_evaluations": MOST_EVALUATIONS, "tolerance": 1e-8}
    first = costly_fit(residual, prior, data, **options)
    data = scaled(first.theta, data)
    return costly_fit(residual, prior, data, **options), data


def scaled(theta: Mapping[str, float], data: Decays) -> Decays:
    """The data with the noise, the scatter and the worth that a fit leaves."""
    found = matched(theta, data)
    size = data.envelope.shape[1]
    noise = jnp.sqrt(found.misfit / (2 * size - 3))
    worth = worth_of(np.asarray(found.residual))
    errors = float(jnp.sqrt(jnp.mean(shift_errors(found, data) ** 2)))
    scatter = max(float(jnp.sqrt(jnp.mean(found.entry.shift**2))), errors)
    return replace(
        data,
        noise_std=noise,
        worth=jnp.asarray(worth),
        shift_std=jnp.asarray(scatter),
    )
