"""The command `jbw sbc`."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from jbw.cli.printing import print_columns

NOT_CALIBRATED = 4
HEADER = ("quantity", "p (ECDF)", "p (chi2)", "99 % holds", "of which", "to")


@click.command()
@click.argument("source", metavar="[CAMPAIGN]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--step", default="third_order", show_default=True,
    help="linear, third_order, opening or joint.",
)  # fmt: skip
@click.option("--replications", type=int, help="Truths; 1000, or 200 of the joint posterior.")
@click.option("--sampler", help="Sampler; the cheapest that suits when left out.")
@click.option(
    "--noise", default="unknown", show_default=True,
    help="Of Step 3: unknown, as it is identified, or known, as the paper supposes.",
)  # fmt: skip
@click.option("--seed", default=0, show_default=True, help="Seed of everything random.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="New or empty folder to write to; sbc-STEP when left out.",
)
@click.option("--json", "json_", is_flag=True, help="Print the calibration as JSON.")
@click.option("--allow-outside", is_flag=True, help="Read files outside the campaign's folder.")
def sbc(
    source: Path | None,
    step: str,
    replications: int | None,
    sampler: str | None,
    noise: str,
    seed: int,
    out: Path | None,
    json_: bool,
    allow_outside: bool,
) -> int:
    """Calibrate a step by simulation: does it hold the truth as often as it says?

    Truths are drawn from the prior, data simulated from them and identified; the ranks of the
    truths among the posterior draws must be uniform. Tests, noise and prior are those of CAMPAIGN,
    a campaign file or the folder of a finished run, or short tests of the virtual rig. Failed
    replications are counted, never dropped. Exit code 4 when the step is not calibrated.
    """
    from jbw.cli.progress import progress
    from jbw.cli.running import prepare_jax

    prepare_jax()
    from jbw.campaign.loading import load_campaign
    from jbw.study.calibration import save_sbc
    from jbw.study.calibration import sbc as calibrate_step
    from jbw.study.known_run import campaign_of
    from jbw.study.storage import claim

    folder = claim(out or Path(f"sbc-{step}"))
    try:
        with progress() as say:
            campaign = None
            if source is not None:
                path = campaign_of(source) if source.is_dir() else source
                say(f"Reading {path}")
                campaign = load_campaign(path, allow_outside=allow_outside)
            found = calibrate_step(
                campaign, step=step, num_replications=replications, sampler=sampler, noise=noise,
                seed=seed, report=say,
            )  # fmt: skip
            save_sbc(folder, found)
    except BaseException:
        if not any(folder.iterdir()):
            folder.rmdir()
        raise
    if json_:
        click.echo(json.dumps(found.record, indent=1))
    else:
        print_calibration(found.record)
        click.echo(f"Calibration: {folder / 'sbc.json'}")
    return 0 if found.record["verdict"]["status"] == "ok" else NOT_CALIBRATED


def print_calibration(record: Mapping[str, Any]) -> None:
    """A line a quantity, then failures and the verdict, on stdout."""
    click.echo(
        f"{record['step']}: {record['replications']} replications by {record['sampler']}, "
        f"{record['failed']} failed"
    )
    rows = [HEADER, *(_line(name, one) for name, one in record["quantities"].items())]
    print_columns(rows)
    click.echo(f"Verdict: {record['verdict']['status']}")
    for finding in record["verdict"]["findings"]:
        told = f"  {finding['reason']} {finding['action']}".rstrip()
        more = "" if finding["status"] == "ok" else f" (jbw explain {finding['code']})"
        click.echo(told + more)


def _line(name: str, one: Mapping[str, float]) -> tuple[str, ...]:
    shares = ("coverage_99", "coverage_99_lower", "coverage_99_upper")
    return (
        name, f"{one['p_ecdf']:.2g}", f"{one['p_chi_square']:.2g}",
        *(f"{one[share]:.2%}" for share in shares),
    )  # fmt: skip
