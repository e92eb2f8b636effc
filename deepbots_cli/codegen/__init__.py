"""From the compiled scenario to readable Python.

robot.py       a controller class per robot: use_message_data, create_message; sensing.py its sensors, driving.py its actuators
supervisor.py  the supervisor class, whose methods are printed by
  reset.py       what an episode varies and how it begins; placing.py how bodies look for a place,
                 variations.py the statement of each figure that varies
  pushes.py      disturbances
  step.py        a step and its ticks, with action.py, messages.py, evaluation.py (limits.py, goal.py), observation.py, masks.py
  redraws.py     parameters and figures of routes, drawn at a reset and within an episode
  readings.py    the paper's methods, which read what a step left
  scripts.py     hand-written policies
workspace.py   what these share: names and readers
reads.py       which engine readers are bound, and how each number is taken from them
printer.py     statements and the memory of stateful functions; names.py identifiers; text.py, wrap.py layout

Only scalar trees and checked names are printed; no text of the user's reaches the code but names that
match `[a-z_][a-z0-9_]*` and quoted strings. The scenario comes from the compiler, which has checked it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from deepbots_cli.canonical import digest
from deepbots_cli.codegen.names import RUNTIME, class_name
from deepbots_cli.codegen.robot import RobotPrinter
from deepbots_cli.codegen.supervisor import supervisor
from deepbots_cli.codegen.wrap import wrapped
from deepbots_cli.expressions.functions import math_names
from deepbots_cli.program import Program

_NAME = re.compile(r"[a-z_][a-z0-9_]*", re.ASCII)


def emit(scenario: Program) -> str:
    """The module that runs `scenario`: one controller class per robot and the supervisor class.

    Raises:
        ValueError: A name is no identifier of the language, which is a fault of the compiler.
    """
    for name in _names(scenario):
        if not _NAME.fullmatch(name):
            raise ValueError(f"{name[:40]!r} cannot be a name in the code")
    classes: list[str] = []
    for robot in scenario.robots:
        classes += ["", "", *RobotPrinter(scenario, robot).text()]
    classes += ["", "", *supervisor(scenario)]
    body = [line for long in _trim_blank_lines(classes) for line in wrapped(long)]
    return "\n".join([*_head(scenario, body), *body]).rstrip("\n") + "\n"


def _names(scenario: Program) -> Iterator[str]:
    """What the scenario defines and the code is made with."""
    robots = scenario.robots
    parts: list[tuple[Any, ...]] = [
        part for robot in robots for part in (robot.sensors, robot.actuators, robot.received, robot.emitted, robot.commands)
    ]
    own: list[tuple[Any, ...]] = [scenario.parameters, scenario.signals, scenario.reward, scenario.endings, scenario.action]
    yield from (robot.name for robot in robots)
    yield from (entry.name for entries in (*parts, *own, scenario.disturbances, scenario.scripts) for entry in entries)


def _head(scenario: Program, body: list[str]) -> list[str]:
    words = set("".join(c if c.isalnum() or c == "_" else " " for c in "\n".join(body)).split())
    used_math = sorted(math_names() & words)
    runtime = [name for name in RUNTIME if name in words]
    lines = [
        f'"""{class_name(scenario.name)}, compiled by deepbots; scenario {digest(scenario)[:12]}.',
        "",
        "SI units. Each robot has a controller class, which knows its sensors and its messages only; the",
        "supervisor is a Gymnasium environment. `reset` and `step` of its base class call `_begin` and `_start`,",
        "and `_advance`, which computes one tick; the methods after it read what that left and change nothing.",
        '"""',
        "",
        "from __future__ import annotations",
        "",
    ]
    if used_math:
        lines.append(f"from math import {', '.join(used_math)}")
    if "Iterator" in words:
        lines.insert(-1 if used_math else len(lines), "from collections.abc import Iterator")
    return [*lines, "from struct import Struct", "from typing import Any", "", f"from deepbots_cli.runtime import {', '.join(runtime)}"]


def _trim_blank_lines(lines: list[str]) -> list[str]:
    """At most two blank lines in a row, one inside classes."""
    result: list[str] = []
    for line in lines:
        if not line and len(result) >= 2 and not result[-1] and not result[-2]:
            continue
        result.append(line)
    return result
