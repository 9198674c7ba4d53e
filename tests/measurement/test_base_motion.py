"""Records on a moving base: read as those of the same structure under a force per mass."""

import numpy as np
import pytest
from pasted import lines_of
from scipy.signal import chirp, lsim

from jbw.campaign.check import check_campaign
from jbw.campaign.load import load_campaign
from jbw.errors import ConfigError
from jbw.study.look import look

FS, SECONDS = 256.0, 12.0
OMEGA, ZETA, SHAPE = 2 * np.pi * 20.0, 0.01, 1.4  # SHAPE: participation times shape at the point
HEAD = """[campaign]
name = "table"
{head}
[[test]]
kind = "sweep"
files = "sweep_*.npz"
channels = {{ base = "b", {role} = "a" }}
units = {{ base = "g", {role} = "{unit}" }}
fs = 256.0
{more}
"""


def base():
    """A sweep of 0.1 g, which comes and goes within half a second [m/s^2]."""
    t = np.arange(0.0, SECONDS, 1 / FS)
    window = np.clip(t / 0.5, 0, 1) * np.clip((SECONDS - t) / 0.5, 0, 1)
    return t, 0.980665 * window * chirp(t, 15.0, SECONDS, 26.0)


def relative(t, b, order):
    """The motion relative to the base by scipy, or a derivative of it, of a linear mode."""
    return lsim(([-SHAPE, *([0.0] * order)], [1.0, 2 * ZETA * OMEGA, OMEGA**2]), b, t)[1]


def written(folder, role="acceleration", unit="m/s^2", head="", more="", *, is_relative=False):
    t, b = base()
    noise = np.random.default_rng(1).standard_normal((2, t.size))
    motion = relative(t, b, ("displacement", "velocity", "acceleration").index(role))
    seen = motion if is_relative else motion + b
    for i in range(2):
        x = seen + 1e-3 * np.std(seen) * noise[i]
        np.savez(folder / f"sweep_{i}.npz", b=b / 9.80665, a=x)
    path = folder / "campaign.toml"
    path.write_text(HEAD.format(head=head, role=role, unit=unit, more=more))
    return path


@pytest.mark.parametrize(
    ("role", "unit", "more"),
    [
        ("acceleration", "m/s^2", ""),
        ("displacement", "m", "relative_to_base = true"),
        ("velocity", "m/s", "relative_to_base = true"),
    ],
)
def test_a_mode_on_a_moving_base_is_read_as_it_is(tmp_path, role, unit, more):
    path = written(tmp_path, role, unit, more=more, is_relative=bool(more))
    campaign = load_campaign(path)
    (row,) = look(campaign, report=lambda _: None).record.tests
    assert row.frequency_hz == pytest.approx(20.0, abs=3 * row.frequency_sd)
    assert row.damping == pytest.approx(ZETA, abs=3 * row.damping_sd)
    assert row.damping_sd < 0.02 * ZETA
    record = campaign.tests[0].records[0]
    y, u = record.channels[role], record.channels["input"]
    order = ("displacement", "velocity", "acceleration").index(role)
    t, b = base()
    np.testing.assert_allclose(u, -b, atol=1e-12)
    expected = relative(t, b, order)
    assert np.std(y - expected) < 3e-3 * np.std(expected)  # noise, and that of the base beside it


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"role": "velocity", "unit": "m/s"}, "the response must be `acceleration`, unless"),
        ({"more": "delay = 0.01"}, "not allowed with `base`"),
        ({"more": 'drive = "force"'}, "leave out one of the two"),
    ],
)
def test_what_a_test_on_a_base_cannot_have_is_named(tmp_path, options, said):
    with pytest.raises(ConfigError, match=said):
        load_campaign(written(tmp_path, **options))


def test_the_remedy_of_a_velocity_on_a_base_is_taken(tmp_path):
    with pytest.raises(ConfigError) as refused:
        load_campaign(written(tmp_path, "velocity", "m/s"))
    ((_, line),) = lines_of(str(refused.value))
    load_campaign(written(tmp_path, "velocity", "m/s", more=line, is_relative=True))


@pytest.mark.parametrize(
    ("role", "unit", "said"),
    [("force", "N", "modal_mass"), ("input", "V", "cannot be combined with tests driven by volt")],
)
def test_another_drive_beside_a_base_is_refused_without_a_mass(tmp_path, role, unit, said):
    path = written(tmp_path)
    table = HEAD.split("[[test]]")[1].format(role="acceleration", unit="m/s^2", more="")
    by_other = table.replace("base", role).replace('"g"', f'"{unit}"')
    path.write_text(f"{path.read_text()}\n[[test]]{by_other}")
    with pytest.raises(ConfigError, match=said):
        load_campaign(path)


def test_a_fault_of_the_base_is_told_in_its_own_row(tmp_path):
    path = written(tmp_path)
    with np.load(tmp_path / "sweep_0.npz") as held:
        b, a = held["b"].copy(), held["a"]
    b[700:900] = np.nan
    np.savez(tmp_path / "sweep_0.npz", b=b, a=a)
    rows = {row.role: row for row in check_campaign(path).rows}
    assert rows["base"].status == "error"
