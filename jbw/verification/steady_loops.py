"""Validation: measured hysteresis loops against predicted ones, and the areas they enclose."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.measurement.integration import differentiate, integrate
from jbw.measurement.loops import enclosed_area, mean_cycle
from jbw.measurement.records import Record, Test
from jbw.observables.samples import advance
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.response import simulate
from jbw.verification.bands import QUANTILES, band
from jbw.verification.draws import Draws, Laws, over_draws

NUM_POINTS = 512  # of a cycle
BAND = (0.5, 20.0)  # of the tone: where a record is integrated and differentiated
Cycle = dict[str, NDArray[np.float64]]


def loop_validation(test: Test, draws: Draws, laws: Laws) -> xr.Dataset:
    r"""Measured loops of a tone against the bands of the model.

    Measured: y by drift-free integration, a by differentiation in a stated band, and
    $F = g V - a - 2\zeta\omega_n v$ with the gain and the damping of every draw, so that the band
    of a measured loop carries them. Predicted: the same force on the steady cycle of every draw
    under the measured input. Both with and without the viscous part.

    Args:
        test: One tone, with repeats.
        draws: Parameters of the joint and gain.
        laws: Laws of the joint.

    Returns:
        Loops over (phase) and (quantile, phase), areas over (quantile), one set for
        $k y$ and the laws' forces and one, named `*_viscous`, with $2\zeta\omega_n v$ added.

    Reference:
        Section 4 (validation), Eq. (1).
    """
    omega = 2 * np.pi * test.tones_hz[0]
    cycle = _mean_cycles(test, omega)
    viscosity = 2 * draws["zeta"] * draws["omega_n"]
    drive = draws["gain"][:, None] * cycle["u"]
    y, v, a = _predicted_cycles(draws, cycle["u"], omega, laws)

    def restoring(v: NDArray[Any], a: NDArray[Any]) -> dict[str, NDArray[Any]]:
        return {"": drive - a - viscosity[:, None] * v, "_viscous": drive - a}

    forces, predicted = restoring(cycle["v"], cycle["a"]), restoring(v, a)
    bands = ("quantile", "phase")
    newton, metre = {"units": "N/kg"}, {"units": "m"}
    variables = {
        "measured_y": ("phase", cycle["y"], metre),
        "model_y": (bands, band(y), metre),
    }
    for suffix, force in forces.items():
        measured_area = enclosed_area(np.broadcast_to(cycle["y"], force.shape), force)
        model_area = enclosed_area(y, predicted[suffix])
        variables |= {
            f"measured_force{suffix}": ("phase", np.median(force, axis=0), newton),
            f"measured_force_band{suffix}": (bands, band(force), newton),
            f"model_force{suffix}": (bands, band(predicted[suffix]), newton),
            f"measured_area{suffix}": ("quantile", band(measured_area), {"units": "J/kg"}),
            f"model_area{suffix}": ("quantile", band(model_area), {"units": "J/kg"}),
        }
    phase = 2 * np.pi * np.arange(NUM_POINTS) / NUM_POINTS
    return xr.Dataset(
        variables,
        {"phase": ("phase", phase, {"units": "rad"}), "quantile": list(QUANTILES)},
        {
            "level": test.level,
            "level_unit": test.records[0].units[test.records[0].source],
            "tone_hz": test.tones_hz[0],
            "num_repeats": len(test.records),
        },
    )


def _mean_cycles(test: Test, omega: float) -> Cycle:
    """One cycle of input, displacement, velocity and acceleration, over all repeats."""
    cycles = [_cycles(record, test, omega) for record in test.records]
    return {name: np.mean([cycle[name] for cycle in cycles], axis=0) for name in cycles[0]}


def _cycles(record: Record, test: Test, omega: float) -> Cycle:
    """The same of one repeat, its phase counted from the input's."""
    fs, reach = record.fs, tuple(part * omega / (2 * np.pi) for part in BAND)
    keep = slice(round(test.settle * fs), None)
    x = advance(record.channels[record.response], test.delay, fs)[keep]
    y, v, a = _kinematics(x, fs, (reach[0], min(reach[1], 0.4 * fs)), record.response)
    # The first and last periods of the band's lower edge are doubtful after integration.
    inner = slice(round(2 * fs / reach[0]), -round(2 * fs / reach[0]))
    source = record.channels[record.source][keep][inner]
    loops = [
        mean_cycle(*pair, fs, omega, NUM_POINTS)
        for pair in ((y[inner], source), (v[inner], a[inner]))
    ]
    turn = np.angle(np.fft.rfft(loops[0].force)[1])
    raw = {"y": loops[0].y, "u": loops[0].force, "v": loops[1].y, "a": loops[1].force}
    return {name: _shifted(cycle, turn) for name, cycle in raw.items()}


def _kinematics(
    x: NDArray[np.float64], fs: float, reach: tuple[float, float], response: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Displacement, velocity and acceleration from the one that was measured."""
    up, down = partial(differentiate, fs=fs, band=reach), partial(integrate, fs=fs, band=reach)
    match response:
        case "displacement":
            v = up(x)
            return x, v, up(v)
        case "velocity":
            return down(x), x, up(x)
        case _:
            v = down(x)
            return down(v), v, x


def _shifted(cycle: NDArray[np.float64], turn: float) -> NDArray[np.float64]:
    """A periodic cycle with its phase counted from where `turn` was."""
    spectrum = np.fft.rfft(cycle)
    return np.fft.irfft(spectrum * np.exp(-1j * turn * np.arange(len(spectrum))), len(cycle))


def _predicted_cycles(
    draws: Draws, source: NDArray[np.float64], omega: float, laws: Laws
) -> tuple[NDArray[np.float64], ...]:
    fs = NUM_POINTS * omega / (2 * np.pi)
    return over_draws(lambda theta: _steady_cycles(theta, jnp.asarray(source), fs, laws), draws)


@partial(jax.jit, static_argnames=("fs", "laws"))
def _steady_cycles(
    draws: Mapping[str, Array], source: Float[Array, " phase"], fs: float, laws: Laws
) -> tuple[Float[Array, "draw phase"], ...]:
    def one(theta: Mapping[str, Array]) -> tuple[Float[Array, " phase"], ...]:
        u = theta["gain"] * source
        cycle = simulate(oscillator_of(theta, laws), u, fs, hold="band_limited", periodic=True)
        return cycle.y, cycle.v, cycle.a

    return jax.vmap(one)(dict(draws))
