"""Seeds of statistical tests: the first in the test's own tier, the others before a release."""

import pytest


def seeds(first, *others):
    """Values for `pytest.mark.parametrize`."""
    return [first, *(pytest.param(seed, marks=pytest.mark.release) for seed in others)]
