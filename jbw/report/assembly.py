"""Figures of a structure with several joints: its modes, the loop of every joint, backbones."""

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from jbw.errors import DataError
from jbw.report import style
from jbw.report.messages import figures as labels
from jbw.report.result import arrays, branch
from jbw.report.style import (
    BAND,
    INK,
    LEVELS,
    MODEL,
    SOFT,
    Panels,
    finish,
    panels,
    shade,
    stacks,
    title,
)
from jbw.report.text import axis_label, length_unit, number, percent, plain

JOINTS, ASSEMBLY = "joints", "assembly"
EXAGGERATED = 0.12  # largest drawn deflection, divided by the structure's largest dimension
MOST_MODES, COLUMNS = 6, 2
MOST_NAMED = 3  # largest number of joints that a title names
ISOMETRIC = np.array([[np.sqrt(0.75), -np.sqrt(0.75), 0.0], [-0.5, -0.5, 1.0]])
# thickness of a flat structure, relative to its largest dimension, up to which it is drawn in a
# plane
FLAT = 1e-9
SMALLEST, LARGEST = 12.0, 160.0  # areas of the marks for joints [pt^2]
View = Float[np.ndarray, "2 3"]  # the two directions in which a structure is drawn
BACKBONES = "backbones"
ONE_LINE = 3  # number of modes whose backbones are drawn side by side
HEIGHT, HEIGHT_OF_LINE = 6.0, 5.0  # heights of backbones [in]


def structure(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Which mode moves which joint?

    If the positions of nodes are known: the shape of every mode that the tests drive, with fully
    stuck joints, drawn over the structure at rest. The larger the mark of a joint, the larger its
    share in the mode's strain energy; the joints with the largest shares are named. Without
    positions, bars show the share of each joint in the losses of all joints in every mode, with 99
    % intervals.

    Panels: one per mode, in pairs; or one panel of bars.
    """
    joints = branch(tree, JOINTS, "energy_share", "loss_share", "frequency_hz")
    group = branch(tree, ASSEMBLY, "weight")
    if "position" not in group or not group.sizes.get("mode"):
        return _bars(joints, ax)
    count = min(joints.sizes["mode"], MOST_MODES)
    columns = 1 if count == 1 else COLUMNS
    lines = -(-count // columns)
    axes = panels(ax, lines, columns, height=0.4 + 2.2 * lines)
    view, names = view_of(*arrays(group, "position", "deflection"))
    for i, panel in enumerate(axes.flat):
        if i >= count:
            panel.set_visible(False)
            continue
        mode = joints.isel(mode=i)
        title(panel, _title(mode), size=8.0)
        _draw_shape(panel, group, i, view)
        _draw_joints(panel, group, mode, i, view)
        panel.set_aspect("equal", adjustable="datalim")
    across, up = (axis_label(name, "m") for name in names)
    return finish(axes, ax, across, up)


def view_of(
    position: Float[np.ndarray, "node 3"], deflection: Float[np.ndarray, "mode node 3"]
) -> tuple[View, tuple[str, str]]:
    """Return the two directions to draw a structure in, with their names.

    They span the plane of a flat structure; other structures are drawn in isometric view.
    """
    extent = np.ptp(position, axis=0)
    is_moved = np.abs(deflection).max(axis=(0, 1)) > FLAT
    for along, seen in ((1, (0, 2)), (2, (0, 1)), (0, (1, 2))):
        if extent[along] <= FLAT * extent.max() and not is_moved[along]:
            first, second = ("xyz"[i] for i in seen)
            return np.eye(3)[list(seen)], (first, second)
    return ISOMETRIC, labels.ISOMETRIC


def _moved(group: xr.Dataset, mode: int, view: View) -> Float[np.ndarray, "node 2"]:
    """Return the displaced nodes of a mode shape, projected in a view."""
    position, deflection = arrays(group, "position", "deflection")
    scale = EXAGGERATED * np.ptp(position, axis=0).max()
    return (position + scale * deflection[mode]) @ view.T


def _draw_shape(panel: Axes, group: xr.Dataset, mode: int, view: View) -> None:
    """Draw the structure at rest and in a mode: its links, or only its nodes."""
    at_rest, moved = group["position"].values @ view.T, _moved(group, mode, view)
    links = group["link"].values
    for nodes, colour, width in ((at_rest, SOFT, 0.7), (moved, style.BLUE, 1.4)):
        panel.add_collection(LineCollection(list(nodes[links]), colors=colour, linewidths=width))
        panel.plot(*nodes.T, ".", color=colour, ms=2.0 if len(links) else 3.0)
    held = at_rest[group["held"].values]
    panel.plot(*held.T, "^", color=SOFT, ms=5)


def _draw_joints(panel: Axes, group: xr.Dataset, joints: xr.Dataset, mode: int, view: View) -> None:
    """Draw a mark at each joint; the area grows with the joint's share of the strain energy."""
    moved, nodes = _moved(group, mode, view), group["node"].values.tolist()
    for i, name in enumerate(joints["joint"].values):
        weights = group["weight"].sel(joint=name)
        members = [str(dof).rpartition(":")[0] for dof in weights["dof"].values[weights != 0]]
        positions = [moved[nodes.index(node)] for node in members if node in nodes]
        if not positions:
            continue
        share = float(joints["energy_share"].sel(joint=name))
        area = SMALLEST + (LARGEST - SMALLEST) * min(share, 1.0)
        panel.scatter(
            *np.mean(positions, axis=0), s=area, color=_colour(i), zorder=3, edgecolors=INK,
            linewidths=0.5, label=plain(name),
        )  # fmt: skip


def _title(joints: xr.Dataset) -> str:
    """Return the title of a panel: the mode and its joints with the largest strain energies."""
    shares = joints["energy_share"].values
    largest = np.argsort(-shares, kind="stable")[:MOST_NAMED]
    named = ", ".join(
        f"{plain(joints['joint'].values[i])} {percent(shares[i], digits=2)}" for i in largest
    )
    mode = labels.mode_at(int(joints["mode"]), float(joints["frequency_hz"]))
    return f"{mode}\n{labels.energy_of(named)}"


def _colour(joint: int) -> str:
    return style.LEVELS[(joint + 1) % len(style.LEVELS)]


def _bars(joints: xr.Dataset, ax: Any) -> Panels:
    """Draw each joint's share of the losses of every mode, with one bar per joint."""
    axes = panels(ax, 1, 1, height=2.6)
    panel = axes[0, 0]
    names, modes = joints["joint"].values, joints["mode"].values
    width = 0.8 / len(names)
    for i, name in enumerate(names):
        low, middle, high = 100 * joints["loss_share"].sel(joint=name).values.T
        x = np.arange(len(modes)) + (i - (len(names) - 1) / 2) * width
        error = np.abs([middle - low, high - middle])
        panel.bar(
            x, middle, width, yerr=error, label=plain(name), color=_colour(i),
            error_kw={"ecolor": INK, "elinewidth": 0.8, "capsize": 2},
        )  # fmt: skip
    pairs = zip(modes, joints["frequency_hz"].values, strict=True)
    panel.set_xticks(
        np.arange(len(modes)), [labels.mode_at(int(mode), float(hz)) for mode, hz in pairs]
    )
    panel.set_ylim(0, 100)
    panel.grid(False, axis="x")
    return finish(axes, ax, labels.MODE, axis_label(labels.LOSS_SHARE, "%"))


def joint_loops(tree: xr.DataTree, ax: Any = None) -> Panels:
    """What force does every joint exert at its largest motion?

    Above, the steady loop of each joint's laws at the medians of the posterior, at the largest
    motion of the joint in the tests. Below, the same loop minus its secant line, which shows how
    far it opens. If a joint is not identified separately, other joints in its place could have
    other loops that agree with the tests.

    Panels: one column per joint, with the loop and the loop minus its secant line.
    """
    joints = branch(tree, JOINTS, "motion", "loop", "identified")
    names = joints["joint"].values
    columns = min(len(names), 3)
    lines = -(-len(names) // columns)
    axes = panels(ax, 2 * lines, columns, height=4.0 * lines)
    units = tree[ASSEMBLY].to_dataset() if ASSEMBLY in tree.children else None
    for place in range(lines * columns):
        line, column = divmod(place, columns)
        pair = axes[2 * line : 2 * line + 2, column]
        if place >= len(names):
            for panel in pair:
                panel.set_visible(False)
            continue
        _draw_loop(pair, joints.isel(joint=place), units)
    return finish(axes, ax)


def _draw_loop(pair: Panels, joint: xr.Dataset, units: xr.Dataset | None) -> None:
    """Draw a joint's loop, and below this loop the loop minus its secant line."""
    name = str(joint["joint"].values)
    x, force = (np.append(values, values[0]) for values in arrays(joint, "motion", "loop"))
    peak = int(np.argmax(np.abs(x)))
    if x[peak] == 0:
        raise DataError(f"Joint {name} does not move.")
    slope = force[peak] / x[peak]
    motion_unit, force_unit = (
        ("m", "N")
        if units is None
        else (str(units[n].sel(joint=name).values) for n in ("motion_unit", "force_unit"))
    )
    factor, prefixed = length_unit(abs(x[peak]))
    shown_unit = prefixed if motion_unit == "m" else f"{prefixed.removesuffix('m')}{motion_unit}"
    verdict = labels.IDENTIFIED if bool(joint["identified"]) else labels.UNIDENTIFIED
    title(pair[0], f"{plain(name)}, {verdict}")
    for panel, values, what in (
        (pair[0], force, labels.FORCE),
        (pair[1], force - slope * x, labels.FORCE_LESS_SECANT),
    ):
        panel.plot(factor * x, values, color=MODEL, lw=1.2)
        panel.axhline(0.0, color=SOFT, lw=0.6)
        panel.set_ylabel(axis_label(what, force_unit))
    pair[1].set_xlabel(axis_label(labels.MOTION, shown_unit))
    pair[0].annotate(
        labels.secant(number(slope), f"{force_unit}/{motion_unit}"), (0.03, 0.95),
        xycoords="axes fraction", va="top", fontsize=7.5, color=INK,
    )  # fmt: skip


def mode_backbones(tree: xr.DataTree, ax: Any = None) -> Panels:
    r"""How do frequency, damping and shape of every mode change with amplitude?

    Bands of the posterior, where the mode shape may change with amplitude. Dashed: the same with
    the mode shape of fully stuck joints, at the medians of the posterior. If the dashed line leaves
    the band, the change of shape matters. Below, first harmonics $|q_i/q_m|$ of the other modes
    relative to the mode itself; they do not grow if the mode keeps its shape. Abscissae are
    amplitudes at the first response point, up to the largest measured amplitude.

    Panels: one column per mode, with its frequency, its equivalent damping ratio and its shape.
    """
    group = branch(tree, BACKBONES, "frequency_hz", "damping", "shape", "displacement")
    of_modes = {int(mode): group.sel(mode=mode) for mode in group["mode"].values}
    chosen = {n: x for n, x in of_modes.items() if np.isfinite(x["displacement"]).all()}
    if not chosen:
        raise DataError(
            "The first response point hardly moves in the modes that the tests drive, so that no "
            "backbone can be drawn at this point."
        )
    axes, columns = mode_columns(ax, len(chosen))
    for (mode, of_mode), column in zip(chosen.items(), columns, strict=True):
        _draw_bands(column, of_mode)
        # The joints are stuck at the smallest amplitude.
        stuck_hz = float(of_mode["frequency_hz"].values[0, 1])
        title(column[0], labels.mode_at(mode, stuck_hz))
    ylabels = ("frequency [Hz]", "damping ratio [%]", labels.OVER_MODE)
    return finish(axes, ax, "", ylabels)


def _draw_bands(column: Panels, of_mode: xr.Dataset) -> None:
    (x,) = arrays(of_mode, "displacement")
    factor, unit = length_unit(float(x[-1]))
    x = factor * x
    for panel, name, quantity, scale in (
        (column[0], "frequency_hz", "frequency", 1.0),
        (column[1], "damping", "damping", 100.0),
    ):
        low, middle, high = scale * of_mode[name].values.T
        shade(panel, x, low, high, MODEL, BAND)
        other, labelled = _beside(of_mode, quantity)
        panel.plot(x, middle, color=MODEL, lw=1.2, label=labelled[0])
        panel.plot(x, scale * of_mode[other].values, color=INK, lw=1.0, ls="--", label=labelled[1])
        panel.ticklabel_format(axis="y", useOffset=False)
    for coordinate in of_mode["coordinate"].values:
        if coordinate != int(of_mode["mode"]):
            place = int(coordinate) - 1
            column[2].plot(
                x, of_mode["shape"].sel(coordinate=coordinate), lw=1.2,
                color=LEVELS[place % len(LEVELS)], label=f"mode {coordinate}",
            )  # fmt: skip
    column[2].set_yscale("log", nonpositive="mask")
    column[2].set_xlabel(labels.first_point_amplitude(unit))


def _beside(of_mode: xr.Dataset, quantity: str) -> tuple[str, tuple[str, str]]:
    """Return the name of the second curve of a mode's backbone, and the labels of both curves."""
    other = f"{quantity}_in_full_stick"
    if other in of_mode:
        return other, (labels.MEDIAN_FREE, labels.MEDIANS_STUCK)
    return f"{quantity}_at_medians", (labels.STUCK_SHAPE, labels.FREE_SHAPE)


def mode_columns(ax: Any, num_modes: int) -> tuple[Panels, list[Panels]]:
    """Return the axes of a figure with three panels per mode, and the panels of each mode."""
    if ax is not None:
        axes = panels(ax, 3, num_modes, height=HEIGHT)
        return axes, list(axes.T)
    height = HEIGHT if num_modes <= ONE_LINE else HEIGHT_OF_LINE
    axes, columns = stacks(None, num_modes, 3, height=height, sharex="col")
    for *_, lowest in columns:
        # Shared axes would have tick labels only in the last row.
        lowest.tick_params(labelbottom=True)
    return axes, [np.ravel(column) for column in columns]
