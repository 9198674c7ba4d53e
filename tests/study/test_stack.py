"""Laws that predict together: each by its weight, from the draws that a comparison left."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from jbw.cli.predict import basis_in
from jbw.errors import DataError
from jbw.law_comparison.answers import weights_for
from jbw.law_comparison.compare import LawComparison
from jbw.law_comparison.stack import basis_of_laws, holds_laws
from jbw.results.attributes import DecayConstants
from jbw.results.laws import StoredLaw
from jbw.study.store import write_json
from jbw.verification.planned import planned_sweep, planned_tones
from jbw.verification.predict import Request, basis_for, predict
from jbw.verification.predictive_basis import Basis, basis_of, seen_of

FREQ_HZ = np.array([17.0, 18.5, 21.0])
ZETA, GAIN = 0.02, 2.0


def posterior(omega_n, **more):
    values = {"omega_n": omega_n, "zeta": ZETA, "gain": GAIN, **more}
    return xr.Dataset(
        {name: (("chain", "draw"), np.full((2, 100), value)) for name, value in values.items()}
    )


def basis(omega_n, laws=(), **more):
    return Basis(
        posterior(omega_n, **more), {}, {}, 1e-3, (), 1, posterior(omega_n), DecayConstants(), laws
    )


def magnitude(omega_n):
    """Of the displacement of a linear oscillator under a force of GAIN."""
    omega = 2 * np.pi * FREQ_HZ
    return GAIN / np.abs(omega_n**2 - omega**2 + 2j * ZETA * omega_n * omega)


def test_every_law_has_its_share_of_the_draws():
    stack = replace(basis(118.0), beside=((0.25, basis(130.0)), (0.01, basis(90.0))))
    assert [(count, one.posterior["omega_n"].values[0, 0]) for count, one in stack.shared(100)] == [
        (75, 118.0), (25, 130.0)  # one draw in a hundred is no band
    ]  # fmt: skip


def test_the_band_is_that_of_the_mixture():
    stack = replace(basis(118.0), beside=((0.25, basis(130.0, ("cubic",), cubic=0.0)),))
    found = predict(stack, planned_tones(stack, FREQ_HZ, 1.0), Request(noise=False))
    band = found["model_magnitude"].values
    first, second = magnitude(118.0), magnitude(130.0)
    np.testing.assert_allclose(band[1], first, rtol=1e-8)  # the median of three in four
    np.testing.assert_allclose(band[0], np.minimum(first, second), rtol=1e-8)
    np.testing.assert_allclose(band[2], np.maximum(first, second), rtol=1e-8)
    assert found.attrs["num_draws"] == 100


def test_sweeps_are_predicted_by_every_law():
    stack = replace(basis(118.0), beside=((0.5, basis(130.0)),))
    sweep = planned_sweep(stack, (15.0, 24.0), 1.0, 4.0, 256.0)
    together = predict(stack, sweep, Request(noise=False))["model_band"].values
    each = [predict(basis(w), sweep, Request(noise=False))["model_band"].values[1]
            for w in (118.0, 130.0)]  # fmt: skip
    np.testing.assert_allclose(together[0], np.minimum(*each), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(together[2], np.maximum(*each), rtol=1e-9, atol=1e-15)


@pytest.fixture
def folder(tmp_path):
    groups = {}
    for name, omega_n in (("linear", 118.0), ("cubic", 130.0), ("bouc_wen", 90.0)):
        more = {"cubic": 0.0} if name == "cubic" else {}
        laws = '["cubic"]' if name == "cubic" else "[]"
        groups[f"/laws/{name}"] = xr.Dataset(attrs={"laws": laws, "y_peak": 1e-3})
        groups[f"/laws/{name}/posterior"] = posterior(omega_n, **more)
    xr.DataTree.from_dict(groups).to_netcdf(tmp_path / "laws.nc", engine="h5netcdf")
    rows = {
        "linear": {"answer": "not told apart", "weight": 0.3},
        "cubic": {"answer": "best", "weight": 0.7},
        "bouc_wen": {"answer": "worse", "weight": 0.0},
    }
    write_json(tmp_path / "laws.json", {"laws": rows})
    return tmp_path


def test_a_folder_of_laws_predicts_as_a_run_does(folder):
    assert holds_laws(folder)
    stack = basis_in(folder)
    assert stack.laws == ("cubic",)
    assert [(share, one.laws) for share, one in stack.beside] == [(0.3, ())]


def test_a_comparison_predicts_as_its_folder_does(folder):
    record = json.loads((folder / "laws.json").read_text(encoding="utf-8"))
    with xr.open_datatree(folder / "laws.nc", engine="h5netcdf") as tree:
        compared = LawComparison({}, tree.load(), record)
    saved = basis_in(folder)
    sweep = planned_sweep(saved, (15.0, 24.0), 1.0, 2.0, 256.0)
    here, there = compared.predict(sweep), predict(saved, sweep)
    np.testing.assert_array_equal(here["model_band"], there["model_band"])


def test_the_best_law_predicts_alone_where_nothing_is_weighed(folder):
    rows = {"linear": {"answer": "best", "weight": None},
            "cubic": {"answer": "not told apart", "weight": None}}  # fmt: skip
    write_json(folder / "laws.json", {"laws": rows})
    assert basis_of_laws(folder).beside == ()


ROWS = {
    "cubic": {
        "answer": "best",
        "weight": 0.7,
        "error_highest": 0.2,
        "error_across": {"sweeps and multisines": 0.05, "loops": 0.02},
    },
    "linear": {"answer": "not told apart", "weight": 0.3, "error_highest": 0.1},
    "bouc_wen": {"answer": "worse", "weight": 0.0, "error_highest": 0.3},
}


@pytest.mark.parametrize(
    ("changed", "target", "shares"),
    [
        ({}, "within", {"cubic": 0.7, "linear": 0.3}),
        ({}, "outward", {"linear": 1.0}),
        # Errors of 0.1 and 0.109 are alike, so that the weights of the comparison decide.
        ({"cubic": {"error_highest": 0.109}}, "outward", {"cubic": 0.7, "linear": 0.3}),
        # A law without any weight predicts alone where it is best by far.
        ({"bouc_wen": {"error_highest": 0.05}}, "outward", {"bouc_wen": 1.0}),
        ({}, "across", {}),  # one law alone was scored
        # Of kinds the worst decides: 0.05 of sweeps beside 0.04 of loops.
        (
            {"linear": {"error_across": {"sweeps and multisines": 0.01, "loops": 0.04}}},
            "across",
            {"linear": 1.0},
        ),
        (
            {"linear": {"error_across": {"sweeps and multisines": 0.01, "loops": 0.9}}},
            "across",
            {"cubic": 1.0},
        ),
    ],
)
def test_the_weights_follow_what_is_predicted(changed, target, shares):
    rows = {name: StoredLaw(**{**row, **changed.get(name, {})}) for name, row in ROWS.items()}
    assert weights_for(rows, target) == pytest.approx(shares)


def test_stronger_tests_and_other_kinds_are_predicted_by_the_laws_that_predict_them_best(folder):
    rows = {
        name: {**row, "error_across": {"loops": row["error_highest"]}} for name, row in ROWS.items()
    }
    write_json(folder / "laws.json", {"laws": rows})
    stack = basis_of_laws(folder)
    assert stack.laws == ("cubic",)
    assert (stack.outward.laws, stack.outward.beside) == ((), ())
    weak, strong = (planned_sweep(stack, (15.0, 24.0), level, 2.0, 256.0) for level in (1e-3, 1e3))
    stack = replace(stack, seen={"fitted": seen_of(weak)}, across=None)
    request = Request(noise=False)
    assert basis_for(stack, weak, request).laws == ("cubic",)
    assert basis_for(stack, strong, request).laws == ()
    # The linear oscillator has 118 rad/s, the others of the folder do not.
    alone = predict(stack.outward, strong, request)["model_band"].values
    np.testing.assert_array_equal(predict(stack, strong, request)["model_band"].values, alone)
    other = basis_of_laws(folder)
    assert basis_for(other, weak, request).laws == ()  # no kind was fitted


def test_a_broken_folder_is_named(folder):
    (folder / "laws.nc").write_bytes(b"")
    with pytest.raises(DataError, match=r"comparison of laws in .* cannot be read"):
        basis_in(folder)


def test_a_posterior_alone_predicts_as_before():
    tree = xr.DataTree.from_dict({"/posterior": posterior(118.0)})
    assert basis_of(tree).shared(50)[0][0] == 50
