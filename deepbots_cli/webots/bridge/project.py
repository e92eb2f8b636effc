"""The scenario of an exported project, compiled, with its generated classes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepbots_cli import api
from deepbots_cli.codegen import load_module
from deepbots_cli.codegen.names import class_name
from deepbots_cli.runtime.copies import copy_name, make_environment, world_with_copies
from deepbots_cli.webots.bridge.task import HasWebotsRobots, exchange

if TYPE_CHECKING:
    from deepbots_cli.port import Engine
    from deepbots_cli.program import Program
    from deepbots_cli.program.robots import Robot
    from deepbots_cli.program.world import WorldModel
    from deepbots_cli.runtime import RobotController, Supervisor
    from deepbots_cli.webots.bridge.task import Host

SCENARIO, MODULE = "scenario.yaml", "environment.py"


@dataclass(frozen=True, eq=False)
class Project:
    """A compiled scenario, and the classes of its module by name."""

    program: Program
    classes: dict[str, Any]

    @property
    def world(self) -> WorldModel:
        """The world, with the copies of a robot."""
        copies = self.program.agent.copies
        return self.program.world if copies is None else world_with_copies(self.program.world, copies)

    @property
    def robots(self) -> dict[str, Robot]:
        """The robots by their names in the world, in the order of their channels."""
        copies = self.program.agent.copies
        robots: dict[str, Robot] = {}
        for robot in self.program.robots:
            if copies is not None and robot.name == copies.robot:
                robots |= {copy_name(copies, number + 1): robot for number in range(copies.count)}
            else:
                robots[robot.name] = robot
        return robots

    @property
    def timestep_ms(self) -> int:
        return round(self.program.world.timestep * 1000)

    def controller_class(self, robot: Robot) -> type[RobotController]:
        """Return the generated class of a robot."""
        kind: type[RobotController] = self.classes[f"{class_name(robot.name)}Controller"]
        return kind

    def supervisor(self, engine: Engine) -> Supervisor:
        """Return the generated supervisor over an engine, with robots that are controllers of their own."""
        kind = self.classes[f"{class_name(self.program.name)}Supervisor"]
        bridged = type(kind.__name__, (HasWebotsRobots, kind), {"__doc__": kind.__doc__})
        return make_environment(bridged, self.program, lambda _: engine)

    def task(self, supervisor: Host) -> Supervisor:
        """Return the environment of the scenario in the world of a Webots supervisor."""
        from deepbots_cli import engines
        from deepbots_cli.webots.bridge.plant import MirrorEngine, Plant

        engine = engines.create("mujoco", self.world)
        plant = Plant(supervisor, self.world)
        mirror = MirrorEngine(engine, plant, self.world)
        task = self.supervisor(mirror)
        mirror.let_timestep_pass = exchange(supervisor, task, lambda: plant.wait(self.timestep_ms))
        return task


@cache
def load_project(folder: Path) -> Project:
    """Return the project whose scenario and module are in a folder.

    Raises:
        ScenarioError: The scenario has errors.
    """
    compiled = api.compile(folder / SCENARIO)
    path = folder / MODULE
    module = load_module(path.read_text("utf-8"), path.stem, str(path))
    return Project(compiled.program, vars(module))


def project_of(compiled: api.Compiled) -> Project:
    """Return the project of a compiled scenario, with the module that deepbots generates."""
    module = load_module(compiled.code, MODULE.partition(".")[0], f"<deepbots {compiled.program.name}>")
    return Project(compiled.program, vars(module))
