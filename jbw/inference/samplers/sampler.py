"""What samplers leave: a draw of a chain, the kernel of a chain, draws of equal weight."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxtyping import Array, Bool, Float, Key, PyTree


class Draw(NamedTuple):
    """What one step of a chain leaves: the parameters by name, and the sampler's statistics."""

    theta: dict[str, Float[Array, "..."]]
    stats: dict[str, Array]


class Kernel(NamedTuple):
    """A Markov chain whose law is the posterior.

    Attributes:
        init: (key, w) to the first state, w the start in the whitened coordinate.
        step: A state to the next.
        read: A state to what it says.
    """

    init: Callable[[Key[Array, ""], Float[Array, " parameter"]], PyTree]
    step: Callable[[PyTree], PyTree]
    read: Callable[[PyTree], Draw]


class Draws(NamedTuple):
    """Draws of equal weight from one posterior.

    Attributes:
        theta: By name, each (chain, draw), in the parameters' units.
        stats: Statistics of the draws, each (chain, draw).
        possible: Whether the posterior is possible wherever the sampler must start.
        arrived: Whether the sampler came to its end.
        facts: Numbers of the whole run, such as log_evidence [nats] and its standard error.
        groups: Further groups of the tree: group to variable to (dimensions, values).
    """

    theta: dict[str, Float[Array, "chain draw"]]
    stats: dict[str, Array]
    possible: Bool[Array, ""] | bool
    arrived: Bool[Array, ""] | bool
    facts: dict[str, Any] = {}  # noqa: RUF012
    groups: dict[str, dict[str, Any]] = {}  # noqa: RUF012
