"""How jbw is cited."""

from pathlib import Path

PACKAGE = Path(__file__).parents[1]


def citation() -> str:
    """How to cite this version of jbw, and the paper whose method it implements.

    Returns:
        The text of `CITATION.cff`, in the Citation File Format that Zenodo, Zotero and most forges
        of software read.
    """
    packed = PACKAGE / "CITATION.cff"  # into the wheel; in a clone it lies beside the package
    file = packed if packed.is_file() else PACKAGE.parent / "CITATION.cff"
    return file.read_text(encoding="utf-8")
