r"""Possible joints for a plan: from ranges before any test, from the posterior after a run.

The information of a test depends on the joint, which is not known yet. Therefore every number of a
plan is computed for several possible joints, and the wanted accuracy must be reached for nine
joints in ten.
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
from jbw.inference.posterior.summary import posterior_draws
from jbw.inference.space.box import Box, bounds_about, box
from jbw.oscillator.laws import laws_named, quantities_of
from jbw.oscillator.modes.parameters import NAMES, own_quantities
from jbw.quantities import DEFAULT_LAWS, MODAL
from jbw.results.attributes import StoredVariable
from jbw.verification.predictive_basis import Draws, laws_of_run, parameter_names, thin

# Factor by which a single stated value may be wrong. It is two, but much less for the natural
# frequency, because a hammer tap shows it.
REACH = {"omega_n": 1.1}
FACTOR = 2.0
Range = tuple[float, float]
# If a posterior does not state its prior's bounds, these are the mean divided by this factor and
# the mean multiplied by it.
UNBOUNDED = 10.0


class Mode(NamedTuple):
    """One mode of the structure, with one value per drawn joint."""

    omega: Float[np.ndarray, " joint"]  # natural frequency [rad/s]
    # motion of the joint per unit response, relative to that in the first mode
    h: Float[np.ndarray, " joint"]


@dataclass(frozen=True)
class Beliefs:
    """The joints drawn for a plan, and the knowledge of their parameters before any test."""

    # values of all parameters and of `gain` for every drawn joint, in the units of the parameters
    joints: Draws
    names: tuple[str, ...]  # names of the inferred parameters
    # divisor that makes changes of each parameter relative
    scale: Float[np.ndarray, "joint parameter"]
    # inverse of the prior covariance of changes that are divided by `scale`
    precision: Float[np.ndarray, "parameter parameter"]
    # prior bounds of the inferred parameters: a plan compares its accuracy with these bounds
    box: Box
    laws: tuple[str, ...] = DEFAULT_LAWS

    @property
    def num_joints(self) -> int:
        """The number of drawn joints, each of which may be the true one."""
        return len(self.scale)

    @property
    def omega_n(self) -> Float[np.ndarray, " joint"]:
        """The natural frequency of every drawn joint [rad/s]."""
        return np.asarray(self.joints["omega_n"])

    @property
    def gain(self) -> Float[np.ndarray, " joint"]:
        """The size of the gain; its sign does not change the motion."""
        return np.abs(self.joints["gain"])

    def joint_by_joint(self) -> Iterator[dict[str, Array]]:
        """Yield the parameters of each drawn joint in turn, by name."""
        for i in range(self.num_joints):
            yield {name: jnp.asarray(values[i]) for name, values in self.joints.items()}


def modes_of(joints: Mapping[str, np.ndarray]) -> list[Mode]:
    """Return each mode's natural frequency and the relative motion of the joint in it."""
    omega_n = np.asarray(joints["omega_n"])
    modes = [Mode(omega_n, np.ones_like(omega_n))]
    for names in NAMES:
        if names.omega in joints:
            h = np.abs(joints.get(names.shape, np.ones_like(omega_n)))
            modes.append(Mode(np.asarray(joints[names.omega]), h))
    return modes


def shares_of(laws: tuple[str, ...]) -> dict[str, str]:
    """Return names of parameters that are shares of omega_n^2, with the stiffness of each."""
    return {
        monomial.name: name
        for law in laws_named(laws)
        for coordinates in law.coordinates.values()
        for monomial in coordinates.inverse
        for name in law.names()
        if monomial.powers == {name: 1, "omega_n": -2}
    }


def usual_of(laws: tuple[str, ...]) -> dict[str, tuple[str, Range]]:
    """Return the default ranges of those parameters that scale with other parameters."""
    return {name: part for law in laws_named(laws) for name, part in law.usual.items()}


def ranges_of(
    omega_n: Range, stated: Mapping[str, Range | None], laws: tuple[str, ...]
) -> dict[str, Range]:
    """Return the ranges of all parameters of a joint, stated or default."""
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
    r"""Return joints drawn from ranges of their parameters, uniformly in the logarithms.

    $$\mathrm{sd}(\log\theta) = \log(\theta_{max} / \theta_{min}) / \sqrt{12}$$

    A range without width is a guess: joints are drawn at it, and the prior extends by a factor of
    two to either side (a tenth for omega_n). A share of omega_n^2 may replace a law's stiffness, as
    `share` does for alpha. Exactly known values, such as `gain`, are `held`. Joints are drawn by a
    Latin hypercube.
    """
    wide = {}
    for name, (low, high) in ranges.items():
        if not (low * high > 0 and low <= high):
            raise ConfigError(
                f"Range `{name}` must be [lower, upper] of one sign, but is [{low:g}, {high:g}].",
                why="A coefficient of variation needs a value that cannot be zero.",
                remedy="Choose bounds on one side of zero.",
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
            # The logarithm of the stiffness is that of its share plus 2 log omega_n.
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
    """Return joints drawn from the main posterior of a run."""
    laws, posterior = laws_of_run(tree), posterior_draws(tree)
    names = parameter_names(laws)
    needed = [name for name in names if name != "gain"]
    missing = [name for name in needed if name not in posterior and name not in held]
    if missing:
        raise DataError(
            f"The main posterior must contain {', '.join(needed)}, but lacks {', '.join(missing)}.",
            why=f"Without {', '.join(missing)} no new test can be predicted.",
            remedy="Plan from ranges: jbw plan PLAN.toml.",
        )
    if held.get("zeta") == 0.0:
        raise DataError(
            "To plan from a run, `zeta` must be positive, but this run fixes it at 0.",
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
    """Return a parameter's prior bounds, as the run states them, or a wide range about the mean."""
    return StoredVariable.of(values).bounds or bounds_about(mean, 1 / UNBOUNDED, UNBOUNDED)
