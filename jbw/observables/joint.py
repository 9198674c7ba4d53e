"""The joint among the parameters of a likelihood, in either of two coordinates."""

from collections.abc import Mapping

from jaxtyping import Array

from jbw.oscillator.parameters import BoucWen
from jbw.oscillator.restoring import Cubic

JOINT = ("omega_n", "zeta", "alpha", "delta", "gamma")
PRODUCTS = ("omega_n", "zeta", "softening", "opening", "share")


def joint_of(theta: Mapping[str, Array]) -> BoucWen:
    r"""The joint of the paper's parameters, or of those that weak motion determines.

    $$\alpha = \kappa\,\omega_n^2, \quad \delta = S / \kappa, \quad \gamma = O / \kappa$$

    Args:
        theta: omega_n [rad/s], zeta [-], and either alpha [1/s^2], delta and gamma [1/m], or
            softening S = alpha delta / omega_n^2 [1/m], opening O = alpha gamma / omega_n^2 [1/m]
            and share kappa = alpha / omega_n^2 [-]. With cubic [1/(m^2 s^2)] among them, a cubic
            stiffness stands beside the joint.

    Returns:
        The joint.
    """
    omega_n, zeta = theta["omega_n"], theta["zeta"]
    beside = Cubic(theta["cubic"]) if "cubic" in theta else None
    if "share" not in theta:
        alpha, delta, gamma = (theta[name] for name in ("alpha", "delta", "gamma"))
        return BoucWen(omega_n, zeta, alpha, delta, gamma, restoring=beside)
    share = theta["share"]
    return BoucWen(
        omega_n,
        zeta,
        share * omega_n**2,
        theta["softening"] / share,
        theta["opening"] / share,
        restoring=beside,
    )
