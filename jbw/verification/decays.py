"""Comparison of free decays with the model's motion from each record's initial state."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Complex, Float, Key

from jbw.identification.discrepancy import NOTHING, AtAmplitude
from jbw.inference.generator import generator
from jbw.measurement.envelopes import bands_of, envelopes, filter_of
from jbw.measurement.records import Test
from jbw.observables.decay import Decays, begun, counting, decays_at, num_begun
from jbw.observables.decay_envelopes import follow
from jbw.observables.effective_values import white_square
from jbw.observables.groups import changed
from jbw.observables.modal_decays import MatchedEnvelopes, ModalDecays, match, modal_envelopes
from jbw.observables.modes import Modes
from jbw.oscillator.modes.parameters import structure_of
from jbw.quantities import UNIT_OF, derivative_order, in_dialect
from jbw.results.attributes import PredictedTest, StoredVariable
from jbw.verification.bands import (
    QUANTILE_AXIS,
    band,
    error,
    half_width,
    noisy_band,
    recentred,
    within,
)
from jbw.verification.places import repeats_named
from jbw.verification.predicted import (
    ALIKE,
    NOT_KNOWN,
    Predicted,
    RepeatNoise,
    Source,
    carry,
    noise_by_label,
)
from jbw.verification.predictive_basis import Draws, Laws, count_of, natural_hz

Envelope = Complex[np.ndarray, "*draw time"]
Envelopes = dict[str, Envelope]
# A function of a random key, the section of a record that determines its initial state, the times
# [s], and the law's initial frequency error [rad/s]. It returns the envelopes of all draws and
# reference models.
Entered = Callable[
    [Key[Array, ""], Decays, Float[np.ndarray, " time"], float], tuple[Envelope, Envelopes]
]
OWN = "own_{}"  # name of a draw's standard normal deviation from the best initial state
# relative standard deviation of frequency between records, assumed if no decay was fitted
NO_SHIFT = 1e-6
MISSED_KEY = 1  # number from which the random key of the model discrepancy is derived
# number of iterations for a record's own natural frequency; each one reduces the phase error
# tenfold
OWN_STEPS = 8
# noise relative to the record's rms, so small that the initial state follows the record
SILENT = 1e-6
LOT = 256  # number of draws whose decays are matched in one call


def predict_decay(source: Source, test: Test) -> Predicted:
    """Predict free decays from their start, until they have lost a quarter of their amplitude."""
    data = _reduced(source, test)
    noise, stored = NOT_KNOWN, source.basis.decay.get("noise_std")
    if stored is not None and "record" in stored.dims:
        if in_dialect(StoredVariable.of(stored).units) == UNIT_OF[data.response]:
            draws = [str(dim) for dim in stored.dims if dim != "record"]
            noise = RepeatNoise(float(stored.mean(draws).median()), ALIKE)
    std = noise.std or SILENT * float(np.sqrt(np.mean(np.abs(data.mean) ** 2)))
    compared = _compared(source, test, data, np.full(len(test.records), std))
    # The starting displacement is that of the strongest record, at the natural frequency.
    order = derivative_order(data.response)
    levels, nrmse, own, coverage, counts = (
        np.array([comparison.attrs[name] for comparison in compared])
        for name in ("level", "nrmse", "nrmse_own_frequency", "coverage", "num_values")
    )
    strongest = float(levels.max())
    peak = strongest / source.draws["omega_n"] ** order
    unit = source.omega_n**order
    begins = tuple((levels / unit).tolist())
    band_name = "predictive_band" if source.noise else "model_band"
    late = [
        comparison.isel(time=time >= time[0] + PredictedTest.of(comparison).seen_s)
        for comparison in compared
        for time in [comparison["time"]]
    ]
    responses = [comparison["measured"].values for comparison in late]
    measured = np.concatenate(responses)
    median = np.concatenate([comparison["model_band"].values[1] for comparison in late])
    edges = np.concatenate([comparison[band_name].values for comparison in late], axis=1)
    far = xr.DataArray(nrmse, dims="record", attrs={"units": "1"})
    squares = np.array([np.sum(response**2) for response in responses])
    joined = xr.concat(compared, "record", join="outer", combine_attrs="drop_conflicts")
    of_records = {"nrmse_of_record": far, "nrmse_own_of_record": far.copy(data=own)}
    dataset = joined.assign(of_records).assign_coords(record=repeats_named(test.records))
    dataset = dataset.assign_attrs(
        level=strongest,
        level_unit=UNIT_OF[data.response],
        coverage=float(np.average(coverage, weights=counts)),
        num_values=int(counts.sum()),
        nrmse=error(measured, median),
        nrmse_own_frequency=float(np.sqrt(own**2 @ squares / squares.sum())),
        half_width=half_width(edges, measured),
    )
    return Predicted(dataset, peak, noise, begins)


def verify_decays(source: Source, test: Test, num_fitted: int) -> list[xr.Dataset]:
    """Compare each free decay with the model; return one dataset per record, fitted ones first."""
    # The initial state of a fitted record comes from the whole record. That of a held-out record
    # comes only from its start; the remaining part is predicted, and errors refer to that part.
    data = _reduced(source, test)
    noise_of_label = noise_by_label(source.basis.decay)
    noise_std = np.array([noise_of_label[label] for label in data.groups.labels[:num_fitted]])
    of_others = np.full(len(test.records) - num_fitted, np.median(noise_std))
    return _compared(source, test, data, np.append(noise_std, of_others), num_fitted)


def _reduced(source: Source, test: Test) -> Decays:
    """Return decays as the likelihood needs them, with the settings of the fit."""
    facts = source.basis.decay_facts
    no_shift = NO_SHIFT * source.omega_n
    stated = {"laws": source.basis.laws, "substeps": facts.substeps or None}
    modes = modes_of_draws(source.draws)
    data = (
        Decays.of(test, **stated) if modes is None else ModalDecays.of(test, **stated, modes=modes)
    )
    shift_std = jnp.asarray(no_shift if facts.shift_std is None else facts.shift_std)
    return counting(replace(data, shift_std=shift_std), facts.worth)


def _compared(
    source: Source,
    test: Test,
    data: Decays,
    noise_std: Float[np.ndarray, " record"],
    num_fitted: int = 0,
) -> list[xr.Dataset]:
    """Compare the filtered motion of each record with the model's, for the same initial state."""
    chosen, key, comparisons = filter_of(test), jax.random.key(source.seed), []
    several = bool(data.several)
    entered, stride = (followed(source), chosen.stride) if several else (_along(source, data), 1)
    omega_n = source.omega_n
    unit, dims = {"units": UNIT_OF[data.response]}, ("quantile", "time")
    for i, (sampled, noise) in enumerate(zip(envelopes(test), noise_std, strict=True)):
        measured_envelope = sampled[::stride]
        held_out = i >= num_fitted
        size = num_begun(source.draws, data) if held_out else data.lengths[i]
        seen_s = float(size * data.step_s) if held_out else 0.0
        # All records get the same name, because names are part of a compiled program; one program
        # is then enough.
        only, name = data.only(i, size), ("record",)
        groups = changed(only.groups, labels=name, runs=name, noise_std=np.array([noise]))
        seen = replace(only, groups=groups)
        time = np.arange(len(measured_envelope)) * stride / chosen.fs
        key_entry, key_other = jax.random.split(jax.random.fold_in(key, i))
        carrier = np.exp(2j * np.pi * chosen.centre_hz * time)
        missed = source.basis.discrepancy if held_out else None
        begin, end = (
            float(np.abs(measured_envelope[k])) / omega_n ** derivative_order(data.response)
            for k in (0, np.searchsorted(time[:-1], seen_s))
        )
        # The discrepancy is taken at two amplitudes: where the record begins, and where its
        # prediction begins.
        at_begin, at = (
            NOTHING if missed is None else missed.at(y, of_decay=True) for y in (begin, end)
        )
        envelope, others = entered(key_entry, seen, time, omega_n * at_begin.frequency)
        own = at_own_frequency(measured_envelope, envelope, time - 0.5 * seen_s)
        own_error = error(*(np.real(x * carrier)[time >= seen_s] for x in (measured_envelope, own)))
        if held_out:
            # Each measurement has its own noise: the noise of the fitted records may be smaller.
            missing = (measured_envelope - own)[time >= seen_s][:: chosen.step // stride]
            noise = max(noise, np.sqrt(white_square(missing) / 2))
        model, scatter = np.real(envelope * carrier), noise
        if missed is not None and not missed.is_nothing:
            key_missed, since = jax.random.fold_in(key_other, MISSED_KEY), time - 0.5 * seen_s
            model, size = _with_discrepancy(key_missed, envelope, since, omega_n, at, carrier)
            scatter = np.hypot(noise, missed.share_of(test.kind, at) * size)
        measured, later = np.real(measured_envelope * carrier), time >= seen_s
        model_band = band(model)
        predictive = noisy_band(model, scatter)
        edges = (predictive if source.noise else model_band)[:, later]
        inside = within(measured[later], edges)
        variables = {
            "measured": ("time", measured, {**unit, "long_name": "measured, in the band"}),
            "model_band": (dims, model_band, unit),
            "predictive_band": (dims, predictive, unit),
        }
        start = test.settle + chosen.half / chosen.fs
        coords = {"time": ("time", start + time, {"units": "s"}), "quantile": QUANTILE_AXIS}
        attrs = {
            "level": float(np.abs(measured_envelope[0])),
            "level_unit": UNIT_OF[data.response],
            "response": data.response,
            "fitted": int(not held_out),
            "seen_s": seen_s,
            "coverage": float(inside.mean()),
            "num_values": inside.size,
            "nrmse": error(measured[later], model_band[1][later]),
            "nrmse_own_frequency": own_error,
            "half_width": half_width(edges, measured[later]),
        }
        for name, other in others.items():
            attrs[f"nrmse_{name}"] = error(measured[later], np.real(other * carrier)[later])
        comparisons.append(xr.Dataset(variables, coords, attrs))
    return comparisons


def at_own_frequency(
    measured: Complex[np.ndarray, " time"],
    envelope: Complex[np.ndarray, "draw time"],
    time: Float[np.ndarray, " time"],
) -> Complex[np.ndarray, " time"]:
    r"""Return the median predicted envelope, with the record's own natural frequency.

    $$\hat e(t)\,e^{j \delta t}, \qquad
      \delta = \arg\min \sum_t |m(t) - \hat e(t)\,e^{j \delta t}|^2$$

    The phase error is iterated, weighted with both amplitudes. Time counts from the middle of the
    part that determines the initial state.
    """
    middle = np.median(np.real(envelope), axis=0) + 1j * np.median(np.imag(envelope), axis=0)
    for _ in range(OWN_STEPS):
        product = measured * np.conj(middle)
        weight = np.abs(product)
        offset = np.sum(weight * time * np.angle(product)) / np.sum(weight * time**2)
        middle = middle * np.exp(1j * offset * time)
    return middle


def _with_discrepancy(
    key: Key[Array, ""],
    envelope: Complex[np.ndarray, "draw time"],
    time: Float[np.ndarray, " time"],
    omega_n: float,
    missed: AtAmplitude,
    carrier: Complex[np.ndarray, " time"],
) -> tuple[Float[np.ndarray, "draw time"], Float[np.ndarray, " time"]]:
    """Return decays with random errors of rate and frequency, and the errors' rms per period.

    The decays are those of `drifted`, centred on the law's prediction.
    """
    rates = omega_n * np.array([missed.damping, missed.frequency])
    law, drifting = np.real(envelope * carrier), drifted(key, envelope, time, rates)
    size = np.median(np.abs(drifting), axis=0) / np.sqrt(2)
    return recentred(np.real(drifting * carrier), np.median(law, axis=0)), size


def drifted(
    key: Key[Array, ""],
    envelope: Complex[np.ndarray, "draw time"],
    time: Float[np.ndarray, " time"],
    rates: Float[np.ndarray, "2"],
) -> Complex[np.ndarray, "draw time"]:
    r"""Add random errors of decay rate and frequency [1/s] to given envelopes.

    $$e_k(t)\,\exp\bigl((-\rho_\zeta z_{k1} + j \rho_\omega z_{k2})\,t\bigr), \quad z \sim N(0, I)$$

    Time counts from the middle of the part that determines the initial state.
    """
    rate_draws = rates * generator(key).standard_normal((len(envelope), 2))
    return envelope * np.exp(np.multiply.outer(-rate_draws[:, 0] + 1j * rate_draws[:, 1], time))


def _along(source: Source, data: Decays) -> Entered:
    """Return a function that predicts records of one mode for all draws and reference models."""
    decays, others = source.carried(lambda draws, laws: decays_at(draws, replace(data, laws=laws)))

    def entered(
        key: Key[Array, ""], seen: Decays, time: np.ndarray, law_std: float
    ) -> tuple[Envelope, Envelopes]:
        envelope, noise_std = np.asarray(seen.mean[0]), float(seen.groups.noise_std[0])
        step_s = float(seen.step_s)

        def continued(rows: np.ndarray, normal: np.ndarray, law_std: float) -> np.ndarray:
            """Return the record's envelope, from a random initial state and frequency shift."""
            initial = begun(rows, envelope, noise_std, seen, law_std)
            change = np.linalg.cholesky(initial.covariance) @ normal[..., None]
            return follow(rows, initial.moved(change[..., 0]), time / step_s, step_s)[0]

        normal = generator(key).standard_normal((len(decays), 3))
        lots = range(0, len(decays), LOT)  # Small lots need little memory.
        drawn = [continued(decays[i : i + LOT], normal[i : i + LOT], law_std) for i in lots]
        of_others = {
            name: continued(rows[None], normal[:1], 0.0)[0] for name, rows in others.items()
        }
        return np.concatenate(drawn), of_others

    return entered


def modes_of_draws(draws: Draws) -> Modes | None:
    """Return the modes with the mean frequencies of the draws; None for a single mode."""
    hz = tuple(natural_hz(draws))
    return Modes(hz) if len(hz) > 1 else None


def first_mode_alone(test: Test, modes: Modes | None) -> Test:
    """Return decays restricted to the band of the first of several modes."""
    return test if modes is None else replace(test, band_hz=bands_of(modes.hz, test)[0])


def followed(source: Source) -> Entered:
    """Return a function that predicts records of several modes, with an initial state per draw."""

    def entered(
        key: Key[Array, ""], seen: Decays, time: Float[np.ndarray, " time"], law_std: float
    ) -> tuple[Envelope, Envelopes]:
        def along(draws: Draws, laws: Laws) -> Envelope:
            size = (count_of(draws), seen.groups.num_own)
            draws_of_start = np.asarray(jax.random.normal(key, size)) * (size[0] > 1)
            white = {OWN.format(i): column for i, column in enumerate(draws_of_start.T)}
            return carry(_follow, {**draws, **white}, replace(seen, laws=laws), len(time))

        return source.carried(along)

    return entered


def _follow(theta: Mapping[str, Array], seen: ModalDecays, length: int) -> Complex[Array, " time"]:
    """Return a record's envelope for one draw of its initial state and frequency shift."""
    structure = structure_of(theta, seen.laws)
    num_values = seen.groups.size[0] / 2
    record = MatchedEnvelopes(seen.mean[0], seen.begun[0], seen.amplitude[0], num_values)
    matched = match(structure, record, seen)
    start = jnp.append(matched.entry.state, matched.entry.shift)
    # As for one mode: a short part of a record determines the initial state, with an uncertainty
    # that follows from the noise of the fitted records. The frequency shift also has a prior.
    precision = matched.precision * seen.fraction / seen.groups.noise_std[0] ** 2
    covariance = jnp.linalg.inv(precision.at[-1, -1].add(1 / seen.shift_std**2))
    centre = -covariance[:, -1] * matched.entry.shift / seen.shift_std**2
    off = jnp.stack([theta[OWN.format(i)] for i in range(seen.groups.num_own)])
    start = start + centre + jnp.linalg.cholesky(covariance) @ off
    full_rate = replace(
        seen,
        stride=1,
        step_s=1 / seen.fs,
        rotation=jnp.exp(-2j * jnp.pi * seen.centre_hz / seen.fs),
        num_samples=length + len(seen.taps) - 1,
    )
    return modal_envelopes(structure, start, full_rate).sum(axis=0)
