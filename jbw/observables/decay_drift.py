r"""The drift of free decays from the predictions that a law makes from their beginning.

$$E(t) = \hat E(t)\,e^{(-\rho + j\varphi)\,(t - t_0 / 2)} + \text{rest}, \qquad
  \hat\rho, \hat\varphi = -\frac{\sum_t w_t t \ln |E / \hat E|}{\sum_t w_t t^2},
  \frac{\sum_t w_t t \arg (E / \hat E)}{\sum_t w_t t^2}, \quad w = |E|^2$$

where $t_0$ is what gives a record's initial state and natural frequency. A law whose frequency runs
otherwise with amplitude drifts from the record, whatever its frequency at the beginning.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float


class Drift(NamedTuple):
    """The drift of a record from its prediction: frequency [rad/s] and rate of decay [1/s]."""

    frequency: float
    rate: float
    rest: Complex[np.ndarray, " value"]  # of the envelope, that no drift explains
    measured: Complex[np.ndarray, " value"]


def drift_of(
    measured: Complex[np.ndarray, " value"],
    predicted: Complex[np.ndarray, " value"],
    time: Float[np.ndarray, " value"],
) -> Drift:
    """Fit the drift of a prediction from an envelope over time since its beginning's middle."""
    ratio = measured / predicted
    weight = np.abs(measured) ** 2 * time
    along = np.sum(weight * time)
    frequency = float(np.sum(weight * np.unwrap(np.angle(ratio))) / along)
    rate = -float(np.sum(weight * np.log(np.abs(ratio))) / along)
    rest = measured - predicted * np.exp((-rate + 1j * frequency) * time)
    return Drift(frequency, rate, rest, measured)


class LeftOutDecay(NamedTuple):
    """Drift of one record, with the errors of what its beginning leaves open of it."""

    drift: Drift
    frequency_std: float  # [rad/s]
    rate_std: float  # [1/s]
    noise: float  # sum of squares that noise leaves of the rest
    fraction: float  # of its values, those that count as independent


def left_out_decay(
    measured: Complex[np.ndarray, " value"],
    predicted: Complex[np.ndarray, " value"],
    time: Float[np.ndarray, " value"],
    errors: tuple[float, float],
    noise_std: float,
    fraction: float,
) -> LeftOutDecay:
    """Return a held-out record's drift, given start errors of log amplitude and frequency [rad/s].

    What is off from the beginning on is a rate over the time that it is weighed by.
    """
    weight = np.abs(measured) ** 2 * time
    rate_std = errors[0] * float(np.sum(weight) / np.sum(weight * time))
    noise = 2 * len(time) * noise_std**2
    return LeftOutDecay(drift_of(measured, predicted, time), errors[1], rate_std, noise, fraction)
