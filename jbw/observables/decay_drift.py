r"""The drift of free decays away from the prediction that a law makes from their start.

$$E(t) = \hat E(t)\,e^{(-\rho + j\varphi)\,(t - t_0 / 2)} + \text{rest}, \qquad
  \hat\rho, \hat\varphi = -\frac{\sum_t w_t t \ln |E / \hat E|}{\sum_t w_t t^2},
  \frac{\sum_t w_t t \arg (E / \hat E)}{\sum_t w_t t^2}, \quad w = \min(|E|, |\hat E|)^2$$

Where the motion has ended, one of the envelopes is small: noise there has no weight at any length.
$t_0$ is the length of the beginning, which determines a record's initial state and natural
frequency. A law whose frequency changes differently with amplitude drifts from the record, whatever
its frequency at the beginning.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

# A value is used if its amplitude exceeds the noise by this factor: its phase is then known to a
# third of a radian, so that full rotations are counted correctly.
ABOVE_NOISE = 3.0


class Drift(NamedTuple):
    """The drift of a record from its prediction, as errors of frequency [rad/s] and rate [1/s]."""

    frequency: float
    rate: float
    rest: Complex[np.ndarray, " value"]  # residual of the envelope without the drift
    measured: Complex[np.ndarray, " value"]
    weight: Float[np.ndarray, " value"]  # weight of each value, multiplied by the time of the value


def drift_of(
    measured: Complex[np.ndarray, " value"],
    predicted: Complex[np.ndarray, " value"],
    time: Float[np.ndarray, " value"],
    noise_std: float = 0.0,
) -> Drift:
    """Fit the drift of an envelope from its prediction, after the start of the record.

    Values that do not exceed the noise have no weight. The drift is zero if no value exceeds it.
    """
    smaller = np.minimum(np.abs(measured), np.abs(predicted))
    weight = np.where(smaller > ABOVE_NOISE * noise_std, smaller, 0.0) ** 2 * time
    heard = weight > 0.0
    ratio = measured[heard] / predicted[heard]
    along = np.sum((weight * time)[heard]) if np.any(heard) else np.inf
    frequency = float(np.sum(weight[heard] * np.unwrap(np.angle(ratio))) / along)
    rate = -float(np.sum(weight[heard] * np.log(np.abs(ratio))) / along)
    rest = measured - predicted * np.exp((-rate + 1j * frequency) * time)
    return Drift(frequency, rate, rest, measured, weight)


class LeftOutDecay(NamedTuple):
    """The drift of a held-out record from its prediction, with standard errors and noise share."""

    drift: Drift
    frequency_std: float  # standard error of the drift's frequency [rad/s]
    rate_std: float  # standard error of the drift's decay rate [1/s]
    noise: float  # share of the remaining sum of squares that noise explains
    fraction: float  # fraction of the record's values that count as independent


def left_out_decay(
    measured: Complex[np.ndarray, " value"],
    predicted: Complex[np.ndarray, " value"],
    time: Float[np.ndarray, " value"],
    errors: tuple[float, float],
    noise_std: float,
    fraction: float,
) -> LeftOutDecay:
    r"""Return a held-out record's drift from its prediction, with the standard errors of the drift.

    An amplitude error that exists from the beginning acts like a rate over the weighted mean time.
    Noise $\sigma$ of which a share f is independent adds $\sigma / \sqrt{f \sum w t^2}$ to both.
    Both errors are infinite if no value exceeds the noise.
    """
    noise = 2 * len(time) * noise_std**2
    drift = drift_of(measured, predicted, time, noise_std)
    along = float(np.sum(drift.weight * time))
    if along == 0.0:
        return LeftOutDecay(drift, np.inf, np.inf, noise, fraction)
    of_noise = noise_std / np.sqrt(fraction * along)
    of_beginning = errors[1], errors[0] * float(np.sum(drift.weight)) / along
    frequency_std, rate_std = (float(np.hypot(error, of_noise)) for error in of_beginning)
    return LeftOutDecay(drift, frequency_std, rate_std, noise, fraction)
