"""The joint among the parameters of a likelihood, in either of two coordinates."""

from collections.abc import Mapping

from jaxtyping import Array

from jbw.oscillator.parameters import BoucWen

JOINT = ("omega_n", "zeta", "alpha", "delta", "gamma")
PRODUCTS = ("omega_n", "zeta", "softening", "opening", "share")


def joint_of(theta: Mapping[str, Array]) -> BoucWen:
    r"""The joint of the paper's parameters, or of those that weak motion determines.

    $$\alpha = \kappa\,\omega_n^2, \quad \delta = S / \kappa, \quad \gamma = O / \kappa$$

    Args:
        theta: omega_n [rad/s], zeta [-], and either alpha [1/s^2], delta and gamma [1/m], or
            softening S = alpha delta / omega_n^2 [1/m], opening O = alpha gamma / omega_n^2 [1/m]
            and share kappa = alpha / omega_n^2 [-].

    Returns:
        The joint.
    """
    if "share" not in theta:
        omega_n, zeta, alpha, delta, gamma = (theta[name] for name in JOINT)
        return BoucWen(omega_n, zeta, alpha, delta, gamma)
    share = theta["share"]
    return BoucWen(
        theta["omega_n"],
        theta["zeta"],
        share * theta["omega_n"] ** 2,
        theta["softening"] / share,
        theta["opening"] / share,
    )
