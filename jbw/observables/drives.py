r"""Drives side by side: one joint, and a natural frequency, damping and gain for each.

A measured force moves the structure alone, and so does nothing at all. A voltage or a current moves
it with its shaker, of which the armature is a part of what oscillates:

$$\omega_n' \ne \omega_n, \qquad \zeta' \ne \zeta, \qquad g' \ne g$$

Where both are measured, the parameters have the names of the structure alone, and those of another
drive its name behind theirs, as `omega_n_voltage`. Offsets of runs are added to either. A campaign
of one drive has the plain names, whatever it is.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from jbw.measurement.resonances import AmplitudeCurve
from jbw.observables.line_fit import LEAST_LINES, oscillator_through
from jbw.observables.modes import with_ratios
from jbw.observables.observable import Observable, SteadyLines
from jbw.quantities import ATTACHED, FED, LINEAR, OSCILLATOR, STUCK

NAMES = tuple(quantity.name for quantity in OSCILLATOR)
DAMPED, LEAST_DAMPED = 0.02, 1e-4  # damping ratios: where nothing tells it, and at least
PLAIN = {quantity.name: plain for quantity, plain in zip(ATTACHED, NAMES * len(FED), strict=True)}


def named(name: str, drive: str) -> str:
    """Return the name of an oscillator parameter that belongs to another drive."""
    return f"{name}_{drive}"


def plain(name: str) -> str:
    """Return a parameter's name without its drive: omega_n for omega_n_voltage."""
    return PLAIN.get(name, name)


def of_drive[Value](theta: Mapping[str, Value], drive: str) -> Mapping[str, Value]:
    """Return the parameters with those of a drive under their plain names, where it has its own."""
    drive_theta = {name: theta[named(name, drive)] for name in NAMES if named(name, drive) in theta}
    return {**theta, **drive_theta} if drive_theta else theta


def of_part[Value](theta: Mapping[str, Value], part: Observable) -> Mapping[str, Value]:
    """Return the parameters as a part of the data takes them."""
    return of_drive(theta, part.drive)


def attached(parts: Sequence[Observable]) -> tuple[str, ...]:
    """Return the drives whose parameters carry the drive in their names, as omega_n_voltage."""
    drives = {part.drive for part in parts if part.drive}
    fed = tuple(drive for drive in FED if drive in drives)
    return fed if drives - set(fed) else fed[1:]


def parts_of(drive: str, parts: Sequence[Observable]) -> list[Observable]:
    """Return the parts of data that use a drive's own parameters ("": the plain parameters)."""
    others = attached(parts)
    return [part for part in parts if (part.drive if part.drive in others else "") == drive]


def readings_of(parts: Sequence[Observable]) -> AmplitudeCurve | None:
    """Collect readings of frequency and damping over amplitude, from decays and held responses."""
    of_one = parts_of("", parts)  # another drive's begin at another damping
    of_parts = (part.shown().amplitude_readings() for part in of_one)
    curves = [readings for readings in of_parts if readings is not None]
    if not curves:
        return None
    columns = [*zip(*curves, strict=True)]
    curve = AmplitudeCurve(
        *map(np.concatenate, columns[:3]), *(np.asarray(block_diag(*x)) for x in columns[3:])
    )
    takes_in = curve.zeta > 0  # a joint cannot give energy out: such a reading is none
    return curve.at(takes_in) if takes_in.any() else None


def used_by(parts: Sequence[Observable], known: Collection[str]) -> list[str]:
    """Return the names in `known` of omega_n, zeta and gain that parts use, in `STUCK`'s order.

    Where a drive has none of its own there, it takes the plain ones. Then those of further modes.
    """
    used = {drive_name if (drive_name := named(name, part.drive)) in known else name
            for name in NAMES for part in parts}  # fmt: skip
    if any(part.modes for part in parts):
        used |= {quantity.name for quantity in STUCK[len(LINEAR) :]}
    return [quantity.name for quantity in STUCK if quantity.name in used and quantity.name in known]


def informed_by(parts: Sequence[Observable]) -> frozenset[str]:
    """Return the names among omega_n, zeta and gain that parts of one drive constrain together.

    A free motion tells stiffness over mass, a prescribed displacement the stiffness [N/m]: together
    the modal mass, which neither tells alone.
    """
    informed = frozenset[str]().union(*(part.informs for part in parts))
    moves = any("omega_n" in part.informs and not part.is_prescribed for part in parts)
    weighs = moves and any(part.is_prescribed for part in parts)
    return informed | {"gain"} if weighs else informed


def by_secant(parts: Sequence[Observable]) -> frozenset[str]:
    """Return the names among omega_n, zeta and gain that only the secant of a loop constrains.

    First values alone: no part tells them by its motion.
    """
    if not any(part.is_prescribed for part in parts):
        return frozenset()
    by_part = (part.shown().first_values() for part in parts_of("", parts))
    return frozenset(NAMES) - frozenset[str]().union(*by_part)


def told_by(parts: Sequence[Observable], held: Mapping[str, Any] | None = None) -> dict[str, float]:
    """Return starting values of omega_n [rad/s], zeta [-] and gain per drive; {} if unknown.

    As the drive's first part tells them that can; where none can, they begin at another drive's.
    A gain that is `held` tells the damping where lines alone do.
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
        named(n, drive): x for drive, values in begun.items() if drive for n, x in values.items()
    }
    return begun[""] | others


def _gain_of(held: Mapping[str, Any] | None, drive: str) -> float | None:
    """Return a drive's gain where it is held."""
    value = (held or {}).get(named("gain", drive) if drive else "gain")
    return None if value is None else float(value)


def _first(parts: Sequence[Observable], gain: float | None) -> dict[str, float]:
    values: dict[str, float] = {}
    if any(part.modes for part in parts):
        for part in parts:  # of several modes each part may tell its own
            values = part.shown().first_values() | values
        return with_ratios(values)
    values = next((values for part in parts if (values := part.shown().first_values())), {})
    if "gain" in values:
        return values
    if "omega_n" in values and "zeta" not in values:
        values = {**values, "zeta": _damping(values["omega_n"], gain, lines_of(parts))}
    return _with_gain(values, parts) if values else _through(lines_of(parts))


def lines_of(parts: Sequence[Observable]) -> SteadyLines | None:
    """Return the lines of steady motion of all parts, by a motion of 1 m; None without any."""
    lines_by_part = [
        part_lines for part in parts if (part_lines := part.shown().steady_lines()) is not None
    ]
    if not lines_by_part:
        return None
    omega, load, motion = (np.concatenate(columns) for columns in zip(*lines_by_part, strict=True))
    return SteadyLines(omega, load / motion, np.ones_like(motion))


def _damping(omega_n: float, gain: float | None, lines: SteadyLines | None) -> float:
    r"""Return the damping ratio of lines U per metre of motion by a gain, to which a joint adds.

    $$\zeta = \min \frac{g\,\mathrm{Im}\,U}{2\,\omega_n\,\omega}$$

    and `DAMPED` where the gain is not known.
    """
    if gain is None or lines is None:
        return DAMPED
    ratios = gain * np.imag(lines.load) / (2 * omega_n * lines.omega)
    return float(np.clip(np.min(ratios), LEAST_DAMPED, 1.0))


def _with_gain(values: Mapping[str, float], parts: Sequence[Observable]) -> dict[str, float]:
    r"""Return the values with the gain by which lines U of the parts are those of omega_n and zeta.

    $$g = \frac{\mathrm{Re} \sum U^* r}{\sum |U|^2}, \qquad
      r = \omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega$$

    per metre of motion. Where none has lines, the gain stays as it is known. A loop of a joint that
    slips is softer than the sticking one, by which its gain is too large.
    """
    lines = lines_of(parts)
    if lines is None or not {"omega_n", "zeta"} <= values.keys():
        return dict(values)
    omega_n, load = values["omega_n"], lines.load
    stiffness = omega_n**2 - lines.omega**2 + 2j * values["zeta"] * omega_n * lines.omega
    gain = np.vdot(load, stiffness).real / np.vdot(load, load).real
    return {**values, "gain": float(gain)}


def _through(lines: SteadyLines | None) -> dict[str, float]:
    """Fit an oscillator through lines; return {} where the lines are too few."""
    if lines is None:
        return {}
    moving = len(np.unique(lines.omega[lines.omega > 0]))
    is_enough = moving >= LEAST_LINES or (moving and np.any(lines.omega == 0))
    return oscillator_through(*lines) if is_enough else {}
