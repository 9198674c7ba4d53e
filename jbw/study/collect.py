"""The run's result as one tree: posteriors, verification and validation, labelled, with units."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
import xarray as xr

from jbw.errors import Attempts
from jbw.identification.assemble import Measured
from jbw.identification.joint import JointPosterior
from jbw.identification.joint_answers import JOINTS
from jbw.identification.linear_step import LinearStep, linear_dataset, modes_dataset
from jbw.identification.paper import step3, step4
from jbw.identification.paper.step3 import KernelFit
from jbw.identification.procedure import Posteriors
from jbw.identification.selection import Sweeps, probing_tests
from jbw.identification.step import Step
from jbw.identification.tied_joints import tied_evidence, tied_laws
from jbw.inference.posterior.summary import running_mean
from jbw.measurement.records import Test
from jbw.observables.decay import Decays
from jbw.quantities import DEFAULT_LAWS, derivative_order
from jbw.report.messages import stages
from jbw.report.messages import study as messages
from jbw.study.arviz_groups import arviz_groups, created
from jbw.study.order import Order
from jbw.verification.backbone import backbone_group
from jbw.verification.bands import QUANTILE_AXIS, polar
from jbw.verification.in_time import predict_motion
from jbw.verification.predictive_basis import NUM_DRAWS, basis_attrs, basis_of, decay_attrs
from jbw.verification.verify import Groups, verify

TIED_KEY = 300  # of the seed: of the evidence of one law for several joints
SPECTRUM = 4.2  # of the tone: the highest frequency of its spectrum shown


def collect(
    order: Order, measured: Measured, posteriors: Posteriors, attempts: Attempts
) -> xr.DataTree:
    """Posteriors, verification and validation, labelled, with units.

    What stands beside the posteriors and cannot be made is left out, and `attempts` says so.
    """
    tests, joint, seed = measured.tests, posteriors.joint, order.seed
    groups = _drawn_groups(measured, posteriors, order.truth or {})
    linear, kernel, sweeps = measured.linear, posteriors.paper.kernel, measured.sweeps
    steps = posteriors.paper.steps
    if linear is not None and kernel is not None:
        groups |= attempts.make(
            stages.KERNEL, lambda: _kernel_groups(tests, linear, kernel, steps), {}
        )
    if sweeps is not None:
        groups |= attempts.make(stages.ENERGY, lambda: _conv_of_velocity(steps, sweeps), {})
    basis = basis_of(xr.DataTree.from_dict(groups))
    groups |= attempts.make(
        stages.TESTS,
        lambda: verify(measured, posteriors, basis, seed, attempts),
        {},
    )
    curve = attempts.make(
        stages.BACKBONE,
        lambda: backbone_group(basis.thinned(NUM_DRAWS), basis.y_peak, basis.laws),
        None,
    )
    if curve is not None:
        groups["/verification/backbone"] = curve
    drawn = {name: created(groups[name]) for name in ("/posterior", "/sample_stats")}
    by_record: Groups = {}
    if not posteriors.checks.sees_no_joint:  # single records say nothing of a linear structure
        attempts.report(stages.SINGLE_RECORDS)
        by_record = attempts.make(
            stages.RECORD_LIKELIHOOD, lambda: arviz_groups(measured, joint, seed), {}
        )
    groups |= drawn | by_record
    return xr.DataTree.from_dict(groups | _tied_joints(order, joint, groups, attempts))


def _drawn_groups(measured: Measured, posteriors: Posteriors, truth: Mapping[str, float]) -> Groups:
    """Step 2 and every posterior, the joint one at the root."""
    joint = posteriors.joint
    facts = joint.tree.attrs | run_attrs(measured.tests, joint, posteriors.free.data)
    groups: Groups = {"/": xr.Dataset(attrs=facts)}
    if measured.linear is not None:
        groups["/steps/linear"] = linear_dataset(measured.linear)
        modes = modes_dataset(measured.linear)
        groups |= {} if modes is None else {"/modes": modes}
    free = posteriors.free.step
    drawn = {f"/steps/{name}": groups_in(step.posterior) for name, step in
             posteriors.paper.steps.items()}  # fmt: skip
    drawn[""] = {**groups_in(joint.tree), **posteriors.checks.groups}
    drawn |= {} if free is None else {f"/steps/{free.name}": groups_in(free.posterior)}
    for place, parts in drawn.items():
        groups |= {f"{place}/{name}": part for name, part in _with_truth(parts, truth).items()}
    return groups


def groups_in(tree: xr.DataTree) -> Groups:
    """The groups of one posterior by name."""
    return {name: node.to_dataset() for name, node in tree.children.items()}


def _tied_joints(order: Order, joint: JointPosterior, groups: Groups, attempts: Attempts) -> Groups:
    """The joints' group that says whether joints of one kind of law share one; of one, nothing."""
    fitted, place = joint.fitted, f"/{JOINTS}"
    if place not in groups or tied_laws(fitted.data.laws) == fitted.data.laws:
        return {}
    attempts.report(stages.TIED)
    key = jax.random.fold_in(jax.random.key(order.seed), TIED_KEY)
    settings = order.campaign.settings
    tied = attempts.make(stages.TIED, lambda: tied_evidence(key, fitted, settings), None)
    return {} if tied is None else {place: groups[place].assign_attrs(tied.attrs)}


def run_attrs(
    tests: Sequence[Test], joint: JointPosterior, decays: Decays | None
) -> dict[str, Any]:
    """What predictions start from besides draws, as `basis_of` reads it from the result."""
    posterior = joint.draws
    omega_n = float(posterior["omega_n"].mean()) if "omega_n" in posterior else 1.0
    attrs = basis_attrs(tests, joint.fitted.data, joint.held, omega_n)
    return attrs | ({} if decays is None else decay_attrs(decays))


def _with_truth(parts: Groups, truth: Mapping[str, float]) -> Groups:
    """The groups of one posterior, the truth beside the draws where it is known."""
    groups = dict(parts)
    posterior = groups["posterior"].copy()
    for name in posterior.data_vars:
        if name in truth:
            posterior[name].attrs["truth"] = float(truth[str(name)])
    if "leave_one_out" in groups:
        groups["leave_one_out"] = _with_units(groups["leave_one_out"], posterior)
    return {**groups, "posterior": posterior}


def _with_units(left_out: xr.Dataset, posterior: xr.Dataset) -> xr.Dataset:
    """Fits without a run, whose parameters have the units of their draws."""
    units = {"group_units": [posterior[n].attrs["units"] for n in left_out["parameter"].values]}
    return left_out.assign({n: left_out[n].assign_attrs(units) for n in ("estimate", "std")})


def _kernel_groups(
    tests: tuple[Test, ...], linear: LinearStep, third_order: KernelFit, steps: Mapping[str, Step]
) -> Groups:
    """Step 3: measured kernel against its bands, a spectrum, conv(n) of the kernel."""
    probing = probing_tests(tests, linear.natural_hz)
    groups: Groups = {"/verification/spectrum": _tone_spectrum(probing[len(probing) // 2])}
    posteriors = {}
    for name, prefix in (("third_order_nuts", "nuts"), ("third_order_paper", "paper")):
        posteriors[prefix] = steps[name].posterior["posterior"].to_dataset()
        energy = step3.integrals(posteriors[prefix], third_order.data)
        groups[f"/steps/{name}/sample_stats"] = _with_conv(steps[name], energy, "rad s^11/m^4")
    groups["/verification/h3"] = _kernel_verification(third_order, posteriors)
    return groups


def _kernel_verification(fitted: KernelFit, posteriors: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """Measured kernel of every repeat, (repeat, freq), against the bands of Step 3's samplers."""
    data, omega = fitted.data, np.asarray(fitted.data.omega)
    shown = [k for k in fitted.kernels if np.any(np.isclose(k.omega, omega))]
    repeats = min(len(k.h3) for k in shown)
    h = np.stack([k.h3[:repeats] for k in shown], axis=-1)
    unit = {"units": "s^6/m^2", "long_name": "third-order kernel"}
    how = np.angle(h.mean(axis=0)), unit, {"units": "rad"}
    variables = polar("measured", h, *how, ("repeat", "freq"))
    variables |= {
        "correction": ("freq", [k.source_ratio for k in shown], {"units": "1"}),
        "y_peak": ("freq", np.asarray(data.y_peak), {"units": "m"}),
    }
    for prefix, posterior in posteriors.items():
        variables |= polar(prefix, step3.predicted(posterior, data), *how)
    freq = ("freq", omega / (2 * np.pi), {"units": "Hz"})
    return xr.Dataset(variables, {"freq_hz": freq, "quantile": QUANTILE_AXIS})


def _tone_spectrum(test: Test) -> xr.Dataset:
    """Peak amplitude over frequency of the displacement of one tone, through a Hann window."""
    record = test.records[0]
    x = record.channels[record.response][round(test.settle * record.fs) :]
    window = np.hanning(len(x))
    freq = np.fft.rfftfreq(len(x), 1 / record.fs)
    keep = (freq > 0.3 * test.tones_hz[0]) & (freq < SPECTRUM * test.tones_hz[0])
    amplitude = np.abs(np.fft.rfft(x * window))[keep] * 2 / window.sum()
    amplitude /= (2 * np.pi * freq[keep]) ** derivative_order(record.response)
    return xr.Dataset(
        {"amplitude": ("freq", amplitude, {"units": "m", "long_name": "displacement"})},
        {"freq": ("freq", freq[keep], {"units": "Hz"})},
        {"tone_hz": test.tones_hz[0], "test": test.name},
    )


def _with_conv(step: Step, energy: np.ndarray, unit: str) -> xr.Dataset:
    conv = np.stack([running_mean(chain) for chain in energy])
    attrs = {"units": unit, "long_name": messages.VARIABLES["conv"]}
    return step.posterior["sample_stats"].to_dataset().assign(conv=(("chain", "draw"), conv, attrs))


def _conv_of_velocity(steps: Mapping[str, Step], sweeps: Sweeps) -> Groups:
    """conv(n) of the velocity for gamma alone: its energy is a smooth function of gamma."""
    record = sweeps.fitted[-1].records[0]

    def energy(draws: dict[str, np.ndarray]) -> np.ndarray:
        return np.sum(predict_motion(draws, record, DEFAULT_LAWS)[0] ** 2, axis=-1) / record.fs

    return {
        f"/steps/{name}/sample_stats": _with_conv(
            steps[name], step4.of_draws(steps[name], energy), "m^2/s"
        )
        for name in step4.SAMPLERS
        if name in steps
    }
