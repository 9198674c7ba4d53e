"""The run's result as one tree: posteriors, verification and validation, labelled, with units."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
import xarray as xr

from jbw.decay_verification import amplitude_verification, decay_verification, thin_decay
from jbw.identification.linear_step import LinearStep, linear_dataset
from jbw.identification.procedure import Identification, Report
from jbw.identification.selection import DecaySplit, Sweeps, probing_tests
from jbw.identification.starts import largest_displacement
from jbw.identification.step import Step
from jbw.identification.third_order import KernelFit, integrals
from jbw.inference.summary import running_mean
from jbw.measurement.records import Test
from jbw.observables.decay import Decays
from jbw.observables.evidence import evidence
from jbw.prediction import predict_record, thin
from jbw.reference import references
from jbw.study.backbone import backbone_group
from jbw.study.basis import basis_attrs
from jbw.study.reach import mark_reach
from jbw.study.verifying import DEFAULT, NUM_DRAWS, Groups, forced_groups, place
from jbw.verification import kernel_verification, tone_spectrum


def collect(
    tests: tuple[Test, ...],
    found: Identification,
    seed: int,
    truth: Mapping[str, float] | None,
    report: Report,
    settings: Mapping[str, Any] | None = None,
) -> xr.DataTree:
    """Gather posteriors, verification and validation into one tree.

    Args:
        tests: The campaign's tests.
        found: What the procedure found.
        seed: Seed of the predictive noise.
        truth: True parameters where the campaign is virtual: only written beside the draws.
        report: Called with one sentence at every stage.
        settings: The campaign's [identify] table.

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
    if found.sweeps is not None:
        groups |= _conv_of_velocity(found.steps, found.sweeps)
    if found.data is not None:
        groups |= forced_groups(tests, settings or {}, found, found.data, seed, report)
    if found.decays is not None and found.decay is not None and found.decay_data is not None:
        report("Verification: free decays, frequency and damping against amplitude")
        kinds = (settings or {}).get("compare_with", DEFAULT)
        groups |= _decay_groups(found.decays, found.decay, found.decay_data, seed, kinds)
    posterior = found.main.posterior["posterior"].to_dataset()
    omega_n = float(posterior["omega_n"].mean()) if "omega_n" in posterior else 1.0
    y_peak = _largest(found, omega_n)
    mark_reach(groups, tests, y_peak, omega_n)
    curve = backbone_group(thin(posterior, NUM_DRAWS, found.main.held), y_peak)
    if curve is not None:
        groups["/verification/backbone"] = curve
    tree = xr.DataTree.from_dict(groups)
    tree.attrs.update(found.main.posterior.attrs)
    tree.attrs.update(basis_attrs(tests, found), y_peak=y_peak)
    return tree


def _largest(found: Identification, omega_n: float) -> float:
    """Largest displacement among what was fitted [m], as far as the joint was seen."""
    if found.data is None:
        return float(found.decay_data.y_start) if found.decay_data is not None else 0.0
    return largest_displacement(found.data, omega_n)


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


def _decay_groups(
    decays: DecaySplit, step: Step, data: Decays, seed: int, kinds: Sequence[str]
) -> Groups:
    """Decays: every record against its bands, and the curves of frequency and damping."""
    posterior = step.posterior["posterior"].to_dataset()
    draws = thin_decay(posterior, NUM_DRAWS)
    num_fitted = len(decays.fitted.records)
    noise_std = posterior["noise_std"].mean(("chain", "draw")).values
    known = {name: float(draws[name].mean()) for name in ("omega_n", "zeta")}
    others = references(evidence([data]), known, float(data.y_start), kinds)
    compared = decay_verification(
        decays.together, num_fitted, draws, data, noise_std, jax.random.key(seed), others
    )
    groups: Groups = {
        place("verification/decay", name): dataset
        for name, dataset in zip(decays.names, compared, strict=True)
    }
    groups["/verification/amplitude"] = amplitude_verification(decays.together, num_fitted, draws)
    return groups
