"""A law, a kind of test, a sampler and a finding from outside, each through a whole campaign.

The truth is integrated by the few lines below, which share nothing with jbw.
"""

import json

import numpy as np
import pytest
import xarray as xr
from exported import rows as table
from guests import BENCH_STOP, STOP, AboutTheFit, Bilinear, RingDown, motion_before_the_stop
from scipy.io import loadmat

import jbw
from jbw.campaign.settings import Identify
from jbw.cli import run
from jbw.errors import ConfigError
from jbw.export.files import write_export
from jbw.export.one_joint import export
from jbw.identification import checks
from jbw.inference.posterior.finding import answers, checked
from jbw.inference.samplers import register as samplers
from jbw.measurement import kinds
from jbw.observables import register as observables
from jbw.oscillator.laws import LAWS, register
from jbw.report.charts import charts_of
from jbw.report.messages import findings
from jbw.study.store import claim, save_result
from jbw.study.study import load_study

FS, SIZE, GAIN = 256.0, 512, 15.0
# Of a velocity of 0.2 m/s rms. A law that says its move alone yields between the ends of a time
# step, which moves zeta by 1 % at eight steps a sample: an sd at this noise.
NOISE = 0.02
OMEGA_N, ZETA, STIFFNESS, YIELD = 118.0, 0.01, 3000.0, 1e-3
TRUTH = {"omega_n": OMEGA_N, "zeta": ZETA, "bilinear_k": STIFFNESS, "bilinear_yield": YIELD}
SWEEPS = "".join(
    f"""
[[test]]
kind = "sweep"
name = "{name}"
files = "{name}_*.csv"
level = {level}
channels = {{ input = "u", velocity = "v" }}
units = {{ input = "V", velocity = "m/s" }}
fs = {FS}
"""
    for name, level in (("weak", 0.3), ("strong", 1.0))
)
SETTINGS = """
[identify]
fit_levels = [1.0]
fit_repeats = 2
hold_out = ["weak"]
sampler = "importance"
num_chains = 2
num_samples = 100
substeps = 8
offsets = "none"
model_error = "none"
"""


def swept(level):
    """Voltage that rises and falls on 14 to 24 Hz, at rest for the last fifth."""
    span = SIZE / FS

    def u(t):
        envelope = np.sin(np.pi * np.clip(t / (0.8 * span), 0, 1)) ** 2
        return level * envelope * np.sin(2 * np.pi * (14 * t + 5 / span * t**2))

    return u


def velocity_under(u, steps=64):
    """Velocity from rest by leapfrog: the spring that yields is exact along every move."""
    h = 1 / (steps * FS)
    drive = (GAIN * u(np.arange(steps * SIZE) * h)).tolist()
    k, damping = OMEGA_N**2 - STIFFNESS, ZETA * OMEGA_N * h
    y = v = s = 0.0
    found = []
    for i, f in enumerate(drive):
        a = f - k * y - s
        if i % steps == 0:
            found.append(v + 0.5 * h * (a - 2 * ZETA * OMEGA_N * v))
        v = ((1 - damping) * v + h * a) / (1 + damping)  # from half a step before to half after
        y += h * v
        s = min(max(s + STIFFNESS * h * v, -STIFFNESS * YIELD), STIFFNESS * YIELD)
    return np.array(found)


def write_sweeps(folder, laws, settings=SETTINGS):
    rng = np.random.default_rng(3)
    for name, level in (("weak", 0.3), ("strong", 1.0)):
        u = swept(level)
        given, velocity = u(np.arange(SIZE) / FS), velocity_under(u)
        for i in range(3):
            noisy = velocity + NOISE * rng.standard_normal(SIZE)
            file = folder / f"{name}_{i}.csv"
            np.savetxt(file, np.c_[given, noisy], delimiter=",", header="u,v", comments="")
    path = folder / "campaign.toml"
    head = f'[campaign]\nname = "guests"\ngain = {GAIN}\n[joint]\nlaws = {json.dumps(laws)}\n'
    path.write_text(head + SWEEPS + settings, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def bilinear():
    """The law registered, and forgotten again."""
    yield register(Bilinear)
    del LAWS["bilinear"]


@pytest.fixture(scope="module")
def bench_stop():
    """The finding registered, and forgotten again."""
    findings.register(BENCH_STOP)
    checks.register("the stop of the bench", motion_before_the_stop)
    yield BENCH_STOP.code
    del findings.FINDINGS[BENCH_STOP.code], checks.FURTHER["the stop of the bench"]


@pytest.fixture(scope="module")
def of_a_law(bilinear, bench_stop, tmp_path_factory):
    """A finished run of a campaign of that law, with the finding of the bench."""
    folder = tmp_path_factory.mktemp("bilinear")
    campaign = jbw.load_campaign(write_sweeps(folder, [bilinear.name]))
    study = jbw.identify(campaign, seed=1, truth=TRUTH, report=lambda _: None)
    save_result(claim(folder / "run"), study.tree, study.record)  # what an export reads
    return study, folder / "run"


@pytest.mark.slow
def test_the_truth_of_another_integrator_lies_in_the_posterior(of_a_law):
    study, _ = of_a_law
    posterior = study.tree["posterior"].to_dataset()
    for name, value in TRUTH.items():
        z = (posterior[name].mean() - value) / posterior[name].std()
        assert abs(z) < 4, name
        assert posterior[name].std() < 0.05 * value
        assert posterior[name].attrs["truth"] == value
    assert study.tree.attrs["khat"] < 0.7
    held_out = study.tree["verification/sweep/weak"].attrs
    assert not held_out["fitted"]
    assert held_out["coverage"] > 0.97
    assert held_out["nrmse"] < 0.7 * held_out["nrmse_linear"]


@pytest.mark.slow
def test_a_finding_from_outside_is_judged_and_explained(of_a_law, bench_stop, capsys):
    study, _ = of_a_law
    verdict = study.summary()["verdict"]
    (finding,) = (row for row in verdict["findings"] if row["code"] == bench_stop)
    assert (finding["status"], finding["number"] < STOP) == ("ok", True)
    assert run(["explain", bench_stop]) == 0
    assert "drive the joint less" in capsys.readouterr().out


def test_a_finding_from_outside_answers_its_question(bench_stop):
    failed = checked(bench_stop, False, {"y_peak": 2.5e-2, "stop": STOP}, 2.5e-2, {"stop": STOP})
    ((question, answer),) = answers([failed])
    assert (question, answer.status) == ("law", "failed")
    assert answer.because == "The joint moves by 0.025 m; the stop of the bench stands at 0.02 m."
    assert failed.action == "Drive the joint less: it may move by 0.02 m."
    with pytest.raises(ConfigError, match="`r_hat` is a finding of jbw"):
        findings.register(BENCH_STOP._replace(code="r_hat"))


@pytest.mark.slow
def test_the_run_is_exported(of_a_law, tmp_path):
    _, folder = of_a_law
    assert run(["export", str(folder), "--out", str(tmp_path / "out")]) == 0
    found = {path.name for path in (tmp_path / "out").iterdir()}
    assert found == {"parameters.csv", "backbone.csv", "loop.csv", "jbw.mat", "joint.tcl"}


def test_a_law_is_exported_in_every_format(bilinear, tmp_path):
    shape = (("chain", "draw"), np.ones((2, 50)))
    posterior = xr.Dataset({name: (shape[0], value * shape[1]) for name, value in TRUTH.items()})
    root = xr.Dataset(attrs={"y_peak": 4e-3, "laws": json.dumps([bilinear.name])})
    tree = xr.DataTree.from_dict({"/": root, "posterior": posterior})
    write_export(tmp_path, export(tree, 2.0, draw=0))
    rows = {row["parameter"]: float(row["value"]) for row in table(tmp_path / "parameters.csv")}
    assert rows == pytest.approx({**TRUTH, "E": 2.0 * STIFFNESS, "epsyP": YIELD})
    curve = table(tmp_path / "backbone.csv")
    y = np.array([float(row["amplitude_m"]) for row in curve])
    found = np.array([float(row["frequency_hz_q500"]) for row in curve])
    np.testing.assert_allclose(found, ringing(y), rtol=1e-4)
    stored = loadmat(tmp_path / "jbw.mat")["draws"]["bilinear_yield"][0, 0]
    assert np.all(stored == YIELD)
    assert "ElasticPP 3 6000 0.001" in (tmp_path / "joint.tcl").read_text(encoding="utf-8")


RINGS = "".join(
    f"""
[[test]]
kind = "ring_down"
name = "{name}"
files = "{name}_*.csv"
channels = {{ displacement = "y", frequency = "f" }}
units = {{ displacement = "mm", frequency = "Hz" }}
"""
    for name in ("first", "second")
)
PULL = f"""
[[test]]
kind = "loop"
name = "pull"
files = "pull_*.csv"
level = 0.004
channels = {{ displacement = "y", restoring_force = "f" }}
units = {{ displacement = "m", restoring_force = "N" }}
fs = {FS}
"""
OF_RINGS = """
[identify]
hold_out = ["second"]
sampler = "about_the_fit"
num_chains = 2
num_samples = 1000
offsets = "none"
model_error = "none"
"""


def ringing(y):
    """Frequency [Hz] against amplitude, with Caughey's equivalent stiffness of such a spring."""
    angle = np.arccos(1 - 2 * YIELD / np.maximum(y, YIELD))
    part = (angle - np.sin(2 * angle) / 2) / np.pi
    return np.sqrt(OMEGA_N**2 - STIFFNESS * (1 - part)) / (2 * np.pi)


def pulled(y):
    """Force [N/kg] along a displacement that starts at rest."""
    s, found = 0.0, [0.0]
    for dy in np.diff(y):
        s = min(max(s + STIFFNESS * dy, -STIFFNESS * YIELD), STIFFNESS * YIELD)
        found.append(s)
    return (OMEGA_N**2 - STIFFNESS) * y + np.array(found)


def write_rings(folder):
    rng = np.random.default_rng(4)
    t = np.arange(SIZE) / FS
    y = 4e-3 * t * FS / SIZE * np.sin(2 * np.pi * t)
    amplitude = {"first": np.geomspace(5e-4, 4e-3, 12), "second": np.linspace(6e-4, 3e-3, 9)}
    for i in range(3):
        for name, of_ring in amplitude.items():
            frequency = ringing(of_ring) + 0.02 * rng.standard_normal(len(of_ring))
            # Amplitudes differ in their sixth digit: the same samples twice are refused.
            columns = np.c_[1e3 * of_ring * (1 + 1e-6 * i), frequency]
            file = folder / f"{name}_{i}.csv"
            np.savetxt(file, columns, delimiter=",", header="y,f", comments="")
        force = pulled(y) + 0.3 * rng.standard_normal(SIZE)
        file = folder / f"pull_{i}.csv"
        np.savetxt(file, np.c_[y, force], delimiter=",", header="y,f", comments="", fmt="%.12g")
    path = folder / "campaign.toml"
    head = '[campaign]\nname = "rings"\nmodal_mass = 1.0\n[joint]\nlaws = ["bilinear"]\n'
    path.write_text(head + RINGS + PULL + OF_RINGS, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def of_a_kind(bilinear, tmp_path_factory):
    """A finished run of a campaign with tests of a kind and a sampler of the tests' own."""
    needed = ("displacement", "frequency")
    kinds.register(kinds.Kind("ring_down", "frequencies of a ring-down", channels=needed))
    observables.register(RingDown)
    samplers.register(samplers.Sampler("about_the_fit", AboutTheFit, needs_fit=True))
    folder = tmp_path_factory.mktemp("rings")
    path = write_rings(folder)
    study = jbw.identify(jbw.load_campaign(path), seed=1, report=lambda _: None)
    study.save(folder / "run", figures=["png"])
    yield study, folder / "run"
    del kinds.KINDS["ring_down"], samplers.SAMPLERS["about_the_fit"]
    observables.OBSERVABLES.remove(RingDown)


def test_tests_of_a_further_kind_are_identified_by_a_further_sampler(of_a_kind):
    study, _ = of_a_kind
    assert study.tree.attrs["sampler"] == "about_the_fit"
    posterior = study.tree["posterior"].to_dataset()
    for name in ("omega_n", "bilinear_k", "bilinear_yield"):
        z = (posterior[name].mean() - TRUTH[name]) / posterior[name].std()
        assert abs(z) < 4, name
        assert posterior[name].std() < 0.02 * TRUTH[name]
    assert Identify.of({"sampler": "about_the_fit"}).sampler == "about_the_fit"


def test_they_are_verified_by_their_own_observable(of_a_kind):
    study, folder = of_a_kind
    for name, size, fitted in (("first", 12, 1), ("second", 9, 0)):
        found = study.tree[f"verification/ring_down/{name}"].to_dataset()
        assert found.attrs["fitted"] == fitted
        assert found.attrs["axis"] == "displacement"
        assert found["displacement"].attrs["units"] == "m"
        assert found["measured"].attrs["units"] == "Hz"
        rows = [np.loadtxt(folder.parent / f"{name}_{i}.csv", delimiter=",", skiprows=1)
                for i in range(3)]  # fmt: skip
        np.testing.assert_allclose(found["measured"], np.mean(rows, axis=0)[:, 1])
        np.testing.assert_allclose(found["model_band"][1], ringing(rows[0][:, 0] / 1e3), rtol=2e-3)
        assert found.attrs["num_values"] == size
        assert found.attrs["coverage"] > 0.85
        assert found.attrs["nrmse"] < 0.5 * found.attrs["nrmse_linear"]
        told = study.record["predictions"][name]
        assert told["kind"] == "ring_down"
        assert told["nrmse"] == found.attrs["nrmse"]
    # 0.02 Hz of noise, of the mean of three repeats.
    half = np.diff(found["predictive_band"].values[1:], axis=0)
    assert np.median(half) == pytest.approx(2.576 * 0.02 / np.sqrt(3), rel=0.4)
    again = study.predict("second")
    np.testing.assert_allclose(again["predictive_band"], found["predictive_band"], rtol=1e-4)
    headings = {chart.heading for chart in charts_of(study.tree)}
    assert {"Ring down first", "Ring down second"} <= headings


def test_they_are_reported_in_the_words_of_their_law(of_a_kind):
    study, folder = of_a_kind
    rows = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["steps"]["joint"]
    assert rows["parameters"]["bilinear_k"]["unit"] == "1/s^2"
    page = (folder / "report.html").read_text(encoding="utf-8")
    for words in ("bilinear", "second", *(q.symbol for q in Bilinear.table)):
        assert words in page
    assert all(quantity.meaning in page for quantity in Bilinear.table)
    assert (folder / "figures" / "extra_groups.png").is_file()
    again = load_study(folder, study.campaign).predict("second", 20)
    np.testing.assert_allclose(again["model_band"], study.predict("second", 20)["model_band"])


def test_a_channel_that_a_further_kind_needs_is_asked_for(of_a_kind, tmp_path, capsys):
    path = tmp_path / "campaign.toml"
    path.write_text(RINGS.replace(', frequency = "f"', "").replace(', frequency = "Hz"', ""))
    assert run(["check", str(path)]) == 2
    assert "channels: kind `ring_down` needs `frequency`." in capsys.readouterr().err
