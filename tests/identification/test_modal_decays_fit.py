"""Two modes with one joint from their free decays alone, made without jbw: the truth is found."""

import jax
import numpy as np
import pytest
from modal_decays import STARTS, STATED, TRUTH, modal_decay_test

from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.identification.coordinates import box_of
from jbw.identification.prepare import from_amplitude_curve, inside
from jbw.inference.fit.costly_fit import costly_fit
from jbw.observables.dataset import Dataset, stacked, with_fitted_noise
from jbw.observables.drives import told_by

SETTINGS = Identify.of({"offsets": "none", "fit_repeats": 3})


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
    best = costly_fit(stacked, prior, data, starts=best.theta, tolerance=1e-6)
    std = np.sqrt(np.diag(best.covariance))
    z = {n: (best.theta[n] - TRUTH[n]) / sd for n, sd in zip(best.theta, std, strict=True)}
    assert set(z) == set(TRUTH)
    # Nine parameters: beyond 4 one in 1700 times.
    assert all(abs(one) < 4 for one in z.values()), z
    relative = {n: sd / abs(best.theta[n]) for n, sd in zip(best.theta, std, strict=True)}
    assert relative["shape_2"] < 0.01
    assert relative["delta"] < 0.05
