"""A campaign of a joint whose response has a clock of its own: its size, and its correction."""

import h5py
import jax
import numpy as np
import pytest
import toy_campaign
from pasted import lines_of
from scipy.interpolate import make_interp_spline

import jbw
from jbw.identification.assemble import measured_in
from jbw.identification.causes import MOSTLY, causes
from jbw.identification.prepare import fit_joint

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

PPM = 500.0  # over 2 s at 118 rad/s: 0.12 rad at the end


def found(path):
    seen = measured_in(jbw.load_campaign(path), str)
    fitted = fit_joint(jax.random.key(1), seen, str)
    return fitted, causes(fitted.fit, fitted.data)


@pytest.mark.release  # test_clocks.py and test_pasted_remedies.py have both
def test_another_clock_is_the_first_cause_and_its_key_cures(tmp_path, monkeypatch):
    driven = toy_campaign.CAMPAIGN.partition('[[test]]\nkind = "loop"')[0]
    monkeypatch.setattr(toy_campaign, "CAMPAIGN", driven.replace("gain = 15.0\n", ""))
    path = toy_campaign.write_toy(tmp_path, toy_campaign.PLAIN)
    for name in tmp_path.glob("*.h5"):
        with h5py.File(name, "r+") as file:
            if "input" in file:
                velocity = file["velocity"][...]
                t = np.arange(velocity.shape[-1]) / toy_campaign.FS
                late = make_interp_spline(t, velocity, 5, axis=-1)(t / (1 + 1e-6 * PPM))
                file["velocity"][...] = late
    fitted, (first, *_) = found(path)
    assert "ppm fast compared with that of the drive" in first.text.what
    assert first.explained > MOSTLY  # then the verdict names it
    ((table, line),) = lines_of(first.text.remedy)
    assert table == "[test]"
    assert float(line.partition(" = ")[2]) == pytest.approx(PPM, rel=0.15)  # one linear step
    path.write_text(path.read_text().replace("fs = 256.0\n", f"fs = 256.0\n{line}\n"))
    cured, _ = found(path)
    # Chi-square of the noise that repeats tell: 53 a degree of freedom before, 1.4 after, which a
    # tenth of the clock and one step a sample leave.
    assert cured.chi_square[0] < 0.05 * fitted.chi_square[0]
    for name, truth in toy_campaign.TRUTH.items():
        assert cured.fit.theta.get(name, truth) == pytest.approx(truth, rel=0.02)
