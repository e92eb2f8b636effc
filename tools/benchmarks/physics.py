"""How far experiments come out from what their closed forms say, in percent.

    python -m tools.benchmarks.physics [--json]

Each is a scenario, from its text to what the policy sees; tests/physics holds them.
"""

from __future__ import annotations

from tests.physics.closed_forms import EXPERIMENTS
from tools.benchmarks.report import options, show


def main() -> None:
    arguments = options(__doc__)
    show((row for experiment in EXPERIMENTS.values() for row in experiment()), as_json=arguments.json)


if __name__ == "__main__":
    main()
