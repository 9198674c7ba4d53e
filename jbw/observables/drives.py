r"""Drives side by side: one joint, and a natural frequency, damping and gain for each.

A measured force moves the structure alone, and so does nothing at all. A voltage or a current moves
it with its shaker, of which the armature is a part of what oscillates:

$$\omega_n' \ne \omega_n, \qquad \zeta' \ne \zeta, \qquad g' \ne g$$

Where both are measured, the parameters have the names of the structure alone, and those of another
drive its name behind theirs, as `omega_n_voltage`. Offsets of runs are added to either. A campaign
of one drive has the plain names, whatever it is.
"""

from collections.abc import Collection, Mapping, Sequence

from jbw.observables.modes import with_ratios
from jbw.observables.observable import Observable
from jbw.quantities import ATTACHED, FED, LINEAR, OSCILLATOR, STUCK

NAMES = tuple(quantity.name for quantity in OSCILLATOR)
PLAIN = {quantity.name: plain for quantity, plain in zip(ATTACHED, NAMES * len(FED), strict=True)}


def named(name: str, drive: str) -> str:
    """What a parameter of the oscillator is called that is another drive's."""
    return f"{name}_{drive}"


def plain(name: str) -> str:
    """What a parameter is called of its own drive alone: omega_n of omega_n_voltage."""
    return PLAIN.get(name, name)


def of_drive[Value](theta: Mapping[str, Value], drive: str) -> Mapping[str, Value]:
    """Parameters with those of a drive under their plain names, where it has its own."""
    own = {name: theta[named(name, drive)] for name in NAMES if named(name, drive) in theta}
    return {**theta, **own} if own else theta


def of_part[Value](theta: Mapping[str, Value], part: Observable) -> Mapping[str, Value]:
    """Parameters as a part of the data takes them."""
    return of_drive(theta, part.drive)


def attached(parts: Sequence[Observable]) -> tuple[str, ...]:
    """Drives that have names of their own: beside the structure alone, else beside the first."""
    known = {part.drive for part in parts if part.drive}
    fed = tuple(drive for drive in FED if drive in known)
    return fed if known - set(fed) else fed[1:]


def parts_of(drive: str, parts: Sequence[Observable]) -> list[Observable]:
    """Parts that take the parameters of a drive with its own names, or, of "", the plain ones."""
    others = attached(parts)
    return [part for part in parts if (part.drive if part.drive in others else "") == drive]


def used_by(parts: Sequence[Observable], known: Collection[str]) -> list[str]:
    """Names among `known` of omega_n, zeta and gain as parts take them, those of `STUCK` in order.

    Where a drive has none of its own there, it takes the plain ones. Then those of further modes.
    """
    used = {own if (own := named(name, part.drive)) in known else name
            for name in NAMES for part in parts}  # fmt: skip
    if any(part.modes for part in parts):
        used |= {one.name for one in STUCK[len(LINEAR) :]}
    return [one.name for one in STUCK if one.name in used and one.name in known]


def told_by(parts: Sequence[Observable]) -> dict[str, float]:
    """First values of omega_n [rad/s], zeta [-] and gain of every drive; nothing if unknown.

    As the drive's first part tells them that can; where none can, they begin at another drive's.
    """
    found = {drive: _first(parts_of(drive, parts)) for drive in ("", *attached(parts))}
    known = next(filter(None, found.values()), {})
    others = [(drive, values or known) for drive, values in found.items() if drive]
    own = {named(name, drive): x for drive, values in others for name, x in values.items()}
    return (found[""] or known) | own


def _first(parts: Sequence[Observable]) -> dict[str, float]:
    if not any(part.modes for part in parts):
        return next((found for part in parts if (found := part.first_values())), {})
    found: dict[str, float] = {}
    for part in parts:  # of several modes each part may tell its own
        found = part.first_values() | found
    return with_ratios(found)
