"""`jbw watch` as a user has it: references, louder hits, loose bolts, crashes and wrong files."""

import html
import json

import h5py
import numpy as np
import pytest
import xarray as xr

from jbw.cli import run
from jbw.report.messages import watch
from jbw.watch.detection import power
from jbw.watch.statement import Trend

FS, SECONDS, F_HZ = 512.0, 8.0, 20.3
NUM = 20  # references
SCATTER_F, SCATTER_ZETA = 4e-5, 0.007  # of a record, relative: the bolted double beam's
CAMPAIGN = """
[campaign]
name = "hammered"
[[test]]
kind = "decay"
name = "impacts"
files = "hit_*.h5"
channels = { velocity = "velocity" }
units = { velocity = "m/s" }
fs = 512.0
band = [14.0, 26.0]
settle = 0.25
"""


def decay(size, rng, zeta=1.0, f=1.0, seconds=SECONDS):
    """A joint whose damping goes with a power of its amplitude, integrated by small steps.

    d ln A / dt = -zeta(A) omega, zeta(A) = 0.001 + 0.004 A^0.6, omega(A) = omega (1 - 0.02 A^0.6).
    """
    f, zeta = (
        f * (1 + SCATTER_F * rng.standard_normal()),
        zeta * (1 + SCATTER_ZETA * rng.standard_normal()),
    )
    steps = 8
    log, phase = np.log(size), rng.uniform(0, 6)
    records = []
    for _ in range(round(FS * seconds)):
        records.append(np.exp(log) * np.cos(phase))
        for _ in range(steps):
            power_of = np.exp(0.6 * log)
            omega = 2 * np.pi * F_HZ * f * (1 - 0.02 * power_of)
            log -= zeta * (0.001 + 0.004 * power_of) * omega / (steps * FS)
            phase += omega / (steps * FS)
    return np.array(records) + 1e-4 * rng.standard_normal(len(records))


def write_hit(path, velocity):
    with h5py.File(path, "w") as file:
        file["velocity"] = velocity
    return path


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A campaign of hits of several sizes, and further hits of the same and of other joints."""
    folder = tmp_path_factory.mktemp("hammered")
    rng = np.random.default_rng(7)
    for i in range(NUM):
        write_hit(folder / f"hit_{i}.h5", decay(rng.uniform(0.6, 1.2), rng))
    more = {
        "same": decay(0.8, rng), "louder": decay(3.0, rng, seconds=11.0),
        "softer": decay(0.05, rng),
        "loose": decay(0.9, rng, zeta=1.08, f=1 - 2e-4), "tight": decay(0.9, rng, f=1 + 1e-3),
    }  # fmt: skip
    for name, velocity in more.items():
        write_hit(folder / f"{name}.h5", velocity)
    (folder / "campaign.toml").write_text(CAMPAIGN)
    return folder


@pytest.fixture
def watched(campaign, tmp_path):
    """The folder of a run of it; of a run a watch needs no more than that it is finished."""
    folder = tmp_path / "run"
    folder.mkdir()
    posterior = xr.Dataset({"omega_n": (("chain", "draw"), [[1.0, 2.0]])})
    tree = xr.DataTree.from_dict({"/posterior": posterior})
    tree.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    record = {"campaign": "hammered", "campaign_file": str(campaign / "campaign.toml")}
    (folder / "summary.json").write_text(json.dumps(record))
    return folder


@pytest.fixture
def call(watched, campaign, capsys):
    def called(*names, options=()):
        files = [word for name in names for word in ("--add", str(campaign / f"{name}.h5"))]
        code = run(["watch", str(watched), *files, *options, "--json"])
        streams = capsys.readouterr()
        return code, json.loads(streams.out), " ".join(streams.err.split())

    return called


def lines(folder):
    return [json.loads(line) for line in (folder / "watch.jsonl").read_text().splitlines()]


def test_a_watch_from_the_references_to_a_loose_bolt(call, watched):
    code, answer, _ = call()
    assert (code, answer["count"]) == (0, NUM)
    assert [line["role"] for line in lines(watched)[1:]] == ["reference"] * NUM
    code, answer, _ = call("same", "louder")
    assert code == 0
    assert [line["alarm"] for line in answer["added"]] == ["", ""]
    code, answer, _ = call("loose")
    assert code == 6
    (loose,) = answer["added"]
    assert loose["alarm"]
    # 8 % of damping is 11 sd and 2e-4 of frequency 5 sd: such a change is hardly ever missed.
    assert power(1e-3, 2, NUM, np.hypot(11, 5)) > 0.999
    assert loose["change"]["direction"] == "looser"
    middle, low, high = loose["change"]["damping"]
    assert low < 0.08 < high
    assert middle == pytest.approx(0.08, abs=4 * 0.01)
    assert loose["alarm"].startswith("reading")
    assert (watched / "watch.png").stat().st_size > 10_000
    page = (watched / "watch.html").read_text(encoding="utf-8")
    assert f"1 of {NUM + 3} records" in page
    assert html.escape(loose["statement"], quote=False) in html.unescape(page)
    assert lines(watched)[-1]["statement"] == loose["statement"]


def test_an_alarm_is_stated_as_a_torque_where_a_fleet_is_known(call, tmp_path, monkeypatch):
    fleet = tmp_path / "fleet.nc"
    fleet.touch()
    # 8 % more damping is 0.077 of its logarithm, and 2e-4 of the frequency 4 mHz.
    slopes = np.tile([4e-3 / 0.3, -0.077 / 0.3], (10, 1))
    monkeypatch.setattr("jbw.population.fleet.read_fleet", lambda path: path)
    monkeypatch.setattr(
        "jbw.watch.readings.trend_of",
        lambda units, torque, amplitudes, test, report: Trend(8.0, slopes, 4.0, 12.0),
    )
    code, answer, _ = call("loose", options=("--population", str(fleet)))
    assert code == 6
    (loose,) = answer["added"]
    like = loose["change"]["torque"]
    assert like["low"] < 8.0 * np.exp(-0.3) < like["high"]
    assert like["explained"]
    after = like["after"], like["low"], like["high"]
    assert (
        watch.torque_change(8.0, after, within_fleet=like["inside"], is_explained=True)
        in (loose["statement"])
    )


def test_a_tighter_joint_is_told_apart(call):
    code, answer, _ = call("tight")
    assert code == 6
    assert answer["added"][0]["change"]["direction"] == "tighter, or another temperature"


def test_a_record_below_the_amplitude_is_refused_and_noted(call, watched):
    code, answer, stderr = call("softer")
    assert code == 3
    assert answer["added"][0]["kind"] == "refused"
    assert "m/s, but not at" in stderr
    assert lines(watched)[-1]["reason"] == answer["added"][0]["reason"]
    code, answer, _ = call("same")
    assert (code, answer["added"][0]["number"]) == (0, NUM + 1)


def test_a_record_counts_once(call, watched):
    call("same")
    before = (watched / "watch.jsonl").read_bytes()
    code, _, stderr = call("same")
    assert code == 0
    assert f"as number {NUM + 1}" in stderr
    assert (watched / "watch.jsonl").read_bytes() == before


def test_a_watch_cut_by_a_crash_goes_on_as_if_nothing_had_happened(call, watched):
    call("same")
    uninterrupted = lines(watched)
    log = watched / "watch.jsonl"
    content = log.read_bytes().splitlines(keepends=True)
    # Within the references, and within the record that was added.
    for cut in (7, len(content) - 1):
        log.write_bytes(b"".join(content[:cut]) + content[cut][:50])
        code, _, stderr = call("same")
        assert code == 0
        assert watch.torn_line(str(log), 50, str(watched / "watch.torn")) in stderr
        resumed = lines(watched)
        drop = [{k: v for k, v in line.items() if k != "when"} for line in resumed]
        assert drop == [{k: v for k, v in line.items() if k != "when"} for line in uninterrupted]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--false-alarms", "0.01"), "`--false-alarms` is 0.01, but the watch began with 0.001"),
        (("--amplitude", "0.3"), "`--amplitude` is (0.3,), but the watch began with"),
        (("--reference", "5"), "`--reference` is 5, but the watch began with 20"),
    ],
)
def test_a_watch_keeps_what_it_began_with(call, options, message):
    call()
    code, _, stderr = call(options=options)
    assert code == 2
    assert message in stderr


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (("--false-alarms", "0.7"), 2, "`--false-alarms` must lie between 0 and 0.5, but is 0.7"),
        (("--amplitude", "0.3,0.3"), 2, "must be different positive numbers"),
        (("--reference", "3"), 2, "`--reference` must be at least 4 for 1 amplitudes, but is 3"),
        (("--test", "noise"), 2, "`--test` must name a test of free decays, but is 'noise'"),
    ],
)
def test_a_watch_that_cannot_begin_says_why_and_leaves_nothing(
    call, watched, options, code, message
):
    found, _, said = call(options=options)
    assert found == code
    assert message in said
    assert not (watched / "watch.jsonl").exists()


def test_two_amplitudes_are_read_and_the_reference_may_be_shorter(call, watched):
    code, _, stderr = call(options=("--amplitude", "0.3,0.2", "--reference", "10"))
    assert code == 0
    settings, *readings = lines(watched)
    assert settings["names"][2] == "f(0.2 m/s) - f(0.3 m/s) [Hz]"
    assert [len(reading["values"]) for reading in readings] == [4] * NUM
    assert [reading["role"] for reading in readings] == ["reference"] * 10 + ["watched"] * 10
    assert not any(reading.get("alarm") for reading in readings)
    assert watch.several_amplitudes(20) in stderr


def test_a_file_that_cannot_be_read_is_noted(call, campaign, watched):
    (campaign / "broken.h5").write_bytes(b"no HDF5")
    code, answer, _ = call("broken", "same")
    (campaign / "broken.h5").unlink()
    assert code == 3
    assert [line["kind"] for line in answer["added"]] == ["refused", "reading"]
    assert lines(watched)[-2]["record"] == "broken.h5"


def test_a_run_without_decays_is_refused(call, watched, tmp_path):
    text = CAMPAIGN.replace('kind = "decay"', 'kind = "noise"').replace(
        'velocity = "velocity"', 'velocity = "velocity", input = "velocity"'
    )
    path = tmp_path / "noise.toml"
    path.write_text(text.replace('velocity = "m/s"', 'velocity = "m/s", input = "V"'))
    code, _, stderr = call(options=("--campaign", str(path)))
    assert code == 3
    assert "has no free decays" in stderr
