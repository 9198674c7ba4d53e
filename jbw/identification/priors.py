"""Prior boxes: the campaign's where it states them, otherwise wide ones from scales alone."""

import warnings

import numpy as np

from jbw.campaign.settings import Identify
from jbw.errors import ConfigError
from jbw.inference.space.box import Box, box
from jbw.oscillator.law import Bounds, Law, Scales
from jbw.oscillator.laws import laws_named
from jbw.oscillator.oscillator import prior_of


def stated(settings: Identify) -> Bounds:
    """Bounds of the campaign's [identify.prior] table."""
    return {name: (float(low), float(high)) for name, (low, high) in settings.prior.items()}


def joint_box(
    settings: Identify,
    omega_n: float,
    zeta: float,
    gain: tuple[float, float] | None,
    y_peak: float,
    *,
    laws: tuple[str, ...] = ("bouc_wen",),
    linear: bool = True,
    forced: bool = False,
) -> Box:
    """Box of the joint route: all parameters of the joint, and the gain.

    Args:
        settings: The campaign's [identify] table.
        omega_n: Natural frequency of Step 2 [rad/s].
        zeta: Damping ratio of Step 2 [-].
        gain: Gain of Step 2 and its standard deviation, or None when it is held at one
            (a known gain or modal mass).
        y_peak: Largest displacement measured [m].
        laws: Names of the laws of the joint, whose own priors hold where nothing is stated.
        linear: Whether omega_n and zeta were read where the joint hardly slips. At a high level
            they hold its softening and its losses, and tell the oscillator's own only roughly.
        forced: Whether all tests prescribe the displacement.

    Returns:
        The box, in the order omega_n, zeta, parameters of the laws, gain.

    Raises:
        ConfigError: The campaign's bounds of a stiffness reach the whole stiffness.
    """
    given = stated(settings)
    bounds: Bounds = {"omega_n": (0.97 * omega_n, 1.03 * omega_n), "zeta": (0.2 * zeta, 3.0 * zeta)}
    if not linear:
        bounds |= {"omega_n": (0.7 * omega_n, 1.5 * omega_n), "zeta": (0.005 * zeta, 3.0 * zeta)}
    if forced:
        bounds["omega_n"] = (0.2 * omega_n, 2.0 * omega_n)
    bounds |= prior_of(laws, Scales(omega_n, zeta, y_peak, forced))
    if gain is not None:
        reach = max(0.1 * gain[0], 8 * gain[1]) if np.isfinite(gain[1]) else 0.5 * gain[0]
        bounds["gain"] = (gain[0] - reach, gain[0] + reach)
    bounds = {name: given.get(name, pair) for name, pair in bounds.items()}
    for law in laws_named(laws):
        own = {name: bounds[name] for name in law.names()}
        _require_stiffness(law, own, given, omega_n)
        if (caution := law.caution(own)) is not None:
            warnings.warn(caution, stacklevel=2)
    return box(bounds)


def _require_stiffness(law: type[Law], own: Bounds, given: Bounds, omega_n: float) -> None:
    """Refuse a prior within which the joint alone is stiffer than omega_n^2: nothing else holds."""
    least = {name: pair[0] for name, pair in own.items()}
    for name in own.keys() & given.keys():
        stiffness = float(law.build({**least, name: own[name][1]}).stiffness())
        if stiffness >= omega_n**2:
            raise ConfigError(
                f"Prior of `{name}`: {name} < omega_n^2 must hold, but {name} reaches "
                f"{own[name][1]:g} and omega_n^2 is {omega_n**2:g} by Step 2.",
                why="The joint's stiffness is a part of the whole, omega_n^2.",
                remedy=f"Lower {name}'s upper bound in [identify.prior].",
            )
