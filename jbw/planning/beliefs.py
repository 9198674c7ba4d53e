r"""What is held possible of the joint: before any test by ranges, after a run by its posterior.

The joint is only guessed, and what a test tells depends on it. So every number of a plan is made
at several joints, and judged by the worst of ten.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.stats import qmc

from jbw.campaign.settings import DEFAULT_LAWS
from jbw.errors import ConfigError, DataError
from jbw.inference.space.box import Box, box
from jbw.oscillator.laws import quantities_of
from jbw.planning.keys import Range, shares_of
from jbw.verification.predictive_basis import Draws, laws_of_run, thin

# A single value is known to a factor of two; the natural frequency, which a tap shows, far better.
REACH = {"omega_n": 1.1}
FACTOR = 2.0
UNBOUNDED = 10.0  # factor to either side, where a posterior tells nothing of its prior's box


@dataclass(frozen=True)
class Beliefs:
    """Joints that are held possible, and what is known before the test.

    Attributes:
        joints: All parameters and `gain`, one value a joint, in their units.
        names: Those that are inferred.
        scale: Units of their relative changes, joint by joint.
        precision: Information that there is already, about the relative changes [-].
        box: Bounds of the inferred parameters, for telling what stays undetermined.
        laws: Laws of the joint.
    """

    joints: Draws
    names: tuple[str, ...]
    scale: Float[np.ndarray, "joint parameter"]
    precision: Float[np.ndarray, "parameter parameter"]
    box: Box
    laws: tuple[str, ...] = DEFAULT_LAWS

    @property
    def law_names(self) -> tuple[str, ...]:
        """Parameters of the laws."""
        return tuple(quantity.name for quantity in quantities_of(self.laws))

    @property
    def num_joints(self) -> int:
        """How many joints."""
        return len(self.scale)

    def each(self) -> Iterator[tuple[dict[str, float], Float[np.ndarray, " parameter"]]]:
        """Every joint, and the units of its relative changes."""
        for i, row in enumerate(self.scale):
            yield {name: float(values[i]) for name, values in self.joints.items()}, row


def before(
    ranges: Mapping[str, Range],
    *,
    held: Mapping[str, float],
    num_joints: int,
    seed: int,
    laws: tuple[str, ...] = DEFAULT_LAWS,
) -> Beliefs:
    r"""Beliefs from ranges, each uniform in the logarithm of its parameter.

    $$\mathrm{sd}(\log\theta) = \log(\theta_{max} / \theta_{min}) / \sqrt{12}$$

    A range without width is a guess: joints are drawn at it, and the prior reaches a factor of two
    to either side (a tenth for omega_n). A share of omega_n^2 may stand for a law's stiffness, as
    `share` does for alpha.

    Args:
        ranges: Lowest and highest value by name, both of one sign: omega_n [rad/s], zeta [-],
            every parameter of the laws in its unit, and gain where it is inferred.
        held: What is known exactly, such as `gain`.
        num_joints: Joints drawn, by a Latin hypercube.
        seed: Of the draws.
        laws: Laws of the joint.

    Raises:
        ConfigError: A range that holds zero, or whose ends are not in order.
    """
    for name, pair in ranges.items():
        require_one_sign(name, pair)
    drawn = _drawn(ranges, num_joints, seed)
    wide = {name: _widened(name, pair) for name, pair in ranges.items()}
    std = np.array([np.log(abs(b / a)) for a, b in wide.values()]) / np.sqrt(12)
    covariance, given = np.diag(std**2), list(ranges)
    for share, stiffness in shares_of(laws).items():
        if share in ranges:
            drawn[stiffness] = drawn.pop(share) * drawn["omega_n"] ** 2
            low, high = wide[share]
            wide[stiffness] = (low * wide["omega_n"][0] ** 2, high * wide["omega_n"][1] ** 2)
            covariance = _with_stiffness_for_share(covariance, given, share)
            given[given.index(share)] = stiffness
    names = tuple(name for name in (*_joint_names(laws), "gain") if name in given)
    order = [given.index(name) for name in names]
    fixed = {name: np.full(num_joints, value) for name, value in held.items()}
    return Beliefs(
        joints={**fixed, **drawn},
        names=names,
        scale=np.stack([drawn[name] for name in names], axis=1),
        precision=np.linalg.inv(covariance[np.ix_(order, order)]),
        box=box({name: _rising(wide[name]) for name in names}),
        laws=laws,
    )


def _joint_names(laws: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters that a joint of these laws needs, without the gain of the source."""
    return ("omega_n", "zeta", *(quantity.name for quantity in quantities_of(laws)))


def _with_stiffness_for_share(
    covariance: Float[np.ndarray, "parameter parameter"], given: list[str], share: str
) -> Float[np.ndarray, "parameter parameter"]:
    """Covariance with log stiffness = log share + 2 log omega_n in the place of log share."""
    to_stiffness = np.eye(len(given))
    to_stiffness[given.index(share), given.index("omega_n")] = 2.0
    return to_stiffness @ covariance @ to_stiffness.T


def require_one_sign(name: str, pair: Range) -> None:
    """Refuse a range within which relative changes have no meaning.

    Raises:
        ConfigError: It holds zero, or its ends are not in order.
    """
    low, high = pair
    if not (low * high > 0 and low <= high):
        raise ConfigError(
            f"Range `{name}` must be [lower, upper] of one sign, but is [{low:g}, {high:g}].",
            why="A coefficient of variation needs a value that cannot be zero.",
            remedy="Bound it away from zero.",
        )


def _drawn(ranges: Mapping[str, Range], num_joints: int, seed: int) -> Draws:
    unit = qmc.LatinHypercube(len(ranges), rng=np.random.default_rng(seed)).random(num_joints)
    return {
        name: low * (high / low) ** x
        for (name, (low, high)), x in zip(ranges.items(), unit.T, strict=True)
    }


def _widened(name: str, pair: Range) -> Range:
    low, high = pair
    if low != high:
        return pair
    factor = REACH.get(name, FACTOR)
    return low / factor, high * factor


def _rising(pair: Range) -> Range:
    return min(pair), max(pair)


def after(tree: xr.DataTree, *, held: Mapping[str, float], num_joints: int) -> Beliefs:
    """Beliefs from the main posterior of a run.

    Args:
        tree: The result, as `posterior.nc` holds it.
        held: What is known exactly, where the posterior does not hold it, such as `gain`.
        num_joints: Draws taken, evenly spaced.

    Raises:
        DataError: The posterior lacks a parameter of the joint, or its damping is held at zero.
    """
    posterior = tree["posterior"].to_dataset()
    laws = laws_of_run(tree)
    needed = _joint_names(laws)
    missing = [name for name in needed if name not in posterior and name not in held]
    if missing:
        raise DataError(
            f"The main posterior must hold all of {', '.join(needed)}, but lacks "
            f"{', '.join(missing)}.",
            why="Without them no further test can be predicted.",
            remedy="Plan from ranges: jbw plan PLAN.toml.",
        )
    if held.get("zeta") == 0.0:
        raise DataError(
            "Damping `zeta` must be positive to plan from a run, but this one holds it at 0.",
            why="Loops under prescribed displacement do not tell how the joint moves by itself.",
            remedy="Plan from ranges: jbw plan PLAN.toml.",
        )
    names = tuple(name for name in (*needed, "gain") if name in posterior)
    every = {name: posterior[name].values.ravel() for name in names}
    means = {name: float(values.mean()) for name, values in every.items()}
    positive = {name: bool((values > 0).all()) for name, values in every.items()}
    relative = [
        np.log(values) if positive[name] else values / abs(means[name])
        for name, values in every.items()
    ]
    draws = {name: v for name, v in thin(posterior, num_joints, laws=laws).items() if name in names}
    count = len(draws[names[0]])
    scale = [draws[name] if positive[name] else np.full(count, abs(means[name])) for name in names]
    return Beliefs(
        joints={**{name: np.full(count, value) for name, value in held.items()}, **draws},
        names=names,
        scale=np.stack(scale, axis=1),
        precision=np.linalg.inv(np.cov(np.array(relative))),
        box=box({name: _bounds(posterior[name], means[name]) for name in names}),
        laws=laws,
    )


def _bounds(values: xr.DataArray, mean: float) -> Range:
    """Box of a parameter where the run says it, else a wide one."""
    if "lower" in values.attrs and "upper" in values.attrs:
        return float(values.attrs["lower"]), float(values.attrs["upper"])
    return _rising((mean / UNBOUNDED, mean * UNBOUNDED))
