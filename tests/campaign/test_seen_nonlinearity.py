"""What `jbw check` says of nonlinearity, on records whose distortion is known."""

import re

import h5py
import numpy as np

from jbw.campaign.check import as_json, check_campaign

FS, SIZE, PERIODS = 512.0, 1024, 4
RNG = np.random.default_rng(6)
TEST = """
[[test]]
kind = "{kind}"
name = "{name}"
files = "{name}_*.h5"
level = 1.0
channels = {{ input = "input", velocity = "velocity" }}
units = {{ input = "V", velocity = "m/s" }}
fs = 512.0
{more}
"""


def write(folder, name, pairs):
    for i, (u, y) in enumerate(pairs):
        with h5py.File(folder / f"{name}_{i}.h5", "w") as file:
            file["input"], file["velocity"] = u, y


def checked(folder, kind, name, more=""):
    path = folder / "campaign.toml"
    path.write_text('[campaign]\nname = "seen"\n' + TEST.format(kind=kind, name=name, more=more))
    return check_campaign(path)


def test_a_sweep_says_its_harmonics_and_how_its_repeats_scatter(tmp_path):
    t = np.arange(int(20 * FS)) / FS
    u = np.cos(2 * np.pi * (10 * t + t**2 / 2))
    clean = 0.1 * (u + 0.3 * u**3)
    write(tmp_path, "swept", [(u, clean + 2e-4 * RNG.normal(size=len(t))) for _ in range(3)])
    found = checked(tmp_path, "sweep", "swept")
    assert as_json(found)["seen"] == list(found.seen)
    repeats, harmonics = found.seen
    # 2e-4 over 0.1 * rms of u + 0.3 u^3, sqrt(1 / 2 + 0.6 * 3 / 8 + 0.09 * 5 / 16) = 0.868.
    assert "3 repeats vary by 0.23 % of the response, which noise explains" in repeats
    # 0.3 / 4 over 1 + 3/4 * 0.3 is 6.12 %; an even order is not there, nor a fifth.
    assert "the third 6.1" in harmonics
    assert "second" not in harmonics
    assert "fifth" not in harmonics


def percents(said):
    return [float(number) for number in re.findall(r"([\d.]+(?:e-\d+)?) %", said)]


def test_a_multisine_tells_even_from_odd_and_distortion_from_noise(tmp_path):
    lines = np.setdiff1d(np.arange(5, 201, 2), np.arange(9, 201, 8))
    pairs = []
    for _ in range(3):
        spectrum = np.zeros(SIZE // 2 + 1, complex)
        spectrum[lines] = 20 * np.exp(2j * np.pi * RNG.random(len(lines)))
        u = np.tile(np.fft.irfft(spectrum), PERIODS)
        u /= np.std(u)
        pairs.append((u, 0.1 * (u + 0.05 * u**3) + 1e-4 * RNG.normal(size=len(u))))
    write(tmp_path, "lines", pairs)
    found = checked(tmp_path, "multisine", "lines", f"periods = {PERIODS}")
    distorted, idle = found.seen
    noise, distortion = percents(distorted)
    assert distortion > 20 * noise
    even, odd, _ = percents(idle)
    assert odd > 20 * even


def test_random_noise_says_its_coherence(tmp_path):
    u = RNG.normal(size=2**14)
    y = np.convolve(u, np.exp(-np.arange(200) / 40) * np.sin(np.arange(200) * 0.25))[: len(u)]
    write(tmp_path, "random", [(u, 1e-3 * y)])
    (said,) = checked(tmp_path, "noise", "random").seen
    assert "coherence at the resonance" in said
    value = float(said.split(" is ")[1].split(";")[0])
    assert 0.9 < value <= 1.0
