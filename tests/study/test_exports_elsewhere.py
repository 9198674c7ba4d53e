"""The joint run where it was exported to: FMUs by FMPy, Octave, a Fortran program; tables read.

Forces are held against the law's own exact moves, and Bouc-Wen's besides against an integration of
its differential equation with nothing of jbw in it.
"""

import json
import re
import shutil
import subprocess
import zipfile
from dataclasses import replace
from itertools import pairwise

import fmpy
import jax
import numpy as np
import pytest
import xarray as xr
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import read_model_description
from fmpy.validation import validate_fmu
from known_laws import THETA, law_of
from scipy.integrate import solve_ivp

import jbw
from jbw.cli import run
from jbw.errors import ConfigError
from jbw.export.exports import PROGRAMS
from jbw.export.exports.fmu import base_powers, compiler
from jbw.export.exports.program import in_modelica, parameters_of
from jbw.export.files import chosen_programs, write_export
from jbw.export.one_joint import export, export_draws

MASS, Y_MAX = 2.5, 4e-3
IN_C = [
    "bouc_wen", "bouc_wen_nu", "jenkins", "jenkins_3", "gap_series", "iwan4", "masing_power",
    "masing_exponential", "cubic", "quintic", "square", "quadratic", "stop", "quadratic_damping",
    "cubic_damping",
]  # fmt: skip
SUM = ("jenkins_3", "stop", "quadratic_damping", "masing_power")
needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
needs_octave = pytest.mark.skipif(shutil.which("octave-cli") is None, reason="there is no Octave")
needs_fortran = pytest.mark.skipif(
    shutil.which("gfortran") is None or compiler() is None, reason="there is no gfortran"
)


def tree_of(laws, spread=0.0):
    rng = np.random.default_rng(0)
    theta = {"omega_n": 118.0, "zeta": 0.005}
    theta |= {name: value for law in laws for name, value in THETA[law].items()}
    shape = ("chain", "draw")
    draws = {n: (shape, v * (1 + spread * rng.random((2, 20)))) for n, v in theta.items()}
    root = xr.Dataset(attrs={"y_peak": Y_MAX, "laws": json.dumps(laws)})
    return xr.DataTree.from_dict({"/": root, "posterior": xr.Dataset(draws)})


def result_of(*laws):
    return export(tree_of(laws), MASS, draw=0)


def path():
    """Displacements that turn at many places, and velocities that have nothing to do with them."""
    rng = np.random.default_rng(1)
    turns = np.concatenate([[0.0], 3e-3 * rng.uniform(-1, 1, 30), [3e-3, -3e-3, 3e-3]])
    y = np.concatenate([np.linspace(a, b, 12)[1:] for a, b in pairwise(turns)])
    return y, rng.standard_normal(y.size)


def forces(laws, y, v):
    """Force of the laws along a path, by their own moves [N]."""
    total = np.zeros(y.size)
    for law in map(law_of, laws):
        move, force = jax.jit(law.move), jax.jit(law.force)
        memory, last = jax.tree.map(float, law.at_rest()), 0.0
        for i in range(y.size):
            memory = move(last, memory, y[i] - last)
            total[i] += MASS * float(force(y[i], v[i], memory))
            last = y[i]
    return total


def assert_same(found, expected):
    # Some ten rounding errors of the largest force a move, over 400 moves that forget.
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.max(np.abs(expected)))


class Slave:
    """An FMU that is stepped, of either version."""

    def __init__(self, file, folder):
        description = read_model_description(str(file))
        kind = FMU2Slave if description.fmiVersion == "2.0" else FMU3Slave
        self.number = {v.name: v.valueReference for v in description.modelVariables}
        self.fmu = kind(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(file), str(folder)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="joint",
        )
        self.two = kind is FMU2Slave
        self.fmu.instantiate()
        if self.two:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def put(self, **values):
        write = self.fmu.setReal if self.two else self.fmu.setFloat64
        write([self.number[name] for name in values], list(values.values()))

    def get(self, name):
        read = self.fmu.getReal if self.two else self.fmu.getFloat64
        return read([self.number[name]])[0]

    def step(self, y, v=0.0):
        self.put(displacement=y, velocity=v)
        self.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=1e-3)
        return self.get("force")


@pytest.fixture
def slave(tmp_path):
    """Makes FMUs and frees them; a library that stays loaded may not be replaced."""
    made = []

    def make(version, *laws):
        folder = tmp_path / f"{version}-{len(made)}"
        folder.mkdir()
        file = PROGRAMS[f"fmi{version}"].code(folder, result_of(*laws))[0]
        assert validate_fmu(str(file)) == []
        made.append(Slave(file, folder / "unpacked"))
        return made[-1]

    yield make
    for one in made:
        one.fmu.freeInstance()


@needs_compiler
@pytest.mark.parametrize("laws", [*((name,) for name in IN_C), SUM], ids="+".join)
def test_the_fmu_moves_as_the_law_does(slave, laws):
    y, v = path()
    one = slave(3, *laws)
    assert_same([one.step(*now) for now in zip(y, v, strict=True)], forces(laws, y, v))


@needs_compiler
@pytest.mark.parametrize("version", [2, 3])
def test_the_fmu_is_the_hysteresis_map_and_its_differential_equation(slave, version):
    y, _ = path()
    one, z, expected = slave(version, "bouc_wen"), 0.0, []
    p = THETA["bouc_wen"]
    joint = jbw.BoucWen(omega_n=118.0, zeta=0.005, **p)
    for dy in np.diff(y, prepend=0.0):
        z = float(jbw.hysteresis_map(joint, z, dy))
        expected.append(MASS * z)
    found = [one.step(each) for each in y]
    assert_same(found, expected)
    z = 0.0
    for dy, force in zip(np.diff(y, prepend=0.0)[:60], found, strict=False):
        rate = lambda s, z, dy=dy: (  # noqa: E731
            p["alpha"] * dy - p["gamma"] * abs(dy) * z - p["delta"] * dy * abs(z)
        )
        z = solve_ivp(rate, (0, 1), [z], rtol=1e-11, atol=1e-14).y[0, -1]
        assert MASS * z == pytest.approx(force, rel=1e-8, abs=1e-10)  # of the integration


@needs_compiler
@pytest.mark.parametrize("version", [2, 3])
def test_the_fmu_keeps_states_takes_parameters_and_knows_its_slopes(slave, version):
    one = slave(version, "bouc_wen", "quadratic_damping")
    fmu = one.fmu
    one.step(1e-3, 0.1)
    kept = fmu.getFMUstate() if version == 2 else fmu.getFMUState()
    onward = one.step(-2e-3, 0.3)
    restore = fmu.setFMUstate if version == 2 else fmu.setFMUState
    restore(kept)
    # Trying a displacement leaves no trace in the memory until a step.
    one.put(displacement=3e-3, velocity=0.0)
    one.get("force")
    assert one.step(-2e-3, 0.3) == onward
    restore(kept)
    if version == 2:
        again = fmu.deSerializeFMUstate(fmu.serializeFMUstate(kept))
    else:
        again = fmu.deserializeFMUState(fmu.serializeFMUState(kept))
    restore(again)
    assert one.step(-2e-3, 0.3) == onward
    # Slopes by central differences of trial displacements.
    asked = [one.number["total_force"]], [one.number["displacement"], one.number["velocity"]]
    for i, (name, at, step) in enumerate(
        (("displacement", -2.5e-3, 1e-7), ("velocity", 0.3, 1e-5))
    ):
        one.put(displacement=-2.5e-3, velocity=0.3)
        direction = [float(i == 0), float(i == 1)]
        slope = fmu.getDirectionalDerivative(*asked, direction)[0]
        sides = []
        for sign in (1, -1):
            one.put(**{name: at + sign * step})
            sides.append(one.get("total_force"))
        assert slope == pytest.approx((sides[0] - sides[1]) / (2 * step), rel=1e-6)
    fmu.reset()
    one.put(mass=2 * MASS, alpha=0.0, quadratic_damping=3.0)
    assert one.step(1e-3, 0.5) == pytest.approx(2 * MASS * 3.0 * 0.25, rel=1e-14)
    with pytest.raises(Exception, match="fmi"):
        one.put(displacement=float("nan"))


def test_without_a_compiler_the_fmu_holds_sources_and_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("CC", "none")
    tree_of(("cubic",)).to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    (tmp_path / "summary.json").write_text("{}")
    assert run(["export", str(tmp_path), "--to", "fmi3", "--draw", "0"]) == 0
    assert "no C compiler" in capsys.readouterr().out
    with zipfile.ZipFile(tmp_path / "export" / "joint_fmi3.fmu") as fmu:
        assert "sources/joint.c" in fmu.namelist()
        assert not any(name.startswith("binaries") for name in fmu.namelist())
    assert validate_fmu(str(tmp_path / "export" / "joint_fmi3.fmu")) == []


def test_modelica_writes_products_by_dots_and_powers_without_a_sign():
    """Modelica's specification 3.6, chapter 19: `N.m`, `m/s2`, `1/(m2.s2)`."""
    assert in_modelica("1/(m^2 s^2)") == "1/(m2.s2)"
    assert in_modelica("N s/m") == "N.s/m"


def test_units_are_powers_of_the_base():
    assert base_powers("1/(m^2 s^2)") == {"kg": 0, "m": -2, "s": -2}
    assert base_powers("N s/m") == {"kg": 1, "m": 0, "s": -1}


@needs_octave
@pytest.mark.parametrize("laws", [*((name,) for name in IN_C), SUM], ids="+".join)
def test_the_step_function_runs_in_octave(tmp_path, laws):
    write_export(tmp_path, result_of(*laws), [PROGRAMS["matlab"]])
    y, v = path()
    np.savetxt(tmp_path / "path.txt", np.column_stack([y, v]), fmt="%.17g")
    script = (
        "w = load('path.txt'); s = []; for i = 1:rows(w);"
        "[f, s] = joint_step(s, w(i, 1), w(i, 2)); printf('%.17g\\n', f); end"
    )
    done = subprocess.run(
        ["octave-cli", "--no-history", "--quiet", "--eval", script],
        cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert_same(np.array(done.stdout.split(), float), forces(laws, y, v))


# Calls UEL as Abaqus does: by reference, from Fortran; an increment is accepted at once.
DRIVER = """
program driver
  implicit none
  integer :: lflags(5), i, n, ios
  double precision :: rhs(2), amatrx(2, 2), svars(400), energy(8), props({num}), u(2), du(2), v(2)
  double precision :: a(2), params(3), dtime, y, w, none(8), time(2)
  props = [{props}]
  svars = 0; a = 0; none = 0; energy = 0; time = 0; dtime = 1d-3
  lflags = [11, 0, 1, 0, 0]
  params = [{hht}, 0.25d0, 0.5d0]
  open (7, file='path.txt')
  do
    read (7, *, iostat=ios) y, w
    if (ios /= 0) exit
    u = [1d0, 1d0 + y]; v = [0d0, w]; du = 0
    call uel(rhs, amatrx, svars, energy, 2, 1, 400, props, {num}, none, 3, 2, u, du, v, a, 1, &
      time, dtime, 1, 1, 1, params, 0, i, none, none, 0, lflags, 2, none, 1, none, i, 0, none)
    write (*, '(4es26.17)') rhs, amatrx(1, 1), amatrx(1, 2)
  end do
end program
"""


@needs_fortran
@pytest.mark.parametrize("hht", [0.0, -0.05])
def test_the_user_element_is_called_from_fortran_as_abaqus_does(tmp_path, hht):
    laws = ("bouc_wen", "stop", "quadratic_damping")
    result = result_of(*laws)
    write_export(tmp_path, result, [PROGRAMS["abaqus"]])
    lines = (tmp_path / "joint.inp").read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("*UEL PROPERTY"))
    props = [word for line in lines[start + 1 :] for word in line.split(", ")]
    assert [float(word) for word in props] == [one.value for one in parameters_of(result)]
    words = ", &\n".join(f"{float(word):.17e}".replace("e", "d") for word in props)
    code = DRIVER.format(num=len(props), props=words, hht=f"{hht}d0")
    (tmp_path / "driver.f90").write_text(code)
    y, v = path()
    np.savetxt(tmp_path / "path.txt", np.column_stack([y, v]), fmt="%.17g")
    for command in (
        [*compiler(), "-std=c99", "-O2", "-c", "joint_uel.c"],
        # Values that are not asked for are one number, whatever their shape.
        [
            "gfortran",
            "-w",
            "-fallow-argument-mismatch",
            "driver.f90",
            "joint_uel.o",
            "-o",
            "a",
            "-lm",
        ],
    ):
        subprocess.run(command, cwd=tmp_path, check=True, timeout=120)
    done = subprocess.run(
        ["./a"], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=60
    )
    first, second, diagonal, beside = np.array(done.stdout.split(), float).reshape(-1, 4).T
    rel = (1.0 + y) - 1.0  # the displacement as the element sees it
    k, c = result.linear["spring"], result.linear["dashpot"]
    total = forces(laws, rel, v) + k * rel + c * v
    assert_same(first, (1 + hht) * total - hht * np.append(0.0, total[:-1]))
    np.testing.assert_array_equal(second, -first)
    np.testing.assert_array_equal(beside, -diagonal)
    # Newmark's dv/du = gamma / (beta h); the joint's own stiffness lies between the spring's and
    # all that sticks or stops, and the damper's slope is 2 c |v|.
    rates = (c + MASS * 2 * THETA["quadratic_damping"]["quadratic_damping"] * np.abs(v)) * 2000.0
    own = diagonal / (1 + hht) - rates
    assert np.all(own > k)
    assert np.all(own < MASS * (118.0**2 + 400.0) + 1.0 + MASS * 497.4)


# -- tables ----------------------------------------------------------------------------------------
def numbers(line):
    return [float(word) for word in line]


def test_tables_hold_the_tips_of_steady_loops(tmp_path):
    result = result_of("bouc_wen")
    write_export(tmp_path, result, [PROGRAMS[n] for n in ("nastran", "ansys", "code_aster")])
    y = Y_MAX * np.arange(1, 20) / 19
    # Steady tips by integrating the rates until they have settled.
    p, k = THETA["bouc_wen"], 118.0**2 - THETA["bouc_wen"]["alpha"]
    tips = []
    for peak in y[[4, 18]]:
        z = 0.0
        for dy in (peak, *(-2 * peak, 2 * peak) * 150):
            rate = lambda s, z, dy=dy: (  # noqa: E731
                p["alpha"] * dy - p["gamma"] * abs(dy) * z - p["delta"] * dy * abs(z)
            )
            z = solve_ivp(rate, (0, 1), [z], rtol=1e-10, atol=1e-13).y[0, -1]
        tips.append(MASS * (k * peak + z))
    # Ansys: pairs of real constants.
    lines = (tmp_path / "joint.mac").read_text().splitlines()
    words = [w for line in lines if line.startswith(("R,1,", "RMORE,"))
             for w in line.removeprefix("R,1,").removeprefix("RMORE,").split(",")]  # fmt: skip
    table = np.reshape(numbers(words), (-1, 2))
    assert table.shape == (20, 2)  # as many as COMBIN39 takes
    np.testing.assert_allclose(table[1:, 0], y, rtol=1e-14)
    np.testing.assert_allclose(table[[5, 19], 1], tips, rtol=1e-8)  # of the integration
    # Nastran: fields of sixteen characters behind one of eight.
    lines = (tmp_path / "joint.bdf").read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("TABLED1*"))
    end = next(i for i, line in enumerate(lines) if "ENDT" in line)
    fields = [line[i : i + 16] for line in lines[first + 2 : end] for i in range(8, len(line), 16)]
    pairs = np.reshape(numbers(fields), (-1, 2))
    np.testing.assert_allclose(pairs[20:], table[1:], rtol=1e-9)  # ten digits
    np.testing.assert_allclose(pairs[:19], -table[:0:-1], rtol=1e-9)
    # Code_Aster: the file is Python, run with what collects the arguments in place of its command.
    given = {}
    exec((tmp_path / "joint.comm").read_text(), {"DEFI_FONCTION": dict}, given)
    force, damping = (np.reshape(given[n]["VALE"], (-1, 2)) for n in ("JOINT_F", "JOINT_C"))
    np.testing.assert_array_equal(force[19:], table)
    np.testing.assert_array_equal(damping[20:, 1], result.skeleton["damping_ns_m"])
    # c = 2 zeta m omega of the backbone at the largest amplitude.
    own = result.backbone
    c = 4 * np.pi * MASS * own["damping_ratio"][-1] * own["frequency_hz"][-1]
    assert damping[-1, 1] == pytest.approx(c, rel=1e-12)


MODELICA = [
    ("bouc_wen",), ("bouc_wen_nu",), ("jenkins_3", "stop", "cubic", "quadratic_damping"),
]  # fmt: skip


@pytest.mark.parametrize("laws", MODELICA, ids="+".join)
def test_the_equations_of_modelica_are_the_laws(tmp_path, laws):
    """Read line by line as formulas, and integrated; no compiler of Modelica is at hand."""
    result = result_of(*laws)
    (file,) = PROGRAMS["modelica"].card(tmp_path, result)
    text = file.read_text().replace("^", "**")
    known = {"abs": abs, "sign": np.sign, "max": max, "min": min}
    for name, value in re.findall(r"parameter Real (\w+)\(.*?\) = (\S+)", text):
        known[name] = eval(value, known)
    states = re.findall(r"der\((\w+)\) =", text)
    assert re.findall(r"Real (\w+)\(.*start=0, fixed=true\)", text) == states
    lines = re.findall(r"^  (\S+) = (.*);$", text.partition("equation\n")[2], re.M)
    choice = re.compile(r"if (.*) then (.*) else (.*)")
    formulas = {left: choice.sub(r"(\2) if (\1) else (\3)", right) for left, right in lines}
    formulas = {left: compile(right, left, "eval") for left, right in formulas.items()}

    def evaluated(x, y, v):
        here = known | dict(zip(states, x, strict=True)) | {"s_rel": y, "v_rel": v}
        for left, formula in formulas.items():
            here[left] = eval(formula, here)
        return here

    y, v = path()
    y, v, x, found, last = y[:120], v[:120], [0.0] * len(states), [], 0.0
    for to, speed in zip(y, v, strict=True):
        dy = to - last
        rates = lambda s, x, at=last, dy=dy: [  # noqa: E731
            evaluated(x, at + s * dy, dy)[f"der({name})"] for name in states
        ]
        x = solve_ivp(rates, (0, 1), x, rtol=1e-7, atol=1e-12, max_step=0.02).y[:, -1]
        found.append(evaluated(x, to, speed)["f"])
        last = to
    linear = result.linear["spring"] * y + result.linear["dashpot"] * v
    expected = forces(laws, y, v)
    # Of the integration over the kinks of slip, which are met within a step of 0.02 of a move.
    np.testing.assert_allclose(found - linear, expected, atol=5e-3 * np.max(np.abs(expected)))


@pytest.mark.parametrize(("law", "sticking"), [("cubic", 0.0), ("bouc_wen", 497.4)])
def test_spring_and_dashpot_are_those_of_the_linear_oscillator(law, sticking):
    """Beside a law of stiffness K a mass m has omega_n^2 = k/m + K, and c = 2 zeta omega_n m."""
    linear = result_of(law).linear
    assert linear["mass"] == MASS
    assert linear["spring"] / MASS + sticking == pytest.approx(118.0**2, rel=1e-13)
    assert linear["dashpot"] / MASS == pytest.approx(2 * 0.005 * 118.0, rel=1e-13)


# -- what is asked for -----------------------------------------------------------------------------
def test_a_law_that_a_program_cannot_take_is_refused_with_what_can():
    result = replace(result_of("cubic"), laws=("bilinear",))
    for name in ("fmi2", "matlab", "abaqus"):
        with pytest.raises(ConfigError, match=r"cannot represent .* `bilinear`.*\n.*--to"):
            chosen_programs([name], result)
    assert chosen_programs(["modelica", "ansys", "fmi2"], result_of("bouc_wen_nu"))
    with pytest.raises(ConfigError, match="matlab"):
        chosen_programs(["matlba"], result)
    with pytest.raises(ConfigError, match="iwan4"):
        chosen_programs(["modelica"], result_of("iwan4"))
    with pytest.raises(ConfigError, match="cubic"):
        chosen_programs(["opensees"], result_of("cubic"))


@pytest.mark.parametrize("name", PROGRAMS)
def test_every_program_says_verdict_and_draw_and_takes_no_order_from_a_name(tmp_path, name):
    """A comment that a campaign's name could end, or carry on, would be code."""
    evil = "Verdict */ --> ]]> ??/ \\"
    result = replace(result_of("bouc_wen"), about=(evil, "Joint: draw 0"))
    program = PROGRAMS[name]
    for file in program.card(tmp_path, result):
        if file.suffix == ".ssv":
            continue  # the FMU says it
        head = file.read_text().split("Joint: draw 0")[0].splitlines()
        assert "Verdict */" in "".join(head)
        assert not head[-2 if len(head) > 1 and head[-1].strip() in "$!#%*/" else -1].endswith("\\")
    for file in program.code(tmp_path, result):
        if file.suffix == ".fmu":
            assert validate_fmu(str(file)) == []
            with zipfile.ZipFile(file) as fmu:
                page = fmu.read("documentation/index.html").decode()
            assert "Verdict */ --&gt;" in page
            assert "Joint: draw 0" in page


def test_cards_of_draws_and_their_manifest(tmp_path):
    tree = tree_of(("bouc_wen",), spread=0.1)
    result = export(tree, MASS, draw=3)
    write_export(
        tmp_path, result, [PROGRAMS[n] for n in ("opensees", "matlab", "ansys")],
        export_draws(tree, result, 4),
    )  # fmt: skip
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["units"]["alpha_delta"] == "1/(m s^2)"
    assert sum(row["weight"] for row in manifest["draws"]) == pytest.approx(1.0)
    posterior = {name: x.values.ravel() for name, x in tree["posterior"].items()}
    assert [row["draw"] for row in manifest["draws"]] == [5, 15, 25, 35]
    for row in manifest["draws"]:
        i, own = row["draw"], tmp_path / row["folder"]
        assert set(row["files"]) == {"joint.tcl", "joint_parameters.m", "joint.mac"}
        assert all((own / name).exists() for name in row["files"])
        alpha = posterior["alpha"][i]
        assert row["parameters"]["alpha"] == alpha
        assert row["products"]["alpha_delta"] == pytest.approx(alpha * posterior["delta"][i])
        spring = MASS * (posterior["omega_n"][i] ** 2 - alpha)
        assert row["parameters"]["spring"] == pytest.approx(spring, rel=1e-14)
        assert f"Joint: draw number {i} (counted from 0)" in (own / "joint.tcl").read_text()
        assert f"Elastic 2 {spring:.12g}"[:18] in (own / "joint.tcl").read_text()
    tables = {(tmp_path / row["folder"] / "joint.mac").read_text() for row in manifest["draws"]}
    assert len(tables) == 4
    with pytest.raises(ConfigError, match="1 to 40"):
        export_draws(tree, result, 41)


def test_the_command_writes_what_is_asked_for(tmp_path, capsys):
    tree_of(("bouc_wen",), spread=0.1).to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    (tmp_path / "summary.json").write_text("{}")
    asked = ["--to", "abaqus,modelica", "--draws", "2", "--draw", "0", "--json"]
    assert run(["export", str(tmp_path), *asked]) == 0
    written = {name.rsplit("/", 1)[-1] for name in json.loads(capsys.readouterr().out)["files"]}
    assert written == {
        "parameters.csv", "backbone.csv", "loop.csv", "jbw.mat", "joint_uel.c", "joint.inp",
        "Joint.mo", "manifest.json",
    }  # fmt: skip
    assert run(["export", str(tmp_path), "--to", "abacus"]) == 2
    assert "Did you mean `abaqus`" in capsys.readouterr().err
