"""The command that compares laws of the joint: `jbw laws CAMPAIGN`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from jbw.cli.options import json_option, out_option, outside_option, seed_option
from jbw.cli.printing import answer
from jbw.cli.progress import computing
from jbw.report.table import Column, Table, table, words
from jbw.report.text import NOTHING


@click.command()
@click.argument("source", metavar="CAMPAIGN", type=click.Path(exists=True, path_type=Path))
@click.option(
    "--laws", help='Laws with commas between them, as "cubic, iwan4 + cubic"; the usual ones when '
    "left out.",
)  # fmt: skip
@seed_option("campaign")
@out_option("laws beside CAMPAIGN")
@json_option
@outside_option
def laws(
    source: Path, laws: str | None, out: Path | None, json_: bool, allow_outside: bool, seed: Any
) -> None:
    """Try laws of the joint on CAMPAIGN, a campaign file or a run's folder.

    All are fitted to the same data with the same weights. Each run is left out in turn and
    predicted from the others; the differences of the log scores, with their standard errors, say
    which laws are told apart, and which are not. laws.json has all numbers, laws.nc the posteriors
    and curves, laws.png what each law makes of amplitude, its loop and what it leaves. `jbw
    predict` on the folder predicts tests with all of them, each by its weight.
    """
    with computing() as say:
        from jbw.campaign.load import load_campaign
        from jbw.study.laws import compare_laws
        from jbw.study.stack import save_laws
        from jbw.study.store import claim
        from jbw.study.study import campaign_of

        path = campaign_of(source) if source.is_dir() else source
        folder = claim(out or path.parent / "laws")
        say(f"Reading {path}")
        loaded = load_campaign(path, allow_outside=allow_outside)
        chosen = None if laws is None else [one.strip() for one in laws.split(",")]
        found = compare_laws(loaded, chosen, seed=seed, report=say)
        save_laws(folder, found.tree, found.record)
    record = found.record
    told = laws_table(record), *record["statements"]
    refused = (f"{name}: {reason}" for name, reason in record["refused"].items())
    answer(json_, record, *told, *refused, saved=f"Laws: {folder / 'laws.json'}")


def laws_table(record: Mapping[str, Any]) -> Table:
    """A line a law, the best first."""
    rows = [{"law": name, "floor": record["line"], **row} for name, row in record["laws"].items()]
    worst = -float("inf")

    def rank(row: Mapping[str, Any]) -> float:
        for key in ("elpd", "log_evidence"):
            if row[key] is not None:
                return row[key]
        return worst

    return table(
        f"Laws of the joint: {record['campaign']}",
        sorted(rows, key=rank, reverse=True),
        words("law", "law"),
        words("parameters", "num_parameters", "right"),
        _percent("fit [%]", "error"),
        _percent("left out [%]", "error_left_out"),
        _percent("highest [%]", "error_highest"),
        _percent("held out [%]", "error_held_out"),
        _percent("beyond [%]", "error_beyond"),
        _percent("own lines [%]", "floor"),
        Column("log score", _difference("elpd_difference", "elpd_difference_se")),
        _number("weight", "weight", ".2f"),
        Column("log evidence", _difference("log_evidence_difference", "log_evidence_error")),
        Column("answer", lambda row: row["answer"], align="left"),
    )


def _number(heading: str, key: str, form: str, scale: float = 1.0) -> Column:
    def shown(row: Mapping[str, Any]) -> str:
        return NOTHING if row[key] is None else format(scale * row[key], form)

    return Column(heading, shown)


def _percent(heading: str, key: str) -> Column:
    return _number(heading, key, ".3g", 100.0)


def _difference(key: str, error: str) -> Any:
    def shown(row: Mapping[str, Any]) -> str:
        if row[key] is None:
            return NOTHING
        told = f"{row[key]:+.1f}" if row[key] else "0"
        return told if row[error] is None else f"{told} +- {row[error]:.2g}"

    return shown
