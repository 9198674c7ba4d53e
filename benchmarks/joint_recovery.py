r"""Do the intervals of two bolts contain the truth, and does the evidence favour one law or two?

Two lapped beams have two bolts, with sweeps through modes 1 to 3 at two levels each, 1 % of noise,
and laws of the bolts that are drawn again for each data set. The second bolt's delta is a given
ratio of the first's; all other parameters are equal. Records are simulated on a grid of twice as
many steps as the fit's.

With `--loosened` each data set is measured twice, the second time with a tenth less preload of the
second bolt, and the two posteriors name the changed bolt. With `--by-fit` no sampler runs; the
answers come from least squares that start at the truth, and from their covariance. With
`--intervals` only the posterior is computed: the fit of `jbw identify --quick`, from readings of
single modes, and weighted points of the sampler, without the evidence, on a grid half as fine as
otherwise, which changes the log likelihood of draws by 0.07 nats. Every data set has the shapes of
the first one, whose compiled programs serve all.

Intervals of one data set are dependent, so that a count of all of them varies by more than the
binomial test assumes. All parameters together have a separate row,

$$2\,(\ln L_{max} - \ln L_{truth}) \sim \chi^2_p$$

for p parameters, where records and model differ only by noise.

    python benchmarks/joint_recovery.py [--first 0] [--number 20] [--delta-ratio 1.3]
        [--intervals] [--loosened] [--by-fit] [--answers FILE] [--json FILE]

The file named by `--answers` stores every answer at once, one per line: its data sets are not
measured again, and the tables cover all of its answers.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr
from scipy import stats
from timing import Table, options, show

import jbw
from jbw.assembly.reduce import ReducedModel
from jbw.campaign.joints import SeveralJoints
from jbw.campaign.load import Campaign
from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured_in
from jbw.identification.joint import sample_joint
from jbw.identification.one_mode_readings import joint_readings
from jbw.identification.prepare import Fitted, prepare
from jbw.identification.tied_joints import tied_evidence
from jbw.inference.fit.fitting import Fit
from jbw.inference.generator import parts_of
from jbw.inference.lanes import at_points
from jbw.inference.posterior.summary import scalars
from jbw.inference.samplers import amis
from jbw.inference.samplers.chunked_run import no_checkpoint
from jbw.inference.space.problem import problem_of
from jbw.inference.space.reparametrisation import along_logarithms, never_zero
from jbw.measurement.records import Record, Test
from jbw.observables import dataset
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.rig.assemblies import lapped_beams
from jbw.study.differences import changed_joints

FS, DURATION, TO_HZ, ZETA, NOISE = 1024.0, 1.0, 320.0, 0.004, 0.01
SUBSTEPS = 16  # steps of the fit: 0.6 rad of the fastest residual mode
COARSE = 8  # steps of the fit if only intervals are requested
# points per round, effective draws to reach, and largest number of rounds
ROUND, EFFECTIVE, MOST_ROUNDS = 256, 600.0, 24
SCATTER = 0.2  # sd of the logarithm of each of the laws' parameters between data sets
LABELS = ("bolt_1", "bolt_2")
LAWS = tuple(f"bouc_wen@{label}" for label in LABELS)
# preload of a loosened bolt: slip then occurs at motion that is smaller by this factor
PRELOAD = 0.9
MIDDLE = {"alpha": 7e6, "delta": 2.5e5, "gamma": 5e4}
# Band [Hz] and forces [N] of the sweeps through each mode, from weak to strong slip.
SWEEPS = {
    "first": ((25.0, 40.0), (0.3, 1.5)),
    "second": ((70.0, 105.0), (0.5, 2.5)),
    "third": ((270.0, 330.0), (1.0, 5.0)),
}
EVIDENCE_KEY, DRAWS_KEY = 300, 400  # numbers added to the seed
NUM_DRAWS = 4000  # draws from the Gaussian approximation at a fit
CENTRAL = 0.99
TAILS = (0.5 - CENTRAL / 2, 0.5 + CENTRAL / 2)
OF_DATA_SETS = {
    "seed": "d", "seconds": ".0f", "within 99 %": "d", "of": "d", "largest abs z": ".2f",
    "chi-square": ".1f", "p": ".2g", "k-hat": ".2f", "ln Z tied / Z own": ".1f", "preferred": "",
}  # fmt: skip
COLUMNS = {
    "parameter": "", "intervals": "d", "within 99 %": "d", "mean z": ".2f", "sd of z": ".2f",
    "p of the binomial test": ".2g",
}  # fmt: skip
TOGETHER = {
    "data sets": "d", "parameters": "d", "mean chi-square": ".2f", "p above 1 %": "d",
    "p of the binomial test": ".2g", "p of Kolmogorov": ".2g",
}  # fmt: skip
CHANGED = {
    "seed": "d", "seconds": ".0f", "named": "", "chi-square of bolt_1": ".1f", "of bolt_2": ".1f",
}  # fmt: skip
COUNTED = {"pairs": "d", "bolt_2 alone named": "d", "bolt_1 named": "d", "none named": "d"}
EVIDENCE = {
    "data sets": "d", "tied preferred": "d", "own preferred": "d", "weights trusted": "d",
    "closest ln ratio": ".1f",
}  # fmt: skip


def reduced(bolts: Sequence[tuple[BoucWenLaw, ...]] = ((), ())) -> ReducedModel:
    """Return a model with modes to 320 Hz and residual modes, with the bolts' laws if given."""
    return lapped_beams().with_laws(*bolts).reduced(to_hz=TO_HZ, zeta=ZETA)


def drawn_truth(rng: np.random.Generator, delta_ratio: float) -> dict[str, float]:
    """Return random true parameters of both bolts' laws, by name."""
    first = {name: x * np.exp(SCATTER * rng.standard_normal()) for name, x in MIDDLE.items()}
    second = first | {"delta": delta_ratio * first["delta"]}
    return {
        f"{name}@{label}": float(x)
        for label, bolt in zip(LABELS, (first, second), strict=True)
        for name, x in bolt.items()
    }


def sweep(band_hz: tuple[float, float], force: float) -> np.ndarray:
    """Return a linear sweep with smooth ends; the response decays freely in its last third."""
    t = np.arange(int(DURATION * FS)) / FS
    window = np.clip(t / 0.1, 0, 1) * np.clip((DURATION - t) / 0.3, 0, 1)
    rate = (band_hz[1] - band_hz[0]) / (2 * DURATION)
    phase = 2 * np.pi * (band_hz[0] * t + rate * t**2)
    return force * np.sin(0.5 * np.pi * window) ** 2 * np.sin(phase)


def loosened(truth: Mapping[str, float]) -> dict[str, float]:
    """Return the true parameters with less preload of the second bolt."""
    slip = {f"{name}@{LABELS[1]}": 1 / PRELOAD for name in ("delta", "gamma")}
    return {name: value * slip.get(name, 1.0) for name, value in truth.items()}


def made(
    seed: int, delta_ratio: float, *, is_loose: bool = False, substeps: int = SUBSTEPS
) -> tuple[Campaign, dict[str, float]]:
    """Return a simulated campaign, and the true values of its parameters by name."""
    # A generator of [seed, 0] equals that of the seed; noise must use other numbers than the truth.
    rng = np.random.default_rng([seed, 1 + is_loose])
    truth = drawn_truth(np.random.default_rng(seed), delta_ratio)
    truth = loosened(truth) if is_loose else truth
    bolts = [(BoucWenLaw(*(truth[f"{name}@{label}"] for name in MIDDLE)),) for label in LABELS]
    structure = reduced(bolts).structure()
    tests = []
    for name, (band_hz, forces) in SWEEPS.items():
        for force in forces:
            u = sweep(band_hz, force)
            motion = jbw.simulate(structure, u, FS, hold="band_limited", substeps=2 * SUBSTEPS)
            v = np.asarray(motion.v)
            v = v + NOISE * np.std(v) * rng.standard_normal(len(v))
            units = {"force": "N", "velocity": "m/s"}
            label = f"{name}_{force:g}N"
            record = Record(FS, {"force": u, "velocity": v}, units, label)
            tests.append(Test("sweep", (record,), label, level=force, run="one"))
    settings = Identify.of(
        {"offsets": "none", "model_error": "none", "substeps": substeps, "num_samples": 500}
    )
    model = reduced()
    for i, name in enumerate(("n", "2", "3")):
        truth[f"omega_{name}"] = float(model.omega[i])
    truth |= dict.fromkeys(("zeta", "zeta_2", "zeta_3"), ZETA)
    joints = SeveralJoints(model, LAWS)
    return Campaign("bolts", None, tuple(tests), laws=LAWS, joints=joints, settings=settings), truth


def identified(seed: int, campaign: Campaign) -> tuple[Fitted, xr.DataTree]:
    """Return the fit with separate joints and its posterior, as `jbw identify` computes them."""
    keys = jax.random.split(jax.random.key(seed), 3)
    seen = measured_in(campaign, lambda _: None)
    known = joint_readings(keys[0], seen).known
    ready = prepare(parts_of(keys[1], 2), assemble(seen), campaign.settings, known)
    return ready, sample_joint(keys[2], ready, campaign.settings, no_checkpoint, "joint")


def weighed(seed: int, campaign: Campaign) -> tuple[Fitted, amis.WeighedPoints]:
    """Return the quick fit with separate joints, and weighted points of its posterior."""
    keys = jax.random.split(jax.random.key(seed), 3)
    seen = measured_in(campaign, lambda _: None)
    known = joint_readings(keys[0], seen).known
    parts = parts_of(keys[1], 2)
    ready = prepare(parts, assemble(seen), campaign.settings, known, quick=True)
    optimum = ready.fit.theta, ready.fit.covariance, ready.box
    place = along_logarithms(*optimum, never_zero(*optimum))
    problem = problem_of(dataset.log_likelihood, ready.box, ready.data, place)
    points = amis.points(keys[2], problem, size=ROUND, least=EFFECTIVE, most_rounds=MOST_ROUNDS)
    return ready, points


def fitted(seed: int, campaign: Campaign, truth: Mapping[str, float]) -> Fitted:
    """Return the least-squares fit that starts at the truth, with weights from its residuals."""
    data = assemble(measured_in(campaign, lambda _: None))
    return prepare(parts_of(jax.random.key(seed), 2), data, campaign.settings, truth)


def compared(seed: int, delta_ratio: float, *, by_fit: bool = False) -> dict[str, Any]:
    """Return which bolts have changed, judged from two data sets, one with a loosened bolt.

    With `by_fit` the posteriors are normal, from fits that start at the truth of the first data
    set.
    """
    began, drawn, start = perf_counter(), [], made(seed, delta_ratio)[1]
    for is_loose in (False, True):
        campaign, _ = made(seed, delta_ratio, is_loose=is_loose)
        if by_fit:
            drawn.append(gaussian_draws(seed + is_loose, fitted(seed, campaign, start).fit))
        else:
            _, tree = identified(seed, campaign)
            drawn.append({name: np.ravel(draws) for name, draws in scalars(tree).items()})
    tight, loose = drawn
    rows = changed_joints(tight, loose, LAWS)
    return {
        "seed": seed,
        "wall": perf_counter() - began,
        "named": [row["joint"] for row in rows if row["changed"]],
        "chi_square": [row["chi_square"] for row in rows],
    }


def gaussian_draws(seed: int, best: Fit) -> dict[str, np.ndarray]:
    """Return draws from the normal distribution of a fit, by parameter name."""
    rng, middle = np.random.default_rng([seed, DRAWS_KEY]), list(best.theta.values())
    draws = rng.multivariate_normal(middle, best.covariance, NUM_DRAWS, method="cholesky")
    return dict(zip(best.theta, draws.T, strict=True))


def chi_square_of(truth: Mapping[str, float], ready: Fitted) -> float:
    """Return twice the log likelihood of the fit minus that of the truth."""
    points = {name: np.array([x, truth[name]]) for name, x in ready.fit.theta.items()}
    most, of_truth = at_points(dataset.log_likelihood, points, ready.data).sum(axis=1)
    return float(2 * (most - of_truth))


def tried(seed: int, delta_ratio: float) -> dict[str, Any]:
    """Return the answer from one data set: z-scores, intervals that contain the truth, evidence."""
    began, (campaign, truth) = perf_counter(), made(seed, delta_ratio)
    ready, tree = identified(seed, campaign)
    key = jax.random.fold_in(jax.random.key(seed), EVIDENCE_KEY)
    tied = tied_evidence(key, ready, campaign.settings)
    if tied is None:
        raise RuntimeError("the bolts have laws of one kind, but nothing was compared")
    draws = scalars(tree)
    ends = {name: np.quantile(draws[name], TAILS) for name in truth}
    return {
        "seed": seed,
        "wall": perf_counter() - began,
        "khat": float(tree.attrs["khat"]),
        "z": {name: float((x - np.mean(draws[name])) / np.std(draws[name]))
              for name, x in truth.items()},
        "within": {name: bool(ends[name][0] <= x <= ends[name][1]) for name, x in truth.items()},
        "chi_square": chi_square_of(truth, ready),
        "log_ratio": tied.log_ratio,
        "known": tied.is_trusted,
    }  # fmt: skip


def tried_by_intervals(seed: int, delta_ratio: float) -> dict[str, Any]:
    """Return the answer from weighted posterior points of one data set, without the evidence.

    An interval contains the true value if a share u of the weight is below it, 0.005 < u < 0.995.
    """
    began, cpu = perf_counter(), process_time()
    campaign, truth = made(seed, delta_ratio, substeps=COARSE)
    ready, points = weighed(seed, campaign)
    w = points.weights
    mean = {name: float(w @ points.theta[name]) for name in truth}
    std = {name: float(np.sqrt(w @ (points.theta[name] - mean[name]) ** 2)) for name in truth}
    below = {name: float(w @ (points.theta[name] < x)) for name, x in truth.items()}
    return {
        "seed": seed,
        "wall": perf_counter() - began,
        "cpu": process_time() - cpu,
        "khat": points.khat,
        "points": len(w),
        "z": {name: (x - mean[name]) / std[name] for name, x in truth.items()},
        "below": below,
        "within": {name: bool(TAILS[0] < u < TAILS[1]) for name, u in below.items()},
        "chi_square": chi_square_of(truth, ready),
    }


def tried_by_fit(seed: int, delta_ratio: float) -> dict[str, Any]:
    """Return the answer from a least-squares fit of one data set, without draws or evidence."""
    began, (campaign, truth) = perf_counter(), made(seed, delta_ratio)
    ready = fitted(seed, campaign, truth)
    std = dict(zip(ready.fit.theta, np.sqrt(np.diag(ready.fit.covariance)), strict=True))
    z = {name: float((x - ready.fit.theta[name]) / std[name]) for name, x in truth.items()}
    widest = stats.norm.ppf(TAILS[1])
    return {
        "seed": seed,
        "wall": perf_counter() - began,
        "z": z,
        "within": {name: bool(abs(x) <= widest) for name, x in z.items()},
        "chi_square": chi_square_of(truth, ready),
    }


def preferred(answer: Mapping[str, Any]) -> str:
    """Return which hypothesis the evidence prefers: one law for both bolts, or two laws."""
    return "tied" if answer["log_ratio"] > 0 else "own"


def line(answer: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return one row of the table of data sets."""
    is_told = "log_ratio" in answer
    evidence = (
        answer.get("khat"), answer.get("log_ratio"), preferred(answer) if is_told else None
    )  # fmt: skip
    within, z = answer["within"].values(), answer["z"].values()
    largest, chi_square = max(map(abs, z)), answer["chi_square"]
    by_chance = float(stats.chi2.sf(chi_square, len(z)))
    return (
        answer["seed"], answer["wall"], sum(within), len(within), largest, chi_square, by_chance,
        *evidence,
    )  # fmt: skip


def row(name: str, within: Sequence[bool], z: Sequence[float]) -> tuple[Any, ...]:
    """Return the coverage for one parameter, or for all, with the exact binomial test of 99 %."""
    chance = stats.binomtest(sum(within), len(within), CENTRAL).pvalue
    return name, len(within), sum(within), float(np.mean(z)), float(np.std(z)), float(chance)


def together(chi_squares: Sequence[float], num_parameters: int) -> tuple[Any, ...]:
    """Return the joint test of all parameters, against a chi-square distribution."""
    p = stats.chi2.sf(chi_squares, num_parameters)
    within = int(np.sum(p > 1 - CENTRAL))
    by_chance = stats.binomtest(within, len(p), CENTRAL).pvalue
    shape = stats.kstest(chi_squares, stats.chi2(num_parameters).cdf).pvalue
    mean = float(np.mean(chi_squares))
    return len(p), num_parameters, mean, within, float(by_chance), float(shape)


def tables(answers: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Return all tables: data sets, coverage, all parameters together, evidence, z-scores."""
    names = list(answers[0]["z"])
    rows = [row(n, [a["within"][n] for a in answers], [a["z"][n] for a in answers]) for n in names]
    every = [a[key][n] for key in ("within", "z") for a in answers for n in names]
    half = len(every) // 2
    rows.append(row("all, as if independent", every[:half], every[half:]))
    of_all = together([a["chi_square"] for a in answers], len(names))
    scores = [(a["seed"], *a["z"].values()) for a in answers]
    return [
        Table("Data sets", OF_DATA_SETS, [line(answer) for answer in answers]),
        Table("Intervals of own joints", COLUMNS, rows),
        Table("All parameters together", TOGETHER, [of_all]),
        *evidence_tables([answer for answer in answers if "log_ratio" in answer]),
        Table("z-scores", {"seed": "d", **dict.fromkeys(names, ".2f")}, scores),
    ]


def evidence_tables(answers: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Return the table of how often the evidence prefers one law for both bolts; empty without."""
    if not answers:
        return []
    counts = [sum(preferred(a) == answer for a in answers) for answer in ("tied", "own")]
    closest = min((a["log_ratio"] for a in answers), key=abs)
    trusted = sum(a["known"] for a in answers)
    return [Table("Tied against own", EVIDENCE, [(len(answers), *counts, trusted, closest)])]


def changed_line(answer: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return one row of the table of pairs of data sets."""
    named = " and ".join(answer["named"]) or "none"
    return answer["seed"], answer["wall"], named, *answer["chi_square"]


def changed_tables(answers: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Return the tables of pairs of data sets, and of how often the loosened bolt was named."""
    named = [answer["named"] for answer in answers]
    first, second = LABELS
    counts = (
        sum(names == [second] for names in named), sum(first in names for names in named),
        sum(not names for names in named),
    )  # fmt: skip
    return [
        Table("Pairs of data sets", CHANGED, [changed_line(answer) for answer in answers]),
        Table("The loosened bolt", COUNTED, [(len(answers), *counts)]),
    ]


class Kind(NamedTuple):
    """A kind of study: how an answer is computed from a data set, shown in a row, and tabulated."""

    answer_of: Callable[[int, float], dict[str, Any]]
    row_of: Callable[[Mapping[str, Any]], tuple[Any, ...]]
    columns: Mapping[str, str]
    tables_of: Callable[[Sequence[Mapping[str, Any]]], list[Table]]


KINDS = {
    "posterior": Kind(tried, line, OF_DATA_SETS, tables),
    "intervals": Kind(tried_by_intervals, line, OF_DATA_SETS, tables),
    "fit": Kind(tried_by_fit, line, OF_DATA_SETS, tables),
    "loosened": Kind(compared, changed_line, CHANGED, changed_tables),
    "loosened by fit": Kind(partial(compared, by_fit=True), changed_line, CHANGED, changed_tables),
}


def kept(file: Path | None, asked: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the answers in a file that belong to the same request."""
    if file is None or not file.exists():
        return []
    answers = [json.loads(text) for text in file.read_text().splitlines()]
    return [answer for answer in answers if asked.items() <= answer.items()]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--first", type=int, default=0, help="seed of the first data set")
    parser.add_argument("--number", type=int, default=20, help="of data sets")
    parser.add_argument("--delta-ratio", type=float, default=1.3, help="of the second bolt's delta")
    parser.add_argument("--answers", type=Path, help="keep every answer here, and go on from it")
    parser.add_argument("--loosened", action="store_true", help="name the bolt that was loosened")
    parser.add_argument("--intervals", action="store_true", help="of the posterior, nothing else")
    parser.add_argument("--by-fit", action="store_true", help="fit from the truth, no sampler")
    chosen = parser.parse_args(arguments)
    jbw.enable_x64()
    names = ("loosened", "loosened by fit") if chosen.loosened else ("posterior", "fit")
    name = "intervals" if chosen.intervals else names[chosen.by_fit]
    kind, asked = KINDS[name], {"kind": name, "delta_ratio": chosen.delta_ratio}
    answers = kept(chosen.answers, asked)
    done = {answer["seed"] for answer in answers}
    print(" | ".join(kind.columns), flush=True)
    for seed in range(chosen.first, chosen.first + chosen.number):
        if seed in done:
            continue
        answers.append(asked | kind.answer_of(seed, chosen.delta_ratio))
        if chosen.answers:
            with chosen.answers.open("a") as file:
                file.write(json.dumps(answers[-1]) + "\n")
        cells = zip(kind.row_of(answers[-1]), kind.columns.values(), strict=True)
        print(" | ".join("" if x is None else format(x, form) for x, form in cells), flush=True)
    show(kind.tables_of(answers), file=chosen.json)


if __name__ == "__main__":
    main()
