"""The procedure as a flow diagram: what each step found, and how far it can be trusted."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

from jbw.report.loops import enclosed_areas
from jbw.report.result import Parameter, branch, node, of_law, parameters, verified
from jbw.report.style import GREEN, INK, SOFT, VERMILLION, panels
from jbw.report.text import NOTHING, number, percent, quantity, spread_text

SAMPLERS = {"nuts": "NUTS", "paper": "paper's walk", "walk": "tuned walk"}
COLOURS = {"ok": GREEN, "failed": VERMILLION, "not assessed": INK}
LINE = 0.17  # height of a line of text [in]
PAD, GAP = 0.1, 0.2  # above and below the text of a box, and between boxes [in]


class Outcome(NamedTuple):
    """What one sampler of a step came to.

    Args:
        who: The sampler, empty where a step has but one.
        status: Its verdict.
        words: What it found.
        mixing: Effective draws and R-hat.
    """

    who: str
    status: str
    words: str
    mixing: str


class Box(NamedTuple):
    """One step of the procedure; without outcomes it was left out."""

    name: str
    does: str
    outcomes: list[Outcome]


def procedure(tree: xr.DataTree, ax: Axes | None = None) -> Axes:
    """Draw the steps as boxes from top to bottom, filled with the run's own numbers.

    Reference:
        Fig. 2.
    """
    told = branch(tree, "procedure", "verdict", "ess", "r_hat")
    boxes = [
        Box("Step 2", "linear regime,\nline fit", _line_fit(tree)),
        Box("Step 3", "third-order kernel\nH₃", _sampled(tree, told, "third_order_")),
        Box("Step 4", "opening of the loop,\nγ alone", _sampled(tree, told, "opening_")),
        Box("Joint", "all parameters\ntogether", _main(tree, told)),
        Box("Verification", "responses,\nfitted and not", _verified(tree)),
        Box("Validation", "hysteresis loops,\nenclosed areas", _validated(tree)),
    ]
    heights = [_height(each) for each in boxes]
    total = sum(heights) + GAP * (len(boxes) - 1)
    only: Axes = panels(ax, 1, 1, height=total + 0.1)[0, 0]
    only.set(xlim=(0.0, 10.0), ylim=(-total - 0.02, 0.02))
    only.axis("off")
    top = 0.0
    for each, height in zip(boxes, heights, strict=True):
        _draw(only, each, top, height)
        top -= height + GAP
        if top > -total:
            look = {"arrowstyle": "-|>", "color": SOFT, "lw": 1.0, "shrinkA": 0, "shrinkB": 0}
            only.annotate("", (1.0, top), (1.0, top + GAP), arrowprops=look)
    return only


def _height(box: Box) -> float:
    """Return the height of a box [in]: two lines for its name, one where it was left out."""
    lines = max(2, sum(map(_lines, box.outcomes))) if box.outcomes else 1
    return 2 * PAD + LINE * lines


def _lines(outcome: Outcome) -> int:
    return 1 + outcome.words.count("\n")


def _draw(ax: Axes, box: Box, top: float, height: float) -> None:
    """Draw a box, its step at the left, its outcomes line by line."""
    edge = INK if box.outcomes else SOFT
    shape: dict[str, Any] = {"boxstyle": "round,pad=0,rounding_size=0.06", "fc": "none", "ec": edge}
    dashes = "-" if box.outcomes else "--"
    ax.add_patch(FancyBboxPatch((0.03, top - height), 9.94, height, lw=0.8, ls=dashes, **shape))
    ax.text(0.2, top - PAD, box.name, va="top", fontsize=9, color=edge, weight="bold")
    look: dict[str, Any] = {"va": "top", "fontsize": 8, "linespacing": 1.5}
    does = box.does if box.outcomes else box.does.replace("\n", " ")
    ax.text(1.7, top - PAD, does, color=SOFT, **look)
    if not box.outcomes:
        ax.text(9.85, top - PAD, "left out: no such tests", color=SOFT, ha="right", **look)
    y = top - PAD
    for each in box.outcomes:
        colour = COLOURS.get(each.status, SOFT)
        words = f"{each.who}: {each.words}" if each.who else each.words
        ax.text(3.6, y, words, color=INK, **look)
        ax.text(8.7, y, each.mixing, color=SOFT, ha="right", **look)
        ax.text(9.85, y, each.status, color=colour, ha="right", **look)
        y -= LINE * _lines(each)


def _line_fit(tree: xr.DataTree) -> list[Outcome]:
    """Return what the line fit found."""
    step = node(tree, "steps/linear")
    if step is None or "pooled_omega_n" not in step.attrs:
        return []
    facts: Mapping[Any, Any] = step.attrs
    hertz = float(facts["pooled_omega_n"]) / (2 * np.pi)
    words = f"fₙ = {number(hertz, digits=5)} Hz"
    if "pooled_zeta" in facts:
        words += f", ζ = {percent(facts['pooled_zeta'])}"
    repeats = step.sizes.get("repeat", 0)
    return [Outcome("", "", words, f"{repeats} repeats" if repeats else "")]


def _sampled(tree: xr.DataTree, told: xr.Dataset, step: str) -> list[Outcome]:
    """Return what every sampler of a step found of the law: its parameter, or their product."""
    return [
        _outcome(told, f"{step}{name}", [_product(of_law(group.to_dataset()))], called)
        for name, called in SAMPLERS.items()
        if f"{step}{name}" in told["step"].values
        and (group := node(tree, f"steps/{step}{name}/posterior")) is not None
    ]


def _product(found: list[Parameter]) -> str:
    """Return what is known of the product of parameters, which is all that weak motion knows."""
    whole = quantity("_".join(each.name for each in found))
    draws = np.prod([each.draws for each in found], axis=0)
    return f"{whole.symbol} = {spread_text(draws, whole.unit)}"


def _main(tree: xr.DataTree, told: xr.Dataset) -> list[Outcome]:
    """Return the main posterior's numbers, two in a line, and below them how it mixed."""
    stored = parameters(branch(tree, "posterior"))
    kept = [each for each in stored if "[" not in each.name and each.name != "gain"]
    texts = [f"{each.symbol} = {spread_text(each.draws, each.unit)}" for each in kept]
    found = _outcome(told, str(told.attrs["main"]), texts, "")
    words = "\n".join(filter(None, (found.words, found.mixing)))
    return [found._replace(words=words, mixing="")]


def _outcome(told: xr.Dataset, name: str, texts: list[str], who: str) -> Outcome:
    """Return one posterior's quantities and verdict."""
    row = told.sel(step=name)
    lines = [",  ".join(texts[i : i + 2]) for i in range(0, len(texts), 2)]
    ess, r_hat = number(row["ess"], 10.0), number(row["r_hat"], 0.1)
    mixing = "" if ess == NOTHING else f"ESS {ess}, R-hat {r_hat}"
    return Outcome(who, str(row["verdict"].item()), "\n".join(lines), mixing)


def _verified(tree: xr.DataTree) -> list[Outcome]:
    """Return the errors of all tests, those that were fitted and those that were not."""
    errors: dict[bool, list[float]] = {False: [], True: []}
    for _, _, test in verified(tree, "nrmse"):
        errors[bool(test.attrs.get("fitted", 1))].append(float(test.attrs["nrmse"]))
    return [
        Outcome(f"{len(errors[fitted])} {called}", "", f"error {_range(errors[fitted])}", "")
        for fitted, called in ((True, "fitted"), (False, "not fitted"))
        if errors[fitted]
    ]


def _range(errors: list[float]) -> str:
    """Return the least and the largest of some relative errors."""
    least, most = percent(min(errors), digits=2), percent(max(errors), digits=2)
    return f"{least} of the record's rms" if least == most else f"{least} to {most} of the rms"


def _validated(tree: xr.DataTree) -> list[Outcome]:
    """Return how far the areas of the loops are from the measured ones."""
    parent = node(tree, "validation/loops")
    pairs = [
        (areas.model[1] / areas.measured[1] - 1.0)
        for test in (parent.children.values() if parent is not None else ())
        if (areas := enclosed_areas(test.to_dataset())) is not None and areas.measured[1]
    ]
    if not pairs:
        return []
    largest = percent(max(map(abs, pairs)), digits=2)
    return [Outcome("", "", f"{len(pairs)} loops, areas of the model within {largest}", "")]
