"""How true the simulation is: the numbers of tests/physics in each engine, beside those of mechanics, as JSON.

python -m tools.benchmarks.physics
"""

from __future__ import annotations

import json

from tests.physics.table import rows

if __name__ == "__main__":
    print(json.dumps(list(rows()), indent=2))
