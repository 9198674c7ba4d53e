"""Draw docs/result.png, the README's picture, from a finished demonstration.

    jbw demo && python docs/draw_result.py demo

Figures 12 and 13 of the demonstration's report, for one test each, and its backbone.
"""

import sys
from pathlib import Path

import matplotlib
import xarray as xr
from matplotlib.figure import Figure

from jbw.report import style
from jbw.report.loops import backbone, validation_loops
from jbw.report.records import verification_sweep
from jbw.report.result import read_result

TARGET = Path(__file__).with_name("result.png")
SWEEP, LOOP = "verification/sweep/sweep_0p10V_day1", "validation/loops/loop_0p05V_day1"
# What the legend names of all that is drawn.
LABELS = {
    name: name
    for name in (
        "measured",
        "median of the model",
        "99 % predictive band (noise included)",
        "99 % band of the repeats",
        "measured, viscous force included",
        "beyond what was fitted",
    )
} | {"99 % parameter band": "99 % parameter band of the model"}


def only(tree: xr.DataTree, path: str) -> xr.DataTree:
    """A result that holds nothing but one test."""
    return xr.DataTree.from_dict({f"/{path}": tree[path].to_dataset()})


def draw(tree: xr.DataTree) -> Figure:
    """A sweep that was not fitted, a hysteresis loop, frequency and damping by amplitude."""
    axes = style.panels(None, 2, 3, height=4.6)
    # The loop's own figure has a second panel, of the whole force, which tells less.
    spare = Figure().subplots()
    with matplotlib.rc_context(style.RC):
        verification_sweep(only(tree, SWEEP), ax=axes[0])
        validation_loops(only(tree, LOOP), ax=[spare, axes[1, 0]])
        backbone(tree, ax=axes[1, 1:])
    style.title(axes[0, 0], "a sweep that no fit saw", size=8)
    style.title(axes[1, 0], "hysteresis loop, 0.05 V at 18.5 Hz", size=8)
    style.title(axes[1, 1], "the joint softens", size=8)
    style.title(axes[1, 2], "and dissipates", size=8)
    axes[1, 1].set(xlabel="amplitude [mm]", ylabel="frequency [Hz]")
    axes[1, 2].set(xlabel="amplitude [mm]", ylabel="damping ratio [%]")
    known: set[str] = set()
    for each in axes.flat:
        if each.get_legend() is not None:
            each.get_legend().remove()
        for handle, label in zip(*each.get_legend_handles_labels(), strict=True):
            told = LABELS.get(label)
            handle.set_label("_unnamed" if told is None or told in known else told)
            known |= {told} if told else set()
    style.finish(axes, None)
    return axes[0, 0].figure


if __name__ == "__main__":
    _, result = read_result(Path(sys.argv[1] if len(sys.argv) > 1 else "demo"))
    draw(result).savefig(TARGET, dpi=120, facecolor="white", pil_kwargs={"optimize": True})
    print(TARGET)
