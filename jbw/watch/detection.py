r"""Detection of a change in readings of frequency and damping.

**Hotelling's test** compares a new record with a reference. Readings without change are Gaussian
with unknown mean and covariance; $n_0$ of them have the mean $m$ and the covariance $S$ (over
$n_0 - 1$). For a new reading $t$ of dimension $p$,

$$T^2 = (t - m)^T S^{-1} (t - m) \sim \frac{p (n_0 - 1)(n_0 + 1)}{n_0 (n_0 - p)} F_{p, n_0 - p},$$

exactly, so that the rate of false alarms is the stated one, however few references there are. Few
references cost power: the threshold rises.

**Bayesian online change-point detection** gives the number of records since the last change.
A run is a sequence of readings without change. Within a run readings are Gaussian with unknown mean
and covariance, under a normal-inverse-Wishart prior; after every reading a change occurs with
probability `hazard`. With $w_r$ the probability that the present run has r readings, a reading x
updates it by

$$w_{r+1} \propto (1 - h)\,w_r\,p(x \mid \text{run } r), \qquad
  w_0 \propto h \sum_r w_r\,p(x \mid \text{run } r),$$

where $p(x \mid \text{run } r)$ is Student's t. In one dimension the prior is the
normal-inverse-gamma with $a = \nu/2$, $b = \psi/2$.

With w the probability that no change occurred since a reference (a change may also have followed
the last reading of the reference), a change is stated when $w < a$. Without a change, $(1 -
h)^{n+1} / w$ is a martingale of mean one, so that by Ville's inequality a false alarm occurs among
n readings with probability $a / (1 - h)^{n+1}$ at most.

Reference:
    Hotelling, Ann. Math. Stat. 2 (1931) 360; Adams and MacKay, arXiv:0710.3742 (2007).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln, logsumexp
from scipy.stats import f as fisher
from scipy.stats import ncf

from jbw.errors import ConfigError

FURTHEST = 2.0  # expected size of a change, in standard deviations of one record's values
Vector = Float[np.ndarray, " p"]
Matrix = Float[np.ndarray, "p p"]


class ReferenceReadings(NamedTuple):
    """The number, mean and covariance (divided by `num` - 1) of values before any change."""

    num: int
    mean: Float[np.ndarray, "*batch p"]
    covariance: Float[np.ndarray, "*batch p p"]


def reference_of(readings: Float[np.ndarray, "*batch record p"]) -> ReferenceReadings:
    """Return the number, mean and covariance of values measured before any change.

    Raises:
        ConfigError: There are no more readings than values per reading: the covariance is singular.
    """
    num, p = readings.shape[-2:]
    if num <= p:
        raise ConfigError(
            f"A reference for {p} values needs at least {p + 1} records, but has {num}.",
            why=f"With fewer than {p + 1} records, the variation between records is unknown in "
            "some direction.",
            remedy="Add records of the unchanged joint, or use only one amplitude.",
        )
    mean = readings.mean(axis=-2)
    away = readings - mean[..., None, :]
    covariance = np.swapaxes(away, -1, -2) @ away / (num - 1)
    return ReferenceReadings(num, mean, covariance)


def threshold(false_alarms: float, p: int, num: int) -> float:
    r"""Return the $T^2$ that an unchanged joint's record exceeds with probability `false_alarms`.

    Args:
        false_alarms: Rate of false alarms per reading.
        p: Number of values of a reading.
        num: Number of readings in the reference, $n_0 > p$.
    """
    return float(_scale(p, num) * fisher.isf(false_alarms, p, num - p))


def distance(
    reading: Float[np.ndarray, "*batch p"],
    reference: ReferenceReadings,
    excess: Matrix | None = None,
) -> Float[np.ndarray, "*batch"]:
    r"""Return Hotelling's $T^2$ of a new record's values against the reference.

    Args:
        reading: Values of the new reading.
        reference: Readings without change.
        excess: Covariance by which the reading's own noise exceeds the references' noise, added to
            theirs: a noisier record may then deviate further without an alarm, and no rate rises.
    """
    covariance = reference.covariance if excess is None else reference.covariance + excess
    away = (reading - reference.mean)[..., None]
    return np.sum(away * np.linalg.solve(covariance, away), axis=(-1, -2))


def tail(squared: Float[np.ndarray, "*batch"], p: int, num: int) -> Float[np.ndarray, "*batch"]:
    r"""Return the probability that a record of an unchanged joint has at least this $T^2$."""
    return np.asarray(fisher.sf(np.asarray(squared) / _scale(p, num), p, num - p))


def power(false_alarms: float, p: int, num: int, change: float) -> float:
    r"""Return the probability that Hotelling's test detects a given change from one record.

    With a change, $n_0 (n_0 - p) / (p (n_0 - 1)(n_0 + 1)) T^2$ is non-central F with $d^2 n_0 /
    (n_0 + 1)$.

    Args:
        false_alarms: Rate of false alarms per reading.
        p: Number of values of a reading.
        num: Number of readings in the reference.
        change: Size d of the change in standard deviations of a reading (Mahalanobis distance).
    """
    limit = fisher.isf(false_alarms, p, num - p)
    return float(ncf.sf(limit, p, num - p, change**2 * num / (num + 1)))


def excess_noise(covariance: Matrix, usual: Matrix) -> Matrix:
    """Return the covariance by which a record's noise exceeds that of the reference records."""
    values, vectors = np.linalg.eigh(covariance - usual)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def _scale(p: int, num: int) -> float:
    return p * (num - 1) * (num + 1) / (num * (num - p))


class Belief(NamedTuple):
    r"""The normal-inverse-Wishart distribution of the mean and covariance since the last change."""

    mean: Float[np.ndarray, "*batch p"]
    # effective number of records: so many independent records would determine the mean equally well
    kappa: Float[np.ndarray, "*runs"]
    nu: Float[np.ndarray, "*runs"]  # degrees of freedom nu
    # scale matrix of the inverse-Wishart distribution, a sum of squared deviations
    psi: Float[np.ndarray, "*batch p p"]


class RunLength(NamedTuple):
    """The posterior of the number of records since the last change."""

    # Probability that r records were measured since the last change, r = 0..n. If the last change
    # may precede the first record, the last entry is the probability that no change occurred.
    probability: Float[np.ndarray, "*batch length"]
    # log probability density of all records [nats]
    log_evidence: Float[np.ndarray, "*batch"]
    # Probability, after each record, that no change has occurred.
    unchanged: Float[np.ndarray, "*batch n"]


def known_from(reference: ReferenceReadings) -> Belief:
    r"""Return the distribution for an unchanged joint: a flat prior updated by the references.

    Its predictive distribution is that of Hotelling: Student's t with $n_0 - p$ degrees of freedom.
    """
    num = reference.num
    return Belief(
        reference.mean,
        np.array(float(num)),
        np.array(num - 1.0),
        (num - 1) * reference.covariance,
    )


def after_change(reference: ReferenceReadings) -> Belief:
    """Return the prior after a change: it is centred at the reference values, but wide.

    Its mean has a standard deviation of `FURTHEST` times that of a reading.
    """
    return known_from(reference)._replace(kappa=np.array(1 / FURTHEST**2))


def run_length(
    readings: Float[np.ndarray, "*batch n p"],
    prior: Belief,
    hazard: float,
    start: Belief | None = None,
) -> RunLength:
    """Return the posterior of the number of records since the last change.

    Args:
        readings: Readings in the order of measurement.
        prior: Belief about a run before its first reading.
        hazard: Probability that a change occurs after a reading.
        start: Belief about the run before the first reading, which a change may have ended just
            before; when None, a run begins with the first reading.
    """
    first = prior if start is None else start
    belief = Belief(
        first.mean[..., None, :], first.kappa[None], first.nu[None], first.psi[..., None, :, :]
    )
    log_w: np.ndarray = np.zeros((*readings.shape[:-2], 1))
    if start is not None:  # A change may have occurred just before the first record.
        both = np.array([np.log(hazard), np.log1p(-hazard)])
        log_w, belief = log_w + both, _with_new_run(belief, prior)
    total = np.zeros(readings.shape[:-2])
    unchanged: list[np.ndarray] = []
    for i in range(readings.shape[-2]):
        x = readings[..., i, :]
        joint = log_w + log_predictive(x, belief)
        change = np.log(hazard) + logsumexp(joint, axis=-1, keepdims=True)
        log_w = np.concatenate([change, np.log1p(-hazard) + joint], axis=-1)
        now = np.asarray(logsumexp(log_w, axis=-1, keepdims=True))
        log_w, total = log_w - now, total + now[..., 0]
        belief = _with_new_run(updated(x, belief), prior)
        unchanged.append(np.exp(log_w[..., -1]))
    history = np.stack(unchanged, axis=-1) if unchanged else np.ones((*total.shape, 0))
    return RunLength(np.exp(log_w), total, history)


def log_predictive(
    x: Float[np.ndarray, "*batch p"], belief: Belief
) -> Float[np.ndarray, "*batch length"]:
    r"""Return a record's log predictive density, $t_{\nu - p + 1}$, for each run length."""
    p = x.shape[-1]
    df = belief.nu - p + 1
    kappa = belief.kappa
    scale = belief.psi * ((kappa + 1) / (kappa * df))[..., None, None]
    away = (x[..., None, :] - belief.mean)[..., None]
    squared = np.sum(away * np.linalg.solve(scale, away), axis=(-1, -2))
    _, log_det = np.linalg.slogdet(scale)
    constant = gammaln((df + p) / 2) - gammaln(df / 2) - p / 2 * np.log(np.pi * df)
    return constant - log_det / 2 - (df + p) / 2 * np.log1p(squared / df)


def updated(x: Float[np.ndarray, "*batch p"], belief: Belief) -> Belief:
    """Update the distributions of mean and covariance, one per run length, by a new record."""
    kappa = belief.kappa
    away = x[..., None, :] - belief.mean
    mean = belief.mean + away / (kappa + 1)[..., None]
    square = away[..., :, None] * away[..., None, :]
    psi = belief.psi + (kappa / (kappa + 1))[..., None, None] * square
    return Belief(mean, kappa + 1, belief.nu + 1, psi)


def _with_new_run(belief: Belief, prior: Belief) -> Belief:
    mean = np.broadcast_to(
        prior.mean[..., None, :], (*belief.mean.shape[:-2], 1, prior.mean.shape[-1])
    )
    psi = np.broadcast_to(
        prior.psi[..., None, :, :], (*belief.psi.shape[:-3], 1, *prior.psi.shape[-2:])
    )
    return Belief(
        np.concatenate([mean, belief.mean], axis=-2),
        np.concatenate([prior.kappa[None], belief.kappa]),
        np.concatenate([prior.nu[None], belief.nu]),
        np.concatenate([psi, belief.psi], axis=-3),
    )
