"""Damping without hysteresis, and intervals narrower than the instruments."""

import numpy as np
import pytest
from pasted import pasted
from scipy.integrate import solve_ivp

import jbw
from jbw.identification.equivalent import Effects, hysteresis_finding
from jbw.identification.no_joint import Nested, drag_finding, may_be_drag
from jbw.measurement.records import Record, Test
from jbw.report.opening import known_parameters
from jbw.report.words import grades
from jbw.results.run import RunSummary

RNG = np.random.default_rng(0)
NOTHING = 1e-4 * RNG.standard_normal(500)
SOFTER = -3e-3 + NOTHING
DAMPED = 0.4 + 0.01 * RNG.standard_normal(500)


@pytest.mark.parametrize(("misses", "status"), [(True, "failed"), (False, "usable")])
def test_damping_that_leaves_the_frequency_alone_is_no_hysteresis(misses, status):
    found = hysteresis_finding(Effects(NOTHING, DAMPED), 1e-3, ("bouc_wen",), misses=misses)
    assert found.status == status
    assert found.code == "no_hysteresis"
    assert "40 % [" in found.reason
    assert 'laws = ["quadratic_damping"]' in found.action


@pytest.mark.parametrize(
    ("added", "laws"),
    [
        (Effects(SOFTER, DAMPED), ("bouc_wen",)),  # hysteresis
        (Effects(NOTHING, NOTHING), ("bouc_wen",)),  # no joint
        (Effects(0 * NOTHING, DAMPED), ("quadratic_damping",)),  # as it was told
    ],
)
def test_hysteresis_no_joint_and_drag_itself_are_not_doubted(added, laws):
    assert hysteresis_finding(added, 1e-3, laws, misses=True) is None


ZETA = 3e-3
SOFTENING = Effects(-0.2 * ZETA * DAMPED, DAMPED)  # a fifth of the damping that it adds


@pytest.mark.parametrize(
    ("added", "laws", "asked"),
    [
        (SOFTENING, ("bouc_wen",), True),
        (Effects(-0.9 * ZETA * DAMPED, DAMPED), ("bouc_wen",), False),  # gamma near delta
        (Effects(NOTHING, -DAMPED), ("bouc_wen",), False),  # damping taken away
        (SOFTENING, (), False),
        (SOFTENING, ("cubic_damping",), False),  # as it was told
    ],
)
def test_drag_is_tried_where_the_frequency_falls_less_than_by_slip(added, laws, asked):
    assert may_be_drag(added, ZETA, laws) is asked


@pytest.mark.parametrize(
    ("growth", "misses", "status"),
    [  # of two parameters chi-square has 9.21 at a probability of 1 %
        (9.22, True, "ok"), (9.20, False, "usable"), (9.20, True, "failed"),
        (-9.22, False, "failed"),
    ],
)  # fmt: skip
def test_hysteresis_is_seen_where_drag_fits_worse_than_by_chance(growth, misses, status):
    nested = Nested(growth, 2, fit=None, bounds={})
    found = drag_finding(nested, SOFTENING, 1e-3, misses=misses)
    assert found.status == status
    if status != "ok":
        assert "adds 40 % [" in found.reason
        assert pasted(found.action).laws == ("quadratic_damping",)


def test_a_doubted_joint_has_no_known_parameter():
    """Neither in the opening nor among what a report calls identified, narrow as intervals are."""
    rows = {
        name: {"mean": 1.0, "q005": 0.99, "q995": 1.01, "cv": 0.004, "kl": 5.0, "unit": "1"}
        for name in ("omega_n", "zeta", "alpha", "delta", "gamma")
    }
    found = drag_finding(Nested(1.0, 2, None, {}), SOFTENING, 1e-3, misses=False)
    record = {
        "main": "joint",
        "steps": {"joint": {"parameters": rows}},
        "verdict": {"status": "usable", "findings": [found.stored()]},
    }
    summary = RunSummary.read(record)
    graded = grades(summary)
    assert {name for name, grade in graded.items() if grade <= 1} == {"omega_n", "zeta"}
    assert [line.split()[0] for line in known_parameters(summary)] == ["omega_n", "zeta"]


DRAG, FS = 5.0, 512.0  # [1/m], a damping ratio of 0.5 % at 2.4 mm; [Hz]


def decays_of(force):
    """Two decays of 20 Hz by SciPy's DOP853, with noise of 0.2 % of the largest response."""
    omega, t = 2 * np.pi * 20.0, np.arange(6 * 512) / FS
    rng, records = np.random.default_rng(3), []

    def rate(_, x):
        y, v, z = x
        pull, dz = force(v, z, omega)
        return v, -2 * ZETA * omega * v - omega**2 * y - pull, dz

    for size in (0.31, 0.27):
        y, v, z = solve_ivp(rate, (0, t[-1]), (0, size, 0), "DOP853", t, rtol=1e-9, atol=1e-12).y
        a = -2 * ZETA * omega * v - omega**2 * y - force(v, z, omega)[0]
        noisy = a + 2e-3 * np.abs(a).max() * rng.standard_normal(a.size)
        records.append(Record(FS, {"acceleration": noisy}, {"acceleration": "m/s^2"}))
    return Test("decay", tuple(records), "impacts", band_hz=(10.0, 40.0))


def drag(v, z, omega):
    return DRAG * v * abs(v), 0.0


def slip(v, z, omega):
    """Bouc-Wen that softens by a quarter of the damping that it adds; beside a stiffness gone."""
    alpha, gamma = 0.3 * omega**2, 2 * DRAG / 0.3
    return z, alpha * v - gamma * abs(v) * z - gamma / 4 * v * abs(z)


def quick_answer(test, laws=("bouc_wen",)):
    campaign = jbw.Campaign("any", None, (test,), laws=laws)
    return jbw.identify(campaign, quick=True, seed=0, report=lambda _: None)


@pytest.mark.release  # the findings are made above
@pytest.mark.filterwarnings("ignore")
def test_a_first_answer_of_drag_doubts_hysteresis_and_the_line_cures():
    test = decays_of(drag)
    study = quick_answer(test)
    codes = {one.code: one for one in study.verdict.findings}
    assert codes["no_hysteresis"].status != "ok"
    assert codes["no_hysteresis"].reason in " ".join(study.record["opening"])
    assert not any(line.startswith("alpha") for line in known_parameters(study.result))
    cured = quick_answer(test, pasted(codes["no_hysteresis"].action).laws)
    assert [one.code for one in cured.verdict.findings] == ["not_sampled"]
    row = cured.record["steps"]["joint"]["parameters"]["quadratic_damping"]
    assert row["q005"] < DRAG < row["q995"]


@pytest.mark.release  # readings of slip are not doubted above
@pytest.mark.filterwarnings("ignore")
def test_a_first_answer_of_slip_that_hardly_softens_is_not_doubted():
    study = quick_answer(decays_of(slip))
    assert "no_hysteresis" not in {one.code for one in study.verdict.findings}
    row = study.record["steps"]["joint"]["parameters"]["alpha_gamma"]
    assert row["q005"] < 2 * DRAG * (2 * np.pi * 20.0) ** 2 < row["q995"]
