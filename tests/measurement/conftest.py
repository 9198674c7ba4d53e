"""The files from which several tests of the readers start."""

import pytest
from tone_file import DRIVE, FS, LASER, ROLES, UNITS

from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.records import Record


@pytest.fixture
def h5(tmp_path):
    path = tmp_path / "sweep.h5"
    record = Record(FS, {"input": DRIVE, "velocity": LASER}, UNITS, "sweep")
    write_hdf5(path, record, names=ROLES)
    return path
