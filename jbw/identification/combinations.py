"""Combinations of the joint's parameters that data know better than the parameters themselves."""

from collections.abc import Iterable

from jbw.inference.powers import Product

FACTORS = {"alpha_delta": ("alpha", "delta"), "alpha_gamma": ("alpha", "gamma")}
# Of the box's parameters, in the paper's coordinates and in those of `jbw.observables.joint`.
PAPER = {
    "alpha_delta": {"alpha": 1.0, "delta": 1.0},
    "alpha_gamma": {"alpha": 1.0, "gamma": 1.0},
}
BY_PRODUCTS = {
    "alpha": {"share": 1.0, "omega_n": 2.0},
    "delta": {"softening": 1.0, "share": -1.0},
    "gamma": {"opening": 1.0, "share": -1.0},
    "alpha_delta": {"softening": 1.0, "omega_n": 2.0},
    "alpha_gamma": {"opening": 1.0, "omega_n": 2.0},
}


def combinations(names: Iterable[str]) -> tuple[Product, ...]:
    r"""The products $\alpha\delta$ and $\alpha\gamma$, and the paper's parameters if not sampled.

    Weak motion knows the joint by these alone: its softening and its losses.

    Args:
        names: Parameters of the box.

    Returns:
        Those combinations whose parameters are all in the box.
    """
    present = set(names)
    table = BY_PRODUCTS if "share" in present else PAPER
    return tuple(
        Product(name, name.replace("_", "*"), powers, FACTORS.get(name, ()))
        for name, powers in table.items()
        if powers.keys() <= present
    )
