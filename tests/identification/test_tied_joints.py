"""One law for two bolts or a law for each: names, sentences, and the evidence on the rig."""

import jax
import numpy as np
import pytest
import two_bolts

from jbw.identification.assemble import assemble, measured_in
from jbw.identification.evidence import likelihood_at
from jbw.identification.prepare import prepare
from jbw.identification.tied_joints import TiedEvidence, tied_evidence, tied_laws, tied_record
from jbw.inference.generator import parts_of
from jbw.report.opening import tied_sentences

BOLT = (7e6, 2.5e5, 5e4)  # alpha [N/m], delta and gamma [1/m]
TIED = ("bouc_wen@bolt_1=bolt_2",)


@pytest.mark.parametrize(
    ("laws", "expected"),
    [
        (two_bolts.LAWS, TIED),
        (TIED, TIED),
        (("bouc_wen@a", "cubic@b", "bouc_wen@c"), ("bouc_wen@a=c", "cubic@b")),
        (("bouc_wen@a=b", "bouc_wen@c"), ("bouc_wen@a=b=c",)),
        (("bouc_wen@a", "cubic@a", "bouc_wen@b"), ("bouc_wen@a", "cubic@a", "bouc_wen@b")),
        (
            ("bouc_wen@a", "cubic@a", "bouc_wen@b", "cubic@b"),
            ("bouc_wen@a=b", "cubic@a=b"),
        ),
    ],
)
def test_joints_of_the_same_kinds_of_laws_are_tied(laws, expected):
    assert tied_laws(laws) == expected


def said(log_ratio, khat=0.1, *, is_bound=False):
    attrs = TiedEvidence(TIED, None, log_ratio, khat, is_bound).attrs  # pyright: ignore[reportArgumentType]
    record = tied_record(attrs)
    assert record is not None
    (sentence,) = tied_sentences({"tied": record})
    return record["answer"], sentence


def test_the_evidence_is_told_in_odds():
    # exp(3.7) is 40.4; 541 nats are 10^235.
    assert said(3.7) == (
        "tied",
        "bolt_1 and bolt_2 have the same law: evidence 40 to 1 against laws of their own.",
    )
    answer, sentence = said(-541.0, is_bound=True)
    assert answer == "own"
    assert sentence == (
        "bolt_1 and bolt_2 have laws that differ: evidence at least 10^235 to 1 against one law."
    )
    answer, sentence = said(-1.0)
    assert answer == "not told"
    assert "2.7 to 1 for laws of their own" in sentence
    answer, sentence = said(9.0, khat=0.9)
    assert answer == "not told"
    assert "k-hat is 0.9" in sentence
    assert tied_record({"other": 1}) is None
    assert tied_sentences({}) == []


def laplace(fitted):
    r"""Log evidence of a Gaussian posterior, $\ln L + \frac12\ln\det 2\pi\Sigma - \ln V$ [nats]."""
    widths = np.asarray(fitted.box.upper) - np.asarray(fitted.box.lower)
    log_volume = 0.5 * np.linalg.slogdet(2 * np.pi * fitted.fit.covariance)[1]
    return likelihood_at(fitted.fit, fitted.data) + log_volume - np.sum(np.log(widths))


@pytest.mark.slow
@pytest.mark.parametrize(("delta_ratio", "answer"), [(1.0, "tied"), (1.3, "own")])
def test_equal_bolts_are_tied_and_bolts_that_differ_by_a_third_are_not(delta_ratio, answer):
    alpha, delta, gamma = BOLT
    bolts = (BOLT, (alpha, delta_ratio * delta, gamma))
    campaign = two_bolts.campaign(bolts=bolts)
    data = assemble(measured_in(campaign, lambda _: None))
    keys = jax.random.split(jax.random.key(0))
    own = prepare(parts_of(keys[0], 2), data, campaign.settings, two_bolts.truth(bolts))
    found = tied_evidence(keys[1], own, campaign.settings)
    assert found is not None
    assert found.laws == TIED
    assert found.answer == answer
    if delta_ratio == 1.0:
        # Posteriors are close to Gaussian: weighed points correct that by tenths of a nat.
        assert found.log_ratio == pytest.approx(laplace(found.tied) - laplace(own), abs=0.5)
        assert found.tied.fit.cost > own.fit.cost
    else:
        assert found.is_bound
        assert found.log_ratio == pytest.approx(
            likelihood_at(found.tied.fit, found.tied.data) - laplace(own), abs=0.5
        )
