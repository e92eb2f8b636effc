"""Inputs under the new names of the language, and where each finding about them stands in the old text."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from itertools import accumulate
from pathlib import Path

from deepbots_cli import api
from deepbots_cli.diagnostics.nearest import RENAMES
from deepbots_cli.lint.fixes import Fixer

_OLD = re.compile(rf"\b({'|'.join({rename.old for rename in RENAMES})})\b")
_TOKEN = re.compile(r"\w+|\W")


def rewrite(inputs: Path, target: Path) -> None:
    """Copy the inputs to `target` with the fixes of DB109 applied; `columns.json` has the columns of each changed line, new and old."""
    shutil.copytree(inputs, target)
    before = {path: path.read_bytes() for path in sorted(target.rglob("*.yaml"))}
    for name in json.loads((target / "inputs.json").read_text(encoding="utf-8")):
        if any(_OLD.search(data.decode("utf-8", "replace")) for path, data in before.items() if path.parent == (target / name).parent):
            for rewritten in Fixer([str(target / name)], api.load, wanted=lambda finding: finding.code == "DB109").fix():
                rewritten.path.write_bytes(rewritten.after)
    columns = {
        path.relative_to(target).as_posix(): dict(_columns(data.decode(), path.read_bytes().decode()))
        for path, data in before.items()
        if path.read_bytes() != data
    }
    (target / "columns.json").write_text(json.dumps(columns), encoding="utf-8")


def _columns(old: str, new: str) -> Iterator[tuple[int, list[tuple[int, int]]]]:
    """The number of each line that differs, with the columns of its words: a rename replaces a word by a word."""
    for number, lines in enumerate(zip(old.split("\n"), new.split("\n"), strict=True), 1):
        if lines[0] != lines[1]:
            starts = [list(accumulate((len(word) for word in _TOKEN.findall(line)), initial=1)) for line in lines]
            yield number, list(zip(starts[1], starts[0], strict=True))
