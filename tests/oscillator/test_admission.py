"""What `simulate` says of doubtful input: the field at fault and the remedy, and no false alarm."""

import warnings

import jax
import numpy as np
import pytest

import jbw
from jbw.errors import ModelError
from jbw.oscillator.checks import warn_of_unbounded_law
from jbw.oscillator.laws.iwan import Iwan4, MasingPower
from jbw.oscillator.oscillator import BoucWen, Oscillator
from jbw.oscillator.response import simulate

PAPER = dict(omega_n=2 * np.pi * 18.8, zeta=0.00444, alpha=497.4, delta=340.21, gamma=32.84)
SMALL = 0.1 * np.sin(0.3 * np.arange(50))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"delta": -400.0}, r"delta \+ gamma > 0"),
        ({"gamma": -10.0}, "gamma >= 0"),
        ({"alpha": -3.0}, "alpha > 0"),
    ],
)
def test_unbounded_parameters_warn_once_with_their_inequality(change, words):
    with pytest.warns(UserWarning, match=f"violate {words}: the hysteretic force may") as found:
        response = simulate(BoucWen(**PAPER | change), SMALL, 512.0)
    assert len(found) == 1
    assert np.all(np.isfinite(response.y))


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (
            Iwan4(500.0, 50.0, -1.2, 0.5),
            "`iwan_chi` of `iwan4` must be greater than -1",
        ),
        (Iwan4(500.0, 50.0, 0.2, -0.5), "`iwan_beta` of `iwan4` must be positive"),
        (MasingPower(50.0, -0.2), "`power_exponent` of `masing_power` must be positive"),
    ],
)
def test_parameters_of_which_no_force_is_known_are_named(law, words):
    assert words in law.doubts()
    with pytest.warns(UserWarning, match="where the law has no force"):
        warn_of_unbounded_law(Oscillator(118.0, 0.004, (law,)))


@pytest.mark.parametrize("change", [{}, {"delta": 0.0, "gamma": 0.0}], ids=["paper", "linear"])
def test_bounded_parameters_are_quiet(change):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate(BoucWen(**PAPER | change), SMALL, 512.0)


def test_traced_parameters_are_trusted():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jax.jit(simulate)(BoucWen(**PAPER | {"gamma": -10.0}), SMALL, 512.0)


def band_limited(fs, top, num=2048):
    """White noise up to `top` times the sampling rate."""
    spectrum = np.fft.rfft(np.random.default_rng(0).normal(size=num))
    freq = np.fft.rfftfreq(num)
    return np.fft.irfft(np.where((freq > 0) & (freq <= top), spectrum, 0.0), num)


@pytest.mark.parametrize("fs", [128.0, 512.0])
@pytest.mark.parametrize("hold", ["first", "band_limited"])
def test_resolved_records_are_quiet(fs, hold):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate(BoucWen(**PAPER), 20.0 * band_limited(fs, 0.4), fs, hold=hold)


def test_two_turning_points_in_a_step_are_counted():
    n = np.arange(512)
    u = 30.0 * np.sin(2 * np.pi * 10 * n / 128) + 150.0 * np.sin(2 * np.pi * 0.44 * n)
    words = r"In \d+ of 511 sample intervals .*`substeps` = 1 at `fs` = 128 Hz.*Raise `substeps`"
    with pytest.warns(UserWarning, match=words):
        simulate(BoucWen(**PAPER), u, 128.0, hold="band_limited")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate(BoucWen(**PAPER), u, 128.0, hold="band_limited", substeps=4)


@pytest.mark.slow
def test_a_steady_state_that_newton_does_not_find_is_reported(monkeypatch):
    monkeypatch.setattr("jbw.oscillator.periodic.MAX_ITERATIONS", 0)
    u = 20.0 * np.cos(2 * np.pi * np.arange(61) / 61)
    with pytest.raises(ModelError, match=r"(?s)No steady state.*Give an `initial` nearer"):
        simulate(BoucWen(**PAPER), u, 61 * 18.8, hold="band_limited", periodic=True)


@pytest.mark.parametrize("several", [False, True])
def test_a_joint_stiffer_than_the_structure_is_named_with_the_inequality(several):
    """Of one mode alpha = 1.21 omega_n^2; of two, 1 / sum(h p / omega^2) = 1 / (1/1e4 + 1/4e4)."""
    law = jbw.laws.BoucWenLaw(12100.0, 300.0, 100.0)
    if several:
        omega, ones = np.array([100.0, 200.0]), np.ones(2)
        joint, limit = jbw.Structure(omega, 0.01 * ones, ones, ones, ones, ones, (law,)), "8000"
    else:
        joint, limit = jbw.Oscillator(100.0, 0.01, (law,)), "10000"
    with pytest.warns(UserWarning, match="stiffer than the structure") as said:
        jbw.simulate(joint, np.zeros(64), 1000.0)
    assert f"12100 > {limit} 1/s^2" in str(said[0].message)
