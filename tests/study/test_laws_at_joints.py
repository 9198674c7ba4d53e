"""Laws of several joints side by side: which sets are tried, and which the data ask for."""

import numpy as np
import pytest
import two_bolts
from pasted import lines_of

from jbw.campaign.load import load_with_doubts
from jbw.errors import ConfigError
from jbw.identification.tied_joints import MOST, trials_at_joints
from jbw.inference.posterior.verdict import GOOD_KHAT
from jbw.law_comparison.compare import compare_laws

OWN = two_bolts.LAWS
TIED = ("bouc_wen@bolt_1=bolt_2",)
THREE = tuple(f"bouc_wen@bolt_{i}" for i in (1, 2, 3))
STUCK = (6e6, 1e-3, 1e-4)  # alpha [N/m], delta and gamma [1/m]: no slip at micrometres
MOVED = np.array([[1.0, 1.0], [1.0, 0.93]])  # of each bolt (row) in each mode (column)
RARE = 4.0  # standard deviations: by chance once in 16,000


def test_every_law_is_tried_at_all_joints_and_at_each():
    sets, sentence = trials_at_joints(OWN, [("jenkins", "cubic"), ()])
    assert sets == (
        ("jenkins@bolt_1", "cubic@bolt_1", "jenkins@bolt_2", "cubic@bolt_2"),
        (),
        OWN,
        TIED,
        ("jenkins@bolt_1", "cubic@bolt_1", "bouc_wen@bolt_2"),
        ("bouc_wen@bolt_2",),
        ("bouc_wen@bolt_1", "jenkins@bolt_2", "cubic@bolt_2"),
        ("bouc_wen@bolt_1",),
    )
    assert sentence == (
        "Compared laws, each at all joints: jenkins + cubic, linear. Compared laws, as the "
        "campaign states them: bouc_wen@bolt_1 + bouc_wen@bolt_2, bouc_wen@bolt_1=bolt_2. In "
        "addition, 4 combinations were compared in which one joint has another law."
    )


def test_joints_that_share_a_law_change_together():
    sets, _ = trials_at_joints(TIED, [("jenkins",)])
    assert sets == (("jenkins@bolt_1=bolt_2",), TIED)
    mixed = ("bouc_wen@a=b", "cubic@c")
    assert trials_at_joints(mixed, [("jenkins",)])[0] == (
        ("jenkins@a=b", "jenkins@c"),
        mixed,
        ("jenkins@a=b", "cubic@c"),
        ("bouc_wen@a=b", "jenkins@c"),
    )


def test_too_many_sets_leave_the_joints_that_stick():
    sets, sentence = trials_at_joints(THREE, None)
    assert len(sets) <= MOST
    for joint in range(3):
        assert tuple(law for i, law in enumerate(THREE) if i != joint) in sets
    assert (
        "In addition, 3 combinations were compared in which one joint is fully stuck." in sentence
    )
    many = tuple(f"bouc_wen@bolt_{i}" for i in range(20))
    sets, sentence = trials_at_joints(many, None)
    assert len(sets) == 6  # five usual ones, of which one is the campaign's, and one law for all
    assert sentence.endswith(
        "No combination was compared in which the law of a single joint is changed."
    )


def test_laws_that_name_their_joints_are_tried_as_they_are():
    stated = ("jenkins@bolt_1", "bouc_wen@bolt_2")
    assert trials_at_joints(OWN, [stated])[0] == (stated, OWN, TIED)
    with pytest.raises(ConfigError, match="but names `bolt_7`") as caught:
        trials_at_joints(OWN, [("jenkins@bolt_7",)])
    assert "bolt_1, bolt_2" in caught.value.remedy


def test_joints_without_a_law_are_refused_and_the_remedy_cures(tmp_path):
    path = two_bolts.written(tmp_path, bolts=None)
    text = path.read_text()
    path.write_text(text.replace("[[joint]]\n", "[[joint]]\nlaws = []\n"))
    with pytest.raises(ConfigError, match="needs a joint with a law") as caught:
        compare_laws(load_with_doubts(path)[0])
    ((table, line),) = lines_of(caught.value.remedy)
    path.write_text(text.replace(f"[{table}]\n", f"[{table}]\n{line}\n", 1))
    assert trials_at_joints(load_with_doubts(path)[0].laws, None)[0]


@pytest.mark.slow
def test_bolts_that_differ_ask_for_laws_of_their_own():
    campaign = two_bolts.campaign(("first",))
    compared = compare_laws(campaign, TIED, report=lambda _: None)
    rows = compared.record["laws"]
    own, tied = " + ".join(OWN), TIED[0]
    assert {name: row["answer"] for name, row in rows.items()} == {own: "best", tied: "worse"}
    # Chi-square: what is left is the noise of the records, 1 % of the motion.
    assert rows[own]["error"] == pytest.approx(two_bolts.NOISE, rel=0.05)
    assert rows[tied]["error"] > 1.1 * two_bolts.NOISE
    assert compared.record["statements"][0].startswith("Compared laws, as the campaign states")
    predicted = compared.predict(campaign.tests[0])
    assert predicted.attrs["nrmse"] == pytest.approx(two_bolts.NOISE, rel=0.2)


@pytest.mark.release  # two bolts and the evidence of laws have tests
def test_sets_of_laws_have_the_factors_of_their_own_joints():
    """Mode 2 moves bolt 2 by 7 % less than the matrices say, and bolt 1 sticks."""
    laws, factor = ("bouc_wen@bolt_2",), "motion_factor_2@bolt_2"
    campaign = two_bolts.campaign(
        bolts=(STUCK, two_bolts.BOLTS[1]), laws=laws, uncertain=True, factors=MOVED
    )
    compared = compare_laws(campaign, [()], report=lambda _: None)
    rows = compared.record["laws"]
    answers = {name: (row["answer"], row["hopeless"]) for name, row in rows.items()}
    assert answers == {"linear": ("worse", True), laws[0]: ("best", False)}
    assert factor not in rows["linear"]["parameters"]
    row = rows[laws[0]]
    assert row["khat_evidence"] < GOOD_KHAT
    assert row["error"] == pytest.approx(two_bolts.NOISE, rel=0.05)
    found = row["parameters"][factor]
    assert abs(found["mean"] - MOVED[1, 1]) < RARE * found["sd"]
    assert found["sd"] < 0.01
    # Bands of all laws together move the bolt by the factor of every draw.
    predicted = compared.predict(campaign.tests[-1])
    assert predicted.attrs["nrmse"] == pytest.approx(two_bolts.NOISE, rel=0.2)
