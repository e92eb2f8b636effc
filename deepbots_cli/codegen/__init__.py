"""From a program to readable Python.

    Program  ->  robot.py       a controller class per robot: use_message_data, create_message, its devices
             ->  supervisor.py  the supervisor class: bindings, the paper's methods, hand-written policies
                   reset.py     the draws and variations of an episode, and its start
                   step.py      a step and its ticks, and `_observe`, which computes everything once per tick
workspace.py   names that the methods of a supervisor share; reads of the engine
printer.py     numbers, vectors and the memories of stateful functions
names.py       names in generated code; its blocks, quotes, comments and templates; breaks of long lines

Bindings and imports are collected while the methods are printed, and written before them.
Only scalar trees and checked names are printed. The only texts of the user in the code are names that match
`[a-z_][a-z0-9_]*`, quoted strings and comments.
"""

from __future__ import annotations

import linecache
import re
import subprocess
from collections.abc import Iterator, Sequence
from functools import lru_cache
from importlib.util import find_spec
from types import CodeType, ModuleType
from typing import Any

from deepbots_cli.codegen.names import (
    COLUMN_NAMES,
    RUNTIME_NAMES,
    WIDTH,
    Constants,
    class_name,
    fill_template,
)
from deepbots_cli.codegen.robot import ControllerPrinter
from deepbots_cli.codegen.supervisor import print_batch_supervisor, print_supervisor
from deepbots_cli.errors import BatchError
from deepbots_cli.expressions.functions import math_names
from deepbots_cli.expressions.text import BATCH, SCALAR, Target
from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.program import Program, world_of
from deepbots_cli.program.identity import digest

_MODULE = '''
"""{name}, compiled by deepbots{purpose}; scenario {digest}.

{about}
"""

from __future__ import annotations

{standard}
from typing import Any

{runtime}

{constants}

{classes}
'''
_OF_ONE_WORLD = """
SI units. Each robot has a controller class, which uses only its sensors and its messages. The supervisor is
a Gymnasium environment. `reset` calls `_begin` and `_start`, and `step` calls `_advance`. `_start` and
`_advance` call `_observe`. The methods below `_observe` return its results and change nothing.
"""
_OF_BATCH = """
SI units. A value is a column, an array with one number per world, or a plain number if it is the same in all worlds.
A vector is a sequence of columns. `reset` resets the single worlds and copies their state into the columns; `step`
calls `_advance`, which observes. `add` does not change worlds whose episode has ended. `each` calls a function
of each single world in turn.
"""
_NAME = re.compile(r"[a-z_][a-z0-9_]*")
# The group is empty for parts that are not names: quotes, comments, numbers, attributes and the keywords of
# calls.
_NAME_IN_CODE = re.compile(r'"(?:[^"\\]|\\.)*"|#.*|[.\d]\w*|\w+=(?!=)|([A-Za-z_]\w*)')

_FORMATTERS = (("ruff", "format", "--isolated"), ("black", "--quiet"))
_NUMBERS = frozenset({"pi", "tau", "e", "inf"})


@lru_cache(maxsize=16)
def generate_module(scenario: Program, target: str = "scalar", scripts: tuple[str, ...] = ()) -> str:
    """Return the module that runs `scenario`: one controller class per robot and the supervisor class.

    It is kept for the next copy of the environment: printing PandaReach takes 50 ms.

    Args:
        target: `scalar` for single worlds, or `batch` for many at once.
        scripts: The scripts that a batch computes; a single world computes all of them.

    Raises:
        BatchError: A batch cannot run the scenario; the message gives the reasons.
        ValueError: A name is not an identifier of the language, which is a fault of the compiler.
    """
    for name in _names(scenario):
        if not _NAME.fullmatch(name):
            raise ValueError(f"{name[:40]!r} cannot be a name in the code")
    if target == "batch" and (reasons := batch_obstacles(scenario, scripts)):
        raise BatchError(f"{scenario.name} does not fit a batch: {'; '.join(reasons)}")
    on_floats = target == "scalar"
    constants = Constants()
    target_kind = SCALAR if on_floats else BATCH
    classes = _classes(scenario, constants, target_kind, scripts)
    used = set(_NAME_IN_CODE.findall("\n".join([*constants.lines, *classes])))
    # Sorted, since the order of a set of texts differs between processes.
    used_math = sorted((math_names() if on_floats else _NUMBERS) & used)
    lines = fill_template(
        _MODULE,
        name=class_name(scenario.name),
        purpose="" if on_floats else " for a batch of worlds",
        about=(_OF_ONE_WORLD if on_floats else _OF_BATCH).strip().split("\n"),
        digest=digest(scenario)[:12],
        standard=[
            *(["from collections.abc import Iterator"] if "Iterator" in used else []),
            *([f"from math import {', '.join(used_math)}"] if used_math else []),
        ],
        runtime=_imports(used, on_floats),
        constants=[*constants.lines, "", ""] if constants.lines else [""],
        classes=classes,
    )
    return "\n".join(_without_gaps(lines)).rstrip("\n") + "\n"


def _classes(
    scenario: Program, constants: Constants, target: Target, scripts: Sequence[str] = ()
) -> list[str]:
    lines = [
        line
        for robot in scenario.robots
        for line in (*ControllerPrinter(scenario, robot, constants, target).lines(), "", "")
    ]
    return [
        *lines,
        *(
            print_supervisor(scenario, constants)
            if target is SCALAR
            else print_batch_supervisor(scenario, constants, [*map(scenario.script, scripts)])
        ),
    ]


def _imports(used: set[str], on_floats: bool) -> list[str]:
    if on_floats:
        return [
            f"from deepbots_cli.runtime import {', '.join(sorted(used & set(RUNTIME_NAMES), key=_as_isort))}"
        ]
    columns = sorted(used & set(COLUMN_NAMES))
    return [
        *(["import numpy as np", ""] if "np" in used else []),
        "from deepbots_cli.runtime.batch import BatchController, BatchSupervisor",
        *([f"from deepbots_cli.runtime.columns import {', '.join(columns)}"] if columns else []),
    ]


def batch_obstacles(scenario: Program, scripts: Sequence[str] = ()) -> list[str]:
    """Return the reasons why a batch cannot run a scenario, and compute these scripts; empty if it can."""
    if (others := scenario.others) is not None:
        of_all = world_of(scenario, others)
        alone = [f"the episode of {others.agent} may end before those of others"]
        return batch_obstacles(of_all, others.scripts) + (alone if of_all.members[others.agent].alone else [])
    agent = scenario.agent
    scripts = scripts or scenario.scripted_rivals
    reasons = [
        (
            bool(agent.images) or any(sensor.optics for robot in scenario.robots for sensor in robot.sensors),
            "it has cameras, whose pictures are drawn world by world",
        ),
        (bool(scenario.python_functions), "it runs code of packages, which computes single numbers"),
    ]
    obstacles = [reason for holds, reason in reasons if holds]
    if not obstacles:
        try:
            _classes(scenario, Constants(), BATCH, scripts)
        except BatchError as error:
            obstacles = [str(error)]
    return obstacles


def _names(scenario: Program) -> Iterator[str]:
    """Yield the names that the scenario defines."""
    robots = scenario.robots
    parts: list[tuple[Any, ...]] = [
        part
        for robot in robots
        for part in (robot.sensors, robot.actuators, robot.received, robot.emitted, robot.commands)
    ]
    supervisor_parts: list[tuple[Any, ...]] = [
        scenario.parameters,
        scenario.signals,
        scenario.agent.reward,
        scenario.endings,
        scenario.agent.action,
    ]
    yield from (robot.name for robot in robots)
    supervisor_parts += [scenario.disturbances, scenario.agent.scripts, scenario.tests]
    yield from (entry.name for entries in (*parts, *supervisor_parts) for entry in entries)


def _as_isort(name: str) -> tuple[int, str]:
    """Return the key for isort's order: constants, classes, functions."""
    if name.isupper():
        return 0, name
    return 1 if name[0].isupper() else 2, name


def _without_gaps(lines: list[str]) -> list[str]:
    """Return the lines with at most two blank lines in a row, and one inside of classes."""
    result: list[str] = []
    for index, line in enumerate(lines):
        if line or not result:
            result.append(line)
            continue
        following = next((later_line for later_line in lines[index:] if later_line), "")
        most = 1 if following.startswith(" ") else 2
        if any(result[-most:]):
            result.append(line)
    return result


def formatted(code: str) -> str:
    """Return a module for readers: as ruff or Black formats it if one of them is installed, else as it is."""
    for name, *options in _FORMATTERS:
        if find_spec(name) is not None:
            command = python_command(name, *options, f"--line-length={WIDTH}", "-")
            environment = python_environment()
            done = subprocess.run(
                command, input=code, env=environment, capture_output=True, text=True, check=False
            )
            if done.returncode == 0:
                return done.stdout
    return code


def load_module(code: str, name: str, filename: str) -> ModuleType:
    """Run `code`, which the compiler printed from typed trees, as module `name`.

    `filename` appears in tracebacks (`<deepbots CartPole 1a2b3c4d>`); its lines are registered, so that
    tracebacks and debuggers show them.
    """
    # `linecache.checkcache` keeps an entry whose time of change is None.
    linecache.cache[filename] = (len(code), None, code.splitlines(keepends=True), filename)
    module = ModuleType(name)
    module.__file__ = filename
    exec(_compiled(code, filename), module.__dict__)
    return module


@lru_cache(maxsize=16)
def _compiled(code: str, filename: str) -> CodeType:
    """Return the compiled code, which copies of one environment share."""
    # By default, `compile` applies the `__future__` imports of this module to the code.
    return compile(code, filename, "exec", dont_inherit=True)
