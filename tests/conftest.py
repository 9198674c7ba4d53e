"""Shared by all tests: float64, jaxtyping shapes checked by beartype, the golden numbers."""

import json
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)

GOLDEN = json.loads((Path(__file__).parent / "golden.json").read_text())


@pytest.fixture(scope="session")
def golden():
    return GOLDEN
