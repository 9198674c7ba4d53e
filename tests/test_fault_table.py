"""The table of faults: whatever is wrong with data, settings, chains or the machine, jbw says so.

A test that carries `@pytest.mark.fault(row)` makes the fault of that row and requires what is
wrong, where, and what to do about it; of a posterior, that its verdict is not ok. `FAULTS` is the
table; every row of it has a test.
"""

import ast
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
FAULTS = {
    1: "samples that are NaN or infinite",
    2: "a channel that is constant, or toggles its last bit",
    3: "no sampling frequency anywhere",
    4: "a sampling frequency that is wrong by a factor",
    5: "channels of one record sampled at two rates",
    6: "a sampling interval rounded by the file's format",
    7: "times that go back or stand still",
    8: "times with gaps or jitter",
    9: "a unit that is wrong by a factor",
    10: "a unit that does not exist",
    11: "an excitation in volts",
    12: "a channel that is not in the file",
    13: "input and response swapped, or of opposite sign",
    14: "channels of unequal lengths",
    15: "repeats of unequal lengths",
    16: "clipped samples",
    17: "too few bits",
    18: "a record that is too short",
    19: "a transient left in a steady test",
    20: "a tone between the lines of a spectrum",
    21: "a third harmonic that folds back",
    22: "a third harmonic below the noise",
    23: "a response that is not the input's",
    24: "damping finer than the record resolves",
    25: "prior bounds reversed, not finite, or negative",
    26: "a prior that excludes the truth",
    27: "parameters without stiffness, or with a loop that grows",
    28: "a direction that the data do not know",
    29: "a posterior of two modes",
    30: "noise of zero, negative, or not given",
    31: "noise that is far too small for the misfit",
    32: "a single repeat",
    33: "residuals that are correlated in time",
    34: "parameters that cannot be solved for",
    35: "a session in single precision",
    36: "chains that are frozen or not finite",
    37: "a single chain",
    38: "divergences, cut trajectories, energies and draws too few",
    39: "a start with unknown names, or outside the prior",
    40: "a run killed between two steps",
    41: "a run interrupted by its user",
    42: "a full disk, or a folder that cannot be written",
    43: "a run gone on with after its campaign, data or versions changed",
    44: "a checkpoint torn or changed",
    45: "two runs in one folder",
    46: "a damaged file of any format",
    47: "a MATLAB file of version 7.3",
    48: "a table, object or function in a MATLAB file",
    49: "a text table in any dialect",
    50: "a file larger than memory",
    51: "a pickle",
    52: "a campaign file with anything in it",
    53: "a path out of the campaign's folder, or an address",
    54: "a file that unpacks without end, or links elsewhere",
    55: "the same seed twice",
    56: "paths with spaces, in other scripts, under any locale",
    57: "no display",
}


def marked(path: Path) -> dict[str, set[int]]:
    """Tests of a file that carry the mark, and their rows."""
    found: dict[str, set[int]] = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            rows = {
                row.value
                for mark in node.decorator_list
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.fault"
                for row in mark.args
                if isinstance(row, ast.Constant)
            }
            if rows:
                found[f"{path.relative_to(TESTS)}::{node.name}"] = rows
    return found


@pytest.fixture(scope="module")
def tests():
    """Every test that carries the mark, and its rows."""
    return {
        name: rows
        for path in sorted(TESTS.rglob("test_*.py"))
        for name, rows in marked(path).items()
    }


def test_every_row_has_a_test(tests):
    covered = set().union(*tests.values())
    assert {row: FAULTS[row] for row in set(FAULTS) - covered} == {}
    assert covered <= set(FAULTS)
    assert sorted(FAULTS) == list(range(1, 58))


def test_only_tests_carry_the_mark(tests):
    assert all(name.partition("::")[2].startswith("test_") for name in tests)


def test_the_folder_of_faults_has_the_rows_that_its_test_claims(tests):
    written = (TESTS / "campaign" / "faulty_folder.py").read_text(encoding="utf-8")
    rows = {
        int(str(node.args[0].value).partition(":")[0])
        for node in ast.walk(ast.parse(written))
        if isinstance(node, ast.Call)
        and ast.unparse(node.func) == "Fault"
        and isinstance(node.args[0], ast.Constant)
    }
    claimed = tests["campaign/test_faults_of_files.py::test_fault_is_found"]
    assert rows - {0} == claimed
