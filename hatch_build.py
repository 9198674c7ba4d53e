"""What hatchling asks while it packs jbw: the documentation goes along where it was built."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PLACES = {"wheel": "jbw/site", "sdist": "site"}


class Site(BuildHookInterface):
    """Packs `site/`, which `mkdocs build` makes, for `jbw docs`; an editable install needs none."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the site to what is packed, if there is one."""
        site = Path(self.root) / "site"
        if version != "editable" and (site / "index.html").is_file():
            build_data["force_include"][str(site)] = PLACES[self.target_name]
