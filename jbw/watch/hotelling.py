r"""Hotelling's test of a new record's frequency and damping against a reference.

Readings without change are Gaussian with unknown mean and covariance; $n_0$ of them have the mean
$m$ and the covariance $S$ (over $n_0 - 1$). For a new reading $t$ of dimension $p$,

$$T^2 = (t - m)^T S^{-1} (t - m) \sim \frac{p (n_0 - 1)(n_0 + 1)}{n_0 (n_0 - p)} F_{p, n_0 - p},$$

exactly, so that the rate of false alarms is the stated one, however few references there are. Few
references cost power: the threshold rises.

Reference: Hotelling, Ann. Math. Stat. 2 (1931) 360.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import f as fisher
from scipy.stats import ncf

from jbw.errors import ConfigError

Vector = Float[np.ndarray, " p"]
Matrix = Float[np.ndarray, "p p"]


class ReferenceReadings(NamedTuple):
    """The number, mean and covariance (divided by `num` - 1) of reference values without change."""

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
