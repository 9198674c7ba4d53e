r"""Reconstruction of an input between its samples, $u(s) = \sum_j c_j s^j$ in each interval.

`s` runs from 0 to 1 within an interval. What happens between the samples matters more than the
integration scheme: a measured record is band-limited, not a polygon.
"""

from dataclasses import replace
from math import comb
from typing import Any, Literal, Self, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jbw.oscillator.parameters import Scalar

# Coefficients of a one-sided second difference of order 4.
_END_CURVATURE = (15 / 4, -77 / 6, 107 / 6, -13.0, 61 / 12, -5 / 6)
_BUMP_WIDTH = 8.0
Hold = Literal["first", "zero", "band_limited"]
HOLDS = get_args(Hold)


class HeldInput(eqx.Module):
    r"""A sampled input, stored as a polynomial for each sample interval, times a gain g.

    $$u_n(s) = g \sum_j c_{jn} s^j, \qquad 0 \le s < 1$$

    The polynomials depend only on the samples: they are computed once for all gains and parameters.

    Attributes:
        samples: The input at the samples, without the gain [N/kg over the unit of g].
        polynomials: Coefficients c_j of every interval.
        gain: Gain g.
        hold: Name of the hold; static.
        periodic: Whether the samples are one period of a steady input; static.
    """

    samples: Float[Array, "*batch time"]
    polynomials: Float[Array, "*batch power interval"]
    gain: Float[Array, "*batch"]
    hold: Hold = eqx.field(static=True)
    periodic: bool = eqx.field(static=True)

    @property
    def u(self) -> Float[Array, "*batch time"]:
        """The input at the samples [N/kg]."""
        return self.gain[..., None] * self.samples

    def times(self, factor: Scalar) -> Self:
        """Return the same input with another gain; the polynomials stay the same."""
        return replace(self, gain=factor * self.gain)

    def pieces(self, substeps: int) -> tuple[Float[Array, " substep"], ...]:
        """Return the input's polynomials in all substeps without the gain; one row per power."""
        parts = substep_matrices(self.polynomials.shape[-2], substeps)
        rows = jnp.einsum("ilj,jn->lni", parts, self.polynomials)
        return tuple(rows.reshape(len(rows), -1))


def held(
    u: Float[np.ndarray | Array, "*batch time"] | HeldInput, hold: Hold, *, periodic: bool
) -> HeldInput:
    """Return a sampled input with polynomials between its samples.

    A `HeldInput` is returned unchanged. NumPy samples are processed by NumPy.
    """
    if isinstance(u, HeldInput):
        return u
    polynomials = namespace(u).moveaxis(input_polynomials(u, hold, periodic=periodic), -1, -2)
    arrays: Any = u, polynomials, np.ones(u.shape[:-1])
    # NumPy is used, because `jnp.asarray` would compile a program for each shape.
    if namespace(u) is np:
        samples, rows, gain = jax.device_put(arrays)
    else:
        samples, rows, gain = map(jnp.asarray, arrays)
    return HeldInput(samples, rows, gain, hold, periodic)


def input_polynomials(
    u: Float[np.ndarray | Array, "... time"], hold: str, *, periodic: bool
) -> Float[np.ndarray | Array, "... interval power"]:
    """Return the polynomials between the samples of an input, by the method named `hold`."""
    xp = namespace(u)
    if hold == "zero":
        return (u if periodic else u[..., :-1])[..., None]
    if hold == "first":
        following = xp.roll(u, -1, axis=-1) if periodic else u[..., 1:]
        start = u if periodic else u[..., :-1]
        return xp.stack([start, following - start], axis=-1)
    slope, curvature = periodic_derivatives(u) if periodic else record_derivatives(u)
    knots = xp.stack([u, slope, curvature], axis=-1)
    following = xp.roll(knots, -1, axis=-2) if periodic else knots[..., 1:, :]
    start = knots if periodic else knots[..., :-1, :]
    return quintic(start, following)


def quintic(start: Float[Array, "... 3"], end: Float[Array, "... 3"]) -> Float[Array, "... 6"]:
    """Return the quintic with given value, slope and curvature at s = 0 and s = 1.

    For a sine of angular frequency omega its error is (omega h)^6 / 46080 of the amplitude.
    """
    xp = namespace(start)
    u, du, ddu = (start[..., i] for i in range(3))
    # Value, slope and curvature at the end, minus those of the parabola that starts with the given
    # values.
    rise = end[..., 0] - (u + du + 0.5 * ddu)
    turn = end[..., 1] - (du + ddu)
    bend = end[..., 2] - ddu
    return xp.stack(
        [
            u,
            du,
            0.5 * ddu,
            10.0 * rise - 4.0 * turn + 0.5 * bend,
            -15.0 * rise + 7.0 * turn - bend,
            6.0 * rise - 3.0 * turn + 0.5 * bend,
        ],
        axis=-1,
    )


def periodic_derivatives(
    u: Float[np.ndarray | Array, "... time"],
) -> tuple[Float[Array, "... time"], Float[Array, "... time"]]:
    r"""Return the slope and curvature per sample of one period of a band-limited signal.

    $$u^{(m)} = \mathcal F^{-1}\left[(j\theta)^m \mathcal F u\right]$$

    The slope of a component at the Nyquist frequency itself is zero at the samples.
    """
    xp = namespace(u)
    num = u.shape[-1]
    theta = 2.0 * np.pi * line_frequencies(num, 1.0, xp)
    slope_gain = 1j * xp.where(xp.arange(len(theta)) == 0.5 * num, 0.0, theta)
    spectrum = xp.fft.rfft(u)
    slope = xp.fft.irfft(slope_gain * spectrum, n=num)
    return slope, xp.fft.irfft(-(theta**2) * spectrum, n=num)


def line_frequencies(num: int, spacing: Scalar, xp: Any = jnp) -> Float[Array, " line"]:
    """Return the frequencies of a real Fourier transform of `num` samples [1/spacing].

    JAX's are computed inside the program: as a constant they would be as long as the record.
    """
    return xp.arange(num // 2 + 1) * (1.0 / (num * spacing))


def record_derivatives(
    u: Float[np.ndarray | Array, "... time"],
) -> tuple[Float[Array, "... time"], Float[Array, "... time"]]:
    """Return the slope and curvature per sample of a record that is not periodic.

    The line from the first to the last sample, and a bump with the curvature of each end, are
    subtracted. The rest is continued as an odd function about both ends. That continuation is
    smooth up to its third derivative, so the effect of the unknown signal outside the record stays
    small and fades within a few samples of the ends.
    """
    xp = namespace(u)
    num = u.shape[-1]
    n = xp.arange(num)
    start, end = _bump(n), _bump(num - 1 - n)
    bend = xp.zeros(num)
    if num > len(_END_CURVATURE):
        bend = xp.concatenate([xp.asarray(_END_CURVATURE), bend[len(_END_CURVATURE) :]])
    curvatures = (u @ bend)[..., None], (u @ bend[::-1])[..., None]
    rest = u - curvatures[0] * start[0] - curvatures[1] * end[0]
    slope = (rest[..., -1:] - rest[..., :1]) / (num - 1)
    rest = rest - (rest[..., :1] + slope * n)
    odd = xp.concatenate([rest, -rest[..., -2:0:-1]], axis=-1)
    first, second = periodic_derivatives(odd)
    return (
        first[..., :num] + slope + curvatures[0] * start[1] - curvatures[1] * end[1],
        second[..., :num] + curvatures[0] * start[2] + curvatures[1] * end[2],
    )


def _bump(
    n: Int[np.ndarray | Array, " time"],
) -> tuple[np.ndarray | Array, np.ndarray | Array, np.ndarray | Array]:
    """Return the smooth pulse n^2 exp(-(n/w)^2)/2, its slope and its curvature."""
    s = (n / _BUMP_WIDTH) ** 2
    fall = namespace(n).exp(-s)
    return 0.5 * n**2 * fall, n * (1.0 - s) * fall, (1.0 - 5.0 * s + 2.0 * s**2) * fall


def namespace(values: Any) -> Any:
    """Return NumPy for NumPy arrays, which compiles nothing, otherwise JAX's NumPy."""
    return np if isinstance(values, np.ndarray) else jnp


def substep_matrices(num_powers: int, substeps: int) -> Float[np.ndarray, "substep power power"]:
    """Return matrices that convert polynomials of an interval to those of its equal parts.

    Entry [i, l, j] is the contribution of c_j of the interval to the power l of the local
    coordinate of part i.
    """
    return np.array(
        [
            [
                [
                    comb(j, part) * (i / substeps) ** (j - part) / substeps**part
                    if j >= part
                    else 0.0
                    for j in range(num_powers)
                ]
                for part in range(num_powers)
            ]
            for i in range(substeps)
        ]
    )
