"""Controlled tests as campaigns: what is read, what is doubted, and the remedies pasted."""

import re

import numpy as np
import pytest

from jbw.campaign.check import check_campaign
from jbw.campaign.draft import start_campaign
from jbw.campaign.load import load_campaign
from jbw.campaign.schema import parse
from jbw.errors import ConfigError, DataError
from jbw.measurement.curves import controlled_curve
from jbw.study.look import look

PUT = re.compile(r"Put under \[([\w.\[\]]+?)\]: `([^`]+)`")
NATURAL, MASS = 2 * np.pi * 20.0, 1.9
Y = np.geomspace(1e-4, 3e-3, 14)
# An oscillator whose stiffness falls and whose damping rises with the amplitude, in closed form.
OMEGA_R, ZETA = NATURAL * (1 - 4 * Y), 0.004 + 0.4 * Y


def locked(degrees=-90.0):
    """Frequency [Hz] and force [N] of every point at a phase of the displacement [deg]."""
    phase = np.radians(degrees) + 0 * Y
    cotangent = np.cos(phase) / np.sin(phase)
    half = ZETA * OMEGA_R * cotangent
    omega = half + np.sqrt(half**2 + OMEGA_R**2)
    force = -MASS * 2 * ZETA * OMEGA_R * omega * Y / np.sin(phase)
    return {"f": omega / (2 * np.pi), "F": force, "y": Y.copy(), "phi": np.degrees(phase)}


def response_at(omega):
    """Phase [deg] and force [N] that hold each amplitude at frequencies [rad/s]."""
    stiffness = MASS * (OMEGA_R**2 - omega**2 + 2j * ZETA * OMEGA_R * omega) * Y
    return np.degrees(-np.angle(stiffness)), np.abs(stiffness)


def s_curve(hz=19.8):
    phase, force = response_at(2 * np.pi * hz)
    return {"f": np.full(14, hz), "F": force, "y": Y.copy(), "phi": phase}


def written(folder, arrays, kind="backbone", response="displacement", keys="", without=()):
    units = {"displacement": "m", "acceleration": "m/s^2"}
    table = {"frequency": ("f", "Hz"), "force": ("F", "N"), response: ("y", units[response]),
             "phase": ("phi", "deg")}  # fmt: skip
    table = {role: pair for role, pair in table.items() if role not in without}
    channels = ", ".join(f'{role} = "{name}"' for role, (name, _) in table.items())
    stated = ", ".join(f'{role} = "{unit}"' for role, (_, unit) in table.items())
    np.savez(folder / "points.npz", **arrays)
    path = folder / "campaign.toml"
    path.write_text(f"""[campaign]
name = "points"
modal_mass = {MASS}
[[test]]
kind = "{kind}"
name = "points"
files = "points.npz"
channels = {{ {channels} }}
units = {{ {stated} }}
{keys}
""")
    return path


def faults(path):
    return [fault for row in check_campaign(path).rows for fault in row.findings]


def pasted(path, remedy):
    """Put the lines of a remedy under [[test]], in the place of what stands there."""
    text = path.read_text()
    for _, line in PUT.findall(remedy):
        key = line.partition(" = ")[0]
        text = re.sub(rf"^{re.escape(key)} = .*\n", "", text, flags=re.MULTILINE)
        text = text.replace("[[test]]\n", f"[[test]]\n{line}\n")
    path.write_text(text)


def turned(arrays, **changes):
    return arrays | {name: change(arrays[name].copy()) for name, change in changes.items()}


def off_at(places, degrees):
    def moved(phase):
        phase[places] += degrees
        return phase

    return moved


@pytest.mark.parametrize("degrees", [-90.0, -60.0, -130.0])
def test_a_backbone_is_taken_as_it_is(tmp_path, degrees):
    path = written(tmp_path, locked(degrees), keys=f"locked_phase = {degrees}")
    assert faults(path) == []
    (test,) = load_campaign(path).tests
    curve = controlled_curve(test.records[0])
    np.testing.assert_allclose(curve.amplitude, Y)
    np.testing.assert_allclose(np.degrees(curve.phase), degrees)


def test_an_accelerometer_has_the_phase_of_its_displacement(tmp_path):
    arrays = locked()
    omega = 2 * np.pi * arrays["f"]
    arrays |= {"y": omega**2 * Y, "phi": arrays["phi"] + 180.0}
    path = written(tmp_path, arrays, response="acceleration")
    assert faults(path) == []
    curve = controlled_curve(load_campaign(path).tests[0].records[0])
    np.testing.assert_allclose(curve.amplitude, Y)
    np.testing.assert_allclose(np.degrees(curve.phase), -90.0)


def test_points_in_any_order_are_an_s_curve(tmp_path):
    order = np.random.default_rng(0).permutation(14)
    arrays = {name: values[order] for name, values in s_curve().items()}
    assert faults(written(tmp_path, arrays, "curve", keys='jumps = "keep"')) == []


@pytest.mark.parametrize("without", [("phase",), ("force",), ("force", "phase")])
def test_a_backbone_needs_no_phase_and_no_force(tmp_path, without):
    arrays = {name: x for name, x in locked().items()}
    path = written(tmp_path, arrays, without=without)
    assert faults(path) == []
    assert controlled_curve(load_campaign(path).tests[0].records[0], -90.0).phase is not None


def jumped():
    """A force-controlled sweep by its points: at the eighth it fell to the other branch."""
    phase = np.linspace(-30, -60, 14)
    phase[7:] -= 90.0
    amplitude = np.linspace(2e-3, 2.3e-3, 14)
    amplitude[7:] /= 4
    return {"f": np.linspace(19.0, 19.3, 14), "F": np.ones(14), "y": amplitude, "phi": phase}


@pytest.mark.parametrize(
    ("arrays", "kind", "key", "said"),
    [
        (turned(locked(), phi=off_at([2, 8], 7.0)), "backbone", "phase_tolerance", "points 3, 9"),
        (turned(locked(), phi=off_at([13], -9.0)), "backbone", "phase_tolerance", "point 14 "),
        (locked(-60.0), "backbone", "locked_phase", "up to 30 degrees"),
        (turned(locked(), phi=np.negative), "backbone", "conjugate", "leads the force"),
        (turned(s_curve(19.0), phi=lambda x: x + 180), "curve", "scale", "leads the force"),
        (jumped(), "curve", "jumps", "Between points 7 and 8 the amplitude jumps"),
        (turned(locked(), f=lambda f: np.where(Y > 1e-3, 1.3 * f, f)), "backbone", "jumps",
         "Between points 9 and 10 the frequency jumps from"),
        (locked(), "frf", "kind", "points of a backbone"),
    ],
)  # fmt: skip
def test_a_pasted_remedy_of_controlled_points_cures(tmp_path, arrays, kind, key, said):
    path = written(tmp_path, arrays, kind)
    (fault,) = faults(path)
    assert said in fault.what
    ((table, line),) = PUT.findall(fault.remedy)
    assert (table, line.partition(" = ")[0]) == ("[test]", key)
    pasted(path, fault.remedy)
    assert faults(path) == []


def test_the_tolerance_is_a_key(tmp_path):
    arrays = turned(locked(), phi=off_at([2], 4.0))
    assert faults(written(tmp_path, arrays)) == []
    (fault,) = faults(written(tmp_path, arrays, keys="phase_tolerance = 3.0"))
    assert "point 3 deviates by up to 4 degrees" in fault.what


def test_s_curves_one_behind_the_other_do_not_jump(tmp_path):
    """From the last amplitude of one to the first of the next it is a factor of thirty."""
    several = [s_curve(hz) for hz in (19.0, 19.5, 19.8)]
    together = {name: np.concatenate([one[name] for one in several]) for name in several[0]}
    assert faults(written(tmp_path, together, "curve")) == []


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"F": lambda x: -x}, "force of every point must be positive, but that of point 1 is not"),
        ({name: lambda x: x[:2] for name in ("f", "F", "y", "phi")}, "needs 3 points"),
    ],
)
def test_points_that_cannot_be(tmp_path, change, says):
    with pytest.raises(DataError, match=says):
        load_campaign(written(tmp_path, turned(locked(), **change)))


TABLE = """[[test]]
kind = "{kind}"
files = "a.csv"
channels = {{ frequency = "f", force = "F", displacement = "y", phase = "p" }}
units = {{ frequency = "Hz", force = "N", displacement = "{unit}" }}
{keys}
"""


@pytest.mark.parametrize(
    ("kind", "keys", "unit", "says"),
    [
        ("curve", "locked_phase = -60", "m", "locked_phase: for kind `backbone`"),
        ("frf", "amplitude_std = 0.01", "m", "amplitude_std: for kind `backbone`, `curve`"),
        ("backbone", "locked_phase = 90", "m", "must lie between -180 and 0"),
        ("backbone", "", "m/N", "`m/N` of `displacement` is for kind `frf` only"),
        ("backbone", "resample = 9.0", "m", "resample: applies only to records in time"),
    ],
)
def test_keys_that_do_not_go_together(kind, keys, unit, says):
    with pytest.raises(ConfigError, match=re.escape(says)):
        parse(TABLE.format(kind=kind, keys=keys, unit=unit))


def test_frequencies_beside_resonance_need_a_force():
    """Damping moves them: omega = zeta omega_n cot(phi) + sqrt(...)."""
    text = TABLE.format(kind="backbone", keys="locked_phase = -60", unit="m")
    text = text.replace('force = "F", ', "").replace('force = "N", ', "")
    with pytest.raises(ConfigError, match="at -60 degrees needs `force`"):
        parse(text)


def csv(folder, header, columns):
    np.savetxt(folder / "points.csv", np.column_stack(columns), delimiter=",", header=header,
               comments="", fmt="%.8g")  # fmt: skip
    return start_campaign(folder).text


@pytest.mark.parametrize(
    ("header", "names", "kind"),
    [
        ("frequency_Hz,amplitude_mm", ("f", "y"), "backbone"),
        ("amplitude_mm,frequency_Hz", ("y", "f"), "backbone"),
        ("frequency,force,displacement", ("f", "F", "y"), "backbone"),
        ("frequency,force,displacement,phase", ("f", "F", "y", "phi"), "backbone"),
    ],
)
def test_a_backbone_is_drafted_as_one(tmp_path, header, names, kind):
    arrays = locked()
    text = csv(tmp_path, header, [arrays[name] for name in names])
    assert f'kind = "{kind}"\n' in text
    assert "displacement" in text
    if "_mm" in header:
        assert 'displacement = "mm"' in text


@pytest.mark.parametrize("with_phase", [True, False])
def test_an_s_curve_is_drafted_as_a_curve(tmp_path, with_phase):
    arrays = s_curve()
    names = ["f", "F", "y", "phi"][: 4 if with_phase else 3]
    header = ",".join(["frequency", "force", "displacement", "phase"][: len(names)])
    assert 'kind = "curve"\n' in csv(tmp_path, header, [arrays[name] for name in names])


def test_a_response_curve_is_still_one(tmp_path):
    omega = np.linspace(0.95, 1.05, 41) * NATURAL
    h = 1 / (NATURAL**2 - omega**2 + 0.01j * NATURAL * omega)
    columns = [omega / (2 * np.pi), np.ones(41), np.abs(h), np.degrees(np.angle(h))]
    text = csv(tmp_path, "frequency,force,displacement,phase", columns)
    assert 'kind = "frf"\n' in text


@pytest.mark.parametrize("made", [locked(), locked(-60.0), s_curve()])
def test_a_look_reads_frequency_and_damping_of_every_point(tmp_path, made):
    """Those of the oscillator in closed form, at any phase."""
    kind = "curve" if np.ptp(made["f"]) == 0 else "backbone"
    keys = "phase_tolerance = 40.0" if kind == "backbone" else ""
    found = look(load_campaign(written(tmp_path, made, kind, keys=keys)), report=lambda _: None)
    readings = found.readings["points"]
    np.testing.assert_allclose([one.y for one in readings], Y)
    np.testing.assert_allclose([2 * np.pi * one.frequency_hz for one in readings], OMEGA_R)
    np.testing.assert_allclose([one.damping for one in readings], ZETA, rtol=1e-9)
    if kind == "backbone":
        assert any("falls from" in line for line in found.record.seen)
