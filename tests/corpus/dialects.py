"""Small files in the dialects of recorders, all written by this script, none by a recorder.

A dialect is a function that writes one file into a folder. The decorator above it states what a
draft must find in the file: force in N and velocity in m/s at 1024 Hz unless it says otherwise. The
docstring of each recorder states the sources of its dialect. To add a file of your own, put it into
`files/` and a line into `files/expected.toml`.
"""

import datetime
from dataclasses import dataclass, field

import h5py
import numpy as np
import scipy.io
import scipy.io.wavfile

FS, N = 1024.0, 384
T = np.arange(N) / FS
FORCE = 3.0 * np.sin(2 * np.pi * 30.0 * T + 40.0 * T**2) + 0.01
VELOCITY = 0.02 * np.sin(2 * np.pi * 31.0 * T + 35.0 * T**2 + 0.4)
ACCELERATION = 5.0 * np.exp(-4.0 * T) * np.cos(2 * np.pi * 60.0 * T)
G = 9.80665
HZ = np.linspace(20.0, 40.0, 81)
MOBILITY = 1j * HZ / (30.0**2 - HZ**2 + 1j * HZ) / 7.0
TRUTH = {"force": FORCE, "velocity": VELOCITY, "acceleration": ACCELERATION}
LEAST_FORCE, LEAST_VELOCITY = FORCE[::2], VELOCITY[::2]


@dataclass(frozen=True)
class Dialect:
    """One file in a dialect, and what a draft must find in it."""

    write: object
    file: str
    recorder: str = ""
    kind: str = "sweep"
    fs: float = FS
    roles: tuple[str, ...] = ("force", "velocity")
    asks: bool = False  # whether the draft asks a question
    truth: dict = field(default_factory=dict)
    rtol: float = 2e-5  # relative to the largest sample, as the number of digits allows


DIALECTS: dict[str, Dialect] = {}


def dialect(file, recorder="plain text", **expected):
    """Return a decorator that puts a writer of files into the table of dialects."""

    def put(write):
        DIALECTS[write.__name__] = Dialect(write, file, recorder, **expected)
        return write

    return put


DECAY = {"kind": "decay", "roles": ("acceleration",)}


# --- text ---
def rows(columns, delimiter=",", decimal=".", form="{:.7g}"):
    lines = (delimiter.join(form.format(x) for x in row) for row in zip(*columns, strict=True))
    return [line.replace(".", decimal) for line in lines]


def text(path, *lines, end="\n", encoding="utf-8"):
    path.write_bytes((end.join(lines) + end).encode(encoding))


TFV = (T, FORCE, VELOCITY)


@dialect("sweep_1.csv")
def units_in_brackets(path):
    text(path, "time [s],force [N],velocity [m/s]", *rows(TFV))


@dialect("sweep_1.csv")
def units_in_a_second_row(path):
    text(path, "Time,Load cell,Laser", "s,N,mm/s", *rows((T, FORCE, 1e3 * VELOCITY)))


@dialect("sweep_1.csv")
def units_in_parentheses_below_a_blank_line(path):
    text(
        path,
        "Time;Force;Velocity",
        "(ms);(kN);(mm/s)",
        "",
        *rows((1e3 * T, FORCE / 1e3, 1e3 * VELOCITY), ";"),
    )


@dialect("sweep_1.csv")
def units_after_a_comma(path):
    text(path, "Time, s;Force, N;Velocity, m/s", *rows(TFV, ";"))


@dialect("sweep_1.txt")
def decimal_commas_and_tabs(path):
    text(
        path,
        "Zeit [s]\tKraft [N]\tGeschwindigkeit [mm/s]",
        *rows((T, FORCE, 1e3 * VELOCITY), "\t", ","),
    )


@dialect("sweep_1.csv")
def separator_line_and_footer(path):
    text(
        path,
        "sep=;",
        "time [s];force [N];velocity [m/s]",
        *rows(TFV, ";"),
        "",
        f"Max;{FORCE.max():.6g};{VELOCITY.max():.6g}",
        "RMS;1.0;2.0",
    )


@dialect("sweep_1.csv")
def byte_order_mark_and_quotes(path):
    text(path, '"Time (s)";"Force (N)";"Velocity (m/s)"', *rows(TFV, ";"), encoding="utf-8-sig")


@dialect("sweep_1.txt", rtol=1e-4)
def utf16_of_a_shell(path):
    text(
        path,
        "time [s]\tforce [N]\tvelocity [m/s]",
        *rows(TFV, "\t", form="{:.5g}"),
        encoding="utf-16",
    )


@dialect("sweep_1.csv")
def names_with_any_character(path):
    text(path, "t [s],AI 0/1: Force #2 [N],x'(t) - velocity [m/s]", *rows(TFV))


@dialect("hammer_1.txt", **DECAY)
def one_column_and_a_rate_above_it(path):
    text(
        path, "Acceleration (g)", "Sample rate: 1024 Hz", *rows((ACCELERATION / G,), form="{:.6f}")
    )


@dialect("hammer_1.csv", **DECAY)
def an_interval_in_the_preamble(path):
    text(
        path,
        "Serial number,1234",
        "Sampling interval (ms),0.9765625",
        "Ch 1 [m/s²],Ch 2 [EU]",
        *rows((ACCELERATION, 0.01 * T)),
    )


@dialect("sweep_1.csv", rtol=2e-3)
def thousands_separators(path):
    text(
        path,
        "time [s];force [mN];velocity [um/s]",
        *(f"{t:.6f};{1e3 * f:,.2f};{1e6 * v:,.2f}" for t, f, v in zip(*TFV, strict=True)),
    )


def stamps(form):
    begin = datetime.datetime(2026, 3, 1, 23, 59, 59, 900000)
    return [(begin + datetime.timedelta(seconds=float(t))).strftime(form) for t in T]


@dialect("sweep_1.csv")
def dates_and_times_past_midnight(path):
    text(
        path,
        "Timestamp;Force [N];Velocity [m/s]",
        *(
            f"{s};{f:.7g};{v:.7g}"
            for s, f, v in zip(stamps("%Y-%m-%d %H:%M:%S.%f"), FORCE, VELOCITY, strict=True)
        ),
    )


@dialect("sweep_1.csv")
def times_of_day(path):
    text(
        path,
        "Time;Force [N];Velocity [m/s]",
        *(
            f"{s};{f:.7g};{v:.7g}"
            for s, f, v in zip(stamps("%H:%M:%S.%f"), FORCE, VELOCITY, strict=True)
        ),
    )


@dialect(
    "sweep_1.csv", fs=FS / 2, truth={"force": LEAST_FORCE, "velocity": LEAST_VELOCITY}, rtol=2e-3
)
def two_rates_side_by_side(path):
    lines = [
        (f"{2 * T[i]:.7g},{FORCE[2 * i]:.7g}" if i < N // 2 else ",") + f",{T[i]:.7g},{v:.7g}"
        for i, v in enumerate(VELOCITY)
    ]
    text(path, "Time_F (s),Force (N),Time_V (s),Velocity (m/s)", *lines)


@dialect(
    "sweep_1.csv", fs=FS / 2, truth={"force": LEAST_FORCE, "velocity": LEAST_VELOCITY}, rtol=2e-3
)
def a_slower_channel_between_empty_cells(path):
    lines = [
        f"{T[i]:.7g}," + (f"{f:.7g}" if i % 2 == 0 else "") + f",{VELOCITY[i]:.7g}"
        for i, f in enumerate(FORCE)
    ]
    text(path, "Time (s),Force (N),Velocity (m/s)", *lines)


@dialect("hammer_1.csv", **DECAY)
def units_behind_an_underscore(path):
    text(path, "time_ms,acc_g", *rows((1e3 * T, ACCELERATION / G)))


@dialect("hammer_1.csv", **DECAY)
def units_above_the_names(path):
    text(
        path,
        ",[ms],[g]",
        "Sample,Time,Acc",
        *(f"{i},{row}" for i, row in enumerate(rows((1e3 * T, ACCELERATION / G)))),
    )


@dialect("hammer_1.txt", **DECAY)
def rate_and_unit_above_one_column(path):
    text(path, "fs = 1024", "Unit: g", "acc", *rows((ACCELERATION / G,), form="{:.6f}"))


@dialect("hammer_1.csv", **DECAY)
def times_since_1970(path):
    text(
        path,
        "timestamp,acc [m/s2]",
        *(f"{1.7e9 + t:.7f},{a:.7g}" for t, a in zip(T, ACCELERATION, strict=True)),
    )


@dialect("hammer_1.csv", **DECAY)
def imperial_words(path):
    text(path, "Time (sec),Accel (in/sec^2)", *rows((T, ACCELERATION / 0.0254)))


@dialect("impact_1.csv", asks=True, **DECAY)
def no_unit_at_all(path):
    text(path, "time,acceleration", *rows((T, ACCELERATION)))


# --- recorders that write text ---
def lvm(path, separator, decimal, has_times):
    mark = {"Tab": "\t", "Comma": ","}[separator]
    head = [
        "LabVIEW Measurement",
        f"Writer_Version{mark}2",
        f"Separator{mark}{separator}",
        f"Decimal_Separator{mark}{decimal}",
        f"Multi_Headings{mark}No",
        f"X_Columns{mark}{'One' if has_times else 'No'}",
        f"Time_Pref{mark}Relative",
        f"***End_of_Header***{mark}",
        mark,
        f"Channels{mark}2",
        mark.join(["Samples", str(N), str(N)]),
        mark.join(["Y_Unit_Label", "Newtons", "m/s"]),
        mark.join(["X_Dimension", "Time", "Time"]),
        mark.join(["X0", "0.0", "0.0"]),
        mark.join(["Delta_X", *2 * [f"{1 / FS:.10f}".replace(".", decimal)]]),
        f"***End_of_Header***{mark}{mark}",
        mark.join(["X_Value", "Force", "Velocity", "Comment"]),
    ]
    times = [f"{t:.7f}" if has_times else "" for t in T]
    body = [
        mark.join([t, f"{f:.7g}", f"{v:.7g}"]).replace(".", decimal)
        for t, f, v in zip(times, FORCE, VELOCITY, strict=True)
    ]
    text(path, *head, *body, end="\r\n")


@dialect("sweep_1.lvm", "NI LabVIEW LVM")
def labview_without_times(path):
    lvm(path, "Tab", ".", False)


@dialect("sweep_1.lvm", "NI LabVIEW LVM")
def labview_with_times_and_commas(path):
    lvm(path, "Tab", ",", True)


@dialect("sweep_1.txt", "NI LabVIEW LVM")
def labview_under_another_suffix(path):
    lvm(path, "Comma", ".", True)


@dialect("sweep_1.lvm", "NI LabVIEW LVM")
def labview_with_times_of_each_channel(path):
    text(
        path,
        *(line.replace("X_Columns\tNo", "X_Columns\tMulti") for line in LVM_HEAD),
        "Channels\t2\t\t\t",
        f"Samples\t{N}\t\t{N}\t",
        "Y_Unit_Label\tN\tm/s\t\t",
        END_OF_HEADER,
        "X_Value\tForce\tX_Value\tVelocity\tComment",
        *rows((T, FORCE, T, VELOCITY), "\t", form="{:.9f}"),
    )


LVM_HEAD = [
    "LabVIEW Measurement\t",
    "Writer_Version\t0.92",
    "Reader_Version\t1",
    "Separator\tTab",
    "Multi_Headings\tNo",
    "X_Columns\tNo",
    "Time_Pref\tAbsolute",
    "***End_of_Header***\t",
    "\t",
]
END_OF_HEADER = "***End_of_Header***\t\t\t"


@dialect("sweep_1.lvm", "NI LabVIEW LVM", fs=1 / 0.000977)
def labview_packets_under_one_header(path):
    text(
        path,
        *LVM_HEAD,
        "Channels\t2\t\t",
        f"Samples\t{N // 2}\t{N // 2}\t",
        "Y_Unit_Label\tN\tm/s\t",
        "X0\t0.0000000000000000E+0\t0.0000000000000000E+0\t",
        "Delta_X\t0.000977\t0.000977\t",
        END_OF_HEADER,
        "X_Value\tForce\tVelocity\tComment",
        *("\t" + line for line in rows((FORCE, VELOCITY), "\t", form="{:.9f}")),
    )


@dialect("sweep_1.lvm", "NI LabVIEW LVM")
def labview_with_an_empty_channel_and_a_note(path):
    text(
        path,
        *(line.strip().replace("X_Columns\tNo", "X_Columns\tOne") for line in LVM_HEAD),
        "Notes\tX values guaranteed valid only for Force",
        "Channels\t3",
        f"Samples\t{N}\t0\t{N}",
        "Y_Unit_Label\tN\tV\tm/s",
        "X0\t0.0000000000000000E+0\t0.0000000000000000E+0\t0.0000000000000000E+0",
        f"Delta_X\t{1 / FS:.6f}\t1.000000\t{1 / FS:.6f}",
        END_OF_HEADER.strip(),
        "X_Value\tForce\tUntitled\tVelocity\tComment",
        *(f"{t:.9f}\t{f:.6f}\t\t{v:.9f}" for t, f, v in zip(T, FORCE, VELOCITY, strict=True)),
    )


@dialect("sweep_1.csv", "DEWESoft")
def dewesoft_text(path):
    text(
        path,
        "File name:,rig.dxd",
        "Start time:,2026-03-01 10:00:00",
        "Number of channels:,2",
        "Sample rate:,1024",
        "Data info:,",
        "Time (s),AI 1 (N),AI 2 (m/s)",
        *rows(TFV),
    )


@dialect("sweep_1.csv", "PicoScope")
def picoscope_text(path):
    text(
        path,
        "Time,Channel A,Channel B",
        "(ms),(N),(mm/s)",
        "",
        *rows((1e3 * T, FORCE, 1e3 * VELOCITY)),
    )


@dialect("sweep_1.csv", "PicoScope")
def picoscope_text_with_blanks(path):
    text(
        path,
        "Time, Channel A, Channel B",
        "(µs), (N), (mm/s)",
        *rows((1e6 * T, FORCE, 1e3 * VELOCITY), ", ", form="{:.9g}"),
    )


@dialect("tap_1.csv", "phyphox", fs=FS, **DECAY)
def phyphox_even(path):
    text(
        path,
        '"Time (s)","Linear Acceleration x (m/s^2)","Linear Acceleration y (m/s^2)"',
        *rows((T, 0.001 * np.sin(9 * T), ACCELERATION), form="{:.8E}"),
    )


@dialect("tap_1.csv", "phyphox", **DECAY)
def phyphox_semicolons_and_a_shorter_column(path):
    rests = [*np.zeros(N - 2), np.nan, np.nan]
    text(
        path,
        '"Time (s)";"Acceleration x (m/s^2)";"Acceleration y (m/s^2)"',
        *(line.replace("NAN", "NaN")
          for line in rows((T, rests, ACCELERATION), ";", ",", form="{:.9E}")),
    )  # fmt: skip


@dialect("tap_1.csv", "Tektronix", **DECAY)
def tektronix(path):
    facts = [
        ("Record Length", f"{N:.6e}"),
        ("Sample Interval", f"{1 / FS:.10e}"),
        ("Trigger Point", "0"),
        ("Source", "CH1"),
        ("Vertical Units", "g"),
        ("Horizontal Units", "s"),
        ("Note", ""),
    ]
    facts += [("", "")] * (N - len(facts))
    text(
        path,
        *(
            f"{k},{v},,{t - 0.05:.8f},{a / G:.7g},"
            for (k, v), t, a in zip(facts, T, ACCELERATION, strict=True)
        ),
    )


@dialect("tap_1.csv", "Tektronix", **DECAY, rtol=2e-4)
def tektronix_in_fixed_widths(path):
    facts = [
        ("Record Length", "2.500000e+03"),
        ("Sample Interval", f"{1 / FS:.6e}"),
        ("Trigger Point", "1.000000000000e+02"),
        *3 * [("", "")],
        ("Source", "CH1"),
        ("Vertical Units", "g"),
        ("Vertical Scale", "5.000000e-02"),
        ("Vertical Offset", "0.000000e+00"),
        ("Horizontal Units", "s"),
        ("Pt Fmt", "Y"),
        ("Model Number", "TDS2014B"),
    ]
    facts += (N - len(facts)) * [("", "")]
    text(
        path,
        *(
            f"{k},{v},,{t - 100 / FS:016.12f},{a / G:10.5f},"
            for (k, v), t, a in zip(facts, T, ACCELERATION, strict=True)
        ),
    )


@dialect("sweep_1.csv", "Rigol", kind="sweep", roles=("force", "velocity"))
def rigol(path):
    text(
        path,
        "X,CH1,CH2,Start,Increment",
        f"Sequence,N,mm/s,0.0,{1 / FS:.10e}",
        *(
            f"{i},{f:.7g},{1e3 * v:.7g},"
            for i, (f, v) in enumerate(zip(FORCE, VELOCITY, strict=True))
        ),
    )


@dialect("sweep_1.csv", "Rigol")
def rigol_without_numbers_of_samples(path):
    text(
        path,
        "CH1,CH2,Start,Increment,",
        f"N,mm/s,-6.0e-02,{1 / FS:.10e}",
        *(f"{f:.7g},{1e3 * v:.7g}," for f, v in zip(FORCE, VELOCITY, strict=True)),
    )


@dialect("sweep_1.csv")
def words_in_a_column(path):
    lines = (f"unit 7,{row},ok" for row in rows(TFV))
    text(path, "rig,time [s],force [N],velocity [m/s],state", *lines)


@dialect("sweep_1.csv")
def dates_above_a_row_of_units(path):
    found = zip(stamps("%d.%m.%Y"), stamps("%H:%M:%S.%f"), FORCE, VELOCITY, strict=True)
    lines = (f"{day};{hour};{f:.7g};{v:.7g}" for day, hour, f, v in found)
    text(path, "Date;Time;Force;Velocity", "dd.mm.yyyy;hh:mm:ss.ffffff;N;m/s", *lines)


@dialect("sweep_1.csv")
def a_rate_in_a_sentence(path):
    lines = rows((FORCE, VELOCITY))
    text(path, "# hall 3, sampled at 1.024 kHz by hand", "force [N],velocity [m/s]", *lines)


@dialect("sweep_1.csv")
def comments_by_semicolons(path):
    text(path, ";SampleRate, 1024,Hz", ";Headers, time,force [N],velocity [m/s]", *rows(TFV),
         "; 3 stopped")  # fmt: skip


@dialect("sweep_1.csv")
def doubled_ends_and_null_bytes(path):
    text(path, "time [s],force [N],velocity [m/s]", *rows(TFV), end="\r\r\n")
    path.write_bytes(path.read_bytes() + b"\0" * 512)


@dialect("sweep_1.csv")
def times_called_by_their_unit(path):
    text(path, "ms,force [N],velocity [m/s]", *rows((1e3 * T, FORCE, VELOCITY)))


@dialect("frf.csv", kind="frf", fs=np.nan, roles=("frequency", "velocity", "phase"),
         truth={"velocity": np.abs(MOBILITY), "phase": np.angle(MOBILITY)})  # fmt: skip
def real_and_imaginary_parts(path):
    parts = rows((HZ, MOBILITY.real, MOBILITY.imag), ";", ",", "{:.9e}")
    text(path, "Format;Spectrum", "First;20,0", "Delta;0,25", "AxisUnit;Hz", "",
         "';Laser (Real);Laser (Imag.)", "';(m/s)/N;(m/s)/N", *parts)  # fmt: skip


@dialect("sweep_1.txt")
def catman_text(path):
    text(
        path,
        "HBM_CATMAN_DATAFILE",
        "Date\t01.03.2026",
        "Rate\t1024 Hz",
        "Time 1 [s]\tKraft 1 [N]\tWeg-Geschw. vel [mm/s]",
        *rows((T, FORCE, 1e3 * VELOCITY), "\t", ","),
    )


@dialect("sweep_1.txt")
def polytec_text(path):
    text(
        path,
        "Source File Name:\tscan.svd",
        "Point Index:\t1",
        "Signal:\tVelocity",
        "",
        "Time\tRef1 Force\tVelocity",
        "[ s ]\t[ N ]\t[ m/s ]",
        *rows(TFV, "\t"),
    )


@dialect("sweep_1.csv")
def m_and_p_text(path):
    text(
        path,
        "# SO Analyzer",
        "# Date: 2026-03-01",
        "# Time [s];Force [N];Velocity [m/s]",
        *rows(TFV, ";"),
    )


@dialect("sweep_1.txt")
def data_physics_text(path):
    text(
        path,
        "SignalCalc",
        "Test\tsweep",
        "X-axis (Sec)\tForce (N)\tVelocity (m/s)".replace("X-axis", "Time"),
        *rows(TFV, "\t", form="{:.6E}"),
    )


@dialect("sweep_1.csv")
def head_acoustics_text(path):
    text(
        path,
        "Title;Sweep",
        "Abtastrate;1024",
        "Time/s;Force/N;Velocity/(m/s)".replace("/", " / "),
        *rows(TFV, ";"),
    )


@dialect("sweep_1.csv")
def dantec_text(path):
    text(
        path,
        "BSA Flow Software",
        "Rows;384",
        "Time [ms];Force [N];LDA1-vel [m/s]",
        *rows((1e3 * T, FORCE, VELOCITY), ";", ","),
    )


@dialect("sweep_1.csv")
def prosig_text(path):
    text(
        path,
        "DATS export",
        "Sample Rate,1024,Hz",
        "Force (Newtons),Velocity (mm/sec)",
        *rows((FORCE, 1e3 * VELOCITY)),
    )


# --- curves ---
CURVE = {
    "kind": "frf",
    "fs": np.nan,
    "roles": ("velocity",),
    "truth": {"velocity": np.abs(MOBILITY), "phase": np.angle(MOBILITY), "frequency": HZ},
}


@dialect("curve_1.csv", **CURVE)
def mobility_in_decibels(path):
    text(
        path,
        "Frequency [Hz],Velocity [dB re 1e-3 m/s/N],Phase [deg]",
        *rows((HZ, 20 * np.log10(np.abs(MOBILITY) / 1e-3), np.degrees(np.angle(MOBILITY)))),
    )


@dialect("curve_1.csv", **CURVE)
def mobility_and_degrees_without_unit(path):
    text(
        path,
        "Frequency (RPM),Velocity (m/(N s)),Phase",
        *rows((60 * HZ, np.abs(MOBILITY), np.degrees(np.angle(MOBILITY)))),
    )


@dialect(
    "curve_1.txt",
    **{
        **CURVE,
        "roles": ("acceleration",),
        "truth": {"acceleration": np.abs(MOBILITY), "phase": np.angle(MOBILITY), "frequency": HZ},
    },
)
def accelerance_in_inverse_kilograms(path):
    text(
        path,
        "Frequency (Hz)\tAcceleration (1/kg)\tPhase (rad)",
        *rows((HZ, np.abs(MOBILITY), np.angle(MOBILITY)), "\t"),
    )


# --- MATLAB ---
def signal_of(values, unit, name, increment=1 / FS, axis="s"):
    return {
        "x_values": {
            "start_value": 0.0,
            "increment": increment,
            "number_of_values": 1.0 * len(values),
            "quantity": {"label": axis},
        },
        "y_values": {"values": values, "quantity": {"label": unit}},
        "function_record": {"name": name, "type": "Time"},
    }


@dialect("sweep_1.mat", "Siemens Testlab")
def testlab_two_signals(path):
    scipy.io.savemat(
        path,
        {
            "Signal_0": signal_of(FORCE, "N", "Force:+X"),
            "Signal_1": signal_of(1e3 * VELOCITY, "mm/s", "Vib:+Z"),
        },
    )


@dialect("hammer_1.mat", "Siemens Testlab", **DECAY)
def testlab_several_columns_of_one(path):
    values = np.column_stack([ACCELERATION / G, 0.1 * ACCELERATION / G])
    scipy.io.savemat(path, {"Signal": signal_of(values, "g", "Point")}, do_compression=True)


@dialect("curve_1.mat", "Siemens Testlab", **CURVE)
def testlab_frf(path):
    frf = signal_of(MOBILITY, "m/s/N", "FRF vel", increment=0.25, axis="Hz")
    frf["x_values"]["start_value"] = 20.0
    scipy.io.savemat(path, {"FRF": frf})


def flat(path, rate, units):
    channels = {}
    for i, (name, x) in enumerate((("Force", FORCE), ("Laser", 1e3 * VELOCITY)), 1):
        channels[f"Channel_{i}_Data"] = x
        channels[f"Channel_{i}_Header"] = {"SignalName": name, "Unit": units[i - 1]}
    head = {"SampleFrequency": rate, "NumberOfChannels": "2", "NumberOfSamplesPerChannel": str(N)}
    scipy.io.savemat(path, {"File_Header": head, **channels}, do_compression=True)


@dialect("sweep_1.mat", "HBK Pulse and HBM catman")
def pulse_flat(path):
    flat(path, "1024", ("N", "mm/s"))


@dialect("sweep_1.mat", "HBK Pulse and HBM catman")
def catman_flat_with_a_decimal_comma(path):
    flat(path, "1024,000 Hz", ("N", "mm/s"))


@dialect("sweep_1.mat", "DEWESoft", asks=True)
def dewesoft_mat(path):
    channels = {
        "Data1_Force": FORCE,
        "Data1_time_Force": T,
        "Data1_Velocity": VELOCITY,
        "Data1_time_Velocity": T,
    }
    scipy.io.savemat(path, channels, do_compression=True)


@dialect("sweep_1.mat", "MATLAB structs")
def a_timetable_as_struct(path):
    properties = {
        "VariableNames": np.array(["Time", "F", "Velo"], object),
        "VariableUnits": np.array(["s", "N", "m/s"], object),
    }
    scipy.io.savemat(
        path,
        {"TT": {"Time": T, "F": FORCE, "Velo": VELOCITY, "Properties": properties}},
        do_compression=True,
    )


@dialect("sweep_1.mat", "MATLAB structs")
def units_as_a_struct_and_the_rate_as_text(path):
    scipy.io.savemat(
        path,
        {
            "force": FORCE,
            "velocity": VELOCITY,
            "fs": "1024 Hz",
            "units": {"force": "N", "velocity": "m/s"},
        },
        do_compression=True,
    )


def v73(path, build):
    with h5py.File(path, "w", userblock_size=512) as file:

        def put(name, data, kind):
            file.create_dataset(name, data=data).attrs["MATLAB_class"] = np.bytes_(kind)

        build(file, put)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def codes(text):
    return np.array([[ord(letter)] for letter in text], np.uint16)


@dialect("curve_1.mat", "MATLAB structs", **CURVE)
def v73_with_a_complex_response(path):
    def build(file, put):
        z = np.zeros((len(HZ), 1), dtype=[("real", "<f8"), ("imag", "<f8")])
        z["real"][:, 0], z["imag"][:, 0] = MOBILITY.real, MOBILITY.imag
        put("velocity", z, "double")
        put("f", HZ[:, None], "double")
        group = file.create_group("units")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, unit in (("velocity", "m/s/N"), ("f", "Hz")):
            group.create_dataset(name, data=codes(unit)).attrs["MATLAB_class"] = np.bytes_("char")

    v73(path, build)


@dialect("hammer_1.mat", "MATLAB structs", **DECAY)
def v73_with_texts_and_an_empty_cell(path):
    def build(file, put):
        put("acc", ACCELERATION[None, :], "double")
        put("units", codes("m/s^2"), "char")
        put("Fs", codes("1024"), "char")
        empty = file.create_dataset("notes", data=np.array([0, 0], np.uint64))
        empty.attrs["MATLAB_class"], empty.attrs["MATLAB_empty"] = np.bytes_("cell"), np.uint8(1)

    v73(path, build)


@dialect("hammer_1.mat", "PicoScope", kind="decay", roles=(), asks=True)
def picoscope_mat(path):
    scipy.io.savemat(
        path,
        {
            "A": ACCELERATION.astype(np.float32),
            "Tinterval": 1 / FS,
            "Tstart": -0.1,
            "Length": float(N),
        },
    )


# --- Python ---
@dialect("sweep_1.h5", "Python tables")
def h5py_with_lists_in_attributes(path):
    with h5py.File(path, "w") as file:
        data = file.create_dataset("data", data=np.stack([FORCE, VELOCITY]).astype(">f4"))
        data.attrs["channel_names"] = ["force", "velocity"]
        data.attrs["units"] = ["N", "m/s"]
        data.attrs["dt"] = 1 / FS


@dialect("sweep_1.h5", "", rtol=1e-12)
def h5py_with_units_of_each(path):
    with h5py.File(path, "w") as file:
        file.attrs["sampling_rate"] = FS
        for name, x, unit in (("force", FORCE, "Newton"), ("velocity", 1e3 * VELOCITY, "mm/s")):
            file.create_dataset(f"run/{name}", data=x).attrs["units"] = unit


@dialect("sweep_1.nc", "Rattlesnake", rtol=1e-12)
def rattlesnake(path):
    with h5py.File(path, "w") as file:
        file.attrs["sample_rate"] = 1024
        file["time_data"] = np.stack([FORCE, VELOCITY])
        told = {"node_number": ("1", "101"), "node_direction": ("Z+", "Z+"),
                "channel_type": ("Force", "Velocity"), "unit": ("N", "m/s")}  # fmt: skip
        for name, words in told.items():
            file[f"channels/{name}"] = np.array(words, dtype=h5py.string_dtype())


@dialect("sweep_1.h5", "Python tables", asks=True, rtol=1e-12)
def a_data_frame_of_pandas(path):
    with h5py.File(path, "w") as file:
        group = file.create_group("df")
        group.attrs["pandas_type"] = np.bytes_("frame")
        group.create_dataset("block0_items", data=np.array([b"force", b"velocity"]))
        group.create_dataset("axis0", data=np.array([b"force", b"velocity"]))
        group.create_dataset("axis1", data=T)
        group.create_dataset("block0_values", data=np.column_stack([FORCE, VELOCITY]))


@dialect("sweep_1.nc", "xarray", rtol=1e-12)
def a_dataset_of_xarray(path):
    with h5py.File(path, "w") as file:
        for name, x, unit in (
            ("time", T, "s"),
            ("force", FORCE, "N"),
            ("velocity", VELOCITY, "m s-1"),
        ):
            file.create_dataset(name, data=x).attrs["units"] = np.bytes_(unit)


@dialect("sweep_1.nc", "xarray", rtol=1e-12)
def a_dataset_of_xarray_with_dates(path):
    with h5py.File(path, "w") as file:
        for name, x, unit in (
            ("time", np.round(1e9 * T).astype(np.int64), "nanoseconds since 2026-03-01 00:00:00"),
            ("force", FORCE, "N"),
            ("velocity", VELOCITY, "m s-1"),
        ):
            file.create_dataset(name, data=x).attrs["units"] = unit


@dialect("sweep_1.npz", "Python tables", rtol=1e-12)
def numpy_with_names_and_units(path):
    np.savez(
        path,
        data=np.stack([FORCE, VELOCITY]),
        names=["force", "velocity"],
        units=["N", "m/s"],
        fs=FS,
    )


@dialect("sweep_1.npz", "MATLAB structs", rtol=1e-12)
def numpy_arrays_and_their_units(path):
    np.savez(path, force=FORCE, velocity=VELOCITY, units=np.array(["N", "m/s"]), fs=FS)


@dialect("hammer_1.npz", "MATLAB structs", rtol=1e-12, **DECAY)
def numpy_with_an_interval(path):
    np.savez(path, acc=ACCELERATION, units=np.array(["m/s^2"]), dt=1 / FS)


@dialect("hammer_1.h5", "", rtol=1e-12, **DECAY)
def sep005_in_attributes(path):
    with h5py.File(path, "w") as file:
        facts = file.create_dataset("y", data=ACCELERATION / G).attrs
        facts["fs"], facts["unit_str"], facts["name"] = FS, "g", "tip acceleration"


# --- UFF, TDMS, WAV ---
def set58(name, values, unit, label, code, function=1, x=None):
    even = x is None
    return {
        "type": 58,
        "func_type": function,
        "binary": 0,
        "id1": name,
        "id2": "NONE",
        "id4": "NONE",
        "id5": "NONE",
        "rsp_node": 1,
        "rsp_dir": 3,
        "ref_node": 1,
        "ref_dir": 3,
        "abscissa_spacing": 1,
        "abscissa_min": 0.0 if even else float(x[0]),
        "abscissa_inc": 1 / FS if even else float(x[1] - x[0]),
        "num_pts": len(values),
        "ord_data_type": 6 if np.iscomplexobj(values) else 4,
        "data": values,
        "x": T if even else x,
        "abscissa_axis_units_lab": "s" if even else "Hz",
        "abscissa_spec_data_type": 17 if even else 18,
        "ordinate_spec_data_type": code,
        "ordinate_axis_lab": label,
        "ordinate_axis_units_lab": unit,
        "orddenom_spec_data_type": 13 if function == 4 else 0,
        "orddenom_axis_units_lab": "N" if function == 4 else "NONE",
    }


def uff(path, *sets):
    import pyuff

    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(list(sets), mode="add")


@dialect("sweep_1.uff", "Universal file 58")
def uff_named_by_identification(path):
    uff(path, set58("Force", FORCE, "N", "NONE", 13), set58("Laser", VELOCITY, "m/s", "NONE", 11))


@dialect("sweep_1.uff", "Universal file 58")
def uff_of_lines_that_are_not_filled(path):
    uff_named_by_identification(path)
    lines = [line.rstrip() for line in path.read_text().splitlines()]
    geometry = ["    -1", "  2411", "         1         1", "    -1"]
    path.write_text("\n".join([*geometry, *lines]) + "\n")


@dialect("sweep_1.unv", "Universal file 58")
def uff_named_by_axis(path):
    uff(
        path,
        set58("NONE", FORCE, "N", "Excitation", 13),
        set58("NONE", 1e3 * VELOCITY, "mm/s", "Response", 11),
    )


@dialect("curve_1.uff", "Universal file 58", **CURVE)
def uff_with_a_denominator(path):
    uff(path, set58("H1", MOBILITY, "m/s", "Velocity", 11, 4, HZ))


def tdms(path, channels, group="Log"):
    import nptdms

    with nptdms.TdmsWriter(str(path)) as writer:
        for name, x, facts in channels:
            writer.write_segment([nptdms.ChannelObject(group, name, x, facts)])


@dialect("sweep_1.tdms", "NI TDMS", rtol=1e-12)
def tdms_with_unit_words(path):
    tdms(
        path,
        [
            ("cDAQ1Mod1/ai0 Force", FORCE, {"wf_increment": 1 / FS, "unit_string": "Newtons"}),
            ("Vib", VELOCITY / 0.0254, {"wf_increment": 1 / FS, "unit_string": "ips"}),
        ],
    )


@dialect("sweep_1.tdms", "NI TDMS", rtol=1e-12)
def tdms_with_a_channel_of_times(path):
    tdms(
        path,
        [
            ("Time", T, {"unit_string": "s"}),
            ("Force", FORCE, {"unit_string": "N"}),
            ("Velocity", VELOCITY, {"NI_UnitDescription": "m/s"}),
        ],
    )


@dialect(
    "sweep_1.tdms",
    "NI TDMS",
    fs=FS / 2,
    rtol=2e-3,
    truth={"force": LEAST_FORCE, "velocity": LEAST_VELOCITY},
)
def tdms_of_two_rates(path):
    tdms(
        path,
        [
            ("Force", FORCE, {"wf_increment": 1 / FS, "unit_string": "N"}),
            ("Velocity", VELOCITY[::2], {"wf_increment": 2 / FS, "unit_string": "m/s"}),
        ],
    )


@dialect("hammer_1.wav", "WAV", kind="decay", roles=(), asks=True)
def wav_without_a_scale(path):
    scipy.io.wavfile.write(path, int(FS), (6000 * ACCELERATION).astype(np.int16))
