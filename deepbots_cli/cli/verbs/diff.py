"""`deepbots diff`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.comparison import Change, Group, changes
from deepbots_cli.cli.exits import FAILED, WRONG
from deepbots_cli.cli.options import AllowCode, AllowPaths, Json, Sets
from deepbots_cli.cli.sources import opened
from deepbots_cli.errors import ScenarioError

_HEADINGS = {
    Group.policy: "a policy trained on one does not fit the other",
    Group.task: "sensors, actions, rewards or endings differ",
    Group.world: "world, messages or starts differ, and so how hard the task is",
    Group.training: "training and evaluation",
    Group.cosmetic: "names, looks, the order of keys and last digits, which change no meaning",
}
_Side = Annotated[str, typer.Argument(metavar="SCENARIO|RUN", help="A file, the name of a shipped scenario, or a run directory.")]


def command(
    one: _Side,
    other: _Side,
    sets: Sets = None,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Compare two scenarios by meaning.

    Both are compiled and then compared: layout, comments and units make no difference. The scenario of a run directory
    is the one that it was trained on. --set changes the second scenario.

    The exit code is 0 if at most cosmetic differences were found, 1 for other differences, and 2 if a scenario cannot be compiled.

    \b
      deepbots diff pit_escape pit_escape_as_printed
      deepbots diff cartpole cartpole --set fall_angle=10deg
      deepbots diff runs/cartpole-0-1 cartpole.yaml
    """
    try:
        sides = [opened(name, given, allow_paths or (), allow_code=allow_code) for name, given in ((one, ()), (other, sets or ()))]
    except ScenarioError as error:
        terminal.show_findings(error.findings)
        raise typer.Exit(WRONG) from None
    found = changes(*sides)
    if as_json:
        terminal.show_json(_data(one, other, found))
    else:
        _show(found, one, other)
    if any(change.group is not Group.cosmetic for change in found):
        raise typer.Exit(FAILED)


def _data(one: str, other: str, found: Sequence[Change]) -> dict[str, object]:
    return {
        "one": one,
        "other": other,
        "same_meaning": all(change.group is Group.cosmetic for change in found),
        "policy_fits": all(change.group is not Group.policy for change in found),
        "differences": [{**vars(change), "group": change.group.value} for change in found],
    }


def _show(found: Sequence[Change], one: str, other: str) -> None:
    if not found:
        terminal.say(f"{one} and {other} mean the same")
    for group, heading in _HEADINGS.items():
        here = [change for change in found if change.group is group]
        if here:
            terminal.say(f"{group.value}: {heading}")
            for change in here:
                _show_change(change)
            terminal.say()


def _show_change(change: Change) -> None:
    terminal.say(f"  {change.path}")
    if change.through:
        terminal.say(f"      {change.one}\n      by another value of {', '.join(change.through)}")
        return
    if change.kind == "changed" and not (change.one or change.other):
        return
    for mark, text, absent in (("-", change.one, "added"), ("+", change.other, "removed")):
        if change.kind != absent:
            terminal.say(f"    {mark} {text or '(not written)'}")
