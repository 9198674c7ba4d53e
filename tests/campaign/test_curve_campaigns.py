"""Measured curves and loops as campaigns: amplitudes, phases, signs, channels in several files."""

import numpy as np
import pytest

from jbw.campaign.load import load_campaign
from jbw.errors import ConfigError, DataError
from jbw.measurement.curves import displacement_of, response_curve
from jbw.measurement.faults.responses import impassive
from jbw.measurement.files.read import read
from jbw.measurement.records import Record

FREQ = np.linspace(78.0, 82.0, 81)
OMEGA, OMEGA_N = 2 * np.pi * FREQ, 2 * np.pi * 80.0
Y = 1 / 1.9 / (OMEGA_N**2 - OMEGA**2 + 2j * 0.002 * OMEGA_N * OMEGA)  # for a force of 1 N
FORCE = np.linspace(0.5, 0.3, 81)
CHANNELS = {"frequency": "f", "force": "F", "acceleration": "A", "phase": "phi"}
UNITS = {"frequency": "Hz", "force": "N", "acceleration": "m/s^2", "phase": "rad"}


def toml(value):
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + " }"
    return f'"{value}"' if isinstance(value, str) else str(value).lower()


def campaign(folder, arrays, channels=CHANNELS, units=UNITS, kind="frf", files="a.npz", **keys):
    if isinstance(files, str):
        np.savez(folder / files, **arrays)
    table = {"kind": kind, "files": files, "channels": channels, "units": units, **keys}
    lines = [f"{key} = {toml(value)}" for key, value in table.items()]
    (folder / "campaign.toml").write_text("\n".join(["[[test]]", *lines]))
    return folder / "campaign.toml"


def arrays(response=-(OMEGA**2) * Y * FORCE):
    return {"f": FREQ, "F": FORCE, "A": np.abs(response), "phi": np.angle(response)}


def curve_of(path):
    return response_curve(load_campaign(path).tests[0].records[0])


def test_amplitude_and_phase(tmp_path, recwarn):
    curve = curve_of(campaign(tmp_path, arrays()))
    np.testing.assert_allclose(displacement_of(curve), Y * FORCE, rtol=1e-13)
    assert not recwarn.list


def test_rms_amplitudes_become_peak(tmp_path):
    rms = arrays() | {"F": FORCE / np.sqrt(2), "A": arrays()["A"] / np.sqrt(2)}
    curve = curve_of(campaign(tmp_path, rms, amplitudes="rms"))
    np.testing.assert_allclose(curve.source, FORCE)
    np.testing.assert_allclose(displacement_of(curve), Y * FORCE, rtol=1e-13)


def test_degrees_and_rad_per_second(tmp_path):
    other = arrays() | {"f": OMEGA, "phi": np.degrees(arrays()["phi"])}
    units = UNITS | {"frequency": "rad/s", "phase": "deg"}
    curve = curve_of(campaign(tmp_path, other, units=units))
    np.testing.assert_allclose(curve.freq_hz, FREQ)
    np.testing.assert_allclose(displacement_of(curve), Y * FORCE, rtol=1e-12)


def test_complex_response_needs_no_phase(tmp_path):
    complex_ = {"f": FREQ, "F": FORCE, "A": -(OMEGA**2) * Y * FORCE}
    channels = {role: CHANNELS[role] for role in ("frequency", "force", "acceleration")}
    units = {role: UNITS[role] for role in channels}
    curve = curve_of(campaign(tmp_path, complex_, channels, units))
    np.testing.assert_allclose(displacement_of(curve), Y * FORCE, rtol=1e-13)
    with pytest.raises(DataError, match=r"a\.npz: role `acceleration` is complex, but `phase`"):
        load_campaign(campaign(tmp_path, complex_ | {"phi": FREQ}))


def test_response_per_unit_force(tmp_path):
    ratio = {"f": FREQ, "A": -(OMEGA**2) * Y * 1e3}
    channels = {"frequency": "f", "acceleration": "A"}
    units = {"frequency": "Hz", "acceleration": "mm/s^2/N"}
    curve = curve_of(campaign(tmp_path, ratio, channels, units))
    assert curve.is_ratio
    np.testing.assert_array_equal(curve.source, 1.0)
    np.testing.assert_allclose(displacement_of(curve), Y, rtol=1e-12)
    with pytest.raises(ConfigError, match="is for kind `frf` only"):
        load_campaign(campaign(tmp_path, ratio, {"acceleration": "A"},
                               {"acceleration": "m/s^2/N"}, kind="decay"))  # fmt: skip


@pytest.mark.parametrize(
    ("channels", "change", "says"),
    [
        ({r: CHANNELS[r] for r in ("frequency", "force", "acceleration")}, {}, "but no phase"),
        (CHANNELS, {"f": FREQ[::-1] * (FREQ < 80)}, "positive, and either all rise or all fall"),
        (CHANNELS, {"F": -FORCE}, "amplitude of the input must be positive"),
        (CHANNELS, {"phi": FREQ[:-1]}, "equal lengths"),
        (CHANNELS, {name: x[:3] for name, x in arrays().items()}, "has 3 points"),
    ],
)
def test_faults_of_curves(tmp_path, channels, change, says):
    units = {role: UNITS[role] for role in channels}
    with pytest.raises(DataError, match=says):
        load_campaign(campaign(tmp_path, arrays() | change, channels, units))


def test_band_beside_the_curve(tmp_path):
    with pytest.raises(DataError, match=r"No point of the .* 78 to 82 Hz, lies in `band`"):
        load_campaign(campaign(tmp_path, arrays(), band=[490.0, 510.0]))


def test_phase_in_degrees_read_as_radians_is_doubted(tmp_path):
    with pytest.warns(UserWarning, match='units = {.* phase = "deg" }'):
        load_campaign(campaign(tmp_path, arrays() | {"phi": np.degrees(arrays()["phi"])}))


@pytest.mark.parametrize("phase", [np.degrees(arrays()["phi"]), np.full(81, -90.0)])
def test_a_phase_in_degrees_is_not_taken_for_a_wrong_sign_or_a_backbone(tmp_path, phase):
    """Read in radians it turns any way: the unit is the one cause that can be named."""
    with pytest.warns(UserWarning, match='units = {.* phase = "deg" }') as caught:
        load_campaign(campaign(tmp_path, arrays() | {"phi": phase}))
    (only,) = (str(told.message) for told in caught)
    assert "passive" not in only
    assert "backbone" not in only


def test_masked_lines_do_not_hide_a_phase_in_degrees(tmp_path):
    phase = np.where(np.arange(81) == 3, np.nan, np.degrees(arrays()["phi"]))
    with (
        pytest.warns(UserWarning, match="1 of 81 samples are not finite; gaps"),
        pytest.warns(UserWarning, match='units = {.* phase = "deg" }'),
    ):
        load_campaign(campaign(tmp_path, arrays() | {"phi": phase}, gaps="mask"))


def test_a_curve_read_by_itself_goes_one_way_too(tmp_path):
    np.savez(tmp_path / "a.npz", **arrays() | {"f": np.roll(FREQ, 1)})
    with pytest.raises(DataError, match="positive, and either all rise or all fall"):
        read(tmp_path / "a.npz", CHANNELS, UNITS)


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("conjugate", [False, True])
@pytest.mark.parametrize("sign", [1, -1])
def test_signs_are_told_apart(order, conjugate, sign):
    """Any turned sign is found, and the remedy that is given turns it back."""
    role = ("displacement", "velocity", "acceleration")[order]
    x = sign * (1j * OMEGA) ** order * Y * FORCE
    x = np.conj(x) if conjugate else x

    def findings(amplitude, phase):
        channels = {"frequency": FREQ, "force": FORCE, role: amplitude, "phase": phase}
        return tuple(impassive(response_curve(Record(np.nan, channels, {"force": "N"}))))

    found = findings(np.abs(x), np.angle(x))
    assert bool(found) == (conjugate or sign < 0)
    if found:
        phase = -1 if "`conjugate = true`" in found[0].remedy else 1
        turned = -1 if f"{role} = -1.0" in found[0].remedy else 1
        assert not findings(turned * np.abs(x), phase * np.angle(x))


def test_a_phase_locked_backbone_is_called_one(tmp_path):
    """The phase is held at -90 degrees, and the force goes with the amplitude: no wrong sign."""
    held = arrays()["phi"] * 0 - np.pi / 2 + 0.01 * np.cos(np.arange(81))
    with pytest.warns(UserWarning, match="points of a backbone") as caught:
        load_campaign(campaign(tmp_path, arrays() | {"phi": held}))
    assert not any("passive" in str(told.message) for told in caught)


@pytest.mark.parametrize("complex_response", [False, True])
def test_conjugate_turns_the_phase_of_a_curve(tmp_path, complex_response):
    """As a lock-in amplifier counts it: a phase of its own, or that of a complex response."""
    plain = load_campaign(campaign(tmp_path, arrays())).tests[0].records[0]
    turned = arrays() | {"phi": -arrays()["phi"]}
    channels, units = CHANNELS, UNITS
    if complex_response:
        (response,) = {"displacement", "velocity", "acceleration"} & CHANNELS.keys()
        name = CHANNELS[response]
        turned[name] = turned[name] * np.exp(1j * turned["phi"])
        channels = {role: where for role, where in CHANNELS.items() if role != "phase"}
        units = {role: unit for role, unit in UNITS.items() if role != "phase"}
    path = campaign(tmp_path, turned, channels, units)
    with pytest.warns(UserWarning, match="`conjugate = true`"):
        load_campaign(path)
    path = campaign(tmp_path, turned, channels, units, conjugate=True)
    (record,) = load_campaign(path).tests[0].records
    np.testing.assert_allclose(record.channels["phase"], plain.channels["phase"], atol=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_loop_takes_energy_in(tmp_path, sign, recwarn):
    phase = np.arange(4000) * 2 * np.pi / 1000
    # Elastic and frictional: the force leads the displacement; it takes in pi * 0.3 a turn.
    loop = {"y": np.sin(phase), "F": sign * (np.sin(phase) + 0.3 * np.cos(phase))}
    channels = {"displacement": "y", "restoring_force": "F"}
    units = {"displacement": "mm", "restoring_force": "N"}
    load_campaign(campaign(tmp_path, loop, channels, units, kind="loop", fs=1000.0))
    assert ["force falls" in str(told.message) for told in recwarn.list] == [True] * (sign < 0)


@pytest.mark.parametrize("rate", [1.0, -1.0])
def test_a_decay_falls(tmp_path, rate, recwarn):
    t = np.arange(4000) / 1000.0
    decay = {"v": 1e-3 * np.exp(-rate * t) * np.cos(100 * t)}
    path = campaign(tmp_path, decay, {"velocity": "v"}, {"velocity": "m/s"}, "decay", fs=1000.0)
    load_campaign(path)
    assert ["last quarter" in str(told.message) for told in recwarn.list] == [True] * (rate < 0)


# --- several files, offsets, periods ---


def pair(folder, names=("u_1", "u_2", "y_1", "y_2"), fs=(750.0, 750.0)):
    rng = np.random.default_rng(0)
    for name in names:
        samples = rng.normal(size=4096) + 0.5
        np.savez(folder / f"{name}.npz", x=samples, fs=fs[name.startswith("y")])


TWO = {
    "files": {"force": "u_*.npz", "displacement": "y_*.npz"},
    "channels": {"force": "x", "displacement": "x"},
    "units": {"force": "N", "displacement": "mm"},
    "kind": "sweep",
}


def test_channels_in_files_of_their_own_are_paired_in_order(tmp_path):
    pair(tmp_path)
    (test,) = load_campaign(campaign(tmp_path, {}, **TWO, fs="fs")).tests
    assert [r.name for r in test.records] == ["u_1.npz + y_1.npz", "u_2.npz + y_2.npz"]
    with np.load(tmp_path / "y_2.npz") as archive:
        np.testing.assert_array_equal(test.records[1].channels["displacement"], archive["x"] * 1e-3)
    assert test.records[0].provenance["sha256"].count(";") == 1
    (test,) = load_campaign(campaign(tmp_path, {}, **TWO, fs="fs", exclude="u_1*")).tests
    assert [r.name for r in test.records] == ["u_2.npz + y_2.npz"]


def test_files_that_do_not_pair(tmp_path):
    pair(tmp_path, ("u_1", "u_2", "y_1"))
    with pytest.raises(DataError, match=r"equally many files for each role, but has u_1\.npz: 2"):
        load_campaign(campaign(tmp_path, {}, **TWO, fs="fs"))


def test_files_of_two_rates(tmp_path):
    pair(tmp_path, fs=(750.0, 1024.0))
    with pytest.raises(DataError, match=r"u_1\.npz has 750 Hz and y_1\.npz has 1024 Hz"):
        load_campaign(campaign(tmp_path, {}, **TWO, fs="fs"))


def test_mean_is_removed_and_said(tmp_path):
    pair(tmp_path)
    stated = campaign(tmp_path, {}, **TWO, fs="fs", remove_mean=True, settle=0.1)  # in motion
    (test,) = load_campaign(stated).tests
    for samples in test.records[0].channels.values():
        assert abs(samples.mean()) < 1e-15
    with np.load(tmp_path / "u_1.npz") as archive:
        said = float(test.records[0].provenance["mean of force removed"])
        np.testing.assert_allclose(said, archive["x"].mean(), rtol=1e-5)  # six digits are said


def test_periods_must_be_whole(tmp_path):
    pair(tmp_path)
    (test,) = load_campaign(campaign(tmp_path, {}, **TWO, fs="fs", periods=4)).tests
    assert test.periods == 4
    with pytest.raises(DataError, match="4096 samples are not 5 whole periods"):
        load_campaign(campaign(tmp_path, {}, **TWO, fs="fs", periods=5))
