"""Faults of single channels, and of a source and its response: what, why and remedy."""

from jbw.report.messages.message import FaultText, number

UNORDERED = FaultText(
    "The frequencies must be positive, and either all rise or all fall.",
    remedy=(
        "Sort the lines of the measured FRF by frequency, and remove repeated lines and the "
        "line at 0 Hz."
    ),
)

FOLDED = FaultText(
    "The frequencies must either all rise or all fall, but they turn back, as along a curve "
    "that folds.",
    "Sorted points would mix the branches of the curve.",
    'Put under [[test]]: `kind = "curve"`, which keeps the points in the measured order.',
)


def unequal_lengths(lengths: str) -> FaultText:
    """Return the message that channels have different lengths."""
    return FaultText(
        f"Channels must have equal lengths, but their numbers of samples differ: {lengths}.",
        "To cut the longer channel, one would have to assume that both channels begin together.",
        "Export the channels together, or name channels that were sampled together.",
    )


def masked_or_left_out(leave_out: str) -> str:
    """Return the remedy for samples that are not finite: mask them or exclude the record."""
    return f'Put under [[test]]: `gaps = "mask"`, or {leave_out}.'


def not_finite(count: int, total: int, first: str, remedy: str) -> FaultText:
    """Return the message on samples that are not finite, with the first of them."""
    return FaultText(
        f"Samples must be finite numbers, but {count} of {total} are not; the first at {first}.",
        "Filling the gaps would invent data.",
        remedy,
    )


def masked(count: int, total: int) -> FaultText:
    """Return the message on samples that the campaign masks."""
    return FaultText(
        f'{count} of {total} samples are not finite; gaps = "mask" leaves these samples out of '
        "the fit.",
        remedy="Nothing is to be done if the gaps are intended.",
    )


def beyond_measurement(sample: int, largest: float) -> FaultText:
    """Return the message on a sample that no instrument measures."""
    return FaultText(
        f"Sample {sample} is {largest:.3g} in SI units, beyond any measurement.",
        "The file may be damaged, or the instrument writes a huge number for lost samples.",
        "Copy or export the file again, and check the unit.",
    )


def constant(value: float, leave_out: str, *, toggles: bool) -> FaultText:
    """Return the message that a channel is constant, perhaps except for its last bit."""
    return FaultText(
        f"The channel is constant at {value:.6g}" + (", to within one bit." if toggles else "."),
        "A dead sensor or an unconnected input gives a constant signal.",
        f"Name the right channel, or {leave_out}.",
    )


def few_levels(count: int, least: int) -> FaultText:
    """Return the message that a channel has only few distinct values."""
    return FaultText(
        f"The channel has only {count} distinct values, fewer than {least}.",
        f"With fewer than {least} values, quantisation errors are not like white noise.",
        "Measure with a smaller range, so that more bits are used.",
    )


def held(each: int, fs: float, lag_s: float | None) -> FaultText:
    """Return the message that each value is repeated for several samples.

    `lag_s` is the lag of the channel if the record has a drive to lag behind.
    """
    line = "" if lag_s is None else f", or put under [[test]]: `delay = {lag_s:.4g}`"
    return FaultText(
        f"Each value is repeated for {each} samples: the channel was recorded at {fs:.6g} Hz.",
        f"This channel lags by {_samples((each - 1) / 2)} behind channels that were recorded at "
        "the stated rate.",
        f"Export all channels at {fs:.6g} Hz{line}.",
    )


def _samples(count: float) -> str:
    return "1 sample" if count == 1 else f"{count:g} samples"


def dropped_out(count: int, first_s: float) -> FaultText:
    """Return the message that a signal has drop-outs."""
    return FaultText(
        f"The signal has drop-outs: at {count} places, first at {first_s:.4g} s, it falls to "
        "nearly zero for a few samples.",
        "A laser vibrometer that loses its signal, or a loose contact, causes drop-outs.",
        "Improve the focus or the surface and measure again, or bridge these samples before "
        "you export.",
    )


def implausible(role: str, largest: float, guess: str) -> FaultText:
    """Return the message on a motion that is too large for a bolted joint."""
    return FaultText(
        f"The largest {role} is {number(largest)} in SI units, more than a bolted joint survives.",
        remedy=f"Check the unit: is the file in {guess}?",
    )


def lost_samples(
    count: int, total: int, value: float, first_s: float, others: tuple[float, float], remedy: str
) -> FaultText:
    """Return the message on samples at the value that a logger writes for lost samples."""
    low, high = others
    return FaultText(
        f"{count} of {total} samples are {value:.6g} in SI units, the first at {first_s:.4g} s; "
        f"all other samples lie between {low:.3g} and {high:.3g}.",
        "Some loggers write a fixed number for every lost sample.",
        remedy,
    )


def clipped(
    share: float, where: str, remedy: str = "Leave the clipped part of the record out."
) -> FaultText:
    """Return the message on the fraction of clipped samples, and where they are."""
    return FaultText(
        f"{100 * share:.2g} % of the samples are clipped, {where}.",
        "A fit mistakes clipped peaks for softening and for harmonics.",
        f"{remedy} Otherwise measure with a larger range.",
    )


def stopped(end: float, keep: str) -> FaultText:
    """Return the message that a recorder was stopped before the end of its file."""
    return FaultText(
        f"The response is constant from {end:.4g} s to the end of the record.",
        "A stopped recorder fills its file with a constant value; a structure keeps ringing.",
        f"{keep}.",
    )


def gaps(stretches: str, count: int, remedy: str) -> FaultText:
    """Return the message on gaps that a recorder filled with its last value."""
    return FaultText(
        f"The response is constant at {stretches}, with motion before and after: "
        f"{'1 gap' if count == 1 else f'{count} gaps'}.",
        "A recorder that lost samples fills the gaps with its last value.",
        remedy,
    )


def swapped(of: str = "", ratio: float | None = None) -> FaultText:
    """Return the message that input and response seem to be exchanged."""
    peaked = (
        ""
        if ratio is None
        else f": the spectrum of the input is {ratio:.3g} times more peaked than the spectrum of "
        "the response"
    )
    return FaultText(
        f"Input and response{of} seem to be swapped{peaked}.",
        "A resonance belongs to the response, not to the input.",
        "Check which channel is the input and which is the response, and correct `channels`.",
    )


def incoherent(coherence: float) -> FaultText:
    """Return the message that little of a response comes from its input."""
    return FaultText(
        f"The median coherence with the input is {coherence:.2f} over the excited lines.",
        "Only a small part of the response is caused by the input.",
        "Check that the two channels belong together, or narrow `band` to spectral lines with "
        "good coherence.",
    )


def outside_band(peak: float, low: float, high: float, ratio: float) -> FaultText:
    """Return the message that the response is largest outside the band."""
    return FaultText(
        f"The response is largest at {peak:.4g} Hz, outside `band` = [{low:g}, {high:g}] Hz; this "
        f"frequency is {ratio:.3g} times the centre of the band.",
        "A factor of 6.28 suggests rad/s, 2 suggests half the sampling frequency, and 1.024 a "
        "rate of 1000 Hz that was rounded from 1024 Hz.",
        "Check `fs` and `band`.",
    )


def unresolved(peak: float, width: float, duration_s: float, resolution_hz: float) -> FaultText:
    """Return the message on a resonance that is narrower than the record can resolve."""
    return FaultText(
        f"The resonance at {peak:.4g} Hz appears {width:.3g} Hz wide, hardly more than the "
        f"resolution of a record of {duration_s:.4g} s ({resolution_hz:.3g} Hz).",
        "If the width of a resonance is not resolved, its damping is only an upper bound.",
        f"Measure longer: a record of {4 * duration_s:.4g} s resolves {resolution_hz / 4:.3g} Hz.",
    )


def noisy_drive(source: str, ratio: float, response: str) -> FaultText:
    """Return the message that the drive's noise causes more error than the response's noise."""
    return FaultText(
        f"At the resonance the noise of `{source}` causes {ratio:.2g} times the error that the "
        f"noise of `{response}` causes.",
        "A fit takes the measured drive as exact, so that the errors of the fitted parameters are "
        "larger than stated.",
        f"Set the measuring range of `{source}` closer to its level, raise the level, or leave "
        "the test out.",
    )
