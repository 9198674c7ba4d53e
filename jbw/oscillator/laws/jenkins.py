r"""Jenkins elements in parallel: springs, each of which slips at its own displacement."""

from collections.abc import Mapping
from functools import cache, reduce
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Complex, Float

from jbw.oscillator.kinks import Ends, StepPath, barrier, kink_impulse, signed, slope_jump_impulse
from jbw.oscillator.law import Bounds, Law, Loop, Monomial, Scales, Threshold
from jbw.oscillator.parameters import (
    MOST_SOFTENING,
    SLOW,
    Conversion,
    Material,
    Scalar,
    of_opensees,
)
from jbw.oscillator.steady.waveform import (
    angle_of,
    crest,
    exponentials,
    gauss_legendre,
    synthesis,
)
from jbw.quantities import Quantity
from jbw.report.messages import joint as messages

# The prior of the first slip displacement lies between these fractions of the largest displacement.
# Each further slip is its predecessor times a ratio of at least one, so that sliders cannot be
# interchanged. The ratios together span the same range; a slider that never slips is a linear
# spring.
SLIP = (0.02, 2.0)
SHARE = (0.002, 0.5)  # prior range of the sliders' total stiffness, relative to omega_n^2
FORCED_SHARE = (0.01, MOST_SOFTENING)
_NODES, _NODES_PER_HARMONIC = 24, 2
_SUBSCRIPT = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def _table(count: int) -> tuple[Quantity, ...]:
    """Return the parameter table of `count` sliders, in the order of their slip displacements."""
    rows = []
    for i in range(1, count + 1):
        low, before = (f"{number}".translate(_SUBSCRIPT) for number in (i, i - 1))
        meaning = f"stiffness of slider {i}"
        rows.append(Quantity(f"stiffness_{i}", f"α{low}", "1/s^2", meaning, 0.0, is_share=True))
        if i == 1:
            rows.append(_slip(1))
        else:
            meaning = f"slip of slider {i} / slip of slider {i - 1}"
            rows.append(Quantity(f"slip_ratio_{i}", f"φ{low}/φ{before}", "1", meaning, 1.0))
    return tuple(rows)


def _slip(i: int) -> Quantity:
    low = f"{i}".translate(_SUBSCRIPT)
    return Quantity(f"slip_{i}", f"φ{low}", "m", f"displacement at which slider {i} slips", 0.0)


def _slips(count: int) -> tuple[Monomial, ...]:
    """Return each slip displacement after the first, as a product of slip_1 and ratios."""
    return tuple(
        Monomial(_slip(i), {"slip_1": 1} | {f"slip_ratio_{j}": 1 for j in range(2, i + 1)})
        for i in range(2, count + 1)
    )


class Jenkins(Law):
    r"""Jenkins elements in parallel; the internal state is the stretch x of each spring.

    $$F = \sum_i \alpha_i x_i, \qquad x_i \leftarrow \mathrm{clip}(x_i + dy,\,
      -\varphi_i,\, \varphi_i)$$

    The move is exact for every monotone path. It is a Masing law: damping follows from softening.

    Attributes:
        alpha: Stiffness of each slider [1/s^2]; scalars, or an array of one axis.
        phi: Displacement at which each slider slips [m].

    Reference:
        Iwan (1966).
    """

    name: ClassVar[str] = "jenkins"
    table: ClassVar[tuple[Quantity, ...]] = _table(1)
    same_as: ClassVar[str] = messages.SAME_CURVES

    alpha: tuple[Scalar, ...] = eqx.field(converter=tuple)
    phi: tuple[Scalar, ...] = eqx.field(converter=tuple)

    def __check_init__(self) -> None:
        if len(self.alpha) != len(self.phi):
            raise ValueError("Jenkins needs as many `phi` as `alpha`.")

    @classmethod
    def build(cls, theta: Mapping[str, Any]) -> Self:
        """Build the array from stiffness_1, slip_1, stiffness_2, slip_ratio_2 (or slip_2), ..."""
        phi = [theta["slip_1"]]
        for i in range(2, len(cls.table) // 2 + 1):
            slip = f"slip_{i}"
            phi.append(theta[slip] if slip in theta else phi[-1] * theta[f"slip_ratio_{i}"])
        return cls(tuple(theta[f"stiffness_{i}"] for i in range(1, len(phi) + 1)), tuple(phi))

    def parameters(self) -> dict[str, Any]:
        """Return the stiffnesses, the first slip and the slip ratios by name."""
        values: dict[str, Any] = {}
        for i, (alpha, phi) in enumerate(zip(self.alpha, self.phi, strict=True)):
            values[f"stiffness_{i + 1}"] = alpha
            values |= {f"slip_ratio_{i + 1}": phi / self.phi[i - 1]} if i else {"slip_1": phi}
        return values

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds: equal stiffness of all sliders, first slip, and ratios of slips."""
        count = len(cls.table) // 2
        share = FORCED_SHARE if scales.forced else SHARE
        low, high = (float(part * scales.omega_n**2 / count) for part in share)
        least, most = (part * scales.y_peak for part in SLIP)
        bounds: Bounds = {"stiffness_1": (low, high), "slip_1": (least, most)}
        for i in range(2, count + 1):
            bounds[f"stiffness_{i}"] = (low, high)
            bounds[f"slip_ratio_{i}"] = (1.0, (most / least) ** (1.0 / (count - 1)))
        return bounds

    # -- motion ------------------------------------------------------------------------------------
    def thresholds(self) -> tuple[Threshold, ...]:
        """Return the slip displacements; sliders that never slip act as one linear spring."""
        return tuple(
            Threshold(f"slip of slider {i}", phi, messages.STUCK_SLIDER)
            for i, phi in enumerate(self.phi, 1)
        )

    def stiffness(self) -> Scalar:
        """Return the total stiffness of the stuck sliders [1/s^2]."""
        return sum(self.alpha)

    def at_rest(self) -> tuple[Scalar, ...]:
        """Return the internal state at rest: no spring is stretched."""
        return tuple(0.0 for _ in self.alpha)

    def force(self, y: Scalar, v: Scalar, memory: tuple[Scalar, ...]) -> Scalar:
        """Return the sum of the sliders' forces [N/kg]."""
        return sum(alpha * x for alpha, x in zip(self.alpha, memory, strict=True))

    def rate(self, y: Scalar, v: Scalar, memory: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
        """Return each spring's stretch rate: the velocity for stuck sliders, zero for slipping."""
        slips = self.branch(v, memory)
        return tuple(jnp.where(slip, 0.0, v) for slip in slips)

    def move(self, y: Scalar, memory: tuple[Scalar, ...], dy: Scalar) -> tuple[Scalar, ...]:
        """Return each spring's exact stretch after a monotone move."""
        return tuple(jnp.clip(x + dy, -phi, phi) for x, phi in zip(memory, self.phi, strict=True))

    def convert(self, omega_n: float, zeta: float, mass: float) -> dict[str, Conversion]:
        """Return each slider as an elastic-perfectly-plastic material of OpenSees."""
        pairs = zip(self.alpha, self.phi, strict=True)
        return of_opensees(*(Material("ElasticPP", (mass * k, slip)) for k, slip in pairs))

    def memory_unit(self, omega_n: Scalar) -> tuple[Scalar, ...]:
        """Return omega_n, which converts each spring's stretch to a velocity."""
        return tuple(omega_n for _ in self.alpha)

    # -- through a time step -----------------------------------------------------------------------
    def branch(self, v: Scalar, memory: tuple[Scalar, ...]) -> tuple[Bool[Array, "..."], ...]:
        """Return a mask of slipping sliders; their springs are stretched by the slip limit."""
        pairs = zip(memory, self.phi, strict=True)
        return tuple(signed(x, v) >= phi for x, phi in pairs)

    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: tuple[Scalar, ...], branch: tuple
    ) -> tuple[Scalar, Scalar]:
        """Return the force lost to slip, sum alpha (x - y), and its rate times the time step h."""
        pairs = zip(self.alpha, memory, strict=True)
        return sum(alpha * (x - y) for alpha, x in pairs), -h * v * self._slipping(branch)

    def bend(
        self, h: Scalar, y: Scalar, v: Scalar, a: Scalar, memory: tuple, branch: tuple
    ) -> Scalar:
        """Return h^2/2 times the second time derivative of the force lost to slip."""
        return -0.5 * h**2 * a * self._slipping(branch)

    def glide(
        self, y: Scalar, memory: tuple[Scalar, ...], dy: Scalar, branch: tuple
    ) -> tuple[tuple[Scalar, ...], Bool[Array, "..."]]:
        """Return each spring's stretch after a move, and whether a slider began to slip."""
        moved = self.move(y, memory, dy)
        after = self.branch(dy, moved)
        met = (now != was for now, was in zip(after, branch, strict=True))
        return moved, reduce(jnp.logical_or, met)

    def turn(
        self, h: Scalar, y: Scalar, memory: tuple[Scalar, ...], ends: Ends, quartic: Scalar
    ) -> tuple[tuple[Scalar, ...], Scalar, Scalar]:
        """Return the springs' stretch after a step that may reverse, and the changes of v and y."""
        path = StepPath.through(ends, quartic)
        start = jnp.where(ends[0] == 0.0, ends[1], ends[0])
        # All sliders are treated at once, because they take several times as long to compile one by
        # one.
        alpha, phi, x = (jnp.stack(part) for part in (self.alpha, self.phi, memory))
        at_turn = barrier(jnp.clip(x + path.before, -phi, phi))
        slid = signed(at_turn, start) >= phi
        first = slid & (signed(x, start) < phi), path.passage(signed(phi, start) - x, first=True)
        last = barrier(jnp.clip(at_turn + path.after, -phi, phi))
        slips_again = path.turns & (signed(last, ends[1]) >= phi)
        place = path.before + signed(phi, ends[1]) - at_turn
        regained = jnp.where(path.turns & slid, alpha, 0.0)
        turned = kink_impulse(1.0 - path.fraction, regained * path.bend, 0.0)
        impulse_v, impulse_y = turned.v, turned.y
        # At a slip onset the slope of the force falls by alpha; slip ends where the motion turns.
        for begins, s in (first, (slips_again, path.passage(place, first=False))):
            s = barrier(jnp.where(begins, s, 1.0))
            lost = jnp.where(begins, -alpha, 0.0)
            v, dy = slope_jump_impulse(
                1.0 - s, lost * path.cubic.slope(s), lost * path.cubic.bend(s)
            )
            impulse_v, impulse_y = barrier((impulse_v + v, impulse_y + dy))
        return tuple(last), jnp.sum(impulse_v), jnp.sum(impulse_y)

    def shift(
        self, y: Scalar, memory: tuple[Scalar, ...], dy: Scalar, branch: tuple
    ) -> tuple[Scalar, ...]:
        """Return each spring's stretch after a small move, which changes only the stuck sliders."""
        triples = zip(memory, self.phi, branch, strict=True)
        return tuple(jnp.where(slip, x, jnp.clip(x + dy, -phi, phi)) for x, phi, slip in triples)

    def _slipping(self, branch: tuple) -> Scalar:
        """Return the total stiffness of the slipping sliders [1/s^2]."""
        pairs = zip(self.alpha, branch, strict=True)
        return sum(jnp.where(slip, alpha, 0.0) for alpha, slip in pairs)

    # -- along a periodic motion -------------------------------------------------------------------
    def at_tip(self, y_peak: Scalar) -> tuple[Scalar, ...]:
        """Return each spring's stretch at the tip y = Y of the steady loop."""
        return tuple(jnp.minimum(y_peak, phi) for phi in self.phi)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        r"""Return the sliders' equivalent stiffness and damping, in closed form.

        c = arccos(1 - 2 phi/Y) for Y > phi; elsewhere a slider's stiffness is alpha.

        $$\kappa = \frac{\alpha}{\pi}\left(c - \tfrac12 \sin 2c\right)
          + 4j\,\frac{\alpha\varphi (Y - \varphi)}{\pi Y^2}$$
        """
        y_peak = jnp.asarray(y_peak, float)
        stiffness, damping = 0.0 * y_peak, 0.0 * y_peak
        for alpha, phi in zip(self.alpha, self.phi, strict=True):
            slips = y_peak > phi
            part = jnp.where(slips, phi / jnp.where(slips, y_peak, 1.0), 0.5)
            c = jnp.arccos(1.0 - 2.0 * part)
            real = (c - 0.5 * jnp.sin(2.0 * c)) / jnp.pi
            stiffness = stiffness + alpha * jnp.where(slips, real, 1.0)
            losses = 4.0 / jnp.pi * part * (1.0 - part)
            damping = damping + alpha * jnp.where(slips, losses, 0.0)
        return Loop(stiffness, damping)

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return odd harmonics, integrated piecewise between turning points and slip onsets."""
        if max_turns > 2:
            return super().harmonics(q, max_turns, omega)
        start = crest(q)
        peak = synthesis(q, start)
        num_nodes = _NODES + _NODES_PER_HARMONIC * q.shape[0]
        total = jnp.zeros_like(q)
        for alpha, phi in zip(self.alpha, self.phi, strict=True):
            begin, slip_angle = stop_gradient((start, angle_of(q, start, peak - 2.0 * phi)))
            theta, weights = gauss_legendre(num_nodes, begin, slip_angle, begin + jnp.pi)
            basis = exponentials(theta, q.shape[0])
            r = self._unloading(phi, peak, jnp.sum(basis * q, -1).real)
            total = total + alpha * ((weights * r) @ basis.conj())
        return 2.0 / jnp.pi * total

    def force_over_period(
        self,
        q: Complex[Array, " harmonic"],
        theta: Float[Array, " time"],
        max_turns: int,
        omega: Scalar = SLOW,
    ) -> Float[Array, " time"]:
        """Return the exact steady force [N/kg] at angles of a period with two turning points."""
        if max_turns > 2:
            return super().force_over_period(q, theta, max_turns, omega)
        peak = synthesis(q, crest(q))
        side = jnp.where(synthesis(q, theta, 1) > 0.0, -1.0, 1.0)
        y = side * synthesis(q, theta)
        parts = (
            alpha * (y + self._unloading(phi, peak, y))
            for alpha, phi in zip(self.alpha, self.phi, strict=True)
        )
        return side * sum(parts)

    def _unloading(self, phi: Scalar, peak: Scalar, y: Scalar) -> Scalar:
        """Return a spring's stretch minus displacement on unloading, first stuck, then slipping."""
        return jnp.where(peak > phi, -jnp.minimum(peak - phi, y + phi), 0.0)


@cache
def jenkins(count: int) -> type[Jenkins]:
    """Return the law class with `count` sliders, `jenkins_3` in a campaign."""
    body = {
        "name": f"jenkins_{count}",
        "table": _table(count),
        "products": _slips(count),
        "__module__": __name__,
    }
    return type(f"Jenkins{count}", (Jenkins,), body)
