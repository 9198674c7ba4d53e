"""What a run tells a plan: its posterior, its noise, its sampling and its largest motion."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from jbw.errors import ConfigError
from jbw.planning.prospects import Noise

RESPONSE_OF = {"m": "displacement", "m s-1": "velocity", "m s-2": "acceleration"}
INPUT_UNITS = ("V", "N", "N/kg")


@dataclass(frozen=True)
class Rig:
    """The rig that a run was measured on, as far as the run tells.

    Attributes:
        noise: Of the response; None where the run fitted no record in time.
        fs: Sampling frequency [Hz]; None where the run keeps no record.
        input_unit: Unit of the input; None where it is not told.
        y_peak: Largest displacement that was fitted [m]; None where it is not told.
        held: Parameters that were not inferred, such as a known gain.
    """

    noise: Noise | None
    fs: float | None
    input_unit: str | None
    y_peak: float | None
    held: Mapping[str, float]


def rig_of(tree: xr.DataTree) -> Rig:
    """What a run tells of its rig.

    Args:
        tree: The result, as `posterior.nc` holds it.
    """
    tests = list(_tests(tree))
    y_peak = float(tree.attrs.get("y_peak", 0.0))
    units = [str(test.attrs.get("level_unit", "")) for test in tests]
    seen = json.loads(str(tree.attrs.get("tests", "{}")))
    units += [str(facts.get("source", "")) for facts in seen.values()]
    rates = [
        1 / float(np.median(np.diff(test["time"])))
        for test in tests
        if test.sizes.get("time", 0) > 1
    ]
    return Rig(
        noise=_noise(tree["posterior"].to_dataset()),
        fs=float(f"{np.median(rates):.10g}") if rates else None,
        input_unit=next((unit for unit in units if unit in INPUT_UNITS), None),
        y_peak=y_peak if y_peak > 0 else None,
        held=json.loads(str(tree.attrs.get("held", "{}"))),
    )


def _tests(tree: xr.DataTree) -> Iterator[xr.Dataset]:
    if "verification" in tree.children:
        for node in tree["verification"].subtree:
            yield node.to_dataset()


def _noise(posterior: xr.Dataset) -> Noise | None:
    """Median over levels and draws of the noise of a sample.

    That of free decays, which were filtered, and that of harmonics are none of a sample.
    """
    for name, values in posterior.data_vars.items():
        response = RESPONSE_OF.get(str(values.attrs.get("units", "")))
        sampled = str(values.dims[-1]).startswith("level")
        if str(name).startswith("noise_std") and sampled and response is not None:
            return Noise(float(values.median()), response)
    return None


def noise_of(given: Noise | None, rig: Rig) -> Noise:
    """The noise as given, else as the run tells it.

    Raises:
        ConfigError: Neither does.
    """
    noise = given or rig.noise
    if noise is None:
        raise ConfigError(
            "Key `noise` must be given beside this run, which fitted no record in time, "
            "but it is not.",
            why="Without the noise of a sample nothing can be said of a further record.",
            remedy="Write [plan] with noise and noise_unit into a file and add: --limits FILE",
        )
    return noise
