"""Measured decays against the 99 % bands of the model: the motion, its frequency and damping."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Complex, Float, Key
from numpy.typing import NDArray

from jbw.inference.summary import evenly_spaced
from jbw.measurement.records import Test
from jbw.observables.decay import LETTER, Decays, envelopes, filter_of, readings, reduce
from jbw.observables.decay_entry import Entry, follow, match
from jbw.observables.decay_model import decay_of
from jbw.observables.joint import joint_of
from jbw.oscillator.hysteresis import steady_loop
from jbw.prediction import QUANTILES, band, error

NAMES = ("omega_n", "zeta", "softening", "opening", "share")
SEEN = 0.5  # s of a held-out record from which its initial state is read
NUM_AMPLITUDES = 60
Draws = dict[str, Array]


def thin_decay(posterior: xr.Dataset, num_draws: int) -> Draws:
    """Evenly spaced draws of the parameters of a decay over all chains."""
    keep = evenly_spaced(posterior, num_draws)
    return {name: jnp.asarray(posterior[name].values.ravel()[keep]) for name in NAMES}


def decay_verification(
    test: Test,
    num_fitted: int,
    draws: Draws,
    fitted: Decays,
    noise_std: Float[np.ndarray, " record"],
    key: Key[Array, ""],
    references: Mapping[str, Mapping[str, float]] | None = None,
) -> list[xr.Dataset]:
    """Filtered motion of every record beside the model's, entered at the record's initial state.

    The initial state of a fitted record comes from the whole of it, that of a held-out record from
    its first half second, so that the rest is predicted.

    Args:
        test: All decays, the fitted ones first.
        num_fitted: How many were fitted.
        draws: Draws of the parameters.
        fitted: The data that were fitted, with the worth and the scatter found.
        noise_std: Noise of each fitted record; their mean stands for the others.
        key: Random key of initial states and predictive noise.
        references: Oscillators to compare with, by name.

    Returns:
        One dataset a record over (quantile, time); attributes `coverage`, `nrmse` and
        `nrmse_linear` and so on concern what was predicted: all of a fitted record, a held-out one
        after `seen_s`.
    """
    data = replace(
        reduce(test, substeps=fitted.substeps), worth=fitted.worth, shift_std=fitted.shift_std
    )
    decays = _decays(draws, data)
    others = {
        name: _decays({key: jnp.array([value]) for key, value in one.items()}, data)
        for name, one in (references or {}).items()
    }
    chosen = filter_of(test)
    found = []
    for i, whole in enumerate(envelopes(test)):
        held_out = i >= num_fitted
        size = max(8, round(SEEN / data.step_s)) if held_out else data.envelope.shape[1]
        noise = float(noise_std[i] if not held_out else noise_std.mean())
        steps = jnp.arange(len(whole)) / chosen.step
        seen = replace(
            data, envelope=data.envelope[i : i + 1, :size], noise_std=jnp.asarray([noise])
        )
        keys = jax.random.split(jax.random.fold_in(key, i))
        model, *alone = (
            np.asarray(_entered(keys[0], some, seen, steps)) for some in (decays, *others.values())
        )
        time = np.arange(len(whole)) / chosen.fs
        carrier = np.exp(2j * np.pi * chosen.centre_hz * time)
        start = test.settle + chosen.half / chosen.fs
        attrs = {
            "level": float(np.abs(whole[0])),
            "response": data.response,
            "fitted": int(not held_out),
            "seen_s": float(size * data.step_s) if held_out else 0.0,
        }
        measured, predicted = np.real(whole * carrier), np.real(model * carrier)
        later = time >= attrs["seen_s"]
        attrs |= {
            f"nrmse_{name}": error(measured[later], np.real(one[0] * carrier)[later])
            for name, one in zip(others, alone, strict=True)
        }
        found.append(_compared(measured, predicted, time, start, noise, keys[1], attrs))
    return found


@eqx.filter_jit
def _decays(draws: Draws, data: Decays) -> Complex[Array, "draw step"]:
    return jax.lax.map(lambda theta: decay_of(theta, data), draws, batch_size=8)


@eqx.filter_jit
def _entered(
    key: Key[Array, ""],
    decays: Complex[Array, "draw step"],
    seen: Decays,
    steps: Float[Array, " time"],
) -> Complex[Array, "draw time"]:
    """Envelope of one record for every draw, from one draw of its initial state and shift."""

    def one(pair: tuple[Array, Array]) -> Array:
        key, decay = pair
        found = jax.vmap(lambda e: match(decay, e, seen.step_s))(seen.envelope)
        entry = jax.tree.map(lambda x: x[0], found.entry)
        # A short beginning says little of its own noise; that of the fitted records stands for it.
        precision = found.precision[0] * seen.worth / seen.noise_std[0] ** 2
        # The shift's own prior holds it where a short beginning would not.
        both = jnp.linalg.inv(precision.at[2, 2].add(1 / seen.shift_std**2))
        centre = -both[:, 2] * entry.shift / seen.shift_std**2
        change = centre + jnp.linalg.cholesky(both) @ jax.random.normal(key, (3,))
        moved = Entry(
            entry.place + change[0] / found.rate[0],
            entry.phase + change[1],
            entry.shift + change[2],
        )
        return follow(decay, moved, steps, seen.step_s)[0]

    return jax.lax.map(one, (jax.random.split(key, len(decays)), decays))


def _compared(
    measured: NDArray[np.float64],
    model: NDArray[np.float64],
    time: NDArray[np.float64],
    start: float,
    noise_std: float,
    key: Key[Array, ""],
    attrs: Mapping[str, Any],
) -> xr.Dataset:
    model_band = band(model)
    noise = noise_std * np.asarray(jax.random.normal(key, model.shape))
    predictive = band(model + noise)
    later = time >= float(attrs["seen_s"])
    inside = (measured >= predictive[0]) & (measured <= predictive[-1])
    unit = {"displacement": "m", "velocity": "m s-1", "acceleration": "m s-2"}[attrs["response"]]
    dims = ("quantile", "time")
    return xr.Dataset(
        {
            "measured": ("time", measured, {"units": unit, "long_name": "measured, in the band"}),
            "model_band": (dims, model_band, {"units": unit}),
            "predictive_band": (dims, predictive, {"units": unit}),
        },
        {"time": ("time", start + time, {"units": "s"}), "quantile": list(QUANTILES)},
        {
            **attrs,
            "coverage": float(inside[later].mean()),
            "num_values": inside[later].size,
            "nrmse": error(measured[later], model_band[1][later]),
        },
    )


def amplitude_verification(test: Test, num_fitted: int, draws: Draws) -> xr.Dataset:
    r"""Frequency and damping against amplitude: read from the records, and of the model.

    $$\omega^2 = k + k_{eq}(Y) + \tfrac34 \kappa_3 Y^2, \qquad
      \zeta_{eq} = \zeta\,\frac{\omega_n}{\omega} + \frac{E(Y)}{2\pi\omega^2 Y^2}$$

    Args:
        test: All decays, the fitted ones first.
        num_fitted: How many were fitted.
        draws: Draws of the parameters.

    Returns:
        Readings over (record, piece) and bands over (quantile, amplitude).

    Reference:
        Equivalent stiffness and damping of the steady loop of Eq. (2).
    """
    found = readings(test)
    pieces = min(len(one.amplitude) for one in found)
    measured = {
        name: np.stack([getattr(one, name)[:pieces] for one in found])
        for name in ("amplitude", "frequency_hz", "damping")
    }
    amplitude = np.linspace(0.0, 1.05 * measured["amplitude"].max(), NUM_AMPLITUDES + 1)[1:]
    order = list(LETTER).index(test.records[0].response)
    centre = 2 * np.pi * filter_of(test).centre_hz
    frequency, damping = map(np.asarray, _backbone(draws, jnp.asarray(amplitude), centre, order))
    unit = {"units": ("m", "m s-1", "m s-2")[order], "long_name": test.records[0].response}
    hertz, ratio = {"units": "Hz"}, {"units": "1"}
    dims, bands = ("record", "piece"), ("quantile", "amplitude")
    return xr.Dataset(
        {
            "measured_amplitude": (dims, measured["amplitude"], unit),
            "measured_frequency": (dims, measured["frequency_hz"], hertz),
            "measured_damping": (dims, measured["damping"], ratio),
            "model_frequency": (bands, band(frequency), hertz),
            "model_damping": (bands, band(damping), ratio),
            "fitted": ("record", (np.arange(len(found)) < num_fitted).astype(int)),
        },
        {"amplitude": ("amplitude", amplitude, unit), "quantile": list(QUANTILES)},
    )


@eqx.filter_jit
def _backbone(
    draws: Draws, amplitude: Float[Array, " amplitude"], centre: float, order: int
) -> tuple[Float[Array, "draw amplitude"], Float[Array, "draw amplitude"]]:
    def one(theta: Mapping[str, Array]) -> tuple[Array, Array]:
        joint = joint_of(theta)
        omega = jnp.full_like(amplitude, centre)
        y_peak = amplitude / omega**order
        for _ in range(3):  # the displacement of an amplitude depends weakly on the frequency
            loop = steady_loop(joint, y_peak)
            spring = joint.k + loop.k_eq + 0.75 * theta.get("cubic", 0.0) * y_peak**2
            omega = jnp.sqrt(spring)
            y_peak = amplitude / omega**order
        added = steady_loop(joint, y_peak).energy / (2 * jnp.pi * omega**2 * y_peak**2)
        return omega / (2 * jnp.pi), joint.zeta * joint.omega_n / omega + added

    return jax.vmap(one)(draws)
