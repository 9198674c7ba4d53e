r"""Likelihood of free decays, with every record's own unknowns integrated out.

A record has an initial state (log amplitude and phase, flat priors), a small shift of its natural
frequency and a noise of its own. The shifts share one unknown scatter: structures are never twice
the same to the last digit, and a model without it takes their difference for knowledge.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Key

from jbw.inference.offsets import Estimate
from jbw.inference.scatter import log_density_of_offsets
from jbw.observables.decay import Decays
from jbw.observables.decay_entry import Match, match
from jbw.observables.decay_model import decay_of

NUM_OWN = 3  # unknowns of a record besides its noise: amplitude, phase, shift
SCATTERS = np.geomspace(1e-8, 1e-2, 25)  # of omega_n: a log-uniform prior of the shifts' scatter


def matches(theta: Mapping[str, Array], data: Decays) -> Match:
    """Every record matched to the decay of the joint.

    Args:
        theta: omega_n, zeta, softening, opening, share.
        data: The reduced decays.

    Returns:
        The matches, every field with a leading axis of records.
    """
    decay = decay_of(theta, data)
    return jax.vmap(lambda one: match(decay, one, data.step_s))(data.envelope)


def log_likelihood(theta: Mapping[str, Array], data: Decays) -> Float[Array, " term"]:
    r"""Terms of the log likelihood: one a record, then the scatter of their frequencies.

    $$\log p_i = -\frac{n - 3}{2} \log Q_i - \frac12 \log |A_i| - \log e_i, \qquad
      \log p = \sum_i \log p_i
      + \log \int p(s) \prod_i e_i N(\hat\delta_i; 0, s^2 + e_i^2)\,ds$$

    where Q is what the best initial state and shift leave, A their normal matrix, n the number of
    independent real values, and the shift's estimate has the standard error e. The noise is
    integrated out under 1/sigma. Q is linear enough in the three unknowns for this to be exact to
    the accuracy of a Laplace approximation at the signal-to-noise ratio of a decay.

    Args:
        theta: omega_n, zeta, softening, opening, share.
        data: The reduced decays.

    Returns:
        Terms [nats], up to a constant.

    Reference:
        Eq. (37) on the envelope, initial states and noise inferred.
    """
    found = estimate_of(theta, data)
    scatters = SCATTERS[:, None] * theta["omega_n"]
    each_its_own = tuple(range(len(data.envelope)))
    return jnp.append(found.log_density, log_density_of_offsets(found, (each_its_own,), scatters))


def estimate_of(theta: Mapping[str, Array], data: Decays, num_own: int = 1) -> Estimate:
    """What every record says of the shift of its natural frequency.

    Args:
        theta: As `log_likelihood`.
        data: The reduced decays.
        num_own: Offsets of a run; a record knows the first, the shift, alone.
    """
    found = matches(theta, data)
    size = _num_values(data)
    _, log_det = jnp.linalg.slogdet(found.precision)
    error = shift_errors(found, data)
    log_density = -(size - NUM_OWN) / 2 * jnp.log(found.misfit) - 0.5 * log_det - jnp.log(error)
    first = jnp.eye(num_own)[0]
    precision = jnp.outer(first, first) / error[:, None, None] ** 2
    return Estimate(log_density, found.entry.shift[:, None] * first, precision)


def _num_values(data: Decays) -> Float[Array, ""]:
    return 2 * data.envelope.shape[1] * data.worth


def covariance_of(found: Match, data: Decays) -> Float[Array, "record own own"]:
    """Covariance of log amplitude, phase and shift [rad/s] of every record."""
    variance = found.misfit / (_num_values(data) - NUM_OWN)
    return variance[:, None, None] * jnp.linalg.inv(found.precision)


def shift_errors(found: Match, data: Decays) -> Float[Array, " record"]:
    """Standard error of every record's shift of natural frequency [rad/s]."""
    return jnp.sqrt(covariance_of(found, data)[:, 2, 2])


def draw_noise_std(key: Key[Array, ""], found: Match, data: Decays) -> Float[Array, " record"]:
    r"""Exact draw of the noise of each record, given everything else.

    $$\sigma^2 \mid \theta \sim w Q(\theta) / \chi^2_{n - 3}$$

    Args:
        key: Random key.
        found: The matches.
        data: The reduced decays.

    Returns:
        Standard deviation of the real, and of the imaginary, part of the envelope's noise.
    """
    degrees = _num_values(data) - NUM_OWN
    chi_square = jax.random.chisquare(key, degrees, found.misfit.shape)
    return jnp.sqrt(data.worth * found.misfit / chi_square)


def residual(theta: Mapping[str, Array], data: Decays) -> Float[Array, " values"]:
    """Residuals in standard deviations of the noise and of the shifts, for least squares."""
    found = matches(theta, data)
    left: Complex[Array, "record step"] = found.residual / data.noise_std[:, None]
    # Every value counts whole here, so the shifts count as much more as the values are worth less.
    shifts = found.entry.shift / (data.shift_std * jnp.sqrt(data.worth))
    return jnp.concatenate([left.real.ravel(), left.imag.ravel(), shifts])
