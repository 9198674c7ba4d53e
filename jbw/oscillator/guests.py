"""The check of laws from outside jbw, which runs before they are used."""

from collections.abc import Iterable
from importlib import import_module
from typing import Any

# This module is loaded only for a law from outside: it solves for motions, in modules above the
# laws.
CONTRACT = "jbw.oscillator.contract"


def require_contract(kinds: Iterable[type]) -> None:
    """Raise if a law class from outside jbw breaks its contract; check each class only once.

    Raises:
        ConfigError: A method disagrees with the law's force and rate.
    """
    guests = [kind for kind in kinds if not kind.__module__.startswith("jbw.")]
    if guests:
        contract: Any = import_module(CONTRACT)
        contract.require_contract(guests)
