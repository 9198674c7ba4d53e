"""The free-form law: a law without a prescribed formula, fitted to frequency and damping."""

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jbw.errors import JbwError
from jbw.freeform.free_law import CALLED, QUANTILES, FreeLaw, free_law
from jbw.freeform.sliders import gap_sliders
from jbw.identification.assemble import Measured, entered, fitted_repeats
from jbw.measurement.curves import forced_loop
from jbw.measurement.readings.statement import RecordTable
from jbw.measurement.records import Test
from jbw.report.messages import free_law as messages
from jbw.report.result import FREE_LAW
from jbw.study.look import Look

if TYPE_CHECKING:
    import xarray as xr

PARTICLES = 400  # With this number of particles, the log evidence is accurate to one nat.
NUM_AMPLITUDES = 48
# Bands extend from the smallest measured amplitude divided by this factor to the largest measured
# amplitude multiplied by this factor.
REACH = 3.0
BEYOND = 1.25  # multiple of the largest amplitude at which a sentence states the bands
# ratio of the variances of frequency and damping to the variances of their measurement errors;
# above this ratio a sentence states that frequency and damping vary
SCATTERED = 2.0


def fitted_tables(looked: Look, seen: Measured) -> list[RecordTable]:
    """Return the tables of frequency and damping in steady motion of all fitted records.

    If some repeats of a test cannot be read, it has fewer tables than repeats; all are returned.
    """
    fitted, repeats = entered(seen), fitted_repeats(seen)
    chosen: list[RecordTable] = []
    for test in seen.tests:
        if fitted.get(test.name, True):
            tables = looked.steady(test)
            is_whole = len(test.records) == len(tables)
            places = [i - 1 for i in repeats[test.name]] if is_whole else range(len(tables))
            chosen += [tables[i] for i in places]
    return chosen


def free_law_of(
    looked: Look, seen: Measured, seed: int, *, named: bool, particles: int = PARTICLES
) -> FreeLaw | None:
    """Fit a law without a prescribed formula to a campaign's measured frequency and damping.

    Return None for several modes or joints, and where the readings do not suffice.
    """
    if seen.modes is not None or seen.joints is not None:
        return None
    try:
        tables = fitted_tables(looked, seen)
        return free_law(tables, named=named, seed=seed, num_particles=particles)
    except JbwError:  # There are too few measured values for a free-form law.
        return None


def gap_record(tests: Sequence[Test], seen: Measured) -> dict[str, Any] | None:
    """Return the errors with which sliders behind gaps fit and predict force loops, or None.

    Errors are relative to the rms of the force; a held-out loop also has the error that remains
    with a separate constant force.
    """
    fitted = entered(seen)
    named = [
        (test.name, forced_loop(record, test.delay))
        for test in tests
        if test.traits.is_prescribed
        for record in test.records
    ]
    try:
        found = gap_sliders([loop for name, loop in named if fitted.get(name, False)])
    except JbwError:
        return None
    held_out = [(name, loop) for name, loop in named if not fitted.get(name, False)]
    return {
        "error": found.error,
        "mean_gap": found.mean_gap,
        "sliders": int(np.sum(found.strengths > 0)),
        "held_out": {name: list(found.errors(loop)) for name, loop in held_out},
    }


def gap_sentences(record: Mapping[str, Any] | None) -> list[str]:
    """Return sentences on how well sliders behind gaps fit and predict force loops."""
    if record is None:
        return []
    fit = messages.gap_sliders(record["sliders"], record["error"], record["mean_gap"])
    return [fit, *(messages.held_out_loop(n, *e) for n, e in record["held_out"].items())]


def free_law_groups(law: FreeLaw | None) -> "dict[str, xr.Dataset]":
    """Return the bands of the free-form law as a result group; empty if it was not fitted."""
    if law is None:
        return {}
    import xarray as xr  # The import takes long.

    low, high = float(law.rows.y.min()), float(law.rows.y.max())
    amplitude = np.geomspace(low / REACH, REACH * high, NUM_AMPLITUDES)
    frequency, damping = law.bands(amplitude)
    dims = "quantile", "amplitude"
    group = xr.Dataset(
        {
            "frequency": (dims, frequency, {"units": "Hz", "long_name": messages.FREQUENCY}),
            "damping": (dims, damping, {"units": "1", "long_name": messages.DAMPING}),
            "least_damping": (
                "amplitude", law.least_damping(amplitude),
                {"units": "1", "long_name": messages.LEAST_DAMPING},
            ),
        },
        {
            "amplitude": ("amplitude", amplitude, {"units": "m"}),
            "quantile": ("quantile", list(QUANTILES), {"units": "1"}),
        },
        {
            "y_low": low, "y_high": high, "against_masing": law.masing,
            "log_evidence": json.dumps(law.log_evidence),
        },
    )  # fmt: skip
    return {f"/{FREE_LAW}": group}


def free_law_record(law: FreeLaw | None) -> dict[str, Any] | None:
    """Return evidence and tests of the free-form law as plain values; None if not fitted."""
    if law is None:
        return None
    best = max(law.log_evidence.values())
    return {
        "log_evidence": dict(law.log_evidence),
        "log_evidence_difference": {n: z - best for n, z in law.log_evidence.items()},
        "against_masing": law.masing,
        "masing": law.rule,
        "scatter": law.scatter,
        "inflation": law.rows.inflation,
        "num_readings": len(law.rows.y),
    }


def free_law_sentences(law: FreeLaw | None) -> list[str]:
    """Return sentences on frequency and damping according to the free-form law."""
    if law is None:
        return []
    high = float(law.rows.y.max())
    at = np.array([high, BEYOND * high])
    hz, zeta = law.bands(at)
    sentences = [
        messages.bands(high, tuple(hz[:, 0]), tuple(zeta[:, 0])),
        messages.bands_beyond(BEYOND, tuple(hz[:, 1]), tuple(zeta[:, 1])),
        messages.masing(law.rule, law.masing, CALLED),
    ]
    if law.rule != "broken":
        sentences.append(messages.least_damping(BEYOND, float(law.least_damping(at[1:])[0])))
    if law.rows.inflation > SCATTERED:
        sentences.append(messages.scattered(float(np.sqrt(law.rows.inflation))))
    return sentences
