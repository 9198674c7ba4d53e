"""What a population says in sentences and by its status, of records made up by hand."""

import numpy as np
import pytest

from jbw.population.population import statements, status_of
from jbw.report.messages import population
from jbw.results.population import StoredPopulation


def interval(low, median, high):
    return {"q005": low, "median": median, "q995": high}


def a_record(num=6, **changed):
    names = [f"unit_{k}" for k in range(num)]
    row = {
        "scatter": interval(0.1, 0.2, 0.3), "run_scatter": None, "own_over_scatter": 0.5,
        "slope_torque": interval(-2.0, -1.5, -1.0),
    }  # fmt: skip
    facts = {
        "units": names, "torque": [4.0, 8.0, 12.0] * (num // 3) + [4.0] * (num % 3),
        "columns": ["mean", "torque"], "correlation": None, "saturating": [], "ratios": {},
        "parameters": {"stiffness": row}, "belongs": dict.fromkeys(names, 0.5),
        "weighed": dict.fromkeys(names, 0.9), "failed": [], "no_logarithm": {},
        "sampling": {"r_hat": 1.001, "divergences": 0, "num_draws": 2000}, "status": "ok",
        **changed,
    }  # fmt: skip
    return StoredPopulation.read(facts)


def stated(**changed):
    return statements(a_record(**changed))


@pytest.mark.parametrize(
    ("num", "columns", "status"),
    # A trend needs n - 2 >= 3 degrees of freedom, with bedding-in n - 3; a scatter three units.
    [(2, 1, "not assessed"), (3, 1, "ok"), (4, 2, "not assessed"), (5, 2, "ok"),
     (5, 3, "not assessed"), (6, 3, "ok")],
)  # fmt: skip
def test_few_degrees_of_freedom_are_not_assessed(num, columns, status):
    record = a_record(num, columns=["mean", "torque", "sequence"][:columns])
    assert status_of(record) == status


def test_failed_runs_and_a_failed_sampler_are_named():
    failed = ["unit_1", "unit_4"]
    assert population.failed_runs(failed, 6) in stated(failed=failed)
    diverged = {"r_hat": 1.2, "divergences": 40, "num_draws": 2000}
    record = a_record(sampling=diverged)
    assert status_of(record) == "failed"
    assert statements(record.replaced(status="failed"))[0] == population.not_converged(1.2, 40)


@pytest.mark.parametrize("correlation", [0.99, -0.99])
def test_a_torque_that_goes_with_the_sequence_is_told(correlation):
    assert population.confounded(correlation) in stated(correlation=correlation)
    assert stated(correlation=0.5 * correlation) == stated()


def test_a_wrench_that_sets_and_one_that_reads_are_told_apart():
    """Set: 0.1 |slope| of scatter. Read: 0.01/(var + 0.01) less, as errors in variables do."""
    attenuation = 0.01 / (np.var(np.log([4.0, 8.0, 12.0] * 2)) + 0.01)
    sentence = population.wrench("stiffness", 0.1, 0.15, attenuation)
    assert sentence in stated()
    assert sentence not in stated(columns=["mean"], torque=[None] * 6)


def test_ratios_runs_and_what_has_no_logarithm_are_told():
    level, rising = interval(-0.2, 0.1, 0.4), interval(0.2, 0.4, 0.6)
    statements = stated(ratios={"gamma/delta": level, "a/b": rising})
    assert population.ratio_trend("gamma/delta", level, depends=False) in statements
    assert population.ratio_trend("a/b", rising, depends=True) in statements
    row = a_record().parameters["stiffness"].replaced(run_scatter=0.031)
    assert population.scatter([("stiffness", 0.031, 0.2)]) in stated(parameters={"stiffness": row})
    lacking = {"gamma": ["unit_2"]}
    assert population.no_logarithm("gamma", ["unit_2"]) in stated(no_logarithm=lacking)
    weighed = {f"unit_{k}": 0.9 for k in range(2, 6)}
    assert population.approximated(["unit_0", "unit_1"]) in stated(weighed=weighed)
