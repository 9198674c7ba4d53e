"""Messages of the monitoring: alarm or not, the change, and the torque that explains it."""

from jbw.report.messages.message import percent

Estimate = tuple[float, float, float]
"""A value and its 99 % interval."""


def distances(squared: float, threshold: float, num_reference: int, unchanged: float) -> str:
    """Return the sentence on the numbers behind an alarm: distance, threshold, probability."""
    return (
        f"T^2 is {squared:.3g} (threshold {threshold:.3g}); the probability that nothing changed "
        f"since the {num_reference} reference records is {unchanged:.3g}."
    )


def no_alarm(numbers: str) -> str:
    """Return the sentence that there is no sign of a change."""
    return f"No alarm. {numbers}"


def alarm(kind: str, record: str, first: str, direction: str, changes: str, numbers: str) -> str:
    """Return the sentence that the joint has changed, and since which record."""
    since = f", change since {first}" if first != record else ""
    return f"Alarm ({kind}) at {record}{since}: {direction}. {changes} {numbers}"


def changes(frequency: Estimate, damping: Estimate, torque: str) -> str:
    """Return the sentence on the change of frequency and the relative change of damping."""
    middle, low, high = (100 * value for value in damping)
    f, f_low, f_high = frequency
    return (
        f"Frequency {f:+.3g} Hz [{f_low:+.3g}, {f_high:+.3g}], damping {middle:+.3g} % "
        f"[{low:+.3g}, {high:+.3g}]{torque}."
    )


def torque_change(before: float, after: Estimate, *, within_fleet: bool, is_explained: bool) -> str:
    """Return the clause on the change of torque that explains a change best."""
    middle, low, high = after
    way = "fall" if middle < before else "rise"
    phrase = (
        f", which corresponds to a {way} of the torque from {before:.3g} to {middle:.3g} N m "
        f"[{low:.3g}, {high:.3g}]"
    )
    if not within_fleet:
        phrase += ", outside the torques of the fleet"
    if not is_explained:
        phrase += ", but no torque explains both the frequency and the damping"
    return phrase


def attenuated(error: float, attenuation: float) -> str:
    """Return the warning that errors of the torques make the trends with torque too small."""
    return (
        "If the torques of the fleet were not set but measured with an error of "
        f"{percent(error, '.0f')}, its slopes are about {percent(attenuation, '.1g')} too "
        "small, and changes of torque are overestimated by as much."
    )


def furthest(metres: float | None) -> str:
    """Return the words for the largest displacement of a fleet's units [m], if it is known."""
    return "some units state no displacement" if metres is None else f"{metres:.3g} m"


def torn_line(path: str, num_bytes: int, torn_path: str) -> str:
    """Return the warning that a crash cut off the last line of a monitoring log."""
    return (
        f"A crash cut off the last line of {path}; its {num_bytes} bytes are in {torn_path}. Add "
        "that record again."
    )


def known_already(record: str, number: int) -> str:
    """Return the message that a record has already been read."""
    return f"The watch already contains `{record}`, as number {number}."


def particles(record: str, share: float, *, moved: bool) -> str:
    """Return the progress message on the fraction of effective particles after a record."""
    kernel = "; the particles were resampled and moved" if moved else ""
    return f"{record}: {percent(share, '.0f')} of the particles are effective{kernel}"


def several_amplitudes(few: int) -> str:
    """Return the advice to use one amplitude if there are few reference records."""
    return (
        f"With fewer than {few} reference records, measurements at one amplitude detect "
        "smaller changes than those at several amplitudes."
    )


CAPTION = (
    "Frequency and damping at one amplitude, and the band that contains 99 % of new records of an "
    "unchanged joint. A square marks an alarm."
)
BAND = "band that contains 99 % of records of an unchanged joint"
CARRIED = "A run that is updated by new records"


def heading(num_records: int, num_reference: int) -> str:
    """Return the heading of the page on monitored records."""
    return f"{num_records} records, monitored by jbw; the first {num_reference} are the reference."


def table_title(amplitude: str, false_alarms: float) -> str:
    """Return the title of the table of monitored records."""
    return f"Frequency and damping at {amplitude}; false alarms per record: {false_alarms:g}"
