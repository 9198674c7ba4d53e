"""WAV of Head acoustics, Dantec, Prosig, and of sound cards.

Files: .wav
Recognised by: the format itself
Names: the channel numbers
Units: none: the largest value is 1, and `scale` of the campaign states its meaning
Rate: the rate in the file's header
Start: none
Based on: Microsoft's and IBM's description of RIFF WAVE, read by SciPy
Untested: calibrations in chunks that only one manufacturer uses
"""

from dataclasses import replace

from jbw.measurement.files.tree import Contents
from jbw.measurement.recorders.recorder import Recorder


def read(contents: Contents) -> Contents:
    """Return the contents unchanged, because the WAV reader already supplies rate and channels."""
    return replace(contents)


RECORDER = Recorder("WAV", read=read, is_general=True, readers=("WAV",))
