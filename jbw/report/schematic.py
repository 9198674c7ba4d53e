"""The oscillator that stands for the structure, with the run's own numbers."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from jbw.errors import DataError
from jbw.report.backbone import GROUP, draw_loops
from jbw.report.result import Parameter, laws_of, node, of_joint
from jbw.report.style import BLUE, INK, SOFT, VERMILLION, Panels, legend, panels, plain, title
from jbw.report.text import spread_text

# Of a law with memory: the stiffness that it takes over from the spring, and the rate of its force.
RATES = {"bouc_wen": ("α", "Ż = α ẏ − γ |ẏ| Z − δ ẏ |Z|")}
SPRINGS = {"cubic": "λ₃ y³"}
MOST = 6  # parameters that have room below the drawing
WALL, MASS, RIGHT = 0.6, 4.6, 7.0  # abscissae of the drawing
SPRING, DAMPER, HYSTERESIS = 9.6, 8.2, 6.8  # ordinates of its elements
LINE: Any = {"color": INK, "lw": 1.2, "solid_capstyle": "round"}


def oscillator(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw mass, spring, damper and hysteretic element with the numbers of the main posterior.

    Numbers are medians with half of their 99 % intervals.

    Panels: the schematic; the loops of the hysteretic element where the run keeps them (2 axes).

    Reference:
        Eqs. (1), (2).
    """
    stored = node(tree, "posterior")
    found = [] if stored is None else of_joint(stored.to_dataset())
    if not found:
        raise DataError("The result has no posterior of the joint.")
    loops = node(tree, GROUP) is not None
    axes = panels(ax, 1, 2 if loops else 1, height=3.9, width_ratios=[1.25, 1][: 1 + loops])
    _schematic(axes[0, 0], laws_of(tree))
    _numbers(axes[0, 0], found[:MOST])
    title(axes[0, 0], "one mode, per unit mass")
    if loops:
        draw_loops(tree, axes[0, 1])
        title(axes[0, 1], "what slip does to the hysteretic force")
        legend(axes[:, 1:], ax)
    return axes


def _schematic(ax: Axes, laws: tuple[str, ...]) -> None:
    """Draw the oscillator: a wall, its elements side by side, the mass, force and motion."""
    ax.set(xlim=(0.0, 10.0), ylim=(-0.3, 11.4))
    ax.axis("off")
    ax.plot([WALL, WALL], [6.0, 10.4], **LINE)
    for y in np.arange(6.2, 10.5, 0.5):
        ax.plot([WALL - 0.35, WALL], [y - 0.35, y], color=SOFT, lw=0.8)
    ax.add_patch(Rectangle((MASS, 6.0), RIGHT - MASS, 4.4, fc="none", ec=INK, lw=1.2))
    _write(ax, (MASS + RIGHT) / 2, 8.2, "unit\nmass")
    _spring(ax)
    _damper(ax)
    memory = [law for law in laws if law not in SPRINGS]
    taken, rate = RATES.get(memory[0], ("K", f"Z: {plain(memory[0])}")) if memory else ("", "")
    stiffness = f"ωₙ² − {taken}" if taken else "ωₙ²"
    if memory:
        _hysteretic(ax)
    _write(ax, 2.6, SPRING + 0.65, stiffness)
    _arrow(ax, RIGHT, 8.9, "u(t)", BLUE)
    _arrow(ax, RIGHT, 7.3, "y(t)", SOFT)
    terms = [f"({stiffness}) y" if taken else "ωₙ² y", *(SPRINGS[n] for n in laws if n in SPRINGS)]
    motion = " + ".join(["ÿ + 2ζωₙ ẏ", *terms, *(["Z"] if memory else [])])
    _write(ax, 0.2, 4.95, f"{motion} = u", ha="left")
    _write(ax, 0.2, 4.1, rate, ha="left", color=VERMILLION)


def _spring(ax: Axes) -> None:
    """Draw the spring that stays when the joint slips."""
    coil = np.array([0.0, 0.0, *([0.28, -0.28] * 5), 0.0, 0.0])
    x = np.concatenate([[WALL], np.linspace(1.5, 3.7, coil.size - 2), [MASS]])
    ax.plot(x, SPRING + coil, **LINE)


def _damper(ax: Axes) -> None:
    """Draw the dashpot."""
    ax.plot([WALL, 2.4], [DAMPER, DAMPER], **LINE)
    ax.plot([2.4, 2.4], [DAMPER - 0.22, DAMPER + 0.22], **LINE)
    ax.plot([2.0, 2.9, 2.9, 2.0], DAMPER + np.array([0.34, 0.34, -0.34, -0.34]), **LINE)
    ax.plot([2.9, MASS], [DAMPER, DAMPER], **LINE)
    _write(ax, 3.75, DAMPER + 0.38, "2ζωₙ")


def _hysteretic(ax: Axes) -> None:
    """Draw the hysteretic element: a box with a loop."""
    colour = {**LINE, "color": VERMILLION}
    ax.plot([WALL, 1.9], [HYSTERESIS, HYSTERESIS], **colour)
    ax.plot([3.3, MASS], [HYSTERESIS, HYSTERESIS], **colour)
    ax.add_patch(Rectangle((1.9, HYSTERESIS - 0.5), 1.4, 1.0, fc="none", ec=VERMILLION, lw=1.2))
    angle = np.linspace(0, 2 * np.pi, 120)
    y = np.cos(angle)
    force = y - 0.25 * np.sin(angle) * (1 - 0.4 * y**2)
    ax.plot(2.6 + 0.5 * y, HYSTERESIS + 0.32 * force, color=VERMILLION, lw=1.0)
    _write(ax, 3.95, HYSTERESIS + 0.38, "Z", color=VERMILLION)


def _arrow(ax: Axes, x: float, y: float, text: str, colour: str) -> None:
    """Draw an arrow to the right from the mass, with its quantity."""
    look = {"arrowstyle": "-|>", "color": colour, "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (x + 1.3, y), (x, y), arrowprops=look)
    _write(ax, x + 1.45, y, text, ha="left", color=colour)


def _numbers(ax: Axes, found: list[Parameter]) -> None:
    """Write the parameters below the drawing: symbol, value, meaning."""
    for row, each in enumerate(found):
        y = 3.0 - 0.6 * row
        _write(ax, 0.2, y, plain(each.symbol), ha="left", size=8)
        _write(ax, 1.2, y, spread_text(each.draws, each.unit), ha="left", size=8)
        _write(ax, 9.9, y, plain(each.meaning), ha="right", size=7, color=SOFT)


def _write(ax: Axes, x: float, y: float, text: str, size: float = 9.0, **look: Any) -> None:
    ax.text(x, y, text, fontsize=size, **{"ha": "center", "va": "center", "color": INK, **look})
