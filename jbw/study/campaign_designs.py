"""What a campaign prescribes for its own calibration: tests, noise and prior as it has them."""

from collections.abc import Callable

import jax
import numpy as np

from jbw.campaign.load import Campaign, force_per_unit
from jbw.errors import DataError
from jbw.identification.linear_step import LinearStep, linear_step
from jbw.identification.paper import step3, step4
from jbw.identification.posteriors import posterior_of
from jbw.identification.selection import linear_test, probing_tests, sweep_tests
from jbw.observables.dataset import Dataset
from jbw.observables.records import Records
from jbw.study.calibration_designs import KernelDesign, SweepDesign

Report = Callable[[str], None]


def probing_design(campaign: Campaign, report: Report) -> KernelDesign:
    """Tones, displacements, noise and prior of Step 3.

    Args:
        campaign: The campaign.
        report: Called with one sentence at every stage.

    Raises:
        DataError: Without noise and tones, or with tones of different numbers of repeats.
    """
    report("Reading the design of Step 3 from the campaign")
    found = _kernel_fit(campaign, _linear(campaign))
    counts = np.unique(np.asarray(found.data.num_repeats)).astype(int)
    if len(counts) > 1:
        raise DataError(
            f"Step 3 is calibrated with one number of repeats, but the tones have {counts}.",
            remedy="Exclude repeats until all tones have as many.",
        )
    return KernelDesign(found.data, int(counts[0]), found.box)


def opening_design(campaign: Campaign, report: Report) -> SweepDesign:
    """Sweeps, noise and prior of Step 4; held is what Steps 2 and 3 fit.

    Args:
        campaign: The campaign.
        report: Called with one sentence at every stage.

    Raises:
        DataError: Without noise, tones or sweeps.
    """
    report("Reading the design of Step 4 from the campaign")
    sweeps = sweep_tests(campaign.tests, campaign.settings)
    if sweeps is None:
        raise DataError("Step 4 needs sweeps, which the campaign lacks.")
    linear = _linear(campaign)
    means = _kernel_fit(campaign, linear).fit.theta
    records = Records.of(sweeps.fitted, substeps=campaign.settings.substeps)
    found = step4.fit_opening(jax.random.key(0), records, linear.pooled, means, campaign.settings)
    return SweepDesign(_timed(records), records.repeats.noise_std, found.held, found.box)


def joint_design(campaign: Campaign, report: Report) -> SweepDesign:
    """Sweeps, noise and prior of the joint posterior; what else it is made from is left out.

    Args:
        campaign: The campaign.
        report: Called with one sentence at every stage.

    Raises:
        DataError: Without sweeps of one form.
    """
    posterior = posterior_of(
        "joint",
        campaign.tests,
        campaign.settings,
        laws=campaign.laws,
        gain=force_per_unit(campaign),
        report=report,
    )
    data = posterior.data
    parts = [p for p in data.parts if isinstance(p, Records)] if isinstance(data, Dataset) else []
    if len(parts) != 1:
        raise DataError(
            f"The joint posterior is calibrated on sweeps of one form, but there are {len(parts)}.",
            remedy="Leave one form of sweeps, or calibrate without a campaign.",
        )
    held = {name: float(value) for name, value in data.held.items()}
    return SweepDesign(_timed(parts[0]), parts[0].repeats.noise_std, held, posterior.box)


def _linear(campaign: Campaign) -> LinearStep:
    noise = linear_test(campaign.tests)
    if noise is None:
        raise DataError("Steps 3 and 4 need a noise test for Step 2, which the campaign lacks.")
    return linear_step(noise, force_per_unit(campaign))


def _kernel_fit(campaign: Campaign, linear: LinearStep) -> step3.KernelFit:
    probing = probing_tests(campaign.tests, linear.natural_hz)
    return step3.fit_kernel(jax.random.key(0), probing, linear.pooled, campaign.settings)


def _timed(records: Records) -> Records:
    """Records that the simulator can make: compared in time, from rest, of several repeats."""
    wrong = {
        "a band": records.lines is not None,
        "whole periods": records.periodic,
        "one repeat": bool(np.any(np.asarray(records.repeats.num_repeats) < 2)),
        "runs with offsets": records.origin.shape[1] > 0,
        "accelerations": records.response == "acceleration",
    }
    named = [name for name, found in wrong.items() if found]
    if named:
        raise DataError(f"Sweeps with {named[0]} cannot be simulated for a calibration.")
    return records
