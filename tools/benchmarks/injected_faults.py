"""How many of the mistakes put into scenarios lint finds in the right place, by the right code, and as the
only ones.

    python -m tools.benchmarks.injected_faults [--json]

All of tests/faults: every kind of mistake in every way of writing, in all shipped scenarios and some
crafted ones. Takes two minutes of CPU.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.faults.injected import Project, everything
from tools.benchmarks.report import Row, options, show


def main() -> None:
    arguments = options(__doc__)
    cases = everything()
    right: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        project = Project(Path(folder))
        for case in cases:
            mistake = project.mistake(case)
            right[case.kind] += mistake is None
            if mistake is not None:
                print(f"{case.source}: {case.kind}, {case.style}: {mistake}", file=sys.stderr)
    counts = Counter(case.kind for case in cases)
    rows = [Row("injected faults", len(cases), "", 1000, at_least=True)]
    rows += [
        Row(f"of them right: {kind}, {counts[kind]}", right[kind], "", counts[kind], at_least=True)
        for kind in sorted(counts)
    ]
    rows.append(Row("of them right: all", right.total(), "", len(cases), at_least=True))
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()
