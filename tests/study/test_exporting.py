"""What `jbw export` writes, read back by other readers and held against the draws."""

import csv

import numpy as np
import pytest
import xarray as xr
from conventions import BaberNoori, Benchmark, from_baber_noori, from_benchmark
from scipy.io import loadmat

from jbw.cli import run
from jbw.errors import ConfigError, DataError
from jbw.study.export import export, write_export

TRUTH = {"omega_n": 118.1239, "zeta": 0.00444, "alpha": 497.40, "delta": 340.21, "gamma": 32.84}
MASS = 2.5


def result(spread=1e-3, **more):
    rng = np.random.default_rng(0)
    draws = {n: v * (1 + spread * rng.standard_normal((4, 100))) for n, v in TRUTH.items()}
    posterior = xr.Dataset({n: (("chain", "draw"), v) for n, v in (draws | more).items()})
    return xr.DataTree.from_dict(
        {"/": xr.Dataset(attrs={"y_peak": 4.8e-3}), "posterior": posterior}
    )


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def written(tmp_path):
    tree = result()
    write_export(tmp_path, export(tree, MASS))
    return tree, tmp_path


def test_parameters_carry_their_intervals(written):
    tree, folder = written
    ours = [row for row in rows(folder / "parameters.csv") if row["convention"] == "jbw"]
    assert [row["parameter"] for row in ours] == list(TRUTH)
    for row in ours:
        values = tree["posterior"][row["parameter"]].values
        assert float(row["mean"]) == pytest.approx(values.mean(), rel=1e-12)
        quantiles = [float(row[mark]) for mark in ("q005", "q500", "q995")]
        np.testing.assert_allclose(quantiles, np.quantile(values, [0.005, 0.5, 0.995]), rtol=1e-12)


@pytest.mark.parametrize(
    ("convention", "record", "back"),
    [
        ("Bouc-Wen-Baber-Noori, OpenSees", BaberNoori, from_baber_noori),
        ("hysteretic benchmark", Benchmark, from_benchmark),
    ],
)
def test_other_conventions_lead_back_to_the_joint(tmp_path, convention, record, back):
    write_export(tmp_path, export(result(spread=0.0), MASS))
    found = {
        row["parameter"]: float(row["mean"])
        for row in rows(tmp_path / "parameters.csv")
        if row["convention"] == convention
    }
    joint = back(record(**found))
    for name, value in TRUTH.items():
        assert float(getattr(joint, name)) == pytest.approx(value, rel=1e-12)


def test_the_backbone_is_that_of_the_steady_loop(written):
    _, folder = written
    curve = rows(folder / "backbone.csv")
    assert float(curve[-1]["amplitude_m"]) == pytest.approx(4.8e-3)
    first = float(curve[0]["frequency_hz_q500"])
    # At 48 um the joint has softened by 4 alpha delta Y / (3 pi) of the stiffness (section 2).
    softer = 4 * 497.4 * 340.21 * 4.8e-5 / (3 * np.pi)
    expected = np.sqrt(118.1239**2 - softer) / (2 * np.pi)
    assert first == pytest.approx(expected, rel=2e-4)  # the median of 400 draws 1e-3 wide
    for row in curve:
        assert float(row["damping_ratio_q005"]) < float(row["damping_ratio_q995"])
        power = 2 * float(row["damping_ratio_q500"]) * float(row["amplitude_m"])
        force = power * (2 * np.pi * float(row["frequency_hz_q500"])) ** 2 * MASS
        assert float(row["force_n_q500"]) == pytest.approx(force, rel=1e-2)


def test_matlab_reads_draws_and_backbone(written):
    tree, folder = written
    found = loadmat(folder / "jbw.mat", squeeze_me=True)
    zeta = found["draws"]["zeta"].item()
    np.testing.assert_array_equal(zeta, tree["posterior"]["zeta"].values.ravel())
    assert found["backbone"]["frequency_hz_q500"].item().shape == (100,)
    line = (folder / "joint.tcl").read_text().splitlines()[1].split()
    assert line[:2] == ["uniaxialMaterial", "BoucWen"]
    assert float(line[4]) == pytest.approx(MASS * 118.1239**2, rel=1e-3)


def test_a_cubic_joint_has_no_material_of_opensees(tmp_path):
    tree = result(cubic=np.full((4, 100), 1e8))
    with pytest.raises(ConfigError, match="--y-max"):
        export(tree, MASS, y_max=-1.0)
    made = write_export(tmp_path, export(tree, MASS))
    assert "joint.tcl" not in {path.name for path in made}
    found = rows(tmp_path / "parameters.csv")
    assert {row["convention"] for row in found} == {"jbw"}
    assert "cubic" in {row["parameter"] for row in found}


def test_a_posterior_without_the_joint_is_refused():
    tree = result()
    tree["posterior"] = xr.DataTree(tree["posterior"].to_dataset().drop_vars("zeta"))
    with pytest.raises(DataError, match="lacks zeta"):
        export(tree)


def test_the_command_writes_beside_the_run(tmp_path, capsys):
    result().to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    (tmp_path / "summary.json").write_text("{}")
    assert run(["export", str(tmp_path), "--mass", "2"]) == 0
    assert "backbone.csv" in capsys.readouterr().out
    assert run(["export", str(tmp_path)]) != 0  # the folder is no longer empty
    assert "must be new or empty" in capsys.readouterr().err
