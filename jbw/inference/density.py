"""Prior densities that are not uniform: NumPyro distributions by name, with bounds.

A campaign file states `zeta = { LogNormal = [-5.4, 0.3] }` under [identify.prior]; in Python it is
the same table or the distribution itself. NumPyro, and JAX with it, are loaded only when a density
is stated.
"""

from collections.abc import Callable, Mapping
from difflib import get_close_matches
from math import isfinite
from typing import Any

import numpy as np

# Probability beyond five standard deviations of a normal distribution. Bounds that exclude this
# much at each end do not change a narrower posterior.
TAIL = 2.866515718791933e-07  # probability below -5 standard deviations
COMMON = (
    "Beta", "Cauchy", "Exponential", "Gamma", "HalfCauchy", "HalfNormal", "InverseGamma", "Laplace",
    "LogNormal", "LogUniform", "Normal", "StudentT", "TruncatedNormal", "Uniform", "Weibull",
)  # fmt: skip  # suggested in messages; all others of NumPyro can be used too
NEAR = 1e-3  # relative step from the end of the support, at which a density is tested for zero


class Density(tuple[float, float]):
    """A prior density, and a pair of numbers: the bounds beyond which the density is negligible.

    Attributes:
        family: Name of the distribution in `numpyro.distributions`.
        arguments: Its arguments, in their order or by name.
        build: Function that creates the distribution, in the session's precision.
    """

    family: str
    arguments: tuple[float, ...] | dict[str, float]
    build: Callable[[], Any]

    def __new__(
        cls, family: str, arguments: Any, build: Callable[[], Any] | None = None
    ) -> "Density":
        """Create the density with its bounds.

        Raises:
            ValueError: There is no distribution of that name or with these arguments, or it is
                discrete, has several variables, or has no end.
        """
        make = build or (lambda: _built(family, arguments))
        density = super().__new__(cls, _bounds(make(), family))
        density.family, density.arguments, density.build = family, arguments, make
        return density

    def __reduce__(self) -> tuple[Any, ...]:
        """Return name and arguments for pickling, or the distribution if a user created it."""
        return _rebuilt, (self.family, self.arguments, self._distribution_of_caller())

    def _distribution_of_caller(self) -> Any:
        """Return a distribution that the user created; None for a distribution stated by name."""
        return None if isinstance(self.arguments, dict) or self.arguments else self.build()

    def __repr__(self) -> str:
        """Format the density as a campaign file states it."""
        if isinstance(self.arguments, dict):
            inner = ", ".join(f"{name} = {value!r}" for name, value in self.arguments.items())
            return f"{{ {self.family} = {{ {inner} }} }}"
        return f"{{ {self.family} = {list(self.arguments)!r} }}"

    def table(self) -> dict[str, Any]:
        """Return the density as a table of a campaign file."""
        stated = self.arguments if isinstance(self.arguments, dict) else list(self.arguments)
        return {self.family: stated}


def _rebuilt(family: str, arguments: Any, distribution: Any) -> Density:
    return Density(family, arguments, None if distribution is None else lambda: distribution)


def density_of(stated: Any) -> Density:
    """Return the density stated by a NumPyro distribution, or by a table with its name.

    Raises:
        ValueError: It states no density; the message gives the reason.
    """
    if isinstance(stated, Density):
        return stated
    if not isinstance(stated, Mapping):
        return Density(type(stated).__name__, _arguments(stated), lambda: stated)
    if len(stated) != 1:
        raise ValueError(f"must name one distribution, but names {', '.join(stated) or 'none'}.")
    ((family, arguments),) = stated.items()
    if isinstance(arguments, Mapping):
        return Density(family, {name: _number(value) for name, value in arguments.items()})
    values = arguments if isinstance(arguments, list | tuple) else [arguments]
    return Density(family, tuple(_number(value) for value in values))


def _arguments(distribution: Any) -> dict[str, float]:
    """Return a distribution's arguments by name; no arguments if they are not all numbers."""
    try:
        return {name: float(getattr(distribution, name)) for name in distribution.arg_constraints}
    except (AttributeError, TypeError, ValueError):
        return {}


def is_distribution(value: Any) -> bool:
    """Return whether a value is a NumPyro distribution, without loading NumPyro."""
    return any(kind.__module__.startswith("numpyro.distributions") for kind in type(value).__mro__)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ValueError(f"takes finite numbers, but one is {value!r}.")
    return float(value)


def _near(family: str) -> str:
    nearest = get_close_matches(family, COMMON, n=1, cutoff=0.5)
    return (f"; did you mean `{nearest[0]}`" if nearest else "") + f" (it has {', '.join(COMMON)})"


def _built(family: str, arguments: Any) -> Any:
    import numpyro.distributions as distributions

    make = getattr(distributions, family, None)
    if family[:1].islower() or not callable(make):
        raise ValueError(f"names the distribution {family!r}, which NumPyro lacks{_near(family)}.")
    try:
        if isinstance(arguments, dict):
            return make(**arguments, validate_args=True)
        return make(*arguments, validate_args=True)
    except (TypeError, ValueError, AssertionError) as error:
        reason = " ".join(str(error).split()).removesuffix(".")
        raise ValueError(
            f"must have valid arguments of {family}, but {arguments!r} is not valid: {reason}."
        ) from None


def _bounds(distribution: Any, family: str) -> tuple[float, float]:
    """Return the bounds of a density: extreme quantiles, or ends of the support."""
    import jax
    from numpyro.distributions import Distribution

    if not isinstance(distribution, Distribution):
        raise ValueError(f"must be a NumPyro distribution such as LogNormal, not `{family}`.")
    one_number = distribution.event_shape == distribution.batch_shape == ()
    if not one_number or distribution.support is None or distribution.is_discrete:
        raise ValueError(f"must be a density of one real number, but `{family}` is not.")
    try:
        with jax.enable_x64(True):
            ends = _quantile(distribution, TAIL), _quantile(distribution, 1.0 - TAIL)
    except (NotImplementedError, ImportError):
        raise ValueError(f"needs a distribution function, which `{family}` lacks.") from None
    if not (isfinite(ends[0]) and isfinite(ends[1]) and ends[0] < ends[1]):
        raise ValueError(
            f"must have finite quantiles, but `{family}` has quantiles {ends[0]} and {ends[1]}."
        )
    return ends


def _quantile(distribution: Any, mass: float) -> float:
    """Return the point where the distribution function reaches a probability near 0 or 1.

    If the density does not vanish towards the end of the support, return that end.
    """
    from scipy.optimize import brentq

    low = float(getattr(distribution.support, "lower_bound", -np.inf))
    high = float(getattr(distribution.support, "upper_bound", np.inf))

    def excess(value: float) -> float:
        return float(distribution.cdf(value)) - mass

    below, above = _bracket(excess, low, high)
    root: Any = below if below == above else brentq(excess, below, above, xtol=1e-300)
    crossing = float(root)
    end = low if mass < 0.5 else high
    if not isfinite(end) or crossing == end:
        return crossing
    near_end, at_crossing = (
        distribution.log_prob(end + NEAR * (crossing - end)),
        distribution.log_prob(crossing),
    )
    return end if float(near_end - at_crossing) > np.log(0.5) else crossing


def _bracket(excess: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Return two points in an interval between which a rising function crosses zero."""
    middle = (low + high) / 2 if isfinite(low) and isfinite(high) else 0.0
    if isfinite(low) != isfinite(high):
        middle = low + 1.0 if isfinite(low) else high - 1.0
    below, above, reach = middle, middle, 1.0
    while excess(below) > 0.0 and reach < 1e300:
        below = low + (below - low) / 2 if isfinite(low) else below - reach
        reach *= 2.0
    reach = 1.0
    while excess(above) < 0.0 and reach < 1e300:
        above = high - (high - above) / 2 if isfinite(high) else above + reach
        reach *= 2.0
    return below, above
