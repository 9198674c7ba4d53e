"""Where a test stands in the tree of a result."""


def place(group: str, name: str) -> str:
    """Path of a test in the tree."""
    return f"/{group}/{safe(name)}"


def safe(name: str) -> str:
    """A test's name as one level of the tree: a slash would open another."""
    return name.replace("/", "\N{DIVISION SLASH}")
