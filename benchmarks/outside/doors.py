"""What jbw reports on a campaign's files; only this module knows jbw's functions."""

import re
import shutil
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

LINE = re.compile(r"`((?:[\w.]+) = [^`]+)`")
HEAD = re.compile(r"under \[([\w.\[\]]+)\]")


class Finding(NamedTuple):
    """A finding of a check; `test` is empty if it belongs to no test."""

    severity: str
    test: str
    what: str
    remedy: str

    @property
    def lines(self) -> list[tuple[str, str]]:
        """The lines that the remedy tells the user to paste, each with its table."""
        head = HEAD.search(self.remedy)
        table = head.group(1) if head else "[test]"
        return [(table, line) for line in LINE.findall(self.remedy)]


class Row(NamedTuple):
    """Frequency and damping at an amplitude; standard deviations are NaN if none is stated."""

    test: str
    y: float
    hz: float
    hz_sd: float
    zeta: float
    zeta_sd: float


CUT = "before their blow"  # part of the sentence on records whose beginning is not evaluated


@dataclass
class Said:
    """Everything that jbw reports on a campaign file."""

    findings: list[Finding] = field(default_factory=list)
    statements: list[str] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    loops: list[dict[str, Any]] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)  # errors of functions that failed
    seconds: dict[str, float] = field(default_factory=dict)  # CPU seconds, by function

    @property
    def nonlinear(self) -> bool:
        """Whether jbw reports that the structure is nonlinear."""
        return any(re.search(r"Nonlinear: yes", sentence) for sentence in self.statements)


def ask(path: Path) -> Said:
    """Run `check` and `look` on a campaign file."""
    from jbw.campaign.check import check_campaign
    from jbw.campaign.load import load_campaign
    from jbw.study.look import look

    said = Said()
    checked = _through(said, "check", lambda: check_campaign(path))
    if checked is not None:
        said.findings = [
            Finding(fault.severity, row.test, fault.what, fault.remedy)
            for row in checked.rows
            for fault in row.findings
        ]
        if checked.exit_code:
            return said
    loaded = _through(said, "load", lambda: load_campaign(path))
    looked = loaded and _through(said, "look", lambda: look(loaded, report=lambda _: None))
    if looked is not None:
        cut = [sentence for sentence in looked.record.seen if CUT in sentence]
        said.statements = [*looked.record.statements, *cut]
        said.rows = list(_rows(looked.readings))
        said.loops = [loop.plain() for loop in looked.record.loops]
    return said


def draft(folder: Path, files: list[Path]) -> tuple[str, list[str], Said]:
    """Draft a campaign from files as `jbw init` does; return text, open questions, and a check."""
    from jbw.campaign.draft import start_campaign, write_campaign

    folder.mkdir()
    for file in files:
        shutil.copy(file, folder)
    said = Said()
    drafted = _through(said, "init", lambda: start_campaign(folder))
    if drafted is None:
        return "", [], said
    path = write_campaign(drafted, folder)
    checked = ask(path)
    checked.seconds |= said.seconds
    return drafted.text, list(drafted.assumed), checked


def quick(path: Path) -> tuple[dict[str, Any], dict[str, tuple[float, float]]]:
    """Identify a campaign by its fit alone, as `jbw identify --quick` does.

    Returns:
        The summary, and mean and standard deviation of each parameter that is one number.

    Raises:
        JbwError: The command would refuse the campaign.
    """
    import jbw

    jbw.enable_x64()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        study = jbw.identify(jbw.load_campaign(path), quick=True, report=lambda _: None)
    draws = study.tree["posterior"].to_dataset()
    numbers = {
        str(name): (float(x.mean()), float(x.std()))
        for name, x in draws.data_vars.items()
        if set(x.dims) <= {"chain", "draw"}
    }
    return study.summary(), numbers


def paste(text: str, finding: Finding) -> str | None:
    """Return a campaign file with the lines of a remedy inserted; None if the remedy has none."""
    changed = text
    for table, line in finding.lines:
        blocks = re.split(r"(?m)^(?=\[)", changed)
        key = line.split(" = ")[0]
        for i, block in enumerate(blocks):
            own = block.startswith(f"[{table}]") and (
                table != "[test]" or not finding.test or f'name = "{finding.test}"' in block
            )
            if own:
                kept = re.sub(rf"(?m)^{re.escape(key)} = .*\n", "", block)
                head, _, rest = kept.partition("\n")
                blocks[i] = f"{head}\n{line}\n{rest}"
                break
        changed = "".join(blocks)
    return changed if changed != text else None


def _rows(readings: dict[str, list[Any]]) -> Iterator[Row]:
    """Yield rows from the result of `look`: single amplitudes, or columns of several."""
    for test, of_test in readings.items():
        for one in of_test:
            hz = _column(one, "hz", "frequency_hz")
            zeta = _column(one, "zeta", "damping")
            y = _column(one, "y")
            nothing = np.full_like(hz, np.nan)
            sds = [_column(one, name) for name in ("frequency_sd", "damping_sd")]
            hz_sd, zeta_sd = (nothing if sd is None else sd for sd in sds)
            for values in zip(y, hz, hz_sd, zeta, zeta_sd, strict=True):
                yield Row(test, *map(float, values))


def _column(one: Any, *names: str) -> Any:
    for name in names:
        if hasattr(one, name):
            return np.atleast_1d(np.asarray(getattr(one, name), float))
    return None


def _through(said: Said, door: str, call: Callable[[], Any]) -> Any:
    """Call one of jbw's functions; record its CPU seconds, and its error if it fails."""
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            # warnings of loading, which the check has reported already
            warnings.simplefilter("ignore")
            return call()
    except Exception as error:
        said.errors.append(f"{door}: {type(error).__name__}: {' '.join(str(error).split())}")
        return None
    finally:
        said.seconds[door] = time.process_time() - start
