"""`deepbots eject`: a scenario as a small Python project whose generated classes are there to be edited."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from shlex import quote
from typing import Annotated

import typer

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.options import AllowCode, AllowPaths, Json, Scenario, Sets
from deepbots_cli.cli.rewriting import Files, write_new
from deepbots_cli.codegen.names import class_name
from deepbots_cli.compiler.inputs import FOLDER, RESOLVED
from deepbots_cli.errors import UsageError, cloned


def command(
    scenario: Scenario,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A new or empty folder.")],
    sets: Sets = None,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Write a scenario out as a small Python project of its own.

    It holds the generated classes to edit, the scenario with its files, and scripts to run and to train. It needs deepbots as a library.
    What can be said in the scenario is better changed there.

    \b
      deepbots eject cartpole my_cartpole
      cd my_cartpole && python run.py
    """
    _check(folder)
    compiled = api.compile(scenario, sets=sets or (), allow_paths=allow_paths or (), allow_code=allow_code)
    terminal.mention(compiled.findings, scenario)
    written = write_new(project(compiled), folder)
    if as_json:
        terminal.show_json({"project": folder, "files": written})
        return
    for path in written:
        terminal.say(str(path))
    terminal.note(f"run it: cd {quote(str(folder))} && python run.py")


def project(compiled: api.Compiled) -> Files:
    """The files of the project, README first; the templates are in `project/`."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    folder = Path(__file__).parents[1] / "project"
    templates = Environment(loader=FileSystemLoader(folder), undefined=StrictUndefined, keep_trailing_newline=True, autoescape=False)
    words = {
        "name": compiled.program.name,
        "summary": compiled.program.summary,
        "version": deepbots_cli.__version__,
        "digest": compiled.digest[:12],
        "supervisor": f"{class_name(compiled.program.name)}Supervisor",
        "resolved": RESOLVED,
        "inputs": FOLDER,
        "options": ", allow_code=True" if compiled.allow_code else "",
    }
    made = {name: templates.get_template(f"{name}.j2").render(words) for name in ("README.md", "task.py", "run.py", "train.py")}
    made |= {"environment.py": compiled.code, RESOLVED: compiled.resolved, "requirements.txt": _requirements()}
    copies = {PurePosixPath(FOLDER, path): content for path, content in compiled.inputs.items()}
    return {PurePosixPath(path): text.encode() for path, text in made.items()} | copies


def _requirements() -> str:
    """What the project needs: the clone that deepbots was installed from, where pip knows it; no index of packages has deepbots."""
    clone = cloned()
    known = clone != "deepbots-cli"
    here = f"deepbots-cli[train] @ {Path(clone).as_uri()}" if known else "# deepbots-cli[train] @ file:///PATH/TO/THE/CLONE"
    moved = ", where that has changed" if known else ""
    return f"# deepbots {deepbots_cli.__version__} is installed from a clone; put its place here{moved}\n{here}\n"


def _check(folder: Path) -> None:
    """Raises: UsageError: The folder is there and holds anything; a project is never written over another."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} exists and is not an empty folder; name another")
