"""Predictions of a run's response to other loads, with bands from posterior draws.

A member holds the draws of one law as oscillators of equivalent stiffness and loss. Bands contain
the uncertainty of parameters, the variation between runs and the model discrepancy at the amplitude
of the load; they do not contain measurement noise.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypedDict

import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.errors import ConfigError, ModelError
from jbw.forced.curves import peaks
from jbw.forced.equivalent import EquivalentMotion, Values, equivalent_motion
from jbw.identification.discrepancy import NOTHING, AtAmplitude
from jbw.inference.thresholds import BEYOND
from jbw.measurement.records import BASE
from jbw.observables.residual_terms import receptance, taken
from jbw.oscillator.modes.parameters import has_further_modes
from jbw.oscillator.oscillator import Oscillator, oscillator_of
from jbw.quantities import UNIT_OF, are_at_joints, derivative_order
from jbw.report.messages import loads as messages
from jbw.units import FACTORS, factor_of
from jbw.verification.bands import QUANTILE_AXIS, QUANTILES
from jbw.verification.predictive_basis import NUM_DRAWS, Basis, Draws
from jbw.verification.withheld import is_withheld

FEW = 4  # number of draws for a first estimate of the amplitude under a load
# One harmonic is accurate to 1e-5 up to this ratio of the third harmonic to the first.
ONE_HARMONIC = 1e-3
MANY = 8  # number of odd harmonics that are computed above the ratio `ONE_HARMONIC`
TAU = 2.0 * np.pi
Complexes = NDArray[np.complex128]


@dataclass(frozen=True)
class Load:
    """A load on the structure, with the settings of its prediction.

    Attributes:
        drive: `force` for the source of the run; `voltage` or `current` where a run has both; or
            `base` for an acceleration of the base [m/s^2].
        draws: Number of draws of the posterior.
        participation: Participation of the mode in the motion of the base, phi^T M r [-]. NaN
            stands for the identified one of a run with a moving base, and for 1 of other runs.
        shape: Deflection of the measured point in the mode shape [-].
        harmonics: Number of odd harmonics; None takes 8 where the third one is above 1e-3 of the
            first.
        unit: Unit of the response, such as `g`; that of the records if empty.
        seed: Seed of the variation between runs.
    """

    drive: str = "force"
    draws: int = NUM_DRAWS
    participation: float = float("nan")
    shape: float = 1.0
    harmonics: int | None = None
    unit: str = ""
    seed: int = 0

    @property
    def is_base(self) -> bool:
        """Whether the load is a motion of the base."""
        return self.drive == BASE


def load_on(basis: Basis, load: Load) -> Load:
    """Return the load with its participation factor: stated, identified, or 1.

    Raises:
        ConfigError: The stated participation is zero or infinite.
    """
    stated = load.participation
    if np.isnan(stated):
        identified = any(test.drive == BASE for test in basis.seen.values())
        gain = float(np.mean(basis.draws(load.draws)["gain"])) if identified else 1.0
        return replace(load, participation=gain)
    if np.isinf(stated) or stated == 0.0:
        raise ConfigError(
            f"Argument `participation` must be a number other than zero, but is {stated:g}.",
            remedy="Compute `participation` from the matrices, as phi^T M r with the mode shape "
            "phi scaled to unit modal mass.",
        )
    return load


class LoadOptions(TypedDict, total=False):
    """The keyword arguments of predictions under other loads, which are the fields of `Load`."""

    drive: str
    draws: int
    participation: float
    shape: float
    harmonics: int | None
    unit: str
    seed: int


class Member(NamedTuple):
    """Posterior draws of one law, as oscillators with amplitude-dependent stiffness and damping.

    Attributes:
        motion: The oscillators of equivalent stiffness and loss.
        theta: The parameters by name, of shape (draw,).
        share: Force per unit mass and unit of the source, of shape (draw, 1).
    """

    motion: EquivalentMotion
    theta: Draws
    share: Values


class SeenResponse(NamedTuple):
    """The response that is predicted: its quantity, its unit, and the unit of the source.

    Attributes:
        name: Quantity: displacement, velocity or acceleration.
        unit: Unit of the quantity.
        factor: Factor from SI to the unit.
        source: Unit of the source, such as N or V.
    """

    name: str
    unit: str
    factor: float
    source: str

    @property
    def attrs(self) -> dict[str, str]:
        """The unit and the name of the response as attributes of a variable."""
        return {"units": self.unit, "long_name": self.name}


def joints_of_basis(basis: Basis, draws: int = NUM_DRAWS) -> Oscillator:
    """Return the posterior draws as one oscillator whose arrays have the shape (draw,)."""
    _require_one_mode(basis)
    if basis.beside:
        raise ConfigError(
            "A comparison of several laws has no single joint.",
            remedy="Load the run of a single law.",
        )
    theta = basis.draws(draws, gain=1.0)
    return oscillator_of({name: jnp.asarray(x) for name, x in theta.items()}, basis.laws)


def measured_of(basis: Basis, load: Load) -> SeenResponse:
    """Return the response that the run measured, with its unit and the unit of its source."""
    driven = [seen for seen in basis.seen.values() if seen.response in UNIT_OF]
    name = "acceleration" if load.is_base else driven[0].response if driven else "displacement"
    stated = [seen.stated_unit for seen in driven if seen.response == name]
    is_unit = bool(stated) and stated[0] in FACTORS[name]
    unit = load.unit or (stated[0] if is_unit else UNIT_OF[name])
    factor = 1.0 / factor_of(unit, name)
    sources = [seen.source for seen in driven if seen.source]
    per_mass = "N/kg" if basis.held.get("gain", 1.0) == 1.0 else "N"
    source = "m/s^2" if load.is_base else sources[0] if sources else per_mass
    return SeenResponse(name, unit, factor, source)


def members_of(basis: Basis, load: Load, draws: int, missed: AtAmplitude) -> list[Member]:
    """Return the draws of each law of a run as oscillators, with the load's number of harmonics.

    Raises:
        ConfigError: There are too few draws.
        DataError: The run determines no gain.
        ModelError: The run has several modes or joints.
    """
    _require_one_mode(basis)
    found = []
    for count, member in basis.shared(draws):
        gain = load.participation if load.is_base else None
        drive = "" if load.is_base else load.drive
        theta = member.draws(count, gain, load.seed, drive, missed=missed)
        joint = oscillator_of({name: jnp.asarray(x) for name, x in theta.items()}, member.laws)
        motion = equivalent_motion(joint, load.harmonics or 1)
        found.append(Member(motion, theta, theta["gain"][:, None]))
    return found


def _require_one_mode(basis: Basis) -> None:
    if has_further_modes(basis.posterior) or are_at_joints(basis.laws):
        raise ModelError(
            "The run must have one mode with one joint for this prediction, but has several.",
            remedy="Follow the curve of a `jbw.Structure` by `jbw.response_curve`, or predict a "
            "sweep by `jbw predict RUN --sweep`.",
        )


class Prepared(NamedTuple):
    """Posterior draws prepared for one level of a load, with the amplitude that they reach.

    Attributes:
        members: The draws of every law.
        reach: Ratio of the largest amplitude to the largest fitted amplitude; NaN where unknown.
        withheld: Whether no band can be stated at this amplitude.
        load: The load, with the number of harmonics.
        warnings: Sentences that must be considered before the prediction is trusted.
    """

    members: list[Member]
    reach: float
    withheld: bool
    load: Load
    warnings: tuple[str, ...]

    @property
    def facts(self) -> dict[str, Any]:
        """The attributes of a prediction: amplitude, whether its band is withheld, warnings."""
        said = "\n".join(self.warnings)
        return {"reach": self.reach, "withheld": int(self.withheld), "warnings": said}


def prepared(
    basis: Basis, load: Load, amplitude: Callable[[Member], Values], what: str
) -> Prepared:
    """Prepare the draws of all laws for a load, with the model discrepancy at the load's amplitude.

    Args:
        basis: The draws and settings from which the run predicts.
        load: The load.
        amplitude: A function that returns the largest displacement of every draw of a member [m].
        what: The load in words, for warnings.
    """
    few = members_of(basis, replace(load, harmonics=1), FEW, NOTHING)
    y = float(np.median(np.concatenate([np.ravel(amplitude(member)) for member in few])))
    reach = y / basis.y_peak if basis.y_peak > 0 else np.nan
    if reach > BEYOND and basis.outward is not None:
        basis = basis.outward
    if load.harmonics is None:
        load = replace(load, harmonics=_harmonics(few[0], y))
    missed = NOTHING if basis.discrepancy is None else basis.discrepancy.at(y)
    members = members_of(basis, load, load.draws, missed)
    withheld = is_withheld(basis, (y,))
    warnings = tuple(messages.warnings_of(what, y, reach, BEYOND, withheld=withheld))
    return Prepared(members, reach, withheld, load, warnings)


def _harmonics(member: Member, y: float) -> int:
    """Return the number of odd harmonics for an amplitude [m]: 1 if the third is small, else 8."""
    motion = member.motion
    amplitude = np.full((len(motion.omega_n), 1), y)
    stiffness, _ = motion.values(amplitude, motion.omega_n)
    third = motion.shapes(amplitude, np.sqrt(np.maximum(stiffness, 0.0)))[1]
    return 1 if np.nanmax(third, initial=0.0) < ONE_HARMONIC else MANY


def response_of(
    member: Member, load: Load, seen: SeenResponse, level: float, omega: Values, y: Complexes
) -> Complexes:
    """Return the response to a load in the requested unit, from displacements per draw.

    Displacements y are in m, with phases relative to the force.

    Under a force the modes outside the band add to the response. On a moving base the response is
    the absolute acceleration of the point. All arrays have the shape (draw, any).
    """
    if load.is_base:
        sign = np.sign(load.participation)
        return seen.factor * (level + load.shape * omega**2 * sign * y)
    gain = member.share
    terms = {name: jnp.asarray(x)[:, None] for name, x in taken(member.theta, "auto").items()}
    added = gain * level * np.asarray(receptance(terms, jnp.asarray(omega))) if terms else 0.0
    order = derivative_order(seen.name)
    return seen.factor * (1j * omega) ** order * (np.sign(gain) * y + added)


def level_of(member: Member, level: float) -> Values:
    """Return each draw's force amplitude per unit mass at a level of the source [N/kg]."""
    return np.abs(member.share) * level


def peak_of(level: float) -> Callable[[Member], Values]:
    """Return a function that computes each draw's peak displacement [m] at a source level."""
    return lambda member: peaks(member.motion, level_of(member, level)).y


def bands(values: Sequence[Values], *, withheld: bool = False) -> Values:
    """Return the 99 % band (low, median, high) over all draws; both ends are NaN if withheld.

    Draws without a value are ignored, such as the jump of a curve that does not fold.
    """
    drawn = np.concatenate(values)
    found = np.full((len(QUANTILES), *drawn.shape[1:]), np.nan)
    has_value = np.any(np.isfinite(drawn), axis=0)
    found[:, has_value] = np.nanquantile(drawn[:, has_value], QUANTILES, axis=0)
    if withheld:
        found[[0, -1]] = np.nan
    return found


def labelled(
    variables: Mapping[str, Any], coords: Mapping[str, Any], load: Load, seen: SeenResponse
) -> xr.Dataset:
    """Return a dataset of a predicted response, with attributes that describe its load."""
    facts = {
        "drive": load.drive, "source_unit": seen.source, "quantity": seen.name,
        "num_draws": load.draws, "harmonics": load.harmonics or 1, "band": messages.IN_BANDS,
    }  # fmt: skip
    if load.is_base:
        facts |= {"participation": load.participation, "shape": load.shape}
    return xr.Dataset(dict(variables), {**coords, "quantile": QUANTILE_AXIS}, facts)


def checked_levels(values: Iterable[float]) -> list[float]:
    """Return the levels of a load as numbers; raise an error if one is not positive and finite."""
    levels = [float(value) for value in values]
    wrong = [value for value in levels if not 0.0 < value < np.inf]
    if wrong or not levels:
        found = f"{wrong[0]:g}" if wrong else "no value"
        raise ConfigError(
            f"Levels, limits and durations must be positive, but {found} was given.",
            remedy="Give amplitudes in the unit of the source, such as 0.1.",
        )
    return levels


def checked_band(band_hz: tuple[float, float]) -> tuple[float, float]:
    """Return a frequency band [Hz]; raise an error unless its ends are positive and increasing."""
    low, high = map(float, band_hz)
    if not 0.0 < low < high < np.inf:
        raise ConfigError(
            f"Argument `band` must rise from a positive frequency, but is {low:g} to {high:g} Hz.",
            remedy="Give the band as `17:20`.",
        )
    return low, high
