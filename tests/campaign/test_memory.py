"""Records that memory cannot hold: one sentence with the size, the limit and what to do."""

import os
import subprocess
import sys
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from scipy.signal import bilinear, lfilter

from jbw import memory
from jbw.campaign.load import _followed, load_campaign
from jbw.cli import run
from jbw.errors import DataError

FS, BAND = 256.0, (14.0, 24.0)
SWEEP = """[campaign]
name = "long"
gain = 15.0
[joint]
laws = ["bouc_wen"]
[[test]]
kind = "sweep"
name = "sweep"
files = "sweep_*.h5"
level = 1.0
channels = { input = "input", velocity = "velocity" }
units = { input = "V", velocity = "m/s" }
fs = 256.0
"""
PEAK = """
import sys, warnings
from jbw.cli.progress import prepare_process
prepare_process()
warnings.simplefilter("ignore")
import jbw, numpy
from jbw.identification.joint import joint_problem
from jbw.inference.lanes import at_points
from jbw.observables.dataset import stacked
from jbw.study.prepared import prepare_tests
prepared = prepare_tests(jbw.load_campaign(sys.argv[1]), lambda _: None, 0)
problem = joint_problem(prepared.measured, {}, seed=0, report=lambda _: None)
points = numpy.linspace(0.999, 1.001, 11 * 11)
theta = dict(omega_n=118.0, zeta=0.01, alpha=500.0, delta=300.0, gamma=30.0)
# A fit from eleven starts asks for a point and two differences a parameter of each at once.
at_points(stacked, {name: value * points for name, value in theta.items()}, problem.data, lanes=16)
print(next(x for x in open("/proc/self/status") if x.startswith("VmHWM")).split()[1])
"""


def swept(folder, num_samples, repeats=1):
    """A campaign of sweeps through a linear mode at 18.8 Hz, by SciPy's filter."""
    t = np.arange(num_samples) / FS
    u = np.sin(2 * np.pi * (BAND[0] * t + (BAND[1] - BAND[0]) / 2 / t[-1] * t**2))
    omega = 2 * np.pi * 18.8
    v = lfilter(*bilinear([15.0, 0.0], [1.0, 0.02 * omega, omega**2], FS), u)
    for i in range(repeats):
        noise = 1e-3 * np.random.default_rng(i).standard_normal(num_samples)
        with h5py.File(folder / f"sweep_{i}.h5", "w") as file:
            file["input"], file["velocity"] = u, v + noise
    path = folder / "campaign.toml"
    path.write_text(SWEEP)
    return path


def test_records_beyond_the_memory_are_refused_as_soon_as_they_are_too_many(tmp_path, monkeypatch):
    path = swept(tmp_path, 4_096, repeats=2)
    of_one = memory.NO_RECORDS.begun(2).beside(4_096, 2).needed
    monkeypatch.setattr(memory, "most_memory", lambda: of_one + 4_096)
    with pytest.raises(DataError, match=r"up to sweep_1.h5 need about 0") as told:
        load_campaign(path)
    assert "`span = [first, last]`" in told.value.remedy
    assert "`resample = RATE`" in told.value.remedy
    for line in ("span = [0.0, 8.0]", "resample = 128.0"):
        path.write_text(SWEEP.replace("fs = 256.0", f"fs = 256.0\n{line}"))
        assert len(load_campaign(path).tests[0].records) == 2


@pytest.mark.fault(50)
def test_a_record_that_memory_cannot_hold_is_refused_before_it_is_read(tmp_path, monkeypatch):
    path = tmp_path / "campaign.toml"
    path.write_text(SWEEP)
    with h5py.File(tmp_path / "sweep_0.h5", "w") as file:  # 400 million samples of no bytes
        for name in ("input", "velocity"):
            file.create_dataset(name, (400_000_000,), "f8", chunks=(2**16,))
    monkeypatch.setattr(memory, "most_memory", lambda: 2.0**35)
    monkeypatch.setattr("jbw.measurement.files.tree.load", lambda *_: pytest.fail("read"))
    # 400e6 x (2 channels x 8 + 100 + 200 + 330 of the mode and as much of the joint) bytes, and
    # 0.95e9 of the process
    told = r"up to sweep_0.h5 need about 364.5 GiB, but this process may use 32.0 GiB"
    with pytest.raises(DataError, match=told):
        load_campaign(path)


@pytest.mark.skipif(sys.platform == "win32", reason="no such limits on this system")
@pytest.mark.fault(50)
def test_the_limit_is_the_least_of_machine_container_and_address_space(tmp_path, monkeypatch):
    container = tmp_path / "memory.max"
    container.write_text(f"{2**28}\n")
    monkeypatch.setattr(memory, "CONTAINER", (container,))
    assert memory.most_memory() == 2**28
    container.write_text("max\n")
    machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert memory.most_memory() <= machine
    limited = "import resource as r; r.setrlimit(r.RLIMIT_AS, (2**31, 2**31))"
    code = f"{limited}; from jbw.memory import most_memory; print(most_memory())"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(told.stdout) <= 2**31


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("RESOURCE_EXHAUSTED: 7 GB")])
def test_memory_that_is_exhausted_is_no_internal_error(tmp_path, monkeypatch, capsys, error):
    path = swept(tmp_path, 4096)

    def exhausted(*_, **__):
        raise error

    monkeypatch.setattr("jbw.campaign.load.load_campaign", exhausted)
    assert run(["identifiability", str(path)]) == 1
    said = capsys.readouterr().err
    assert "The memory that this process may use" in said
    assert "`resample = RATE`" in said
    assert "Internal error" not in said


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
@pytest.mark.slow
def test_the_estimate_is_the_peak_of_a_process_that_fits(tmp_path):
    """The reference is what the system counts; libraries of other versions begin at other sizes."""
    path = swept(tmp_path, 500_000)
    ended = subprocess.run(
        [sys.executable, "-c", PEAK, str(path)], capture_output=True, text=True, check=True
    )
    peak = 1024 * float(ended.stdout.split()[-1])
    assert 0.65 < memory.NO_RECORDS.begun(2).beside(500_000, 2).needed / peak < 1.5


@pytest.mark.parametrize(
    ("kind", "structure", "size"),
    [("noise", (), 0), ("decay", (), 0), ("sweep", (), 2), ("sweep", (1, 2, 3), 4)],
)
def test_modes_and_joints_count_where_a_solver_follows_them(kind, structure, size):
    spec = SimpleNamespace(structure=SimpleNamespace(modes=structure) if structure else None)
    assert _followed(SimpleNamespace(kind=kind), spec, None) == size
    joints = SimpleNamespace(model=SimpleNamespace(H=np.zeros((2, 5))))
    assert _followed(SimpleNamespace(kind=kind), spec, joints) == (7 if size else 0)
