"""Draws five recorders' folders on their way to `jbw look`, two commands each: recorders.svg.

    python docs/draw_recorders.py

The records are a simulated joint's, written in the dialects of `tests/corpus`; the commands are run
and what they print is drawn as it is, but for the lines that only say that work goes on.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "tests")]

from corpus import dialects  # noqa: E402
from draw_terminal import drawn  # noqa: E402

import jbw  # noqa: E402

FOLDERS = {
    "testlab": "testlab_several_columns_of_one",
    "labview": "labview_without_times",
    "tdms": "tdms_with_unit_words",
    "phyphox": "phyphox_even",
    "tektronix": "tektronix",
}
PICTURE = HERE / "recorders.svg"
WIDTH = "100"  # columns of the terminal
CALL = "import sys; from jbw.cli import run; sys.exit(run(sys.argv[1:]))"
SECONDS, HZ = 8.0, 30.0


def simulated() -> dict[str, np.ndarray]:
    """A sweep of a joint by a force per mass, and its free decay, at the corpus' rate."""
    jax.config.update("jax_enable_x64", True)
    omega_n = 2 * np.pi * HZ
    joint = jbw.BoucWen(omega_n, 0.004, 0.2 * omega_n**2, 400.0, 250.0)
    t = np.arange(round(SECONDS * dialects.FS)) / dialects.FS
    force = 6.0 * np.sin(2 * np.pi * (15.0 * t + 30.0 / SECONDS / 2 * t**2))
    swept = np.asarray(jbw.simulate(joint, force, dialects.FS).v)
    burst = np.where(t < 1.0, 40.0 * np.sin(2 * np.pi * HZ * t), 0.0)
    v = np.asarray(jbw.simulate(joint, burst, dialects.FS).v)
    start = round(1.1 * dialects.FS)
    decay = np.gradient(v, 1 / dialects.FS)[start : start + len(t) - start]
    noise = np.random.default_rng(0).standard_normal((2, len(t)))
    return {
        "FORCE": force,
        "VELOCITY": swept + 1e-4 * np.std(swept) * noise[0],
        "ACCELERATION": decay + 1e-4 * np.std(decay) * noise[1][: len(decay)],
    }


def written(folder: Path, name: str, samples: dict[str, np.ndarray]) -> None:
    """One file in a recorder's dialect."""
    dialect = dialects.DIALECTS[name]
    size = len(samples["ACCELERATION" if dialect.kind == "decay" else "FORCE"])
    own = {key: x[:size] for key, x in samples.items()} | {
        "N": size, "T": np.arange(size) / dialects.FS,
    }  # fmt: skip
    for key, value in own.items():
        setattr(dialects, key, value)
    folder.mkdir()
    dialect.write(folder / dialect.file)


def printed(words: list[str], folder: Path) -> str:
    """What a command of jbw prints in a folder; it has to end with 0."""
    env = {**os.environ, "NO_COLOR": "1", "COLUMNS": WIDTH}
    return subprocess.run(
        [sys.executable, "-c", CALL, *words], cwd=folder, env=env, check=True, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    ).stdout  # fmt: skip


def recording() -> str:
    """What was typed, and what came of it."""
    samples, found = simulated(), []
    with tempfile.TemporaryDirectory() as place:
        for name, dialect in FOLDERS.items():
            written(Path(place) / name, dialect, samples)
            for words in (["init", name], ["look", f"{name}/campaign.toml"]):
                found += [f"$ jbw {' '.join(words)}", printed(words, Path(place)).rstrip()]
    return "\n".join(found)


if __name__ == "__main__":
    PICTURE.write_text(drawn(recording(), "five recorders"), encoding="utf-8")
