"""What a population says in sentences and by its status, of records made up by hand."""

import numpy as np
import pytest

from jbw.population.record import status_of
from jbw.population.statements import statements


def interval(low, median, high):
    return {"q005": low, "median": median, "q995": high}


def a_record(num=6, **changed):
    names = [f"unit_{k}" for k in range(num)]
    row = {
        "scatter": interval(0.1, 0.2, 0.3), "run_scatter": None, "own_over_scatter": 0.5,
        "slope_torque": interval(-2.0, -1.5, -1.0),
    }  # fmt: skip
    return {
        "units": names, "torque": [4.0, 8.0, 12.0] * (num // 3) + [4.0] * (num % 3),
        "columns": ["mean", "torque"], "correlation": None, "saturating": [], "ratios": {},
        "parameters": {"stiffness": row}, "belongs": dict.fromkeys(names, 0.5),
        "weighed": dict.fromkeys(names, 0.9), "failed": [], "no_logarithm": {},
        "sampling": {"r_hat": 1.001, "divergences": 0, "num_draws": 2000}, "status": "ok",
        **changed,
    }  # fmt: skip


def said(**changed):
    return " ".join(statements(a_record(**changed)))


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
    assert "2 of 6 units have runs that failed and are pooled with the others: unit_1, unit_4" in (
        said(failed=["unit_1", "unit_4"])
    )
    diverged = {"r_hat": 1.2, "divergences": 40, "num_draws": 2000}
    record = a_record(sampling=diverged)
    assert status_of(record) == "failed"
    assert "did not converge" in statements({**record, "status": "failed"})[0]


@pytest.mark.parametrize(("together", "way"), [(0.99, "rose together"), (-0.99, "against each")])
def test_a_torque_that_goes_with_the_sequence_is_told(together, way):
    assert way in said(correlation=together)
    assert "number of the tightening" not in said(correlation=0.5 * together)


def test_a_wrench_that_sets_and_one_that_reads_are_told_apart():
    """Set: 0.1 |slope| of scatter. Read: 0.01/(var + 0.01) less, as errors in variables do."""
    text = said()
    part = 0.01 / (np.var(np.log([4.0, 8.0, 12.0] * 2)) + 0.01)
    assert "the exponents stay unbiased" in text
    assert "adds a scatter of 15 % to stiffness" in text
    assert f"every exponent is about {100 * part:.1g} % too small" in text
    assert "wrench" not in said(columns=["mean"], torque=[None] * 6)


def test_ratios_runs_and_what_has_no_logarithm_are_told():
    assert "gamma/delta goes as torque^0.1 [-0.2, 0.4]: no dependence on torque is seen" in said(
        ratios={"gamma/delta": interval(-0.2, 0.1, 0.4)}
    )
    assert "0.4 [0.2, 0.6]: it depends on torque" in said(ratios={"a/b": interval(0.2, 0.4, 0.6)})
    row = {**a_record()["parameters"]["stiffness"], "run_scatter": 0.031}
    assert "stiffness by 3.1 % between runs of a unit and by 20 % between units" in said(
        parameters={"stiffness": row}
    )
    assert "gamma has no logarithm in unit_2" in said(no_logarithm={"gamma": ["unit_2"]})
    assert "Of unit_0, unit_1 a normal approximation of the posterior enters." in said(
        weighed={f"unit_{k}": 0.9 for k in range(2, 6)}
    )
