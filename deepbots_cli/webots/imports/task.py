"""Actions and messages of a project, read from the class of its robot."""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import TYPE_CHECKING

from deepbots_cli.webots.imports.calls import Calls
from deepbots_cli.webots.imports.code import last_name
from deepbots_cli.webots.imports.reader import Frame, Reader
from deepbots_cli.webots.imports.values import (
    CodeLocation,
    Condition,
    Part,
    Quantity,
    Space,
    Unknown,
    Value,
    is_number,
    number_text,
)
from deepbots_cli.webots.imports.world import Names, scenario_name
from deepbots_cli.webots.nodes import number, text

if TYPE_CHECKING:
    from deepbots_cli.webots.imports.code import ClassCode, Code, ModuleCode
    from deepbots_cli.webots.imports.world import RobotParts
    from deepbots_cli.webots.scene import Device

MAX_ACTIONS = 64
_SHOWN_LINES = 30
_WORD = re.compile(r"(?<![\w.])[A-Za-z_]\w*")
_UNITS = {"velocity": "rad/s", "position": "rad", "torque": "N*m"}
_LINEAR_UNITS = {"velocity": "m/s", "position": "m", "torque": "N"}
_MOTORS = {"velocity": "velocity_motor", "position": "position_motor", "torque": "torque_motor"}


@dataclass(frozen=True)
class Entry:
    """An entry of a section: key, YAML text, and a remark."""

    key: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Todo:
    """Python that is left to a person, at a location; `about` names the entry that is missing."""

    location: CodeLocation
    about: str = ""
    python: tuple[str, ...] = ()
    """The lines of a method that is left whole."""
    hints: tuple[str, ...] = ()
    """What the language has for its Python, such as `time for self.getTime()`."""


Item = Entry | Todo


@dataclass
class Task:
    """Sections of a scenario, in the order of the Python."""

    format: str = "csv"
    timing: str = ""
    sensors: dict[str, str] = field(default_factory=dict)
    emit: list[Item] = field(default_factory=list)
    actuators: dict[str, str] = field(default_factory=dict)
    apply: dict[str, str] = field(default_factory=dict)
    action: list[Item] = field(default_factory=list)
    augment: list[Item] = field(default_factory=list)
    observation: list[Item] = field(default_factory=list)
    reward: list[Item] = field(default_factory=list)
    success: list[Item] = field(default_factory=list)
    failure: list[Item] = field(default_factory=list)
    truncation: list[Item] = field(default_factory=list)
    agent: list[Item] = field(default_factory=list)
    solved: list[Item] = field(default_factory=list)


@dataclass
class Controller:
    """The class of a controller, with the code around it and the functions of Webots that it calls."""

    code: Code
    cls: ClassCode
    calls: Calls

    def reader(self) -> Reader:
        """Return a reader after `__init__`."""
        reader = Reader(self.code, self.cls, self.calls)
        reader.call("__init__", self._arguments(reader))
        _forget_changes(reader, self.code)
        return reader

    def _arguments(self, reader: Reader) -> list[Value]:
        """Return the arguments of the first call that creates the object."""
        for module in self.code.modules.values():
            for node in ast.walk(module.tree):
                if isinstance(node, ast.Call) and last_name(node.func) == self.cls.name and node.args:
                    frame = Frame(module, {})
                    return [reader.evaluate(frame, argument) for argument in node.args]
        return []


# Attributes that change


def _forget_changes(reader: Reader, code: Code) -> None:
    """Set attributes that change after `__init__` to unknown, except counters of steps and of the return."""
    changes: dict[str, list[tuple[ModuleCode, ast.stmt]]] = {}
    for module in code.modules.values():
        for function in ast.walk(module.tree):
            if isinstance(function, ast.FunctionDef) and id(function) in reader.followed:
                continue
            for statement in getattr(function, "body", ()) if isinstance(function, ast.FunctionDef) else ():
                _collect_changes(statement, module, changes)
        for statement in module.tree.body:
            if not isinstance(statement, ast.FunctionDef | ast.ClassDef):
                _collect_changes(statement, module, changes)
    for name, statements in changes.items():
        if name in reader.attributes:
            reader.attributes[name] = _changed(reader.attributes[name], statements)


def _collect_changes(
    statement: ast.stmt, module: ModuleCode, changes: dict[str, list[tuple[ModuleCode, ast.stmt]]]
) -> None:
    for node in ast.walk(statement):
        if isinstance(node, ast.AugAssign | ast.AnnAssign):
            targets: list[ast.expr] = [node.target]
        elif isinstance(node, ast.Assign):
            targets = list(node.targets)
        else:
            continue
        for target in targets:
            for element in target.elts if isinstance(target, ast.Tuple | ast.List) else [target]:
                if isinstance(element, ast.Attribute):
                    changes.setdefault(element.attr, []).append((module, node))


def _changed(before: Value, statements: list[tuple[ModuleCode, ast.stmt]]) -> Value:
    others = [(module, node) for module, node in statements if not _sets_again(node, before)]
    if not others:
        return before
    if all(isinstance(node, ast.AugAssign) and _adds_one(node) for _, node in others):
        return Quantity("step")
    if all(isinstance(node, ast.AugAssign) and _adds_reward(node) for _, node in others):
        return Quantity("episode_return")
    module, node = others[0]
    unknown = Unknown(module.location(node))
    return [unknown] * len(before) if isinstance(before, list) else unknown


def _sets_again(node: ast.stmt, before: Value) -> bool:
    return (
        isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant) and node.value.value == before
    )


def _adds_one(node: ast.AugAssign) -> bool:
    return isinstance(node.op, ast.Add) and isinstance(node.value, ast.Constant) and node.value.value == 1


def _adds_reward(node: ast.AugAssign) -> bool:
    return isinstance(node.op, ast.Add) and isinstance(node.value, ast.Name) and node.value.id == "reward"


# Messages


def read_messages(task: Task, robot: Controller, name: str, names: dict[str, str]) -> list[Value]:
    """Read `create_message` into `emit`; returns the values as the supervisor sees them.

    `names` are names of sensors by device.
    """
    result = robot.reader().call("create_message", [])
    if result is None:
        return []
    returned, value = result
    if not isinstance(value, list):
        locations = [value.location] if isinstance(value, Unknown) else [part.location for part in returned]
        task.emit += [Todo(location, "the values of the message") for location in locations[-1:]]
        return []
    received: list[Value] = []
    for position, item in enumerate(value):
        if isinstance(item, Quantity) and item.sensor is not None:
            device, component = item.sensor
            sensor = names[device]
            received.append(
                Quantity(
                    f"{name}.{sensor}{f'.{component}' if component else ''}", item.unit, sensor=item.sensor
                )
            )
            if Entry(sensor, sensor) not in task.emit:
                task.emit.append(Entry(sensor, sensor))
        elif isinstance(item, Quantity):
            key = f"value_{position}"
            task.emit.append(Entry(key, item.text))
            received.append(Quantity(f"{name}.{key}", item.unit))
        elif isinstance(item, Unknown):
            task.emit.append(Todo(item.location, f"value {position} of the message"))
            received.append(item)
        elif isinstance(item, Condition):
            received.append(Condition((Part(f"{name}.{item.text}", item.parts[0].location),)))
            task.emit.append(Entry(item.text, item.text))
        else:
            received.append(item)
    return received


# Further robots


def read_other(
    task: Task, robot: Controller, space: Value, parts: RobotParts, labels: dict[str, str]
) -> Task:
    """Return the sensors, messages and actuators of a further robot, which gets the action of `task`.

    `labels` are names of sensors by device. Commands that use the action in another way are left to a person.
    """
    entries = robot.calls.sensors
    robot_task = Task(sensors={labels[device]: entry.text for device, entry in entries.items()})
    read_messages(robot_task, robot, parts.name, labels)
    names = Names()
    read_action(robot_task, robot, "use_message_data", space, parts, names)
    actions = [entry for entry in task.action if isinstance(entry, Entry)]
    read = [entry for entry in robot_task.action if isinstance(entry, Entry)]
    if [entry.value for entry in actions] == [entry.value for entry in read]:
        keys = {entry.key: action.key for entry, action in zip(read, actions, strict=True)}
        robot_task.apply = {name: _renamed(value, keys) for name, value in robot_task.apply.items()}
        return robot_task
    if "use_message_data" in robot.cls.methods:
        robot_task.agent.append(
            whole(robot.cls, "use_message_data", f"what {parts.name} does with the action")
        )
    robot_task.actuators, robot_task.apply = {}, {}
    return robot_task


def _renamed(text: str, names: dict[str, str]) -> str:
    return _WORD.sub(lambda match: names.get(match[0], match[0]), text)


# Actions


@dataclass(frozen=True)
class _Motors:
    """Motors that always get the same command."""

    kind: str
    devices: tuple[str, ...]
    is_linear: bool

    @property
    def unit(self) -> str:
        return (_LINEAR_UNITS if self.is_linear else _UNITS)[self.kind]


def read_action(
    task: Task, controller: Controller, method: str, space: Value, parts: RobotParts, names: Names
) -> None:
    """Read `use_message_data` or `apply_action` into `action`, `actuators` and `apply`."""
    motors = [device for device in controller.calls.robot.devices.values() if device.type.endswith("Motor")]
    count = space.choices if isinstance(space, Space) else space
    read = _read_ranges(task, controller, method, space, parts, names) or _read_choices(
        task, controller, method, count, parts, names
    )
    if read:
        return
    if method in controller.cls.methods:
        task.action.append(whole(controller.cls, method, "the actions"))
    add_placeholder(task, motors, parts, names)


def whole(cls: ClassCode, method: str, about: str) -> Todo:
    """Return a method as a `Todo`, with its lines."""
    module, function = cls.methods[method]
    body = [
        statement
        for statement in function.body
        if not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant))
    ]
    lines = [line for statement in body for line in ast.unparse(statement).splitlines()]
    if len(lines) > _SHOWN_LINES:
        lines = [*lines[:_SHOWN_LINES], "..."]
    return Todo(CodeLocation(module.file, function.lineno, f"def {method}"), about, tuple(lines))


def _outputs(controller: Controller, method: str, argument: Value) -> dict[tuple[str, str], Value] | None:
    """Return the values that an action sets; None if the project has no such method."""
    reader = controller.reader()
    reader.outputs.clear()
    if reader.call(method, [argument]) is None:
        return None
    devices = {device for device, _ in reader.outputs}
    result = {}
    for device in devices:
        for kind in ("torque", "position", "velocity"):
            if (device, kind) in reader.outputs:
                result[device, kind] = reader.outputs[device, kind]
                break
    order = list(controller.calls.robot.devices)
    return {key: result[key] for key in sorted(result, key=lambda key: order.index(key[0]))}


def _groups(
    columns: Sequence[dict[tuple[str, str], Value]], controller: Controller
) -> list[tuple[_Motors, list[Value]]]:
    """Return motors with equal commands in all columns, and these commands."""
    groups: list[tuple[_Motors, list[Value]]] = []
    for device, kind in columns[0]:
        values = [column.get((device, kind)) for column in columns]
        is_linear = controller.calls.robot.devices[device].type == "LinearMotor"
        for position, (motors, others) in enumerate(groups):
            if motors.kind == kind and motors.is_linear == is_linear and others == values:
                groups[position] = (_Motors(kind, (*motors.devices, device), is_linear), others)
                break
        else:
            groups.append((_Motors(kind, (device,), is_linear), values))
    return groups


def _read_ranges(
    task: Task, controller: Controller, method: str, space: Value, parts: RobotParts, names: Names
) -> bool:
    """Read actions that are numbers of a range."""
    for count in (MAX_ACTIONS, 0):
        words = [Quantity(f"action_{index}") for index in range(count)]
        outputs = _outputs(controller, method, words if count else Quantity("action_0"))
        if not outputs:
            return False
        if all(isinstance(value, Quantity) and value.unit == "" for value in outputs.values()):
            break
    else:
        return False
    groups = _groups([outputs], controller)
    texts = [value.text for _, (value,) in groups]
    used = sorted({int(index) for text in texts for index in re.findall(r"\baction_(\d+)\b", text)})
    if not used:
        return False
    variables = {
        f"action_{index}": names.new("action" if used == [0] else f"action_{index}") for index in used
    }
    for index in used:
        low, high = -1.0, 1.0
        if isinstance(space, Space) and index < len(space.low):
            low, high = space.low[index], space.high[index]
        is_plain = isfinite(low) and isfinite(high) and low < high
        ends = f"{number_text(low)} .. {number_text(high)}" if is_plain else "-1 .. 1"
        note = "" if isinstance(space, Space) and is_plain else "the project does not state its range"
        task.action.append(Entry(variables[f"action_{index}"], ends, note))
    for motors, (value,) in groups:
        command = re.sub(r"\baction_\d+\b", lambda match: variables[match.group()], value.operand)
        _actuator(task, motors, f"{command} * 1 {motors.unit}", parts, names)
    return True


def _read_choices(
    task: Task, controller: Controller, method: str, count: Value, parts: RobotParts, names: Names
) -> bool:
    """Read a choice of actions: each of its numbers is tried."""
    if not isinstance(count, int) or not 1 < count <= MAX_ACTIONS:
        return False
    columns = None
    for argument in (lambda index: [index], lambda index: index, lambda index: [str(index)]):
        tried = [_outputs(controller, method, argument(index)) for index in range(count)]
        good = [
            column
            for column in tried
            if column and all(is_number(value) and isfinite(value) for value in column.values())
        ]
        if len(good) == count and all(column.keys() == good[0].keys() for column in good):
            columns = good
            break
    if columns is None:
        return False
    groups = _groups(columns, controller)
    variables = []
    for motors, _ in groups:
        label = _label(motors.devices)
        variables.append(names.new("command" if len(groups) == 1 else f"{label}_command"))
    options = []
    for index in range(count):
        values = [number_text(column[index]) for _, column in groups]
        pairs = ", ".join(f"{name}: {value}" for name, value in zip(variables, values, strict=True))
        options.append(f"action_{index}: {values[0] if len(groups) == 1 else f'{{{pairs}}}'}")
    key = variables[0] if len(groups) == 1 else names.new("command")
    task.action.append(Entry(key, f"{{choices: {{{', '.join(options)}}}}}"))
    for (motors, _), variable in zip(groups, variables, strict=True):
        _actuator(task, motors, f"{variable} * 1 {motors.unit}", parts, names)
    return True


def _label(devices: Sequence[str]) -> str:
    """Return a name for several devices: `wheel1` and `wheel2` are `wheels`."""
    if len(devices) == 1:
        return scenario_name(devices[0], "motor")
    first, last = min(devices), max(devices)
    prefix_length = next((at for at in range(len(first)) if first[at] != last[at : at + 1]), len(first))
    stem = scenario_name(first[:prefix_length].rstrip("0123456789 _-"), "motor")
    return stem if stem.endswith("s") else f"{stem}s"


def _actuator(task: Task, motors: _Motors, command: str, parts: RobotParts, names: Names) -> None:
    label = names.new(_label(motors.devices), "motor")
    joints = [task_joint for device in motors.devices if (task_joint := _joint(device, parts)) is not None]
    where = f"joint: {joints[0]}" if len(joints) == 1 else f"joints: [{', '.join(joints)}]"
    task.actuators[label] = f"{{type: {_MOTORS[motors.kind]}, {where}}}"
    task.apply[label] = command


def _joint(device: str, parts: RobotParts) -> str | None:
    for body in parts.bodies:
        for joint in body.joints:
            if joint.motor is not None and text(joint.motor, "name") == device:
                return parts.joints[id(joint)]
    return None


def add_placeholder(task: Task, motors: list[Device], parts: RobotParts, names: Names) -> None:
    """Add one range for all motors, so that the scenario is valid until a person writes the actions."""
    for is_linear in (False, True):
        matching = [motor for motor in motors if (motor.type == "LinearMotor") is is_linear]
        matching = [motor for motor in matching if _joint(motor.name, parts) is not None]
        if not matching:
            continue
        speed = min(number(motor.node, "maxVelocity") for motor in matching) or 1.0
        group = _Motors("velocity", tuple(motor.name for motor in matching), is_linear)
        variable = names.new("action")
        task.action.append(Entry(variable, "-1 .. 1", "a placeholder for all motors"))
        _actuator(task, group, f"{variable} * {number_text(speed, group.unit)}", parts, names)
