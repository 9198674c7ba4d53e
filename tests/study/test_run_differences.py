"""Two runs of known posteriors: what differs and how sure that is, by closed forms."""

import json

import numpy as np
import pytest
import xarray as xr
from scipy.stats import norm

from jbw.cli import run
from jbw.errors import ConfigError
from jbw.identification.discrepancy import Discrepancy, Missed, Scatter, as_dataset
from jbw.report.changes import probability_text
from jbw.report.messages import differences as texts
from jbw.study.differences import changed_joints, compared, differences, joint_statements

COUNT = 1000
UNITS = {"omega_n": "rad/s", "zeta": "1", "alpha": "1/s^2", "delta": "1/m", "gamma": "1/m"}
# No hysteretic stiffness to speak of: frequency and damping are the linear oscillator's.
LINEAR = {"zeta": 0.01, "alpha": 1e-6, "delta": 1.0, "gamma": 1.0}


def gaussian(mean, sd, seed=0):
    """Draws at a Gaussian's own quantiles, in any order: their moments are the Gaussian's."""
    draws = mean + sd * norm.ppf((np.arange(COUNT) + 0.5) / COUNT)
    return np.random.default_rng(seed).permutation(draws)


def write_run(
    folder, omega_n, *, units=UNITS, laws="bouc_wen", kl=3.0, scatter=None, held=None,
    discrepancy=None, **more,
):  # fmt: skip
    """A finished run as `read_result` finds it: `omega_n` is mean and sd, the rest is fixed."""
    folder.mkdir()
    draws = {"omega_n": gaussian(*omega_n, seed=len(folder.name))}
    draws |= {name: np.full(COUNT, value) for name, value in LINEAR.items()} | more
    posterior = xr.Dataset(
        {
            name: (("chain", "draw"), values[None], {"units": units.get(name, "1")})
            for name, values in draws.items()
        }
    )
    attrs = {"laws": json.dumps([laws]), "y_peak": 2e-3}
    if held is not None:
        attrs["held"] = json.dumps(held)
    if scatter is not None:
        attrs["scatter"] = np.asarray(scatter)
    groups = {"/": xr.Dataset(attrs=attrs), "/posterior": posterior}
    if discrepancy is not None:
        groups["/discrepancy"] = as_dataset(discrepancy)
    tree = xr.DataTree.from_dict(groups)
    tree.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    summary = {
        "campaign": folder.name,
        "main": "joint",
        "steps": {"joint": {"parameters": {"omega_n": {"kl": kl}}}},
        "verdict": {"status": "ok", "findings": []},
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder


def test_the_probability_of_gaussians_is_the_closed_one():
    """P(A > B) = Phi((a - b) / sqrt(s^2 + t^2)); quantile draws of 1,000 miss it by 1 / 1,000."""
    for a, s, b, t in ((1.0, 0.3, 0.7, 0.4), (0.0, 1.0, 0.0, 1.0), (-2.0, 0.5, 0.0, 0.5)):
        found = compared(gaussian(a, s), gaussian(b, t, seed=1))
        wide = np.hypot(s, t)
        assert found.probability == pytest.approx(norm.cdf((a - b) / wide), abs=2e-3)
        # The outermost of 1,000 draws cut the tails: 1 % of the interval's end.
        expected = norm.ppf([0.005, 0.5, 0.995], a - b, wide)
        np.testing.assert_allclose(found.difference, expected, atol=0.02 * wide)


def correlated(mean, covariance, seed):
    """Draws whose mean and covariance are exactly those that are asked for."""
    white = np.random.default_rng(seed).standard_normal((len(mean), COUNT))
    white -= white.mean(axis=1, keepdims=True)
    white = np.linalg.solve(np.linalg.cholesky(np.cov(white)), white)
    return np.asarray(mean)[:, None] + np.linalg.cholesky(covariance) @ white


def test_the_joint_that_has_changed_is_named_by_all_its_parameters():
    """Along a ridge of two parameters each alone may be the same, and both together differ."""
    laws = ("bouc_wen@bolt_1", "bouc_wen@bolt_2")
    names = [f"{n}@bolt_{j}" for j in (1, 2) for n in ("alpha", "delta", "gamma")]
    std = np.array([1e5, 4e3, 6e2] * 2)
    ridge = np.array([[1.0, -0.9, 0.0], [-0.9, 1.0, 0.0], [0.0, 0.0, 1.0]])
    covariance = np.kron(np.eye(2), ridge) * np.outer(std, std)
    mean = np.array([6e6, 3e5, 4e4, 6e6, 3e5, 4e4])
    # Both by 1.5 standard errors of the difference, against the ridge.
    away = np.array([0.2, -0.1, 0.3, 1.5, 1.5, 0.0]) * np.sqrt(2) * std
    first, second = (
        dict(zip(names, correlated(mean + x, covariance, seed), strict=True))
        for seed, x in enumerate((away, 0 * away))
    )
    same, changed = changed_joints(first, second, laws)
    # 1.5^2 (1, 1) R^-1 (1, 1) = 2 1.5^2 / (1 - 0.9); of the first joint by its own ridge.
    assert changed.chi_square == pytest.approx(45.0, rel=1e-6)
    expected = (0.04 + 0.01 - 2 * 0.9 * 0.02) / (1 - 0.81) + 0.09
    assert same.chi_square == pytest.approx(expected, rel=1e-6)
    assert changed.degrees_of_freedom == same.degrees_of_freedom == 3
    assert (same.changed, changed.changed) == (False, True)
    # The survival function of chi-square with three degrees of freedom in closed form.
    x = expected
    p = 2 * norm.sf(np.sqrt(x)) + np.sqrt(2 * x / np.pi) * np.exp(-x / 2)
    assert same.p == pytest.approx(p, rel=1e-6)
    said = joint_statements([same, changed])
    assert said[0] == texts.joint_changed("bolt_2", 45.0, 3)
    assert said[1].startswith("Joints that may be the same: bolt_1 (p = ")


def test_factors_on_the_motion_of_joints_are_compared_one_by_one_and_that_is_said(tmp_path):
    """They are no parameters of a joint: what a mode moves it by is of the structure."""
    factor, runs = "motion_factor_2@bolt_1", []
    held = {"seen_1": 1.0, "motion_1@bolt_1": 1.0}
    for folder, middle in (("first", 1.0), ("second", 1.1)):
        draws = {f"{n}@bolt_1": gaussian(x, 0.01 * x) for n, x in
                 (("alpha", 6e6), ("delta", 3e5), ("gamma", 4e4))}  # fmt: skip
        draws[factor] = gaussian(middle, 0.01)
        runs.append(
            write_run(tmp_path / folder, (126.0, 0.1), laws="bouc_wen@bolt_1", held=held, **draws)
        )
    record = differences(*runs)[0]
    assert [row.degrees_of_freedom for row in record.joints] == [3]
    assert not record.joints[0].changed
    row = next(row for row in record.parameters if row.name == factor)
    # Phi(-0.1 / sqrt(2) 0.01) of a factor that is larger in the second run.
    assert row.probability < 1e-6
    assert texts.factors_apart([factor]) in record.statements


def test_laws_in_metres_of_other_motions_are_told(tmp_path):
    """Where one run drives mode 1 and the other mode 2, other motions are held at the model's."""
    held = {"seen_1": 1.0, "motion_1@bolt_1": 1.0}
    draws = {f"{n}@bolt_1": gaussian(x, 0.01 * x) for n, x in
             (("alpha", 6e6), ("delta", 3e5), ("gamma", 4e4))}  # fmt: skip
    runs = []
    for folder, *shares in (("first", 0.19, 0.03), ("second", 0.02, 0.03), ("third", 0.2, 0.1)):
        run_folder = write_run(
            tmp_path / folder, (126.0, 0.1), laws="bouc_wen@bolt_1", held=held, **draws
        )
        joints = xr.Dataset(
            {"energy_share": (("joint", "mode"), [shares]), "motion_factor": ("mode", [1.0, 1.1])},
            {"joint": ["bolt_1"], "mode": [1, 2]},
        )
        joints.to_netcdf(run_folder / "posterior.nc", mode="a", group="joints", engine="h5netcdf")
        runs.append(run_folder)
    said = texts.homes_differ("bolt_1", "bolt_1 in mode 1", "bolt_1 in mode 2")
    assert said in differences(*runs[:2])[0].statements
    alike = differences(runs[0], runs[2])[0].statements
    assert not any("the model's motion of" in sentence for sentence in alike)


def test_of_one_joint_no_joint_is_named(tmp_path):
    first, second = (write_run(tmp_path / name, (126.0, 0.1)) for name in ("first", "second"))
    assert differences(first, second)[0].joints == []
    assert joint_statements([]) == []


def test_a_tie_counts_as_half():
    assert compared(np.ones(10), np.ones(20)).probability == 0.5
    assert compared(np.array([1.0, 3.0]), np.array([1.0, 2.0])).probability == 0.625  # 2.5 / 4


def test_frequencies_differ_by_what_the_oscillators_do(tmp_path):
    """A linear oscillator's frequency is omega_n / 2 pi at every amplitude, its damping zeta."""
    one = write_run(tmp_path / "first", (126.0, 0.1))
    other = write_run(tmp_path / "second", (125.0, 0.1))
    found = differences(one, other)
    rows = {(row.name, round(1e3 * row.amplitude, 6)): row for row in found[0].backbone}
    assert {y for _, y in rows} == {0.2, 0.5, 1.0, 1.5, 2.0}
    low, middle, high = rows["frequency", 2.0].difference
    # Of 200 draws carried the tails end at 2.8 standard deviations.
    half = 2.576 * np.hypot(0.1, 0.1) / (2 * np.pi)
    assert middle == pytest.approx(1.0 / (2 * np.pi), abs=0.05 * half)
    assert (high - low) / 2 == pytest.approx(half, rel=0.1)
    assert rows["frequency", 2.0].probability > 0.999
    np.testing.assert_allclose(rows["damping", 1.0].a, 0.01, rtol=1e-6)
    said = found[0].statements
    assert texts.differs("omega_n", "1.00 [0.64, 1.36] rad/s", sure=True) in said
    assert texts.may_be_same(["zeta", "alpha", "delta", "gamma", "gamma/delta"]) in said
    assert texts.ONE_ASSEMBLY in said


def with_ratio(mean, sd, seed):
    """Of a joint whose alpha and delta are poorly known: its ratio is the one number."""
    delta = np.exp(gaussian(5.0, 0.3, seed))
    return {"delta": delta, "gamma": delta * gaussian(mean, sd, seed + 1)}


def test_what_laws_miss_widens_the_difference_of_frequency_and_damping(tmp_path):
    """Errors of 0.1 % of the frequency and 0.001 of the damping ratio in each of two equal laws."""
    missed = Missed(Scatter(1e-3), Scatter(1e-3))
    discrepancy = Discrepancy(missed, missed, {}, 1e-4, 2e-3)
    a, b = (
        write_run(tmp_path / name, (mean, 1e-6), discrepancy=discrepancy)
        for name, mean in (("a", 100.0), ("bb", 99.9))
    )
    for row in differences(a, b)[0].backbone:
        # 0.1 % apart with errors of 0.1 % each: P(A > B) = Phi(1 / sqrt 2), and half for damping.
        hz = 0.1 / (2 * np.pi)
        apart, wide = (hz, hz) if row.name == "frequency" else (0.0, 1e-3)
        # The normal deviates of 200 draws; each pair of them counts.
        expected = norm.cdf(apart / (np.sqrt(2) * wide))
        assert row.probability == pytest.approx(expected, abs=0.02)
        interval = norm.ppf([0.005, 0.995], apart, np.sqrt(2) * wide)
        np.testing.assert_allclose(np.asarray(row.difference)[[0, 2]], interval, atol=0.1 * wide)


def test_two_modes_of_one_joint_have_one_ratio(tmp_path):
    one = write_run(tmp_path / "first", (126.0, 0.1), **with_ratio(0.27, 0.02, 1))
    other = write_run(tmp_path / "second", (252.0, 0.1), **with_ratio(0.50, 0.03, 4))
    found = differences(one, other)[0]
    row = found.parameters[-1]
    assert (row.name, row.unit) == ("gamma/delta", "1")
    # The outermost of 1,000 draws cut the tails, as above.
    low, middle, high = norm.ppf([0.005, 0.5, 0.995], -0.23, np.hypot(0.02, 0.03))
    np.testing.assert_allclose(row.difference, [low, middle, high], atol=2e-3)
    said = " ".join(found.statements)
    assert "gamma/delta is the same in both. A: 0.270 [0.2" in said
    assert texts.SHARES[True] in said
    same = write_run(tmp_path / "same", (252.0, 0.1), **with_ratio(0.29, 0.03, 4))
    said = " ".join(differences(one, same)[0].statements)
    assert texts.SHARES[True] not in said
    assert texts.SHARES[False] in said
    # Of one mode on two days nothing is said of modes; a softening that may be none has no ratio.
    again = write_run(tmp_path / "again", (127.0, 0.1), **with_ratio(0.50, 0.03, 4))
    said = " ".join(differences(one, again)[0].statements)
    assert not any(answer in said for answer in texts.SHARES.values())
    weak = write_run(tmp_path / "weak", (252.0, 0.1), delta=gaussian(1.0, 1.0))
    names = [row.name for row in differences(one, weak)[0].parameters]
    assert "gamma/delta" not in names


def test_equal_runs_do_not_differ_and_their_scatter_is_told(tmp_path):
    one = write_run(tmp_path / "first", (126.0, 0.1), scatter=(0.5, 1e-4))
    other = write_run(tmp_path / "second", (126.0, 0.1))
    said = differences(one, other)[0].statements
    assert said[0] == texts.NONE_DIFFERS
    assert texts.sessions_scatter({"A": ("0.5 rad/s", "0.0001")}) in said


def test_what_the_data_do_not_know_is_not_compared(tmp_path):
    one = write_run(tmp_path / "first", (126.0, 0.1))
    other = write_run(tmp_path / "second", (125.0, 0.1), kl=0.1)
    found = differences(one, other)[0]
    row = next(row for row in found.parameters if row.name == "omega_n")
    assert probability_text(row) == "prior"
    assert texts.of_prior({"omega_n": ["B"]}) in found.statements


def test_laws_and_units_must_agree_and_a_gain_of_another_source_is_left_out(tmp_path):
    one = write_run(tmp_path / "first", (126.0, 0.1))
    stop = {"cubic": np.ones(COUNT)}
    other = write_run(tmp_path / "law", (126.0, 0.1), laws="cubic", **stop)
    with pytest.raises(ConfigError, match=r"has bouc_wen and .* has cubic"):
        differences(one, other)
    volts = write_run(tmp_path / "volts", (126.0, 0.1), units=UNITS | {"alpha": "1/(V s^2)"})
    with pytest.raises(ConfigError, match="units of `alpha` must be the same"):
        differences(one, volts)
    gain = {"gain": np.ones(COUNT)}
    newtons = write_run(tmp_path / "n", (126.0, 0.1), units=UNITS | {"gain": "1/kg"}, **gain)
    driven = write_run(tmp_path / "v", (126.0, 0.1), units=UNITS | {"gain": "N/kg/V"}, **gain)
    names = [row.name for row in differences(newtons, driven)[0].parameters]
    assert names == ["omega_n", *LINEAR, "gamma/delta"]


def test_the_command_prints_both_tables_draws_and_answers_json(tmp_path, capsys):
    one = write_run(tmp_path / "first", (126.0, 0.1))
    other = write_run(tmp_path / "second", (125.0, 0.1))
    figure = tmp_path / "diff.svg"
    assert run(["diff", str(one), str(other), "--figure", str(figure)]) == 0
    told = capsys.readouterr().out
    assert "P(A > B)" in told
    assert "> 0.999" in told
    assert "frequency [Hz]" in told
    assert figure.stat().st_size > 10_000
    assert run(["diff", str(one), str(other), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["runs"]["B"]["campaign"] == "second"
    assert run(["diff", str(one), str(other), "--figure", "x.doc"]) == 2
    assert "must end in one of .png" in capsys.readouterr().err
    assert run(["diff", str(one), str(tmp_path / "none")]) == 2


def with_scattered_records(folder, scatter, count):
    """The run with what its records, each fitted by itself, scatter by in zeta."""
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as opened:
        tree = opened.load()
    tree["between_records"] = xr.DataTree(
        xr.Dataset(
            {"scatter": ("quantity", [scatter])},
            {"quantity": ["zeta"], "record": [f"impact {i}" for i in range(count)]},
        )
    )
    tree.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    return folder


def test_records_that_scatter_widen_what_a_run_says(tmp_path):
    """Of n records the mean is known to tau / sqrt(n), in both runs."""
    zeta = [gaussian(mean, 1e-5, seed=i) for i, mean in enumerate((0.0100, 0.0105))]
    runs = [
        write_run(tmp_path / name, (126.0, 0.1), zeta=x) for name, x in zip("ab", zeta, strict=True)
    ]
    told = differences(*runs)[0]
    (plain,) = [row for row in told.parameters if row.name == "zeta"]
    assert plain.probability == 0.0
    assert not [line for line in told.statements if line.startswith("Single records of a run")]
    for folder in runs:
        with_scattered_records(folder, 0.06, 9)
    told = differences(*runs)[0]
    (row,) = [row for row in told.parameters if row.name == "zeta"]
    std = np.sqrt(2e-10 + (0.06 / 3) ** 2 * (0.01**2 + 0.0105**2))
    # A million pairs of 1,000 random draws each: 5 % of a standard deviation.
    assert row.probability == pytest.approx(norm.cdf(-0.0005 / std), abs=0.02)
    low, _, high = row.difference
    assert high - low == pytest.approx(2 * 2.576 * std, rel=0.1)
    (line,) = [line for line in told.statements if line.startswith("Single records of a run")]
    assert "a zeta 2 %" in line.lower()


def adequacy(folder, status):
    path = folder / "summary.json"
    summary = json.loads(path.read_text())
    summary["verdict"]["answers"] = {"law": {"status": status}}
    path.write_text(json.dumps(summary))
    return folder


def test_a_sure_difference_under_a_law_that_leaves_more_than_noise_may_be_of_the_records(tmp_path):
    first = adequacy(write_run(tmp_path / "one", (118.0, 0.01)), "usable")
    second = adequacy(write_run(tmp_path / "other", (119.0, 0.01)), "ok")
    assert texts.inadequate(["A"]) in differences(first, second)[0].statements
    adequacy(first, "ok")
    assert texts.inadequate(["A"]) not in differences(first, second)[0].statements
