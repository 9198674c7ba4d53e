"""Every test of a campaign beside the model, fitted or held out: which test is verified how."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from jbw.measurement.records import Test
from jbw.quantities import derivative_order
from jbw.verification.curves import curves_of, predict_curves
from jbw.verification.decays import amplitude_verification, verify_decays
from jbw.verification.draws import Draws
from jbw.verification.in_time import compare_frfs, compare_records, motion_of
from jbw.verification.predict import predicted
from jbw.verification.predicted import Predicted, Source
from jbw.verification.steady_loops import loop_validation

BAND = (0.75, 1.25)  # of the natural frequency: where FRFs are shown
Groups = dict[str, xr.Dataset]


@dataclass(frozen=True)
class Tested:
    """The tests of a campaign by what was done with them.

    Attributes:
        tests: All of them but free decays.
        fitted: Names of those that the posterior was made from.
        sweeps: Repeats of sweeps that no fit saw; the fitted ones where a level has no others.
        validating: Tones near the resonance, of which the loops are compared.
        decays: All free decays, the fitted ones first, by name.
        num_fitted_decays: How many of them were fitted.
    """

    tests: Sequence[Test] = ()
    fitted: frozenset[str] = frozenset()
    sweeps: Sequence[Test] = ()
    validating: Sequence[Test] = ()
    decays: tuple[Test, Sequence[str]] | None = None
    num_fitted_decays: int = 0


def place(group: str, name: str) -> str:
    """Path of a test in the tree."""
    return f"/{group}/{safe(name)}"


def safe(name: str) -> str:
    """A test's name as one level of the tree: a slash would open another."""
    return name.replace("/", "\N{DIVISION SLASH}")


def verify_forced(source: Source, few: Draws, tested: Tested, natural_hz: float) -> Groups:
    """Verification and validation on every test but free decays.

    Args:
        source: What is carried through the model.
        few: Some of its draws, for long records.
        tested: The campaign's tests.
        natural_hz: Natural frequency [Hz].
    """
    long, band_hz = replace(source, draws=few), (BAND[0] * natural_hz, BAND[1] * natural_hz)
    frfs, verified = {}, {}
    for test in tested.sweeps:
        motion = motion_of(source, test)
        frfs[place("verification/frf", test.name)] = compare_frfs(motion, band_hz)
        found = Predicted(compare_records(source, motion), motion.peak, motion.noise)
        verified[place("verification/sweep", test.name)] = _said(found, source, tested, test)
    for test in tested.tests:
        if test.traits.is_broadband and not test.is_cyclic:
            motion = motion_of(replace(long, references={}), test, substeps=1)
            frfs[place("verification/frf", test.name)] = compare_frfs(motion, band_hz)
    verified |= _curves(source, tested)
    loops = [(test, source) for test in tested.tests if test.traits.is_prescribed]
    cyclic = [(test, long) for test in tested.tests if test.is_cyclic]
    for test, carried in (*loops, *cyclic):
        found = predicted(carried, test)
        path = place(f"verification/{test.kind}", test.name)
        verified[path] = _said(found, source, tested, test)
    used = {safe(name) for name in tested.fitted}
    for path, dataset in (frfs | verified).items():
        dataset.attrs.setdefault("fitted", int(path.rsplit("/", 1)[-1] in used))
        dataset.attrs["offsets"] = int(len(source.basis.scatter) > 0)
    validated = {
        place("validation/loops", test.name): loop_validation(test, source.draws, source.basis.laws)
        for test in tested.validating
    }
    return frfs | verified | validated


def _curves(source: Source, tested: Tested) -> Groups:
    """Response curves, stepped sines and tones; fitted tones of a level apart from the others."""
    validating = {test.name for test in tested.validating}
    rest = [test for test in tested.tests if test.name not in validating]
    fitted = [test for test in rest if test.name in tested.fitted]
    held_out = [test for test in rest if test.name not in tested.fitted]
    curves = curves_of(fitted) | curves_of(held_out, " (held out)")
    found = predict_curves(source, list(curves.values()))
    return {
        place("verification/curve", name): _said(one, source, tested, curve.test)
        for (name, curve), one in zip(curves.items(), found, strict=True)
    }


def _said(found: Predicted, source: Source, tested: Tested, test: Test) -> xr.Dataset:
    """A prediction's dataset, with where its noise is known from and how far it reaches."""
    dataset = found.dataset
    dataset.attrs |= {"noise": found.noise.says, "fitted": int(test.name in tested.fitted)}
    extrapolation = found.extrapolation(source.basis)
    if extrapolation is not None and not dataset.attrs["fitted"]:
        dataset.attrs["extrapolation"] = extrapolation
    return dataset


def verify_free(source: Source, tested: Tested) -> Groups:
    """Free decays: every record against its bands, and the curves of frequency and damping.

    Args:
        source: What is carried through the model.
        tested: The campaign's tests.
    """
    if tested.decays is None:
        return {}
    together, names = tested.decays
    compared = verify_decays(source, together, tested.num_fitted_decays)
    power = derivative_order(together.records[0].response)
    unit = float(np.mean(source.draws["omega_n"])) ** power * source.basis.y_peak
    for dataset in compared:
        if not dataset.attrs["fitted"] and unit > 0:
            dataset.attrs["extrapolation"] = dataset.attrs["level"] / unit
    groups = {
        place("verification/decay", name): dataset
        for name, dataset in zip(names, compared, strict=True)
    }
    curves = amplitude_verification(
        together, tested.num_fitted_decays, source.draws, source.basis.laws
    )
    return groups | {"/verification/amplitude": curves}
