r"""Continuation of a frequency-response curve along its arc length, through its folds."""

from functools import partial
from typing import Any, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jbw.errors import ModelError
from jbw.oscillator.checks import require_concrete, require_sense
from jbw.oscillator.modes.balance import StructureHarmonics, modes_of, of_one_joint
from jbw.oscillator.modes.structure import Structure, admitted, by_joint
from jbw.oscillator.newton import newton_root
from jbw.oscillator.oscillator import Joint, as_oscillator
from jbw.oscillator.steady.balance import (
    Packed,
    Unit,
    balance,
    dimensionless,
    linear_response,
    most_turns,
    residual,
    unpack,
)

# Weight: a relative change of the frequency by this much counts as a change of the harmonics by 1.
_FREQUENCY_SCALE = 0.2
_LEAST_STEP = 1e-6
_GROWTH = 1.5
_TOLERANCE = 1e-10
_MAX_NEWTON = 8

Point = Float[Array, " unknown"]


class ResponseCurve(eqx.Module):
    """The points along a frequency-response curve.

    Attributes:
        omega: Angular frequencies, not monotone where the curve folds [rad/s].
        harmonics: Complex peak amplitudes of orders 1, 3, 5, ... [m].
        onward: Whether the frequency moves towards the end of the curve at the point. Where it
            moves back, between two folds, the response is unstable.
    """

    omega: Float[np.ndarray, " point"]
    harmonics: Complex[np.ndarray, "point harmonic"]
    onward: np.ndarray


class StructureCurve(eqx.Module):
    """The points along a frequency-response curve of several modes with joints.

    Attributes:
        omega: Angular frequencies, not monotone where the curve folds [rad/s].
        harmonics: Harmonics of the joints, the modes and the outputs [m].
        onward: Whether the frequency moves towards the end of the curve, as in `ResponseCurve`.
    """

    omega: Float[np.ndarray, " point"]
    harmonics: StructureHarmonics
    onward: np.ndarray


@overload
def response_curve(
    joint: Structure,
    omega_start: float,
    omega_stop: float,
    amplitude: float,
    *a: int,
    **options: Any,
) -> StructureCurve: ...
@overload
def response_curve(
    joint: Joint,
    omega_start: float,
    omega_stop: float,
    amplitude: float,
    num_harmonics: int = 8,
    **options: Any,
) -> ResponseCurve: ...
def response_curve(  # pyright: ignore[reportInconsistentOverload]
    joint: Joint | Structure,
    omega_start: float,
    omega_stop: float,
    amplitude: float,
    num_harmonics: int = 8,
    *,
    step: float = 0.1,
    max_points: int = 2000,
    max_turns: int = 2,
) -> ResponseCurve | StructureCurve:
    r"""Compute the frequency-response curve at one level, through its folds.

    The unknowns are the harmonics q and the frequency; each point lies on the plane

    $$\tau\cdot(X - X_0) = s, \qquad \|dX\|^2 = \frac{\|dq\|^2}{\|q\|^2}
      + \left(\frac{d\omega}{0.2\,\omega}\right)^2$$

    ahead of the last point along its tangent tau, so that the curve is followed around its folds.
    The step s is halved where Newton's iteration fails, and grows back to `step`. This is a loop
    over compiled steps and cannot be used under `jit`.

    Args:
        joint: A `BoucWen` with nu = 1, or an `Oscillator`, scalars; or a `Structure`.
        omega_start: Angular frequency of the first point [rad/s], where one response exists.
        omega_stop: Angular frequency at which to stop, above or below the first [rad/s].
        amplitude: Force amplitude A [N/kg].
        num_harmonics: Number of odd harmonics.
        step: Largest arc length between two points [-].
        max_points: Number of points after which to stop with an error.
        max_turns: Turning points of y allowed in a period.

    Returns:
        The curve; its last point lies at or beyond `omega_stop`.

    Raises:
        ModelError: The first point does not converge, the step has become too small, the points do
            not reach `omega_stop`, or as for `steady_state`.
        ConfigError: The call is traced, or as for `steady_state`.

    Examples:
        The curve of a Duffing oscillator folds back, so that a sweep jumps there. Its peak is near
        A / (2 zeta omega_n omega):

        >>> import jbw; jbw.enable_x64()
        >>> import numpy as np
        >>> duffing = jbw.Oscillator(omega_n=100.0, zeta=0.01, laws=(jbw.Cubic(2.8e8),))
        >>> curve = jbw.response_curve(duffing, omega_start=90.0, omega_stop=115.0, amplitude=0.5)
        >>> print(f"{1e3 * abs(curve.harmonics[:, 0]).max():.2f} mm")
        2.36 mm
        >>> print(np.any(np.diff(curve.omega) < 0))
        True
    """
    require_concrete("response_curve", joint, omega_start, omega_stop, amplitude)
    stated_joint = joint
    is_one_joint = isinstance(joint, Structure) and jnp.ndim(joint.h) < 2
    joint = by_joint(admitted(joint)) if isinstance(joint, Structure) else as_oscillator(joint)
    require_sense(stated_joint, omega_start, amplitude, num_harmonics, max_turns)
    scalars = jax.tree.map(lambda x: jnp.asarray(x, float), (joint, omega_start, amplitude))
    unit, first, length = dimensionless(*scalars)
    unit_frequency = float(omega_start / first)
    last = omega_stop / unit_frequency
    side = 1.0 if last > first else -1.0
    point, direction = _first_point(unit, first, side, num_harmonics, max_turns)
    points, directions, arc = [point], [direction], step
    _require_progress(True, points, unit_frequency, amplitude)
    while side * (float(points[-1][-1]) - last) < 0.0:
        tried, direction, good = _advance(
            unit, points[-1], directions[-1], jnp.asarray(arc), max_turns
        )
        if not good:
            arc = 0.5 * arc
            _require_progress(arc > _LEAST_STEP, points, unit_frequency, amplitude)
            continue
        points.append(tried)
        directions.append(direction)
        _require_progress(len(points) < max_points, points, unit_frequency, amplitude)
        arc = min(step, _GROWTH * arc)
    x = np.stack(points)
    q = np.stack([_harmonics(unit, point) for point in x])
    omega, harmonics = x[:, -1] * unit_frequency, np.asarray(length) * (q[:, 0] + 1j * q[:, 1])
    onward = side * np.stack(directions)[:, -1] > 0.0
    if isinstance(joint, Structure):
        harmonics_at = partial(modes_of, joint, max_turns=max_turns)
        all_harmonics = jax.vmap(lambda omega, x: harmonics_at(omega, amplitude, x))(
            omega, harmonics
        )
        all_harmonics = of_one_joint(all_harmonics) if is_one_joint else all_harmonics
        return StructureCurve(omega, all_harmonics, onward)
    return ResponseCurve(omega, harmonics, onward)


@eqx.filter_jit
def _first_point(
    unit: Unit, ratio: Array, side: float, num_harmonics: int, max_turns: int
) -> tuple[Point, Point]:
    """Return the response at the first frequency with its direction; NaN if not converged."""
    start = linear_response(unit, ratio, num_harmonics)
    packed, load = balance(unit, ratio, start, max_turns)
    x = jnp.where(load == 1.0, jnp.append(packed.ravel(), ratio), jnp.nan)
    ahead = jnp.zeros_like(x).at[-1].set(side)
    return x, _tangent(unit, x, ahead, max_turns)


@eqx.filter_jit
def _advance(
    unit: Unit, x: Point, direction: Point, arc: Float[Array, ""], max_turns: int
) -> tuple[Point, Point, Array]:
    """Return the next point of the curve, its direction, and whether it was found."""
    scale = _scale(x)
    predicted = x + arc * direction * scale

    def on_plane(tried: Point, _: None) -> Point:
        off = jnp.dot(direction, (tried - predicted) / scale)
        return jnp.append(_equations(unit, tried, max_turns), off)

    tried, converged = newton_root(on_plane, predicted, tolerance=_TOLERANCE, max_steps=_MAX_NEWTON)
    ahead = _tangent(unit, tried, direction, max_turns)
    near = jnp.linalg.norm((tried - predicted) / scale) < arc
    turns = most_turns(unpack(_harmonics(unit, tried)))
    good = converged & near & (turns <= max_turns)
    return tried, ahead, good & jnp.all(jnp.isfinite(ahead))


def _equations(unit: Unit, x: Point, max_turns: int) -> Float[Array, " equation"]:
    return residual(_harmonics(unit, x), (unit, x[-1]), max_turns).ravel()


def _harmonics(unit: Unit, x: Point) -> Packed:
    """Return the harmonics of a point of the curve, for every joint of a structure."""
    joints = (len(unit.laws),) if isinstance(unit, Structure) else ()
    return x[:-1].reshape(2, *joints, -1)


def _tangent(unit: Unit, x: Point, previous: Point, max_turns: int) -> Point:
    """Return the unit tangent of the curve, in the direction of the previous one."""
    scale = _scale(x)
    jacobian = jax.jacfwd(lambda x: _equations(unit, x, max_turns))(x) * scale
    bordered = jnp.concatenate([jacobian, previous[None]])
    end = jnp.zeros_like(x).at[-1].set(1.0)
    tangent = jnp.linalg.solve(bordered, end)
    return tangent / jnp.linalg.norm(tangent)


def _scale(x: Point) -> Point:
    """Return the scale of each unknown: norm of the harmonics, a fifth of the frequency."""
    size = jnp.full_like(x, jnp.linalg.norm(x[:-1]))
    return size.at[-1].set(_FREQUENCY_SCALE * x[-1])


def _require_progress(
    good: bool, points: list[Point], unit_frequency: float, amplitude: float
) -> None:
    """Raise if the continuation stopped before the end of the frequency range."""
    if good and np.all(np.isfinite(points[-1])):
        return
    omega = float(points[-1][-1]) * unit_frequency
    raise ModelError(
        f"The response curve at amplitude = {amplitude:g} stopped at omega = {omega:g} after "
        f"{len(points)} points.",
        remedy="Start where the response is nearly linear, raise `max_points` or `max_turns`, or "
        "lower `step`.",
    )
