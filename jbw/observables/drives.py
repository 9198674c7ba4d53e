r"""Parameters per drive: one joint, but a natural frequency, damping and gain for each drive.

A measured force moves the structure alone; free motion is that of the structure alone, too. A
voltage or a current moves it with its shaker, whose armature is part of the oscillating system:

$$\omega_n' \ne \omega_n, \qquad \zeta' \ne \zeta, \qquad g' \ne g$$

If both are measured, the parameters of the structure alone have the plain names, and those of
another drive carry its name, as `omega_n_voltage`. Offsets of runs are added to both. A base that
moves carries no armature: beside a force it only has its own gain, `gain_base`, the participation
of the mode. A campaign with a single drive has the plain names, whatever the drive is.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from jbw.measurement.records import BASE
from jbw.measurement.resonances import AmplitudeCurve, oscillator_through
from jbw.observables.line_fit import LEAST_LINES
from jbw.observables.modes import with_ratios
from jbw.observables.observable import Observable, SteadyLines
from jbw.quantities import FED, LINEAR, OSCILLATOR, STUCK

NAMES = tuple(quantity.name for quantity in OSCILLATOR)
# damping ratio that is assumed if unknown, and smallest damping ratio
DAMPED, LEAST_DAMPED = 0.02, 1e-4
# The separate parameters of each drive, and their names without the drive.
OWN = {**dict.fromkeys(FED, NAMES), BASE: ("gain",)}
PLAIN = {f"{name}_{drive}": name for drive, names in OWN.items() for name in names}


def named(name: str, drive: str) -> str:
    """Return the name of an oscillator parameter for a drive, such as omega_n_voltage."""
    return f"{name}_{drive}"


def plain(name: str) -> str:
    """Return a parameter's name without the drive, such as omega_n for omega_n_voltage."""
    return PLAIN.get(name, name)


def of_drive[Value](theta: Mapping[str, Value], drive: str) -> Mapping[str, Value]:
    """Return the parameters that apply to a drive, keyed by names without the drive's suffix."""
    drive_theta = {name: theta[named(name, drive)] for name in NAMES if named(name, drive) in theta}
    return {**theta, **drive_theta} if drive_theta else theta


def attached(parts: Sequence[Observable]) -> tuple[str, ...]:
    """Return the drives that occur in names of parameters, such as voltage in omega_n_voltage."""
    drives = {part.drive for part in parts if part.drive}
    fed = tuple(drive for drive in FED if drive in drives)
    moved = (BASE,) if {BASE, "force"} <= drives else ()
    return (*(fed if drives - set(fed) else fed[1:]), *moved)


def parts_of(drive: str, parts: Sequence[Observable]) -> list[Observable]:
    """Return the dataset parts with a drive's own parameters; for "", the parts without a drive."""
    others = attached(parts)
    return [part for part in parts if (part.drive if part.drive in others else "") == drive]


def readings_of(parts: Sequence[Observable]) -> AmplitudeCurve | None:
    """Return measured frequencies and damping ratios against amplitude; None if there are none."""
    # Only one drive is used, because the damping at small amplitude differs between drives.
    of_one = parts_of("", parts)
    of_parts = (part.shown().amplitude_readings() for part in of_one)
    curves = [readings for readings in of_parts if readings is not None]
    if not curves:
        return None
    columns = [*zip(*curves, strict=True)]
    curve = AmplitudeCurve(
        *map(np.concatenate, columns[:3]), *(np.asarray(block_diag(*x)) for x in columns[3:])
    )
    takes_in = curve.zeta > 0  # A joint cannot supply energy, so a negative damping is invalid.
    return curve.at(takes_in) if takes_in.any() else None


def used_by(parts: Sequence[Observable], known: Collection[str]) -> list[str]:
    """Return, in a fixed order, which of the known oscillator parameters the dataset parts need.

    A drive without its own name there uses the plain one. Parameters of other modes follow.
    """
    used = {drive_name if (drive_name := named(name, part.drive)) in known else name
            for name in NAMES for part in parts}  # fmt: skip
    if any(part.modes for part in parts):
        used |= {quantity.name for quantity in STUCK[len(LINEAR) :]}
    return [quantity.name for quantity in STUCK if quantity.name in used and quantity.name in known]


def informed_by(parts: Sequence[Observable]) -> frozenset[str]:
    """Return those of omega_n, zeta and gain that the dataset parts determine jointly.

    Free motion determines stiffness / mass, a prescribed displacement the stiffness [N/m]:
    together they determine the modal mass, which neither determines alone.
    """
    informed = frozenset[str]().union(*(part.informs for part in parts))
    moves = any("omega_n" in part.informs and not part.is_prescribed for part in parts)
    weighs = moves and any(part.is_prescribed for part in parts)
    return informed | {"gain"} if weighs else informed


def by_secant(parts: Sequence[Observable]) -> frozenset[str]:
    """Return those of omega_n, zeta and gain that only the secant stiffness of a loop determines.

    These are only starting values: the motion of no part determines them.
    """
    if not any(part.is_prescribed for part in parts):
        return frozenset()
    by_part = (part.shown().first_values() for part in parts_of("", parts))
    return frozenset(NAMES) - frozenset[str]().union(*by_part)


def told_by(parts: Sequence[Observable], held: Mapping[str, Any] | None = None) -> dict[str, float]:
    """Return starting values of omega_n [rad/s], zeta and gain of each drive, if tests show them.

    They come from the first part of the drive that can give them, else from another drive. A fixed
    gain (in `held`) determines the damping if only steady lines are measured.
    """
    by_drive = {drive: parts_of(drive, parts) for drive in ("", *attached(parts))}
    values_by_drive = {
        drive: _first(drive_parts, _gain_of(held, drive)) for drive, drive_parts in by_drive.items()
    }
    first_known = next(filter(None, values_by_drive.values()), {})
    begun = {
        drive: values_by_drive[drive] or _with_gain(first_known, drive_parts)
        for drive, drive_parts in by_drive.items()
    }
    others = {
        named(n, drive): x
        for drive, values in begun.items()
        for n, x in values.items()
        if named(n, drive) in PLAIN
    }
    return begun[""] | others


def _gain_of(held: Mapping[str, Any] | None, drive: str) -> float | None:
    """Return the gain of a drive if it is fixed; otherwise None."""
    value = (held or {}).get(named("gain", drive) if drive else "gain")
    return None if value is None else float(value)


def _first(parts: Sequence[Observable], gain: float | None) -> dict[str, float]:
    values: dict[str, float] = {}
    if any(part.modes for part in parts):
        for part in parts:  # Different parts may measure the gains of different modes.
            values = part.shown().first_values() | values
        return with_ratios(values)
    values = next((values for part in parts if (values := part.shown().first_values())), {})
    if "gain" in values:
        return values
    if "omega_n" in values and "zeta" not in values:
        values = {**values, "zeta": _damping(values["omega_n"], gain, lines_of(parts))}
    return _with_gain(values, parts) if values else _through(lines_of(parts))


def lines_of(parts: Sequence[Observable]) -> SteadyLines | None:
    """Return the steady harmonics of all dataset parts, scaled to a motion of 1 m, or None."""
    lines_by_part = [
        part_lines for part in parts if (part_lines := part.shown().steady_lines()) is not None
    ]
    if not lines_by_part:
        return None
    omega, load, motion = (np.concatenate(columns) for columns in zip(*lines_by_part, strict=True))
    return SteadyLines(omega, load / motion, np.ones_like(motion))


def _damping(omega_n: float, gain: float | None, lines: SteadyLines | None) -> float:
    r"""Return a starting damping ratio from a known gain and the steady harmonics per metre.

    $$\zeta = \min \frac{g\,\mathrm{Im}\,U}{2\,\omega_n\,\omega}$$

    and `DAMPED` if the gain is not known. The least ratio is used because the joint adds damping.
    """
    if gain is None or lines is None:
        return DAMPED
    ratios = gain * np.imag(lines.load) / (2 * omega_n * lines.omega)
    return float(np.clip(np.min(ratios), LEAST_DAMPED, 1.0))


def _with_gain(values: Mapping[str, float], parts: Sequence[Observable]) -> dict[str, float]:
    r"""Return starting values with the gain that fits the steady harmonics to omega_n and zeta.

    $$g = \frac{\mathrm{Re} \sum U^* r}{\sum |U|^2}, \qquad
      r = \omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega$$

    per metre of motion. Without lines the gain stays as it is known. The loop of a slipping joint
    is softer than that of the stuck joint, so that the gain is then too large.
    """
    lines = lines_of(parts)
    if lines is None or not {"omega_n", "zeta"} <= values.keys():
        return dict(values)
    omega_n, load = values["omega_n"], lines.load
    stiffness = omega_n**2 - lines.omega**2 + 2j * values["zeta"] * omega_n * lines.omega
    gain = np.vdot(load, stiffness).real / np.vdot(load, load).real
    return {**values, "gain": float(gain)}


def _through(lines: SteadyLines | None) -> dict[str, float]:
    """Fit an oscillator to spectral lines; return an empty dictionary if they are too few."""
    if lines is None:
        return {}
    moving = len(np.unique(lines.omega[lines.omega > 0]))
    is_enough = moving >= LEAST_LINES or (moving and np.any(lines.omega == 0))
    return oscillator_through(*lines) if is_enough else {}
