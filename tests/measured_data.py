"""Where the published measurements lie that some tests read, and skip without."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("JBW_DATA") or ROOT / "data")
