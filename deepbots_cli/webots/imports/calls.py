"""Functions that controllers call: of Webots, deepbots, numpy and Python."""

from __future__ import annotations

import ast
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from deepbots_cli.webots.imports.values import (
    CodeLocation,
    Condition,
    External,
    Instance,
    Method,
    Normalized,
    Parent,
    Part,
    ProjectFunction,
    Quantity,
    RobotDevice,
    Space,
    Unknown,
    Value,
    WorldField,
    WorldNode,
    is_number,
    number_text,
    with_note_of,
)
from deepbots_cli.webots.nodes import numbers, parameters, real, text, walk

if TYPE_CHECKING:
    from collections.abc import Mapping

    from deepbots_cli.webots.imports.draft import SensorEntry
    from deepbots_cli.webots.imports.reader import Frame, Reader
    from deepbots_cli.webots.scene import Robot, Scene
    from deepbots_cli.webots.syntax import Node

_AXES = ("x", "y", "z")
_COMMANDS = {
    "setPosition": "position",
    "setVelocity": "velocity",
    "setTorque": "torque",
    "setForce": "torque",
}
_PASSING = frozenset(
    ["float", "int", "str", "array", "asarray", "float32", "float64", "int32", "list", "tuple"]
)


@dataclass
class Calls:
    """What names of Webots mean for one controller.

    `names` are expressions of nodes by node, such as `robot.pole`; `sensors` entries by device name, and
    `readings` prefixes of readings by device name, such as `robot.pole_angle`. `message` is what
    `handle_receiver` returns.
    """

    scene: Scene
    robot: Robot
    names: Mapping[Node, str]
    sensors: Mapping[str, SensorEntry]
    readings: Mapping[str, str]
    step: float
    message: list[Value] | None = None
    used: set[Node] = field(default_factory=set)
    """The nodes whose state the code reads."""
    devices: list[str] = field(default_factory=list)
    """The devices that the code names."""

    # Attributes

    def attribute(self, reader: Reader, name: str, frame: Frame, node: ast.AST) -> Value:
        """Return an attribute of `self` that the project does not define."""
        if name in ("timestep", "time_step"):
            return int(self.step)
        if name in reader.cls.methods or name.startswith(("get", "handle")):
            return Method(Instance(reader.cls), name)
        return Unknown(frame.module.location(node)) if name.islower() else Method(Instance(reader.cls), name)

    def external_constant(self, name: str) -> Value:
        last = name.rpartition(".")[2]
        if name.partition(".")[0] in ("math", "numpy", "np"):
            constants = {"pi": math.pi, "inf": math.inf, "Inf": math.inf, "e": math.e, "nan": math.nan}
            if last in constants:
                return constants[last]
        return External(name)

    # Calls

    def call(
        self,
        reader: Reader,
        frame: Frame,
        called: Value,
        arguments: list[Value],
        named: dict[str, Value],
        node: ast.Call,
    ) -> Value:
        """Return what a call stands for."""
        location = frame.module.location(node)
        name = _called_name(node.func)
        if name.lower().replace("_", "") == "normalizetorange":
            return _normalized(arguments, named, location)
        match called:
            case ProjectFunction():
                return reader.follow(frame, called, arguments, named)
            case Method(owner=Instance()):
                return self._of_self(called.name, arguments, location)
            case Method(owner=owner, name=method):
                return self._of_object(reader, owner, method, arguments, location)
            case External() as external:
                return self._external(reader, external, arguments, named, frame, node)
        return Unknown(location)

    def _of_self(self, name: str, arguments: list[Value], location: CodeLocation) -> Value:
        first = arguments[0] if arguments else None
        if name == "getSelf":
            return WorldNode(self.robot.node)
        if name in ("getTime", "get_time"):
            return Quantity("time", "s")
        if name == "getBasicTimeStep":
            return float(self.scene.basic_step)
        if name == "getFromDef" and isinstance(first, str):
            node = next((candidate for candidate in walk(self.scene.nodes) if candidate.name == first), None)
            return None if node is None else WorldNode(node)
        if name in ("handle_receiver", "handleReceiver"):
            return Unknown(location) if self.message is None else list(self.message)
        if name.startswith("get") and isinstance(first, str) and first in self.robot.devices:
            if first not in self.devices:
                self.devices.append(first)
            return RobotDevice(self.robot.devices[first])
        return Unknown(location)

    def _of_object(
        self, reader: Reader, owner: Value, name: str, arguments: list[Value], location: CodeLocation
    ) -> Value:
        match owner:
            case WorldNode(node):
                return self._of_node(node, name, arguments, location)
            case WorldField(node, field_name):
                return self._of_field(node, field_name, name, location)
            case RobotDevice(device):
                return self._of_device(reader, device.name, name, arguments, location)
            case Parent():
                return None if name == "__init__" else Unknown(location)
            case list():
                return _of_list(owner, name, arguments, location)
            case dict() if name in ("keys", "values", "items"):
                pairs = [list(pair) for pair in owner.items()]
                return {"keys": list(owner), "values": list(owner.values()), "items": pairs}[name]
        return Unknown(location)

    def _of_node(self, node: Node, name: str, arguments: list[Value], location: CodeLocation) -> Value:
        if name == "getField" and arguments and isinstance(arguments[0], str):
            return WorldField(node, arguments[0])
        inner = real(node)
        body = self.names.get(inner)
        if body is None:
            return Unknown(location)
        if name == "getPosition":
            return self._vector(inner, f"position({body})", "m")
        if name == "getVelocity":
            return [
                *self._vector(inner, f"velocity({body})", "m/s"),
                *self._vector(inner, f"angular_velocity({body})", "rad/s"),
            ]
        return Unknown(location)

    def _vector(self, node: Node, call: str, unit: str) -> list[Value]:
        self.used.add(node)
        return [Quantity(f"{call}.{axis}", unit) for axis in _AXES]

    def _of_field(self, node: Node, field_name: str, name: str, location: CodeLocation) -> Value:
        inner = real(node)
        if field_name == "translation" and name == "getSFVec3f" and inner in self.names:
            return self._vector(inner, f"position({self.names[inner]})", "m")
        if field_name not in parameters(node):
            return Unknown(location)
        plain = numbers(node, field_name)
        if name in ("getSFFloat", "getSFInt32") and len(plain) == 1:
            return plain[0]
        if name in ("getSFVec2f", "getSFVec3f", "getMFFloat") and field_name not in (
            "translation",
            "rotation",
        ):
            return list(plain)
        return text(node, field_name) if name == "getSFString" else Unknown(location)

    def _of_device(
        self, reader: Reader, device: str, name: str, arguments: list[Value], location: CodeLocation
    ) -> Value:
        if name in _COMMANDS and arguments:
            self_command = _COMMANDS[name]
            is_endless = arguments[0] == math.inf
            if not (self_command == "position" and is_endless):
                reader.outputs[device, self_command] = arguments[0]
            else:
                reader.outputs.pop((device, "position"), None)
            return None
        entry, reading = self.sensors.get(device), self.readings.get(device)
        motor = self.robot.devices[device].node
        if name in ("getMaxVelocity", "getMaxTorque", "getMaxForce", "getMaxPosition", "getMinPosition"):
            key = name[3].lower() + name[4:]
            return (
                next(iter(numbers(motor, key)), Unknown(location))
                if key in parameters(motor)
                else Unknown(location)
            )
        if entry is None or reading is None:
            return None if name in ("enable", "disable") else Unknown(location)
        if name == "getValue" and entry.is_truth:
            return Condition((Part(reading, location),))
        if name == "getValue" and not entry.components:
            return Quantity(reading, entry.unit, sensor=(device, ""))
        if name in ("getValues", "getQuaternion") and entry.components:
            return [
                Quantity(f"{reading}.{component}", entry.unit, sensor=(device, component))
                for component in entry.components
            ]
        return None if name in ("enable", "disable") else Unknown(location)

    def _external(
        self,
        reader: Reader,
        external: External,
        arguments: list[Value],
        keywords: dict[str, Value],
        frame: Frame,
        node: ast.Call,
    ) -> Value:
        location, name = frame.module.location(node), external.last
        first = arguments[0] if arguments else None
        if name == "super":
            return Parent(reader.cls)
        if name in ("print",):
            return None
        if name in ("Discrete", "Box"):
            return _space(name, arguments, keywords, location)
        if name in _PASSING:
            return _converted(name, first, location)
        if name == "range":
            return _range(arguments, location)
        if name == "len":
            return len(first) if isinstance(first, list | dict | str) else Unknown(location)
        if name in ("isnan", "isinf"):
            return [False] * len(first) if isinstance(first, list) else False
        if (
            name in ("any", "all")
            and isinstance(first, list)
            and all(isinstance(item, bool) for item in first)
        ):
            return any(first) if name == "any" else all(first)
        if name == "enumerate" and isinstance(first, list):
            return [[index, item] for index, item in enumerate(first)]
        if name == "zip" and all(isinstance(argument, list) for argument in arguments):
            return [list(pair) for pair in zip(*arguments, strict=False)]
        if name in ("zeros", "ones") and isinstance(first, int) and 0 <= first <= 1000:
            return [0.0 if name == "zeros" else 1.0] * first
        return _calculated(name, arguments, location)


def _called_name(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def _of_list(owner: list[Value], name: str, arguments: list[Value], location: CodeLocation) -> Value:
    if name == "append" and arguments and len(owner) < 1000:
        owner.append(arguments[0])
        return None
    if name == "extend" and arguments:
        extra = arguments[0]
        owner.extend(extra if isinstance(extra, list) and len(extra) < 1000 else [Unknown(location)])
        return None
    if name in ("tolist", "copy", "flatten"):
        return list(owner)
    return Unknown(location)


def _normalized(arguments: list[Value], keywords: dict[str, Value], location: CodeLocation) -> Value:
    """Return the call of `normalize_to_range(value, low, high, new_low, new_high, clip)`."""
    keys = (
        ("value",),
        ("min_val", "min", "low"),
        ("max_val", "max", "high"),
        ("new_min", "newMin"),
        ("new_max", "newMax"),
    )
    values = list(arguments[:6])
    for position in range(len(values), 5):
        names = [name for name in keys[position] if name in keywords]
        if not names:
            return Unknown(location)
        values.append(keywords[names[0]])
    value, *ends = values[:5]
    clips = values[5] if len(values) > 5 else keywords.get("clip", False)
    if not all(is_number(end) and math.isfinite(end) for end in ends) or ends[0] >= ends[1]:
        return Unknown(location)
    if is_number(value):
        return value
    if not isinstance(value, Quantity):
        return value if isinstance(value, Unknown) else Unknown(location)
    low, high, new_low, new_high = ends
    return Normalized(value, low, high, new_low, new_high, clips is True, location)


def _space(name: str, arguments: list[Value], keywords: dict[str, Value], location: CodeLocation) -> Value:
    if name == "Discrete":
        count = arguments[0] if arguments else keywords.get("n")
        return Space(choices=count) if isinstance(count, int) and 0 < count <= 1000 else Unknown(location)
    ends = [
        keywords.get(key, arguments[at] if len(arguments) > at else None)
        for at, key in enumerate(("low", "high"))
    ]
    shape = keywords.get("shape", arguments[2] if len(arguments) > 2 else None)
    size = shape[0] if isinstance(shape, list) and len(shape) == 1 else shape
    columns = []
    for end in ends:
        column = [end] * size if is_number(end) and isinstance(size, int) and 0 < size <= 1000 else end
        if is_number(column):
            column = [column]
        if not isinstance(column, list) or not all(map(is_number, column)):
            return Unknown(location)
        columns.append(tuple(float(value) for value in column))
    if len(columns[0]) != len(columns[1]):
        return Unknown(location)
    return Space(low=columns[0], high=columns[1])


def _range(arguments: list[Value], location: CodeLocation) -> Value:
    if not arguments or not all(isinstance(argument, int) for argument in arguments) or len(arguments) > 3:
        return Unknown(location)
    if len(arguments) == 3 and arguments[2] == 0:
        return Unknown(location)
    values = range(*arguments)
    return list(values) if len(values) <= 1000 else Unknown(location)


def _converted(name: str, value: Value, location: CodeLocation) -> Value:
    """Return `float(value)` and the like; a quantity stays what it is."""
    try:
        match value:
            case str() if name in ("float", "float32", "float64"):
                return float(value)
            case str() if name in ("int", "int32"):
                return int(value)
            case int() | float() if name in ("float", "float32", "float64"):
                return float(value)
            case int() | float() if name in ("int", "int32"):
                return int(value)
            case int() | float() if name == "str":
                return str(value)
    except (ValueError, OverflowError):
        return Unknown(location)
    if isinstance(value, Quantity) and name in ("int", "int32"):
        return Unknown(location)
    return list(value) if isinstance(value, list) else value


_PLAIN: dict[str, Any] = {
    "abs": abs,
    "fabs": abs,
    "absolute": abs,
    "sqrt": math.sqrt,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "exp": math.exp,
    "radians": math.radians,
    "deg2rad": math.radians,
    "degrees": math.degrees,
    "rad2deg": math.degrees,
}


def _calculated(name: str, arguments: list[Value], location: CodeLocation) -> Value:
    """Return a function of numbers, or of quantities where the language has it."""
    first = arguments[0] if arguments else None
    if name == "round" and isinstance(first, Quantity):
        digits = arguments[1] if len(arguments) > 1 else 0
        if not isinstance(digits, int):
            return Unknown(location)
        return Quantity(first.text, first.unit, first.is_simple, f"the project rounds to {digits} digits")
    if arguments and all(is_number(argument) for argument in arguments):
        return _number(name, arguments, location)
    if name == "clip" and isinstance(first, list):
        return [_calculated(name, [item, *arguments[1:]], location) for item in first]
    if isinstance(first, Quantity):
        return with_note_of(arguments, _of_quantity(name, first, arguments, location))
    if name in ("min", "max", "hypot") and all(
        isinstance(argument, Quantity) or is_number(argument) for argument in arguments
    ):
        return with_note_of(arguments, _joined(name, arguments, location))
    if name == "norm" and isinstance(first, list):
        return with_note_of(first, _joined("hypot", first, location))
    return Unknown(location)


def _number(name: str, arguments: list[Value], location: CodeLocation) -> Value:
    try:
        if name in _PLAIN and len(arguments) == 1:
            return _PLAIN[name](arguments[0])
        if name == "round":
            return round(arguments[0], int(arguments[1]) if len(arguments) > 1 else None)
        if name in ("min", "max") and len(arguments) > 1:
            return min(arguments) if name == "min" else max(arguments)
        if name == "clip" and len(arguments) == 3:
            return min(max(arguments[0], arguments[1]), arguments[2])
        if name in ("hypot", "atan2", "arctan2") and len(arguments) == 2:
            return math.hypot(*arguments) if name == "hypot" else math.atan2(*arguments)
    except (ValueError, OverflowError, TypeError):
        return Unknown(location)
    return Unknown(location)


def _of_quantity(name: str, value: Quantity, arguments: list[Value], location: CodeLocation) -> Value:
    if name in ("abs", "fabs", "absolute"):
        return Quantity(f"abs({value.text})", value.unit)
    if name == "sqrt" and value.unit in ("", "m^2"):
        return Quantity(f"sqrt({value.text})", "m" if value.unit else "")
    if name in ("sin", "cos", "tan") and value.unit == "rad":
        return Quantity(f"{name}({value.text})", "")
    if name == "clip" and len(arguments) == 3 and all(map(is_number, arguments[1:])):
        low, high = arguments[1:]
        if low < high and math.isfinite(low) and math.isfinite(high):
            ends = f"{number_text(low)} .. {number_text(high, value.unit)}"
            return Quantity(f"clamp({value.text}, {ends})", value.unit)
    if name in ("min", "max", "hypot"):
        return _joined(name, arguments, location)
    return Unknown(location)


def _joined(name: str, values: list[Value], location: CodeLocation) -> Value:
    """Return a function of several quantities of one unit."""
    units = {value.unit for value in values if isinstance(value, Quantity)}
    if len(units) != 1 or len(values) < 2:
        return Unknown(location)
    unit = units.pop()
    if not all(isinstance(value, Quantity) or is_number(value) for value in values):
        return Unknown(location)
    texts = [value.text if isinstance(value, Quantity) else number_text(value, unit) for value in values]
    joined = ", ".join(texts)
    return Quantity(f"{name}({joined})", unit) if len(joined) < 300 else Unknown(location)
