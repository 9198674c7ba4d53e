r"""Free decays of several modes that move one joint; each initial state is integrated out.

Two modes that ring together do not follow one decay curve, as a single mode does: the slip in
either depends on both. Therefore every record is simulated from its own start, a displacement and a
velocity of every mode, $q_i(0)$ and $\dot q_i(0)$. It is compared in a band that contains all
modes, as the complex envelope about the band's centre: the filter removes all other ringing, and
leaves as few values as the band has degrees of freedom. The start has flat priors. Each record also
has a small shift of its natural frequencies, all in proportion, because structures are never
exactly the same twice. The shifts share one scatter.

For any parameters the best start is found by Gauss-Newton, from the start that the modes' own
envelopes show. Parameters change only the rest of the residual, with Q a basis of the changes by
the start,

$$r = (1 - Q Q^T)\,(X - \hat X(\theta, s)), \qquad J = \hat X_s = Q R$$

which at the best s is the residual of least squares with the correct derivative of its size; the
change of Q itself is neglected.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jbw.errors import ConfigError
from jbw.measurement.channels import lines_within, whole_up
from jbw.measurement.envelopes import bands_of
from jbw.measurement.records import Test
from jbw.observables.decay import Decays, amplitude_curve, first_values, matched
from jbw.observables.groups import Rows, changed
from jbw.observables.modal_starts import starts_of
from jbw.observables.modes import Modes
from jbw.observables.observable import Laws, Shown, Theta
from jbw.oscillator.law import Memory
from jbw.oscillator.modes.parameters import structure_of
from jbw.oscillator.modes.response import remainder_of
from jbw.oscillator.modes.structure import Memories, Structure, by_joint
from jbw.oscillator.response import simulate
from jbw.quantities import DEFAULT_LAWS, LETTER_OF, OSCILLATOR
from jbw.report.messages import observed as messages

# solver steps per period of the highest mode; with fewer, reversals within a step are missed
STEPS_A_PERIOD = 20.0
STEP = 1e-6  # step of finite differences, relative to a mode's amplitude; rounding is 1e-10
# number of Gauss-Newton steps for a record's initial state before a last step; each step needs one
# simulation
NUM_STEPS = 2
TINY = np.finfo(float).tiny
# fraction of a Gauss-Newton step that is tried if the whole step increases the residual
SHORTER = 0.25
FIRST = tuple(quantity.name for quantity in OSCILLATOR)


class Start(NamedTuple):
    """The unknowns of a record: initial q_i, q_i' / omega_i [m], and a frequency shift [rad/s]."""

    state: Float[Array, "*record coordinate"]
    shift: Float[Array, "*record"]


class Matched(NamedTuple):
    """A record fitted by least squares, with the sum of squares of its residual.

    `precision` is the normal matrix of the state and the shift, for noise of unit variance.
    """

    entry: Start
    misfit: Float[Array, "*record"]
    residual: Complex[Array, "*record step"]
    precision: Float[Array, "*record own own"]


class ModalDecays(Decays):
    """The free decays of several modes, reduced to the form that the likelihood needs.

    Attributes:
        begun: Own unknowns of each record, as in `Start`, from which the search for the best
            begins.
        amplitude: Amplitudes of each record's modes at its beginning, as displacements [m].
        alone: Decays of each mode alone, with the other modes filtered out.
        bands_hz: Bands of these single-mode decays [Hz].
    """

    several: ClassVar[bool | None] = True
    unread: ClassVar[Mapping[str, Any]] = {**Decays.unread, "alone": (), "bands_hz": ()}

    begun: Float[Array, "record own"]
    amplitude: Float[Array, "record mode"]
    alone: tuple[Decays, ...]
    bands_hz: tuple[tuple[float, float], ...] = eqx.field(static=True)

    @classmethod
    def reduce(
        cls,
        tests: Sequence[Test],
        *,
        laws: Laws = DEFAULT_LAWS,
        substeps: int | None = None,
        modes: Modes | None = None,
    ) -> tuple[Self, ...]:
        """Return each test's decay envelopes in a band with all modes of the structure."""
        return tuple(cls.of(test, laws=laws, substeps=substeps, modes=modes) for test in tests)

    @classmethod
    def of(
        cls,
        test: Test,
        *,
        laws: Laws = DEFAULT_LAWS,
        substeps: int | None = None,
        modes: Modes | None = None,
    ) -> Self:
        """Build a test's envelopes after `settle`, with a guess of the noise."""
        if modes is None:
            raise ConfigError("Argument `modes` must name the modes of the structure, but is None.")
        mode_tests = [replace(test, band_hz=band) for band in bands_of(modes.hz, test)]
        starts = np.stack([starts_of(mode_test) for mode_test in mode_tests], axis=1)
        state = np.concatenate(
            [np.real(starts), np.imag(starts), np.zeros((len(starts), 1))], axis=1
        )
        decays = Decays.of(test, laws=laws, substeps=1)
        attributes = {field.name: getattr(decays, field.name) for field in fields(decays)}
        highest = max(modes.hz)
        attributes |= {
            "y_start": jnp.asarray(np.abs(starts).sum(axis=1).max()),
            "num_samples": (decays.mean.shape[1] - 1) * decays.stride + len(decays.taps),
            "substeps": substeps or whole_up(STEPS_A_PERIOD * highest / decays.fs),
            "modes": modes,
            "groups": changed(decays.groups, num_own=state.shape[1]),
        }
        return cls(
            **attributes,
            begun=jnp.asarray(state),
            amplitude=jnp.asarray(np.abs(starts)),
            alone=tuple(Decays.of(mode_test, laws=laws) for mode_test in mode_tests),
            bands_hz=tuple(bands_of(modes.hz, test)),
        )

    def solved(self, *points: Any, **asked: Any) -> None:
        """Return None, because nothing can be computed in advance for decays of several modes."""

    def matches(self, theta: Theta) -> Any:
        """Fit the initial state of each record in turn; stack the results along one axis."""
        structure = structure_of(theta, self.laws)
        lengths = self.groups.size / 2
        records = MatchedEnvelopes(self.mean, self.begun, self.amplitude, lengths)
        return jax.lax.map(lambda seen: match(structure, seen, self), records)

    def only(self, record: int, size: int) -> Self:
        """Return one record alone, cut to the section that determines its initial state."""
        values = self.values_of(record, size)
        num_samples = (values["mean"].shape[1] - 1) * self.stride + len(self.taps)
        return replace(self, **values, num_samples=num_samples)

    def values_of(self, record: int, size: int) -> dict[str, Any]:
        """Return one record's fields, with its initial state and modal amplitudes."""
        record_slice = slice(record, record + 1)
        beginnings = {"begun": self.begun[record_slice], "amplitude": self.amplitude[record_slice]}
        return super().values_of(record, size) | beginnings

    def with_fitted_noise(self, theta: Theta, residuals: Rows) -> Self:
        """Return the decays with noise and initial state of each record, from a fit."""
        start: Start = matched(theta, self).entry  # pyright: ignore[reportAssignmentType]
        begun = jnp.concatenate([start.state, start.shift[:, None]], axis=1)
        return replace(super().with_fitted_noise(theta, residuals), begun=begun)

    def shown(self, omega_n: float = 1.0) -> Shown:
        """Return model-free estimates of every mode, and the amplitude curve of the first mode."""
        curve = partial(amplitude_curve, self.alone[0])
        peaks = tuple(np.max(np.asarray(self.amplitude), axis=0).tolist())
        values = partial(_first_values, self)
        return (
            super()
            .shown(omega_n)
            ._replace(
                first_values=values,
                amplitude_curve=curve,
                amplitude_readings=curve,
                y_peak=float(self.y_start),
                peaks_of_modes=peaks,
            )
        )

    def statements(self, theta: Theta) -> list[str]:
        """Return sentences on the residual near each mode, and on the decays."""
        residual = np.asarray(matched(theta, self).residual)
        errors = " and ".join(
            f"{error:.2g} near {hz:.4g} Hz"
            for hz, error in zip(self.modes.hz, errors_by_mode(residual, self), strict=True)
        )
        return [
            messages.left_of_motion(errors),
            *super().statements(theta),
        ]


def _first_values(data: ModalDecays) -> dict[str, float]:
    """Return starting values of omega_n and zeta of every mode, at zero amplitude."""
    values: dict[str, float] = {}
    others = data.modes.names if data.modes is not None else ()
    for decays, (omega, zeta, *_) in zip(data.alone, (FIRST, *others), strict=True):
        values |= dict(zip((omega, zeta), first_values(decays).values(), strict=True))
    return values


class MatchedEnvelopes(NamedTuple):
    """The fitted envelopes, with each record's initial state, modal amplitudes and length."""

    envelope: Complex[Array, "*record step"]
    begun: Float[Array, "*record own"]
    amplitude: Float[Array, "*record mode"]
    length: Float[Array, "*record"]


def memory_at(structure: Structure, q: Array, v: Array) -> Memories:
    r"""Return the laws' internal states on their steady loops, at the joints' present amplitudes.

    $$X = \sum_i |h_i| \sqrt{q_i^2 + (\dot q_i/\omega_i)^2}, \qquad x = \sum_i h_i q_i$$

    for every joint, on the unloading branch from X or the loading branch from -X, as x moves.
    """
    whole = by_joint(structure)
    h = jnp.asarray(whole.h)
    omega_n = jnp.maximum(jnp.asarray(structure.omega_n), TINY)  # a rigid-body mode has omega_n = 0
    sizes, x, moves = jnp.abs(h) @ jnp.hypot(q, v / omega_n), h @ q, h @ v

    def of_law(law: Any, size: Array, x: Array, moves: Array) -> Memory:
        tip = law.at_tip(size)
        falling = law.move(size, tip, x - size)
        rising = law.move(-size, law.move(size, tip, -2.0 * size), x + size)
        return jax.tree.map(lambda up, down: jnp.where(moves > 0, up, down), rising, falling)

    memories = tuple(
        tuple(of_law(law, sizes[j], x[j], moves[j]) for law in laws)
        for j, laws in enumerate(joint_laws(whole))
    )
    return memories if jnp.ndim(structure.h) == 2 else memories[0]


def joint_laws(structure: Structure) -> tuple[tuple[Any, ...], ...]:
    """Return the laws of every joint of a structure that has an axis of joints."""
    return structure.laws  # pyright: ignore[reportReturnType]


def held_by_joints(structure: Structure, q: Array, v: Array) -> Float[Array, " mode"]:
    r"""Return each mode's static position under joint forces, $-\sum_j p_{ij} r_j / \omega_i^2$."""
    h, p, omega_n = (jnp.asarray(x) for x in (structure.h, structure.p, structure.omega_n))
    x, moves, memories = h @ q, h @ v, memory_at(structure, q, v)
    joints = zip(joint_laws(structure), x, moves, memories, strict=True)
    r = jnp.stack([remainder_of(*joint) for joint in joints])
    is_held = omega_n > 0
    return jnp.where(is_held, -(p @ r) / jnp.where(is_held, omega_n, 1.0) ** 2, 0.0)


def modal_envelopes(
    structure: Structure, own: Float[Array, " own"], data: ModalDecays
) -> Complex[Array, "mode step"]:
    r"""Return each mode's part of an envelope, from a record's initial state and frequency shift.

    Modes other than those of the decays do not ring: they begin at their static position under the
    joints' forces, $q_i = -\sum_j p_{ij} r_j / \omega_i^2$; their motion is counted with the first
    mode.
    """
    num_ringing, c = len(data.modes.hz), jnp.asarray(structure.c)
    y, over = jnp.split(own[:-1], 2)
    rest = jnp.zeros(c.size - num_ringing)
    q = jnp.concatenate([y / c[:num_ringing], rest])
    rate = 2 * np.pi * jnp.asarray(data.modes.hz) * over
    v = jnp.concatenate([rate / c[:num_ringing], rest])
    if rest.size:
        q = q.at[num_ringing:].set(held_by_joints(structure, q, v)[num_ringing:])
    start = (q, v, memory_at(structure, q, v))
    seen = jnp.diag(c)[:num_ringing].at[0, num_ringing:].set(c[num_ringing:])
    per_mode = replace(structure, c=seen)
    silence = jnp.zeros(data.num_samples)
    free = simulate(per_mode, silence, data.fs, hold="zero", initial=start, substeps=data.substeps)
    kernel = jnp.stack([data.taps.real, data.taps.imag])[:, None, :]
    x = getattr(free, LETTER_OF[data.response])[:, None, :]
    parts = jax.lax.conv_general_dilated(x, kernel, (data.stride,), "VALID")
    length = parts.shape[-1]
    turned = data.rotation ** jnp.arange(length) * jnp.exp(1j * own[-1] * _turns(length, data))
    return jax.lax.complex(parts[:, 0], parts[:, 1]) * turned


def _turns(length: int, data: ModalDecays) -> Float[Array, "mode step"]:
    """Return the change of each mode's phase per unit of the first mode's frequency shift [s]."""
    hz = jnp.asarray(data.modes.hz)
    return hz[:, None] / hz[0] * data.step_s * jnp.arange(length)


def match(structure: Structure, seen: MatchedEnvelopes, data: ModalDecays) -> Matched:
    """Fit the initial state of a record by Gauss-Newton, with derivatives at the first guess."""
    still, scale = jax.tree.map(jax.lax.stop_gradient, structure), _units(seen, data)
    num, length = len(scale), len(seen.envelope)
    ahead = jnp.concatenate([jnp.zeros((1, num)), STEP * jnp.diag(scale)[:-1]])
    perturbed_envelopes = jax.vmap(lambda start: modal_envelopes(still, start, data))(
        seen.begun + ahead
    )
    here, *perturbed = perturbed_envelopes.sum(axis=1)
    by_shift = scale[-1] * jnp.sum(1j * _turns(length, data) * perturbed_envelopes[0], axis=0)
    changes = jnp.concatenate([(jnp.stack(perturbed) - here) / STEP, by_shift[None]])
    measured = jnp.arange(length) < seen.length
    changes = jnp.where(measured, changes, 0.0)
    normal = (jnp.conj(changes) @ changes.T).real

    def deviation_of(structure: Structure, start: Float[Array, " own"]) -> Complex[Array, " step"]:
        deviation = seen.envelope - modal_envelopes(structure, start, data).sum(axis=0)
        return jnp.where(measured, deviation, 0.0)

    def step(deviation: Complex[Array, " step"]) -> Float[Array, " own"]:
        return jnp.linalg.solve(normal, (jnp.conj(changes) @ deviation).real)

    def onward(carry: tuple[Array, Array, Array], _: None) -> tuple[Any, None]:
        start, least, move = carry
        deviation = deviation_of(still, start + scale * move)
        better = _square(deviation) < least  # A NaN gives False.
        start = jnp.where(better, start + scale * move, start)
        move = jnp.where(better, step(deviation), SHORTER * move)
        return (start, jnp.where(better, _square(deviation), least), move), None

    deviation = jnp.where(measured, seen.envelope - here, 0.0)
    begun = (seen.begun, _square(deviation), step(deviation))
    (start, _, move), _ = jax.lax.scan(onward, begun, None, length=NUM_STEPS)
    start = jax.lax.stop_gradient(start + scale * move)
    changes, normal = jax.lax.stop_gradient((changes, normal))
    deviation = deviation_of(structure, start)
    last = step(deviation)
    residual = deviation - last @ changes
    start = start + scale * last
    precision = normal / jnp.outer(scale, scale)
    return Matched(Start(start[:-1], start[-1]), _square(residual), residual, precision)


def _units(seen: MatchedEnvelopes, data: ModalDecays) -> Float[Array, " own"]:
    """Return scales of the unknowns: modal amplitudes, and a shift of 1 rad per record [rad/s]."""
    radian = 1 / (data.step_s * jnp.full(1, len(seen.envelope)))
    return jnp.concatenate([seen.amplitude, seen.amplitude, radian])


def _square(residual: Complex[Array, " step"]) -> Float[Array, ""]:
    return jnp.sum(jnp.square(residual.real) + jnp.square(residual.imag))


def errors_by_mode(residual: Complex[np.ndarray, "record step"], data: ModalDecays) -> list[float]:
    """Return the relative residual near each mode, from the spectra of the envelopes."""
    hz = data.centre_hz + np.fft.fftfreq(residual.shape[1], data.step_s)
    lines, measured_lines = (np.fft.fft(np.asarray(rows)) for rows in (residual, data.mean))
    mode_lines = [lines_within(hz, band) for band in data.bands_hz]
    return [
        float(np.linalg.norm(lines[:, k]) / np.linalg.norm(measured_lines[:, k]))
        for k in mode_lines
    ]
