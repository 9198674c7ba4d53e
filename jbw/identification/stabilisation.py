r"""Stabilisation: which modes a band holds, by poles that stay where the model's order rises.

A fraction of polynomials with one denominator for all outputs (pLSCF) is fitted at every order n,

$$H_o(\omega) \approx \frac{\sum_{k \le n} b_{ok} z^k}{\sum_{k \le n} a_k z^k}, \qquad
  z = e^{j(\omega - \omega_0)T}, \quad a_n = 1$$

by linear least squares of $a H - b$, the numerators eliminated. The circle is laid about the band,
so that only poles of positive frequency appear. Poles of noise move with the order, modes stay.

Reference:
    Peeters, Van der Auweraer, Guillaume and Leuridan, Shock Vib. 11 (2004) 395.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from jbw.errors import ConfigError, DataError
from jbw.measurement.spectra import FRF
from jbw.quantities import derivative_order

Real = NDArray[np.float64]
SAME_OMEGA, SAME_ZETA = 0.01, 0.05  # relative: what a pole may move by from order to order
MOST_ZETA = 0.2  # of what may be a mode
SPAN = 0.75 * 2 * np.pi  # of the circle that the band takes
FIRST, LAST = 2, 8  # orders a mode that is expected
MOST_ORDERS = 24  # between the two: of many modes some are passed over
EXPECTED = 4  # modes at least: noise hides a mode from the lowest orders
BEYOND = 0.02  # of the band's width: as far outside may a mode lie that is asked for
UNSAID_ZETA = 0.01  # where the diagram shows no mode near a frequency that is asked for
NEAR = 0.02  # relative, of such a mode
LEAST_SHARE = 0.5  # of the orders that a mode is stable in, at least


@dataclass(frozen=True)
class Stabilisation:
    """The diagram: a pole a place, of every order."""

    order: NDArray[np.int64]
    omega: Real  # natural frequency [rad/s]
    zeta: Real
    is_stable: NDArray[np.bool_]  # the order before has it too: to 1 % and 5 % of the damping
    groups: Real  # (omega, zeta) of poles that stay, those of most orders first
    share: Real  # of the orders in which each is stable

    @property
    def modes(self) -> Real:
        """(omega, zeta) of what is stable in half of the orders or more, by rising frequency."""
        stable = self.groups[self.share >= LEAST_SHARE]
        return stable[np.argsort(stable[:, 0])]


def stabilisation(outputs: Sequence[FRF], expected: int = 0) -> Stabilisation:
    """Poles of orders 2 to 8 times the modes expected, four at least, and the modes that stay.

    `outputs` are the FRFs of one input at the same lines. Smeared peaks look more damped than they
    are: the modes are starts of a fit.

    Raises:
        DataError: Fewer lines than the lowest order takes.
    """
    num_lines, expected = len(outputs[0].freq), max(expected, EXPECTED)
    # More lines than coefficients of one output's numerator and denominator.
    highest, lowest = min(LAST * expected, (num_lines - 1) // 2), FIRST * expected
    if highest <= lowest:
        raise DataError(
            f"The band must hold {2 * lowest + 3} lines or more to look for {expected} modes, "
            f"but it holds {num_lines}.",
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
    """(omega, zeta) of the poles in the band that lose energy, at one order."""
    omega = outputs[0].omega
    middle, period = (omega[0] + omega[-1]) / 2, SPAN / (omega[-1] - omega[0])
    powers = np.exp(1j * np.outer((omega - middle) * period, np.arange(order + 1)))
    normal = np.zeros((order + 1, order + 1), complex)
    for part in outputs:
        factor = np.power(1j * omega, derivative_order(part.response), dtype=complex)
        data = part.h * factor
        columns = powers * data[:, None]
        # Numerators at their best: what the powers of z alone explain of a H is taken off.
        basis = np.linalg.qr(powers)[0]
        residual = columns - basis @ (basis.conj().T @ columns)
        normal += residual.conj().T @ residual / np.vdot(data, data).real
    a = np.append(np.linalg.lstsq(normal[:-1, :-1], -normal[:-1, -1])[0], 1.0)
    with np.errstate(divide="ignore"):
        poles = np.log(np.roots(a[::-1])) / period + 1j * middle
    size = np.abs(poles)
    zeta = -poles.real / size
    inside = (poles.imag >= omega[0]) & (poles.imag <= omega[-1])
    keep = inside & (zeta > 0) & (zeta < MOST_ZETA)
    return np.column_stack([size[keep], zeta[keep]])[np.argsort(size[keep])]


def _has(poles: Real, pole: Real) -> bool:
    """Whether a pole is among others, to the tolerances of stability."""
    near = np.abs(poles - pole) <= np.array([SAME_OMEGA, SAME_ZETA]) * pole
    return bool(np.any(np.all(near, axis=1)))


def _staying(poles: Real) -> tuple[Real, Real]:
    """Medians of groups of stable poles, and how many each has, the largest groups first."""
    remaining, groups = poles, []
    while len(remaining):
        # About the pole with the most others beside it.
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
    """(omega, zeta) to begin with, in the order asked for, and the diagram."""
    if isinstance(modes, int):
        if isinstance(modes, bool) or modes < 1:
            raise ConfigError(f"Argument `modes` must count one mode at least, not {modes!r}.")
        diagram = stabilisation(parts, modes)
        if len(diagram.groups) < modes:
            stable_hz = ", ".join(f"{x / (2 * np.pi):.4g}" for x in diagram.groups[:, 0]) or "none"
            raise DataError(
                f"The band must show {modes} modes, as `modes` says, but only {stable_hz} Hz stay "
                "where the model's order rises.",
                remedy="Give their frequencies, or ask for fewer.",
            )
        return diagram.groups[:modes][np.argsort(diagram.groups[:modes, 0])], diagram
    frequencies = np.atleast_1d(np.asarray(modes, float))
    slack = BEYOND * (edges[1] - edges[0])
    for freq in frequencies:
        if not edges[0] - slack <= freq <= edges[1] + slack:
            raise ConfigError(
                f"Every mode must lie in the band, {edges[0]:.4g} to {edges[1]:.4g} Hz, but "
                f"`modes` names {freq:.4g} Hz.",
                remedy="Leave it to the residual terms, or widen `band`.",
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
                f"The band {edges[0]:.4g} to {edges[1]:.4g} Hz must show a mode, but no pole stays "
                "where the model's order rises.",
                remedy="Say with `modes` where they lie, or look at `band` and the channels.",
            )
        return diagram.modes, diagram
    stable_poles = np.zeros((0, 2)) if diagram is None else diagram.groups
    return np.array([_start_near(2 * np.pi * freq, stable_poles) for freq in frequencies]), diagram


def _start_near(omega: float, stable_poles: Real) -> tuple[float, float]:
    """A frequency asked for, with the damping of what the diagram shows near it."""
    near = stable_poles[np.abs(stable_poles[:, 0] / omega - 1) < NEAR]
    if not len(near):
        return omega, UNSAID_ZETA
    return omega, float(near[np.argmin(np.abs(near[:, 0] - omega)), 1])
