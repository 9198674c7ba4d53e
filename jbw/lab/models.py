"""The posteriors of the identification's steps, with simulators of their data, for calibration.

A simulator takes a random key, the true parameters and a design, and returns data in the form of
the design. The simulators have separate code for every law, so that an error in a likelihood is not
repeated here.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, Key
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.identification.coordinates import combinations
from jbw.identification.linear import line_fit
from jbw.identification.linear_step import NAMES
from jbw.identification.paper import kernel, simulated_kernel
from jbw.identification.paper.kernel import KernelData
from jbw.identification.paper.step4 import OpeningCurve, opening_curve
from jbw.identification.paper.step4 import log_likelihood as opening_likelihood
from jbw.identification.windowed import receptance
from jbw.inference.calibration.record import Calibration, judged
from jbw.inference.calibration.replications import (
    LOG_LIKELIHOOD,
    NUM_RANKS,
    Model,
    Quantity,
    ranked,
)
from jbw.inference.fit.locate import Search
from jbw.inference.generator import generator
from jbw.inference.space.box import Box, Product, from_unit, value_of
from jbw.inference.space.problem import Theta
from jbw.lab.designs import Design
from jbw.measurement.spectra import FRF
from jbw.observables.dataset import Dataset, log_likelihood, stacked
from jbw.observables.groups import changed
from jbw.observables.records import Records
from jbw.oscillator.oscillator import oscillator_of
from jbw.parts import Parts, unkept
from jbw.quantities import DEFAULT_LAWS
from jbw.rig.integrator import Specimen, State, doubles, runge_kutta
from jbw.rig.law_forces import forces_of

WHERE = 0.55  # fraction of a record after which a sweep has just passed the resonance
LOT = 100  # number of replications of Step 2 (FRF fit) per progress message
DRAWS = (4, 250)  # numbers of chains and of draws per chain in Step 2 (FRF fit)
STEPS = 8  # number of Runge-Kutta steps between two samples


class CalibratedStep(NamedTuple):
    """A step of the identification with its model, sampler and batch size for a calibration."""

    model: Model  # posterior, simulator, quantities, and the least-squares search for the posterior
    batch: int  # number of replications that run in parallel
    sampler: str  # fastest sampler that finds the whole posterior from any start in the prior
    stepped: bool = False  # whether an evaluation steps through time, which is expensive


def third_order(design: Design[KernelData], *, known_noise: bool = False) -> CalibratedStep:
    """Return the model of Step 3: zeta, alpha, delta from the third-order kernel, Eq. (36)."""
    data = design.data
    simulate = Partial(
        simulated_kernel.measured_kernel,
        design=data,
        num_repeats=int(data.num_repeats[0]),
        known_noise=known_noise,
    )
    likelihood = kernel.known_noise_log_likelihood if known_noise else kernel.log_likelihood
    quantities, logs = _products(design.prior)
    quantities |= simulated_kernel.ranked_quantities(data)
    search = Search(kernel.residual, logs)
    return CalibratedStep(
        Model(simulate, likelihood, design.prior, quantities, search), 100, "importance"
    )


def opening(design: Design[Records]) -> CalibratedStep:
    """Return the model of Step 4: gamma from sweeps, with all other parameters fixed."""

    def simulate(key: Key[Array, ""], theta: Theta) -> OpeningCurve:
        records = measured_records(key, _with_held(theta, design), design.data)
        return opening_curve(records, design.held, design.prior)

    return CalibratedStep(Model(simulate, opening_likelihood, design.prior), 100, "quadrature")


def joint(design: Design[Records]) -> CalibratedStep:
    """Return the model of the joint posterior: all parameters from sweeps."""

    def simulate(key: Key[Array, ""], theta: Theta) -> Dataset:
        records = measured_records(key, _with_held(theta, design), design.data)
        return Dataset.of([records], design.held)

    quantities, logs = _products(design.prior)
    quantities["response"] = _response
    search = Search(stacked, logs, 64, 30)
    model = Model(simulate, log_likelihood, design.prior, quantities, search)
    return CalibratedStep(model, 4, "amis", stepped=True)


def _with_held(theta: Theta, design: Design[Records]) -> Theta:
    return {**{name: jnp.asarray(value) for name, value in design.held.items()}, **theta}


def _response(theta: Theta, data: Dataset) -> Float[Array, ""]:
    """Return the response to the highest input level, shortly after the resonance is passed."""
    records = cast(Records, data.parts[0])
    at = round(WHERE * records.source.shape[-1])
    return records.predict({**data.held, **theta})[-1, at]


def _products(prior: Box) -> tuple[dict[str, Quantity], tuple[str, ...]]:
    """Return products that data determine better than their factors, and the positive factors."""
    every = combinations(prior.names)
    known_products = [product for product in every if set(product.factors) == product.powers.keys()]
    factors = {name for product in known_products for name in product.powers}
    bounds = zip(prior.names, np.asarray(prior.lower), strict=True)
    logs = tuple(name for name, low in bounds if name in factors and low > 0)
    return {product.name: Partial(_product, product=product) for product in known_products}, logs


def _product(theta: Theta, data: Any, product: Product) -> Float[Array, ""]:
    return value_of(product, theta)


def calibrate_linear(
    key: Key[Array, ""],
    design: FRF,
    prior: Box,
    *,
    num_replications: int = 1000,
    report: Callable[[int], None] = lambda done: None,
    parts: Parts = unkept,
) -> Calibration:
    """Rank true omega_n, zeta and gain among draws of Step 2's FRF fits, Eqs. (23), (38), (39)."""

    def replicated(lot: Key[Array, " replication"]) -> list[tuple[NDArray, NDArray, bool]]:
        return [_line_replication(one, design, prior) for one in lot]

    # A fit that finds no resonance counts as a failure.
    rows = []
    replication_keys = jax.random.split(key, num_replications)
    for first in range(0, num_replications, LOT):
        lot = partial(replicated, replication_keys[first : first + LOT])
        rows += parts(f"replications from {first}", lot)
        report(len(rows))
    keys = jax.random.split(jax.random.fold_in(key, num_replications), num_replications)
    rank = jax.jit(jax.vmap(ranked))
    ranks = rank(keys, *(jnp.array(column) for column in zip(*rows, strict=True)))
    return judged((*NAMES, LOG_LIKELIHOOD), ranks, NUM_RANKS)


def _line_replication(
    key: Key[Array, ""], design: FRF, prior: Box
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Simulate and fit FRF lines once; return the truth, draws, and whether the fit converged."""
    rng = generator(key)
    point = from_unit(rng.uniform(size=3), prior)
    theta = np.array([float(point[name]) for name in NAMES])
    # The formula is repeated here, because a call of the likelihood would hide an error of the
    # likelihood.
    omega_n, zeta, gain = theta
    stiffness = omega_n**2 - design.omega**2 + 2j * zeta * omega_n * design.omega
    # Real and imaginary part each have half of the variance.
    noise = rng.normal(size=(2, design.freq.size)) * np.sqrt(design.variance / 2)
    measured = replace(design, h=gain / stiffness + noise[0] + 1j * noise[1])
    try:
        fit = line_fit(measured, (measured.freq[0], measured.freq[-1]))
    except DataError:
        return np.append(theta, 0.0), np.full((*DRAWS, 4), np.nan), False
    draws = rng.multivariate_normal(fit.theta, fit.covariance, DRAWS)
    values = np.append(theta, _line_log_likelihood(theta, measured))
    likelihood = _line_log_likelihood(draws, measured)
    return values, np.concatenate([draws, likelihood[..., None]], axis=-1), True


def _line_log_likelihood(theta: Float[np.ndarray, "... 3"], measured: FRF) -> NDArray[np.float64]:
    """Return the log likelihood of all FRF lines, up to a constant [nats]."""
    omega_n, zeta, gain = np.moveaxis(theta[..., None], -2, 0)
    misfit = measured.h - receptance(measured.omega, omega_n, zeta, gain)
    return -np.sum(np.abs(misfit) ** 2 / measured.variance, axis=-1)


def measured_records(key: Key[Array, ""], theta: Theta, design: Records) -> Records:
    """Simulate noisy repeats: mean v + sigma eta / sqrt(K), variance sigma^2 chi^2_(N (K - 1))."""
    key_mean, key_within = jax.random.split(key)
    count, size = design.groups.num_repeats, design.source.shape[-1]
    noise_std = design.groups.noise_std
    column = ("displacement", "velocity").index(design.response)
    force = theta["gain"] * design.source
    clean = jax.vmap(lambda u: motion(theta, u, design.fs, design.laws)[:, column])(force)
    error = jax.random.normal(key_mean, clean.shape)
    mean = clean + (noise_std / jnp.sqrt(count))[:, None] * error
    within = noise_std**2 * 2 * jax.random.gamma(key_within, size * (count - 1) / 2)
    scatter = jnp.sqrt(within / (size * (count - 1)))
    groups = changed(design.groups, within=within, noise_std=scatter)
    return replace(design, mean=mean, groups=groups)


def motion(
    theta: Theta,
    force: Float[Array, " time"],
    fs: float,
    laws: Iterable[str] = DEFAULT_LAWS,
) -> Float[Array, "time 2"]:
    """Return displacement and velocity under a force [N/kg] from rest, Eqs. (1), (2).

    The time integration uses Runge-Kutta steps.
    """
    # The force between samples follows from the spectrum of the samples, because both ends are at
    # rest.
    joint = oscillator_of(theta, laws)
    # pyright: ignore[reportArgumentType]
    specimen = Specimen(joint.omega_n, joint.zeta, forces_of(joint.laws, jnp.asarray))  # pyright: ignore[reportArgumentType]
    h, size = 1 / (fs * STEPS), force.shape[-1]
    # Zeros are appended to the spectrum, which interpolates the input at the ends and middles of
    # the steps.
    fine = jnp.fft.irfft(jnp.fft.rfft(force), 2 * STEPS * size) * 2 * STEPS
    ends = jnp.concatenate([fine, fine[:1]])
    at = jnp.stack([ends[:-1:2], ends[1::2], ends[2::2]], axis=-1).reshape(size, STEPS, 3)

    def step(state: State, u: Float[Array, "3"]) -> tuple[State, None]:
        return runge_kutta(specimen.state_rate, specimen.settle, state, (u[0], u[1], u[2]), h), None

    def sample(state: State, u: Float[Array, "step 3"]) -> tuple[State, Float[Array, "2"]]:
        return jax.lax.scan(step, state, u)[0], jnp.stack(state[:2])

    return jax.lax.scan(sample, doubles((0.0, 0.0, specimen.at_rest())), at)[1]
