"""Cases of a test of which one stands for all in its tier, and the others wait for a release."""

import pytest


def represented_by(first, *others):
    """Values for `pytest.mark.parametrize`, tuples where a case has several arguments."""
    waiting = (each if isinstance(each, tuple) else (each,) for each in others)
    return [first, *(pytest.param(*values, marks=pytest.mark.release) for values in waiting)]
