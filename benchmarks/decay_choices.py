"""How far do band, settling time and choice of impacts change a joint identified from decays?

Nine impacts on a bolted double beam are fitted by Bouc-Wen's law with three bands and three values
of `settle`, all nine together and the three at each place of impact. Printed are alpha * gamma and
alpha * delta with their 99 % intervals, then three standard deviations of each product relative to
its mean: between the choices, between the places for one choice, and between records fitted one by
one beyond their own errors, as `jbw identify` reports it. The run takes twenty minutes.

    JBW_DATA=FOLDER python benchmarks/decay_choices.py [--calls 5] [--json FILE]
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr
from timing import Table, options, show

import jbw
from jbw.campaign.load import Campaign
from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured_in
from jbw.identification.leaving_out import REACH, between_records
from jbw.identification.prepare import prepare
from jbw.inference.fit.fitting import Fit

BANDS = ((95.0, 150.0), (85.0, 160.0), (105.0, 140.0))  # [Hz]; the other mode is at 243 Hz
SETTLES = (0.05, 0.15, 0.3)  # [s]
CHOICES = (
    *((BANDS[0], settle) for settle in SETTLES),
    *((band, SETTLES[0]) for band in BANDS[1:]),
)
# Records 1 to 3, 4 to 6 and 7 to 9 have blows at one place each.
PLACES = {f"place {i + 1}": slice(3 * i, 3 * i + 3) for i in range(3)}
SETS = {"all": slice(None), **PLACES}
PRODUCTS = ("gamma", "delta")  # factors of alpha in the products
TEST = """
[campaign]
name = "bolted double beam"
[[test]]
kind = "decay"
name = "impacts"
files = "$JBW_DATA/bolted_double_beam/data.mat"
channels = { velocity = "xData[:, 1]" }
units = { velocity = "m/s" }
fs = 5120.0
band = [95.0, 150.0]
"""


class Known(NamedTuple):
    """A product of a fit's parameters and its standard deviation."""

    value: float
    std: float


class Row(NamedTuple):
    """A choice of settings and records: products of their fit, and variation between records."""

    band: tuple[float, float]  # [Hz]
    settle: float  # [s]
    records: str
    known: dict[str, Known]
    between: xr.Dataset | None


def campaign() -> Campaign:
    """Return the campaign of impacts, with every record fitted."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "campaign.toml"
        path.write_text(TEST)
        loaded = jbw.load_campaign(path, allow_outside=True)
    return replace(loaded, settings=Identify(fit_repeats="all", coordinates="paper"))


def chosen(taken: Campaign, band: tuple[float, float], settle: float, which: slice) -> Campaign:
    """Return the campaign with another band and settling time, and with some of its records."""
    (test,) = taken.tests
    some = replace(test, band_hz=band, settle=settle, records=test.records[which])
    return replace(taken, tests=(some,))


def known(fit: Fit, name: str) -> Known:
    """Return alpha times a parameter of the fit, and its standard deviation to first order."""
    slope = np.array(
        [{"alpha": fit.theta[name], name: fit.theta["alpha"]}.get(each, 0.0) for each in fit.theta]
    )
    std = float(np.sqrt(slope @ fit.covariance @ slope))
    return Known(fit.theta["alpha"] * fit.theta[name], std)


def rows(calls: int) -> Iterator[Row]:
    """Yield the fitted products of each choice and set of records; the first with record variation.

    Later fits start at the optimum of the first.
    """
    taken, begun = campaign(), None
    for band, settle in CHOICES[:calls]:
        for name, which in SETS.items():
            seen = measured_in(chosen(taken, band, settle, which), lambda _: None)
            keys = jax.random.split(jax.random.key(0))
            fitted = prepare(keys, assemble(seen), seen.settings, begun, quick=begun is not None)
            between = between_records(fitted.fit, fitted.box, fitted.data) if not begun else None
            begun = begun or fitted.fit.theta
            row = Row(band, settle, name, {x: known(fitted.fit, x) for x in PRODUCTS}, between)
            print(f"{band} Hz, {settle} s, {name}: {row.known}", file=sys.stderr, flush=True)
            yield row


def scatters(found: Sequence[Row], one: str) -> tuple[str, float, float, float, float]:
    """Return a product's stated relative error, and its sd between choices, places and records."""
    of_set = {
        name: np.array([row.known[one] for row in found if row.records == name]) for name in SETS
    }
    whole = of_set["all"][:, 0]
    mean = float(np.mean(whole))
    apart = np.std([of_set[name][:, 0] for name in PLACES], axis=0, ddof=1)
    between = next(row.between for row in found if row.between is not None)
    return (
        f"alpha * {one}",
        REACH * float(np.sqrt(np.mean(of_set["all"][:, 1] ** 2))) / mean,
        float(np.std(whole, ddof=1)) / mean if len(whole) > 1 else np.nan,
        float(np.sqrt(np.mean(apart**2))) / mean,
        float(between["scatter"].sel(quantity=f"alpha_{one}")),
    )


def main() -> None:
    """Print the tables of products and of their variations."""
    asked = options(__doc__, calls=len(CHOICES)).parse_args()
    jbw.enable_x64()
    found = list(rows(asked.calls))
    columns = {"band, Hz": "", "settle, s": ".2f", "records": ""}
    for one in PRODUCTS:
        columns |= {f"alpha * {one}": ".4g", f"99 % of {one}": ""}
    table = Table(
        "Products of the nine impacts, by band, settling time and records",
        columns,
        [
            (f"{row.band[0]:g} to {row.band[1]:g}", row.settle, row.records,
             *(cell for one in PRODUCTS for cell in _cells(row.known[one])))
            for row in found
        ],
    )  # fmt: skip
    spread = Table(
        "Half of the stated 99 % interval, and standard deviations, over the product",
        {"product": "", "99 % of all": ".3f", "between choices": ".3f",
         "between places": ".3f", "between records": ".3f"},
        [scatters(found, one) for one in PRODUCTS],
    )  # fmt: skip
    show([table, spread], file=asked.json)


def _cells(one: Known) -> tuple[float, str]:
    low, high = one.value - REACH * one.std, one.value + REACH * one.std
    return one.value, f"[{low:.4g}, {high:.4g}]"


if __name__ == "__main__":
    main()
