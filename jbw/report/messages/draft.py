"""Comments and guesses in a drafted campaign file, and questions of `jbw init`."""

from collections.abc import Sequence

HEAD = """\
# Campaign file of jbw. Check the lines marked CHECK: the records do not state their values.
# To check this file and its records: jbw check campaign.toml
# A channel is a path, such as group.name. [3] selects the fourth item, counted from zero.
# As in MATLAB, (4) and {4} also select the fourth item. [:] selects all items.
# 'a - b' is the difference of two channels.

[campaign]"""
FURTHER = "# More keys of a [[test]]; write them below its line `kind`:"
NO_RESPONSE = "no channel has the name of a response: name the response in `channels`."
NAME_RECORD = (
    "Name a record, a campaign file, or a folder that contains records or a campaign file."
)
GUESS = "  # CHECK: a guess"
NO_BAND = "band must be given."
NO_TONES = "tones must be given."
RELATIVE = "relative_to_base = true  # CHECK: the response was measured relative to the base"
DWELL = "dwell = 1.0  # CHECK: duration of each step [s]"
EXAMPLE_BAND = "# band = [5.0, 40.0]  # CHECK: frequencies around the one mode [Hz]"
EXAMPLE_PLACES = ("1:x", "2:x")
EXAMPLE_TONES = "tones = [1.0]  # CHECK: frequencies [Hz]"
NO_RATE = "the sampling frequency fs must be given."
EXAMPLE_RATE = "# fs = 1024.0  # CHECK: sampling frequency [Hz], not in the file"
ASK_BAND = "lowest and highest frequency of the one mode [Hz]"
ASK_DWELL = "duration of each step [s]"
ASK_TONES = "frequencies of the tones [Hz]"
ASK_RATE = "rate to resample to [Hz]"


def several_folders(folders: Sequence[str]) -> tuple[str, str, str]:
    """Return the message that the named records must lie in one folder, and its remedy."""
    return (
        f"Records that are named together must lie in one folder, but lie in {', '.join(folders)}.",
        "A campaign file can only name records in the folder of the campaign file.",
        "Copy the records into one folder, or name the records of one folder at a time.",
    )


def other_records(path: str) -> tuple[str, str, str]:
    """Return the message that an existing campaign file has the draft's name but other records."""
    return (
        f"The campaign file for the given records must be `{path}`, but `{path}` exists and names "
        "other records.",
        "An existing campaign file is not overwritten.",
        f"Name `{path}` instead of the records, or rename `{path}`.",
    )


def mass_of_campaign(path: str, mass: str) -> tuple[str, str]:
    """Return the error that `--mass` has no effect on an existing campaign file, and the remedy."""
    return (
        f"Option --mass is only for new campaign files, but `{path}` exists already.",
        f"State the mass in the file, under [campaign]: modal_mass = {mass}",
    )


def drafted(path: str) -> str:
    """Return the message that a campaign file was written."""
    return f"Drafted from the records: {path}"


def drafted_before(path: str) -> str:
    """Return the message that a campaign file for these records exists already."""
    return f"The existing campaign file {path} names the given records, and is used."


def guessed_kind(kind: str) -> str:
    """Return the note that the kind of a test was guessed."""
    return f"kind {kind!r} is a guess."


def guessed_role(role: str, channel: str) -> str:
    """Return the note that a channel's quantity was guessed."""
    return f"the quantity of channel `{channel}` is a guess: {role}."


def check_roles(roles: Sequence[str]) -> str:
    """Return the mark for a line with guessed quantities."""
    are = "is a guess" if len(roles) == 1 else "are guesses"
    return f"  # CHECK: {', '.join(roles)} {are}"


def not_used(channels: str) -> str:
    """Return the comment that names the unused channels of a file."""
    return f"# channels that are not used: {channels}"


def shared_band(band: str) -> str:
    """Return the draft line of a band around the spectral line that all decays show."""
    return f"band = {band}  # CHECK: around the spectral line that every decay shows"


def about_strongest(low: float, high: float) -> str:
    """Return the note that a band [Hz] was guessed from the strongest spectral line."""
    return (
        f"the band {low:g} to {high:g} Hz is a guess: it lies around the strongest spectral line."
    )


def about_shared(low: float, high: float) -> str:
    """Return the note that a band [Hz] was guessed from a line that all decays show."""
    return (
        f"the band {low:g} to {high:g} Hz is a guess: it lies around the spectral line that "
        "every decay shows."
    )


def more_groups(count: int) -> str:
    """Return the comment on how many groups of a file were not drafted."""
    return f"# {count} more groups like these are in the file.\n"


def files(pattern: str, count: int) -> str:
    """Return the draft line with the files of a test, and their number."""
    return f"files = {pattern}  # {count} file(s), each of which is one repeat"


def assembly(name: str) -> str:
    """Return the draft line of a test's assembly, from the torque in its file names."""
    return f"assembly = {name}  # CHECK: from the torque in the name"


def of_one_torque(torque: str) -> str:
    """Return the [assembly] table with the torque [N m] that all file names contain."""
    return f"[assembly]\ntorque = {torque}  # [N m] CHECK: taken from the names of the files"


def torques(patterns: Sequence[str]) -> str:
    """Return the note that files of several torques are drafted as assemblies of one joint."""
    return (
        "files of several torques are drafted as assemblies of one joint, each with its own "
        "frequency and damping. If the joint changes with torque, identify the files of each "
        f"torque separately: `jbw identify {patterns[0]}` and so on. `jbw diff` then compares the "
        "runs."
    )


def level(level: str, source: str) -> str:
    """Return the draft line of a test's level, measured in the record of its source."""
    return f"level = {level}  # peak of the {source}"


def delay(delay: str) -> str:
    """Return the draft line of a delay between channels, from their starting times."""
    return f"delay = {delay}  # from the start times in the file"


def resampled(rate: str) -> str:
    """Return the line of a draft with a rate [Hz] at which uneven samples are resampled."""
    return f"resample = {rate}  # CHECK: [Hz]; the times of the record are not evenly spaced"


def resampled_at(rate: float) -> str:
    """Return the note that a rate for resampling was guessed [Hz]."""
    return f"resampled at {rate:g} Hz, because the times of the record are not evenly spaced."


def assumed_unit(role: str, unit: str) -> str:
    """Return the note that a unit was guessed because the file states none."""
    return f"the unit of {role} is assumed to be the SI unit, {unit}."


def check_units(roles: str) -> str:
    """Return the mark for a line of units that the file does not state."""
    return f"  # CHECK: SI assumed, not in the file, for {roles}"


def band(band: str) -> str:
    """Return the draft line of a band around the strongest spectral line."""
    return (
        f"band = {band}  # CHECK: around the strongest spectral line; no other mode may lie in it"
    )


def about_tone(hz: float) -> str:
    """Return the note that a tone was guessed [Hz]."""
    return f"the tones, {hz:g} Hz, are a guess: the strongest spectral line of the record's source."


def tone(tones: str) -> str:
    """Return the draft line of a tone at the strongest spectral line."""
    return f"tones = {tones}  # CHECK: the strongest spectral line of the record's source [Hz]"


def scalar_rate(name: str) -> str:
    """Return the draft line of a sampling frequency that is stored in the file."""
    return f"fs = {name}  # the scalar of that name in the file"


def name_channels(file: str, channels: str) -> str:
    """Return the comment that the user must name the channels of a file."""
    return f"# CHECK: name the channels of {file} by hand, from {channels}."


def kind(kind: str, kinds: str) -> str:
    """Return the commented draft line of a test's kind, with all possible kinds."""
    return f"# kind = {kind}  # one of {kinds}"


def separate_files(files: str) -> str:
    """Return the comment with a line for channels in separate files."""
    return f"# if the response is in separate files: files = {files}"


def slowest(rate: str) -> str:
    """Return the draft line that resamples all channels to the slowest rate [Hz]."""
    return f"resample = {rate}  # [Hz], the rate of the slowest channel"


def doubtful(doubt: str) -> str:
    """Return a comment on data that the reader cannot use."""
    return f"# CHECK: {doubt}"


def one_of_axes(role: str, channels: str) -> str:
    """Return the note that one of several axes or curves must be chosen."""
    return f"{role} may be any of {channels}: choose one channel, or make a separate test of each."


def check_axes(role: str, channels: str) -> str:
    """Return the comment CHECK for a channel that a draft chose from several axes."""
    return f"  # CHECK: {role} may be any of {channels}"


def assumed_time_unit(channel: str, unit: str) -> str:
    """Return the note that the unit of times was guessed."""
    return (
        f"the unit of the channel of times, {channel}, is assumed to be {unit}; the sampling "
        "frequency depends on it."
    )


def counts_samples(channel: str) -> str:
    """Return the note that a column only counts samples and that no rate is stated."""
    return f"channel {channel} counts samples, so that the sampling frequency fs must be given."


def coarse_times(channel: str, fs: float) -> str:
    """Return the note on times with too few digits, with their mean rate [Hz]."""
    return (
        f"the times in channel {channel} have too few digits: check `fs`, which is set to the mean "
        f"rate, {fs:g} Hz."
    )


def mean_rate(fs: str) -> str:
    """Return the line of a draft with the mean rate [Hz] of times that have too few digits."""
    return f"fs = {fs}  # CHECK: [Hz], the mean rate of times with too few digits"


def in_volts(role: str) -> str:
    """Return the note on a channel in volts that belongs to a sensor."""
    return f"{role} is in volts, as the file states: add the sensitivity of its sensor."


def sensitivity(sensors: str) -> str:
    """Return the commented draft line of sensitivities, which the user must complete."""
    return f"# sensitivity = {sensors}  # CHECK: of the sensor, from its certificate"


def matrices(files: Sequence[str]) -> str:
    """Return the note on files with a model's matrices next to the records."""
    return (
        f"{', '.join(files)}: matrices of a model. To identify the joints of the model, fill in "
        "the tables [structure] and [[joint]], which the draft contains as a comment."
    )


def matrices_alone(folder: str, files: Sequence[str]) -> tuple[str, str, str]:
    """Return the error for a folder with a model's matrices but no record."""
    return (
        f"Folder `{folder}` must contain a record, but contains only matrices of a model: "
        f"{', '.join(files)}.",
        "Joints are identified from records; matrices only state how each mode moves each joint.",
        "Put the records of the structure into this folder.",
    )


def structure(matrices: str, places: Sequence[str], written: Sequence[str]) -> str:
    """Return the commented tables [structure] and [[joint]] for the files of a model."""
    some = ", ".join(places[:6]) + (f", ..., {places[-1]}" if len(places) > 6 else "")
    push, points, across = written
    return f"""\
Next to the records there is a model. Its degrees of freedom: {some or "node:direction, as 17:x"}.
CHECK: to identify its joints, fill in the lines below and remove the `# ` before each of them.
[structure]
matrices = {matrices}
units = "SI"  # CHECK: or N-mm-t-s, kN-mm-kg-ms, lbf-in-s; no file states it
to_hz = 400.0  # CHECK: modes up to this frequency are kept [Hz]
damping = 0.004  # CHECK: ratio of every mode
input = {push}  # CHECK: where the source pushes
points = {points}  # CHECK: where the response is measured
[[joint]]
name = "bolt 1"
across = {across}  # CHECK: the degrees of freedom of its two sides
stiffness = 1e6  # CHECK: with the joint fully stuck [N/m, or N m/rad]
"""


def to_export(remedy: str) -> str:
    """Return the note on how to export a file that jbw cannot read."""
    return f"this file cannot be read. {remedy}"
