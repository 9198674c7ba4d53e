"""Faults of a campaign file, and of records that contradict it: what, why and remedy."""

from collections.abc import Sequence

from jbw.report.messages.message import FaultText, number

AMPLITUDE_ALONE = FaultText(
    "The response is real: it has an amplitude, but no phase.",
    "Amplitude alone does not determine damping and stiffness separately.",
    "Name the channel `phase` in `channels`, or a channel that contains the complex response.",
)
TWO_SOURCES = FaultText(
    "`input` and `force` were both recorded; `input` is taken as the source.",
    "With the shaker's voltage or current as the source, the shaker is part of the structure.",
    'State the source by drive = "voltage" or drive = "force".',
)
ONE_RUN = "offsets are differences between runs, but the campaign has only one run"
NO_FORCE = "the tests are driven by a voltage or a current, and no force is known"
GAIN_STATED = "the campaign states the gain, so that it is not identified"
NO_GAIN = "no test has a source whose gain could be identified"
NOTHING_FREE = "the displacement is prescribed, so that no mode of the structure vibrates freely"
NO_MODE = FaultText(
    "No mode in the bands of the tests moves a joint; the data do not constrain any law.",
    remedy="Sweep a mode in which the joints have large energy shares.",
)
ONE_MODE = (
    "One mode determines only the sum of the effects of all joints, not the effect of each joint."
)
EXCHANGEABLE = (
    "Interchanging the joints' laws changes no response, so that the posterior has two modes."
)
SUM_OF_LAWS = (
    "Single modes determine only the sum of the joints' laws; only several modes that move at "
    "once determine the difference."
)
SAME_SAMPLES = "contains the same samples as"
FILES_ONCE = "Name each file once in `files`."
NO_TESTS = "[[test]]: at least one test is needed, each under its own [[test]]."
GAIN_OR_MASS = "[campaign]: give gain or modal_mass, not both; one follows from the other."
SEE_TOML = (
    "The rules of a campaign file are at https://toml.io; strings need quotes, and each "
    "key may occur only once."
)
BACKSLASH = "has a backslash in double quotes, where a backslash begins an escape such as \\n"
DECIMAL_COMMA = "has a decimal comma, but a comma separates values"
BARE_POINT = "has a number without a digit before or after the decimal point"
BARE_WORD = "has a word without quotes"
NO_JOINTS = "[structure] matrices: need a [[joint]] table for every joint, but there is none."


def typographic(typed: str) -> str:
    """Return the message for typographic quotes, minus signs and blanks, which TOML rejects."""
    return f"has typographic characters, {typed}, which TOML does not accept"


def mended(number: int, line: str, alike_lines: Sequence[int]) -> str:
    """Return the remedy for a mistake: the corrected line, and the next line with this mistake."""
    more = (
        f" Line {alike_lines[0]} has the same mistake: correct that line too."
        if alike_lines
        else ""
    )
    return f"Write line {number} as `{line}`.{more}"


def table_again(number: int, table: str, other: int) -> tuple[str, str]:
    """Return the message that two lines open the same table."""
    return (
        f"line {number} opens [{table}] again, after line {other}",
        f"Move the keys below line {number} to the keys below line {other}, and remove line "
        f"{number}.",
    )


def key_again(number: int, key: str, other: int) -> tuple[str, str]:
    """Return the message that two lines state the same key, and the remedy."""
    return (
        f"line {number} states `{key}` again, after line {other}",
        f"Keep only one of the lines {other} and {number}.",
    )


def in_one_table(other: int, number: int, key: str, line: str) -> tuple[str, str]:
    """Return the message that two lines state the same table, with one line that replaces both."""
    return (
        f"lines {other} and {number} both state `{key}`",
        f"Write line {other} as `{line}`, and remove line {number}.",
    )


def decimal_points(bounds: str) -> str:
    """Return the message on two values that were written with decimal commas."""
    return f"A comma separates values: with decimal points, write {bounds}."


def two_rates(fs: float, other: str, other_fs: float) -> FaultText:
    """Return the message for repeats of a test with two sampling frequencies [Hz]."""
    return FaultText(
        f"Repeats of a test must have one sampling frequency, but this record has {fs:.7g} Hz and "
        f"{other} has {other_fs:.7g} Hz.",
        remedy="Make a separate test of the records of each sampling frequency.",
    )


def motion_of_metres(motion: float, hz: float) -> FaultText:
    """Return the message on an implausibly large motion [m] at a spectral line [Hz]; 0 if none."""
    line = f" at its strongest line, {hz:.3g} Hz" if hz else ""
    return FaultText(
        f"In the stated units, the motion is {number(motion)} m{line}.",
        "Joints in laboratories and machines move by centimetres at most.",
        "Correct the unit of the channel, the unit of `time`, or `fs`.",
    )


def band_beyond(end: float, nyquist: float) -> FaultText:
    """Return the message on a band that ends above half the sampling frequency [Hz]."""
    return FaultText(
        f"`band` ends at {end:g} Hz, above half the sampling frequency ({nyquist:g} Hz).",
        remedy=f"Lower the band's end to at most {nyquist:g} Hz, or correct fs.",
    )


def tone_beyond(tone: float, limit: float) -> FaultText:
    """Return the message on a tone whose third harmonic would be aliased [Hz]."""
    return FaultText(
        f"Tone {tone:g} Hz must lie below a third of half the sampling frequency ({limit:.4g} Hz).",
        "The third harmonic of a higher tone is aliased.",
        "Leave the tone out, or measure with a higher sampling frequency.",
    )


def too_short(length: float, needed: float, *, is_stepped: bool) -> FaultText:
    """Return the message on a record that is shorter than its steps or its transient [s]."""
    duration = "the steps take" if is_stepped else "`settle` alone takes"
    return FaultText(
        f"The record lasts {length:.4g} s, but {duration} {needed:.4g} s.",
        remedy="Correct settle, dwell or tones, or give the whole record.",
    )


def broken_periods(samples: int, periods: int) -> FaultText:
    """Return the message on a number of samples that is not a whole number of periods."""
    return FaultText(
        f"The record's {samples} samples are not {periods} whole periods.",
        "Averages over periods need whole periods: otherwise the phase shifts along the record.",
        "Correct `periods`, or use `span` to cut the record to whole periods.",
    )


def no_line_in_band(lines: tuple[float, float], band: Sequence[float]) -> FaultText:
    """Return the message on a response curve whose points all lie outside the band [Hz]."""
    return FaultText(
        f"No point of the response curve, {lines[0]:.4g} to {lines[1]:.4g} Hz, lies in `band` = "
        f"[{band[0]:g}, {band[1]:g}] Hz.",
        remedy="Correct `band`, or the unit of `frequency`, which may be rad/s.",
    )


def started_apart(size_s: float, delay_s: float, *, later: bool) -> FaultText:
    """Return the message on channels that were started at different times [s]."""
    return FaultText(
        f"According to the file, the response was started {size_s:.6g} s "
        f"{'after' if later else 'before'} the drive.",
        "Samples with the same number in both channels were measured at different times.",
        f"Put under [[test]]: `delay = {delay_s:.9g}`, or export both channels from the same "
        "time on.",
    )


def unread(name: str, reason: str) -> FaultText:
    """Return the message that a setting has no effect, with the reason."""
    return FaultText(
        f"`{name}` has no effect: {reason}.",
        remedy=f"Leave `{name}` out.",
    )


def read_by_kinds(kinds: str) -> str:
    """Return the reason why a setting has no effect: it applies only to absent kinds of test."""
    return f"only tests of kind {kinds} use this key, and the campaign has no test of this kind"


def no_test_of_kind(kind: str) -> str:
    """Return the reason why a setting has no effect: no test of the required kind exists."""
    return f"no test of the campaign is of kind {kind}"


def nothing_to_adapt(sampler: str) -> str:
    """Return the reason why a setting has no effect: the sampler has no warm-up."""
    return f"sampler {sampler} has no warm-up"


def no_coordinates(laws: str) -> str:
    """Return the reason why a setting has no effect: no law offers other coordinates."""
    return f"no law of the joint ({laws}) has alternative parametrisations"


def put_same_as(joint: str, leader: str) -> str:
    """Return the remedy with the campaign line that lets a joint use the law of another joint."""
    return f"Put under [[joint]] `{joint}`: `same_as = {leader}`, or sweep more modes."


def few_modes(laws: int, modes: int) -> FaultText:
    """Return the message that fewer modes are swept than there are laws of joints."""
    return FaultText(
        f"To determine {laws} laws, at least {laws} modes must be swept, but the bands of the "
        f"tests contain only {modes}.",
        "Every mode determines one number: the sum of the effects of all joints.",
        "Sweep more modes, or tie joints by `same_as`.",
    )


def unmoved(joint: str) -> FaultText:
    """Return the message that no swept mode moves a joint."""
    return FaultText(
        f"No mode in the bands of the tests moves joint `{joint}`; the data do not constrain its "
        "law.",
        remedy=f"Sweep a mode in which joint `{joint}` has a large share of the energy.",
    )


def exchanged(test: str, ratio: float, other: str, smaller: float) -> FaultText:
    """Return the message that the stated levels of two tests contradict their measured drives."""
    return FaultText(
        f"The `level` of test `{test}` is {ratio:.3g} times that of `{other}`, but its drive is "
        f"{smaller:.3g} times smaller, and its response is smaller too.",
        f"The levels or the files of tests `{test}` and `{other}` are interchanged.",
        f"Correct `level` or `files` of tests `{test}` and `{other}`.",
    )


def twice(first: str, relation: str, second: str, remedy: str) -> FaultText:
    """Return the message that two tests contain the same record."""
    return FaultText(
        f"{first} {relation} {second}.",
        "A record that is used twice makes intervals too narrow; if one copy is held out, its "
        "prediction is no test.",
        remedy,
    )


def shares(share: float) -> str:
    """Return the words on the fraction of a record that another record also contains."""
    return f"shares {share:.0%} with"


def rest_or_leave_out(part_line: str, leaving_out: str) -> str:
    """Return the remedy: use the part of a record that no other test contains, or exclude it."""
    return f"{part_line}, a part that no other test contains, or {leaving_out}."


def several_assemblies(count: int, names: Sequence[str]) -> str:
    """Return the message that [assembly] describes one assembly but tests belong to several."""
    return (
        f"[assembly]: describes one assembly, but the campaign has {count}: {', '.join(names)}; "
        "write a campaign file for each."
    )


def name_of_several(name: str, count: int) -> str:
    """Return the message that several tests have the same name."""
    return f"[[test]] name: {name!r} is given to {count} tests."


def mode_outside(hz: float, bands: str) -> str:
    """Return the message that a mode [Hz] lies in the band of no driven test."""
    return (
        f"[identify] modes: {hz:g} Hz must lie in the band of a test with a source, {bands}; "
        "widen `band`, or let `residuals` describe this mode."
    )


def no_level(level: float, levels: str) -> str:
    """Return the message that `fit_levels` names a level that no test has."""
    return f"[identify] fit_levels: no test has level {level:g}; levels: {levels}."


def no_role(role: str) -> str:
    """Return the message on a role of `gain_std` that no test has."""
    return f"[campaign] gain_std: names role `{role}`, but no test has a channel of this role."


def base_beside_others(others: str) -> str:
    """Return the message that a campaign combines tests on a moving base with other drives."""
    return (
        f"[[test]] channels: tests with `base` cannot be combined with tests driven by {others}, "
        "which have another gain; make a separate campaign of the tests of each drive."
    )


BASE_WITHOUT_MASS = (
    "[[test]] channels: tests with `base` and tests driven by a force need the modal mass, which "
    "relates their gains. Put under [campaign]: `modal_mass = 1.0`, with the mass in kg, or make a "
    "separate campaign of the tests with `base`."
)


def joint_twice(table: str, count: int) -> str:
    """Return the message that several joints have the same name."""
    return f"{table} name: must be unique, but {count} joints have the same name."


def no_place(table: str) -> str:
    """Return the message that a joint of a matrix model has no location."""
    return f"{table}: if there are matrices, a joint must have `across` or `weights`."


def no_stiffness(table: str) -> str:
    """Return the message that a joint of a matrix model has no stiffness."""
    return f"{table} stiffness: missing; state the stiffness of the stuck joint [N/m, or N m/rad]."


def without_matrices(table: str, key: str) -> str:
    """Return the message on a key that needs `matrices`."""
    return f"{table} {key}: needs `matrices` under [structure]."


def shape_of_modes(table: str, modes: int, count: int) -> str:
    """Return the message on a joint's shape whose length is not the number of modes."""
    return (
        f"{table} shape: must have a number for each of {modes} modes under [structure], but "
        f"has {count}."
    )


def unknown_leader(key: str, leader: str, guess: str, joints: str) -> str:
    """Return the message that `same_as` names a joint that does not exist."""
    return f"{key}: must be the name of a joint, but is `{leader}`. {guess}Joints: {joints}."


def circle(key: str) -> str:
    """Return the message that joints refer to each other in a circle by `same_as`."""
    return (
        f"{key}: must lead to a joint with its own law, but the joints refer to each other in a "
        "circle. Leave this key out of one of these joints."
    )


def other_laws(key: str, joint: str, laws: str, leader: str, of_leader: str) -> str:
    """Return the message that joints with a shared law state different laws."""
    return (
        f"{key}: joints that share a law must have the same laws, but `{joint}` has {laws} and "
        f"`{leader}` {of_leader}. Leave `laws` out of `{joint}`."
    )
