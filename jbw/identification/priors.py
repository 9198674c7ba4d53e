"""Prior boxes: the campaign's where it states them, otherwise wide ones about the earlier steps."""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from jbw.errors import ConfigError
from jbw.inference.box import Box, box

# Half widths of the paper's boxes about the initial fit, read from the CVs of its priors.
PAPER_HALF_WIDTH = {"zeta": 0.20, "alpha": 0.163, "delta": 0.20, "gamma": 0.41}

Bounds = dict[str, tuple[float, float]]


def stated(settings: Mapping[str, Any]) -> Bounds:
    """Bounds of the campaign's [identify.prior] table."""
    return {
        name: (float(low), float(high)) for name, (low, high) in settings.get("prior", {}).items()
    }


def physical(omega_n: float, zeta: float, y_peak: float) -> Bounds:
    r"""Wide bounds on the joint from scales alone.

    Softening and opening matter where $\delta Y$ and $\gamma Y$ are of order one; alpha is a part
    of $\omega_n^2$. Gamma may not exceed delta by so much that the loop is unbounded.

    Args:
        omega_n: Natural frequency of Step 2 [rad/s].
        zeta: Damping ratio of Step 2 [-].
        y_peak: Largest displacement measured [m].

    Returns:
        Bounds of zeta, alpha, delta and gamma.
    """
    return {
        "zeta": (0.2 * zeta, 3.0 * zeta),
        "alpha": (0.002 * omega_n**2, 0.5 * omega_n**2),
        "delta": (0.01 / y_peak, 20.0 / y_peak),
        "gamma": (0.0, 20.0 / y_peak),
    }


def about(centre: Mapping[str, float], half_width: Mapping[str, float]) -> Bounds:
    """The paper's kind of box: a share of the initial fit to either side."""
    return {
        name: (centre[name] * (1 - share), centre[name] * (1 + share))
        for name, share in half_width.items()
        if name in centre
    }


def joint_box(
    settings: Mapping[str, Any],
    omega_n: float,
    zeta: float,
    gain: tuple[float, float] | None,
    y_peak: float,
    *,
    linear: bool = True,
) -> Box:
    """Box of the joint route: all parameters of the joint, and the gain.

    Args:
        settings: The campaign's [identify] table.
        omega_n: Natural frequency of Step 2 [rad/s].
        zeta: Damping ratio of Step 2 [-].
        gain: Gain of Step 2 and its standard deviation, or None when it is held at one
            (a known gain or modal mass).
        y_peak: Largest displacement measured [m].
        linear: Whether omega_n and zeta were read where the joint hardly slips. At a high level
            they hold its softening and its losses, and tell the oscillator's own only roughly.

    Returns:
        The box, in the order omega_n, zeta, alpha, delta, gamma(, gain)(, cubic); a cubic stiffness
        is there when the campaign bounds it.

    Raises:
        ConfigError: The campaign's bounds of alpha reach the whole stiffness.
    """
    bounds: Bounds = {"omega_n": (0.97 * omega_n, 1.03 * omega_n)}
    bounds |= physical(omega_n, zeta, y_peak)
    if not linear:
        bounds |= {"omega_n": (0.7 * omega_n, 1.5 * omega_n), "zeta": (0.005 * zeta, 3.0 * zeta)}
    if gain is not None:
        reach = max(0.1 * gain[0], 8 * gain[1]) if np.isfinite(gain[1]) else 0.5 * gain[0]
        bounds["gain"] = (gain[0] - reach, gain[0] + reach)
    given = stated(settings)
    if "cubic" in given:
        bounds["cubic"] = given["cubic"]
    bounds = {name: given.get(name, pair) for name, pair in bounds.items()}
    _require_stiffness(bounds, omega_n)
    _warn_of_growth(bounds)
    return box(bounds)


def _require_stiffness(bounds: Bounds, omega_n: float) -> None:
    """Refuse a prior beyond alpha = omega_n^2, where nothing holds the structure in its place."""
    highest = bounds["alpha"][1]
    if highest >= omega_n**2:
        raise ConfigError(
            f"Prior of `alpha`: alpha < omega_n^2 must hold, but alpha reaches {highest:g} and "
            f"omega_n^2 is {omega_n**2:g} by Step 2.",
            why="The joint's stiffness alpha is a part of the whole, omega_n^2.",
            remedy="Lower alpha's upper bound in [identify.prior].",
        )


def _warn_of_growth(bounds: Bounds) -> None:
    """Warn where the law lets the hysteretic force grow for ever: measured joints may need it."""
    lowest = bounds["gamma"][0] + bounds["delta"][0]
    if lowest < 0:
        warnings.warn(
            f"The prior lets gamma + delta fall to {lowest:.4g} 1/m, where the hysteretic force "
            "grows without bound; draws that diverge count as failed solves. Raise the lower bound "
            "of gamma above -delta unless that is meant.",
            stacklevel=3,
        )
