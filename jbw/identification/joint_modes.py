r"""Modes of a structure with several joints, up to the largest measured motion, for every draw.

A single mode at an amplitude a of its own coordinate, with the mode shape of fully stuck joints,
moves joint j by $|H_{ji}|a$. There the joint's steady loop reduces the mode's stiffness and adds to
its losses

$$K_{ji} = H_{ji}^2\,\big(k_j - \mathrm{Re}\,\kappa_j(|H_{ji}|a)\big), \qquad
  L_{ji} = H_{ji}^2\,\mathrm{Im}\,\kappa_j(|H_{ji}|a)$$

with $\kappa_j$ the complex stiffness of its laws and $k_j$ their stiffness at rest; where shapes
are uncertain, $H_{ji}$ is that of each draw. Joints that slip change the shape, and so move
further: the extended periodic motion of Krack (2015) at frequency $\omega$, with harmonics n, has

$$K_{ji} = -\frac{\sum_n \mathrm{Re}\,r_{jn}\bar X_{jn}}{\sum_{in} n^2|q_{in}|^2}, \qquad
  L_{ji} = \frac{\sum_n n\,\mathrm{Im}\,r_{jn}\bar X_{jn}}{\sum_{in} n^2|q_{in}|^2}$$

so that $L_{ji}/2\omega^2$ is the loss per cycle over $4\pi$ times the energy, which is twice the
mean kinetic energy. The numbers of all draws are those of the fully stuck shape times the ratio of
free to stuck shape. This ratio is computed at a few draws, and is linear in the logarithms of the
parameters between them.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Bool, Float, Int

from jbw.identification.assembled import ASSEMBLED, largest_amplitudes
from jbw.inference.posterior.summary import evenly_spaced
from jbw.observables.dataset import Dataset, as_arrays
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.modes.assembled import STIFFNESS, laws_at, motion_in
from jbw.oscillator.modes.backbone import ModalBackbone, modal_backbone
from jbw.oscillator.modes.parameters import DRIVEN, structure_of
from jbw.oscillator.steady.waveform import orders
from jbw.quantities import joints_of, motion_factors_in, name_at

# amplitudes of a mode, relative to its largest measured amplitude
LEVELS = np.linspace(0.0, 1.0, 9)[1:]
# number of odd harmonics; the errors are then 1e-6 of frequency, and 1e-4 of damping at small slip
NUM_HARMONICS = 3
MAX_TURNS = 2  # largest number of turning points of a joint in a period
NUM_FREE = 48  # smallest number of posterior draws that give mode shapes against amplitude
# smallest number of posterior draws per parameter that give mode shapes against amplitude
SPARE = 3
# names of the parameters of fully stuck modes
STUCK_NAMES = frozenset(name for pair in DRIVEN for name in pair)


class ModeNumbers(NamedTuple):
    """Frequency, damping and contributions of joints, by mode, amplitude and draw.

    Attributes:
        omega: Natural frequency [rad/s].
        zeta: Equivalent damping ratio [-].
        softening: Stiffness loss K due to every joint [1/s^2].
        losses: Losses L due to every joint [1/s^2].
        energy: Share of every joint in the strain energy [-].
    """

    omega: Float[np.ndarray, "mode level *draw"]
    zeta: Float[np.ndarray, "mode level *draw"]
    softening: Float[np.ndarray, "joint mode level *draw"]
    losses: Float[np.ndarray, "joint mode level *draw"]
    energy: Float[np.ndarray, "joint mode level *draw"]

    def at(self, level: int) -> "ModeNumbers":
        """Return frequency, damping and contributions of joints at one amplitude."""
        rates = (x[:, level] for x in (self.omega, self.zeta))
        return ModeNumbers(*rates, *(x[:, :, level] for x in self[2:]))

    @property
    def added(self) -> Float[np.ndarray, "mode level *draw"]:
        """The damping ratio that all joints together add.

        It is their loss per cycle over 4 pi times the energy.
        """
        return self.losses.sum(axis=0) / (2 * self.omega**2)


class JointModes(NamedTuple):
    """The driven modes of a structure with several joints, at rising amplitudes.

    Attributes:
        amplitude: Amplitude of the mode's own coordinate; NaN for modes that the first point hardly
            measures.
        free: Numbers of every draw with the free shape, or with the fully stuck shape where there
            is no free one.
        at_medians: Numbers at the medians, or at the fit, with the fully stuck shape.
        backbones: Extended periodic motion of every mode at the medians; NaN beyond its end.
        is_free: Whether a free shape exists; there may be none beyond an internal resonance.
    """

    amplitude: Float[np.ndarray, "mode level"]
    free: ModeNumbers
    at_medians: ModeNumbers
    backbones: tuple[ModalBackbone, ...]
    is_free: Bool[np.ndarray, "mode level"]


def joint_modes(
    posterior: xr.Dataset, data: Dataset, about: Mapping[str, float] | None = None
) -> JointModes | None:
    """Return the driven modes against amplitude; None for a single joint.

    Draws of a Gaussian approximation at a fit (`about`) are propagated by first order. Where the
    tests determine only a sum of joints, such draws leave the narrow curved valley along which the
    sum is constant. The effect of the free shape is then that at the fit.
    """
    modes = data.modes
    if modes is None or modes.meet != ASSEMBLED or not joints_of(data.laws):
        return None
    amplitude = np.multiply.outer(largest_amplitudes(modes, data), LEVELS)
    drawn = draws_of_structure(posterior, data)
    middle = {n: float(np.median(x) if about is None else about[n]) for n, x in drawn.items()}
    theta = {name: np.append(middle[name], draws) for name, draws in drawn.items()}
    stuck = _in_full_stick(theta, data, amplitude, None if about is None else middle)
    count = max(NUM_FREE, SPARE * len(theta))
    chosen = (
        np.append(0, 1 + evenly_spaced(posterior, count)) if about is None else np.zeros(1, int)
    )
    backbones = [
        _backbones({name: float(draws[i]) for name, draws in theta.items()}, data, amplitude)
        for i in chosen
    ]
    rows = [_with_free_shape(curves, _stiffness(data)) for curves in backbones]
    free = ModeNumbers(*(np.stack(parts, axis=-1) for parts in zip(*rows, strict=True)))
    is_free = np.isfinite(free.omega[..., 0])
    steps = _in_deviations(theta)
    numbers = [
        at_rest * _ratios(exact / at_rest[..., chosen], steps, chosen)
        for exact, at_rest in zip(free, stuck, strict=True)
    ]
    is_seen = np.isfinite(amplitude)
    seen = (np.where(is_seen[..., None], x[..., 1:], np.nan) for x in numbers)
    fixed = (np.where(is_seen, x[..., 0], np.nan) for x in stuck)
    return JointModes(amplitude, ModeNumbers(*seen), ModeNumbers(*fixed), backbones[0], is_free)


def draws_of_structure(posterior: xr.Dataset, data: Dataset) -> dict[str, np.ndarray]:
    """Return the draws of modal parameters, joint laws, and factors on joint motion."""
    names = {quantity.name for quantity in quantities_of(data.laws)}
    names |= {name for pair in DRIVEN for name in pair} | motion_factors_in(posterior).keys()
    return {str(n): x.values.ravel() for n, x in posterior.data_vars.items() if n in names}


def _stiffness(data: Dataset) -> Float[np.ndarray, " joint"]:
    """Return the stiffness of every joint when fully stuck."""
    numbers = dict(data.modes.numbers if data.modes is not None else ())
    return np.array([numbers[name_at(STIFFNESS, joint)] for joint in joints_of(data.laws)])


def _backbones(
    theta: Mapping[str, float], data: Dataset, amplitude: Float[np.ndarray, "mode level"]
) -> tuple[ModalBackbone, ...]:
    """Compute the backbone (periodic motion) of every mode at one parameter point."""
    structure = structure_of(as_arrays(theta, data), data.laws)
    levels = np.where(np.isfinite(amplitude), amplitude, 0.0)
    curves = (
        modal_backbone(
            structure, at, mode=mode, num_harmonics=NUM_HARMONICS, max_turns=MAX_TURNS,
            may_end=True,
        )
        for mode, at in enumerate(levels)
    )  # fmt: skip
    return tuple(jax.device_get(curve) for curve in curves)


def _with_free_shape(
    backbones: Sequence[ModalBackbone], stiffness: Float[np.ndarray, " joint"]
) -> ModeNumbers:
    """Return frequency, damping and joint contributions, for shapes that change with amplitude."""
    omega, zeta, q, x, r = (
        np.stack([getattr(curve, name) for curve in backbones])
        for name in ("omega", "zeta", "q", "x", "r")
    )
    n = orders(q.shape[-1])
    mass = np.sum((n * np.abs(q)) ** 2, axis=(-2, -1))
    work, size = (np.moveaxis(z, 2, 0) for z in (r * np.conj(x), np.abs(x) ** 2))
    in_phase, lost = np.real(work), np.sum(n * np.imag(work), axis=-1)
    stored = np.sum(stiffness[:, None, None, None] * size + in_phase, axis=-1)
    softening = -np.sum(in_phase, axis=-1) / mass
    return ModeNumbers(omega, zeta, softening, lost / mass, stored / (omega**2 * mass))


def _in_full_stick(
    theta: Mapping[str, np.ndarray],
    data: Dataset,
    amplitude: Float[np.ndarray, "mode level"],
    about: Mapping[str, float] | None,
) -> ModeNumbers:
    """Return modes' frequency, damping and joint effects, for the shapes with stuck joints."""
    numbers = dict(data.modes.numbers if data.modes is not None else ())
    driven = _DrivenJoints(data.laws, joints_of(data.laws), *jax.device_put((numbers, amplitude)))
    of_joints = {name: x for name, x in theta.items() if name not in STUCK_NAMES}
    softening, losses = (
        np.asarray(_each_draw(jax.device_put(of_joints), driven)) if about is None
        else _by_first_order(of_joints, about, driven)
    )  # fmt: skip
    known = {**data.held, **theta}
    omega_stuck, zeta_stuck = (
        np.array(
            [np.broadcast_to(known[pair[k]], softening.shape[-1:])
             for pair in DRIVEN[: len(amplitude)]]
        )[:, None]
        for k in range(2)
    )  # fmt: skip
    omega = np.sqrt(np.maximum(omega_stuck**2 - softening.sum(axis=0), 0.0))
    everything = {**numbers, **theta}
    h = np.array(
        [
            [np.broadcast_to(motion_in(everything, i + 1, joint), omega.shape[-1:])
             for i in range(len(amplitude))]
            for joint in driven.names
        ]
    )[:, :, None]  # fmt: skip
    stored = _stiffness(data)[:, None, None, None] * h**2 - softening
    with np.errstate(divide="ignore", invalid="ignore"):
        zeta = zeta_stuck * omega_stuck / omega + losses.sum(axis=0) / (2 * omega**2)
        return ModeNumbers(omega, zeta, softening, losses, stored / omega**2)


def _in_deviations(theta: Mapping[str, np.ndarray]) -> Float[np.ndarray, "draw parameter"]:
    """Return draws minus the first one, in standard deviations; use logs if positive."""
    columns = [np.log(draws) if np.all(draws > 0) else draws for draws in theta.values()]
    steps = np.stack([column - column[0] for column in columns], axis=-1)
    return steps / np.maximum(np.std(steps, axis=0), np.finfo(float).tiny)


def _ratios(
    ratios: Float[np.ndarray, "... some"],
    steps: Float[np.ndarray, "draw parameter"],
    chosen: Int[np.ndarray, " some"],
) -> Float[np.ndarray, "... draw"]:
    """Extend ratios that are known only for some draws to all draws, by linear regression.

    The result is clipped to the range of the known ratios. It is one if the first ratio is unknown.
    """
    rows = ratios.reshape(-1, len(chosen))
    extended = np.ones((len(rows), len(steps)))
    for row, whole in zip(rows, extended, strict=True):
        is_known = np.isfinite(row)
        if is_known[0]:
            known = row[is_known]
            slopes = np.linalg.lstsq(steps[chosen[is_known]], known - known[0], rcond=None)[0]
            whole[:] = np.clip(known[0] + steps @ slopes, known.min(), known.max())
    return extended.reshape(*ratios.shape[:-1], len(steps))


class _DrivenJoints(eqx.Module):
    """The laws of the joints, the fixed numbers of the model, and the amplitudes of its modes."""

    laws: tuple[str, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)  # names of the joints
    numbers: dict[str, Float[Array, ""]]
    amplitude: Float[Array, "mode level"]


def _by_first_order(
    theta: Mapping[str, np.ndarray], best_theta: Mapping[str, float], driven: _DrivenJoints
) -> Float[np.ndarray, "two joint *mode_level draw"]:
    r"""Linearise the joints' stiffness loss K and losses L at a fit, for all draws.

    $f(\hat\theta) + \sum_i f_i\,\delta_i$, where f_i are the derivatives with
    respect to the parameters. Steps delta are those of the logarithms, times the fitted value, for
    parameters that are always positive.
    """
    fit = {name: float(best_theta[name]) for name in theta}
    value, slopes = jax.device_get(_about(jax.device_put(fit), driven))
    total = np.repeat(value[..., None], len(next(iter(theta.values()))), axis=-1)
    for name, draws in theta.items():
        is_log = fit[name] > 0 and np.all(draws > 0)
        moved = fit[name] * np.log(draws / fit[name]) if is_log else draws - fit[name]
        total = total + slopes[name][..., None] * moved
    return total


@eqx.filter_jit
def _about(
    theta: Mapping[str, Array], driven: _DrivenJoints
) -> tuple[Float[Array, "two joint mode level"], dict[str, Float[Array, "two joint mode level"]]]:
    return _at(theta, driven), jax.jacfwd(_at)(dict(theta), driven)


@eqx.filter_jit
def _each_draw(
    theta: Mapping[str, Array], driven: _DrivenJoints
) -> Float[Array, "two joint *mode_level draw"]:
    return jax.vmap(lambda draw: _at(draw, driven), out_axes=-1)(dict(theta))


def _at(theta: Mapping[str, Array], driven: _DrivenJoints) -> Float[Array, "two joint mode level"]:
    """Return every joint's stiffness loss K and losses L, by mode and amplitude."""
    rows = []
    everything = {**driven.numbers, **theta}
    modes = range(1, len(driven.amplitude) + 1)
    for joint in driven.names:
        h = jnp.stack([motion_in(everything, i, joint) for i in modes])[:, None]
        laws = laws_at(theta, driven.laws, joint)
        motion = jnp.abs(h) * driven.amplitude
        loops = [law.loop(motion.ravel()) for law in laws]
        at_rest = sum(law.stiffness() for law in laws)
        stiffness = sum(loop.stiffness for loop in loops)
        parts = (at_rest - stiffness, sum(loop.damping for loop in loops))
        rows.append(tuple(h**2 * jnp.reshape(part, motion.shape) for part in parts))
    return jnp.stack([jnp.stack(by_joint) for by_joint in zip(*rows, strict=True)])
