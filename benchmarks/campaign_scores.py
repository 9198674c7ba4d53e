"""The identification of whole campaigns of the virtual rig, with z-scores of the true values."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest

from jbw import rig
from jbw.errors import ConfigError
from jbw.identification.assemble import assemble, measured, reading_of
from jbw.identification.coordinates import box_of
from jbw.identification.linear_step import linear_step
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.samplers.sampling import sample
from jbw.observables.dataset import Dataset, log_likelihood, stacked
from jbw.observables.drives import told_by
from jbw.observables.records import Records

FITTED = ("sweep_0p05V", "sweep_0p20V")
NOISE = "noise_0p005V"
NUM_DRAWS = 500
# [N] noise of the mixed campaign's loop, which must not determine everything alone
FORCE_NOISE = 0.2

Measured = tuple[Dataset, rig.RigCampaign]


@dataclass(frozen=True)
class Scores:
    """The agreement of posteriors with the truth over many campaigns.

    Attributes:
        names: Names of the parameters.
        z: (posterior mean - truth) / posterior sd, shape (campaign, parameter).
        p_values: P-values of a Kolmogorov-Smirnov test of each parameter's z against the standard
            normal.
        khat: Pareto shape of the importance weights of each campaign.
        chi_square: Chi-square of the fit per degree of freedom, for each campaign.
    """

    names: tuple[str, ...]
    z: NDArray[np.float64]
    p_values: dict[str, float]
    khat: NDArray[np.float64]
    chi_square: NDArray[np.float64]


def score_campaigns(
    num_campaigns: int = 50,
    *,
    campaign: str = "sweeps",
    repeats: int | None = None,
    noise_ratio: float | None = None,
    substeps: int = 2,
    report: Callable[[int], None] = lambda done: None,
) -> Scores:
    """Measure campaigns with seeds 0, 1, 2, ... and identify each from all of its tests.

    The posterior's mean and sd come from importance sampling of its Laplace approximation. The
    Pareto shape of the weights is returned: below 0.7 the results are those of the posterior
    itself.

    Args:
        num_campaigns: Number of campaigns.
        campaign: "sweeps" for weak noise and sweeps of two levels; or "mixed" for the rig's
            campaign of noise, tones at three levels, stepped sine, sweeps, decays and a forced
            loop.
        repeats: Repeats of each level of sweeps, 24 by default; in a mixed campaign repeats of each
            test, by default as planned.
        noise_ratio: Noise as a share of each record's rms; the laser's 50 um/s when None.
        substeps: Solver steps between samples.
        report: A function that is called with the number of finished campaigns.

    Returns:
        The z-scores and their tests.

    Raises:
        ConfigError: The campaign is unknown.
    """
    if campaign not in CAMPAIGNS:
        known = ", ".join(f'"{name}"' for name in CAMPAIGNS)
        raise ConfigError(f'Argument `campaign` must be one of {known}, but is "{campaign}".')
    rows = []
    for seed in range(num_campaigns):
        made = CAMPAIGNS[campaign](seed, repeats, noise_ratio, substeps)
        rows.append(_identified(seed, *made))
        report(seed + 1)
    names = tuple(rows[0][0])
    z = np.array([list(row[0].values()) for row in rows])
    p_values = {name: float(kstest(z[:, i], "norm").pvalue) for i, name in enumerate(names)}
    khat, chi_square = np.array([row[1:] for row in rows]).T
    return Scores(names, z, p_values, khat, chi_square)


def _sweeps(seed: int, repeats: int | None, noise_ratio: float | None, substeps: int) -> Measured:
    """Measure weak noise and sweeps of two levels; return data and campaign."""
    quiet = rig.measure(seed=seed, tests=[NOISE], repeats=2)
    swept = rig.measure(seed=seed, tests=FITTED, repeats=repeats or 24, noise_ratio=noise_ratio)
    linear = linear_step(quiet.tests[0])
    return Dataset.of([reading_of(linear), Records.of(swept.tests, substeps=substeps)]), swept


def _mixed(seed: int, repeats: int | None, noise_ratio: float | None, substeps: int) -> Measured:
    """Measure every kind of test of the rig's mixed campaign; return data and campaign."""
    campaign = rig.measure(
        "mixed", seed=seed, repeats=repeats, noise_ratio=noise_ratio, force_noise_std=FORCE_NOISE
    )
    settings = campaign.settings.model_copy(update={"substeps": substeps})
    return assemble(measured(campaign.tests, settings)), campaign


CAMPAIGNS = {"sweeps": _sweeps, "mixed": _mixed}


def _identified(
    seed: int, data: Dataset, campaign: rig.RigCampaign
) -> tuple[dict[str, float], float, float]:
    """Return the z-scores of one campaign, k-hat, and chi-square per degree of freedom."""
    prior = box_of(campaign.settings, data, told_by(data.parts))
    centre = {
        n: float(v) for n, v in zip(prior.names, (prior.lower + prior.upper) / 2, strict=True)
    }
    best = costly_fit(stacked, prior, data, starts=centre)
    found = sample(
        jax.random.key(seed), log_likelihood, prior, data, sampler="importance", num_chains=1,
        num_samples=NUM_DRAWS, start=best.theta, covariance=best.covariance,
    )  # fmt: skip
    draws = found["posterior"].to_dataset()
    truth = {**campaign.truth["joint"], "gain": campaign.truth["gain"]}
    z = {n: float((draws[n].mean() - truth[n]) / draws[n].std()) for n in prior.names}
    chi_square, dof = best.chi_square
    return z, found.attrs["khat"], chi_square / dof
