"""What the channels of a file may be, guessed from their names, shapes and units."""

import re
from collections.abc import Mapping
from pathlib import Path

from jbw.campaign.keys import KINDS, RESPONSES, SOURCES
from jbw.errors import ConfigError
from jbw.measurement.files.tree import Leaf
from jbw.measurement.roles import ROLES, si_of

# A channel's name to its role, most telling first.
HINTS = (
    (r"^t$|time|zeit", "time"),
    (r"restoring|friction", "restoring_force"),
    (r"^freq|^f_?hz$", "frequency"),
    (r"phase|^phi$", "phase"),
    (r"vel|laser|vib|^v$|ldv", "velocity"),
    (r"acc", "acceleration"),
    (r"dis[pl]|lvdt|^[yx]$|pos", "displacement"),
    (r"force|load|^f$", "force"),
    (r"input|shaker|volt|drive|source|amp|^u$|^v1$", "input"),
)
KIND_HINTS = {
    "step": "stepped",
    "tone": "tones",
    "hammer": "decay",
    "impact": "decay",
    "msine": "multisine",
    "sinesw": "sweep",
}
FEW_COLUMNS = 16  # a table of more is no record of a few channels


def series_in(leaves: Mapping[str, Leaf]) -> dict[str, Leaf]:
    """The arrays that are one series, and the rows or columns of narrow tables, by their paths."""
    found: dict[str, Leaf] = {}
    for name, leaf in leaves.items():
        long = [length for length in leaf.shape if length > 1]
        if len(long) == 1:
            found[name] = leaf
        elif len(leaf.shape) == 2 and min(long, default=0) <= FEW_COLUMNS < max(long, default=0):
            along_rows = leaf.shape[0] < leaf.shape[1]
            found |= {
                f"{name}[{i}]" if along_rows else f"{name}[:, {i}]": leaf for i in range(min(long))
            }
    return found


def records_in(series: Mapping[str, Leaf]) -> list[dict[str, Leaf]]:
    """Series by the struct or group that they lie in, where several hold the same names."""
    groups: dict[str, dict[str, Leaf]] = {}
    for name, leaf in series.items():
        groups.setdefault(name.rpartition(".")[0], {})[name] = leaf
    fields = {frozenset(map(last_name, group)) for group in groups.values()}
    alike = len(groups) > 1 and len(fields) == 1
    return list(groups.values()) if alike else [dict(series)]


def last_name(path: str) -> str:
    """The last name of a path, without what follows in brackets."""
    return re.split(r"[./]", re.sub(r"\[[^\]]*\]", "", path))[-1].lower()


def roles_of(series: Mapping[str, Leaf]) -> dict[str, str]:
    """Role to channel, by the channels' names, and by their units where the file gives them."""
    roles: dict[str, str] = {}
    for name, leaf in series.items():
        role = _role(name, leaf.unit)
        if role and role not in roles:
            roles[role] = name
    if {"frequency", "phase", "force", "input"} <= set(roles) and not RESPONSES & set(roles):
        # Beside a force and a phase, an amplitude is that of the response.
        roles["acceleration"] = roles.pop("input")
    return roles


def _role(name: str, unit: str) -> str:
    last = last_name(name)
    by_name = [last] if last in ROLES else []
    by_name += [role for pattern, role in HINTS if re.search(pattern, last)]
    return next((role for role in by_name if _agrees(role, unit)), "")


def _agrees(role: str, unit: str) -> bool:
    if not unit:
        return True
    try:
        si_of(role, unit)
    except ConfigError:
        return False
    return True


def kind_of(path: Path, roles: Mapping[str, str]) -> tuple[str, bool]:
    """Kind of a test by its file's name and channels, and whether these say so."""
    if {"frequency", "phase"} <= set(roles):
        return "frf", True
    name = path.stem.lower()
    driven = bool(SOURCES & set(roles))
    fitting = {"decay": True, "loop": "restoring_force" in roles, "frf": False}
    for hint, kind in {**{kind: kind for kind in KINDS}, **KIND_HINTS}.items():
        if hint in name and fitting.get(kind, driven):
            return kind, True
    if not driven and {"restoring_force", "displacement"} <= set(roles):
        return "loop", False
    return ("sweep" if driven else "decay"), False
