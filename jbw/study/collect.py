"""The run's result as one tree: posteriors, verification and validation, labelled, with units."""

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from jbw.campaign.settings import Identify
from jbw.identification.linear_step import LinearStep, linear_dataset
from jbw.identification.paper.step3 import KernelFit, integrals
from jbw.identification.procedure import Identification, Report
from jbw.identification.selection import Sweeps, fitted, loop_tests, probing_tests
from jbw.identification.step import Step
from jbw.inference.posterior.summary import running_mean
from jbw.measurement.records import Test
from jbw.observables.dataset import Dataset, largest_displacement
from jbw.verification.backbone import backbone_group
from jbw.verification.draws import NUM_DRAWS, predict_motion
from jbw.verification.kernels import kernel_verification, tone_spectrum
from jbw.verification.predicted import Source
from jbw.verification.predictive_basis import SUBSTEPS, Basis, basis_attrs, seen_of
from jbw.verification.reference_oscillators import references
from jbw.verification.verify import Groups, Tested, verify_forced, verify_free

NUM_NOISE_DRAWS = 20  # of the draws, through long noise records


def collect(
    tests: tuple[Test, ...],
    found: Identification,
    seed: int,
    truth: Mapping[str, float] | None,
    report: Report,
    settings: Identify,
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
    basis = basis_for(tests, found)
    groups |= _verified(tests, found, basis, settings, seed, report)
    curve = backbone_group(basis.thinned(NUM_DRAWS), basis.y_peak, basis.laws)
    if curve is not None:
        groups["/verification/backbone"] = curve
    tree = xr.DataTree.from_dict(groups)
    tree.attrs.update(found.main.posterior.attrs)
    tree.attrs.update(basis_attrs(basis))
    return tree


def basis_for(tests: Sequence[Test], found: Identification) -> Basis:
    """What predictions start from, as `basis_of` reads it from the result.

    Args:
        tests: The campaign's tests.
        found: What the procedure found.
    """
    posterior = found.main.posterior["posterior"].to_dataset()
    omega_n = float(posterior["omega_n"].mean()) if "omega_n" in posterior else 1.0
    decay, facts = found.decay, {}
    if found.decay_data is not None:
        facts = {n: float(getattr(found.decay_data, n)) for n in ("shift_std", "substeps")}
        facts["worth"] = float(found.decay_data.fraction)
    fitted_data = found.data or Dataset.of([found.decay_data] if found.decay_data else [])
    shared = [part for part in fitted_data.parts if not part.own_shifts]
    counts = (getattr(part, "substeps", None) for part in shared)
    steps = [count for count in counts if count is not None]
    return Basis(
        posterior,
        found.main.held,
        {test.name: seen_of(test) for test in tests},
        _largest(found, omega_n),
        tuple(np.asarray(fitted_data.scatter).tolist()),
        max(steps, default=SUBSTEPS),
        posterior if decay is None else decay.posterior["posterior"].to_dataset(),
        facts,
        fitted_data.laws,
    )


def _verified(
    tests: Sequence[Test],
    found: Identification,
    basis: Basis,
    settings: Identify,
    seed: int,
    report: Report,
) -> Groups:
    """Every test beside the model and the oscillators without hysteresis."""
    groups: Groups = {}
    kinds = settings.compare_with
    tested = tested_of(tests, found, settings)
    if found.data is not None:
        report("Verification and validation: every test against the model, and without hysteresis")
        draws, few = (basis.draws(n, seed=seed) for n in (NUM_DRAWS, NUM_NOISE_DRAWS))
        mean = {name: float(np.mean(values)) for name, values in draws.items()}
        reach = largest_displacement(found.data, mean["omega_n"])
        source = Source(basis, draws, references(found.data, mean, reach, kinds), seed=seed)
        natural_hz = mean["omega_n"] / (2 * np.pi)
        if found.linear is not None:
            natural_hz = found.linear.natural_hz
        groups |= verify_forced(source, few, tested, natural_hz)
    if found.decay_data is not None:
        report("Verification: free decays, frequency and damping against amplitude")
        draws = basis.thinned(NUM_DRAWS, basis.decay)
        known = {name: float(draws[name].mean()) for name in ("omega_n", "zeta")}
        data = Dataset.of([found.decay_data])
        others = references(data, known, float(found.decay_data.y_start), kinds)
        groups |= verify_free(Source(basis, draws, others, seed=seed), tested)
    return groups


def tested_of(tests: Sequence[Test], found: Identification, settings: Identify) -> Tested:
    """The campaign's tests by what was done with them.

    Args:
        tests: The campaign's tests.
        found: What the procedure found.
        settings: Its [identify] table.
    """
    chosen = frozenset(test.name for test in fitted(tests, settings))
    validating = () if found.linear is None else loop_tests(tests, found.linear.natural_hz)
    decays, num_fitted = None, 0
    if found.decays is not None:
        decays = found.decays.together, found.decays.names
        num_fitted = len(found.decays.fitted.records)
    compared: list[Test] = []
    if found.sweeps is not None:
        swept = {test.name for test in found.sweeps.fitted}
        others = {test.name for test in found.sweeps.held_out}
        chosen -= others - swept  # levels that are not fitted
        rest = [t for t in found.sweeps.fitted if t.name not in chosen or t.name not in others]
        compared = [*found.sweeps.held_out, *rest]
    return Tested(tests, chosen, compared, validating, decays, num_fitted)


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
        groups[f"/steps/{name}/sample_stats"] = _with_conv(steps[name], energy, "rad s^11/m^4")
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
        energy = np.sum(predict_motion(draws, record, ("bouc_wen",))[0] ** 2, axis=-1) / record.fs
        smooth = np.polynomial.Polynomial.fit(grid, energy, 4)
        added[f"/steps/{name}/sample_stats"] = _with_conv(steps[name], smooth(gamma), "m^2/s")
    return added
