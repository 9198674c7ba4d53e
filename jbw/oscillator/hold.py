r"""The input between its samples: one polynomial per sample interval, $u(s) = \sum_j c_j s^j$.

`s` runs from 0 to 1 within an interval. What happens between the samples matters more than the
integration scheme: a measured record is band-limited, not a polygon.
"""

from math import comb
from typing import Literal, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# One-sided second difference of order 4.
_END_CURVATURE = (15 / 4, -77 / 6, 107 / 6, -13.0, 61 / 12, -5 / 6)
_BUMP_WIDTH = 8.0
Hold = Literal["first", "zero", "band_limited"]
HOLDS = get_args(Hold)


def input_polynomials(
    u: Float[Array, "... time"], hold: str, *, periodic: bool
) -> Float[Array, "... interval power"]:
    """Polynomials of a sampled input under a named hold."""
    if hold == "zero":
        return (u if periodic else u[..., :-1])[..., None]
    if hold == "first":
        following = jnp.roll(u, -1, axis=-1) if periodic else u[..., 1:]
        start = u if periodic else u[..., :-1]
        return jnp.stack([start, following - start], axis=-1)
    slope, curvature = periodic_derivatives(u) if periodic else record_derivatives(u)
    knots = jnp.stack([u, slope, curvature], axis=-1)
    following = jnp.roll(knots, -1, axis=-2) if periodic else knots[..., 1:, :]
    start = knots if periodic else knots[..., :-1, :]
    return quintic(start, following)


def quintic(start: Float[Array, "... 3"], end: Float[Array, "... 3"]) -> Float[Array, "... 6"]:
    """Quintic with given value, slope and curvature at s = 0 and s = 1.

    For a sine of angular frequency omega its error is (omega h)^6 / 46080 of the amplitude.
    """
    u, du, ddu = (start[..., i] for i in range(3))
    # What the end asks for beyond the parabola of the start.
    rise = end[..., 0] - (u + du + 0.5 * ddu)
    turn = end[..., 1] - (du + ddu)
    bend = end[..., 2] - ddu
    return jnp.stack(
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
    u: Float[Array, "... time"],
) -> tuple[Float[Array, "... time"], Float[Array, "... time"]]:
    r"""Slope and curvature per sample of one period of a band-limited signal.

    $$u^{(m)} = \mathcal F^{-1}\left[(j\theta)^m \mathcal F u\right]$$

    The slope of a component at the Nyquist frequency itself is zero at the samples.
    """
    num = u.shape[-1]
    theta = 2.0 * np.pi * np.fft.rfftfreq(num)
    slope_gain = 1j * theta
    if num % 2 == 0:
        slope_gain[-1] = 0.0
    spectrum = jnp.fft.rfft(u)
    slope = jnp.fft.irfft(slope_gain * spectrum, n=num)
    return slope, jnp.fft.irfft(-(theta**2) * spectrum, n=num)


def record_derivatives(
    u: Float[Array, "... time"],
) -> tuple[Float[Array, "... time"], Float[Array, "... time"]]:
    """Slope and curvature per sample of a record that is not periodic.

    The line from the first to the last sample and a bump with the curvature of either end are
    taken off and the rest is continued as an odd function about both ends. That continuation is
    smooth up to its third derivative, so what the unknown outside does to the reconstruction stays
    small and fades within a few samples of the ends.
    """
    num = u.shape[-1]
    n = np.arange(num)
    start, end = _bump(n), _bump(num - 1 - n)
    bend = np.zeros(num)
    bend[: len(_END_CURVATURE)] = _END_CURVATURE if num > len(_END_CURVATURE) else 0.0
    curvatures = (u @ bend)[..., None], (u @ bend[::-1])[..., None]
    rest = u - curvatures[0] * start[0] - curvatures[1] * end[0]
    slope = (rest[..., -1:] - rest[..., :1]) / (num - 1)
    rest = rest - (rest[..., :1] + slope * n)
    odd = jnp.concatenate([rest, -rest[..., -2:0:-1]], axis=-1)
    first, second = periodic_derivatives(odd)
    return (
        first[..., :num] + slope + curvatures[0] * start[1] - curvatures[1] * end[1],
        second[..., :num] + curvatures[0] * start[2] + curvatures[1] * end[2],
    )


def _bump(n: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bump n^2 exp(-(n/w)^2)/2 of unit curvature at n = 0, with its slope and curvature."""
    s = (n / _BUMP_WIDTH) ** 2
    fall = np.exp(-s)
    return 0.5 * n**2 * fall, n * (1.0 - s) * fall, (1.0 - 5.0 * s + 2.0 * s**2) * fall


def substep_matrices(num_powers: int, substeps: int) -> Float[np.ndarray, "substep power power"]:
    """Change of polynomial coefficients from an interval to each of its equal parts.

    Entry [i, l, j] is what c_j of the interval gives to the power l of the local coordinate of
    part i.
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
