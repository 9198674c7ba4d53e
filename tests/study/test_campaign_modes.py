"""`modes` of a campaign: Step 2 beside a neighbour, in the summary, the tree and the figure."""

import json
from dataclasses import replace

import numpy as np
import pytest

from jbw.campaign.schema import parse
from jbw.errors import ConfigError
from jbw.identification.linear_step import linear_step, modes_dataset
from jbw.measurement.records import Record, Test
from jbw.study.summary import _linear

FS, BAND = 256.0, (17.0, 22.0)
OMEGA, ZETA, GAIN = 2 * np.pi * np.array([18.8, 20.0]), np.array([0.005, 0.004]), [15.0, 12.0]


@pytest.fixture(scope="module")
def noise():
    """Two repeats of periodic noise through two modes, a neighbour at 20 Hz."""
    rng, num = np.random.default_rng(1), 32 * 256
    omega = 2 * np.pi * np.fft.rfftfreq(num, 1 / FS)
    h = sum(
        g / (w**2 - omega**2 + 2j * z * w * omega)
        for w, z, g in zip(OMEGA, ZETA, GAIN, strict=True)
    )
    records = []
    for _ in range(2):
        drive = np.fft.rfft(rng.standard_normal(num))
        u, y = (np.tile(np.fft.irfft(x, num), 4) for x in (drive, 1j * omega * h * drive))
        y = y + 1e-4 * np.std(y) * rng.standard_normal(len(y))
        units = {"input": "V", "velocity": "m/s"}
        records.append(Record(fs=FS, channels={"input": u, "velocity": y}, units=units))
    return Test("multisine", tuple(records), name="multisine", band_hz=BAND, periods=4)


@pytest.mark.parametrize("modes", [(18.8, 20.0), 2])
def test_the_joints_own_mode_is_read_beside_its_neighbour(noise, modes):
    step = linear_step(noise, modes=modes)
    # 64 noisy lines of each peak's width at 1e-4: some 1e-5 of the width, five times that.
    np.testing.assert_allclose(step.pooled.mean, [OMEGA[0], ZETA[0], GAIN[0]], rtol=1e-3)
    alone = linear_step(noise)
    assert abs(alone.pooled.zeta / ZETA[0] - 1) > 0.02  # what one mode makes of both
    summary = _linear(step, {})
    json.dumps(summary, allow_nan=False)
    assert [round(row["omega_n"] / (2 * np.pi), 3) for row in summary["modes"]] == [18.8, 20.0]
    assert summary["modes"][1]["residue"] == pytest.approx(GAIN[1], rel=1e-3)
    assert "18.8 Hz (0.50 %), 20 Hz (0.40 %)" in summary["statements"][1]
    assert "modes" not in _linear(alone, {})


def test_the_second_of_two_may_be_the_joints(noise):
    step = linear_step(noise, modes=(20.0, 18.8))
    assert step.pooled.omega_n == pytest.approx(OMEGA[1], rel=1e-4)


def test_the_diagram_is_drawn(noise):
    pytest.importorskip("matplotlib")
    import xarray as xr

    from jbw.report.figures import FIGURES, figure_of

    found = modes_dataset(linear_step(noise, modes=2))
    assert found is not None
    near = np.abs(found["pole_omega"].values[:, None] / OMEGA - 1).min(axis=1) < 1e-3
    # Both modes at each of 25 orders, but for the lowest.
    assert near.sum() > 40
    drawn = figure_of(FIGURES["stabilisation"](xr.DataTree.from_dict({"/modes": found})))
    assert "18.80 Hz (0.50 %), 20.00 Hz (0.40 %)" in drawn.axes[0].get_title(loc="left")
    assert modes_dataset(linear_step(replace(noise, records=noise.records[:1]))) is None


TEXT = """[[test]]
kind = "noise"
files = "a.h5"
channels = {{ input = "u", velocity = "v" }}
units = {{ input = "V", velocity = "m/s" }}
band = [17.0, 22.0]
[identify]
modes = {}
"""


@pytest.mark.parametrize("stated", ["2", "[18.8, 20.0]", "[18.8]"])
def test_modes_are_counted_or_named(stated):
    assert parse(TEXT.format(stated)).settings.modes == (
        2 if stated == "2" else tuple(eval(stated))
    )


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ("[18.8, 30.0]", r"modes: 30 Hz must lie in the band .* 17 to 22 Hz"),
        ("0", "must be a whole number of at least 1"),
        ("true", "must be"),
        ("[18.8, 18.8]", "must not repeat a frequency"),
        ('"two"', "must be a list of numbers"),
    ],
)
def test_modes_that_cannot_be_meant_are_refused(stated, said):
    with pytest.raises(ConfigError, match=said):
        parse(TEXT.format(stated))
