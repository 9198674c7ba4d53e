"""Recognition of kinds of test from samples or tables, and of matrices next to the records."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.stats import spearmanr

from jbw.assembly.files.read import READERS, read_matrices, role_of
from jbw.campaign.document import toml
from jbw.campaign.roles import MOST_SAMPLES, Channel
from jbw.errors import JbwError
from jbw.measurement.channels import Reals
from jbw.measurement.faults.responses import LOCKED
from jbw.measurement.files.read import opened
from jbw.measurement.files.tree import Leaf, load, names
from jbw.measurement.records import INPUTS, RESPONSES, si_of
from jbw.report.messages import draft as messages

PARTS = 16  # number of sections into which a record is divided; each has a spectrum
LEAST = 64  # smallest number of samples in a section
# In a tone's section, more than this fraction of the power is near the strongest spectral line.
ONE_LINE = 0.9
# In a section of noise, less than this fraction of the power is near the strongest spectral line.
NO_LINE = 0.35
# largest ratio of amplitudes between sections of a steady tone, without the first quarter
STEADY = 1.2
FALLS = 0.5  # largest rms of a decay's last quarter, relative to the strongest quarter
# smallest shift of the strongest spectral line during a sweep, as a multiple of the line spacing
MOVES = 3
FEWEST = 4  # smallest number of points of a response curve in a table
FOLLOWS = 0.9  # smallest rank correlation between amplitude and frequency or force along a backbone
GROWS = 2.0  # smallest ratio of the largest to the smallest amplitude or force along a backbone
SHIFTS = 0.3  # largest relative range of frequency along a backbone
SAME = 1e-6  # largest relative change of a frequency that counts as constant
# suffixes of files that contain all matrices and nothing else
HELD_TOGETHER = (".pch", ".dmig", ".op4")
HELD_WITH_NAMES = (".mat", ".npz")  # suffixes of files that contain either all matrices or records
TEXTS = (".csv", ".txt", ".dat")
# column names in tables of degrees of freedom and of nodes; a table has one of these sets
TABLES = {"dofs": ({"node"}, {"direction", "dof", "dir"}), "nodes": ({"node"}, {"x"}, {"y"}, {"z"})}
BEGINNING = 256  # number of characters at a text's start that contain its header


MatrixFiles = str | dict[str, str]  # a file or several files, in the form that [structure] uses


def course_of(x: Reals) -> Literal["tones", "noise", "sweep"] | None:
    """Return whether a source is a steady tone, noise or a sweep; None if this is unclear."""
    x = x[np.isfinite(x)]
    size = len(x) // PARTS
    if size < LEAST or not np.ptp(x):
        return None
    parts = x[: size * PARTS].reshape(PARTS, size)
    parts = parts - parts.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(parts * np.hanning(size), axis=1)) ** 2
    heard = power.sum(axis=1) > 1e-4 * power.sum(axis=1).max()
    peaks = power.argmax(axis=1)
    line_power = [row[max(at - 2, 0) : at + 3].sum() for row, at in zip(power, peaks, strict=True)]
    share = np.array(line_power)[heard] / power.sum(axis=1)[heard]
    if np.median(share) < NO_LINE:
        return "noise"
    line_bins = peaks[heard]
    rms = parts.std(axis=1)[PARTS // 4 :]
    if np.all(share > ONE_LINE) and np.ptp(line_bins) <= 1 and rms.max() < STEADY * rms.min():
        return "tones"
    steps = np.diff(line_bins)
    one_way = max(np.sum(steps >= 0), np.sum(steps <= 0)) >= 0.8 * len(steps)
    return "sweep" if np.ptp(line_bins) >= MOVES and one_way else None


def falls(x: Reals) -> bool:
    """Return whether samples decay: the last quarter's rms is below half of the largest one."""
    x = x[np.isfinite(x)]
    if len(x) < 8:
        return False
    x = x - x.mean()
    rms = [float(part.std()) for part in np.array_split(x, 4)]
    return rms[-1] < FALLS * max(rms)


def controlled_kind(roles: Mapping[str, Channel], series: Mapping[str, Leaf]) -> str:
    """Return the kind of test of a table of frequencies and amplitudes; an empty text if unclear.

    A constant phase indicates a backbone, as do a frequency and a force that change with the
    amplitude. Frequencies that are constant or go back indicate points of S-curves or of folded
    curves.
    """
    response = next((role for role in RESPONSES if role in roles), "")
    source = next((role for role in INPUTS if role in roles), "")
    if not response or "frequency" not in roles or "time" in roles:
        return ""
    columns = {role: _column(roles[role], series) for role in roles}
    hz, y, force = columns["frequency"], columns[response], columns.get(source)
    columns_read = [x for x in (hz, y, force) if x is not None]
    if hz is None or y is None or len({len(x) for x in columns_read}) > 1 or len(hz) < FEWEST:
        return ""
    if not all(np.all(x > 0) for x in columns_read):
        return ""
    phase = columns.get("phase")
    steps = np.diff(hz)
    goes_back = np.any(steps > SAME * hz.max()) and np.any(steps < -SAME * hz.max())
    stays = np.mean(np.abs(steps) < SAME * hz.max()) > 0.5
    if phase is not None:
        radians = np.unwrap(phase * si_of("phase", roles["phase"].unit or "rad")[0])
        if np.ptp(radians) < LOCKED and not stays:
            return "backbone"
        return "curve" if goes_back or stays else ""
    if force is not None and stays:
        return "curve"
    driven = y if force is None else force
    if y.max() < GROWS * y.min() or driven.max() < GROWS * driven.min():
        return ""
    together = float(np.asarray(spearmanr(y, hz if force is None else force))[0])
    shifts = 0 < np.ptp(hz) < SHIFTS * hz.max()
    return "backbone" if shifts and abs(together) > FOLLOWS else ""


def _column(channel: Channel, series: Mapping[str, Leaf]) -> Reals | None:
    """Return a column of finite real numbers; None if it has other values or too many."""
    leaf = series.get(channel.path)
    if leaf is None or max(leaf.shape, default=0) > MOST_SAMPLES:
        return None
    values = np.ravel(np.asarray(load(leaf)))
    if np.iscomplexobj(values) or not np.issubdtype(values.dtype, np.number):
        return None
    finite = values.astype(float)
    return finite if np.isfinite(finite).all() else None


def model_files(files: Sequence[Path]) -> tuple[MatrixFiles, Sequence[Path]] | None:
    """Return the files of a model, with mass and stiffness in one file or two; empty if none.

    Matrices in separate files are recognised by the names of the files, and the tables of degrees
    of freedom and of nodes next to them by their columns.
    """
    if (whole := next(filter(_holds_model, files), None)) is not None:
        return whole.name, (whole,)
    parts = {role: path for path in files if (role := _role_of_file(path))}
    if not {"mass", "stiffness"} <= set(parts):
        return None
    return {role: path.name for role, path in parts.items()}, tuple(parts.values())


def structure_lines(stated: MatrixFiles, folder: Path) -> Iterator[str]:
    """Yield the tables [structure] and [[joint]] as comments; the user adds where joints act."""
    source: str | Path | Mapping[str, Path]
    if isinstance(stated, str):
        source = folder / stated
    else:
        source = {role: folder / name for role, name in stated.items()}
    places: list[str] = []
    with suppress(JbwError):  # `jbw check` reports the cause.
        places = [str(dof) for dof in read_matrices(source, units="SI").dofs]
    first = places[0] if places else messages.EXAMPLE_PLACES[0]
    others = (place for place in reversed(places) if place.endswith(first[first.index(":") :]))
    last = next(others, messages.EXAMPLE_PLACES[1])
    written = toml(first), toml({"tip": last}), toml([first, last])
    for line in messages.structure(toml(stated), places, written).splitlines():
        yield f"# {line}"


def _holds_model(path: Path) -> bool:
    """Return whether the names of a file's arrays include those of mass and stiffness."""
    suffix = path.suffix.lower()
    if suffix in HELD_TOGETHER:
        return True
    if suffix in HELD_WITH_NAMES:
        with suppress(JbwError), opened(path) as contents:
            return {"mass", "stiffness"} <= {role_of(name) for name, _ in names(contents.root)}
    return False


def _role_of_file(path: Path) -> str:
    """Return which matrix or table a file contains, from its name (`K.mtx`) or its columns."""
    suffix = path.suffix.lower()
    if suffix in READERS and suffix not in HELD_TOGETHER:
        words = (word.rstrip("0123456789") for word in re.split(r"[\W_]+", path.stem))
        return next((role for word in words if (role := role_of(word))), "")
    if suffix not in TEXTS:
        return ""
    with suppress(OSError), path.open(encoding="utf-8-sig", errors="replace") as text:
        header = set(re.split(r"[^a-z]+", text.read(BEGINNING).lower().partition("\n")[0]))
        return next((t for t, columns in TABLES.items() if all(header & c for c in columns)), "")
    return ""
