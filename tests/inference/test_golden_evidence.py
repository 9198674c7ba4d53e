"""Log evidence of four laws on a noisy path of Iwan's joint, against nested sampling elsewhere."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

import jbw
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.laws.iwan import Iwan4, MasingExponential
from jbw.oscillator.laws.jenkins import Jenkins

GOLD = json.loads((Path(__file__).parents[1] / "golden_laws.json").read_text())["evidence"]
Y, FORCE, SD = jnp.array(GOLD["y"]), jnp.array(GOLD["force"]), GOLD["sd"]

# From the golden coordinates, each flat in its box.
LAWS = {
    "jenkins": lambda k, f: Jenkins([jnp.exp(k)], [jnp.exp(f - k)]),
    "masing_exponential": lambda k, f: MasingExponential(jnp.exp(k), jnp.exp(k - f)),
    "iwan4": lambda k, f, chi, b: Iwan4.of_segalman(jnp.exp(k), jnp.exp(f), chi, jnp.exp(b)),
    "bouc_wen_1": lambda k, f, r: BoucWenLaw(
        jnp.exp(k), (1 - r) * jnp.exp(k - f), r * jnp.exp(k - f)
    ),
}


def left(name, x):
    """Residual over its standard deviation."""
    joint = jbw.Oscillator(200.0, 0.0, (LAWS[name](*x),))
    return (FORCE - (joint.force_along(Y) - joint.k * Y)) / SD


@pytest.mark.parametrize("name", LAWS)
def test_the_log_evidence_is_golden(name):
    golden = GOLD["laws"][name]
    low, high = np.array(golden["box"]).T
    names = [f"x{i}" for i in range(len(low))]

    def log_likelihood(theta, data):
        misfit = left(name, [theta[one] for one in names])
        # A likelihood without a value is an impossible one.
        terms = -0.5 * misfit**2 - 0.5 * np.log(2 * np.pi * SD**2)
        return jnp.where(jnp.all(jnp.isfinite(terms)), terms, -jnp.inf)

    residual = jax.jit(lambda x: left(name, x))
    best = least_squares(
        residual, golden["posterior_mean"], bounds=(low, high), x_scale=high - low, diff_step=1e-5
    )
    most = float(jnp.sum(log_likelihood(dict(zip(names, best.x, strict=True)), None)))
    # The golden one is the largest of those that were drawn.
    assert -0.02 < most - golden["max_log_likelihood"] < 1.0
    bounds = dict(zip(names, zip(low, high, strict=True), strict=True))
    tree = sample(
        jax.random.key(0), log_likelihood, box(bounds),
        jnp.zeros(1), sampler="amis", start=dict(zip(names, best.x, strict=True)),
        covariance=np.linalg.inv(best.jac.T @ best.jac),
    )  # fmt: skip
    # The golden evidence is told to 0.15, and by importance sampling within 0.2 of that.
    assert abs(tree.attrs["log_evidence"] - golden["log_evidence_importance"]) < 0.2
