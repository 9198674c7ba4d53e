"""Figures of the oscillator and of the steps of the method, with the results of a run."""

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch, Rectangle

from jbw.errors import DataError
from jbw.quantities import GAINS
from jbw.report import style
from jbw.report.loops import draw_loops, enclosed_areas
from jbw.report.messages import figures as labels
from jbw.report.result import (
    BACKBONE,
    HELD_OUT,
    PosteriorParameter,
    branch,
    laws_of,
    node,
    of_joint,
    of_law,
    parameters,
    verified,
)
from jbw.report.style import INK, SOFT, VERMILION, Panels, finish, panels, title
from jbw.report.text import NOTHING, number, percent, plain, quantity, shown_as, spread_text
from jbw.results.attributes import StoredLineFit

# for each law with memory: the symbol of the initial stiffness of its force, and the equation for
# the rate of this force
RATES = {"bouc_wen": ("α", "Ż = α ẏ − γ |ẏ| Z − δ ẏ |Z|")}
SPRINGS = {"cubic": "λ₃ y³"}
MOST = 6  # largest number of parameters in the drawing
WALL, MASS, RIGHT = 0.6, 4.6, 7.0  # abscissae of the drawing
SPRING, DAMPER, HYSTERESIS = 9.6, 8.2, 6.8  # ordinates of the drawn elements
STROKE: Any = {"color": INK, "lw": 1.2, "solid_capstyle": "round"}
ARROW: Any = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0}

SAMPLERS = {"nuts": "NUTS", "paper": "paper's walk", "walk": "tuned walk"}
COLOURS = {"ok": style.GREEN, "failed": VERMILION, "not assessed": INK}
LINE = 0.17  # height of a line of text [in]
PAD, GAP = 0.1, 0.2  # space above and below the text of a box, and between boxes [in]


def oscillator(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Which model represents the structure, and which force does the joint exert?

    Left, one mode with a hysteretic element for the joint: medians of the main posterior with half
    of their 99 % intervals. Right, the force of this element along cycles of a quarter, half and
    all of the largest fitted displacement: the larger the cycle, the softer the joint and the wider
    its loop.

    Panels: the schematic; the loops of the hysteretic element where the run stored them (2 axes).

    Reference:
        Eqs. (1), (2).
    """
    stored = node(tree, "posterior")
    joint_parameters = [] if stored is None else of_joint(stored.to_dataset())
    if not joint_parameters:
        raise DataError(
            "The result has no posterior of the joint's parameters.",
            remedy="Identify a campaign with tests that move the joint, and do not omit steps.",
        )
    loops = node(tree, BACKBONE) is not None
    axes = panels(ax, 1, 2 if loops else 1, height=3.9, width_ratios=[1.25, 1][: 1 + loops])
    schematic: Axes = axes[0, 0]
    schematic.set(xlim=(0.0, 10.0), ylim=(-0.3, 11.4))
    schematic.axis("off")
    memory = [law for law in laws_of(tree) if law not in SPRINGS]
    hysteretic_stiffness, rate = (
        RATES.get(memory[0], ("K", f"Z: {plain(memory[0])}")) if memory else ("", "")
    )
    stiffness = f"ωₙ² − {hysteretic_stiffness}" if hysteretic_stiffness else "ωₙ²"
    _elements(schematic, stiffness, hysteretic=bool(memory))
    terms = ["ÿ + 2ζωₙ ẏ", f"({stiffness}) y" if hysteretic_stiffness else "ωₙ² y"]
    terms += [SPRINGS[law] for law in laws_of(tree) if law in SPRINGS] + ["Z"] * bool(memory)
    _write(schematic, 0.2, 4.95, f"{' + '.join(terms)} = u", ha="left")
    _write(schematic, 0.2, 4.1, rate, ha="left", color=VERMILION)
    for row, parameter in enumerate(joint_parameters[:MOST]):
        y = 3.0 - 0.6 * row
        _write(schematic, 0.2, y, plain(_symbol(parameter)), ha="left", size=8)
        _write(schematic, 1.2, y, _spread(parameter), ha="left", size=8)
        _write(schematic, 9.9, y, plain(parameter.meaning), ha="right", size=7, color=SOFT)
    title(schematic, labels.ONE_MODE)
    if loops:
        draw_loops(tree, axes[0, 1])
        title(axes[0, 1], labels.SLIP)
        finish(axes[:, 1:], ax)
    return axes


def _elements(ax: Axes, stiffness: str, *, hysteretic: bool) -> None:
    """Draw the oscillator: wall, parallel elements, mass, force and motion."""
    ax.plot([WALL, WALL], [6.0, 10.4], **STROKE)
    for y in np.arange(6.2, 10.5, 0.5):
        ax.plot([WALL - 0.35, WALL], [y - 0.35, y], color=SOFT, lw=0.8)
    ax.add_patch(Rectangle((MASS, 6.0), RIGHT - MASS, 4.4, fc="none", ec=INK, lw=1.2))
    _write(ax, (MASS + RIGHT) / 2, 8.2, "unit\nmass")
    # This spring remains when the joint slips.
    coil = np.array([0.0, 0.0, *([0.28, -0.28] * 5), 0.0, 0.0])
    x = np.concatenate([[WALL], np.linspace(1.5, 3.7, coil.size - 2), [MASS]])
    ax.plot(x, SPRING + coil, **STROKE)
    _write(ax, 2.6, SPRING + 0.65, stiffness)
    # The dashpot.
    ax.plot([WALL, 2.4], [DAMPER, DAMPER], **STROKE)
    ax.plot([2.4, 2.4], [DAMPER - 0.22, DAMPER + 0.22], **STROKE)
    ax.plot([2.0, 2.9, 2.9, 2.0], DAMPER + np.array([0.34, 0.34, -0.34, -0.34]), **STROKE)
    ax.plot([2.9, MASS], [DAMPER, DAMPER], **STROKE)
    _write(ax, 3.75, DAMPER + 0.38, "2ζωₙ")
    if hysteretic:  # The joint is drawn as a box that contains a loop.
        stroke = {**STROKE, "color": VERMILION}
        ax.plot([WALL, 1.9], [HYSTERESIS, HYSTERESIS], **stroke)
        ax.plot([3.3, MASS], [HYSTERESIS, HYSTERESIS], **stroke)
        ax.add_patch(Rectangle((1.9, HYSTERESIS - 0.5), 1.4, 1.0, fc="none", ec=VERMILION, lw=1.2))
        angle = np.linspace(0, 2 * np.pi, 120)
        y = np.cos(angle)
        force = y - 0.25 * np.sin(angle) * (1 - 0.4 * y**2)
        ax.plot(2.6 + 0.5 * y, HYSTERESIS + 0.32 * force, color=VERMILION, lw=1.0)
        _write(ax, 3.95, HYSTERESIS + 0.38, "Z", color=VERMILION)
    for y, text, colour in ((8.9, "u(t)", style.BLUE), (7.3, "y(t)", SOFT)):
        look = {**ARROW, "color": colour, "lw": 1.2}
        ax.annotate("", (RIGHT + 1.3, y), (RIGHT, y), arrowprops=look)
        _write(ax, RIGHT + 1.45, y, text, ha="left", color=colour)


def _write(ax: Axes, x: float, y: float, text: str, size: float = 9.0, **look: Any) -> None:
    ax.text(x, y, text, fontsize=size, **{"ha": "center", "va": "center", "color": INK, **look})


def _spread(parameter: PosteriorParameter) -> str:
    """Return a parameter's median, with half of its 99 % interval, as text."""
    factor, unit, _ = shown_as(parameter.name, parameter.unit)
    return spread_text(factor * parameter.draws, unit)


def _symbol(parameter: PosteriorParameter) -> str:
    return parameter.symbol + shown_as(parameter.name, parameter.unit)[-1]


class StepOutcome(NamedTuple):
    """The results of one sampler in a step: estimates, mixing and verdict."""

    words: str
    mixing: str = ""
    status: str = ""


def _height(outcomes: list[StepOutcome]) -> float:
    """Return the height of a step's box [in], with space for a name of two lines."""
    return 2 * PAD + LINE * max(2, sum(1 + outcome.words.count("\n") for outcome in outcomes))


def procedure(tree: xr.DataTree, ax: Axes | None = None) -> Axes:
    """What did each step of the procedure find?

    The steps that the tests allow: medians with half of their 99 % intervals. For every sampler,
    its verdict, the least effective sample size and the largest R-hat.

    Reference:
        Fig. 2.
    """
    facts = branch(tree, "procedure", "verdict", "ess", "r_hat")
    boxes = [
        ("Step 2", "linear regime,\nline fit", _line_fit(tree)),
        ("Step 3", "third-order kernel\nH₃", _sampled(tree, facts, "third_order_")),
        ("Step 4", "γ alone,\nsweeps", _sampled(tree, facts, "opening_")),
        ("Joint", "all parameters\ntogether", _main(tree, facts)),
        ("Verification", "responses, fitted\nand held out", _verified(tree)),
        ("Validation", "hysteresis loops,\nenclosed areas", _validated(tree)),
    ]
    boxes = [(name, does, outcomes) for name, does, outcomes in boxes if outcomes]
    total = sum(_height(outcomes) for *_, outcomes in boxes) + GAP * (len(boxes) - 1)
    only: Axes = panels(ax, 1, 1, height=total + 0.1)[0, 0]
    only.set(xlim=(0.0, 10.0), ylim=(-total - 0.02, 0.02))
    only.axis("off")
    top = 0.0
    for i, (name, does, outcomes) in enumerate(boxes, start=1):
        _draw(only, name, does, outcomes, top)
        top -= _height(outcomes) + GAP
        if i < len(boxes):
            look = {**ARROW, "color": SOFT, "lw": 1.0}
            only.annotate("", (1.0, top), (1.0, top + GAP), arrowprops=look)
    return only


def _draw(ax: Axes, name: str, does: str, outcomes: list[StepOutcome], top: float) -> None:
    shape: dict[str, Any] = {"boxstyle": "round,pad=0,rounding_size=0.06", "fc": "none", "ec": INK}
    height, y = _height(outcomes), top - PAD
    ax.add_patch(FancyBboxPatch((0.03, top - height), 9.94, height, lw=0.8, **shape))
    ax.text(0.2, y, name, va="top", fontsize=9, color=INK, weight="bold")
    look: dict[str, Any] = {"va": "top", "fontsize": 8, "linespacing": 1.5}
    ax.text(1.7, y, does, color=SOFT, **look)
    for outcome in outcomes:
        ax.text(3.6, y, outcome.words, color=INK, **look)
        ax.text(8.7, y, outcome.mixing, color=SOFT, ha="right", **look)
        ax.text(
            9.85, y, outcome.status, color=COLOURS.get(outcome.status, SOFT), ha="right", **look
        )
        y -= LINE * (1 + outcome.words.count("\n"))


def _line_fit(tree: xr.DataTree) -> list[StepOutcome]:
    step = node(tree, "steps/linear")
    if step is None or (facts := StoredLineFit.of(step)).pooled_omega_n is None:
        return []
    hertz = facts.pooled_omega_n / (2 * np.pi)
    words = f"fₙ = {number(hertz, digits=5)} Hz"
    if facts.pooled_zeta is not None:
        words += f", ζ = {percent(facts.pooled_zeta)}"
    repeats = step.sizes.get("repeat", 0)
    records = f"{repeats} repeats" if repeats > 1 else "1 record"
    return [StepOutcome(words, records if repeats else "")]


def _sampled(tree: xr.DataTree, facts: xr.Dataset, step: str) -> list[StepOutcome]:
    outcomes = []
    for name, called in SAMPLERS.items():
        group = node(tree, f"steps/{step}{name}/posterior")
        if group is not None and f"{step}{name}" in facts["step"].values:
            # Weak motion determines only the product of the law's parameters.
            law = of_law(of_joint(group.to_dataset()))
            product = quantity("_".join(parameter.name for parameter in law))
            draws = np.prod([parameter.draws for parameter in law], axis=0)
            words = f"{called}: {product.symbol} = {spread_text(draws, product.unit)}"
            outcomes.append(StepOutcome(words, *_quality(facts, f"{step}{name}")))
    return outcomes


def _main(tree: xr.DataTree, facts: xr.Dataset) -> list[StepOutcome]:
    """Return the estimates of the main posterior as texts, two per line, then its mixing."""
    stored = parameters(branch(tree, "posterior"))
    shown = [
        parameter
        for parameter in stored
        if "[" not in parameter.name and parameter.name not in GAINS
    ]
    texts = [f"{_symbol(parameter)} = {_spread(parameter)}" for parameter in shown]
    mixing, status = _quality(facts, str(facts.attrs["main"]))
    lines = [",  ".join(texts[i : i + 2]) for i in range(0, len(texts), 2)]
    return [StepOutcome("\n".join(filter(None, (*lines, mixing))), status=status)]


def _quality(facts: xr.Dataset, name: str) -> tuple[str, str]:
    row = facts.sel(step=name)
    ess, r_hat = number(row["ess"], 10.0), number(row["r_hat"], 0.1)
    return "" if ess == NOTHING else f"ESS {ess}, R-hat {r_hat}", str(row["verdict"].item())


def _verified(tree: xr.DataTree) -> list[StepOutcome]:
    attributes = [test.attrs for _, _, test in verified(tree, "nrmse")]
    outcomes = []
    for fitted, called in ((True, "fitted"), (False, HELD_OUT)):
        errors = [float(of["nrmse"]) for of in attributes if bool(of.get("fitted", 1)) == fitted]
        if errors:
            least, most = percent(min(errors), digits=2), percent(max(errors), digits=2)
            reach = f"{least} of the record's" if least == most else f"{least} to {most} of the"
            outcomes.append(StepOutcome(f"{len(errors)} {called}: error {reach} rms"))
    return outcomes


def _validated(tree: xr.DataTree) -> list[StepOutcome]:
    parent = node(tree, "validation/loops")
    tests = parent.children.values() if parent is not None else ()
    areas = [enclosed_areas(test.to_dataset()) for test in tests]
    ratios = [area.model[1] / area.measured[1] for area in areas if area and area.measured[1]]
    if not ratios:
        return []
    largest = percent(max(abs(ratio - 1.0) for ratio in ratios), digits=2)
    return [StepOutcome(labels.loop_areas(len(ratios), largest))]
