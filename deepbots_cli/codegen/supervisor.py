"""Prints the supervisor class: what it binds, and the methods that the other modules print."""

from __future__ import annotations

from deepbots_cli.codegen.action import choice_tables
from deepbots_cli.codegen.evaluation import bind_foreign
from deepbots_cli.codegen.goal import compute_reward
from deepbots_cli.codegen.masks import allowed
from deepbots_cli.codegen.names import class_name
from deepbots_cli.codegen.observation import album
from deepbots_cli.codegen.pushes import bind_pushes, drawing
from deepbots_cli.codegen.readings import readings
from deepbots_cli.codegen.reset import begin, is_arranged
from deepbots_cli.codegen.robot import controller_name
from deepbots_cli.codegen.scripts import scripts
from deepbots_cli.codegen.step import advance, start
from deepbots_cli.codegen.text import block, docstring, indent, quoted
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.program import Program


def supervisor(scenario: Program) -> list[str]:
    """The lines of the class."""
    space = Workspace(scenario)
    controllers = ", ".join(f"{quoted(robot.name)}: {controller_name(robot)}" for robot in scenario.robots)
    lines = [f"class {class_name(scenario.name)}Supervisor(Supervisor):"]
    lines += indent([*docstring(scenario.summary or scenario.name), "", f"CONTROLLERS = {{{controllers}}}", *choice_tables(space), ""])
    asked = (*readings(space), allowed(space), compute_reward(space), *scripts(space))
    for method in (_bind(space), begin(space), drawing(space), start(space), advance(space), *asked):
        lines += indent(method)
    return lines


def _bind(space: Workspace) -> list[str]:
    arranged = is_arranged(space.scenario)
    lines = ["self.bodies = Arrangement(self.scenario, engine)"] if arranged else []
    if space.reads.charts:
        lines.append(f"self.ways = Ways(self.scenario, engine{', self.bodies' if arranged else ''})")
    lines += [*space.reads.bind_lines(), *bind_pushes(space)]
    if space.scenario.numbers:
        lines.append(f'self.pack = Struct("{len(space.scenario.numbers)}f").pack_into')
    for pictured in space.scenario.images:
        lines.append(f"{album(space, pictured)} = self.albums[{quoted(pictured.key)}].frames")
    lines += bind_foreign(space)
    if space.scenario.goal is not None:
        lines.append(f'self.pack_goal = Struct("{2 * len(space.scenario.goal.low)}f").pack_into')
    return block("def bind(self, engine: Any) -> None:", lines or ["pass"])
