"""Predictions of a run's response to other loads, with bands from posterior draws.

A member holds the draws of one law as oscillators of equivalent stiffness and loss, for one mode.
Several modes are predicted one by one, which needs modes that are far apart. Bands contain the
uncertainty of parameters, the variation between runs and the model discrepancy at the amplitude of
the load; they do not contain measurement noise.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypedDict

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.errors import ConfigError, DataError, ModelError
from jbw.forced.curves import peaks
from jbw.forced.equivalent import EquivalentMotion, Values, equivalent_motion
from jbw.identification.discrepancy import NOTHING, AtAmplitude
from jbw.inference.thresholds import BEYOND
from jbw.measurement.records import BASE
from jbw.observables.residual_terms import receptance, taken
from jbw.oscillator.law import laws_in
from jbw.oscillator.modes.assembled import is_assembled
from jbw.oscillator.modes.parameters import NAMES, has_further_modes, modal_structure_of
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Oscillator, oscillator_of
from jbw.quantities import UNIT_OF, are_at_joints, derivative_order
from jbw.report.messages import loads as messages
from jbw.units import FACTORS, factor_of
from jbw.verification.bands import QUANTILE_AXIS, QUANTILES
from jbw.verification.predictive_basis import NUM_DRAWS, Basis, Draws

LOAD_DRAWS = 200  # default number of draws; the least that gives the ends of a 99 % band
FEW = 4  # number of draws for a first estimate of the amplitude under a load
# One harmonic is accurate to 1e-5 up to this ratio of the third harmonic to the first.
ONE_HARMONIC = 1e-3
MANY = 8  # number of odd harmonics that are computed above the ratio `ONE_HARMONIC`
# smallest distance between two modes that are predicted one by one, in half-power widths
APART = 10.0
# odd multiples of a frequency at which another mode takes up energy, and tolerance for these
ORDERS, NEAR = (3, 5), 0.05
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
        mode: Number of the mode whose resonance is predicted, from 1.
    """

    drive: str = "force"
    draws: int = LOAD_DRAWS
    participation: float = float("nan")
    shape: float = 1.0
    harmonics: int | None = None
    unit: str = ""
    seed: int = 0
    mode: int = 1

    @property
    def is_base(self) -> bool:
        """Whether the load is a motion of the base."""
        return self.drive == BASE


def load_on(basis: Basis, load: Load) -> Load:
    """Return the load with its participation factor: stated, identified, or 1.

    Raises:
        ConfigError: The stated participation is zero or infinite, or does not apply to all modes.
    """
    stated = load.participation
    identified = any(test.drive == BASE for test in basis.seen.values())
    is_one_for_all = not (identified and np.isnan(stated))
    if load.is_base and is_one_for_all and has_several(basis.posterior, basis.laws):
        raise ConfigError(
            "A moving base needs the participation of every mode. The run has several modes, but "
            "was not identified on a moving base, or `participation` states only one number.",
            remedy="Identify a test on a moving base, and leave out `participation`.",
        )
    if np.isnan(stated):
        gain = float(np.mean(basis.draws(load.draws, drive=BASE)["gain"])) if identified else 1.0
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
    mode: int


class Member(NamedTuple):
    """Posterior draws of one law, as oscillators with amplitude-dependent stiffness and damping.

    Attributes:
        motion: The oscillators of equivalent stiffness and loss, of one mode.
        theta: The parameters by name, of shape (draw,).
        share: Force on the mode per unit mass and unit of the source, of shape (draw, 1).
    """

    motion: EquivalentMotion
    theta: Draws
    share: Values

    def measured(self, y: Values, omega: Values) -> Values:
        """Return the measured displacements [m] at amplitudes y of the mode, (draw, any)."""
        return y * np.abs(self.motion.seen(y, omega))

    def resonant(self, y: Values) -> Values:
        """Return the resonance frequency [rad/s] at amplitudes y of the mode, (draw, any)."""
        stiffness, _ = self.motion.values(y, np.broadcast_to(self.motion.omega_n, y.shape))
        return np.sqrt(np.maximum(stiffness, 0.0))


class SeenResponse(NamedTuple):
    """The response that is predicted: its quantity, its unit, and the unit of the source.

    Attributes:
        name: Quantity: displacement, velocity or acceleration.
        unit: Unit of the quantity.
        factor: Factor from SI to the unit.
        source: Unit of the source, such as N or V.
        in_bands: What the bands of the run contain, in words.
    """

    name: str
    unit: str
    factor: float
    source: str
    in_bands: str = messages.PARAMETERS

    @property
    def attrs(self) -> dict[str, str]:
        """The unit and the name of the response as attributes of a variable."""
        return {"units": self.unit, "long_name": self.name}


def joints_of_basis(basis: Basis, draws: int = NUM_DRAWS) -> Oscillator | Structure:
    """Return the posterior draws as one model whose arrays have a first axis of draws."""
    if basis.beside:
        raise ConfigError(
            "A model needs the run of a single law, but this run compares several laws.",
            remedy="Load the run of a single law.",
        )
    return model_of(basis.draws(draws, gain=1.0), basis.laws)


def model_of(theta: Draws, laws: tuple[str, ...]) -> Oscillator | Structure:
    """Return draws of parameters as an oscillator, or as a structure of several modes.

    Raises:
        DataError: The run determines no gain of a further mode.
    """
    arrays = {name: jnp.asarray(x) for name, x in theta.items()}
    if not has_several(theta, laws):
        return oscillator_of(arrays, laws)
    missing = [] if is_assembled(theta) else [
        mode.ratio for mode in NAMES if mode.omega in theta and mode.ratio not in theta
    ]  # fmt: skip
    if missing:
        raise DataError(
            f"The run's main posterior lacks {', '.join(missing)}, which a prediction needs.",
            remedy="Identify also from tests that drive these modes.",
        )
    return jax.vmap(lambda one: modal_structure_of(one, laws))(arrays)


def has_several(theta: Iterable[Hashable], laws: tuple[str, ...]) -> bool:
    """Return whether parameters and laws describe several modes or joints."""
    return has_further_modes(theta) or are_at_joints(laws)


def measured_of(basis: Basis, load: Load) -> SeenResponse:
    """Return the response that the run measured, with its unit and the unit of its source."""
    driven = [seen for seen in basis.seen.values() if seen.response in UNIT_OF]
    # If the base moves in some tests, a force load has the unit of the tests with a force.
    driven = [seen for seen in driven if (seen.drive == BASE) == load.is_base] or driven
    name = "acceleration" if load.is_base else driven[0].response if driven else "displacement"
    stated = [seen.stated_unit for seen in driven if seen.response == name]
    is_unit = bool(stated) and stated[0] in FACTORS[name]
    unit = load.unit or (stated[0] if is_unit else UNIT_OF[name])
    factor = 1.0 / factor_of(unit, name)
    sources = [seen.source for seen in driven if seen.source]
    per_mass = "N/kg" if basis.held.get("gain", 1.0) == 1.0 else "N"
    source = "m/s^2" if load.is_base else sources[0] if sources else per_mass
    in_bands = messages.in_bands(scatters=len(basis.scatter) > 0, misses=basis.misses)
    return SeenResponse(name, unit, factor, source, in_bands)


def members_of(basis: Basis, load: Load, draws: int, missed: AtAmplitude) -> list[Member]:
    """Return the draws of each law of a run as oscillators, with the load's number of harmonics.

    Raises:
        ConfigError: There are too few draws.
        DataError: The run determines no gain.
        ConfigError: The run has no such mode.
    """
    found = []
    for count, member in basis.shared(draws):
        gain = load.participation if load.is_base else None
        drive = "" if load.is_base else load.drive
        theta = member.draws(count, gain, load.seed, drive, missed=missed)
        joint, share = model_of(theta, member.laws), theta["gain"][:, None]
        motion = equivalent_motion(joint, load.harmonics or 1, load.mode - 1)
        if isinstance(joint, Structure):
            share = share * np.asarray(joint.b)[:, load.mode - 1, None]
        found.append(Member(motion, theta, share))
    return found


class Zone(NamedTuple):
    """The frequencies that are nearer to one mode than to the others [rad/s]."""

    mode: int
    omega: float  # natural frequency of the mode
    low: float
    high: float

    def holds(self, omega: Values) -> NDArray[np.bool_]:
        """Return whether each frequency [rad/s] lies in this mode's zone."""
        return (omega >= self.low) & (omega < self.high)

    def within(self, omega: Values) -> Values:
        """Return the given frequencies [rad/s] that lie in this mode's zone."""
        return omega[self.holds(omega)]


def zones_of(basis: Basis, load: Load) -> list[Zone]:
    """Return the zones of all driven modes, which meet at the frequencies' geometric means."""
    (_, first), *_ = basis.shared(max(FEW, 2))
    joint = model_of(first.draws(FEW, gain=1.0, seed=load.seed), first.laws)
    if not isinstance(joint, Structure):
        return [Zone(1, float(np.median(joint.omega_n)), 0.0, np.inf)]
    driven = np.flatnonzero(np.any(np.asarray(joint.b) != 0.0, axis=0))
    omega = np.median(np.asarray(joint.omega_n), axis=0)
    driven = driven[np.argsort(omega[driven])]
    middles = np.sqrt(omega[driven[1:]] * omega[driven[:-1]])
    ends = np.concatenate([[0.0], middles, [np.inf]])
    return [
        Zone(int(mode) + 1, float(omega[mode]), *ends[i : i + 2]) for i, mode in enumerate(driven)
    ]


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
        amplitude: A function that returns the largest amplitude of the mode, by draw [m].
        what: The load in words, for warnings.
    """
    few = members_of(basis, replace(load, harmonics=1), FEW, NOTHING)
    _require_widths(few[0].motion, few[0].motion.omega_n, few[0].motion.viscous, what)
    y = float(np.median(np.concatenate([np.ravel(amplitude(member)) for member in few])))
    y_seen = _require_apart(few[0], y, what)
    reach = y_seen / basis.y_peak if basis.y_peak > 0 else np.nan
    if reach > BEYOND and basis.outward is not None:
        basis = basis.outward
    if load.harmonics is None:
        load = replace(load, harmonics=1 if _third(few[0], y) < ONE_HARMONIC else MANY)
    missed = NOTHING if basis.discrepancy is None else basis.discrepancy.at(y_seen)
    members = members_of(basis, load, load.draws, missed)
    why = basis.why_withheld((y_seen,))
    warnings = (
        *messages.warnings_of(what, y_seen, reach, BEYOND, why),
        *_internal_resonances(few[0], y, what),
        *_thresholds_beyond(few[0], y, basis.y_peak, what),
    )
    return Prepared(members, reach, bool(why), load, warnings)


def by_zones(
    basis: Basis,
    load: Load,
    freq_hz: Values,
    amplitude: Callable[[Member], Values],
    what: str,
    predict: Callable[[Zone, Prepared], list[dict[str, Values]]],
) -> tuple[dict[str, list[Values]], Prepared]:
    """Predict each mode at the frequencies in the mode's zone, and join the predictions.

    Args:
        basis: The draws and settings from which the run predicts.
        load: The load.
        freq_hz: Frequencies in rising order [Hz].
        amplitude: As for `prepared`.
        what: The load in words.
        predict: Function that returns, for each law, arrays whose last axis grows with the zones.

    Returns:
        The arrays of each law by name, and the facts of all modes together.
    """
    zones = [zone for zone in zones_of(basis, load) if np.any(zone.holds(TAU * freq_hz))]
    readied = [prepared(basis, replace(load, mode=zone.mode), amplitude, what) for zone in zones]
    found = [predict(zone, ready) for zone, ready in zip(zones, readied, strict=True)]
    parts = {
        name: [np.concatenate([zone[name] for zone in of_law], -1)
               for of_law in zip(*found, strict=True)]
        for name in found[0][0]
    }  # fmt: skip
    return parts, together(readied)


def together(readied: Sequence[Prepared]) -> Prepared:
    """Combine the facts of several modes: largest reach, any withheld band, and all warnings."""
    reach, withheld = max(one.reach for one in readied), any(one.withheld for one in readied)
    harmonics = max(one.load.harmonics or 1 for one in readied)
    warnings = dict.fromkeys(line for one in readied for line in one.warnings)
    first = readied[0]
    load = replace(first.load, harmonics=harmonics)
    return Prepared(first.members, reach, withheld, load, tuple(warnings))


def _third(member: Member, y: float) -> float:
    """Return the ratio of the joints' third to first harmonic in resonance at an amplitude [m]."""
    amplitude = np.full((len(member.share), 1), y)
    third = member.motion.shapes(amplitude, member.resonant(amplitude))[1]
    return float(np.nanmax(third, initial=0.0))


def _require_apart(member: Member, y: float, what: str) -> float:
    """Return a mode's measured displacement [m]; raise an error if the next mode is too near.

    Raises:
        ModelError: Another mode is nearer than ten half-power widths.
    """
    motion = member.motion
    if not motion.has_further_modes:
        return y
    amplitude = np.full((len(member.share), 1), y)
    omega = member.resonant(amplitude)
    _, loss = motion.values(amplitude, omega)
    _require_widths(motion, omega, motion.viscous + loss / omega, what)
    return float(np.median(member.measured(amplitude, omega)))


def _require_widths(motion: EquivalentMotion, omega: Values, widths: Values, what: str) -> None:
    """Raise if the next mode is nearer than ten half-power widths, of medians over the draws."""
    if not motion.has_further_modes or np.shape(motion.joint.omega_n)[1] < 2:
        return
    own, width = float(np.median(omega)), float(np.median(widths))
    others = np.delete(np.median(np.asarray(motion.joint.omega_n), axis=0), motion.mode)
    nearest = others[np.argmin(np.abs(others - own))]
    if abs(nearest - own) < APART * width:
        raise ModelError(
            f"{what} needs a mode that is at least {APART:g} half-power widths from the next, but "
            f"mode {motion.mode + 1} at {own / TAU:.4g} Hz is {abs(nearest - own) / width:.2g} "
            "widths from the next.",
            why="Modes are predicted one by one, as if each mode moved alone.",
            remedy=messages.WITH_ALL_MODES,
        )


def _internal_resonances(member: Member, y: float, what: str) -> Iterator[str]:
    """Yield a warning if harmonics of the motion at an amplitude [m] are near another mode."""
    if not member.motion.has_further_modes or _third(member, y) < ONE_HARMONIC:
        return
    own = float(np.median(member.resonant(np.full((len(member.share), 1), y))))
    for other in np.median(np.asarray(member.motion.joint.omega_n), axis=0):
        if any(abs(other / (n * own) - 1.0) < NEAR for n in ORDERS):
            yield messages.internal_resonance(what, own / TAU, other / TAU)


def _thresholds_beyond(member: Member, y: float, y_peak: float, what: str) -> Iterator[str]:
    """Yield a warning for each threshold of a law that the load exceeds but the fit does not.

    The displacement of one of several joints is unknown in fitted tests, so that these are not
    compared.
    """
    if member.motion.has_further_modes:
        return
    for law in laws_in(member.motion.joint.laws):
        for threshold in law.thresholds():
            place = float(np.median(threshold.y))
            if 0.0 < y_peak < place < y:
                yield messages.threshold_beyond(what, threshold.what, place, threshold.rests)


def response_of(
    member: Member, load: Load, seen: SeenResponse, level: float, omega: Values, y: Complexes
) -> Complexes:
    """Return the response to a load in the requested unit, from displacements per draw.

    Displacements y of the mode are in m, with phases relative to the force.

    Under a force the modes outside the band add to the response. On a moving base the response is
    the absolute acceleration of the point. All arrays have the shape (draw, any).
    """
    y = np.sign(member.share) * y * member.motion.seen(np.abs(y), omega)
    if load.is_base:
        return seen.factor * (level + load.shape * omega**2 * y)
    gain = member.theta["gain"][:, None]
    terms = {name: jnp.asarray(x)[:, None] for name, x in taken(member.theta, "auto").items()}
    added = gain * level * np.asarray(receptance(terms, jnp.asarray(omega))) if terms else 0.0
    order = derivative_order(seen.name)
    return seen.factor * (1j * omega) ** order * (y + added)


def level_of(member: Member, level: float) -> Values:
    """Return each draw's force amplitude per unit mass at a level of the source [N/kg]."""
    return np.abs(member.share) * level


def peak_of(level: float) -> Callable[[Member], Values]:
    """Return a function that computes each draw's peak displacement [m] at a source level."""
    return lambda member: peaks(member.motion, level_of(member, level)).y


def bands(values: Sequence[Values], *, withheld: bool = False) -> Values:
    """Return the 99 % band (low, median, high) over all draws; both ends are NaN if withheld.

    Draws without a value are ignored, such as the jump of a curve that does not fold. The quantile
    p of n draws is the value number p (n + 1) in rising order, so that a further draw is outside
    with the probability 1 - 0.99, if there are `LOAD_DRAWS` or more.
    """
    drawn = np.concatenate(values)
    found = np.full((len(QUANTILES), *drawn.shape[1:]), np.nan)
    has_value = np.any(np.isfinite(drawn), axis=0)
    found[:, has_value] = np.nanquantile(drawn[:, has_value], QUANTILES, axis=0, method="weibull")
    if withheld:
        found[[0, -1]] = np.nan
    return found


def labelled(
    variables: Mapping[str, Any], coords: Mapping[str, Any], load: Load, seen: SeenResponse
) -> xr.Dataset:
    """Return a dataset of a predicted response, with attributes that describe its load."""
    facts = {
        "drive": load.drive, "source_unit": seen.source, "quantity": seen.name,
        "num_draws": load.draws, "harmonics": load.harmonics or 1, "band": seen.in_bands,
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
