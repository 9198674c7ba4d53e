"""Two modes with one joint from their free decays alone, made without jbw: the truth is found."""

import jax
import numpy as np
import pytest
from modal_decays import STARTS, STATED, TRUTH, modal_decay_test

from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.identification.coordinates import box_of
from jbw.identification.curve_fit import from_amplitude_curve
from jbw.identification.first_fit import inside
from jbw.inference.fit.costly_fit import costly_fit
from jbw.observables.dataset import Dataset, stacked
from jbw.observables.drives import told_by
from jbw.observables.noise import with_fitted_noise

SETTINGS = Identify.of({"offsets": "none", "fit_repeats": 3})
# Relative standard errors by differences of 1e-4 about the truth.
ERRORS = {
    "omega_n": 5.4e-6, "zeta": 1.1e-3, "alpha": 1.6e-2, "delta": 1.7e-2, "gamma": 1.6e-2,
    "omega_2": 2.9e-6, "zeta_2": 2.1e-4, "shape_2": 1.5e-3, "coupling_2": 2.0e-3,
}  # fmt: skip


@pytest.mark.slow
def test_a_fit_from_first_values_recovers_the_truth_within_its_errors():
    test = modal_decay_test(STARTS[:3], settle=0.25)
    data = assemble(measured((test,), SETTINGS, structure=STATED, report=lambda _: None))
    data = Dataset.of(data.parts, {**data.held, "sign_2": -1.0})  # the other is tried by `prepare`
    known = told_by(data.parts)
    prior = box_of(SETTINGS, data, known)
    known = {**from_amplitude_curve(jax.random.key(0), data, prior, known), **known}
    best = costly_fit(stacked, prior, data, starts=inside(known, prior), tolerance=1e-6)
    data = with_fitted_noise(best.theta, {}, data)
    best = costly_fit(stacked, prior, data, starts=best.theta)
    assert set(best.theta) == set(TRUTH)
    own = dict(zip(best.theta, np.sqrt(np.diag(best.covariance)), strict=True))
    for name, error in ERRORS.items():
        assert best.theta[name] == pytest.approx(TRUTH[name], rel=4 * error), name
        # A turn of the joint that comes or goes within a step of the solver makes no error small.
        assert own[name] / abs(TRUTH[name]) == pytest.approx(error, rel=0.1), name
