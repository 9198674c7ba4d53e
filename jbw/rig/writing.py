"""The campaign into a folder, as a laboratory would leave it: HDF5 files and a campaign file."""

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jbw.campaign.document import toml
from jbw.errors import RunError
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.records import Test
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import rig as messages
from jbw.rig.acquisition import RigCampaign


def write(campaign: RigCampaign, folder: str | Path) -> Path:
    """Writes the campaign's files; the campaign file comes last and marks the folder complete.

    A folder that an interrupted writing left behind is completed; equal campaigns give equal
    files, byte for byte. The path of `campaign.toml` is returned.

    Raises:
        RunError: When the folder holds a campaign or other data files, or cannot be written.
    """
    folder = Path(folder)
    target = folder / "campaign.toml"
    _check_folder(campaign, folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for test in campaign.tests:
            demands = campaign.demands.get(test.name, (None,) * len(test.records))
            for record, demand in zip(test.records, demands, strict=True):
                filed = record
                if demand is not None:  # beside what was measured of the source
                    channels = {"demand": demand, **record.channels}
                    units = {"demand": record.units[record.source], **record.units}
                    filed = replace(record, channels=channels, units=units)
                # float32 holds the 24 bits of the converters exactly; a curve has no converter.
                dtype = np.float64 if np.isnan(record.fs) else np.float32
                write_hdf5(folder / f"{record.name}.h5", filed, dtype=dtype)
        _write_text(folder / "truth.json", json.dumps(campaign.truth, indent=2) + "\n")
        _write_text(target, _campaign_text(campaign))
    except OSError as error:
        raise RunError(
            f"Folder {folder} must be writable, but: {error}.",
            remedy="Free some space or choose another folder.",
        ) from error
    return target


def _check_folder(campaign: RigCampaign, folder: Path) -> None:
    """A finished campaign is never overwritten, and no stranger may match a file pattern."""
    if (folder / "campaign.toml").exists():
        raise RunError(
            f"Folder {folder} must be new or empty, but holds a campaign.",
            remedy="Choose another folder, or remove this one.",
        )
    planned = {f"{record.name}.h5" for test in campaign.tests for record in test.records}
    strangers = sorted(path.name for path in folder.glob("*.h5") if path.name not in planned)
    if strangers:
        raise RunError(
            f"Folder {folder} must hold no other data, but holds {strangers[0]}.",
            why="The campaign file's patterns would take it for a repeat.",
            remedy="Choose an empty folder.",
        )


def _write_text(path: Path, text: str) -> None:
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)


def _campaign_text(campaign: RigCampaign) -> str:
    blocks = [f"{messages.HEAD}\n[campaign]\nname = {toml(campaign.name)}\n"]
    if stated := dict(campaign.assembly):
        blocks.append(_table("[assembly]", stated))
    if campaign.laws != DEFAULT_LAWS:
        blocks.append(_table("[joint]", {"laws": campaign.laws}))
    if campaign.structure is not None:
        blocks.append(_table("[structure]", dict(campaign.structure)))
    blocks += [_test_text(test) for test in campaign.tests]
    if stated := dict(campaign.settings):
        prior = stated.pop("prior", None)
        blocks.append(_table(f"{messages.IDENTIFY}\n[identify]", stated))
        if prior is not None:
            blocks.append(_table(f"{messages.PRIOR}\n[identify.prior]", prior))
    return "\n".join(blocks)


def _table(head: str, table: Mapping[str, Any]) -> str:
    """A table, keys that say nothing left out."""
    stated = [f"{key} = {toml(value)}" for key, value in table.items() if value is not None]
    return "\n".join([head, *stated]) + "\n"


def _test_text(test: Test) -> str:
    record, purpose = test.records[0], messages.PURPOSE.get(test.name.split("_")[0])
    table = {
        "name": test.name,
        "kind": test.kind,
        "files": f"{test.name}_*.h5",
        "level": test.level,
        "fs": record.fs if np.isfinite(record.fs) else None,
        "tones": test.tones_hz or None,
        "band": test.band_hz,
        "dwell": test.dwell if np.isfinite(test.dwell) else None,
        "settle": test.settle or None,
        "delay": test.delay or None,
        "periods": test.periods if test.periods > 1 else None,
        "run": test.run or None,
        "drive": test.drive or None,
        "locked_phase": test.locked_phase if test.locked_phase != -90.0 else None,
        "amplitude_std": test.amplitude_std or None,
        "channels": {role: role for role in record.channels},
        "units": {role: record.units[role] for role in record.channels},
    }
    return _table(f"# {purpose}\n[[test]]" if purpose else "[[test]]", table)
