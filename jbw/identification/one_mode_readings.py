r"""Starting values for several joints, from fits of single modes.

Weak motion of mode i alone, as an oscillator with one Bouc-Wen law, determines two numbers

$$s_i = \alpha\delta\,|c_i| = \sum_j B_{ij}S_j, \qquad o_i = \alpha\gamma\,|c_i| = \sum_jB_{ij}O_j$$

for a mode of unit modal mass, with alpha, delta and gamma by the displacement of the first point.
The least squares are non-negative. Their chi-square tests whether these joints explain these modes,
if more modes were fitted than there are laws, and all of them in weak motion. B is that of the
model; with uncertain shapes it gives only the start, and nothing is tested.
"""

import logging
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from jbw.campaign.joints import Starts, starts_of
from jbw.errors import JbwError
from jbw.identification.assemble import Measured, assemble, measured
from jbw.identification.assembled import passes
from jbw.identification.prepare import Fitted, prepare
from jbw.inference.fit.fitting import to_first_order
from jbw.inference.generator import parts_of
from jbw.measurement.records import Test, drive_of
from jbw.observables.modes import HARDLY_SEEN, Modes, gain_shares
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.modes.assembled import PUSH, STIFFNESS, numbered, seen_name
from jbw.quantities import FED, name_at, split
from jbw.report.messages import joint as messages

LAW = BoucWenLaw.name
HALF = 0.5  # starting value of a law's stiffness, relative to that of the fully stuck joint
# Above this slip of a fitted law, fits of single modes do not determine sums over the joints, and
# the joints are not tested.
WEAK = 0.3

under_way = logging.getLogger("jbw.progress")


class Readings(NamedTuple):
    """Starting values of all laws, and sentences on whether the model's joints explain modes."""

    known: dict[str, float]
    statements: tuple[str, ...]


NOTHING = Readings({}, ())


def joint_readings(key: Key[Array, ""], seen: Measured) -> Readings:
    """Return starting values of all joints, from the weakest sweep that drives each mode alone.

    Empty for a single joint, for laws other than Bouc-Wen's, or if sweeps pass through fewer single
    modes than there are laws.
    """
    modes, joints = seen.modes, seen.joints
    if modes is None or joints is None or any(split(law)[0] != LAW for law in seen.laws):
        return NOTHING
    weakest = _weakest(modes, seen.swept)
    if len(weakest) < len(seen.laws):
        return NOTHING
    read: dict[int, tuple[np.ndarray, np.ndarray, float]] = {}
    for i, test in weakest.items():
        under_way.info("mode %d alone", i + 1)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                read[i] = _reading(jax.random.fold_in(key, i), i, test, seen, modes)
        except JbwError:  # Omit modes that cannot be fitted alone.
            continue
    if len(read) < len(seen.laws):
        return NOTHING
    hz = [modes.hz[i] for i in read]
    values, stds, slips = map(np.array, zip(*read.values(), strict=True))
    starts = [starts_of(joints, hz, values[:, k], stds[:, k]) for k in range(2)]
    is_weak = max(slips) <= WEAK
    is_tested = is_weak and not modes.uncertain
    statements = _statements(starts, len(read)) if is_tested else ()
    return Readings(_known(starts, seen.laws, modes), statements)


def with_readings(ready: Fitted, readings: Readings) -> Fitted:
    """Return a fit with additional sentences on the single-mode fits."""
    return replace(ready, statements=(*readings.statements, *ready.statements))


def _weakest(modes: Modes, tests: Sequence[Test]) -> dict[int, Test]:
    """Return, for each mode, the weakest sweep at the first point that drives only this mode."""
    shares, weakest = np.abs(gain_shares(modes)), {}
    for test in sorted(tests, key=lambda test: float(np.mean(_source(test) ** 2))):
        passed = [i for i, window in enumerate(modes.windows_hz) if passes(test, window)]
        is_seen = len(passed) == 1 and shares[passed[0]] > HARDLY_SEEN * shares.max()
        if is_seen and not test.point:
            weakest.setdefault(passed[0], test)
    return dict(sorted(weakest.items()))


def _source(test: Test) -> np.ndarray:
    record = test.records[0]
    return np.asarray(record.channels[record.source])


def _reading(
    key: Key[Array, ""], mode: int, test: Test, seen: Measured, modes: Modes
) -> tuple[np.ndarray, np.ndarray, float]:
    """Fit a law to a sweep through a mode; return products s and o, their errors, the law's slip.

    The products are s = alpha delta |c| and o = alpha gamma |c|.
    """
    numbers = dict(modes.numbers)
    c = numbers[seen_name(mode + 1)]
    gain = None if drive_of(test) in FED else numbers[numbered(PUSH, mode + 1)] * c
    settings = seen.settings.model_copy(
        update={"prior": {}, "hold_out": (), "fit": None, "fit_levels": None, "fit_repeats": "all"}
    )
    with_upper = replace(test, residuals="upper")
    prepared = measured([with_upper], settings, laws=(LAW,), gain=gain, report=lambda _: None)
    ready = prepare(parts_of(key, 2), assemble(prepared), settings, quick=True)
    products, std = (
        np.array(list(by_name.values())) for by_name in to_first_order(_products, ready.fit)
    )
    slip = float(BoucWenLaw.build(ready.fit.theta).slip(ready.y_peak))
    return abs(c) * products, abs(c) * std, slip


def _products(theta: Mapping[str, Array]) -> dict[str, Array]:
    """Return the products that small motion determines: softening alpha delta, loss alpha gamma."""
    s, o = BoucWenLaw.build(theta).weak_motion()
    return {"s": jnp.asarray(s), "o": jnp.asarray(o)}


def _known(starts: Sequence[Starts], laws: Sequence[str], modes: Modes) -> dict[str, float]:
    """Return starting values of all laws, each with half of its joint's fully stuck stiffness."""
    numbers, first = dict(modes.numbers), {}
    for k, name in enumerate(laws):
        joints = split(name)[1]
        stiffness = HALF * min(numbers[name_at(STIFFNESS, joint)] for joint in joints)
        softening, opening = (float(start.estimate[k]) for start in starts)
        law = BoucWenLaw.of_weak_motion(softening, opening, stiffness)
        first |= {name_at(name, joints[0]): value for name, value in law.parameters().items()}
    return first


def _statements(starts: Sequence[Starts], num_modes: int) -> tuple[str, ...]:
    """Return the sentence on whether the model's joints explain its modes, if it can be tested."""
    if starts[0].explains is None:
        return ()
    tests = [(start.chi_square, start.degrees_of_freedom, start.p) for start in starts]
    return (messages.modes_explained(num_modes, tests, all(start.explains for start in starts)),)
