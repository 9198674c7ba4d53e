"""jbw identifies bolted joints from vibration measurements.

The public names below load on first use, so `import jbw` is quick and changes no global state.
Results need float64: call `jbw.enable_x64()` before any array is made.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jbw import rig
    from jbw.campaign.load import Campaign, load_campaign
    from jbw.errors import ConfigError, DataError, JbwError, ModelError, RunError
    from jbw.identification.linear import line_fit, pool
    from jbw.measurement.files.read import read
    from jbw.measurement.harmonics import harmonics
    from jbw.measurement.probing import third_order_kernel
    from jbw.measurement.records import Record, Test
    from jbw.measurement.spectra import frf
    from jbw.oscillator import laws
    from jbw.oscillator.laws.hysteresis import hysteresis_map, hysteresis_rate, steady_loop
    from jbw.oscillator.laws.springs import Cubic, Polynomial
    from jbw.oscillator.oscillator import BoucWen, Oscillator
    from jbw.oscillator.paper.kernels import h1, h3, third_harmonic
    from jbw.oscillator.paper.smoothing import smoothing
    from jbw.oscillator.response import Response, simulate
    from jbw.oscillator.steady.backbone import backbone, frequency_response
    from jbw.oscillator.steady.continuation import response_curve
    from jbw.oscillator.steady.cycle import steady_cycle, steady_state
    from jbw.planning.making import plan_tests
    from jbw.study.calibration import sbc
    from jbw.study.compare import compare
    from jbw.study.identifiability import identifiability
    from jbw.study.identify import identify
    from jbw.study.study import Study, load_study

__version__ = "0.1.0"

# Public name to its home, read only when the name is first used.
_HOME = {
    "BoucWen": "oscillator.oscillator",
    "Campaign": "campaign.load",
    "ConfigError": "errors",
    "Cubic": "oscillator.laws.springs",
    "DataError": "errors",
    "JbwError": "errors",
    "ModelError": "errors",
    "Oscillator": "oscillator.oscillator",
    "Polynomial": "oscillator.laws.springs",
    "Record": "measurement.records",
    "Response": "oscillator.response",
    "RunError": "errors",
    "Study": "study.study",
    "Test": "measurement.records",
    "backbone": "oscillator.steady.backbone",
    "compare": "study.compare",
    "frequency_response": "oscillator.steady.backbone",
    "frf": "measurement.spectra",
    "h1": "oscillator.paper.kernels",
    "h3": "oscillator.paper.kernels",
    "harmonics": "measurement.harmonics",
    "hysteresis_map": "oscillator.laws.hysteresis",
    "hysteresis_rate": "oscillator.laws.hysteresis",
    "identifiability": "study.identifiability",
    "identify": "study.identify",
    "line_fit": "identification.linear",
    "load_campaign": "campaign.load",
    "load_study": "study.study",
    "plan_tests": "planning.making",
    "pool": "identification.linear",
    "read": "measurement.files.read",
    "response_curve": "oscillator.steady.continuation",
    "sbc": "study.calibration",
    "simulate": "oscillator.response",
    "smoothing": "oscillator.paper.smoothing",
    "steady_cycle": "oscillator.steady.cycle",
    "steady_loop": "oscillator.laws.hysteresis",
    "steady_state": "oscillator.steady.cycle",
    "third_harmonic": "oscillator.paper.kernels",
    "third_order_kernel": "measurement.probing",
}

# Rooms that are public as a whole.
_ROOMS = {"laws": "jbw.oscillator.laws", "rig": "jbw.rig"}

__all__ = [
    "BoucWen",
    "Campaign",
    "ConfigError",
    "Cubic",
    "DataError",
    "JbwError",
    "ModelError",
    "Oscillator",
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
    "laws",
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
    if name in _ROOMS:
        return import_module(_ROOMS[name])
    if name in _HOME:
        return getattr(import_module(f"jbw.{_HOME[name]}"), name)
    raise AttributeError(f"module 'jbw' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
