"""The physics engines by name, with their requirements and limitations. An engine is imported only when it is
used.

Other packages add an engine by an entry point of the group `deepbots.engines`, whose name is the word under
`world.engine`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from typing import Literal, NamedTuple

from deepbots_cli import plugins

ENTRY_POINT_GROUP = "deepbots.engines"


class Limitation(NamedTuple):
    """A feature that an engine does not support, and what to use instead. It is data, so that linting can
    report it without importing the engine."""

    reason: str
    help: str


Feature = Literal["armature", "center_of_mass", "joint_wrench", "self_collision", "torque_curve"]
"""A capability of an engine that a scenario may need."""
_LIMITATIONS: Mapping[Feature, Limitation] = {
    "armature": Limitation(
        "a joint cannot have an armature in {engine}",
        "remove `armature`, or use the engine `mujoco`",
    ),
    "center_of_mass": Limitation(
        "the center of mass of a link cannot be drawn in {engine}",
        "write a fixed `com`, or use the engine `mujoco`",
    ),
    "joint_wrench": Limitation(
        "the force and the torque in a joint cannot be measured in {engine}",
        "use `joint_torque` or `force`, or the engine `pybullet` or `mujoco`",
    ),
    "self_collision": Limitation(
        "links of one robot cannot touch each other in {engine}",
        "remove `self_collision`, or use the engine `pybullet` or `mujoco`",
    ),
    "torque_curve": Limitation(
        "the torque of a motor cannot fall with its speed in {engine}",
        "remove `stall_torque` and `no_load_speed`, or use the engine `pybullet` or `mujoco`",
    ),
}
MAX_PYBULLET_JOINTS = 127
"""The joints of a robot in PyBullet; those of a larger one cannot be read."""
Diagonal = Literal["falling", "rising"]
"""The diagonal of a cell of the ground, seen from above, x to the right and y up."""


class EngineKind(NamedTuple):
    """A physics engine: `factory` is the `module:attribute` of a `port.EngineFactory`, `library` the module
    that it imports, `batch` the `module:attribute` of its batches (many worlds of one model at once).

    `last_python` is the last Python that the library is built for; `on_windows` is true if it is built for
    Windows. `mesh_terrain` is the reason why a mesh cannot be the ground, None if it can.
    `implausible_inertia` is the reason why a link cannot have an inertia that no rigid body has, None if it
    can. `diagonal` divides each cell of a ground with heights into two triangles, and `lacks` are the
    capabilities that our own engine lacks.
    """

    summary: str
    title: str
    factory: str
    library: str | None = None
    batch: str | None = None
    last_python: tuple[int, int] | None = None
    on_windows: bool = True
    mesh_terrain: Limitation | None = None
    implausible_inertia: Limitation | None = None
    diagonal: Diagonal = "falling"
    lacks: tuple[Feature, ...] = ()

    def supports(self, capability: str) -> bool:
        """Return whether it has a capability. For an engine of another package this imports it, and reads its
        `capabilities`."""
        if self.library is not None:
            return capability not in self.lacks
        try:
            return capability in plugins.import_attribute(self.factory).capabilities
        except Exception:  # noqa: BLE001 - of a plug-in; building the world raises it again
            return True

    def limitation(self, feature: Feature) -> Limitation:
        """Return the limitation of an engine that does not support a feature."""
        reason, help = _LIMITATIONS[feature]
        engine = self.title if self.library is not None else f"the engine `{self.title}`"
        return Limitation(reason.format(engine=engine), help)

    @property
    def is_installed(self) -> bool:
        """Whether its library can be found; true for an engine of another package."""
        if self.library is None:
            return True
        if self.library in sys.modules:  # None there: a program that forbids it
            return sys.modules[self.library] is not None
        # `find_spec` does not import the library.
        return find_spec(self.library) is not None

    @property
    def missing(self) -> str:
        """The reason why its library is missing, as far as it is known."""
        here = sys.version_info[:2]
        if sys.platform == "win32" and not self.on_windows:
            return f"{self.title} has no build for Windows"
        if self.last_python is not None and here > self.last_python:
            return f"{self.title} has no build for Python {here[0]}.{here[1]}"
        return f"{self.title} is not installed"

    @property
    def help(self) -> str:
        """The way to install it, or the engine to use instead."""
        others = [name for name, kind in ENGINES.built_in.items() if kind is not self and kind.is_installed]
        instead = f", or the engine `{others[0]}`" if others else ""
        if others and sys.platform == "win32" and not self.on_windows:
            return f"use the engine `{others[0]}`"
        if self.last_python is not None and sys.version_info[:2] > self.last_python:
            return f"use Python {self.last_python[0]}.{self.last_python[1]}{instead}"
        return f"install it with: pip install {self.library}{instead}"


def _of_another_package(name: str, place: str) -> Iterator[tuple[str, EngineKind]]:
    yield name, EngineKind(f"Of {place}.", name, place)


DEFAULT_ENGINE = "pybullet"
PHYSICS = 2
"""The version of the simulated physics. It is raised when the same scenario moves differently."""
OTHER_ENGINES = "use the engine `pybullet` or `mujoco`"
ENGINES: plugins.PluginTable[EngineKind] = plugins.PluginTable(
    ENTRY_POINT_GROUP,
    {
        "pybullet": EngineKind(
            "PyBullet, the default where it is installed.",
            "PyBullet",
            "deepbots_cli.engines.pybullet.engine:PyBulletEngine",
            library="pybullet",
            lacks=("armature", "center_of_mass"),
            last_python=(3, 11),
            on_windows=False,
        ),
        "mujoco": EngineKind(
            "MuJoCo, several times as fast.",
            "MuJoCo",
            "deepbots_cli.engines.mujoco.engine:MuJoCoEngine",
            library="mujoco",
            batch="deepbots_cli.engines.mujoco.batch:MuJoCoBatch",
            diagonal="rising",
            mesh_terrain=Limitation(
                "a mesh cannot be the ground in MuJoCo, which uses the convex hull of a mesh",
                "use a terrain of heights (heightfield, formula or pit), or the engine `pybullet`",
            ),
            implausible_inertia=Limitation(
                "has an inertia that no rigid body can have, which MuJoCo refuses",
                "in its <inertia>, make each principal moment above 0 and at most the sum of the other two,"
                " or use the engine `pybullet`",
            ),
        ),
    },
    _of_another_package,
    imports=False,
)


def diagonal_of(engine: str) -> Diagonal:
    """Return the diagonal along which an engine divides the cells of the ground; that of PyBullet for an
    engine of another package."""
    kind = ENGINES.built_in.get(engine)
    return "falling" if kind is None else kind.diagonal


def with_engine(overrides: Iterable[str] | None, engine: str | None) -> list[str]:
    """Return the assignments of `--set` followed by that of `--engine`, so that the scenario is checked for
    this engine."""
    # The last assignment to a path wins.
    return [*(overrides or ()), *([] if engine is None else [f"world.engine={engine}"])]


def chosen(name: str | None) -> str:
    """Return the engine of this name, or the default one: PyBullet if it is installed, else the first
    installed engine.

    Results of two engines differ, so another default than PyBullet is reported by a warning, once per
    process.
    """
    return name if name is not None else _default()


@cache
def _default() -> str:
    # Without any engine, the error of the default one explains how to install it.
    engine = next((name for name, kind in ENGINES.built_in.items() if kind.is_installed), DEFAULT_ENGINE)
    if engine != DEFAULT_ENGINE:
        import logging

        usual = ENGINES.built_in[DEFAULT_ENGINE]
        logging.getLogger("deepbots").warning(
            "note: %s; this runs on %s, which gives different returns than %s (choose an engine with --engine"
            " or world.engine)",
            usual.missing,
            ENGINES.built_in[engine].title,
            usual.title,
        )
    return engine
