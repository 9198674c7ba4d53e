"""Free decays beside the model's: the motion of every record, and frequency and damping."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Complex, Float, Key
from numpy.typing import NDArray

from jbw.measurement.records import Test
from jbw.observables.decay import Decays, decay_of
from jbw.observables.decay_envelopes import Entry, envelopes, filter_of, follow, match, readings
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.steady.backbone import backbone
from jbw.quantities import UNIT_OF, derivative_order
from jbw.verification.bands import QUANTILES, band, error
from jbw.verification.draws import Draws, Laws
from jbw.verification.noise import of_decays
from jbw.verification.predicted import Predicted, Source

SEEN = 0.5  # s of a held-out record from which its initial state is read
NUM_AMPLITUDES = 60
NO_SHIFT = 1e-6  # of omega_n: scatter of the records' frequencies where no decay was fitted
SILENT = 1e-6  # of a record: a noise that leaves its initial state sharp


def predict_decay(source: Source, test: Test) -> Predicted:
    """Free decays from their first half second on, which gives the initial state.

    Args:
        source: What is carried.
        test: Of kind decay; every record is predicted by itself.

    Returns:
        Bands over (record, quantile, time).
    """
    data = _reduced(source, test)
    unit = UNIT_OF[data.response]
    noise = of_decays(source.basis.decay, unit)
    std = noise.std or SILENT * float(np.sqrt(np.mean(np.abs(data.envelope) ** 2)))
    found = compare_decays(source, test, data, np.full(len(test.records), std))
    # The strongest record begins with this displacement, at the natural frequency.
    strongest = max(one.attrs["level"] for one in found)
    peak = strongest / source.draws["omega_n"] ** derivative_order(data.response)
    return Predicted(_together(found, source.noise), peak, noise)


def verify_decays(source: Source, test: Test, num_fitted: int) -> list[xr.Dataset]:
    """Every record of all decays beside the model's, the fitted ones first.

    Args:
        source: What is carried.
        test: All decays.
        num_fitted: How many were fitted: their noise is known, and its mean is the others'.
    """
    noise_std = source.basis.decay["noise_std"].mean(("chain", "draw")).values
    every = np.append(noise_std, np.full(len(test.records) - num_fitted, noise_std.mean()))
    return compare_decays(source, test, _reduced(source, test), every, num_fitted)


def _reduced(source: Source, test: Test) -> Decays:
    """Decays with the fraction of values that count and the scatter that the fitted ones had."""
    facts = source.basis.decay_facts
    no_shift = NO_SHIFT * float(np.mean(source.draws["omega_n"]))
    return replace(
        Decays.of(test, laws=source.basis.laws, substeps=int(facts.get("substeps", 1))),
        fraction=jnp.asarray(facts.get("worth", 1.0)),
        shift_std=jnp.asarray(facts.get("shift_std", no_shift)),
    )


def compare_decays(
    source: Source,
    test: Test,
    data: Decays,
    noise_std: Float[np.ndarray, " record"],
    num_fitted: int = 0,
) -> list[xr.Dataset]:
    """Filtered motion of every record beside the model's, entered at the record's initial state.

    The initial state of a fitted record comes from the whole of it, that of a held-out record from
    its first half second, so that the rest is predicted.

    Args:
        source: What is carried.
        test: The decays, the fitted ones first.
        data: The same reduced.
        noise_std: Noise of each record.
        num_fitted: How many were fitted.

    Returns:
        One dataset a record over (quantile, time); attributes `coverage`, `nrmse` and
        `nrmse_linear` and so on concern what was predicted: all of a fitted record, a held-out one
        after `seen_s`.
    """
    models = [_decays(_arrays(source.draws), data)]
    models += [
        _decays(_arrays(one), replace(data, laws=laws)) for one, laws in source.references.values()
    ]
    chosen, key = filter_of(test), jax.random.key(source.seed)
    found = []
    for i, (whole, noise) in enumerate(zip(envelopes(test), noise_std, strict=True)):
        held_out = i >= num_fitted
        size = max(8, round(SEEN / data.step_s)) if held_out else data.envelope.shape[1]
        seen = replace(
            data, envelope=data.envelope[i : i + 1, :size], noise_std=jnp.asarray([noise])
        )
        steps = jnp.arange(len(whole)) / chosen.step
        keys = jax.random.split(jax.random.fold_in(key, i))
        time = np.arange(len(whole)) / chosen.fs
        carrier = np.exp(2j * np.pi * chosen.centre_hz * time)
        model, *others = (
            np.real(np.asarray(_entered(keys[0], one, seen, steps)) * carrier) for one in models
        )
        attrs = {
            "level": float(np.abs(whole[0])),
            "response": data.response,
            "fitted": int(not held_out),
            "seen_s": float(size * data.step_s) if held_out else 0.0,
        }
        measured, later = np.real(whole * carrier), time >= attrs["seen_s"]
        attrs |= {
            f"nrmse_{name}": error(measured[later], other[0][later])
            for name, other in zip(source.references, others, strict=True)
        }
        start = test.settle + chosen.half / chosen.fs
        found.append(_compared(measured, model, time, start, float(noise), keys[1], attrs))
    return found


def _arrays(draws: Mapping[str, Any]) -> dict[str, Array]:
    return {name: jnp.atleast_1d(jnp.asarray(values)) for name, values in draws.items()}


@eqx.filter_jit
def _decays(draws: Mapping[str, Array], data: Decays) -> Complex[Array, "draw step"]:
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
        precision = found.precision[0] * seen.fraction / seen.noise_std[0] ** 2
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
    unit = UNIT_OF[attrs["response"]]
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


def _together(found: Sequence[xr.Dataset], noise: bool) -> xr.Dataset:
    """Records side by side, the shorter filled up with NaN; errors over all of them."""
    edges = "predictive_band" if noise else "model_band"
    inside, left, total = [], 0.0, 0.0
    for one in found:
        later = one["time"] >= float(one["time"][0]) + one.attrs["seen_s"]
        part = one.isel(time=np.flatnonzero(later))
        low, _, high = part[edges].transpose("quantile", "time").values
        measured = part["measured"].values
        inside.append((measured >= low) & (measured <= high))
        left += float(np.sum((measured - part["model_band"].values[1]) ** 2))
        total += float(np.sum(measured**2))
    far = xr.DataArray([one.attrs["nrmse"] for one in found], dims="record", attrs={"units": "1"})
    joined = xr.concat(found, "record", join="outer", combine_attrs="drop_conflicts")
    values = np.concatenate(inside)
    return joined.assign(nrmse_of_record=far).assign_attrs(
        level=max(one.attrs["level"] for one in found),
        level_unit=str(joined["measured"].attrs.get("units", "")),
        coverage=float(values.mean()),
        num_values=values.size,
        nrmse=float(np.sqrt(left / total)),
    )


def amplitude_verification(test: Test, num_fitted: int, draws: Draws, laws: Laws) -> xr.Dataset:
    r"""Frequency and damping against amplitude: read from the records, and of the model.

    $$X = \omega(Y)^p\,Y, \qquad \omega = \omega(Y), \quad \zeta_{eq} = \zeta_{eq}(Y)$$

    with the backbone of the oscillator on the right and p the order of the measured derivative.

    Args:
        test: All decays, the fitted ones first.
        num_fitted: How many were fitted.
        draws: Draws of the parameters.
        laws: Laws of the joint.

    Returns:
        Readings over (record, piece) and bands over (quantile, amplitude).

    Reference:
        Equivalent stiffness and damping of the steady loop of Eq. (2), `oscillator.backbone`.
    """
    found = readings(test)
    pieces = min(len(one.amplitude) for one in found)
    measured = {
        name: np.stack([getattr(one, name)[:pieces] for one in found])
        for name in ("amplitude", "frequency_hz", "damping")
    }
    amplitude = np.linspace(0.0, 1.05 * measured["amplitude"].max(), NUM_AMPLITUDES + 1)[1:]
    response = test.records[0].response
    centre = 2 * np.pi * filter_of(test).centre_hz
    frequency, damping = (
        np.asarray(rows)
        for rows in _backbone(
            _arrays(draws), jnp.asarray(amplitude), centre, derivative_order(response), laws
        )
    )
    unit = {"units": UNIT_OF[response], "long_name": response}
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
    draws: Mapping[str, Array],
    amplitude: Float[Array, " amplitude"],
    centre: float,
    order: int,
    laws: Laws,
) -> tuple[Float[Array, "draw amplitude"], Float[Array, "draw amplitude"]]:
    """Frequency [Hz] and damping by every draw at amplitudes of the measured response."""

    def one(theta: Mapping[str, Array]) -> tuple[Array, Array]:
        joint, omega = oscillator_of(theta, laws), jnp.full_like(amplitude, centre)
        for _ in range(3):  # the displacement of an amplitude depends weakly on the frequency
            omega = backbone(joint, amplitude / omega**order).omega
        found = backbone(joint, amplitude / omega**order)
        return found.omega / (2 * jnp.pi), found.zeta

    return jax.vmap(one)(draws)
