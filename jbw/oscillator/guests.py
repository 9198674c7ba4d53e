"""Laws from outside of jbw, which are tried before they are used."""

from collections.abc import Iterable
from importlib import import_module
from typing import Any

# Loaded for a law from outside alone: it solves for motions, which stand above the laws.
CONTRACT = "jbw.oscillator.contract"


def require_contract(kinds: Iterable[type]) -> None:
    """Raise where a law from outside does not keep its contract, which is tried once a class.

    Raises:
        ConfigError: A method disagrees with the law's force and rate.
    """
    guests = [kind for kind in kinds if not kind.__module__.startswith("jbw.")]
    if guests:
        contract: Any = import_module(CONTRACT)
        contract.require_contract(guests)
