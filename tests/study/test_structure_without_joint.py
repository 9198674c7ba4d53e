"""Three levels of sweeps and free decays of a linear oscillator: no joint, and no ridge to draw."""

from collections import Counter

import numpy as np
import pytest
from linear_campaign import write_linear
from toy_campaign import TRUTH

import jbw
from jbw.identification import checks, joint
from jbw.observables.dataset import log_likelihood, stacked

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def answered(tmp_path_factory):
    """The study, what was said, lots of evaluations, and how often a joint was asked for."""
    said, lots, asked = [], Counter(), []
    ask = joint.without_joint

    def counted(function):
        solver = function.solver

        def solve(theta, data, threads):
            substeps = max(part.substeps for part in data.parts)
            lots[function.__name__, data.laws, substeps] += 1
            return solver(theta, data, threads)

        return solve

    def counted_question(*arguments):
        asked.append(arguments)
        return ask(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        for function in (log_likelihood, stacked):
            patch.setattr(function, "solver", counted(function))
        for asking in (joint, checks):
            patch.setattr(asking, "without_joint", counted_question)
        path = write_linear(tmp_path_factory.mktemp("linear"))
        study = jbw.identify(jbw.load_campaign(path), seed=1, report=said.append)
    return study, said, lots, asked


def test_a_structure_without_a_joint_is_answered_by_its_fit(answered):
    study, said, *_ = answered
    posterior = study.tree["posterior"].to_dataset()
    assert not {"alpha", "delta", "gamma"} & {*posterior.data_vars}
    for name in ("omega_n", "zeta"):
        z = (float(posterior[name].mean()) - TRUTH[name]) / float(posterior[name].std())
        assert abs(z) < 4, name  # two intervals: a chance of 1e-4
    found = {one.code: one for one in study.verdict.findings}["no_joint"]
    assert found.status == "failed"
    assert "laws = []" in found.action
    assert np.isfinite(found.number)
    # No second posterior, and no record by itself.
    stages = [line for line in said if not line.startswith("Identified from the fit alone (")]
    assert not [line for line in stages if "alone" in line or "by itself" in line]
    assert "decay" not in study.record["steps"]
    # The model is the linear oscillator: none is fitted again to be compared with it.
    assert all(one["nrmse_linear"] is None for one in study.record["predictions"].values())


def test_what_is_not_there_costs_two_programs_and_one_question(answered):
    *_, lots, asked = answered
    with_joint = {key: count for key, count in lots.items() if key[1]}
    # Its residual and its likelihood, and neither at finer steps of the solver.
    assert sorted(what for what, *_ in with_joint) == ["log_likelihood", "stacked"]
    # The likelihood: 256 points of the box for the choice of a law, 32 a lot. The fit starts from
    # the parameters of that choice.
    assert sum(n for (what, *_), n in with_joint.items() if what == "log_likelihood") == 8
    # Of a structure without a joint the steps are exact: none is halved.
    assert len({steps for _, laws, steps in lots if not laws}) == 1
    assert len(asked) == 1
