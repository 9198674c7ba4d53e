"""Step 4's posterior by NUTS, the walk and quadrature, and by a grid that shares no code with them.

The outside answer integrates the paper's equations by numpy, at 241 values of gamma, and sums.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.interpolate import CubicSpline

from jbw.identification.paper.step4 import log_likelihood, opening_curve
from jbw.inference.posterior.summary import diagnose
from jbw.inference.samplers.sampling import sample
from jbw.lab import designs
from jbw.lab.models import measured_records

SEEDS = (0,)
STEPS = 8


def velocities(gammas, force, held):
    """Velocity at the samples, (time, gamma), by Runge-Kutta steps of numpy."""
    size, h = len(force), 1 / (designs.FS * STEPS)
    fine = np.fft.irfft(np.fft.rfft(force), 2 * STEPS * size) * 2 * STEPS
    fine = np.append(fine, fine[0])

    def rate(state, u):
        y, v, z = state
        a = u - 2 * held["zeta"] * held["omega_n"] * v - z
        a = a - (held["omega_n"] ** 2 - held["alpha"]) * y
        slip = gammas * np.abs(v) * z + held["delta"] * v * np.abs(z)
        return np.array([v, a, held["alpha"] * v - slip])

    state, found = np.zeros((3, len(gammas))), []
    for i in range(size * STEPS):
        if i % STEPS == 0:
            found.append(state[1])
        u = fine[2 * i : 2 * i + 3]
        k_1 = rate(state, u[0])
        k_2 = rate(state + h / 2 * k_1, u[1])
        k_3 = rate(state + h / 2 * k_2, u[1])
        k_4 = rate(state + h * k_3, u[2])
        state = state + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
    return np.array(found)


def outside(records, held, lower, upper):
    """Mean and sd of gamma: Student's marginal of the noise, by Simpson's rule."""
    coarse = np.linspace(lower, upper, 241)
    log_p = 0.0
    for level, source in enumerate(np.asarray(records.source)):
        v = velocities(coarse, held["gain"] * source, held)
        count = float(records.groups.num_repeats[level])
        misfit = count * np.sum((np.asarray(records.mean[level])[:, None] - v) ** 2, axis=0)
        total = misfit + float(records.groups.within[level])
        log_p = log_p - count * len(source) / 2 * np.log(total)
    gamma = np.linspace(lower, upper, 20_001)
    log_p = CubicSpline(coarse, log_p)(gamma)
    p = np.exp(log_p - log_p.max())
    mean = simpson(p * gamma, x=gamma) / simpson(p, x=gamma)
    return mean, np.sqrt(simpson(p * (gamma - mean) ** 2, x=gamma) / simpson(p, x=gamma))


@pytest.mark.release  # test_comparing.py compares samplers
@pytest.mark.parametrize("seed", SEEDS)
def test_samplers_agree_with_the_outside_answer_on_step_4(seed):
    design = designs.opening()
    truth = {n: jnp.asarray(v) for n, v in designs.truth().items()}
    key = jax.random.key(seed)
    records = measured_records(key, truth, design.data)
    curve = opening_curve(records, design.held, design.prior)
    lower, upper = float(design.prior.lower[0]), float(design.prior.upper[0])
    mean, sd = outside(records, design.held, lower, upper)
    for sampler in ("nuts", "random_walk", "quadrature"):
        tree = sample(key, log_likelihood, design.prior, curve, sampler=sampler)
        values = tree["posterior"]["gamma"].values
        ess = diagnose(values)["ess_bulk"]
        assert abs(values.mean() - mean) < 4 * sd / np.sqrt(ess), sampler
        assert abs(values.std() / sd - 1) < 4 * np.sqrt(1 / ess), sampler
        if sampler == "quadrature":
            exact = tree["exact"].to_dataset()
            # The likelihood's two steps a sample move the velocity by 3e-6 m/s, of 2.5 mm/s noise.
            np.testing.assert_allclose(exact["mean"], mean, atol=0.02 * sd)
            np.testing.assert_allclose(exact["sd"], sd, rtol=0.02)
