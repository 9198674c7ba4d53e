"""Files of `jbw export` as other readers take them: comments first, then a header and rows."""

import csv


def comments(path):
    """Lines of comment at the head of a text file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return [line.removeprefix("# ") for line in lines if line.startswith("# ")]


def rows(path):
    """Rows of a table by the names of its columns."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def column(path, name):
    """Numbers of one column of a table."""
    return [float(row[name]) for row in rows(path)]
