"""Step 3: zeta, alpha and delta from the third-order kernel around a third of the resonance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import jax
import numpy as np
import xarray as xr
from jaxtyping import Key
from numpy.typing import NDArray

from jbw.campaign.settings import Identify
from jbw.identification.linear import PooledFit
from jbw.identification.paper import kernel
from jbw.identification.paper.kernel import KernelData
from jbw.identification.step import Step, attrs, finished
from jbw.inference.fit.fitting import Fit, fit
from jbw.inference.posterior.summary import posterior_draws, shape_of
from jbw.inference.posterior.verdict import verdict
from jbw.inference.samplers.chunked_run import (
    UNSUPERVISED,
    Keep,
    Supervision,
    no_checkpoint,
)
from jbw.inference.samplers.sampling import SamplingRequest, draw_posterior
from jbw.inference.space.box import Box, bounds_about, box
from jbw.inference.space.problem import Target
from jbw.inference.space.ridge import along_ridge
from jbw.measurement.probing import ThirdOrder, third_order_kernel
from jbw.measurement.records import Test
from jbw.oscillator.law import Bounds, Scales
from jbw.oscillator.oscillator import prior_of
from jbw.paper.kernels import cubic_stiffness, softened_receptance
from jbw.paper.objectives import kernel_energy
from jbw.report.messages import paper_steps as messages

NAMES = ("zeta", "alpha", "delta")
# Half widths of the prior ranges of Teloli et al., divided by their centres: alpha in [424.31,
# 589.61] is 507 +- 16.3 %.
PAPER_HALF_WIDTH = {"zeta": 0.20, "alpha": 0.163, "delta": 0.20, "gamma": 0.41}
SAMPLERS = {
    "third_order_nuts": SamplingRequest("nuts", num_warmup=500, num_samples=500),
    "third_order_paper": SamplingRequest("random_walk_paper"),
    "third_order_walk": SamplingRequest("random_walk", num_warmup=2000, num_samples=20_000),
}


@dataclass(frozen=True)
class KernelFit:
    """The initial fit to the third-order kernel (Step 3), with bounds and measured kernels."""

    kernels: tuple[ThirdOrder, ...]
    data: KernelData
    fit: Fit
    box: Box


def about(centre: Mapping[str, float], half_width: Mapping[str, float]) -> Bounds:
    """Return prior bounds at given relative distances on both sides of the initial kernel fit."""
    return {
        name: bounds_about(centre[name], 1 - share, 1 + share)
        for name, share in half_width.items()
        if name in centre
    }


def measured_kernels(tests: Sequence[Test], linear: PooledFit) -> tuple[ThirdOrder, ...]:
    """Return the third-order kernel from each tone, corrected for the source's third harmonic.

    The source's harmonic excites the structure while it slides under the tone, which is softer than
    in Step 2. A first kernel by H1 shows how much softer; the second kernel uses the softer
    receptance. The input is per unit mass.

    Reference:
        Eqs. (29), (30).
    """
    first = [_measured_kernel(test, linear, 0.0) for test in tests]
    products = [_product(measured, linear) for measured in first if measured.above_noise]
    if not products:
        return tuple(first)
    softer = [2 * np.median(products) * np.mean(np.abs(measured.y_1)) / np.pi for measured in first]
    return tuple(
        _measured_kernel(test, linear, float(less))
        for test, less in zip(tests, softer, strict=True)
    )


def _product(measured: ThirdOrder, linear: PooledFit) -> float:
    r"""Return alpha*delta from a measured kernel, by the leading term of Eq. (31) [1/(m s^2)].

    $$\lambda_3 \approx -\frac{35\,\alpha\delta}{96\,Y}, \qquad
      \lambda_3 = -\mathrm{Re}\frac{H_3}{H_1(\omega)^3 H_1(3\omega)}$$
    """
    h_3 = np.mean(measured.h3)
    lambda_3 = cubic_stiffness(h_3, measured.omega, linear.omega_n, linear.zeta)
    return float(-96 * np.mean(measured.y_peak) * lambda_3 / 35)


def _measured_kernel(test: Test, linear: PooledFit, softer: float) -> ThirdOrder:
    r"""Return the kernel measured in one test, with the receptance that the test's tone softens.

    $$\frac1{H(3\omega)} = \frac1{H_1(3\omega)} - \frac{2\,\alpha\delta\,|Y_1|}{\pi}$$

    This is, to first order, the mean over a period of the slope alpha (1 - delta |y|) of Eq. (2);
    `softer` is its second term [1/s^2].
    """
    omega = 2 * np.pi * test.tones_hz[0]
    role = test.records[0].source
    u = np.stack([linear.gain * record.channels[role] for record in test.records])
    response = test.records[0].response
    y = np.stack([record.channels[response] for record in test.records])
    receptance = complex(softened_receptance(3 * omega, linear.omega_n, linear.zeta, softer))
    return third_order_kernel(
        u, y, test.records[0].fs, omega,
        h1_3omega=receptance, response=response, delay=test.delay, start=test.settle,
    )  # fmt: skip


def fit_kernel(key: Key, tests: Sequence[Test], linear: PooledFit, settings: Identify) -> KernelFit:
    """Fit zeta, alpha and delta to tones at a third of the resonance; return fit and bounds.

    The prior bounds are the campaign's if it states any, otherwise those with the relative widths
    of Teloli et al. around a first fit within physical bounds. If the optimum lies at its bounds,
    `fit.at_bound` says so.

    Reference:
        Eqs. (38), (39).
    """
    kernels = measured_kernels(tests, linear)
    data = kernel.reduce(kernels, linear.omega_n)
    bounds = {name: pair for name, pair in settings.prior.items() if name in NAMES}
    if set(bounds) != set(NAMES):
        scales = Scales(linear.omega_n, linear.zeta, float(np.max(data.y_peak)))
        wide = {"zeta": (0.2 * linear.zeta, 3.0 * linear.zeta), **prior_of(["bouc_wen"], scales)}
        first = fit(kernel.residual, box({n: wide[n] for n in NAMES}), data, starts=16, key=key)
        bounds = {**about(first.theta, PAPER_HALF_WIDTH), **bounds}
    prior = box({name: bounds[name] for name in NAMES})
    return KernelFit(kernels, data, fit(kernel.residual, prior, data, starts=16, key=key), prior)


def third_order_steps(
    key: Key,
    step: KernelFit,
    settings: Identify,
    *,
    keep: Keep = no_checkpoint,
    statements: Sequence[str] = (),
) -> dict[str, Step]:
    """Sample zeta, alpha and delta given the third-order kernel: NUTS, two random walks (Step 3).

    NUTS and the tuned walk use coordinates along the ridge alpha*delta, from wall to wall of the
    box, with the noise integrated out. The walk of Teloli et al. uses the box itself, with the
    noise as estimated. All chains start dispersed, so that their comparison is meaningful: the
    published chain, started at one optimum, always agrees with itself. `statements` are put before
    those of each step.

    Reference:
        Eqs. (35), (36).
    """
    notes = tuple(note for measured in step.kernels for note in measured.notes)
    steps = {}
    known_noise = Target(kernel.known_noise_log_likelihood, step.box, step.data)
    for draw_key, (name, request) in zip(jax.random.split(key, 3), SAMPLERS.items(), strict=True):
        started = perf_counter()
        request = request._replace(num_chains=settings.num_chains, chain_method="vectorized")
        supervision = Supervision(kept=keep(name))
        if name == "third_order_paper":
            tree = draw_posterior(
                draw_key, known_noise, request, supervision=supervision, attrs=attrs()
            )
        else:
            tree = draw(draw_key, step, request._replace(options={"adapt_mass": True}), supervision)
        steps[name] = finished(
            name, tree, step.box, step.fit, started,
            findings=verdict(tree, step.box, chi_square=step.fit.chi_square).findings,
            statements=(*statements, _product_sentence(tree), *notes),
        )  # fmt: skip
    return steps


def draw(
    key: Key,
    step: KernelFit,
    request: SamplingRequest,
    supervision: Supervision = UNSUPERVISED,
) -> xr.DataTree:
    """Draw the posterior of Step 3 along the ridge of constant alpha*delta; integrate out noise."""
    noisy = as_noise(step.fit)
    ridge = along_ridge(noisy.theta, noisy.covariance, step.box)
    target = Target(kernel.log_likelihood, step.box, step.data)
    return draw_posterior(key, target, request, ridge, supervision=supervision, attrs=attrs())


def as_noise(best: Fit) -> Fit:
    """Return a fit with its covariance enlarged as if its residual were noise."""
    chi_square, dof = best.chi_square
    return replace(best, covariance=best.covariance * max(1.0, chi_square / max(dof, 1)))


def _product_sentence(tree: xr.DataTree) -> str:
    """Return the sentence on alpha*delta, which the third-order kernel determines."""
    posterior = posterior_draws(tree)
    product = (posterior["alpha"] * posterior["delta"]).values
    low, high = np.quantile(product, [0.005, 0.995])
    return messages.product(product.mean(), low, high)


def predicted(posterior: xr.Dataset, data: KernelData) -> NDArray[np.complex128]:
    """Return each draw's third-order kernel at the tones [m^-2 s^6], shape (draw, freq)."""
    theta = {name: posterior[name].values.ravel() for name in NAMES}
    return np.asarray(jax.vmap(lambda t: kernel.predict(t, data))(theta))


def integrals(posterior: xr.Dataset, data: KernelData) -> np.ndarray:
    r"""Return each draw's energy of the third-order kernel in the tones' band, (chain, draw).

    $$\int_B |H_3(\omega)|^2\,\mathrm{d}\omega$$

    Reference:
        Eq. (40).
    """
    integral = np.asarray(kernel_energy(predicted(posterior, data), np.asarray(data.omega)))
    return integral.reshape(shape_of(posterior))
