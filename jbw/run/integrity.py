"""Whether a result is still what the run wrote: hashes of its files, which stand in its summary."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jbw.errors import DataError
from jbw.run.files import hash_of

SEAL = "sha256"  # the field of a summary that holds the hashes
MARK = "hashes"  # attribute of a posterior's file whose summary has them


def sealed(summary: Mapping[str, Any], posterior: Path) -> dict[str, Any]:
    """Return the summary with the hash of its own content and that of the posterior's file."""
    return {**summary, SEAL: {"summary": _digest(summary), posterior.name: hash_of(posterior)}}


def unsealed(summary: Mapping[str, Any], posterior: Path) -> dict[str, Any]:
    """Return the summary without its hashes, once it and the posterior's file agree with them.

    Runs of earlier versions have none, and are taken as they are.

    Raises:
        DataError: A file is no longer what the run wrote.
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
    """Return the error of a file that is no longer what the run wrote."""
    return DataError(
        f"The file {path} is damaged: its content is not what the run wrote, by its SHA-256.",
        remedy="Restore the folder from a copy, or identify again: jbw identify CAMPAIGN.toml.",
    )


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
