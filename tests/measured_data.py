"""The folder of the published measurements that some tests read; without it they are skipped."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("JBW_DATA") or ROOT / "data")
