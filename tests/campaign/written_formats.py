"""A record in every format that laboratories use, written by each format's own library."""

from dataclasses import dataclass, field

import h5py
import numpy as np
import scipy.io
import scipy.io.wavfile

FULL_SCALE = {"force": 32.0, "velocity": 2.0, "displacement": 1 / 64, "restoring_force": 512.0}


@dataclass(frozen=True)
class Format:
    """One file format, and the function that writes a record in it.

    Attributes:
        suffix: Suffix of the file.
        write: Function write(path, record).
        path: Path of a role's channel in the file; `{role}`, `{i}` and `{n}` are filled in.
        rtol: Relative rounding error of a sample in the format.
        curves: Whether the format can store a response curve, which has no time.
        keys: Additional keys of the campaign's test.
    """

    suffix: str
    write: object
    path: str = "{role}"
    rtol: float = 0.0
    curves: bool = True
    keys: dict = field(default_factory=dict)

    def channels(self, record):
        """Return the path in the file of each role."""
        return {role: self.path.format(role=role, i=i) for i, role in enumerate(record.channels)}


def npz(path, record):
    """Write the channels as arrays by name."""
    np.savez(path, **record.channels)


def mat_5(path, record):
    """Write a struct, as `save` of MATLAB before -v7.3 does."""
    scipy.io.savemat(path, {"run": {"data": dict(record.channels)}}, do_compression=True)


def mat_73(path, record):
    """Write HDF5 after MATLAB's own header, with rows and columns swapped."""
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("run")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for role, samples in record.channels.items():
            item = group.create_dataset(role, data=samples[None, :])
            item.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def csv(path, record, digits=17, separator=",", comma=False):
    """Write a header of names, then rows that begin with the time, or with a curve's frequency."""
    columns = dict(record.channels)
    if np.isfinite(record.fs):
        columns = {"time": np.arange(record.num_samples) / record.fs, **columns}
    rows = np.column_stack(list(columns.values()))
    text = "\n".join(separator.join(f"{x:.{digits}g}" for x in row) for row in rows)
    text = text.replace(".", ",") if comma else text
    path.write_text(separator.join(columns) + "\n" + text + "\n")


def csv_of_europe(path, record):
    """Write decimal commas between semicolons, with nine digits."""
    csv(path, record, digits=9, separator=";", comma=True)


def wav(path, record):
    """Write 32-bit integers, scaled by a power of two so that a converter's 24 bits survive."""
    parts = [samples / FULL_SCALE[role] for role, samples in record.channels.items()]
    whole = np.rint(np.stack(parts, axis=1) * 2.0**31).astype(np.int32)
    scipy.io.wavfile.write(path, round(record.fs), whole)


def uff(path, record):
    """Write one binary set of type 58 per channel, through pyuff."""
    pyuff = __import__("pyuff")
    file = pyuff.UFF(str(path))
    for role, samples in record.channels.items():
        labels = {"abscissa_axis_units_lab": "s", "ordinate_axis_units_lab": record.units[role]}
        places = {"rsp_node": 1, "rsp_dir": 1, "ref_node": 1, "ref_dir": 1}
        file.write_sets(
            {
                "type": 58, "func_type": 1, "binary": 1, "id1": role, "abscissa_spacing": 1,
                "orddenom_spec_data_type": 0, "data": samples,
                "x": np.arange(samples.size) / record.fs, **labels, **places,
            },
            mode="add",
        )  # fmt: skip


def tdms(path, record):
    """Write the channels of a group, with the time step of their waveform."""
    nptdms = __import__("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        for role, samples in record.channels.items():
            step = {} if np.isnan(record.fs) else {"wf_increment": 1 / record.fs}
            found = {**step, "unit_string": record.units[role]}
            writer.write_segment([nptdms.ChannelObject("Log", role, samples, found)])


FORMATS = {
    "npz": Format(".npz", npz),
    "mat v5": Format(".mat", mat_5, "run.data.{role}"),
    "mat v7.3": Format(".mat", mat_73, "run.{role}"),
    "csv": Format(".csv", csv),
    "csv of Europe": Format(".csv", csv_of_europe, rtol=5e-9),
    "wav": Format(".wav", wav, "channel[{i}]", curves=False),
    "uff": Format(".uff", uff, curves=False),
    "tdms": Format(".tdms", tdms, "Log.{role}"),
}
