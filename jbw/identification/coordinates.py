"""In which parameters the joint posterior lives, and within which bounds."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jbw.identification.priors import joint_box, stated
from jbw.identification.starts import largest_displacement
from jbw.inference.box import Box, box
from jbw.inference.fitting import Fit
from jbw.observables.evidence import Evidence
from jbw.observables.linear import LineReading
from jbw.observables.loops import Loops

SHARE = (0.002, 0.9)  # of the stiffness: from a joint that hardly carries to nearly all of it
FORCED_SHARE = (0.01, 1.0)  # under a prescribed displacement nothing else need carry at all
REACH = 4.0  # times a fitted product: where it is looked for


def box_of(settings: Mapping[str, Any], data: Evidence, known: Mapping[str, float]) -> Box:
    """Box of the joint route: the joint's parameters, and the gain, where they are not held.

    Args:
        settings: The campaign's [identify] table.
        data: The evidence.
        known: First values of omega_n, zeta and gain.

    Returns:
        The box, the campaign's own bounds where it states them.
    """
    given = stated(settings)
    forced = all(isinstance(part, Loops) for part in data.parts)
    omega_n = known.get("omega_n") or stiffest(data) ** 0.5
    zeta = known.get("zeta", 0.01)
    y_peak = largest_displacement(data, omega_n)
    gain = None if "gain" in data.held else (known["gain"], _gain_std(data))
    linear = any(isinstance(part, LineReading) for part in data.parts)
    prior = joint_box(settings, omega_n, zeta, gain, y_peak, linear=linear)
    bounds = {
        name: (float(low), float(high))
        for name, low, high in zip(prior.names, prior.lower, prior.upper, strict=True)
        if name not in data.held
    }
    if forced:
        wide = {
            "omega_n": (0.2 * omega_n, 2.0 * omega_n),
            "alpha": tuple(share * omega_n**2 for share in FORCED_SHARE),
        }
        bounds |= {name: pair for name, pair in wide.items() if name not in given}
    return box(bounds)


def stiffest(data: Evidence) -> float:
    """Force over displacement of the stiffest loop, peak to peak, per unit mass [1/s^2]."""
    found = []
    for part in data.parts:
        if isinstance(part, Loops):
            gain = float(data.held.get("gain", 1.0))
            force = np.ptp(np.asarray(part.mean), axis=1)
            found += list(gain * force / np.ptp(np.asarray(part.displacement), axis=1))
    return float(max(found))


def _gain_std(data: Evidence) -> float:
    """Standard deviation of the gain as a line fit knows it; infinite without one."""
    known = [part for part in data.parts if isinstance(part, LineReading)]
    return float(np.sqrt(known[0].covariance[2, 2])) if known else float("inf")


def by_products(best: Fit, settings: Mapping[str, Any]) -> bool:
    """Whether to sample in the products alpha delta and alpha gamma: where no more is known.

    A campaign says so by `coordinates`; otherwise, where it bounds none of the three itself.
    """
    asked = settings.get("coordinates", "auto")
    if asked != "auto" or "share" in best.theta:
        return asked == "products" and "share" not in best.theta
    bounded = {"alpha", "delta", "gamma"} & set(stated(settings))
    weak = set() if best.weak is None else {"alpha", "delta", "gamma"} & set(best.weak.names)
    return bool(weak) and not bounded


def products_of(theta: Mapping[str, float]) -> dict[str, float]:
    r"""The same point as softening, opening and share, $\alpha\delta/\omega_n^2$ and so on."""
    square = theta["omega_n"] ** 2
    rest = {name: v for name, v in theta.items() if name not in ("alpha", "delta", "gamma")}
    return {
        **rest,
        "softening": theta["alpha"] * theta["delta"] / square,
        "opening": theta["alpha"] * theta["gamma"] / square,
        "share": theta["alpha"] / square,
    }


def product_box(prior: Box, theta: Mapping[str, float], settings: Mapping[str, Any]) -> Box:
    """Box of the products about a fit, that of the other parameters kept.

    Args:
        prior: The box of the paper's parameters; where it lets delta or gamma be negative, so may
            be their products.
        theta: The fit.
        settings: The campaign's [identify] table, whose bounds on alpha bound its share.
    """
    found = products_of(theta)
    bounds = {
        name: (float(low), float(high))
        for name, low, high in zip(prior.names, prior.lower, prior.upper, strict=True)
    }
    largest = REACH * max(abs(found["softening"]), abs(found["opening"]))
    del bounds["alpha"]
    products = {
        product: (-largest if bounds.pop(factor)[0] < 0 else 0.0, largest)
        for product, factor in (("softening", "delta"), ("opening", "gamma"))
    }
    alpha = stated(settings).get("alpha")
    square = theta["omega_n"] ** 2
    products["share"] = SHARE if alpha is None else (alpha[0] / square, alpha[1] / square)
    front = {name: bounds[name] for name in ("omega_n", "zeta") if name in bounds}
    return box({**front, **products, **{n: b for n, b in bounds.items() if n not in front}})
