"""The command that compares laws of the joint: `jbw laws CAMPAIGN`."""

from pathlib import Path
from typing import Any

import click

from jbw.cli.options import json_option, out_option, outside_option, seed_option
from jbw.cli.printing import answer
from jbw.cli.progress import computing, working
from jbw.report.law_table import free_law_table, laws_table


@click.command()
@click.argument("source", metavar="CAMPAIGN", type=click.Path(exists=True, path_type=Path))
@click.option(
    "--laws", help='Laws separated by commas, such as "cubic, iwan4 + cubic"; by default the '
                   "usual laws.",
)  # fmt: skip
@seed_option("campaign")
@out_option("laws next to CAMPAIGN")
@json_option
@outside_option
def laws(
    source: Path, laws: str | None, out: Path | None, json_: bool, allow_outside: bool, seed: Any
) -> None:
    """Compare laws of the joint on CAMPAIGN, a campaign file or a run's folder.

    All laws are fitted to the same data with the same weights. Each run is left out in turn and
    predicted from the others; the differences of the log scores, with their standard errors, show
    which laws the data distinguish. laws.json contains all numbers, laws.nc the posteriors and
    curves, laws.html this table and the measured points on every law's backbone, laws.png each
    law's frequency and damping against amplitude, loop and residual. `jbw predict` on the folder
    predicts tests by all laws, each with its weight.
    """
    with computing() as say:
        from jbw.campaign.load import load_campaign
        from jbw.law_comparison.compare import compare_laws
        from jbw.law_comparison.stack import save_laws
        from jbw.study.study import campaign_of, inputs_of

        path = campaign_of(source) if source.is_dir() else source
        with working(say, out or path.parent / "laws") as job:
            folder = job.folder
            say(f"Reading {path}")
            loaded = load_campaign(path, allow_outside=allow_outside)
            chosen = None if laws is None else [name.strip() for name in laws.split(",")]
            parts = job.parts(inputs_of(loaded), say)
            compared = compare_laws(loaded, chosen, seed=seed, report=say, parts=parts)
            save_laws(folder, compared.tree, compared.result)
    record = compared.result
    tables = [table for table in (laws_table(record), free_law_table(record)) if table is not None]
    lines = *tables, *record.statements
    refused = (f"{name}: {reason}" for name, reason in record.refused.items())
    answer(json_, compared.record, *lines, *refused, saved=f"Laws: {folder / 'laws.html'}")
