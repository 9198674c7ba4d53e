"""The free exponent's exported moves, into gross slip and back, against mpmath.

The MATLAB function is run by Octave where there is one, and everywhere by a translation of its few
statements into Python; the FMU's C is compiled and run.
"""

import functools
import re
import shutil
import subprocess

import mpmath as mp
import numpy as np
import pytest
from stretched import way
from test_exports_elsewhere import MASS, Slave, needs_compiler, needs_octave, tree_of

from jbw.export.exports import PROGRAMS
from jbw.export.one_joint import export

ALPHA, MM = 1e4, mp.mpf("1e-3")
FACTORS = [(0.4, 0.3), (0.1, 0.6)]  # d and g: softening, and hardening on the way back to w = 0
TURNS = (1e-6, -1e-3, 0.3, 1.0, -3.0, -7.0, 10.0, -30.0, 30.0, 29.0, -100.0, 100.0, 0.0)


def stretch(c, distance, nu):
    """The inverse of `way`, by halving."""
    low, high = mp.mpf(0), c ** (-1 / nu) if c > 0 else 1000 * distance
    for _ in range(700):
        middle = (low + high) / 2
        low, high = (low, middle) if way(c, middle, nu) > distance else (middle, high)
    return low


def path(d, g, nu):
    """Turning points [m], from a millionth of the slip displacement to a hundred times it."""
    slip = 1e-3 * (d + g) ** (-1.0 / nu)
    return [slip * turn for turn in TURNS]


@functools.cache
def forces(d, g, nu):
    """Forces at the turning points [N], by 200 digits: slip brings a stretch so near its limit."""
    with mp.workdps(200):
        exponent = mp.mpf(nu)
        less, more = ((mp.mpf(d) + sign * mp.mpf(g)) / MM**exponent for sign in (-1, 1))
        w, last, found = mp.mpf(0), 0.0, []
        for y in path(d, g, nu):
            dy, last = mp.mpf(y) - mp.mpf(last), y
            side, distance = (1 if dy > 0 else -1), abs(dy)
            begun = way(less if side * w < 0 else more, abs(w), exponent)
            if side * w < 0 and distance < begun:
                w = -side * stretch(less, begun - distance, exponent)
            elif side * w < 0:
                w = side * stretch(more, distance - begun, exponent)
            else:
                w = side * stretch(more, begun + distance, exponent)
            found.append(float(w) * ALPHA * MASS)
        return np.array(found)


def exported(d, g, nu):
    theta = {"nu_stiffness": ALPHA, "nu_softening": d, "nu_opening": g, "nu": nu}
    tree = tree_of(("bouc_wen_nu",))
    draws = {name: tree["posterior"][name] * 0.0 + value for name, value in theta.items()}
    tree["posterior"].update(draws)
    return export(tree, MASS, draw=0)


def assert_same(found, expected):
    # Sums of a hundred terms at each of the moves, which forget; a stretch's last digit is 1e-15.
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13 * np.max(np.abs(expected)))


CASES = [(*factors, nu) for factors in FACTORS for nu in (0.5, 1.0, 2.0)]


# -- a few of MATLAB's statements ------------------------------------------------------------------
KNOWN = {
    name: getattr(np, name)
    for name in ("abs", "ceil", "exp", "expm1", "log", "log1p", "array", "sum")
} | {"Inf": np.inf, "max": np.maximum, "min": np.minimum}
KNOWN["side_of"] = lambda x: -1.0 if x < 0 else 1.0


def translated(text):
    """Functions of MATLAB as text of Python: assignments, branches, counts, and no more."""
    lines, depth, out = [], 0, ""
    for line in text.splitlines():
        line = line.partition("%")[0].strip().rstrip(";")
        line = re.sub(r"\bfrom\b", "start", line)  # a word of Python
        line = re.sub(r"\b([pm])\((\d)\)", r"\1[\2 - 1]", line)
        line = re.sub(r"= \[(.*)\]", r"= array([\1])", line)
        line = re.sub(r"\.([*/^])", r" \1", line).replace("^", "**")
        if head := re.fullmatch(r"function \[?(.+?)\]? = (\w+\(.*\))", line):
            out, depth = head[1], 1
            lines.append(f"def {head[2]}:")
        elif line == "end":
            depth -= 1
            lines += [f"    return {out}"] * (depth == 0)
        elif count := re.fullmatch(r"for (\w+) = 1:(\d+)", line):
            lines.append("    " * depth + f"for {count[1]} in range({count[2]}):")
            depth += 1
        elif line.startswith("if "):
            lines.append("    " * depth + line + ":")
            depth += 1
        elif line == "else":
            lines.append("    " * (depth - 1) + "else:")
        elif line:
            assert re.match(r"[\w\[\] -]+ = ", line), line
            lines.append("    " * depth + line)
    return "\n".join(lines)


@pytest.mark.parametrize(("d", "g", "nu"), CASES)
def test_the_matlab_function_moves_into_slip_as_mpmath(tmp_path, d, g, nu):
    (file,) = PROGRAMS["matlab"].code(tmp_path, exported(d, g, nu))
    _, head, functions = file.read_text().partition("function [force, m] = bouc_wen_nu")
    known = dict(KNOWN)
    exec(translated(head + functions), known)
    memory, last, found = [0.0], 0.0, []
    for y in path(d, g, nu):
        force, memory = known["bouc_wen_nu"]([ALPHA, d, g, nu], memory, last, y, 0.0)
        found.append(MASS * force)
        last = y
    assert_same(found, forces(d, g, nu))


@needs_octave
@pytest.mark.parametrize(("d", "g", "nu"), CASES)
def test_octave_moves_into_slip_as_mpmath(tmp_path, d, g, nu):
    result = exported(d, g, nu)
    PROGRAMS["matlab"].code(tmp_path, result)
    PROGRAMS["matlab"].card(tmp_path, result)
    steps = "".join(
        f"[f, s] = joint_step(s, {y!r}, 0); printf('%.17g\\n', f);" for y in path(d, g, nu)
    )
    done = subprocess.run(
        [shutil.which("octave-cli"), "--no-history", "--quiet", "--eval", f"s = []; {steps}"],
        cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert_same(np.array(done.stdout.split(), float), forces(d, g, nu))


@needs_compiler
@pytest.mark.parametrize(("d", "g", "nu"), CASES)
def test_the_fmu_moves_into_slip_as_mpmath(tmp_path, d, g, nu):
    (file,) = PROGRAMS["fmi3"].code(tmp_path, exported(d, g, nu))
    slave = Slave(file, tmp_path / "unpacked")
    try:
        assert_same([slave.step(y) for y in path(d, g, nu)], forces(d, g, nu))
    finally:
        slave.fmu.freeInstance()
