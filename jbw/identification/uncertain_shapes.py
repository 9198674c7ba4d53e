r"""Uncertain mode shapes of a model: a factor on the motion of each joint in each mode.

$$H_{ji} = f_{ji}\,H_{ji}^{model}, \qquad \ln f_{ji} \sim N(0, 0.1^2)$$

A factor that is common to all modes changes no motion, because the joint's law compensates it:

$$H_{ji} \to s\,H_{ji}, \qquad F_j(x) \to F_j(x/s)/s$$

Therefore one factor of the joints that share a law is fixed at 1: the one in their home mode, where
they have the largest energy share $k_jH_{ji}^2/\omega_i^2$ of all driven modes. Modes that no test
drives and residual modes keep the model's motion, and so does a joint in a mode that hardly moves
it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

from jbw.campaign.settings import Identify
from jbw.errors import ConfigError
from jbw.inference.density import Density
from jbw.inference.space.stated import StatedDensities
from jbw.observables.dataset import Dataset
from jbw.observables.modes import Modes
from jbw.oscillator.modes.assembled import OMEGA, STIFFNESS, factor_name, motion_name, numbered
from jbw.quantities import joints_of, motion_factors_in, name_at, split

SPREAD = 0.1  # prior standard deviation of the logarithm of a factor on a joint's motion in a mode
# A joint hardly moves in a mode if its share of the energy is below this fraction of the mode's
# largest share.
HARDLY_MOVED = 1e-4
Place = tuple[str, int]  # joint, and number of the mode, counted from 1


@cache
def shape_prior() -> Density:
    """Return the default prior of a factor on a joint's motion."""
    return Density("LogNormal", (0.0, SPREAD))


def home_modes(modes: Modes, laws: Sequence[str]) -> dict[str, Place]:
    """Return for each joint the pair (joint, mode) whose motion factor is fixed to one."""
    shares = _energy_shares(modes, joints_of(laws))
    homes: dict[str, Place] = {}
    for joints in dict.fromkeys(split(law)[1] for law in laws):
        places = [place for place in shares if place[0] in joints]
        home = max(places, key=lambda place: shares[place])
        homes |= dict.fromkeys(joints, home)
    return homes


def shape_factors(modes: Modes, laws: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the inferred factors; empty if the model's mode shapes are certain."""
    if not modes.uncertain:
        return ()
    shares = _energy_shares(modes, joints_of(laws))
    homes = set(home_modes(modes, laws).values())
    largest = {
        mode: max(share for (_, other), share in shares.items() if other == mode)
        for _, mode in shares
    }
    return tuple(
        factor_name(mode, joint)
        for (joint, mode), share in shares.items()
        if (joint, mode) not in homes and share > HARDLY_MOVED * largest[mode]
    )


def _energy_shares(modes: Modes, joints: Sequence[str]) -> dict[Place, float]:
    """Return the share of every joint in the strain energy of every driven mode."""
    numbers = dict(modes.numbers)
    return {
        (joint, mode): numbers[name_at(STIFFNESS, joint)]
        * (numbers[motion_name(mode, joint)] / numbers[numbered(OMEGA, mode)]) ** 2
        for joint in joints
        for mode in range(1, len(modes.hz) + 1)
    }


def first_factors(data: Dataset) -> dict[str, float]:
    """Return the starting values of the factors on joint motions: one, as in the model."""
    return {} if data.modes is None else dict.fromkeys(shape_factors(data.modes, data.laws), 1.0)


def with_shape_priors(modes: Modes, laws: Sequence[str], settings: Identify) -> Identify:
    """Return settings with a prior for each inferred factor, and without priors for the others.

    A prior that the campaign states is kept.
    """
    names, factors = shape_factors(modes, laws), motion_factors_in(settings.prior)
    stated = {n: x for n, x in settings.prior.items() if n in names or n not in factors}
    priors = dict.fromkeys(names, shape_prior())
    return settings.model_copy(update={"prior": {**priors, **stated}})


def with_stated_priors(settings: Identify, data: Dataset) -> Dataset:
    """Return data with the prior densities that the settings state for sampled parameters."""
    stated = {name: prior for name, prior in settings.prior.items() if name not in data.held}
    return replace(data, stated=StatedDensities.of(stated))


def require_inferred(modes: Modes, laws: Sequence[str], prior: Mapping[str, Any]) -> None:
    """Raise a ConfigError if a prior is stated for a motion factor that is not inferred.

    Raises:
        ConfigError: There is such a prior.
    """
    names = shape_factors(modes, laws)
    stated = [name for name in motion_factors_in(prior) if name not in names]
    if not stated:
        return
    if not modes.uncertain:
        raise ConfigError(
            f"[identify.prior] `{stated[0]}` needs uncertain mode shapes, but the campaign takes "
            "the mode shapes from the model.",
            remedy='Put under [structure]: `shapes = "uncertain"`, or leave the prior out.',
        )
    raise ConfigError(
        f"[identify.prior] `{stated[0]}` is not one of the inferred factors: "
        f"{', '.join(names) or 'none is inferred'}.",
        why="The motion of a joint is taken from the model in the joint's home mode, in modes that "
        "no test drives, and in modes that hardly move the joint.",
        remedy=f"Leave the prior of `{stated[0]}` out.",
    )
