r"""Steady harmonics of tones, stepped sines and response curves: reduction, prediction.

The measured motion is the guess from which harmonic balance finds the model's, so no curve is
lost where it bends over, and a point costs two steps of Newton's iteration and no search.
"""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from jbw.observables.joint import joint_of
from jbw.observables.repeats import Repeats, repeats
from jbw.oscillator.harmonic_balance import refined
from jbw.oscillator.hysteresis import steady_loop
from jbw.oscillator.parameters import BoucWen
from jbw.oscillator.waveform import odd_harmonics

NUM_NODES = 16
NUM_HARMONICS = 4  # odd orders balanced: what is left out is a part in 1e6 of the first


class Points(eqx.Module):
    """Harmonics of the steady motion at many frequencies and levels, group by group.

    A group is one harmonic of one test. In a force-controlled test the response is compared, in a
    response-controlled one the force is.

    Attributes:
        omega: Frequency of each point [rad/s].
        load: Measured odd harmonics of the source at each point [V, N or N/kg].
        motion: Measured odd harmonics of the displacement [m], zero where not measured.
        mean: Values of each group: those of the response in the unit it was measured in, or of the
            force in the source's; zero behind a group's last point.
        point: Number of the point of each value.
        position: Position of each group's order among the odd ones.
        factor: From displacement or force per unit mass to the value's unit; zero behind the last.
        repeats: Their repeats.
        of_force: Whether a group's values are the force; static.
    """

    omega: Float[Array, " point"]
    load: Complex[Array, "point harmonic"]
    motion: Complex[Array, "point harmonic"]
    mean: Complex[Array, "group value"]
    point: Int[Array, "group value"]
    position: Int[Array, " group"]
    factor: Complex[Array, "group value"]
    repeats: Repeats
    of_force: tuple[bool, ...] = eqx.field(static=True)


class Group(NamedTuple):
    """One measured harmonic of one test, before it is put among others.

    Attributes:
        label: Name of the group.
        run: Run of its test.
        omega: Frequencies [rad/s].
        load: Odd harmonics of the source, phases counted from its first [unit of the source].
        motion: Odd harmonics of the displacement, zero where not measured [m].
        order: Order that is compared: 1, 3, ...
        values: Measured values, mean over repeats.
        factor: From metres, or N/kg, to the unit of the values.
        within: Scatter of the repeats about their mean, summed.
        num_repeats: Repeats.
        of_force: Whether the values are the force's.
    """

    label: str
    run: str
    omega: Float[np.ndarray, " value"]
    load: Complex[np.ndarray, "value harmonic"]
    motion: Complex[np.ndarray, "value harmonic"]
    order: int
    values: Complex[np.ndarray, " value"]
    factor: Complex[np.ndarray, " value"]
    within: float
    num_repeats: int
    of_force: bool = False


def gather(groups: list[Group]) -> Points:
    """Groups side by side; those of one test share its points.

    Args:
        groups: The groups, those of a test with the same omega, load and motion.

    Returns:
        The points.
    """
    tests: dict[bytes, int] = {}
    omega, load, motion, first = [], [], [], []
    for group in groups:
        key = group.omega.tobytes() + group.load.tobytes() + group.motion.tobytes()
        if key not in tests:
            tests[key] = sum(map(len, omega))
            omega.append(group.omega)
            load.append(group.load)
            motion.append(group.motion)
        first.append(tests[key])
    longest = max(len(group.values) for group in groups)

    def filled(rows: list[np.ndarray]) -> Array:
        return jnp.asarray(np.stack([np.pad(row, (0, longest - len(row))) for row in rows]))

    sizes = np.array([2 * len(group.values) for group in groups])
    return Points(
        omega=jnp.asarray(np.concatenate(omega)),
        load=jnp.asarray(np.concatenate(load)),
        motion=jnp.asarray(np.concatenate(motion)),
        mean=filled([group.values for group in groups]),
        point=filled(
            [start + np.arange(len(g.values)) for start, g in zip(first, groups, strict=True)]
        ),
        position=jnp.asarray([group.order // 2 for group in groups]),
        factor=filled([group.factor for group in groups]),
        repeats=repeats(
            within=np.array([group.within for group in groups]),
            num_repeats=np.array([group.num_repeats for group in groups]),
            sizes=sizes,
            longest=2 * longest,
            labels=tuple(group.label for group in groups),
            runs=tuple(group.run for group in groups),
            scale=np.array([np.sqrt(np.mean(np.abs(g.values) ** 2) / 2) for g in groups]),
        ),
        of_force=tuple(group.of_force for group in groups),
    )


def motion_of(theta: Mapping[str, Array], data: Points) -> Complex[Array, "point harmonic"]:
    """Odd harmonics of the displacement under the measured force of every point [m].

    Args:
        theta: The joint's parameters and `gain`.
        data: The points.
    """
    joint = joint_of(theta)
    return jax.vmap(lambda omega, guess, load: refined(joint, omega, guess, load))(
        data.omega, data.motion, theta["gain"] * data.load
    )


def force_of(theta: Mapping[str, Array], data: Points) -> Complex[Array, " point"]:
    r"""Fundamental of the force per unit mass that the measured fundamental motion takes [N/kg].

    $$F_1 = (k - \omega^2 + 2j\zeta\omega_n\omega)\,Y_1 + Z_1(|Y_1|)\,Y_1/|Y_1|$$

    The third harmonic of the motion, which a controller leaves free, is neglected: it changes the
    first by 3e-4 at most.

    Reference:
        Eqs. (1), (2).
    """
    joint, y = joint_of(theta), data.motion[:, 0]
    stiffness = joint.k - data.omega**2 + 2j * joint.zeta * joint.omega_n * data.omega
    return (stiffness + equivalent_stiffness(joint, jnp.abs(y))) * y


def first_harmonic(joint: BoucWen, y_peak: Float[Array, ""]) -> Complex[Array, ""]:
    """First harmonic of the hysteretic force, and of that beside it, for y = Y cos(theta)."""
    z_1 = steady_loop(joint, y_peak).z_1
    if joint.restoring is None:
        return z_1
    return z_1 + odd_harmonics(joint.restoring, jnp.atleast_1d(y_peak).astype(complex))[0]


def equivalent_stiffness(
    joint: BoucWen, y_peak: Float[Array, " point"]
) -> Complex[Array, " point"]:
    """Z_1(Y) / Y, and what stands beside it, at many amplitudes.

    By a polynomial: it is a smooth function of the amplitude, which sixteen Chebyshev nodes give
    to 1e-9 over a decade.
    """
    middle, half = 0.5 * (y_peak.max() + y_peak.min()), 0.5 * (y_peak.max() - y_peak.min())
    half = jnp.maximum(half, 1e-6 * middle)
    angle = np.pi * (np.arange(NUM_NODES) + 0.5) / NUM_NODES
    nodes = middle + half * np.cos(angle)
    values = jax.vmap(lambda y: first_harmonic(joint, y))(nodes) / nodes
    order = np.arange(NUM_NODES)
    to_series = 2.0 / NUM_NODES * np.cos(np.outer(order, angle))
    to_series[0] /= 2.0
    place = jnp.arccos(jnp.clip((y_peak - middle) / half, -1.0, 1.0))
    return jnp.cos(place[:, None] * order) @ (to_series @ values)


def predict(theta: Mapping[str, Array], data: Points) -> Complex[Array, "group value"]:
    """Predicted values of every group, zero behind its last.

    Args:
        theta: The joint's parameters and `gain`.
        data: The points.

    Returns:
        Response in its measured unit, or force in the source's.
    """
    column, of_force = data.position[:, None], np.array(data.of_force)
    forced = moved = jnp.zeros(data.point.shape, complex)
    if of_force.any():
        forced = force_of(theta, data)[data.point] / theta["gain"]
    if not of_force.all():
        moved = motion_of(theta, data)[data.point, column]
    return data.factor * jnp.where(of_force[:, None], forced, moved)


def compare(theta: Mapping[str, Array], data: Points) -> Float[Array, "group part"]:
    """Measured less predicted values, real parts then imaginary parts."""
    left = data.mean - predict(theta, data)
    return jnp.concatenate([left.real, left.imag], axis=1)
