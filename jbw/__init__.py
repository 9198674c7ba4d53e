"""jbw identifies bolted joints from vibration measurements.

The public names below load on first use, so `import jbw` is quick and changes no global state.
Results need float64: call `jbw.enable_x64()` before any array is made.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jbw.errors import ConfigError, DataError, JbwError, ModelError, RunError
    from jbw.oscillator.parameters import BoucWen

__version__ = "0.1.0"

_HOME = {
    "BoucWen": "jbw.oscillator.parameters",
    "ConfigError": "jbw.errors",
    "DataError": "jbw.errors",
    "JbwError": "jbw.errors",
    "ModelError": "jbw.errors",
    "RunError": "jbw.errors",
}

__all__ = ["BoucWen", "ConfigError", "DataError", "JbwError", "ModelError", "RunError", "enable_x64"]


def enable_x64() -> None:
    """Switch JAX to float64 for this process; jbw never does it by itself."""
    import jax

    jax.config.update("jax_enable_x64", True)


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'jbw' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
