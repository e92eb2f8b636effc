"""`deepbots compile`: the Python module of a scenario, or a project around it; `lsp`: the language server, or
the JSON Schema of scenario files."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path, PurePosixPath
from typing import Annotated

import typer

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import ADVANCED, OUTPUT, Force, Json, Overrides, Scenario, option
from deepbots_cli.cli.written_files import Files, check_new_folder, modeline, write_new
from deepbots_cli.codegen import formatted, generate_module
from deepbots_cli.codegen.names import class_name
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME
from deepbots_cli.compiler.inventory import scenario_names
from deepbots_cli.diagnostics.render import summary
from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.installation import clone_folder
from deepbots_cli.program import identity
from deepbots_cli.program.task import Training
from deepbots_cli.scenario.json_schema import schema_text
from deepbots_cli.scenario.training import ALGORITHMS
from deepbots_cli.words import shell_word


def command(
    scenario: Scenario,
    overrides: Overrides = None,
    output: Annotated[
        Path | None,
        option("--output -o FILE", "Write to this file. By default, or with - as FILE, print.", OUTPUT),
    ] = None,
    project: Annotated[
        Path | None,
        option(
            "--project DIR",
            "Write a Python project to this folder: the module, and scripts that run and train it.",
            OUTPUT,
        ),
    ] = None,
    as_json: Json = False,
    program: Annotated[
        bool,
        option("--program", "Print the compiled scenario as canonical JSON instead of Python.", ADVANCED),
    ] = False,
    target: Annotated[
        str,
        option(
            "--target TARGET",
            "scalar: one world; batch: many worlds, where each number is an array.",
            ADVANCED,
        ),
    ] = "scalar",
    force: Force = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Print the Python module of a scenario, or write a project around it."""
    if target not in ("scalar", "batch"):
        raise UsageError(f"there is no target '{target}'; use scalar or batch")
    if project is not None:
        check_new_folder(project, force=force)
    compiled = api.compile(scenario, overrides=overrides or (), permissions=permissions)
    output = terminal.output_file(output)
    if output is not None:
        terminal.refuse_input(
            output, () if compiled.document is None else compiled.document.files, compiled.inputs.values()
        )
    terminal.note_warnings(compiled.findings, scenario, compiled.permissions, compiled.overrides)
    if project is not None:
        paths = write_new(project_files(compiled), project, force=force)
        further = [f"cd {shell_word(project)} && python run.py"]
        terminal.show(
            {"project": project, "files": paths}, *map(str, paths), as_json=as_json, next_commands=further
        )
        return
    code = formatted(compiled.code if target == "scalar" else generate_module(compiled.program, target))
    if as_json:
        data = {
            "name": compiled.program.name,
            "digest": compiled.digest,
            "code": code,
            "inputs": list(compiled.inputs),
        }
        text = terminal.json_text(data)
    else:
        text = f"{identity.to_json(compiled.program)}\n" if program else code
    terminal.print_or_write(text, output, force=force)


def project_files(compiled: api.Compiled) -> Files:
    """Return the files of the project, README first; the templates are in `project/`."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    templates = Environment(
        loader=FileSystemLoader(Path(__file__).parents[1] / "project"),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,
    )
    words = {
        "name": compiled.program.name,
        "summary": compiled.program.summary,
        "version": deepbots_cli.__version__,
        "digest": compiled.digest[:12],
        "supervisor": f"{class_name(compiled.program.name)}Supervisor",
        "resolved": RESOLVED_NAME,
        "inputs": INPUTS_FOLDER,
        "code": compiled.permissions.code,
    }
    contents = {
        name: templates.get_template(f"{name}.j2").render(words)
        for name in ("README.md", "task.py", "run.py", "train.py")
    }
    contents |= {
        "environment.py": formatted(compiled.code),
        RESOLVED_NAME: compiled.resolved,
        "requirements.txt": _requirements(compiled.program.agent.training),
    }
    copies = {PurePosixPath(INPUTS_FOLDER, path): content for path, content in compiled.inputs.items()}
    return {PurePosixPath(path): text.encode() for path, text in contents.items()} | copies


def _requirements(training: Training | None) -> str:
    """Return the requirements of the project: the clone from which deepbots was installed, if pip records it;
    no package index has deepbots."""
    used = () if training is None else (training, *(own for _, own in training.agents))
    is_contrib = any(ALGORITHMS[each.algorithm].import_path.startswith("sb3_contrib:") for each in used)
    extra = "contrib" if is_contrib else "train"
    clone = clone_folder()
    version = deepbots_cli.__version__
    if clone is None:
        return (
            f"# deepbots {version} is not on a package index; write the path of its clone here\n"
            f"# deepbots-cli[{extra}] @ file:///PATH/TO/THE/CLONE\n"
        )
    return (
        f"# deepbots {version} is installed from a clone; write its path here if it has moved\n"
        f"deepbots-cli[{extra}] @ {clone.as_uri()}\n"
    )


def command_lsp(
    port: Annotated[
        int | None,
        option(
            "--tcp PORT",
            "Listen on this port; by default, use standard input and output.",
            ADVANCED,
            min=1,
            max=65535,
        ),
    ] = None,
    schema: Annotated[
        bool, option("--schema", "Print the JSON Schema of scenario files, and run no server.")
    ] = False,
    scenario: Annotated[
        str | None,
        option(
            "--for SCENARIO",
            "Also list the joints, links, sensors and other names of this scenario in the schema.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        option(
            "--output -o FILE",
            "Write the schema to this file. By default, or with - as FILE, print to standard output.",
            OUTPUT,
        ),
    ] = None,
    force: Force = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Run the language server, or print the JSON Schema of scenario files."""
    if schema:
        _schema(scenario, output, force=force, folders=permissions.folders)
        return
    if find_spec("pygls") is None:
        raise MissingExtraError("editor", "the language server")
    from deepbots_cli.lsp.server import serve

    raise typer.Exit(serve(port, permissions=permissions))


def _schema(scenario: str | None, output: Path | None, *, force: bool, folders: Sequence[str | Path]) -> None:
    """Print or write the JSON Schema of scenario files; with the names of a scenario, if there is one."""
    output = terminal.output_file(output)
    if scenario is None:
        terminal.print_or_write(schema_text(), output, force=force)
        return
    checked = api.load(scenario, permissions=Permissions(folders))
    if output is not None:
        terminal.refuse_input(output, checked.document.files, checked.inputs.contents().values())
    terminal.print_or_write(schema_text(scenario_names(checked)), output, force=force)
    if checked.findings.errors:
        terminal.note(
            f"{summary(checked.findings.errors)}: names in unreadable parts are missing; see: deepbots lint"
            f" {shell_word(scenario)}"
        )
    if output is not None and Path(scenario).is_file():
        terminal.note(
            f"write as the first line of {checked.document.path.name}:"
            f" {modeline(checked.document.path, output)}"
        )
