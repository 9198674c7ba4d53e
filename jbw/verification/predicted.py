"""The draws that predict a test, the prediction, and the known noise of the test."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, PyTree
from numpy.typing import NDArray

from jbw.identification.discrepancy import NOTHING, AtAmplitude
from jbw.inference.lanes import at_points
from jbw.measurement.records import Test
from jbw.observables.groups import Groups
from jbw.observables.harmonic_groups import harmonic_label
from jbw.observables.observable import Observable, alone, prediction
from jbw.report.messages import verification as messages
from jbw.report.messages.discrepancy import withheld
from jbw.verification.bands import LAW, about_law, band, middle
from jbw.verification.predictive_basis import (
    Basis,
    CampaignTest,
    Draws,
    Laws,
    count_of,
    noise_by_label,
    seen_of,
)

OWN = messages.OWN
ALIKE = messages.ALIKE
REPEATS = messages.REPEATS
UNKNOWN = messages.UNKNOWN
LEFT_OUT = messages.LEFT_OUT
OF_BAND = ("coverage", "num_values", "half_width")  # attributes of a prediction with a band
LANES = 8  # number of draws that are evaluated in parallel


class RepeatNoise(NamedTuple):
    """The noise of one repeat of a test."""

    # standard deviation of the noise, in the unit of the compared values; None if unknown
    std: float | None
    says: str  # source of the noise level, or the reason why it is unknown


NOT_KNOWN = RepeatNoise(None, UNKNOWN)


class Predicted(NamedTuple):
    """A test with its prediction."""

    dataset: xr.Dataset  # measured values with bands
    peak: NDArray[np.float64] | None  # peak displacement of every draw [m]; None if unknown
    noise: RepeatNoise  # noise of each repeat of the test
    begins: tuple[float, ...] = ()  # displacement at the start of every free decay [m]

    @property
    def amplitudes(self) -> tuple[float, ...]:
        """The largest displacement [m] of each free decay, or of the test (median of draws)."""
        if self.begins or self.peak is None:
            return self.begins
        return (float(np.median(self.peak)),)

    def extrapolation(self, basis: Basis) -> float | None:
        """Return the ratio of largest predicted (99.5 %) to largest fitted displacement."""
        if self.peak is None or basis.y_peak <= 0:
            return None
        return float(band(self.peak)[-1]) / basis.y_peak


@dataclass(frozen=True)
class Source:
    """The draws from which a test is predicted, with reference models for comparison."""

    basis: Basis
    draws: Draws
    # Parameters and laws of the reference models, which have no hysteresis.
    references: Mapping[str, tuple[Mapping[str, float], Laws]] = field(default_factory=dict)
    noise: bool = True  # whether bands include known noise
    # noise level to use if the noise is unknown: with 0, bands contain only the uncertainty of the
    # parameters; with None, coverage is not stated
    bare: float | None = None
    seed: int = 0
    # Draws of other laws, which are appended to the draws of this run's law.
    beside: tuple[tuple[Draws, Laws], ...] = ()
    # The draws of all laws without the model discrepancy; empty if there is none.
    undisturbed: tuple[tuple[Draws, Laws], ...] = ()
    # relative error of the response, in addition to the errors of omega_n and zeta
    model_error: float = 0.0

    @property
    def omega_n(self) -> float:
        """The mean natural frequency of the draws [rad/s]."""
        return float(np.mean(self.draws["omega_n"]))

    @property
    def num_draws(self) -> int:
        """The number of draws of all laws."""
        return count_of(self.draws) + sum(count_of(draws) for draws, _ in self.beside)

    def std(
        self, known: RepeatNoise, model: NDArray[Any], num_repeats: float = 1.0, share: float = 1.0
    ) -> float | None:
        r"""Return the standard deviation of the mean of K repeats, from noise and model error.

        $$\sqrt{f \sigma^2 / K + s^2 \,\mathrm{mean}(m^2)}$$

        where s is the model's relative error of its response m, separately for real and imaginary
        parts, and `share` is the part $\sqrt f$ of the noise that is compared.
        """
        if not self.noise or (known.std is None and not self.model_error):
            return self.bare
        noise = share * (known.std or 0.0) / float(np.sqrt(num_repeats))
        power = np.mean(np.abs(middle(model)) ** 2)
        size = np.sqrt(power / (1 + np.iscomplexobj(model)))
        return float(np.hypot(noise, self.model_error * size))

    def compared(
        self,
        known: RepeatNoise,
        model: NDArray[Any],
        others: Mapping[str, NDArray[Any]],
        num_repeats: float = 1.0,
        share: float = 1.0,
    ) -> tuple[NDArray[Any], dict[str, NDArray[Any]], float | None]:
        """Return draws centred on the law's prediction, reference models, and the noise for bands.

        The last value is the result of `std`.
        """
        return *about_law(model, others), self.std(known, model, num_repeats, share)

    def carried(self, predict: Callable[[Draws, Laws], PyTree]) -> tuple[Any, dict[str, Any]]:
        """Return the predictions of all draws, and those of each reference model by its name.

        If the draws include a model discrepancy, the law without it is a reference named `LAW`.
        """
        others = {}
        for name, (parameters, laws) in self.references.items():
            single = {key: np.array([value]) for key, value in parameters.items()}
            others[name] = jax.tree.map(lambda rows: rows[0], predict(single, laws))

        def of_all(members: Sequence[tuple[Draws, Laws]]) -> Any:
            rows = [predict(draws, laws) for draws, laws in members]
            return jax.tree.map(lambda *parts: np.concatenate(parts), *rows)

        if self.undisturbed:
            others[LAW] = jax.tree.map(middle, of_all(self.undisturbed))
        return of_all(((self.draws, self.basis.laws), *self.beside)), others

    def observed(self, data: Observable) -> tuple[Any, dict[str, Any]]:
        """Return the predictions of data for all draws, and for each reference model by name."""
        seen = alone(data)
        return self.carried(lambda draws, laws: carry(prediction, draws, replace(seen, laws=laws)))


def source_of(
    basis: Basis, test: Test, num_draws: int, missed: AtAmplitude, gain: Any = None, **how: Any
) -> Source:
    """Return the draws that predict a test, with contributions from every law of a run.

    Args:
        basis: Basis of the run's predictions.
        test: The test to predict.
        num_draws: Largest number of draws of all laws.
        missed: Model discrepancy in the test's bands.
        gain: Gain [N/kg per unit of the source] for the test's own source; None for that of the
            run.
        how: Other fields of `Source`, including the seed.
    """

    def of_every_law(missed: AtAmplitude) -> tuple[tuple[Draws, Laws], ...]:
        drawn = partial(Basis.draws_for, missed=missed, gain=gain, seed=how.get("seed", 0))
        shares = basis.shared(num_draws)
        return tuple((drawn(of_law, test, count), of_law.laws) for count, of_law in shares)

    (draws, _), *others = of_every_law(missed)
    undisturbed = () if missed == NOTHING else of_every_law(NOTHING)
    error = basis.model_error(test, missed)
    return Source(
        basis, draws, beside=tuple(others), undisturbed=undisturbed, model_error=error, **how
    )


def is_measured(test: Test) -> bool:
    """Return True if a test has a measured response, and False if it is only planned."""
    record = test.records[0]
    return bool(np.any(np.isfinite(record.channels[record.response])))


def carry(predict: Callable[..., PyTree], draws: Draws, *args: Any) -> PyTree:
    """Evaluate a prediction for every draw, several in parallel, by one compiled program."""
    # Define `predict` at module level: only then is its compiled program reused. In the program
    # all of `args` except arrays are constants.
    return at_points(_prediction, draws, (predict, args), lanes=min(LANES, count_of(draws)))


def _prediction(theta: Mapping[str, Array], predict_and_args: Any) -> PyTree:
    predict, args = predict_and_args
    return predict(theta, *args)


def noise_of(
    basis: Basis,
    test: Test,
    repeated: RepeatNoise = NOT_KNOWN,
    *,
    label: str = "",
    order: int = 0,
    behind: str = "",
) -> RepeatNoise:
    """Return the noise of one repeat: from the fit, from repeats, or from similar fitted tests.

    `behind` is the text after the test's name in the label of its group, if it has several.
    """
    fitted_noise, traits = noise_by_label(basis.posterior), seen_of(test)
    # An earlier test with the same name may have another kind, source or response.
    if (label or test.name) in fitted_noise and basis.seen.get(test.name, traits)[:3] == traits[:3]:
        return RepeatNoise(fitted_noise[label or test.name], OWN)
    if repeated.std is not None:
        return repeated
    if not basis.seen:  # A run that stores nothing about its tests has only sweeps.
        comparable = {
            name: (None, std) for name, std in fitted_noise.items() if test.traits.is_transient
        }
    else:
        comparable = {
            name: (other.level, fitted_noise[name])
            for test_name, other in {**basis.seen, test.name: traits}.items()
            if (other.kind, other.response) == (traits.kind, traits.response)
            for name in _labels(test_name + behind, other, order)
            if name in fitted_noise
        }
    near = [std for level, std in comparable.values() if level == test.level]
    chosen = near or [std for _, std in comparable.values()]
    return RepeatNoise(float(np.median(chosen)), ALIKE) if chosen else NOT_KNOWN


def _labels(name: str, seen: CampaignTest, order: int) -> list[str]:
    """Return the labels that a test's data groups may have for a harmonic order."""
    names = [name, seen.family] if seen.family else [name]
    harmonics = [harmonic_label(group_name, order) for group_name in names] if order else []
    return harmonics + (names if order < 2 else [])


def of_repeats(groups: Groups, group: int = 0) -> RepeatNoise:
    """Return the noise of one repeat, from the variation between a data group's repeats."""
    columns = groups.within, groups.size, groups.num_repeats
    within, size, count = (float(column[group]) for column in columns)
    if count < 2:
        return NOT_KNOWN
    return RepeatNoise(float(np.sqrt(within / (size * (count - 1)))), REPEATS)


def without_band(dataset: xr.Dataset, why: str) -> xr.Dataset:
    """Return the prediction of a test without the band; the attribute `noise` states why."""
    bands = [name for name in dataset.data_vars if "predictive" in str(name)]
    bare = dataset.drop_vars(bands)
    bare.attrs = {name: value for name, value in dataset.attrs.items() if name not in OF_BAND}
    return bare.assign_attrs(noise=withheld(why), withheld=1)
