"""The inputs of a finished run's predictions: draws, fixed parameters, fitted tests, noise."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Key
from numpy.typing import ArrayLike, NDArray

from jbw.errors import ConfigError, DataError
from jbw.identification.discrepancy import NOTHING, AtAmplitude, Discrepancy, discrepancy_in
from jbw.inference.generator import generator
from jbw.inference.posterior.summary import evenly_spaced, posterior_draws
from jbw.inference.thresholds import BEYOND
from jbw.measurement.curves import response_curve
from jbw.measurement.records import INPUTS, RESPONSES, Test, belongs_to, drive_of, run_of
from jbw.observables.dataset import Dataset, largest_displacement
from jbw.observables.decay import Decays
from jbw.observables.drives import of_drive, plain
from jbw.observables.harmonic_groups import family_of, response_held
from jbw.observables.observable import OFFSETS
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.modes.parameters import own_quantities
from jbw.quantities import (
    ATTACHED,
    DEFAULT_LAWS,
    MODAL,
    MODES,
    RESIDUAL_TERMS,
    motion_factors_in,
)
from jbw.report.messages import discrepancy as messages
from jbw.results.attributes import DecayConstants, DrawnPosterior

# name of the draws before stated clock and calibration errors were added
AS_RECORDED = "as_recorded"
# Names of all groups of a result tree that `basis_of` reads.
GROUPS_OF_BASIS = ("posterior", AS_RECORDED, "runs", "discrepancy", "steps")
NUM_DRAWS = 100  # number of draws that give the ends of 99 % bands
SUBSTEPS = 2  # solver steps per sample, for a run that does not state them
SCATTER_KEY = 200  # number from which the random key of the variation between runs is derived
Draws = dict[str, NDArray[np.float64]]
Laws = tuple[str, ...]


class CampaignTest(NamedTuple):
    """A test of the run's campaign, with the properties that predictions need."""

    kind: str
    source: str  # unit of the source; empty if there is none
    response: str  # measured quantity; for a controlled response, the source
    level: float | None = None  # level of the test; None if unknown
    family: str = ""  # name of the data group that all tests of one level form
    drive: str = ""  # the drive; empty if unknown
    stated_unit: str = ""  # unit of the response in the record; empty if not stated


@dataclass(frozen=True)
class Basis:
    """The inputs of predictions: posterior draws, fixed parameters, known tests and laws."""

    posterior: xr.Dataset  # the main posterior, with dimensions (chain, draw)
    held: Mapping[str, float]  # parameters that were fixed
    seen: Mapping[str, CampaignTest]  # tests of the run's campaign; empty if unknown
    y_peak: float  # largest fitted displacement [m]; 0 if unknown
    # standard deviations of omega_n [rad/s] and zeta between runs; empty without run offsets
    scatter: tuple[float, ...]
    substeps: int  # solver steps between samples
    decay: xr.Dataset  # posterior of the free decays alone, or else the main posterior
    # Constants of the fitted decays: `worth` is the share of their values that are independent,
    # `shift_std` is the standard deviation of natural frequencies between records [rad/s].
    decay_facts: DecayConstants
    laws: Laws
    # Draws of omega_n and zeta in each fitted run, one for each evenly spaced posterior draw; None
    # without run offsets.
    runs: xr.Dataset | None = None
    # Other laws, each with its share of the draws. The tests and the noise of this basis apply to
    # all of them.
    beside: tuple[tuple[float, "Basis"], ...] = ()
    # Compared laws that predict tests beyond the fitted amplitudes (`outward`) and other kinds of
    # test (`across`). If None, the law of this basis predicts these tests.
    outward: "Basis | None" = None
    across: "Basis | None" = None
    # Residual terms that only some units of a population have; predictions of new units omit them.
    lacking: tuple[str, ...] = ()
    points: tuple[str, ...] = ()  # additional points where responses are measured
    discrepancy: Discrepancy | None = None  # model discrepancy of the law; None if unknown
    # laws that the fitted tests do not exclude, and that may slip fully at larger amplitudes
    rivals: Laws = ()

    def shared(self, num_draws: int) -> tuple[tuple[int, "Basis"], ...]:
        """Return each law's number of draws and the inputs of the predictions with this law."""
        counts = [(round(share * num_draws), basis) for share, basis in self.beside]
        counts = [(count, basis) for count, basis in counts if count >= 2]
        num_first = num_draws - sum(count for count, _ in counts)
        return ((max(num_first, 2) if counts else num_first, replace(self, beside=())), *counts)

    def thinned(self, num_draws: int, posterior: xr.Dataset | None = None) -> Draws:
        """Return evenly spaced draws of a posterior, together with the fixed parameters."""
        if num_draws < 2:
            raise ConfigError(
                f"Argument `draws` must be at least 2, but is {num_draws}.",
                why="The ends of a band are quantiles of several draws.",
                remedy="Give about 100 draws or more for a 99 % band.",
            )
        chosen = self.posterior if posterior is None else posterior
        return thin(chosen, num_draws, self.held, laws=self.laws)

    def draws(
        self,
        num_draws: int,
        gain: float | None = None,
        seed: int = 0,
        drive: str = "",
        *,
        missed: AtAmplitude = NOTHING,
    ) -> Draws:
        """Draw the parameters of a joint in a new run, with the gain [N/kg per unit of the source].

        Parameters of a drive with separate ones are returned under their plain names; for other
        drives, under all names. `missed` is the model discrepancy that the draws include.
        """
        key = jax.random.fold_in(jax.random.key(seed), SCATTER_KEY)
        theta = self._complete(dict(of_drive(self.thinned(num_draws), drive)), gain)
        return scattered(key, theta, self._scatter(theta, missed))

    def _scatter(self, draws: Draws, missed: AtAmplitude) -> tuple[float, ...]:
        """Return the sd of omega_n and zeta, from differences of runs and model discrepancy."""
        by_law = missed.frequency * float(np.mean(draws["omega_n"])), missed.damping
        if not any(by_law):
            return self.scatter
        return tuple(np.hypot(self.scatter or (0.0, 0.0), by_law).tolist())

    def draws_for(
        self,
        test: Test,
        num_draws: int,
        gain: float | None = None,
        seed: int = 0,
        *,
        missed: AtAmplitude = NOTHING,
    ) -> Draws:
        """Return the draws that predict a test; for a fitted run, with the run's omega_n and zeta.

        Free decays use draws of their own posterior and no gain.
        """
        name, drive = self.run_of(test), drive_of(test)
        if test.traits.is_free:
            return dict(of_drive(self.thinned(num_draws, self.decay), drive))
        if self.runs is None or name is None:
            return self.draws(num_draws, gain, seed, drive, missed=missed)
        run = self.runs.sel(run=name)
        count = run.sizes["draw"]
        theta = self.thinned(count)
        theta |= {str(n): v.values for n, v in run.data_vars.items() if plain(str(n)) in OFFSETS}
        theta = of_drive(theta, drive)
        indices = np.unique(np.linspace(0, count - 1, num_draws).round().astype(int))
        return self._complete({name: values[indices] for name, values in theta.items()}, gain)

    def run_of(self, test: Test) -> str | None:
        """Return the name of a test's run if this run was fitted; None for a new run."""
        fitted_runs = () if self.runs is None else self.runs["run"].values.tolist()
        names = (name for name in (run_of(test), family_of(test)) if name in fitted_runs)
        return next(names, None) if test.name in self.seen else None

    def has_fitted_kind(self, kind: str) -> bool:
        """Return whether any test of a kind was fitted."""
        labels = noise_by_label(self.posterior)
        kinds = {
            seen.kind
            for name, seen in self.seen.items()
            if any(belongs_to(label, name) for label in labels)
        }
        return kind in kinds

    @property
    def misses(self) -> bool:
        """Whether the error of the law exceeds the noise of held-out tests."""
        return self.discrepancy is not None and not self.discrepancy.is_nothing

    def why_withheld(self, amplitudes: Iterable[float]) -> str:
        """Return why the law's error at the given amplitudes is unknown; "" if bands are stated."""
        reached, discrepancy = list(amplitudes), self.discrepancy
        if self.rivals and max(reached, default=0.0) > BEYOND * self.y_peak > 0:
            return messages.rivals_not_excluded(self.rivals)
        if discrepancy is None or all(map(discrepancy.is_stated, reached)):
            return ""
        return messages.ERROR_UNKNOWN

    def has_fitted(self, test: Test) -> bool:
        """Return whether a test was fitted: a fitted group's name begins with the test's name."""
        fitted = noise_by_label(self.posterior)
        matches = (belongs_to(label, test.name) for label in fitted)
        return any(matches) and self.seen.get(test.name, seen_of(test))[:3] == seen_of(test)[:3]

    def model_error(self, test: Test, missed: AtAmplitude) -> float:
        """Return a response's relative error due to the law, without errors of omega_n and zeta."""
        return 0.0 if self.discrepancy is None else self.discrepancy.share_of(test.kind, missed)

    def scatters(self, test: Test) -> bool:
        """Return whether a test's bands include the variation between runs."""
        return len(self.scatter) > 0 and (self.runs is None or self.run_of(test) is None)

    def _complete(self, draws: Draws, gain: float | None) -> Draws:
        """Return draws with a given gain; raise if a parameter of the response is missing."""
        if gain is not None:
            draws["gain"] = np.full(count_of(draws) if draws else 0, gain)
        missing = [name for name in parameter_names(self.laws) if name not in draws]
        if missing:
            raise DataError(
                f"The run's main posterior lacks {', '.join(missing)}, which a prediction needs.",
                remedy="State `gain` or `modal_mass` in the campaign of the tests to predict."
                if missing == ["gain"]
                else "Identify from tests that move the mass, such as noise, sweeps or tones.",
            )
        return draws


def natural_hz(draws: Draws) -> list[float]:
    """Return the mean natural frequency of every mode in the draws [Hz]."""
    names = ("omega_n", *(omega.name for omega, *_ in MODES))
    return [float(np.mean(draws[name])) / (2 * np.pi) for name in names if name in draws]


def count_of(draws: Mapping[str, Any]) -> int:
    """Return the number of draws in a mapping of draws by name."""
    return len(next(iter(draws.values())))


def parameter_names(laws: Laws) -> tuple[str, ...]:
    """Return the names of the parameters of oscillator and laws, and `gain`."""
    return ("omega_n", "zeta", *(quantity.name for quantity in quantities_of(laws)), "gain")


def thin(
    posterior: xr.Dataset, num_draws: int, held: Mapping[str, float] | None = None, *, laws: Laws
) -> Draws:
    """Return at most `num_draws` evenly spaced draws of all parameters, by name."""
    keep = evenly_spaced(posterior, num_draws)
    fixed = {name: np.full(len(keep), float(value)) for name, value in (held or {}).items()}
    terms = (term.name for term in (*RESIDUAL_TERMS, *MODAL, *own_quantities(laws)))
    others = (quantity.name for quantity in ATTACHED)
    names = [name for name in (*parameter_names(laws), *terms, *others) if name in posterior]
    names += motion_factors_in(posterior)
    return {**fixed, **{name: posterior[name].values.ravel()[keep] for name in names}}


def scattered(key: Key[Array, ""], draws: Draws, scatter: ArrayLike) -> Draws:
    """Draw parameters of a new run: omega_n + b_1, zeta + b_2, b ~ N(0, diag(s^2))."""
    std = np.asarray(scatter)
    if not std.size:
        return draws
    b = std * generator(key).standard_normal((count_of(draws), len(OFFSETS)))
    moved = {name: draws[name] + b[:, i] for i, name in enumerate(OFFSETS)}
    # Damping must stay positive, so an offset reduces the damping to a hundredth at most.
    return {**draws, **moved, "zeta": np.maximum(moved["zeta"], 0.01 * draws["zeta"])}


def laws_of_run(tree: xr.DataTree) -> Laws:
    """Return a run's laws; for runs before jbw 0.1, the default law and any cubic spring."""
    if "posterior" not in tree.children:
        raise DataError(
            "The result has no group /posterior, from which predictions are made.",
            remedy="Give the folder of a finished run.",
        )
    if (laws := DrawnPosterior.of(tree).laws) is not None:
        return laws
    return (*DEFAULT_LAWS, "cubic") if "cubic" in tree["posterior"] else DEFAULT_LAWS


def basis_attrs(
    tests: Sequence[Test], data: Dataset, held: Mapping[str, float], omega_n: float
) -> dict[str, Any]:
    """Return the attributes that predictions need in addition to draws; `basis_of` reads them."""
    shared = [part for part in data.parts if not part.own_shifts]
    counts = (part.substeps for part in shared)
    attrs: dict[str, Any] = {
        "held": json.dumps(dict(held)),
        "tests": json.dumps({test.name: seen_of(test)._asdict() for test in tests}),
        "substeps": max(filter(None, counts), default=SUBSTEPS),
        "y_peak": largest_displacement(data, omega_n),
        "laws": json.dumps(data.laws),
    }
    if data.modes is not None and data.modes.points:
        attrs["points"] = json.dumps(data.modes.points)
    scatter = np.asarray(data.scatter)
    return attrs | ({"scatter": scatter} if scatter.size else {})


def decay_attrs(data: Decays) -> dict[str, str]:
    """Return the attributes that predictions from a posterior of free decays need."""
    constants = {"worth": data.fraction, "shift_std": data.shift_std, "substeps": data.substeps}
    return {"decay": json.dumps({name: float(value) for name, value in constants.items()})}


def basis_of(tree: xr.DataTree) -> Basis:
    """Return the inputs of a run's predictions from its stored result."""
    laws, stored = laws_of_run(tree), DrawnPosterior.of(tree)
    posterior = posterior_draws(tree)
    # Predicted measurements have the same instrument errors, so their uncertainty is not added.
    if AS_RECORDED in tree.children:
        posterior = posterior.assign(tree[AS_RECORDED].to_dataset().data_vars)
    return Basis(
        posterior,
        stored.held,
        {name: CampaignTest(**facts) for name, facts in stored.tests.items()},
        stored.y_peak or 0.0,
        stored.scatter,
        stored.substeps or SUBSTEPS,
        _of_decays(tree, posterior, laws),
        stored.decay,
        laws,
        tree["runs"].to_dataset() if "runs" in tree.children else None,
        lacking=stored.lacking,
        points=stored.points,
        discrepancy=discrepancy_in(tree["discrepancy"].to_dataset())
        if "discrepancy" in tree.children
        else None,
        rivals=stored.rivals,
    )


def _of_decays(tree: xr.DataTree, posterior: xr.Dataset, laws: Laws) -> xr.Dataset:
    """Return the decays' own posterior if it contains the joint, else the given posterior.

    Free decays are predicted with this posterior.
    """
    place = "/steps/decay/posterior"
    own = tree[place].to_dataset() if place in tree.groups else posterior
    of_joint = {quantity.name for quantity in quantities_of(laws)} & set(posterior)
    return own if of_joint <= set(own) else posterior


def noise_by_label(posterior: xr.Dataset) -> dict[str, float]:
    """Return the mean noise of each data group in a posterior, by the group's label."""
    noise = {}
    for name, values in posterior.data_vars.items():
        dims = [dim for dim in values.dims if dim not in ("chain", "draw")]
        if str(name).startswith("noise_std") and len(dims) == 1 and dims[0] in values.coords:
            means = values.mean(("chain", "draw")).values
            noise |= dict(zip(map(str, values[dims[0]].values), map(float, means), strict=True))
    return noise


def seen_of(test: Test) -> CampaignTest:
    """Return the properties of a test that predictions need: kind, source unit, quantity."""
    record = test.records[0]
    place = (test.level if np.isfinite(test.level) else None, family_of(test), drive_of(test))
    if test.traits.is_prescribed:
        return CampaignTest(test.kind, "N", "restoring_force", *place)
    source = record.source if any(role in record.channels for role in INPUTS) else ""
    response = next((role for role in RESPONSES if role in record.channels), "")
    if test.traits.is_controlled:
        response = source
    elif test.traits.is_curve:
        curve = response_curve(record)
        if curve.is_ratio:
            response = f"{response} ratio"
        elif response_held(curve):
            response = source
    # A free decay has no source, even if its record includes an input.
    unit = "" if test.traits.is_free else record.units.get(source, "")
    # The text after the unit states its conversion to SI.
    stated_unit = record.provenance.get(f"unit of {response}", "").partition(",")[0]
    return CampaignTest(test.kind, unit, response, *place, stated_unit)
