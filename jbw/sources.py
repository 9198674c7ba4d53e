"""The hash of those source files of jbw, or of some of its packages, that computed a number.

The hash differs between two commits of the same version, and for a modified copy.
"""

import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path


@cache
def sources_of(*packages: str) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 hash of all Python files of packages.

    Args:
        packages: Package names, for example "jbw.measurement"; files in subfolders count too.
    """
    digest = hashlib.sha256()
    for package in packages:
        spec = find_spec(package)
        root = Path(str(spec.origin)).parent if spec is not None else Path()
        for path in sorted(root.rglob("*.py")):
            content = path.read_bytes()
            digest.update(f"{path.relative_to(root).as_posix()}\0{len(content)}\0".encode())
            digest.update(content)
    return digest.hexdigest()[:16]
