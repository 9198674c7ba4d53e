r"""The error of a law beyond noise, as standard deviations at any amplitude.

Runs held out of a fit show errors of natural frequency and damping ratio (`model_discrepancy`).
Their standard deviations apply within the fitted amplitudes, and grow with the distance d from
these,

$$\sqrt{g(y)} = 1 + d(y) / h, \quad
  d = \max(\ln y / y_{max},\, \ln y_{min} / y,\, 0), \quad
  h = \tfrac12 \max(\ln y_{max} / y_{min}, \ln 2)$$

as an error grows that is linear in the logarithm of the amplitude. At small amplitudes a joint
becomes fully stuck and the error of a law tends to a limit, so $\sqrt g$ is at most three. The
error of a held-out run at small amplitude may be as small as an error that is linear in the
amplitude itself, $\sqrt{g_r} = 1 + 2 (y_{min} - y_r) / \max(y_{max} - y_{min}, y_{min})$, and is
scaled by that.

Beyond the largest fitted amplitude, posterior errors of the parameters no longer describe the
error: the parameters have adapted to a law that is wrong at the fitted amplitudes. So the whole
error of held-out runs beyond noise, $\tau_0$, grows outward,

$$\tau^2(y) = \tau^2 + \max(\tau, \tau_0)^2 \bigl(g(y)\,(y / y_{max})^4 - 1\bigr), \quad
  y > y_{max}$$

with the square of the amplitude, as the equivalent stiffness of a cubic spring does: runs at
smaller amplitudes cannot determine which power applies beyond them. The discrepancy is not stated
farther above the fitted amplitudes, in the logarithm, than their own range.

Reference:
    Kennedy and O'Hagan (2001), J. R. Stat. Soc. B 63, 425: calibrated models with a discrepancy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy import stats

from jbw.identification.accuracy import another_law
from jbw.inference.posterior.finding import Finding
from jbw.observables.observable import OFFSETS
from jbw.report.messages import discrepancy as messages
from jbw.results.attributes import StoredDiscrepancy

# smallest range of log amplitude from which the slope of an error is estimated
LEAST_RANGE = float(np.log(2.0))
# exponents of amplitude that are tried: those of a stiffness change, of friction, of a cubic spring
POWERS = (0, 1, 2)
# largest factor by which a standard deviation grows below the fitted amplitudes
MOST_GROWN = 3.0
COUNTS = 1e-3  # smallest relative error that matters; a good sensor's nonlinearity is as large
# smallest amplitude of a fitted record's motion that is above noise, relative to the largest
LOWEST = 0.1
# smallest number of degrees of freedom from which a variance between runs is estimated
FEWEST_DEGREES = 3
UPPER = 0.995  # probability of the upper end of a 99 % band
ONE_LEVEL = 1.1  # Runs whose amplitudes have a smaller ratio than this are repeats of one level.


class Scatter(NamedTuple):
    """The standard deviation of an error at the largest fitted amplitude, and how it grows.

    `whole` is the standard deviation of the whole error, including that of the parameters; it grows
    outward.
    """

    std: float
    power: int = 0
    whole: float = 0.0


NO_SCATTER = Scatter(0.0)


class Missed(NamedTuple):
    """The error of a law in frequency and in damping, within the fitted amplitudes."""

    frequency: Scatter  # error of the law in natural frequency: relative standard deviation [-]
    damping: Scatter  # error of the law in damping ratio: standard deviation [-]


class AtAmplitude(NamedTuple):
    """The standard deviations of a law's errors at one amplitude."""

    frequency: float  # error of the law in natural frequency: relative standard deviation [-]
    damping: float  # error of the law in damping ratio: standard deviation [-]
    share: float  # factor on the response error that frequency and damping shifts do not explain
    # factor on the whole error of the response, which is added beyond the fitted amplitudes
    beyond: float = 0.0


NOTHING = AtAmplitude(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Discrepancy:
    """The error of a law beyond noise, on tests that were not fitted."""

    forced: Missed
    decays: Missed  # errors in predictions of a decay from its start
    # error of the response that shifts of frequency and damping do not explain, relative to its
    # rms, by kind of test
    share: Mapping[str, Scatter]
    y_low: float  # smallest and largest fitted amplitude [m]; 0 if unknown
    y_high: float
    in_noise: bool = False  # whether the noise of the tests may hide a part of the error

    @property
    def is_nothing(self) -> bool:
        """Whether the law has no error that exceeds the noise."""
        scatters = (*self.forced, *self.decays, *self.share.values())
        return not any(scatter.std or scatter.whole for scatter in scatters)

    def at(self, y: float | None, *, of_decay: bool = False) -> AtAmplitude:
        """Return the sd of the law's errors at an amplitude [m]; the largest sd if it is None."""
        grown, beyond = growth(y, self.y_low, self.y_high), outward(y, self.y_low, self.y_high)
        ratio = y / self.y_high if y is not None and self.y_high > 0 else 1.0
        within = 1.0 if beyond else grown

        def std_of(scatter: Scatter) -> float:
            inside = within * scatter.std * min(ratio, 1.0) ** scatter.power
            return float(np.hypot(inside, beyond * scatter.whole))

        frequency, damping = map(std_of, self.decays if of_decay else self.forced)
        return AtAmplitude(frequency, damping, within, beyond)

    def is_stated(self, y: float) -> bool:
        """Return whether the error of the law can be stated at an amplitude [m].

        It can be stated up to a distance above the fitted amplitudes, in the logarithm, that equals
        their own range or one octave: held-out runs do not show what lies beyond. If there is no
        discrepancy because the law's error counts as noise, nothing grows, and no larger amplitude
        is stated.
        """
        if self.is_nothing:
            return not (self.in_noise and y > ONE_LEVEL * self.y_high > 0)
        return growth(y, self.y_low, self.y_high) <= MOST_GROWN

    def share_of(self, kind: str, missed: AtAmplitude) -> float:
        """Return the law's relative error for a kind of test; the largest error if unknown."""
        shares = {
            name: float(np.hypot(missed.share * scatter.std, missed.beyond * scatter.whole))
            for name, scatter in self.share.items()
        }
        return shares.get(kind, max(shares.values(), default=0.0))


def growth(y: float | None, y_low: float, y_high: float) -> float:
    r"""Return the factor $\sqrt g$ on the law's standard deviations at an amplitude y [m].

    It grows with the logarithm of the amplitude; below the fitted range, where a joint is stuck, to
    three at most.
    """
    if y is None or not (0 < y_low <= y_high and y > 0):
        return 1.0
    wide = max(np.log(y_high / y_low), LEAST_RANGE)
    above, below = 1 + 2 * np.log([y / y_high, y_low / y]) / wide
    return float(max(above, min(below, MOST_GROWN), 1.0))


def growth_shown(y: float | None, y_low: float, y_high: float) -> float:
    r"""Return the growth $\sqrt{g_r}$ of the law's error from the fitted range to a held-out run.

    Below the fitted amplitudes it is linear in the amplitude, because the error of a run there may
    be no larger than an error that is linear in the amplitude.
    """
    if y is None or not 0 < y < y_low <= y_high:
        return growth(y, y_low, y_high)
    return 1 + 2 * (y_low - y) / max(y_high - y_low, y_low)


def outward(y: float | None, y_low: float, y_high: float) -> float:
    r"""Return the factor $\sqrt{g (y / y_{max})^4 - 1}$ on the law's error, 0 up to $y_{max}$."""
    if y is None or not 0 < y_low <= y_high < y:
        return 0.0
    grown = growth(y, y_low, y_high) * (y / y_high) ** max(POWERS)
    return float(np.sqrt(grown**2 - 1))


def discrepancy_of_misfit(error: float, zeta: float, y_peak: float) -> Discrepancy:
    r"""Return the error of a law in frequency and damping from its misfit to the fitted tests.

    $$\frac{\tau_\omega}{\omega_n} = \tau_\zeta = \rho\,\zeta\,\frac{t_{3, 0.995}}{z_{0.995}}$$

    because a change of frequency by $\omega_n e$, or of damping by e, changes the response at
    resonance by $e / \zeta$. One fit determines these errors as poorly as three numbers do.

    Args:
        error: Error of the law relative to the response, rho.
        zeta: Equivalent damping ratio within the fitted amplitudes.
        y_peak: Largest fitted displacement [m].
    """
    std = error * zeta * float(np.sqrt(widened(FEWEST_DEGREES)))
    missed = Missed(Scatter(std, 0, std), Scatter(std, 0, std))
    return Discrepancy(missed, missed, {}, LOWEST * y_peak, y_peak)


def widened(num_runs: int) -> float:
    r"""Return the factor that widens a variance from n runs, $(t_{n, 0.995} / z_{0.995})^2$.

    At least three degrees of freedom are used. With the factor, the 99 % band of a normal
    distribution is that of Student's t.
    """
    degrees = max(num_runs, FEWEST_DEGREES)
    return float((stats.t.ppf(UPPER, degrees) / stats.norm.ppf(UPPER)) ** 2)


def as_dataset(discrepancy: Discrepancy) -> xr.Dataset:
    """Return a discrepancy as a run stores it; `discrepancy_in` reads it."""
    shares, of_rest = discrepancy.share.values(), {"units": "1", "long_name": "sd over rms"}
    return xr.Dataset(
        {
            "rest": ("kind", [share.std for share in shares], of_rest),
            "rest_beyond": ("kind", [share.whole for share in shares], of_rest),
        },
        {"kind": np.array(list(discrepancy.share), str)},
        {
            "forced": np.ravel(discrepancy.forced), "decays": np.ravel(discrepancy.decays),
            "y_low": discrepancy.y_low, "y_high": discrepancy.y_high,
        },
    )  # fmt: skip


def discrepancy_in(found: xr.Dataset) -> Discrepancy:
    """Return the model discrepancy that a run has stored."""
    rests = found["rest"]
    beyond = found.get("rest_beyond", xr.zeros_like(rests))
    pairs = zip(rests.kind.values, rests.values.tolist(), beyond.values.tolist(), strict=True)
    shares = {str(kind): Scatter(rest, 0, farther) for kind, rest, farther in pairs}
    forced, decays = (_missed_in(found.attrs[name]) for name in ("forced", "decays"))
    in_noise = StoredDiscrepancy.of(found).hidden_in_noise
    return Discrepancy(forced, decays, shares, *_range(found), in_noise)


def _range(found: xr.Dataset) -> tuple[float, float]:
    """Return the smallest and largest fitted displacement [m]."""
    facts = StoredDiscrepancy.of(found)
    return facts.y_low, facts.y_high


def _missed_in(numbers: Float[np.ndarray, " number"]) -> Missed:
    rows = np.reshape(numbers, (len(OFFSETS), -1)).tolist()
    return Missed(*(Scatter(std, int(power), *total) for std, power, *total in rows))


def discrepancy_finding(found: xr.Dataset, laws: Sequence[str]) -> Finding | None:
    """Return the finding on the law's error for held-out runs; None if no run can be held out.

    A change of frequency by omega_n times e, or of damping by e, changes the response at resonance
    by the relative amount e / zeta.
    """
    if not found.sizes["run"]:
        return None
    discrepancy, facts = discrepancy_in(found), StoredDiscrepancy.of(found)
    if discrepancy.is_nothing:
        entry = "" if facts.noise_by_repeats else "discrepancy.no_repeats"
        return Finding("discrepancy", "ok", {}, 0.0, entry=entry)
    shift, noise_std = found["shift"].values, found["noise_std"].values
    over_noise = np.where(np.isfinite(noise_std), np.abs(shift) / noise_std, 0.0)
    run = int(np.argmax(over_noise.max(axis=1)))
    forced = discrepancy.forced if any(x.whole for x in discrepancy.forced) else discrepancy.decays
    rest = max((share.whole for share in discrepancy.share.values()), default=0.0)
    of_modes = max(forced.frequency.whole, forced.damping.whole) / facts.zeta
    if (error := max(of_modes, rest)) < COUNTS:
        values = {"error": error, "limit": COUNTS}
        return Finding("discrepancy", "ok", values, error, entry="discrepancy.small")
    values = {
        "frequency": forced.frequency.whole,
        "damping": forced.damping.whole,
        "rest": rest,
        "run": str(found["run"].values[run]),
        "run_frequency": float(shift[run, 0] / facts.omega_n),
        "run_damping": float(shift[run, 1]),
    }
    remedy = {"another_law": another_law(laws)}
    largest = max(forced.frequency.whole, forced.damping.whole, rest)
    return Finding("discrepancy", "usable", values, largest, remedy)


def unscored_levels(found: xr.Dataset) -> str:
    """Return the reason (as a key) why predictions of other levels are not scored, or ""."""
    if not found.sizes["run"]:
        return "two runs" if StoredDiscrepancy.of(found).num_runs > 1 else "one run"
    y_low, y_high = _range(found)
    return "one level" if 0 < y_low <= y_high <= ONE_LEVEL * y_low else ""


def discrepancy_sentences(found: xr.Dataset) -> list[str]:
    """Return the sentences on the discrepancy in prediction bands and on unscored levels."""
    reason = unscored_levels(found)
    unscored = [messages.UNSCORED[reason].sentence] if reason else []
    return unscored if discrepancy_in(found).is_nothing else [messages.IN_BANDS, *unscored]
