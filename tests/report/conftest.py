"""The toy result of a run for tests of the report: its summary and its tree."""

import pytest
from toy_summary import result_summary
from toy_tree import result_tree


@pytest.fixture(scope="session")
def tree():
    return result_tree()


@pytest.fixture
def summary():
    return result_summary()
