r"""The drift of free decays away from the prediction that a law makes from their start.

$$E(t) = \hat E(t)\,e^{(-\rho + j\varphi)\,(t - t_0 / 2)} + \text{rest}, \qquad
  \hat\rho, \hat\varphi = -\frac{\sum_t w_t t \ln |E / \hat E|}{\sum_t w_t t^2},
  \frac{\sum_t w_t t \arg (E / \hat E)}{\sum_t w_t t^2}, \quad w = |E|^2$$

where $t_0$ is the length of the beginning, which determines a record's initial state and natural
frequency. A law whose frequency changes differently with amplitude drifts from the record, whatever
its frequency at the beginning.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float


class Drift(NamedTuple):
    """The drift of a record from its prediction, as a frequency [rad/s] and a decay rate [1/s]."""

    frequency: float
    rate: float
    rest: Complex[np.ndarray, " value"]  # residual of the envelope without the drift
    measured: Complex[np.ndarray, " value"]


def drift_of(
    measured: Complex[np.ndarray, " value"],
    predicted: Complex[np.ndarray, " value"],
    time: Float[np.ndarray, " value"],
) -> Drift:
    """Fit the drift of an envelope from its prediction, over time since the middle of its start."""
    ratio = measured / predicted
    weight = np.abs(measured) ** 2 * time
    along = np.sum(weight * time)
    frequency = float(np.sum(weight * np.unwrap(np.angle(ratio))) / along)
    rate = -float(np.sum(weight * np.log(np.abs(ratio))) / along)
    rest = measured - predicted * np.exp((-rate + 1j * frequency) * time)
    return Drift(frequency, rate, rest, measured)


class LeftOutDecay(NamedTuple):
    """The drift of one held-out record, with the errors that come from its initial state."""

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
    """Return a held-out record's drift, given errors of log amplitude and frequency [rad/s].

    An amplitude error that exists from the beginning acts like a rate over the weighted mean time.
    """
    weight = np.abs(measured) ** 2 * time
    rate_std = errors[0] * float(np.sum(weight) / np.sum(weight * time))
    noise = 2 * len(time) * noise_std**2
    return LeftOutDecay(drift_of(measured, predicted, time), errors[1], rate_std, noise, fraction)
