"""Strongly damped decays of few independent values are fitted, with intervals that hold."""

import numpy as np
import pytest
from scipy import stats

import jbw
from jbw.measurement.demodulation import FEWEST_VALUES
from jbw.measurement.envelopes import envelopes, filter_of

HZ, ZETA, FS, LEAST, COUNT = 7.0, 0.035, 100.0, 2.5, 20
BAND = (2.5, 11.5)


def impacts(rng):
    """Two decays of a linear oscillator with noise of a hundredth of their amplitude."""
    t = np.arange(round(LEAST * FS)) / FS
    omega_n = 2 * np.pi * HZ
    records = []
    for amplitude, phase in zip(rng.uniform(0.5, 1.5, 2), rng.uniform(0, 6.28, 2), strict=True):
        motion = np.cos(omega_n * np.sqrt(1 - ZETA**2) * t + phase)
        y = amplitude * np.exp(-ZETA * omega_n * t) * motion + 0.01 * rng.standard_normal(len(t))
        records.append(jbw.Record(FS, {"displacement": 1e-3 * y}, {"displacement": "m"}))
    return jbw.Test("decay", tuple(records), "impacts", band_hz=BAND)


@pytest.mark.slow
def test_errors_of_short_decays_are_as_large_as_stated():
    rng, scores = np.random.default_rng(1), []
    for _ in range(COUNT):
        test = impacts(rng)
        (envelope, _), step = envelopes(test), filter_of(test).step
        assert FEWEST_VALUES <= len(envelope[::step]) < 16
        study = jbw.identify(
            jbw.Campaign("short", None, (test,), laws=()), quick=True, report=lambda _: None
        )
        table = study.table()
        scores.append([
            (table["mean"][name] - true) / table["sd"][name]
            for name, true in (("omega_n", 2 * np.pi * HZ), ("zeta", ZETA))
        ])  # fmt: skip
    # Two chi-squares of twenty cases: one run in five hundred falls outside.
    low, high = stats.chi2.ppf([0.0005, 0.9995], COUNT)
    squares = np.sum(np.square(scores), axis=0)
    assert np.all((low < squares) & (squares < high)), squares
