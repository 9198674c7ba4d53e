"""Frequency and damping against amplitude, from the posterior and from free decays."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float

from jbw.identification.discrepancy import NOTHING, Discrepancy
from jbw.identification.equivalent import backbones_at
from jbw.measurement.envelopes import filter_of
from jbw.measurement.faults.examine import read_decays
from jbw.measurement.records import Test
from jbw.oscillator.oscillator import Oscillator, oscillator_of
from jbw.oscillator.steady.backbone import backbone
from jbw.quantities import UNIT_OF, derivative_order
from jbw.report.messages import verification as messages
from jbw.verification.bands import QUANTILE_AXIS, band, noisy_band
from jbw.verification.predicted import carry
from jbw.verification.predictive_basis import Draws, Laws, parameter_names

NUM_AMPLITUDES = 40
CARRIED_ON = 1.25  # largest amplitude of the curves, relative to the largest fitted displacement
# amplitudes of the drawn loops, relative to the largest fitted displacement
PARTS = (0.25, 0.5, 1.0)
NUM_PHASES = 64  # number of points on half a loop
# number of amplitudes at which curves are compared with decays
NUM_OF_DECAYS = 60
HERTZ, RATIO, BANDS = {"units": "Hz"}, {"units": "1"}, ("quantile", "amplitude")


def backbone_group(
    draws: Draws, y_peak: float, laws: Laws, discrepancy: Discrepancy | None = None
) -> xr.Dataset | None:
    """Return frequency and damping against amplitude with bands, and three loops of Eq. (2).

    The bands of frequency and damping contain the error of the law, if it is known.

    The loops show the force Z of the laws with a memory: computed on unloading, and by Z(-y) =
    -Z(y) on loading. None if the draws lack a parameter of the joint, or no displacement is known.
    """
    if not has_backbone(draws, y_peak, laws):
        return None
    amplitude = np.linspace(0.0, CARRIED_ON * y_peak, NUM_AMPLITUDES + 1)[1:]
    frequency, damping, _ = curves(draws, amplitude, laws)
    of_frequency, of_damping = errors_of_law(amplitude, frequency, discrepancy)
    peaks = y_peak * np.asarray(PARTS)
    angle = np.linspace(0.0, np.pi, NUM_PHASES + 1)[:-1]
    half = peaks[:, None] * np.cos(angle)
    falling, stuck = carry(_unloading, draws, *jax.device_put((peaks, half)), laws)
    y, z = np.concatenate([half, -half], -1), np.concatenate([falling, -falling], -1)
    slip = z - stuck[:, None, None] * y
    loops = ("quantile", "loop", "phase")
    force = {"units": "N/kg", "long_name": "hysteretic force"}
    stiffness = {"units": "1/s^2", "long_name": messages.STIFFNESS}
    return xr.Dataset(
        {
            "frequency": (BANDS, noisy_band(frequency, of_frequency), HERTZ),
            "damping": (BANDS, noisy_band(damping, of_damping), RATIO),
            "frequency_missed": (
                "amplitude",
                of_frequency,
                {**HERTZ, "long_name": messages.MISSED},
            ),
            "damping_missed": ("amplitude", of_damping, {**RATIO, "long_name": messages.MISSED}),
            "loop_y": (("loop", "phase"), y, {"units": "m"}),
            "loop_z": (loops, band(z), force),
            "loop_slip": (loops, band(slip), {**force, "long_name": messages.SLIP}),
            "stuck": ("quantile", band(stuck), stiffness),
        },
        {"amplitude": ("amplitude", amplitude, {"units": "m"}), "quantile": QUANTILE_AXIS},
        {"y_fitted": float(y_peak), "discrepancy": int(np.any([of_frequency, of_damping]))},
    )


def errors_of_law(
    amplitude: Float[np.ndarray, " amplitude"],
    frequency: Float[np.ndarray, "draw amplitude"],
    discrepancy: Discrepancy | None,
) -> tuple[Float[np.ndarray, " amplitude"], Float[np.ndarray, " amplitude"]]:
    """Return the standard deviations of a law's frequency [Hz] and damping at amplitudes [m]."""
    missed = [NOTHING if discrepancy is None else discrepancy.at(y) for y in amplitude.tolist()]
    of_frequency, of_damping = np.array([(one.frequency, one.damping) for one in missed]).T
    return of_frequency * np.median(frequency, axis=0), of_damping


def has_backbone(draws: Draws, y_peak: float, laws: Laws) -> bool:
    """Return whether draws have all parameters of frequency and damping, and y_peak is known."""
    needed = set(parameter_names(laws)) - {"gain"}
    return needed <= set(draws) and 0.0 < y_peak < np.inf


def curves(
    draws: Draws, amplitude: Float[np.ndarray, " amplitude"], laws: Laws
) -> tuple[Float[np.ndarray, "draw amplitude"], ...]:
    """Return frequency [Hz], damping and force [N/kg] of all draws at amplitudes [m]."""
    omega, zeta, force = backbones_at(draws, amplitude, laws)
    return omega / (2 * np.pi), zeta, force


def _unloading(
    theta: Mapping[str, Array],
    peaks: Float[Array, " loop"],
    y: Float[Array, "loop phase"],
    laws: Laws,
) -> tuple[Float[Array, "loop phase"], Float[Array, ""]]:
    """Return the hysteretic laws' force on unloading from given peaks, and their stiffness."""
    joint = oscillator_of(theta, laws)
    slipping = [law for law in joint.laws if jax.tree.leaves(law.at_rest())]
    memory = Oscillator(joint.omega_n, joint.zeta, slipping)
    stiffness = jnp.asarray(sum(law.stiffness() for law in slipping), float)
    return jax.vmap(memory.force_unloading)(peaks, y), stiffness


def amplitude_verification(test: Test, num_fitted: int, draws: Draws, laws: Laws) -> xr.Dataset:
    r"""Compare frequency and damping against amplitude between free decays and the model.

    $$X = \omega(Y)^p\,Y$$

    with omega(Y) of the oscillator's backbone and p the order of the measured derivative. Records
    that cannot be evaluated have NaN.

    Raises:
        DataError: No record can be evaluated as the decay of one mode in its band.
    """
    centre_hz = filter_of(test).centre_hz
    tables = read_decays(test)
    read = [table for table in tables if table is not None]
    none = np.full(min(len(table.amplitude) for table in read), np.nan)
    sizes, frequencies, ratios, *errors = (
        np.stack([none if x is None else getattr(x, name)[: len(none)] for x in tables])
        for name in ("amplitude", "hz", "zeta", "hz_sd", "zeta_sd")
    )
    amplitude = np.linspace(0.0, 1.05 * np.nanmax(sizes), NUM_OF_DECAYS + 1)[1:]
    response = test.records[0].response
    centre, order = 2 * np.pi * centre_hz, derivative_order(response)
    frequency, damping, _ = carry(
        curves_of_response, draws, jnp.asarray(amplitude), centre, order, laws
    )
    unit, dims = {"units": UNIT_OF[response], "long_name": response}, ("record", "piece")
    return xr.Dataset(
        {
            "measured_amplitude": (dims, sizes, unit),
            "measured_frequency": (dims, frequencies, HERTZ),
            "measured_damping": (dims, ratios, RATIO),
            "measured_frequency_sd": (dims, errors[0], HERTZ),
            "measured_damping_sd": (dims, errors[1], RATIO),
            "model_frequency": (BANDS, band(frequency), HERTZ),
            "model_damping": (BANDS, band(damping), RATIO),
            "fitted": ("record", (np.arange(len(tables)) < num_fitted).astype(int)),
        },
        {"amplitude": ("amplitude", amplitude, unit), "quantile": QUANTILE_AXIS},
    )


def curves_of_response(
    theta: Mapping[str, Array],
    amplitude: Float[Array, " amplitude"],
    centre: float,
    order: int,
    laws: Laws,
) -> tuple[Float[Array, " amplitude"], ...]:
    """Return frequency [Hz], damping and force [N/kg] at amplitudes of the measured response."""
    joint, omega = oscillator_of(theta, laws), jnp.full_like(amplitude, centre)
    for _ in range(3):  # Displacement depends weakly on frequency, so few rounds are enough.
        omega = backbone(joint, amplitude / omega**order).omega
    curve = backbone(joint, amplitude / omega**order)
    return curve.omega / (2 * jnp.pi), curve.zeta, curve.amplitude
