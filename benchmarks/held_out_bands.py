"""Do the bands of measured structures contain records that were not fitted?

Each test of a campaign, or each record of its decays, is left out in turn; a single record is cut
into four blocks. The rest is fitted, draws come from the Gaussian approximation at the optimum, and
the left-out part is predicted, without the model discrepancy and with it. Bands of 99 % should
contain 95 to 100 % of the values, and their mean half width divided by 2.58 times the error should
be 3 at most. A withheld band contains nothing. With --rig, the virtual rig makes sweeps of six
levels by the fitted law or by another one; an inner level and the highest one are left out.

    JBW_DATA=FOLDER python benchmarks/held_out_bands.py [--set "double beam"] [--json FILE]
    python benchmarks/held_out_bands.py --rig 5 [--first SEED] [--case "right law"] [--json FILE]
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import xarray as xr
from timing import Table, options, show

import jbw
from jbw import rig
from jbw.campaign.load import Campaign
from jbw.identification.assemble import measured_in
from jbw.identification.discrepancy import discrepancy_in
from jbw.identification.laplace import fit_alone
from jbw.identification.leaving_out import fits_without_each_run
from jbw.identification.model_discrepancy import model_discrepancy
from jbw.identification.selection import fitted_for_use
from jbw.measurement.records import Test
from jbw.observables.dataset import Dataset
from jbw.oscillator.laws import laws_named
from jbw.rig.generator import Sweep
from jbw.rig.presets import Preset
from jbw.study.quick import fit_tree
from jbw.verification.predict import Request, predict
from jbw.verification.predictive_basis import Basis, basis_of

FOLDER = Path(__file__).parent.parent / "notebooks" / "campaigns"
SETS = {
    "double beam": "bolted_double_beam",
    "Brake-Reuss": "brake_reuss_beam",
    "hysteretic benchmark": "hysteretic_benchmark",
    "friction damper": "friction_damper",
    "F-16": "f16_sweep",
    "F-16, multisines": "f16_multisine",
    "Silverbox": "silverbox",
}
# standard deviation of the logarithms of the law's parameters
OMEGA_N, ZETA, SCATTER = 2 * np.pi * 18.8, 0.00444, 0.2
BOUC_WEN = {"alpha": 2500.0, "delta": 340.0, "gamma": 90.0}
IWAN = {"iwan_stiffness": 1500.0, "iwan_loss": 217.0, "iwan_chi": -0.3, "iwan_beta": 0.5}
# true parameters, the fitted laws, and the smallest and largest level [V]
RIG = {
    "right law": (BOUC_WEN, ("bouc_wen",), (0.01, 0.08)),
    "Iwan under Bouc-Wen": (IWAN, ("bouc_wen",), (0.005, 0.04)),
    "softening under cubic": (BOUC_WEN, ("cubic",), (0.01, 0.08)),
    "extra damping": ({**BOUC_WEN, "quadratic_damping": 20.0}, ("bouc_wen",), (0.01, 0.08)),
}
TRUE = {
    "right law": ("bouc_wen",),
    "Iwan under Bouc-Wen": ("iwan4",),
    "softening under cubic": ("bouc_wen",),
    "extra damping": ("bouc_wen", "quadratic_damping"),
}
LEFT_OUT = (2, 5)  # indices of left-out levels among six
NUM_BLOCKS = 4  # number of blocks of a set with only one record
REACH = 2.576  # standard deviations from the centre of a 99 % band to its ends
COLUMNS = {
    "set": "",
    "left out": "",
    "error, %": ".2g",
    "own frequency, %": ".2g",
    "held before, %": ".1f",
    "held, %": ".1f",
}
COLUMNS |= {"width before": ".2f", "width": ".2f", "missed": "", "time, s": ".0f"}


def folds(campaign: Campaign) -> Iterator[tuple[Campaign, Test]]:
    """Yield a campaign without each of its tests (or records) in turn, and the left-out test."""
    tests = campaign.tests
    records_of_one = len(tests) == 1 and len(tests[0].records) > 1
    if records_of_one:
        tests = tuple(replace(tests[0], records=(one,)) for one in tests[0].records)
    elif len(tests) == 1:
        tests = tuple(blocks(tests[0]))
    for i, test in enumerate(tests):
        rest = tuple(other for j, other in enumerate(tests) if j != i)
        if records_of_one:  # All records are in one test again.
            rest = (replace(test, records=tuple(other.records[0] for other in rest)),)
        held = replace(test, name=f"{test.name}, {i + 1}")
        known = fitted_for_use(rest, campaign.settings)
        yield replace(campaign, tests=rest, settings=known), held


def blocks(test: Test) -> Iterator[Test]:
    """Yield four blocks of a record; the first third of each lets its initial state decay."""
    (record,) = test.records
    size = record.num_samples // NUM_BLOCKS
    for i in range(NUM_BLOCKS):
        cut = {name: x[i * size : (i + 1) * size] for name, x in record.channels.items()}
        yield replace(
            test,
            kind="sweep",
            name=f"block {i + 1}",
            periods=1,
            settle=size / record.fs / 3,
            records=(replace(record, channels=cut),),
        )


def bases(campaign: Campaign) -> tuple[Basis, Basis]:
    """Return the basis of predictions from a campaign's fit, without and with model discrepancy."""
    seen = measured_in(campaign, lambda said: None, campaign.tests)
    found = fit_alone(seen, seed=0, report=lambda said: None)
    ready = found.joint.fitted
    fits = fits_without_each_run(ready.fit, ready.box, ready.data)
    missed = model_discrepancy(ready.fit, ready.box, ready.data, fits)
    tree = fit_tree(seen, found)
    posterior = tree["posterior"].to_dataset()
    tree["posterior"] = xr.DataTree(posterior.assign(noise_of(ready.data, posterior.sizes)))
    basis = basis_of(tree)
    return basis, replace(basis, discrepancy=discrepancy_in(missed))


def noise_of(data: Dataset, sizes: Mapping[str, int]) -> dict[str, Any]:
    """Return the noise of every data group of the fit, in the form of a posterior."""
    known, shape = {}, (sizes["chain"], sizes["draw"])
    for i, part in enumerate(data.parts):
        if part.dimension:
            std, dim = np.asarray(part.groups.noise_std), f"{part.dimension}_{i}"
            dim = "record" if part.own_shifts else dim
            name = "noise_std" if part.own_shifts else f"noise_std_{i}"
            values = np.broadcast_to(std, (*shape, len(std)))
            known[name] = (("chain", "draw", dim), values, {"units": part.groups.unit})
            known[dim] = (dim, list(part.groups.labels))
    return known


def rows(name: str) -> Iterator[dict[str, Any]]:
    """Yield one row per left-out part of a set, with the coverage of its bands."""
    campaign = jbw.load_campaign(FOLDER / f"{SETS[name]}.toml", allow_outside=True)
    for rest, held in folds(campaign):
        started = perf_counter()
        row = {"set": name, "left out": held.name}
        yield row | compared(*bases(rest), held) | {"time, s": perf_counter() - started}


def missed_by(basis: Basis) -> str:
    """Return the quantities in which the law's error exceeds noise, as the verdict lists them."""
    discrepancy = basis.discrepancy
    assert discrepancy is not None
    both = zip(discrepancy.forced, discrepancy.decays, strict=True)
    named = [
        name
        for name, scatters in zip(("frequency", "damping"), both, strict=True)
        if any(scatter.whole for scatter in scatters)
    ]
    rest = ["rest"] if any(share.whole for share in discrepancy.share.values()) else []
    return " and ".join([*named, *rest]) or "nothing"


def compared(before: Basis, after: Basis, held: Test) -> dict[str, Any]:
    """Return the coverage of a test's bands, without and with the model discrepancy."""
    found: dict[str, Any] = {"missed": missed_by(after)}
    for suffix, basis in ((" before", before), ("", after)):
        attrs = predict(basis, held, Request(seed=1)).attrs
        found["error, %"] = 100 * float(attrs["nrmse"])
        found["own frequency, %"] = 100 * float(attrs.get("nrmse_own_frequency", np.nan))
        found[f"held{suffix}, %"] = 100 * float(attrs.get("coverage", np.nan))
        width = float(attrs.get("half_width", np.nan))
        found[f"width{suffix}"] = width / (REACH * found["error, %"] / 100)
    if "withheld" in attrs:
        found["missed"] += "; the band is withheld"
    return found


def made(case: str, seed: int) -> Campaign:
    """Return a campaign of sweeps at six levels from the rig; the case states the fitted laws."""
    truth, laws, levels = RIG[case]
    rng = np.random.default_rng(seed)
    theta = {name: x * np.exp(SCATTER * rng.standard_normal()) for name, x in truth.items()}
    joint = jbw.Oscillator(OMEGA_N, ZETA, tuple(law.build(theta) for law in laws_named(TRUE[case])))
    plans = tuple(
        rig.Plan(
            f"sweep_{1e3 * level:.1f}mV", "sweep",
            Sweep(12.0, 26.0, level, burst=3.0, fade=0.2, duration=4.0), repeats=2,
        )
        for level in np.geomspace(*levels, 6)
    )  # fmt: skip
    preset = Preset(
        name=case, gain=15.0, input_range=1.0, velocity_range=2.0, plans=plans, noise_ratio=0.01
    )
    campaign = rig.measure(preset, joint=joint, seed=seed, fs=256.0)
    return replace(campaign, laws=laws)


def rig_rows(case: str, seed: int) -> Iterator[dict[str, Any]]:
    """Yield the coverage of the bands for two left-out levels, an inner one and the highest."""
    campaign, started = made(case, seed), perf_counter()
    held = [campaign.tests[i] for i in LEFT_OUT]
    tests = tuple(test for i, test in enumerate(campaign.tests) if i not in LEFT_OUT)
    settings = {"prior": {}, "fit": None, "fit_levels": [x.level for x in tests], "fit_repeats": 2}
    known = campaign.settings.model_copy(update=settings)
    before, after = bases(replace(campaign, tests=tests, settings=known))
    for test in held:
        row = {"set": case, "left out": f"{test.name}, seed {seed}"}
        yield row | compared(before, after, test) | {"time, s": perf_counter() - started}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--set", action="append", choices=SETS, help="of those; all when left out")
    parser.add_argument("--rig", type=int, metavar="N", help="campaigns of each case on the rig")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="that of the first")
    parser.add_argument("--case", action="append", choices=RIG, help="of those on the rig")
    chosen = parser.parse_args(arguments)
    jbw.enable_x64()
    found = []
    if chosen.rig:
        seeds = range(chosen.first, chosen.first + chosen.rig)
        cases = chosen.case or list(RIG)
        each = (row for seed in seeds for case in cases for row in rig_rows(case, seed))
    else:
        each = (row for name in chosen.set or SETS for row in rows(name))
    for row in each:
        print(row, flush=True)
        found.append([row[column] for column in COLUMNS])
    show([Table("Bands of what was left out", COLUMNS, found)], file=chosen.json)


if __name__ == "__main__":
    main()
