"""Row 50: a part of a huge file costs the memory of that part."""

import subprocess
import sys

import h5py
import numpy as np
import pytest
import scipy.io.wavfile

from jbw.errors import DataError
from jbw.measurement.files.read import read

FS = 51200
TAKEN = 2**23  # samples of the part, 64 MiB as float64
BEFORE = 60 * FS  # samples in front of it

# Reads the part in a process of its own and prints what that added to its peak of memory [bytes].
# A part of one second is read first, so that libraries are loaded before.
PROGRAM = """
import resource, sys
from jbw.measurement.files.read import read
path, channel, start, stop = sys.argv[1], sys.argv[2], float(sys.argv[3]), float(sys.argv[4])
asked = dict(units={"velocity": "m/s"}, scale={"velocity": 1.0})
read(path, {"velocity": channel}, span=(start, start + 0.5), fs=51200.0, **asked)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
(record,) = read(path, {"velocity": channel}, span=(start, stop), fs=51200.0, **asked)
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(record.num_samples, (after - before) * 1024)
"""


def signal(n, dtype=np.float64):
    return np.sin(np.arange(n) * 0.01).astype(dtype)


def write_sparse(path):
    """A day at 51.2 kHz, 35 GB: sparse on disk but for the part."""
    with h5py.File(path, "w") as file:
        laser = file.create_dataset("laser", (FS * 86400,), dtype="f8", chunks=(2**18,))
        laser[BEFORE : BEFORE + TAKEN] = signal(TAKEN)
    return "laser", 1.0


def write_npy(path):
    samples = np.lib.format.open_memmap(path, "w+", np.float32, (BEFORE + 4 * TAKEN,))
    samples[BEFORE : BEFORE + TAKEN] = signal(TAKEN)
    samples.flush()
    return "data", 1.0


def write_wav(path):
    samples = np.zeros(BEFORE + 4 * TAKEN, np.int16)
    samples[BEFORE : BEFORE + TAKEN] = signal(TAKEN) * 30000
    scipy.io.wavfile.write(path, FS, samples)
    return "channel", 30000 / 2**15


def write_tdms(path):
    nptdms = pytest.importorskip("nptdms")
    rest = np.zeros(TAKEN, np.float32)
    properties = {"wf_increment": 1 / FS}
    with nptdms.TdmsWriter(path) as writer:
        for part in (rest[:BEFORE], signal(TAKEN, np.float32), rest, rest, rest):
            writer.write_segment([nptdms.ChannelObject("log", "laser", part, properties)])
    return "log.laser", 1.0


@pytest.mark.fault(50)
@pytest.mark.skipif(sys.platform != "linux", reason="peak memory is counted in KiB on Linux only")
@pytest.mark.parametrize(
    ("suffix", "write"),
    [(".h5", write_sparse), (".npy", write_npy), (".wav", write_wav), (".tdms", write_tdms)],
)
def test_part_of_a_huge_file_costs_its_own_memory(tmp_path, suffix, write):
    path = tmp_path / f"day{suffix}"
    channel, _ = write(path)
    start, stop = BEFORE / FS, (BEFORE + TAKEN) / FS
    if suffix == ".h5":
        assert path.stat().st_blocks * 512 < 2 * 8 * TAKEN  # sparse: nothing but the part on disk
        with pytest.raises(DataError, match="GiB"):
            read(path, {"velocity": channel}, {"velocity": "m/s"}, fs=float(FS))
    arguments = [sys.executable, "-c", PROGRAM, str(path), channel, str(start), str(stop)]
    ended = subprocess.run(arguments, capture_output=True, text=True, check=True, timeout=120)
    samples, added = map(int, ended.stdout.split())
    assert samples == TAKEN
    # The part in float64, a fifth for the checks, and the mapped pages of the file's own type.
    mapped = {".npy": 4, ".wav": 2, ".tdms": 4}.get(suffix, 0) * TAKEN
    assert added < 1.2 * 8 * TAKEN + 2 * mapped, f"{added / 2**20:.0f} MiB"


def test_part_is_the_right_one(tmp_path):
    for suffix, write in ((".npy", write_npy), (".wav", write_wav)):
        channel, scale = write(tmp_path / f"a{suffix}")
        start = (BEFORE + 1000) / FS
        (record,) = read(
            tmp_path / f"a{suffix}",
            {"velocity": channel},
            {"velocity": "m/s"},
            fs=float(FS),
            scale={"velocity": 1 / scale},
            span=(start, start + 0.1),
        )
        # Half a step of the 16 bits, or of float32.
        np.testing.assert_allclose(
            record.channels["velocity"], signal(1000 + 5120)[1000:], atol=1 / 30000
        )


# Checks a campaign in a process of its own and prints what that added to its peak memory [bytes].
CHECK = """
import resource, sys
from jbw.campaign.check import check_campaign
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
found = check_campaign(sys.argv[1])
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(found.exit_code, (after - before) * 1024)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="peak memory is counted in KiB on Linux only")
def test_a_check_costs_six_times_its_memory_at_most(tmp_path):
    samples = 2**23
    rng = np.random.default_rng(0)
    with h5py.File(tmp_path / "noise.h5", "w") as file:
        for name in ("input", "velocity"):
            file.create_dataset(name, data=rng.normal(size=samples))
    (tmp_path / "campaign.toml").write_text(
        '[[test]]\nkind = "noise"\nfiles = "noise.h5"\nfs = 51200\n'
        'channels = { input = "input", velocity = "velocity" }\n'
        'units = { input = "V", velocity = "m/s" }\n'
    )
    arguments = [sys.executable, "-c", CHECK, str(tmp_path / "campaign.toml")]
    ended = subprocess.run(arguments, capture_output=True, text=True, check=True)
    exit_code, added = map(int, ended.stdout.split())
    assert exit_code == 0
    # Both channels, and of one of them spectrum, magnitude, window and what its checks compare:
    # 4.7 times their memory when this was written. It must not grow with the number of checks.
    assert added < 6 * 2 * 8 * samples, f"{added / 2**30:.1f} GiB"
