"""`deepbots list`."""

from __future__ import annotations

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Json
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.document import Scalar, load, shipped


def command(as_json: Json = False) -> None:
    """List the scenarios that come with deepbots.

    \b
      deepbots list
      deepbots list --json

    Next: `deepbots inspect NAME` shows a scenario, `deepbots copy NAME` copies it to a folder of yours, and `deepbots runs`
    lists your runs.
    """
    rows: list[Row] = []
    for name in shipped.scenario_names():
        path = shipped.scenario_path(name)
        root = load(path).root if path else None
        summary = root.get("summary") if root else None
        rows.append({"name": name, "summary": summary.text if isinstance(summary, Scalar) else ""})
    if as_json:
        terminal.show_json({"scenarios": rows})
        return
    terminal.say("scenarios\n" + table(rows))
    terminal.note("your runs are listed by: deepbots runs")
