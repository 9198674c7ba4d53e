"""The command `jbw sbc`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from jbw.cli.options import json_option, out_option, outside_option, seed_option
from jbw.cli.printing import answer, verdict_lines
from jbw.cli.running import NOT_TRUSTED, computing
from jbw.report.table import Column, Table, table, words


@click.command()
@click.argument("source", metavar="[CAMPAIGN]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--step", default="third_order", show_default=True,
    help="linear, third_order, opening or joint.",
)  # fmt: skip
@click.option(
    "--replications", "num_replications", type=int,
    help="Truths; 1000, or 200 of the joint posterior.",
)  # fmt: skip
@click.option("--sampler", help="Sampler; the cheapest that suits when left out.")
@click.option(
    "--noise", default="unknown", show_default=True,
    help="Of Step 3: unknown, as it is identified, or known, as the paper supposes.",
)  # fmt: skip
@seed_option(default=0)
@out_option("sbc-STEP")
@json_option
@outside_option
def sbc(
    source: Path | None, out: Path | None, json_: bool, allow_outside: bool, **asked: Any
) -> int:
    """Calibrate a step by simulation: does it hold the truth as often as it says?

    Truths are drawn from the prior, data simulated from them and identified; the ranks of the
    truths among the posterior draws must be uniform. Tests, noise and prior are those of CAMPAIGN,
    a campaign file or the folder of a finished run, or short tests of the virtual rig. Failed
    replications are counted, never dropped. Exit code 4 when the step is not calibrated.
    """
    with computing() as say:
        from jbw.campaign.load import load_campaign
        from jbw.study import calibration
        from jbw.study.store import claim
        from jbw.study.study import campaign_of

        folder = claim(out or Path(f"sbc-{asked['step']}"))
        try:
            campaign = None
            if source is not None:
                path = campaign_of(source) if source.is_dir() else source
                say(f"Reading {path}")
                campaign = load_campaign(path, allow_outside=allow_outside)
            found = calibration.sbc(campaign, report=say, **asked)
            calibration.save_sbc(folder, found)
        except BaseException:
            if not any(folder.iterdir()):
                folder.rmdir()
            raise
    verdict = found.record["verdict"]
    told = calibration_table(found.record), *verdict_lines(verdict, passed=True)
    answer(json_, found.record, *told, saved=f"Calibration: {folder / 'sbc.json'}")
    return 0 if verdict["status"] == "ok" else NOT_TRUSTED


def calibration_table(record: Mapping[str, Any]) -> Table:
    """The calibration, a line a quantity."""
    columns = [
        Column(heading, lambda row, key=key, form=form: format(row[key], form))
        for heading, key, form in (
            ("p (ECDF)", "p_ecdf", ".2g"),
            ("p (chi2)", "p_chi_square", ".2g"),
            ("99 % holds", "coverage_99", ".2%"),
            ("of which", "coverage_99_lower", ".2%"),
            ("to", "coverage_99_upper", ".2%"),
        )
    ]
    return table(
        f"{record['step']}: {record['replications']} replications by {record['sampler']}, "
        f"{record['failed']} failed",
        [{"quantity": name, **one} for name, one in record["quantities"].items()],
        words("quantity", "quantity"),
        *columns,
    )
