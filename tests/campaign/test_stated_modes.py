"""Modes that a campaign states are no fault of its records."""

import numpy as np
import pytest

from jbw.campaign.check import check_campaign, has_one_mode
from jbw.campaign.schema import parse

FS, FIRST, SECOND = 512.0, 18.0, 23.0
CAMPAIGN = """[campaign]
name = "two modes"
[[test]]
kind = "decay"
files = "tap.csv"
channels = { time = "t", velocity = "v" }
units = { time = "s", velocity = "m/s" }
band = [12.0, 30.0]
"""


def write_tap(folder, *modes_hz):
    """Write the decay of modes with a damping ratio of 0.5 % each."""
    t = np.arange(4096) / FS
    v = sum(np.exp(-0.005 * 2 * np.pi * hz * t) * np.cos(2 * np.pi * hz * t) for hz in modes_hz)
    v = 0.01 * v + 1e-6 * np.random.default_rng(0).standard_normal(len(t))
    rows = np.stack([t, v], 1)
    np.savetxt(folder / "tap.csv", rows, delimiter=",", header="t,v", comments="")


@pytest.mark.parametrize(("second_hz", "is_apart"), [(23.0, True), (18.5, False)])
def test_a_band_is_proposed_only_where_it_leaves_the_first_mode_as_it_is(
    tmp_path, second_hz, is_apart
):
    write_tap(tmp_path, FIRST, second_hz)
    path = tmp_path / "campaign.toml"
    path.write_text(CAMPAIGN)
    faults = [fault for row in check_campaign(path).rows for fault in row.findings]
    remedy = next(fault.remedy for fault in faults if "two modes" in fault.what)
    assert ("band = [" in remedy) is is_apart
    assert "[structure]" in remedy


def test_two_modes_in_a_band_are_named_unless_the_campaign_states_them(tmp_path):
    write_tap(tmp_path, FIRST, SECOND)
    path = tmp_path / "campaign.toml"

    def said(text):
        path.write_text(text)
        return [fault.what for row in check_campaign(path).rows for fault in row.findings]

    assert any("two modes" in what for what in said(CAMPAIGN))
    assert said(CAMPAIGN + f"[structure]\nmodes = [{FIRST}, {SECOND}]\n") == []


@pytest.mark.parametrize(
    ("modes", "is_one"), [("1", True), ("[18.0]", True), ("2", False), ("[18.0, 23.0]", False)]
)
def test_linear_neighbours_that_the_campaign_states_are_modes_too(modes, is_one):
    assert has_one_mode(parse(CAMPAIGN + f"[identify]\nmodes = {modes}\n")) is is_one
