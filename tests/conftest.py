"""Puts the engine `exact` where engines of other packages are found."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "exact"))
