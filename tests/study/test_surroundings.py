"""Residual terms in words: an inertance of a rigid body, or the compliance of what is above."""

import numpy as np
import pytest
import xarray as xr

from jbw.study.comparisons import constants_sentence


def posterior(**draws):
    count = 1001
    return xr.Dataset({n: (("chain", "draw"), np.full((1, count), x)) for n, x in draws.items()})


@pytest.mark.parametrize(
    ("terms", "source", "words"),
    [
        # 0.5 kg^-1 of modal mass and 504 rad/s: -0.5 (504^2 U) = 1.5; and the same by L.
        ({"residual_upper": -3.0 / 504**2}, "N", "1.50 [1.50, 1.50] 1/kg, which comes from"),
        ({"residual_lower": -3.0}, "N", "1.50 [1.50, 1.50] 1/kg, which comes from"),
        ({"residual_lower": -3.0}, "V", "1.50 [1.50, 1.50] m/s^2/V, which comes from"),
        (
            {"residual_upper": 4e-6, "residual_lower": -3e-6 * 504**2}, "N",
            "m/N, which is the compliance of the modes above",
        ),
    ],
)  # fmt: skip
def test_one_real_constant_has_its_unit_and_its_name(terms, source, words):
    said = constants_sentence(posterior(omega_n=504.0, **terms), {"gain": 0.5}, source)
    assert words in said.replace("1.5 [1.5, 1.5]", "1.50 [1.50, 1.50]")
    if "compliance" in words:
        assert "5.00e-07" in said  # 0.5 (4e-6 - 3e-6)


def test_there_is_none_to_speak_of():
    assert constants_sentence(posterior(omega_n=504.0, gain=1.0), {}, "N") is None
    assert constants_sentence(posterior(residual_upper=1.0), {}, "N") is None
