r"""Step 2 for several modes: their number in a band, their poles and residues.

Stabilisation determines the number of modes: a fraction of polynomials with one denominator for all
outputs (pLSCF) is fitted at every order n,

$$H_o(\omega) \approx \frac{\sum_{k \le n} b_{ok} z^k}{\sum_{k \le n} a_k z^k}, \qquad
  z = e^{j(\omega - \omega_0)T}, \quad a_n = 1$$

by linear least squares of $a H - b$, with the numerators eliminated. The band is mapped to most of
the unit circle, so that only poles of positive frequency appear. Poles due to noise move with the
order, modes do not.

The modes are fitted from these starts. Residues and residual terms are linear in the lines: they
are optimised at every trial of the poles (variable projection), so starts are needed for the poles
only. The result is the start of the full fit of `jbw.identification.lines`, which is also used for
a single mode.

Reference:
    Peeters, Van der Auweraer, Guillaume and Leuridan, Shock Vib. 11 (2004) 395.
    Golub and Pereyra, Inverse Problems 19 (2003) R1; El-Kafafy et al., MSSP 37 (2013) 418.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from jbw.errors import ConfigError, DataError
from jbw.identification.line_method import LineFit, in_band
from jbw.identification.linear import NUM_RESIDUALS, Residuals, checked_smear
from jbw.identification.lines import (
    FittedLines,
    FRFLines,
    fit_lines,
    mode_lines,
    modes_by_output,
    observed_variance,
    terms,
    to_measured,
)
from jbw.identification.windowed import Real, receptance
from jbw.measurement.spectra import FRF
from jbw.quantities import derivative_order
from jbw.report.messages import modes as messages

# Largest relative changes of a stable pole between successive orders: frequency, damping.
SAME_OMEGA, SAME_ZETA = 0.01, 0.05
MOST_STABLE_ZETA = 0.2  # largest damping ratio of a mode
SPAN = 0.75 * 2 * np.pi  # angle of the unit circle onto which the band is mapped [rad]
FIRST, LAST = 2, 8  # lowest and highest order of the denominator, per expected mode
MOST_ORDERS = 24  # largest number of orders that are tried
EXPECTED = 4  # smallest number of expected modes, because noise hides modes at low orders
# How far outside the band a requested mode may lie, relative to the width of the band.
BEYOND = 0.02
# starting damping ratio of a requested mode that the stabilisation diagram does not show
UNSAID_ZETA = 0.01
# A pole belongs to a requested mode if their frequencies differ by less than this relative amount.
NEAR = 0.02
LEAST_SHARE = 0.5  # smallest fraction of the orders at which a mode must be stable
SAME_LINES = ("window", "estimator", "nperseg", "noverlap", "num_segments", "num_repeats", "fs")
LEAST_ZETA, MOST_ZETA = 1e-5, 0.5  # limits of damping ratios during the fit
OUTSIDE = 0.25  # largest distance of a fitted mode from the band, divided by the band's width
MOST_TRIALS = 60  # largest number of iterations for the poles; a good fit takes ten
MOST_MISFIT = 0.5  # If an output's relative residual is larger than this, the modes must be wrong.
BEYOND_NOISE = 10.0  # chi-square per degree of freedom that noise alone never reaches
# Two modes are one mode if they are closer than this fraction of the larger half width.
APART = 0.1


@dataclass(frozen=True)
class Stabilisation:
    """The stabilisation diagram: poles at all orders, and which of them are stable."""

    order: NDArray[np.int64]
    omega: Real  # natural frequency [rad/s]
    zeta: Real
    # whether the pole exists at the previous order, within 1 % (omega) and 5 % (zeta)
    is_stable: NDArray[np.bool_]
    groups: Real  # (omega, zeta) of groups of stable poles, most frequent ones first
    share: Real  # fraction of the orders at which each pole is stable

    @property
    def modes(self) -> Real:
        """The (omega, zeta) of poles that are stable at half of the orders or more."""
        stable = self.groups[self.share >= LEAST_SHARE]
        return stable[np.argsort(stable[:, 0])]


def stabilisation(outputs: Sequence[FRF], expected: int = 0) -> Stabilisation:
    """Compute poles at rising orders, and the modes that are stable.

    At least four modes are assumed. `outputs` are the FRFs of one input at the same lines. Smeared
    peaks look too damped, so the modes serve as starts of a fit only.

    Raises:
        DataError: There are too few lines for the lowest order.
    """
    num_lines, expected = len(outputs[0].freq), max(expected, EXPECTED)
    # There must be more lines than coefficients in one output's numerator and denominator.
    highest, lowest = min(LAST * expected, (num_lines - 1) // 2), FIRST * expected
    if highest <= lowest:
        raise DataError(
            f"The band must contain at least {2 * lowest + 3} lines to look for {expected} modes, "
            f"but contains {num_lines}.",
            remedy="Widen `band`, lengthen the windows, or ask for fewer modes.",
        )
    orders = range(lowest, highest + 1, max(1, (highest - lowest) // MOST_ORDERS))
    by_order = [_poles(outputs, order) for order in orders]
    stable = [np.zeros(len(by_order[0]), bool)]
    for before, after in pairwise(by_order):
        stable.append(np.array([_has(before, pole) for pole in after], bool))
    poles, is_stable = np.concatenate(by_order), np.concatenate(stable)
    order = np.repeat(orders, [len(poles_of_order) for poles_of_order in by_order])
    groups, votes = _staying(poles[is_stable])
    share = votes / (len(by_order) - 1)
    return Stabilisation(order, poles[:, 0], poles[:, 1], is_stable, groups, share)


def _poles(outputs: Sequence[FRF], order: int) -> Real:
    """Return (omega, zeta) of the poles in the band with positive damping, at one order."""
    omega = outputs[0].omega
    middle, period = (omega[0] + omega[-1]) / 2, SPAN / (omega[-1] - omega[0])
    powers = np.exp(1j * np.outer((omega - middle) * period, np.arange(order + 1)))
    normal = np.zeros((order + 1, order + 1), complex)
    for part in outputs:
        factor = np.power(1j * omega, derivative_order(part.response), dtype=complex)
        data = part.h * factor
        columns = powers * data[:, None]
        # Eliminate the numerators, that is, remove the part of each FRF that powers of z can
        # explain.
        basis = np.linalg.qr(powers)[0]
        residual = columns - basis @ (basis.conj().T @ columns)
        normal += residual.conj().T @ residual / np.vdot(data, data).real
    a = np.append(np.linalg.lstsq(normal[:-1, :-1], -normal[:-1, -1])[0], 1.0)
    with np.errstate(divide="ignore"):
        poles = np.log(np.roots(a[::-1])) / period + 1j * middle
    size = np.abs(poles)
    zeta = -poles.real / size
    inside = (poles.imag >= omega[0]) & (poles.imag <= omega[-1])
    keep = inside & (zeta > 0) & (zeta < MOST_STABLE_ZETA)
    return np.column_stack([size[keep], zeta[keep]])[np.argsort(size[keep])]


def _has(poles: Real, pole: Real) -> bool:
    """Return whether a pole agrees with one of `poles` within the tolerances of stability."""
    near = np.abs(poles - pole) <= np.array([SAME_OMEGA, SAME_ZETA]) * pole
    return bool(np.any(np.all(near, axis=1)))


def _staying(poles: Real) -> tuple[Real, Real]:
    """Return the median of each group of stable poles, with the number of poles in the group."""
    remaining, groups = poles, []
    while len(remaining):
        # The group consists of the neighbours of the pole with the most close neighbours.
        near = np.abs(remaining[:, None, 0] / remaining[:, 0] - 1) <= SAME_OMEGA
        group = near[:, np.argmax(near.sum(axis=0))]
        groups.append(remaining[group])
        remaining = remaining[~group]
    groups.sort(key=len, reverse=True)
    medians = np.array([np.median(group, axis=0) for group in groups]).reshape(-1, 2)
    return medians, np.array([len(group) for group in groups], float)


def starts_of(
    parts: Sequence[FRF], modes: int | Sequence[float], edges: tuple[float, float]
) -> tuple[Real, Stabilisation | None]:
    """Return starting (omega, zeta) of the modes, and the stabilisation diagram."""
    if isinstance(modes, int):
        if isinstance(modes, bool) or modes < 1:
            raise ConfigError(f"Argument `modes` must be at least 1, but is {modes!r}.")
        diagram = stabilisation(parts, modes)
        if len(diagram.groups) < modes:
            stable_hz = ", ".join(f"{x / (2 * np.pi):.4g}" for x in diagram.groups[:, 0]) or "none"
            raise DataError(
                f"The band must show {modes} modes, as stated by `modes`, but the poles that are "
                f"stable as the model order increases are only: {stable_hz} (Hz).",
                remedy="Give the frequencies of the modes, or ask for fewer modes.",
            )
        return diagram.groups[:modes][np.argsort(diagram.groups[:modes, 0])], diagram
    frequencies = np.atleast_1d(np.asarray(modes, float))
    slack = BEYOND * (edges[1] - edges[0])
    for freq in frequencies:
        if not edges[0] - slack <= freq <= edges[1] + slack:
            raise ConfigError(
                f"Every mode must lie in the band, {edges[0]:.4g} to {edges[1]:.4g} Hz, but "
                f"`modes` names {freq:.4g} Hz.",
                remedy=f"Leave {freq:.4g} Hz out of `modes` (the residual terms represent modes "
                "outside the band), or widen `band`.",
            )
    if len(np.unique(frequencies)) < len(frequencies):
        raise ConfigError(
            f"Argument `modes` must not repeat a frequency, but is {frequencies.tolist()}."
        )
    try:
        diagram = stabilisation(parts, len(frequencies))
    except DataError:
        if not len(frequencies):
            raise
        diagram = None
    if not len(frequencies):
        if diagram is None or not len(diagram.modes):
            raise DataError(
                f"The band {edges[0]:.4g} to {edges[1]:.4g} Hz must show a mode, but no pole is "
                "stable as the model order increases.",
                remedy="State the frequencies of the modes by `modes`, or check `band` and the "
                "channels.",
            )
        return diagram.modes, diagram
    stable_poles = np.zeros((0, 2)) if diagram is None else diagram.groups
    return np.array([_start_near(2 * np.pi * freq, stable_poles) for freq in frequencies]), diagram


def _start_near(omega: float, stable_poles: Real) -> tuple[float, float]:
    """Return a requested frequency with the damping of the stable pole nearest to it."""
    near = stable_poles[np.abs(stable_poles[:, 0] / omega - 1) < NEAR]
    if not len(near):
        return omega, UNSAID_ZETA
    return omega, float(near[np.argmin(np.abs(near[:, 0] - omega)), 1])


@dataclass(frozen=True)
class ModalFit:
    """Modes fitted to the FRFs of one input, in the order in which they were requested."""

    omega: Real  # natural frequencies [rad/s], shape (mode,)
    zeta: Real  # damping ratios
    # residues: force per modal mass times mode shape [N/kg per unit], shape (mode, output)
    residues: Real
    covariance: Real  # covariance of (omega, zeta, residues), each in the order of modes
    upper: Real  # constant receptance of higher modes, by output [m per unit]
    lower: Real  # coefficient of 1 / omega^2 of lower modes, by output
    misfit: Real  # relative residual of each output, in standard errors
    chi_square: float  # sum of squared residuals, divided by their variance
    dof: int  # number of real data minus parameters
    num_lines: int  # number of fitted lines of each output
    band_hz: tuple[float, float]  # lowest and highest fitted line [Hz]
    smeared: bool  # whether the model includes the smearing of a resonance by the window
    diagram: Stabilisation | None  # stabilisation diagram; None if there are too few lines

    @property
    def theta(self) -> Real:
        """The parameters to which the covariance belongs: omega, zeta, then residues by mode."""
        return np.concatenate([self.omega, self.zeta, self.residues.ravel()])

    @property
    def std(self) -> Real:
        """The standard deviations of theta."""
        return np.sqrt(np.diag(self.covariance))


def fit_modes(
    frfs: FRF | Sequence[FRF],
    modes: int | Sequence[float] = (),
    band: tuple[float, float] | None = None,
    *,
    residuals: Residuals = "both",
    smear: bool | None = None,
) -> ModalFit:
    r"""Fit frequencies, damping ratios and residues of a band's modes by weighted least squares.

    $$H_o(\omega) = \sum_i \frac{R_{oi}}{\omega_i^2 - \omega^2 + 2j\zeta_i\omega_i\omega}
      + U_o + \frac{L_o}{\omega^2}$$

    with real R, weighted and smeared as in `line_fit`. The outputs share the poles. If the input is
    random, their leakage is correlated too, and the covariance includes this. The noise of a record
    without repeats or averages (`record_frf`) is estimated from the residual of the fit.

    Args:
        frfs: Receptances of one input at the same lines, one per output.
        modes: Frequencies of the modes [Hz], or their number to take from the stabilisation
            diagram; by default all stable ones.
        band: Lowest and highest frequency to fit [Hz]; by default 20 % around the highest peak.
        residuals: Terms of modes outside the band, for every output: none, upper (U) or both.
        smear: Whether the input was random, as in `line_fit`.

    Returns:
        The fit, with the diagram. A warning is given if a mode ends outside the band.

    Raises:
        DataError: There are fewer lines than unknowns, modes that cannot be separated, no positive
            damping, or a residual of more than half of an output.
        ConfigError: A mode is outside the band, FRFs have different lines, or an option is invalid.

    Reference:
        Eqs. (23), (38), (39), of several modes.

    Examples:
        Two modes are read back from one record:

        >>> import jbw
        >>> import numpy as np
        >>> u = np.random.default_rng(0).standard_normal(8192)
        >>> s = 2j * np.pi * np.fft.rfftfreq(8192, 1 / 512.0)
        >>> H = 1 / (s**2 + 2.0 * s + 118.0**2) + 0.5 / (s**2 + 6.0 * s + 360.0**2)
        >>> frf = jbw.record_frf(u, np.fft.irfft(H * np.fft.rfft(u)), 512.0, band=(10.0, 80.0))
        >>> modes = jbw.fit_modes(frf, modes=[18.8, 57.3], band=(10.0, 80.0))
        >>> print(modes.omega.round(2), modes.zeta.round(5), modes.residues.ravel().round(3))
        [118. 360.] [0.00847 0.00833] [1.  0.5]
    """
    outputs = _same_lines([frfs] if isinstance(frfs, FRF) else list(frfs))
    smear = checked_smear(outputs[0], residuals, smear)
    first = in_band(outputs[0], band)
    edges = float(first.freq[0]), float(first.freq[-1])
    parts = tuple(in_band(part, edges) for part in outputs)
    starts, diagram = starts_of(parts, modes, edges)
    lines = FRFLines(parts, len(starts), NUM_RESIDUALS[residuals], smear)
    _enough(lines)
    order = np.argsort(starts[:, 0])
    start = _projected(lines, starts[order])
    fitted = fit_lines(lines, start, _typical(lines, start))
    _apart(lines, fitted.theta)
    # From here on, the modes are in the requested order.
    fit = _as_fit(lines, fitted, diagram, edges, np.argsort(order))
    _within(fit)
    _follows(fit)
    return fit


def line_of(fit: ModalFit) -> LineFit:
    """Return the first mode at the first output of a modal fit as the line fit of a single mode."""
    num = len(fit.omega)
    read = [0, num, 2 * num]
    omega_n, zeta, gain = map(float, fit.theta[read])
    return LineFit(
        omega_n, zeta, gain, covariance=fit.covariance[np.ix_(read, read)],
        upper=float(fit.upper[0]), lower=float(fit.lower[0]), chi_square=fit.chi_square,
        dof=fit.dof, num_lines=fit.num_lines, band_hz=fit.band_hz, smeared=fit.smeared,
    )  # fmt: skip


def in_order(fit: ModalFit, order: NDArray[np.int64]) -> ModalFit:
    """Return a fit with its modes in another order."""
    num, outputs = fit.residues.shape
    place = np.arange(num * outputs).reshape(num, outputs)[order].ravel()
    read = np.concatenate([order, num + order, 2 * num + place])
    return replace(
        fit, omega=fit.omega[order], zeta=fit.zeta[order], residues=fit.residues[order],
        covariance=fit.covariance[np.ix_(read, read)],
    )  # fmt: skip


def model_lines(fit: ModalFit, omega: Real) -> NDArray[np.complex128]:
    """Return the receptance of every output at frequencies [rad/s], without smearing."""
    modal = [receptance(omega, *pole, 1.0) for pole in zip(fit.omega, fit.zeta, strict=True)]
    return fit.residues.T @ np.array(modal) + fit.upper[:, None] + fit.lower[:, None] / omega**2


def _same_lines(outputs: list[FRF]) -> list[FRF]:
    """Return the FRFs of all outputs; raise a ConfigError unless they have the same lines."""
    if not outputs:
        raise ConfigError("Argument `frfs` must contain at least one FRF, but is empty.")
    first = outputs[0]
    for number, part in enumerate(outputs[1:], 2):
        differ = [name for name in SAME_LINES if getattr(part, name) != getattr(first, name)]
        if not np.array_equal(part.freq, first.freq):
            differ = ["freq", *differ]
        if differ:
            raise ConfigError(
                f"The FRFs must have the same lines, but FRF {number} differs from the first FRF "
                f"in `{differ[0]}`.",
                remedy="Estimate all outputs of an input by the same call of `frf`.",
            )
    return outputs


def _enough(lines: FRFLines) -> None:
    """Raise a DataError if a band has fewer values than unknowns."""
    values = 2 * sum(len(part.freq) for part in lines.outputs)
    if values <= lines.num_parameters:
        raise DataError(
            f"The band must contain more values than unknowns, but its {values // 2} lines give "
            f"{values} values, and {lines.num_modes} modes have {lines.num_parameters} unknowns.",
            remedy="Widen `band`, lengthen the windows, or ask for fewer modes.",
        )


def _projected(lines: FRFLines, starts: Real) -> Real:
    """Fit the poles; for any poles, linear least squares gives the best residues."""
    weights = np.split(np.sqrt(2 / observed_variance(lines)), len(lines.outputs))
    data = [part.h * to_measured(part) for part in lines.outputs]
    extra = [terms(part, lines.num_residuals) for part in lines.outputs]

    def poles_of(x: Real) -> Real:
        offset, log_ratio = x.reshape(2, -1)
        omega = starts[:, 0] * (1 + starts[:, 1] * offset)
        return np.column_stack([omega, starts[:, 1] * np.exp(log_ratio)])

    def linear(poles: Real) -> tuple[list[Real], Real]:
        """Return the best residues and residual terms for given poles, with the residual."""
        coefficients, residuals = [], []
        for part, weight, h, term_columns in zip(lines.outputs, weights, data, extra, strict=True):
            modal = [mode_lines(part, (omega, zeta, 1.0), lines.smear) for omega, zeta in poles]
            columns, target = (
                _stacked(weight * np.array([*modal, *term_columns])),
                _stacked(weight * h),
            )
            scale = np.linalg.norm(columns, axis=1)
            best = np.linalg.lstsq((columns / scale[:, None]).T, target)[0] / scale
            coefficients.append(best)
            residuals.append(target - best @ columns)
        return coefficients, np.concatenate(residuals)

    first, last = lines.outputs[0].omega[[0, -1]]
    ends = np.array([first, last]) + OUTSIDE * (last - first) * np.array([-1, 1])
    reach = (ends[:, None] / starts[:, 0] - 1) / starts[:, 1]
    log_ends = np.log(np.array([LEAST_ZETA, MOST_ZETA])[:, None] / starts[:, 1])
    bounds = np.concatenate([reach, log_ends], axis=1)
    best = optimize.least_squares(
        lambda x: linear(poles_of(x))[1], np.zeros(bounds.shape[1]), jac="3-point", bounds=bounds,
        xtol=1e-10, ftol=1e-10, gtol=1e-10, max_nfev=MOST_TRIALS,
    )  # fmt: skip
    poles = poles_of(best.x)
    coefficients = np.array(linear(poles)[0])  # shape: (output, modes and terms)
    modes = np.column_stack([poles, coefficients[:, : len(poles)].T])
    theta = np.concatenate([modes.ravel(), coefficients[:, len(poles) :].ravel()])
    _apart(lines, theta)
    return theta


def _stacked(rows: NDArray[np.complex128]) -> Real:
    return np.concatenate([rows.real, rows.imag], axis=-1)


def _typical(lines: FRFLines, start: Real) -> Real:
    """Return typical sizes of all parameters of a modal fit, by which they are scaled."""
    modal = lines.num_modes * lines.width
    blocks = np.abs(start[:modal]).reshape(lines.num_modes, lines.width)
    blocks[:, 2:] = np.maximum(blocks[:, 2:], 0.1 * blocks[:, 2:].max(axis=0))
    peaks = [np.abs(part.h).max() for part in lines.outputs]
    return np.concatenate([blocks.ravel(), np.repeat(peaks, lines.num_residuals)])


def _as_fit(
    lines: FRFLines,
    fitted: FittedLines,
    diagram: Stabilisation | None,
    edges: tuple[float, float],
    order: NDArray[np.int64],
) -> ModalFit:
    """Return fitted lines as a `ModalFit`, with the modes in the given order."""
    num, modal = len(lines.outputs), lines.num_modes * lines.width
    place = np.arange(modal).reshape(lines.num_modes, lines.width)[order]
    read = np.concatenate([place[:, 0], place[:, 1], place[:, 2:].ravel()])
    blocks = fitted.theta[place]
    added = np.zeros((num, 2))
    added[:, : lines.num_residuals] = fitted.theta[modal:].reshape(num, -1)
    # The lines of the receptance are divided by their errors. For a swept record this restores the
    # lines of the measured response, whose noise is constant.
    residual, size = (
        np.linalg.norm(np.split(x / np.sqrt(fitted.variance), num), axis=-1)
        for x in (fitted.residual, lines.data)
    )
    return ModalFit(
        omega=blocks[:, 0], zeta=blocks[:, 1], residues=blocks[:, 2:],
        covariance=fitted.covariance[np.ix_(read, read)], upper=added[:, 0],
        lower=added[:, 1] * lines.outputs[0].omega.mean() ** 2, misfit=residual / size,
        chi_square=fitted.chi_square, dof=2 * len(lines.data) - len(fitted.theta),
        num_lines=len(lines.outputs[0].freq), band_hz=edges, smeared=lines.smear, diagram=diagram,
    )  # fmt: skip


def _apart(lines: FRFLines, theta: Real) -> None:
    """Raise a DataError if two fitted modes have changed places or coincide."""
    omega, zeta, _ = np.array(modes_by_output(lines, theta)[0]).T
    half_width = np.maximum((zeta * omega)[1:], (zeta * omega)[:-1])
    near = np.diff(omega) < APART * half_width
    if np.any(near):
        i = int(np.argmax(near))
        first, second = omega[i : i + 2] / (2 * np.pi)
        crossed = "passed each other" if second < first else "ended as one"
        raise DataError(
            f"Modes {i + 1} and {i + 2} must stay apart, but they {crossed}, at {first:.5g} and "
            f"{second:.5g} Hz.",
            why=f"The lines do not distinguish modes {i + 1} and {i + 2}.",
            remedy="Ask for fewer modes, or give frequencies nearer to the peaks.",
        )


def _follows(fit: ModalFit) -> None:
    """Raise a DataError if an output's residual is far beyond noise at most of its lines."""
    if fit.misfit.max() > MOST_MISFIT and fit.chi_square > BEYOND_NOISE * fit.dof:
        modes_hz = " and ".join(f"{freq:.4g}" for freq in fit.omega / (2 * np.pi))
        raise DataError(
            f"The modes must reproduce the FRFs, but with the modes found at {modes_hz} Hz the "
            f"residual of an output is {100 * fit.misfit.max():.0f} % of that output.",
            why="The stabilisation diagram shows no stable pole where the lines have a peak.",
            remedy="Give the frequencies of the peaks in place of the number of modes, or estimate "
            "the FRFs with a longer `window_s`.",
        )


def _within(fit: ModalFit) -> None:
    """Warn if a mode ended outside the band; raise a DataError if it is far outside."""
    low, high = fit.band_hz
    for freq in fit.omega / (2 * np.pi):
        excess = max(low - freq, freq - high)
        sentence = messages.outside_band(freq, low, high)
        if excess > OUTSIDE * (high - low):
            raise DataError(
                f"{sentence}, and a mode outside the band is not determined.",
                remedy="Ask for fewer modes, or give frequencies nearer to the peaks.",
            )
        if excess > 0:
            warnings.warn(
                f"{sentence}: the mode describes the residual of the other modes, not a peak.",
                stacklevel=3,
            )
