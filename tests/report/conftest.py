"""A run's result for the report: a toy summary beside the toy tree."""

import pytest
from toy_summary import result_summary
from toy_tree import result_tree


@pytest.fixture(scope="session")
def tree():
    return result_tree()


@pytest.fixture
def summary():
    return result_summary()
