"""Planning: what a test would tell of a joint that is only guessed, before it is measured."""

from pathlib import Path

EXAMPLE = Path(__file__).with_name("example.toml").read_text(encoding="utf-8")
