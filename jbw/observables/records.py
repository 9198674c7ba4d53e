"""Records under a measured input (sweeps, multisines) in the likelihood."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from threading import Thread
from typing import Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jbw.measurement.delays import on_time
from jbw.measurement.records import Test, periods, run_of
from jbw.measurement.residual_spectra import Spectrum, of_lines, of_samples
from jbw.measurement.resonances import oscillator_through
from jbw.observables import remembered
from jbw.observables.forms import by_form, common_form, first_alike
from jbw.observables.groups import Rows, changed, repeated, with_slope
from jbw.observables.modal_readings import band_peak, lines_of_motions, read_modes
from jbw.observables.modes import by_model
from jbw.observables.observable import OFFSETS, Laws, Observable, Shown, Theta, alone
from jbw.observables.residual_terms import own_columns, taken
from jbw.observables.samples import (
    Lines,
    band_limited,
    in_band,
    joints_at,
    lines_of,
    loudest_hz,
    models_at,
    response_of_terms,
    response_to,
    substeps_for,
    values_of,
)
from jbw.oscillator.batch import (
    MeasuredResponse,
    Model,
    Motions,
    compile_ahead,
    filled_up,
    march,
    record_of,
)
from jbw.oscillator.deepening import with_depth
from jbw.oscillator.hold import HeldInput
from jbw.oscillator.law import laws_in
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.laws.reversals import SIZE
from jbw.oscillator.modes.parameters import has_further_modes
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.residual_sums import Compared, Sums, residual_sums
from jbw.quantities import DEFAULT_LAWS, UNIT_OF, derivative_order
from jbw.report.messages import observed as messages

# Starting values are fitted to spectral lines above this fraction of the peak.
NEAR_PEAK = 0.3
ABSURD = 1e6  # A prediction larger than the largest measured value by this factor is invalid.
# Largest number of rows whose products with the response are summed in the time loop. For more
# rows, storing the response is cheaper.
MOST_ROWS = 12
# Relative steps of finite differences, which change the motion by about a thousandth. The
# truncation error is of fourth order in the step; rounding adds 1e-12.
DIFFERENCE = {"omega_n": 3e-6, "zeta": 5e-4}
SUBSTEPS = 2  # smallest default number of solver steps between samples


class Solution(eqx.Module):
    """Responses and residuals of records, computed in advance at one or many parameter points.

    Attributes:
        response: Response of every level from the first compared sample; None if only the sums
            below were requested.
        square: Sum of squares of the misfit of every level.
        along: Products of the misfit with the directions.
        peak: Largest response.
        y_peak: Largest displacement [m].
        products: Products of the response with given rows; None if none were given.
    """

    response: Float[Array, "*point level compared"] | None
    square: Float[Array, "*point level"]
    along: Float[Array, "*point level own"]
    peak: Float[Array, "*point level"]
    y_peak: Float[Array, "*point level"]
    products: Float[Array, "*point level row"] | None = None


class Records(Observable):
    """Records of several levels, reduced to means and deviations of their repeats.

    Attributes:
        held: Mean measured input of each level [V, N or N/kg], with its polynomials between the
            samples; periodic if each record is one period of a steady motion.
        mean: Mean measured response of each level [m, m/s or m/s^2], one group each, from the first
            compared sample. It is predicted at the origin of its group, if that has one: a record
            follows the phase over so many periods that no linearisation about the common omega_n
            reaches another day's frequency.
        fs: Sampling frequency [Hz]; static, like all below.
        response: displacement, velocity or acceleration.
        lines: First and end of the compared lines of the spectrum; None compares the samples.
        skipped: Samples at the start that are simulated from rest but not compared, `settle`.
        points: Point at which each level's response is measured: name of an additional point of
            `modes`, empty for the first point.
        moved: For each level, the first level with the same input: one motion, observed at several
            points.
        solution: Precomputed solution at the requested points; None if there is none.
    """

    kinds: ClassVar[tuple[str, ...]] = ("sweep", "multisine")
    dimension: ClassVar[str] = "level"
    stepped: ClassVar[bool] = True
    reads_hz: ClassVar[bool] = False

    held: HeldInput
    fs: float = eqx.field(static=True)
    response: str = eqx.field(static=True, default="velocity")
    lines: Lines | None = eqx.field(static=True, default=None)
    skipped: int = eqx.field(static=True, default=0)
    points: tuple[str, ...] = eqx.field(static=True, default=())
    moved: tuple[int, ...] = eqx.field(static=True, default=())
    solution: Solution | None = None

    @classmethod
    def reduce(
        cls, tests: Sequence[Test], *, laws: Laws = DEFAULT_LAWS, substeps: int | None = None
    ) -> tuple[Self, ...]:
        """Reduce tests to mean and deviations of repeats or periods; group tests by sampling."""
        sweeps = [on_time(test) for test in tests if test.kind != "multisine"]
        steady = [periods(test) for test in tests if test.kind == "multisine"]
        steady = [test for test in steady if test is not None]
        return tuple(
            cls.of(same, laws=laws, substeps=substeps, periodic=tests is steady)
            for tests in (sweeps, steady)
            for same in by_form(tests)
        )

    @classmethod
    def of(
        cls,
        tests: Sequence[Test],
        *,
        laws: Laws = DEFAULT_LAWS,
        substeps: int | None = None,
        periodic: bool = False,
    ) -> Self:
        """Build means and deviations of repeats, over time or over the spectral lines of a band."""
        tests = [on_time(test) for test in tests]
        fs, response, length, skipped, residuals, *band_hz = common_form(tests)
        lines = lines_of(band_hz, length - skipped, fs)
        inputs = np.stack([np.mean([r.channels[r.source] for r in t.records], 0) for t in tests])
        responses = [np.stack([r.channels[response] for r in t.records]) for t in tests]
        responses = [in_band(r[:, skipped:], lines) for r in responses]
        means = np.stack([r.mean(axis=0) for r in responses])
        periods_of = [max(test.periods, 1) if periodic else 1 for test in tests]
        of_records = [
            r.reshape(-1, n, r.shape[1]) for r, n in zip(responses, periods_of, strict=True)
        ]
        size = means.shape[1] if lines is None else 2 * (lines[1] - lines[0])
        has_own_terms = residuals == "own"
        return cls(
            laws=laws,
            held=band_limited(inputs, periodic=periodic),
            mean=jax.device_put(means),
            # For a band, the sum of squared deviations over time equals that over the band's lines.
            groups=repeated(
                of_records,
                np.full(len(tests), size),
                [test.name for test in tests],
                [run_of(test) for test in tests],
                spanned=own_columns(inputs[:, skipped:], fs, response, lines)
                if has_own_terms
                else None,
                units=(UNIT_OF[response],) * len(tests),
                is_complex=lines is not None,
            ),
            depth=SIZE,
            fs=fs,
            response=response,
            substeps=substeps or substeps_for(loudest_hz(means, fs), fs, SUBSTEPS),
            lines=lines,
            skipped=skipped,
            residuals=residuals,
            points=tuple(test.point for test in tests),
            moved=tuple(first_alike(inputs)),
        )

    @property
    def source(self) -> Float[Array, "level time"]:
        """The mean measured input of each level [V, N or N/kg]."""
        return self.held.u

    @property
    def solving(self) -> dict[str, Any]:
        """The simulation options, as keyword arguments of `motion_under`."""
        return {"laws": self.laws, "substeps": self.substeps, "depth": self.depth}

    def predict(self, theta: Theta) -> Float[Array, "level compared"]:
        """Predict the response of each level to its mean input, including the run's offsets."""
        if self.solution is not None and self.solution.response is not None:
            return self.solution.response + self._of_terms(theta)
        several = any(self.points)

        def one(level: tuple[HeldInput, Array]) -> Float[Array, "*point compared"]:
            source, origin = level
            # `origin` is empty if runs have no offsets.
            offsets = dict(zip(OFFSETS, origin, strict=False))
            motion = response_to(
                {**theta, **offsets},
                source,
                self.fs,
                response=self.response,
                residuals=self.residuals,
                every_point=several,
                **self.solving,
            )
            return motion[..., self.skipped :]

        # Simulate levels one by one, because the solver skips work for rare events only without a
        # batch.
        if not several:
            return jax.lax.map(one, (self.held, self.groups.origin))
        motions = sorted(set(self.moved))
        first = jax.tree.map(lambda x: x[np.array(motions)], (self.held, self.groups.origin))
        rows = jax.lax.map(one, first)
        points = ("", *self.modes.points)
        where = [motions.index(m) for m in self.moved], [points.index(p) for p in self.points]
        return rows[tuple(map(np.array, where))]

    def _of_terms(self, theta: Theta) -> Float[Array, "level compared"] | float:
        """Return the response of residual terms to each level's input; 0 without residual terms."""
        if not taken(theta, self.residuals):
            return 0.0
        how = {"response": self.response, "residuals": self.residuals}
        terms = jax.vmap(lambda source: response_of_terms(theta, source, self.fs, **how))(self.held)
        return terms[:, self.skipped :]

    def compared(self, values: Array) -> Float[Array, "level value"]:
        """Return responses as real numbers: samples or, in a band, the lines of their spectra."""
        return values_of(values, self.lines)

    def misfit(self, theta: Theta) -> Float[Array, "level value"]:
        r"""Return mean response minus prediction, linear in the run's offsets.

        It is $d - m(o) - J^T (\theta - o)$ about an origin o.
        """
        predicted = self.predict(theta)
        # The rounding errors of a very large motion exceed the data. Such a motion may lie outside
        # the compared band, so that the samples are checked.
        hidden = self._hidden(jnp.max(jnp.abs(predicted), axis=1))
        residual = self.compared(self.mean - predicted)
        residual = jnp.where(hidden[:, None], jnp.nan, residual)
        if not self.groups.origin.shape[1]:
            return residual
        away = jnp.stack([theta[name] for name in OFFSETS]) - self.groups.origin
        return residual - jnp.einsum("lo,lov->lv", away, self.groups.directions)

    def residual_sums(
        self,
        theta: Theta,
        rows: Float[Array, "level row value"] | None = None,
        offset: Float[Array, "level own"] | None = None,
    ) -> tuple[Float[Array, " level"], Float[Array, "level row"]]:
        """Return residual sums, from the stored response or accumulated in the time loop."""
        groups, solution = self.groups, self.solution
        if solution is not None and solution.response is None:
            if rows is not None and solution.products is not None:
                return self._sums_by_products(theta, rows, offset, solution.products)
            if rows is None and offset is None:
                hidden = self._hidden(solution.peak)
                return jnp.where(hidden, jnp.nan, solution.square), solution.along
        rows = groups.directions if rows is None else rows
        is_summed = solution is None and self._is_summed(theta) and not has_further_modes(theta)
        if not is_summed or rows.shape[1] > MOST_ROWS:
            return super().residual_sums(theta, rows, offset)
        offset_from_origin = self._from_origin(theta, offset)

        def summed(level: tuple[HeldInput, Array, tuple[Array, ...]]) -> Sums:
            source, origin, rows = level
            # `origin` is empty if runs have no offsets.
            place = dict(zip(OFFSETS, origin, strict=False))
            joint = with_depth(oscillator_of({**theta, **place}, self.laws), self.depth)
            order = derivative_order(self.response)
            compared = Compared(*rows, order=order, first=self.skipped)
            source = source.times(theta["gain"])
            return residual_sums(joint, source, self.fs, self.substeps, compared)

        arrays = self.mean, groups.directions, offset_from_origin, rows
        sums = jax.lax.map(summed, (self.held, groups.origin, arrays))
        # The rounding errors of a very large motion hide the data.
        return jnp.where(self._hidden(sums.peak), jnp.nan, sums.square), sums.along

    def _from_origin(
        self, theta: Theta, offset: Float[Array, "level of_run"] | None
    ) -> Float[Array, "level own"]:
        away = jnp.zeros((len(self.groups.origin), self.groups.directions.shape[1]))
        if self.groups.origin.shape[1]:
            away = jnp.stack([theta[name] for name in OFFSETS]) - self.groups.origin
        return away if offset is None or not away.shape[1] else away + offset

    def _sums_by_products(
        self,
        theta: Theta,
        rows: Float[Array, "level row value"],
        offset: Float[Array, "level of_run"] | None,
        products: Float[Array, "level row"],
    ) -> tuple[Float[Array, " level"], Float[Array, "level row"]]:
        r"""Return residual sums, from stored scalar products of the response with given rows.

        $$Q_b = Q - 2 b^T s + b^T J J^T b, \qquad R r_b = R d - R m - R J^T (a + b)$$

        at the offsets b, from Q and s = J r without offsets, for parameters at a distance a from
        the point of linearisation.
        """
        directions = self.groups.directions
        square, along = self.residual_sums(theta)
        if offset is not None and directions.shape[1]:
            normal = jnp.einsum("liv,ljv->lij", directions, directions)
            moved = jnp.einsum("lij,lj->li", normal, offset)
            square = square + jnp.sum(offset * (moved - 2 * along), axis=1)
        measured = jnp.einsum("lrv,lv->lr", rows, self.mean)
        per_offset = jnp.einsum("lrv,liv->lri", rows, directions)
        explained = jnp.einsum("lri,li->lr", per_offset, self._from_origin(theta, offset))
        return square, measured - products - explained

    def solved(
        self,
        theta: Mapping[str, Float[np.ndarray, " point"]],
        threads: int,
        *,
        writes: bool,
        rows: Float[np.ndarray, "level row value"] | None = None,
    ) -> Self | None:
        """Return the records with predictions computed in advance at parameter points, or None.

        It cannot be used for periodic motion, nor for laws that the exact step does not support.
        The number of solver steps, which no longer matters, is reset.
        """
        if (models := self._models_of_levels(theta, range(len(self.groups.labels)))) is None:
            return None
        writes = writes or not self._is_summed(theta)
        away = np.zeros((len(self.groups.labels), len(theta["gain"]), 0))
        if self.groups.origin.shape[1]:
            here = np.stack([theta[name] for name in OFFSETS], axis=-1)
            away = here - np.asarray(self.groups.origin)[:, None]

        def level(number: int) -> Motions:
            own = None if rows is None or writes else rows[number]
            return self.marched(
                theta, number, models[number], known=away[number], rows=own, writes=writes
            )

        with ThreadPoolExecutor(threads) as pool:
            motions = list(pool.map(level, range(len(self.groups.labels))))
        num_directions = self.groups.directions.shape[1]
        of_levels = [motion.products for motion in motions if motion.products is not None]
        products = np.stack(of_levels, axis=1) if of_levels else None
        solution = Solution(
            jax.device_put(self._from_first([x.response for x in motions])) if writes else None,
            jax.device_put(np.stack([x.square for x in motions], axis=1)),
            jax.device_put(np.stack([x.along[:, :num_directions] for x in motions], axis=1)),
            jax.device_put(np.stack([x.peak for x in motions], axis=1)),
            jax.device_put(np.stack([x.y_peak for x in motions], axis=1)),
            None if products is None else jax.device_put(products),
        )
        return replace(self, laws=(), substeps=SUBSTEPS, depth=SIZE, solution=solution)

    def _from_first(self, rows: Sequence[Any]) -> Float[np.ndarray, "point level compared"]:
        return np.stack([row[:, self.skipped :] for row in rows], axis=1)

    def marched(
        self,
        theta: Mapping[str, Float[np.ndarray, " point"]],
        number: int,
        models: Model | None = None,
        *,
        known: Float[np.ndarray, "point own"] | None = None,
        rows: Float[np.ndarray, "row value"] | None = None,
        writes: bool,
    ) -> Motions:
        """Simulate one level at many parameter points, with omega_n and zeta of its run.

        Products with rows of compared values are included. If `models` are given, they are not
        built again. Residual terms are not included.
        """
        if models is None and (found := self._models_of_levels(theta, [number])) is not None:
            (models,) = found
        if models is None:
            raise TypeError(
                "Records that are periodic or of an unsuitable law cannot be simulated as a batch: "
                "simulate one parameter point at a time."
            )
        measured = None  # In a band, spectral lines are compared instead of samples.
        if self.lines is None:
            measured = MeasuredResponse(self.mean, self.groups.directions, self.skipped)
        record = record_of(self.held, number, measured)
        return march(
            models,
            theta["gain"] * float(np.asarray(self.held.gain)[number]),
            record._replace(rows=_behind(rows, self.skipped)),
            self.fs, self.substeps, derivative_order(self.response), known=known, writes=writes,
        )  # fmt: skip

    def is_marched(self, theta: Mapping[str, Float[np.ndarray, " point"]]) -> bool:
        """Return whether the batch solver can simulate these records."""
        return self._models_of_levels(theta, [0]) is not None

    def _models_of_levels(
        self, theta: Mapping[str, Float[np.ndarray, " point"]], numbers: Sequence[int]
    ) -> list[Model] | None:
        """Return several levels' models at parameter points, repeated to fill the batch.

        None is returned for periodic motion, and for laws that the batch solver cannot simulate.
        """
        if self.held.periodic:
            return None
        count, origin = len(numbers), np.asarray(self.groups.origin)[list(numbers)]
        every = {name: np.tile(values, count) for name, values in filled_up(dict(theta)).items()}
        lanes = len(every["gain"]) // count
        every |= {
            name: np.repeat(values, lanes)
            # `origin` has no columns if runs have no offsets.
            for name, values in zip(OFFSETS, origin.T, strict=False)
        }
        models = models_at(every, self.laws, depth=self.depth)
        if models is None or (self.depth is None and any(x.depth for x in laws_in(models.laws))):
            return None
        rows = jax.tree.map(lambda x: np.asarray(x).reshape(count, lanes, *x.shape[1:]), models)
        of_levels = [jax.tree.map(lambda x, i=i: x[i], rows) for i in range(count)]
        pairs = zip(numbers, of_levels, strict=True)
        return [self._seen_at_point(number, model) for number, model in pairs]

    def _seen_at_point(self, number: int, model: Model) -> Model:
        """Return the model; a structure has two outputs, the first point and the level's point."""
        if not isinstance(model, Structure):
            return model
        point = self.points[number] if self.points else ""
        row = 1 + self.modes.points.index(point) if point else 0
        return replace(model, c=np.asarray(model.c)[:, [0, row]])

    def _hidden(self, peak: Float[Array, " level"]) -> Bool[Array, " level"]:
        """Return a mask of levels whose predicted response far exceeds the measured response."""
        # The measured size is zero for planned levels, which have no measurement.
        size = jnp.max(jnp.abs(self.mean), axis=1)
        return (size > 0) & (peak > ABSURD * size)

    def _is_summed(self, theta: Mapping[str, Any]) -> bool:
        """Return whether the time loop can sum the residual; this needs time samples from rest."""
        plain = not (self.held.periodic or self.groups.is_complex or any(self.points))
        return plain and not self.groups.spanned.shape[1] and not taken(theta, self.residuals)

    def squares(self, theta: Theta) -> Float[Array, " level"]:
        r"""Return sums of squares of repeats, $Q = \sum_k |d_k - m|^2 = K\,|\bar d - m|^2 + S$."""
        square, _ = self.residual_sums(theta)
        return self.groups.num_repeats * square + self.groups.within

    def linearised(self, theta: Theta, offsets: Mapping[str, Float[np.ndarray, " own"]]) -> Self:
        """Return each level linearised about its run's omega_n and zeta, if these are known."""
        centre = np.array([float(theta[name]) for name in OFFSETS])
        origin = np.stack([centre + offsets.get(run, 0.0) for run in self.groups.runs])
        placed = replace(self, groups=changed(self.groups, origin=origin))
        slope = placed.slope_by_differences(theta)
        slope = _slope_at_origin(theta, alone(placed)) if slope is None else slope
        return replace(placed, groups=with_slope(placed.groups, slope))

    def slope_by_differences(self, theta: Theta) -> Float[np.ndarray, "level value own"] | None:
        r"""Return the response's derivatives with respect to omega_n and zeta of each level's run.

        $$x'(0) \approx \frac{8 (x(h) - x(-h)) - (x(2h) - x(-2h))}{12 h}$$

        It uses the program that fits them; derivatives through time would need another one. None is
        returned if that program does not support the laws. The error is 1e-8 of the derivative,
        because turning points fall into other solver steps on either side, the more so the longer
        the steps.
        """
        middle = dict.fromkeys(OFFSETS, 0.0) | {n: float(x) for n, x in theta.items()}
        steps = np.array([DIFFERENCE[name] * middle[name] for name in OFFSETS])
        away = np.kron(np.diag(steps), np.array([[1.0], [-1.0], [2.0], [-2.0]]))
        points = {name: np.full(len(away), value) for name, value in middle.items()}
        # parameters of every level at every step of the finite differences
        origin = np.asarray(self.groups.origin)[:, None] + away
        if not self.is_marched(points):
            return None
        rows, none = [], np.asarray(self.groups.origin)[:, :0]
        unmoved = replace(self, groups=changed(self.groups, origin=none))
        for number in range(len(self.groups.labels)):
            place = dict(zip(OFFSETS, origin[number].T, strict=True))
            rows.append(unmoved.marched({**points, **place}, number, writes=True).response)
        values = values_of(np.stack(rows)[..., self.skipped :], self.lines)
        sides = np.reshape(values, (len(rows), len(OFFSETS), 4, -1))
        ahead, behind, far, beyond = np.moveaxis(sides, 2, 0)
        slope = (8 * (ahead - behind) - (far - beyond)) / (12 * steps[:, None])
        return np.moveaxis(slope, 1, -1)

    def shown(self, omega_n: float = 1.0) -> Shown:
        """Return model-free estimates: an oscillator fitted to a peak, and the largest motion."""
        order = derivative_order(self.response)
        first_values, spectra = partial(_first_values, self), partial(_spectra, self)
        if self.modes is None:
            y_peak = float(np.max(np.abs(self.mean))) / omega_n**order
            return Shown(first_values, y_peak=y_peak, spectra=spectra)
        at_first_point = np.asarray(self.mean)[[not point for point in self.points]]
        if not len(at_first_point):
            return Shown(first_values, spectra=spectra)
        above = 0.5 * min(self.modes.hz), np.inf
        is_assembled = self.modes.meet == "assembled"
        bands = self.modes.regions_hz if is_assembled else self.modes.windows_hz
        peak, *peaks = (band_peak(at_first_point, self.fs, order, x) for x in (above, *bands))
        return Shown(first_values, y_peak=peak, peaks_of_modes=tuple(peaks), spectra=spectra)

    def statements(self, theta: Theta) -> list[str]:
        """Return sentences on motion with more load reversals than a law can remember."""
        return remembered.told(theta, self)


def _spectra(data: Records, residuals: Rows) -> dict[str, Spectrum]:
    """Return the spectrum of each level, from the samples, or from the lines of a band."""
    order, length, spectra = derivative_order(data.response), data.mean.shape[1], {}
    omega = 2 * np.pi * np.fft.rfftfreq(length, 1 / data.fs)
    for i, label in enumerate(data.groups.labels):
        mean, source = np.asarray(data.mean[i]), np.asarray(data.source[i, data.skipped :])
        if data.lines is None:
            spectra[label] = of_samples(
                mean, residuals[label], source, data.fs, order, periodic=data.held.periodic
            )
            continue
        band = slice(*data.lines)
        # The samples over time still contain the measured noise outside the band.
        rate = np.fft.irfft(1j * omega * np.fft.rfft(mean), length)
        late = None if data.held.periodic else np.arange(length) / data.fs * rate
        rows = (mean, source, 0.0 * mean if late is None else late)
        x, u, turned = (np.sqrt(2 / length) * np.fft.rfft(row)[band] for row in rows)
        spectra[label] = of_lines(
            x, residuals[label], omega[band], u, (1j * omega[band]) ** order,
            None if late is None else turned,
        )  # fmt: skip
    return spectra


def _first_values(data: Records) -> dict[str, float]:
    """Return starting values: an oscillator fitted near the spectral peak of the weakest level."""
    mean, source = np.asarray(data.mean), np.asarray(data.source[:, data.skipped :])
    if data.modes is not None:
        motions = zip(data.moved, data.points, source, mean, strict=True)
        order = derivative_order(data.response)
        readings = read_modes(data.modes, lines_of_motions(motions, data.fs, order))
        is_assembled = data.modes.meet == "assembled"
        return by_model(data.modes, readings) if is_assembled else readings
    level = int(np.argmin(np.mean(mean**2, axis=1)))
    omega = 2 * np.pi * np.fft.rfftfreq(mean.shape[1], 1 / data.fs)[1:]
    x, u = (np.fft.rfft(row[level])[1:] for row in (mean, source))
    y = x / (1j * omega) ** derivative_order(data.response)
    driven = np.abs(u) > 0.1 * np.abs(u).max()
    near = driven & (np.abs(x) > NEAR_PEAK * np.abs(x[driven]).max())
    return oscillator_through(omega[near], u[near], y[near])


def compile_beside(tests: Sequence[Test], laws: Laws) -> Thread | None:
    """Compile the batch solver of sweeps and decays in a separate thread; None if there are none.

    Everything before the first solve continues meanwhile. Laws with a stack of reversals need one
    program per depth, which is not known yet.
    """
    marched = [test for test in tests if test.kind in ("sweep", "decay") and not test.point]
    if not (marched and laws):
        return None
    order = derivative_order(marched[0].records[0].response)
    names = ("omega_n", "zeta", *(quantity.name for quantity in quantities_of(laws)))

    def compiled() -> None:
        # An error of this compilation occurs again, and is then reported, when the solver is used.
        with suppress(Exception):
            joints = joints_at(dict.fromkeys(names, np.ones(1)), laws)
            if joints is not None and not any(law.depth for law in joints.laws):
                compile_ahead(joints, order)

    thread = Thread(target=compiled, name=messages.COMPILING)
    thread.start()
    return thread


def _behind(
    rows: Float[np.ndarray, "row value"] | None, skipped: int
) -> Float[np.ndarray, "row time"] | None:
    """Put zeros before arrays of compared samples, so that they have the length of the record."""
    return None if rows is None else np.pad(rows, ((0, 0), (skipped, 0)))


@eqx.filter_jit
def _slope_at_origin(theta: Theta, data: Records) -> Float[Array, "level value own"]:
    """Return the response's derivatives with respect to omega_n and zeta of each run, by JAX."""

    def moved(offset: Float[Array, " own"]) -> Float[Array, "level value"]:
        groups = replace(data.groups, origin=data.groups.origin + offset)
        return data.compared(replace(data, groups=groups).predict(theta))

    return jax.jacfwd(moved)(jnp.zeros(len(OFFSETS)))
