"""`deepbots list`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Json
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.document import Scalar, load, shipped
from deepbots_cli.errors import RunError
from deepbots_cli.learning.report import solved_text
from deepbots_cli.learning.run import NAME, Record


def command(
    runs: Annotated[Path, typer.Option("--runs", metavar="DIR", help="Folder of your runs.")] = Path("runs"),
    as_json: Json = False,
) -> None:
    """List the scenarios that come with deepbots, and your runs.

    Two runs with the same digest have the same scenario; `deepbots diff` compares the scenarios of two runs.

    \b
      deepbots list
      deepbots list --runs /data/runs --json

    Next: `deepbots inspect NAME` shows a scenario, and `deepbots copy NAME` copies it to a folder of yours.
    """
    scenarios, known = _scenarios(), _runs(runs)
    if as_json:
        terminal.show_json({"scenarios": scenarios, "runs": known})
        return
    terminal.say("scenarios\n" + table(scenarios))
    if known:
        terminal.say(f"\nruns in {runs}\n" + table([{**row, "digest": str(row["digest"])[:8]} for row in known]))
    else:
        terminal.note(f"\nthere are no runs in {runs}; next: deepbots train cartpole")


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
        return {
            "run": path.name,
            "scenario": "?",
            "digest": "",
            "status": "damaged",
            "steps": None,
            "mean_return": None,
            "solved": str(error),
        }
    result = record.result
    return {
        "run": path.name,
        "scenario": record.scenario,
        "digest": record.digest,
        "status": record.status,
        "steps": result and result.steps,
        "mean_return": result and result.mean_return,
        "solved": solved_text(result.solved_at if result else None),
        "trained": record.updated,
    }
