"""Laws fitted to frequency and damping against amplitude, and the order in which they fit them."""

import jax
import numpy as np
import pytest
from decays import OMEGA_N, ZETA, decay_test

import jbw
from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.identification.curve_fit import from_readings, rows_of_curve
from jbw.measurement.resonances import AmplitudeCurve
from jbw.oscillator.oscillator import oscillator_of

JOINTS = {
    "bouc_wen": {"alpha": 400.0, "delta": 300.0, "gamma": 25.0},
    "masing_power": {"power_loss": 90.0, "power_exponent": 0.45},
    "cubic": {"cubic": -3e6},
}
NUM = 24


def curve(law, frequency_error, seed):
    """The backbone of a law in closed form, with independent relative errors."""
    joint = oscillator_of({"omega_n": OMEGA_N, "zeta": ZETA, **JOINTS[law]}, (law,))
    y = np.geomspace(2e-4, 3e-3, NUM)
    exact, rng = jbw.backbone(joint, y), np.random.default_rng(seed)
    sd = frequency_error * OMEGA_N, 0.01 * ZETA
    omega, zeta = (
        np.asarray(x) + s * rng.standard_normal(NUM)
        for x, s in zip((exact.omega, exact.zeta), sd, strict=True)
    )
    return AmplitudeCurve(y, omega, zeta, *(s**2 * np.eye(NUM) for s in sd))


def fitted(law, seen, below=np.inf):
    low = -0.2 if law == "cubic" else 0.2  # relative to the truth
    bounds = {name: sorted((low * x, 5 * x)) for name, x in JOINTS[law].items()}
    settings = Identify(prior=bounds)
    data = assemble(measured([decay_test()], settings, laws=(law,)))
    return from_readings(jax.random.key(0), data, settings, seen, below=below)


@pytest.mark.parametrize("truth", JOINTS)
def test_the_law_that_made_a_curve_has_the_smallest_criterion(truth):
    seen = curve(truth, 1e-5, seed=len(truth))
    found = {law: fitted(law, seen) for law in JOINTS}
    criteria = {law: one.criterion for law, one in found.items()}
    # A difference of 10 is decisive evidence (Kass and Raftery 1995).
    assert all(criteria[law] > criteria[truth] + 10 for law in JOINTS if law != truth)
    exact = {"omega_n": OMEGA_N, "zeta": ZETA, **JOINTS[truth]}
    ours, theirs = (
        jbw.backbone(oscillator_of(theta, (truth,)), seen.y)
        for theta in (found[truth].theta, exact)
    )
    # The rows' errors: 1e-5 of the frequency, or 1 % of its change; 1 % of the damping.
    change = np.ptp(np.asarray(theirs.omega))
    np.testing.assert_allclose(ours.omega, theirs.omega, atol=3 * (1e-5 * OMEGA_N + 0.01 * change))
    np.testing.assert_allclose(ours.zeta, theirs.zeta, rtol=0.05)


def test_a_law_whose_parameters_alone_exceed_a_criterion_is_not_fitted():
    seen = curve("cubic", 1e-5, seed=1)
    penalty = 3 * np.log(2 * NUM)  # omega_n, zeta and the spring
    assert fitted("cubic", seen, below=penalty) is None
    assert fitted("cubic", None) is None
    assert fitted("cubic", seen, below=penalty + 500) is not None


def test_the_rows_have_the_errors_of_the_curve():
    """Of a linear record without change only the stated errors and the floors remain."""
    sd = 2e-4, 5e-5
    flat = AmplitudeCurve(
        np.geomspace(1e-4, 1e-3, 5), np.full(5, OMEGA_N), np.full(5, ZETA),
        *(s**2 * np.eye(5) for s in (sd[0] * OMEGA_N, sd[1])),
    )  # fmt: skip
    rows = rows_of_curve(flat)
    np.testing.assert_allclose(rows.values, [1.0] * 5 + [2 * ZETA] * 5)
    errors = np.sqrt(np.diag(rows.factor @ rows.factor.T))
    np.testing.assert_allclose(errors[:5], 2 * sd[0], rtol=1e-5)
    np.testing.assert_allclose(errors[5:], np.hypot(2 * sd[1], 2e-3 * 2 * ZETA))
