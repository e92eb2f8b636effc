"""Physics engines behind the port.

mechanics.py   bodies by name, objects as robots, masses, the torque of DC motors, inverse kinematics
pybullet/      the only package that imports PyBullet: contacts, sight, any tree of joints
mujoco/        the only package that imports MuJoCo: the same, and exact snapshots

An engine is imported when it is first used. `deepbots_cli.engine_kinds` has the table of engines. Other
packages add theirs as an entry point of the group `deepbots.engines`: a name, and the `module:attribute` of
an `EngineFactory`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

from deepbots_cli import plugins
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.engine_kinds import ENGINES as ALL
from deepbots_cli.engine_kinds import ENTRY_POINT_GROUP, OTHER_ENGINES
from deepbots_cli.errors import BatchError, EngineError, MissingExtraError, UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from importlib.metadata import EntryPoint

    from deepbots_cli.engine_kinds import Feature
    from deepbots_cli.port import BatchEngine, Engine, EngineFactory
    from deepbots_cli.program.world import WorldModel

ENGINES = ALL.built_in
"""Our own engines."""
BATCHES = {name: kind.batch for name, kind in ENGINES.items() if kind.batch is not None}
"""The engines that step many worlds of one model at once."""
_OF_EXTRA_SIM = ("pybullet", "mujoco", "numpy", "trimesh", "yourdfpy")


def names() -> tuple[str, ...]:
    """Return the names of all engines, those of deepbots first."""
    return tuple(ALL)


def create(name: str, world: WorldModel) -> Engine:
    """Return the world, built in the engine called `name`.

    Raises:
        MissingExtraError: The libraries that worlds need are not installed.
        UsageError: No engine has this name, or its library is not installed; the message lists the engines.
        EngineError: The engine cannot build this world.
    """
    try:
        engine = _factory(name)(_with_masses(world))
    except ModuleNotFoundError as error:
        kind = ENGINES.get(name)
        if (
            kind is not None
            and error.name == kind.library
            and any(candidate.is_installed for candidate in ENGINES.values())
        ):
            raise UsageError(f"the engine '{name}' cannot be used: {kind.missing}; {kind.help}") from error
        if error.name in _OF_EXTRA_SIM:
            raise MissingExtraError("sim", "running a scenario") from error
        raise
    follower = next(
        (f"'{joint}' of '{robot.name}'" for robot in world.robots for joint in robot.model.followers), None
    )
    if follower is not None and "mimic" not in engine.capabilities:
        # A world of PyBullet takes about 29 MB until it is closed.
        engine.close()
        raise EngineError(
            f"the engine '{name}' does not move joints that follow others (<mimic>), such as {follower};"
            f" {OTHER_ENGINES}"
        )
    for feature, needing in _features(world):
        if feature not in engine.capabilities:
            engine.close()
            reason, help = ALL[name].limitation(feature)
            raise EngineError(f"{reason}, such as {needing}; {help}")
    return engine


def _features(world: WorldModel) -> Iterator[tuple[Feature, str]]:
    """Yield each feature of an engine that the world needs, with the part that needs it."""
    for robot in world.robots:
        for joint in (joint for joint in robot.model.joints if joint.armature > 0.0):
            yield "armature", f"'{joint.name}' of '{robot.name}'"
        for link in (link for link in robot.model.links if link.center_varies):
            yield "center_of_mass", f"'{link.name}' of '{robot.name}'"


def create_batch(name: str, world: WorldModel, count: int) -> BatchEngine:
    """Return `count` worlds in the engine called `name`.

    Raises:
        MissingExtraError: The engine's library is not installed.
        BatchError: The engine has single worlds only.
        EngineError: The engine cannot build this world.
    """
    if name not in BATCHES:
        raise BatchError(f"the engine '{name}' has no batches of worlds; use one of {', '.join(BATCHES)}")
    try:
        return cast("BatchEngine", plugins.import_attribute(BATCHES[name])(_with_masses(world), count))
    except ModuleNotFoundError as error:
        if error.name in _OF_EXTRA_SIM:
            raise MissingExtraError("sim", "running a scenario") from error
        raise


def _with_masses(world: WorldModel) -> WorldModel:
    """Return the world with a mass on each link that has a density instead."""
    if all(link.density is None for robot in world.robots for link in robot.model.links):
        return world
    from deepbots_cli.geometry import with_masses

    return replace(
        world, robots=tuple(replace(robot, model=with_masses(robot.model)) for robot in world.robots)
    )


def _factory(name: str) -> EngineFactory:
    if name in ENGINES:
        return cast("EngineFactory", plugins.import_attribute(ENGINES[name].factory))
    for entry in plugins.entry_points_of(ENTRY_POINT_GROUP):
        if entry.name == name:
            return _plugin_engine(entry)
    suggestion = nearest_word(name, names())
    hint = f"; did you mean '{suggestion}'?" if suggestion else ""
    raise UsageError(f"there is no engine '{name}'; there are {', '.join(names())}{hint}")


def _plugin_engine(entry: EntryPoint) -> EngineFactory:
    try:
        factory = entry.load()
        if not callable(factory):
            raise TypeError("it does not make an engine")
    except Exception as error:  # the import of another package may raise anything
        if isinstance(error, ModuleNotFoundError) and error.name in _OF_EXTRA_SIM:
            raise
        raise UsageError(plugins.unavailable_message(entry, error)) from error
    return cast("EngineFactory", factory)
