r"""Controlled tests in the likelihood: the force that sustains each measured amplitude.

A controller fixes the phase (a backbone, or points at another phase) or the amplitude (S-curves,
response curves through their unstable branch, surfaces of force). The quantities that are not fixed
are predicted at the measured amplitude, by a harmonic balance condensed to it
(`jbw.oscillator.steady.backbone`): no point can jump to another branch.

| controlled | measured and taken as exact | compared |
|---|---|---|
| phase | amplitude, phase | frequency [Hz], force |
| amplitude | amplitude, frequency | phase [rad], force |

A group is one compared quantity of one test, with its own noise; that of a force is relative.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.optimize import minimize_scalar

from jbw.errors import DataError
from jbw.measurement.curves import ControlledCurve, controlled_curve
from jbw.measurement.records import Record, Test, run_of
from jbw.measurement.resonances import oscillator_through
from jbw.observables.groups import (
    Groups,
    Rows,
    changed,
    compared,
    filled,
    repeated,
    with_fitted_noise,
)
from jbw.observables.line_fit import LEAST_LINES
from jbw.observables.observable import Laws, Observable, Shown, SteadyLines, Theta, alone
from jbw.observables.residual_terms import receptance, taken
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.steady.backbone import force_at, tone_at_phase
from jbw.quantities import DEFAULT_LAWS, Motion, derivative_order

# half width of a resonance relative to its frequency, used until a fit gives the damping
HALF_WIDTH = 0.01
# fraction of the points, those of smallest motion, from which omega_n gets its starting value
FEW = 0.25
# lower limit of the fitted standard deviation of the noise, relative to the rms residual of a fit;
# the noise from amplitude errors is known and is added to the fitted noise
LEAST_NOISE = 1e-3
QUARTER = -0.5 * np.pi  # phase of the displacement relative to the force at phase resonance [rad]
# Deviations between repeats are stored for four quantities: the frequency (the phase, if the test
# prescribes the frequency), the force, log Y and the phase.
MOMENTS = 4


class ControlledGroup(NamedTuple):
    """A data group of a controlled test: the number of the test, and the compared quantity."""

    test: int
    quantity: str  # compared quantity: frequency, phase or force


class ControlledPoints(Observable):
    """The points of controlled tests: a data group for frequency or phase, and one for force.

    Attributes:
        omega: Measured frequency of every point [rad/s]; padded with a test's last value.
        amplitude: Measured amplitude of the displacement [m]; padded with a test's last value.
        phase: Measured or controlled phase of the displacement to the force [rad]; NaN if neither.
        load: Measured amplitude of the source [N, V or N/kg]; NaN if not measured.
        counted: 1 for a point, 0 for padding.
        mean: Compared values in their units; zero for padding. Errors are relative to the mean
            force, to the half width of the resonance [Hz], or to one radian.
        scale: Noise of every value over its geometric mean, a number of about 1.
        mixed: Part of the force's misfit in a group, because both contain the noise of the
            amplitude.
        moments: Scatter of the repeats of every point: products of deviations, summed over repeats,
            of the compared quantity other than force, the force, the log amplitude and the phase.
        amplitude_std: Stated relative standard deviation of each test's amplitudes.
        rows: Test and compared quantity of each group; static.
        is_locked: Whether the phase is controlled, so that the frequency is predicted; static.
        unit_of_source: Unit of the forces; static.
    """

    kinds: ClassVar[tuple[str, ...]] = ("backbone", "curve")
    suffix: ClassVar[str] = "_controlled"
    dimension: ClassVar[str] = "controlled"
    several: ClassVar[bool | None] = False

    omega: Float[Array, "test point"]
    amplitude: Float[Array, "test point"]
    phase: Float[Array, "test point"]
    load: Float[Array, "test point"]
    counted: Float[Array, "test point"]
    scale: Float[Array, "group point"]
    mixed: Float[Array, "group point"]
    moments: Float[Array, "test point variable variable"]
    amplitude_std: Float[Array, " test"]
    rows: tuple[ControlledGroup, ...] = eqx.field(static=True)
    is_locked: bool = eqx.field(static=True)
    unit_of_source: str = eqx.field(static=True)

    @classmethod
    def reduce(
        cls, tests: Sequence[Test], *, laws: Laws = DEFAULT_LAWS, substeps: int | None = None
    ) -> tuple["ControlledPoints", ...]:
        """Average the repeats of each point; equally controlled tests form one dataset part."""
        families: dict[tuple[Any, ...], list[tuple[Test, list[ControlledCurve]]]] = {}
        for test in tests:
            held = test.locked_phase if test.traits.is_locked else float("nan")
            curves = [controlled_curve(record, held) for record in test.records]
            _require_alike(test, curves)
            valid_curves = _without_lost_points(curves)
            form = test.traits.is_locked, valid_curves[0].force is not None, test.residuals
            families.setdefault(form, []).append((test, valid_curves))
        return tuple(
            (cls if forced else Frequencies).of(family, laws, residuals, is_locked=locked)
            for (locked, forced, residuals), family in families.items()
        )

    @classmethod
    def of(
        cls,
        family: Sequence[tuple[Test, Sequence[ControlledCurve]]],
        laws: Laws,
        residuals: str,
        *,
        is_locked: bool,
    ) -> Self:
        """Build a dataset part from equally controlled tests and the curves of their repeats."""
        if residuals == "own":
            raise DataError(
                "`residuals` = 'own' needs a test whose response is compared, but "
                f"{family[0][0].name} compares the force.",
                why="In a test with a controlled response, a residual term changes the compared "
                "force through the law of the joint.",
                remedy="State `residuals` = 'upper' or 'both', whose terms all tests share.",
            )
        rows, values = zip(
            *(
                (ControlledGroup(number, quantity), of_repeats)
                for number, (_, curves) in enumerate(family)
                for quantity, of_repeats in _compared(curves, is_locked=is_locked)
            ),
            strict=True,
        )
        means = [of_repeats.mean(axis=0) for of_repeats in values]
        scales = [_first_scale(row, mean) for row, mean in zip(rows, means, strict=True)]
        omega, amplitude, phase = zip(*(_mean_inputs(curves) for _, curves in family), strict=True)
        forces = [_mean_force(curves) for _, curves in family]
        moments = [_moments(curves, is_locked=is_locked) for _, curves in family]
        longest = max(map(len, means))
        source = family[0][0].records[0]
        unit = "" if np.isnan(forces[0]).all() else source.units[source.source]
        return cls(
            omega=filled(omega, "edge"),
            amplitude=filled(amplitude, "edge"),
            phase=filled(phase, "edge"),
            load=filled(forces, "edge"),
            counted=filled([np.ones(len(points)) for points in omega]),
            mean=filled(means),
            scale=filled(scales, "edge"),
            mixed=jnp.zeros((len(means), longest)),
            moments=jnp.asarray(
                np.stack([np.pad(m, ((0, longest - len(m)), (0, 0), (0, 0))) for m in moments])
            ),
            amplitude_std=jnp.asarray([test.amplitude_std for test, _ in family]),
            groups=_groups_of([family[row.test][0] for row in rows], rows, values, scales, unit),
            rows=rows,
            is_locked=is_locked,
            unit_of_source=unit,
            laws=laws,
            residuals=residuals,
        )

    @classmethod
    def design(
        cls,
        theta: Theta,
        amplitude: Float[np.ndarray, " point"],
        *,
        response: Motion,
        noise_std: float,
        num_samples: int,
        laws: Laws = DEFAULT_LAWS,
    ) -> Self:
        r"""Return planned points at phase resonance, with their expected measurement noise.

        The fundamental of N samples has the relative standard deviation $\epsilon =
        \sigma\sqrt{2/N}/X$ along and across its phasor, where X is the response's amplitude. The
        force has the same; the frequency has $\zeta_{eq} f \epsilon$, because an error of the phase
        shifts it.
        """
        omega = np.full(len(amplitude), float(theta["omega_n"]))
        load = np.ones(len(amplitude))
        curve = ControlledCurve(omega / (2 * np.pi), amplitude, np.full_like(omega, QUARTER), load)
        record = Record(float("nan"), {"force": load}, {"force": "N"})
        test = Test("backbone", (record,), "planned")
        planned = cls.of([(test, [curve])], laws, "none", is_locked=True)
        hz, force = np.asarray(_predicted(theta, alone(planned)))
        zeta = float(theta["gain"]) * force / (2 * (2 * np.pi * hz) ** 2 * amplitude)
        part = noise_std * np.sqrt(2 / num_samples)
        part = part / ((2 * np.pi * hz) ** derivative_order(response) * amplitude)
        scale = np.abs([zeta * hz * part, force * part])
        groups = changed(planned.groups, noise_std=np.ones(2))
        mean = jnp.asarray([hz, force])
        return replace(planned, mean=mean, scale=jnp.asarray(scale), groups=groups)

    def predict(self, theta: Theta) -> Float[Array, "group point"]:
        """Predict each data group: frequency [Hz], phase [rad], or force in the source's unit."""
        return self._at(theta, self.amplitude, self.phase)

    def _at(
        self, theta: Theta, amplitude: Float[Array, "test point"], phase: Float[Array, "test point"]
    ) -> Float[Array, "group point"]:
        """Predict each data group at given amplitudes [m] and phases [rad] of the displacement."""
        joint, gain = oscillator_of(theta, self.laws), theta["gain"]
        y, phi = self._of_joint(theta, amplitude, phase)
        if self.is_locked:
            tone = partial(tone_at_phase, joint)
            omega, force = jax.vmap(jax.vmap(tone))(y, phi)
            frequency_or_phase = omega / (2 * np.pi)
        else:
            held = jax.vmap(jax.vmap(partial(force_at, joint)))(self.omega, y) / gain
            # The phase of the force refers to the motion without residual terms, which leads the
            # measured motion.
            frequency_or_phase, force = -jnp.angle(held) - (phi - phase), jnp.abs(gain * held)
        by_quantity = {"force": force / jnp.abs(gain)}
        return jnp.stack(
            [by_quantity.get(row.quantity, frequency_or_phase)[row.test] for row in self.rows]
        )

    def _of_joint(
        self, theta: Theta, amplitude: Float[Array, "test point"], phase: Float[Array, "test point"]
    ) -> tuple[Float[Array, "test point"], Float[Array, "test point"]]:
        r"""Return amplitude and phase of the joint's motion, $Y e^{j\varphi} - R(\omega) g F$."""
        terms = taken(theta, self.residuals)
        if not terms or self.unit_of_source == "":
            return amplitude, phase
        motion_phase = phase
        # If the phase is not measured, `phase` is that of the motion without residual terms.
        if not self.is_locked:
            hold = partial(force_at, oscillator_of(theta, self.laws))
            without = -jnp.angle(jax.vmap(jax.vmap(hold))(self.omega, amplitude) / theta["gain"])
            motion_phase = jnp.where(jnp.isfinite(phase), phase, without)
        moved = amplitude * jnp.exp(1j * motion_phase)
        joint_motion = moved - receptance(terms, self.omega) * theta["gain"] * self.load
        return jnp.abs(joint_motion), motion_phase + jnp.angle(joint_motion / moved)

    def compared(self, values: Any) -> Float[Array, "group point"]:
        """Return values divided by their noise profile, less the part correlated with the force."""
        rows = self._counted * values
        return (rows - self.mixed * rows[self._force_of_test]) / self.scale

    def misfit(self, theta: Theta) -> Float[Array, "group point"]:
        """Return measured minus predicted values / their noise profile, with wrapped phases."""
        residual = self.mean - self.predict(theta)
        turned = jnp.array([row.quantity == "phase" for row in self.rows])[:, None]
        return self.compared(jnp.where(turned, jnp.angle(jnp.exp(1j * residual)), residual))

    @property
    def _counted(self) -> Float[Array, "group point"]:
        return self.counted[np.array([row.test for row in self.rows])]

    @property
    def _force_of_test(self) -> Int[np.ndarray, " group"]:
        forces = {row.test: i for i, row in enumerate(self.rows) if row.quantity == "force"}
        return np.array([forces.get(row.test, i) for i, row in enumerate(self.rows)])

    def spread(self, group: int) -> Float[np.ndarray, " value"]:
        """Return the standard deviation of each value of a group, divided by the group's noise."""
        where, force = compared(self.groups, group), self._force_of_test[group]
        scale, mixed = (np.asarray(x)[group][where] for x in (self.scale, self.mixed))
        noise = np.asarray(self.groups.noise_std)
        force_noise = mixed * np.asarray(self.scale)[force][where] * noise[force] / noise[group]
        return np.hypot(scale, force_noise)

    def relative_to(self, group: int) -> Float[np.ndarray, " value"]:
        """Return the values to which relative errors refer; for forces, the measured forces."""
        mean = np.asarray(self.mean)[group][compared(self.groups, group)]
        if self.rows[group].quantity == "force":
            return mean
        return np.full(len(mean), np.asarray(self.groups.reference)[group])

    def with_fitted_noise(self, theta: Theta, residuals: Rows) -> Self:
        """Return the data with noise estimated from residuals, including amplitude noise."""
        rows = np.zeros(self.mean.shape)
        for i, label in enumerate(self.groups.labels):
            rows[i, : len(residuals[label])] = np.real(residuals[label])
        raw = rows * np.asarray(self.scale)
        raw += np.asarray(self.mixed) * raw[self._force_of_test]
        carried = self._carrying(theta, raw)
        together, groups = np.asarray(carried.compared(raw)), carried.groups
        residuals = {x: together[i][compared(groups, i)] for i, x in enumerate(groups.labels)}
        return replace(carried, groups=with_fitted_noise(residuals, groups))

    def _carrying(self, theta: Theta, residual: Float[np.ndarray, "group point"]) -> Self:
        r"""Propagate noise of amplitude and phase through the model, linearised at a point.

        $$r_i = \epsilon_i + s_i\,\eta_i, \qquad s_i = \partial m_i / \partial \ln Y_i$$

        where all groups of a test share the errors eta of its amplitudes, with the stated standard
        deviation. The other groups contain the part $\mathrm{cov}(r, r_F) / \mathrm{var}(r_F)$ of
        the force's misfit r_F; it is subtracted from them. The deviation of a repeat counts without
        the part that its own amplitude and phase explain.
        """
        slopes = [np.asarray(x) for x in slopes_by_inputs(theta, replace(self, groups=None))]
        deviations = [self._deviation(i, [x[i] for x in slopes]) for i in range(len(self.rows))]
        scale, mixed = np.array(self.scale), np.zeros(self.mean.shape)
        within, force = np.asarray(self.groups.within).copy(), self._force_of_test
        variances, noisy = np.ones(scale.shape), np.asarray(self.amplitude_std)
        # Force groups come first, because the other groups need their result.
        for i in sorted(range(len(self.rows)), key=lambda i: i != force[i]):
            where, test = compared(self.groups, i), self.rows[i].test
            by_amplitude = (noisy[test] * slopes[0][i][where]) ** 2
            count = float(self.groups.num_repeats[i])
            square = count * residual[i][where] ** 2
            course = _course(self.rows[i], (np.asarray(self.mean)[i] - residual[i])[where])
            noise = beside_known(square, course, by_amplitude)
            variances[i][where] = noise * course**2 + by_amplitude
            remaining_variance = variances[i][where]
            if force[i] != i and noisy[test] > 0:
                other = slopes[0][force[i]][where]
                common = noisy[test] ** 2 * slopes[0][i][where] * other
                mixed[i][where] = common / variances[force[i]][where]
                remaining_variance = remaining_variance - mixed[i][where] * common
            scale[i][where] = np.sqrt(
                remaining_variance / np.exp(np.mean(np.log(remaining_variance)))
            )
            together = deviations[i] - mixed[i][:, None] * deviations[force[i]]
            within[i] = self._scatter(i, together, scale[i])
        groups = changed(self.groups, within=within, reference=self._sizes(theta))
        arrays = jax.device_put({"scale": scale, "mixed": mixed})
        return replace(self, **arrays, groups=groups)

    def _deviation(
        self, group: int, slopes: Sequence[Float[np.ndarray, " point"]]
    ) -> Float[np.ndarray, "point variable"]:
        """Return weights that remove effects of amplitude and phase errors from deviations."""
        weights = np.zeros((len(slopes[0]), MOMENTS))
        weights[:, 1 if self.rows[group].quantity == "force" else 0] = 1.0
        weights[:, 2] = -slopes[0]
        if self.is_locked:
            weights[:, 3] = -slopes[1]
        return weights

    def _scatter(
        self,
        group: int,
        weights: Float[np.ndarray, "point variable"],
        scale: Float[np.ndarray, " point"],
    ) -> float:
        """Return the weighted sum of squared deviations of repeats from their mean."""
        products = np.asarray(self.moments)[self.rows[group].test]
        squares = np.einsum("pi,pij,pj->p", weights, products, weights)
        return float(np.sum((squares / scale**2)[compared(self.groups, group)]))

    def _sizes(self, theta: Theta) -> Float[np.ndarray, " group"]:
        r"""Return reference values of relative errors; for frequencies $g F f / (2 \omega^2 Y)$."""
        size, gain = np.array(self.groups.reference), abs(float(theta["gain"]))
        for i, row in enumerate(self.rows):
            if row.quantity == "frequency" and self.unit_of_source:
                where = compared(self.groups, i)
                omega, y, load = (
                    np.asarray(x)[row.test][where] for x in (self.omega, self.amplitude, self.load)
                )
                size[i] = np.mean(gain * load / (4 * np.pi * omega * y))
        return size

    def shown(self, omega_n: float = 1.0) -> Shown:
        """Return estimates without a model: frequency at small motion, and the measured forces."""
        lines = partial(_steady_lines, self)
        y_peak = float(jnp.max(self.amplitude))
        amplitudes = np.asarray(self.amplitude)[[row.test for row in self.rows]]
        places = [y[compared(self.groups, i)] for i, y in enumerate(amplitudes)]
        of_groups = range(len(self.rows))
        return Shown(
            partial(_first_values, self),
            lines,
            y_peak=y_peak,
            axis=("displacement", "m"),
            places=places,
            spreads=[self.spread(i) for i in of_groups],
            references=[self.relative_to(i) for i in of_groups],
        )


def _first_values(data: ControlledPoints) -> dict[str, float]:
    """Return a starting value of omega_n from the points of smallest motion."""
    omega, y, load, phase = _points(data)
    least = np.argsort(y)[: max(LEAST_LINES, int(FEW * len(y)))]
    several = len(np.unique(omega[least])) >= LEAST_LINES
    if data.is_locked or not several or np.isnan(load * phase).any():
        return {"omega_n": float(np.median(omega[least]))}
    moved = y[least] * np.exp(1j * phase[least])
    through = oscillator_through(omega[least], load[least] + 0j, moved)
    return {"omega_n": through["omega_n"]}


def _steady_lines(data: ControlledPoints) -> SteadyLines | None:
    """Return the points with a measured force; replace unmeasured phases by 0 or -pi."""
    if not data.unit_of_source:
        return None
    omega, y, load, phase = _points(data)
    limit_phase = np.where(omega < _first_values(data)["omega_n"], 0.0, -np.pi)
    phase_or_limit = np.where(np.isfinite(phase), phase, limit_phase)
    return SteadyLines(omega, load + 0j, y * np.exp(1j * phase_or_limit))


def _points(data: ControlledPoints) -> list[Float[np.ndarray, " point"]]:
    """Return frequency [rad/s], amplitude [m], source and phase [rad] of all points, unpadded."""
    counted = np.asarray(data.counted) > 0
    columns = data.omega, data.amplitude, data.load, data.phase
    return [np.asarray(column)[counted] for column in columns]


@eqx.filter_jit
def _predicted(theta: Theta, data: ControlledPoints) -> Float[Array, "group point"]:
    return data.predict(theta)


class Frequencies(ControlledPoints):
    """A backbone without forces, which constrains neither damping nor modal mass."""

    kinds: ClassVar[tuple[str, ...]] = ()
    informs: ClassVar[frozenset[str]] = frozenset({"omega_n"})


@eqx.filter_jit
def slopes_by_inputs(
    theta: Theta, data: ControlledPoints
) -> tuple[Float[Array, "group point"], Float[Array, "group point"]]:
    """Return derivatives of the predictions with respect to log amplitude and phase [1/rad]."""
    y, phase = data.amplitude, data.phase
    none, unit = jnp.zeros_like(y), jnp.ones_like(y)
    _, slopes_along = jax.linearize(partial(data._at, theta), y, phase)
    by_amplitude, by_phase = jax.vmap(slopes_along)(jnp.stack([y, none]), jnp.stack([none, unit]))
    return by_amplitude, by_phase


def beside_known(
    square: Float[np.ndarray, " value"],
    course: Float[np.ndarray, " value"],
    known: Float[np.ndarray, " value"],
) -> float:
    r"""Estimate the variance of the noise that a known variance does not explain, from residuals.

    $$\max_{\sigma^2} -\sum_i \left(\log v_i + \frac{r_i^2}{v_i}\right), \qquad
      v_i = \sigma^2 c_i^2 + \kappa_i^2$$
    """
    total_variance = float(np.mean(square / course**2))
    if total_variance == 0.0 or not np.any(known):
        return total_variance or 1.0

    def cost(log_variance: float) -> float:
        variance = np.exp(log_variance) * course**2 + known
        return float(np.sum(np.log(variance) + square / variance))

    bounds = np.log(total_variance) + np.array([2 * np.log(LEAST_NOISE), np.log(4.0)])
    minimum: Any = minimize_scalar(cost, bounds=bounds, method="bounded")
    return float(np.exp(minimum.x))


def _require_alike(test: Test, curves: Sequence[ControlledCurve]) -> None:
    if len({len(curve.freq_hz) for curve in curves}) > 1:
        raise DataError(
            f"Repeats of test `{test.name}` must have the same points, but they have "
            f"{', '.join(str(len(curve.freq_hz)) for curve in curves)}.",
            remedy="Make a separate test of each.",
        )


def _without_lost_points(curves: Sequence[ControlledCurve]) -> list[ControlledCurve]:
    """Return the repeated curves, without points that are lost (NaN) in any of the repeats."""
    valid = np.logical_and.reduce([curve.valid for curve in curves])
    return [curve.at(valid) for curve in curves]


def _compared(
    curves: Sequence[ControlledCurve], *, is_locked: bool
) -> Iterator[tuple[str, Float[np.ndarray, "repeat point"]]]:
    """Yield the name and all repeats' values of each compared quantity of a test."""
    if is_locked:
        yield "frequency", np.stack([curve.freq_hz for curve in curves])
    elif curves[0].phase is not None:
        first = curves[0].phase
        yield "phase", np.stack([_near(curve.phase, first) for curve in curves])
    if curves[0].force is not None:
        yield "force", np.stack([np.asarray(curve.force) for curve in curves])


def _near(phase: Any, first: Any) -> Float[np.ndarray, " point"]:
    """Return a phase shifted by whole turns to within half a turn of another phase [rad]."""
    return first + np.angle(np.exp(1j * (phase - first)))


def _groups_of(
    tests: Sequence[Test],
    rows: Sequence[ControlledGroup],
    values: Sequence[np.ndarray],
    scales: Sequence[np.ndarray],
    unit_of_source: str,
) -> Groups:
    """Build data groups from repeats, an array (repeat, point); scale each point's deviations."""
    means = [of_repeats.mean(axis=0) for of_repeats in values]
    size = np.array([_size(row, mean) for row, mean in zip(rows, means, strict=True)])
    unit_by_quantity = {"frequency": "Hz", "phase": "rad", "force": unit_of_source}
    return repeated(
        values,
        np.array([len(mean) for mean in means], float),
        [f"{test.name} {row.quantity}" for test, row in zip(tests, rows, strict=True)],
        [run_of(test) for test in tests],
        scale=size,
        course=scales,
        units=tuple(unit_by_quantity[row.quantity] for row in rows),
        reference=jax.device_put(size),
    )


def _mean_inputs(curves: Sequence[ControlledCurve]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each point's mean frequency [rad/s], amplitude [m] and phase [rad] (or NaN)."""
    omega = 2 * np.pi * np.mean([curve.freq_hz for curve in curves], axis=0)
    amplitude = np.exp(np.mean([np.log(curve.amplitude) for curve in curves], axis=0))
    return omega, amplitude, np.mean([_phase(curve, curves[0]) for curve in curves], axis=0)


def _phase(curve: ControlledCurve, first: ControlledCurve) -> Float[np.ndarray, " point"]:
    if curve.phase is None or first.phase is None:
        return np.full(len(curve.freq_hz), np.nan)
    return _near(curve.phase, first.phase)


def _mean_force(curves: Sequence[ControlledCurve]) -> Float[np.ndarray, " point"]:
    if curves[0].force is None:
        return np.full(len(curves[0].freq_hz), np.nan)
    return np.mean([np.asarray(curve.force) for curve in curves], axis=0)


def _moments(
    curves: Sequence[ControlledCurve], *, is_locked: bool
) -> Float[np.ndarray, "point variable variable"]:
    """Return the products of the quantities' deviations at each point, summed over repeats."""
    phase = np.stack([np.nan_to_num(_phase(curve, curves[0])) for curve in curves])
    frequency_or_phase = np.stack([curve.freq_hz for curve in curves]) if is_locked else phase
    force = np.nan_to_num(np.stack([_mean_force([curve]) for curve in curves]))
    log_y = np.log(np.stack([curve.amplitude for curve in curves]))
    values = np.stack([frequency_or_phase, force, log_y, phase], axis=-1)
    deviation = values - values.mean(axis=0)
    return np.einsum("kpi,kpj->pij", deviation, deviation)


def _course(row: ControlledGroup, mean: Float[np.ndarray, " point"]) -> Float[np.ndarray, " point"]:
    """Return the noise profile: proportional to the mean if a force is compared, else constant."""
    return mean if row.quantity == "force" else np.ones(len(mean))


def _first_scale(
    row: ControlledGroup, mean: Float[np.ndarray, " point"]
) -> Float[np.ndarray, " point"]:
    course = _course(row, mean)
    return course / np.exp(np.mean(np.log(course)))


def _size(row: ControlledGroup, mean: Float[np.ndarray, " point"]) -> float:
    if row.quantity == "force":
        return float(np.exp(np.mean(np.log(mean))))
    return HALF_WIDTH * float(np.mean(mean)) if row.quantity == "frequency" else 1.0
