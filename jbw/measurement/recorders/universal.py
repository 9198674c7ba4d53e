"""Universal files (data set 58) of Testlab, Pulse, PSV, SO Analyzer, SignalCalc, DATS and others.

Files: .uff, .unv
Recognised by: the format itself; data set 151 names the program
Names: the first line of identification; if that is empty, the label of the ordinate
Units: the label of the ordinate's unit, or the specific data type and data set 164
Rate: the spacing of the abscissa
Start: the minimum of the abscissa
Based on: SDRC's description of the data sets 58, 151 and 164, read by pyuff
Untested: waterfalls, and shapes of data set 55
"""

from dataclasses import replace

from jbw.measurement.files.tree import Contents
from jbw.measurement.recorders.recorder import Recorder


def read(contents: Contents) -> Contents:
    """Return the data sets as read, and the name of the program that wrote the file."""
    program = str(contents.attributes.get("program", ""))
    return replace(contents, notes={**contents.notes, "program": program or "not stated"})


RECORDER = Recorder("Universal file 58", read=read, is_general=True, readers=("UFF 58",))
