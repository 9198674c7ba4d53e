"""A universal file of time records, for tests of its reader."""

import numpy as np
import pytest


def write_uff(path, record, binary=False):
    """Write one set of type 58 per channel, with every field that pyuff needs."""
    pyuff = pytest.importorskip("pyuff")
    time = np.arange(record.num_samples) / record.fs
    for role, samples in record.channels.items():
        fields = {
            "type": 58, "func_type": 1, "binary": int(binary), "id1": role, "rsp_node": 1,
            "rsp_dir": 1, "ref_node": 1, "ref_dir": 1, "abscissa_spacing": 1,
            "abscissa_axis_units_lab": "s", "ordinate_axis_units_lab": record.units[role],
            "orddenom_spec_data_type": 0, "data": samples, "x": time,
        }  # fmt: skip
        # Only this mode writes binary sets completely.
        pyuff.UFF(str(path)).write_sets(fields, mode="add")
