"""A limit on the size of files, as a full disk: the next step, and nothing half written."""

import contextlib

import numpy as np
import pytest

from jbw.cli import run

resource = pytest.importorskip("resource", reason="no limits on this system")

CAMPAIGN = """[campaign]
name = "decay"
[[test]]
kind = "decay"
files = "decay.npz"
channels = { velocity = "velocity" }
units = { velocity = "m/s" }
band = [10.0, 40.0]
fs = 512.0
"""


@contextlib.contextmanager
def no_room():
    """No file may grow."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture
def folder(tmp_path):
    t = np.arange(4096) / 512
    x = np.exp(-t) * np.cos(2 * np.pi * 20 * t)
    x += 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    np.savez(tmp_path / "decay.npz", velocity=x)
    return tmp_path


@pytest.mark.fault(42)
def test_a_draft_that_cannot_be_written_is_said_and_leaves_nothing(folder, capsys):
    with no_room():
        code = run(["init", str(folder)])
    assert code == 1
    stderr = capsys.readouterr().err
    assert "campaign.toml` cannot be written: File too large." in stderr
    assert f"jbw init --print {folder}" in stderr
    assert [path.name for path in folder.iterdir()] == ["decay.npz"]
    assert run(["init", str(folder)]) == 0


@pytest.mark.fault(42)
@pytest.mark.parametrize(
    ("command", "option", "name"), [("look", "--figure", "look.png"), ("check", "--figures", "all")]
)
def test_a_figure_that_cannot_be_written_is_said_and_leaves_nothing(
    folder, capsys, command, option, name
):
    (folder / "campaign.toml").write_text(CAMPAIGN)
    words = [command, str(folder / "campaign.toml"), option, str(folder / name)]
    with no_room():
        code = run(words)
    assert code == 1
    stderr = capsys.readouterr().err
    assert "cannot be written" in stderr
    assert "File too large." in stderr
    # The place is at fault and not the campaign.
    assert f"Next: jbw {' '.join(words)}, after the correction" in stderr
    assert not list(folder.rglob("*.p*ng*"))
