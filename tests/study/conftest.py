"""The finished run of the toy campaign, for tests of the content of runs."""

import pytest
from finished import finished
from toy_campaign import write_run


@pytest.fixture(scope="session")
def toy():
    """Return the folder of the toy campaign, with its result in `run`."""
    return finished("toy", write_run)
