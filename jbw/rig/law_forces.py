"""Forces of all laws, written a second time for the rig: one line per law.

Laws of Masing's kind are represented by three hundred parallel sliders. They are in bins whose
width grows with the square of the cube root of the slip, and each slider has the integrals of the
density over its bin. With a density near the inverse of the slip, the relative error of the force
is nearly the same at every amplitude.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from jbw.errors import ModelError
from jbw.oscillator.law import Law
from jbw.rig.forces import (
    MILLIMETRE,
    BoucWenForce,
    BoucWenNuForce,
    Drag,
    EvenSpring,
    Force,
    GapForce,
    LinearSpring,
    PowerSpring,
    Scalar,
    SliderForces,
    StopForce,
    WornForce,
)

# number of sliders that represent a continuous density; the last slider covers a hundredth of the
# largest slip
BINS = 300
GRADING = 3  # Edges of the bins of slip limits are evenly spaced numbers to this power.
FARTHEST = 0.1  # slip limit of the last slider, for a density without an end [m]


def jenkins(**theta: Scalar) -> list[Force]:
    """Return sliders from their stiffnesses, the first slip displacement [m] and slip ratios."""
    springs = [x for name, x in theta.items() if name.startswith("stiffness")]
    # The first entry is the slip in metres, and each later entry is a ratio.
    ratios = (x for name, x in theta.items() if name.startswith("slip"))
    return [SliderForces(_row(springs), jnp.cumprod(_row(ratios)))]


def _row(numbers: Iterable[Scalar]) -> Array:
    return jnp.stack([jnp.asarray(x) for x in numbers])


def _slips(last: Scalar) -> Array:
    """Return slip limits from zero to the last one, which divide a slider density into bins."""
    return last * jnp.linspace(0.0, 1.0, BINS + 1) ** GRADING


def _binned(weight: Array, moment: Array) -> SliderForces:
    """Return one slider per bin, at its centroid, from integrals of the density and its moment."""
    springs = jnp.diff(weight)
    return SliderForces(springs, jnp.diff(moment) / springs)


def _power_density(r: Scalar, chi: Scalar, last: Scalar) -> SliderForces:
    r"""Return sliders with the density $R \varphi^\chi$ of slip limits $\varphi$ up to `last`."""
    x = _slips(last)
    return _binned(r * x ** (chi + 1) / (chi + 1), r * x ** (chi + 2) / (chi + 2))


def iwan4(
    iwan_stiffness: Scalar, iwan_loss: Scalar, iwan_chi: Scalar, iwan_beta: Scalar
) -> list[Force]:
    """Return sliders with Segalman's density, and a group at its upper end that slips together."""
    chi, spread = iwan_chi, iwan_stiffness / (1 + iwan_beta)
    r = iwan_loss * (chi + 1) * (chi + 2) / MILLIMETRE ** (chi + 1)
    last = (spread * (chi + 1) / r) ** (1 / (chi + 1))
    together = SliderForces(_row([iwan_beta * spread]), _row([last]))
    return [_power_density(r, chi, last), together]


def masing_power(power_loss: Scalar, power_exponent: Scalar) -> list[Force]:
    """Return sliders with a power-law density, and a spring that subtracts their stiffness."""
    q = power_exponent
    r = power_loss * q * (q + 1) / MILLIMETRE**q
    sliders = _power_density(r, q - 1, FARTHEST)
    return [sliders, LinearSpring(-sliders.stiffness)]


def masing_exponential(exponential_alpha: Scalar, exponential_b: Scalar) -> list[Force]:
    r"""Return sliders with the density $\alpha b\,e^{-b\varphi}$ of slip limits $\varphi$."""
    alpha, b = exponential_alpha, exponential_b
    x = _slips(40.0 / b)  # Only a fraction of 4e-18 of the sliders slips beyond 40/b.
    passed = jnp.exp(-b * x)
    return [_binned(-alpha * passed, -alpha * passed * (x + 1 / b))]


# The rig's parallel forces for each law of a campaign; the number in a name such as `jenkins_3` is
# omitted.
FORCES: dict[str, Callable[..., Sequence[Force]]] = {
    "bouc_wen": lambda **theta: [BoucWenForce(**theta)],
    "bouc_wen_nu": lambda **theta: [BoucWenNuForce(**theta)],
    "bwbn": lambda **theta: [WornForce(**theta)],
    "bwbn_pinching": lambda **theta: [WornForce(**theta)],
    "cubic": lambda cubic: [PowerSpring(cubic, 3)],
    "cubic_damping": lambda cubic_damping: [Drag(cubic_damping, 3)],
    "gap_series": lambda **theta: [GapForce(**theta)],
    "iwan4": iwan4,
    "jenkins": jenkins,
    "masing_exponential": masing_exponential,
    "masing_power": masing_power,
    "quadratic": lambda quadratic: [PowerSpring(quadratic, 2)],
    "quadratic_damping": lambda quadratic_damping: [Drag(quadratic_damping, 2)],
    "quintic": lambda quintic: [PowerSpring(quintic, 5)],
    "square": lambda square: [EvenSpring(square)],
    "stop": lambda stop_stiffness, stop_gap: [StopForce(stop_stiffness, stop_gap)],
}


def kind_of(law: Law | type[Law]) -> str:
    """Return the key of a law in `FORCES`: its name, or its name without the number at the end."""
    return law.name if law.name in FORCES else law.name.rstrip("_0123456789")


def forces_of(laws: Iterable[Law], number: Callable[[Any], Scalar] = float) -> tuple[Force, ...]:
    """Return the rig's own forces for given laws; `number` converts every parameter."""
    forces: list[Force] = []
    for law in laws:
        if law.name == "bouc_wen" and (nu := getattr(law, "nu", 1.0)) != 1.0:
            raise ModelError(
                f"Parameter `joint.nu` of the rig must be 1, but is {nu}.",
                remedy="For any nu, use the law `bouc_wen_nu`: BoucWenNu.of_bouc_wen(...).",
            )
        if (kind := kind_of(law)) not in FORCES:
            raise ModelError(
                f"The rig does not have the law `{law.name}`, but only {', '.join(FORCES)}.",
                why="The rig integrates every law by separate code.",
                remedy="Make records with `simulate`, which accepts every law.",
            )
        forces += FORCES[kind](**{name: number(x) for name, x in law.parameters().items()})
    return tuple(forces)
