"""Checks of a user's law: its methods must agree with its force and rate.

Methods that are defaults of `Law` follow from force and rate; the tests of jbw cover them. Parts of
the interface are checked only where a law overrides them. The laws of the register are covered by
their own tests and are not checked when a program starts.
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jbw.errors import ConfigError, JbwError, reason_of
from jbw.oscillator import generic
from jbw.oscillator.checks import is_concrete
from jbw.oscillator.law import Law
from jbw.oscillator.oscillator import Oscillator
from jbw.oscillator.parameters import SLOW, Scales
from jbw.oscillator.response import simulate
from jbw.oscillator.steady.backbone import backbone
from jbw.oscillator.steady.balance import imbalance
from jbw.oscillator.steady.cycle import steady_state
from jbw.oscillator.steady.waveform import exponentials, synthesis
from jbw.report.messages import joint as messages

SCALES = Scales(118.0, 0.01, 5e-3)
# Parameters of a law under trial lie at this fraction of their prior ranges; in the middle of a
# range, a force may vanish.
PLACE = 0.6
# Tolerance relative to the largest value. The grids of the default methods cause errors of 1e-3
# where a force yields between their points; a method with a wrong factor or sign is far worse.
NEAR = 5e-3
OMEGA, AMPLITUDE = 112.0, 4.0  # frequency and force of the trial tone [rad/s, N/kg]
Y = 0.6 * SCALES.y_peak
MOTION = np.array([Y, 0.05j * Y])  # first and third harmonic of the trial motion [m]
SETTLED = 8  # simulated periods, of which only the last is compared
POINTS = 256  # samples per period

# Methods of the time step. If a law uses their defaults, records agree with its steady state.
STEP = ("branch", "remainder", "bend", "glide", "turn", "shift", "missed", "packed")

_TRIED: dict[type[Law], str | None] = {}
# Result of one check: name of the method, value it returned, description of the expected value,
# expected value, and a scale. The tolerance is relative to the expected value, but to no less than
# a thousandth of this scale.
Check = tuple[str, Any, str, Any, Any]


def require_contract(kinds: Any) -> None:
    """Check each law class of a user once; raise an error if its methods disagree.

    Nothing is checked inside a traced function.

    Raises:
        ConfigError: A method disagrees with the law's force and rate; the message states both
            values.
    """
    for kind in kinds:
        if not is_concrete(jnp.zeros(())):
            continue
        if kind not in _TRIED:
            _TRIED[kind] = None  # the checks below call this function again
            with jax.enable_x64(True):
                _TRIED[kind] = broken(kind)
        if (fault := _TRIED[kind]) is not None:
            raise ConfigError(
                f"The law `{kind.name}` is refused: {fault}",
                remedy="Correct the method. An optional method may be left out: its default "
                "follows from `force` and `rate`.",
            )


def broken(kind: type[Law]) -> str | None:
    """Return a description of the first wrong method of a law, or None if all methods are right."""
    bounds = kind.prior(SCALES) if has_prior(kind) else dict.fromkeys(kind.names(), (0.5, 1.5))
    if absent := [name for name in kind.names() if name not in bounds]:
        return messages.no_bounds(absent)
    theta = {name: _within(*bounds[name]) for name in kind.names()}
    law = jax.tree.map(lambda x: jnp.asarray(x, float), kind.build(theta))
    joint = Oscillator(SCALES.omega_n, SCALES.zeta, (law,))
    joint = jax.tree.map(lambda x: jnp.asarray(x, float), joint)
    method = "build"
    try:
        values = law.parameters()
        found, right = [float(values[name]) for name in theta], [*theta.values()]
        if not np.allclose(found, right):
            return messages.law_disagrees("parameters", found, messages.VALUES_OF_BUILD, right)
        for checks in (_of_force, _of_memory, _of_stiffness, _of_motion, _of_period):
            for method, found, what, right, least in checks(law, joint):
                if not _agree(found, right, least):
                    return messages.law_disagrees(method, *_worst(found, what, right))
    # Every error is reported, because a user of the law would meet it too.
    except Exception as error:
        return messages.law_fails(method, reason_of(error))
    return None


def has_prior(kind: type[Law]) -> bool:
    """Return whether a law class states a prior; without one it cannot be fitted."""
    return kind.prior.__func__ is not Law.prior.__func__  # pyright: ignore


def offers(kind: type[Law], *parts: str) -> bool:
    """Return whether a law class overrides one of these methods of `Law`."""
    return any(getattr(kind, part, None) is not getattr(Law, part, None) for part in parts)


def _within(low: float, high: float) -> float:
    return low + PLACE * (high - low)


def _agree(found: Any, right: Any, least: Any) -> bool:
    size = max(np.max(np.abs(right), initial=0.0), 1e-3 * float(least), 1e-30)
    return bool(np.max(np.abs(np.subtract(found, right)), initial=0.0) <= NEAR * size)


def _worst(found: Any, what: str, right: Any) -> tuple[Any, str, Any]:
    found, right = np.broadcast_arrays(np.atleast_1d(found), np.atleast_1d(right))
    at = np.unravel_index(np.argmax(np.nan_to_num(np.abs(found - right), nan=np.inf)), found.shape)
    return found[at], what, right[at]


def _of_force(law: Law, joint: Oscillator) -> Iterator[Check]:
    """Yield the checks that the force at rest is a finite number with finite slopes."""
    force = np.asarray(law.force(0.3 * Y, 0.3 * Y * OMEGA, law.at_rest()))
    yield "force", force.ndim, messages.A_SCALAR, 0, 0.0
    yield "force", force, messages.FINITE, np.nan_to_num(force, posinf=0.0, neginf=0.0), 0.0
    rest = jax.tree.map(lambda x: jnp.asarray(x, float), (law.at_rest(), 0.0, 0.0))
    slopes = jax.grad(lambda law, memory, y, v: law.force(y, v, memory), (0, 1, 2, 3))(law, *rest)
    for slope in jax.tree.leaves(slopes):
        yield (
            "force",
            slope,
            messages.SMOOTH_AT_REST,
            np.nan_to_num(slope),
            0.0,
        )


def _of_memory(law: Law, joint: Oscillator) -> Iterator[Check]:
    """Yield the checks that the internal state depends on displacement only, as `rate` states."""
    if not law.remembers:
        return
    start = law.move(0.0, law.at_rest(), 0.2 * Y)
    if law.stepped:
        once, twice = (jax.tree.leaves(law.rate(0.2 * Y, v, start)) for v in (1.0, 2.0))
        for slow, fast in zip(once, twice, strict=True):
            yield "rate", fast, messages.PROPORTIONAL, 2.0 * np.asarray(slow), 0.0

    @jax.jit
    def forces(law: Law) -> Any:
        y, memory, exact = 0.0, law.at_rest(), law.at_rest()
        pairs = []
        for end in (0.4 * Y, -Y, 0.1 * Y):
            exact, dy = law.move(y, exact, end - y), (end - y) / POINTS

            def onward(carry: tuple, _: None, dy: Any = dy) -> tuple[tuple, None]:
                at, memory = carry
                return (at + dy, generic.move_by_rates(law, at, memory, dy)), None

            carry = jax.tree.map(lambda x: jnp.asarray(x, float), (y, memory))
            (_, memory), _ = jax.lax.scan(onward, carry, None, POINTS)
            y = end
            pairs.append([law.force(y, SLOW * dy, each) for each in (exact, memory)])
        return jnp.asarray(pairs).T

    by_move, by_rate = forces(law)
    yield "move", by_move, messages.INTEGRAL_OF_RATE, by_rate, 0.0


def _of_stiffness(law: Law, joint: Oscillator) -> Iterator[Check]:
    """Yield the check that `stiffness` is the slope of the force at rest."""
    dy, size = 1e-9 * Y, np.abs(law.force(0.3 * Y, 0.3 * Y * OMEGA, law.at_rest()))
    after = law.move(0.0, law.at_rest(), dy)
    slope = (law.force(dy, SLOW, after) - law.force(0.0, SLOW, law.at_rest())) / dy
    yield "stiffness", law.stiffness(), messages.SLOPE_AT_REST, slope, size / Y


def _of_motion(law: Law, joint: Oscillator) -> Iterator[Check]:
    """Yield the check that derivatives of a simulation agree with finite differences."""
    if not offers(type(law), *STEP):
        return
    time = np.arange(64) / 512.0
    u = 2.0 * AMPLITUDE * np.sin(OMEGA * time)

    @jax.jit
    def power(step: Any) -> Any:
        def size(step: Any) -> Any:
            moved = jax.tree.map(lambda x: x * (1.0 + step), law)
            joint_moved = Oscillator(joint.omega_n, joint.zeta, (moved,))
            return jnp.sum(simulate(joint_moved, u, 512.0, substeps=2).v ** 2)

        return jax.jvp(size, (step,), (jnp.ones(()),))

    step = 1e-4
    value, found = power(jnp.zeros(()))
    ahead, behind = power(jnp.asarray(step))[0], power(jnp.asarray(-step))[0]
    right = (ahead - behind) / (2.0 * step)
    yield "simulate", found, messages.DIFFERENCE_OF_RECORDS, right, 10.0 * value


def _of_period(law: Law, joint: Oscillator) -> Iterator[Check]:
    """Yield the checks of harmonics, loop and backbone against the force along a motion."""
    if law.degrades or refuses(law.check_periodic):
        return

    @jax.jit
    def along(law: Law, q: Any) -> tuple[Any, ...]:
        theta = jnp.asarray(2.0 * np.pi * np.arange(POINTS) / POINTS)
        y, v = synthesis(q, theta), OMEGA * synthesis(q, theta, 1)

        def onward(carry: tuple, point: tuple) -> tuple[tuple, Any]:
            (y, memory), (y_next, v_next) = carry, point
            memory = law.move(y, memory, y_next - y)
            return (y_next, memory), law.force(y_next, v_next, memory)

        start = jax.tree.map(lambda x: jnp.asarray(x, float), (0.0, law.at_rest()))
        _, force = jax.lax.scan(onward, start, (jnp.tile(y, SETTLED), jnp.tile(v, SETTLED)))
        force = force[-POINTS:]
        harmonics = 2.0 / POINTS * (force @ exponentials(theta, q.shape[0]).conj())
        return force, harmonics - law.stiffness() * q, law.harmonics(q, 2, OMEGA)

    force, right, found = along(law, jnp.asarray(MOTION))
    half = POINTS // 2
    yield "force", -force[half:], messages.ODD, force[:half], 0.0
    size = np.abs(force).max()
    yield "harmonics", found, messages.ALONG_MOTION, right, size
    if offers(type(law), "scaled"):
        length, kappa = 2e-3, SCALES.omega_n**2
        scaled = law.scaled(jnp.asarray(length), jnp.asarray(kappa))
        there = scaled.harmonics(jnp.asarray(MOTION / length), 2, OMEGA / SCALES.omega_n)
        yield "scaled", there * kappa * length, messages.OTHER_UNITS, found, size
    tone = jnp.asarray([Y + 0j, 0.0])
    first = along(law, tone)[1][0] / Y + law.stiffness()
    loop = law.loop(Y, OMEGA)
    loop = complex(loop.stiffness, loop.damping)
    yield "loop", loop, messages.FIRST_HARMONIC, first, size / Y
    curve = backbone(joint, Y)
    left = imbalance(
        joint, curve.omega, jnp.asarray([-1j * Y, 0.0]), np.array([1, 0]) * curve.amplitude
    )
    right = curve.amplitude
    yield "backbone", right + left[0], messages.HOLDS_MOTION, right, 0.0
    if not offers(type(law), *STEP) or not law.stepped:
        return
    phase = 2.0 * np.pi * np.arange(64) / 64
    record = simulate(
        joint, AMPLITUDE * np.cos(phase), 64 * OMEGA / (2.0 * np.pi),
        hold="band_limited", periodic=True, substeps=4,
    )  # fmt: skip
    first = 2.0 * np.mean(np.asarray(record.y) * np.exp(-1j * phase))
    found = steady_state(joint, OMEGA, AMPLITUDE)[0]
    yield (
        "steady_state",
        found,
        messages.OF_PERIODIC_RECORD,
        first,
        0.0,
    )


def refuses(check: Callable[[], None]) -> bool:
    """Return whether a check raises one of jbw's own errors, and so refuses the law properly."""
    try:
        check()
    except JbwError:
        return True
    return False
