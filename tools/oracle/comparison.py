"""Says in what two records differ."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import yaml

ACCEPTED = Path(__file__).parent / "accepted.yaml"
LEAST_IDENTICAL = 0.99
Record = dict[str, Any]


def compare(before: Path, after: Path) -> bool:
    """Print all differences. True if every motion is identical and at least 99 % of the files have identical
    findings."""
    parts = {"motion": _compare_motion, "findings": _compare_findings}
    good = True
    for name, compared in parts.items():
        files = [folder / f"{name}.json" for folder in (before, after)]
        there = [path.is_file() for path in files]
        if all(there):
            good = compared(*(json.loads(path.read_text(encoding="utf-8")) for path in files)) and good
        else:
            print(
                f"{name}: not compared, since"
                f" {' and '.join(str(path) for path in files if not path.is_file())} is missing"
            )
            good = good and not any(there)
    return good


def _compare_motion(before: Record, after: Record) -> bool:
    identical, redigested = 0, 0
    for name in sorted(before.keys() | after.keys()):
        old, new = dict(before.get(name, {})), dict(after.get(name, {}))
        redigested += old.pop("digest", "") != new.pop("digest", "")
        if "error" in old and old == new:
            print(f"{name}: the same failure in both: {old['error']}")
        if old == new:
            identical += 1
            continue
        print(f"{name}: DIFFERS")
        for key in sorted((old.keys() | new.keys()) - {"steps", "samples", "sha256", "start"}):
            _show_change(key, old.get(key), new.get(key))
        _show_motion(old, new)
    total = len(before.keys() | after.keys())
    print(f"motion, spaces and layouts: {identical} of {total} scenarios are identical")
    print(f"digests of scenarios: {redigested} differ (for information)")
    return bool(total) and identical == total


def _show_change(key: str, old: Any, new: Any) -> None:
    """What went and came under a key; of lists only the rows that differ."""
    if isinstance(old, list) and isinstance(new, list):
        for sign, rows, others in (("-", old, new), ("+", new, old)):
            for row in rows:
                if row not in others:
                    print(f"    {key} {sign} {row}")
        if old != new and sorted(map(str, old)) == sorted(map(str, new)):
            print(f"    {key}: the order differs")
    elif old != new:
        print(f"    {key} - {old}\n    {key} + {new}")


def _show_motion(old: Record, new: Record) -> None:
    """The first step that differs, in which part, and the sample after it."""
    if old.get("start") != new.get("start"):
        print(f"    the first reset differs: {old.get('start')} -> {new.get('start')}")
    before, after = old.get("steps", []), new.get("steps", [])
    step = next(
        (index for index, (one, other) in enumerate(zip(before, after, strict=False)) if one != other), None
    )
    if step is None:
        if len(before) != len(after):
            print(f"    {len(before)} steps -> {len(after)} steps")
        elif old.get("sha256") != new.get("sha256"):
            print("    an observation after a later reset differs")
        return
    parts = ("observation", "info", "reward", "terminated", "truncated", "ended_by")
    for part, one, other in zip(parts, before[step].split(" ", 5), after[step].split(" ", 5), strict=True):
        if one != other:
            readable = [repr(float.fromhex(text)) if part == "reward" else text for text in (one, other)]
            print(f"    first at step {step + 1}: {part} {' -> '.join(readable)}")
    for at, sample in sorted(old.get("samples", {}).items(), key=lambda entry: int(entry[0])):
        other = new.get("samples", {}).get(at)
        if sample != other and int(at) > step:
            print(f"    sample of step {at} - {sample}\n    sample of step {at} + {other}")
            break


def _compare_findings(before: Record, after: Record) -> bool:
    accepted: dict[str, str] = (
        yaml.safe_load(ACCEPTED.read_text(encoding="utf-8")) if ACCEPTED.is_file() else None
    ) or {}
    names = sorted(before.keys() | after.keys())
    differing = [name for name in names if before.get(name) != after.get(name)]
    went, came, files = Counter[str](), Counter[str](), Counter[str]()
    for name in (name for name in differing if name not in accepted):
        print(f"{name}:")
        old, new = (
            Counter(map(tuple, record.get(name, [["missing", "", 0, 0, ""]]))) for record in (before, after)
        )
        lost, gained = old - new, new - old
        for sign, changed, counts in (("-", lost, went), ("+", gained, came)):
            for code, severity, line, column, file in sorted(changed.elements()):
                print(f"    {sign} {code} {severity} {file}:{line}:{column}")
                counts[code] += 1
        files.update({finding[0] for finding in (*lost, *gained)})
    explained = [name for name in differing if name in accepted]
    for name in explained:
        print(f"{name}: accepted, {accepted[name]}")
    if files:
        print(f"\n{'code':<12}{'went':>8}{'came':>8}{'files':>8}")
        for code in sorted(files):
            print(f"{code:<12}{went[code]:>8}{came[code]:>8}{files[code]:>8}")
        print()
    total = len(names) - len(explained)
    identical = len(names) - len(differing)
    share = identical / total if total else 0.0
    print(
        f"findings: {identical} of {total} files are identical ({100 * share:.2f} %), beside {len(explained)}"
        " accepted"
    )
    return share >= LEAST_IDENTICAL
