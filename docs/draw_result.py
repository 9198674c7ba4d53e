"""Draw docs/result.png, the picture of the README: the first figure of a finished demonstration.

    jbw demo && python docs/draw_result.py demo     # takes its numbers over, and draws them
    python docs/draw_result.py                      # draws the kept numbers again

`docs/result.json` holds what the figure draws. The picture carries the words that stand in it:
`tests/test_readme.py` draws it again and asks for the same.
"""

import json
import sys
from pathlib import Path

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.text import Text

from jbw.report import style
from jbw.report.loops import backbone
from jbw.report.result import BACKBONE, read_result

TARGET = Path(__file__).with_name("result.png")
NUMBERS = TARGET.with_suffix(".json")
DRAWN = {BACKBONE: ("frequency", "damping"), "look": ("y", "frequency_hz", "damping")}
ATTRS = ("kind", "fitted", "y_fitted")
DIGITS = 6
WORDS = "Description"  # of a PNG's texts: what stands in the picture


def drawn_of(tree: xr.DataTree) -> dict[str, dict]:
    """The groups that the figure draws, each with its quantities alone, as plain values."""
    groups = {BACKBONE: DRAWN[BACKBONE]}
    groups |= {f"look/{name}": DRAWN["look"] for name in tree["look"].children}
    return {path: _plain(tree[path].to_dataset(), names) for path, names in groups.items()}


def _plain(dataset: xr.Dataset, names: tuple[str, ...]) -> dict:
    told = {
        key: dataset.attrs[key] for key in ("kind", "fitted", "y_fitted") if key in dataset.attrs
    }
    some = dataset[list(names)]
    rounded = {
        name: (values.dims, [float(f"{value:.{DIGITS}g}") for value in np.ravel(values)])
        for name, values in some.variables.items()
    }
    return {
        "attrs": {key: getattr(value, "item", lambda v=value: v)() for key, value in told.items()},
        "sizes": dict(some.sizes),
        "values": rounded,
    }


def tree_of(groups: dict[str, dict]) -> xr.DataTree:
    """The result that holds what was kept."""
    return xr.DataTree.from_dict(
        {
            f"/{path}": xr.Dataset(
                {
                    name: (dims, np.reshape(values, [group["sizes"][dim] for dim in dims]))
                    for name, (dims, values) in group["values"].items()
                },
                attrs=group["attrs"],
            )
            for path, group in groups.items()
        }
    )


def draw() -> Figure:
    """Frequency and damping against amplitude, of the kept numbers."""
    tree = tree_of(json.loads(NUMBERS.read_text(encoding="utf-8")))
    with matplotlib.rc_context(style.RC):
        return backbone(tree)[0, 0].figure


def words_in(figure: Figure) -> list[str]:
    """Labels of the axes and of the legends, as they are drawn."""
    figure.canvas.draw()
    labels = [text for ax in figure.axes for text in (ax.xaxis.label, ax.yaxis.label, ax.title)]
    legends = [*figure.legends, *(ax.get_legend() for ax in figure.axes if ax.get_legend())]
    entries = [text for legend in legends for text in legend.get_texts()]
    shown: list[Text] = [text for text in [*labels, *entries] if text.get_visible()]
    return sorted({text.get_text() for text in shown if text.get_text()})


if __name__ == "__main__":
    if len(sys.argv) > 1:
        _, result = read_result(Path(sys.argv[1]))
        NUMBERS.write_text(json.dumps(drawn_of(result)) + "\n", encoding="utf-8")
    picture = draw()
    picture.savefig(
        TARGET, dpi=130, facecolor="white", metadata={WORDS: "\n".join(words_in(picture))}
    )
    print(TARGET)
