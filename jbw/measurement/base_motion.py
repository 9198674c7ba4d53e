r"""Records of a structure on a moving base, converted to records of the structure under a force.

With the motion $y$ of a point relative to the base, the acceleration $a_b$ of the base and the
participation $p$ of the mode, of a shape that is 1 at the point,

$$\ddot y + 2\zeta\omega_n\dot y + \omega_n^2 y + \ldots = -p\,a_b, \qquad \ddot y = a - a_b,$$

where $a$ is the acceleration that an accelerometer at the point measures. The source is $-a_b$,
in N/kg, and its gain is $p$.
"""

from dataclasses import replace

from jbw.measurement.records import BASE, Record

MINUS_BASE = "input"  # channel role of -a_b, the negative base acceleration


def beside_base(record: Record, *, is_relative: bool) -> Record:
    """Return a record with the motion relative to the base, and the equivalent force per mass.

    Args:
        record: Record that includes the acceleration of the base [m/s^2].
        is_relative: Whether the response was measured relative to the base. If not, the
            acceleration of the base is subtracted from it.
    """
    channels, units = dict(record.channels), dict(record.units)
    base = channels.pop(BASE)
    del units[BASE]
    response = channels[record.response]
    channels[record.response] = response if is_relative else response - base
    channels[MINUS_BASE], units[MINUS_BASE] = -base, "N/kg"
    return replace(record, channels=channels, units=units)
