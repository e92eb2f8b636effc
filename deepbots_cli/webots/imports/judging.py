"""Observations, rewards and endings of a project, read from the class of its supervisor."""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence
from math import isfinite
from typing import TYPE_CHECKING

from deepbots_cli.webots.imports.reader import Frame, Reader
from deepbots_cli.webots.imports.task import Entry, Item, Task, Todo, whole
from deepbots_cli.webots.imports.values import (
    CodeLocation,
    Condition,
    Normalized,
    Otherwise,
    Part,
    Quantity,
    Space,
    Unknown,
    Value,
    is_number,
    negated,
    number_text,
)
from deepbots_cli.webots.imports.world import Names

if TYPE_CHECKING:
    from deepbots_cli.webots.imports.code import ClassCode, Code, ModuleCode

_AXES = ("x", "y", "z")
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*")
_NO_NAMES = frozenset(
    ["self", "np", "numpy", "math", "abs", "round", "float", "int", "not", "and", "or", "len"]
)
_TIME = re.compile(r"time (>=?) (\S+) s")
_STEP = re.compile(r"step (>=?) (\d+)")
_SUCCESS = re.compile(r"solved|success|reached|goal|escaped", re.IGNORECASE)
_NO_SUCCESS = re.compile(r"unsolved|unreached|missed|fail|lost|not_|= False", re.IGNORECASE)
_RETURN = re.compile(r"episode_return >=? \S+")


# Observations


def read_observation(task: Task, reader: Reader, space: Value, names: Names) -> None:
    """Read `get_observations` into `observation` and `augment`."""
    result = reader.call("get_observations", [])
    if result is None:
        return
    returned, value = result
    if not isinstance(value, list):
        locations = [outcome.location for outcome in returned]
        if isinstance(value, Unknown):
            locations.append(value.location)
        if locations:
            task.observation.append(Todo(locations[-1], "the observation"))
        return
    labels = _labels(reader)
    keys: set[str] = set()
    for position, item in enumerate(value):
        label = labels[position] if len(labels) == len(value) else ""
        _add_observation(task, item, label, position, space, names, keys)
    task.observation = _joined_vectors(task.observation)


def _labels(reader: Reader) -> list[str]:
    """Return the names in the list that `get_observations` returns last, "" for anything else."""
    _, function = reader.cls.methods["get_observations"]
    returns = [node for node in ast.walk(function) if isinstance(node, ast.Return)]
    for node in sorted(returns, key=lambda node: node.lineno, reverse=True):
        value = node.value
        if isinstance(value, ast.Call) and value.args:
            value = value.args[0]
        if isinstance(value, ast.List | ast.Tuple):
            return [element.id if isinstance(element, ast.Name) else "" for element in value.elts]
    return []


def _add_observation(
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
                task.observation.append(Todo(_text_location(item), "its range"))
                return
        case Quantity():
            task.observation.append(Todo(_text_location(item), "its range"))
            return
        case Unknown(location):
            task.observation.append(Todo(location, f"value {position} of the observation"))
            return
        case _:
            about = f"value {position} of the observation, which does not change"
            task.observation.append(Todo(CodeLocation("get_observations", 0, f"`{str(item)[:20]}`"), about))
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
    match = re.search(r"\((\w+),", item.location.python) if isinstance(item, Normalized) else None
    return match.group(1) if match and not match.group(1).isdigit() else ""


def _text_location(value: Quantity) -> CodeLocation:
    return CodeLocation("observation", 0, value.text)


def _is_reading(value: Quantity) -> bool:
    return re.fullmatch(r"[a-z_]\w*\.[a-z_]\w*(\.[a-z_]\w*)?", value.text) is not None


def _joined_vectors(items: list[Item]) -> list[Item]:
    """Return entries with x, y and z of one reading in one range as one entry."""
    result: list[Item] = []
    position = 0
    while position < len(items):
        three = items[position : position + 3]
        if len(three) == 3 and all(isinstance(item, Entry) for item in three):
            stems = [item.key.rpartition(".") for item in three if isinstance(item, Entry)]
            values = {item.value for item in three if isinstance(item, Entry)}
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
    result = reader.call("get_reward", [Unknown(CodeLocation("get_reward", 0, "action"))])
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
        task.reward.append(whole(reader.cls, "get_reward", "the reward"))


def _divisor(unit: str) -> str:
    return unit if re.fullmatch(r"\w+", unit) else f"({unit})"


def read_endings(task: Task, reader: Reader, names: Names) -> None:
    """Read `is_done` into `termination` and `truncation`."""
    result = reader.call("is_done", [])
    if result is None:
        return
    returned, _ = result
    barred: list[Condition | Unknown] = []
    for outcome in returned:
        if outcome.value is False or outcome.value is None:
            if conditions := _stated(outcome.path):
                barred.append(conditions[0] if len(conditions) == 1 else Unknown(outcome.location))
            continue
        for condition in _ending_conditions(
            [*_opposites(barred), *outcome.path], outcome.value, outcome.location
        ):
            if isinstance(condition, Unknown):
                task.failure.append(Todo(condition.location, "an ending"))
                continue
            for part in condition.parts:
                if part.text:
                    _add_ending(task, part, names, is_success=_names_success(reader, part.location))
                else:
                    task.failure.append(Todo(part.location, "an ending"))


def _stated(path: Sequence[Condition | Unknown]) -> list[Condition | Unknown]:
    """Return the conditions of a path, except those that an earlier `return` covers."""
    return [condition for condition in path if not isinstance(condition, Otherwise)]


def _opposites(conditions: Sequence[Condition | Unknown]) -> list[Condition | Unknown]:
    """Return the opposites of conditions under which an earlier `return` of `is_done` returns False."""
    return [
        negated(
            condition, condition.location if isinstance(condition, Unknown) else condition.parts[0].location
        )
        for condition in conditions
    ]


def _ending_conditions(
    path: Sequence[Condition | Unknown], value: Value, location: CodeLocation
) -> list[Condition | Unknown]:
    """Return the conditions under which a `return` ends the episode."""
    if isinstance(value, Unknown):
        return [value]
    conditions = _stated(path)
    if isinstance(value, Condition):
        conditions.append(value)
    elif value is not True:
        return [Unknown(location)]
    for condition in conditions:
        if isinstance(condition, Unknown):
            return [condition]
        if condition.unknown is not None and len(conditions) > 1:
            return [Unknown(condition.unknown.location)]
    if len(conditions) < 2:
        return conditions
    joined_text = " and ".join(
        f"({condition.text})" for condition in conditions if isinstance(condition, Condition)
    )
    last = conditions[-1]
    return [
        Condition((Part(joined_text, last.parts[0].location if isinstance(last, Condition) else location),))
    ]


def _names_success(reader: Reader, location: CodeLocation) -> bool:
    """Return whether the branch of an ending mentions success, as in `self.is_solved = True`."""
    for module in reader.code.modules.values():
        for node in ast.walk(module.tree) if module.file == location.file else ():
            if isinstance(node, ast.If) and node.test.lineno == location.line:
                lines = map(ast.unparse, node.body)
                return any(_SUCCESS.search(line) and not _NO_SUCCESS.search(line) for line in lines)
    return False


def _add_ending(task: Task, part: Part, names: Names, *, is_success: bool) -> None:
    if match := _TIME.fullmatch(part.text):
        _add_limit(task, "max_time", f"{match.group(2)} s")
    elif match := _STEP.fullmatch(part.text):
        # `>` is true a step later than `>=`.
        _add_limit(task, "max_steps", str(int(match.group(2)) + (match.group(1) == ">")))
    elif _RETURN.fullmatch(part.text):
        task.success.append(Entry(names.new("enough", "ending"), part.text, part.note))
    else:
        words = [word for word in _IDENTIFIER.findall(part.location.python) if word not in _NO_NAMES]
        key = names.new(f"{words[0] if words else 'ending'}_limit", "ending")
        (task.success if is_success else task.failure).append(Entry(key, part.text, part.note))


def _add_limit(task: Task, key: str, value: str) -> None:
    if not any(isinstance(item, Entry) and item.key == key for item in task.truncation):
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
                child.slice.lower
                for child in ast.walk(node.left)
                if isinstance(child, ast.Subscript)
                and isinstance(child.slice, ast.Slice)
                and child.slice.lower
            ),
            None,
        )
        calls = [child for child in ast.walk(node.left) if isinstance(child, ast.Call)]
        if episodes is None or not any(ast.unparse(call.func).endswith("mean") for call in calls):
            continue
        frame = Frame(module, {}, None)
        bar, count = reader.evaluate(frame, node.comparators[0]), reader.evaluate(frame, episodes)
        if is_number(bar) and isfinite(bar) and isinstance(count, int) and 1 <= -count <= 10_000:
            task.solved.append(Entry("", f"mean_return >= {number_text(bar)} over {-count} episodes"))
            return
    task.solved.append(Todo(module.location(function.body[-1]), "when the task is solved"))


def read_limits(task: Task, code: Code, reader: Reader) -> None:
    """Read the largest number of steps from a loop over a range that steps the environment."""
    for module in code.modules.values():
        for node in ast.walk(module.tree):
            if not (isinstance(node, ast.For) and isinstance(node.iter, ast.Call)):
                continue
            if not (isinstance(node.iter.func, ast.Name) and node.iter.func.id == "range"):
                continue
            if not _steps_environment(node):
                continue
            ends = [_constant(argument, module, reader) for argument in node.iter.args]
            limit = _count(ends)
            if 0 < limit < 1_000_000:
                _add_limit(task, "max_steps", str(limit))
                return


def _count(ends: Sequence[Value]) -> int:
    """Return how often a loop over `range(*ends)` runs; 0 if that is unknown."""
    numbers = [end for end in ends if type(end) is int]
    try:
        return len(range(*numbers)) if len(numbers) == len(ends) else 0
    except (TypeError, ValueError, OverflowError):  # the wrong number of arguments, or a step of 0
        return 0


def _steps_environment(loop: ast.For) -> bool:
    """Return whether a loop calls `step` itself, and not in a loop inside."""
    waiting: list[ast.AST] = list(loop.body)
    while waiting:
        node = waiting.pop()
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr == "step"
            and (node.args or node.keywords)  # `optimizer.step()` has none
        ):
            return True
        if not isinstance(node, ast.For | ast.While):
            waiting += ast.iter_child_nodes(node)
    return False


def _constant(node: ast.expr, module: ModuleCode, reader: Reader) -> Value:
    """Return the value of a constant of the module, or of an attribute of the supervisor that another
    variable has, as in `env.limit`."""
    if isinstance(node, ast.Attribute) and node.attr in reader.attributes:
        return reader.attributes[node.attr]
    if isinstance(node, ast.Name):
        for statement in ast.walk(module.tree):
            if isinstance(statement, ast.Assign) and any(
                isinstance(target, ast.Name) and target.id == node.id for target in statement.targets
            ):
                return statement.value.value if isinstance(statement.value, ast.Constant) else None
    return reader.evaluate(Frame(module, {}), node)
