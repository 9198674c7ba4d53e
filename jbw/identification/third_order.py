"""Step 3: zeta, alpha and delta from the third-order kernel around a third of the resonance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Key

from jbw.identification.linear import PooledFit
from jbw.identification.priors import PAPER_HALF_WIDTH, about, physical, stated
from jbw.inference.box import Box, box
from jbw.inference.fitting import Fit, fit
from jbw.inference.sampling import sample
from jbw.measurement.harmonics import ThirdOrder
from jbw.measurement.probing import third_order_kernel
from jbw.measurement.records import Test
from jbw.observables import kernel
from jbw.observables.kernel import KernelData
from jbw.oscillator.volterra import h1

NAMES = ("zeta", "alpha", "delta")
ATTRS = {
    "zeta": {"units": "1", "long_name": "damping ratio"},
    "alpha": {"units": "s-2", "long_name": "stiffness of the hysteretic part"},
    "delta": {"units": "m-1", "long_name": "softening of the hysteresis"},
}


@dataclass(frozen=True)
class KernelFit:
    """The initial fit of Step 3.

    Attributes:
        kernels: The measured kernel of each probing test.
        data: Their sufficient statistics.
        fit: Least squares in the box.
        box: The prior box of the posterior.
    """

    kernels: tuple[ThirdOrder, ...]
    data: KernelData
    fit: Fit
    box: Box


def measured_kernels(tests: Sequence[Test], linear: PooledFit) -> tuple[ThirdOrder, ...]:
    """The measured third-order kernel of every probing test, the source's harmonic taken out.

    Args:
        tests: Probing tests with one tone each.
        linear: Step 2: gain, and H1 at three times the tone.

    Returns:
        One kernel a test, input per unit mass.

    Reference:
        Eqs. (29), (30).
    """
    return tuple(_measured_kernel(test, linear) for test in tests)


def _measured_kernel(test: Test, linear: PooledFit) -> ThirdOrder:
    omega = 2 * np.pi * test.tones_hz[0]
    role = test.records[0].source
    u = np.stack([linear.gain * record.channels[role] for record in test.records])
    response = test.records[0].response
    y = np.stack([record.channels[response] for record in test.records])
    receptance = complex(h1(3 * omega, linear.omega_n, linear.zeta))
    return third_order_kernel(
        u, y, test.records[0].fs, omega,
        h1_3omega=receptance, response=response, delay=test.delay, start=test.settle,
    )  # fmt: skip


def fit_kernel(
    key: Key, tests: Sequence[Test], linear: PooledFit, settings: Mapping[str, Any]
) -> KernelFit:
    """The initial fit of zeta, alpha and delta, and the box of their posterior.

    The box is the campaign's where it states one, otherwise the paper's widths about a first fit
    within physical bounds.

    Args:
        key: Random key of the starts.
        tests: Probing tests.
        linear: Step 2.
        settings: The campaign's [identify] table.

    Returns:
        The fit in the box, at whose bounds the optimum may lie: it is said in `fit.at_bound`.

    Reference:
        Eqs. (38), (39).
    """
    kernels = measured_kernels(tests, linear)
    data = kernel.reduce(kernels, linear.omega_n)
    bounds = {name: pair for name, pair in stated(settings).items() if name in NAMES}
    if set(bounds) != set(NAMES):
        wide = physical(linear.omega_n, linear.zeta, float(np.max(data.y_peak)))
        first = fit(kernel.residual, box({n: wide[n] for n in NAMES}), data, starts=16, key=key)
        centred = about(first.theta, {name: PAPER_HALF_WIDTH[name] for name in NAMES})
        bounds = {**centred, **bounds}
    prior = box({name: bounds[name] for name in NAMES})
    return KernelFit(kernels, data, fit(kernel.residual, prior, data, starts=16, key=key), prior)


def sample_kernel(key: Key, step: KernelFit, sampler: str, **options: Any) -> xr.DataTree:
    """Posterior of zeta, alpha and delta by (36), started as the sampler asks for it.

    "nuts" starts dispersed over the box; the paper's walk too, so that its chains can be compared:
    from one optimum they would agree with each other and with nothing else.

    Args:
        key: Random key.
        step: The initial fit.
        sampler: "nuts", "random_walk" or "random_walk_paper".
        options: Further options of `jbw.inference.sampling.sample`.

    Returns:
        The posterior.

    Reference:
        Eqs. (35), (36).
    """
    return sample(
        key, kernel.log_likelihood, step.box, step.data, sampler=sampler, attrs=ATTRS, **options
    )  # fmt: skip


def integrals(posterior: xr.Dataset, data: KernelData) -> np.ndarray:
    r"""Energy of each draw's kernel over the probing band, for conv(n_s).

    $$\int_B |H_3(\omega)|^2\,\mathrm{d}\omega$$

    Args:
        posterior: Draws of zeta, alpha and delta.
        data: The probing frequencies.

    Returns:
        One integral a draw, shape (chain, draw).

    Reference:
        Eq. (40).
    """
    theta = {name: posterior[name].values.ravel() for name in NAMES}
    magnitude = np.abs(np.asarray(jax.vmap(lambda t: kernel.predict(t, data))(theta))) ** 2
    integral = np.trapezoid(magnitude, np.asarray(data.omega), axis=-1)
    return integral.reshape(posterior.sizes["chain"], posterior.sizes["draw"])
