"""The names of attributes and methods in generated classes.

`codegen` prints them; the runtime, `lint`, `insight` and `view` look them up by the names of the scenario.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Literal

from deepbots_cli.program.robots import Direction

TestQuestion = Literal["holds", "compared"]
"""The question to a test: whether each condition holds, or the values that the conditions compare."""

_TERM = "term_"


def identifier(*parts: str | None) -> str:
    """Return a name of the scenario, such as `cart.pole_angle`, as an identifier: `cart_pole_angle`."""
    return re.sub(r"\W", "_", "_".join(part for part in parts if part))


# Of a supervisor


def robot(name: str) -> str:
    """Return the name of the controller of a robot."""
    return f"robot_{name}"


def channel(robot: str, direction: Direction) -> str:
    """Return the name of the path of messages to or from a robot."""
    return f"to_{robot}" if direction == "to_robot" else f"from_{robot}"


def link(sender: str, receiver: str) -> str:
    """Return the name of the path of messages from one robot to another."""
    return f"{sender}_to_{receiver}"


def term(name: str) -> str:
    """Return the name of a term of the last reward."""
    return f"{_TERM}{name}"


def last(local: str) -> str:
    """Return the name of a value of the last timestep, by its local."""
    return f"last_{local}"


def push(disturbance: str) -> str:
    """Return the name of the device that pushes."""
    return f"push_{disturbance}"


def allowed(choice: str) -> str:
    """Return the name of the options of a choice that may be chosen next."""
    return f"allowed_{choice}"


def script(name: str) -> str:
    """Return the name of the method that computes the next action of a script."""
    return f"script_{name}"


def test(name: str, question: TestQuestion) -> str:
    """Return the name of the method that answers a question about a test."""
    return f"test_{name}_{question}"


# Of a controller


def drive(actuator: str) -> str:
    """Return the name of an actuator."""
    return f"drive_{actuator}"


def sense(sensor: str) -> str:
    """Return the name of the device of a sensor."""
    return f"sense_{sensor}"


def emitted(local: str) -> str:
    """Return the name of a value of the last message, by its local."""
    return f"emitted_{local}"


# Of both


def reader(local: str) -> str:
    """Return the name of a reader of the engine, by the local of its result."""
    return f"read_{local}"


# Lines of methods


def as_written(statement: str) -> str:
    """Return a statement with names as the scenario has them: without `self.`, the prefix of terms, and the
    comment."""
    names = re.sub(rf"\bself\.({_TERM})?", "", statement.partition("  # ")[0])
    return re.sub(r"\bstep_count\b", "step", names)


def names_in(line: str) -> Iterator[str]:
    """Return the names in a line in their order: an assignment names its target first, then the names that it
    reads."""
    return (match[1] for match in re.finditer(r"(?:self\.)?([A-Za-z_]\w*)", line))
