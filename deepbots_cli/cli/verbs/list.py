"""`deepbots list`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.options import Json
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.errors import RunError
from deepbots_cli.learning.record import NAME, Record
from deepbots_cli.source import Scalar, load, shipped


def command(
    runs: Annotated[Path, typer.Option("--runs", metavar="DIR", help="The folder that holds your runs.")] = Path("runs"),
    as_json: Json = False,
) -> None:
    """List the scenarios that come with deepbots, and your runs.

    \b
      deepbots list
      deepbots list --runs /data/runs --json
    """
    scenarios, known = _scenarios(), _runs(runs)
    if as_json:
        terminal.show_json({"scenarios": scenarios, "runs": known})
        return
    terminal.say("scenarios\n" + table(scenarios))
    if known:
        terminal.say(f"\nruns in {runs}\n" + table(known))
    else:
        terminal.note(f"\nno runs in {runs} yet; make one with: deepbots train cartpole")


def _scenarios() -> list[Row]:
    rows: list[Row] = []
    for name in shipped.scenario_names():
        path = shipped.scenario_path(name)
        root = load(path).root if path else None
        summary = root.get("summary") if root else None
        rows.append({"name": name, "summary": summary.text if isinstance(summary, Scalar) else ""})
    return rows


def _runs(folder: Path) -> list[Row]:
    if not folder.is_dir():
        return []
    found = [path for path in folder.iterdir() if (path / NAME).is_file()]
    return [_run(path) for path in sorted(found, key=lambda path: ((path / NAME).stat().st_mtime, path.name))]


def _run(path: Path) -> Row:
    try:
        record = Record.read(path)
    except RunError as error:
        return {"run": path.name, "scenario": "?", "status": "damaged", "steps": None, "mean_return": None, "solved": str(error)}
    result = record.result or {}
    return {
        "run": path.name,
        "scenario": record.scenario,
        "status": record.status,
        "steps": _number(result.get("steps")),
        "mean_return": _number(result.get("mean_return")),
        "solved": _solved(result.get("solved_at")),
        "trained": record.updated,
    }


def _number(value: object) -> float | None:
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def _solved(at: object) -> str:
    if not isinstance(at, dict):
        return "not yet"
    episode = _number(at.get("episode"))
    return "yes" if episode is None else f"in episode {episode:,}"
