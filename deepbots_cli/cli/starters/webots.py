"""A scenario from a project of Webots: the YAML text, with a comment at each place that is left to a
person."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from deepbots_cli import api
from deepbots_cli.cli.starters.draft import aligned, yaml_name
from deepbots_cli.diagnostics.findings import FILL_IN
from deepbots_cli.errors import UsageError
from deepbots_cli.webots.imports.draft import read_project
from deepbots_cli.webots.imports.task import Entry

if TYPE_CHECKING:
    from deepbots_cli.webots.imports.draft import Draft, DraftRobot
    from deepbots_cli.webots.imports.task import Item, Task

_MAX_PASSES = 20
_LONGEST = 140  # characters of a line of Python
_HEAD = """\
# From {world} of Webots. {todos}
# What the project states in a plain form is below, with the values of the project. Webots and deepbots differ in their
# physics: see "Your project as a scenario" in docs/webots.md."""


@dataclass
class Starter:
    """The files of a scenario, the number of places that are left, and warnings about the world."""

    files: dict[PurePosixPath, bytes]
    todos: int
    warnings: list[str] = field(default_factory=list)


def from_webots(world: Path, library: Sequence[Path], name: str, title: str) -> Starter:
    """Return the scenario `NAME.yaml` for a world, with a robot file per robot. No code of the project runs.

    Raises:
        WorldError: The world has errors.
        UsageError: A file cannot be read, no robot has a motor, or no valid scenario came out.
    """
    draft = read_project(world, library)
    robots = {PurePosixPath(_robot_file(name, robot)): robot.urdf().encode() for robot in draft.robots}
    meshes = {
        PurePosixPath(path): content for robot in draft.robots for path, content in robot.built.meshes.items()
    }
    further = {**robots, **meshes}
    further |= {PurePosixPath(path): content for path, content in draft.surroundings.pictures.items()}
    lines = _settled(_lines(draft, name, title), further, name)
    text = "".join(f"{line.rstrip()}\n" for line in lines)
    todos = sum(line.strip().startswith(FILL_IN) for line in lines)
    head = _HEAD.format(world=_one_line(draft.world_file), todos=_todo_text(todos))
    files = {PurePosixPath(f"{name}.yaml"): f"{head}\n{text}".encode(), **further}
    return Starter(files, todos, list(map(str, draft.findings.warnings)))


def _todo_text(todos: int) -> str:
    if not todos:
        return "No place is left to you."
    count_text = "One place is" if todos == 1 else f"{todos} places are"
    return f"{count_text} left to you: search for FILL IN."


def _robot_file(name: str, robot: DraftRobot) -> str:
    return f"{name}_{robot.name}.urdf"


# A valid text

_REQUIRED = ("deepbots:", "name:", "urdf:", "timestep:")
"""Keys without which no scenario is left."""


def _settled(lines: list[str], files: dict[PurePosixPath, bytes], name: str) -> list[str]:
    """Return the lines with those commented out that make an error: a value may lack a form in the language
    although each part of it has one."""
    with tempfile.TemporaryDirectory() as folder:
        for path, content in files.items():
            Path(folder, path).write_bytes(content)
        scenario = Path(folder, f"{name}.yaml")
        for _ in range(_MAX_PASSES):
            scenario.write_text("\n".join(lines) + "\n", encoding="utf-8")
            errors = [finding for finding in api.lint(scenario) if finding.severity == "error"]
            if not errors:
                return lines
            numbers = {
                error.span.start_position.line
                for error in errors
                if error.span.source.name.endswith(scenario.name)
            }
            numbers = {number for number in numbers if _is_entry(lines, number)}
            if not numbers:
                break
            lines = _with_placeholders(lines, numbers)
    raise UsageError(f"no valid scenario came out: {errors[0].headline}")


def _is_entry(lines: Sequence[str], number: int) -> bool:
    if not 1 <= number <= len(lines):
        return False
    line = lines[number - 1].strip()
    return ": " in line and not line.startswith((*_REQUIRED, "#"))


def _with_placeholders(lines: list[str], numbers: set[int]) -> list[str]:
    result = []
    for number, line in enumerate(lines, start=1):
        if number in numbers:
            indent = len(line) - len(line.lstrip())
            result.append(f"{' ' * indent}{FILL_IN}: deepbots does not accept `{line.strip()}`")
        else:
            result.append(line)
    return _filled(result)


# Sections


def _lines(draft: Draft, name: str, title: str) -> list[str]:
    task = draft.task
    lines = ["deepbots: 1", f"name: {title}", "", "world:"]
    lines += [f"  {key}: {value}" for key, value in draft.surroundings.world]
    lines += [
        f"  {FILL_IN} from {_one_line(location)}: {_one_line(sentence)}"
        for location, sentence in draft.surroundings.left_out
    ]
    if draft.surroundings.objects:
        lines += ["", "objects:"]
        lines += [f"  {key}: {value}" for key, value in draft.surroundings.objects.items()]
    lines += ["", "robots:"]
    for robot in draft.robots:
        lines += _robot(robot, draft, name)
    timing = f", timing: {task.timing}" if task.timing else ""
    lines += ["", f"messages: {{format: {task.format}{timing}}}"]
    if task.agent:
        lines += ["", *_comments(task.agent, "")]
    lines += _section("action", task.action)
    lines += _section("augment", task.augment)
    lines += _section("observation", task.observation)
    lines += _section("reward", task.reward)
    lines += _endings(draft)
    lines += _section("truncation", task.truncation)
    starts = {
        f"{robot.name}.{joint}": value
        for robot in draft.robots
        for joint, value in robot.built.starts.items()
    }
    if starts:
        pairs = ", ".join(f"{joint}: {_position(value, joint, draft)}" for joint, value in starts.items())
        lines += ["", "reset:", f"  joints: {{{pairs}}}"]
    lines += _solved(draft)
    return _filled(lines)


def _position(value: float, joint: str, draft: Draft) -> str:
    robot_name, _, joint_name = joint.partition(".")
    robot = next(candidate for candidate in draft.robots if candidate.name == robot_name)
    unit = "m" if robot.model.joint(joint_name).type == "prismatic" else "rad"
    return f"{value:.9g} {unit}"


def _robot(robot: DraftRobot, draft: Draft, name: str) -> list[str]:
    lines = [f"  {robot.name}:", f"    urdf: {yaml_name(_robot_file(name, robot))}"]
    if robot.is_fixed:
        lines.append("    base: fixed")
    lines.append(f"    pose: {robot.pose}")
    task = robot.task
    if task is None and robot is draft.agent:
        task = draft.task
    if task is None:
        return lines
    if robot.sensors:
        lines.append("    sensors:")
        lines += [f"      {key}: {value}" for key, value in robot.sensors.items()]
    if robot.unused_sensors:
        lines.append("    # Sensors that the messages of the project do not use:")
        lines += [f"    #   {key}: {value}" for key, value in robot.unused_sensors.items()]
    if robot.left_out:
        lines.append(f"    # deepbots has no such sensor: {', '.join(map(_one_line, robot.left_out))}")
    lines.append("    actuators:")
    lines += [f"      {key}: {value}" for key, value in task.actuators.items()]
    lines += _emit(task)
    lines += _comments(task.agent, "    ") if robot is not draft.agent else []
    lines.append("    apply:")
    lines += [f"      {key}: {value}" for key, value in task.apply.items()]
    return lines


def _emit(task: Task) -> list[str]:
    emit = task.emit
    entries = [item for item in emit if isinstance(item, Entry)]
    lines = _comments(emit, "    ")
    if entries and all(entry.key == entry.value for entry in entries):
        return [*lines, f"    emit: [{', '.join(entry.key for entry in entries)}]"]
    if entries:
        return [*lines, "    emit:", *(f"      {entry.key}: {entry.value}" for entry in entries)]
    return lines


def _section(key: str, items: Sequence[Item]) -> list[str]:
    return ["", f"{key}:", *_items(items, "  ")] if items or key in _PLACEHOLDERS else []


def _items(items: Sequence[Item], indent: str) -> list[str]:
    lines = []
    for item in items:
        if isinstance(item, Entry):
            note = f"    # {item.note}" if item.note else ""
            if item.value.startswith("{choices: ") and len(item.value) > _LONGEST // 2:
                lines += _choices(item, indent)
                continue
            lines.append(aligned(f"{indent}{item.key}: {item.value}{note}"))
        else:
            lines += _comments([item], indent)
    return lines


def _choices(entry: Entry, indent: str) -> list[str]:
    """Return an action of several options with a line for each."""
    options = entry.value.removeprefix("{choices: {").removesuffix("}}")
    lines = re.sub(r"(?:^|, )(?=action_\d+: )", f"\n{indent}    ", options).splitlines()
    return [f"{indent}{entry.key}:", f"{indent}  choices:", *lines[1:]]


def _comments(items: Sequence[Item], indent: str) -> list[str]:
    lines = []
    for item in items:
        if not isinstance(item, Entry):
            about = f"{item.about}, " if item.about else ""
            where = f"from {item.location}" if item.location.line else f"of {item.location.python}"
            lines.append(f"{indent}{FILL_IN}: {about}{_one_line(where)}")
            lines += [f"{indent}#     {_visible(line)}" for line in item.python]
            lines += [f"{indent}#   Write {_visible(hint)}" for hint in item.hints]
    return lines


def _visible(line: str) -> str:
    """Return a line of Python without characters that YAML refuses."""
    return "".join(letter if letter.isprintable() else "?" for letter in line)[:_LONGEST]


def _endings(draft: Draft) -> list[str]:
    lines = []
    for key, items in (("success", draft.task.success), ("failure", draft.task.failure)):
        if items:
            lines += [f"  {key}:", *_items(items, "    ")]
    return ["", "termination:", *lines] if lines else []


def _solved(draft: Draft) -> list[str]:
    lines = [""]
    for item in draft.task.solved:
        lines += [f"solved: {item.value}"] if isinstance(item, Entry) else _comments([item], "")
    return lines if len(lines) > 1 else []


def _one_line(text: str) -> str:
    return " ".join(json.dumps(text, ensure_ascii=False)[1:-1].replace('\\"', '"').split())


# Sections without an entry

_PLACEHOLDERS = {
    "action": "command: -1 .. 1",
    "observation": "previous_action: auto",
    "reward": "each_step: 0",
    "truncation": "max_steps: 1000",
}
"""Entries that make a scenario valid until a person writes this section."""


def _filled(lines: list[str]) -> list[str]:
    """Return the lines with a placeholder in each required section without an entry, and without others that
    have none."""
    result: list[str] = []
    for position, line in enumerate(lines):
        key = line.strip().removesuffix(":")
        if not line.strip().endswith(":") or line.strip().startswith("#") or _has_entry(lines, position):
            result.append(line)
        elif line == f"{key}:" and key in _PLACEHOLDERS:
            result += [line, f"  {_PLACEHOLDERS[key]}    # a placeholder"]
        else:
            result.append(f"{line[: _indentation(line)]}# {line.strip()}")
    return result


def _has_entry(lines: Sequence[str], position: int) -> bool:
    """Return whether an entry, which is neither a comment nor a section, follows with more indentation."""
    for line in lines[position + 1 :]:
        if not line.strip() or line.strip().startswith("#"):
            continue
        if _indentation(line) <= _indentation(lines[position]):
            return False
        if not line.strip().endswith(":"):
            return True
    return False


def _indentation(line: str) -> int:
    return len(line) - len(line.lstrip())
