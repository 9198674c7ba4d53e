"""The plan file: what it says, and what is refused, all at once."""

import re

import numpy as np
import pytest

from jbw.errors import ConfigError
from jbw.planning import EXAMPLE
from jbw.planning.description import MOTIONS, TABLES, parse, read_description
from jbw.report.messages.planning import told_by_run
from jbw.units import FACTORS

IWAN = "[joint]\nlaws = 'iwan4'\n[plan]\n"
LEAST = "[plan]\nnatural_hz = 20.0\ndelta = [100.0, 300.0]\nnoise = 1e-5\n"


def test_the_least_file_has_sensible_defaults():
    description = parse(LEAST)
    assert description.ranges["omega_n"] == pytest.approx((40 * np.pi, 40 * np.pi))
    assert description.ranges["zeta"] == (0.002, 0.01)
    assert description.ranges["share"] == (0.01, 0.1)
    assert description.ranges["gamma"] == pytest.approx((5.0, 90.0))  # 0.05 to 0.3 of delta
    assert (description.gain, description.input_unit) == (None, None)
    assert (description.noise.std, description.noise.response) == (1e-5, "velocity")
    assert description.grids == {}


def test_the_example_is_a_plan_file_and_shows_every_table():
    description = parse(EXAMPLE)
    assert (description.gain, description.input_unit) == (15.0, "V")
    assert description.noise.std == pytest.approx(50e-6)
    assert set(description.grids) == {"sweep", "tones", "stepped"}
    assert set(TABLES) - {"plan", "joint"} == {*description.grids, "backbone"}
    assert "# [backbone]" in EXAMPLE  # no candidate unless it is asked for
    for name in ("fs", "max_repeats", "joints", "seed", "levels", "rates", "dwell"):
        assert f"# {name} = " in EXAMPLE
    assert f"; {', '.join(unit for motion in MOTIONS for unit in FACTORS[motion])}\n" in EXAMPLE


def test_a_modal_mass_makes_newtons_and_its_range_is_inferred():
    description = parse(LEAST + "modal_mass = [2.0, 4.0]\nnoise_unit = 'mm'\n")
    assert description.input_unit == "N"
    assert description.gain is None
    assert description.ranges["gain"] == (0.25, 0.5)
    assert (description.noise.std, description.noise.response) == (1e-8, "displacement")
    assert parse(LEAST + "modal_mass = 2.0\n").gain == 0.5


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", ["natural_hz: missing", "delta: missing", "noise: missing"]),
        ("[plan", ["not valid TOML"]),
        ("plan = 3\n", ["[plan]: must be a table"]),
        (LEAST + "[swep]\n", ["[swep]: unknown table; did you mean `sweep`"]),
        (LEAST + "zetta = 0.1\n", ["[plan] zetta: unknown key; did you mean `zeta`"]),
        (LEAST + "cv = 5\n", ["cv: must lie between 0 and 1", "5 %"]),
        (LEAST + "gamma = [-5.0, 5.0]\n", ["gamma: must be a number other than 0", "one sign"]),
        (LEAST + "gamma = [5.0, 4.0]\n", ["lower < upper"]),
        (LEAST + "gamma = [5.0, 6.0, 7.0]\n", ["must be a number or [lower, upper]"]),
        (IWAN + "iwan_chi = -1.0\n", ["iwan_chi: must be greater than -1, but is -1."]),
        (IWAN + "iwan_beta = -1.0\n", ["iwan_beta: must be positive, but is -1."]),
        (LEAST + "zeta = -0.01\n", ["zeta: must be positive, but is -0.01."]),
        (LEAST + "share = [0.5, 1.0]\n", ["share: must lie between 0 and 1", "upper end is 1"]),
        (LEAST + "share = 0.1\nalpha = 3.0\n", ["give share or alpha, not both"]),
        (LEAST + "omega_n = 3.0\n", ["give natural_hz or omega_n, not both"]),
        (LEAST + "gain = 1.0\nmodal_mass = 1.0\n", ["give gain or modal_mass, not both"]),
        (LEAST + "alpha = [1.0, 2e4]\n", ["alpha: must stay below omega_n^2", "15791"]),
        (LEAST + "wanted = ['alfa']\n", ["'alfa' is unknown; did you mean `alpha`"]),
        (LEAST + "noise_unit = 'V'\n", ["Unit `V` measures a voltage"]),
        (LEAST + "joints = 1\n", ["joints: must be a whole number of at least 2"]),
        (LEAST + "max_repeats = 0\n", ["max_repeats: must be a whole number of at least 1"]),
        (LEAST + "fs = 'fast'\n", ["fs: must be a number"]),
        (
            LEAST + "[tones]\ndwell = 2.0\nsettle = 3.0\n",
            ["[tones] settle: must be shorter", "2 s"],
        ),
        (LEAST + "[sweep]\nspan = [9.0, 3.0]\nrates = []\n", ["[sweep] span", "[sweep] rates"]),
        (LEAST + "[sweep]\nfrequencies = [9.0]\n", ["[sweep] frequencies: unknown key"]),
        (LEAST + "max_displacement = 0\ncv = 2\n", ["2 errors", "max_displacement", "cv"]),
    ],
)
def test_what_is_refused_and_how(text, says):
    with pytest.raises(ConfigError) as caught:
        parse(text)
    for part in says:
        assert part in str(caught.value)


def test_beside_a_run_the_joint_is_not_told_again():
    text = "[plan]\nzeta = 0.01\ngain = [1.0, 2.0]\nmax_input = 3.0\n"
    with pytest.raises(ConfigError) as caught:
        parse(text, of_run=True)
    assert told_by_run("zeta") in str(caught.value)
    assert "gain: must be a single value when a run is given, but is [1.0, 2.0]" in str(
        caught.value
    )
    description = parse("[plan]\nmax_input = 3.0\n", of_run=True)
    assert (description.ranges, dict(description.settings)) == ({}, {"max_input": 3.0})


def test_a_file_that_is_not_there_or_not_text(tmp_path):
    with pytest.raises(ConfigError, match=r"does not exist") as caught:
        read_description(tmp_path / "none.toml")
    assert "jbw plan --example" in str(caught.value)
    damaged = tmp_path / "plan.toml"
    damaged.write_bytes(b"[plan]\n# \xff\xfe\n")
    with pytest.raises(ConfigError, match=r"not UTF-8 text: byte 9 is invalid"):
        read_description(damaged)


JENKINS = """
[joint]
laws = "jenkins_2"
[plan]
natural_hz = 20.0
noise = 1e-5
stiffness_1 = [100.0, 300.0]
stiffness_2 = [50.0, 100.0]
slip_1 = [1e-4, 3e-4]
"""


def test_another_law_brings_its_own_keys_and_wishes():
    description = parse(JENKINS + "slip_ratio_2 = 5.0\nwanted = 'slip_ratio_2'\n")
    assert description.laws == ("jenkins_2",)
    assert list(description.ranges) == [
        "omega_n", "zeta", "stiffness_1", "slip_1", "stiffness_2", "slip_ratio_2",
    ]  # fmt: skip
    assert description.settings.wanted == ("slip_ratio_2",)
    with pytest.raises(ConfigError) as caught:
        parse(JENKINS + "delta = 3.0\nwanted = 'alpha'\n")
    for part in ("slip_ratio_2: missing; ", "delta: unknown key", "'alpha' is unknown"):
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("laws", "says"),
    [
        ('"bouc_wenn"', "[joint] laws: Unknown law `bouc_wenn`; did you mean `bouc_wen`"),
        ('["cubic", "cubic"]', "[joint] laws: "),
    ],
)
def test_laws_that_cannot_be_meant(laws, says):
    with pytest.raises(ConfigError) as caught:
        parse(f"[joint]\nlaws = {laws}\n{LEAST}")
    assert says in str(caught.value)
    with pytest.raises(ConfigError, match=re.escape(told_by_run("[joint]"))):
        parse('[joint]\nlaws = "cubic"\n', of_run=True)
