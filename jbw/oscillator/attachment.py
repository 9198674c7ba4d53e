r"""A shaker on a structure: its armature is a mass, damper and spring at the drive point.

A voltage V drives an armature that is tied to the structure at a point that moves by $x_d$,

$$F = g\,V - (m_a \ddot x_d + c_a \dot x_d + k_a x_d)$$

where $c_a$ includes the back-EMF. The response to a measured force is that of the structure alone;
the response to a voltage is that of the structure with its attachment. The two differ in omega_n
and zeta, but not in the joint.

Reference:
    McConnell and Varoto (2008), Vibration Testing; Tomlinson, J. Sound Vib. 63 (1979) 337.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jbw.errors import ModelError

Modal = Float[np.ndarray, " mode"]


class Attachment(NamedTuple):
    """A mass, damper and spring attached to one point of a structure.

    Examples:
        A mass of 1 kg tied to a mode of 4 kg lowers its frequency by the factor 1 / sqrt(1 + 1/4):

        >>> import jbw
        >>> armature = jbw.Attachment(mass=1.0, damping=0.0, stiffness=0.0)
        >>> omega, zeta = jbw.attached([100.0], [0.01], [0.5], armature)
        >>> print(omega.round(2))
        [89.44]
    """

    mass: float  # mass m_a [kg]; negative if a suspension's stiffness falls with frequency
    damping: float  # damping c_a [N s/m]
    stiffness: float  # stiffness k_a [N/m]


def attached(
    omega: ArrayLike, zeta: ArrayLike, shape: ArrayLike, attachment: Attachment
) -> tuple[Modal, Modal]:
    r"""Return the natural frequencies [rad/s] and damping ratios of a structure with an attachment.

    $$(I + m_a \phi\phi^T)\,\ddot q + (\mathrm{diag}(2\zeta\omega) + c_a \phi\phi^T)\,\dot q
      + (\mathrm{diag}(\omega^2) + k_a \phi\phi^T)\,q = 0$$

    Args:
        omega: Natural frequencies without it [rad/s], shape (mode,).
        zeta: Damping ratios without it.
        shape: Mass-normalised mode shapes phi at the drive point [1/sqrt(kg)].
        attachment: The attachment at the drive point.

    Returns:
        Frequencies in rising order, and the damping ratio of each.

    Raises:
        ModelError: A mode does not oscillate, or the attachment makes it unstable.

    Examples:
        A spring of 8400 N/m tied to a mode of 4 kg raises 100 rad/s to sqrt(100^2 + 8400 / 4):

        >>> import jbw
        >>> suspension = jbw.Attachment(mass=0.0, damping=0.0, stiffness=8400.0)
        >>> omega, zeta = jbw.attached([100.0], [0.01], [0.5], suspension)  # shape 1 / sqrt(4 kg)
        >>> print(omega.round(2), zeta.round(5))  # the damping ratio falls by 100 / 110
        [110.] [0.00909]
    """
    w, z, phi = (np.atleast_1d(np.asarray(x, float)) for x in (omega, zeta, shape))
    if not (w.shape == z.shape == phi.shape and w.ndim == 1):
        raise ModelError(
            "Arguments `omega`, `zeta` and `shape` must have one value per mode, but their "
            f"shapes are {w.shape}, {z.shape} and {phi.shape}."
        )
    if not (np.all(w > 0) and np.all(np.isfinite([w, z, phi])) and np.all(np.isfinite(attachment))):
        raise ModelError("Every omega must be positive, and zeta, shape and attachment finite.")
    at_once = np.outer(phi, phi)
    eye, none = np.eye(len(w)), np.zeros((len(w), len(w)))
    mass = eye + attachment.mass * at_once
    stiffness = np.diag(w**2) + attachment.stiffness * at_once
    for name, matrix in (("mass", mass), ("stiffness", stiffness)):
        if np.linalg.eigvalsh(matrix)[0] <= 0:
            raise ModelError(
                f"Structure and attachment must have a positive {name} together, but the "
                f"attachment's {name}, {getattr(attachment, name):.4g}, removes all of it.",
                remedy="Fit the attachment over a wider band, or at the right drive point.",
            )
    damping = np.diag(2 * z * w) + attachment.damping * at_once
    inner = np.linalg.solve(mass, np.concatenate([stiffness, damping], axis=1))
    values = np.linalg.eigvals(np.block([[none, eye], [-inner]]))
    poles = values[values.imag > 0]
    if len(poles) < len(w):
        raise ModelError(
            "Every mode with the attachment must oscillate, but the damping ratio of a mode is "
            "above 1.",
            remedy="Reduce `damping` of the attachment, or check the unit of `shape`.",
        )
    poles = poles[np.argsort(np.abs(poles))]
    return np.abs(poles), -poles.real / np.abs(poles)
