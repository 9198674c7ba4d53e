"""Put the pages of a release beside those of earlier ones, and make the page that leads to them.

    mkdocs build --strict && python packaging/versions_of_docs.py site PAGES 1.2.0

The pages of each release lie in a folder of its version in PAGES; `index.html` opens those of the
newest and lists all others.
"""

import re
import shutil
import sys
from pathlib import Path

VERSION = re.compile(r"(\d+)\.(\d+)\.(\d+)")
PAGE = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta http-equiv="refresh" content="0; url={newest}/index.html">
<title>jbw</title>
<h1>Versions of jbw</h1>
<ul>
{listed}
</ul>
</html>
"""


def publish(site: Path, pages: Path, version: str) -> None:
    """Copy a site into the folder of its version, and write the page of all versions."""
    if not VERSION.fullmatch(version):
        sys.exit(f"The version must be three numbers, as 1.2.0, but is {version!r}.")
    if not (site / "index.html").is_file():
        sys.exit(f"{site} must hold index.html; build it with: mkdocs build --strict")
    shutil.rmtree(pages / version, ignore_errors=True)
    shutil.copytree(site, pages / version)
    there = [folder.name for folder in pages.iterdir() if VERSION.fullmatch(folder.name)]
    there.sort(key=lambda name: tuple(map(int, name.split("."))), reverse=True)
    listed = "\n".join(f'<li><a href="{name}/index.html">{name}</a></li>' for name in there)
    (pages / "index.html").write_text(PAGE.format(newest=there[0], listed=listed), "utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit("Give three arguments: the built site, the folder of all pages, the version.")
    publish(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
