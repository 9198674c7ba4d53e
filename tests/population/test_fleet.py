"""A fleet of runs: what it holds of them, and which runs it refuses to put together."""

import json
import re

import h5py
import numpy as np
import pytest
import xarray as xr

import jbw
from jbw.cli import run
from jbw.population.fleet import fleet_of, read_fleet, write_fleet

UNITS = {"omega_n": "rad/s", "zeta": "1", "alpha": "1/s^2", "delta": "1/m", "gamma": "1/m"}
MEANS = {"omega_n": 118.0, "zeta": 0.01, "alpha": 3000.0, "delta": 400.0, "gamma": 150.0}
BOUNDS = {"omega_n": (50.0, 200.0), "zeta": (1e-4, 0.1), "delta": (-100.0, 5000.0)}
VERSIONS = {"jbw": "0.1.0", "jax": "0.12.0"}


def a_run(
    folder, seed=0, laws=("bouc_wen",), draws=None, units=UNITS, scatter=None, attrs=None, box=True,
    **record,
):  # fmt: skip
    """The folder of a finished run made up: draws of two chains of fifty, log-normal."""
    rng = np.random.default_rng(seed)
    if draws is None:
        draws = {n: m * np.exp(0.02 * rng.standard_normal((2, 50))) for n, m in MEANS.items()}
    posterior = xr.Dataset({n: (("chain", "draw"), v) for n, v in draws.items()})
    for name in draws:
        posterior[name].attrs["units"] = units.get(name, "1")
        if box and name in BOUNDS:
            posterior[name].attrs.update(zip(("lower", "upper"), BOUNDS[name], strict=True))
    facts = {"laws": json.dumps(laws)} | ({} if scatter is None else {"scatter": scatter})
    facts |= attrs or {}
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs=facts), "/posterior": posterior})
    folder.mkdir(parents=True)
    tree.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    parameters = {name: {"ess_bulk": 90.0 + i} for i, name in enumerate(draws)}
    summary = {
        "campaign": folder.name,
        "main": "joint",
        "steps": {"joint": {"parameters": parameters}},
        "verdict": {"status": "usable", "answers": {"sampling": {"status": "ok"}}},
        "versions": VERSIONS,
        "inputs": {"a.h5": f"hash of {folder.name}"},
        **record,
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder, draws


def two(path, **second):
    first, _ = a_run(path / "A", 1)
    other, _ = a_run(path / "B", 2, **second)
    return [first, other]


def test_a_fleet_holds_the_logarithms_of_every_draw(tmp_path):
    runs = [a_run(tmp_path / name, seed) for seed, name in enumerate("ABC")]
    fleet = fleet_of([folder for folder, _ in runs])
    assert fleet["unit"].values.tolist() == ["A", "B", "C"]
    for folder, draws in runs:
        held = fleet[folder.name]["draws"]
        for name, values in draws.items():
            assert np.array_equal(held.sel(parameter=name), np.log(values.ravel()))
        product = np.log((draws["alpha"] * draws["delta"]).ravel())
        assert np.allclose(held.sel(parameter="alpha_delta"), product, rtol=1e-14)
        softening = product - 2 * np.log(draws["omega_n"].ravel())
        assert np.allclose(held.sel(parameter="softening"), softening, rtol=1e-13)
        # NumPy's own mean and covariance of what the file holds.
        assert np.allclose(fleet["mean"].sel(unit=folder.name), held.values.mean(0), rtol=1e-14)
        covariance = fleet["covariance"].sel(unit=folder.name)
        assert np.allclose(covariance, np.cov(held.values.T), rtol=1e-12)
    assert json.loads(fleet.attrs["units"])["alpha_delta"] == "1/(m s^2)"
    assert fleet["ess"].values.tolist() == [90.0, 90.0, 90.0]
    assert fleet["verdict"].values.tolist() == ["usable"] * 3
    assert fleet["sampling"].values.tolist() == ["ok"] * 3


def test_a_fleet_is_read_as_it_was_written(tmp_path):
    stated = {"torque": 8.0, "sequence": 1, "temperature": 21.5, "assembly": "beam 3"}
    runs = two(tmp_path, assembly={**stated, "torque": 4.0})
    fleet = fleet_of(runs, covariates={"A": stated})
    write_fleet(tmp_path / "fleet.nc", fleet)
    reread = read_fleet(tmp_path / "fleet.nc")
    assert reread.identical(fleet)
    assert reread["torque"].values.tolist() == [8.0, 4.0]
    assert reread["assembly"].values.tolist() == ["beam 3"] * 2
    assert not list(tmp_path.glob(".part-*"))


def test_bounds_are_of_what_was_sampled_and_say_where_they_cut(tmp_path):
    half = np.abs(np.random.default_rng(3).standard_normal((2, 5000)))
    draws = {n: np.full((2, 5000), m) for n, m in MEANS.items()}
    draws |= {"omega_n": 200.0 - half, "zeta": 0.01 + 1e-4 * half}
    runs = two(tmp_path, draws=draws)
    fleet = fleet_of(runs)
    cut = fleet["beyond"].sel(unit="B")
    # Of half a Gaussian the mean is sqrt(2/pi) sd from its end and the sd sqrt(1 - 2/pi).
    assert float(cut.sel(parameter="omega_n")) == pytest.approx(0.0929, abs=0.005)
    assert float(cut.sel(parameter="zeta")) < 1e-12
    assert np.isnan(cut.sel(parameter="alpha"))
    assert float(fleet["lower"].sel(unit="A", parameter="delta")) == -np.inf
    assert float(fleet["upper"].sel(unit="A", parameter="zeta")) == np.log(0.1)


def test_what_has_no_logarithm_in_one_unit_is_named_and_left_out(tmp_path):
    draws = {n: np.full((1, 9), m) for n, m in MEANS.items()} | {"delta": np.full((1, 9), -3.0)}
    fleet = fleet_of(two(tmp_path, draws=draws, scatter=[0.5, 1e-4]))
    assert "delta" not in fleet["parameter"]
    left_out = json.loads(fleet.attrs["left_out"])
    assert left_out == {name: ["B"] for name in ("delta", "alpha_delta", "softening")}
    scatter = fleet["run_scatter"].sel(unit="B")
    assert float(scatter.sel(parameter="omega_n")) == pytest.approx(0.5 / 118, rel=1e-12)
    assert np.isnan(fleet["run_scatter"].sel(unit="A")).all()


@pytest.mark.parametrize(
    ("second", "message", "remedy"),
    [
        ({"laws": ("bouc_wen", "cubic")}, "different laws", "same \\[joint\\] laws"),
        ({"units": {**UNITS, "zeta": "%"}}, "have zeta in different units: 1, and %", "same unit"),
        ({"versions": {**VERSIONS, "jax": "0.1"}}, "versions of jax: 0.12.0, and 0.1", "--mixed"),
        (
            {"inputs": {"x": "hash of A"}},
            "A and B were identified from the same records",
            "Give only one",
        ),
        ({"assembly": {"torque": 3.0}}, "`torque` is stated for 1 of 2 runs.* A\\.", "leave out A"),
        ({"assembly": {"torque": -3.0}}, "Run B: `torque` must be positive", "in N m"),
        ({"assembly": {"torque": "x"}}, "Run B: `torque` must be a finite number.*'x'", "Correct"),
        ({"draws": {"omega_n": np.array([[1.0, np.nan]])}}, "of omega_n in .*be finite", "again"),
        ({"laws": ("bouc_wen@bolt_1", "bouc_wen@bolt_2")}, "B must be of one joint", "jbw diff"),
    ],
)  # fmt: skip
def test_runs_that_do_not_belong_together_are_refused(tmp_path, second, message, remedy):
    if "cubic" in second.get("laws", ()):
        second["draws"] = {**{n: np.full((1, 9), m) for n, m in MEANS.items()},
                           "cubic": np.full((1, 9), 1e5)}  # fmt: skip
    with pytest.raises(jbw.JbwError, match=message) as error:
        fleet_of(two(tmp_path, **second))
    assert re.search(remedy, error.value.remedy)


def test_other_versions_are_taken_where_that_is_said(tmp_path):
    runs = two(tmp_path, versions={**VERSIONS, "jax": "0.1"})
    assert fleet_of(runs, mixed_versions=True).sizes["unit"] == 2


def test_one_run_is_no_fleet(tmp_path):
    folder, _ = a_run(tmp_path / "A")
    with pytest.raises(jbw.DataError, match="at least 2 runs, but there is one"):
        fleet_of([folder])
    with pytest.raises(jbw.DataError, match="given twice"):
        fleet_of([folder, folder])
    with pytest.raises(jbw.ConfigError, match="run `Q`, which is not among the runs"):
        fleet_of(two(tmp_path / "x"), covariates={"Q": {}})
    with pytest.raises(jbw.ConfigError, match="`torqe` is not a covariate"):
        fleet_of(two(tmp_path / "y"), covariates={"A": {"torqe": 1.0}})


def test_runs_of_one_name_take_that_of_the_folder_around_them(tmp_path):
    runs = [a_run(tmp_path / name / "run", inputs={"a": name})[0] for name in ("m1", "m2")]
    assert fleet_of(runs)["unit"].values.tolist() == ["m1_run", "m2_run"]
    clash = [a_run(tmp_path / name, inputs={"a": name})[0] for name in ("mean", "other")]
    assert fleet_of(clash)["unit"].values.tolist() == ["mean_run", "other_run"]


def test_a_file_that_is_no_fleet_is_refused(tmp_path):
    with pytest.raises(jbw.DataError, match="cannot be read"):
        read_fleet(tmp_path / "none.nc")
    with h5py.File(tmp_path / "other.nc", "w") as file:
        file.attrs["format"] = 1
    with pytest.raises(jbw.DataError, match="contains no fleet of format 1"):
        read_fleet(tmp_path / "other.nc")


def test_the_command_collects_a_folder_of_runs(tmp_path, capsys):
    two(tmp_path / "runs")
    (tmp_path / "runs" / "C" / ".run").mkdir(parents=True)
    (tmp_path / "units.csv").write_text("run,torque,assembly\nA,8,beam\nB,4,beam\n")
    out = tmp_path / "fleet.nc"
    arguments = ["collect", tmp_path / "runs", "--out", out, "--covariates", tmp_path / "units.csv"]
    assert run([*map(str, arguments), "--json"]) == 0
    printed = capsys.readouterr()
    assert "is left out of the fleet, because the run is" in " ".join(printed.err.split())
    answer = json.loads(printed.out)
    assert [unit["torque"] for unit in answer["units"]] == [8.0, 4.0]
    assert read_fleet(out)["torque"].values.tolist() == [8.0, 4.0]


def test_the_command_says_what_is_wrong_with_a_table_of_covariates(tmp_path, capsys):
    runs = [str(folder) for folder in two(tmp_path / "runs")]
    table = tmp_path / "units.csv"
    table.write_text("unit,torque\nA,8\n")
    assert run(["collect", *runs, "--covariates", str(table)]) == 2
    assert "units.csv, line 2: must name a run" in capsys.readouterr().err
    assert run(["collect", str(tmp_path)]) == 3
    assert "contains no finished run" in capsys.readouterr().err
