"""Makes what the tests of a cluster share importable."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
