"""Backbones of every mode as a figure: where it marks internal resonances, and where it ends."""

import json
from pathlib import Path

import numpy as np
import pytest

import jbw
from jbw.errors import ConfigError
from jbw.report import modal_backbones
from jbw.report.modal_backbones import draw_backbones, interactions

GOLDEN = json.loads((Path(__file__).parents[1] / "golden_modes.json").read_text())


def test_a_harmonic_meets_a_mode_where_the_frequencies_say():
    """omega_1 = 100 (1 - 10 X): three times it is 297 at 1 mm; five times it never nears 297."""
    x = np.linspace(0.0, 2e-3, 9)
    omega_n = np.array([100.0, 297.0, 470.0])
    ((order, mode, x_peak),) = interactions(omega_n, 0, x, 100.0 * (1 - 10.0 * x))
    assert (order, mode) == (3, 1)
    # The detuning is a hyperbola, of which the two amplitudes beside are 1e-5 from its chord.
    assert x_peak == pytest.approx(1e-3, rel=1e-3)
    # A mode that is neared within 1 % and not met is marked where it is nearest; before an end.
    omega = np.where(x < 1.2e-3, 100.0 * (1 - 5.0 * x), np.nan)
    assert interactions(omega_n, 0, x, omega) == [(3, 1, 1e-3)]
    assert interactions(omega_n, 0, x, np.full(9, np.nan)) == []


class Linear:
    """Modes as the figure reads them, which no joint changes."""

    omega_n = np.array([100.0, 300.0])
    h = np.ones(2)


def test_every_mode_has_a_column(monkeypatch):
    x = np.linspace(0.0, 1e-3, 5)
    ends = np.where(x > 6e-4, np.nan, 1.0)

    def motion(structure, levels, mode, num_harmonics):
        omega = Linear.omega_n[mode] * (ends if mode == 1 else np.ones(5))
        shape = np.tile([1.0, 0.01], (5, 1))
        return modal_backbones.BackboneCurve(
            omega, 0.01 * omega / omega, shape, 5e-4 if mode else None
        )

    monkeypatch.setattr(modal_backbones, "curve_of", motion)
    monkeypatch.setattr(modal_backbones, "admitted", lambda structure: structure)
    axes = draw_backbones(Linear(), x)
    assert axes.shape == (3, 2)
    (frequency,) = axes[0, 0].lines[:1]
    np.testing.assert_allclose(frequency.get_ydata(), 100 / (2 * np.pi))
    assert [text.get_text() for text in axes[0, 0].texts] == [
        "resonance 1:3 with\nmode 2 at 0.00 mm"
    ]
    assert "ends at 0.500 mm\n(fold or too many turns)" in axes[0, 1].get_title(loc="left")
    assert axes[2, 0].get_xlabel() == "amplitude at the joint [mm]"


def test_titles_of_many_modes_stand_apart(monkeypatch):
    """Six modes that all end early, in two lines of three columns."""

    class Six:
        omega_n = np.linspace(100.0, 900.0, 6)
        h = np.ones((2, 6))

    def motion(structure, levels, mode, num_harmonics):
        values = np.full(5, structure.omega_n[mode])
        return modal_backbones.BackboneCurve(values, 0.01 + 0 * values, np.ones((5, 6)), 5e-4)

    monkeypatch.setattr(modal_backbones, "curve_of", motion)
    monkeypatch.setattr(modal_backbones, "admitted", lambda structure: structure)
    axes = draw_backbones(Six(), np.linspace(0.0, 1e-3, 5))
    assert axes.shape == (3, 6)
    figure = axes[0, 0].figure
    figure.draw_without_rendering()
    boxes = [panel._left_title.get_window_extent() for panel in axes[0]]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[i + 1 :])
    assert max(box.x1 for box in boxes) <= figure.bbox.x1
    # The fourth mode begins a line of its own, below the first.
    assert axes[0, 3].get_position().y1 < axes[2, 0].get_position().y0
    assert [axes[0, i].get_ylabel() for i in (0, 3)] == ["frequency [Hz]"] * 2
    assert axes[2, 4].get_xlabel() == axes[2, 1].get_xlabel() == "amplitude of the mode [mm]"
    given = figure.subplots(3, 6)
    assert draw_backbones(Six(), np.linspace(0.0, 1e-3, 5), ax=given)[2, 5] is given[2, 5]


def test_amplitudes_must_rise():
    with pytest.raises(ConfigError, match="two rising amplitudes or more"):
        draw_backbones(Linear(), [1e-3, 1e-4])
    assert jbw.draw_backbones is draw_backbones


@pytest.mark.release  # test_modal_steady.py has the golden backbones
def test_it_is_the_backbone_of_a_golden_structure():
    """A golden amplitude lies on the curve that is drawn, and its 1:3 resonance is marked."""
    case = next(
        golden_case
        for golden_case in GOLDEN["backbone"]["cases"]
        if golden_case["system"]["w"][0] > 500
    )
    system, x = case["system"], case["x_joint_first_harmonic"]
    law = jbw.laws.LAWS["bouc_wen"].build(
        {name: system[key] for name, key in (("alpha", "al"), ("delta", "de"), ("gamma", "ga"))}
    )
    w, zeta, h, p, b = (np.array(system[key]) for key in ("w", "ze", "h", "p", "b"))
    structure = jbw.Structure(w, zeta, h, p, b, np.ones(len(w)), (law,))
    axes = draw_backbones(structure, [0.0, 0.5 * x, x])
    lines = [axes[row, 0].lines[0].get_ydata()[-1] for row in (0, 1)]
    expected = [case["omega"] / (2 * np.pi), 100 * case["zeta_eq"]]
    np.testing.assert_allclose(lines, expected, rtol=1e-7)  # the golden table's accuracy
    assert axes[0, 0].texts[0].get_text().startswith("resonance 1:3 with\nmode 2")
