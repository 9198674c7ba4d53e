"""Free decays of one mode in the likelihood; each record's initial state is integrated out.

These unknowns are an initial state (log amplitude and phase, flat priors), a noise, and a small
shift of the natural frequency, because structures are never exactly the same twice. The shifts
share one scatter.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float
from numpy.lib.stride_tricks import sliding_window_view

from jbw.inference.groups.offsets import Estimate
from jbw.kept_programs import KeptProgram
from jbw.measurement.channels import rms
from jbw.measurement.readings.statement import curve_of, in_steady_motion
from jbw.measurement.resonances import AmplitudeCurve
from jbw.observables.decay_drift import LeftOutDecay, left_out_decay
from jbw.observables.decay_envelopes import (
    Entry,
    Envelopes,
    Match,
    follow,
    match,
)
from jbw.observables.effective_values import white_square
from jbw.observables.groups import Rows, changed, weights, with_effective_values
from jbw.observables.observable import Shown, Theta, Weighted, alone
from jbw.observables.samples import joints_at
from jbw.oscillator.batch import LANES, march, released
from jbw.oscillator.hold import namespace
from jbw.oscillator.oscillator import Oscillator, oscillator_of
from jbw.oscillator.response import simulate
from jbw.quantities import LETTER_OF, derivative_order
from jbw.report.messages import observed as messages

# Length of a record's first section that determines its initial state, in units of 1 / (zeta
# omega_n).
BEGINNING = 0.3
LEAST_BEGUN = 8  # smallest number of envelope values in the first section of a record


class Decays(Envelopes):
    """The free decays of one mode, reduced to the form that the likelihood needs.

    `solution` contains the fits of the records to the simulated decay, where they were computed
    before.
    """

    dimension: ClassVar[str] = "record"
    informs: ClassVar[frozenset[str]] = frozenset({"omega_n", "zeta"})
    stepped: ClassVar[bool] = True
    own_shifts: ClassVar[bool] = True
    # A larger relative residual than this shows motion that the model does not have.
    most_misfit: ClassVar[float | None] = 0.05
    several: ClassVar[bool | None] = False
    unread: ClassVar[Mapping[str, Any]] = {"centre_hz": 0.0, "readings": None}

    solution: Match | None = eqx.field(kw_only=True, default=None)

    @property
    def fraction(self) -> Float[Array, ""]:
        """The fraction of a record's values that count as independent."""
        return jnp.max(jnp.asarray(self.groups.num_values / self.groups.num_counted))

    def matches(self, theta: Theta) -> Match:
        """Fit the initial state and the frequency shift of each record to the model's decay."""
        if self.solution is not None:
            return self.solution
        lengths = self.groups.size / 2
        return match(decay_of(theta, self)[None], self.mean, self.step_s, lengths)

    def solved(
        self,
        theta: Mapping[str, Float[np.ndarray, " point"]],
        threads: int,
        *,
        writes: bool,
        rows: Float[np.ndarray, "group row value"] | None = None,
    ) -> Self | None:
        """Compute the decay, and the fits of the records to it, at many points in advance."""
        matches = matches_at(theta, self)
        return replace(self, laws=(), num_samples=0, solution=jax.device_put(matches))

    def predict(self, theta: Theta) -> Complex[Array, "record step"]:
        """Predict each record's envelope with its optimal initial state and frequency shift."""
        return self.mean - self.matches(theta).residual

    def compared(self, values: Any) -> Float[Array, "record value"]:
        """Return envelopes as real numbers: real parts, imaginary parts, then 0 for the shift."""
        return jnp.pad(super().compared(values), ((0, 0), (0, 1)))

    def misfit(self, theta: Theta) -> Float[Array, "record value"]:
        """Return the residual of each envelope with its best-fitting initial state and shift."""
        return self.compared(self.matches(theta).residual)

    def weighted(self, theta: Theta) -> Weighted:
        """Return residuals in standard deviations; the last one belongs to the frequency shift."""
        matches = self.matches(theta)
        residual = self.compared(matches.residual) * weights(self.groups)[:, None]
        shift = matches.entry.shift[:, None] / self.shift_std
        rows = jnp.concatenate([residual[:, :-1], shift], axis=1)
        return jnp.where(self._says[:, None], rows, 0.0), self.groups.directions

    @property
    def _says(self) -> Bool[Array, " record"]:
        """Whether a record has more independent values than unknowns, as any fit requires."""
        return self.groups.num_values > self.groups.num_own

    @property
    def _degrees(self) -> Float[Array, " record"]:
        """The independent values of a record minus its unknowns, at least 1."""
        values = self.groups.num_values
        return namespace(values).where(self._says, values - self.groups.num_own, 1.0)

    def estimate(self, theta: Theta, num_offsets: int) -> Estimate:
        r"""Estimate each record's shift of natural frequency, which is the first offset of its run.

        $$\log p_i = -\frac{n - 3}{2} \log Q_i - \frac12 \log |A_i| - \log e_i$$

        where Q is the residual at the best initial state and shift, A their normal matrix, n the
        number of independent real values, and e the shift's standard error: eq. (37) on the
        envelope, with its noise integrated out under 1/sigma. Q is nearly quadratic in the three
        unknowns. A record that does not count gives no estimate.
        """
        matches = self.matches(theta)
        _, log_det = jnp.linalg.slogdet(matches.precision)
        error = self.shift_errors(matches)
        log_density = -self._degrees / 2 * jnp.log(matches.misfit) - 0.5 * log_det - jnp.log(error)
        first = jnp.eye(max(num_offsets, 1))[0]
        counted = jnp.where(self._says, 1.0, 0.0)
        precision = jnp.outer(first, first) * (counted / error**2)[:, None, None]
        return Estimate(counted * log_density, matches.entry.shift[:, None] * first, precision)

    def shift_errors(self, found: Match) -> Float[Array, " record"]:
        """Return the standard error of every record's natural-frequency shift [rad/s]."""
        xp = namespace(found.misfit)
        variance = found.misfit / self._degrees
        return xp.sqrt(variance * xp.linalg.inv(found.precision)[:, -1, -1])

    def with_fitted_noise(self, theta: Theta, residuals: Rows) -> Self:
        """Return the decays with noise and frequency variation from the residuals of a fit."""
        matches, groups = jax.tree.map(np.asarray, (matched(theta, self), self.groups))
        noise = np.sqrt(matches.misfit / (groups.size - groups.num_own))
        errors = replace(self, groups=groups).shift_errors(matches)
        scatter = max(rms(matches.entry.shift), rms(errors))
        changes = jax.device_put((noise, np.float64(scatter)))
        return replace(
            self, groups=changed(self.groups, noise_std=changes[0]), shift_std=changes[1]
        )

    def shown(self, omega_n: float = 1.0) -> Shown:
        """Return model-free estimates of the decays: frequency, damping, initial amplitude."""
        over = omega_n ** derivative_order(self.response)
        begins = (np.abs(np.asarray(self.mean)[:, 0]) / over).tolist()
        curve = partial(amplitude_curve, self)
        return Shown(
            partial(first_values, self),
            amplitude_curve=curve,
            amplitude_readings=curve,
            y_peak=float(self.y_read),
            begins=dict(zip(self.groups.labels, begins, strict=True)),
        )

    def only(self, record: int, size: int) -> Self:
        """Return one record as a dataset part, cut to its first `size` values."""
        return replace(self, **self.values_of(record, size))

    def values_of(self, record: int, size: int) -> dict[str, Any]:
        """Return the fields of one record, cut to its first `size` values."""
        at, values = slice(record, record + 1), 2.0 * size
        groups = jax.tree.map(lambda column: column[at], self.groups)
        names = {"labels": groups.labels[at], "runs": groups.runs[at], "units": groups.units[at]}
        groups = replace(
            groups,
            **names,
            size=jnp.full(1, values),
            num_values=groups.num_values / groups.size * values,
            directions=groups.directions[..., : 2 * size + 1],
            spanned=groups.spanned[..., : 2 * size + 1],
        )
        return {"mean": self.mean[at, :size], "groups": groups}

    def statements(self, theta: Theta) -> list[str]:
        """Return sentences on frequencies of records, and on independent residual values."""
        shift = np.asarray(matched(theta, self).entry.shift)
        scatter = float(np.sqrt(np.mean(shift**2))) / (2 * np.pi)
        return [
            messages.frequencies_scatter(len(self.groups.labels), scatter),
            messages.correlated(float(self.fraction)),
        ]


def first_values(data: Decays) -> dict[str, float]:
    """Return starting values: omega_n and zeta extrapolated linearly to zero amplitude."""
    return dict(zip(("omega_n", "zeta"), at_rest(amplitude_curve(data)), strict=True))


def amplitude_curve(data: Decays) -> AmplitudeCurve:
    """Return frequency and damping of a steady motion against amplitude, from every record."""
    tables = [reading.table() for reading in data.readings() if reading is not None]
    return curve_of([in_steady_motion(table) for table in tables])


def counting[Data: Decays](data: Data, fraction: float) -> Data:
    """Return the decays with a given fraction of their values counted as independent."""
    fractions = dict.fromkeys(data.groups.labels, fraction)
    return replace(data, groups=with_effective_values(fractions, data.groups))


def at_rest(curve: AmplitudeCurve) -> tuple[float, float]:
    """Return the curve's frequency [rad/s] and damping, extrapolated linearly to zero amplitude."""
    y, omega, zeta = curve[:3]
    most = float(np.abs(zeta.max()))
    least = np.clip(np.polyfit(y, zeta, 1)[1], 0.1 * most, most)
    return float(np.polyfit(y, omega, 1)[1]), float(least)


def decay_of(theta: Theta, data: Envelopes) -> Complex[Array, " step"]:
    """Return the model's free decay after the band's filter, as the logarithm log |X| + j arg X.

    The steps are `step_s` apart and the phase is unwrapped. The decay follows eqs. (1), (2) with u
    = 0, from rest at its greatest displacement, with the memory on the steady loop of that
    amplitude.
    """
    joint = oscillator_of(theta, data.laws)
    if not data.laws:
        return _logarithm(_exponential(joint, data), data)
    start = (data.y_start, jnp.zeros(()), joint.at_tip(data.y_start))
    silence = jnp.zeros(data.num_samples)
    free = simulate(joint, silence, data.fs, hold="zero", initial=start, substeps=data.substeps)
    kernel = jnp.stack([data.taps.real, data.taps.imag])[:, None, :]
    x = getattr(free, LETTER_OF[data.response])[None, None, :]
    parts = jax.lax.conv_general_dilated(x, kernel, (data.stride,), "VALID")[0]
    return _logarithm(jax.lax.complex(parts[0], parts[1]), data)


@KeptProgram
def _decays_of(
    theta: Mapping[str, Float[Array, " point"]], data: Envelopes
) -> Complex[Array, "point step"]:
    return jax.vmap(lambda point: decay_of(point, data))(dict(theta))


def decays_at(
    theta: Mapping[str, Float[np.ndarray, " point"]], data: Envelopes
) -> Complex[np.ndarray, "point step"]:
    """Return `decay_of` at many parameter points, by the batch solver if it suits the laws.

    The batch solver's program is that of swept records, and the same for records of any length.
    """
    joints = joints_at(theta, data.laws) if data.laws else None
    if joints is None:
        simulated = replace(data, mean=None, groups=None, **data.unread)
        return np.asarray(_decays_of(jax.device_put(dict(theta)), simulated))
    count = len(next(iter(theta.values())))
    record = released(float(data.y_start), data.num_samples)
    order = derivative_order(data.response)
    lots = [
        march(
            jax.tree.map(lambda leaf, lot=lot: leaf[lot], joints), np.zeros(LANES), record,
            data.fs, data.substeps, order,
        ).response
        for lot in (slice(first, first + LANES) for first in range(0, count, LANES))
    ]  # fmt: skip
    taps = np.asarray(data.taps)
    windows = sliding_window_view(np.concatenate(lots)[:count], len(taps), axis=1)
    return _logarithm(windows[:, :: data.stride] @ taps, data)


def _exponential(joint: Oscillator, data: Envelopes) -> Complex[Array, " step"]:
    r"""Return the filtered decay of a structure without a joint, in closed form.

    $$X_k = \sum_{\pm} a_\pm s_\pm^d H(\lambda_\pm) \lambda_\pm^{k S}, \qquad
      s_\pm = \omega_n (-\zeta \pm \sqrt{\zeta^2 - 1}), \quad \lambda = e^{s / f_s}, \quad
      H(\lambda) = \sum_m h_m \lambda^m$$

    with the taps h, the stride S, the order d of the response's derivative, and $a_\pm$ of a motion
    that begins at rest at `y_start`.
    """
    root = jnp.sqrt(jax.lax.complex(joint.zeta**2 - 1.0, jnp.zeros(())))
    s = joint.omega_n * (jnp.stack([root, -root]) - joint.zeta)
    begun = data.y_start * s[::-1] / (s[::-1] - s) * s ** derivative_order(data.response)
    filtered = jnp.exp(s[:, None] * jnp.arange(len(data.taps)) / data.fs) @ data.taps
    steps = (data.num_samples - len(data.taps)) // data.stride + 1
    course = jnp.exp((jnp.arange(steps) * data.stride)[:, None] * s / data.fs)
    return course @ (begun * filtered)


def _logarithm(
    envelope: Complex[Any, "*point step"], data: Envelopes
) -> Complex[Any, "*point step"]:
    """Return the logarithm of an envelope with its phase unwrapped."""
    xp = namespace(envelope)
    turns = envelope[..., 1:] * xp.conj(envelope[..., :-1]) * xp.asarray(data.rotation)
    phase = xp.cumsum(xp.angle(turns), axis=-1)
    phase = xp.concatenate([xp.zeros_like(phase[..., :1]), phase], axis=-1)
    return xp.log(xp.abs(envelope)) + 1j * phase


def matches_at(theta: Mapping[str, Float[np.ndarray, " point"]], data: Decays) -> Match:
    """Fit each record's initial state and shift at many parameter points, by NumPy.

    Where the motion diverges, the results are not finite.
    """
    with np.errstate(all="ignore"):
        decays, envelope = decays_at(theta, data)[:, None], np.asarray(data.mean)
        return match(decays, envelope, data.step_s, np.array(data.lengths))


def matched(theta: Theta, data: Decays) -> Match:
    """Fit each record's initial state and shift at one parameter point."""
    if data.modes is not None:
        return _matched(theta, alone(data))
    with np.errstate(all="ignore"):
        decay, envelope = _decay_at(theta, data)[None], np.asarray(data.mean)
        return match(decay, envelope, data.step_s, np.array(data.lengths))


def _decay_at(theta: Theta, data: Decays) -> Complex[np.ndarray, " step"]:
    """Return `decay_of` at one parameter point, by the programs that serve fits."""
    point = {name: np.full(LANES, float(value)) for name, value in theta.items()}
    return decays_at(point, data)[0]


@eqx.filter_jit
def _matched(theta: Theta, data: Decays) -> Match:
    return data.matches(theta)


class Beginning(NamedTuple):
    """The initial state of a record, estimated from its start alone, with its covariance.

    The covariance is of log amplitude, phase and shift; `rate` is the change of the log amplitude
    by the place. Each row belongs to another simulated decay.
    """

    entry: Entry
    covariance: Float[np.ndarray, "*decay own own"]
    rate: Float[np.ndarray, "*decay"]

    def moved(self, change: Float[np.ndarray, "*decay own"]) -> Entry:
        """Return the initial state after changes of log amplitude, phase and frequency shift."""
        of_size, of_phase, of_shift = np.moveaxis(change, -1, 0)
        place, phase, shift = self.entry
        return Entry(place + of_size / self.rate, phase + of_phase, shift + of_shift)


def begun(
    decay: Complex[np.ndarray, "*decay step"],
    envelope: Complex[np.ndarray, " value"],
    noise_std: float,
    data: Decays,
    law_std: float = 0.0,
) -> Beginning:
    r"""Estimate the initial state and the frequency shift of a record from its start alone.

    A beginning shows the shift s of the record's natural frequency together with the error d of the
    law's frequency at that amplitude, $s \sim N(0, S^2)$ and $d \sim N(0, \tau^2)$. Of their sum
    only the share $S^2 / (S^2 + \tau^2)$ continues after the beginning, where the phase is
    continuous.

    Args:
        decay: Logarithm of the joint's decay at every step, for one decay or for many.
        envelope: The beginning of the record.
        noise_std: Noise of the real part, and of the imaginary part.
        data: The decays, with the scatter S of shifts.
        law_std: Standard deviation tau of the law's frequency error [rad/s].
    """
    found = match(decay, envelope, data.step_s)
    # A short section hardly determines the noise, so the noise of the fitted records is used.
    precision = found.precision * (float(data.fraction) / noise_std**2)
    # If the section is too short to determine the shift, the shift's prior determines it.
    shift_variance = float(data.shift_std) ** 2
    variance = shift_variance + law_std**2
    both = np.linalg.inv(precision + np.diag([0.0, 0.0, 1.0 / variance]))
    total = found.entry.shift * (1 - both[..., 2, 2] / variance)
    centre = -both[..., 2] * (found.entry.shift / variance)[..., None]
    share, length_s = shift_variance / variance, float(data.step_s) * len(envelope)
    kept = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, (1 - share) * length_s], [0.0, 0.0, share]])
    own = np.array([0.0, -length_s, 1.0])
    covariance = kept @ both @ kept.T + shift_variance * (1 - share) * np.outer(own, own)
    beginning = Beginning(found.entry, covariance, found.rate)
    return beginning._replace(entry=beginning.moved(centre - (1 - share) * total[..., None] * own))


def num_begun(theta: Mapping[str, Any], data: Decays) -> int:
    """Return how many values of a record lie in its first 0.3 / (zeta omega_n) seconds."""
    rate = float(np.mean(theta["zeta"] * theta["omega_n"]))
    half = min(data.lengths) // 2
    num_values = BEGINNING / (rate * data.step_s) if rate > 0 else half
    return int(min(max(num_values, LEAST_BEGUN), half))


def drift_from_beginning(theta: Theta, data: Decays, run: str) -> LeftOutDecay:
    """Return the drift of a record from the prediction that starts from the record's beginning.

    Its noise is that of the other records, as for a record that no fit has seen, or the white part
    of its own residual if that is larger.
    """
    record, size = data.groups.labels.index(run), num_begun(theta, data)
    noise = np.asarray(data.groups.noise_std)
    decay = _decay_at(theta, data)
    measured = np.asarray(data.mean[record])[: data.lengths[record]]
    own = match(decay, measured, data.step_s).residual
    others = np.delete(noise, record)
    usual = float(np.median(others)) if len(others) else float(noise[record])
    noise_std = max(usual, np.sqrt(white_square(own) / 2))
    beginning = begun(decay, measured[:size], float(noise_std), data)
    steps = np.arange(len(measured), dtype=float)
    expected, _ = follow(decay, beginning.entry, steps, data.step_s)
    error, _, shift_error = np.sqrt(np.diag(beginning.covariance)).tolist()
    time = data.step_s * (steps - 0.5 * size)
    return left_out_decay(
        measured[size:], expected[size:], time[size:], (error, shift_error), noise_std,
        float(data.fraction),
    )  # fmt: skip
