"""Comparison of free decays of several modes, each record from its own initial state."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Key

from jbw.measurement.envelopes import bands_of
from jbw.measurement.records import Test
from jbw.observables.decay import Decays
from jbw.observables.modal_decays import MatchedEnvelopes, ModalDecays, match, modal_envelopes
from jbw.observables.modes import Modes
from jbw.oscillator.modes.parameters import structure_of
from jbw.verification.predicted import Source, carry
from jbw.verification.predictive_basis import Draws, Laws, count_of, natural_hz

Envelope = Complex[np.ndarray, "*draw time"]
Envelopes = dict[str, Envelope]
# A function of a random key, the section of a record that determines its initial state, the times
# [s], and the law's initial frequency error [rad/s]. It returns the envelopes of all draws and
# reference models.
Entered = Callable[
    [Key[Array, ""], Decays, Float[np.ndarray, " time"], float], tuple[Envelope, Envelopes]
]
OWN = "own_{}"  # name of a draw's standard normal deviation from the best initial state


def modes_of_draws(draws: Draws) -> Modes | None:
    """Return the modes with the mean frequencies of the draws; None for a single mode."""
    hz = tuple(natural_hz(draws))
    return Modes(hz) if len(hz) > 1 else None


def first_mode_alone(test: Test, modes: Modes | None) -> Test:
    """Return decays restricted to the band of the first of several modes."""
    return test if modes is None else replace(test, band_hz=bands_of(modes.hz, test)[0])


def followed(source: Source) -> Entered:
    """Return a function that predicts records of several modes, with an initial state per draw."""

    def entered(
        key: Key[Array, ""], seen: Decays, time: Float[np.ndarray, " time"], law_std: float
    ) -> tuple[Envelope, Envelopes]:
        def along(draws: Draws, laws: Laws) -> Envelope:
            size = (count_of(draws), seen.groups.num_own)
            draws_of_start = np.asarray(jax.random.normal(key, size)) * (size[0] > 1)
            white = {OWN.format(i): column for i, column in enumerate(draws_of_start.T)}
            return carry(_follow, {**draws, **white}, replace(seen, laws=laws), len(time))

        return source.carried(along)

    return entered


def _follow(theta: Mapping[str, Array], seen: ModalDecays, length: int) -> Complex[Array, " time"]:
    """Return a record's envelope for one draw of its initial state and frequency shift."""
    structure = structure_of(theta, seen.laws)
    record = MatchedEnvelopes(seen.mean[0], seen.begun[0], seen.amplitude[0])
    matched = match(structure, record, seen)
    start = jnp.append(matched.entry.state, matched.entry.shift)
    # As for one mode, the noise of the fitted records determines how well a short start is known;
    # the frequency shift also has its prior.
    precision = matched.precision * seen.fraction / seen.groups.noise_std[0] ** 2
    covariance = jnp.linalg.inv(precision.at[-1, -1].add(1 / seen.shift_std**2))
    centre = -covariance[:, -1] * matched.entry.shift / seen.shift_std**2
    off = jnp.stack([theta[OWN.format(i)] for i in range(seen.groups.num_own)])
    start = start + centre + jnp.linalg.cholesky(covariance) @ off
    full_rate = replace(
        seen,
        stride=1,
        step_s=1 / seen.fs,
        rotation=jnp.exp(-2j * jnp.pi * seen.centre_hz / seen.fs),
        num_samples=length + len(seen.taps) - 1,
    )
    return modal_envelopes(structure, start, full_rate).sum(axis=0)
