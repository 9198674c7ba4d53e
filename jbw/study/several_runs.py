r"""Frequency and damping against amplitude in several finished runs, and their trend with torque.

The draws q of every run, at an amplitude that all runs fitted, are taken as independent. Over the
logarithm x of the torques each set of draws has the slope of least squares,

$$b = \frac{\sum_i (x_i - \bar x)\,q_i}{\sum_i (x_i - \bar x)^2},$$

which is the change per doubling of the torque where x is the binary logarithm. Where the chi-square
of the residuals from the line is improbable, the runs vary independently of torque, and the
interval of the slope is widened, in quadrature, by Student's interval from that variation.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy import stats

from jbw.errors import ConfigError
from jbw.inference.posterior.summary import QUANTILES
from jbw.report.messages import differences as messages
from jbw.report.result import read_result
from jbw.report.text import interval, length_unit, number
from jbw.results.differences import ReadingBeside, RunBeside, RunsSideBySide, TorqueTrend
from jbw.verification.backbone import curves, has_backbone
from jbw.verification.predictive_basis import Basis, basis_of

NUM_DRAWS = 200  # number of draws of each run
# amplitudes at which runs are compared, relative to the largest displacement of every run's fit
GRID = np.linspace(0.05, 1.0, 20)
# indices into GRID of the reported amplitudes: 10 % and 100 % of the largest amplitude
TOLD = (1, 19)
QUANTITIES = (("frequency", "Hz", 1.0), ("damping ratio", "%", 100.0))
# The variation around a trend is reported if its p-value is smaller than this.
BY_CHANCE = 0.01


def side_by_side(folders: Sequence[Path]) -> tuple[RunsSideBySide, xr.Dataset]:
    """Compare frequency and damping against amplitude in several finished runs, of any laws.

    The second value contains their 99 % bands of frequency [Hz] and damping ratio, by run, quantile
    and amplitude. Runs are ordered by the torques of their campaigns where all state one, otherwise
    as given.

    Raises:
        ConfigError: A run has no frequency and damping against amplitude.
    """
    opened = [read_result(folder) for folder in folders]
    torques: list[Any] = [summary.assembly.get("torque") for summary, _ in opened]
    order = list(range(len(folders)))
    if all(torque is not None for torque in torques):
        order.sort(key=lambda i: torques[i])
    bases = [basis_of(opened[i][1]) for i in order]
    for i, basis in zip(order, bases, strict=True):
        _require_backbone(folders[i], basis)
    amplitude = min(basis.y_peak for basis in bases) * GRID
    names = _names([folders[i] for i in order])
    runs = [
        RunBeside(
            name=name,
            folder=str(folders[i]),
            campaign=opened[i][0].campaign,
            verdict=opened[i][0].verdict.status,
            laws=list(basis.laws),
            torque=torques[i],
        )
        for name, i, basis in zip(names, order, bases, strict=True)
    ]
    draws = [_along(basis, amplitude) for basis in bases]
    # Axes: run, quantile, quantity, amplitude.
    bands = np.array([np.quantile(x, QUANTILES, axis=1) for x in draws])
    dims = ("run", "quantile", "amplitude")
    backbones = xr.Dataset(
        {
            what: (dims, bands[:, :, q], {"units": unit})
            for q, (what, unit) in enumerate((("frequency", "Hz"), ("damping", "1")))
        },
        {
            "run": names, "quantile": list(QUANTILES),
            "amplitude": ("amplitude", amplitude, {"units": "m"}),
        },
    )  # fmt: skip
    readings = [
        ReadingBeside.read(
            {"run": name, "amplitude": float(amplitude[place])}
            | {
                what: (scale * bands[i, :, q, place]).tolist()
                for q, (what, _, scale) in enumerate(QUANTITIES)
            }
        )
        for i, name in enumerate(names)
        for place in TOLD
    ]
    record = RunsSideBySide(runs=runs, readings=readings, trends=_trends(runs, draws, amplitude))
    return record.replaced(statements=_statements(record)), backbones


def _require_backbone(folder: Path, basis: Basis) -> None:
    if not has_backbone(basis.thinned(2), basis.y_peak, basis.laws):
        raise ConfigError(messages.without_backbone(str(folder)), remedy=messages.LEAVE_IT_OUT)


def _names(folders: Sequence[Path]) -> list[str]:
    """Return the names of the runs' folders, or their paths if two names are equal."""
    short = [folder.resolve().name for folder in folders]
    return short if len({*short}) == len(short) else [str(folder) for folder in folders]


def _along(
    basis: Basis, amplitude: Float[np.ndarray, " place"]
) -> Float[np.ndarray, "what draw place"]:
    """Return frequency [Hz] and damping of each draw of a run at each amplitude [m]."""
    carried = curves(basis.thinned(NUM_DRAWS), amplitude, basis.laws)
    return np.array([np.asarray(x) for x in carried[:2]])


def _trends(
    runs: Sequence[RunBeside],
    draws: Sequence[Float[np.ndarray, "what draw place"]],
    amplitude: Float[np.ndarray, " place"],
) -> list[TorqueTrend]:
    """Return the changes of frequency and damping per doubling of torque, from several runs.

    The list is empty if torques are missing or do not differ.
    """
    torques = [run.torque for run in runs if run.torque is not None]
    if len(torques) < len(runs) or len({*torques}) < 2:
        return []
    doublings = np.log2(torques)
    return [
        TorqueTrend(
            name=what,
            unit=unit,
            amplitude=float(amplitude[place]),
            **_trend(doublings, [scale * x[q, :, place] for x in draws]),
        )
        for q, (what, unit, scale) in enumerate(QUANTITIES)
        for place in TOLD
    ]


def _trend(
    doublings: Float[np.ndarray, " run"], draws: Sequence[Float[np.ndarray, " draw"]]
) -> dict[str, Any]:
    """Return a quantity's change per doubling of torque over several runs, with a 99 % interval."""
    count = min(map(len, draws))
    # Draws of runs with the same seed are correlated, so they are put in random order.
    rng = np.random.default_rng(0)
    values = np.array([rng.permutation(x)[:count] for x in draws])
    away = doublings - doublings.mean()
    low, middle, high = np.quantile(away @ values / np.sum(away**2), QUANTILES)
    mean, sd = values.mean(axis=1), values.std(axis=1)
    left = mean - mean.mean() - away * middle
    degrees = len(draws) - 2
    p = float(stats.chi2.sf(np.sum((left / sd) ** 2), degrees)) if degrees else 1.0
    # In this way the interval includes the variation of runs around the trend.
    if p < BY_CHANCE:
        deviation = np.sqrt(np.sum(left**2) / degrees / np.sum(away**2))
        reach = stats.t.ppf(QUANTILES[2], degrees) * deviation
        low, high = middle - np.hypot(middle - low, reach), middle + np.hypot(high - middle, reach)
    rising, falling = (
        bool(np.all(np.mean(sign * np.diff(values, axis=0) > 0, axis=1) > QUANTILES[2]))
        and bool(np.all(np.diff(doublings) > 0))  # Runs of one torque have no order.
        for sign in (1, -1)
    )
    word = "rises" if rising or low > 0 else "falls" if falling or high < 0 else ""
    return {"per_doubling": [low, middle, high], "p": p, "direction": word}


def _statements(record: RunsSideBySide) -> list[str]:
    factor, unit = length_unit(max(row.amplitude for row in record.readings))
    sentences = []
    for row in record.trends:
        low, middle, high = row.per_doubling
        at = f"{number(factor * row.amplitude)} {unit}"
        change = f"{interval(low, middle, high)} {row.unit}"
        steady = not low <= 0.0 <= high
        sentences.append(messages.with_torque(row.name, at, change, row.direction, steady=steady))
    if any(row.p < BY_CHANCE for row in record.trends):
        sentences.append(messages.SCATTER)
    if not record.trends:
        sentences.append(messages.NO_TORQUES)
    sentences += [
        messages.not_usable(run.name, run.verdict)
        for run in record.runs
        if run.verdict not in ("ok", "usable")
    ]
    return [*sentences, messages.INDEPENDENT_RUNS]
