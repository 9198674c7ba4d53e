"""Drafts by what samples are: kinds, tones, bands of all decays together, names; and answers."""

import tomllib

import numpy as np
import pytest
from click.testing import CliRunner
from corpus.dialects import v73

from jbw.campaign.asked import answered, channels_named_by, still_doubtful
from jbw.campaign.content import course_of, falls
from jbw.campaign.draft import start_campaign
from jbw.campaign.files import repeats_of
from jbw.campaign.schema import parse
from jbw.cli import cli
from jbw.measurement.spectra import strongest_line

FS = 512.0
T = np.arange(8192) / FS
TONE = np.sin(2 * np.pi * 18.3 * T)
SWEEP = np.sin(2 * np.pi * (10.0 * T + 20.0 * T**2 / 32.0))
NOISE = np.random.default_rng(0).standard_normal(len(T))
DECAY = np.exp(-0.4 * T) * np.cos(2 * np.pi * 30.0 * T)
RNG = np.random.default_rng(1)


@pytest.mark.parametrize(
    ("samples", "course"),
    [
        (TONE, "tones"),
        (TONE + 5.0, "tones"),
        (SWEEP, "sweep"),
        (SWEEP[::-1], "sweep"),
        (np.where(T < 10.0, SWEEP, 0.0), "sweep"),
        (NOISE, "noise"),
        (np.zeros(8192), None),
        (TONE[:200], None),
        (TONE + np.sin(2 * np.pi * 47.0 * T), None),
    ],
)
def test_what_a_source_plays_is_told_by_its_parts(samples, course):
    assert course_of(samples) == course
    assert course_of(1e-6 * samples) == course


def test_only_a_decay_falls():
    assert falls(DECAY)
    assert falls(np.append(np.zeros(1000), DECAY))
    assert not any(falls(x) for x in (TONE, NOISE, SWEEP))


def test_the_strongest_line_is_found_between_the_lines():
    """A Hann window's parabola of logarithms is within two hundredths of a line."""
    for hz in (18.3, 18.317, 40.0):
        found = strongest_line(np.cos(2 * np.pi * hz * T + 0.4), FS)
        assert found == pytest.approx(hz, abs=0.02 * FS / len(T))


def written(folder, name, **channels):
    np.savez(folder / name, fs=FS, **channels)


def drafted(folder):
    text = start_campaign(folder).text
    return text, parse(text).tests


@pytest.mark.parametrize(
    ("source", "kind", "tones"),
    [(TONE, "tones", (18.3,)), (NOISE, "noise", ()), (SWEEP, "sweep", ())],
)
def test_a_driven_record_without_a_telling_name_is_of_the_kind_that_it_plays(
    tmp_path, source, kind, tones
):
    written(tmp_path, "run_1.npz", force=source, velocity=0.1 * source)
    text, (test,) = drafted(tmp_path)
    assert test.kind == kind
    assert test.tones == pytest.approx(tones, abs=1e-3)
    assert "kind = " in text
    assert "a guess" not in text


def test_a_velocity_that_falls_is_a_decay_and_one_that_does_not_is_asked_for(tmp_path):
    written(tmp_path, "run_1.npz", velocity=DECAY)
    assert "a guess" not in drafted(tmp_path)[0]
    written(tmp_path, "run_1.npz", velocity=TONE)
    assert 'kind = "decay"  # CHECK: a guess' in drafted(tmp_path)[0]


def test_a_loop_without_times_asks_for_none(tmp_path):
    y = 1e-3 * np.sin(2 * np.pi * T)
    np.savetxt(tmp_path / "specimen.csv", np.stack([y, 1e6 * y], 1), delimiter=",",
               header="displacement,restoring_force", comments="")  # fmt: skip
    text, (test,) = drafted(tmp_path)
    assert test.kind == "loop"
    assert "# fs" not in text
    assert "SI assumed, not in the file, for displacement, restoring_force" in text


def test_tests_are_named_by_their_files_where_there_are_several(tmp_path):
    for name in ("low_sweep_1", "low_sweep_2", "high sweep-1"):
        written(tmp_path, f"{name}.npz", force=SWEEP, velocity=SWEEP)
    assert [test.name for test in drafted(tmp_path)[1]] == ["high sweep", "low_sweep"]
    for path in tmp_path.glob("low*"):
        path.unlink()
    assert "name" not in tomllib.loads(drafted(tmp_path)[0])["test"][0]


def test_all_decays_are_banded_about_the_line_that_each_of_them_shows(tmp_path):
    """One blow moves a suspension of 4 Hz three times as far as the joint of 30 Hz."""
    noise = [1e-3 * RNG.standard_normal(len(T)) for _ in range(3)]
    rocking = 3.0 * np.exp(-0.4 * T) * np.cos(2 * np.pi * 4.0 * T)
    written(tmp_path, "hammer_1.npz", displacement=DECAY + rocking + noise[0])
    alone = drafted(tmp_path)[1][0].band
    assert alone[0] < 4.0 < alone[1]
    written(tmp_path, "tap_1.npz", displacement=DECAY + noise[1])
    written(tmp_path, "pluck_1.npz", displacement=0.3 * DECAY + noise[2])
    text, tests = drafted(tmp_path)
    assert all(test.band[0] < 30.0 < test.band[1] for test in tests)
    assert all(test.band[0] > 10.0 for test in tests)
    assert text.count("around the spectral line that every decay shows") == 3


def test_few_points_are_banded_about_their_only_line(tmp_path):
    """Four periods of 0.004 Hz in 34 readings of a chart, beside a mean 25 times as large."""
    rng = np.random.default_rng(6)
    t = np.unique(rng.uniform(0, 1014, 34).round())
    x = 54 + 2.2 * np.exp(-t / 2900) * np.cos(t / 40.0)
    np.savetxt(tmp_path / "decay_1.csv", np.stack([t, x.round(2)], 1), delimiter=",",
               header="time [s],displacement", comments="")  # fmt: skip
    low, high = drafted(tmp_path)[1][0].band
    assert low < 1 / (2 * np.pi * 40.0) < high


DRAFT = """[campaign]
name = "a"
[[test]]
kind = "decay"  # CHECK: a guess
files = "a.csv"  # 1 file(s), each of which is one repeat
channels = { time = "t", velocity = "v" }
units = { time = "s", velocity = "m/s" }  # CHECK: SI assumed, not in the file, for time, velocity
# fs = 1024.0  # CHECK: sampling frequency [Hz], not in the file
band = [5.0, 9.0]  # CHECK: around the strongest spectral line; no other mode may lie in it
"""


def scripted(*answers):
    """A person who gives these answers and leaves."""
    left, heard = list(answers), []

    def ask(question):
        heard.append(question)
        if not left:
            raise EOFError
        return left.pop(0)

    return ask, heard


def test_answers_take_the_place_of_values_and_none_keeps_them():
    ask, heard = scripted("", "", "mm/s", "2048", "6 8.5")
    text = answered(DRAFT, ask, pytest.fail)
    (test,) = parse(text).tests
    assert (test.kind, test.units["velocity"], test.fs) == ("decay", "mm/s", 2048.0)
    assert test.band == (6.0, 8.5)
    assert 'units = { time = "s", velocity = "mm/s" }' in text
    assert [line.partition(": ")[2].split(" = ")[0] for line in still_doubtful(text)] == [
        "kind", "units",
    ]  # fmt: skip
    assert heard[2] == '"a.csv": unit of velocity [m/s]: '
    assert "leave it out" in heard[3]


def test_what_a_campaign_cannot_take_is_said_and_the_draft_keeps_its_value():
    told = []
    ask, _ = scripted("earthquake", "", "furlong", "-3", "9 5")
    assert answered(DRAFT, ask, told.append) == DRAFT
    assert len(told) == 4
    assert all("Kept: " in line for line in told)
    assert "'earthquake' is unknown" in told[0]


def test_from_where_nobody_answers_the_draft_is_as_it_was():
    ask, heard = scripted("sweep")
    text = answered(DRAFT.replace('velocity = "v"', 'velocity = "v", force = "f"'), ask, print)
    assert 'kind = "sweep"\n' in text
    assert len(heard) == 2
    assert (
        text.partition("files")[2]
        == DRAFT.replace('velocity = "v"', 'velocity = "v", force = "f"').partition("files")[2]
    )


def test_channels_with_names_that_say_nothing_are_asked_for_once(tmp_path):
    for name in ("first.csv", "second.csv"):
        np.savetxt(tmp_path / name, np.stack([T, NOISE, 0.1 * DECAY], 1), delimiter=",",
                   header="zeit,kanal7,kanal9", comments="")  # fmt: skip
    told = []
    ask, heard = scripted("kanal8", "kanal9", "velocity", "kanal7", "")
    text = start_campaign(tmp_path, channels_named_by(ask, told.append)).text
    assert told == ["`kanal8` is not one of the listed names. Did you mean `kanal9`?"]
    assert heard[0] == '"first.csv": which channel is the response: kanal7, kanal9? [none]: '
    assert heard[2:4] == [
        '"first.csv": which quantity does kanal9 measure: acceleration or velocity or '
        "displacement? [acceleration]: ",
        '"first.csv": which channel is the drive: kanal7? [none]: ',
    ]
    assert len(heard) == 5
    for test in parse(text).tests:
        assert test.kind == "noise"
        assert test.channels == {"time": "zeit", "velocity": "kanal9", "force": "kanal7"}
    assert text.count("SI assumed, not in the file, for time, velocity, force") == 2


def test_the_unit_at_the_end_of_a_name_tells_the_quantity(tmp_path):
    np.savez(tmp_path / "run_1.npz", fs=FS, drive_V=NOISE, resp_g=0.1 * DECAY)
    (test,) = parse(start_campaign(tmp_path).text).tests
    assert test.channels == {"input": "drive_V", "acceleration": "resp_g"}
    assert test.units == {"input": "V", "acceleration": "g"}


def test_a_with_a_place_is_an_acceleration(tmp_path):
    np.savez(tmp_path / "run_1.npz", fs=FS, F=NOISE, a_end=0.1 * DECAY)
    (test,) = parse(start_campaign(tmp_path).text).tests
    assert test.channels == {"force": "F", "acceleration": "a_end"}


def test_a_response_alone_is_drafted_by_its_samples_and_nobodys_answer_is_a_comment(tmp_path):
    np.savez(tmp_path / "run_1.npz", fs=FS, a=NOISE, b=0.1 * DECAY)
    ask, _ = scripted("b", "", "")
    (test,) = parse(start_campaign(tmp_path, channels_named_by(ask, pytest.fail)).text).tests
    assert (test.kind, test.channels) == ("decay", {"acceleration": "b"})
    ask, heard = scripted()
    text = start_campaign(tmp_path, channels_named_by(ask, pytest.fail)).text
    assert len(heard) == 1
    assert text == start_campaign(tmp_path).text


def test_the_command_asks_and_writes_once(tmp_path):
    written(tmp_path, "run_1.npz", velocity=DECAY)
    ask = ["init", "--ask", str(tmp_path)]
    found = CliRunner().invoke(cli, ask, input="mm/s\n\n")
    assert found.exit_code == 0, found.output
    (test,) = parse((tmp_path / "campaign.toml").read_text()).tests
    assert test.units == {"velocity": "mm/s"}
    again = CliRunner().invoke(cli, ask, input="")
    assert "exists already" in str(again.exception)
    assert "unit of velocity" not in again.output


HZ = np.linspace(15.0, 25.0, 201)
OMEGA, NATURAL = 2 * np.pi * HZ, 2 * np.pi * 20.0
RECEPTANCE = 0.5 / (NATURAL**2 - OMEGA**2 + 0.01j * NATURAL * OMEGA)
CURVES = {
    "displacement": ("m/N", RECEPTANCE),
    "velocity": ("m/s/N", 1j * OMEGA * RECEPTANCE),
    "acceleration": ("m/s^2/N", -(OMEGA**2) * RECEPTANCE),
}


@pytest.mark.parametrize("role", CURVES)
@pytest.mark.parametrize("frequency", ["f", "w"])
def test_a_complex_curve_without_a_name_is_told_by_its_phase(tmp_path, role, frequency):
    unit, curve = CURVES[role]
    np.savez(tmp_path / "one.npz", **{"H": curve, frequency: HZ if frequency == "f" else OMEGA})
    draft = start_campaign(tmp_path)
    (test,) = parse(draft.text).tests
    assert (test.kind, test.channels) == ("frf", {"frequency": frequency, role: "H"})
    assert test.units == {"frequency": "Hz" if frequency == "f" else "rad/s", role: unit}
    assert f"CHECK: frequency, {role} are guesses" in draft.text


def test_a_complex_array_of_matlab_is_a_curve(tmp_path):
    """Of v7.3: compounds of real and imag, beside a string object and an empty cell."""

    def build(file, put):
        z = np.zeros((201, 1), dtype=[("real", "<f8"), ("imag", "<f8")])
        z["real"][:, 0], z["imag"][:, 0] = CURVES["velocity"][1].real, CURVES["velocity"][1].imag
        put("H", z, "double")
        put("f", HZ[:, None], "double")
        put("title", np.array([[3707764736], [2], [1], [1], [1], [1]], np.uint32), "string")
        empty = file.create_dataset("notes", data=np.array([0, 0], np.uint64))
        empty.attrs["MATLAB_class"], empty.attrs["MATLAB_empty"] = np.bytes_("cell"), np.uint8(1)

    v73(tmp_path / "curve.mat", build)
    (test,) = parse(start_campaign(tmp_path).text).tests
    assert test.channels == {"frequency": "f", "velocity": "H"}
    (record,) = repeats_of(test, tmp_path)
    np.testing.assert_allclose(record.channels["velocity"], np.abs(CURVES["velocity"][1]))
    np.testing.assert_allclose(record.channels["phase"], np.angle(CURVES["velocity"][1]))


def test_a_named_complex_curve_without_a_unit_is_per_newton(tmp_path):
    np.savez(tmp_path / "one.npz", receptance=RECEPTANCE, Frequency_Hz=HZ)
    (test,) = parse(start_campaign(tmp_path).text).tests
    assert test.units == {"frequency": "Hz", "displacement": "m/N"}


def test_a_complex_response_beside_its_force_is_an_amplitude(tmp_path):
    np.savez(tmp_path / "one.npz", velocity=3.0 * CURVES["velocity"][1], f=HZ, force=[3.0] * 201)
    (test,) = parse(start_campaign(tmp_path).text).tests
    assert test.units == {"frequency": "Hz", "force": "N", "velocity": "m/s"}


def test_of_two_complex_curves_a_person_is_asked(tmp_path):
    np.savez(tmp_path / "one.npz", H1=RECEPTANCE, H2=RECEPTANCE, f=HZ)
    draft = start_campaign(tmp_path)
    assert "test" not in tomllib.loads(draft.text)
    assert '# CHECK: name the channels of "one.npz" by hand, from "H1", "H2", "f".' in draft.text
