"""Nastran's OUTPUT4 and OUTPUT2 files of matrices, read by pyNastran if it is installed.

pyNastran 1.4.1 requires NumPy below 2, which jbw does not work with. Its reader of OUTPUT4 works
with later versions all the same; its reader of OUTPUT2 does not load with them.
"""

from pathlib import Path
from typing import Any

from jbw.assembly.files.contents import MatrixFile
from jbw.errors import DataError


def contents(path: Path) -> MatrixFile:
    """Read the matrices of an .op4 or .op2 file, without a table of degrees of freedom.

    Raises:
        DataError: pyNastran is not installed, or does not work with the installed NumPy.
    """
    loaded = _op4(path) if path.suffix.lower() == ".op4" else _op2(path)
    return MatrixFile({name: matrix.data for name, matrix in loaded.items()})


def _op4(path: Path) -> dict[str, Any]:
    try:
        from pyNastran.op4.op4 import OP4  # pyright: ignore[reportMissingImports]
    except (ImportError, AttributeError) as error:
        raise _missing(path, error) from None
    return OP4(debug=False).read_op4(str(path))


def _op2(path: Path) -> dict[str, Any]:
    try:
        from pyNastran.op2.op2 import OP2  # pyright: ignore[reportMissingImports]
    except (ImportError, AttributeError) as error:
        raise _missing(path, error) from None
    model = OP2(debug=False)
    model.read_op2(str(path))
    return model.matrices


def _missing(path: Path, error: Exception) -> DataError:
    installed = not isinstance(error, ModuleNotFoundError)
    return DataError(
        f"pyNastran is needed to read {path.name}, but cannot be imported: {error}."
        if installed
        else f"pyNastran is needed to read {path.name}, but is not installed.",
        remedy="Export a punch file of DMIG, which needs no pyNastran."
        if installed
        else "Export a punch file of DMIG, which needs no pyNastran, or install pyNastran with "
        "pip install --no-deps pyNastran cpylog docopt-ng.",
    )
