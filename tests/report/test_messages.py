"""The English of the catalogue: one snapshot of every entry with example values."""

import re

import pytest
from messages import SNAPSHOT, catalogue, of_findings

from jbw.report.messages.message import percent, written


def test_the_catalogue_says_what_the_snapshot_holds():
    """After a change of wording: `python tests/report/messages.py`, and read the difference."""
    assert catalogue() == SNAPSHOT.read_text(encoding="utf-8")


def test_every_sentence_of_a_finding_is_whole():
    for line in of_findings():
        text = line.partition(": ")[2]
        assert text[:1].isupper() or not text[:1].isalpha(), line
        assert text.endswith("."), line


def test_every_field_has_its_value():
    """A table of a campaign file has spaces within its braces, a field has none."""
    for line in catalogue().splitlines():
        assert not re.search(r"\{[a-z_]|[a-z_\])]\}|\S  (?!#)|\bnan\b|\bNone\b", line), line


@pytest.mark.parametrize(
    ("template", "text"),
    [
        ("{x:.2g %}", "7.3 %"), ("{x:.0f %}", "7 %"), ("{names:list}", "a, b, c"),
        ("{names:and}", "a, b and c"), ("{x:.4f}", "0.0734"),
        (lambda x, names: f"{len(names)} {x}", "3 0.0734"),
    ],
)  # fmt: skip
def test_values_are_put_into_a_text(template, text):
    assert written(template, {"x": 0.0734, "names": ["a", "b", "c"]}) == text
    assert percent(0.0734) == "7.3 %"
