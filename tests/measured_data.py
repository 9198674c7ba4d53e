"""Where the published measurements lie that some tests read, and skip without."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[1]
# In the checkout, or shared by the checkouts beside each other.
PLACES = (ROOT / "data", ROOT.parent / "shared" / "data")
DATA = Path(os.environ.get("JBW_DATA") or next(filter(Path.is_dir, PLACES), PLACES[0]))
