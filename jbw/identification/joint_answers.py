r"""What several joints do to every mode that tests drive, by the posterior.

A mode alone, at the largest motion a that was measured of it, moves joint j by $|H_{ji}|a$. There
the joint's steady loop takes from the mode's stiffness and adds to its losses

$$K_{ji} = H_{ji}^2\,\big(k_j - \mathrm{Re}\,\kappa_j(|H_{ji}|a)\big), \qquad
  L_{ji} = H_{ji}^2\,\mathrm{Im}\,\kappa_j(|H_{ji}|a)$$

with $\kappa_j$ the complex stiffness of its laws and $k_j$ theirs at rest; where shapes are
uncertain, $H_{ji}$ is that of each draw. Sums over joints are what a mode tells; a joint by itself
is identified where its own K and L are.

Backbones of the modes have bands of draws at the shape of full stick,

$$\omega^2 = \omega_i^2 - \sum_j K_{ji}(a), \qquad
  \zeta_{eq} = \zeta_i\,\frac{\omega_i}{\omega} + \frac{\sum_j L_{ji}(a)}{2\omega^2}$$

and beside them stands the extended periodic motion at the medians, which lets the shape change.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float

from jbw.identification.assembled import ASSEMBLED, largest_amplitudes
from jbw.inference.posterior.finding import Finding
from jbw.inference.posterior.summary import QUANTILES
from jbw.observables.dataset import Dataset, as_arrays
from jbw.observables.modes import Modes
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.modes.assembled import STIFFNESS, factor_name, laws_at, motion_in, seen_name
from jbw.oscillator.modes.backbone import ModalBackbone, modal_backbone
from jbw.oscillator.modes.parameters import DRIVEN, structure_of
from jbw.quantities import joints_of, motion_factors_in, name_at, split
from jbw.report.messages import modes as messages

JOINTS = "joints"
SPREAD = 2.0  # of the ends of a 99 % interval: a joint that is known better is identified
NO_LOSS = 1e-9  # of what a mode's joints take from its stiffness: losses of a spring
MAIN = 0.5  # of a mode's losses: a joint that takes more is said to damp it
NUM_PHASES = 64  # of a loop that is kept
BACKBONES = "backbones"
BACKBONE_LEVELS = np.linspace(0.0, 1.0, 9)[
    1:
]  # of the largest amplitude that was measured of a mode
NUM_HARMONICS = 3  # frequency to 1e-6, damping to 1e-4
MAX_TURNS = 2  # of a joint in a period


def joints_group(
    posterior: xr.Dataset, data: Dataset, about: Mapping[str, float] | None = None
) -> xr.Dataset | None:
    """Shares of every joint in every driven mode, and what all do together; None of one joint.

    Variables over `joint` and `mode`: `energy_share` in full stick, by the median of uncertain
    shapes, `loss_share` and `softening_share` of what the joints do together, at the largest motion
    measured of the mode, with quantiles; over `mode`: `frequency_hz`, `amplitude`,
    `frequency_change` and `damping_added` of all joints together; over `joint`: `identified`,
    `motion` and `loop` at its largest motion. Where shapes are uncertain, `motion_factor` over
    `joint` and `mode` with quantiles: the motion over that of the model, 1 where that is held.

    Draws of a Gaussian `about` a fit are propagated by first order: where the tests tell a sum of
    joints alone, they leave the narrow curved valley along which it stays the same.
    """
    modes = data.modes
    if modes is None or modes.meet != ASSEMBLED or not joints_of(data.laws):
        return None
    names = joints_of(data.laws)
    numbers = dict(modes.numbers)
    driven = range(len(modes.hz))
    amplitude = largest_amplitudes(modes, data)
    softening, losses = softening_and_losses(posterior, data, amplitude, about)
    omega = np.array([values_of(posterior, data, DRIVEN[i][0]) for i in driven])
    lowered = np.sqrt(np.maximum(1 - softening.sum(axis=0) / omega**2, 0.0))
    added = losses.sum(axis=0) / (2 * (omega * lowered) ** 2)
    k = np.array([numbers[name_at(STIFFNESS, joint)] for joint in names])
    medians = {name: float(np.median(x)) for name, x in draws_of_joints(posterior, data).items()}
    likely = numbers | medians
    motion = np.array([[motion_in(likely, i + 1, joint) for i in driven] for joint in names])
    shares = k[:, None] * motion**2 / (2 * np.pi * np.array(modes.hz)) ** 2
    largest = np.nanmax(np.abs(motion) * amplitude, axis=1)
    x, force = _loops(medians, data.laws, names, largest)
    return xr.Dataset(
        {
            "energy_share": (("joint", "mode"), shares, _words("1", "share in strain energy")),
            "loss_share": (*_bands(_shares(losses)), _words("1", messages.LOSS_SHARE)),
            "softening_share": (
                *_bands(_shares(softening)), _words("1", messages.SOFTENING_SHARE),
            ),
            "frequency_hz": ("mode", np.array(modes.hz), _words("Hz", "natural frequency, model")),
            "amplitude": ("mode", amplitude, _words("m kg^0.5", "largest modal amplitude")),
            "frequency_change": (
                ("mode", "quantile"), _quantiles(lowered - 1), _words("1", "change by all joints"),
            ),
            "damping_added": (
                ("mode", "quantile"), _quantiles(added), _words("1", "damping of all joints"),
            ),
            "identified": ("joint", _identified(names, data.laws, softening, losses)),
            "motion": (("joint", "phase"), x, _words("m", "relative motion")),
            "loop": (("joint", "phase"), force, _words("N", messages.LOOP_FORCE)),
            **_factors(posterior, modes, names),
        },
        {"joint": list(names), "mode": [i + 1 for i in driven], "quantile": list(QUANTILES)},
    )  # fmt: skip


def draws_of_joints(posterior: xr.Dataset, data: Dataset) -> dict[str, np.ndarray]:
    """Draws of the parameters of the joints' laws, and of factors on their motion."""
    names = {quantity.name for quantity in quantities_of(data.laws)}
    names |= motion_factors_in(posterior).keys()
    return {str(n): x.values.ravel() for n, x in posterior.data_vars.items() if n in names}


def softening_and_losses(
    posterior: xr.Dataset,
    data: Dataset,
    amplitude: Float[np.ndarray, " mode"],
    about: Mapping[str, float] | None = None,
) -> Float[np.ndarray, "two joint mode draw"]:
    """K and L of every joint in every mode at its amplitude, for every draw."""
    numbers = dict(data.modes.numbers if data.modes is not None else ())
    theta = draws_of_joints(posterior, data)
    arrays = jax.device_put((numbers, amplitude))
    driven = _DrivenJoints(data.laws, joints_of(data.laws), *arrays)
    if about is not None:
        return _by_first_order(theta, about, driven)
    return np.asarray(_each_draw(jax.device_put(theta), driven))


def values_of(posterior: xr.Dataset, data: Dataset, name: str) -> np.ndarray:
    """Draws of a parameter, or what it is held at."""
    if name in posterior:
        return posterior[name].values.ravel()
    return np.atleast_1d(np.asarray(data.held[name]))


class _DrivenJoints(eqx.Module):
    """The joints' laws, the numbers of the model, and how far tests drove its modes."""

    laws: tuple[str, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)  # of the joints
    numbers: dict[str, Float[Array, ""]]
    amplitude: Float[Array, " mode"]


def _by_first_order(
    theta: Mapping[str, np.ndarray], best_theta: Mapping[str, float], driven: _DrivenJoints
) -> Float[np.ndarray, "two joint mode draw"]:
    r"""K and L of draws about a fit, $f(\hat\theta) + \sum_i f_i\,\delta_i$, by derivatives f_i.

    Steps delta are of logarithms, times the fit, where nothing is zero or changes sign.
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
) -> tuple[Float[Array, "two joint mode"], dict[str, Float[Array, "two joint mode"]]]:
    """K and L at a point, and their derivatives by every parameter."""
    return _at(theta, driven), jax.jacfwd(_at)(dict(theta), driven)


@eqx.filter_jit
def _each_draw(
    theta: Mapping[str, Array], driven: _DrivenJoints
) -> Float[Array, "two joint mode draw"]:
    """K and L of every draw."""
    return jax.vmap(lambda draw: _at(draw, driven), out_axes=-1)(dict(theta))


def _at(theta: Mapping[str, Array], driven: _DrivenJoints) -> Float[Array, "two joint mode"]:
    """K and L of every joint and mode."""
    rows = []
    everything = {**driven.numbers, **theta}
    modes = range(1, driven.amplitude.size + 1)
    for joint in driven.names:
        h = jnp.stack([motion_in(everything, i, joint) for i in modes])
        laws = laws_at(theta, driven.laws, joint)
        loops = [law.loop(jnp.abs(h) * driven.amplitude) for law in laws]
        at_rest = sum(law.stiffness() for law in laws)
        stiffness = sum(loop.stiffness for loop in loops)
        rows.append((h**2 * (at_rest - stiffness), h**2 * sum(x.damping for x in loops)))
    return jnp.stack([jnp.stack(by_joint) for by_joint in zip(*rows, strict=True)])


def _loops(
    theta: Mapping[str, float],
    laws: tuple[str, ...],
    names: Sequence[str],
    largest: Float[np.ndarray, " joint"],
) -> tuple[Float[np.ndarray, "joint phase"], Float[np.ndarray, "joint phase"]]:
    """Motion and force of every joint's laws along their steady loop."""
    phase = np.linspace(0, np.pi, NUM_PHASES // 2, endpoint=False)
    x, force = [], []
    for joint, peak in zip(names, largest, strict=True):
        down = peak * np.cos(phase)
        falling = np.zeros_like(down)
        for law in laws_at(theta, laws, joint):
            tip = law.at_tip(peak)
            falling += [float(law.force(to, -1.0, law.move(peak, tip, to - peak))) for to in down]  # pyright: ignore
        x.append(np.concatenate([down, -down]))
        force.append(np.concatenate([falling, -falling]))
    return np.array(x), np.array(force)


def _words(unit: str, meaning: str) -> dict[str, str]:
    return {"units": unit, "long_name": meaning}


def _shares(parts: Float[np.ndarray, "joint mode draw"]) -> Float[np.ndarray, "joint mode draw"]:
    """Parts of every joint over their sum; NaN where nothing is."""
    total = parts.sum(axis=0)
    return parts / np.where(total != 0, total, np.nan)


def _quantiles(draws: Float[np.ndarray, "... draw"]) -> Float[np.ndarray, "... quantile"]:
    return np.moveaxis(np.quantile(draws, QUANTILES, axis=-1), 0, -1)


def _bands(draws: Float[np.ndarray, "joint mode draw"]) -> tuple[tuple[str, ...], np.ndarray]:
    return ("joint", "mode", "quantile"), _quantiles(draws)


def _factors(posterior: xr.Dataset, modes: Modes, names: Sequence[str]) -> dict[str, Any]:
    """Factors on the motion of every joint in every mode; nothing where shapes are the model's."""
    if not modes.uncertain:
        return {}
    size = posterior["omega_n"].size if "omega_n" in posterior else 1
    draws = [
        [
            posterior[name].values.ravel() if (name := factor_name(i + 1, joint)) in posterior
            else np.ones(size)
            for i in range(len(modes.hz))
        ]
        for joint in names
    ]  # fmt: skip
    return {"motion_factor": (*_bands(np.array(draws)), _words("1", messages.MOTION_FACTOR))}


def _identified(
    names: Sequence[str],
    laws: Sequence[str],
    softening: Float[np.ndarray, "joint mode draw"],
    losses: Float[np.ndarray, "joint mode draw"],
) -> list[bool]:
    """Whether what each joint does is known within a factor of two, in the mode that shows it best.

    Joints of a tie have one law, of which either mode and joint may tell.
    """
    size = np.abs(np.median(softening, axis=-1)).sum(axis=0)
    is_identified = np.zeros(softening.shape[:2], bool)
    for j, i in np.ndindex(is_identified.shape):
        has_losses = np.median(losses[j, i]) > NO_LOSS * size[i]
        is_identified[j, i] = _is_known(softening[j, i]) and (
            not has_losses or _is_known(losses[j, i])
        )
    tied = {joint: split(law)[1] for law in laws for joint in split(law)[1]}
    rows = dict(zip(names, is_identified.any(axis=1), strict=True))
    return [any(rows[other] for other in tied[joint]) for joint in names]


def _is_known(draws: Float[np.ndarray, " draw"]) -> bool:
    low, _, high = np.quantile(draws, QUANTILES)
    low, high = (low, high) if low > 0 else (-high, -low)
    return bool(low > 0 and high < SPREAD * low)


def joints_words(group: xr.Dataset | None) -> list[str]:
    """What damps each mode, what all joints do together, and which are identified; sentences."""
    if group is None:
        return []
    sentences = []
    for mode in group["mode"].values:
        of_mode = group.sel(mode=mode)
        name = messages.numbered(mode, float(of_mode["frequency_hz"]))
        if not np.isfinite(float(of_mode["amplitude"])):
            sentences.append(messages.hardly_seen(name))
            continue
        change, damping = (
            (100 * of_mode[n].values).tolist() for n in ("frequency_change", "damping_added")
        )
        sentences.append(messages.all_joints(name, change, damping))
        sentences += _who_damps(int(mode), of_mode)
    identified = dict(zip(group["joint"].values, group["identified"].values, strict=True))
    named = ", ".join(str(joint) for joint, is_identified in identified.items() if is_identified)
    if named:
        sentences.append(messages.identified(named))
    return sentences + _shape_words(group)


def _shape_words(group: xr.Dataset) -> list[str]:
    """By what factor modes move the joints, where the model's shapes are uncertain."""
    if "motion_factor" not in group:
        return []
    factors = group["motion_factor"]
    sentences = []
    for joint, mode in itertools.product(group["joint"].values, group["mode"].values):
        low, middle, high = factors.sel(joint=joint, mode=mode).values.tolist()
        if low < high:
            sentences.append(messages.moved_by_factor(int(mode), str(joint), middle, low, high))
    return [*sentences, messages.LAWS_BY_MODEL]


def _who_damps(mode: int, of_mode: xr.Dataset) -> list[str]:
    """The identified joint that takes most of a mode's losses, where its interval says so."""
    low, middle, high = (of_mode["loss_share"].isel(quantile=i).values for i in range(3))
    if np.all(np.isnan(middle)):
        return []
    first = int(np.nanargmax(middle))
    if low[first] < MAIN or not bool(of_mode["identified"].values[first]):
        return []
    joint = str(of_mode["joint"].values[first])
    return [messages.damped_by(mode, joint, middle[first], low[first], high[first])]


def joints_finding(group: xr.Dataset | None) -> Finding | None:
    """Whether every joint is identified by itself; None of one joint."""
    if group is None:
        return None
    identified = dict(zip(group["joint"].values, group["identified"].values, strict=True))
    unknown = [str(joint) for joint, is_identified in identified.items() if not is_identified]
    status = "usable" if unknown else "ok"
    return Finding("unidentified_joints", status, {"joints": unknown}, float(len(unknown)))


def joints_record(group: xr.Dataset | None) -> dict[str, Any] | None:
    """The same in plain values for a summary; None of one joint."""
    if group is None:
        return None
    quantiles = [str(q) for q in group["quantile"].values]

    def bands(row: xr.DataArray) -> dict[str, float | None]:
        return {q: _plain(x) for q, x in zip(quantiles, row.values, strict=True)}

    modes = [
        {
            "mode": int(mode),
            "frequency_hz": float(group["frequency_hz"].sel(mode=mode)),
            **{name: bands(group[name].sel(mode=mode))
               for name in ("frequency_change", "damping_added")},
        }
        for mode in group["mode"].values
    ]  # fmt: skip
    joints = [
        {
            "joint": str(joint),
            "verdict": "identified" if bool(of_joint["identified"]) else "unidentified",
            "energy_share": [_plain(x) for x in of_joint["energy_share"].values],
            **{name: [bands(of_joint[name].sel(mode=mode)) for mode in group["mode"].values]
               for name in ("loss_share", "softening_share")},
        }
        for joint, of_joint in group.groupby("joint", squeeze=False)
        for of_joint in [of_joint.squeeze("joint")]
    ]  # fmt: skip
    return {"modes": modes, "joints": joints}


def _plain(x: Any) -> float | None:
    return float(x) if np.isfinite(x) else None


def backbones_group(posterior: xr.Dataset, data: Dataset) -> xr.Dataset | None:
    """Frequency, damping and shape of every driven mode against amplitude; None of one joint.

    Variables over `mode` and `level`: `displacement` at the first point, `frequency_hz` and
    `damping` with quantiles, the same `at_medians` with the shape free, and over `coordinate` their
    `shape`, the modal coordinates over that of the mode. NaN of modes that the first point hardly
    sees, and behind the end of a backbone.
    """
    modes = data.modes
    if modes is None or modes.meet != ASSEMBLED or not joints_of(data.laws):
        return None
    largest, driven = largest_amplitudes(modes, data), range(len(modes.hz))
    amplitude = np.multiply.outer(largest, BACKBONE_LEVELS)
    omega, zeta = (
        np.array(np.broadcast_arrays(*(values_of(posterior, data, DRIVEN[i][k]) for i in driven)))
        for k in range(2)
    )
    bands = [
        _of_draws(omega, zeta, *softening_and_losses(posterior, data, at).sum(axis=1))
        for at in amplitude.T
    ]
    frequency, damping = (np.stack(rows, axis=1) for rows in zip(*bands, strict=True))
    free = [_at_medians(posterior, data, i, amplitude[i]) for i in driven]
    numbers = dict(modes.numbers)
    seen = np.abs([numbers[seen_name(i + 1)] for i in driven])
    of_levels, with_quantiles = ("mode", "level"), ("mode", "level", "quantile")
    return xr.Dataset(
        {
            "displacement": (of_levels, seen[:, None] * amplitude, {"units": "m"}),
            "frequency_hz": (with_quantiles, frequency / (2 * np.pi), {"units": "Hz"}),
            "damping": (with_quantiles, damping, {"units": "1"}),
            "frequency_at_medians": (
                of_levels, np.array([x.omega for x in free]) / (2 * np.pi), {"units": "Hz"},
            ),
            "damping_at_medians": (of_levels, np.array([x.zeta for x in free]), {"units": "1"}),
            "shape": (
                (*of_levels, "coordinate"),
                np.abs([x.shape[:, : len(driven)] for x in free]), {"units": "1"},
            ),
        },
        {
            "mode": [i + 1 for i in driven], "coordinate": [i + 1 for i in driven],
            "quantile": list(QUANTILES),
        },
    )  # fmt: skip


def _of_draws(
    omega: Float[np.ndarray, "mode draw"],
    zeta: Float[np.ndarray, "mode draw"],
    softening: Float[np.ndarray, "mode draw"],
    losses: Float[np.ndarray, "mode draw"],
) -> tuple[Float[np.ndarray, "mode quantile"], Float[np.ndarray, "mode quantile"]]:
    """Quantiles of frequency and damping of draws at one level of every mode."""
    lowered = np.sqrt(np.maximum(omega**2 - softening, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        damping = zeta * omega / lowered + losses / (2 * lowered**2)
    frequencies, dampings = (np.quantile(x, QUANTILES, axis=-1).T for x in (lowered, damping))
    return frequencies, dampings


def _at_medians(
    posterior: xr.Dataset, data: Dataset, mode: int, amplitude: Float[np.ndarray, " level"]
) -> ModalBackbone:
    """The extended periodic motion of a mode, the parameters at their medians."""
    medians = {str(n): float(np.median(x.values)) for n, x in posterior.data_vars.items()
               if x.dims == ("chain", "draw")}  # fmt: skip
    structure = structure_of(as_arrays(medians, data), data.laws)
    levels = np.where(np.isfinite(amplitude), amplitude, 0.0)
    return modal_backbone(
        structure, levels, mode=mode, num_harmonics=NUM_HARMONICS, max_turns=MAX_TURNS, may_end=True
    )
