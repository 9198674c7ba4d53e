"""What `jbw export` writes, read back by other readers and held against the draws."""

import json

import numpy as np
import pytest
import xarray as xr
from dialect import readable
from exported import column, comments, rows
from scipy.io import loadmat

from jbw.cli import run
from jbw.errors import ConfigError, DataError
from jbw.export.files import write_export
from jbw.export.one_joint import export
from jbw.oscillator.conventions import BaberNoori, Benchmark, from_baber_noori, from_benchmark

TRUTH = {"omega_n": 118.1239, "zeta": 0.00444, "alpha": 497.40, "delta": 340.21, "gamma": 32.84}
MASS = 2.5
FINDINGS = [
    {"code": "r_hat", "status": "ok", "reason": "Fine."},
    {"code": "modes", "status": "failed", "reason": "Two modes \x1b[31m,\nno more."},
]
VERDICT = {"status": "failed", "findings": FINDINGS}


def result(spread=1e-3, **more):
    rng = np.random.default_rng(0)
    draws = {n: v * (1 + spread * rng.standard_normal((4, 100))) for n, v in TRUTH.items()}
    # Of the density that the draws come from.
    z = [(draws[n] / v - 1) / max(spread, 1e-9) for n, v in TRUTH.items()]
    return tree_of(draws | more, -0.5 * np.sum(np.square(z), axis=0))


def tree_of(draws, lp, **attrs):
    """What `jbw export` reads of a run."""
    dims = ("chain", "draw")
    posterior = xr.Dataset({name: (dims, values) for name, values in draws.items()})
    facts = xr.Dataset(attrs={"y_peak": 4.8e-3, **attrs})
    stats = xr.Dataset({"lp": (dims, lp)})
    return xr.DataTree.from_dict({"/": facts, "posterior": posterior, "sample_stats": stats})


def of_jbw(folder):
    """The exported joint in our own letters."""
    table = rows(folder / "parameters.csv")
    return {r["parameter"]: float(r["value"]) for r in table if r["convention"] == "jbw"}


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
        assert float(row["value"]) in values
        quantiles = [float(row[mark]) for mark in ("q005", "q500", "q995")]
        np.testing.assert_allclose(quantiles, np.quantile(values, [0.005, 0.5, 0.995]), rtol=1e-12)
    assert all(readable(row["unit"]) for row in rows(folder / "parameters.csv"))


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
        row["parameter"]: float(row["value"])
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
    joint = {name: found["joint"][name].item() for name in TRUTH}
    assert joint == of_jbw(folder)
    lines = (folder / "joint.tcl").read_text().splitlines()
    spring, own, both = (line.split()[1:] for line in lines if line.startswith("uniaxial"))
    stuck = float(spring[2]) + float(own[3])
    assert stuck == pytest.approx(MASS * joint["omega_n"] ** 2, rel=1e-12)
    assert both == ["Parallel", "1", spring[1], own[1]]


def test_a_cubic_joint_has_no_material_of_opensees(tmp_path):
    tree = result(cubic=np.full((4, 100), 1e8))
    with pytest.raises(ConfigError, match="--y-max"):
        export(tree, MASS, y_max=-1.0)
    made = write_export(tmp_path, export(tree, MASS))
    assert "joint.tcl" not in {path.name for path in made}
    found = rows(tmp_path / "parameters.csv")
    assert {row["convention"] for row in found} == {"jbw", "jbw, products"}
    assert "cubic" in {row["parameter"] for row in found}


def test_a_posterior_without_the_joint_is_refused():
    tree = result()
    tree["posterior"] = xr.DataTree(tree["posterior"].to_dataset().drop_vars("zeta"))
    with pytest.raises(DataError, match="lacks zeta"):
        export(tree)


def test_the_command_writes_beside_the_run(tmp_path, capsys):
    result().to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    (tmp_path / "summary.json").write_text(json.dumps({"campaign": "beam", "verdict": VERDICT}))
    assert run(["export", str(tmp_path), "--mass", "2", "--draw", "7"]) == 0
    assert "backbone.csv" in capsys.readouterr().out
    for name in ("parameters.csv", "backbone.csv", "loop.csv", "joint.tcl"):
        about = comments(tmp_path / "export" / name)
        assert about[0] == "Verdict of the run beam: failed: Two modes \\x1b[31m, no more."
        assert about[1].startswith("Joint: draw number 7 of 400 (counted from 0), as requested")
    stored = loadmat(tmp_path / "export" / "jbw.mat", squeeze_me=True)["about"]
    assert [str(line) for line in stored[:2]] == about[:2]
    assert run(["export", str(tmp_path)]) != 0  # the folder is no longer empty
    assert "must be new or empty" in capsys.readouterr().err


def ridge():
    """Draws along alpha delta = const, 1 % wide, and their densities; alpha over two decades."""
    rng = np.random.default_rng(1)
    along = rng.standard_normal((2, 2000))
    across = 0.01 * rng.standard_normal((2, 2, 2000))
    alpha = 500.0 * np.exp(np.clip(along, -2.5, 2.5))
    draws = {name: np.full((2, 2000), value) for name, value in TRUTH.items()}
    draws |= {
        "alpha": alpha,
        "delta": 1.7e5 * (1 + across[0]) / alpha,
        "gamma": 1.6e4 * (1 + across[1]) / alpha,
    }
    return tree_of(draws, -0.5 * (along**2 + np.sum((across / 0.01) ** 2, axis=0)))


def test_the_joint_of_a_ridge_is_a_draw_of_it_and_not_the_means(tmp_path):
    tree = ridge()
    posterior = {name: tree["posterior"][name].values.ravel() for name in TRUTH}
    write_export(tmp_path, found := export(tree, MASS))
    table = {row["parameter"]: row for row in rows(tmp_path / "parameters.csv")}
    for name, factors in {"alpha_delta": "alpha delta", "alpha_gamma": "alpha gamma"}.items():
        one, other = factors.split()
        low, high = np.quantile(posterior[one] * posterior[other], [0.005, 0.995])
        assert low <= found.joint[one] * found.joint[other] <= high
        assert float(table[name]["value"]) == pytest.approx(found.joint[one] * found.joint[other])
        # The means are no joint of this posterior: theirs is twice as large.
        assert posterior[one].mean() * posterior[other].mean() > 1.5 * high
    assert "mean" not in table["alpha"]
    # It is one draw, and among the best.
    number = int(np.flatnonzero(posterior["alpha"] == found.joint["alpha"])[0])
    assert all(posterior[name][number] == found.joint[name] for name in TRUTH)
    density = tree["sample_stats"]["lp"].values.ravel()
    assert np.sum(density > density[number]) < 20
    curve = rows(tmp_path / "backbone.csv")
    for row in curve:
        for name in ("frequency_hz", "damping_ratio", "force_n"):
            assert float(row[f"{name}_q005"]) <= float(row[name]) <= float(row[f"{name}_q995"])
    assert f"Joint: draw number {number} of 4000" in comments(tmp_path / "joint.tcl")[1]


def test_the_best_draw_is_not_taken_from_the_edge_of_what_the_data_know():
    """A gamma whose density is highest at its bound of zero: there the joint loses nothing."""
    tree = ridge()
    lp = tree["sample_stats"]["lp"].values.copy()
    gamma = tree["posterior"]["gamma"].values.copy()
    gamma[0, 5], lp[0, 5] = 0.0, 1e3
    draws = {name: tree["posterior"][name].values for name in TRUTH} | {"gamma": gamma}
    found = export(tree_of(draws, lp), MASS)
    assert found.joint["gamma"] > 0
    chosen = export(tree_of(draws, lp), MASS, draw=5)
    assert chosen.joint["gamma"] == 0.0
    assert any("alpha_gamma is 0 1/(m s^2), outside" in line for line in chosen.about)
    assert any("joint lies partly outside" in line for line in chosen.about)
    with pytest.raises(ConfigError, match="must be 0 to 3999"):
        export(tree, MASS, draw=4000)


def test_the_static_loop_loses_what_the_backbone_says(written):
    _, folder = written
    y, force, peak = (
        np.reshape(column(folder / "loop.csv", name), (3, -1))
        for name in ("displacement_m", "force_n", "y_peak_m")
    )
    joint = of_jbw(folder)
    np.testing.assert_array_equal(y.max(axis=1), peak[:, 0])
    # Closed form of Eq. (2) on the way down while Z > 0, from the greatest Z of the loop.
    z_max = force[2, 0] / MASS - (joint["omega_n"] ** 2 - joint["alpha"]) * y[2, 0]
    c = joint["gamma"] - joint["delta"]
    down = y[2, 0] - y[2, 1:20]
    z = (z_max + joint["alpha"] / c) * np.exp(-c * down) - joint["alpha"] / c
    k = joint["omega_n"] ** 2 - joint["alpha"]
    np.testing.assert_allclose(force[2, 1:20], MASS * (k * y[2, 1:20] + z), rtol=1e-9)
    # The area is what the force in resonance feeds in beyond the dashpot; trapezia of 200 sides.
    area = np.trapezoid(force, y, axis=1)[2]
    last = rows(folder / "backbone.csv")[-1]
    omega, size = 2 * np.pi * float(last["frequency_hz"]), y[2, 0]
    dashpot = MASS * 2 * joint["zeta"] * joint["omega_n"] * omega * size
    assert area == pytest.approx(np.pi * size * (float(last["force_n"]) - dashpot), rel=1e-3)
