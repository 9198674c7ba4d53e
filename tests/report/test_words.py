"""Sentences with symbols, and which parameters a run knows."""

import numpy as np
import pytest

from jbw.report.messages.opening import GRADES
from jbw.report.text import quantity, shown_as, spread_text
from jbw.report.words import identified_words, in_symbols
from jbw.results.run import RunSummary

PARAMETERS = ("omega_n", "zeta", "alpha", "delta", "gamma", "gain", "cubic", "share")
KNOWN = {name: quantity(name) for name in (*PARAMETERS, "alpha_delta", "alpha_gamma")}


@pytest.mark.parametrize(
    ("plain", "printed"),
    [
        ("only the product alpha*delta", "only the product α·δ"),
        ("softening = alpha*delta/omega_n^2", "softening = α·δ/ωₙ²"),
        ("161181 m^-1 s^-2", "161181 m⁻¹ s⁻²"),
        ("gain*zeta^0.27 of sweep2, 3 m^2", "gain*ζ^0.27 of sweep2, 3 m²"),
        ("r_hat of alpha_gamma is 1.004", "R-hat of α γ is 1.004"),
        ("the best cubic oscillator, a share of it", "the best cubic oscillator, a share of it"),
        ("Gamma is conditional on lambda_3", "γ is conditional on λ₃"),
        ("counts 3.82e+05 of 1.4e-05", "counts 3.82×10⁵ of 1.4×10⁻⁵"),
        ("data/alpha/delta.mat of sweep_alpha", "data/alpha/delta.mat of sweep_alpha"),
        ("set `gamma` in it", "set `gamma` in it"),
        ("widen alpha: `alpha = [1e+03, 2e-05]`", "widen α: `alpha = [1e+03, 2e-05]`"),
    ],
)  # fmt: skip
def test_names_become_symbols(plain, printed):
    assert in_symbols(plain, KNOWN) == printed


def test_parameters_are_graded_by_what_is_known_of_them():
    parameters = {
        "omega_n": {"cv": 1e-4, "kl": 5.0},
        "zeta": {"cv": 0.2, "kl": 1.0},
        "alpha": {"cv": 0.5, "kl": None},
        "share": {"cv": 0.3, "kl": 0.1},
        "noise_std[0.1]": {"cv": 0.01, "kl": None},
    }
    words = identified_words(
        RunSummary.read({"main": "joint", "steps": {"joint": {"parameters": parameters}}}), KNOWN
    )
    assert tuple(sentence.partition(":")[0] for sentence in words) == GRADES
    assert "natural frequency" in words[0]
    assert "noise" not in "".join(words)
    assert identified_words(RunSummary.read({}), KNOWN) == []


def test_a_frequency_is_shown_in_hertz_and_a_spread_as_half_of_its_interval():
    assert shown_as("omega_n", "rad/s")[0] * 2 * np.pi * 18.8 == pytest.approx(18.8, rel=1e-14)
    draws = np.linspace(90.0, 110.0, 100_001)
    assert spread_text(draws, "Hz") == "100.0 Hz ± 9.9 %"  # 99 % of them lie within 9.9 of 100
