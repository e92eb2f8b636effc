"""Records what the package does, and compares two records.

    python -m tools.oracle record DIR [--source PATH] [--inputs PATH] [--only motion|findings]
    python -m tools.oracle compare DIR_A DIR_B

A change that must not change behavior is recorded before and after, with the same inputs:

    python -m tools.oracle record build/oracle/before
    (change the package)
    python -m tools.oracle record build/oracle/after
    python -m tools.oracle compare build/oracle/before build/oracle/after

`--source` is the checkout whose package is recorded, by default the working directory. `--inputs` is the
folder of the files that are linted, by default `inputs` beside DIR. The first recording writes them, and
later ones read them, so that all versions lint the same text: the golden inputs, the shipped scenarios, and
2000 of the scenarios of tests/faults with one mistake each.

`motion.json` holds spaces, layouts of messages and every step of the shipped scenarios of the checkout under
random actions, and of a few steps of each golden input without findings. `findings.json` holds the findings
of each input, rules in preview included.

`compare` exits with 0 if every motion is identical and at least 99 % of the files have identical findings.
`accepted.yaml` beside this file maps files to the reason why their findings may differ; they are shown apart
and do not count. A recording takes about two minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

from tests.faults.injected import CRAFTED, ROOT, Injected, everything
from tests.golden.cases import write as write_golden
from tools.oracle.comparison import compare

PARTS = ("motion", "findings")
FAULTS = 2000


def write_inputs(folder: Path) -> None:
    """Write the inputs, and the list of those that are linted; a folder that holds them already stays as it
    is."""
    if folder.exists():
        return
    part_folder = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part_folder, ignore_errors=True)
    write_golden(part_folder / "golden")
    shutil.copytree(ROOT / "scenarios", part_folder / "scenarios")
    for place in (part_folder, part_folder / "faults"):
        shutil.copytree(ROOT / "robots", place / "robots")
    (part_folder / "deepbots.toml").touch()  # the folder is a project of its own
    listed = [*(part_folder / "golden").rglob("*.yaml"), *(part_folder / "scenarios").glob("*.yaml")]
    for number, case in enumerate(drawn(everything(), FAULTS)):
        name = re.sub(r"\W+", "-", f"{number:04}-{case.kind}-{case.style}")
        write_case(part_folder / "faults" / name, case)
        listed.append(part_folder / "faults" / name / case.source)
    names = sorted(path.relative_to(part_folder).as_posix() for path in listed)
    (part_folder / "inputs.json").write_text(json.dumps(names, indent=0), encoding="utf-8")
    part_folder.rename(folder)


def drawn(cases: list[Injected], count: int) -> list[Injected]:
    """Draw as evenly as possible from all kinds of mistakes and all ways of writing them."""
    chance = random.Random(0)
    groups: dict[tuple[str, str], list[Injected]] = {}
    for case in chance.sample(cases, len(cases)):
        groups.setdefault((case.kind, case.style), []).append(case)
    ranked = [(rank, key, case) for key, group in groups.items() for rank, case in enumerate(group)]
    return [case for _, _, case in sorted(ranked, key=lambda entry: entry[:2])[:count]]


def write_case(folder: Path, case: Injected) -> None:
    """Write the files of a case, and those shipped or crafted files that they mention."""
    folder.mkdir()
    beside = {
        path.relative_to(top).as_posix(): path
        for top in (ROOT / "scenarios", CRAFTED)
        for path in top.rglob("*.*")
    }
    texts = list(case.files.values())
    for text in texts:  # grows while it is read
        for name, path in beside.items():
            if name in text and name not in case.files and not (folder / name).exists():
                (folder / name).parent.mkdir(exist_ok=True)
                shutil.copy(path, folder / name)
                texts.append(path.read_text(encoding="utf-8"))
    for name, text in case.files.items():
        (folder / name).write_text(text, encoding="utf-8", newline="")


def record(target: Path, source: Path, inputs: Path, parts: tuple[str, ...]) -> None:
    """Record the parts of a checkout, each in a process of its own."""
    write_inputs(inputs)
    target.mkdir(parents=True, exist_ok=True)
    settings = {
        **os.environ,
        "PYTHONPATH": str(source),
        "PYTHONHASHSEED": "0",
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    script = Path(__file__).with_name("recorder.py")
    for part in parts:
        began, file = time.monotonic(), target / f"{part}.json"
        subprocess.run(
            [sys.executable, "-P", str(script), part, str(inputs), str(file)],
            cwd=source,
            env=settings,
            check=True,
        )
        count = len(json.loads(file.read_text(encoding="utf-8")))
        print(f"{file}: {count} entries in {time.monotonic() - began:.0f} s")


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.oracle", description=(__doc__ or "").partition("\n")[0]
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    recorded = verbs.add_parser("record", help="record what the package of a checkout does")
    recorded.add_argument("target", type=Path, metavar="DIR")
    recorded.add_argument("--source", type=Path, default=Path(), help="the checkout")
    recorded.add_argument("--inputs", type=Path, help="the files that are linted")
    recorded.add_argument("--only", choices=PARTS)
    compared = verbs.add_parser("compare", help="compare two records")
    compared.add_argument("before", type=Path, metavar="DIR_A")
    compared.add_argument("after", type=Path, metavar="DIR_B")
    arguments = parser.parse_args()
    if arguments.verb == "compare":
        return 0 if compare(arguments.before, arguments.after) else 1
    target = arguments.target.resolve()
    inputs = (arguments.inputs or target.parent / "inputs").resolve()
    record(target, arguments.source.resolve(), inputs, (arguments.only,) if arguments.only else PARTS)
    return 0


if __name__ == "__main__":
    sys.exit(main())
