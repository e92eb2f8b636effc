"""A scenario from a project of Webots: the YAML text, with the project's Python at each place that is left to
a person."""

from __future__ import annotations

import ast
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from deepbots_cli import api
from deepbots_cli.cli.command import Starter
from deepbots_cli.cli.starters.draft import yaml_name
from deepbots_cli.diagnostics.findings import FILL_IN
from deepbots_cli.errors import UsageError
from deepbots_cli.robots.model import to_urdf
from deepbots_webots.imports.draft import Controller, Draft, DraftRobot, Quote, read_project, stated_number
from deepbots_webots.imports.world import Names, plain, pose_text

_UNITS = {"revolute": "rad", "continuous": "rad", "prismatic": "m"}
_LONGEST = 140  # characters of a line of Python
_STEPS = ("step", "handle_emitter", "handle_receiver", "run")
"""Methods of deepbots that a project may write anew."""
_HEAD = """\
# From {world} of Webots. {todos} left to you: search for FILL IN.
# Scene, robots and devices are those of the project. Webots and deepbots differ in their physics: see
# "Your project as a scenario" in docs/webots.md."""


def from_webots(world: Path, library: Sequence[Path], name: str, title: str) -> Starter:
    """Return the scenario `NAME.yaml` for a world, with a robot file per robot. No code of the project runs.

    Raises:
        WorldError: The world has errors.
        UsageError: A file cannot be read, no robot has a motor, or no valid scenario came out.
    """
    draft = read_project(world, library)
    lines = _lines(draft, name, title)
    todos = sum(line.strip().startswith(FILL_IN) for line in lines)
    count_text = "One place is" if todos == 1 else f"{todos} places are"
    head = _HEAD.format(world=_one_line(draft.world_file), todos=count_text)
    files = {f"{name}.yaml": "".join(f"{line.rstrip()}\n" for line in (head, *lines)).encode()}
    files |= {_robot_file(name, robot): to_urdf(robot.built.model).encode() for robot in draft.robots}
    files |= {path: content for robot in draft.robots for path, content in robot.built.meshes.items()}
    files |= draft.surroundings.pictures
    _check(files, name)
    paths = {PurePosixPath(path): content for path, content in files.items()}
    return Starter(paths, todos, list(map(str, draft.findings.warnings)))


def _check(files: dict[str, bytes], name: str) -> None:
    """Check that the scenario is valid.

    Raises:
        UsageError: It has an error.
    """
    with tempfile.TemporaryDirectory() as folder:
        for path, content in files.items():
            Path(folder, path).write_bytes(content)
        for finding in api.lint(Path(folder, f"{name}.yaml")):
            if finding.severity == "error":
                raise UsageError(f"no valid scenario came out: {finding.headline}")


def _robot_file(name: str, robot: DraftRobot) -> str:
    return f"{name}_{robot.name}.urdf"


def _lines(draft: Draft, name: str, title: str) -> list[str]:
    around, judge = draft.surroundings, draft.judge
    lines = ["deepbots: 1", f"name: {title}", "", "world:"]
    lines += [f"  {key}: {value}" for key, value in around.world]
    lines += [
        f"  {FILL_IN}: from {_one_line(place)}: {_one_line(sentence)}" for place, sentence in around.left_out
    ]
    if around.objects:
        lines += ["", "objects:", *(f"  {key}: {value}" for key, value in around.objects.items())]
    lines += ["", "robots:"]
    for robot in draft.robots:
        lines += _robot(robot, draft, name)
    lines += ["", f"messages: {{{'format: csv, timing: delayed' if draft.has_messages else 'format: none'}}}"]
    if names := draft.names():
        lines += ["", "# Names in the Python of the project, and here:"]
        lines += [f"#   {_visible(entry)}" for entry in names]
    for method in _STEPS:
        if judge is not None and method in judge.methods:
            lines += ["", *_quoted(judge.quote(method, f"what the project's own {method} does"), "")]
    lines += ["", "action:", f"  {FILL_IN}: the action, which robots get under `apply`", "  action: -1 .. 1"]
    lines += _observation(judge)
    lines += _reward(judge)
    if (ending := _quote(judge, "is_done", "the endings", constant=False)) is not None:
        lines += ["", "# termination:", *_quoted(ending, "  ")]
    limit = Quote("the time limit of an episode, which the loop of the project's training may have")
    lines += ["", "truncation:", *_quoted(limit, "  "), "  max_steps: 1000"]
    lines += _reset(draft)
    if (solved := _quote(judge, "solved", "when the task is solved", constant=False)) is not None:
        lines += ["", *_quoted(solved, "")]
    return lines


def _quote(
    judge: Controller | None, method: str, about: str, *, constant: bool | None = None
) -> Quote | None:
    """Return a method that is left to a person; None without one, or if it only returns the constant."""
    if judge is None or method not in judge.methods:
        return None
    returned = judge.returned(method)
    is_constant = isinstance(returned, ast.Constant) and returned.value is constant
    return None if is_constant else judge.quote(method, about)


def _robot(robot: DraftRobot, draft: Draft, name: str) -> list[str]:
    lines = [f"  {robot.name}:", f"    urdf: {yaml_name(_robot_file(name, robot))}"]
    if not robot.parts.root.is_free:
        lines.append("    base: fixed")
    lines.append(f"    pose: {pose_text(robot.parts.root.frame)}")
    if robot is not draft.agent and robot.controller is None:
        return lines
    if robot.sensors:
        lines += ["    sensors:", *(f"      {key}: {value}" for key, value in robot.sensors.items())]
    if robot.unused:
        lines.append("    # Sensors that the project does not name:")
        lines += [f"    #   {key}: {value}" for key, value in robot.unused.items()]
    if robot.left_out:
        lines.append(f"    # deepbots has no such sensor: {', '.join(map(_one_line, robot.left_out))}")
    lines.append("    actuators:")
    lines += [
        f"      {key}: {{type: velocity_motor, joint: {joint}}}" for key, (joint, _) in robot.motors.items()
    ]
    message = _quote(robot.controller, "create_message", "the message: `emit` with names of sensors")
    lines += _quoted(message, "    ")
    lines.append("    apply:")
    method = "use_message_data" if draft.has_messages else "apply_action"
    command = _quote(robot.controller, method, "what motors do")
    lines += _quoted(command or Quote("what motors do"), "      ")
    lines += [f"      {key}: action * {speed}" for key, (_, speed) in robot.motors.items()]
    return lines


def _observation(judge: Controller | None) -> list[str]:
    """Return the values that the project maps from a constant range, or a placeholder."""
    quote = _quoted(_quote(judge, "get_observations", "the observation") or Quote("the observation"), "  ")
    names = Names()
    augment, observation = [], []
    for position, value in enumerate(judge.normalized() if judge is not None else ()):
        key = names.new(value.name or f"value_{position}", "value")
        augment += [*_quoted(Quote(key, value.location), "  "), f"  {key}: 0"]
        ends = f"{plain(value.low)} .. {plain(value.high)}"
        observation.append(f"  {key}: {ends if value.clips else f'{{range: {ends}, clip: false}}'}")
    if augment:
        return ["", "augment:", *quote, *augment, "", "observation:", *observation]
    return ["", "observation:", *quote, "  previous_action: auto"]


def _reward(judge: Controller | None) -> list[str]:
    quote = _quote(judge, "get_reward", "the reward") or Quote("the reward")
    value = stated_number(judge.returned("get_reward")) if judge is not None and quote.location else None
    if value is not None:
        return ["", "reward:", f"  {'alive' if value > 0 else 'each_step'}: {plain(value)}"]
    return ["", "reward:", *_quoted(quote, "  "), "  each_step: 0"]


def _reset(draft: Draft) -> list[str]:
    quote = _quoted(_quote(draft.judge, "reset", "the reset"), "  ")
    starts = [
        f"{robot.name}.{joint}: {plain(value)} {_UNITS[robot.built.model.joint(joint).type]}"
        for robot in draft.robots
        for joint, value in robot.built.starts.items()
    ]
    if starts:
        return ["", "reset:", *quote, f"  joints: {{{', '.join(starts)}}}"]
    return ["", "# reset:", *quote] if quote else []


def _quoted(quote: Quote | None, indent: str) -> list[str]:
    """Return the comment of a place that is left to a person."""
    if quote is None:
        return []
    place = f", from {_one_line(quote.location)}" if quote.location else ""
    return [
        f"{indent}{FILL_IN}: {quote.about}{place}",
        *(f"{indent}#     {_visible(line)}" for line in quote.lines),
    ]


def _visible(line: str) -> str:
    """Return a line of Python without characters that YAML refuses."""
    return "".join(letter if letter.isprintable() else "?" for letter in line)[:_LONGEST]


def _one_line(text: str) -> str:
    return " ".join(json.dumps(text, ensure_ascii=False)[1:-1].replace('\\"', '"').split())
