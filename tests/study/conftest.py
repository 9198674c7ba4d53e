"""The toy campaign's finished run, which tests of what a run holds read."""

import pytest
from finished import finished
from toy_campaign import write_run


@pytest.fixture(scope="session")
def toy():
    """The folder of the toy campaign, with its result in `run`."""
    return finished("toy", write_run)
