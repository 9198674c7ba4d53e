"""The modes of a structure that joints couple, with checks of the modes' parameters."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.checks import is_concrete, require_finite, stiffer_than_structure
from jbw.oscillator.law import Law, Memory, laws_in, map_laws
from jbw.oscillator.parameters import Scalar
from jbw.report.messages import joint as messages

_PER_MODE = ("omega_n", "zeta", "b")
# Relative distance to a higher harmonic within which a mode is excited by a lower mode.
_NEAR = 0.05
_ORDERS = (3, 5)
# A joint counts as not moved by a mode if its motion in this mode, divided by its largest motion in
# any mode, is below this limit: such a motion is rounding error.
_UNMOVED = 1e-8
# Tolerance on the joints' share of the stiffness, which may reach 1.
_ROUND_OFF = 1e-9

# The laws of one joint, or a tuple of them for every joint.
Laws = tuple[Law, ...] | tuple[tuple[Law, ...], ...]
Memories = tuple[Memory, ...]  # internal states of the laws of one joint, or of every joint


def _as_laws(laws: Any) -> Laws:
    """Convert any sequence of laws, or of sequences of laws, to tuples."""
    # pyright: ignore
    return tuple(tuple(law) if isinstance(law, tuple | list) else law for law in laws)  # pyright: ignore


class Structure(eqx.Module):
    r"""The modes of a structure with one or several joints, each mode per unit modal mass.

    $$\ddot q_i + 2\zeta_i\omega_i\dot q_i + \omega_i^2 q_i + \sum_j p_{ij} r_j = b_i u, \qquad
      x_j = \sum_i h_{ji} q_i, \qquad y_o = \sum_i c_{oi} q_i$$

    with r_j = sum (F - K x_j), the forces of joint j's laws at its relative displacement x_j minus
    those of their stiffness at rest: the modes are those with all joints stuck. The motion does not
    change under h_j -> s h_j, p_j -> s p_j with the joint's laws rescaled, nor under b_i, p_i -> t
    b_i, t p_i with c_i, h_i -> c_i/t, h_i/t.

    For one joint, h and p are arrays with one number per mode and the laws are one tuple: then x, r
    and the laws' memories have no axis of joints. With h_1 = p_1 = 1 the laws have the meaning and
    the units that they have for mode 1 alone; that choice is the caller's. A field is an array with
    one number per mode, or one number for one mode. For several joints, h has one row per joint and
    the laws are one tuple per joint. By reciprocity p is h transposed if the modal masses are one;
    this is assumed where p is None. For a batch of structures use `jax.vmap`.

    Attributes:
        omega_n: Natural frequencies with stuck joints [rad/s]; 0 is allowed where a mode moves no
            joint.
        zeta: Viscous damping ratios [-].
        h: Motion of each joint per unit of each mode, (mode,) or (joint, mode) [-].
        p: Effect of each joint's force on each mode, (mode,) or (mode, joint) [-].
        b: Effect of the input on each mode [-].
        c: Motion of each output per unit of each mode [-]; one output, or outputs along the first
            axis.
        laws: Forces across the joint, or a tuple of forces for every joint.

    Examples:
        Two modes share one joint. Weak motion at the first resonance is amplified by 1 / (2 zeta):

        >>> import jbw; jbw.enable_x64()
        >>> import numpy as np
        >>> one, law = np.ones(2), jbw.laws.BoucWenLaw(alpha=497.4, delta=340.2, gamma=32.8)
        >>> omega_n, h = np.array([118.1, 360.0]), np.array([1.0, -1.7])
        >>> modes = jbw.Structure(omega_n, 0.004 * one, h, b=one, c=one, laws=(law,))
        >>> y = jbw.steady_state(modes, omega=118.1, amplitude=1e-6).y[0]
        >>> print(f"{abs(y) * 118.1**2 / 1e-6:.1f}")
        125.0
    """

    omega_n: Scalar
    zeta: Scalar
    h: Scalar
    p: Scalar | None = None
    b: Scalar | None = None
    c: Scalar | None = None
    laws: Laws = eqx.field(default=(), converter=_as_laws)

    def at_rest(self) -> Memories:
        """Return the internal states of the laws before any motion."""
        return map_laws(lambda law: law.at_rest(), self.laws)


def by_joint(structure: Structure) -> Structure:
    """Return a checked structure with motions h (joint, mode) and couplings p (mode, joint)."""
    if jnp.ndim(structure.h) == 2:
        return structure
    h, p = jnp.asarray(structure.h), jnp.asarray(structure.p)
    return replace(structure, h=h[None], p=p[:, None], laws=(structure.laws,))


def map_joint_laws(function: Callable[..., Any], laws: Laws, *of_joints: Any) -> Laws:
    """Apply a function to every law and to the entries for its joint in further sequences."""
    return tuple(
        # pyright: ignore[reportGeneralTypeIssues]
        tuple(function(law, *entries) for law in of_joint)  # pyright: ignore[reportGeneralTypeIssues]
        for of_joint, *entries in zip(laws, *of_joints, strict=True)
    )


def first_frequency(structure: Structure) -> Scalar:
    """Return the frequency of the first flexible mode [rad/s], the unit of frequency."""
    omega_n = jnp.asarray(structure.omega_n)
    return omega_n[jnp.argmax(omega_n > 0.0)]


class Commensurate(NamedTuple):
    """A pair of modes, of which the higher is near an odd multiple of the lower.

    Attributes:
        mode: Index of the lower mode, from 0.
        other: Index of the higher mode.
        order: Odd harmonic of the lower mode that is near the higher one.
        detuning: Frequency of the higher mode divided by that of the harmonic, minus 1 [-].
    """

    mode: int
    other: int
    order: int
    detuning: float


def admitted(structure: Structure) -> Structure:
    """Check a structure; return it with all numbers converted to arrays.

    Raises:
        ConfigError: Shapes differ, or no mode moves a joint.
        ModelError: A frequency or damping ratio is invalid, or a number is not finite.
    """
    for name in ("b", "c"):
        if getattr(structure, name) is None:
            raise ConfigError(
                f"Field `{name}` of a `Structure` must have one number per mode, but is "
                "missing.",
                remedy=f"Give `{name}`: " + ("0 for a mode that the source does not push."
                if name == "b" else "1 for every mode if the response sums the modal coordinates."),
            )  # fmt: skip
    if structure.p is None:
        structure = replace(structure, p=jnp.asarray(structure.h).T)
    values = {n: jnp.asarray(getattr(structure, n), float) for n in (*_PER_MODE, "h", "p", "c")}
    structure = replace(structure, **values)
    several = jnp.ndim(structure.h) == 2
    names = _PER_MODE if several else (*_PER_MODE, "h", "p")
    modes = _number_of_modes({name: values[name].shape for name in names})
    structure = replace(structure, **{name: values[name].reshape(modes) for name in names})
    if several:
        _require_joints(structure, *modes)
    elif any(isinstance(law, tuple) for law in structure.laws):
        raise ConfigError(
            "Field `laws` of a `Structure` must contain laws if `h` has one number per mode, "
            "but contains tuples of laws.",
            remedy="Give `h` a row for every joint, or give only the laws of the single joint.",
        )
    c = jnp.atleast_1d(values["c"])
    if c.ndim > 2 or c.shape[-1:] != modes:
        raise ConfigError(
            f"Field `c` of a `Structure` must have {modes[0]} numbers, one per mode, for every "
            f"output, but has the shape {c.shape}.",
            remedy="Give one row per output.",
        )
    structure = replace(structure, c=c)
    _require_modes(structure)
    return structure


def _number_of_modes(shapes: dict[str, tuple[int, ...]]) -> tuple[int]:
    """Return the shape of the fields with one value per mode; raise if their shapes differ."""
    distinct_shapes = {shape for shape in shapes.values() if shape}
    if len(distinct_shapes) > 1 or any(len(shape) > 1 for shape in distinct_shapes):
        raise ConfigError(
            f"The fields {', '.join(shapes)} of a `Structure` must have one number per mode "
            f"each, but have the shapes {', '.join(map(str, shapes.values()))}.",
            remedy=f"Give each of {', '.join(shapes)} one number per mode; for a batch of "
            "structures use `jax.vmap`.",
        )
    modes = next(iter(distinct_shapes), (1,))
    if any(not shape for shape in shapes.values()) and modes != (1,):
        bare = next(name for name, shape in shapes.items() if not shape)
        raise ConfigError(
            f"Field `{bare}` of a `Structure` must have {modes[0]} numbers, one per mode, but "
            "is one number.",
            remedy=f"Give `{bare}` one number per mode.",
        )
    if modes == (0,):
        raise ConfigError("A `Structure` must have at least one mode, but its fields are empty.")
    return modes  # pyright: ignore[reportReturnType]


def _require_joints(structure: Structure, num_modes: int) -> None:
    """Raise if motions h, couplings p and laws do not belong to the same joints and modes."""
    num_joints = len(jnp.asarray(structure.h))
    for name, shape, axes in (
        ("h", (num_joints, num_modes), "joint, mode"), ("p", (num_modes, num_joints), "mode, joint")
    ):  # fmt: skip
        if (own := getattr(structure, name).shape) != shape:
            raise ConfigError(
                f"Field `{name}` of a `Structure` of {num_modes} modes must have the shape {shape} "
                f"({axes}), but has {own}.",
                remedy="Give `h` one row per joint, and leave out `p` if it is h transposed.",
            )
    if num_joints == 0:
        raise ConfigError(
            "Field `h` of a `Structure` must have at least one row, but has none.",
            remedy="Give one joint without laws, `laws=((),)`, if there is no joint.",
        )
    if len(structure.laws) != num_joints or any(
        not isinstance(law, tuple) for law in structure.laws
    ):
        raise ConfigError(
            "Field `laws` of a `Structure` must contain a tuple of laws for each of the "
            f"{num_joints} joints, which are the rows of `h`, but contains "
            f"{len(structure.laws)} entries of the kinds "
            f"{', '.join(sorted({type(law).__name__ for law in structure.laws})) or 'none'}.",
            remedy="Give `laws=((law_of_joint_0,), (law_of_joint_1,))`, and () for a joint without "
            "a law.",
        )


def _require_modes(structure: Structure) -> None:
    """Raise if the numbers of a mode are invalid; values that JAX traces are not checked."""
    require_finite(structure)
    concrete = {
        name: np.asarray(getattr(structure, name))
        for name in ("omega_n", "zeta", "h", "p")
        if is_concrete(getattr(structure, name))
    }
    several = jnp.ndim(structure.h) == 2
    for name in ("omega_n", "zeta"):
        x = concrete.get(name, np.ones(1))
        is_rigid_allowed = name == "zeta" or several
        bad = x < 0.0 if is_rigid_allowed else x <= 0.0
        if np.any(bad):
            relation = "at least" if is_rigid_allowed else "greater than"
            raise ModelError(
                f"Field `{name}` of a `Structure` must be {relation} 0 for every mode, but "
                f"that of mode {int(np.argmax(bad))} is {x[np.argmax(bad)]:g}."
            )
    for name in ("h", "p"):
        if name in concrete:
            (_require_moved if several else _require_first)(name, concrete[name])
    if several and {"omega_n", "h"} <= concrete.keys():
        _require_rigid(concrete["omega_n"], concrete["h"])


def _require_first(name: str, values: np.ndarray) -> None:
    """Raise if the first mode, whose motion the laws refer to, does not move the joint."""
    if values[0] == 0.0:
        raise ConfigError(
            f"Field `{name}` of a `Structure` must not be 0 for the first mode, but it is.",
            why="The laws are in units of the joint's motion in the first mode.",
            remedy=f"Put a mode that moves the joint in the first place, with {name}[0] = 1.",
        )


def _require_moved(name: str, values: np.ndarray) -> None:
    """Raise if no mode moves one of the joints."""
    unmoved = ~np.any(values if name == "h" else values.T, axis=1)
    if np.any(unmoved):
        raise ConfigError(
            f"Field `{name}` of a `Structure` must not be 0 in all modes of a joint, but it is "
            f"0 for joint {int(np.argmax(unmoved))}.",
            why="No mode would move the joint, or its force would have no effect.",
            remedy="Keep a mode that moves the joint, or leave the joint out.",
        )


def _require_rigid(omega_n: np.ndarray, h: np.ndarray) -> None:
    """Raise if a rigid-body mode moves a joint that has stiffness."""
    moves = np.abs(h) > _UNMOVED * np.max(np.abs(h), axis=1, keepdims=True)
    bad = (omega_n == 0.0) & moves
    if np.any(bad):
        joint, mode = np.argwhere(bad)[0]
        raise ModelError(
            f"Field `omega_n` of a `Structure` must be greater than 0 for every mode that moves a "
            f"joint, but mode {mode} has omega_n = 0 and moves joint {joint} by "
            f"{h[joint, mode]:g}.",
            why="A fully stuck joint restrains every mode that moves the joint, so that omega_n is "
            "positive.",
            remedy="Use the modes of the structure including the stiffness of the joints.",
        )


def warn_of_stiff_joints(structure: Structure) -> None:
    r"""Warn if the joints are stiffer than the whole structure.

    $$\lambda_{max}\Big(k_j \sum_i h_{ji} p_{il} / \omega_i^2\Big) > 1$$

    with the joints' stiffness k_j; for one mode, $k > \omega_n^2$: once the joints slip, no
    stiffness holds the structure. The structure must be an admitted one.
    """
    if not laws_in(structure.laws) or not is_concrete(structure):
        return
    all_joints = by_joint(structure)
    h, p, omega_n = (np.asarray(x) for x in (all_joints.h, all_joints.p, all_joints.omega_n))
    # pyright: ignore
    k = np.array([sum(float(law.stiffness()) for law in laws) for laws in all_joints.laws])  # pyright: ignore
    compliance = np.divide(1.0, omega_n**2, out=np.zeros_like(omega_n), where=omega_n > 0.0)
    shares = k[:, None] * ((h * compliance) @ p)
    largest = float(np.max(np.real(np.linalg.eigvals(shares))))
    if largest <= 1.0 + _ROUND_OFF:
        return
    if len(k) == 1:
        limit = k[0] / shares[0, 0]
        warning = stiffer_than_structure("1 / sum(h p / omega_n^2)", k[0], limit)
    else:
        warning = messages.joints_stiffer(largest)
    warnings.warn(warning, stacklevel=3)


def require_sampled(structure: Structure, fs: Any, substeps: int) -> None:
    """Raise if a step exceeds half a period of the highest mode; warn if it is nearly as long."""
    if not is_concrete(structure.omega_n, fs):
        return
    highest = float(np.max(np.asarray(structure.omega_n)))
    angle = highest / (float(fs) * substeps)
    motion_in_step = messages.step_of_mode(highest / (2 * np.pi), angle, float(fs), substeps)
    enough = int(np.ceil(highest / float(fs)))
    remedy = messages.put_substeps(enough)
    if angle > np.pi:
        raise ConfigError(f"{motion_in_step}; a step can resolve at most pi rad.", remedy=remedy)
    if angle > 1.0:
        warnings.warn(
            f"{motion_in_step}; above 1 the motion of the joint is inaccurate. {remedy}",
            stacklevel=4,
        )


def internal_resonances(
    structure: Structure,
    *,
    within: float = _NEAR,
    orders: tuple[int, ...] = _ORDERS,
) -> tuple[Commensurate, ...]:
    r"""List modes near an odd harmonic of a lower mode, $\omega_j \approx n\,\omega_i$.

    The joint produces forces at n omega; a mode there takes up energy, so that a backbone of one
    mode and one harmonic is wrong by several per cent in damping. A softening joint lowers omega_i
    with amplitude.

    Args:
        structure: The modes.
        within: Largest |omega_j / (n omega_i) - 1| [-].
        orders: Odd orders n.

    Returns:
        Pairs of modes, nearest first.

    Raises:
        ConfigError: The frequencies are traced, or as for every function that takes a `Structure`.

    Examples:
        A mode at 57.0 Hz lies 1.1 % above three times 18.8 Hz:

        >>> import jbw; jbw.enable_x64()
        >>> import numpy as np
        >>> omega_n, one = 2 * np.pi * np.array([18.8, 57.0]), np.ones(2)
        >>> modes = jbw.Structure(omega_n, 0.004 * one, h=np.array([1.0, -1.7]), b=one, c=one)
        >>> (found,) = jbw.internal_resonances(modes)
        >>> print(found.mode, found.other, found.order, f"{found.detuning:.1%}")
        0 1 3 1.1%
    """
    if not is_concrete(structure.omega_n, within):
        raise ConfigError(
            "`internal_resonances` cannot be traced by `jit`, `grad` or `vmap`.",
            why="The number of returned pairs depends on the frequencies.",
            remedy="Call `internal_resonances` outside `jit`, `grad` and `vmap`.",
        )
    omega = np.asarray(admitted(structure).omega_n)
    pairs = [
        Commensurate(i, j, n, float(omega[j] / (n * omega[i]) - 1.0))
        for i in range(omega.size)
        for j in range(omega.size)
        for n in orders
        if i != j and abs(omega[j] / (n * omega[i]) - 1.0) <= within
    ]
    return tuple(sorted(pairs, key=lambda pair: abs(pair.detuning)))
