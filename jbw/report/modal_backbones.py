"""The backbones of every mode of a structure, and the change of mode shapes with amplitude."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float

from jbw.errors import ConfigError
from jbw.oscillator.modes.backbone import modal_backbone
from jbw.oscillator.modes.structure import Structure, admitted
from jbw.report.assembly import mode_columns
from jbw.report.messages import figures as labels
from jbw.report.style import INK, LEVELS, MODEL, SOFT, Panels, finish, title
from jbw.report.text import length_unit, number

TURN = 2 * np.pi
ORDERS = (3, 5, 7)
NEAR = 0.01  # relative distance between two frequencies that counts as an internal resonance
# A backbone ends where a joint's motion has more turning points per period than this.
MAX_TURNS = 2

Levels = Float[np.ndarray, " level"]


class BackboneCurve(NamedTuple):
    """The backbone of one mode; NaN beyond its end."""

    omega: Levels
    zeta: Levels
    shape: Float[np.ndarray, "level mode"]  # |q_i / X|
    end: float | None  # largest solved amplitude [m]; None if all are solved


def draw_backbones(
    structure: Structure,
    x_peak: ArrayLike,
    *,
    modes: Sequence[int] | None = None,
    num_harmonics: int = 8,
    ax: Any = None,
) -> Panels:
    r"""Draw frequency, damping and deflection shape of modes against amplitude.

    Each mode has one column, with three columns side by side: its resonance frequency, its
    equivalent damping ratio, and the first harmonics $|q_i / X|$ of all modal coordinates relative
    to that of the joint's displacement. For a structure with an axis of joints X is the amplitude
    of the mode's own coordinate. Where a harmonic meets another mode, $\omega_j = n\,\omega_i(X)$
    within 1 %, the figure names it, as "1:3 with mode 3". A backbone that folds ends there, and its
    title states the amplitude.

    Args:
        structure: Modes of the structure, with their joints.
        x_peak: Rising amplitudes X [m], from zero or from a small one.
        modes: Indices of the modes, from 0; all modes that vibrate when None. After the kept modes
            of a reduced model follow residual modes, which are no modes of the structure and should
            be left out.
        num_harmonics: Number of odd harmonics.
        ax: Three axes per mode, row by row; a new figure when None.

    Returns:
        Axes in three rows, with one column per drawn mode.

    Raises:
        ConfigError: The amplitudes do not rise, or for reasons that `jbw.backbone` states.

    Reference:
        Krack (2015), Computers and Structures 154, 59.

    Examples:
        Frequency, damping and shape of two modes are drawn in three rows and two columns:

        >>> import jbw; jbw.enable_x64()
        >>> import numpy as np
        >>> one, law = np.ones(2), jbw.laws.BoucWenLaw(alpha=497.4, delta=340.2, gamma=32.8)
        >>> omega_n, h = np.array([118.1, 360.0]), np.array([1.0, -1.7])
        >>> modes = jbw.Structure(omega_n, 0.004 * one, h, b=one, c=one, laws=(law,))
        >>> axes = jbw.draw_backbones(modes, np.linspace(0.0, 1e-3, 5))
        >>> axes[0, 0].figure.savefig("backbones.png")
        >>> print(axes.shape)
        (3, 2)
    """
    levels = np.atleast_1d(np.asarray(x_peak, float))
    if levels.ndim != 1 or len(levels) < 2 or not np.all(np.diff(levels) > 0):
        raise ConfigError(
            "Argument `x_peak` must be two rising amplitudes or more, but is "
            f"{np.array2string(levels, threshold=4)}.",
            remedy="Give for example np.linspace(0, 1e-3, 50).",
        )
    structure = admitted(structure)
    omega_n = np.asarray(structure.omega_n)
    factor, unit = length_unit(float(levels[-1]))
    chosen = [i for i, omega in enumerate(omega_n) if omega > 0] if modes is None else list(modes)
    axes, columns = mode_columns(ax, len(chosen))
    for mode, column in zip(chosen, columns, strict=True):
        curve = curve_of(structure, levels, mode, num_harmonics)
        _draw(column, factor * levels, curve)
        title(column[0], _title(mode, curve, factor, unit))
        for interaction in interactions(omega_n, mode, levels, curve.omega):
            _mark(column, interaction, factor, unit)
    ylabels = ("frequency [Hz]", "damping ratio [%]", "|q / X| [-]")
    several = np.ndim(structure.h) == 2
    finish(axes, ax, labels.modal_amplitude(unit, several), ylabels)
    return np.column_stack(columns)


def curve_of(structure: Structure, levels: Levels, mode: int, num_harmonics: int) -> BackboneCurve:
    """Return the backbone of one mode up to the largest amplitude that could be solved."""
    motion = modal_backbone(
        structure, levels, mode=mode, num_harmonics=num_harmonics, max_turns=MAX_TURNS, may_end=True
    )
    omega, zeta = np.asarray(motion.omega), np.asarray(motion.zeta)
    solved = levels[np.isfinite(omega)]
    end = None if len(solved) == len(levels) else float(solved.max(initial=0.0))
    return BackboneCurve(omega, zeta, np.abs(np.asarray(motion.shape)), end)


def interactions(
    omega_n: Float[np.ndarray, " mode"], mode: int, levels: Levels, omega: Levels
) -> list[tuple[int, int, float]]:
    """Return harmonic, mode and amplitude where a mode is within 1 % of a harmonic of another."""
    met = []
    solved = np.isfinite(omega)
    for order in ORDERS:
        for other in (j for j in range(len(omega_n)) if j != mode and solved.any()):
            away = omega_n[other] / (order * omega[solved]) - 1.0
            nearest = int(np.argmin(np.abs(away)))
            if abs(away[nearest]) < NEAR:
                met.append((order, other, _crossing(away, levels[solved], nearest)))
    return met


def _crossing(away: Levels, levels: Levels, nearest: int) -> float:
    """Return the amplitude at which the difference of two frequencies is zero, or else smallest."""
    turns = np.flatnonzero(np.diff(np.sign(away)) != 0)
    if not len(turns):
        return float(levels[nearest])
    i = int(turns[0])
    part = away[i] / (away[i] - away[i + 1])
    return float(levels[i] + part * (levels[i + 1] - levels[i]))


def _draw(column: Panels, x: Levels, curve: BackboneCurve) -> None:
    column[0].plot(x, curve.omega / TURN, color=MODEL, lw=1.2)
    column[1].plot(x, 100 * curve.zeta, color=MODEL, lw=1.2)
    for i, share in enumerate(curve.shape.T):
        column[2].plot(x, share, color=LEVELS[i % len(LEVELS)], lw=1.2, label=f"mode {i + 1}")
    column[2].set_yscale("log", nonpositive="mask")
    for panel in column[:2]:
        panel.ticklabel_format(axis="y", useOffset=False)
    for panel in column:
        panel.set_xlim(x[0], x[-1])


def _title(mode: int, curve: BackboneCurve, factor: float, unit: str) -> str:
    name = f"mode {mode + 1}"
    if curve.end is None:
        return name
    return labels.fold(name, f"{number(factor * curve.end)} {unit}")


def _mark(column: Panels, interaction: tuple[int, int, float], factor: float, unit: str) -> None:
    """Draw a line at the amplitude at which a harmonic meets another mode; name that mode."""
    order, mode, x_peak = interaction
    place = factor * x_peak
    for panel in column:
        panel.axvline(place, color=SOFT, lw=0.8, ls=":")
    low, high = column[0].get_xlim()
    ha, away = ("right", -3) if place > 0.5 * (low + high) else ("left", 3)
    column[0].annotate(
        f"resonance 1:{order} with\nmode {mode + 1} at {number(place)} {unit}",
        (place, 0.04), xycoords=("data", "axes fraction"), xytext=(away, 0),
        textcoords="offset points", ha=ha, fontsize=7, color=INK,
    )  # fmt: skip
