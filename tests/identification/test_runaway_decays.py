"""Short decays of a structure whose model runs away in a part of the box: fits refuse it."""

from itertools import product

import decays
import jax
import numpy as np
import pytest

from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.identification.coordinates import box_of
from jbw.inference.fit import costly_fit as module
from jbw.inference.fit.costly_fit import costly_fit, evaluator, to_search, trust_region
from jbw.inference.space.box import box as make_box
from jbw.measurement.records import Record, Test
from jbw.observables.dataset import stacked
from jbw.observables.drives import told_by

# Damped by 2 %, and opening twice as fast as it softens.
STRUCTURE = {"ZETA": 0.02, "SOFTENING": 10.0, "OPENING": 20.0, "SHARE": 0.1}


@pytest.fixture
def short_decays(monkeypatch):
    """Two decays of 2.4 s and 49 periods."""
    for name, value in STRUCTURE.items():
        monkeypatch.setattr(decays, name, value)
    rng, records = np.random.default_rng(0), []
    for state in ((2.0e-3, 0.0), (-1.0e-3, 0.16)):
        v = decays.free_velocity.__wrapped__(*state, 2.4)
        v = v + 2e-4 * rng.standard_normal(len(v))
        records.append(Record(decays.FS, {"velocity": v}, {"velocity": "m/s"}))
    return Test("decay", tuple(records), "impacts", band_hz=decays.BAND)


def test_a_residual_whose_square_overflows_is_refused():
    """Finite residuals and slopes, whose squares are not: SciPy's SVD ended on them."""

    def residual(theta, data):
        return data * 10.0 ** theta["a"]

    exponents = make_box({"a": (-1.0, 300.0)})
    part = evaluator(residual, exponents, np.linspace(1.0, 2.0, 4))
    start = to_search(np.array([0.7]), exponents)  # a = 210
    assert np.isfinite(residual({"a": 210.0}, 2.0))
    end = trust_region(part, start, 20, 1e-6)
    assert (end.cost, end.num_refused) == (np.inf, 1)


@pytest.mark.slow
def test_a_motion_that_runs_away_is_refused_by_the_fit_of_its_decays(short_decays):
    settings = Identify.of({"offsets": "none"})
    data = assemble(measured((short_decays,), settings, report=lambda _: None))
    box = box_of(settings, data, told_by(data.parts))
    alpha = STRUCTURE["SHARE"] * decays.OMEGA_N**2
    truth = {
        "omega_n": decays.OMEGA_N, "zeta": STRUCTURE["ZETA"], "alpha": alpha,
        "delta": 100.0, "gamma": 200.0,
    }  # fmt: skip
    lower, upper = np.asarray(box.lower), np.asarray(box.upper)
    unit = (np.array([truth[name] for name in box.names]) - lower) / (upper - lower)
    inside = np.asarray(to_search(jax.numpy.asarray(unit), box))
    part = evaluator(stacked, box, data)
    corners = [np.array(corner) for corner in product((1e-3, 1 - 1e-3), repeat=len(box.names))]
    unsolved = [corner for corner in corners if not np.all(np.isfinite(part(corner, 0)))]
    for start in unsolved:
        end = trust_region(part, start, 20, 1e-6)
        assert (end.cost, end.num_refused) == (np.inf, 1)
    values = [box.lower + module.from_search(jax.numpy.asarray(s), box)[0] * (box.upper - box.lower)
              for s in (inside, unsolved[0])]  # fmt: skip
    both = {name: np.array([float(x[i]) for x in values]) for i, name in enumerate(box.names)}
    best = costly_fit(stacked, box, data, starts=both, tolerance=1e-6)
    assert best.num_refused >= 1
    assert best.theta["omega_n"] == pytest.approx(decays.OMEGA_N, rel=1e-3)
    assert best.theta["zeta"] == pytest.approx(STRUCTURE["ZETA"], rel=0.02)
