"""jbw identifies bolted joints from vibration measurements.

The public names below load on first use, so `import jbw` is quick and changes no global state.
Results need float64: call `jbw.enable_x64()` before any array is made.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jbw import rig
    from jbw.campaign.loading import Campaign, load_campaign
    from jbw.errors import ConfigError, DataError, JbwError, ModelError, RunError
    from jbw.identification.linear import line_fit, pool
    from jbw.measurement.files.door import read
    from jbw.measurement.harmonics import harmonics
    from jbw.measurement.probing import third_order_kernel
    from jbw.measurement.records import Record, Test
    from jbw.measurement.spectra import frf
    from jbw.oscillator.backbone import backbone, frequency_response
    from jbw.oscillator.continuation import response_curve
    from jbw.oscillator.hysteresis import hysteresis_map, hysteresis_rate, steady_loop
    from jbw.oscillator.parameters import BoucWen
    from jbw.oscillator.response import Response, simulate
    from jbw.oscillator.restoring import Cubic, Polynomial
    from jbw.oscillator.smoothing import smoothing
    from jbw.oscillator.steady import steady_cycle, steady_state
    from jbw.oscillator.volterra import h1, h3, third_harmonic
    from jbw.planning.making import plan_tests
    from jbw.study.calibration import sbc
    from jbw.study.comparing import compare
    from jbw.study.identifiability import identifiability
    from jbw.study.identify import identify
    from jbw.study.study import Study, load_study

__version__ = "0.1.0"

# Public name to its home, read only when the name is first used.
_HOME = {
    "BoucWen": "oscillator.parameters",
    "Campaign": "campaign.loading",
    "ConfigError": "errors",
    "Cubic": "oscillator.restoring",
    "DataError": "errors",
    "JbwError": "errors",
    "ModelError": "errors",
    "Polynomial": "oscillator.restoring",
    "Record": "measurement.records",
    "Response": "oscillator.response",
    "RunError": "errors",
    "Study": "study.study",
    "Test": "measurement.records",
    "backbone": "oscillator.backbone",
    "compare": "study.comparing",
    "frequency_response": "oscillator.backbone",
    "frf": "measurement.spectra",
    "h1": "oscillator.volterra",
    "h3": "oscillator.volterra",
    "harmonics": "measurement.harmonics",
    "hysteresis_map": "oscillator.hysteresis",
    "hysteresis_rate": "oscillator.hysteresis",
    "identifiability": "study.identifiability",
    "identify": "study.identify",
    "line_fit": "identification.linear",
    "load_campaign": "campaign.loading",
    "load_study": "study.study",
    "plan_tests": "planning.making",
    "pool": "identification.linear",
    "read": "measurement.files.door",
    "response_curve": "oscillator.continuation",
    "sbc": "study.calibration",
    "simulate": "oscillator.response",
    "smoothing": "oscillator.smoothing",
    "steady_cycle": "oscillator.steady",
    "steady_loop": "oscillator.hysteresis",
    "steady_state": "oscillator.steady",
    "third_harmonic": "oscillator.volterra",
    "third_order_kernel": "measurement.probing",
}

__all__ = [
    "BoucWen",
    "Campaign",
    "ConfigError",
    "Cubic",
    "DataError",
    "JbwError",
    "ModelError",
    "Polynomial",
    "Record",
    "Response",
    "RunError",
    "Study",
    "Test",
    "backbone",
    "compare",
    "enable_x64",
    "frequency_response",
    "frf",
    "h1",
    "h3",
    "harmonics",
    "hysteresis_map",
    "hysteresis_rate",
    "identifiability",
    "identify",
    "line_fit",
    "load_campaign",
    "load_study",
    "plan_tests",
    "pool",
    "read",
    "response_curve",
    "rig",
    "sbc",
    "simulate",
    "smoothing",
    "steady_cycle",
    "steady_loop",
    "steady_state",
    "third_harmonic",
    "third_order_kernel",
]


def enable_x64() -> None:
    """Switch JAX to float64 for this process; jbw never does it by itself."""
    import jax

    jax.config.update("jax_enable_x64", True)


def __getattr__(name: str) -> Any:
    if name == "rig":
        return import_module("jbw.rig")
    if name in _HOME:
        return getattr(import_module(f"jbw.{_HOME[name]}"), name)
    raise AttributeError(f"module 'jbw' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
