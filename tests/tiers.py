"""Test cases of which one represents all others in its tier, and the others wait for a release."""

import pytest


def represented_by(first, *others):
    """Return values for `pytest.mark.parametrize` of which only the first runs before a release."""
    waiting = (each if isinstance(each, tuple) else (each,) for each in others)
    return [first, *(pytest.param(*values, marks=pytest.mark.release) for values in waiting)]


def standing_for_all(names, *stay):
    """Return names for `pytest.mark.parametrize` or a fixture; only `stay` run before a release."""
    return [n if n in stay else pytest.param(n, marks=pytest.mark.release) for n in names]


def not_run_yet(paths, waiting, how):
    """Return paths for `pytest.mark.parametrize`, of which those `waiting` must lack their outputs.

    `how` returns the command that makes the outputs of a path; once it has run, the mark must go.
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
