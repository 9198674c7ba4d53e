"""Every law of the register, and sums of them, as `jbw export` hands them to other programs.

Materials of OpenSees are moved here by the formulas of its source code, with nothing of jbw in it.
"""

import json
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr
from exported import column, rows
from known_laws import THETA
from tiers import standing_for_all

from jbw.export.files import write_export
from jbw.export.one_joint import export
from jbw.oscillator.laws import LAWS

STRUCTURE = {"omega_n": 118.0, "zeta": 0.005}
MASS, Y_MAX, STEPS = 2.5, 4e-3, 2000
SUMS = [("bouc_wen", "cubic"), ("jenkins_3", "stop", "quadratic_damping"), ("iwan4", "quintic")]
SLIDING = {"iwan4", "masing_exponential", "masing_power"}  # as sliders, within some thousandths
KNOWN_TO_OPENSEES = SLIDING | {
    "bouc_wen", "bouc_wen_nu", "bwbn_pinching", "cubic_damping", "jenkins", "jenkins_3",
    "quadratic_damping", "stop",
}  # fmt: skip


def exported(folder, laws):
    theta = STRUCTURE | {name: value for law in laws for name, value in THETA[law].items()}
    draws = {name: (("chain", "draw"), np.full((2, 4), value)) for name, value in theta.items()}
    root = xr.Dataset(attrs={"y_peak": Y_MAX, "laws": json.dumps(laws)})
    tree = xr.DataTree.from_dict({"/": root, "posterior": xr.Dataset(draws)})
    write_export(folder, export(tree, MASS, draw=0))


def made(path):
    """Materials of a script by their tags: their kind and what follows."""
    lines = (line.split() for line in path.read_text().splitlines() if line[0] != "#")
    return {tag: (kind, words) for _, kind, tag, *words in lines}


def forces(kind, words, y):
    """Force of one material along slow displacements from rest, as OpenSees defines it."""
    if kind == "Elastic":
        return float(words[0]) * y
    if kind == "ElasticPP":
        stiffness, most = (float(word) for word in words)
        stretch, found = 0.0, []
        for dy in np.diff(y, prepend=0.0):
            stretch = np.clip(stretch + dy, -most, most)
            found.append(stiffness * stretch)
        return np.array(found)
    if kind == "ElasticMultiLinear":
        half = words.index("-stress")
        strain, stress = (np.array(part, float) for part in (words[1:half], words[half + 1 :]))
        slopes = np.diff(stress) / np.diff(strain)
        inside = np.interp(y, strain, stress)
        beyond = slopes[-1] * np.maximum(y - strain[-1], 0) + slopes[0] * np.minimum(
            y - strain[0], 0
        )
        return inside + beyond
    if kind == "Viscous":
        return 0.0 * y  # slow motion
    assert kind == "BoucWen"
    ratio, stiffness, n, gamma, beta, a_0, *degradation = (float(word) for word in words)
    assert not any(degradation)
    z, found = 0.0, []
    for dy in np.diff(y, prepend=0.0):

        def slope(z, dy=dy):
            return a_0 - np.abs(z) ** n * (gamma + beta * np.sign(dy * z))

        middle = z + 0.5 * dy * slope(z)
        z = z + dy * slope(middle)  # the midpoint rule; OpenSees' own is Euler's, backwards
        found.append(z)
    return ratio * stiffness * y + (1 - ratio) * stiffness * np.array(found)


# Bouc, Wen, Baber and Noori's law with pinching is the one without and more.
@pytest.mark.parametrize(
    "laws",
    standing_for_all(
        [*((name,) for name in [*LAWS, "jenkins_3"]), *SUMS],
        *((name,) for name in [*LAWS, "jenkins_3"] if name != "bwbn"), *SUMS,
    ),
)  # fmt: skip
def test_every_law_is_exported_as_tables_and_where_opensees_has_it_as_materials(tmp_path, laws):
    exported(tmp_path, laws)
    amplitude, frequency, force = (
        np.array(column(tmp_path / "backbone.csv", name))
        for name in ("amplitude_m", "frequency_hz", "force_n")
    )
    y, static, peak = (
        np.array(column(tmp_path / "loop.csv", name))
        for name in ("displacement_m", "force_n", "y_peak_m")
    )
    y, static = y[peak == Y_MAX], static[peak == Y_MAX]
    # The equivalent stiffness of the backbone is the first cosine of the static force.
    theta = np.linspace(0, 2 * np.pi, len(y))
    first = np.trapezoid(static * np.cos(theta), theta) / np.pi
    stiffness = MASS * (2 * np.pi * frequency[-1]) ** 2
    if "square" in laws:  # softens by its even harmonics, which no static force shows
        stiffness += MASS * 5 / 6 * (THETA["square"]["square"] * Y_MAX / STRUCTURE["omega_n"]) ** 2
    assert first == pytest.approx(stiffness * amplitude[-1], rel=1e-4)
    # What the loop loses, with the dashpot and the dampers beside it, is what the force feeds in.
    lost = np.trapezoid(static, y)
    dashpot = MASS * 0.01 * 118.0 * 2 * np.pi * frequency[-1] * Y_MAX
    fed = np.pi * Y_MAX * (force[-1] - dashpot)
    if any("damping" in law for law in laws):
        assert lost < fed
    else:
        assert lost == pytest.approx(fed, rel=5e-3, abs=1e-9)
    damping = np.array(column(tmp_path / "backbone.csv", "damping_ratio"))
    np.testing.assert_allclose(2 * damping * MASS * (2 * np.pi * frequency) ** 2 * amplitude, force)
    script = tmp_path / "joint.tcl"
    assert script.exists() == (set(laws) <= KNOWN_TO_OPENSEES)
    # A loop of OpenSees wears from cycle to cycle; `test_opensees.py` follows it there.
    if script.exists() and "bwbn_pinching" not in laws:
        materials = made(script)
        kind, tags = materials.pop("1")
        assert kind == "Parallel"
        assert tags == [*materials]
        turns = Y_MAX * np.array([0, 1, -1, 1, -1, 1, -1, 1])  # four periods: it has settled
        path = np.concatenate([np.linspace(a, b, STEPS)[1:] for a, b in pairwise(turns)])
        total = sum(forces(kind, words, path) for kind, words in materials.values())
        down, half = slice(-2 * (STEPS - 1), -(STEPS - 1)), len(y) // 2
        expected = np.interp(path[down][::-1], y[: half + 1][::-1], static[: half + 1][::-1])
        # Straight lines between the loop's points; bins of sliders.
        atol = (2e-3 if set(laws) & SLIDING else 5e-4) * np.max(static)
        np.testing.assert_allclose(total[down][::-1], expected, atol=atol)


def test_dampers_are_dashpots_of_opensees(tmp_path):
    exported(tmp_path, ("quadratic_damping", "cubic_damping"))
    dashpots = {power: float(c) for kind, (c, *rest) in made(tmp_path / "joint.tcl").values()
                if kind == "Viscous" for power in rest}  # fmt: skip
    assert dashpots == {"2": MASS * 2.0, "3": MASS * 4.0}
    names = [row["parameter"] for row in rows(tmp_path / "parameters.csv")]
    assert names == ["omega_n", "zeta", "quadratic_damping", "cubic_damping"]
