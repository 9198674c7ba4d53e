"""WAV of Head acoustics, Dantec, Prosig, and of sound cards.

Files: .wav
Recognised by: the format itself
Names: the numbers of the channels
Units: none: full scale is 1, and `scale` of the campaign says what that is
Rate: the format's own
Start: none
Based on: Microsoft's and IBM's description of RIFF WAVE, read by SciPy
Untested: calibrations in chunks of a maker's own
"""

from dataclasses import replace

from jbw.measurement.files.tree import Contents
from jbw.measurement.recorders.recorder import Recorder


def read(contents: Contents) -> Contents:
    """Return the contents unchanged, because the WAV reader has found everything."""
    return replace(contents)


RECORDER = Recorder("WAV", lambda contents: contents.reader == "WAV", read, is_general=True)
