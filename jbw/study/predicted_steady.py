"""Predictions of steady motion, forced loops and free decays."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.curve_verification import Curve, compare_curve
from jbw.decay_verification import NAMES, decay_verification
from jbw.measurement.channels import derivative_order
from jbw.measurement.periods import periods
from jbw.measurement.records import Test
from jbw.observables import decay, harmonics, loops, response, steady
from jbw.observables.harmonics import Group, Points
from jbw.prediction import Draws, carry
from jbw.steady_verification import compare_loop, compare_period
from jbw.study.basis import Basis
from jbw.study.known_noise import ALIKE, UNKNOWN, Noise, noise_of, or_of_repeats
from jbw.study.predicted_records import Predicted

ROUNDS = 3  # of Newton's iteration, each from the median of the draws of the one before
NO_SHIFT = 1e-6  # of omega_n: scatter of the records' frequencies where no decay was fitted
SILENT = 1e-6  # of a record: a noise that leaves its initial state sharp


def predict_curve(basis: Basis, test: Test, draws: Draws, *, noise: bool = True) -> Predicted:
    """Harmonics of a tone, a stepped sine or a response curve.

    Args:
        basis: The run.
        test: Of kind tones (one tone), stepped or frf.
        draws: Parameters of the joint and gain.
        noise: Whether the noise is looked for.
    """
    groups = _groups(test)
    data = nameless(harmonics.gather(groups))
    found = [_noise_of(basis, test, group, data, i) for i, group in enumerate(groups)]
    counts = np.sqrt(np.asarray(data.repeats.num_repeats))
    means = [(one.std or 0.0) / n if noise else 0.0 for one, n in zip(found, counts, strict=True)]
    peak = np.full(len(draws["zeta"]), float(np.max(np.abs(groups[0].motion[:, 0]))))
    if groups[0].of_force:
        model = carry(harmonics.predict, draws, data)
    else:
        motion = _motion(data, draws)
        column = np.asarray(data.position)[:, None]
        model = np.asarray(data.factor) * motion[:, np.asarray(data.point), column]
        peak = np.abs(motion[..., 0]).max(axis=-1)
    models = [model[:, i] for i in range(len(groups))]
    dataset = compare_curve(Curve(groups, test), models, [{}] * len(groups), means)
    # A ratio was measured at an amplitude that it does not tell.
    known = "ratio" not in test.records[0].provenance
    return Predicted(dataset, peak if known else None, found[0])


def _groups(test: Test) -> list[Group]:
    if test.kind == "frf":
        return [steady.curve_group(test)]
    return steady.stepped_groups(test) if test.kind == "stepped" else steady.tone_groups([test])


def _noise_of(basis: Basis, test: Test, group: Group, data: Points, row: int) -> Noise:
    """Noise of a harmonic; the fitted tones of one level share theirs."""
    label = group.label
    if test.kind == "tones" and label not in _labels(basis):
        label = f"tones {test.level:g} order {group.order}"
    return or_of_repeats(
        noise_of(basis.posterior, basis.seen, test, label, group.order), data.repeats, row
    )


def _labels(basis: Basis) -> set[str]:
    coords = basis.posterior.coords
    return {
        str(x) for name in coords if str(name).startswith("harmonic") for x in coords[name].values
    }


def _motion(data: Points, draws: Draws) -> NDArray[np.complex128]:
    """Odd harmonics of the displacement of every draw at every point.

    Newton's iteration starts from the measured motion, which is a close guess only where the model
    is right, then from the median of the draws.
    """
    motion = np.asarray(carry(harmonics.motion_of, draws, data), complex)
    for _ in range(ROUNDS - 1):
        median = np.median(np.real(motion), axis=0) + 1j * np.median(np.imag(motion), axis=0)
        data = replace(data, motion=jnp.where(np.isfinite(median), median, data.motion))
        motion = np.asarray(carry(harmonics.motion_of, draws, data), complex)
    return motion


def nameless(data: Points) -> Points:
    """Points without the names of their groups, so that tests of one shape share compiled code."""
    none = ("",) * len(data.repeats.labels)
    return replace(data, repeats=replace(data.repeats, labels=none, runs=none))


def predict_loop(basis: Basis, test: Test, draws: Draws, *, noise: bool = True) -> Predicted:
    """Force along a prescribed displacement.

    Args:
        basis: The run.
        test: Of kind loop.
        draws: Parameters of the joint and gain.
        noise: Whether the noise is looked for.
    """
    data = loops.reduce([test])
    known = or_of_repeats(noise_of(basis.posterior, basis.seen, test), data.repeats)
    mean = (known.std or 0.0) / np.sqrt(len(test.records)) if noise else 0.0
    dataset = compare_loop(test, data, carry(loops.predict, draws, data), mean)
    peak = float(jnp.max(jnp.abs(data.displacement)))
    return Predicted(dataset, np.full(len(draws["zeta"]), peak), known)


def predict_periods(basis: Basis, test: Test, draws: Draws, *, noise: bool = True) -> Predicted:
    """Steady periods of a multisine.

    Args:
        basis: The run.
        test: Of kind multisine, with at least two periods.
        draws: Parameters of the joint and gain.
        noise: Whether the noise is looked for.
    """
    cut = periods(test) or test
    data = response.reduce([cut], substeps=basis.substeps, periodic=True)
    model = carry(response.predict, draws, data)
    known = or_of_repeats(noise_of(basis.posterior, basis.seen, test), data.repeats)
    mean = (known.std or 0.0) / np.sqrt(len(cut.records)) if noise else 0.0
    dataset = compare_period(cut, data, model, mean, band_hz=test.band_hz)
    # One period of a steady motion is differentiated and integrated line by line.
    omega = 2 * np.pi * np.fft.rfftfreq(model.shape[-1], 1 / data.fs)
    lines = np.fft.rfft(model[:, 0])[:, 1:] / (1j * omega[1:]) ** derivative_order(data.response)
    y = np.fft.irfft(np.pad(lines, ((0, 0), (1, 0))), model.shape[-1])
    return Predicted(dataset, np.abs(y).max(axis=-1), known)


def predict_decay(
    basis: Basis, test: Test, num_draws: int, *, noise: bool = True, seed: int = 0
) -> Predicted:
    """Free decays from their first half second on, which gives the initial state.

    Args:
        basis: The run.
        test: Of kind decay; every record is predicted by itself.
        num_draws: Draws of the posterior.
        noise: Whether the noise is looked for.
        seed: Of initial states and noise.

    Returns:
        Bands over (record, quantile, time).
    """
    draws = _products(basis, num_draws)
    data = decay.reduce(test, substeps=1)
    facts = basis.decay_facts
    shift_std = facts.get("shift_std", NO_SHIFT * float(np.mean(draws["omega_n"])))
    data = replace(
        data,
        worth=jnp.asarray(facts.get("worth", 1.0)),
        shift_std=jnp.asarray(shift_std),
    )
    known = _noise_of_decays(basis, data.response)
    std = known.std or SILENT * float(np.sqrt(np.mean(np.abs(data.envelope) ** 2)))
    found = decay_verification(test, 0, draws, data, np.array([std]), jax.random.key(seed))
    return Predicted(_together(found, noise), _peaks(found, draws, data.response), known)


def _products(basis: Basis, num_draws: int) -> dict[str, jax.Array]:
    """Draws of omega_n, zeta and the products that decays are sampled in."""
    draws = basis.thinned(num_draws, basis.decay)
    square = draws["omega_n"] ** 2
    share = draws["alpha"] / square
    every = {
        **draws,
        "share": share,
        "softening": share * draws["delta"],
        "opening": share * draws["gamma"],
    }
    return {name: jnp.asarray(every[name]) for name in (*NAMES, "cubic") if name in every}


def _noise_of_decays(basis: Basis, kind: str) -> Noise:
    """Mean noise of the fitted records."""
    stored = basis.decay.get("noise_std")
    units = {"displacement": "m", "velocity": "m s-1", "acceleration": "m s-2"}
    if stored is None or "record" not in stored.dims or stored.attrs.get("units") != units[kind]:
        return Noise(None, UNKNOWN)
    return Noise(float(stored.mean()), ALIKE)


def _together(found: list[xr.Dataset], noise: bool) -> xr.Dataset:
    """Records side by side, the shorter filled up with NaN; errors over all of them."""
    band = "predictive_band" if noise else "model_band"
    inside, left, total = [], 0.0, 0.0
    for one in found:
        later = one["time"] >= float(one["time"][0]) + one.attrs["seen_s"]
        part = one.isel(time=np.flatnonzero(later))
        low, _, high = part[band].transpose("quantile", "time").values
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


def _peaks(found: list[xr.Dataset], draws: dict[str, jax.Array], kind: str) -> np.ndarray:
    """Displacement that the strongest record begins with, at the natural frequency."""
    strongest = max(one.attrs["level"] for one in found)
    return strongest / np.asarray(draws["omega_n"]) ** derivative_order(kind)
