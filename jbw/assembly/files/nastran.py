"""Nastran's OUTPUT4 and OUTPUT2 files of matrices, read by pyNastran if it is installed.

pyNastran 1.4.1 requires NumPy below 2, which jbw does not work with. Its reader of OUTPUT4 works
with later versions all the same; its reader of OUTPUT2 does not load with them.
"""

from importlib import import_module
from pathlib import Path

from jbw.assembly.files.contents import MatrixFile
from jbw.errors import DataError


def contents(path: Path) -> MatrixFile:
    """Read the matrices of an .op4 or .op2 file, without a table of degrees of freedom.

    Raises:
        DataError: pyNastran is not installed, or does not work with the installed NumPy.
    """
    kind = path.suffix.lower().removeprefix(".")  # op4 or op2
    try:
        reader = getattr(import_module(f"pyNastran.{kind}.{kind}"), kind.upper())
    except (ImportError, AttributeError) as error:
        raise _missing(path, error) from None
    model = reader(debug=False)
    loaded = getattr(model, f"read_{kind}")(str(path))
    matrices = loaded if kind == "op4" else model.matrices
    return MatrixFile({name: matrix.data for name, matrix in matrices.items()})


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
