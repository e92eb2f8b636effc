"""What `new`, `lint --deep` and `try` make of well-known robots of public repositories, as data and as a
table.

    python -m tools.benchmarks.robot_files FOLDER WORK         # writes its record
    python -m tools.benchmarks.robot_files FOLDER WORK PART    # again for files whose path has PART
    python -m tools.benchmarks.robot_files --page              # writes the summary in docs/robots.md

FOLDER has a clone of each repository of robot_files.yaml as OWNER+NAME; scenarios are written into WORK.
Robots are tried with the script of their scenario, or with zero actions.
"""

from __future__ import annotations

import datetime
import json
import os
import re
import resource
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import yaml

from tools.results.card import table

ROBOTS = Path(__file__).with_suffix(".yaml")
DOCS = Path(__file__).parents[2] / "docs"
DATA = DOCS.parent / "tools" / "results" / "records" / "robots.json"
PAGE = DOCS / "robots.md"
_TABLE = re.compile(r"(?<=<!-- robots -->\n).*?(?=<!-- end of robots -->)", re.DOTALL)
_TIMEOUT_S = 300


def measure(folder: Path, work: Path, part: str = "") -> list[dict[str, Any]]:
    """Return what the commands say about each robot; the data of those without `part` in their path stay."""
    rows = []
    for number, robot in enumerate(yaml.safe_load(ROBOTS.read_text())):
        if part not in robot["file"]:
            rows.append(json.loads(DATA.read_text())["robots"][number])
            continue
        clone = folder / robot["repository"].replace("/", "+")
        row = {**robot, **_measured(clone / robot["file"], clone, f"r{number}", work)}
        print(json.dumps(row), file=sys.stderr, flush=True)
        rows.append(row)
    return rows


def _measured(file: Path, clone: Path, name: str, work: Path) -> dict[str, Any]:
    allow = ("--allow-path", str(clone))
    created, cpu = _run(work, "new", name, "--force", "--urdf", str(file), *allow)
    said = next((line for line in created.stderr.splitlines() if line.startswith(f"{file} is ")), "")
    row: dict[str, Any] = {"new": created.returncode, "cpu_s": round(cpu, 1)}
    row["said"] = said.removeprefix(f"{file} is ") or created.stderr.splitlines()[0].replace(str(clone), "")
    if created.returncode:
        return row
    linted = json.loads(_run(work, "lint", f"{name}.yaml", "--deep", "--format", "json", *allow)[0].stdout)
    row["findings"] = dict(Counter(finding["code"] for finding in linted["findings"]))
    row["errors"] = sum(finding["severity"] == "error" for finding in linted["findings"])
    script = re.search(r"^scripts:.*\n  (\w+):", (work / f"{name}.yaml").read_text(), re.MULTILINE)
    row["driver"] = script[1] if script else "zero"
    tried = _run(work, "try", f"{name}.yaml", "--driver", row["driver"], "--episodes", "3", "--json", *allow)[
        0
    ]
    row["try"] = tried.returncode
    if not tried.returncode:
        summary = json.loads(tried.stdout)["summary"]
        row |= {"endings": summary["endings"], "mean_length": summary["mean_length"]}
    return row


def _run(work: Path, *words: str) -> tuple[subprocess.CompletedProcess[str], float]:
    """Return the result of a command and its CPU time in s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "deepbots_cli", *words]
    environment = {**os.environ, "PYTHONPATH": str(DOCS.parent)}
    done = subprocess.run(
        command, cwd=work, env=environment, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def filled(text: str, *, whole: bool = True) -> str:
    """Return the page with a summary of the record, and with its table, which only the site has."""
    data = json.loads(DATA.read_text(encoding="utf-8"))
    rows = data["robots"]
    right = sum(_is_right(row) for row in rows)
    clean = sum(not row["new"] and not row["errors"] and not row["try"] for row in rows)
    few = sum(sum(row.get("findings", {}).values()) < 4 for row in rows if not row["new"])
    lines = [
        "",
        f"`new`, `lint --deep` and `try` of {len(rows)} robots, {data['date']}: the kind is right for {right};"
        f" {clean} have no error; {few} have at most three findings ([data](../tools/results/records/robots.json)).",
        "",
    ]
    head = ("robot", "repository", "`new` says", "findings", "tried with", "episodes end by")
    lines += [*table(head, map(_cells, rows)), "", ""] if whole else [""]
    return _TABLE.sub(lambda _: "\n".join(lines), text)


def _is_right(row: dict[str, Any]) -> bool:
    from deepbots_cli.robots.kinds import NOUNS, Kind

    kinds = row["kind"] if isinstance(row["kind"], list) else [row["kind"]]
    return any(row["said"].startswith(f"{NOUNS[Kind(kind)]}: ") for kind in kinds)


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    findings = ", ".join(f"{count} {code}" for code, count in row.get("findings", {}).items())
    endings = ", ".join(f"{name} {count}" for name, count in row.get("endings", {}).items())
    said = row["said"] if _is_right(row) else f"**{row['said']}**"
    return (Path(row["file"]).stem, row["repository"], said, findings, row.get("driver", ""), endings)


def main() -> None:
    if sys.argv[1:] == ["--page"]:
        PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), whole=False), encoding="utf-8")
        return
    folder, work, *part = sys.argv[1:]
    rows = measure(Path(folder), Path(work), *part)
    DATA.write_text(json.dumps({"date": str(datetime.date.today()), "robots": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
