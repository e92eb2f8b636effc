"""What may be printed: a compiled scenario from elsewhere is checked before a line of Python is made of it.

The compiler checks what users write. A run directory may come from anyone, though, and its compiled
scenario is printed and run when the policy is evaluated. So every word that would stand in the code
outside of quotes must be an identifier of the language or an entry of a table.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass

from deepbots_cli.canonical import CanonicalError
from deepbots_cli.ir import Choices, CompiledScenario
from deepbots_cli.lang.emit import PYTHON
from deepbots_cli.lang.scalar import Draw, Name, Op, State, World
from deepbots_cli.lang.state import RULES

_NAME = re.compile(r"[a-z_][a-z0-9_]*", re.ASCII)
_DRAWS = frozenset({"uniform", "integer", "normal", "choice"})
_FACTS: dict[str, tuple[str | None, ...]] = {
    **dict.fromkeys(("position", "velocity", "angular_velocity"), ("x", "y", "z")),
    "orientation": ("x", "y", "z", "w"),
    **dict.fromkeys(("joint_position", "joint_velocity", "joint_torque"), (None,)),
}


def check_printable(scenario: CompiledScenario) -> None:
    """Refuse what the compiler would never have written.

    Raises:
        CanonicalError: A name is no identifier, or an operation, draw or fact is not in its table.
    """
    for name in _defined_names(scenario):
        if not _NAME.fullmatch(name):
            raise CanonicalError(f"{name[:40]!r} is no name that a scenario may define")
    for node in _nodes(scenario):
        match node:
            case Op(op=word) if word != "pow" and word not in PYTHON:
                raise CanonicalError(f"{word[:40]!r} is no operation")
            case State(function=word) if word not in RULES:
                raise CanonicalError(f"{word[:40]!r} is no stateful function")
            case Draw(distribution=word) if word not in _DRAWS:
                raise CanonicalError(f"{word[:40]!r} is no distribution")
            case World(function=word, subjects=subjects, component=component):
                joint = word.startswith("joint_")
                if component not in _FACTS.get(word, ()) or len(subjects) != 1 or (joint and "." not in subjects[0]):
                    raise CanonicalError(f"{word[:40]!r} of {str(subjects)[:60]} is nothing that an engine can tell")


def _defined_names(scenario: CompiledScenario) -> Iterator[str]:
    for robot in scenario.robots:
        yield robot.name
        for entries in (robot.sensors, robot.actuators, robot.receive, robot.emit, robot.apply):
            yield from (entry.name for entry in entries)
    for named in (scenario.parameters, scenario.signals, scenario.reward, scenario.endings, scenario.action):
        yield from (entry.name for entry in named)
    for part in scenario.action:
        if isinstance(part, Choices):
            yield from part.variables
            yield from (option.name for option in part.options)


def _nodes(value: object) -> Iterator[Op | State | Draw | World | Name]:
    """Every node of every expression, wherever it stands."""
    waiting = [value]
    while waiting:
        here = waiting.pop()
        if isinstance(here, (Op, State, Draw, World, Name)):
            yield here
        if isinstance(here, tuple):
            waiting.extend(here)
        elif is_dataclass(here) and not isinstance(here, type):
            waiting.extend(getattr(here, field.name) for field in fields(here))
