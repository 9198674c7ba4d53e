"""The effect of several joints on each driven mode, from the posterior.

Each mode is considered alone, at its largest measured motion, with the shape that slipping joints
give it (`jbw.identification.joint_modes`). A mode determines sums over joints; a single joint is
identified if its separate effect is determined.

Bands of the modes' backbones come from draws with this free shape. In addition, at the medians,
the result contains the extended periodic motion with its shape, and the values for the shape of
fully stuck joints.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.identification.joint_modes import JointModes
from jbw.inference.posterior.finding import Finding
from jbw.inference.posterior.summary import QUANTILES
from jbw.observables.dataset import Dataset
from jbw.observables.modes import Modes
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.modes.assembled import STIFFNESS, factor_name, laws_at, motion_in, seen_name
from jbw.oscillator.modes.parameters import DRIVEN
from jbw.quantities import joints_of, motion_factors_in, name_at, split
from jbw.report.messages import modes as messages
from jbw.results.stored import finite

JOINTS = "joints"
# A joint's effect is identified if the ratio of the ends of its 99 % interval is smaller than this.
SPREAD = 2.0
# A joint acts as a spring in a mode if the joint's damping of the mode is smaller than this
# fraction of the softening of the mode by all joints.
NO_LOSS = 1e-9
# A sentence states that a joint damps a mode if it causes more than this fraction of the mode's
# losses.
MAIN = 0.5
NUM_PHASES = 64  # number of stored points of a loop
BACKBONES = "backbones"


def joints_group(posterior: xr.Dataset, data: Dataset, modes: JointModes) -> xr.Dataset:
    """Return the share of every joint in every driven mode, and the total effect of all joints.

    Variables over `joint` and `mode` refer to the largest measured motion of the mode with its free
    shape, and have quantiles: `energy_share_at_motion` is the share in the mode's strain energy,
    `loss_share` and `softening_share` are shares of the effect of all joints. `energy_share` is the
    share of energy of fully stuck joints, at the median of uncertain shapes. Variables over `mode`
    are `frequency_hz`, `amplitude`, `frequency_change` and `damping_added` of all joints together,
    and `shape_is_free`, which is false where no free shape exists. Variables over `joint` are
    `identified`, and `motion` and `loop` at its largest motion. Where shapes are uncertain,
    `motion_factor` over `joint` and `mode`, with quantiles, is the motion over that of the model;
    1 where it is fixed.
    """
    model_modes = data.modes
    if model_modes is None:
        raise ValueError("results of several joints need the modes of a model (`data.modes`)")
    names = joints_of(data.laws)
    numbers = dict(model_modes.numbers)
    driven = range(len(model_modes.hz))
    amplitude = modes.amplitude[:, -1]
    at_largest = modes.free.at(-1)
    softening, losses = at_largest.softening, at_largest.losses
    omega = np.array([values_of(posterior, data, DRIVEN[i][0]) for i in driven])
    k = np.array([numbers[name_at(STIFFNESS, joint)] for joint in names])
    medians = {name: float(np.median(x)) for name, x in draws_of_joints(posterior, data).items()}
    likely = numbers | medians
    motion = np.array([[motion_in(likely, i + 1, joint) for i in driven] for joint in names])
    shares = k[:, None] * motion**2 / (2 * np.pi * np.array(model_modes.hz)) ** 2
    moved = np.stack([np.abs(curve.x[-1, :, 0]) for curve in modes.backbones], axis=-1)
    moved = np.where(modes.is_free[:, -1], moved, np.abs(motion) * amplitude)
    largest = np.nanmax(np.where(np.isfinite(amplitude), moved, np.nan), axis=1)
    x, force = _loops(medians, data.laws, names, largest)
    return xr.Dataset(
        {
            "energy_share": (("joint", "mode"), shares, _words("1", "share in strain energy")),
            "energy_share_at_motion": (
                *_bands(at_largest.energy), _words("1", messages.ENERGY_AT_MOTION),
            ),
            "loss_share": (*_bands(_shares(losses)), _words("1", messages.LOSS_SHARE)),
            "softening_share": (
                *_bands(_shares(softening)), _words("1", messages.SOFTENING_SHARE),
            ),
            "frequency_hz": (
                "mode", np.array(model_modes.hz), _words("Hz", "natural frequency, model"),
            ),
            "amplitude": ("mode", amplitude, _words("m kg^0.5", "largest modal amplitude")),
            "shape_is_free": ("mode", modes.is_free[:, -1]),
            "frequency_change": (
                ("mode", "quantile"), _quantiles(at_largest.omega / omega - 1),
                _words("1", "change by all joints"),
            ),
            "damping_added": (
                ("mode", "quantile"), _quantiles(at_largest.added),
                _words("1", "damping of all joints"),
            ),
            "identified": ("joint", _identified(names, data.laws, softening, losses)),
            "motion": (("joint", "phase"), x, _words("m", "relative motion")),
            "loop": (("joint", "phase"), force, _words("N", messages.LOOP_FORCE)),
            **_factors(posterior, model_modes, names),
        },
        {"joint": list(names), "mode": [i + 1 for i in driven], "quantile": list(QUANTILES)},
    )  # fmt: skip


def draws_of_joints(posterior: xr.Dataset, data: Dataset) -> dict[str, np.ndarray]:
    """Return the draws of the parameters of the joints' laws, and of factors on joint motion."""
    names = {quantity.name for quantity in quantities_of(data.laws)}
    names |= motion_factors_in(posterior).keys()
    return {str(n): x.values.ravel() for n, x in posterior.data_vars.items() if n in names}


def values_of(posterior: xr.Dataset, data: Dataset, name: str) -> np.ndarray:
    """Return the draws of a parameter, or its value if it is fixed."""
    if name in posterior:
        return posterior[name].values.ravel()
    return np.atleast_1d(np.asarray(data.held[name]))


def _loops(
    theta: Mapping[str, float],
    laws: tuple[str, ...],
    names: Sequence[str],
    largest: Float[np.ndarray, " joint"],
) -> tuple[Float[np.ndarray, "joint phase"], Float[np.ndarray, "joint phase"]]:
    """Return the motion and the restoring force of every joint along its steady loop."""
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
    """Return each joint's contribution divided by the sum over all joints; NaN if this is zero."""
    total = parts.sum(axis=0)
    return parts / np.where(total != 0, total, np.nan)


def _quantiles(draws: Float[np.ndarray, "... draw"]) -> Float[np.ndarray, "... quantile"]:
    return np.moveaxis(np.quantile(draws, QUANTILES, axis=-1), 0, -1)


def _bands(draws: Float[np.ndarray, "joint mode draw"]) -> tuple[tuple[str, ...], np.ndarray]:
    return ("joint", "mode", "quantile"), _quantiles(draws)


def _factors(posterior: xr.Dataset, modes: Modes, names: Sequence[str]) -> dict[str, Any]:
    """Return the factors on each joint's motion in each mode; {} if the mode shapes are exact."""
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
    """Return for each joint whether the joint's effect on some mode is known to a factor of two.

    Tied joints share one law, so any of them and any mode may determine it.
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
    """Return sentences on damping by mode, the effect of all joints, and identified joints."""
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
        is_free = bool(of_mode["shape_is_free"])
        sentences.append(messages.all_joints(name, change, damping, is_free=is_free))
        sentences += _who_damps(int(mode), of_mode)
    if named := ", ".join(name for name, is_identified in _by_joint(group) if is_identified):
        sentences.append(messages.identified(named))
    return sentences + _shape_words(group)


def _shape_words(group: xr.Dataset) -> list[str]:
    """Return sentences on the factors on joint motion, if the model's mode shapes are uncertain."""
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
    """Return the sentence that one joint causes most of a mode's losses, if this is certain."""
    low, middle, high = (of_mode["loss_share"].isel(quantile=i).values for i in range(3))
    if np.all(np.isnan(middle)):
        return []
    first = int(np.nanargmax(middle))
    if low[first] < MAIN or not bool(of_mode["identified"].values[first]):
        return []
    joint = str(of_mode["joint"].values[first])
    return [messages.damped_by(mode, joint, middle[first], low[first], high[first])]


def _by_joint(group: xr.Dataset) -> Iterator[tuple[str, bool]]:
    """Yield each joint's name, and whether it is identified."""
    of_joints = group["identified"]
    return zip(of_joints.joint.values.astype(str), of_joints.values, strict=True)


def joints_finding(group: xr.Dataset | None) -> Finding | None:
    """Return the finding on whether each joint is identified; None for a single joint."""
    if group is None:
        return None
    unknown = [name for name, is_identified in _by_joint(group) if not is_identified]
    status = "usable" if unknown else "ok"
    return Finding("unidentified_joints", status, {"joints": unknown}, float(len(unknown)))


def joints_record(group: xr.Dataset | None) -> dict[str, Any] | None:
    """Return the effects of several joints as plain values; None for a single joint."""
    if group is None:
        return None
    quantiles = [str(q) for q in group["quantile"].values]

    def bands(row: xr.DataArray) -> dict[str, float | None]:
        return {q: finite(x) for q, x in zip(quantiles, row.values, strict=True)}

    modes = [
        {
            "mode": int(mode),
            "frequency_hz": float(group["frequency_hz"].sel(mode=mode)),
            "shape": "free" if bool(group["shape_is_free"].sel(mode=mode)) else "full stick",
            **{name: bands(group[name].sel(mode=mode))
               for name in ("frequency_change", "damping_added")},
        }
        for mode in group["mode"].values
    ]  # fmt: skip
    joints = [
        {
            "joint": str(joint),
            "verdict": "identified" if bool(of_joint["identified"]) else "unidentified",
            "energy_share": [finite(x) for x in of_joint["energy_share"].values],
            **{name: [bands(of_joint[name].sel(mode=mode)) for mode in group["mode"].values]
               for name in ("energy_share_at_motion", "loss_share", "softening_share")},
        }
        for joint, of_joint in group.groupby("joint", squeeze=False)
        for of_joint in [of_joint.squeeze("joint")]
    ]  # fmt: skip
    return {"modes": modes, "joints": joints}


def backbones_group(data: Dataset, modes: JointModes) -> xr.Dataset:
    """Return the frequency, damping and shape of every driven mode against amplitude.

    Variables over `mode` and `level` are `displacement` at the first point, and `frequency_hz` and
    `damping` with quantiles. Frequency and damping are also given `at_medians`, from extended
    periodic motion, and `in_full_stick`, with the shape of fully stuck joints. The free `shape`,
    also over `coordinate`, contains the modal coordinates over that of the mode. Values are NaN for
    modes that the first point hardly measures. Values at medians and `shape` are NaN beyond the end
    of a backbone, where the bands have the fully stuck shape.
    """
    amplitude, free = modes.amplitude, modes.free
    driven = range(len(amplitude))
    numbers = dict(data.modes.numbers if data.modes is not None else ())
    seen = np.abs([numbers[seen_name(i + 1)] for i in driven])
    of_levels, with_quantiles = ("mode", "level"), ("mode", "level", "quantile")
    hz, one = {"units": "Hz"}, {"units": "1"}
    per_turn = 2 * np.pi
    curves = modes.backbones
    return xr.Dataset(
        {
            "displacement": (of_levels, seen[:, None] * amplitude, {"units": "m"}),
            "frequency_hz": (with_quantiles, _quantiles(free.omega) / per_turn, hz),
            "damping": (with_quantiles, _quantiles(free.zeta), one),
            "frequency_at_medians": (of_levels, np.array([x.omega for x in curves]) / per_turn, hz),
            "damping_at_medians": (of_levels, np.array([x.zeta for x in curves]), one),
            "frequency_in_full_stick": (of_levels, modes.at_medians.omega / per_turn, hz),
            "damping_in_full_stick": (of_levels, modes.at_medians.zeta, one),
            "shape": (
                (*of_levels, "coordinate"),
                np.abs([x.shape[:, : len(driven)] for x in curves]), one,
            ),
        },
        {
            "mode": [i + 1 for i in driven], "coordinate": [i + 1 for i in driven],
            "quantile": list(QUANTILES),
        },
    )  # fmt: skip
