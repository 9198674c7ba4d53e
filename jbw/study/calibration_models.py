"""The posteriors of the procedure beside simulators of their data, ready to be calibrated."""

from collections.abc import Callable
from typing import NamedTuple, cast

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, Key

from jbw.identification.paper import kernel
from jbw.identification.paper.kernel import KernelData
from jbw.identification.paper.step4 import OpeningCurve, opening_curve
from jbw.identification.paper.step4 import log_likelihood as opening_likelihood
from jbw.inference.calibration.replications import Model
from jbw.inference.fit.locate import Search
from jbw.inference.space.box import Box
from jbw.inference.space.problem import Theta
from jbw.observables.dataset import Dataset, log_likelihood, stacked
from jbw.observables.records import Records
from jbw.study.calibration_designs import KernelDesign, SweepDesign
from jbw.study.simulators import kernel_of_known_noise, measured_kernel, measured_records

PRODUCTS = {"alpha_delta": ("alpha", "delta"), "alpha_gamma": ("alpha", "gamma")}
WHERE = 0.55  # of a record, where a sweep has just passed the resonance


class Step(NamedTuple):
    """One calibration.

    Attributes:
        model: Posterior, simulator and quantities, and how least squares find the posterior.
        batch: Replications side by side.
        sampler: The cheapest that crosses this posterior.
        stepped: Whether an evaluation steps through time, and costs accordingly.
    """

    model: Model
    batch: int
    sampler: str
    stepped: bool = False


def third_order(design: KernelDesign, *, known_noise: bool = False) -> Step:
    """Step 3: zeta, alpha and delta from the kernel at the probing tones.

    Args:
        design: Tones, noise and prior.
        known_noise: Whether the likelihood is told the noise, as (36) supposes; otherwise it has to
            learn it from the repeats, as Step 3 does.
    """
    simulate = kernel_of_known_noise if known_noise else measured_kernel
    quantities = {
        **_products(design.prior.names),
        "lambda_3": _lambda_3,
        **{
            f"h3_{hertz:.4g}Hz": Partial(_h3_magnitude, index=i)
            for i, hertz in enumerate(np.asarray(design.data.omega) / (2 * np.pi))
        },
    }
    model = Model(
        Partial(simulate, design=design.data, num_repeats=design.num_repeats),
        kernel.known_noise_log_likelihood if known_noise else kernel.log_likelihood,
        design.prior,
        quantities,
        Search(kernel.residual, _logs(design.prior)),
    )
    return Step(model, 100, "importance")


def _lambda_3(theta: Theta, data: KernelData) -> Float[Array, ""]:
    """The paper's lambda_3 at the displacement of the first tone."""
    delta, y_peak = theta["delta"], data.y_peak[0]
    return theta["alpha"] * (delta**2 / 6 - 35 * delta / (96 * y_peak))


def _h3_magnitude(theta: Theta, data: KernelData, index: int) -> Float[Array, ""]:
    return jnp.abs(kernel.predict(theta, data))[index]


def opening(design: SweepDesign) -> Step:
    """Step 4: gamma from sweeps, everything else held.

    Args:
        design: Sweeps, noise, what is held, prior.
    """

    def simulate(key: Key[Array, ""], theta: Theta, held: Theta) -> OpeningCurve:
        whole = {**held, **theta}
        records = measured_records(key, whole, design.records, design.noise_std)
        return opening_curve(records, design.held, design.prior)

    held = {name: jnp.asarray(value) for name, value in design.held.items()}
    model = Model(Partial(simulate, held=held), opening_likelihood, design.prior)
    return Step(model, 100, "quadrature")


def joint(design: SweepDesign) -> Step:
    """All parameters from sweeps.

    Args:
        design: Sweeps, noise, what is held, prior.
    """
    held = {name: jnp.asarray(value) for name, value in design.held.items()}

    def simulate(key: Key[Array, ""], theta: Theta) -> Dataset:
        whole = {**held, **theta}
        records = measured_records(key, whole, design.records, design.noise_std)
        return Dataset.of([records], design.held)

    model = Model(
        simulate,
        log_likelihood,
        design.prior,
        {**_products(design.prior.names), "response": _response},
        Search(stacked, _logs(design.prior), 64, 30),
    )
    return Step(model, 4, "importance", stepped=True)


def _response(theta: Theta, data: Dataset) -> Float[Array, ""]:
    """Response of the last level at one instant, shortly after the resonance."""
    records = cast(Records, data.parts[0])
    at = round(WHERE * records.source.shape[-1])
    return records.predict({**data.held, **theta})[-1, at]


def _products(names: tuple[str, ...]) -> dict[str, Callable[[Theta, object], Float[Array, ""]]]:
    wanted = {one: both for one, both in PRODUCTS.items() if set(both) <= set(names)}
    return {one: Partial(_product, names=both) for one, both in wanted.items()}


def _product(theta: Theta, data: object, names: tuple[str, str]) -> Float[Array, ""]:
    return theta[names[0]] * theta[names[1]]


def _logs(prior: Box) -> tuple[str, ...]:
    """Parameters whose product is known better than they are, and that cannot be zero."""
    wanted = set().union(*PRODUCTS.values())
    known = zip(prior.names, np.asarray(prior.lower), strict=True)
    return tuple(name for name, low in known if name in wanted and low > 0)
