"""How much a design of a fleet tells: the published table, and a regression on made-up fleets."""

import json

import numpy as np
import pytest
from scipy.stats import linregress

from jbw.cli import run
from jbw.errors import ConfigError
from jbw.planning.plan import fleet_designs

# Sd of the slope, half of its 99 % interval, half of that of a new assembly; 2 to 12 N m.
TABLE = {
    (3, 1): (0.79, 50, 74), (3, 2): (0.56, 2.6, 5.0), (3, 3): (0.46, 1.6, 3.7),
    (4, 2): (0.53, 2.0, 3.9), (5, 1): (0.71, 4.1, 6.4), (5, 3): (0.41, 1.2, 3.1),
}  # fmt: skip


def test_the_table_of_designs():
    for design in fleet_designs((2.0, 12.0)):
        slope_sd, slope, new = TABLE[design.levels, design.assemblies]
        # As the table rounds.
        assert design.slope_sd == pytest.approx(slope_sd, abs=0.006)
        assert design.slope == pytest.approx(slope, rel=0.03)
        assert design.new_unit == pytest.approx(new, rel=0.02)


def test_the_slopes_interval_is_that_of_regressions():
    (design,) = fleet_designs((2.0, 12.0), [(3, 2)])
    rng = np.random.default_rng(0)
    t = np.repeat(np.linspace(np.log(2.0), np.log(12.0), 3), 2)
    slopes = [linregress(t, rng.standard_normal(6)).slope for _ in range(2000)]
    assert np.std(slopes) == pytest.approx(design.slope_sd, rel=0.06)  # 1.6 % counting error


@pytest.mark.parametrize("torques", [(0.0, 12.0), (12.0, 2.0), (2.0, np.inf)])
def test_torques_are_a_range(torques):
    with pytest.raises(ConfigError, match="must be positive and rise"):
        fleet_designs(torques)


def test_the_command_scales_the_table_by_the_scatter(capsys):
    assert run(["plan", "--population", "--torques", "2:12", "--scatter", "0.2", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["designs"][1]["slope"] == pytest.approx(2.6, rel=0.02)
    assert run(["plan", "--population"]) == 0
    assert "+-50 %" in capsys.readouterr().out  # a tenth of 5.0
    assert run(["plan", "--population", "--torques", "two"]) == 2
    assert "from:to" in capsys.readouterr().err
