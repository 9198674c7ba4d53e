"""The check of a user's law before its first use."""

from collections.abc import Iterable
from importlib import import_module
from typing import Any

# This module is loaded only for a user's law, because it needs modules that build on the laws.
CONTRACT = "jbw.oscillator.contract"


def require_contract(kinds: Iterable[type]) -> None:
    """Raise if the methods of a user's law disagree; check each law class only once.

    Raises:
        ConfigError: A method disagrees with the law's force and rate.
    """
    guests = [kind for kind in kinds if not kind.__module__.startswith("jbw.")]
    if guests:
        contract: Any = import_module(CONTRACT)
        contract.require_contract(guests)
