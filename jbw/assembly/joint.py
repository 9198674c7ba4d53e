"""Joints of an assembled structure: where they act, stiffness when fully stuck, and laws."""

from dataclasses import dataclass
from typing import Any

from jbw.assembly.dofs import Place
from jbw.errors import ConfigError, ModelError

_ROUND_OFF = 1e-9


@dataclass(frozen=True, init=False)
class Joint:
    r"""A scalar joint with force $F_j(x_j)$ and relative motion $x_j = w_j^Tq$.

    Attributes:
        name: Name of the joint.
        weights: Factors w_j by degree of freedom, such as {"17:rx": 0.0025, "112:rx": 0.0025} [-,
            or m/rad].
        stiffness: Stiffness k_j of the fully stuck joint [N/m, or N m/rad].
        laws: Laws across the joint in physical units; the part of k_j beyond their stiffness at
            rest stays linear. Empty if the joint is linear or its law is to be identified.

    Args:
        name: Name of the joint.
        weights: Factors as above, or terms "node:direction*factor"; either this or `across`.
        across: Two degrees of freedom: x_j is the second minus the first.
        stiffness: Stiffness as above.
        laws: Laws as above.

    Raises:
        ConfigError: Both `weights` and `across` are given, or neither.
        ModelError: The stiffness is not positive, or the laws' stiffness exceeds it.

    Examples:
        The displacement of a joint across two degrees of freedom is the second less the first:

        >>> import jbw
        >>> bolt = jbw.Joint("bolt", across=("1:x", "2:x"), stiffness=1e4)
        >>> print(bolt.weights)
        {'1:x': -1.0, '2:x': 1.0}
    """

    name: str
    weights: Place
    stiffness: float
    laws: tuple[Any, ...]

    def __init__(
        self,
        name: str,
        weights: Place | None = None,
        *,
        stiffness: float,
        across: tuple[str, str] | None = None,
        laws: Any = (),
    ) -> None:
        if (weights is None) == (across is None):
            raise ConfigError(
                f"Joint `{name}` must have either `weights` or `across`, but has "
                f"{'neither' if weights is None else 'both'}.",
                remedy='Give across=("17:x", "112:x"), or weights={"17:rx": 0.0025, ...}.',
            )
        if across is not None:
            weights = _difference(name, across)
        if not 0 < stiffness < float("inf"):
            raise ModelError(
                f"The stiffness of joint `{name}` must be positive and finite, but is "
                f"{stiffness!r}.",
                remedy="State the stiffness of the fully stuck joint [N/m], or leave the joint "
                "out.",
            )
        laws = tuple(laws) if isinstance(laws, tuple | list) else (laws,)
        taken_by_laws = float(sum(law.stiffness() for law in laws))
        if taken_by_laws > stiffness * (1 + _ROUND_OFF):
            raise ModelError(
                f"The laws of joint `{name}` must have no more stiffness at rest than the fully "
                f"stuck joint, {stiffness:g}, but have {taken_by_laws:g}.",
                remedy="Raise `stiffness`, or lower that of the laws.",
            )
        for field, entry in (
            ("name", name),
            ("weights", weights),
            ("stiffness", float(stiffness)),
            ("laws", laws),
        ):
            object.__setattr__(self, field, entry)


def _difference(name: str, across: tuple[str, str]) -> dict[str, float]:
    if isinstance(across, str) or len(across) != 2:
        raise ConfigError(
            f"`across` of joint `{name}` must be two degrees of freedom, but is {across!r}.",
            remedy='Give across=("17:x", "112:x"); a joint to ground has weights={"17:x": 1.0}.',
        )
    first, second = across
    if first == second:
        raise ConfigError(
            f"`across` of joint `{name}` must be two different degrees of freedom, but is "
            f"`{first}` twice.",
            why="The joint would never move.",
            remedy="Give the degrees of freedom on both sides of the joint.",
        )
    return {first: -1.0, second: 1.0}
