"""What a channel can be: roles, and the quantity that each measures."""

from jbw.errors import ConfigError
from jbw.measurement.records import RESPONSES
from jbw.units import FACTORS, plain, quantity_of, si_unit

# A role may admit several quantities: a source is a voltage, or already a force per modal mass.
QUANTITIES: dict[str, tuple[str, ...]] = {
    "input": ("voltage", "force per mass"),
    "force": ("force",),
    "displacement": ("displacement",),
    "velocity": ("velocity",),
    "acceleration": ("acceleration",),
    "restoring_force": ("force",),
    "frequency": ("frequency",),  # axis of a measured FRF, which has no sampling frequency
    "phase": ("angle",),  # of the response relative to the force, in a measured FRF
    "time": ("time",),  # gives the sampling frequency; not kept as a channel
}
ROLES = tuple(QUANTITIES)


def ratio_of(role: str, unit: str) -> tuple[float, str] | None:
    """Factor to SI of a unit such as `m/s^2/N`, and the role of what it divides by.

    Args:
        role: The response's role.
        unit: Its unit in the file.

    Returns:
        The factor and `force` or `input`; None when the unit is no ratio of that kind.
    """
    if role not in RESPONSES:
        return None
    above, _, below = plain(unit).rpartition("/")
    above = above.strip("()")
    below = below.strip("()")
    for source in ("force", "input"):
        for quantity in QUANTITIES[source]:
            if below in FACTORS[quantity] and above in FACTORS[QUANTITIES[role][0]]:
                factor = FACTORS[QUANTITIES[role][0]][above] / FACTORS[quantity][below]
                return factor, source
    return None


def si_of(role: str, unit: str) -> tuple[float, str]:
    """Factor to SI and SI unit of a role whose channel is in `unit`.

    Raises:
        ConfigError: The unit is unknown or measures something else than the role.
    """
    try:
        quantity = quantity_of(unit, QUANTITIES[role])
    except ConfigError as error:
        what = f"Role `{role}`: {error.what}"
        raise ConfigError(what, why=error.why, remedy=error.remedy) from None
    return FACTORS[quantity][plain(unit)], si_unit(quantity)
