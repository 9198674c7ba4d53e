"""NI TDMS, as LabVIEW, FlexLogger, DIAdem and other programs write it.

Files: .tdms
Recognised by: the format itself
Names: the names of the channels, or `NI_ChannelName`
Units: `unit_string`, `NI_UnitDescription`, or `unit`
Rate: `wf_increment`, or a channel that contains the times
Start: `wf_start_time` and `wf_start_offset`
Based on: NI's description of the TDMS internal format, read by npTDMS
Untested: files of DAQmx raw data with scales other than linear
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from jbw.measurement.files.tree import Contents, Leaf
from jbw.measurement.recorders.recorder import Recorder, is_time, top


def _channels(root: Any) -> Iterator[tuple[str, Leaf]]:
    for group, channels in root.items() if isinstance(root, Mapping) else ():
        for name, item in channels.items():
            if isinstance(item, Leaf):
                yield f"{group}.{name}", item


def read(contents: Contents) -> Contents:
    """Return the channels of a TDMS file, without times if the channels state their own rate."""
    series = dict(_channels(top(contents)))
    timed = [name for name, item in series.items() if item.fs]
    channels = {n: x for n, x in series.items() if not (timed and is_time(n.rpartition(".")[2]))}
    return replace(contents, series=channels)


RECORDER = Recorder("NI TDMS", read=read, is_general=True, readers=("TDMS",))
