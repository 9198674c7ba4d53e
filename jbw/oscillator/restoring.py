r"""Smooth restoring forces $f(y)$ beside the hysteretic one, per unit mass.

A force is any pytree that can be called: elementwise, from the displacement [m] to the force
[N/kg], differentiable twice, and preferably without a part linear in y, which belongs to
`omega_n`. Its leaves are scalars, or arrays of the joint's batch shape. The records below are the
common ones; a plain function serves where nothing in it is to be identified.
"""

import equinox as eqx
import numpy as np

from jbw.errors import ModelError
from jbw.oscillator.checks import is_concrete
from jbw.oscillator.parameters import BoucWen, Restoring, Scalar

# Displacements at which a force is probed for oddness [m].
_PROBES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)


class Cubic(eqx.Module):
    r"""Cubic stiffness, $f(y) = \lambda_3\,y^3$ [N/kg].

    With delta = gamma = 0 the joint is a Duffing oscillator of natural frequency omega_n.

    Attributes:
        lambda_3: Cubic stiffness, positive where it stiffens [1/(m^2 s^2)].
    """

    lambda_3: Scalar

    def __call__(self, y: Scalar) -> Scalar:
        """Force at the displacement y [m]."""
        return self.lambda_3 * y**3


class Polynomial(eqx.Module):
    r"""Polynomial stiffness, $f(y) = \sum_{n \ge 2} c_n\,y^n$ [N/kg].

    Attributes:
        coefficients: c_2, c_3, c_4, ... [1/(m^(n-1) s^2)]; None for a power that is not there.
            The periodic responses, being of odd orders, need None (or a plain 0) for even powers.
    """

    coefficients: tuple[Scalar | None, ...] = eqx.field(converter=tuple)

    def __call__(self, y: Scalar) -> Scalar:
        """Force at the displacement y [m]."""
        terms = enumerate(self.coefficients, start=2)
        return sum((c * y**n for n, c in terms if c is not None), 0.0 * y)


def require_odd(joint: BoucWen) -> None:
    """Raise unless the joint's restoring force is odd, so that its response has odd orders only.

    Args:
        joint: Bouc-Wen parameters; a force that is no `Polynomial` is trusted when traced.

    Raises:
        ModelError: The force has an even part.
    """
    force = joint.restoring
    if force is None or isinstance(force, Cubic):
        return
    if isinstance(force, Polynomial):
        even = {f"c_{n}": c for n, c in enumerate(force.coefficients, start=2) if n % 2 == 0}
        bad = [name for name, c in even.items() if c is not None and _may_act(c)]
        found = f"its {', '.join(bad)} may act"
    else:
        bad = is_concrete(force) and not all(_is_odd_at(force, y) for y in _PROBES)
        found = "f(-y) differs from -f(y)"
    if bad:
        raise ModelError(
            f"Parameter `restoring` must be an odd force for a periodic response, but {found}.",
            why="Harmonics of odd orders, and half a period, describe odd motions only.",
            remedy="Put None for the even powers of `Polynomial`, or use `simulate` with "
            "periodic=True.",
        )


def require_none(joint: BoucWen, function: str) -> None:
    """Raise where a restoring force stands beside the joint of a formula that has no place for it.

    Args:
        joint: Bouc-Wen parameters.
        function: Name of the function that holds the formula.

    Raises:
        ModelError: There is such a force.
    """
    if joint.restoring is not None:
        raise ModelError(
            f"Parameter `restoring` must be None for `{function}`, but it is a force of kind "
            f"{type(joint.restoring).__name__}.",
            why="Its formula knows the hysteretic force and a linear spring only.",
            remedy="Use `steady_state` or `simulate`, which hold for every restoring force.",
        )


def _may_act(coefficient: Scalar) -> bool:
    return not is_concrete(coefficient) or bool(np.any(np.asarray(coefficient) != 0.0))


def _is_odd_at(force: Restoring, y: float) -> bool:
    there, back = np.asarray(force(y)), np.asarray(force(-y))
    return bool(np.all(np.abs(there + back) <= 1e-9 * np.abs(there - back)))
