"""Modes that the joint couples, as a campaign states them: checks, signs and statements."""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from jbw.campaign.settings import Identify, Structured, structure_errors
from jbw.errors import ConfigError, DataError
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.summary import QUANTILES
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.measurement.records import BASE, Test, drive_of
from jbw.observables.dataset import Dataset, stacked
from jbw.observables.drives import told_by
from jbw.observables.modes import Modes, ModesAtJoint
from jbw.observables.observable import Observable
from jbw.observables.residual_terms import has_own
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.modes.parameters import own_name
from jbw.report.messages import modes as messages

# A mode moves the joint if chance alone improves the fit as much with a probability below this.
BY_CHANCE = 0.01
BARE = ("", "none", "force", BASE)  # drives with which the shaker's dynamics do not matter
# relative tolerance of the sum of squares and of the step, in fits that only show whether the sign
# of a mode is wrong or a mode moves the joint
ROUGH = 1e-6


def modes_of(
    structure: Structured | None, tests: Collection[Test], settings: Identify
) -> Modes | None:
    """Return the modes of a campaign's structure; None if only one mode moves the joint.

    Raises:
        ConfigError: Tests or priors are not supported for several modes.
    """
    if errors := [*structure_errors(structure, tests)]:
        raise ConfigError(errors[0])
    if structure is None or len(structure.modes) < 2:
        return None
    stated = structure.driving_point, structure.joint_shape, structure.points
    modes = Modes(structure.modes, *stated, meet="apart" if structure.modal else "common")
    _require_own_constants(modes, tests)
    # If the force is measured, the shaker's dynamics do not matter; the same holds without a drive.
    drives = sorted({"force" if drive_of(t) in BARE else drive_of(t) for t in tests})
    if len(drives) > 1:
        raise ConfigError(
            "[structure] needs tests of one drive, but the tests are driven by "
            f"{' and '.join(drives)}.",
            why="A shaker that moves with the structure changes every mode.",
            remedy="Write a separate campaign file for the tests of each drive.",
        )
    highest = max(modes.hz)
    for test in tests:
        fs = test.records[0].fs
        if highest >= 0.5 * fs:
            raise ConfigError(
                f"[structure] modes: {highest:g} Hz must lie below half the sampling frequency of "
                f"every test, but test `{test.name}` is sampled at {fs:g} Hz.",
                remedy="Leave the mode out, or sample faster.",
            )
    _require_unknown(modes, settings.prior)
    _require_apart(modes, settings.prior)
    return modes


def _require_own_constants(modes: Modes, tests: Collection[Test]) -> None:
    """Raise a ConfigError if responses at several points are to share residual terms."""
    shared = [test for test in tests if test.residuals in ("upper", "both")]
    if modes.points and shared:
        raise ConfigError(
            f"[[test]] {shared[0].name}: `residuals` must be own, none or auto where [structure] "
            f"has several points, but is {shared[0].residuals}.",
            why="The contribution of other modes to a response differs from point to point.",
            remedy='State residuals = "own", or leave `residuals` out.',
        )


def with_own_constants(modes: Modes | None, tests: Collection[Test]) -> tuple[Test, ...]:
    """Return tests with separate residual constants for each test, if the campaign wants them."""
    return tuple(
        replace(test, residuals="own")
        if has_own(test.residuals, several_modes=modes is not None)
        else test
        for test in tests
    )


def _require_unknown(modes: Modes, prior: Mapping[str, tuple[float, float]]) -> None:
    """Raise a ConfigError if a prior is stated for a quantity that [structure] fixes."""
    settled_by = {names.shape: "joint_shape" for names in modes.names if modes.joint_shape}
    settled_by |= {names.coupling: "driving_point" for names in modes.names if modes.driving_point}
    joint_names = {name for names in modes.names for name in (names.shape, names.coupling)}
    for name in prior:
        suffix = re.search(r"_mode_\d$", name)
        if (suffix and modes.meet != "apart") or (name in joint_names and modes.meet == "apart"):
            raise ConfigError(
                f"[identify.prior] `{name}` applies only to modes that "
                f"{'have separate laws' if suffix else 'share one joint'}, but the modes of this "
                "campaign do not.",
                remedy=f"Leave the prior of `{name}` out, or change `modal` in [structure].",
            )
        if name in settled_by:
            raise ConfigError(
                f"[identify.prior] `{name}` must be an unknown parameter, but "
                f"`{settled_by[name]}` in [structure] sets its value.",
                remedy=f"Leave out the prior of `{name}`, or leave out `{settled_by[name]}` in "
                "[structure].",
            )


def _require_apart(modes: Modes, prior: Mapping[str, tuple[float, float]]) -> None:
    """Raise a ConfigError if the prior bounds of two modes' frequencies overlap."""
    names = ("omega_n", *(mode_names.omega for mode_names in modes.names))
    wide = {
        n: (2 * np.pi * low, 2 * np.pi * high)
        for n, (low, high) in zip(names, modes.windows_hz, strict=True)
    }
    bounds = sorted((prior.get(name, wide[name]), name) for name in names)
    for ((_, high), name), ((low, _), other) in pairwise(bounds):
        if high > low:
            raise ConfigError(
                f"[identify.prior] `{name}` must end below `{other}`, which begins at {low:.5g} "
                f"rad/s, but ends at {high:.5g}.",
                why="The modes would change places.",
                remedy=f"Narrow or remove the bounds of `{name}` or `{other}` in [identify.prior].",
            )


def require_driven(modes: Modes, parts: Sequence[Observable]) -> None:
    """Raise a DataError if no test gives starting values of a mode."""
    first_values = told_by(parts)
    for hz, names in zip(modes.hz, (None, *modes.names), strict=True):
        if (names.omega if names else "omega_n") not in first_values:
            raise DataError(
                f"[structure] modes: a test must drive the mode at {hz:g} Hz within 7 %, but no "
                "fitted test does.",
                remedy=f"Sweep through {hz:g} Hz, or leave {hz:g} Hz out of `modes`.",
            )
        for point, seen in modes.seen.items() if modes.meet != "assembled" else ():
            if seen[0 if names is None else modes.names.index(names) + 1] not in first_values:
                raise DataError(
                    f"[structure] points: a fitted test must drive the mode at {hz:g} Hz within "
                    f"7 % of this frequency and be measured at `{point}`, but no test does both.",
                    remedy=f"Measure the mode at `{point}`, or leave `{point}` out of `points`.",
                )
        ratio = first_values.get(names.ratio) if names else 1.0
        if modes.driving_point and ratio is None:
            raise DataError(
                "[structure] driving_point needs driven tests, but only free decays are fitted.",
                why="With `driving_point`, the gain of a mode determines the effect of the joint "
                "on the mode.",
                remedy="Leave `driving_point` out, or add a sweep or a multisine.",
            )
        if modes.driving_point and ratio is not None and ratio < 0:
            raise DataError(
                f"[structure] driving_point: the mode at {hz:g} Hz must have a gain of the first "
                f"mode's sign, but this gain is {ratio:.2g} times that of the "
                "first mode.",
                why="At the drive point the gain of every mode is the square of its shape.",
                remedy="Leave `driving_point` out, or reverse the sign of the response channel.",
            )


def unknown_signs(prior: Box, data: Dataset) -> list[str]:
    """Return the names of the signs of those modes whose shapes are free parameters."""
    return [] if data.modes is None else [
        names.sign for names in data.modes.names if names.shape in prior.names
    ]  # fmt: skip


def with_signs(best: Fit, prior: Box, data: Dataset) -> tuple[Fit, Dataset]:
    """Try the opposite sign of each mode in turn; return the best fit with its dataset."""
    growth = []
    for sign in unknown_signs(prior, data):
        other = replace(data, held={**data.held, sign: -data.held[sign]})
        flipped = costly_fit(stacked, prior, other, starts=best.theta, tolerance=ROUGH)
        growth.append(2 * abs(flipped.cost - best.cost))
        if flipped.cost < best.cost:
            best, data = flipped, other
    if growth:
        parts = (replace(p, growth=jnp.asarray(growth)) if isinstance(p, ModesAtJoint) else p
                for p in data.parts)  # fmt: skip
        data = replace(data, parts=tuple(parts))
    return best, data


def one_joint_sentences(best: Fit, prior: Box, data: Dataset) -> list[str]:
    r"""Return the sentence on whether modes after the first move the joint or are linear.

    $$\chi^2_{linear} - \chi^2 > F^{-1}_{\chi^2_k}(0.99)$$

    with k sizes of modes at the joint; empty if these are not fitted.
    """
    if data.modes is None or not unknown_signs(prior, data):
        return []
    bounds = bounds_by_name(prior)
    linear = {n: pair for n, pair in bounds.items() if n not in data.modes.free}
    start = {name: best.theta[name] for name in linear}
    linear_fit = costly_fit(stacked, box(linear), data, starts=start, tolerance=ROUGH)
    growth, num = 2 * (linear_fit.cost - best.cost), len(bounds) - len(linear)
    least = float(stats.chi2.isf(BY_CHANCE, num))
    evidence = messages.growth_by_neighbours(growth)
    if growth > least:
        return [messages.one_joint(evidence, least)]
    return [messages.no_shared_joint(evidence)]


def same_joint_sentences(posterior: xr.Dataset, data: Dataset) -> list[str]:
    r"""Return sentences on whether modes with separate laws could share one joint.

    In one joint, a law is the same in every mode except for its units of length and force, so
    dimensionless parameters and ratios of parameters with one unit, such as $\delta/\gamma$, agree.
    One joint is rejected if the 99 % interval of the difference of their logarithms between two
    modes excludes zero.
    """
    if data.modes is None or data.modes.meet != "apart":
        return []
    sentences = []
    for name, pair in _invariants(data.laws).items():
        first = _log_of(posterior, pair, lambda parameter: parameter)
        for mode, hz in enumerate(data.modes.hz[1:], 2):
            other = _log_of(posterior, pair, lambda parameter, mode=mode: own_name(parameter, mode))
            if first is None or other is None:
                continue
            low, _, high = np.quantile(other - first, QUANTILES)
            mean = np.exp([np.median(first), np.median(other)])
            ratio = float(np.exp(low)), float(np.exp(high))
            conclusion = messages.NOT_COMMON if low > 0 or high < 0 else messages.MAY_BE_COMMON
            sentences.append(messages.compared(name, mean[0], mean[1], hz, ratio, conclusion))
    return sentences


def _invariants(laws: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return parameters and ratios of parameters that are free of units of length and force."""
    invariants: dict[str, tuple[str, ...]] = {}
    by_unit: dict[str, str] = {}
    for quantity in quantities_of(laws):
        if quantity.unit == "1":
            invariants[quantity.name] = (quantity.name,)
        elif (other := by_unit.setdefault(quantity.unit, quantity.name)) != quantity.name:
            invariants[f"{other}/{quantity.name}"] = (other, quantity.name)
    return invariants


def _log_of(
    posterior: xr.Dataset, pair: Sequence[str], name_of: Callable[[str], str]
) -> NDArray[np.float64] | None:
    """Return logarithms of the draws of a parameter or a ratio; None unless all are positive."""
    draws = [posterior[name_of(name)].values.ravel() for name in pair if name_of(name) in posterior]
    ratio = draws[0] if len(draws) == 1 else draws[0] / draws[1] if draws else np.zeros(1)
    return np.log(ratio) if len(draws) == len(pair) and np.all(ratio > 0) else None


def participation_sentences(posterior: xr.Dataset, modes: Modes | None) -> list[str]:
    """Return sentences on modes whose gain may be zero according to the posterior."""
    sentences = []
    for hz, names in zip(modes.hz[1:] if modes else (), modes.names if modes else (), strict=True):
        # Free decays do not determine this mode's gain relative to the first mode.
        if names.ratio not in posterior:
            continue
        low, _, high = np.quantile(posterior[names.ratio].values, QUANTILES)
        if low <= 0.0 <= high:
            sentences.append(messages.still_mode(hz, names.ratio, low, high))
    return sentences
