"""The run's result as one tree: posteriors, verification and validation, labelled, with units."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from jbw.errors import Attempts
from jbw.identification.assemble import Measured
from jbw.identification.linear_step import LinearStep, linear_dataset, modes_dataset
from jbw.identification.paper import step3, step4
from jbw.identification.paper.step3 import KernelFit
from jbw.identification.procedure import Identification
from jbw.identification.selection import Sweeps, probing_tests
from jbw.identification.step import Step
from jbw.inference.posterior.finding import Verdict
from jbw.inference.posterior.summary import running_mean
from jbw.measurement.records import Test
from jbw.observables.dataset import Dataset
from jbw.quantities import DEFAULT_LAWS, derivative_order
from jbw.report.messages import stages
from jbw.report.messages import study as messages
from jbw.study.arviz_groups import arviz_groups, created
from jbw.verification.backbone import backbone_group
from jbw.verification.bands import QUANTILE_AXIS, polar
from jbw.verification.in_time import predict_motion
from jbw.verification.predictive_basis import NUM_DRAWS, basis_attrs, basis_of, decay_attrs
from jbw.verification.verify import Groups, verify

SPECTRUM = 4.2  # of the tone: the highest frequency of its spectrum shown


def collect(
    measured: Measured,
    posteriors: Identification,
    seed: int,
    truth: Mapping[str, float] | None,
    attempts: Attempts,
) -> xr.DataTree:
    """Posteriors, verification and validation as the tree that is saved as `posterior.nc`.

    What stands beside the posteriors and cannot be made is left out, and `attempts` says so.
    """
    tests, main = measured.tests, posteriors.main
    facts = xr.Dataset(attrs=main.posterior.attrs | run_attrs(tests, posteriors))
    groups: Groups = {"/": facts}
    if posteriors.linear is not None:
        groups["/steps/linear"] = linear_dataset(posteriors.linear)
        modes = modes_dataset(posteriors.linear)
        groups |= {} if modes is None else {"/modes": modes}
    for name, step in posteriors.steps.items():
        place = "" if name == main.name else f"/steps/{name}"
        groups |= {f"{place}/{part}": ds for part, ds in _groups(step, truth or {}).items()}
    linear, kernel, sweeps = posteriors.linear, posteriors.kernel, posteriors.sweeps
    if linear is not None and kernel is not None:
        groups |= attempts.make(
            stages.KERNEL,
            lambda: _kernel_groups(tests, linear, kernel, posteriors.steps),
            {},
        )
    if sweeps is not None:
        groups |= attempts.make(
            stages.ENERGY,
            lambda: _conv_of_velocity(posteriors.steps, sweeps),
            {},
        )
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
    if not sees_no_joint(main.verdict):  # of a linear structure single records say nothing
        attempts.report(stages.SINGLE_RECORDS)
        by_record = attempts.make(
            stages.RECORD_LIKELIHOOD, lambda: arviz_groups(measured, posteriors, seed), {}
        )
    return xr.DataTree.from_dict(groups | drawn | by_record)


def sees_no_joint(verdict: Verdict) -> bool:
    """Whether a posterior is of a structure in which no joint is seen."""
    return any(row.code == "no_joint" and row.status != "ok" for row in verdict.findings)


def run_attrs(tests: Sequence[Test], found: Identification) -> dict[str, Any]:
    """What predictions start from besides draws, as `basis_of` reads it from the result."""
    posterior = found.main.posterior["posterior"].to_dataset()
    omega_n = float(posterior["omega_n"].mean()) if "omega_n" in posterior else 1.0
    decays = [] if found.decay_data is None else [found.decay_data]
    data = found.data or Dataset.of(decays)
    attrs = basis_attrs(tests, data, found.main.held, omega_n)
    return attrs | (decay_attrs(decays[0]) if decays else {})


def _groups(step: Step, truth: Mapping[str, float]) -> Groups:
    """The groups of one posterior, the truth beside the draws where it is known."""
    groups = {name: node.to_dataset() for name, node in step.posterior.children.items()}
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
