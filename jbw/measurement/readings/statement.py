r"""Statistical tests of frequency and damping: do records differ, and does amplitude matter?

A frequency or damping ratio, in row j of record i at amplitude $a_{ij}$, is modelled as

$$y_{ij} = \mu + b_1 r_{ij} + b_2 r_{ij}^2 + \beta_i + \epsilon_{ij}, \qquad
  \beta_i \sim N(0, \tau^2), \quad \epsilon_i \sim N(0, C_i), \quad r = a / a_{max}$$

with the covariance C of the reading of each record. The first question is whether records differ at
equal amplitude: $\tau$ is found by restricted maximum likelihood and tested by its likelihood ratio
against 0. Whether amplitude matters is Wald's test of b with $\tau$ in its errors, so that a joint
that relaxes between records is not mistaken for one that softens. The power is that of
$\mu + b\,r^p$ from the profile of its likelihood.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.linalg import block_diag
from scipy.special import chdtrc, erfc, fdtrc

from jbw.measurement.channels import Reals
from jbw.measurement.resonances import AmplitudeCurve

ROWS = 4  # number of values used per record; more would add nothing, because tables are smooth
EXPONENTS = np.round(np.concatenate([np.arange(-1.2, 0.0, 0.1), np.arange(0.1, 4.01, 0.05)]), 3)
INSIDE = 6.63  # limit on 2 ln of the likelihood ratio for the 99 % interval of one parameter
# p-values below which records differ, and values depend on amplitude
RECORDS, AMPLITUDE = 1e-3, 1e-4
# relative standard deviations between records that are tried
SPREADS = np.geomspace(1e-7, 1.0, 141)
LEAST_VARIANCE = 1e-14  # smallest variance of a value, relative to the mean squared
# smallest ratio of largest to smallest amplitude at which an effect of amplitude is tested
LEAST_RANGE = 1.2
# smallest changes that are reported: relative change of the frequency, divided by zeta; relative
# change of zeta
LEAST = {"hz": 3e-3, "zeta": 5e-3}
SURE = 3.5  # number of standard deviations by which a turning frequency must fall and rise again
CERTAIN = 2.576  # half width of a 99 % interval in standard deviations
EQUAL = 0.05  # error of an estimated power that averaging may cause
SPRING = 0.02  # largest ratio of a spring's change of damping to its relative change of frequency
# Smallest ratio of damping change to relative fall of frequency for a joint that slips: for sliders
# with the Iwan exponent chi, 4 (chi + 1) / (pi (chi + 3)), which is 0.1 at -0.8.
SLIPS = 0.1
# exponent of the amplitude in the change of frequency (springs), of damping (dampers) or of both
# (hysteresis), by law
NEAR = 1.0  # half the distance between the powers of two springs
SPRINGS = {"cubic": 2.0, "quintic": 4.0}
DAMPERS = {"quadratic_damping": 1.0, "cubic_damping": 2.0}
HYSTERESIS = {"bouc_wen": 1.0}
# allowed decrease of the exponent of a law that saturates; the exponent of bouc_wen is 0.8 instead
# of 1 at the amplitude where delta y reaches 2
SATURATES = 0.25
ELASTIC, SLIPPING = 0.5, 2.0  # c in `in_steady_motion`
SLIDERS = ("masing_power", "iwan4")
KINDS_OF_FORCE = (tuple(SPRINGS), tuple(DAMPERS), (*HYSTERESIS, *SLIDERS))


class RecordTable(NamedTuple):
    """Frequency and damping of one record against the amplitude of motion, with covariances.

    `chance` is the probability that a linear mode produces such a record, if that was tested.
    """

    y: Reals
    hz: Reals
    zeta: Reals
    hz_covariance: Float[np.ndarray, "row row"]
    zeta_covariance: Float[np.ndarray, "row row"]
    chance: float = 0.0


def few_rows(table: RecordTable) -> RecordTable:
    """Return a table restricted to a few rows, which contain all information, as it is smooth."""
    pick = np.unique(np.linspace(0, len(table.y) - 1, ROWS).astype(int))
    square = np.ix_(pick, pick)
    return RecordTable(
        table.y[pick], table.hz[pick], table.zeta[pick],
        table.hz_covariance[square], table.zeta_covariance[square], table.chance,
    )  # fmt: skip


def in_steady_motion(decay: RecordTable) -> RecordTable:
    r"""Return the table of a free decay with the damping that a steady motion has.

    $$\zeta_{steady} = \zeta_{decay}\,(1 + c\,s), \qquad s = \frac{d \ln f}{d \ln Y}$$

    A decay whose frequency changes loses amplitude at another rate than a steady motion has
    damping. If an elastic force hardens, $d(f Y^2)/dt = -4\pi\zeta f\,f Y^2$ and c = 1/2. If a
    joint slips by Masing's rule, the energy between two reversals gives
    $1 + c s = G'(Y) / \omega^2$ with the skeleton curve G of the whole force: c is 2 where the
    stiffness falls linearly, and from 1.8 to 2.2 where it falls with the power 0.05 to 2 of Y.
    """
    if len(decay.y) < 3:
        return decay
    along = np.gradient(np.eye(len(decay.y)), np.log(decay.y), axis=0, edge_order=2)
    s = along @ np.log(decay.hz)
    share = np.where(s < 0, SLIPPING, ELASTIC)
    factor, by_hz = 1 + share * s, (decay.zeta * share)[:, None] * along / decay.hz
    covariance = np.outer(factor, factor) * decay.zeta_covariance
    covariance += by_hz @ decay.hz_covariance @ by_hz.T
    return decay._replace(zeta=factor * decay.zeta, zeta_covariance=covariance)


def curve_of(tables: Sequence[RecordTable]) -> AmplitudeCurve:
    """Return frequency and damping of all records as one curve against amplitude.

    Its covariances include the variation between records.
    """

    def covariance(quantity: str, unit: float) -> Float[np.ndarray, "row row"]:
        mean = np.mean(np.concatenate([getattr(table, quantity) for table in tables]))
        spread = trend(tables, quantity).scatter * mean
        blocks = [getattr(table, f"{quantity}_covariance") + spread**2 for table in tables]
        return unit**2 * np.asarray(block_diag(*blocks))

    y, hz, zeta = (
        np.concatenate([getattr(table, name) for table in tables]) for name in ("y", "hz", "zeta")
    )
    radians = 2 * np.pi
    return AmplitudeCurve(y, radians * hz, zeta, covariance("hz", radians), covariance("zeta", 1.0))


class AmplitudeTrend(NamedTuple):
    """The dependence of frequency or damping on amplitude, estimated from several records.

    Attributes:
        at_rest: Value at vanishing amplitude.
        change: Change from the smallest to the largest amplitude, relative for a frequency.
        change_sd: Standard deviation of the change.
        chance: Probability of such a change if amplitude has no influence.
        is_seen: Whether the change is improbable by chance and large enough to matter.
        exponent: Power of the amplitude with the ends of its 99 % interval; None if no change is
            seen or the value turns.
        turn: Amplitude and value at the turning point; None if the value is monotonic.
        scatter: Relative standard deviation between records at equal amplitude.
        records_chance: Probability of such a variation among equal records.
        offsets: Relative deviation of each record from the mean, with its standard deviation.
        onset: Smallest amplitude at which the change is certain; None if no change is seen.
    """

    at_rest: float
    change: float
    change_sd: float
    chance: float
    is_seen: bool
    exponent: tuple[float, float, float] | None
    turn: tuple[float, float] | None
    scatter: float
    records_chance: float
    offsets: tuple[tuple[float, float], ...]
    onset: float | None


class _RowsOfRecords(NamedTuple):
    """The values of all records: amplitude / largest amplitude, value / mean value.

    A whitening W is the root of the inverse covariance of a record's values, W^T W = C^-1.
    """

    r: Reals
    value: Reals
    whitenings: tuple[Float[np.ndarray, "row row"], ...]

    def split(self, values: Reals) -> list[Reals]:
        """Split an array with columns of all records' values into one array per record."""
        return np.split(values, np.cumsum([len(one) for one in self.whitenings])[:-1], axis=-2)


class _Estimate(NamedTuple):
    values: Float[np.ndarray, "*axes unknown"]
    covariance: Float[np.ndarray, "*axes unknown unknown"]
    squares: Float[np.ndarray, "*axes"]  # of the residual, in units of its covariance
    penalty: Float[np.ndarray, "*axes"]  # -2 ln of the restricted likelihood


def trend(tables: Sequence[RecordTable], quantity: str) -> AmplitudeTrend:
    """Return the dependence of `hz` or `zeta` on amplitude and its differences between records.

    Args:
        tables: Readings, one table per record.
        quantity: "hz" or "zeta".
    """
    unit = float(np.mean([np.mean(getattr(table, quantity)) for table in tables]))
    top = max(float(table.y.max()) for table in tables)
    low = min(float(table.y.min()) for table in tables)
    rows = _rows(tables, quantity, unit, top)
    spans = top > LEAST_RANGE * low
    terms = max(min(2, len(rows.value) - 2), 0) if spans else 0
    design = np.vander(rows.r, terms + 1, increasing=True)
    tau, records_chance = _between_records(rows, design)
    found = _estimated(rows, design, tau)
    degrees = max(len(rows.value) - design.shape[1], 1)
    inflation = max(float(found.squares) / degrees, 1.0)
    inflated = found.covariance * inflation
    offsets = _offsets(rows, design, found)
    at_rest, sd_scale = float(found.values[0]) * unit, 1.0 if quantity == "hz" else unit
    none = AmplitudeTrend(
        at_rest, 0.0, float(np.sqrt(inflated[0, 0])) * sd_scale, 1.0, False, None, None, tau,
        records_chance, offsets, None,
    )  # fmt: skip
    if terms == 0:
        return none
    b = found.values[1:]
    statistic = max(float(b @ np.linalg.pinv(inflated[1:, 1:], hermitian=True) @ b), 0.0)
    # With one value per record its variation is estimated; otherwise each record has its own
    # errors.
    is_along = max(len(table.y) for table in tables) > 1
    chance = float(
        chdtrc(terms, statistic) if is_along else fdtrc(terms, degrees, statistic / terms)
    )
    if len(tables) == 1:
        chance = max(chance, tables[0].chance)
    step = np.array([1.0 - (low / top) ** (k + 1) for k in range(terms)])
    change, change_sd = float(step @ b), float(np.sqrt(max(step @ inflated[1:, 1:] @ step, 0.0)))
    squares = _squares_of_powers(rows, tau) / inflation
    turn = _turn(b, inflated[1:, 1:], low / top) if terms == 2 else None
    # A power fits as well with as many parameters: the value is monotonic, and no parabola.
    if np.any(squares < found.squares / inflation + INSIDE):
        turn = None
    zeta = float(np.mean([np.mean(table.zeta) for table in tables]))
    least = LEAST[quantity] * (abs(zeta) if quantity == "hz" else 1.0)
    is_seen = chance < AMPLITUDE and (abs(change) > least or turn is not None)
    if not is_seen:
        return none._replace(
            change=change * sd_scale, change_sd=change_sd * sd_scale, chance=chance
        )
    return AmplitudeTrend(
        at_rest=at_rest, change=change * sd_scale, change_sd=change_sd * sd_scale, chance=chance,
        is_seen=True, exponent=None if turn else _exponent(squares),
        turn=None if turn is None else (turn * top, (_at(found.values, turn)) * unit),
        scatter=tau, records_chance=records_chance, offsets=offsets,
        onset=_onset(b, inflated[1:, 1:], low / top, top),
    )  # fmt: skip


def _rows(tables: Sequence[RecordTable], quantity: str, unit: float, top: float) -> _RowsOfRecords:
    values, r, whitenings = [], [], []
    for table in map(few_rows, tables):
        values.append(getattr(table, quantity) / unit)
        r.append(table.y / top)
        variances, vectors = np.linalg.eigh(getattr(table, f"{quantity}_covariance") / unit**2)
        sd = np.sqrt(np.maximum(variances, LEAST_VARIANCE))
        whitenings.append(vectors.T / sd[:, None])
    return _RowsOfRecords(np.concatenate(r), np.concatenate(values), tuple(whitenings))


def _estimated(
    rows: _RowsOfRecords, design: Float[np.ndarray, "*axes row unknown"], tau: ArrayLike
) -> _Estimate:
    r"""Estimate coefficients by generalised least squares, given the sd tau between records.

    The columns X of design and values are divided into their mean m in each record and the rest,
    which the variation between records does not change:

    $$X^T (C + \tau^2 1 1^T)^{-1} X = (X - 1 m)^T C^{-1} (X - 1 m) + \frac{m^T m}{1/s + \tau^2},
      \qquad s = 1^T C^{-1} 1, \quad m = 1^T C^{-1} X / s$$

    Leading axes of `design` and `tau` are separate estimates.
    """
    variance = np.square(tau)[..., None, None]
    axes = np.broadcast_shapes(design.shape[:-2], variance.shape[:-2])
    value = np.broadcast_to(rows.value[:, None], (*design.shape[:-1], 1))
    parts, log_det = [], np.zeros(axes)
    for whitening, columns in zip(
        rows.whitenings, rows.split(np.concatenate([design, value], axis=-1)), strict=True
    ):
        ones = whitening.sum(axis=1, keepdims=True)
        s, white = np.sum(ones**2), whitening @ columns
        mean = ones.T @ white / s
        parts += [white - ones * mean, mean / np.sqrt(1 / s + variance)]
        log_det = log_det - 2 * np.linalg.slogdet(whitening)[1] + np.log1p(s * variance[..., 0, 0])
    stacked = np.concatenate([np.broadcast_to(x, (*axes, *x.shape[-2:])) for x in parts], axis=-2)
    columns, white = stacked[..., :-1], stacked[..., -1:]
    u, scales, v = np.linalg.svd(columns, full_matrices=False)
    inverse = np.where(scales > 1e-13 * scales[..., :1], 1 / np.maximum(scales, 1e-300), 0.0)
    values = v.mT @ (inverse[..., None] * (u.mT @ white))
    squares = np.sum((white - columns @ values) ** 2, axis=(-2, -1))
    covariance = v.mT @ (inverse[..., None] ** 2 * v)
    penalty = squares + log_det + 2 * np.sum(np.log(np.maximum(scales, 1e-300)), axis=-1)
    return _Estimate(values[..., 0], covariance, squares, penalty)


def _between_records(
    rows: _RowsOfRecords, design: Float[np.ndarray, "row unknown"]
) -> tuple[float, float]:
    """Return the standard deviation between records, and the p-value of such a variation."""
    if len(rows.whitenings) < 2 or len(rows.value) - design.shape[1] < 1:
        return 0.0, 1.0
    nothing, *penalties = _estimated(rows, design, np.append(0.0, SPREADS)).penalty
    at = int(np.argmin(penalties))
    gain = max(float(nothing - penalties[at]), 0.0)
    # Without variation, the variance is at its bound, and the statistic is half a chi-square
    # variable.
    chance = 0.5 * float(erfc(np.sqrt(gain / 2)))
    return (float(SPREADS[at]), chance) if gain > 0 else (0.0, 1.0)


def _offsets(
    rows: _RowsOfRecords, design: Float[np.ndarray, "row unknown"], found: _Estimate
) -> tuple[tuple[float, float], ...]:
    """Return the mean residual of every record with its standard deviation."""
    residuals = rows.split((rows.value - design @ found.values)[:, None])
    weights = [one.sum(axis=1) @ one for one in rows.whitenings]  # 1^T C^-1
    return tuple(
        (float(w @ residual[:, 0] / w.sum()), float(w.sum() ** -0.5))
        for w, residual in zip(weights, residuals, strict=True)
    )


def _at(values: Reals, r: float) -> float:
    return float(values[0] + values[1] * r + values[2] * r**2)


def _turn(b: Reals, covariance: Reals, low: float) -> float | None:
    """Return where a parabola turns, relative to the largest amplitude; None if not certain.

    The value at the turning point must differ from the values at both ends by `SURE` standard
    deviations.
    """
    if b[1] == 0.0 or not low < (at := float(-b[0] / (2 * b[1]))) < 1.0:
        return None
    for end in (low, 1.0):
        step = np.array([end - at, end**2 - at**2])
        if abs(step @ b) < SURE * np.sqrt(max(float(step @ covariance @ step), 0.0)):
            return None
    return at


def _onset(b: Reals, covariance: Reals, low: float, top: float) -> float | None:
    """Return the smallest amplitude at which the value clearly differs from the first value."""
    powers = np.arange(1, len(b) + 1)
    for r in np.geomspace(low, 1.0, 60)[1:]:
        step = r**powers - low**powers
        if abs(step @ b) > CERTAIN * np.sqrt(max(float(step @ covariance @ step), 0.0)):
            return float(r * top)
    return None


def _squares_of_powers(rows: _RowsOfRecords, tau: float) -> Reals:
    """Return the sum of squares left by each power of `EXPONENTS`; infinite for under four rows."""
    if len(rows.value) < 4:
        return np.full(len(EXPONENTS), np.inf)
    powers = rows.r ** EXPONENTS[:, None]
    designs = np.stack([np.ones_like(powers), powers], axis=-1)
    return _estimated(rows, designs, tau).squares


def _exponent(squares: Reals) -> tuple[float, float, float] | None:
    """Return the exponent of the amplitude with its 99 % interval, from the profile likelihood."""
    if not np.all(np.isfinite(squares)):
        return None
    best = int(np.argmin(squares))
    inside = EXPONENTS[squares < squares[best] + INSIDE]
    return float(EXPONENTS[best]), float(inside.min()), float(inside.max())


def laws_with(hz: AmplitudeTrend, zeta: AmplitudeTrend) -> tuple[str, ...]:
    """Return the names of laws whose frequency and damping follow the observed powers.

    Laws are compared to first order in the amplitude. The simplest law comes first, but a law that
    would have to saturate comes last. A law of sliders can have any power, depending on the
    distribution of their slips. Springs do not change the damping. An unseen change of damping
    excludes slip only if it would have been seen.
    """
    if hz.turn is not None:
        return ("bouc_wen", "cubic")
    if not hz.is_seen:
        return _with_power(DAMPERS, zeta.exponent) if zeta.is_seen else ()
    slipping: tuple[str, ...] = ()
    if hz.exponent is not None and hz.change < 0:
        low, high = hz.exponent[1:]
        first = _with_power(HYSTERESIS, hz.exponent)
        saturated = _with_power(HYSTERESIS, (hz.exponent[0], low - SATURATES, high + SATURATES))
        sliders = SLIDERS if low < 1 - EQUAL or high > 1 + EQUAL else ()
        slipping = (*first, *sliders, *(() if first else saturated))
    if zeta.is_seen and abs(zeta.change) >= SPRING * abs(hz.change):
        return slipping
    could_slip = zeta.change + CERTAIN * zeta.change_sd > SLIPS * abs(hz.change)
    return (*_with_power(SPRINGS, hz.exponent), *(slipping if could_slip else ()))


def nearby(seen: AmplitudeTrend) -> AmplitudeTrend:
    """Return a trend with a wider interval of its power, where the interval has no law's power."""
    if seen.exponent is None:
        return seen
    middle, low, high = seen.exponent
    return seen._replace(exponent=(middle, low - NEAR, high + NEAR))


def _with_power(
    laws: Mapping[str, float], interval: tuple[float, float, float] | None
) -> tuple[str, ...]:
    """Return the laws whose power of the amplitude is in an interval; none without an interval."""
    if interval is None:
        return ()
    low, high = interval[1] - EQUAL, interval[2] + EQUAL
    return tuple(name for name, power in laws.items() if low <= power <= high)
