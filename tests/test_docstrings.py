"""The example in the docstring of every public name prints what it shows, in a session of its own.

A session of Python begins in float32: an example that needs float64 must ask for it.
"""

import doctest

import jax
import pytest

import jbw

# The first three take 20 to 30 CPU seconds each. `new_units` makes the population of the next
# two, and `fleet_of` makes the fleet of the last two.
OF_FLEETS = (
    "new_backbone", "one_stage", "updated", "population_of", "new_prediction", "write_fleet",
    "read_fleet",
)  # fmt: skip


def example_of(name):
    """The example of a public name, of its own docstring and not of what it contains."""
    finder = doctest.DocTestFinder(recurse=False)
    found = finder.find(getattr(jbw, name), f"jbw.{name}", globs={})
    return next((test for test in found if test.examples), None)


@pytest.fixture
def _a_session_of_its_own(tmp_path, monkeypatch):
    """An empty folder, float32 until the example asks for more, and figures without a screen."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    jax.config.update("jax_enable_x64", False)
    yield
    jax.config.update("jax_enable_x64", True)


@pytest.mark.usefixtures("_a_session_of_its_own")
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.release) if n in OF_FLEETS else n for n in jbw.__all__],
)
def test_the_example_of_a_public_name_prints_what_it_shows(name):
    test = example_of(name)
    assert test is not None, f"The docstring of jbw.{name} needs an example, under `Examples:`."
    assert any(example.want for example in test.examples)
    assert not any(doctest.SKIP in example.options for example in test.examples)
    told = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(test, out=told.append)
    assert not told, "".join(told)
