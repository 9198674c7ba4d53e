"""The run's result as one tree: posteriors, verification and validation, labelled, with units."""

from collections.abc import Mapping

import jax
import numpy as np
import xarray as xr

from jbw.decay_verification import amplitude_verification, decay_verification, thin_decay
from jbw.identification.linear_step import LinearStep, linear_dataset
from jbw.identification.procedure import Identification, Report
from jbw.identification.selection import DecaySplit, Sweeps, loop_tests, probing_tests
from jbw.identification.step import Step
from jbw.identification.third_order import KernelFit, integrals
from jbw.inference.summary import running_mean
from jbw.measurement.records import Test
from jbw.observables.decay import Decays
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
    if found.linear is not None and found.kernel is not None:
        groups |= _kernel_groups(tests, found.linear, found.kernel, found.steps)
    if found.linear is not None and found.sweeps is not None:
        groups |= _conv_of_velocity(found.steps, found.sweeps)
        report("Verification: FRFs and sweeps under the measured inputs")
        groups |= _verification_groups(tests, found.linear, found.sweeps, found.main)
        report("Validation: hysteresis loops")
        groups |= _validation_groups(tests, found.linear, found.main)
    if found.decays is not None and found.decay is not None and found.decay_data is not None:
        report("Verification: free decays, frequency and damping against amplitude")
        groups |= _decay_groups(found.decays, found.decay, found.decay_data, seed)
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


def _kernel_groups(
    tests: tuple[Test, ...], linear: LinearStep, kernel: KernelFit, steps: Mapping[str, Step]
) -> Groups:
    """Step 3: measured kernel against its bands, a spectrum, conv(n) of the kernel."""
    probing = probing_tests(tests, linear.natural_hz)
    groups: Groups = {"/verification/spectrum": tone_spectrum(probing[len(probing) // 2])}
    posteriors = {}
    for name, prefix in (("third_order_nuts", "nuts"), ("third_order_paper", "paper")):
        posteriors[prefix] = steps[name].posterior["posterior"].to_dataset()
        energy = integrals(posteriors[prefix], kernel.data)
        groups[f"/steps/{name}/sample_stats"] = _with_conv(steps[name], energy, "rad m^-4 s^11")
    groups["/verification/h3"] = kernel_verification(kernel.kernels, kernel.data, posteriors)
    return groups


def _with_conv(step: Step, energy: np.ndarray, unit: str) -> xr.Dataset:
    conv = np.stack([running_mean(chain) for chain in energy])
    attrs = {"units": unit, "long_name": "running mean of the response's energy, conv(n)"}
    return step.posterior["sample_stats"].to_dataset().assign(conv=(("chain", "draw"), conv, attrs))


def _conv_of_velocity(steps: Mapping[str, Step], sweeps: Sweeps) -> Groups:
    """conv(n) of the velocity for gamma alone: its energy is a smooth function of gamma."""
    record = sweeps.fitted[-1].records[0]
    added: Groups = {}
    for name in {"opening_nuts", "opening_paper"} & set(steps):
        gamma = np.asarray(steps[name].posterior["posterior"].to_dataset()["gamma"])
        grid = np.linspace(gamma.min(), gamma.max(), 9)
        draws = {n: np.full(9, v) for n, v in steps[name].held.items()} | {"gamma": grid}
        energy = np.sum(predict_record(draws, record) ** 2, axis=-1) / record.fs
        smooth = np.polynomial.Polynomial.fit(grid, energy, 4)
        added[f"/steps/{name}/sample_stats"] = _with_conv(steps[name], smooth(gamma), "m^2 s^-1")
    return added


def _verification_groups(
    tests: tuple[Test, ...], linear: LinearStep, sweeps: Sweeps, main: Step
) -> Groups:
    """FRFs of noise and sweeps, and the sweeps, that were not fitted, against their bands."""
    posterior = main.posterior["posterior"].to_dataset()
    draws, few = (thin(posterior, n, main.held) for n in (NUM_DRAWS, NUM_NOISE_DRAWS))
    noise_std = posterior["noise_std"].mean(("chain", "draw")).values
    fitted = {test.name: i for i, test in enumerate(sweeps.fitted)}
    band_hz = (BAND[0] * linear.natural_hz, BAND[1] * linear.natural_hz)
    groups: Groups = {}
    for test in sweeps.held_out:
        level = fitted.get(test.name)
        # An unfitted level has no noise of its own: the fitted ones' mean stands for it.
        noise = float(noise_std[level] if level is not None else noise_std.mean())
        groups[f"/verification/sweep/{test.name}"] = sweep_verification(test, draws, noise)
        groups[f"/verification/frf/{test.name}"] = frf_verification(test, draws, band_hz)
    for test in tests:
        if test.kind in ("noise", "multisine"):
            dataset = frf_verification(test, few, band_hz, substeps=1)
            groups[f"/verification/frf/{test.name}"] = dataset
    read = {*fitted, linear.test.name}
    for path, dataset in groups.items():
        dataset.attrs["fitted"] = int(path.rsplit("/", 1)[-1] in read)
    return groups


def _validation_groups(tests: tuple[Test, ...], linear: LinearStep, main: Step) -> Groups:
    """Hysteresis loops of every tone near the resonance."""
    draws: Draws = thin(main.posterior["posterior"].to_dataset(), NUM_DRAWS, main.held)
    return {
        f"/validation/loops/{test.name}": loop_validation(test, draws)
        for test in loop_tests(tests, linear.natural_hz)
    }


def _decay_groups(decays: DecaySplit, step: Step, data: Decays, seed: int) -> Groups:
    """Decays: every record against its bands, and the curves of frequency and damping."""
    posterior = step.posterior["posterior"].to_dataset()
    draws = thin_decay(posterior, NUM_DRAWS)
    num_fitted = len(decays.fitted.records)
    noise_std = posterior["noise_std"].mean(("chain", "draw")).values
    compared = decay_verification(
        decays.together, num_fitted, draws, data, noise_std, jax.random.key(seed)
    )
    groups: Groups = {
        f"/verification/decay/{name}": dataset
        for name, dataset in zip(decays.names, compared, strict=True)
    }
    groups["/verification/amplitude"] = amplitude_verification(decays.together, num_fitted, draws)
    return groups
