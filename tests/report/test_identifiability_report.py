"""Tables and figures of what the data identify."""

import numpy as np
import pytest
import xarray as xr
from toy_identifiability import RATIO, identifiability_group, identifiability_summary

from jbw.errors import DataError
from jbw.report.identifiability import (
    directions_table,
    information_spectrum,
    profile_curves,
    quantities_table,
)
from jbw.report.page import render_page
from jbw.report.text import quantity
from jbw.report.words import combination
from jbw.results.run import RunSummary, StoredIdentifiability


@pytest.fixture(scope="module")
def known():
    return xr.DataTree.from_dict({"/identifiability": identifiability_group()})


def test_bars_end_at_the_ratio_of_every_direction(known):
    directions, right = information_spectrum(known).flat
    ends = [bar.get_x() + bar.get_width() for bar in directions.patches]
    np.testing.assert_allclose(ends, np.sort(RATIO), rtol=1e-12)
    assert [label.get_text() for label in directions.get_yticklabels()][3] == "α·δ"
    assert [label.get_text() for label in right.get_yticklabels()][-2:] == ["α δ", "α γ"]
    before, after = right.lines[:2]
    np.testing.assert_allclose(before.get_xdata()[:6], RATIO)
    np.testing.assert_allclose(after.get_xdata()[:6], np.sqrt(0.9) * RATIO, rtol=1e-9)


def test_before_sampling_there_are_no_draws(known):
    group = known["identifiability"].to_dataset()
    bare = group.drop_vars([n for n in group if "contraction" in str(n) or "shift" in str(n)])
    axes = information_spectrum(xr.DataTree.from_dict({"/identifiability": bare}))
    labels = [text.get_text() for text in axes.flat[0].figure.legends[0].get_texts()]
    assert labels == ["from the fit, before sampling"]


def test_one_curve_a_parameter_and_a_sentence_without(known):
    axes = profile_curves(known)
    assert sum(ax.get_visible() for ax in axes.flat) == 6
    group = known["identifiability"].to_dataset()
    bare = group.drop_vars(["profile_value", "profile_chi_square"])
    with pytest.raises(DataError, match="profiles = true"):
        profile_curves(xr.DataTree.from_dict({"/identifiability": bare}))


def test_names_become_symbols_and_the_rest_stays():
    assert combination("alpha^(1/2)*omega_n/delta", {}) == "α^(1/2)·ωₙ/δ"
    assert combination("a mixture of gain and gamma", {}) == "a mixture of gain and γ"
    assert combination("offset - 0.5 zeta", {}) == "offset − 0.5 ζ"
    assert combination("omega_2*zeta_2^-1", {}) == "ω₂·ζ₂^−1"
    at_joint = {"delta@bolt-1": quantity("delta")}  # a name with a sign of its own
    assert combination("delta@bolt-1/zeta", at_joint) == "δ/ζ"


def test_long_mixtures_stay_beside_their_bars(known):
    group = known["identifiability"].to_dataset()
    names = "omega_n, zeta, omega_2, zeta_2, alpha@bolt_1, delta@bolt_1 and gamma@bolt_1"
    group["direction_text"] = group["direction_text"].copy(
        data=[f"a mixture of {names}"] * group.sizes["direction"]
    )
    directions, _ = information_spectrum(xr.DataTree.from_dict({"/identifiability": group})).flat
    labels = {label.get_text() for label in directions.get_yticklabels()}
    assert labels == {"a mixture of ωₙ, ζ, ω₂\nand 4 more"}
    directions.figure.canvas.draw()
    assert directions.get_position().width > 0.25


def texts(shown):
    """Rows of a table: first cell to the texts by the first word of their headings."""
    first, *others = shown.columns
    return {
        first.cell(row).text: {c.heading.split()[0]: c.cell(row).text for c in others}
        for row in shown.rows
    }


def test_rows_of_the_tables():
    shown = quantities_table(StoredIdentifiability.read(identifiability_summary()), {})
    rows = texts(shown)
    assert rows["α"]["follows"] == "0.17 by α lower"
    assert rows["δ"]["follows"] == "∞ by α upper"
    assert rows["γ"]["follows"] == "–"
    assert rows["ζ"]["99"] == "0.004380 to 0.004500"
    assert rows["α"]["99"] == "open to open"
    assert shown.columns[3].cell(shown.rows[-2]).text == "0.30 %"
    assert (
        list(texts(directions_table(StoredIdentifiability.read(identifiability_summary()), {})))[3]
        == "α·δ"
    )
    assert shown.meanings.endswith("412.0, 412.3, 980.0, none.")


def test_a_run_without_is_shown_without(summary, tree):
    assert (
        quantities_table(StoredIdentifiability.read({}), {}).rows
        == directions_table(StoredIdentifiability.read({}), {}).rows
        == []
    )
    assert (
        "Costs"
        not in quantities_table(
            StoredIdentifiability.read({"waterfall": {"costs": [1.0]}}), {}
        ).meanings
    )
    bare = xr.DataTree.from_dict({"/steps/linear": tree["steps/linear"].to_dataset()})
    page = render_page(RunSummary.read({**summary, "identifiability": {}}), bare)
    assert "What the data identify" not in page
    page = render_page(RunSummary.read(summary), bare)
    assert "What the data identify" in page
    assert "&lt;α&gt;" in page
