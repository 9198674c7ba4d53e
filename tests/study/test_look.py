"""What records show without a model: linear oscillators and joints integrated without jbw."""

import json

import numpy as np
import pytest
import xarray as xr
from made_runs import FS, JOINT, OMEGA_N, SILENT, SIZE, ZETA, a_test
from scipy.signal import lsim

from jbw.campaign.load import Campaign
from jbw.cli import run
from jbw.errors import DataError
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.readings.statement import RecordTable, laws_with, trend
from jbw.measurement.records import Record, Test
from jbw.measurement.resonances import Reading, driven_lines, read_curve, read_lines
from jbw.report.looking import look_figure
from jbw.report.messages import look as texts
from jbw.results.run import StoredLook, StoredReading
from jbw.study.identify import identify
from jbw.study.look import days, look, look_groups, nonlinear, statements

HERTZ = OMEGA_N / (2 * np.pi)


def linear(level, noise=0.0, **more):
    return a_test(level, SILENT, noise, **more)


def test_a_sweep_of_a_linear_oscillator_is_read_exactly():
    """Its transform has no error but the record's ends; 1e-6 is lsim's hold between samples."""
    read = read_lines(driven_lines(linear(0.3).records[0]))
    assert read.frequency_hz == pytest.approx(HERTZ, rel=1e-5)
    assert read.damping == pytest.approx(ZETA, rel=2e-3)
    assert read.left < 2e-3


def test_a_record_that_ends_in_motion_is_read_as_well():
    """Noise that does not stop: the two constants take the ends of the record."""
    rng = np.random.default_rng(0)
    fine = 16
    t = np.arange(8 * SIZE * fine) / (FS * fine)
    tones = rng.uniform(5.0, 60.0, 200), rng.uniform(0, 2 * np.pi, 200)
    u = sum(np.cos(2 * np.pi * f * t + phase) for f, phase in zip(*tones, strict=True))
    v = lsim(([1.0, 0.0], [1.0, 2 * ZETA * OMEGA_N, OMEGA_N**2]), u, t)[1]
    record = Record(FS, {"input": u[::fine], "velocity": v[::fine]}, {"velocity": "m/s"})
    read = read_lines(driven_lines(record))
    # Without the constants frequency and damping are off by 4e-4 and 3 %.
    assert read.frequency_hz == pytest.approx(HERTZ, rel=2e-5)
    assert read.damping == pytest.approx(ZETA, rel=2e-3)


@pytest.mark.parametrize("num_samples", [1, 2, 7, 20])
def test_a_record_of_few_samples_drives_too_few_lines(num_samples):
    noise = np.random.default_rng(0).normal(size=num_samples)
    with pytest.raises(DataError, match="drives fewer than 12 spectral lines"):
        driven_lines(Record(FS, {"input": noise, "displacement": noise}, {}))


def test_the_amplitude_of_a_steady_tone_is_its_own():
    t = np.arange(2560) / FS
    y = 3e-3 * np.cos(2 * np.pi * 18.5 * t)
    u = np.random.default_rng(1).standard_normal(len(t))
    u += 3 * np.cos(2 * np.pi * 18.5 * t)
    lines = driven_lines(Record(FS, {"input": u, "displacement": y}, {}), (15.0, 22.0))
    spectrum = np.zeros(len(t), complex)
    spectrum[lines.place] = 2 * lines.y
    size = np.abs(np.fft.ifft(spectrum))
    assert np.sum(size**3) / np.sum(size**2) == pytest.approx(3e-3, rel=1e-9)


def softened(u, c, fs):
    """Displacement under y'' + 2 zeta omega_n y' + omega_n^2 y - c y|y| = u, given at half steps.

    By Runge and Kutta, to 2e-6 of the frequency.
    """
    y, v, found, h = 0.0, 0.0, [], 1 / fs

    def rate(y, v, u):
        return u - 2 * ZETA * OMEGA_N * v - OMEGA_N**2 * y + c * y * abs(y)

    for first, middle, last in zip(u[:-2:2], u[1:-1:2], u[2::2], strict=True):
        found.append(y)
        v_2, a_1 = v + h / 2 * rate(y, v, first), rate(y, v, first)
        a_2 = rate(y + h / 2 * v, v_2, middle)
        v_3 = v + h / 2 * a_2
        a_3 = rate(y + h / 2 * v_2, v_3, middle)
        v_4 = v + h * a_3
        a_4 = rate(y + h * v_3, v_4, last)
        y += h / 6 * (v + 2 * v_2 + 2 * v_3 + v_4)
        v += h / 6 * (a_1 + 2 * a_2 + 2 * a_3 + a_4)
    return np.array(found)


@pytest.mark.parametrize("kind", ["noise", "sweep"])
def test_a_reading_lies_on_the_backbone_at_its_amplitude(kind):
    r"""Of a spring -c y|y| that is omega^2 = omega_n^2 - 8 c Y / (3 pi), by harmonic balance."""
    fs, seconds = 512.0, 128 if kind == "noise" else 32
    t = np.arange(2 * round(seconds * fs) + 1) / (2 * fs)
    if kind == "noise":
        u = np.random.default_rng(2).standard_normal(len(t))
    else:
        u = np.where(t < 16.0, np.sin(np.pi * 2.5 * t**2), 0.0)  # 0 to 40 Hz in 16 s
    linear = softened(u, 0.0, fs)
    c = 0.02 * OMEGA_N**2 / np.max(np.abs(linear))
    y = softened(u, c, fs)
    read = read_lines(driven_lines(Record(fs, {"input": u[:-1:2], "displacement": y}, {})))
    at = (OMEGA_N**2 - (2 * np.pi * read.frequency_hz) ** 2) * 3 * np.pi / (8 * c)
    # 6 and 8 % apart where amplitudes are weighed by their squares. A sweep is partly forced, so
    # that its weights are not its energy alone.
    assert read.y == pytest.approx(at, rel=0.03)
    if kind == "noise":  # Rayleigh's amplitudes, by chance and by the spring to 3 %
        assert read.y / np.sqrt(np.mean(y**2)) == pytest.approx(3 * np.sqrt(np.pi / 8), rel=0.03)


def test_a_response_curve_is_read_by_its_closed_form():
    omega = np.linspace(0.97, 1.03, 41) * OMEGA_N
    load = np.ones(41, complex)
    y = 2.0 / (OMEGA_N**2 - omega**2 + 2j * ZETA * OMEGA_N * omega)
    read = read_curve(omega, load, y)
    assert read.frequency_hz == pytest.approx(HERTZ, rel=1e-9)
    assert read.damping == pytest.approx(ZETA, rel=1e-8)
    with pytest.raises(DataError, match="6 frequencies"):
        read_curve(omega[:5], load[:5], y[:5])


@pytest.mark.slow
def test_a_linear_structure_is_called_linear_and_a_joint_is_not():
    """The joint's equivalent oscillator is the lower and the more damped, the more it moves."""
    levels = (0.1, 0.2, 0.4, 0.8, 1.2)
    for joint in (SILENT, JOINT):
        tests = tuple(
            a_test(level, joint, 1e-4, repeats=2, name=f"sweep {level}") for level in levels
        )
        found = look(Campaign("levels", None, tests))
        (said,) = [s for s in found.record.statements if s.startswith("Nonlinear: ")]
        assert said.startswith("Nonlinear: yes.") == (joint is JOINT)
        rows = found.record.tests
        assert [row.test for row in rows] == [test.name for test in tests]
        if joint is SILENT:
            assert "no change of the frequency is detected" in said
            assert rows[-1].left < 0.01
        else:
            frequencies = [row.frequency_hz for row in rows]
            assert frequencies == sorted(frequencies, reverse=True)
            assert rows[-1].left > 0.03  # several times what a linear structure leaves
        # 1e-4 m/s of noise over each record's rms, from two repeats: half of it is chance.
        rms = np.sqrt(np.mean(tests[0].records[0].channels["velocity"] ** 2))
        assert rows[0].noise == pytest.approx(1e-4 / rms, rel=0.1)


def a_table(y, hz, zeta, hz_sd=1e-4, zeta_sd=1e-6):
    """Readings of one record that know nothing of each other."""
    y = np.atleast_1d(np.asarray(y, float))
    hz, zeta = np.broadcast_to(hz, y.shape).astype(float), np.broadcast_to(zeta, y.shape) * 1.0
    return RecordTable(y, hz, zeta, np.eye(len(y)) * hz_sd**2, np.eye(len(y)) * zeta_sd**2)


def test_records_whose_errors_are_all_one_have_the_offsets_of_their_means():
    """A covariance of rank one, as of a frequency that is fitted to the whole record."""
    y, shifts = np.geomspace(1e-4, 1e-3, 4), (-1e-3, 0.0, 1e-3)
    whole = np.full((4, 4), 1e-6), np.full((4, 4), 1e-10)
    tables = [RecordTable(y, np.full(4, 20 * (1 + s)), np.full(4, 0.01), *whole) for s in shifts]
    offsets, sds = np.transpose(trend(tables, "hz").offsets)
    np.testing.assert_allclose(offsets, shifts, atol=1e-9)
    np.testing.assert_allclose(sds, 1e-3 / 20, rtol=1e-6)


def of_slip(top, *, factor=1.0, shift=0.0):
    """Readings of a decay of a slipping joint from an amplitude; its unit may be another one."""
    y = top * np.geomspace(1.0, 0.05, 4)
    hz = 100.0 * (1 + shift - 0.02 * (y / 1e-3) ** 0.6)
    zeta = 0.003 + 0.008 * (y / 1e-3) ** 0.6
    return RecordTable(factor * y, hz, zeta, np.eye(4) * 1e-6, np.eye(4) * 1e-10)


@pytest.mark.parametrize("wrong", [0, 1, 2])
@pytest.mark.parametrize("factor", [9.80665, 1 / 9.80665, 1e3, 0.0254])
def test_the_one_record_in_another_unit_is_named_with_its_factor(wrong, factor):
    tops = (1e-3, 0.8e-3, 0.9e-3)
    tables = [of_slip(top, factor=factor if i == wrong else 1.0) for i, top in enumerate(tops)]
    said = nonlinear(tables).sentences[0]
    assert said.startswith(f"Record {wrong + 1} of 3 has other frequencies")
    assert f"multiplied by {1 / factor:.6g}" in said


def test_records_that_differ_otherwise_are_not_called_of_another_unit():
    tops = (1e-3, 0.8e-3, 0.9e-3)
    for tables in (
        [of_slip(top, shift=0.003 * (i == 1)) for i, top in enumerate(tops)],  # tightened again
        [
            of_slip(top, factor=9.80665 if i else 1.0) for i, top in enumerate(tops[:2])
        ],  # which one?
        [of_slip(top, factor=3.0 if i == 1 else 1.0) for i, top in enumerate(tops)],  # of no unit
    ):
        sentences = nonlinear(tables).sentences
        assert sentences[0].startswith("Records differ at equal amplitude")


def test_a_frequency_that_rises_is_said_to_rise_and_few_readings_say_nothing():
    y = np.geomspace(1e-4, 1e-3, 12)
    rng = np.random.default_rng(0)
    rising = [
        a_table(y, 18.0 * (1 + 5.0 * y) + 1e-4 * rng.standard_normal(12), 0.01) for _ in range(3)
    ]
    found = nonlinear(rising)
    assert found.is_seen
    (said, *_) = found.sentences
    # 18 (1 + 5 y) rises by 5 (1e-3 - 1e-4) = 0.45 % of its value at rest, to the power 1.
    assert said.startswith(
        "Nonlinear: yes. From 0.1 to 1 mm (3 records) the frequency rises by 0.4"
    )
    assert "no change of the damping ratio is detected" in said
    (low, high) = trend(rising, "hz").exponent[1:]
    assert low <= 1.0 <= high
    # No law has it: a cubic spring changes the frequency by the square of the amplitude. It is
    # worth a fit.
    assert not any("Laws whose" in sentence for sentence in found.sentences)
    assert found.laws == ("cubic",)
    same = nonlinear([a_table([1e-3], 18.0, 0.01), a_table([1e-3], 18.0, 0.01)])
    assert not same.is_seen
    assert "not assessed" in same.sentences[-1]
    # One reading a record: 0.13 % of the frequency is an eighth of the half width, 1 %.
    few = [a_table([a], 18.0 * (1 + 5.0 * a), 0.01) for a in np.linspace(1e-4, 3.6e-4, 3)]
    assert not nonlinear(few).is_seen
    far = [one._replace(hz=18.0 * (1 + 50.0 * one.y)) for one in few]
    assert nonlinear(far).is_seen
    assert "yes, the joint hardens" in nonlinear(far).sentences[-1]
    low = [one._replace(zeta=one.zeta * (1 + i)) for i, one in enumerate(few)]
    assert nonlinear(low).is_seen


def test_records_that_relax_are_no_softening_joint():
    """Four linear records, each 0.1 % lower and stronger than the last: order, not amplitude."""
    rng = np.random.default_rng(3)
    y = np.geomspace(1e-5, 1e-3, 12)
    tables = [
        a_table(y * (1 + 0.2 * i), 20.0 * (1 - 1e-3 * i) + 1e-4 * rng.standard_normal(12), 0.005)
        for i in range(6)
    ]
    found = nonlinear(tables)
    assert not found.is_seen
    differ, nothing = found.sentences
    # Their standard deviation: 1e-3 sqrt(3.5).
    assert trend(tables, "hz").scatter == pytest.approx(1e-3 * np.sqrt(3.5), rel=0.1)
    assert "The difference grows from record to record" in differ
    assert nothing.startswith("Nonlinear: not detected.")


@pytest.mark.parametrize(
    ("p", "grows", "laws"),
    [(1.0, 1.0, ("bouc_wen",)), (0.5, 1.0, ("masing_power", "iwan4")), (2.0, 0.0, ("cubic",)),
     (4.0, 0.0, ("quintic",))],
)  # fmt: skip
def test_the_law_follows_from_the_power_of_the_amplitude(p, grows, laws):
    rng = np.random.default_rng(1)
    y = np.geomspace(2e-5, 1e-3, 12)
    r = (y / 1e-3) ** p
    tables = [
        a_table(y, 20.0 * (1 - 0.01 * r) + 1e-4 * rng.standard_normal(12),
                0.005 * (1 + grows * r) + 1e-6 * rng.standard_normal(12))
        for _ in range(3)
    ]  # fmt: skip
    hz = trend(tables, "hz")
    assert hz.exponent[1] <= p <= hz.exponent[2]
    assert laws_with(hz, trend(tables, "zeta")) == laws


def test_laws_of_a_near_power_are_fitted_but_not_said_to_have_it():
    """A frequency with the power 2.3: no law has it, and a cubic spring is nearest."""
    rng = np.random.default_rng(1)
    y = np.geomspace(2e-5, 1e-3, 12)
    hz = 20.0 * (1 - 0.01 * (y / 1e-3) ** 2.3)
    tables = [
        a_table(y, hz + 1e-4 * rng.standard_normal(12), 0.005 + 1e-6 * rng.standard_normal(12))
        for _ in range(3)
    ]
    assert laws_with(trend(tables, "hz"), trend(tables, "zeta")) == ()
    found = nonlinear(tables)
    assert found.laws == ("cubic",)
    assert not any("Laws whose" in sentence for sentence in found.sentences)


def test_a_decay_is_read_along_its_envelope():
    """y = exp(-zeta omega t) cos(omega_d t): one frequency and damping at every amplitude."""
    t = np.arange(12 * 256) / FS
    omega_d = OMEGA_N * np.sqrt(1 - ZETA**2)
    y = 1e-3 * np.exp(-ZETA * OMEGA_N * t) * np.cos(omega_d * t)
    test = Test("decay", (Record(FS, {"displacement": y}, {"displacement": "m"}),), "tap")
    found = look(Campaign("tap", None, (test,)))
    each = found.readings["tap"]
    assert len(each) > 5
    # The first readings: later ones lie where the filter's ripple of 80 dB is seen.
    for one in each[:5]:
        assert one.frequency_hz == pytest.approx(omega_d / (2 * np.pi), rel=1e-4)
        assert one.damping == pytest.approx(ZETA, rel=1e-2)


def test_what_cannot_be_read_is_said_once_and_stops_nothing():
    good = linear(0.3, name="good")
    gap = linear(0.3, name="gap")
    gap.records[0].channels["velocity"][5] = np.nan
    found = look(Campaign("two", None, (good, gap)))
    assert [row.test for row in found.record.tests] == ["good"]
    assert found.record.statements[-1] == (
        "Frequency and damping could not be determined in gap. A record has samples missing."
    )


def test_an_offset_that_drifts_is_not_taken_for_the_resonance():
    """Slow drift of source and accelerometer, whose displacement is huge: it is not swept."""
    plain = linear(0.3).records[0]
    t = np.arange(plain.num_samples) / FS
    drift = np.cos(2 * np.pi * t / t[-1])
    u = plain.channels["input"] + 0.02 * plain.channels["input"].std() * drift
    v = plain.channels["velocity"]
    drifting = v + 0.05 * np.abs(v).max() * drift
    read = read_lines(driven_lines(Record(FS, {"input": u, "velocity": drifting}, {})))
    assert read.frequency_hz == pytest.approx(HERTZ, rel=1e-4)
    assert read.damping == pytest.approx(ZETA, rel=0.02)


def test_what_no_oscillator_fits_is_no_reading():
    """Noise that has nothing to do with its source, beside a sound test."""
    good, alien = linear(0.3, name="good"), linear(0.3, name="alien")
    size = alien.records[0].num_samples
    noise = np.random.default_rng(0).standard_normal(size)
    alien.records[0].channels["velocity"][:] = noise
    found = look(Campaign("two", None, (good, alien)))
    assert [row.test for row in found.record.tests] == ["good"]
    assert "alien" in found.record.statements[-1]
    assert found.record.statements[-1].startswith(
        "Frequency and damping could not be determined in "
    )


def test_a_reading_holds_where_it_takes_energy_in_and_explains_the_response():
    assert Reading(1e-3, 20.0, 0.01, 0.4).holds
    assert Reading(1e-3, 20.0, 0.01).holds  # of a decay, that has been looked at already
    assert not Reading(1e-3, 20.0, -0.004, 0.1).holds
    assert not Reading(1e-3, 20.0, 0.01, 2.7).holds
    assert Reading(1e-3, 20.0, 0.01, 0.7, residual=1e-3).holds  # of a strongly nonlinear decay
    assert not Reading(1e-3, 20.0, 0.01, 0.7, residual=0.6).holds


def test_a_decay_that_is_far_from_linear_is_read():
    """Damping rises with the amplitude, a' = -k a^2, and the frequency falls by 15 %.

    A linear oscillator misses more than half of it, which is no reason to leave it out.
    """
    t, k, start = np.arange(0.0, 6.0, 1 / FS), 13.0, 0.5
    amplitude = start / (1 + start * k * t)
    periods = 20.0 * (t - 0.15 * np.log1p(start * k * t) / (start * k))
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(t))
    v = amplitude * np.cos(2 * np.pi * periods) + noise
    record = Record(FS, {"velocity": v}, {"velocity": "m/s"})
    decay = Test("decay", (record,), name="tap", band_hz=(10.0, 30.0))
    found = look(Campaign("far", None, (decay,))).record
    assert found.unread == {}
    (row,) = found.tests
    assert row.left > 0.5
    # The displacement a / omega decays faster than a, as omega rises.
    a = 2 * np.pi * row.frequency_hz * row.y
    rise = 0.15 * a / start
    expected = k * row.y * (1 + rise / (1 - rise))
    assert row.damping == pytest.approx(expected, rel=0.02)  # a fifth of its 99 % interval
    assert found.statements[0].startswith("Nonlinear: yes.")


def test_what_stands_beside_the_readings_stops_nothing_either(monkeypatch):
    """Coherence of a record that drives nothing, a loop held still: told, and the rest is read."""
    still = np.full(64, 1e-3)
    loop = Record(FS, {"displacement": still, "restoring_force": still}, {})
    held = Test("loop", (loop,), "held")

    def refuse(_):
        raise DataError("No coherence.")

    good, noise = linear(0.3, name="good"), linear(0.3, name="noise", kind="noise")
    monkeypatch.setattr("jbw.study.look._coherence", lambda test: test is noise and refuse(test))
    found = look(Campaign("three", None, (good, noise, held)))
    assert list(found.readings) == ["good"]
    assert found.record.loops == []
    assert found.record.unread == {
        "noise": "No coherence.",
        "held": "The displacement of test held is constant.",
    }


def test_an_identification_looks_before_it_samples(monkeypatch):
    """A look that fails must not cost a finished posterior: the procedure is never begun."""
    said = []

    def look_fails(campaign, report):
        said.append([test.name for test in campaign.tests])
        raise DataError("Nothing is seen.")

    monkeypatch.setattr("jbw.study.look.look", look_fails)
    monkeypatch.setattr("jbw.study.identify.fit_problem", lambda *_, **__: said.append("fitted"))
    good, left_out, told = linear(0.3, name="good"), linear(0.3, name="left out"), []
    monkeypatch.setattr(
        "jbw.study.prepared.usable", lambda tests, *_, **__: ((good,), ("One less.",), None)
    )
    with pytest.raises(DataError, match="Nothing is seen"):
        identify(Campaign("two", None, (good, left_out)), report=told.append)
    assert said == [["good"]]
    assert told == ["One less.", "Measuring frequency and damping of the records without a model"]


def test_the_figure_holds_every_test():
    tests = tuple(linear(level, name=f"at {level}") for level in (0.1, 0.3))
    groups = look_groups(look(Campaign("two", None, tests)))
    axes = look_figure(xr.DataTree.from_dict(groups))
    assert len(axes[0, 0].lines) == 2
    assert [line.get_label() for line in axes[0, 1].lines] == ["at 0.1", "at 0.3"]


def test_the_command_reads_a_folder(tmp_path, capsys):
    for i, level in enumerate((0.1, 0.3)):
        write_hdf5(tmp_path / f"sweep_{i}.h5", linear(level).records[0])
    tests = "".join(
        f'[[test]]\nkind = "sweep"\nname = "s{i}"\nfiles = "sweep_{i}.h5"\nlevel = {level}\n'
        'channels = { input = "input", velocity = "velocity" }\n'
        'units = { input = "V", velocity = "m/s" }\n'
        for i, level in enumerate((0.1, 0.3))
    )
    path = tmp_path / "campaign.toml"
    path.write_text(f'[campaign]\nname = "two"\n{tests}')
    assert run(["look", str(path), "--figure", str(tmp_path / "look.svg")]) == 0
    streams = capsys.readouterr()
    assert "18.77" in streams.out  # 18.7803, within an error of 0.004
    assert "Nonlinear: not detected. From" in streams.out
    assert "s1: no harmonic exceeds the residual of the fit" in streams.out
    assert "Reading s1" in streams.err
    assert (tmp_path / "look.svg").stat().st_size > 10_000
    assert run(["look", str(path), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["tests"]) == 2
    assert run(["look", str(path), "--figure", "x.doc"]) == 2


def test_the_command_says_what_is_doubtful_beside_the_numbers_that_it_changes(tmp_path, capsys):
    """A window exp(-t / tau) adds 1 / (tau omega) to the damping ratio: 0.4 % of critical here."""
    rng, tau, zeta, hertz, fs = np.random.default_rng(0), 2.0, 0.004, 20.0, 512.0
    t = np.arange(round(12 * fs)) / fs
    for i in range(2):
        v = 0.1 * np.exp(-zeta * 2 * np.pi * hertz * t) * np.cos(2 * np.pi * hertz * t + i)
        v = (v + 2e-4 * rng.standard_normal(len(t))) * np.exp(-t / tau)
        write_hdf5(tmp_path / f"ring_{i}.h5", Record(fs, {"velocity": v}, {"velocity": "m/s"}))
    path = tmp_path / "campaign.toml"
    path.write_text(
        '[campaign]\nname = "windowed"\n[[test]]\nkind = "decay"\nfiles = "ring_*.h5"\n'
        'channels = { velocity = "velocity" }\nunits = { velocity = "m/s" }\n'
        "band = [10.0, 40.0]\n"
    )
    assert run(["look", str(path)]) == 0
    said = capsys.readouterr().out
    assert "window_s = " in said
    assert run(["check", str(path)]) == 0
    channels = capsys.readouterr().out
    findings = channels[channels.index("warning decay, velocity: ") :]
    assert said.startswith(findings.partition("\nwarning")[0])  # as the check says it, and first
    assert run(["look", str(path), "--json"]) == 0
    (doubt,) = json.loads(capsys.readouterr().out)["doubts"]
    stated = float(doubt.rpartition("window_s = ")[2].split("`")[0])
    assert stated == pytest.approx(tau, rel=0.05)  # 0.03 s is the standard error that it states
    path.write_text(path.read_text() + f"window_s = {stated}\n")
    assert run(["look", str(path), "--json"]) == 0
    cured = json.loads(capsys.readouterr().out)
    assert cured["doubts"] == []
    # An error of tau by 5 % leaves 5 % of the 0.4 % that the window added.
    assert cured["tests"][0]["damping"] == pytest.approx(zeta, abs=2e-4)


def row(y, frequency, sd=0.01, damping=0.01, **more):
    """A row of a look, of a test at this motion [m]."""
    facts = {"test": f"at {1e3 * y:g} mm", "kind": "sweep", "level": 1.0, "run": None}
    facts |= {"assembly": None, "y": y, "frequency_hz": frequency, "frequency_sd": sd}
    return StoredReading.read({**facts, "damping": damping, "damping_sd": 1e-4, **more})


def test_readings_tell_where_their_frequency_leaves_the_weakest():
    """f = 20 (1 - 10 y), y in m, read to 1e-3 Hz: 5 um of motion are one of them."""
    rng = np.random.default_rng(0)
    y = np.geomspace(1e-5, 1e-3, 12)
    tables = [
        a_table(y, 20.0 * (1 - 10 * y) + 1e-3 * rng.standard_normal(12), 0.01, hz_sd=1e-3)
        for _ in range(4)
    ]
    # 99 % of a difference of 1e-3 Hz over 48 readings: within a few of these steps.
    assert 1e-5 < trend(tables, "hz").onset < 1.2e-4
    same = [one._replace(hz=20.0 + 1e-3 * rng.standard_normal(12)) for one in tables]
    assert trend(same, "hz").onset is None


def test_a_frequency_that_falls_and_rises_turns():
    """A parabola of r with its least value at half of the largest amplitude."""
    rng = np.random.default_rng(0)
    y = np.linspace(1e-4, 2e-3, 12)
    hz = 80.0 * (1 - 0.01 * (y / 1e-3) * (2 - y / 1e-3)) + 1e-4 * rng.standard_normal(12)
    found = trend([a_table(y, hz, 0.004), a_table(y, hz, 0.004)], "hz")
    assert found.is_seen
    at, least = found.turn
    assert at == pytest.approx(1e-3, rel=0.01)
    assert least == pytest.approx(79.2, rel=1e-4)
    assert found.exponent is None


def test_scatter_within_a_day_stands_against_that_between_days():
    """Days at 18.8, 18.9 and 19.0 Hz: 0.1 Hz of 18.9; records 0.01 Hz."""
    rows = [row(1e-3, 18.8 + 0.1 * i, run=f"day {i}") for i in range(3)]
    (said,) = days(rows)
    assert "3 sessions or assemblies" in said
    # 0.01 and 0.1 Hz of 18.9 Hz.
    assert "frequency 0.053 % within a session, 0.53 % between" in said
    assert days([row(1e-3, 18.8), row(2e-3, 18.7)]) == []
    # Levels are not compared with one another.
    assert days([row(1e-3, 18.8, run="a"), row(2e-3, 18.7, run="b", level=2.0)]) == []


def test_each_of_several_modes_is_told_by_itself():
    """The first mode falls by 2 %, the second keeps its frequency at motions between."""
    y = np.geomspace(1e-4, 4e-3, 12)
    readings = {
        "first": [a_table(y, 30.0 * (1 - 5.0 * y), 0.01)],
        "second": [a_table(y, 90.0, 0.01)],
    }
    record = StoredLook()
    told = statements(record, readings, (30.5, 91.0))[0]
    first = [sentence for sentence in told if sentence.startswith("Mode near 30.5 Hz: ")]
    (second,) = [sentence for sentence in told if sentence.startswith("Mode near 91 Hz: ")]
    assert first[0].startswith("Mode near 30.5 Hz: Nonlinear: yes")
    assert second.startswith("Mode near 91 Hz: Nonlinear: not detected")
    # A mode that no test reads says nothing; one mode alone is not named.
    alone = {"first": readings["first"]}
    assert statements(record, alone, (30.5, 91.0))[0] == first
    unnamed = statements(record, alone)[0]
    assert [texts.of_mode(30.5, sentence) for sentence in unnamed] == first
