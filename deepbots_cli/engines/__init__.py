"""Physics engines behind the port.

pybullet/      the only package that imports PyBullet: contacts, sight, any tree of joints
quiet.py       what a native library prints, kept off the terminal

solids.py      objects and walls as one-link robots
kinematics.py  inverse kinematics of chains of joints
lookup.py      things by name

An engine is imported when it is first used. Other packages add theirs as an entry point of the group
`deepbots_cli.engines`: a name, and the `module:attribute` of an `EngineFactory`.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, cast

from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.errors import MissingExtraError, UsageError

if TYPE_CHECKING:
    from deepbots_cli.port import Engine, EngineFactory
    from deepbots_cli.program.world import WorldModel

ENGINES = {
    "pybullet": "deepbots_cli.engines.pybullet:PyBulletEngine",
}
_OF_EXTRA_SIM = ("pybullet", "numpy", "trimesh", "yourdfpy")


def names() -> tuple[str, ...]:
    """Every engine that can be asked for, our own first."""
    return tuple(dict.fromkeys([*ENGINES, *(entry.name for entry in entry_points(group="deepbots_cli.engines"))]))


def create(name: str, world: WorldModel) -> Engine:
    """The world, built in the engine called `name`.

    Raises:
        MissingExtraError: The engine's library is not installed.
        UsageError: No engine has this name; lists those there are.
        EngineError: The engine cannot hold this world.
    """
    try:
        return _factory(name)(_with_masses(world))
    except ModuleNotFoundError as error:
        if error.name in _OF_EXTRA_SIM:
            raise MissingExtraError("sim", "running a scenario") from error
        raise


def _with_masses(world: WorldModel) -> WorldModel:
    """The world with a mass on each link that has a density instead."""
    if all(link.density is None for robot in world.robots for link in robot.model.links):
        return world
    from deepbots_cli.geometry import with_masses

    return replace(world, robots=tuple(replace(robot, model=with_masses(robot.model)) for robot in world.robots))


def _factory(name: str) -> EngineFactory:
    if name in ENGINES:
        module, _, attribute = ENGINES[name].partition(":")
        return cast("EngineFactory", getattr(import_module(module), attribute))
    for entry in entry_points(group="deepbots_cli.engines", name=name):
        return cast("EngineFactory", entry.load())
    near = nearest(name, names())
    hint = f"; did you mean '{near}'?" if near else ""
    raise UsageError(f"there is no engine '{name}'; there are {', '.join(names())}{hint}")
