"""The integrity of a result: hashes of its files, stored in its summary."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jbw.errors import DataError
from jbw.run.files import hash_of

SEAL = "sha256"  # field of a summary that contains the hashes
MARK = "hashes"  # attribute of a posterior's file that is present if the summary contains hashes


def sealed(summary: Mapping[str, Any], posterior: Path) -> dict[str, Any]:
    """Return a run's summary with the SHA-256 hashes of the summary and the posterior's file."""
    return {**summary, SEAL: {"summary": _digest(summary), posterior.name: hash_of(posterior)}}


def unsealed(summary: Mapping[str, Any], posterior: Path) -> dict[str, Any]:
    """Check a run's summary and posterior against their SHA-256 hashes; return the bare summary.

    Runs of earlier versions have no hashes and are accepted.

    Raises:
        DataError: A file differs from what the run wrote.
    """
    content = {name: value for name, value in summary.items() if name != SEAL}
    if SEAL not in summary:
        return content
    hashes = summary[SEAL]
    digests = {"summary": _digest(content), posterior.name: hash_of(posterior)}
    for name, digest in digests.items():
        if not isinstance(hashes, Mapping) or hashes.get(name) != digest:
            raise damaged(
                posterior if name == posterior.name else posterior.parent / "summary.json"
            )
    return content


def damaged(path: Path) -> DataError:
    """Return the error for a result file whose content differs from what the run wrote."""
    return DataError(
        f"The file {path} is damaged: the SHA-256 of its content differs from the stored SHA-256.",
        remedy="Restore the folder from a copy, or identify again: jbw identify CAMPAIGN.toml.",
    )


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
