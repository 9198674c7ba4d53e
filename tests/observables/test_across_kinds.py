"""Each kind of test predicted from the others, where one joint made all and where it did not."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from test_evidence import GAIN, PRIOR, curve, loop

from jbw.campaign.settings import Identify
from jbw.identification import across_kinds as kinds
from jbw.identification.across_kinds import (
    across_kinds,
    across_kinds_record,
    across_kinds_sentence,
    kinds_of,
)
from jbw.identification.assemble import assemble, measured
from jbw.identification.held_out import HeldOut
from jbw.identification.leaving_out import identified_alone
from jbw.identification.prepare import with_weights
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.space.box import box
from jbw.observables.dataset import as_arrays, error_by_label, residual_by_label, stacked
from jbw.observables.noise import silenced
from jbw.report.messages.residuals import identified_by

LEVELS = (5, 20, 60)


@cache
def fitted(levels, factor=None):
    """Fit, prior and data of curves at levels, and of a loop whose force is multiplied."""
    loops = [] if factor is None else [stiffer(loop(), factor)]
    tests = [*map(curve, levels), *loops]
    prior = box(PRIOR)
    data = assemble(measured(tests, Identify(), gain=GAIN))
    middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()}
    best = costly_fit(stacked, prior, data, starts=middle)
    data = with_weights(best, data, Identify())
    return costly_fit(stacked, prior, data, starts=best.theta), prior, data


def stiffer(test, factor):
    """A loop whose load cell reads more: no joint makes it and the curves alike."""
    records = tuple(
        replace(
            record,
            channels=record.channels
            | {"restoring_force": factor * record.channels["restoring_force"]},
        )
        for record in test.records
    )
    return replace(test, records=records)


def test_of_one_joint_the_kinds_predict_each_other_to_the_noise():
    best, prior, data = fitted(LEVELS, 1.0)
    assert kinds_of(data) == {
        "tones and curves": ("held at 5", "held at 20", "held at 60"), "loops": ("loop",)
    }  # fmt: skip
    predicted = across_kinds(best, prior, data)
    assert predicted is not None
    # Noise is in both errors; what parameters of the other kind scatter by is small beside it.
    ratio = predicted["error"] / predicted["fitted"]
    assert ratio.sel(kind="loops").item() < 1.5
    assert ratio.sel(kind="tones and curves").item() < 5.0  # a loop knows no damping
    record = across_kinds_record(predicted)
    assert "zeta" in record["tones and curves"]["rests_on"]
    assert "and zeta" in across_kinds_sentence(predicted)


def test_what_one_joint_cannot_make_is_an_error_of_the_other_kind():
    """A force 3 % too large is 3 % of the loop, as nothing in the curves asks for it."""
    best, prior, data = fitted(LEVELS, 1.03)
    predicted = across_kinds(best, prior, data)
    assert predicted is not None
    assert predicted["error"].sel(kind="loops").item() == pytest.approx(0.03 / 1.03, rel=0.1)


def test_a_parameter_is_as_much_wider_as_its_standard_deviation_without_a_kind(monkeypatch):
    whole, rest = (
        SimpleNamespace(covariance=np.diag(v), theta={"a": 1.0, "b": 1.0})
        for v in ([1.0, 4.0], [9.0, 4.0])
    )
    monkeypatch.setattr(kinds, "kinds_of", lambda _: {"sweeps": ("s",), "loops": ("l",)})
    monkeypatch.setattr(kinds, "errors_with_own_frequency", lambda *_: {"s": 0.1, "l": 0.1})
    table = {"sweeps": HeldOut(("s",), None, rest), "loops": HeldOut(("l",), None, rest)}
    monkeypatch.setattr(kinds, "held_out", lambda *_: table)
    found = across_kinds(
        whole, box({"a": (0.0, 2.0), "b": (0.0, 2.0)}), SimpleNamespace(has_offsets=False)
    )
    assert found["wider"].values.tolist() == [[3.0, 1.0]] * 2


def test_the_error_of_a_kind_is_the_rms_of_its_tests():
    """By the residuals of a fit to the rest, group by group, from the definition."""
    best, prior, data = fitted(LEVELS, 1.03)
    predicted = across_kinds(best, prior, data)
    assert predicted is not None
    rest = silenced(kinds_of(data)["tones and curves"], data)
    theta = as_arrays(costly_fit(stacked, prior, rest, starts=best.theta).theta, data)
    residual = residual_by_label(np.asarray(stacked(theta, data)), data)
    errors = error_by_label(residual, data)
    squared = [errors[label] ** 2 for label in kinds_of(data)["tones and curves"]]
    error = predicted["error"].sel(kind="tones and curves").item()
    assert error == pytest.approx(np.sqrt(np.mean(squared)), rel=1e-5)


def test_of_one_kind_nothing_is_told():
    best, prior, data = fitted(LEVELS[:2])
    assert across_kinds(best, prior, data) is None


def test_a_kind_left_out_says_nothing():
    best, _, data = fitted(LEVELS, 1.0)
    changed = {**best.theta, "delta": 1.2 * best.theta["delta"]}
    theta = {name: np.asarray(value) for name, value in changed.items()}
    rest = silenced(["loop"], data)
    whole, without = (np.asarray(stacked(theta, each)) for each in (data, rest))
    labels = list(data.layout)
    ends = np.cumsum(list(data.layout.values()))
    at = labels.index("loop")
    rows = slice(ends[at] - data.layout["loop"], ends[at])
    assert np.linalg.norm(without[rows]) < 1e-3 * np.linalg.norm(whole[rows])
    others = np.delete(np.arange(len(whole)), np.r_[rows])
    np.testing.assert_array_equal(whole[others], without[others])


def test_what_alone_identifies_a_parameter_is_named():
    wider = xr.DataArray(
        [[1.2, 40.0], [np.inf, 4.9]],
        {"run": ["low", "high"], "parameter": ["omega_n", "gamma"]},
        ("run", "parameter"),
    )
    needed = identified_alone(wider)
    assert needed == {"low": ["gamma"], "high": ["omega_n"]}
    said = " Identified only by low: gamma; identified only by high: omega_n."
    assert identified_by(needed) == said
    assert identified_by({"low": [], "high": []}) == ""
