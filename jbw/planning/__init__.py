"""Planning of tests from guessed joints: the information of a test before it is measured."""

from pathlib import Path

EXAMPLE = Path(__file__).with_name("example.toml").read_text(encoding="utf-8")
