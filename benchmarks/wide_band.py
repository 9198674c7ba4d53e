"""How much of an F-16's sweeps over four modes and three points is explained by one joint?

Sine sweeps of four levels between 4.9 and 10.5 Hz, with three accelerations, form a campaign with
[structure]. Three models are compared: the modes are linear; the joint acts on the first mode
alone; one joint acts on all modes. In the last one the shapes at the joint start at those of the
relative motion between wing and payload, from the points' motion in the linear modes, and are then
free. The fit is by least squares, marginal over the constants of all lines. Printed is the error of
each point relative to its response, as mean over levels. The run takes half an hour to an hour.

    JBW_DATA=FOLDER python benchmarks/wide_band.py [--law bouc_wen --law cubic] [--json FILE]
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import jax
import numpy as np
from timing import Table, options, show

import jbw
from jbw.campaign.load import Campaign
from jbw.identification.assemble import assemble, measured_in
from jbw.identification.coordinates import box_of
from jbw.identification.evidence import under
from jbw.identification.first_fit import fit_from
from jbw.inference.fit.fitting import Fit
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.observables.drives import told_by

LEVELS = {1: 4.8, 3: 28.8, 5: 67.0, 7: 95.6}  # nominal force [N]
POINTS = ("wing", "payload", "shaker")
LEAST_COUPLING = 0.05  # smallest coupling at which a fit starts
COLUMNS = {"model": "", "mean, %": ".1f", **{f"{point}, %": ".1f" for point in POINTS}}
COLUMNS |= {"worst level, %": ".1f", "parameters": "d", "time, s": ".0f"}
HEAD = """
[structure]
modes = [7.3, 5.2, 6.66, 9.2]
points = ["payload", "shaker"]
[identify]
offsets = "none"
"""
TEST = """
[[test]]
kind = "sweep"
name = "level {level}"
level = {force}
files = "$JBW_DATA/f16_gvt_sinesweep/F16Data_SineSw_Level{level}.npz"
channels = {{ force = "Force", acceleration = "Acceleration[1]" }}
points = {{ payload = "Acceleration[2]", shaker = "Acceleration[0]" }}
units = {{ force = "N", acceleration = "m/s^2" }}
fs = 400.0
band = [4.9, 10.5]
span = [55.0, 215.0]
settle = 35.0
"""


def campaign(laws: Sequence[str]) -> Campaign:
    """Return the campaign of sweeps, each cut to the part in which it passes the band."""
    text = HEAD + "".join(TEST.format(level=n, force=force) for n, force in LEVELS.items())
    with TemporaryDirectory() as folder:
        path = Path(folder) / "campaign.toml"
        path.write_text(text)
        loaded = jbw.load_campaign(path, allow_outside=True)
    return replace(loaded, laws=tuple(laws))


def fitted(data: Dataset, taken: Campaign, start: Mapping[str, float]) -> Fit:
    """Return the least-squares fit from a start, or else from the most likely of many points."""
    known = {**told_by(data.parts), **start}
    prior = box_of(taken.settings, data, known)
    return fit_from(jax.random.key(0), data, prior, known, alone=True)


def relative_motion(best: Mapping[str, float]) -> tuple[float, ...]:
    """Return the payload's motion minus the wing's in every mode, relative to the wing's."""
    return tuple(best[f"point_2_{mode}"] - 1.0 for mode in (1, 2, 3, 4))


def row(name: str, best: Fit, data: Dataset, seconds: float) -> tuple[object, ...]:
    """Return a fit's errors at each point, averaged over levels, as a table row."""
    left = dataset.residual_by_label(best.residual, data)
    every = dataset.error_by_label(left, data)
    names = [f"level {n}" for n in LEVELS]
    of = [[100 * every[n if p == "wing" else f"{n} at {p}"] for n in names] for p in POINTS]
    levels = np.mean(of, axis=0)
    return (
        name, float(np.mean(of)), *np.mean(of, axis=1).tolist(), float(levels.max()),
        len(best.theta), seconds,
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--law", action="append", help="of the joint; bouc_wen when left out")
    chosen = parser.parse_args(arguments)
    jbw.enable_x64()
    laws, rows = tuple(chosen.law or ["bouc_wen"]), []

    def done(name: str, data: Dataset, taken: Campaign, start: Mapping[str, float]) -> Fit:
        began = perf_counter()
        best = fitted(data, taken, start)
        rows.append(row(name, best, data, perf_counter() - began))
        return best

    taken = campaign(laws)
    data = assemble(measured_in(taken, print))
    done("linear", under((), data), taken, {})
    done("joint on the first mode", under(laws, data, "first"), taken, {})
    assert taken.structure is not None
    shape = relative_motion(told_by(data.parts))
    held = taken.structure.model_copy(update={"joint_shape": shape})
    known = replace(taken, structure=held)
    own = assemble(measured_in(known, print))
    common = done("one joint, shapes measured", own, known, {})
    signs = {n: float(x) for n, x in own.held.items() if n.startswith("sign_")}
    free = replace(data, held={**data.held, **{n: np.asarray(x) for n, x in signs.items()}})
    shapes = {n: float(x) for n, x in own.held.items() if n.startswith("shape_")}
    begun = {**common.theta, **shapes}
    # A coupling that ended at its bound, where its slope is zero, starts inside.
    begun |= {n: max(x, LEAST_COUPLING) for n, x in begun.items() if n.startswith("coupling_")}
    done("one joint, shapes free", free, taken, begun)
    show([Table("F-16, 4.9 to 10.5 Hz", COLUMNS, rows)], file=chosen.json)


if __name__ == "__main__":
    main()
