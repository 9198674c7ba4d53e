"""Bands of first answers contain the error of a law that leaves more than noise in the records."""

import numpy as np
import pytest
from decays import OMEGA_N, OPENING, SHARE, SOFTENING, ZETA, decay_test

import jbw
from jbw.identification.discrepancy import discrepancy_of_misfit
from jbw.report.messages.opening import LAW_APPROXIMATES


def test_an_error_of_the_law_is_the_change_that_its_misfit_makes_at_resonance():
    """A linear oscillator with another frequency or damping, at resonance in closed form."""
    zeta, misfit, wider = 0.004, 0.01, 5.8409 / 2.5758  # t_3 over z, both at 0.995 (tables)
    found = discrepancy_of_misfit(misfit, zeta, 1e-3).at(1e-3)

    def response(frequency, damping):
        return 1 / (frequency**2 - 1 + 2j * damping * frequency)

    at_rest = response(1.0, zeta)
    shifts = found.frequency / wider, found.damping / wider
    changed = response(1.0 + shifts[0], zeta), response(1.0, zeta + shifts[1])
    # Changes of the second order in the misfit of a hundredth.
    np.testing.assert_allclose(np.abs(np.array(changed) / at_rest - 1), misfit, rtol=0.02)
    assert discrepancy_of_misfit(0.0, zeta, 1e-3).is_nothing


def first_answer(law):
    campaign = jbw.Campaign("impacts", None, (decay_test(),), laws=(law,))
    return jbw.identify(campaign, quick=True, report=lambda _: None)


@pytest.mark.slow
def test_bands_of_another_law_contain_the_joint_that_made_the_records():
    """Bouc-Wen's joint, integrated by SciPy, where Masing's power law is stated."""
    study = first_answer("masing_power")
    curve = study.tree["verification/backbone"].to_dataset()
    assert curve.attrs["discrepancy"] == 1
    # Decays spend little time at their ends, where the error of a law is several times as large.
    fitted = curve.sel(amplitude=slice(*(np.array([0.15, 0.65]) * curve.attrs["y_fitted"])))
    stiffness = SHARE * OMEGA_N**2
    law = jbw.laws.BoucWenLaw(stiffness, SOFTENING / SHARE, OPENING / SHARE)
    truth = jbw.backbone(jbw.Oscillator(OMEGA_N, ZETA, [law]), fitted["amplitude"].values)
    for name, true in (("frequency", truth.omega / (2 * np.pi)), ("damping", truth.zeta)):
        low, _, high = fitted[name].values
        inside = (low < true) & (true < high)
        assert np.all(inside), (name, low, np.asarray(true), high)
    assert LAW_APPROXIMATES in " ".join(study.record["opening"])


@pytest.mark.slow
def test_the_law_that_made_the_records_has_no_error():
    curve = first_answer("bouc_wen").tree["verification/backbone"]
    assert curve.attrs["discrepancy"] == 0
    assert not np.any(curve["frequency_missed"])
