"""Which start of a fit is gone on with, and on which side of a threshold a fit is left."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from jbw.campaign.settings import Identify
from jbw.identification import first_fit
from jbw.identification.assemble import assemble, measured
from jbw.identification.coordinates import box_of
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.space.box import bounds_by_name
from jbw.measurement.records import Record, Test
from jbw.observables import dataset
from jbw.observables.drives import told_by
from jbw.oscillator.laws.iwan import Iwan4

OMEGA_N, ZETA, STIFFNESS, LOSS, CHI = 500.0, 0.003, 4e4, 2e3, -0.3
LEVELS = (5.0, 20.0, 40.0, 60.0, 80.0, 100.0)
Y_PEAK = 100.0 / OMEGA_N**2


def through(best, prior, data):
    """The fit of one evaluation, which stays where it begins."""
    return costly_fit(dataset.stacked, prior, data, starts=best, max_evaluations=1)


def of(phi_max):
    """Iwan's array whose weak motion is one and the same, with macroslip at phi_max [m]."""
    stiffness = LOSS * (1.0 + 0.5) * (2.0 + CHI) * (phi_max / 1e-3) ** (1.0 + CHI)
    return {"iwan_stiffness": stiffness, "iwan_loss": LOSS, "iwan_chi": CHI, "iwan_beta": 0.5}


def held(level, theta, seed=0):
    """Force [N per kg] that holds an acceleration, by the law's loop."""
    rng = np.random.default_rng([seed, int(level)])
    freq = np.linspace(78.0, 81.0, 30)
    omega = 2 * np.pi * freq
    y = level / omega**2
    loop = Iwan4(**theta).loop(y)
    stuck = OMEGA_N**2 - theta["iwan_stiffness"]
    stuck = stuck + np.asarray(loop.stiffness) + 1j * np.asarray(loop.damping)
    force = y * (stuck - omega**2 + 2j * ZETA * OMEGA_N * omega)
    records = []
    for _ in range(3):
        seen = force + 0.005 * (rng.normal(size=30) + 1j * rng.normal(size=30))
        channels = {
            "frequency": freq,
            "force": np.abs(seen),
            "acceleration": np.full(30, level),
            "phase": np.pi - np.angle(seen),
        }
        units = {"frequency": "Hz", "force": "N", "acceleration": "m/s^2", "phase": "rad"}
        records.append(Record(float("nan"), channels, units))
    return Test("frf", tuple(records), f"held at {level:g}", float(level))


def campaign(theta):
    tests = [held(level, theta) for level in LEVELS]
    data = assemble(measured(tests, Identify(), laws=("iwan4",), gain=1.0))
    return box_of(Identify(), data, told_by(data.parts)), data


@pytest.mark.parametrize(("true", "begun"), [(4.0, 0.9), (0.7, 4.0), (0.7, 0.7)])
def test_a_fit_ends_on_the_side_of_a_threshold_where_the_truth_is(true, begun):
    prior, data = campaign(of(true * Y_PEAK))
    start = {"omega_n": OMEGA_N, "zeta": ZETA, "gain": 1.0, **of(begun * Y_PEAK)}
    best = through({name: start[name] for name in prior.names}, prior, data)
    chosen = first_fit.across_thresholds(best, prior, data)
    law = Iwan4(**{name: chosen.theta[name] for name in of(1.0)})
    assert (law.phi_max > Y_PEAK) == (true > 1.0)
    if begun != true:
        assert chosen.cost < best.cost
        std = dict(zip(prior.names, np.sqrt(np.diag(chosen.covariance)), strict=True))
        for name, value in (("omega_n", OMEGA_N), ("iwan_loss", LOSS), ("iwan_chi", CHI)):
            assert abs(chosen.theta[name] - value) < 3 * std[name]  # one noise, drawn once


def by_rounds(monkeypatch, floors, falls=100.0, at_bound=None):
    """Ends of rounds of costs that fall towards floors of their own, and the evaluations spent."""
    spent, falls = [], np.broadcast_to(falls, len(floors))

    def roughly(begun, prior, data, evaluations):
        return [one_fit(theta, evaluations) for theta in begun]

    def one_fit(theta, evaluations):
        number, done = int(theta["number"]), theta["done"] + evaluations
        spent.append((number, evaluations))
        cost = floors[number] + falls[number] / done
        return SimpleNamespace(
            cost=cost,
            chi_square=(2 * cost, 1),
            theta={"number": number, "done": done},
            at_bound=at_bound or {},
        )

    monkeypatch.setattr(first_fit, "roughly", roughly)
    begun = [{"number": i, "done": 0} for i in range(len(floors))]
    ends = first_fit.by_rounds(begun, None, None)
    return [end.theta["number"] for end in ends], spent


def test_the_starts_that_fall_furthest_are_gone_on_with(monkeypatch):
    numbers, spent = by_rounds(monkeypatch, [100.0, 90.0, 20.0, 80.0, 70.0, 60.0])
    assert numbers == [2, 5, 4, 3, 1, 0]
    assert [number for number, evaluations in spent if evaluations == 60] == [2, 5]
    assert sum(evaluations for _, evaluations in spent) == 6 * 8 + 4 * 12 + 2 * 60


def test_starts_that_all_end_at_one_minimum_are_not_gone_on_with(monkeypatch):
    numbers, spent = by_rounds(monkeypatch, [50.0 + 1e-6 * i for i in range(6)], falls=0.0)
    assert numbers == [0, 1, 2, 3, 4, 5]
    assert spent == [(i, 8) for i in range(6)]


def test_beside_an_end_at_a_bound_the_others_go_on_until_one_explains_the_data(monkeypatch):
    """The second start falls to nothing, but so late that the rounds leave it behind four."""
    monkeypatch.setattr(first_fit, "EXPLAINED", 40.0)
    costs = [100.0, 0.0, 30.0, 35.0, 40.0, 45.0], [0.0, 1000.0, 0.0, 0.0, 0.0, 0.0]
    numbers, spent = by_rounds(monkeypatch, *costs, at_bound={"delta": "lower"})
    assert numbers == [1, 2, 3, 4, 5, 0]
    assert [n for n, evaluations in spent if evaluations == 60] == [2, 3, 4, 5, 0, 1]
    assert by_rounds(monkeypatch, *costs)[0][0] == 2


def test_an_earlier_fit_moves_the_start_and_not_the_bounds(monkeypatch):
    begun = []

    def caught(_key, _data, prior, values, *, alone):
        begun.append(values)
        return through({name: values[name] for name in prior.names}, prior, data)

    monkeypatch.setattr(first_fit, "fit_from", caught)
    monkeypatch.setattr(first_fit, "across_thresholds", lambda best, *_: best)
    prior, data = campaign(of(4.0 * Y_PEAK))
    start = {"omega_n": 1.02 * OMEGA_N, "zeta": 4 * ZETA, "gain": 1.0, **of(4.0 * Y_PEAK)}
    found, _, _ = first_fit.first_fit(jax.random.key(0), data, Identify(), start=start)
    assert bounds_by_name(found) == bounds_by_name(prior)
    assert start.items() <= begun[-1].items()
