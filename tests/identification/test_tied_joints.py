"""One law for two bolts or a law for each: names, sentences, and the evidence on the rig."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest
import two_bolts

from jbw.campaign.settings import Identify
from jbw.identification import tied_joints
from jbw.identification.assemble import assemble, measured_in
from jbw.identification.evidence import likelihood_at
from jbw.identification.prepare import prepare
from jbw.identification.tied_joints import TiedEvidence, tied_evidence, tied_laws, tied_record
from jbw.identification.uncertain_shapes import first_factors
from jbw.inference.generator import parts_of
from jbw.inference.posterior.verdict import GOOD_KHAT
from jbw.report.opening import tied_sentences
from jbw.results.run import StoredJoints

BOLT = (7e6, 2.5e5, 5e4)  # alpha [N/m], delta and gamma [1/m]
TIED = ("bouc_wen@bolt_1=bolt_2",)
# Log evidence of one law less that of two, shapes uncertain, by the ratio of the bolts' deltas: by
# bridge sampling (Meng and Wong 1996) between a t distribution and draws of Metropolis chains, in
# NumPy; the standard errors are 0.03 and 0.05.
BRIDGED = {1.0: 12.23, 1.3: -24.00}


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
    (sentence,) = tied_sentences(StoredJoints.read({"tied": record}))
    return record["answer"], sentence


def test_the_evidence_is_told_in_odds():
    # exp(3.7) is 40.4; 541 nats are 10^235.
    assert said(3.7) == (
        "tied",
        "bolt_1 and bolt_2 have the same law: the evidence is 40 to 1 against separate laws.",
    )
    answer, sentence = said(-541.0, is_bound=True)
    assert answer == "own"
    assert sentence == (
        "bolt_1 and bolt_2 have different laws: "
        "the evidence is at least 10^235 to 1 against one law."
    )
    answer, sentence = said(-1.0)
    assert answer == "not told"
    assert "2.7 to 1 for separate laws" in sentence
    answer, sentence = said(9.0, khat=0.9)
    assert answer == "not told"
    assert "(k-hat 0.9)" in sentence
    assert tied_record({"other": 1}) is None
    assert tied_sentences(StoredJoints()) == []


def test_the_evidence_of_one_law_is_above_that_of_two_and_as_sure_as_the_poorer(monkeypatch):
    own, one = (SimpleNamespace(data=None, fit=None) for _ in range(2))
    own.data = SimpleNamespace(
        laws=two_bolts.LAWS, modes=SimpleNamespace(meet=tied_joints.ASSEMBLED)
    )
    weighed = [
        SimpleNamespace(log_evidence=-7.0, khat=0.6),
        SimpleNamespace(log_evidence=-3.0, khat=0.2),
    ]
    monkeypatch.setattr(tied_joints, "tied_fit", lambda *_: one)
    monkeypatch.setattr(tied_joints, "likelihood_at", lambda *_: -1.0)
    monkeypatch.setattr(tied_joints, "_weighed", lambda *_: weighed.pop(0))
    found = tied_evidence(jax.random.key(0), own, Identify())
    assert (found.laws, found.log_ratio, found.khat, found.answer) == (TIED, 4.0, 0.6, "tied")


def laplace(fitted):
    r"""Log evidence of a Gaussian posterior, $\ln L + \frac12\ln\det 2\pi\Sigma - \ln V$ [nats]."""
    widths = np.asarray(fitted.box.upper) - np.asarray(fitted.box.lower)
    log_volume = 0.5 * np.linalg.slogdet(2 * np.pi * fitted.fit.covariance)[1]
    return likelihood_at(fitted.fit, fitted.data) + log_volume - np.sum(np.log(widths))


def compared(delta_ratio, *, uncertain=False, key=None):
    """The fit with laws of their own, and the evidence of one law; the bolts differ in delta."""
    alpha, delta, gamma = BOLT
    bolts = (BOLT, (alpha, delta_ratio * delta, gamma))
    seen = measured_in(two_bolts.campaign(bolts=bolts, uncertain=uncertain), lambda _: None)
    data = assemble(seen)
    keys = jax.random.split(jax.random.key(0))
    known = two_bolts.truth(bolts) | first_factors(data)
    own = prepare(parts_of(keys[0], 2), data, seen.settings, known)
    return own, tied_evidence(keys[1] if key is None else key, own, seen.settings)


@pytest.mark.slow
@pytest.mark.parametrize(("delta_ratio", "answer"), [(1.0, "tied"), (1.3, "own")])
def test_equal_bolts_are_tied_and_bolts_that_differ_by_a_third_are_not(delta_ratio, answer):
    own, found = compared(delta_ratio)
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


@pytest.mark.release  # bolts of stated shapes are compared above
@pytest.mark.parametrize(("delta_ratio", "answer"), [(1.3, "own"), (1.0, "tied")])
def test_bolts_are_compared_where_shapes_are_uncertain(delta_ratio, answer):
    """A joint's factor is traded for the other's law along a curve, whose ends count too.

    By this key of equal bolts, k-hat of points about the fit is 0.77.
    """
    key = jax.random.key(7) if answer == "tied" else None
    own, found = compared(delta_ratio, uncertain=True, key=key)
    assert found is not None
    assert "motion_factor_1@bolt_1" in set(found.tied.box.names) - set(own.box.names)
    assert found.khat < GOOD_KHAT
    assert found.answer == answer
    assert not found.is_bound
    # Both log evidences to a tenth of a nat, where k-hat is good.
    assert found.log_ratio == pytest.approx(BRIDGED[delta_ratio], abs=0.3)
