"""`deepbots scenarios`: the scenarios that come with deepbots."""

from __future__ import annotations

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Json
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.document import ScalarNode, load, shipped


def command(as_json: Json = False) -> None:
    """List the scenarios that come with deepbots."""
    rows: list[Row] = []
    for name in shipped.scenario_names():
        path = shipped.scenario_path(name)
        root = load(path).root if path else None
        summary = root.get("summary") if root else None
        rows.append({"name": name, "summary": summary.text if isinstance(summary, ScalarNode) else ""})
    terminal.show({"scenarios": rows}, table(rows), as_json=as_json)
