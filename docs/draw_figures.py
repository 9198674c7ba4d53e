"""Keep the figures of finished runs for the page that explains them.

    jbw report RUN --figures png
    python docs/draw_figures.py RUN [RUN ...]

Each figure is taken from the first run that has it; one that none of them has stays as it is.
"""

import sys
from collections.abc import Iterable
from pathlib import Path

from PIL import Image

from jbw.report.figures import FIGURE_LIST

TARGET = Path(__file__).with_name("figures")
WIDTH = 1000  # pixels
COLOURS = 256  # enough for bands that lie on one another; 64 lost the smallest marks


def keep(runs: Iterable[Path]) -> None:
    """Store every figure under its name."""
    runs = list(runs)
    TARGET.mkdir(exist_ok=True)
    for entry in FIGURE_LIST:
        files = [run / "figures" / f"{entry.slug}.png" for run in runs]
        found = next((file for file in files if file.is_file()), None)
        if found is not None:
            picture = Image.open(found).convert("RGB")
            height = round(picture.height * WIDTH / picture.width)
            smaller = picture.resize((WIDTH, height), Image.Resampling.LANCZOS)
            smaller.quantize(COLOURS).save(TARGET / f"{entry.name}.png", optimize=True)


if __name__ == "__main__":
    keep(map(Path, sys.argv[1:]))
