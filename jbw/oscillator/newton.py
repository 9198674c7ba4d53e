"""Newton's iteration for a root, differentiable in its arguments (implicit function theorem)."""

from collections.abc import Callable
from typing import Any

import optimistix
from jaxtyping import Array, Bool, Float


def newton_root(
    function: Callable[[Any, Any], Any],
    start: Float[Array, "..."],
    args: Any = None,
    *,
    tolerance: float,
    max_steps: int,
) -> tuple[Float[Array, "..."], Bool[Array, ""]]:
    """Return the root of function(x, args) from `start`, and whether the iteration converged.

    Args:
        function: Function of x and `args` that vanishes at the root.
        start: Starting value of the iteration.
        args: Arguments in which the root is differentiable.
        tolerance: Relative and absolute tolerance.
        max_steps: Largest number of iterations.
    """
    solution = optimistix.root_find(
        function,
        optimistix.Newton(rtol=tolerance, atol=tolerance),
        start,
        args,
        max_steps=max_steps,
        throw=False,
    )
    return solution.value, solution.result == optimistix.RESULTS.successful
