"""The stored population in a folder: draws of new units, and the torque of the prediction."""

import json
from pathlib import Path

from jbw.errors import DataError
from jbw.report.result import require_finite
from jbw.run.netcdf import read_tree
from jbw.verification.predictive_basis import Basis, basis_of

# relative difference up to which two torques count as equal, because three digits are stated
SAME_TORQUE = 1e-3


def holds_population(folder: Path) -> bool:
    """Return whether a folder contains the population of a fleet."""
    return (folder / "population.json").is_file()


def basis_of_population(folder: Path) -> Basis:
    """Return the inputs of predictions of new units, from the population in a folder.

    Raises:
        DataError: The folder contains no complete population.
    """
    try:
        tree = read_tree(folder / "population.nc")
        require_finite(tree, folder / "population.nc")
        return basis_of(tree)
    except (OSError, KeyError, TypeError, ValueError, DataError) as cause:
        raise DataError(
            f"The population in {folder} cannot be read: {type(cause).__name__} {cause}",
            remedy="Repeat: jbw population FLEET.",
        ) from cause


def require_same_torque(folder: Path, torque: float | None) -> float | None:
    """Return the torque [N m] of a stored population; raise an error if the tests have another.

    The result is None where the folder contains no population, or one without a torque.
    """
    if not holds_population(folder):
        return None
    at = json.loads((folder / "population.json").read_text())["new_unit"]["torque"]
    if torque is not None and at is not None and abs(torque / at - 1.0) > SAME_TORQUE:
        raise DataError(
            f"The tests are of a joint tightened to {torque:g} N m, but the population in "
            f"{folder} predicts units at {at:g} N m.",
            remedy=f"Compute it for that torque: jbw population FLEET --torque {torque:g} --out "
            "DIR, then jbw predict DIR.",
        )
    return at
