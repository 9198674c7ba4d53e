"""Text tables of Polytec, m+p, HBM catman, Head acoustics, Dantec, Prosig, Data Physics and others.

Files: .csv, .txt, .tsv, .dat, .asc
Recognised by: a table of numbers that no other entry of this list recognises
Names: the last line above the table that has as many names as it has columns
Units: after the names, in brackets, in parentheses or after a comma; or in a separate row
Rate: a column of times; otherwise a line such as `Sample rate: 1000 Hz` or `Interval;0.001 s`
Start: the first time
Based on: common knowledge of the layout, not checked against a file or a description; for catman
also public scripts, with titles such as `Time 1 - default sample rate [s]`
Untested: files that these programs wrote; catman's text with 29 lines of properties of each column,
the first of which contains the names: jbw asks for names, units and rate
"""

from dataclasses import replace

from jbw.measurement.files.tree import Contents
from jbw.measurement.recorders.recorder import Recorder


def read(contents: Contents) -> Contents:
    """Return the contents unchanged, because the text reader has found everything."""
    return replace(contents)


RECORDER = Recorder("plain text", read=read, is_general=True, readers=("CSV",))
