"""`deepbots new`: a scenario from a template, for a robot file (`starters/`) or for a world of Webots, or a
copy of a shipped one with the files that it reads; `scenarios`: the shipped ones."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import starters, terminal
from deepbots_cli.cli.arguments import RobotError, open_robot, robot_path, xacro_arguments
from deepbots_cli.cli.command import OUTPUT, Force, Json, Starter, XacroArguments, entry_of_webots, option
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.starters.draft import Template, from_template, scenario_title
from deepbots_cli.cli.starters.first_scenario import UNIT_CODES, Choices, FirstScenario, Task
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.cli.written_files import Files, modeline, write_new
from deepbots_cli.compiler.inventory import scenario_names
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.diagnostics.nearest import did_you_mean
from deepbots_cli.document import Permissions, ScalarNode, files, load, shipped, walk
from deepbots_cli.document.files import UnusableFile, project_root, resolve_reference
from deepbots_cli.document.load import allowed_folders
from deepbots_cli.document.nodes import node_at
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import UsageError
from deepbots_cli.files import refuse_overwriting
from deepbots_cli.program import Program
from deepbots_cli.robots import reader
from deepbots_cli.robots.kinds import Kind
from deepbots_cli.robots.meshes import read_mesh
from deepbots_cli.robots.model import Mesh
from deepbots_cli.robots.reader import RobotFile
from deepbots_cli.scenario.json_schema import schema_text
from deepbots_cli.words import shell_word

_WORKFLOW = """\
name: lint
on: [push, pull_request]
jobs:
  lint:
    runs-on: ubuntu-latest
    steps:
      - uses: actions/checkout@v4
      - uses: actions/setup-python@v5
        with: {python-version: "3.11"}
      - run: pip install deepbots-cli # or the address of a clone of deepbots
      - run: deepbots lint . --format github
"""
_PROJECT = {
    ".gitignore": "exploits/\nruns/\n",
    ".github/workflows/lint.yml": _WORKFLOW,
    ".vscode/extensions.json": '{"recommendations": ["redhat.vscode-yaml"]}\n',
    ".vscode/settings.json": '{\n  "yaml.schemas": {"deepbots.schema.json": ["*.yaml"]},\n '
    ' "yaml.disableDefaultProperties": true\n}\n',
}
"""The files of a project beside its scenario and `deepbots.schema.json`. The second setting leaves out keys
that repeat a default."""

_MAX_TIMED_MESHES = 10
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the scenario; the file is NAME.yaml.")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the files.")] = Path("."),
    template: Annotated[Template | None, option("--template", "Template to begin with.")] = None,
    shipped_name: Annotated[
        str | None,
        option(
            "--from SCENARIO", "Shipped scenario to copy with its files; `deepbots scenarios` lists them."
        ),
    ] = None,
    urdf: Annotated[
        str | None,
        option(
            "--urdf ROBOT", "Robot file to begin with: a path, package://..., or the name of a shipped robot."
        ),
    ] = None,
    kind: Annotated[
        Kind | None,
        option("--kind", "What the robot of --urdf is, where deepbots judges wrongly."),
    ] = None,
    task: Annotated[
        Task | None,
        option("--task", "What the robot of --urdf is to do, by default the task of its kind."),
    ] = None,
    xacro: XacroArguments = None,
    copy: Annotated[
        bool,
        option("--copy", "Copy the robot file of --urdf and its meshes into the folder."),
    ] = False,
    webots: Annotated[
        Path | None,
        option(
            "--webots WORLD.wbt",
            "World of a project of Webots to begin with; deepbots reads its controllers, and runs no code.",
        ),
    ] = None,
    protos: Annotated[
        list[Path] | None,
        option(
            "--protos DIR",
            "A copy of Webots, or a folder with PROTO files, from which the world may read; may be repeated.",
        ),
    ] = None,
    lesson: Annotated[
        bool,
        option("--lesson", "Write a lesson that marks itself, in the folder NAME, to change."),
    ] = False,
    schema: Annotated[
        bool, option("--schema", "Also write NAME.schema.json for completion in an editor.", OUTPUT)
    ] = False,
    project: Annotated[
        Path | None,
        option(
            "--project DIR",
            "Write a project: scenario, schema, settings of VS Code, and a GitHub workflow that lints.",
            OUTPUT,
        ),
    ] = None,
    as_json: Json = False,
    force: Force = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Write a scenario: from a template, a copy, a robot file, or a world of Webots."""
    name = validated_name(name)
    if lesson:
        _write_lesson(folder / name, as_json=as_json, force=force)
        return
    if not (template or shipped_name or urdf or webots):
        raise UsageError(
            f"choose what to start from: --template {'|'.join(Template)}, --from SCENARIO, --urdf ROBOT,"
            " --webots WORLD.wbt, or --lesson"
        )
    if project is not None:
        if folder != Path("."):
            raise UsageError("--project names the folder; leave out DIR")
        folder = project
    starter: Starter | None = None
    first: FirstScenario | None = None
    if urdf:
        choices = Choices(kind, task, xacro_arguments(xacro))
        place = f" --project {shell_word(project)}" if project is not None else _folder_argument(folder)
        base = f"deepbots new {name} --urdf {shell_word(urdf)}{_choice_options(choices)}{place}"
        base += f"{' --schema' if schema else ''}{' --force' if force else ''}{_options(permissions)}"
        contents, first = _from_robot(urdf, name, folder, permissions, choices, base, copy=copy)
        _note_kind(urdf, first)
    elif webots is not None:
        starter = entry_of_webots("starter")(webots, protos or (), name, scenario_title(name))
        contents = dict(starter.files)
    else:
        contents = from_shipped(shipped_name, name) if shipped_name else from_template(template or "", name)
    if project is not None:
        contents |= {PurePosixPath(path): text.encode() for path, text in _PROJECT.items()}
        contents[PurePosixPath("deepbots.schema.json")] = schema_text().encode()
    before = _contents([*(folder / target for target in contents), folder / f"{name}.schema.json"])
    if copy:
        permissions = Permissions(code=permissions.code)
    paths = (
        write_with_schema(contents, folder, permissions, force=force)
        if schema
        else write_new(contents, folder, force=force)
    )
    if project is not None and permissions.folders and "DB204" in {f.code for f in api.lint(paths[0])}:
        terminal.note("the GitHub workflow will fail, because it reads the project alone; add --copy")
    if urdf or starter is not None:
        terminal.note_warnings(api.lint(paths[0], permissions=permissions), str(paths[0]), permissions)
    if starter is not None:
        _note_places(starter)
    commands = _next_commands(
        paths[0], starter, permissions, has_schema=bool(schema or project), as_json=as_json
    )
    todos = None if starter is None else starter.todos
    unchanged = before.items() & _contents(paths).items()
    _show(paths, {path for path, _ in unchanged}, commands, permissions, first, as_json=as_json, todos=todos)


def _write_lesson(folder: Path, *, as_json: bool, force: bool) -> None:
    """Write a lesson that `deepbots course verify` proves as it is."""
    from deepbots_cli.course.lessons import course_folder

    model = course_folder() / "template"
    contents = {
        PurePosixPath(path.relative_to(model)): path.read_bytes()
        for path in sorted(model.rglob("*"))
        if path.is_file()
    }
    write_new(contents, folder, force=force)
    commands = [
        f"deepbots course verify {shell_word(folder)}",
        f"deepbots course start {shell_word(folder)} as_a_student",
    ]
    terminal.show(
        {"lesson": str(folder)},
        f"{folder}: a small lesson with a check of each kind; change its files, text.md and teacher.md, too",
        as_json=as_json,
        next_commands=commands,
    )


def _next_commands(
    scenario: Path, starter: Starter | None, permissions: Permissions, *, has_schema: bool, as_json: bool
) -> list[str]:
    """Return the commands to go on with, the next one first."""
    commands = ["try", "inspect", "lint", "train"]
    if starter is not None:
        commands = ["lint", "try", "inspect", "train"]
    program = api.load(scenario, permissions=permissions).program
    if program is not None:
        if not as_json:
            _name_faster_engine(program)
        if program.members:
            commands.append("compare")
        else:
            commands += [f"train --teacher {script.name}" for script in program.agent.scripts[:1]]
    return commands if has_schema else [*commands, "lsp --schema --for"]


def _note_places(starter: Starter) -> None:
    """Print what the world has that the scenario lacks, and how many places are left."""
    for warning in starter.warnings:
        terminal.note(warning)
    count_text = "1 place is" if starter.todos == 1 else f"{starter.todos} places are"
    terminal.note(
        f"{count_text} left to you; each begins with `# FILL IN` and names the Python it comes from"
    )


def _name_faster_engine(program: Program) -> None:
    """Print the engine that steps the new world faster; nothing without a simulator, and for robots of many
    meshes, which engines take seconds to load."""
    shapes = [
        part.shape
        for robot in program.world.robots
        for link in robot.model.links
        for part in (*link.visuals, *link.collisions)
    ]
    if sum(isinstance(shape, Mesh) for shape in shapes) > _MAX_TIMED_MESHES:
        return
    with suppress(ModuleNotFoundError):
        terminal.note_faster_engine(program, None, Permissions())


def validated_name(name: str) -> str:
    """Return the name of a new scenario without the suffix .yaml.

    Raises:
        UsageError: The name is not valid for a file and a run.
    """
    bare = name.removesuffix(".yaml")
    folder, _, last = bare.rpartition("/")
    if folder and _NAME.fullmatch(last):
        raise UsageError(
            f"'{name[:80]}' contains a folder; write the folder after the name: deepbots new {last}"
            f" {shell_word(folder)} ..."
        )
    if not _NAME.fullmatch(bare):
        raise UsageError(
            f"'{name[:80]}' is not a valid name; use up to 64 letters, digits, _ and -, and begin with a"
            " letter"
        )
    return bare


def _options(permissions: Permissions) -> str:
    """Return the options for these permissions, with a blank before each."""
    return "".join(f" {option}" for option in terminal.scenario_options(permissions))


def _from_robot(
    robot: str,
    name: str,
    folder: Path,
    permissions: Permissions,
    choices: Choices,
    base: str,
    *,
    copy: bool,
) -> tuple[Files, FirstScenario]:
    """Return the files for a robot file, and what was chosen for it; a file whose meshes are in folders that
    are not allowed is refused with the commands that allow them, which begin with `base`."""
    try:
        return from_robot(robot, name, folder, permissions, choices, base, copy=copy)
    except RobotError as error:
        if not error.allow:
            raise
        terminal.show_findings(error.findings, permissions)
        base += _options(Permissions(error.allow))
        terminal.note(
            f"\nto copy the robot and its meshes into the folder of the scenario:\n  {base} --copy\n"
            f"to leave them where they are, and allow the folder in each command:\n  {base}"
        )
        raise typer.Exit(FAILED) from error


def _note_kind(urdf: str, first: FirstScenario) -> None:
    """Print what kind of robot a file describes, and the tasks that suit it."""
    further = " or ".join(f"--task {task}" for task in first.further)
    choice = f"; {further} writes another one" if further else ""
    terminal.note(f"{urdf} is {first.judgment}\nthe task of its scenario is `{first.task}`{choice}")


def _choice_options(choices: Choices) -> str:
    """Return the options for these choices, with a blank before each."""
    arguments = (("--xacro-arg", f"{key}:={value}") for key, value in choices.xacro.items())
    options = [("--kind", choices.kind), ("--task", choices.task), *arguments]
    return "".join(f" {option} {shell_word(value)}" for option, value in options if value is not None)


def _folder_argument(folder: Path) -> str:
    return "" if folder == Path(".") else f" {shell_word(folder)}"


def from_robot(
    robot: str,
    name: str,
    folder: Path,
    permissions: Permissions,
    choices: Choices,
    base: str,
    *,
    copy: bool = False,
) -> tuple[Files, FirstScenario]:
    """Return the scenario `NAME.yaml` in `folder` for a robot file: a path, the name of a shipped robot, or
    package://...; with `copy` also the robot file and its meshes, in a folder of their own. Also returns what
    was chosen for it. Commands in an error begin with `base`.

    Raises:
        UsageError: The file does not exist, a scenario in the folder may not read it, the robot has no joint
            that can be driven, no kind is sure, or the task does not suit the robot.
        RobotError: The file is not a valid robot.
    """
    file, findings = open_robot(robot, permissions.folders, choices.xacro)
    copies = _copies(file, robot_path(robot, permissions.folders)) if copy else {}
    reference = next(iter(copies)).as_posix() if copies else _reference(robot, folder, permissions, base)
    if copies:  # a copy is expanded
        choices = replace(choices, xacro={})
    try:
        first = starters.scenario(file.model, reference, scenario_title(name), choices)
    except UsageError:
        if units := [finding for finding in findings if finding.code in UNIT_CODES]:
            terminal.show_findings(units, permissions)  # a mesh in millimeters hides what the robot is
        raise
    return {PurePosixPath(f"{name}.yaml"): first.text.encode(), **copies}, first


def _copies(file: RobotFile, path: Path) -> Files:
    """Return a robot file, which names its meshes by relative paths, and the meshes; the folders between them
    stay."""
    path = path.resolve()
    if file.xacro:
        path = path.with_name(f"{path.name.partition('.')[0]}.urdf")
    meshes = {Path(mesh): Path(mesh) for mesh in file.meshes}
    # A `.gltf` file is copied with its buffers, as `.glb`.
    for mesh in [mesh for mesh in meshes if mesh.suffix.lower() == ".gltf"]:
        names = (mesh.with_name(f"{mesh.stem}{number}.glb") for number in ("", *range(2, len(meshes) + 2)))
        meshes[mesh] = next(name for name in names if name not in meshes.values())
    top = Path(os.path.commonpath([path.parent, *(mesh.parent for mesh in meshes)]))
    home = PurePosixPath(path.stem)
    text = file.with_mesh_names(
        lambda mesh: os.path.relpath(meshes[Path(mesh)], path.parent).replace(os.sep, "/")
    )
    return {home / path.relative_to(top).as_posix(): text.encode()} | {
        home / target.relative_to(top).as_posix(): read_mesh(mesh) for mesh, target in meshes.items()
    }


def _reference(robot: str, folder: Path, permissions: Permissions, base: str) -> str:
    """Return the reference to a robot file in a scenario in `folder`; commands in an error begin with
    `base`."""
    file = robot_path(robot, permissions.folders)
    # In a scenario, a file of this name comes before the shipped robot.
    is_name = file == shipped.robot_path(robot) and not (folder / robot).is_file()
    if is_name or robot.startswith("package://"):
        return robot
    path = os.path.relpath(file.resolve(), folder.resolve()).replace(os.sep, "/")
    referenced = resolve_reference(
        path,
        folder.resolve(),
        [project_root(folder), *shipped.data_roots(), *allowed_folders(permissions.folders)],
    )
    if isinstance(referenced, UnusableFile):
        parent = shell_word(os.path.dirname(robot) or ".")
        raise UsageError(
            f"a scenario in {folder.resolve()} may not read {robot}, because the file {referenced.problem};"
            f" copy it with its meshes: `{base} --copy`; or allow its folder, here and in later commands:"
            f" `{base} --allow-path {shell_word(parent)}`; a robot of an installed package is named as"
            " package://PACKAGE/PATH"
        )
    return path


# Copies of shipped scenarios

_PLAIN = re.compile(r"[A-Za-z0-9_./-]+")


def from_shipped(shipped_name: str, name: str) -> Files:
    """Return the files of a shipped scenario by their paths in the new folder, the scenario first, as
    `NAME.yaml` and under this name.

    Files of `scenarios/` move to the top of the folder. The paths in scenarios are rewritten; comments stay.

    Raises:
        UsageError: There is no shipped scenario of this name, it is not UTF-8 text, or it reads another one
            that is called `NAME.yaml`.
    """
    first = shipped.scenario_path(shipped_name)
    if first is None:
        names = shipped.scenario_names()
        if shipped_name.endswith((".yaml", ".yml")) and os.path.isfile(shipped_name):
            advice = (
                f"copy your own file with `cp {shell_word(shipped_name)} {name}.yaml`, or write `extends:"
                f" {shipped_name}` in a new file"
            )
            raise UsageError(
                f"--from copies a scenario that comes with deepbots, and {shipped_name} is a file; {advice}"
            )
        if shipped_name.startswith("package://") or shipped_name.endswith((".urdf", ".xacro")):
            raise UsageError(
                f"--from copies a scenario, and {shipped_name} is a robot; for a scenario with this robot:"
                f" deepbots new {shell_word(name)} --urdf {shell_word(shipped_name)}"
            )
        raise UsageError(
            f"there is no shipped scenario '{shipped_name}'{did_you_mean(shipped_name, names)}; shipped"
            f" scenarios are: {', '.join(names)}"
        )
    target = PurePosixPath(f"{name}.yaml")
    text, waiting = _rewritten(first.resolve())
    contents: Files = {target: text if name == first.stem else _renamed(text, name)}
    while waiting:
        file = waiting.pop(0)
        if _target(file) == target:
            raise UsageError(f"'{name}' is the name of a file that {shipped_name} reads; choose another name")
        if _target(file) not in contents:
            contents[_target(file)], needed = _moved(file)
            waiting += needed
    return contents


def _renamed(content: bytes, name: str) -> bytes:
    """Return the scenario with another `name`, if it has one."""
    text = content.decode()
    node = node_at(parse(Source("", text), Findings()), "name")
    return (
        (text[: node.span.start] + scenario_title(name) + text[node.span.end :]).encode() if node else content
    )


def _target(file: Path) -> PurePosixPath:
    # The innermost one: a package may lie in the checkout of deepbots.
    folders = [folder.resolve() for folder in shipped.data_dirs()]
    data = max(filter(file.is_relative_to, folders), key=lambda folder: len(folder.parts))
    scenarios = data / "scenarios"
    return PurePosixPath(file.relative_to(scenarios if file.is_relative_to(scenarios) else data))


def _moved(file: Path) -> tuple[bytes, list[Path]]:
    """Return the content of `file` for its new place, and the files that it needs."""
    if file.suffix == ".yaml":
        return _rewritten(file)
    content = file.read_bytes()
    if file.suffix == ".urdf":
        robot = reader.read(file, file.name, Findings())
        return content, [Path(mesh) for mesh in robot.meshes] if robot else []
    return content, []


def _rewritten(file: Path) -> tuple[bytes, list[Path]]:
    findings = Findings()
    text = files.decode(files.read(file), str(file), findings)[0].text
    for error in findings.errors:
        raise UsageError(f"{error.span.location}: {error.headline}")
    needed = []
    # From the last one on, so that the spans of those before stay valid.
    for scalar, path in reversed(list(_references(file, text))):
        needed.append(path)
        relative = os.path.relpath(_target(path), _target(file).parent).replace(os.sep, "/")
        quoted = relative if _PLAIN.fullmatch(relative) else json.dumps(relative)
        text = text[: scalar.span.start] + quoted + text[scalar.span.end :]
    return text.encode(), needed[::-1]


def _references(file: Path, text: str) -> Iterator[tuple[ScalarNode, Path]]:
    """Yield every value that names a shipped file, in file order: a path, or a name as the value of `urdf` or
    `extends`. The value of an anchor is one value, whatever number of aliases it has."""
    root = parse(Source(file.name, text), Findings())
    if root is None:
        return
    values = {node.span: (path, node) for path, node in reversed(list(walk(root)))}
    for path, node in reversed(values.values()):
        if isinstance(node, ScalarNode) and isinstance(node.value, str):
            library = (
                {"urdf": shipped.ROBOTS, "extends": shipped.SCENARIOS}.get(str(path[-1])) if path else None
            )
            referenced = files.resolve_reference(node.text, file.parent, shipped.data_roots(), library)
            if isinstance(referenced, Path):
                yield node, referenced


# Writing


def _contents(paths: Iterable[Path]) -> dict[Path, bytes]:
    """Return the contents of those paths that are files."""
    return {path: path.read_bytes() for path in paths if path.is_file()}


def _show(
    paths: Sequence[Path],
    unchanged: set[Path],
    commands: Sequence[str],
    permissions: Permissions,
    first: FirstScenario | None,
    *,
    as_json: bool,
    todos: int | None = None,
) -> None:
    """Print the paths, with a mark at files that were there before with the same content, and the commands to
    go on with."""
    scenario, schema = shell_word(paths[0]), shell_word(paths[0].with_suffix(".schema.json"))
    lines = [f"{path} (unchanged)" if path in unchanged else str(path) for path in paths]
    further = [
        f"deepbots {command} {scenario}{_options(permissions)}"
        + (f" -o {schema}" if "schema" in command else "")
        for command in commands
    ]
    facts: dict[str, object] = {"scenario": paths[0], "files": paths}
    if todos is not None:
        facts["places"] = todos
    if first is not None:
        judgment = first.judgment
        facts |= {"kind": judgment.kind, "evidence": judgment.evidence, "task": first.task}
        facts["further_tasks"] = first.further
    terminal.show(facts, *lines, as_json=as_json, next_commands=further)


def write_with_schema(files: Files, folder: Path, permissions: Permissions, *, force: bool) -> list[Path]:
    """Write the files into `folder`, the first of them a scenario, with a schema for that one. Returns the
    files that were written.

    Raises:
        UsageError: Other files are in the way; nothing is written.
    """
    (target, text), *remaining = files.items()
    schema = target.with_suffix(".schema.json")
    with_modeline = f"{modeline(folder / target, folder / schema)}\n\n".encode() + text
    is_new = _contents([folder / target]) != {folder / target: with_modeline}
    # Unlike `exists`, this finds a link that leads nowhere, too.
    if is_new and os.path.lexists(folder / schema):
        refuse_overwriting(folder / schema, force=force)
    paths = write_new({target: with_modeline, **dict(remaining)}, folder, force=force)
    names = scenario_names(api.load(paths[0], permissions=permissions))
    return [*paths, *write_new({schema: schema_text(names).encode()}, folder, force=force)]


def command_scenarios(as_json: Json = False) -> None:
    """List the scenarios that come with deepbots."""
    rows: list[Row] = []
    for name in shipped.scenario_names():
        path = shipped.scenario_path(name)
        root = load(path).root if path else None
        summary = root.get("summary") if root else None
        rows.append({"name": name, "summary": summary.text if isinstance(summary, ScalarNode) else ""})
    terminal.show({"scenarios": rows}, table(rows), as_json=as_json)
