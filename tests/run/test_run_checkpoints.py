"""Checkpoints: two generations, found whole or not used."""

import errno
import os
import warnings

import numpy as np
import pytest

from jbw.errors import RunError
from jbw.run import checkpoints, files
from jbw.run.checkpoints import Checkpoint, Interruption, pack, unpack


def arrays(n):
    return {"state/0": np.arange(n, dtype=np.uint32), "theta/gamma": np.full((2, n), 1 / 3)}


@pytest.fixture
def saved(tmp_path):
    """A folder with the generations 4 and 5 of a checkpoint."""
    checkpoint = Checkpoint(tmp_path, "joint", Interruption())
    for n in range(1, 6):
        checkpoint.save(arrays(n), last=False)
    return tmp_path


def loaded(folder):
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        arrays_loaded = Checkpoint(folder, "joint", Interruption()).load()
    size = None if arrays_loaded is None else arrays_loaded["state/0"].size
    return size, " ".join(str(warning.message) for warning in warned)


def newest(folder):
    paths = sorted(folder.glob("*.checkpoint"))
    return max(paths, key=lambda path: unpack(path.read_bytes())[0])


def test_the_newest_of_two_generations_is_loaded(saved):
    assert len(list(saved.iterdir())) == 2
    assert loaded(saved) == (5, "")
    arrays_loaded = Checkpoint(saved, "joint", Interruption()).load()
    np.testing.assert_array_equal(arrays_loaded["theta/gamma"], arrays(5)["theta/gamma"])
    assert arrays_loaded["state/0"].dtype == np.uint32
    assert loaded(saved / "..") == (None, "")


@pytest.mark.fault(44)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_torn_checkpoint_falls_back_one_generation(saved, share):
    path = newest(saved)
    intact = path.read_bytes()
    path.write_bytes(intact[: int(share * len(intact))])
    size, warning = loaded(saved)
    assert size == 4
    assert "joint" in warning
    assert "the previous checkpoint is used" in warning


@pytest.mark.fault(44)
def test_a_changed_byte_anywhere_is_noticed():
    intact = pack(7, arrays(3))
    assert unpack(intact)[0] == 7
    for i in range(len(intact)):
        changed = bytearray(intact)
        changed[i] ^= 1
        assert unpack(bytes(changed)) is None


@pytest.mark.fault(44)
def test_two_damaged_checkpoints_start_the_chains_again(saved):
    for path in saved.iterdir():
        path.write_bytes(b"junk")
    size, warning = loaded(saved)
    assert size is None
    assert "its chains start again" in warning


def test_saving_goes_on_over_the_damaged_generation(saved):
    damaged = newest(saved)
    damaged.write_bytes(b"junk")
    checkpoint = Checkpoint(saved, "joint", Interruption())
    with pytest.warns(UserWarning, match="damaged"):
        checkpoint.load()
    checkpoint.save(arrays(9), last=False)
    assert loaded(saved) == (9, "")


def test_pickled_arrays_are_neither_written_nor_read(tmp_path):
    with pytest.raises(ValueError, match=r"[Oo]bject arrays"):
        pack(0, {"x": np.array([{}], dtype=object)})


@pytest.mark.fault(42)
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_full_disk_is_said_and_leaves_what_was_saved(saved, monkeypatch, call):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    checkpoint = Checkpoint(saved, "joint", Interruption())
    checkpoint.load()
    monkeypatch.setattr(files.os, call, full)
    with pytest.raises(RunError, match="No space left") as caught:
        checkpoint.save(arrays(6), last=False)
    monkeypatch.undo()
    assert str(saved) in caught.value.what
    assert "jbw resume" in caught.value.remedy
    assert len(list(saved.iterdir())) == 2
    assert loaded(saved) == (5, "")


def test_saving_takes_a_small_share_of_the_time(tmp_path, monkeypatch):
    checkpoint, now = Checkpoint(tmp_path, "joint", Interruption()), [0.0]
    monkeypatch.setattr(checkpoints, "perf_counter", lambda: now[0])
    monkeypatch.setattr(checkpoints, "write_whole", lambda *_: now.__setitem__(0, now[0] + 1.0))
    checkpoint.save(arrays(1), last=False)  # takes one second
    now[0] += 0.9 / checkpoints.COST
    assert not checkpoint.due()
    now[0] += 0.2 / checkpoints.COST
    assert checkpoint.due()


@pytest.mark.fault(41)
def test_who_asked_to_stop_is_obeyed_after_a_saving(tmp_path):
    interruption = Interruption()
    checkpoint = Checkpoint(tmp_path, "joint", interruption)
    assert not checkpoint.due()
    interruption._ask(2, None)  # chains are growing: nothing is raised yet
    assert checkpoint.due()
    with pytest.raises(KeyboardInterrupt):
        checkpoint.save(arrays(2), last=False)
    assert loaded(tmp_path) == (2, "")
    with pytest.raises(KeyboardInterrupt):
        Interruption()._ask(2, None)  # nothing is growing: at once
