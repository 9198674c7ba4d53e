"""What a line through each level of a beam's curves leaves, without and with a residual term."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from measured_data import DATA, ROOT
from tiers import represented_by

from jbw.campaign.load import load_campaign
from jbw.campaign.settings import Identify
from jbw.identification.assemble import measured
from jbw.identification.prepare import fit_joint
from jbw.observables.dataset import error_by_label, residual_by_label


@pytest.fixture(scope="module")
def levels():
    """The Brake-Reuss beam's curves by their levels, each alone about one of its modes."""
    if not (DATA / "brake_reuss_beam").is_dir():
        pytest.skip(f"brake_reuss_beam is not in {DATA}; set JBW_DATA to the folder of the data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JBW_DATA", str(DATA))
        file = ROOT / "notebooks" / "campaigns" / "brake_reuss_beam.toml"
        return {test.level: test for test in load_campaign(file, allow_outside=True).tests}


def floor(test, residuals):
    """Error over the receptance, which a line knows for every amplitude: its force may be one."""
    curve = test.records[0]
    force = curve.channels["force"]
    per_newton = {
        "force": np.ones_like(force),
        "acceleration": curve.channels["acceleration"] / force,
    }
    record = replace(curve, channels={**curve.channels, **per_newton})
    test = replace(test, records=(record,), residuals=residuals)
    seen = measured([test], Identify(offsets="none"), laws=())
    ready = fit_joint(jax.random.key(0), seen, lambda said: None)
    left = error_by_label(residual_by_label(ready.fit.residual, ready.data), ready.data)
    return left.popitem()[1], ready.fit.theta


# What SciPy's least squares of the receptance leave with the same term, its inertance [1/kg] at the
# mode, and what they leave without it.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("level", "with_term", "inertance", "without"),
    represented_by(
        (5, 0.0100, 1.62, 0.0245), (20, 0.0070, 1.79, 0.0289), (30, 0.0078, 2.20, 0.0406)
    ),
)
def test_one_real_constant_leaves_a_per_cent(levels, level, with_term, inertance, without):
    error, theta = floor(levels[level], "upper")
    assert error < 0.013
    assert error == pytest.approx(with_term, abs=2e-4)  # its last digit
    found = -theta["gain"] * theta["residual_upper"] * theta["omega_n"] ** 2
    assert found == pytest.approx(inertance, rel=0.01)
    assert floor(levels[level], "none")[0] == pytest.approx(without, abs=2e-4)
