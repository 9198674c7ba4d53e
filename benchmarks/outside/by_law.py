"""Campaigns of each law, judged one by one, with the options that all such benchmarks have."""

import argparse
import json
import secrets
import tempfile
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jbw.run.session import prepare_process

from .plants import COMMON, Rng

Row = dict[str, Any]


def judge_each(
    name: str,
    judged: Callable[[Rng, str, int, Path], Row],
    table: Callable[[Sequence[Row]], str],
    arguments: Sequence[str] | None = None,
) -> None:
    """Judge campaigns of each law one by one, and print the table of results.

    Args:
        name: Name of the benchmark's module.
        judged: Function that draws and judges one campaign: of random numbers, the law, the number
            of the campaign, and a folder for its files.
        table: Function that returns the rows as a table in Markdown.
        arguments: Arguments of the command line; those of the process by default.
    """
    made = argparse.ArgumentParser(prog=f"python -m benchmarks.outside.{name}")
    made.add_argument("--campaigns", type=int, default=20, help="of each law")
    made.add_argument("--law", nargs="+", choices=COMMON, default=COMMON)
    made.add_argument("--seed", type=int, help="to repeat a run; a fresh one when left out")
    made.add_argument("--only", type=int, nargs="+", metavar="N", help="numbers of campaigns")
    made.add_argument("--keep", type=Path, help="folder that keeps the files")
    made.add_argument("--out", type=Path, help="file of JSON lines that outcomes are appended to")
    chosen = made.parse_args(arguments)
    prepare_process()  # with the cache of compiled code that commands have
    seed = secrets.randbits(48) if chosen.seed is None else chosen.seed
    print(f"Seed {seed}: add `--seed {seed}` to repeat.\n", flush=True)
    rows = []
    for i in range(chosen.campaigns):
        for law in chosen.law:
            if chosen.only and i not in chosen.only:
                continue
            rng = np.random.default_rng([seed, COMMON.index(law), i])
            with tempfile.TemporaryDirectory() as temporary:
                folder = (chosen.keep or Path(temporary)) / f"{seed}-{law}-{i}"
                try:
                    row = {"seed": seed, "number": i} | judged(rng, law, i, folder)
                except Exception:
                    print(law, i, traceback.format_exc(), flush=True)
                    continue
            rows.append(row)
            if chosen.out:
                with chosen.out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    print(table(rows))
