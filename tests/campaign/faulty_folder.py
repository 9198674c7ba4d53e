"""A folder of records with one fault of each kind, and the required answers of `jbw check`.

The rows are numbered as in the project's list of bad inputs: 1-24 are faults of records, 46-54 of
files. Every fault is one test of one campaign, named by its row.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from faulty_records import (
    FS,
    GAIN,
    N,
    bomb,
    decimal_comma,
    drive,
    flipped_exponent,
    good,
    huge,
    in_g,
    lengths,
    lightly_damped,
    linked_out,
    matlab73,
    matlab_table,
    noise,
    one_column,
    pickled,
    renamed,
    repeat,
    respond,
    rounded_interval,
    settling,
    spoilt,
    swap,
    timed,
    tone,
    tones,
    truncated,
    two_rates,
    with_nan,
)


@dataclass(frozen=True)
class Fault:
    """One fault: how to write it, and the required answer of the check.

    Attributes:
        row: Row in the list of bad inputs, and the fault.
        write: Function that writes the files into a folder and returns the keys of the [[test]]
            table.
        status: Required status: ok, warning or error.
        says: Text that the message must contain.
        remedy: Text that the remedy must contain.
        role: Channel to which the message must belong; empty for any.
    """

    row: str
    write: Callable[[Path], dict]
    status: str = "error"
    says: str = ""
    remedy: str = ""
    role: str = ""


BAND = [30.0, 50.0]
# The modal mass from the response lacks 5 % of its integral outside the evaluated lines, so that
# factors of 1000 and 9.81 are read as 949 and 1 / 0.0968.
FAULTS = (
    Fault("0: nothing", noise(good(), ".h5", band=BAND), "ok"),
    Fault("1: one NaN", spoilt("velocity", with_nan(1)), "error", f"1 of {N}", "span", "velocity"),
    Fault("1: 1 % NaN", spoilt("velocity", with_nan(164)), "error", "164 of", "span", "velocity"),
    Fault("1: all NaN", spoilt("velocity", with_nan(N)), "error", "first at 7", "", "velocity"),
    Fault("2: dead", spoilt("velocity", lambda x: x * 0), "error", "constant at 0", "right channel",
          "velocity"),
    Fault("2: dead but for one bit", spoilt("velocity", lambda x: 0.3 + (np.arange(N) % 2) * 1e-7),
          "error", "within one bit", "right channel", "velocity"),
    Fault("3: no fs", noise(good(), fs=None), "error", "frequency is missing", "fs = HZ"),
    Fault("4: fs in rad/s", noise(good(), fs=FS * 2 * np.pi, band=BAND), "warning", "6.28 times",
          "Check `fs`", "velocity"),
    Fault("4: half the fs", noise(good(), fs=FS / 2, band=BAND), "warning", "0.5 times",
          "Check `fs`", "velocity"),
    Fault("4: 1000 for 1024 Hz", noise(good(), fs=1000.0, band=[39.8, 40.2]), "warning",
          "largest at 39.06 Hz", "Check `fs`", "velocity"),
    Fault("5: two rates", two_rates, "error", "1024 Hz and `velocity` is 2048 Hz", "resample"),
    Fault("6: rounded interval", rounded_interval, "ok"),
    Fault("7: time not sorted", timed(swap), "error", "sample 101", "span"),
    Fault("7: time repeated", timed(repeat), "error", "sample 101", "span"),
    Fault("8: gap", timed(lambda t: t + (t > 3.0) * 0.01), "error", "1 gap(s): 3-3.01", "span"),
    Fault("8: jitter", timed(lambda t: t + 0.02 / FS * np.sin(7.0 * np.arange(N))), "error",
          "must be evenly spaced within 0.001", "`resample = 1024`"),
    Fault("9: mm/s as m/s", noise({"input": drive() * 1e-2, "velocity": respond(drive()) * 10}),
          "warning", "949 times", "units of input and response", "velocity"),
    Fault("9: g as m/s^2", noise(in_g(), units={"input": "V", "acceleration": "m/s^2"}), "warning",
          "0.0968 times", "units of input and response", "acceleration"),
    Fault("9: mV as V", spoilt("input", lambda x: x * 1e3), "warning", "0.000949 times",
          "units of input and response", "velocity"),
    Fault("11: volts", noise(good()), "ok"),
    Fault("12: missing channel", renamed, "error", "`velocty` is not in the file",
          "Did you mean `velocity`"),
    Fault("13: swapped", noise({"input": respond(drive()), "velocity": drive()}), "warning",
          "more peaked", "which channel", "input"),
    Fault("13: polarity", spoilt("velocity", np.negative, band=BAND), "warning",
          "the gain is negative", "velocity = -1.0", "velocity"),
    Fault("14: lengths by one", spoilt("velocity", lambda x: x[:-1]), "error",
          f"`input` has {N}, `velocity` has {N - 1}", "together"),
    Fault("14: half as long", spoilt("velocity", lambda x: x[: N // 2]), "error",
          f"`velocity` has {N // 2}", "together"),
    Fault("15: repeats of three lengths", lengths, "ok"),
    Fault("16: clipped", spoilt("velocity", lambda x: np.clip(x, -0.5 * x.max(), 0.5 * x.max())),
          "error", "% of the samples are clipped, at", "a larger range", "velocity"),
    Fault("17: few bits", spoilt("velocity", lambda x: np.round(x / x.max() * 100) * x.max() / 100),
          "warning", "distinct values, fewer than 256", "smaller range", "velocity"),
    Fault("18: short noise", noise({r: x[:512] for r, x in good().items()}), "warning",
          "the resolution of a record of 0.5 s", "Measure longer: a record of 2 s", "velocity"),
    Fault("18: short tone", tones({r: x[:300] for r, x in tone().items()}), "error",
          "must last 0.3976 s", "Measure longer", "displacement"),
    Fault("19: transient", tones(settling()), "warning", "the amplitude changes by", "settle",
          "displacement"),
    Fault("20: tone off the lines", tones(tone()), "ok"),
    Fault("21: third harmonic folds", tones({r: x[::34] for r, x in tone(5.5).items()}, (5.5,),
          FS / 34), "error", "must lie below a third", "higher sampling", "displacement"),
    Fault("22: buried harmonic", tones(tone(noise=1e-3, seed=1)), "warning",
          "does not exceed the noise", "Raise the level", "displacement"),
    Fault("23: incoherent", spoilt("velocity", lambda x: x + 0.5 * x.std() * drive(9)), "warning",
          "coherence with the input is", "narrow `band`", "velocity"),
    Fault("24: damping unresolved", noise(lightly_damped()), "warning",
          "than the resolution of a record of 16 s", "Measure longer", "velocity"),
    Fault("46: half an .h5", truncated(".h5"), "error", "cannot be read by the hdf5", "again"),
    Fault("46: half an .npz", truncated(".npz"), "error", "cannot be read by the npz", "again"),
    Fault("46: flipped exponent", flipped_exponent, "error", "Sample 40 is 4e+284", "again",
          "velocity"),
    Fault("47: MATLAB v7.3", matlab73, "ok"),
    Fault("48: MATLAB table", matlab_table, "error", "is a MATLAB table", "table2array"),
    Fault("49: decimal comma", decimal_comma, "ok"),
    Fault("49: one column", one_column, "error", "one column with a decimal comma", "semicolon"),
    Fault("50: larger than memory", huge, "error", "GiB", "span"),
    Fault("51: pickle", pickled, "error", "is a pickle", "savez"),
    Fault("54: link out of the file", linked_out, "error", "is a link out", "h5copy"),
    Fault("54: bomb", bomb, "error", "16.0 GiB", "span"),
)  # fmt: skip


def write_folder(folder: Path) -> Path:
    """Write every fault into a separate folder, and one campaign file for all."""
    blocks = [f'[campaign]\nname = "faults"\ngain = {GAIN}\n']
    for i, fault in enumerate(FAULTS):
        below = folder / f"{i:02d}"
        below.mkdir(parents=True)
        keys = fault.write(below)
        keys["files"] = f"{below.name}/{keys['files']}"
        lines = [f"{key} = {_toml(value)}" for key, value in {"name": fault.row, **keys}.items()]
        blocks.append("\n".join(["[[test]]", *lines, ""]))
    path = folder / "campaign.toml"
    path.write_text("\n".join(blocks), encoding="utf-8")
    return path


def _toml(value) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(float(value))
