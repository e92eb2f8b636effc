"""Worlds of Webots as texts, and what tests do with them."""

from __future__ import annotations

from pathlib import Path

from deepbots_cli.diagnostics import Source
from deepbots_cli.webots.devices import device_object
from deepbots_cli.webots.project import Files, World, world_of_source
from deepbots_cli.webots.scene_builder import build_scene
from deepbots_cli.webots.simulation import Simulation
from deepbots_cli.webots.tree import Node

HEADER = "#VRML_SIM R2023b utf8\n"
FLOOR = "Solid { boundingObject Plane { } }"


def read(text: str, folder: Path = Path("/nowhere")) -> World:
    """Return the world of a text; `folder` is that of its project."""
    text = text if text.startswith("#") else HEADER + text
    path = folder / "worlds" / "world.wbt"
    return world_of_source(Source("world.wbt", text), path, Files(folder))


def simulate(text: str, step: int = 8, **info: object) -> Simulation:
    """Return a world of `step` ms that runs; `info` are further fields of its WorldInfo."""
    fields = " ".join(f"{name} {value}" for name, value in {"basicTimeStep": step, **info}.items())
    world = read(f"WorldInfo {{ {fields} }} {text}")
    scene = build_scene(world)
    world.findings.require_none()
    return Simulation(scene, world.span)


def run(simulation: Simulation, seconds: float) -> None:
    for _ in range(round(seconds * 1000 / simulation.basic_step)):
        simulation.run_step()


def node(simulation: Simulation, name: str) -> Node:
    """Return the node of a DEF name, as a supervisor gets it."""
    from deepbots_cli.webots.nodes import walk

    return Node(simulation, next(entry for entry in walk(simulation.scene.nodes) if entry.name == name))


def device(simulation: Simulation, name: str, robot: int = 0):
    """Return a device of a robot."""
    return device_object(simulation, simulation.scene.robots[robot].devices[name])


def solid(shape: str, fields: str = "", mass: float = 1.0, name: str = "BODY") -> str:
    """Return a solid with a bounding object and a mass (kg)."""
    return (
        f"DEF {name} Solid {{ {fields} boundingObject {shape} physics Physics {{ density -1 mass {mass} }} }}"
    )


def hinge(parameters: str = "", devices: str = "", end: str = "", kind: str = "HingeJoint") -> str:
    """Return a robot whose only joint is at its origin, about y; the end point is a rod of 1 m along x."""
    rod = end or "boundingObject Pose { translation 0.5 0 0 children [ Box { size 1 0.02 0.02 } ] }"
    axis = "JointParameters { axis 1 0 0" if kind == "SliderJoint" else "HingeJointParameters { axis 0 1 0"
    return f"""DEF ROBOT Robot {{ children [ DEF JOINT {kind} {{
      jointParameters DEF PARAMETERS {axis} {parameters} }} device [ {devices} ]
      endPoint DEF ROD Solid {{ {rod} physics DEF PHYSICS Physics {{ density -1 mass 2 }} }} }} ] }}"""
