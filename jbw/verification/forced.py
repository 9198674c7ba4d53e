"""Comparison of all driven tests with the model: records, responses, curves, points and loops."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from jbw.errors import Attempts
from jbw.identification.assemble import Measured, entered
from jbw.identification.discrepancy import NOTHING, AtAmplitude
from jbw.identification.selection import Sweeps, loop_tests
from jbw.measurement.records import Test, drive_of
from jbw.report.messages import verification as messages
from jbw.verification.curves import Curve, curves_of, predict_curves
from jbw.verification.groups import has_groups_alone, predict_apart
from jbw.verification.in_time import (
    NEAR,
    Motion,
    bands_of_modes,
    compare_frfs,
    compare_records,
    most_driven,
    motion_of,
)
from jbw.verification.places import place
from jbw.verification.predict import missed_in, route_of
from jbw.verification.predicted import Predicted, Source, source_of, without_band
from jbw.verification.predictive_basis import NUM_DRAWS, Basis
from jbw.verification.reference_oscillators import Reference, of_run
from jbw.verification.steady_motion import loop_validation

under_way = logging.getLogger("jbw.progress")
NUM_FEW = 20  # number of draws with which long records are predicted
FRF = "frequency response of "
Placed = Iterator[tuple[str, xr.Dataset]]  # comparisons, each with its path in the result tree


@dataclass(frozen=True)
class ForcedTests:
    """The inputs that all comparisons of driven tests share.

    Attributes:
        basis: Basis of predictions: draws, laws and fitted tests.
        seed: Random seed.
        simpler: Oscillators without hysteresis, by kind.
        fitted: Names of fitted tests without held-out repeats.
        unseen: Sweeps without any fitted repeat.
        bands_hz: Band of the first mode by Step 2, then bands of the other modes [Hz].
        attempts: Messages on comparisons that cannot be made.
    """

    basis: Basis
    seed: int
    simpler: Mapping[str, Reference]
    fitted: set[str]
    unseen: tuple[Test, ...]
    bands_hz: list[tuple[float, float]]
    attempts: Attempts

    def attempted(
        self, test: Test, build: Callable[[], Placed], what: str = ""
    ) -> dict[str, xr.Dataset]:
        """Make a test's comparisons; if one fails, return the comparisons made before it."""
        under_way.info("%s", test.name)
        made: dict[str, xr.Dataset] = {}
        what = messages.comparison_of(test.name, what)
        self.attempts.make(what, lambda: made.update(build()), None)
        return made

    def missed(self, test: Test) -> AtAmplitude:
        """Return the model discrepancy for the bands of a test; it is zero for fitted tests.

        The noise of fitted tests includes the discrepancy.
        """
        if test.name in self.fitted:
            return NOTHING
        return missed_in(self.basis, test, seed=self.seed)

    def beside(
        self, test: Test, num_draws: int = NUM_DRAWS, discrepancy: AtAmplitude | None = None
    ) -> Source:
        """Return the draws that predict a test: those of its run if that run was fitted."""
        missed = self.missed(test) if discrepancy is None else discrepancy
        references = of_run(self.simpler, self.basis.run_of(test), drive_of(test))
        how = {"seed": self.seed, "references": references}
        return source_of(self.basis, test, num_draws, missed, **how)

    def marks(self, test: Test) -> dict[str, Any]:
        """Return a test's attributes: whether it was fitted, and what its bands include."""
        is_fitted, basis = test.name in self.fitted, self.basis
        return {
            "fitted": int(is_fitted), "offsets": int(len(basis.scatter) > 0),
            "scatter": int(basis.scatters(test)),
            "discrepancy": int(not is_fitted and basis.misses),
        }  # fmt: skip

    def marked(
        self, kind: str, name: str, test: Test, predicted: Predicted
    ) -> tuple[str, xr.Dataset]:
        """Return a prediction with its path in the result tree; omit a band that is withheld."""
        attrs, is_fitted = self.marks(test), test.name in self.fitted
        attrs |= {"noise": predicted.noise.says}
        extrapolation = predicted.extrapolation(self.basis)
        if extrapolation is not None and not is_fitted:
            attrs |= {"extrapolation": extrapolation}
        compared = predicted.dataset.assign_attrs(attrs)
        why = "" if is_fitted else self.basis.why_withheld(predicted.amplitudes)
        where = place(f"verification/{kind}", name)
        return where, without_band(compared, why) if why else compared

    def frf(self, motion: Motion) -> Placed:
        """Yield the measured and predicted frequency response in the most driven band."""
        test = motion.test
        band_hz = most_driven(test.records[0], self.bands_hz)
        frf = compare_frfs(motion, band_hz).assign_attrs(self.marks(test))
        yield place("verification/frf", test.name), frf

    def sweep(self, test: Test) -> Placed:
        """Yield the comparisons of a sweep: over time, and by its frequency response."""
        source = self.beside(test)
        motion = motion_of(source, test)
        yield from self.attempted(test, partial(self.frf, motion), FRF).items()
        predicted = Predicted(compare_records(source, motion), motion.peak, motion.noise)
        seen = int(all(test is not other for other in self.unseen))
        shown = predicted._replace(dataset=predicted.dataset.assign_attrs(seen=seen))
        yield self.marked("sweep", test.name, test, shown)

    def response(self, test: Test) -> Placed:
        """Yield the comparison of the frequency response to random input, for a few draws."""
        source = replace(self.beside(test, NUM_FEW, NOTHING), references={})
        for where, frf in self.frf(motion_of(source, test, substeps=1)):
            yield where, frf.assign_attrs(discrepancy=0)

    def curves(self, named: Mapping[str, Curve], discrepancy: AtAmplitude) -> Placed:
        """Yield the comparisons of all curves of one run and one drive, predicted together."""
        together = list(named.values())
        source = self.beside(together[0].test, discrepancy=discrepancy)
        compared = predict_curves(source, together)
        for (name, curve), predicted in zip(named.items(), compared, strict=True):
            yield self.marked("curve", name, curve.test, predicted)

    def whole(self, test: Test) -> Placed:
        """Yield the comparison of a test with the prediction that its kind of test defines."""
        source = self.beside(test, NUM_FEW if test.is_cyclic else NUM_DRAWS)
        yield self.marked(test.kind, test.name, test, route_of(test)(source, test))

    def points(self, test: Test) -> Placed:
        """Yield the comparison of a controlled test's points with the model."""
        for name, predicted in predict_apart(self.beside(test), test):
            yield self.marked("controlled", name, test, predicted)

    def loop(self, test: Test) -> Placed:
        """Yield the comparison of a held-out tone's hysteresis loop, as in Teloli et al."""
        draws = self.beside(test, discrepancy=NOTHING).draws
        validated = loop_validation(test, draws, self.basis.laws)
        marked = validated.assign_attrs(scatter=int(self.basis.scatters(test)))
        yield place("validation/loops", test.name), marked


def verify_forced(
    source: Source, simpler: Mapping[str, Reference], measured: Measured, attempts: Attempts
) -> dict[str, xr.Dataset]:
    """Compare all tests but free decays with the model; return datasets by path in the result."""
    natural_hz = source.omega_n / (2 * np.pi)
    loops: tuple[Test, ...] = ()
    if measured.linear is not None:
        natural_hz = measured.linear.natural_hz
        loops = loop_tests(measured.tests, natural_hz)
    entries = {name for name, is_fitted in entered(measured).items() if is_fitted}
    fitted, sweeps = _compared_sweeps(entries, measured.sweeps)
    unseen = () if measured.sweeps is None else tuple(measured.sweeps.held_out)
    bands = [(NEAR[0] * natural_hz, NEAR[1] * natural_hz), *bands_of_modes(source.draws)[1:]]
    forced = ForcedTests(source.basis, source.seed, simpler, fitted, unseen, bands, attempts)
    groups: dict[str, xr.Dataset] = {}
    for test in sweeps:
        groups |= forced.attempted(test, partial(forced.sweep, test))
    for test in measured.tests:
        if test.traits.is_broadband and not test.is_cyclic:
            groups |= forced.attempted(test, partial(forced.response, test), FRF)
    validating = {test.name for test in loops}
    others = [test for test in measured.tests if test.name not in validating]
    for (_, _, discrepancy), named in _curves_together(forced, others).items():
        first = next(iter(named.values())).test
        build = partial(forced.curves, named, discrepancy)
        groups |= forced.attempted(first, build, "curve of ")
    for test in measured.tests:
        if test.traits.is_controlled:
            groups |= forced.attempted(test, partial(forced.points, test))
        elif test.traits.is_prescribed or test.is_cyclic or has_groups_alone(test):
            groups |= forced.attempted(test, partial(forced.whole, test))
    for test in loops:
        groups |= forced.attempted(test, partial(forced.loop, test), "loop of ")
    return groups


def _curves_together(
    forced: ForcedTests, tests: Sequence[Test]
) -> dict[tuple[str | None, str, AtAmplitude], dict[str, Curve]]:
    """Group curves by run, drive and model discrepancy; do not mix fitted and held-out tones."""
    curves = curves_of([test for test in tests if test.name in forced.fitted])
    held_out = [test for test in tests if test.name not in forced.fitted]
    curves |= curves_of(held_out, " (held out)")
    together: dict[tuple[str | None, str, AtAmplitude], dict[str, Curve]] = {}
    for name, curve in curves.items():
        test = curve.test
        conditions = forced.basis.run_of(test), drive_of(test), forced.missed(test)
        together.setdefault(conditions, {})[name] = curve
    return together


def _compared_sweeps(names: set[str], sweeps: Sweeps | None) -> tuple[set[str], list[Test]]:
    """Return the names of completely fitted tests, and the sweeps to compare.

    The sweeps are the held-out repeats, and the fitted ones if no repeat was held out.
    """
    if sweeps is None:
        return names, []
    others = {test.name for test in sweeps.held_out}
    names = names - (others - {test.name for test in sweeps.fitted})
    rest = [test for test in sweeps.fitted if test.name not in names & others]
    return names, [*sweeps.held_out, *rest]
