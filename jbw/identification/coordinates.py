"""The parameters in which the joint posterior is sampled, their bounds, and their products.

Bounds of the prior are those that the campaign states; otherwise wide ones that follow from scales
of the data alone.
"""

import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping

import numpy as np

from jbw.campaign.settings import Identify
from jbw.errors import ConfigError, DataError
from jbw.identification.assembled import ASSEMBLED, joint_bounds
from jbw.identification.residual_terms import stated_terms, term_bounds
from jbw.inference.density import Density
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box, Product, bounds_by_name, box
from jbw.observables.dataset import Dataset, largest_displacement
from jbw.observables.drives import OWN, attached, named, of_drive, parts_of, plain
from jbw.observables.modes import Modes, bounds_of
from jbw.oscillator.law import Bounds, Coordinates, Law, Scales
from jbw.oscillator.laws import laws_named, same_by_construction
from jbw.oscillator.modes.parameters import own_name
from jbw.oscillator.oscillator import prior_of
from jbw.oscillator.parameters import MOST_SOFTENING
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import posterior as messages


def box_of(settings: Identify, data: Dataset, known: Mapping[str, float]) -> Box:
    """Return the prior bounds of the joint posterior: of the joint, and of the gain."""
    parts = parts_of("", data.parts)
    # The damping is undetermined only if all tests prescribe the displacement of the joint.
    forced = all("zeta" not in part.informs for part in parts)
    omega_n = known.get("omega_n")
    if not omega_n:
        omega_n = _stiffest(data) ** 0.5
    y_peak = largest_displacement(data, omega_n)
    scales = Scales(omega_n, known.get("zeta", 0.01), y_peak, forced)
    gain = None if "gain" in data.held else (known["gain"], min(p.shown().gain_std for p in parts))
    linear = any(part.is_linear for part in parts)
    several = data.modes if data.modes is not None and data.modes.meet == ASSEMBLED else None
    of_one_joint = data.laws if several is None else ()
    prior = joint_box(settings, scales, gain, of_one_joint, linear=linear)
    bounds = {name: pair for name, pair in bounds_by_name(prior).items() if name not in data.held}
    if "gain" in bounds and not any("gain" in part.shown().first_values() for part in parts):
        bounds["gain"] = settings.prior.get("gain", weighed_bounds(known["gain"]))
    for drive in attached(data.parts):
        bounds |= _bounds_of(drive, settings, data, known)
    bounds |= _bounds_beside(settings, data, known)
    if several is not None and data.laws:
        bounds |= joint_bounds(several, data, settings.prior, scales.zeta)
    if data.modes is not None and "omega_n" in bounds and "omega_n" not in settings.prior:
        window = (2 * np.pi * hz for hz in data.modes.windows_hz[0])
        (low, high), (lowest, highest) = window, bounds["omega_n"]
        bounds["omega_n"] = max(low, lowest), min(high, highest)
    stated = term_bounds(stated_terms(data), omega_n, settings.prior)
    _require_drives(settings.prior, data)
    _require_sampled(data.stated.names, bounds | stated)
    return box(bounds | stated)


def _stiffest(data: Dataset) -> float:
    """Return the stiffest loop's ratio of force to displacement, per unit mass [1/s^2]."""
    stiffnesses = (part.shown().stiffness() for part in data.parts)
    measured = [value for value in stiffnesses if value is not None]
    if not measured:
        raise DataError(
            "The campaign must contain a test that determines the natural frequency, but only one "
            f"frequency of steady motion is fitted ({', '.join(data.labels)}).",
            remedy="Add a free decay, noise, a sweep, or tones at other frequencies.",
        )
    return float(data.held.get("gain", 1.0)) * max(measured)


def _bounds_of(
    drive: str, settings: Identify, data: Dataset, estimates: Mapping[str, float]
) -> Bounds:
    """Return prior bounds of a drive's own omega_n, zeta and gain, unless these are fixed."""
    parts = parts_of(drive, data.parts)
    own = of_drive(estimates, drive)
    omega_n, zeta, gain = own["omega_n"], own.get("zeta", 0.01), own.get("gain")
    std = None if gain is None else (gain, min(part.shown().gain_std for part in parts))
    linear = any(part.is_linear for part in parts)
    wide = linear_bounds(Scales(omega_n, zeta, 0.0), std, linear=linear)
    bounds = {named(name, drive): pair for name, pair in wide.items() if name in OWN[drive]}
    return {n: settings.prior.get(n, pair) for n, pair in bounds.items() if n not in data.held}


def _bounds_beside(settings: Identify, data: Dataset, estimates: Mapping[str, float]) -> Bounds:
    """Return the prior bounds of the modal parameters of all modes after the first."""
    if data.modes is None:
        return {}
    wide = bounds_of(data.modes, estimates, with_joint=bool(data.laws))
    if data.modes.meet == "apart":
        wide |= _bounds_of_own_laws(data.modes, data, estimates)
    return {name: settings.prior.get(name, pair) for name, pair in wide.items()}


def _bounds_of_own_laws(modes: Modes, data: Dataset, estimates: Mapping[str, float]) -> Bounds:
    """Return the prior bounds of the separate laws of all modes after the first."""
    peaks = np.max([largest for p in data.parts if (largest := p.shown().peaks_of_modes)], axis=0)
    bounds: Bounds = {}
    for mode, (names, peak) in enumerate(zip(modes.names, peaks[1:], strict=True), 2):
        scales = Scales(estimates[names.omega], estimates[names.zeta], float(peak))
        law_bounds = prior_of(data.laws, scales)
        bounds |= {own_name(name, mode): pair for name, pair in law_bounds.items()}
    return bounds


def _require_sampled(densities: Collection[str], names: Collection[str]) -> None:
    """Raise a ConfigError if a prior is stated for a parameter that is not sampled."""
    for name in densities:
        if name not in names:
            raise ConfigError(
                f"[identify.prior] `{name}`: a distribution must be that of a sampled parameter, "
                f"but {', '.join(names)} are sampled.",
                remedy=f"State [lower, upper] for `{name}`, or a distribution for a sampled "
                "parameter.",
            )


def _require_drives(prior: Collection[str], data: Dataset) -> None:
    """Raise a ConfigError if a prior is stated for a drive that no fitted test has."""
    others = attached(data.parts)
    for name in prior:
        if plain(name) != name and not name.endswith(others):
            raise ConfigError(
                f"[identify.prior] `{name}`: needs tests of this drive in addition to tests of "
                "another drive, but the campaign does not fit both.",
                remedy=f"State the prior of `{plain(name)}` instead, or state `drive` in the "
                "tests.",
            )


def joint_box(
    settings: Identify,
    scales: Scales,
    gain: tuple[float, float] | None,
    laws: tuple[str, ...] = DEFAULT_LAWS,
    *,
    linear: bool = True,
) -> Box:
    """Return prior bounds of omega_n, zeta, the parameters of the laws, and the gain.

    The gain is given with its standard deviation. If `linear` is False, omega_n and zeta of the
    scales were determined at an amplitude that includes the joint's softening and losses, so they
    are only roughly those of the oscillator.
    """
    stated_prior, omega_n = settings.prior, scales.omega_n
    structure_bounds = linear_bounds(scales, gain, linear=linear)
    # The gain is a parameter of the source and comes last.
    last = {name: structure_bounds.pop(name) for name in ("gain",) if name in structure_bounds}
    bounds = structure_bounds | prior_of(laws, scales) | last
    bounds = {name: stated_prior.get(name, pair) for name, pair in bounds.items()}
    if (redundancy := same_by_construction(laws)) is not None:
        warnings.warn(redundancy, stacklevel=2)
    kinds = laws_named(laws)
    for law in kinds:
        _require_stiffness(law, {name: bounds[name] for name in law.names()}, stated_prior, omega_n)
    bounds |= _shared(kinds, bounds, stated_prior, omega_n)
    for law in kinds:
        law_bounds = {name: bounds[name] for name in law.names()}
        # With default bounds a law cannot diverge; with stated bounds it may.
        stated = {
            name: stated_prior.get(name, (max(pair[0], 0.0), pair[1]))
            for name, pair in law_bounds.items()
        }
        if (caution := law.caution(stated, scales.y_peak)) is not None:
            warnings.warn(caution, stacklevel=2)
    return box(bounds)


def linear_bounds(scales: Scales, gain: tuple[float, float] | None, *, linear: bool) -> Bounds:
    """Return prior bounds of omega_n, zeta and a gain, from estimates in the linear regime."""
    omega_n, zeta = scales.omega_n, scales.zeta
    bounds: Bounds = {"omega_n": (0.97 * omega_n, 1.03 * omega_n), "zeta": (0.2 * zeta, 3.0 * zeta)}
    if not linear:
        bounds |= {"omega_n": (0.7 * omega_n, 1.5 * omega_n), "zeta": (0.005 * zeta, 3.0 * zeta)}
    if scales.forced:
        bounds["omega_n"] = (0.2 * omega_n, MOST_SOFTENING**0.5 * omega_n)
    if gain is not None:
        size = abs(gain[0])  # The sign of a channel may be reversed.
        reach = max(0.1 * size, 8 * gain[1]) if np.isfinite(gain[1]) else 0.5 * size
        bounds["gain"] = (gain[0] - reach, gain[0] + reach)
    return bounds


def weighed_bounds(gain: float) -> tuple[float, float]:
    """Return prior bounds of a gain that is estimated from the secant stiffness of a loop."""
    # the sign of a channel may be reversed
    low, high = sorted((gain / MOST_SOFTENING, MOST_SOFTENING * gain))
    return low, high


def _require_stiffness(
    law: type[Law], bounds: Bounds, stated: Collection[str], omega_n: float
) -> None:
    """Raise a ConfigError if the prior admits a joint as stiff as the structure (omega_n^2)."""
    least = {name: pair[0] for name, pair in bounds.items()}
    for name in bounds.keys() & set(stated):
        stiffness = float(law.build({**least, name: bounds[name][1]}).stiffness())
        if stiffness >= omega_n**2:
            raise ConfigError(
                f"Prior of `{name}`: {name} < omega_n^2 must hold, but the upper bound of {name} "
                f"is {bounds[name][1]:g} and Step 2 estimates omega_n^2 = {omega_n**2:g}.",
                why="The stiffness of the joint is a part of the total stiffness, omega_n^2.",
                remedy=f"Lower the upper bound of {name} in [identify.prior].",
            )


def _shared(
    laws: Collection[type[Law]], bounds: Bounds, prior_names: Collection[str], omega_n: float
) -> Bounds:
    """Reduce the upper bounds of the laws' stiffnesses until their sum is a possible stiffness.

    Upper bounds that the campaign does not state are lowered by one factor; stated ones must leave
    room for them.
    """
    parts = [[q.name for q in law.table if q.is_share] for law in laws]
    names = [name for shares in parts for name in shares]
    stated = [name for name in names if name in prior_names]
    free = [name for name in names if name not in prior_names]
    held = sum(bounds[name][1] for name in stated)
    stiffest = max((sum(bounds[name][1] for name in shares) for shares in parts), default=0.0)
    total = omega_n**2 if stated else max(omega_n**2, stiffest)
    if held < omega_n**2 and sum(bounds[name][1] for name in names) <= total:
        return {}
    room = max(omega_n**2 - held, 0.0) if stated else stiffest
    scale = room / sum(bounds[name][1] for name in free) if free else 0.0
    lowered = {name: (bounds[name][0], scale * bounds[name][1]) for name in free}
    if held >= omega_n**2 or any(low >= high for low, high in lowered.values()):
        raise ConfigError(
            "The sum of the laws' stiffnesses must stay below omega_n^2, which Step 2 estimates as "
            f"{omega_n**2:g}, but the priors of {', '.join(f'`{name}`' for name in stated)} allow "
            f"a sum of {held:g}.",
            why="The stiffness of each law is a part of the total stiffness, omega_n^2.",
            remedy=f"Lower the upper bounds of {', '.join(stated)} in [identify.prior].",
        )
    return lowered


def chosen_coordinates(
    best: Fit, settings: Identify, laws: tuple[str, ...]
) -> Iterator[tuple[type[Law], Coordinates]]:
    """Yield each law that is sampled in alternative coordinates, with these coordinates.

    A campaign chooses them by `coordinates`. With "auto" they are used where the campaign bounds
    none of the law's parameters and the fit does not determine all of them.
    """
    for law in laws_named(laws):
        law_names, choice = set(law.names()), settings.coordinates
        if not law_names <= best.theta.keys():
            continue
        weak = set() if best.weak is None else law_names & set(best.weak.names)
        is_open = bool(weak) and not law_names & set(settings.prior)
        for name, coordinates in law.coordinates.items():
            if choice == name:
                densities = {n for n in law_names if isinstance(settings.prior.get(n), Density)}
                _require_sampled(sorted(densities), coordinates.names)
            if choice == name or (choice == "auto" and is_open):
                yield law, coordinates
                break


def coordinates_sentence(law: type[Law], coordinates: Coordinates) -> str:
    """Return the sentence on the sampled parametrisation, with the reason."""
    *most, last = law.names()
    meanings = "; ".join(quantity.meaning for quantity in coordinates.table)
    return messages.products_sampled(most, last, coordinates.names, meanings)


def coordinate_box(
    prior: Box,
    theta: Mapping[str, float],
    settings: Identify,
    law: type[Law],
    coordinates: Coordinates,
) -> Box:
    """Return the prior bounds in another parametrisation of a law, near a fit."""
    bounds = bounds_by_name(prior)
    other = law.coordinate_bounds(  # pyright: ignore[reportAttributeAccessIssue]
        coordinates.name, bounds, theta, dict(settings.prior)
    )
    merged: Bounds = {}
    for name, pair in bounds.items():
        merged |= other if name in law.names() else {name: pair}
    return box(merged)


def combinations(names: Iterable[str], laws: tuple[str, ...] = DEFAULT_LAWS) -> tuple[Product, ...]:
    """Return those products of each law's parameters that small motion determines.

    If a law is sampled in other coordinates, its parameters are also returned as products of these.
    Only products of sampled parameters (`names`) are returned.
    """
    present = set(names)
    products = []
    for law in laws_named(laws):
        other = next((c for c in law.coordinates.values() if set(c.names) & present), None)
        if other is not None:
            products += [
                Product(coordinate.name, coordinate.name, coordinate.powers)
                for coordinate in other.forward
            ]
        for product in law.products:
            factors = tuple(product.powers)
            powers = product.powers if other is None else other.powers(product.powers)
            products.append(Product(product.name, "*".join(factors), powers, factors))
    return tuple(product for product in products if product.powers.keys() <= present)
