"""Lower limits of a law's error: variation between repeats, and linear fits of single runs.

A law whose error is at most a fifth above the scatter of the repeats' mean needs no successor. A
linear oscillator fitted to each run alone adapts to its level and its day; its residual shows
nonlinearity within a run.
"""

from collections.abc import Mapping
from dataclasses import replace

from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.space.box import bounds_about, box
from jbw.measurement.channels import rms
from jbw.observables import dataset, noise
from jbw.observables.dataset import Dataset
from jbw.observables.drives import plain, used_by
from jbw.oscillator.modes.assembled import is_assembled
from jbw.quantities import LINEAR, STUCK

# prior bounds of a linear oscillator's omega_n, zeta and gain, relative to those of the joint
PLAIN = {"omega_n": (0.5, 1.5), "zeta": (1e-2, 1e2), "gain": (0.1, 10.0)}
# prior bounds of further modes, relative to their frequencies, which change little
APART = ((0.95, 1.05), *list(PLAIN.values())[1:])
REACH = {quantity.name: PLAIN[plain(quantity.name)] for quantity in LINEAR}
REACH |= {quantity.name: APART[i % 3] for i, quantity in enumerate(STUCK[len(LINEAR) :])}
# settings of a fit whose error is needed to two digits only
CLOSE = {"max_evaluations": 40, "tolerance": 1e-6}


def scatter_of_means(data: Dataset) -> float | None:
    r"""Return the relative standard error of the mean of K repeats, $s / \sqrt K$, if K > 1.

    This is the root mean square over the groups. The residual of a fit refers to that mean.
    """
    scatters = list(noise.repeatability(data, of_mean=True).values())
    return rms(scatters) if scatters else None


def own_lines(data: Dataset, known: Mapping[str, float]) -> dict[str, float]:
    """Fit a separate linear oscillator to each run; return the relative error of each run.

    `known` contains omega_n, zeta and the gain of a joint, for every drive; the fits start there.
    """
    even = [noise.evenly(part) for part in data.parts]
    parts = [replace(part, laws=()) for part in even if part is not None]
    within = {n: bounds_about(known[n], *REACH[n]) for n in REACH if n in known}
    within = {name: pair for name, pair in within.items() if name not in data.held}
    if not parts or not within:
        return {}
    of_model = is_assembled(data.held)
    held = {name: float(value) for name, value in data.held.items() if of_model or name in REACH}
    linear = Dataset.of(parts, held)
    pairs = list(zip(linear.labels, linear.runs, strict=True))
    errors = {}
    for run in dict.fromkeys(linear.runs):
        used = used_by([part for part in linear.parts if run in part.groups.runs], within)
        prior = box({name: within[name] for name in within if name in used})
        single = noise.silenced([label for label, name in pairs if name != run], linear)
        start = {name: known[name] for name in prior.names}
        best = costly_fit(dataset.stacked, prior, single, starts=start, **CLOSE)
        residuals = dataset.residual_by_label(best.residual, single)
        error = dataset.error_by_label(residuals, single)
        of_run = [error[label] for label, name in pairs if name == run and label in error]
        errors[run] = rms(of_run)
    return errors
