r"""Causes of misfit: common measurement errors that would explain the residual of a fit.

A suspect is a possible error that changes the data by columns D near the fit, in addition to the
parameters' own J: a delay, a wrong clock, a sign or a unit, an offset, clipping, the response of
modes outside the band or of one more mode within it, runs with separate natural frequencies. One
Gauss-Newton step with D, and one without, show how much of the misfit it would explain:

$$\min_{\Delta\theta, c} |r + J\,\Delta\theta - D\,c|^2, \qquad
  1 - \frac{|r + J\,\Delta\theta - D\,c|^2}{|r + J\,\Delta\theta|^2}$$
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.finding import Finding
from jbw.inference.posterior.remedies import put
from jbw.measurement.residual_spectra import Row, Spectrum, real_rows
from jbw.measurement.resonances import oscillator_through
from jbw.observables.dataset import Dataset, by_label, residual_by_label
from jbw.observables.drives import plain
from jbw.observables.effective_values import LEAST_VALUES, is_coloured
from jbw.observables.noise import repeatability
from jbw.observables.observable import OFFSETS
from jbw.observables.records import NEAR_PEAK
from jbw.report.messages import causes as messages
from jbw.report.messages.causes import Words

DRIVEN = 0.1  # input lines above this share of the largest are searched for another mode
NUM_MODES, MODE_ZETAS = 96, (0.003, 0.01, 0.03)  # trial modes: number of frequencies, dampings
APART = 0.05  # relative distance in frequency from which a mode is not the joint's own
FACTOR = "factor"  # kind of the suspects that concern the gain of one group
TURNED = 0.2  # distance from -1 within which a factor is a reversed sign
CLOSE = 0.03  # relative distance within which a factor is a ratio of units
UNITS = {
    1e-3: "thousandths", 1e3: "thousands", 1e-6: "millionths", 1e6: "millions",
    9.80665: "units of g", 1 / 9.80665: "units of g", 2 * np.pi: "rad/s for Hz",
    1 / (2 * np.pi): "rad/s for Hz", 2**0.5: "rms for peak", 0.5**0.5: "rms for peak",
    0.0254: "inches", 1 / 0.0254: "inches",
}  # fmt: skip

TEST = "[test]"  # table of the campaign file in which a remedy puts its line

Columns = Mapping[str, Float[np.ndarray, "value column"]]  # by label of the group
Spectra = Mapping[str, Spectrum]
Slopes = Mapping[str, Mapping[str, Row]]  # of residuals, by parameter and by label
MOSTLY = 0.5  # explained share of the misfit from which a cause is a finding
WORTH_SAYING = 0.1
MOST_SAID = 3
LEAST_LINES = 6  # lines near a resonance that the separate gain of one group needs
FAR_OFF = 3.0  # ratio of gains from which a unit or sign is wrong; softening does not reach it
BY_CHANCE = 2.0  # largest error of a short group that noise explains, in sd of its repeats


class Suspect(NamedTuple):
    """A possible cause of misfit: its kind, derivative columns, and text for given coefficients."""

    kind: str
    columns: Columns
    words: Callable[[NDArray[np.float64]], Words]
    mode: tuple[float, float] | None = None  # omega [rad/s] and zeta if it is a mode


def three(x: float) -> float:
    """Return a number rounded to three significant digits."""
    return float(f"{x:.3g}")


def as_columns(*rows: Row) -> NDArray[np.float64]:
    """Return rows as columns of a real array; imaginary parts follow below the real parts."""
    return real_rows(np.stack(rows, axis=1))


def suspects(spectra: Spectra, slopes: Slopes, omega_n: float) -> Iterator[Suspect]:
    """Yield all suspected measurement errors to test on the spectra of the data groups."""
    yield _delay(spectra)
    yield from _clock(spectra)
    yield from (_factor(label, spectrum) for label, spectrum in spectra.items())
    yield from _in_time(spectra)
    yield _residual_term(spectra)
    if len(spectra) > 1 and len(slopes) > 0:
        yield _own_frequency(spectra, slopes, omega_n)
    yield from modes_anywhere(spectra, omega_n)


def _delay(spectra: Spectra) -> Suspect:
    r"""Return the suspected error of a delay tau of all responses: $-j\omega X$."""

    def words(coefficients: NDArray[np.float64]) -> Words:
        (tau,) = coefficients
        return messages.delay(tau, put(TEST, "delay", three(tau)))

    columns = {n: as_columns(s.row(-1j * s.omega * s.predicted)) for n, s in spectra.items()}
    return Suspect("delay", columns, words)


def _clock(spectra: Spectra) -> Iterator[Suspect]:
    r"""Yield the suspected error of a fast response clock: $-t\,\dot x$ per relative rate."""
    columns = {n: as_columns(-s.stretched) for n, s in spectra.items() if s.stretched is not None}

    def words(coefficients: NDArray[np.float64]) -> Words:
        (fast,) = 1e6 * coefficients
        return messages.clock(fast, put(TEST, "clock_ppm", three(fast)))

    if columns:
        yield Suspect("clock", columns, words)


def _factor(label: str, spectrum: Spectrum) -> Suspect:
    """Return the suspected error of one group's gain: wrong sign, unit or factor."""
    columns = {label: as_columns(spectrum.values - spectrum.residual)}
    return Suspect(
        f"{FACTOR} of {label}",
        columns,
        lambda coefficients: factor_words(label, 1 + coefficients[0], spectrum.source_role),
    )


def factor_words(label: str, factor: float, source: str = "input") -> Words:
    """Return the text and remedy for a group whose gain is `factor` times that of other groups."""
    if abs(factor + 1) < TURNED:
        return messages.turned(label, put(TEST, f"scale.{source}", -1.0))
    size = abs(factor)
    unit = next((name for f, name in UNITS.items() if abs(size / f - 1) < CLOSE), None)
    line = put(TEST, f"scale.{source}", three(factor))
    return messages.factor(label, size, unit, line, is_turned=factor < 0)


def _in_time(spectra: Spectra) -> Iterator[Suspect]:
    """Yield the suspected errors of sampled records: a constant offset, or clipping."""
    sampled = {
        label: spectrum
        for label, spectrum in spectra.items()
        if not np.iscomplexobj(spectrum.values)
    }
    if not sampled:
        return
    constants = {
        label: np.tile(unit, (len(spectrum.values), 1))
        for (label, spectrum), unit in zip(sampled.items(), np.eye(len(sampled)), strict=True)
    }
    yield Suspect(
        "offset",
        constants,
        lambda coefficients: messages.offset(
            coefficients[np.argmax(np.abs(coefficients))], put(TEST, "remove_mean", True)
        ),
    )
    cut = {}
    for label, spectrum in sampled.items():
        model, most = spectrum.values - spectrum.residual, np.max(np.abs(spectrum.values))
        if np.max(np.abs(model)) > most:
            cut[label] = as_columns(np.clip(model, -most, most) - model)
    if cut:
        yield Suspect("clipping", cut, lambda coefficients: messages.clipping(list(cut)))


def _residual_term(spectra: Spectra) -> Suspect:
    r"""Return the suspected effect of modes outside the band: $X = (R - M / \omega^2)\,U$."""
    columns = {}
    for label, spectrum in spectra.items():
        stiff = spectrum.factor * spectrum.source
        mass = np.divide(
            -stiff, spectrum.omega**2, out=np.zeros_like(stiff), where=spectrum.omega > 0
        )
        columns[label] = as_columns(spectrum.row(stiff), spectrum.row(mass))

    return Suspect(
        "residual term",
        columns,
        lambda coefficients: messages.residual_term(
            coefficients[0], put(TEST, "residuals", "both")
        ),
    )


def _own_frequency(spectra: Spectra, slopes: Slopes, omega_n: float) -> Suspect:
    """Return the suspected error that each group has its own natural frequency and damping."""
    columns, wide = {}, len(spectra) * len(slopes)
    for place, label in enumerate(spectra):
        group_columns = as_columns(*(-slope[label] for slope in slopes.values()))
        columns[label] = np.zeros((len(group_columns), wide))
        columns[label][:, place * len(slopes) : (place + 1) * len(slopes)] = group_columns
    first = next(iter(slopes))

    def words(coefficients: NDArray[np.float64]) -> Words:
        spread = np.std(coefficients[:: len(slopes)]) / (omega_n if first == "omega_n" else 1.0)
        return messages.natural_frequencies(float(spread), put(TEST, "run", "day 1"))

    return Suspect("own frequency", columns, words)


def modes_anywhere(spectra: Spectra, omega_n: float) -> Iterator[Suspect]:
    """Yield suspected further modes at all driven frequencies away from the joint's mode."""
    lines = [s.omega[np.abs(s.source) > DRIVEN * np.abs(s.source).max()] for s in spectra.values()]
    driven = np.concatenate([line[line > 0] for line in lines])
    if not len(driven):
        return
    frequencies = np.geomspace(driven.min(), driven.max(), NUM_MODES)
    for omega in frequencies[np.abs(frequencies / omega_n - 1) > APART]:
        # The remedy's band ends midway between both modes and keeps the joint's own.
        middle = np.sqrt(omega * omega_n)
        ends = (driven.min(), middle) if omega > omega_n else (middle, driven.max())
        band = [three(end / (2 * np.pi)) for end in ends]
        yield from modes_at(spectra, [omega], f" {put(TEST, 'band', band)}")


def modes_at(spectra: Spectra, places: Iterable[float], remedy: str = "") -> Iterator[Suspect]:
    """Yield suspected further modes at given frequencies [rad/s], each with usual dampings."""
    for omega in places:
        yield from (_mode(spectra, float(omega), zeta, remedy) for zeta in MODE_ZETAS)


def _mode(spectra: Spectra, omega: float, zeta: float, remedy: str) -> Suspect:
    r"""Return a suspected mode: $X = a\,U / (\omega_2^2 - \omega^2 + 2j\zeta_2\omega_2\omega)$."""
    columns = {}
    for label, spectrum in spectra.items():
        below = omega**2 - spectrum.omega**2 + 2j * zeta * omega * spectrum.omega
        columns[label] = as_columns(spectrum.row(spectrum.factor * spectrum.source / below))
    hz = omega / (2 * np.pi)
    return Suspect(
        "mode",
        columns,
        lambda coefficients: messages.further_mode(hz, remedy),
        (omega, zeta),
    )


class Cause(NamedTuple):
    """A possible cause of the misfit, the share that it would explain, and its remedy."""

    text: str
    explained: float
    action: str
    mode: tuple[float, float, float] | None = None  # omega [rad/s], zeta and residue, if it is one


class Linearised(NamedTuple):
    """The residual of a fit near its optimum, each group scaled by its rms residual.

    Attributes:
        places: Rows of each tried group, by label.
        weight: Inverse rms residual of each tried group, by label.
        residual: Residual of all groups, without its part along `basis`.
        basis: Orthonormal directions of the parameters.
        counted: Factor of each row that makes its residual relative to the size of its group; zero
            for groups without misfit.
    """

    places: Mapping[str, slice]
    weight: Mapping[str, float]
    residual: NDArray[np.float64]
    basis: NDArray[np.float64]
    counted: NDArray[np.float64]


def causes(best: Fit, data: Dataset) -> list[Cause]:
    """Return likely causes of a fit's misfit, largest explained share first; may be empty."""
    spectra = _spectra(best, data)
    missed = _missed(spectra, data)
    if not missed:
        return []
    linearised = _linearised(best, data, spectra, missed)
    columns = zip(best.theta, best.jacobian.T, strict=True)
    # Each row depends on the offset of one drive only, so columns of several drives can be added.
    of_offset: dict[str, Any] = {}
    for name, x in columns:
        of_offset[plain(name)] = of_offset.get(plain(name), 0.0) + x
    slopes = {n: residual_by_label(x, data) for n, x in of_offset.items() if n in OFFSETS}
    theta = {name: float(x) for name, x in {**data.held, **best.theta}.items()}
    tried = [
        (suspect.kind, _tried(suspect, linearised))
        for suspect in suspects(spectra, slopes, theta["omega_n"])
    ]
    if apart := _apart(spectra, missed):  # a step from a fit far from all groups is unreliable
        tried = [(kind, cause) for kind, cause in tried if not kind.startswith(FACTOR)]
    tried += [(cause.text, cause) for cause in [*apart, *_swapped(spectra, missed, theta)]]
    # Only the best cause of each kind is kept, such as the best frequency of another mode.
    tried.sort(key=lambda pair: pair[1].explained)
    best_of_kind = {kind: cause for kind, cause in tried if cause.explained > WORTH_SAYING}
    return sorted(best_of_kind.values(), key=lambda cause: -cause.explained)


def other_mode(best: Fit, data: Dataset, places: Iterable[float] = ()) -> Cause | None:
    """Return the further mode that explains most of a misfit, near given frequencies or anywhere.

    `places` are the given frequencies [rad/s].

    None if no group with a spectrum has a misfit.
    """
    spectra = _spectra(best, data)
    missed = _missed(spectra, data)
    if not missed:
        return None
    linearised = _linearised(best, data, spectra, missed)
    omega_n = float({**data.held, **best.theta}["omega_n"])
    tried = [*modes_at(spectra, places)] or [*modes_anywhere(spectra, omega_n)]
    tried_causes = [_tried(suspect, linearised) for suspect in tried]
    return max(tried_causes, key=lambda cause: cause.explained, default=None)


def _spectra(best: Fit, data: Dataset) -> dict[str, Spectrum]:
    """Return the spectra of all groups whose misfit can be tested for causes, by label."""
    residuals = residual_by_label(best.residual, data)
    return {
        label: spectrum._replace(source_role="force" if part.drive == "force" else "input")
        for part in data.parts
        for label, spectrum in part.shown().spectra(residuals).items()
    }


def cause_finding(found: Sequence[Cause]) -> Finding | None:
    """Return the finding on the first cause if it explains most of the misfit; else None."""
    if not found or found[0].explained < MOSTLY:
        return None
    first = found[0]
    values, remedy = {"text": first.text, "share": first.explained}, {"action": first.action}
    return Finding("cause", "failed", values, first.explained, remedy)


def causes_sentence(found: Sequence[Cause]) -> str:
    """Return the sentence on the likely causes of the misfit."""
    return messages.causes([(cause.explained, cause.text) for cause in found[:MOST_SAID]])


def _missed(spectra: Spectra, data: Dataset) -> list[str]:
    """Return labels of groups with residuals beyond noise: correlated, or large in short groups."""
    scatter = repeatability(data)
    labels = []
    for label, spectrum in spectra.items():
        error = np.linalg.norm(spectrum.residual) / np.linalg.norm(spectrum.values)
        is_short = len(spectrum.residual) < 2 * LEAST_VALUES
        if (
            error > BY_CHANCE * scatter.get(label, np.inf)
            if is_short
            else is_coloured(spectrum.residual)
        ):
            labels.append(label)
    return labels


def _linearised(best: Fit, data: Dataset, spectra: Spectra, missed: Sequence[str]) -> Linearised:
    """Linearise the residuals of all groups near the optimum; groups without spectrum come last."""
    slopes = [residual_by_label(column, data) for column in best.jacobian.T]
    fitted, slope = by_label(best.residual, data), by_label(best.jacobian, data)
    slices, weight, rows, columns, counted, end = {}, {}, [], [], [], 0
    for label, spectrum in spectra.items():
        group_residual = as_columns(spectrum.residual)[:, 0]
        weight[label] = 1 / np.sqrt(np.mean(group_residual**2))
        rows.append(weight[label] * group_residual)
        columns.append(weight[label] * as_columns(*(derivative[label] for derivative in slopes)))
        size = np.linalg.norm(spectrum.values) if label in missed else np.inf
        counted.append(np.full(len(group_residual), 1 / (weight[label] * size)))
        slices[label] = slice(end, end + len(group_residual))
        end += len(group_residual)
    for label in (other for other in data.layout if other not in spectra):
        rows.append(fitted[label])
        columns.append(slope[label])
        counted.append(np.zeros(len(fitted[label])))
    basis, residual = np.linalg.qr(np.concatenate(columns))[0], np.concatenate(rows)
    residual -= basis @ (basis.T @ residual)
    return Linearised(slices, weight, residual, basis, np.concatenate(counted))


def _tried(suspect: Suspect, linearised: Linearised) -> Cause:
    """Return a suspected error as a cause, with the share of the misfit that it explains."""
    wide = next(iter(suspect.columns.values())).shape[1]
    columns = np.zeros((len(linearised.residual), wide))
    for label, group_columns in suspect.columns.items():
        columns[linearised.places[label]] = linearised.weight[label] * group_columns
    columns -= linearised.basis @ (linearised.basis.T @ columns)
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0] = 1.0
    coefficients = np.linalg.lstsq(columns / scale, linearised.residual)[0] / scale
    before, after = (
        np.sum((linearised.counted * residual) ** 2)
        for residual in (linearised.residual, linearised.residual - columns @ coefficients)
    )
    text, action = suspect.words(coefficients)
    mode = None if suspect.mode is None else (*suspect.mode, float(coefficients[0]))
    return Cause(text, float(1 - after / before), action, mode)


def _apart(spectra: Spectra, missed: Sequence[str]) -> list[Cause]:
    """Return the cause that one group's separate gain differs in sign or size from the others'.

    A fit of all groups may then be far from every group.
    """
    fits = {label: _alone(spectrum) for label, spectrum in spectra.items()}
    single_fits = {label: pair for label, pair in fits.items() if pair is not None}
    missed = [label for label in missed if label in single_fits]
    if len(single_fits) < 2 or not missed:
        return []
    # Compare each gain with the median of the others, by sign and size. If there are only two, it
    # cannot be determined which is wrong.
    ratios = {
        label: gain / np.median([other for n, (other, _) in single_fits.items() if n != label])
        for label, (gain, _) in single_fits.items()
    }
    label = max(ratios, key=lambda n: abs(np.log(abs(ratios[n]))) + FAR_OFF * (ratios[n] < 0))
    if 1 / FAR_OFF < ratios[label] < FAR_OFF:
        return []
    errors = {
        n: np.linalg.norm(spectra[n].residual) / np.linalg.norm(spectra[n].values) for n in missed
    }
    explained = 1 - sum(single_fits[n][1] ** 2 for n in missed) / sum(x**2 for x in errors.values())
    text, action = factor_words(label, ratios[label], spectra[label].source_role)
    return [Cause(text, float(explained), action)]


def _alone(spectrum: Spectrum) -> tuple[float, float] | None:
    """Fit a linear oscillator to one group; return its gain and the relative residual."""
    x = np.divide(
        spectrum.measured,
        spectrum.factor,
        out=np.zeros_like(spectrum.factor),
        where=spectrum.factor != 0,
    )
    driven = np.abs(spectrum.source) > DRIVEN * np.abs(spectrum.source).max()
    near = driven & (np.abs(x) > NEAR_PEAK * np.abs(x[driven]).max(initial=0.0))
    if near.sum() < LEAST_LINES:
        return None
    oscillator = oscillator_through(spectrum.omega[near], spectrum.source[near], x[near])
    modelled = (
        oscillator["gain"]
        * spectrum.factor
        * spectrum.source
        / stiffness(oscillator, spectrum.omega)
    )
    return oscillator["gain"], float(
        np.linalg.norm(spectrum.measured - modelled) / np.linalg.norm(spectrum.measured)
    )


def stiffness(mode: Mapping[str, float], omega: NDArray[np.float64]) -> NDArray[np.complex128]:
    r"""Return the dynamic stiffness of a mode, $\omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega$."""
    return mode["omega_n"] ** 2 - omega**2 + 2j * mode["zeta"] * mode["omega_n"] * omega


def _swapped(spectra: Spectra, missed: Sequence[str], theta: Mapping[str, float]) -> list[Cause]:
    """Return the cause that input and response are swapped, for each group with a misfit."""
    swaps = []
    for label in missed:
        spectrum = spectra[label]
        modelled = spectrum.factor * spectrum.measured / stiffness(theta, spectrum.omega)
        along = np.vdot(modelled, spectrum.source).real / np.vdot(modelled, modelled).real
        residual = np.linalg.norm(spectrum.source - along * modelled) / np.linalg.norm(
            spectrum.source
        )
        error = np.linalg.norm(spectrum.residual) / np.linalg.norm(spectrum.values)
        if along != 0:
            text, action = messages.swapped(label)
            swaps.append(Cause(text, float(1 - (residual / error) ** 2), action))
    return swaps
