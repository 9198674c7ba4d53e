r"""Differences between the joints of two finished runs, with their probabilities.

Two posteriors are taken as independent. For every quantity q that both determine,

$$P(q_A > q_B) = \frac{1}{m n} \sum_{i=1}^{m} \sum_{j=1}^{n} [q_{A,i} > q_{B,j}]$$

over all pairs of draws (a tie counts one half), with the quantiles of $q_A - q_B$ over these pairs.

To decide which of several joints has changed, the parameters $\theta_j$ of joint j are compared,
marginal over the other joints:

$$d_j^2 = (\bar\theta_A - \bar\theta_B)^T\,(\Sigma_A + \Sigma_B)^{-1}\,
          (\bar\theta_A - \bar\theta_B)$$

has a chi-square distribution with as many degrees of freedom as there are parameters, where nothing
has changed and posteriors are Gaussian.

To decide whether two modes share a joint: a joint that moves by $x = h\,y$ acts on the mode's y as
a law of the same kind, whose parameters contain the unknown h. The ratio of the second product to
the first does not contain it. For Bouc-Wen's law

$$\frac{\alpha_i\gamma_i}{\alpha_i\delta_i} = \frac{\gamma}{\delta}, \qquad i = 1, 2$$

so that it must agree between modes that share one joint.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy import stats

from jbw.errors import ConfigError
from jbw.identification.joint_answers import JOINTS
from jbw.inference.posterior.summary import QUANTILES, evenly_spaced, scalars
from jbw.oscillator.laws import laws_named, quantities_of
from jbw.oscillator.parameters import Monomial
from jbw.quantities import (
    OSCILLATOR,
    Quantity,
    are_at_joints,
    in_dialect,
    motion_factors_in,
    per,
    split,
)
from jbw.report.messages import differences as messages
from jbw.report.result import read_result, unit_of
from jbw.report.text import interval, number, typed
from jbw.report.words import UNCOUNTED, is_of_prior
from jbw.results.differences import ComparedJoint, ComparedQuantity, ComparedRun, RunDifference
from jbw.results.run import RunSummary
from jbw.verification.backbone import curves, errors_of_law, has_backbone
from jbw.verification.predictive_basis import Basis, Draws, basis_of

NUM_DRAWS = 1000  # number of draws taken from each run, so that there are a million pairs
NUM_CARRIED = 200  # number of draws of each run for which the backbone is computed
# amplitudes at which runs are compared, relative to the largest displacement fitted in both
GRID = np.linspace(0.05, 1.0, 20)
# indices into GRID of the reported amplitudes: 10, 25, 50, 75 and 100 % of the largest one
TOLD = (1, 4, 9, 14, 19)
SURE = 0.995  # one-sided probability above which the 99 % interval of the difference excludes 0
INPUT = "gain"  # a parameter of the source, which is no property of the joint
BY_CHANCE = 0.01  # probability of reporting a changed joint when no joint has changed
# If two natural frequencies differ by more than this factor, they belong to different modes.
APART = 1.1


class FinishedRun(NamedTuple):
    """A finished run and its letter (A or B) in the comparison."""

    name: str
    folder: Path
    summary: RunSummary
    tree: xr.DataTree
    basis: Basis


def differences(first: Path, second: Path) -> tuple[RunDifference, xr.Dataset | None]:
    """Compare the parameters, frequencies and damping of two finished runs.

    The second value contains both runs' backbones; None where a run has none.

    Raises:
        ConfigError: The runs have different laws, or quantities in different units.
    """
    first_run, second_run = _opened("A", first), _opened("B", second)
    _require_comparable(first_run, second_run)
    parameters, apart = _parameters(first_run, second_run)
    joints = changed_joints(_drawn(first_run), _drawn(second_run), first_run.basis.laws)
    backbones, rows = _along_amplitude(first_run, second_run)
    runs = {
        run.name: ComparedRun(
            folder=str(run.folder),
            campaign=run.summary.campaign,
            verdict=run.summary.verdict.status,
            model_adequacy=run.summary.verdict.answer("law"),
            largest_displacement=run.basis.y_peak,
        )
        for run in (first_run, second_run)
    }
    record = RunDifference(
        runs=runs, laws=list(first_run.basis.laws), parameters=parameters, backbone=rows
    )
    record = record.replaced(joints=joints) if joints else record
    sentences = _statements(record, first_run, second_run, apart)
    return record.replaced(statements=sentences), backbones


def compared(
    a: Float[np.ndarray, " draw"], b: Float[np.ndarray, " other"], **named: Any
) -> ComparedQuantity:
    """Return the intervals of A, B and A - B, and the probability P(A > B), from draws of both."""
    below = np.searchsorted(np.sort(b), a, "left") + np.searchsorted(np.sort(b), a, "right")
    away = np.subtract.outer(a, b).ravel()
    return ComparedQuantity(
        a=np.quantile(a, QUANTILES).tolist(),
        b=np.quantile(b, QUANTILES).tolist(),
        difference=np.quantile(away, QUANTILES).tolist(),
        probability=float(np.mean(below) / (2 * len(b))),
        **named,
    )


def _opened(name: str, folder: Path) -> FinishedRun:
    summary, tree = read_result(folder)
    return FinishedRun(name, folder, summary, tree, basis_of(tree))


def _require_comparable(first: FinishedRun, second: FinishedRun) -> None:
    if first.basis.laws != second.basis.laws:
        laws = [" and ".join(run.basis.laws) or "no law" for run in (first, second)]
        raise ConfigError(
            f"The laws of the two runs must be the same, but {first.folder} has {laws[0]} and "
            f"{second.folder} has {laws[1]}.",
            why="Parameters of different laws are different quantities.",
            remedy="Identify both runs with the same law: state the same `laws` in [joint].",
        )
    for name in _shared(first, second):
        units = [unit_of(run.basis.posterior[name]) for run in (first, second)]
        if units[0] != units[1]:
            raise ConfigError(
                f"The units of `{name}` must be the same in both runs, but are `{units[0]}` in "
                f"{first.folder} and `{units[1]}` in {second.folder}.",
                remedy="Identify both runs from responses of the same physical quantity.",
            )


def _shared(first: FinishedRun, second: FinishedRun) -> list[str]:
    """Return the names of parameters that both runs have, except noise levels."""
    drawn = [scalars(run.tree) for run in (first, second)]
    both = [name for name in drawn[0] if name in drawn[1] and not name.startswith(UNCOUNTED)]
    if INPUT in both and len({unit_of(run.basis.posterior[INPUT]) for run in (first, second)}) > 1:
        both.remove(INPUT)
    return both


def _parameters(
    first: FinishedRun, second: FinishedRun
) -> tuple[list[ComparedQuantity], list[str]]:
    """Return one comparison row per parameter of both runs, and the names that only one run has."""
    drawn = [_drawn(run) for run in (first, second)]
    rows: list[ComparedQuantity] = []
    for name in _shared(first, second):
        a, b = (draws[name] for draws in drawn)
        both = [(run.name, run.summary.parameters.get(name)) for run in (first, second)]
        of_prior = [run for run, row in both if row is not None and is_of_prior(row)]
        unit = unit_of(first.basis.posterior[name])
        rows.append(compared(a, b, name=name, unit=unit, of_prior=of_prior))
    for ratio in ratios(first.basis.laws):
        a, b = (of_draws(ratio, draws) for draws in drawn)
        if a is not None and b is not None:
            name, unit = ratio.ratio.name, ratio.ratio.quantity.unit
            two_modes = are_two_modes(*drawn)
            rows.append(compared(a, b, name=name, unit=unit, of_prior=[], two_modes=two_modes))
    unshared = [
        name for name in drawn[0].keys() ^ drawn[1].keys() if not name.startswith(UNCOUNTED)
    ]
    return rows, sorted(unshared)


def _drawn(run: FinishedRun) -> dict[str, np.ndarray]:
    """Return evenly spaced draws of a run, with the parameters' variation between records added."""
    chosen = evenly_spaced(run.basis.posterior, NUM_DRAWS)
    drawn = {name: draws.ravel()[chosen] for name, draws in scalars(run.tree).items()}
    rng = np.random.default_rng(0)
    for name, std in _std_between(run).items():
        if name in drawn:
            values = drawn[name]
            drawn[name] = values + std * abs(np.mean(values)) * rng.standard_normal(len(values))
    return drawn


def _std_between(run: FinishedRun) -> dict[str, float]:
    r"""Return each mean's relative standard error, $\tau / \sqrt n$, caused by varying records."""
    if "between_records" not in run.tree.children:
        return {}
    between = run.tree["between_records"].to_dataset()
    std = between["scatter"].values / np.sqrt(between.sizes["record"])
    return {str(n): float(x) for n, x in zip(between["quantity"].values, std, strict=True) if x}


def _between_words(runs: Sequence[FinishedRun]) -> list[str]:
    """Return a sentence on the variation between each run's records, which P(A > B) includes."""
    spreads = {run.name: std for run in runs if (std := _std_between(run))}
    return [messages.records_scatter(spreads)] if spreads else []


def _along_amplitude(
    first: FinishedRun, second: FinishedRun
) -> tuple[xr.Dataset | None, list[ComparedQuantity]]:
    """Return both runs' bands of frequency and damping at amplitudes that both fitted."""
    y_peak = min(run.basis.y_peak for run in (first, second))
    laws, drawn = first.basis.laws, [run.basis.thinned(NUM_CARRIED) for run in (first, second)]
    if not all(has_backbone(draws, y_peak, laws) for draws in drawn):
        return None, []
    amplitude = y_peak * GRID
    carried = [
        _with_errors(run.basis, draws, amplitude, seed)
        for seed, (run, draws) in enumerate(zip((first, second), drawn, strict=True))
    ]
    rows, bands = [], {}
    for place, (name, unit) in enumerate((("frequency", "Hz"), ("damping", "1"))):
        a, b = carried[0][place], carried[1][place]
        rows += [
            compared(a[:, i], b[:, i], name=name, unit=unit, amplitude=float(amplitude[i]))
            for i in TOLD
        ]
        both = np.stack([np.quantile(x, QUANTILES, axis=0) for x in (a, b)])
        bands[name] = (("run", "quantile", "amplitude"), both, {"units": unit})
    coordinates = {
        "run": [first.name, second.name],
        "quantile": list(QUANTILES),
        "amplitude": ("amplitude", amplitude, {"units": "m"}),
    }
    return xr.Dataset(bands, coordinates), rows


def _with_errors(
    basis: Basis, draws: Draws, amplitude: Float[np.ndarray, " amplitude"], seed: int
) -> list[Float[np.ndarray, "draw amplitude"]]:
    """Return a run's frequency [Hz] and damping by draw, with random errors of its law."""
    frequency, damping, _ = curves(draws, amplitude, basis.laws)
    of_frequency, of_damping = errors_of_law(amplitude, frequency, basis.discrepancy)
    normal = stats.norm.ppf((np.arange(len(frequency)) + 0.5) / len(frequency))
    rng = np.random.default_rng(seed)
    return [
        values + error * rng.permutation(normal)[:, None]
        for values, error in ((frequency, of_frequency), (damping, of_damping))
    ]


def _statements(
    record: RunDifference, first: FinishedRun, second: FinishedRun, unshared: Sequence[str]
) -> list[str]:
    """Return all sentences that compare two runs: what differs, what may be equal, and limits."""
    rows, runs = record.parameters, record.runs
    identified = [row for row in rows if not row.of_prior]
    sure = [row for row in identified if _is_sure(row)]
    sentences = joint_statements(record.joints)
    factors = list(motion_factors_in(row.name for row in rows))
    if factors and sentences:
        sentences.append(messages.factors_apart(factors))
    homes = _homes(first), _homes(second)
    sentences += [
        messages.homes_differ(joints, home, homes[1][joints])
        for joints, home in homes[0].items()
        if home != homes[1].get(joints, home)
    ]
    sentences += [_differs(row) for row in sure] or [messages.NONE_DIFFERS]
    if rest := [row.name for row in identified if row not in sure]:
        sentences.append(messages.may_be_same(rest))
    if of_prior := {row.name: row.of_prior for row in rows if row.of_prior}:
        sentences.append(messages.of_prior(of_prior))
    sentences += [
        messages.one_joint(row.name, interval(*row.a), interval(*row.b), sure=_is_sure(row))
        for row in rows
        if row.two_modes
    ]
    sentences += [_differs(row) for row in record.backbone[len(TOLD) - 1 :: len(TOLD)]]
    if unshared:
        sentences.append(messages.only_one(unshared))
    verdicts = {name: run.verdict for name, run in runs.items()}
    unusable = {name: word for name, word in verdicts.items() if word not in ("ok", "usable")}
    sentences += [messages.not_usable(name, word) for name, word in unusable.items()]
    inadequate = [name for name, run in runs.items() if run.model_adequacy not in ("ok", "")]
    if sure and inadequate:
        sentences.append(messages.inadequate(inadequate))
    both = (first, second)
    return [*sentences, messages.INDEPENDENT, *_between_words(both), _scatter_words(both)]


def _homes(run: FinishedRun) -> dict[str, str]:
    """Return the joint and the mode whose motion the parameters of each law refer to.

    The laws are stated in metres of the motion with the largest energy share. The dictionary is
    empty where the mode shapes of the model are certain.
    """
    if JOINTS not in run.tree.children or "motion_factor" not in run.tree[JOINTS]:
        return {}
    shares = run.tree[JOINTS].to_dataset()["energy_share"]
    homes = {}
    for joints in dict.fromkeys(split(law)[1] for law in run.basis.laws):
        of_joints = shares.sel(joint=list(joints))
        home = of_joints.isel(of_joints.argmax(["joint", "mode"]))
        homes[" and ".join(joints)] = f"{home['joint'].item()} in mode {home['mode'].item()}"
    return homes


def _is_sure(row: ComparedQuantity) -> bool:
    return max(row.probability, 1 - row.probability) > SURE


def _differs(row: ComparedQuantity) -> str:
    """Return the sentence on a quantity's difference between two runs, with the interval."""
    unit = "" if row.unit in ("", "1") else f" {row.unit}"
    place = "" if row.amplitude is None else f" at {number(row.amplitude)} m"
    low, middle, high = row.difference
    difference = f"{interval(low, middle, high, sd=0.5)}{unit}"
    return messages.differs(typed(f"{row.name}{place}"), difference, sure=_is_sure(row))


def _scatter_words(runs: Sequence[FinishedRun]) -> str:
    """Return the sentence on the variation between assemblies, which P(A > B) does not include."""
    units = [in_dialect(quantity.unit) for quantity in OSCILLATOR[:2]]
    spreads = {}
    for run in runs:
        if run.basis.scatter:
            omega, zeta = (
                f"{sd:.2g} {unit}".removesuffix(" 1")
                for sd, unit in zip(run.basis.scatter, units, strict=True)
            )
            spreads[run.name] = omega, zeta
    return messages.sessions_scatter(spreads) if spreads else messages.ONE_ASSEMBLY


def changed_joints(first: Draws, second: Draws, laws: Sequence[str]) -> list[ComparedJoint]:
    """Test by chi-square which joints have changed between two runs; return one row per joint.

    Args:
        first: Draws of the first run's parameters, by parameter name.
        second: Draws of the second run's parameters, by parameter name.
        laws: Names of the laws of both runs; for a single joint no rows are returned.
    """
    if not are_at_joints(laws):
        return []
    groups = list(dict.fromkeys(split(law)[1] for law in laws))
    rows = []
    for joints in groups:
        of_joints = tuple(law for law in laws if split(law)[1] == joints)
        names = [quantity.name for quantity in quantities_of(of_joints)]
        square, degrees = _distance(first, second, names)
        p = float(stats.chi2.sf(square, degrees)) if degrees else 1.0
        has_changed = p < BY_CHANCE / len(groups)
        rows.append(
            ComparedJoint(
                joint=" and ".join(joints),
                chi_square=square,
                degrees_of_freedom=degrees,
                p=p,
                changed=has_changed,
            )
        )
    return rows


def _distance(first: Draws, second: Draws, names: Sequence[str]) -> tuple[float, int]:
    """Return the squared Mahalanobis distance of two runs' means, with degrees of freedom."""
    varying = [
        name
        for name in names
        if name in first and name in second and np.std(first[name]) + np.std(second[name]) > 0
    ]
    if not varying:
        return 0.0, 0
    means, covariances = [], []
    for draws in (first, second):
        table = np.array([draws[name] for name in varying])
        means.append(table.mean(axis=1))
        covariances.append(np.atleast_2d(np.cov(table)))
    away = means[0] - means[1]
    std = np.sqrt(np.diag(covariances[0] + covariances[1]))
    correlation = (covariances[0] + covariances[1]) / np.outer(std, std)
    return float((away / std) @ np.linalg.solve(correlation, away / std)), len(varying)


def joint_statements(rows: Sequence[ComparedJoint]) -> list[str]:
    """Return sentences on joints that have changed and on joints that may be unchanged."""
    sentences = [
        messages.joint_changed(row.joint, row.chi_square, row.degrees_of_freedom)
        for row in rows
        if row.changed
    ]
    if rest := {row.joint: row.p for row in rows if not row.changed}:
        sentences.append(messages.joints_may_be_same(rest))
    return sentences


class Ratio(NamedTuple):
    """The ratio of two products of a law's parameters, stored together with its divisor."""

    ratio: Monomial
    first: Monomial


def ratios(laws: Sequence[str]) -> list[Ratio]:
    """Return the second product divided by the first for each law that has two products."""
    pairs = [law.products for law in laws_named(tuple(laws)) if len(law.products) == 2]
    return [Ratio(_over(second, first), first) for first, second in pairs]


def _over(second: Monomial, first: Monomial) -> Monomial:
    """Return the quotient of two products, named after those parameters that do not cancel."""
    names = dict.fromkeys((*second.powers, *first.powers))
    powers = {name: second.powers.get(name, 0) - first.powers.get(name, 0) for name in names}
    powers = {name: power for name, power in powers.items() if power}
    above, below = (
        "*".join(n if abs(p) == 1 else f"{n}^{abs(p)}" for n, p in powers.items() if p * sign > 0)
        for sign in (1, -1)
    )
    units = second.quantity.unit, first.quantity.unit
    unit = "1" if units[0] == units[1] else per(*units)
    name = f"{above or 1}/{below}" if below else above
    return Monomial(Quantity(name, name, unit, f"{second.name} over {first.name}"), powers)


def of_draws(ratio: Ratio, draws: Draws) -> Float[np.ndarray, " draw"] | None:
    """Return draws of a ratio of two products of a law's parameters; None if it may be infinite.

    The result is also None if a parameter is missing.
    """
    if not ratio.first.powers.keys() | ratio.ratio.powers.keys() <= draws.keys():
        return None
    low, _, high = np.quantile(ratio.first.of(draws), QUANTILES)
    return None if low <= 0.0 <= high else np.asarray(ratio.ratio.of(draws))


def are_two_modes(first: Draws, second: Draws) -> bool:
    """Return whether two runs identified different modes: their natural frequencies differ."""
    both = [float(np.median(draws["omega_n"])) for draws in (first, second) if "omega_n" in draws]
    return len(both) == 2 and max(both) > APART * min(both)
