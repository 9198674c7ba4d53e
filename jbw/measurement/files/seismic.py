"""MiniSEED and SAC files of seismic recorders, read by the optional package obspy."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jbw.errors import DataError
from jbw.measurement.files.tree import Contents, Leaf, Node, leaf, optional


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a file of traces, named by their identifiers; values are counts without a unit.

    Raises:
        DataError: A trace has gaps, which the format stores as separate pieces.
    """
    traces = optional("obspy", "seismic", path).read(str(path))
    names = [trace.id.strip(".") or f"trace {i}" for i, trace in enumerate(traces)]
    pieces = sorted({name for name in names if names.count(name) > 1})
    if pieces:
        raise DataError(
            f"File `{path.name}` contains trace {pieces[0]} in {names.count(pieces[0])} pieces, "
            "with gaps between the pieces.",
            why="Spectra and sampled inputs need evenly spaced samples.",
            remedy="Write each piece of the trace into a separate file.",
        )
    first = min(trace.stats.starttime for trace in traces)
    series: dict[str, Leaf] = {
        name: leaf(
            trace.data,
            fs=float(trace.stats.sampling_rate),
            start_s=float(trace.stats.starttime - first),
        )
        for name, trace in zip(names, traces, strict=True)
    }
    root: dict[str, Node] = dict(series)
    yield Contents(root, str(traces[0].stats.get("_format", "")) or "seismic", series=series)
