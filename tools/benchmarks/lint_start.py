"""What a cold `deepbots lint cartpole` costs beside the bare import of its libraries, in the same process.

    python -m tools.benchmarks.lint_start [--json] [--runs 4]

The ratio of CPU times, from the imports to the end of the command; the lowest counts, because other programs slow
the rest. Compiled modules are kept in build/bytecode. Ends with 1 if the ratio is above its bound, so that `make check` fails:
`python -X importtime -m deepbots_cli lint cartpole` then names the module that has become slow.
"""

from __future__ import annotations

import subprocess
import sys

from tools.benchmarks.lint_cost import ROOT, with_bytecode
from tools.benchmarks.report import Row, options, show

BOUND = 3.4
"""It was 3.1 when the bound was set."""
PROGRAM = """
import time
begun = time.process_time()
import jinja2, pydantic, rich, typer, yaml
imported = time.process_time()
from deepbots_cli.cli import main
assert main(["lint", "scenarios/cartpole.yaml"]) == 0
print((time.process_time() - begun) / (imported - begun))
"""


def ratio() -> float:
    """The ratio of one process."""
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=ROOT, env=with_bytecode("build/bytecode")
    )
    return float(done.stdout.split()[-1])


def main() -> int:
    arguments = options(__doc__, runs=4)
    ratio()  # writes the bytecode
    lowest = min(ratio() for _ in range(arguments.runs))
    row = Row("deepbots lint cartpole / import of its libraries", lowest, "", BOUND)
    show([row], as_json=arguments.json)
    return 0 if row.met else 1


if __name__ == "__main__":
    sys.exit(main())
