r"""The joints considered possible: by ranges before any test, by the posterior after a run.

The joint is only guessed, and what a test tells depends on it. So every number of a plan is made
at several joints, and judged by the worst of ten.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from scipy.stats import qmc

from jbw.errors import ConfigError, DataError
from jbw.inference.space.box import Box, bounds_about, box
from jbw.oscillator.laws import laws_named, quantities_of
from jbw.oscillator.modes.parameters import NAMES, own_quantities
from jbw.quantities import DEFAULT_LAWS, MODAL
from jbw.verification.predictive_basis import Draws, laws_of_run, parameter_names, thin

# A single value is known to a factor of two; the natural frequency, which a tap shows, far better.
REACH = {"omega_n": 1.1}
FACTOR = 2.0
Range = tuple[float, float]
UNBOUNDED = 10.0  # factor to either side, where a posterior tells nothing of its prior's box


class Mode(NamedTuple):
    """A mode at every joint that is held possible."""

    omega: Float[np.ndarray, " joint"]  # natural frequency [rad/s]
    h: Float[np.ndarray, " joint"]  # motion of the joint over that of the response; 1 of the first


@dataclass(frozen=True)
class Beliefs:
    """Joints that are held possible, and what is known before the test."""

    joints: Draws  # all parameters and `gain`, one value a joint, in their units
    names: tuple[str, ...]  # those that are inferred
    scale: Float[np.ndarray, "joint parameter"]  # units of their relative changes
    precision: Float[np.ndarray, "parameter parameter"]  # known of the relative changes [-]
    box: Box  # of the inferred parameters, for telling what stays undetermined
    laws: tuple[str, ...] = DEFAULT_LAWS

    @property
    def num_joints(self) -> int:
        """How many joints."""
        return len(self.scale)

    def joint_by_joint(self) -> Iterator[dict[str, Array]]:
        """Yield every joint's parameters by name."""
        for i in range(self.num_joints):
            yield {name: jnp.asarray(values[i]) for name, values in self.joints.items()}


def modes_of(joints: Mapping[str, np.ndarray]) -> list[Mode]:
    """Return each mode's natural frequency, and its motion of the joint over the first mode's."""
    omega_n = np.asarray(joints["omega_n"])
    modes = [Mode(omega_n, np.ones_like(omega_n))]
    for names in NAMES:
        if names.omega in joints:
            h = np.abs(joints.get(names.shape, np.ones_like(omega_n)))
            modes.append(Mode(np.asarray(joints[names.omega]), h))
    return modes


def shares_of(laws: tuple[str, ...]) -> dict[str, str]:
    """Return the names of stiffnesses as a share of omega_n^2, each with its law's stiffness."""
    return {
        monomial.name: name
        for law in laws_named(laws)
        for coordinates in law.coordinates.values()
        for monomial in coordinates.inverse
        for name in law.names()
        if monomial.powers == {name: 1, "omega_n": -2}
    }


def usual_of(laws: tuple[str, ...]) -> dict[str, tuple[str, Range]]:
    """Return the parameters that a default stands for: what they are parts of, and which parts."""
    return {name: part for law in laws_named(laws) for name, part in law.usual.items()}


def ranges_of(
    omega_n: Range, stated: Mapping[str, Range | None], laws: tuple[str, ...]
) -> dict[str, Range]:
    """Return ranges of all the joint's parameters, the usual ranges where nothing is stated."""
    ranges = {"omega_n": omega_n, "zeta": stated["zeta"]}
    share_of = {stiffness: share for share, stiffness in shares_of(laws).items()}
    usual = usual_of(laws)
    for name in (quantity.name for quantity in quantities_of(laws)):
        share = share_of.get(name, "")
        if stated[name] is not None:
            ranges[name] = stated[name]
        elif share:
            ranges[share] = stated[share] or usual[name][1]
        else:
            reference, (least, most) = usual[name]
            low, high = sorted(map(abs, ranges[reference]))
            ranges[name] = least * low, most * high
    return ranges


def before(
    ranges: Mapping[str, Range],
    *,
    held: Mapping[str, float],
    num_joints: int,
    seed: int,
    laws: tuple[str, ...] = DEFAULT_LAWS,
) -> Beliefs:
    r"""Build beliefs from ranges, each uniform in the logarithm of its parameter.

    $$\mathrm{sd}(\log\theta) = \log(\theta_{max} / \theta_{min}) / \sqrt{12}$$

    A range without width is a guess: joints are drawn at it, and the prior reaches a factor of two
    to either side (a tenth for omega_n). A share of omega_n^2 may stand for a law's stiffness, as
    `share` does for alpha. What is known exactly, such as `gain`, is `held`; joints are drawn by a
    Latin hypercube.
    """
    wide = {}
    for name, (low, high) in ranges.items():
        if not (low * high > 0 and low <= high):
            raise ConfigError(
                f"Range `{name}` must be [lower, upper] of one sign, but is [{low:g}, {high:g}].",
                why="A coefficient of variation needs a value that cannot be zero.",
                remedy="Bound it away from zero.",
            )
        factor = REACH.get(name, FACTOR) if low == high else 1.0
        wide[name] = low / factor, high * factor
    unit = qmc.LatinHypercube(len(ranges), rng=np.random.default_rng(seed)).random(num_joints)
    drawn = {
        name: low * (high / low) ** x
        for (name, (low, high)), x in zip(ranges.items(), unit.T, strict=True)
    }
    std = np.array([np.log(abs(b / a)) for a, b in wide.values()]) / np.sqrt(12)
    covariance, inferred = np.diag(std**2), list(ranges)
    for share, stiffness in shares_of(laws).items():
        if share in ranges:
            drawn[stiffness] = drawn.pop(share) * drawn["omega_n"] ** 2
            low, high = wide[share]
            wide[stiffness] = (low * wide["omega_n"][0] ** 2, high * wide["omega_n"][1] ** 2)
            # log stiffness = log share + 2 log omega_n
            to_stiffness = np.eye(len(inferred))
            to_stiffness[inferred.index(share), inferred.index("omega_n")] = 2.0
            covariance = to_stiffness @ covariance @ to_stiffness.T
            inferred[inferred.index(share)] = stiffness
    names = tuple(name for name in parameter_names(laws) if name in inferred)
    order = [inferred.index(name) for name in names]
    fixed = {name: np.full(num_joints, value) for name, value in held.items()}
    return Beliefs(
        joints={**fixed, **drawn},
        names=names,
        scale=np.stack([drawn[name] for name in names], axis=1),
        precision=np.linalg.inv(covariance[np.ix_(order, order)]),
        box=box({name: (min(wide[name]), max(wide[name])) for name in names}),
        laws=laws,
    )


def after(tree: xr.DataTree, *, held: Mapping[str, float], num_joints: int) -> Beliefs:
    """Build beliefs from evenly spaced draws of a run's main posterior and from its held values."""
    laws, posterior = laws_of_run(tree), tree["posterior"].to_dataset()
    names = parameter_names(laws)
    needed = [name for name in names if name != "gain"]
    missing = [name for name in needed if name not in posterior and name not in held]
    if missing:
        raise DataError(
            f"The main posterior must hold all of {', '.join(needed)}, but lacks "
            f"{', '.join(missing)}.",
            why="Without them no new test can be predicted.",
            remedy="Plan from ranges: jbw plan PLAN.toml.",
        )
    if held.get("zeta") == 0.0:
        raise DataError(
            "Damping `zeta` must be positive to plan from a run, but this one holds it at 0.",
            why="Loops under prescribed displacement do not determine the joint's free motion.",
            remedy="Plan from ranges: jbw plan PLAN.toml.",
        )
    modal = (quantity.name for quantity in (*MODAL, *own_quantities(laws)))
    names = tuple(name for name in (*names, *modal) if name in posterior)
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
    """Return a parameter's box as the run states it, else a wide box about the mean."""
    if "lower" in values.attrs and "upper" in values.attrs:
        return float(values.attrs["lower"]), float(values.attrs["upper"])
    return bounds_about(mean, 1 / UNBOUNDED, UNBOUNDED)
