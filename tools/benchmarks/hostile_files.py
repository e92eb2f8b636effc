"""What hostile files cost, and whether each ends in a finding that is for it.

    python -m tools.benchmarks.hostile_files [--json]

All of tests/hostile: bombs, depth, size, lies about size, paths that lead outside. CPU time of `deepbots lint
--format json` once everything is imported; the memory is the peak of one process that lints them all.
"""

from __future__ import annotations

from tests.hostile.cases import cases
from tests.hostile.trial import outcomes
from tools.benchmarks.report import Row, options, show


def main() -> None:
    arguments = options(__doc__)
    count = sum(1 for _ in cases())
    tried = list(outcomes())
    answered = sum(
        bool(set(case.codes).intersection(outcome.codes)) and outcome.exit_code == 1
        for case, outcome in tried
    )
    rows = [
        Row(f"hostile files that end in a finding for them, of {count}", answered, "", count, at_least=True),
        Row("files opened outside of the project", sum(len(outcome.outside) for _, outcome in tried), "", 0),
        Row("the slowest of them", max(outcome.seconds for _, outcome in tried), "s", 1),
        Row(
            "memory at most, all in one process", max(outcome.memory for _, outcome in tried) / 1e6, "MB", 300
        ),
    ]
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()
