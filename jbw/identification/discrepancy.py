r"""The error of a law beyond noise, for predictions: by amplitude, growing beyond fitted ones.

Standard deviations of natural frequency and damping ratio that runs left out of a fit show
(`model_discrepancy`) hold within the amplitudes that were fitted, and grow with the distance d from
these,

$$\sqrt{g(y)} = 1 + d(y) / h, \quad
  d = \max(\ln y / y_{max},\, \ln y_{min} / y,\, 0), \quad
  h = \tfrac12 \max(\ln y_{max} / y_{min}, \ln 2)$$

as an error that is linear in the logarithm of the amplitude grows. Below, a joint that moves less
and less sticks, and what a law misses of it tends to a limit: $\sqrt g$ is three at most. A run
that is left out there may miss as little as an error that is linear in the amplitude itself would,
$\sqrt{g_r} = 1 + 2 (y_{min} - y_r) / \max(y_{max} - y_{min}, y_{min})$, and counts by that.

Beyond the largest amplitude fitted the errors of the parameters are no longer those of a law that
holds: they answer for its misfit at the amplitudes that were fitted. So all that the runs left out
miss beyond noise, $\tau_0$, grows outward,

$$\tau^2(y) = \tau^2 + \max(\tau, \tau_0)^2 \bigl(g(y)\,(y / y_{max})^4 - 1\bigr), \quad
  y > y_{max}$$

with the square of the amplitude, as the equivalent stiffness of a cubic spring does: runs below
cannot tell which power holds beyond them. Farther above the fitted amplitudes than these are apart,
in the logarithm, the discrepancy is not stated.

Reference:
    Kennedy and O'Hagan (2001), J. R. Stat. Soc. B 63, 425: a discrepancy beside a calibrated model.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.identification.accuracy import another_law
from jbw.inference.posterior.finding import Finding
from jbw.observables.observable import OFFSETS
from jbw.report.messages import discrepancy as messages

LEAST_RANGE = float(np.log(2.0))  # of the logarithm of amplitude: the least that a slope is over
POWERS = (0, 1, 2)  # of the amplitude: a change of stiffness, friction, a cubic spring
MOST_GROWN = 3.0  # of a standard deviation by the logarithm of the amplitude: the whole range
COUNTS = 1e-3  # of the response at resonance: linearity of a good sensor, which hides less
ONE_LEVEL = 1.1  # of amplitudes: within, runs are repeats of one level


class Scatter(NamedTuple):
    """Standard deviation at the largest amplitude fitted, and the power of amplitude it runs by.

    `whole` is that of all that is missed, errors of the parameters included, which grows outward.
    """

    std: float
    power: int = 0
    whole: float = 0.0


NO_SCATTER = Scatter(0.0)


class Missed(NamedTuple):
    """The error of a law within the amplitudes that were fitted."""

    frequency: Scatter  # of the natural frequency, over itself [-]
    damping: Scatter  # of the damping ratio [-]


class AtAmplitude(NamedTuple):
    """Standard deviations of what a law misses at one amplitude."""

    frequency: float  # of the natural frequency, over itself [-]
    damping: float  # of the damping ratio [-]
    share: float  # factor of the share of the response that is missed otherwise
    beyond: float = 0.0  # factor of what grows outward, of all that is missed of that


NOTHING = AtAmplitude(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Discrepancy:
    """The error of a law beyond noise on tests that were not fitted."""

    forced: Missed
    decays: Missed  # the natural frequency over that of the beginning of a record
    share: Mapping[str, Scatter]  # the rest over the rms of the response, by kind of test
    y_low: float  # smallest and largest amplitude of a run that was fitted [m]; 0 where not known
    y_high: float
    in_noise: bool = False  # whether what counts as noise of the fitted tests hides some of it

    @property
    def is_nothing(self) -> bool:
        """Whether the law leaves nothing beyond noise."""
        scatters = (*self.forced, *self.decays, *self.share.values())
        return not any(scatter.std or scatter.whole for scatter in scatters)

    def at(self, y: float | None, *, of_decay: bool = False) -> AtAmplitude:
        """Return standard deviations at an amplitude [m], for None at the largest fitted one."""
        grown, beyond = growth(y, self.y_low, self.y_high), outward(y, self.y_low, self.y_high)
        ratio = y / self.y_high if y is not None and self.y_high > 0 else 1.0
        within = 1.0 if beyond else grown

        def std_of(scatter: Scatter) -> float:
            inside = within * scatter.std * min(ratio, 1.0) ** scatter.power
            return float(np.hypot(inside, beyond * scatter.whole))

        frequency, damping = map(std_of, self.decays if of_decay else self.forced)
        return AtAmplitude(frequency, damping, within, beyond)

    def is_stated(self, y: float) -> bool:
        """Return whether the discrepancy can be stated at an amplitude [m].

        No farther above the amplitudes that were fitted, in the logarithm, than these are apart, or
        one octave: runs left out show nothing of what lies beyond. Where they show nothing since
        what the law misses counts as noise, nothing grows, and no larger amplitude is stated.
        """
        if self.is_nothing:
            return not (self.in_noise and y > ONE_LEVEL * self.y_high > 0)
        return growth(y, self.y_low, self.y_high) <= MOST_GROWN

    def share_of(self, kind: str, missed: AtAmplitude) -> float:
        """Share of the response that a test of a kind leaves: its kind's, else the largest."""
        shares = {name: _at(scatter, missed) for name, scatter in self.share.items()}
        return shares.get(kind, max(shares.values(), default=0.0))


def _at(share: Scatter, missed: AtAmplitude) -> float:
    return float(np.hypot(missed.share * share.std, missed.beyond * share.whole))


def growth(y: float | None, y_low: float, y_high: float) -> float:
    r"""Return the factor $\sqrt g$ of a standard deviation at an amplitude y [m].

    It grows by the logarithm of the amplitude; below, where a joint sticks, to three at most.
    """
    if y is None or not (0 < y_low <= y_high and y > 0):
        return 1.0
    wide = max(np.log(y_high / y_low), LEAST_RANGE)
    above, below = 1 + 2 * np.log([y / y_high, y_low / y]) / wide
    return float(max(above, min(below, MOST_GROWN), 1.0))


def growth_shown(y: float | None, y_low: float, y_high: float) -> float:
    r"""Return the factor $\sqrt{g_r}$ by which a run counts that is left out of others.

    Below these it grows by the amplitude: what a run misses there is no more than that explained.
    """
    if y is None or not 0 < y < y_low <= y_high:
        return growth(y, y_low, y_high)
    return 1 + 2 * (y_low - y) / max(y_high - y_low, y_low)


def outward(y: float | None, y_low: float, y_high: float) -> float:
    r"""Return the factor $\sqrt{g (y / y_{max})^4 - 1}$ of discrepancy; 0 up to $y_{max}$."""
    if y is None or not 0 < y_low <= y_high < y:
        return 0.0
    grown = growth(y, y_low, y_high) * (y / y_high) ** max(POWERS)
    return float(np.sqrt(grown**2 - 1))


def discrepancy_in(found: xr.Dataset) -> Discrepancy:
    """Return the discrepancy as predictions take it; of old runs without what grows outward."""
    names, rests = map(str, found["kind"].values), found["rest"].values.tolist()
    rests_beyond = (
        found["rest_beyond"].values.tolist() if "rest_beyond" in found else [0.0] * len(rests)
    )
    pairs = zip(names, rests, rests_beyond, strict=True)
    shares = {kind: Scatter(rest, 0, beyond) for kind, rest, beyond in pairs}
    forced, decays = (_missed_in(found.attrs[name]) for name in ("forced", "decays"))
    y_low, y_high = float(found.attrs["y_low"]), float(found.attrs["y_high"])
    in_noise = bool(found.attrs.get("hidden_in_noise", 0))
    return Discrepancy(forced, decays, shares, y_low, y_high, in_noise)


def _missed_in(numbers: Float[np.ndarray, " number"]) -> Missed:
    rows = np.reshape(numbers, (len(OFFSETS), -1)).tolist()
    return Missed(*(Scatter(std, int(power), *total) for std, power, *total in rows))


def discrepancy_finding(found: xr.Dataset, laws: Sequence[str]) -> Finding | None:
    """Return the finding on the law's error for held-out runs; None if no run can be held out.

    A change of frequency by omega_n times e, or of damping by e, moves the response at resonance by
    e / zeta of itself.
    """
    if not found.sizes["run"]:
        return None
    discrepancy = discrepancy_in(found)
    if discrepancy.is_nothing:
        entry = "" if found.attrs.get("noise_by_repeats", 1) else "discrepancy.no_repeats"
        return Finding("discrepancy", "ok", {}, 0.0, entry=entry)
    shift, noise_std = found["shift"].values, found["noise_std"].values
    over_noise = np.where(np.isfinite(noise_std), np.abs(shift) / noise_std, 0.0)
    run = int(np.argmax(over_noise.max(axis=1)))
    forced = discrepancy.forced if any(x.whole for x in discrepancy.forced) else discrepancy.decays
    rest = max((share.whole for share in discrepancy.share.values()), default=0.0)
    of_modes = max(forced.frequency.whole, forced.damping.whole) / found.attrs["zeta"]
    if (error := max(of_modes, rest)) < COUNTS:
        values = {"error": error, "limit": COUNTS}
        return Finding("discrepancy", "ok", values, error, entry="discrepancy.small")
    values = {
        "frequency": forced.frequency.whole,
        "damping": forced.damping.whole,
        "rest": rest,
        "run": str(found["run"].values[run]),
        "run_frequency": float(shift[run, 0] / found.attrs["omega_n"]),
        "run_damping": float(shift[run, 1]),
    }
    remedy = {"another_law": another_law(laws)}
    largest = max(forced.frequency.whole, forced.damping.whole, rest)
    return Finding("discrepancy", "usable", values, largest, remedy)


def unscored_levels(found: xr.Dataset) -> str:
    """Return why predictions of other levels are not scored: a key in `UNSCORED`, or empty."""
    if not found.sizes["run"]:
        return "two runs" if found.attrs["num_runs"] > 1 else "one run"
    y_low, y_high = float(found.attrs["y_low"]), float(found.attrs["y_high"])
    return "one level" if 0 < y_low <= y_high <= ONE_LEVEL * y_low else ""


def discrepancy_sentences(found: xr.Dataset) -> list[str]:
    """Return the sentences on bands of unfitted tests beyond noise, and on unscored levels."""
    reason = unscored_levels(found)
    unscored = [messages.UNSCORED[reason].sentence] if reason else []
    return unscored if discrepancy_in(found).is_nothing else [messages.IN_BANDS, *unscored]
