"""Messages on files and records as they are read, resampled and reduced."""

from collections.abc import Sequence

from jbw.report.messages.message import FaultText, percent

# how to export a file, by the suffix of files that jbw cannot read
_SHEET = "Save the sheet with the record as CSV."
EXPORTS = {
    ".xlsx": _SHEET,
    ".xls": _SHEET,
    ".ods": _SHEET,
    ".parquet": 'Save the file as CSV or HDF5: pandas.read_parquet("FILE").to_csv("FILE.csv").',
    ".feather": 'Save the file as CSV or HDF5: pandas.read_feather("FILE").to_csv("FILE.csv").',
    ".ide": "Export the record as CSV or MATLAB with enDAQ Lab, or with the package endaq-ide.",
    ".svd": "Export time records or FRFs as a universal file (UFF 58) with Polytec's PSV software.",
    ".sie": "Export the record as MATLAB or CSV with the recorder's software, or with libsie.",
    ".dxd": "Export the record as MATLAB or CSV with DEWESoft X.",
    ".d7d": "Export the record as MATLAB or CSV with DEWESoft X.",
    ".op2": "The file contains results of a model. Export measured records as UFF 58 or CSV.",
}


STATE_MASS = (
    "Controlled points determine the damping only if the modal mass is known: state "
    "`modal_mass` in [campaign]."
)
AS_HDF5 = "Save the file as HDF5, which can be read in parts."
AS_V73 = "Save the file with -v7.3, which can be read in parts, or save fewer variables."
FEWER_SAMPLES = (
    "Read only a part of the records, by `span = [first, last]` in seconds under [[test]], or "
    "resample the records, by `resample = RATE` in Hz with at least four times the upper end of "
    "the band."
)
CONJUGATED = "phase conjugated, from exp(-j omega t) to exp(j omega t)"
STORE_NUMBERS = "Store the samples as a dataset of floats or integers."
EXPORT_ARRAYS = (
    "In MATLAB, export plain arrays: table2array(T), timetable2table(T), or struct(object)."
)
MATLAB_OBJECT = "a MATLAB table, object or function handle"
MINE = (
    "Correct the unit that is wrong in the campaign; a unit that the file states can be left "
    'out. If the file is wrong, put under [[test]]: `units_are = "mine"`.'
)
EXPORT = "Export the record again."
EVEN = "Spectra and sampled inputs need evenly spaced samples."
STATE_RATE = "Put under [[test]]: `fs = HZ`, where HZ is the sampling frequency in hertz."
HIGHER_RATE = "Measure at a higher rate."


def times_or_rate(channels: str) -> str:
    """Return the remedy to name a column of times, or to state the rate."""
    return f"Put under [[test]]: `channels = {channels}`, or the rate in hertz: `fs = HZ`."


def resample_or_part(resample: str, part: str) -> str:
    """Return the remedy to resample, or to keep a part without gaps."""
    return f"Put under [[test]]: {resample}, or keep a part: {part}."


def part_or_higher_rate(line: str) -> str:
    """Return the remedy to keep a part without pauses, or to measure at a higher rate."""
    return f"{line}, or measure at a higher rate."


def coarse_times(fs: float) -> str:
    """Return the remedy for times with too few digits, whose mean sampling rate [Hz] is known."""
    return (
        "Export the times with more digits. If no sample is lost, take `time` out of "
        f"`channels` and put under [[test]]: `fs = {fs:.9g}`."
    )


def time_without_unit(name: str, first: Sequence[float], guess: str) -> FaultText:
    """Return the message on whole-number times without a unit, with the likeliest unit.

    `guess` is empty where the times are counts of samples.
    """
    count = (
        "if this column counts samples, take `time` out of `channels` and state the rate "
        "by `fs = HZ`"
    )
    unit = (
        "Put under [[test]] the unit of column `time`, one of s, ms, us and ns, in `units`, "
        f'such as `units = {{ time = "{guess or "ms"}" }}`'
    )
    listed = ", ".join(f"{x:.15g}" for x in first)
    return FaultText(
        f"Column `{name}` contains whole numbers without a unit: {listed}, ...",
        "The whole numbers may be counts of samples, or times in a small unit; the sampling rate "
        "depends on the unit.",
        f"{unit}; {count}.",
    )


def unfitting_names(names: Sequence[str], columns: int) -> str:
    """Return the message that a header has more or fewer entries than the rows below it."""
    some = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
    return (
        f"the header of the file names {len(names)} columns ({some}), but its rows have {columns}, "
        "so that the names cannot be assigned; refer to columns by number, counted from zero: "
        "`column[0]`."
    )


def of_sensor(sensitivity: str, *, is_scaled: bool = False) -> str:
    """Return the remedy for a channel in volts: state the sensitivity of its sensor."""
    which = "in addition to its `scale`" if is_scaled else "as in its certificate"
    return (
        f"The file contains the voltage of a sensor: state its sensitivity, {which}. Put under "
        f"[[test]]: `sensitivity = {sensitivity}`."
    )


def channel_takes(shape: tuple[int, ...]) -> str:
    """Return the subject and verb of the sentence that a channel is too large."""
    return f"A channel of shape {shape} takes"


def beginning(fs: float | None, most: float) -> str:
    """Return the remedy to read only the start of a channel; `fs` is its rate [Hz], if known."""
    if not fs:
        return f"Read at most {most:.0f} samples of the channel at once, by the key `span`."
    return f"Put under [[test]]: `span = [0.0, {most / fs:.4g}]`, or another part that is as long."


def against_file(unit: str, of_file: str) -> str:
    """Return the note that the campaign's unit replaces the file's unit."""
    return f"{unit} as the campaign states, not `{of_file}` as the file states"


def angle_of(role: str) -> str:
    """Return the note on the channel from which a phase was computed."""
    return f"angle of the complex {role}"


def few_driven_lines(record: str, least: int) -> str:
    """Return the message on a record whose source drives too few spectral lines."""
    return (
        f"The source of {record} drives fewer than {least} spectral lines in its band: widen the "
        "band, or record for longer."
    )


def rests(start: float, end: float, share: float, keep: str) -> str:
    """Return the note on the times [s] in which a record moves, with the line to select them."""
    return (
        f"The structure is at rest outside of {start:g} to {end:g} s. {keep}; a fit to this "
        f"part takes only {100 * share:.0f} % of the time."
    )


def oversampled(per_cycle: float, hz: float, ordinal: str, fs: float, every: int) -> str:
    """Return the note that a sampling frequency is higher than necessary."""
    return (
        f"The record has {per_cycle:.0f} samples per cycle of its strongest frequency, {hz:.4g} "
        f"Hz: low-pass the record and export every {ordinal} sample ({fs:g} Hz); a fit then takes "
        f"{100 / every:.0f} % of the time."
    )


def long_record(name: str, samples: int, proposals: Sequence[str]) -> str:
    """Return the note that a record is long, and how it may be shortened."""
    return f"{name} has {samples} samples, which makes fits slow. {' '.join(proposals)}"


def to_rate(fs: float, new_fs: float, passed: float, lost: float) -> str:
    """Return the note on resampling to another rate [Hz], with the lost part of the signal."""
    return (
        f"from {fs:.7g} to {new_fs:.7g} Hz, with an error of 3e-05 below "
        f"{passed * new_fs / 2:.4g} Hz; the part above this frequency is removed "
        f"({100 * lost:.2g} % of the rms)"
    )


def from_uneven(usual: float, new_fs: float, band_hz: float, error: float) -> str:
    """Return the note on resampling uneven samples to a rate [Hz], with the estimated error."""
    return (
        f"from unevenly spaced samples of about {usual:.4g} Hz to {new_fs:.7g} Hz, valid below "
        f"{band_hz:.4g} Hz; held-out samples are interpolated with an error of "
        f"{100 * error:.2g} % of the rms, including their noise"
    )


def response_clock(ppm: float) -> str:
    """Return the note that the response was resampled to the clock of the drive [ppm]."""
    return f"response resampled to the clock of the drive channel, by {ppm:g} ppm"


def input_unknown(tone: str) -> str:
    """Return the message that a third harmonic may come from the source."""
    return (
        f"{tone}: the input was not measured, so its third harmonic may be part of Y(3 omega). "
        "This frequency alone does not allow a conclusion on the joint."
    )


def harmonic_kept(tone: str) -> str:
    """Return the message that the source's third harmonic was not removed."""
    return (
        f"{tone}: the third harmonic of the source was measured, but not removed from the response."
    )


def large_harmonic(tone: str, ratio: float) -> str:
    """Return the message on the source's third harmonic and its fraction of the response."""
    return (
        f"{tone}: the third harmonic of the source adds {percent(ratio, '.0f')} of the joint's Y(3 "
        "omega) to the response; the corrected value depends on H1(3 omega)."
    )


def harmonic_in_noise(tone: str) -> str:
    """Return the message that a third harmonic does not exceed noise."""
    return f"{tone}: Y(3 omega) does not stand above the noise; leave this frequency out."


def held_phase(
    test: str, phase: float, amplitude_mm: tuple[float, float], hz: tuple[float, float]
) -> str:
    """Return the sentence on how frequency at a held phase [degrees] changes with amplitude."""
    (first_mm, last_mm), (first_hz, last_hz) = amplitude_mm, hz
    change = last_hz / first_hz - 1
    return (
        f"{test}: from {first_mm:.3g} to {last_mm:.3g} mm the frequency at {phase:g} degrees "
        f"{'falls' if change < 0 else 'rises'} from {first_hz:.5g} to {last_hz:.5g} Hz, by "
        f"{percent(abs(change))}."
    )


def removed_line(hz: float, amplitude: float, error: float) -> str:
    """Return a removed spectral line as text: frequency [Hz], amplitude, error."""
    return f"{hz:.6g} Hz with the amplitude {amplitude:.4g} (standard error {error:.2g})"


def one_header(packets: int) -> str:
    """Return the note on how many blocks of samples were read as one record."""
    return f"{packets} packets under one header, read as one record without a pause"


def rounded_rate(error: float) -> str:
    """Return the clause on the error of a sampling frequency computed from printed digits."""
    return f"the printed digits cause a relative error of {error:.1e} in the sampling frequency"


def resampled_to(fs: float) -> str:
    """Return the clause on the rate [Hz] to which a campaign resamples."""
    return f"{fs:.10g} Hz, to which the record is resampled"


def own_path(path: str) -> str:
    """Return the remedy for a linked group of a file: use the group's own path."""
    return f"Use the group's own path `{path}`."


def none_decays(name: str) -> tuple[str, str, str]:
    """Return the message that no record of a test decays in its band as one mode does."""
    return (
        f"Test `{name}` must decay in its `band`, but no part of its records is a decay of one "
        "mode in this band.",
        "In every part of the records, the motion grows or is not the decay of a single mode.",
        "Correct `band`, or let `settle` begin after the blow.",
    )
