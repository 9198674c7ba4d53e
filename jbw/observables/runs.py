"""The run that a test belongs to, and the assembly that a run belongs to, by their names."""

from jbw.measurement.records import Test

OF = " / "  # between the name of an assembly and that of one of its runs


def run_of(test: Test) -> str:
    """Name of a test's run: its assembly and day where stated, else the test itself."""
    return OF.join(part for part in (test.assembly, test.run) if part) or test.name


def assemblies_of(runs: tuple[str, ...]) -> tuple[int, ...]:
    """Number of each run's assembly; nothing unless there are several, one with several runs.

    Args:
        runs: Names of the runs, each once.
    """
    owners = [run.partition(OF)[0] for run in runs]
    order = list(dict.fromkeys(owners))
    if not 1 < len(order) < len(runs):
        return ()
    return tuple(order.index(owner) for owner in owners)
