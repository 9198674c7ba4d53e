"""Remedies: the line to put into a campaign file, and when to draw more or by another sampler."""

import json
from typing import Any


def put(table: str, key: str, value: Any) -> str:
    """The sentence with a line of a campaign file: the key of a table and its value."""
    return f"Put under [{table}]: `{key} = {json.dumps(value)}`."


OTHER_LAWS = "Try other laws: jbw laws."


def beside_other_laws(line: str) -> str:
    """The line of another law, and how further ones are compared."""
    return f"{line} Others, a gap between contacts among them, are compared by: jbw laws."


def draw_more(num_samples: int | None, sampler: str) -> str:
    """The line of how many samples to draw; of another sampler where no number is enough."""
    if num_samples is None:
        line = put("identify", "sampler", sampler)
        return f"More draws of this sampler will not be enough. {line}"
    return f"Draw more samples. {put('identify', 'num_samples', num_samples)}"
