"""The run's result as one tree: posteriors, verification and validation, labelled, with units."""

from collections.abc import Mapping

import jax
import numpy as np
import xarray as xr

from jbw.decay_verification import amplitude_verification, decay_verification, thin_decay
from jbw.identification.linear_step import linear_dataset
from jbw.identification.procedure import Identification, Report
from jbw.identification.selection import linear_test, loop_tests, probing_tests
from jbw.identification.step import Step
from jbw.identification.third_order import integrals
from jbw.inference.summary import running_mean
from jbw.measurement.records import Test
from jbw.prediction import Draws, predict_record, thin
from jbw.validation import loop_validation
from jbw.verification import (
    frf_verification,
    kernel_verification,
    sweep_verification,
    tone_spectrum,
)

NUM_DRAWS = 100  # carried through the model: outer quantiles of 99 % bands need about as many
NUM_NOISE_DRAWS = 20  # of them through the long noise records
BAND = (0.75, 1.25)  # of the natural frequency: where FRFs are shown
Groups = dict[str, xr.Dataset]


def collect(
    tests: tuple[Test, ...],
    found: Identification,
    seed: int,
    truth: Mapping[str, float] | None,
    report: Report,
) -> xr.DataTree:
    """Gather posteriors, verification and validation into one tree.

    Args:
        tests: The campaign's tests.
        found: What the procedure found.
        seed: Seed of the predictive noise.
        truth: True parameters where the campaign is virtual: only written beside the draws.
        report: Called with one sentence at every stage.

    Returns:
        The tree that is saved as `posterior.nc`.
    """
    groups: Groups = {}
    if found.linear is not None:
        groups["/steps/linear"] = linear_dataset(found.linear)
    for name, step in found.steps.items():
        place = "" if name == found.main.name else f"/steps/{name}"
        groups |= {f"{place}/{part}": ds for part, ds in _groups(step, truth or {}).items()}
    groups |= _kernel_groups(tests, found)
    if found.sweeps is not None:
        groups |= _conv_of_velocity(groups, found)
        report("Verification: FRFs and sweeps under the measured inputs")
        groups |= _verification_groups(tests, found, seed)
        report("Validation: hysteresis loops")
        groups |= _validation_groups(tests, found)
    if found.decays is not None:
        report("Verification: free decays, frequency and damping against amplitude")
        groups |= _decay_groups(found, seed)
    tree = xr.DataTree.from_dict(groups)
    tree.attrs.update(found.main.posterior.attrs)
    return tree


def _groups(step: Step, truth: Mapping[str, float]) -> Groups:
    """The groups of one posterior, the truth beside the draws where it is known."""
    groups = {name: node.to_dataset() for name, node in step.posterior.children.items()}
    posterior = groups["posterior"].copy()
    for name in posterior.data_vars:
        if name in truth:
            posterior[name].attrs["truth"] = float(truth[str(name)])
    return {**groups, "posterior": posterior}


def _kernel_groups(tests: tuple[Test, ...], found: Identification) -> Groups:
    """Step 3: measured kernel against its bands, a spectrum, conv(n) of the kernel."""
    if found.kernel is None:
        return {}
    natural_hz = found.linear.pooled.omega_n / (2 * np.pi)
    probing = probing_tests(tests, natural_hz)
    posteriors = {}
    groups: Groups = {"/verification/spectrum": tone_spectrum(probing[len(probing) // 2])}
    for name, prefix in (("third_order_nuts", "nuts"), ("third_order_paper", "paper")):
        step = found.steps[name]
        posterior = step.posterior["posterior"].to_dataset()
        posteriors[prefix] = posterior
        energy = integrals(posterior, found.kernel.data)
        groups[f"/steps/{name}/sample_stats"] = _with_conv(step, energy, "rad m^-4 s^11")
    groups["/verification/h3"] = kernel_verification(
        found.kernel.kernels, found.kernel.data, posteriors
    )
    return groups


def _with_conv(step: Step, energy: np.ndarray, unit: str) -> xr.Dataset:
    conv = np.stack([running_mean(chain) for chain in energy])
    attrs = {"units": unit, "long_name": "running mean of the response's energy, conv(n)"}
    return step.posterior["sample_stats"].to_dataset().assign(conv=(("chain", "draw"), conv, attrs))


def _conv_of_velocity(groups: Groups, found: Identification) -> Groups:
    """conv(n) of the velocity for gamma alone: on a grid of gamma, for one response is smooth."""
    added: Groups = {}
    for name in ("opening_nuts", "opening_paper"):
        step = found.steps.get(name)
        if step is None:
            continue
        gamma = step.posterior["posterior"]["gamma"].values
        grid = np.linspace(gamma.min(), gamma.max(), 9)
        draws = {n: np.full(9, v) for n, v in _held(found, step).items()} | {"gamma": grid}
        record = found.sweeps.fitted[-1].records[0]
        energy = np.sum(predict_record(draws, record) ** 2, axis=-1) / record.fs
        smooth = np.polynomial.Polynomial.fit(grid, energy, 4)
        added[f"/steps/{name}/sample_stats"] = _with_conv(step, smooth(gamma), "m^2 s^-1")
    return added


def _held(found: Identification, step: Step) -> dict[str, float]:
    return {name: float(value) for name, value in step.held.items()}


def _verification_groups(tests: tuple[Test, ...], found: Identification, seed: int) -> Groups:
    main = found.main.posterior["posterior"].to_dataset()
    draws = thin(main, NUM_DRAWS, found.main.held)
    few = thin(main, NUM_NOISE_DRAWS, found.main.held)
    noise_std = main["noise_std"].mean(("chain", "draw")).values
    fitted = {test.name: i for i, test in enumerate(found.sweeps.fitted)}
    natural_hz = found.linear.pooled.omega_n / (2 * np.pi)
    band_hz = (BAND[0] * natural_hz, BAND[1] * natural_hz)
    key = jax.random.key(seed)
    groups: Groups = {}
    for i, test in enumerate(found.sweeps.held_out):
        level = fitted.get(test.name)
        # An unfitted level has no noise of its own: the fitted ones' mean stands for it.
        noise = float(noise_std[level] if level is not None else noise_std.mean())
        sweep = sweep_verification(test, draws, noise, jax.random.fold_in(key, i))
        frfs = frf_verification(test, draws, band_hz)
        for kind, dataset in (("sweep", sweep), ("frf", frfs)):
            dataset.attrs["fitted"] = int(level is not None)
            groups[f"/verification/{kind}/{test.name}"] = dataset
    for test in tests:
        if test.kind in ("noise", "multisine"):
            dataset = frf_verification(test, few, band_hz, substeps=1)
            dataset.attrs["fitted"] = int(test is linear_test(tests))
            groups[f"/verification/frf/{test.name}"] = dataset
    return groups


def _validation_groups(tests: tuple[Test, ...], found: Identification) -> Groups:
    natural_hz = found.linear.pooled.omega_n / (2 * np.pi)
    main = found.main.posterior["posterior"].to_dataset()
    draws: Draws = thin(main, NUM_DRAWS, found.main.held)
    return {
        f"/validation/loops/{test.name}": loop_validation(test, draws)
        for test in loop_tests(tests, natural_hz)
    }


def _decay_groups(found: Identification, seed: int) -> Groups:
    """Decays: every record against its bands, and the curves of frequency and damping."""
    posterior = found.decay.posterior["posterior"].to_dataset()
    draws = thin_decay(posterior, NUM_DRAWS)
    split = found.decays
    num_fitted = len(split.fitted.records)
    noise_std = posterior["noise_std"].mean(("chain", "draw")).values
    compared = decay_verification(
        split.together, num_fitted, draws, found.decay_data, noise_std, jax.random.key(seed)
    )
    groups: Groups = {
        f"/verification/decay/{name}": dataset
        for name, dataset in zip(split.names, compared, strict=True)
    }
    groups["/verification/amplitude"] = amplitude_verification(split.together, num_fitted, draws)
    return groups
