"""Modes with laws of their own: what records say of them, and what tells them from one joint."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from two_modes import FS, JOINT, STATED, WING, at_two_points, truth

import jbw
from jbw.campaign.settings import Identify, Structured
from jbw.errors import ConfigError
from jbw.identification.assemble import assemble, measured
from jbw.identification.coordinates import box_of
from jbw.identification.evidence import name_of, trials, under
from jbw.identification.stated_modes import modes_of, same_joint_sentences
from jbw.inference.space.box import bounds_by_name
from jbw.observables.drives import told_by
from jbw.observables.modes import LABEL
from jbw.observables.samples import band_limited, motion_under
from jbw.oscillator.modes.parameters import own_name, own_quantities
from jbw.rig.integrator import GRID, respond

SETTINGS = Identify.of({"offsets": "none", "fit_repeats": 2, "substeps": 4})
APART = STATED.model_copy(update={"modal": True, "points": ("wing",)})
OWN = {"alpha": 900.0, "delta": 500.0, "gamma": 60.0}  # of the second mode


@pytest.fixture(scope="module")
def seen():
    taken = at_two_points(["low_2", "high_2"], duration=2.0)
    return measured(taken.tests, SETTINGS, structure=APART, report=lambda _: None)


@pytest.fixture(scope="module")
def data(seen):
    return assemble(seen)


def test_outputs_are_the_sums_of_oscillators_with_laws_of_their_own():
    """Against the rig, which integrates each oscillator by itself and shares no code."""
    num, rng = 256, np.random.default_rng(0)
    freq = np.arange(8, 120) * FS / num  # of one period, band-limited
    phase = rng.uniform(0, 2 * np.pi, freq.size)

    def force(i, j):
        t = np.arange(i, j)[:, None] / (GRID * FS)
        tones = np.sum(np.cos(2 * np.pi * freq * t + phase), axis=1)
        return 20.0 * tones * np.sin(np.pi * t[:, 0]) ** 4

    theta, ratio, c = truth(), -0.6, WING
    joints = (
        jbw.BoucWen(theta["omega_n"], theta["zeta"], JOINT.alpha, JOINT.delta, JOINT.gamma),
        jbw.BoucWen(theta["omega_2"], theta["zeta_2"], **OWN),
    )
    y1, y2 = (
        respond(joint, lambda i, j, b=b: b * force(i, j), num, FS)[0]
        for joint, b in zip(joints, (1.0, ratio), strict=True)
    )
    point = {name: theta[name] for name in ("omega_n", "zeta", "omega_2", "zeta_2")}
    point |= {"gain": 1.0, "gain_ratio_2": ratio, "point_2_1": c[0], "point_2_2": c[1]}
    point |= {name: float(getattr(JOINT, name)) for name in OWN}
    point |= {own_name(name, 2): value for name, value in OWN.items()}
    point = {name: jnp.asarray(value) for name, value in point.items()}
    source = band_limited(force(0, GRID * num)[::GRID])
    found = motion_under(point, source, FS, substeps=16, every_point=True)
    expected = np.array([y1 + y2, c[0] * y1 + c[1] * y2])
    # Sixteen steps a sample leave less; the force ends flat, so that its samples tell all of it.
    error = np.linalg.norm(found.y - expected, axis=1) / np.linalg.norm(expected, axis=1)
    assert np.all(error < 1e-3)
    linear = motion_under({**point, "delta": jnp.zeros(())}, source, FS, substeps=16)
    assert np.linalg.norm(linear.y - found.y[0]) > 0.05 * np.linalg.norm(found.y[0])


def test_the_box_has_a_law_for_every_mode(data):
    assert LABEL not in data.labels
    bounds = bounds_by_name(box_of(SETTINGS, data, told_by(data.parts)))
    assert {own_name(name, 2) for name in OWN} < set(bounds)
    assert not {"shape_2", "coupling_2", "sign_2"} & set(bounds)
    # By the second mode's own scales: a share of its stiffness, omega_2^2.
    stiffer = (told_by(data.parts)["omega_2"] / told_by(data.parts)["omega_n"]) ** 2
    assert bounds[own_name("alpha", 2)][1] / bounds["alpha"][1] == pytest.approx(stiffer, rel=1e-6)
    units = {one.name: one.unit for one in own_quantities(("bouc_wen",), 2)}
    assert units == {"alpha_mode_2": "1/s^2", "delta_mode_2": "1/m", "gamma_mode_2": "1/m"}


def test_laws_are_tried_in_one_joint_in_each_mode_and_in_the_first(seen):
    taken = at_two_points(["low_2", "high_2"], duration=2.0)
    one = measured(taken.tests, SETTINGS, structure=taken.structure, report=lambda _: None)
    sets = [("cubic",), ("bouc_wen",)]
    names = [name_of(*pair) for pair in trials(sets, one)]
    assert names == ["cubic", "bouc_wen", "bouc_wen of each mode", "bouc_wen in the first mode"]
    assert trials(sets, seen) == [(laws, "") for laws in sets]  # stated as apart
    data = assemble(one)
    assert "sign_2" in data.held
    for meet in ("apart", "first"):
        assert "sign_2" not in under(("bouc_wen",), data, meet).held


def posterior(first, second):
    """Draws of delta and gamma whose ratios are these, by one per cent."""
    rng = np.random.default_rng(0)
    draws = {}
    for mode, ratio in ((1, first), (2, second)):
        gamma = 30.0 * np.exp(0.01 * rng.standard_normal((2, 500)))
        own = {"alpha": 1e3 + 0 * gamma, "gamma": gamma, "delta": ratio * gamma}
        own["delta"] = own["delta"] * np.exp(0.01 * rng.standard_normal((2, 500)))
        draws |= {(n if mode == 1 else own_name(n, 2)): (("chain", "draw"), x)
                  for n, x in own.items()}  # fmt: skip
    return xr.Dataset(draws)


def test_ratios_that_one_joint_would_share_are_compared(data):
    (said,) = same_joint_sentences(posterior(4.0, 2.0), data)
    assert said.startswith("delta/gamma is 4 in the first mode and 2 in the mode at 57.2 Hz")
    assert "the data reject one common joint" in said
    # Ratios of 1 % each: 2.58 times the root of two of that about one half, to the scatter of
    # the outermost of a thousand draws.
    low, high = map(float, re.search(r"\(ratio ([\d.]+) to ([\d.]+)\):", said).groups())
    ends = 0.5 * np.exp(0.01 * 2.576 * np.sqrt(2) * np.array([-1, 1]))
    assert (low, high) == pytest.approx(ends, rel=0.01)
    assert "the modes may share one joint" in same_joint_sentences(posterior(4.0, 4.0), data)[0]
    assert same_joint_sentences(posterior(4.0, 2.0), under(("bouc_wen",), data, "common")) == []


def test_what_is_known_of_a_common_joint_is_refused():
    with pytest.raises(ValueError, match=r"modal: .*`driving_point` describes"):
        Structured(modes=(18.8, 57.2), modal=True, driving_point=True)
    for structure, name in ((APART, "shape_2"), (STATED, "delta_mode_2")):
        settings = Identify.of({"prior": {name: (0.1, 1.0)}})
        with pytest.raises(ConfigError, match=f"`{name}` applies only to modes that"):
            modes_of(structure, [], settings)
