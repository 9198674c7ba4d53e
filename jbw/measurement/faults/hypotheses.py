"""The list of all kinds of fault, and the search for those that a record has."""

from collections.abc import Iterator

from jbw.measurement.faults.clipping import Clipping, Offset
from jbw.measurement.faults.drop_off import DropOff
from jbw.measurement.faults.fault import Fault, doubt, refusal
from jbw.measurement.faults.hypothesis import (
    UNEXPLAINED,
    UNEXPLAINED_SHARE,
    Facts,
    Fits,
    Hypothesis,
    named_cause,
    remainder,
)
from jbw.measurement.faults.lag import ClocksApart, Delay, LostBlock
from jbw.measurement.faults.loop_hypotheses import HighPass, Slip, Wear, ZeroOfLoadCell
from jbw.measurement.faults.plausibility import SwappedChannels
from jbw.measurement.faults.second_mode import OutsideModes, SecondMode
from jbw.measurement.faults.steady_line import UndecayingLine
from jbw.measurement.faults.unlike_gains import OwnFrequencies, UnlikeGain
from jbw.measurement.faults.window import SecondBlow, Window
from jbw.measurement.readings.sweep import SweepFits
from jbw.report.messages import decay_faults as messages

# Kinds of fault that are fitted together with a mode, in order of their number of parameters.
HYPOTHESES: tuple[Hypothesis, ...] = (
    Delay(), ClocksApart(), UndecayingLine(), SecondBlow(), LostBlock(), SecondMode(),
    Window(), DropOff(), HighPass(), Wear(), Slip(), ZeroOfLoadCell(),
    UnlikeGain(), Offset(), Clipping(), SwappedChannels(), OutsideModes(), OwnFrequencies(),
)  # fmt: skip


def explained(fits: Fits, facts: Facts) -> Iterator[Fault]:
    """Yield the faults that a fitted mode shows, and the fault that best explains the residual."""
    yield from (seen := [fault for one in HYPOTHESES for fault in one.seen(fits, facts)])
    # Noise of the drive biases the damping, but leaves no residual that a fault could explain.
    if isinstance(fits, SweepFits) and seen:
        return
    left = remainder(fits)
    if left.is_noise and not left.has_line:
        return
    named = named_cause(fits, (UndecayingLine(),) if left.is_noise else HYPOTHESES)
    if named is not None:
        hypothesis, values, mode = named
        severity = refusal if hypothesis.spoils(values, fits) else doubt
        text = hypothesis.fault(values, fits, facts._replace(mode=mode))
        yield severity(facts.record.response, *text, leaves=mode)
    elif left.rms > UNEXPLAINED and left.share > UNEXPLAINED_SHARE:
        yield doubt(facts.record.response, *messages.unexplained(left.share))
