"""The oscillator, the procedure and the backbone as figures, against the numbers in the tree."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from jbw.errors import DataError
from jbw.report.diagrams import oscillator, procedure
from jbw.report.loops import backbone, draw_loops
from jbw.report.prediction import prediction
from jbw.report.result import near_branch, unwrapped_band
from jbw.report.text import length_unit


def texts(ax):
    return [text.get_text() for text in ax.texts]


def without(tree, *groups):
    return tree.filter(lambda node: not node.path.startswith(groups))


def test_the_backbone_is_the_trees(tree):
    frequency, right = backbone(without(tree, "/look")).flat
    group = tree["verification/backbone"]
    for ax, name, scale in ((frequency, "frequency", 1.0), (right, "damping", 100.0)):
        (line,) = ax.lines
        np.testing.assert_allclose(line.get_xdata(), 1e3 * group["amplitude"].values)
        np.testing.assert_allclose(line.get_ydata(), scale * group[name].values[1])
        # Where what was fitted ends, 6.4 mm, the shading begins.
        assert ax.patches[0].get_x() == pytest.approx(6.4)
    assert frequency.get_ylabel() == "natural frequency [Hz]"
    assert right.get_ylabel() == "equivalent damping ratio [%]"
    assert frequency.get_xlabel() == "amplitude of displacement [mm]"
    labels = [text.get_text() for text in frequency.figure.legends[0].get_texts()]
    assert labels == [
        "99 % band: parameters alone",
        "median of the model",
        "beyond what was fitted",
    ]


def test_loops_are_drawn_whole_or_as_what_slip_takes(tree):
    ax = Figure().subplots()
    draw_loops(tree, ax)
    group = tree["verification/backbone"].to_dataset()
    assert ax.get_ylabel() == "hysteretic force Z [N/kg]"
    widest = ax.lines[-1]
    np.testing.assert_allclose(widest.get_ydata()[:-1], group["loop_z"].values[1, -1])
    thin = group.assign(loop_slip=0.01 * group["loop_z"])
    draw_loops(xr.DataTree.from_dict({"/verification/backbone": thin}), ax)
    assert ax.get_ylabel() == "force lost by slip, Z − α y [N/kg]"
    np.testing.assert_allclose(ax.lines[-1].get_ydata()[:-1], thin["loop_slip"].values[1, -1])


def test_lengths_are_written_with_digits_before_the_point():
    assert [length_unit(x)[1] for x in (2.0, 3e-3, 4e-6, 1e-11)] == ["m", "mm", "µm", "nm"]


def test_the_oscillator_has_the_runs_numbers(tree):
    schematic, loops = oscillator(tree).flat
    written = texts(schematic)
    assert {"ωₙ² − α", "2ζωₙ", "Z", "u(t)"} <= set(written)
    # The toy's alpha is 497.4 with a standard deviation of 2.1: half of 99 % is 1.1 %.
    assert any(text.startswith("497.4 s⁻² ± 1.1") for text in written)
    assert "[mm]" in loops.get_xlabel()
    bare = oscillator(without(tree, "/verification"))
    assert bare.shape == (1, 1)
    with pytest.raises(DataError, match="no posterior"):
        oscillator(without(tree, "/posterior"))


def test_the_procedure_tells_what_each_step_found(tree):
    written = texts(procedure(tree))
    assert "fₙ = 18.799 Hz" in written
    assert written.count("failed") == 2
    assert "ESS 812, R-hat 1.00" in written
    # The toy's product, 169220 with 0.5 % of scatter.
    assert any(text.startswith("NUTS: α δ = 169300 m⁻¹ s⁻² ± 1.3 %") for text in written)
    assert any(text.startswith("NUTS: γ = ") for text in written)
    (joint,) = [text for text in written if text.startswith("ωₙ/2π = ")]
    assert joint.splitlines()[-1] == "ESS 1404, R-hat 1.00"
    # The toy's loops: the model's area is 1.005 times the measured one.
    assert "3 loops, error of the model's loop areas at most 0.50 %" in written
    assert {"Step 2", "Step 3", "Step 4", "Joint", "Verification", "Validation"} <= set(written)


def test_steps_without_tests_have_no_box(tree):
    ax = procedure(without(tree, "/steps", "/validation"))
    assert len(ax.patches) == 2
    assert {"Joint", "Verification"} <= set(texts(ax))
    assert not {"Step 2", "Step 3", "Step 4", "Validation"} & set(texts(ax))


def test_no_text_of_the_procedure_meets_another_or_leaves_its_box(tree):
    for shown in (tree, without(tree, "/steps")):
        ax = procedure(shown)
        ax.figure.draw_without_rendering()
        boxes = [text.get_window_extent() for text in ax.texts if text.get_text()]
        edge = ax.patches[0].get_window_extent()
        assert all(edge.x0 <= box.x0 <= box.x1 <= edge.x1 for box in boxes)
        for first, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in boxes[first + 1 :])


def test_given_axes_are_used(tree):
    ax = Figure().subplots()
    assert procedure(tree, ax) is ax
    pair = Figure().subplots(1, 2)
    assert list(backbone(tree, pair).flat) == list(pair)


def test_a_velocitys_phase_does_not_jump():
    # A velocity's phase runs from 90 to -90 degrees; read as an angle it may leave by a turn.
    exact = np.radians(np.linspace(89.9, -89.9, 41))
    turns = np.where(np.arange(41) % 2, 2 * np.pi, 0.0)
    band = np.stack([exact - 0.01, exact, exact + 0.01]) + turns
    turned = unwrapped_band(band)
    np.testing.assert_allclose(turned[1], np.degrees(exact), atol=1e-9)
    np.testing.assert_allclose(np.diff(turned, axis=0), np.degrees(0.01), atol=1e-9)
    measured = exact + 0.02 - 4 * np.pi
    np.testing.assert_allclose(near_branch(measured, turned[1]) - turned[1], np.degrees(0.02))


def test_a_predicted_phase_does_not_jump_either():
    freq = np.linspace(17.0, 20.0, 41)
    exact = np.radians(np.linspace(89.9, -89.9, 41)) + np.where(np.arange(41) % 3, 0, 2 * np.pi)
    dims = ("quantile", "freq")
    wide = np.array([-0.3, 0.0, 0.3])[:, None]
    variables = {
        "model_magnitude": (dims, np.ones((3, 41)), {"units": "m/s", "long_name": "velocity"}),
        "model_phase": (dims, exact + 0.1 * wide),
        "predictive_magnitude": (dims, np.ones((3, 41))),
        "predictive_phase": (dims, exact + wide - 2 * np.pi),
    }
    dataset = xr.Dataset(variables, {"freq": freq, "quantile": [0.005, 0.5, 0.995]}, {"level": 1.0})
    phase = prediction("planned", dataset)[1, 0]
    for line in phase.lines:
        np.testing.assert_allclose(line.get_ydata(), np.linspace(89.9, -89.9, 41), atol=1e-9)
    for shaded in phase.collections:
        # Bands of 0.6 rad at most, 34 degrees, beside a phase between -90 and 90.
        assert np.abs(shaded.get_paths()[0].vertices[:, 1]).max() < 90 + 18
