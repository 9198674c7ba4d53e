r"""Steady harmonics of tones, stepped sines and response curves, in the likelihood.

The measured motion is the guess from which harmonic balance finds the model's, so that no curve is
lost where it folds, and a point costs two Newton steps without a search.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Inexact, Int

from jbw.errors import DataError
from jbw.measurement.records import Test
from jbw.measurement.residual_spectra import Spectrum, of_lines
from jbw.measurement.resonances import AmplitudeCurve, curve_of_points, oscillator_through
from jbw.observables.groups import Rows, changed, compared, filled, repeated
from jbw.observables.harmonic_groups import (
    NUM_HARMONICS,
    ORDERS,
    MeasuredHarmonic,
    groups_of,
    harmonic_label,
)
from jbw.observables.line_fit import LEAST_LINES, at_quadrature
from jbw.observables.observable import Laws, Observable, Shown, SteadyLines, Theta
from jbw.observables.residual_terms import receptance, taken
from jbw.oscillator.oscillator import Joint, as_oscillator, oscillator_of
from jbw.oscillator.steady.balance import refined
from jbw.oscillator.steady.cycle import steady_state
from jbw.quantities import DEFAULT_LAWS, UNIT_OF, derivative_order

NUM_NODES = 16
LEAST_POINTS = 6  # smallest number of points of a curve to which an oscillator is fitted


class Points(Observable):
    """The harmonics of steady motion at many frequencies and levels, by data group.

    In a force-controlled test the response is compared, in a response-controlled test the force.

    Attributes:
        omega: Frequency of each point [rad/s].
        load: Measured odd harmonics of the source at each point [V, N or N/kg].
        motion: Measured odd harmonics of the displacement [m], zero if not measured.
        point: Number of each value's point.
        position: Position of each group's order among the odd orders.
        factor: Factor from displacement or force per unit mass to the value's unit; zero for
            padding.
        of_force: Whether a group's values are the force; static.
    """

    kinds: ClassVar[tuple[str, ...]] = ("tones", "stepped", "frf")
    suffix: ClassVar[str] = "_harmonics"
    dimension: ClassVar[str] = "harmonic"

    omega: Float[Array, " point"]
    load: Complex[Array, "point harmonic"]
    motion: Inexact[Array, "point harmonic"]
    point: Int[Array, "group value"]
    position: Int[Array, " group"]
    factor: Complex[Array, "group value"]
    of_force: tuple[bool, ...] = eqx.field(static=True)

    @classmethod
    def reduce(
        cls, tests: Sequence[Test], *, laws: Laws = DEFAULT_LAWS, substeps: int | None = None
    ) -> tuple[Self, ...]:
        """Reduce all tests to harmonics; tests with the same residual terms share one dataset."""
        parts = []
        for residuals in dict.fromkeys(test.residuals for test in tests):
            groups = groups_of([test for test in tests if test.residuals == residuals])
            parts += [cls.of(groups, laws=laws, residuals=residuals)] if groups else []
        return tuple(parts)

    @classmethod
    def of(
        cls,
        groups: Sequence[MeasuredHarmonic],
        *,
        laws: Laws = DEFAULT_LAWS,
        residuals: str = "none",
    ) -> Self:
        """Combine data groups; groups of equal frequency, source and motion share their points."""
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
        spanned = _own_columns(groups) if residuals == "own" else None
        return cls(
            laws=laws,
            omega=jnp.asarray(np.concatenate(omega)),
            load=jnp.asarray(np.concatenate(load)),
            motion=jnp.asarray(np.concatenate(motion)),
            mean=filled([group.values for group in groups]),
            point=filled(
                [start + np.arange(len(g.values)) for start, g in zip(first, groups, strict=True)]
            ),
            position=jnp.asarray([group.order // 2 for group in groups]),
            factor=filled([group.factor for group in groups]),
            groups=repeated(
                [group.repeats for group in groups],
                np.array([2.0 * len(group.omega) for group in groups]),
                [group.label for group in groups],
                [group.run for group in groups],
                units=tuple(group.unit for group in groups),
                is_complex=True,
                spanned=spanned,
            ),
            of_force=tuple(group.of_force for group in groups),
            residuals=residuals,
        )

    @classmethod
    def design(
        cls,
        omega: Float[np.ndarray, " tone"],
        level: float,
        motion: Complex[np.ndarray, "tone harmonic"],
        *,
        response: str,
        noise_std: float,
        num_samples: int,
        laws: Laws = DEFAULT_LAWS,
    ) -> Self:
        r"""Return planned tones of given odd harmonics [m], with their expected noise.

        The real and imaginary parts of a harmonic of N samples have the variance $2\sigma^2 / N$
        each.
        """
        load = level * np.tile(np.arange(NUM_HARMONICS) == 0, (len(omega), 1)) + 0j
        groups = []
        for order in ORDERS:
            factor = (1j * order * omega) ** derivative_order(response)
            values = factor * motion[:, order // 2]
            group_fields = harmonic_label("planned", order), "planned", omega, load, motion, order
            groups.append(
                MeasuredHarmonic(*group_fields, values[None], factor, unit=UNIT_OF[response])
            )
        std = noise_std * np.sqrt(2 / num_samples)
        data = cls.of(groups, laws=laws)
        return replace(data, groups=changed(data.groups, noise_std=np.full(len(groups), std)))

    def predict(self, theta: Theta) -> Complex[Array, "group value"]:
        """Predict the response in its unit, or the force in the source's unit."""
        column, of_force = self.position[:, None], np.array(self.of_force)
        forced = moved = jnp.zeros(self.point.shape, complex)
        if of_force.any():
            forced = force_of(theta, self)[self.point] / theta["gain"]
        if not of_force.all():
            moved = (motion_of(theta, self) + added_motion(theta, self))[self.point, column]
        return self.factor * jnp.where(of_force[:, None], forced, moved)

    def shown(self, omega_n: float = 1.0) -> Shown:
        """Return model-free estimates: a fitted oscillator, harmonics, and frequencies."""
        return Shown(
            partial(_first_values, self),
            partial(_steady_lines, self),
            amplitude_readings=partial(_amplitude_readings, self),
            y_peak=float(jnp.max(jnp.abs(self.motion))),
            spectra=partial(_spectra, self),
        )


def _first_values(data: Points) -> dict[str, float]:
    """Return starting values: an oscillator fitted to first harmonics of the weakest curve."""
    motion, load, omega = (np.asarray(x) for x in (data.motion, data.load, data.omega))
    first = [points for points in _first_points(data).values() if len(points) >= LEAST_LINES]
    first = [points for points in first if len(points) > LEAST_LINES] or first
    if not first:
        return {}
    chosen = min(first, key=lambda points: np.abs(motion[points, 0]).max())
    return oscillator_through(omega[chosen], load[chosen, 0], motion[chosen, 0])


def _steady_lines(data: Points) -> SteadyLines:
    """Return source and motion at every point that has a first harmonic."""
    every = np.unique(np.concatenate(list(_first_points(data).values())))
    columns = data.omega[every], data.load[every, 0], data.motion[every, 0]
    return SteadyLines(*(np.asarray(x) for x in columns))


def _first_points(data: Points) -> dict[int, Int[np.ndarray, " point"]]:
    """Return the points of each data group of first harmonics, by index of the group."""
    rows, first = np.asarray(data.point), np.flatnonzero(np.asarray(data.position) == 0)
    return {i: rows[i][compared(data.groups, i)] for i in first.tolist()}


def _amplitude_readings(data: Points) -> AmplitudeCurve | None:
    """Return each curve's frequency and damping, at a held response or a lag of 90 degrees."""
    gain, readings = _first_values(data)["gain"], []
    columns = data.omega, data.load[:, 0], data.motion[:, 0]
    for i, points in _first_points(data).items():
        if len(points) < LEAST_POINTS:
            continue
        omega, load, motion = (np.asarray(x)[points] for x in columns)
        if data.of_force[i]:
            readings.append(_held(omega, load, motion))
        else:
            readings.append(at_quadrature(omega, load, motion, gain))
    rows = [reading for reading in readings if reading is not None]
    return curve_of_points(rows) if rows else None


def _spectra(data: Points, residuals: Rows) -> dict[str, Spectrum]:
    """Return the spectrum of each measured harmonic of the response, at its points' frequencies."""
    spectra = {}
    for i, label in enumerate(data.groups.labels):
        if data.of_force[i]:
            continue
        where, order = compared(data.groups, i), ORDERS[int(data.position[i])]
        point, factor = (np.asarray(x[i])[where] for x in (data.point, data.factor))
        omega, source = (np.asarray(x)[point] for x in (data.omega, data.load))
        values = np.asarray(data.mean[i])[where]
        # Higher harmonics of the source are distortion by the amplifier.
        driven = source[:, 0] * (order == 1)
        spectra[label] = of_lines(values, residuals[label], order * omega, driven, factor)
    return spectra


def _held(
    omega: Float[np.ndarray, " point"],
    load: Complex[np.ndarray, " point"],
    motion: Inexact[np.ndarray, " point"],
) -> tuple[float, float, float]:
    """Fit an oscillator to a controlled response; return its amplitude, frequency and damping."""
    read = oscillator_through(omega, load, motion)
    near = np.argmin(np.abs(omega - read["omega_n"]))
    return abs(motion[near]), read["omega_n"], read["zeta"]


def _own_columns(groups: Sequence[MeasuredHarmonic]) -> Float[np.ndarray, "group 2 part"]:
    r"""Return each curve's responses to unit terms U and L: real parts, then imaginary parts."""
    held = next((group.label for group in groups if group.of_force), None)
    if held is not None:
        raise DataError(
            "`residuals` = 'own' needs a test whose response is compared, but the response of "
            f"{held} was controlled.",
            why="If the response is controlled, measured and predicted force are compared, and a "
            "residual term would change the predicted force through the law of the joint.",
            remedy="State `residuals` as 'upper' or 'both', whose terms all tests share.",
        )
    first = [group.factor * group.load[:, group.order // 2] for group in groups]
    squared = [(group.order * group.omega) ** 2 for group in groups]
    second = [x / y for x, y in zip(first, squared, strict=True)]
    both = np.stack([np.asarray(filled(rows)) for rows in (first, second)], axis=1)
    return np.concatenate([np.real(both), np.imag(both)], axis=-1)


def motion_of(theta: Mapping[str, Array], data: Points) -> Complex[Array, "point harmonic"]:
    """Return odd harmonics of displacement [m] at each point under its measured force."""
    joint = oscillator_of(theta, data.laws)
    return jax.vmap(lambda omega, guess, load: refined(joint, omega, guess, load))(
        data.omega, data.motion, theta["gain"] * data.load
    )


def planned_motion(
    theta: Mapping[str, Array], omega: Any, level: Any, laws: Laws
) -> Complex[Array, "*point harmonic"]:
    """Return the odd harmonics of the displacement [m] that planned tones would cause.

    They are NaN where no steady motion was found.

    Args:
        theta: Parameters; for several joints as columns.
        omega: Frequencies of the tones [rad/s].
        level: Amplitude of the tones' source.
        laws: Names of the laws.
    """
    gain, joint = theta["gain"], oscillator_of(theta, laws)
    motion = steady_state(joint, omega, jnp.abs(gain) * level, NUM_HARMONICS)
    # If a channel's sign is reversed, the motion comes half a period later, so that odd harmonics
    # change sign.
    return jnp.sign(gain)[..., None] * motion


def added_motion(theta: Mapping[str, Array], data: Points) -> Complex[Array, "point harmonic"]:
    """Return odd harmonics of displacement [m] that modes outside the band add."""
    if not (terms := taken(theta, data.residuals)):
        return jnp.zeros_like(data.load)
    orders = jnp.arange(1, 2 * NUM_HARMONICS, 2)
    return receptance(terms, orders * data.omega[:, None]) * theta["gain"] * data.load


def force_of(theta: Mapping[str, Array], data: Points) -> Complex[Array, " point"]:
    r"""Return the force per unit mass [N/kg] that the measured first harmonic needs: eqs. (1), (2).

    $$F_1 = (k - \omega^2 + 2j\zeta\omega_n\omega + K(|Y_1|) + jC(|Y_1|))\,Y_1$$

    with Y_1 the joint's own motion: the measured motion minus the contribution of modes outside the
    band. The third harmonic of the motion, which a controller leaves free, changes it by 3e-4 at
    most.
    """
    joint, y = oscillator_of(theta, data.laws), (data.motion - added_motion(theta, data))[:, 0]
    stiffness = joint.k - data.omega**2 + 2j * joint.zeta * joint.omega_n * data.omega
    return (stiffness + equivalent_stiffness(joint, jnp.abs(y), data.omega)) * y  # pyright: ignore[reportReturnType]


def equivalent_stiffness(
    joint: Joint, y_peak: Float[Array, " point"], omega: Float[Array, " point"] | None = None
) -> Complex[Array, " point"]:
    """Return the laws' equivalent stiffness K + jC = F_1(Y) / Y, by a polynomial in amplitude.

    It has sixteen Chebyshev nodes. Because the stiffness is smooth in the amplitude, this is exact
    to 1e-9 over a decade. With a rate-dependent law, each point is computed separately, at its
    frequency omega [rad/s].
    """
    if omega is not None and any(law.feels_rate for law in joint.laws):
        stiffness, damping = jax.vmap(as_oscillator(joint).loop)(y_peak, omega)
        return stiffness + 1j * damping
    middle, half = 0.5 * (y_peak.max() + y_peak.min()), 0.5 * (y_peak.max() - y_peak.min())
    half = jnp.maximum(half, 1e-6 * middle)
    angle = np.pi * (np.arange(NUM_NODES) + 0.5) / NUM_NODES
    loops = jax.vmap(as_oscillator(joint).loop)(middle + half * np.cos(angle))
    values = loops.stiffness + 1j * loops.damping
    order = np.arange(NUM_NODES)
    to_series = 2.0 / NUM_NODES * np.cos(np.outer(order, angle))
    to_series[0] /= 2.0
    place = jnp.arccos(jnp.clip((y_peak - middle) / half, -1.0, 1.0))
    return jnp.cos(place[:, None] * order) @ (to_series @ values)
