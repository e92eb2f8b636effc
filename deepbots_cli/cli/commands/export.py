"""`deepbots export`: a policy as ONNX, and whether it fits a scenario."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import ADVANCED, AllowPaths, Force, Json, Overrides, option
from deepbots_cli.cli.commands.new import write_new
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.files import check_new_folder
from deepbots_cli.learning.run import Run
from deepbots_cli.program import identity


class Target(StrEnum):
    onnx = "onnx"


def command(
    source: Annotated[Path, typer.Argument(metavar="RUN|BUNDLE", help="A run directory, or with --check a folder that `export` wrote.")],
    to: Annotated[Target, option("--to", "Format of the policy.")] = Target.onnx,
    out: Annotated[Path | None, option("--output -o FOLDER", "Folder to write; by default RUN-onnx.")] = None,
    force: Force = False,
    last: Annotated[bool, option("--last", "Export the last model instead of the best one.", ADVANCED)] = False,
    check: Annotated[str | None, option("--check SCENARIO", "Compare a bundle with a scenario, item by item; write nothing.")] = None,
    overrides: Overrides = None,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
) -> None:
    """Export the policy of a run as ONNX.

    The bundle is a folder that runs with onnxruntime alone. policy.onnx takes an observation in the form that the environment gives, with
    numbers scaled to -1 .. 1, and returns an action in the form that the environment takes. policy_si.onnx does the same in SI units: it
    takes the observation without scaling, and returns the action as `command`. card.json and README.md hold names, units, ranges, the
    control rate, the result with its interval, and versions.

    --check compares the observation, action and messages of the bundle with those of a scenario. The exit code is 0 if the policy fits,
    and 1 if it does not.

    \b
      deepbots export runs/cartpole-0-1 --to onnx -o cartpole-onnx
      deepbots export --check cartpole cartpole-onnx
      deepbots export --check mine.yaml cartpole-onnx

    Next: the README.md of the bundle shows its inputs and outputs.
    """
    if check is not None:
        _check(source, check, overrides or (), Permissions(allow_paths or (), code=True), as_json=as_json, writes=out is not None or last)
        return
    if overrides or allow_paths:
        raise UsageError("--set and --allow-path need --check SCENARIO; a run is always exported as it was trained")
    folder = out or Path(f"{source.resolve().name}-onnx")
    check_new_folder(folder, force=force)
    run = Run.open(source)
    with terminal.transient_line("exporting the policy ..."):
        from deepbots_cli.insight import card  # torch, which exporting imports, takes a second

        files = card.bundle_files(run, "last" if last else "best")
    write_new(files, folder, force=force)
    known = card.read_card(folder)
    sizes = [f"{name} ({len(content) / 1000:,.0f} kB)" for name, content in files.items() if len(name.parts) == 1]
    text = f"{folder}: {', '.join(sizes)}, and the robot files of the scenario\n  {known.scenario}, {known.algorithm}: {known.result_text}"
    if known.result is None and not last and not as_json:
        terminal.note(f"evaluate the run first for a result in the card: deepbots eval {quote(str(source))}")
    next_commands = [f"deepbots export --check SCENARIO {quote(str(folder))}"]
    terminal.show({"bundle": folder, **known.model_dump(mode="json")}, text, as_json=as_json, next_commands=next_commands)


def _check(folder: Path, scenario: str, overrides: list[str] | tuple[()], permissions: Permissions, *, as_json: bool, writes: bool) -> None:
    from deepbots_cli.insight import card

    if writes:
        raise UsageError("--check writes nothing; leave out --output and --last")
    known = card.read_card(folder)
    compiled = api.compile(scenario, overrides=overrides, permissions=permissions)
    words = ("bundle", "scenario")
    differ = identity.compare_interfaces(known.interface, identity.interface(compiled.program), words=words)
    given = "".join(f" --set {quote(text)}" for text in overrides)
    remarks = card.remarks(known, compiled.program, f"deepbots diff {quote(str(folder / 'scenario.yaml'))} {quote(scenario)}{given}")
    verdict = f"the policy in {folder} does not fit {scenario}:" if differ else f"the policy in {folder} fits {scenario}"
    data = {"bundle": folder, "scenario": scenario, "fits": not differ, "differences": differ, "remarks": remarks}
    terminal.show(data, verdict, *(f"  {line}" for line in differ), as_json=as_json)
    for remark in () if as_json else remarks:
        terminal.note(f"note: {remark}")
    if differ:
        raise typer.Exit(FAILED)
