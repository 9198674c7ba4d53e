"""Levels that go against the records: two tests whose levels were exchanged."""

import numpy as np
import pytest

from jbw.campaign.check import check_campaign
from jbw.campaign.together import Level, against_levels

FS = 256.0


def campaign(folder, levels, sizes):
    t = np.arange(4096) / FS
    u = np.sin(2 * np.pi * (10 + 0.6 * t) * t) * np.sin(np.pi * t / t[-1]) ** 2
    omega, w = 2 * np.pi * np.fft.rfftfreq(8192, 1 / FS), 2 * np.pi * 18.0
    x = np.fft.irfft(np.fft.rfft(u, 8192) / (w**2 - omega**2 + 0.02j * w * omega))[:4096]
    tables = []
    for i, (level, size) in enumerate(zip(levels, sizes, strict=True)):
        noise = 1e-3 * np.std(x) * np.random.default_rng(i).standard_normal(len(x))
        np.savez(folder / f"sweep_{i}.npz", u=size * u, x=4 * size * (x + noise))
        tables.append(f"""[[test]]
kind = "sweep"
name = "sweep {i}"
files = "sweep_{i}.npz"
level = {level}
channels = {{ force = "u", displacement = "x" }}
units = {{ force = "N", displacement = "m" }}
fs = {FS}
""")
    path = folder / "campaign.toml"
    path.write_text('[campaign]\nname = "levels"\nmodal_mass = 1.0\n' + "\n".join(tables))
    found = check_campaign(path)
    return [fault.what for row in found.rows for fault in row.findings]


@pytest.mark.parametrize("names", [(0.05, 0.2), (1.0, 4.0)])
def test_exchanged_levels_are_named(tmp_path, names):
    low, high = names
    said = [what for what in campaign(tmp_path, (high, low), (0.05, 0.2)) if "times that" in what]
    assert said == [
        "The `level` of test `sweep 0` is 4 times that of `sweep 1`, but its drive is 4 times "
        "smaller, and its response is smaller too."
    ]


def test_levels_that_go_with_the_drive_are_sound(tmp_path):
    assert campaign(tmp_path, (0.05, 0.2, 0.2), (0.05, 0.2, 0.19)) == []


@pytest.mark.parametrize(("responses", "count"), [((4.0, 1.0), 1), ((1.0, 4.0), 0)])
def test_a_response_that_goes_with_its_level_clears_the_levels(responses, count):
    """A drive that goes against both is another fault: of its channel, not of the levels."""
    alike = ("sweep", "force", "displacement")
    first, second = (
        Level(name, alike, "force", level, drive, response)
        for name, level, drive, response in zip(
            "ab", (1.0, 4.0), (4.0, 1.0), responses, strict=True
        )
    )
    assert len(list(against_levels([first, second]))) == count
