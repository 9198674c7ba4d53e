"""Cases of a test of which one stands for all in its tier, and the others wait for a release."""

import pytest


def represented_by(first, *others):
    """Values for `pytest.mark.parametrize`, tuples where a case has several arguments."""
    waiting = (each if isinstance(each, tuple) else (each,) for each in others)
    return [first, *(pytest.param(*values, marks=pytest.mark.release) for values in waiting)]


def standing_for_all(names, *stay):
    """Values for `pytest.mark.parametrize` or a fixture, of which some stand for all others."""
    return [n if n in stay else pytest.param(n, marks=pytest.mark.release) for n in names]


def not_run_yet(paths, waiting, how):
    """Paths for `pytest.mark.parametrize`, of which those `waiting` must lack their outputs.

    `how` gives the command that makes the outputs of a path; once it ran, the mark has to go.
    """
    return [
        pytest.param(
            path,
            id=path.stem,
            marks=pytest.mark.xfail(
                path.stem in waiting,
                reason=f"run it: {how(path)}",
                raises=FileNotFoundError,
                strict=True,
            ),
        )
        for path in paths
    ]
