"""Prediction of any test from the posterior of a run: bands, errors, extrapolation."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from jbw.campaign.tables import Gain, gain_of
from jbw.errors import ConfigError, DataError
from jbw.identification.discrepancy import NOTHING, AtAmplitude
from jbw.inference.thresholds import BEYOND
from jbw.measurement.records import Test, drive_of
from jbw.observables.residual_terms import TAKEN
from jbw.oscillator.modes.parameters import has_further_modes
from jbw.report.messages import verification as messages
from jbw.verification.bands import QUANTILES, band
from jbw.verification.curves import predict_curve
from jbw.verification.decays import predict_decay
from jbw.verification.groups import has_groups_alone, predict_groups
from jbw.verification.in_time import predict_records
from jbw.verification.planned import predict_planned
from jbw.verification.predicted import (
    LANES,
    LEFT_OUT,
    OF_BAND,
    Predicted,
    Source,
    is_measured,
    source_of,
    without_band,
)
from jbw.verification.predictive_basis import NUM_DRAWS, Basis, seen_of
from jbw.verification.steady_motion import predict_loop, predict_periods

# An input hardly excites the mode if less than this fraction of its power is near the mode.
HARDLY = 0.01
MOST_SAMPLES = 8_000_000  # largest number of samples that are simulated for all draws together
FEWEST = 20  # smallest number of draws, used for long records
ERROR_ALONE = messages.ERROR_ALONE
ERRORS = (*OF_BAND, "nrmse", "nrmse_own_frequency")


@dataclass(frozen=True)
class Request:
    """The options of a prediction."""

    num_draws: int = NUM_DRAWS  # largest number of posterior draws; long records use fewer
    noise: bool = True  # whether bands include known noise
    gain: Gain = None  # gain by drive, as the campaign of the tests states it, or as 1 / modal mass
    seed: int = 0  # seed of the random numbers


def predict(basis: Basis, test: Test, request: Request | None = None) -> xr.Dataset:
    """Predict bands for a test from a run's posterior; the test may be of any kind, fitted or not.

    A test whose response is NaN throughout is a planned test.

    Returns:
        Measured values with bands over `quantile`: `model_*` of the parameters, `predictive_*`
        with the noise if requested and known; over time, frequency or both, repeats and records by
        name. `peak_displacement`, `nrmse_of_repeat` or `nrmse_of_record` if known. There is no
        `predictive_*` if the model discrepancy cannot be stated; `noise` then says so.
        Attributes: `coverage` of the 99 % band and its `num_values`; `nrmse`; for free decays also
        `nrmse_own_frequency` (each record with its own frequency offset); `noise` as text;
        `y_peak`, the 99 % band of the peak displacement [m]; `extrapolation`, its upper edge over
        the largest fitted displacement; `kind`, `level` and `num_draws`.

    Raises:
        ConfigError: There are too few draws.
        DataError: The run's gain does not apply to the test's source, the posterior lacks the
            joint, or the test is a steady or free motion of several modes.
    """
    options = request or Request()
    _require_modes_known(basis, test)
    _require_point_known(basis, test)
    basis = basis_for(basis, test, options)
    source = _source(basis, test, options)
    predicted = route_of(test)(source, test)
    dataset, peak, noise = predicted.dataset, predicted.peak, predicted.noise
    has_noise = noise.std is not None or source.model_error > 0
    says = ERROR_ALONE if noise.std is None and has_noise else noise.says
    facts = {
        "test": test.name, "kind": test.kind, "num_draws": source.num_draws,
        "scatter": int(basis.scatters(test) and not test.traits.is_free),
        "noise": says if options.noise else LEFT_OUT,
    }  # fmt: skip
    is_unseen = options.noise and not basis.has_fitted(test)
    why = basis.why_withheld(predicted.amplitudes) if is_unseen else ""
    lacking = [name for name in basis.lacking if name in TAKEN[test.residuals]]
    if lacking and test.traits.is_driven:
        facts |= {"lacking": ", ".join(lacking)}
    # A free decay's level is its initial amplitude; its stated level has another unit.
    if np.isfinite(test.level) and not test.traits.is_free:
        unit = str(dataset.attrs.get("level_unit", seen_of(test).source))
        facts |= {"level": test.level, "level_unit": unit}
    if options.noise and noise.std is not None and not why:
        facts |= {"noise_std": noise.std}
    if peak is not None:
        facts |= {"y_peak": band(peak)}
    if (extrapolation := predicted.extrapolation(basis)) is not None:
        facts |= {"y_peak_fitted": basis.y_peak, "extrapolation": extrapolation}
    dataset = dataset.assign_attrs(facts)
    dataset = without_band(dataset, why) if why else dataset
    attrs, dropped = dataset.attrs, []
    if not options.noise or not has_noise:
        dropped += [name for name in dataset.data_vars if "predictive" in str(name)]
    if not is_measured(test):
        of_measured = ("measured", "nrmse", "repeat")
        dropped += [n for n in dataset.variables if any(word in str(n) for word in of_measured)]
        attrs = {
            name: value for name, value in attrs.items() if name not in (*ERRORS, "num_repeats")
        }
    dataset = dataset.drop_vars(dropped)
    if peak is not None:
        peak_attrs = {"units": "m", "long_name": "largest displacement"}
        dataset = dataset.assign(peak_displacement=("quantile", band(peak), peak_attrs))
    dataset.attrs = attrs
    return dataset


def route_of(test: Test) -> Callable[[Source, Test], Predicted]:
    """Return the function that predicts a test of this kind, measured or only planned."""
    traits = test.traits
    if has_groups_alone(test):
        return predict_groups
    if traits.is_free:
        return predict_decay
    if traits.is_prescribed:
        return predict_loop
    if traits.is_curve or traits.is_stepped or test.is_single_tone:
        return predict_curve if is_measured(test) else predict_planned
    return predict_periods if test.is_cyclic else predict_records


def _require_modes_known(basis: Basis, test: Test) -> None:
    """Raise a DataError if a run has several modes and the test can be predicted for one only."""
    in_time = route_of(test) in (predict_records, predict_periods, predict_decay)
    if has_further_modes(basis.posterior) and not in_time:
        raise DataError(
            f"Test `{test.name}` of kind `{test.kind}` can be predicted only for one mode, but "
            "the run has several.",
            remedy="Predict sweeps, multisines or decays, or use the draws in a `jbw.Structure`.",
        )


def _require_point_known(basis: Basis, test: Test) -> None:
    """Raise a DataError if a test's response is at a point that the run does not know."""
    if test.point and test.point not in basis.points:
        raise DataError(
            f"Test `{test.name}` is measured at `{test.point}`, but the run has "
            f"{', '.join(basis.points) or 'only one point'}.",
            remedy="Use the names of the points in the run's campaign, or identify from tests at "
            f"the point `{test.point}`.",
        )


def _source(basis: Basis, test: Test, request: Request) -> Source:
    """Return the draws that predict a test; use fewer draws for long records."""
    most, route = request.num_draws, route_of(test)
    gain = _gain_for(basis, test, request)
    if route in (predict_records, predict_periods, predict_groups):
        most = min(most, max(FEWEST, MOST_SAMPLES // test.records[0].num_samples))
    missed = NOTHING if basis.has_fitted(test) else missed_in(basis, test, gain, request.seed)
    how = {"gain": gain, "seed": request.seed, "noise": request.noise, "bare": 0.0}
    return source_of(basis, test, most, missed, **how)


def basis_for(basis: Basis, test: Test, request: Request) -> Basis:
    """Return the compared law that best predicts tests of the given kind and amplitude."""
    if basis.has_fitted(test):
        return basis
    if basis.across is not None and not basis.has_fitted_kind(test.kind):
        return basis.across
    if basis.outward is not None and _reach(basis, test, request) > BEYOND:
        return basis.outward
    return basis


def _reach(basis: Basis, test: Test, request: Request) -> float:
    """Return a test's largest displacement, divided by the largest fitted one, from a few draws."""
    if route_of(test) is predict_decay:
        return 1.0  # The displacement is unknown before the prediction.
    gain = _gain_for(basis, test, request)
    extrapolation = _by_few_draws(basis, test, gain, request.seed).extrapolation(basis)
    return 1.0 if extrapolation is None else extrapolation


def _by_few_draws(basis: Basis, test: Test, gain: float | None, seed: int) -> Predicted:
    """Predict a test from a few draws, to estimate the amplitude of the test."""
    draws = basis.draws_for(test, LANES, gain, seed)
    return route_of(test)(Source(basis, draws, seed=seed), test)


def missed_in(basis: Basis, test: Test, gain: float | None = None, seed: int = 0) -> AtAmplitude:
    """Return the model discrepancy at the amplitude of a held-out test.

    The amplitude is predicted by a few draws. For free decays the result is zero here, because each
    record has its own amplitude.
    """
    discrepancy = basis.discrepancy
    if discrepancy is None or discrepancy.is_nothing or route_of(test) is predict_decay:
        return NOTHING  # Each free decay has its own amplitude.
    return discrepancy.at(next(iter(_by_few_draws(basis, test, gain, seed).amplitudes), None))


def _gain_for(basis: Basis, test: Test, request: Request) -> float | None:
    """Return the gain for a test's source; None if the run was driven by the same source."""
    drive = "force" if test.traits.is_prescribed else drive_of(test)
    if (stated := gain_of(request.gain, drive)) is not None:
        return stated
    unit = seen_of(test).source
    sources = {fitted_test.source for fitted_test in basis.seen.values()} - {""}
    if unit and sources and unit not in sources:
        raise DataError(
            f"The source of test `{test.name}` has the unit {unit}, but the run's gain is per "
            f"{' or '.join(sorted(sources))}.",
            remedy="State `modal_mass` or `gain` in the campaign of the test.",
        )
    return None


def warnings_of(dataset: xr.Dataset) -> list[str]:
    """Return warnings on the reliability of a prediction, each as one sentence.

    Examples:
        A sweep at twice the fitted level moves the joint beyond the fitted displacements:

        >>> import jbw; jbw.enable_x64()
        >>> campaign = jbw.rig.measure(tests=["sweep_0p20V"], repeats=2, fs=256.0, noise_ratio=0.02)
        >>> study = jbw.identify(campaign, quick=True)
        >>> sweep = study.planned_sweep((12.0, 26.0), level=0.4, duration=8.0, fs=256.0)
        >>> (sentence,) = jbw.warnings_of(study.predict(sweep, num_draws=20))
        >>> print(sentence.partition(",")[0])
        Test `sweep 12 to 26 Hz at 0.4` is predicted to reach 14.8 mm
    """
    return list(_warnings(**dataset.attrs))


def _warnings(
    *, test: str = "", warnings: str = "", extrapolation: float = 0.0, y_peak: Any = (),
    y_peak_fitted: float = 0.0, input_near_mode: float = 1.0, lacking: str = "", **_: Any,
) -> Iterator[str]:  # fmt: skip
    """Yield the warnings on a prediction with given attributes."""
    yield from warnings.splitlines()
    if extrapolation > BEYOND:
        yield messages.extrapolated(test, y_peak[-1], extrapolation, y_peak_fitted)
    if input_near_mode < HARDLY:
        yield messages.away_from_mode(test, input_near_mode)
    if lacking:
        yield messages.without_terms(test, lacking)


def row_of(dataset: xr.Dataset) -> dict[str, Any]:
    """Return a prediction as plain numbers, with None for unknown values."""
    attrs = dataset.attrs
    columns = ("test", "kind", "level", "level_unit", "noise", *ERRORS, "num_draws")
    peak, reach = (attrs.get(name) for name in ("y_peak", "extrapolation"))
    marks = map(str, QUANTILES)
    row = {
        **{name: attrs.get(name) for name in columns},
        "y_peak": None if peak is None else dict(zip(marks, map(float, peak), strict=True)),
        "y_peak_fitted": attrs.get("y_peak_fitted"), "extrapolation": reach,
        "beyond": reach is not None and reach > BEYOND, "warnings": warnings_of(dataset),
    }  # fmt: skip
    return {n: None if isinstance(v, float) and not np.isfinite(v) else v for n, v in row.items()}


def chosen(tests: tuple[Test, ...], names: tuple[str, ...], argument: str) -> tuple[Test, ...]:
    """Return the tests with the given names; all tests if no name is given."""
    by_name = {test.name: test for test in tests}
    missing = [name for name in names if name not in by_name]
    if missing:
        raise ConfigError(
            f"{argument} must name a test of the campaign, but is {missing[0]!r}.",
            remedy=f"The tests are {', '.join(by_name)}.",
        )
    return tuple(by_name[name] for name in names) or tests
