"""Actions, messages, observations, rewards and endings of a project, read from its classes."""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import TYPE_CHECKING

from deepbots_cli.webots.imports.calls import Calls
from deepbots_cli.webots.imports.code import last_name
from deepbots_cli.webots.imports.names import Names, scenario_name
from deepbots_cli.webots.imports.reader import Frame, Reader, negated
from deepbots_cli.webots.imports.values import (
    Condition,
    Normalized,
    Otherwise,
    Part,
    Place,
    Quantity,
    Space,
    Unknown,
    Value,
    is_number,
    number_text,
)
from deepbots_cli.webots.nodes import number, text

if TYPE_CHECKING:
    from deepbots_cli.webots.imports.code import ClassCode, Code, ModuleCode
    from deepbots_cli.webots.imports.robots import RobotParts
    from deepbots_cli.webots.scene import Device

MAX_ACTIONS = 64
_SHOWN_LINES = 30
_AXES = ("x", "y", "z")
_UNITS = {"velocity": "rad/s", "position": "rad", "torque": "N*m"}
_LINEAR_UNITS = {"velocity": "m/s", "position": "m", "torque": "N"}
_MOTORS = {"velocity": "velocity_motor", "position": "position_motor", "torque": "torque_motor"}
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*")
_NO_NAMES = frozenset(
    ["self", "np", "numpy", "math", "abs", "round", "float", "int", "not", "and", "or", "len"]
)
_TIME = re.compile(r"time (>=?) (\S+) s")
_STEP = re.compile(r"step (>=?) (\d+)")
_SUCCESS = re.compile(r"solved|success|reached|goal|escaped", re.IGNORECASE)
_RETURN = re.compile(r"episode_return >=? \S+")


@dataclass(frozen=True)
class Entry:
    """An entry of a section: key, YAML text, and a remark."""

    key: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Todo:
    """A place that is left to a person; `about` says what is missing there."""

    place: Place
    about: str = ""
    python: tuple[str, ...] = ()
    """The lines of a method that is left whole."""


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
        """Return what the code creates the object with, where it first does."""
        for module in self.code.modules.values():
            for node in ast.walk(module.tree):
                if isinstance(node, ast.Call) and last_name(node.func) == self.cls.name and node.args:
                    frame = Frame(module, {})
                    return [reader.evaluate(frame, argument) for argument in node.args]
        return []


# Attributes that change


def _forget_changes(reader: Reader, code: Code) -> None:
    """Let attributes be unknown that change after `__init__`, but for counters of steps and of the return."""
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
            for one in target.elts if isinstance(target, ast.Tuple | ast.List) else [target]:
                if isinstance(one, ast.Attribute):
                    changes.setdefault(one.attr, []).append((module, node))


def _changed(before: Value, statements: list[tuple[ModuleCode, ast.stmt]]) -> Value:
    others = [(module, node) for module, node in statements if not _sets_again(node, before)]
    if not others:
        return before
    if all(isinstance(node, ast.AugAssign) and _adds_one(node) for _, node in others):
        return Quantity("step")
    if all(isinstance(node, ast.AugAssign) and _adds_reward(node) for _, node in others):
        return Quantity("episode_return")
    module, node = others[0]
    unknown = Unknown(module.place(node))
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
        place = value.place if isinstance(value, Unknown) else returned[-1].place
        task.emit.append(Todo(place, "the values of the message"))
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
            task.emit.append(Todo(item.place, f"value {position} of the message"))
            received.append(item)
        elif isinstance(item, Condition):
            received.append(Condition((Part(f"{name}.{item.text}", item.parts[0].place),)))
            task.emit.append(Entry(item.text, item.text))
        else:
            received.append(item)
    return received


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
    motors = [one for one in controller.calls.robot.devices.values() if one.type.endswith("Motor")]
    count = space.choices if isinstance(space, Space) else space
    read = _read_ranges(task, controller, method, space, parts, names) or _read_choices(
        task, controller, method, count, parts, names
    )
    if read:
        return
    if method in controller.cls.methods:
        task.action.append(_whole(controller.cls, method, "the actions"))
    add_placeholder(task, motors, parts, names)


def _whole(cls: ClassCode, method: str, about: str) -> Todo:
    """Return a method as a place that is left to a person, with its lines."""
    module, function = cls.methods[method]
    body = [
        one
        for one in function.body
        if not (isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant))
    ]
    lines = [line for statement in body for line in ast.unparse(statement).splitlines()]
    if len(lines) > _SHOWN_LINES:
        lines = [*lines[:_SHOWN_LINES], "..."]
    return Todo(Place(module.file, function.lineno, f"def {method}"), about, tuple(lines))


def _outputs(controller: Controller, method: str, argument: Value) -> dict[tuple[str, str], Value] | None:
    """Return what an action sets; None if the project has no such method."""
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
    same = next((at for at in range(len(first)) if first[at] != last[at : at + 1]), len(first))
    stem = scenario_name(first[:same].rstrip("0123456789 _-"), "motor")
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
        some = [one for one in motors if (one.type == "LinearMotor") is is_linear]
        some = [one for one in some if _joint(one.name, parts) is not None]
        if not some:
            continue
        speed = min(number(one.node, "maxVelocity") for one in some) or 1.0
        group = _Motors("velocity", tuple(one.name for one in some), is_linear)
        variable = names.new("action")
        task.action.append(Entry(variable, "-1 .. 1", "a placeholder for all motors"))
        _actuator(task, group, f"{variable} * {number_text(speed, group.unit)}", parts, names)


# Observations


def read_observation(task: Task, reader: Reader, space: Value, names: Names) -> None:
    """Read `get_observations` into `observation` and `augment`."""
    result = reader.call("get_observations", [])
    if result is None:
        return
    returned, value = result
    if not isinstance(value, list):
        places = [one.place for one in returned]
        if isinstance(value, Unknown):
            places.append(value.place)
        if places:
            task.observation.append(Todo(places[-1], "the observation"))
        return
    labels = _labels(reader)
    keys: set[str] = set()
    for position, item in enumerate(value):
        label = labels[position] if len(labels) == len(value) else ""
        _observe(task, item, label, position, space, names, keys)
    task.observation = _joined_vectors(task.observation)


def _labels(reader: Reader) -> list[str]:
    """Return the names in the list that `get_observations` returns last, "" for anything else."""
    _, function = reader.cls.methods["get_observations"]
    for node in reversed(list(ast.walk(function))):
        value = node.value if isinstance(node, ast.Return) else None
        if isinstance(value, ast.Call) and value.args:
            value = value.args[0]
        if isinstance(value, ast.List | ast.Tuple):
            return [one.id if isinstance(one, ast.Name) else "" for one in value.elts]
    return []


def _observe(
    task: Task, item: Value, label: str, position: int, space: Value, names: Names, keys: set[str]
) -> None:
    note, extra = "", ""
    match item:
        case Normalized(value=value, low=low, high=high):
            ends = (low, high)
            if (item.new_low, item.new_high) != (-1, 1):
                note = f"the project maps it to {number_text(item.new_low)} .. {number_text(item.new_high)}"
            extra = "" if item.clips else ", clip: false"
        case Quantity() if isinstance(space, Space) and position < len(space.low):
            value, ends = item, (space.low[position], space.high[position])
            note = "the project does not scale it"
            if not all(map(isfinite, ends)) or ends[0] >= ends[1]:
                task.observation.append(Todo(_text_place(item), "its range"))
                return
        case Quantity():
            task.observation.append(Todo(_text_place(item), "its range"))
            return
        case Unknown(place):
            task.observation.append(Todo(place, f"value {position} of the observation"))
            return
        case _:
            about = f"value {position} of the observation, which does not change"
            task.observation.append(Todo(Place("get_observations", 0, f"`{str(item)[:20]}`"), about))
            return
    ends_text = f"{number_text(ends[0])} .. {number_text(ends[1], value.unit)}"
    key = value.text
    if value.sensor is None and not _is_reading(value):
        key = names.new(label or _argument_name(item) or value.text, "value")
        task.augment.append(Entry(key, value.text, value.note))
    if key in keys:
        return
    keys.add(key)
    task.observation.append(Entry(key, f"{{range: {ends_text}{extra}}}" if extra else ends_text, note))


def _argument_name(item: Value) -> str:
    """Return the name of the variable that the project normalizes, or ""."""
    match = re.search(r"\((\w+),", item.place.python) if isinstance(item, Normalized) else None
    return match.group(1) if match and not match.group(1).isdigit() else ""


def _text_place(value: Quantity) -> Place:
    return Place("observation", 0, value.text)


def _is_reading(value: Quantity) -> bool:
    return re.fullmatch(r"[a-z_]\w*\.[a-z_]\w*(\.[a-z_]\w*)?", value.text) is not None


def _joined_vectors(items: list[Item]) -> list[Item]:
    """Return entries with x, y and z of one reading in one range as one entry."""
    result: list[Item] = []
    position = 0
    while position < len(items):
        three = items[position : position + 3]
        if len(three) == 3 and all(isinstance(one, Entry) for one in three):
            stems = [one.key.rpartition(".") for one in three if isinstance(one, Entry)]
            values = {one.value for one in three if isinstance(one, Entry)}
            is_one = len({stem for stem, _, _ in stems}) == 1 and len(values) == 1
            if is_one and tuple(last for _, _, last in stems) == _AXES:
                result.append(Entry(stems[0][0], values.pop(), getattr(three[0], "note", "")))
                position += 3
                continue
        result.append(items[position])
        position += 1
    return result


# Rewards and endings


def read_reward(task: Task, reader: Reader) -> None:
    """Read `get_reward` into `reward`."""
    result = reader.call("get_reward", [Unknown(Place("get_reward", 0, "action"))])
    if result is None:
        return
    _, value = result
    if isinstance(value, bool):
        value = int(value)
    if is_number(value) and isfinite(value):
        task.reward.append(Entry("alive" if value > 0 else "each_step", number_text(value)))
    elif isinstance(value, Quantity):
        term = f"{value.operand} / {_divisor(value.unit)}" if value.unit else value.text
        task.reward.append(Entry("task", term, value.note))
    else:
        task.reward.append(_whole(reader.cls, "get_reward", "the reward"))


def _divisor(unit: str) -> str:
    return unit if re.fullmatch(r"\w+", unit) else f"({unit})"


def read_endings(task: Task, reader: Reader, names: Names) -> None:
    """Read `is_done` into `termination` and `truncation`."""
    result = reader.call("is_done", [])
    if result is None:
        return
    returned, _ = result
    barred: list[Condition | Unknown] = []
    for one in returned:
        if one.value is False or one.value is None:
            if conditions := _stated(one.path):
                barred.append(conditions[0] if len(conditions) == 1 else Unknown(one.place))
            continue
        for condition in _ending_conditions([*_opposites(barred), *one.path], one.value, one.place):
            if isinstance(condition, Unknown):
                task.failure.append(Todo(condition.place, "an ending"))
                continue
            for part in condition.parts:
                if part.text:
                    _end(task, part, names, is_success=_names_success(reader, part.place))
                else:
                    task.failure.append(Todo(part.place, "an ending"))


def _stated(path: Sequence[Condition | Unknown]) -> list[Condition | Unknown]:
    """Return the conditions of a path but those that an earlier `return` covers."""
    return [one for one in path if not isinstance(one, Otherwise)]


def _opposites(conditions: Sequence[Condition | Unknown]) -> list[Condition | Unknown]:
    """Return the opposites of conditions under which `is_done` returns False before."""
    return [negated(one, one.place if isinstance(one, Unknown) else one.parts[0].place) for one in conditions]


def _ending_conditions(
    path: Sequence[Condition | Unknown], value: Value, place: Place
) -> list[Condition | Unknown]:
    """Return the conditions under which a `return` ends the episode."""
    if isinstance(value, Unknown):
        return [value]
    conditions = _stated(path)
    if isinstance(value, Condition):
        conditions.append(value)
    elif value is not True:
        return [Unknown(place)]
    for one in conditions:
        if isinstance(one, Unknown):
            return [one]
        if one.unknown is not None and len(conditions) > 1:
            return [Unknown(one.unknown.place)]
    if len(conditions) < 2:
        return conditions
    both = " and ".join(f"({one.text})" for one in conditions if isinstance(one, Condition))
    last = conditions[-1]
    return [Condition((Part(both, last.parts[0].place if isinstance(last, Condition) else place),))]


def _names_success(reader: Reader, place: Place) -> bool:
    """Return whether the branch of an ending speaks of success, as in `self.is_solved = True`."""
    for module in reader.code.modules.values():
        for node in ast.walk(module.tree) if module.file == place.file else ():
            if isinstance(node, ast.If) and node.test.lineno == place.line:
                return _SUCCESS.search(" ".join(map(ast.unparse, node.body))) is not None
    return False


def _end(task: Task, part: Part, names: Names, *, is_success: bool) -> None:
    if match := _TIME.fullmatch(part.text):
        _limit(task, "max_time", f"{match.group(2)} s")
    elif match := _STEP.fullmatch(part.text):
        _limit(task, "max_steps", str(int(match.group(2)) + (match.group(1) == ">")))
    elif _RETURN.fullmatch(part.text):
        task.success.append(Entry(names.new("enough", "ending"), part.text, part.note))
    else:
        words = [word for word in _IDENTIFIER.findall(part.place.python) if word not in _NO_NAMES]
        key = names.new(f"{words[0] if words else 'ending'}_limit", "ending")
        (task.success if is_success else task.failure).append(Entry(key, part.text, part.note))


def _limit(task: Task, key: str, value: str) -> None:
    if not any(isinstance(one, Entry) and one.key == key for one in task.truncation):
        task.truncation.append(Entry(key, value))


def read_solved(task: Task, cls: ClassCode, reader: Reader) -> None:
    """Read `solved`: a mean of the last episodes above a number."""
    if "solved" not in cls.methods:
        return
    module, function = cls.methods["solved"]
    for node in ast.walk(function):
        if not (isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.Gt | ast.GtE)):
            continue
        episodes = next(
            (
                one.slice.lower
                for one in ast.walk(node.left)
                if isinstance(one, ast.Subscript) and isinstance(one.slice, ast.Slice) and one.slice.lower
            ),
            None,
        )
        calls = [one for one in ast.walk(node.left) if isinstance(one, ast.Call)]
        if episodes is None or not any(ast.unparse(one.func).endswith("mean") for one in calls):
            continue
        frame = Frame(module, {}, None)
        bar, count = reader.evaluate(frame, node.comparators[0]), reader.evaluate(frame, episodes)
        if is_number(bar) and isfinite(bar) and isinstance(count, int) and 1 <= -count <= 10_000:
            task.solved.append(Entry("", f"mean_return >= {number_text(bar)} over {-count} episodes"))
            return
    task.solved.append(Todo(module.place(function.body[-1]), "when the task is solved"))


def read_limits(task: Task, code: Code, reader: Reader) -> None:
    """Read the largest number of steps from a loop over a range that steps the environment."""
    for module in code.modules.values():
        for node in ast.walk(module.tree):
            if not (isinstance(node, ast.For) and isinstance(node.iter, ast.Call)):
                continue
            if not (isinstance(node.iter.func, ast.Name) and node.iter.func.id == "range"):
                continue
            if _steps_environment(node) and node.iter.args:
                bound = node.iter.args[-1] if len(node.iter.args) < 3 else node.iter.args[1]
                limit = _constant(bound, module, reader)
                if isinstance(limit, int) and 0 < limit < 1_000_000:
                    _limit(task, "max_steps", str(limit))
                    return


def _steps_environment(loop: ast.For) -> bool:
    """Return whether a loop calls `step` itself, and not in a loop inside."""
    waiting: list[ast.AST] = list(loop.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "step":
            return True
        if not isinstance(node, ast.For | ast.While):
            waiting += ast.iter_child_nodes(node)
    return False


def _constant(node: ast.expr, module: ModuleCode, reader: Reader) -> Value:
    """Return a constant, or an attribute of the supervisor of another name."""
    if isinstance(node, ast.Attribute) and node.attr in reader.attributes:
        return reader.attributes[node.attr]
    if isinstance(node, ast.Name):
        for one in ast.walk(module.tree):
            if isinstance(one, ast.Assign) and any(
                isinstance(target, ast.Name) and target.id == node.id for target in one.targets
            ):
                return one.value.value if isinstance(one.value, ast.Constant) else None
    return reader.evaluate(Frame(module, {}), node)


def read_overridden(task: Task, cls: ClassCode) -> None:
    """Name methods of deepbots that the project writes anew, whose effect is not read."""
    for name in ("step", "reset", "handle_emitter", "handle_receiver", "run"):
        if name in cls.methods:
            _, function = cls.methods[name]
            if not _only_sets(function):
                task.agent.append(_whole(cls, name, f"an own {name}"))


def _only_sets(function: ast.FunctionDef) -> bool:
    """Return whether a method sets attributes to constants, and calls the method of its base."""
    for statement in function.body:
        match statement:
            case ast.Assign(value=ast.Constant()) | ast.Expr(value=ast.Constant()):
                pass
            case ast.Return(value=ast.Call(func=ast.Attribute(value=ast.Call(func=ast.Name(id="super"))))):
                pass
            case _:
                return False
    return True
