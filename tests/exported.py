"""Files of `jbw export` as other readers read them: comments first, then a header and rows."""

import csv


def comments(path):
    """Return the comment lines at the head of a text file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return [line.removeprefix("# ") for line in lines if line.startswith("# ")]


def rows(path):
    """Return the rows of a table by the names of its columns."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def column(path, name):
    """Return the numbers in one column of a table."""
    return [float(row[name]) for row in rows(path)]
