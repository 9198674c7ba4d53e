"""Tables of text of Polytec, m+p, HBM catman, Head acoustics, Dantec, Prosig, Data Physics, others.

Files: .csv, .txt, .tsv, .dat, .asc
Recognised by: a table of numbers, where no other recorder is known
Names: the last line above the table that has as many names as it has columns
Units: behind the names in brackets, parentheses, or after a comma; or a row of their own
Rate: a column of times; else a line such as `Sample rate: 1000 Hz` or `Interval;0.001 s`
Start: the first time
Based on: not checked against a file or a description; from common knowledge of the layout. For
    catman public scripts agree, with titles such as `Time  1 - default sample rate [s]`
Untested: files of the programs themselves; catman's text with 29 lines of properties of each
    column, whose first line names them: names, units and rate are asked for
"""

from dataclasses import replace

from jbw.measurement.files.tree import Contents
from jbw.measurement.recorders.recorder import Recorder


def read(contents: Contents) -> Contents:
    """Return the contents unchanged, because the text reader has found everything."""
    return replace(contents)


RECORDER = Recorder("plain text", lambda contents: contents.reader == "CSV", read, is_general=True)
