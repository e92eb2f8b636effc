"""Exported projects, and their scenarios in the same world, for tests.

The scenario runs in its own environment, without controllers and without the package `deepbots`, over the
physics of the exported world. So a difference is one of the export, and not of physics.

Worlds of Webots as texts, and what tests do with them.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from deepbots_cli import api, diagnostics
from deepbots_cli.cli.written_files import write_new
from deepbots_cli.document import Permissions
from deepbots_cli.port import ZERO_VECTOR
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.runtime.copies import copy_name
from deepbots_webots import supervisor
from deepbots_webots.bridge.mirror import MirrorEngine
from deepbots_webots.bridge.robot import RobotDevices
from deepbots_webots.devices import device_object
from deepbots_webots.export.command import WebotsProject, prepare, project_files
from deepbots_webots.project import Files, World, read_world, world_of_source
from deepbots_webots.runner import SITE
from deepbots_webots.scene import build_scene
from deepbots_webots.simulation import Simulation
from deepbots_webots.tree import Node

ROOT = Path(__file__).parents[2]
STAND_IN = Path(__file__).parent / "stand_in"
"""Two classes in place of the package `deepbots`, where it is not installed."""

REPLAY = '''
import json, sys
from pathlib import Path
from webots_environment import {name}Environment

class Replay({name}Environment):
    """Notes all messages."""
    texts = []
    def handle_emitter(self, cells):
        self.texts.append([self.robot, "to", ",".join(map(str, cells))])
        super().handle_emitter(cells)
    def send_to(self, robot, cells):
        self.robot = robot
        super().send_to(robot, cells)
    def receive_from(self, robot):
        cells = super().receive_from(robot)
        if cells is not None:
            self.texts.append([robot, "from", ",".join(cells)])
        return cells

import numpy as np
def plain(value):
    return np.asarray(value).tolist()

work = json.loads(Path({actions!r}).read_text())
environment, log = Replay(), []
for seed, actions in work:
    observation, first = environment.reset(seed=seed), len(log)
    environment.texts.clear()
    log.append([plain(observation), None, False, None, []])
    for action in actions:
        observation, reward, done, info = environment.step(
            np.asarray(action, environment.action_space.dtype) if isinstance(action, list) else action
        )
        log.append([plain(observation), reward, done, info["ended_by"], list(environment.texts)])
        environment.texts.clear()
        if done:
            break
Path({log!r}).write_text(json.dumps(log))
'''


def exported(name: str, folder: Path, *overrides: str) -> WebotsProject:
    """Write the project of a scenario to a folder."""
    prepared = prepare(Source.open(name, Permissions(), SourceKind.SCENARIO), overrides)
    write_new(project_files(prepared), folder, force=True)
    return prepared


def run_exported(prepared: WebotsProject, folder: Path, episodes: Sequence[Any]) -> list[Any]:
    """Run episodes, each a seed and its actions, by `deepbots webots` with the controllers of the project.

    Returns:
        A row for each reset and step: observation, reward, whether it ended, by what, and the messages.
    """
    actions, log = folder / "actions.json", folder / "log.json"
    actions.write_text(json.dumps(episodes))
    program = prepared.compiled.program
    run_supervisor(folder, REPLAY.format(name=program.name, actions=str(actions), log=str(log)))
    return json.loads(log.read_text())


def run_supervisor(folder: Path, code: str) -> None:
    """Run an exported project with this code as its supervisor."""
    (folder / "controllers/supervisor/supervisor.py").write_text(code)
    packages = [ROOT] if importlib.util.find_spec("deepbots") else [ROOT, STAND_IN]
    ran = subprocess.run(
        [sys.executable, "-m", "deepbots_cli", "webots", str(world_of(folder)), "--allow-code"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, packages))},
        timeout=600,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr


def world_of(folder: Path) -> Path:
    """Return the world of an exported project."""
    (world,) = (folder / "worlds").iterdir()
    return world


def simulation_of(world: World) -> Simulation:
    """Return the simulation of a world without errors."""
    scene = build_scene(world)
    world.findings.require_none()
    return Simulation(scene, world.span)


class PlantEngine(MirrorEngine):
    """The physics of an exported world as an engine of its scenario, motors included."""

    def __init__(self, engine: Any, simulation: Simulation, world: Any) -> None:
        simulation.current = next(robot for robot in simulation.scene.robots if robot.is_supervisor)
        supervisor.activate(simulation)
        super().__init__(engine, supervisor.Supervisor(), world)
        self._robots = {robot.name: robot for robot in simulation.scene.robots}
        self._simulation = simulation

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> Any:
        devices = self._robots[robot].devices
        by_name = SimpleNamespace(getDevice=lambda name: device_object(self._simulation, devices[name]))
        return RobotDevices(by_name, 1.0, ZERO_VECTOR).velocity_motor(robot, joints, max_torque)


def run_scenario(prepared: WebotsProject, folder: Path, episodes: Sequence[Any]) -> list[Any]:
    """Run the same episodes in the environment of the scenario; the rows are those of `run_exported`."""
    simulation = simulation_of(read_world(world_of(folder)))
    sys.path.insert(0, str(SITE))
    try:
        environment = api.build(
            prepared.compiled.program,
            engine="mujoco",
            wrap=lambda engine: PlantEngine(engine, simulation, prepared.project.world),
        )
        return play(environment, episodes)
    finally:
        supervisor.deactivate()
        sys.path.remove(str(SITE))


def play(environment: Any, episodes: Sequence[Any]) -> list[Any]:
    """Run episodes in an environment of a scenario."""
    texts: list[Any] = []
    _note_messages(environment, texts)
    rows: list[Any] = []

    def note(observation: Any, reward: float | None, done: bool, ended_by: Any) -> None:
        rows.append([np.asarray(observation).tolist(), reward, done, ended_by, list(texts)])
        texts.clear()

    for seed, actions in episodes:
        observation, _ = environment.reset(seed=seed)
        environment.engine.is_starting = False
        note(observation, None, False, None)
        for action in actions:
            typed_action = (
                np.asarray(action, environment.action_space.dtype) if isinstance(action, list) else action
            )
            observation, reward, terminated, truncated, info = environment.step(typed_action)
            note(observation, reward, terminated or truncated, info["ended_by"])
            if terminated or truncated:
                break
    return rows


def _note_messages(environment: Any, texts: list[Any]) -> None:
    copies = environment.scenario.agent.copies
    for number, agent in enumerate(environment.agents.values()):
        for (robot, direction), channel in agent.channels.items():
            name = robot if copies is None or robot != copies.robot else copy_name(copies, number + 1)
            path = (name, direction.partition("_")[0])
            channel.transmit = partial(_note, texts, path, channel.transmit)


def _note(texts: list[Any], path: tuple[str, str], send: Any, text: str) -> None:
    texts.append([*path, text])
    send(text)


HEADER = "#VRML_SIM R2023b utf8\n"
FLOOR = "Solid { boundingObject Plane { } }"


def read(text: str, folder: Path = Path("/nowhere")) -> World:
    """Return the world of a text; `folder` is that of its project."""
    text = text if text.startswith("#") else HEADER + text
    path = folder / "worlds" / "world.wbt"
    return world_of_source(diagnostics.Source("world.wbt", text), path, Files(folder))


def simulate(text: str, step: int = 8, axes: str = "ENU", **info: object) -> Simulation:
    """Return a world of `step` ms that runs; `info` are further fields of its WorldInfo. With NUE, a pose turns
    the text, whose axes are east, north and up."""
    if axes == "NUE":
        text = f"Pose {{ rotation 1 1 1 -2.0943951 children [ {text} ] }}"
        info["coordinateSystem"] = '"NUE"'
    fields = " ".join(f"{name} {value}" for name, value in {"basicTimeStep": step, **info}.items())
    return simulation_of(read(f"WorldInfo {{ {fields} }} {text}"))


def enu(values: Sequence[float], axes: str) -> list[float]:
    """Return vectors in east, north and up."""
    triples = [values[at : at + 3] for at in range(0, len(values), 3)]
    return [triple[index] for triple in triples for index in ((0, 1, 2) if axes == "ENU" else (2, 0, 1))]


def run(simulation: Simulation, seconds: float) -> None:
    for _ in range(round(seconds * 1000 / simulation.basic_step)):
        simulation.run_step()


def node(simulation: Simulation, name: str) -> Node:
    """Return the node of a DEF name, as a supervisor gets it."""
    from deepbots_webots.nodes import walk

    return Node(simulation, next(entry for entry in walk(simulation.scene.nodes) if entry.name == name))


def device(simulation: Simulation, name: str, robot: int = 0):
    """Return a device of a robot."""
    return device_object(simulation, simulation.scene.robots[robot].devices[name])


def turning(simulation: Simulation, velocity: float, name: str = "rotational motor"):
    """Return a motor of the first robot under velocity control."""
    motor = device(simulation, name)
    motor.setPosition(inf)
    motor.setVelocity(velocity)
    return motor


def solid(shape: str, fields: str = "", mass: float = 1.0, name: str = "BODY") -> str:
    """Return a solid with a bounding object and a mass (kg)."""
    return (
        f"DEF {name} Solid {{ {fields} boundingObject {shape} physics Physics {{ density -1 mass {mass} }} }}"
    )


ROD_INERTIA = 2 * (1**2 + 0.02**2) / 12 + 2 * 0.5**2
"""Of the rod of `hinge`, about the hinge, kg m^2."""


def hinge(parameters: str = "", devices: str = "", end: str = "", kind: str = "HingeJoint") -> str:
    """Return a robot whose only joint is at its origin, about y; the end point is a rod of 1 m along x."""
    rod = end or "boundingObject Pose { translation 0.5 0 0 children [ Box { size 1 0.02 0.02 } ] }"
    axis = "JointParameters { axis 1 0 0" if kind == "SliderJoint" else "HingeJointParameters { axis 0 1 0"
    return f"""DEF ROBOT Robot {{ children [ DEF JOINT {kind} {{
      jointParameters DEF PARAMETERS {axis} {parameters} }} device [ {devices} ]
      endPoint DEF ROD Solid {{ {rod} physics DEF PHYSICS Physics {{ density -1 mass 2 }} }} }} ] }}"""
