"""A case of the table: a small world, what is read of it in an engine, and the number of its closed form.

Worlds are models (`opened`) or texts of scenarios (`trial`). The engine `batch` is the second of two worlds
of a MuJoCo batch, and `webots` a world of Webots in MuJoCo with the same objects; `webots-NUE` is another
with these axes.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from deepbots_cli import api, frames
from deepbots_cli.engines import create, create_batch
from deepbots_cli.program.world import WorldModel
from deepbots_cli.robots.model import Mesh
from deepbots_webots import supervisor
from deepbots_webots.bridge.mirror import MirrorEngine
from deepbots_webots.export.world import NodeText, WorldWriter, node, world_text
from deepbots_webots.nodes import axis_angle
from deepbots_webots.scene import build_scene
from deepbots_webots.simulation import Simulation
from tests.webots.exported_projects import read

Array = np.ndarray[Any, Any]
G = 9.81
PORT = ("pybullet", "mujoco", "batch")
ALL = (*PORT, "webots")
NUE = "webots-NUE"
FOLDER = tempfile.TemporaryDirectory(prefix="physics-")
"""Files of scenarios and meshes, until the process ends."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """A number that is read, in `unit`: it is `truth`, give or take `tolerance`, in every engine."""

    what: str
    truth: float
    unit: str
    tolerance: float
    engines: tuple[str, ...] = ALL
    """Those that can read it."""

    def is_met(self, measured: float) -> bool:
        return abs(measured - self.truth) <= self.tolerance


def near(what: str, truth: float, unit: str, percent: float) -> Quantity:
    """A number within some percent of the truth."""
    return Quantity(what, truth, unit, abs(truth) * percent / 100)


def most(what: str, limit: float, unit: str) -> Quantity:
    """An error, at most `limit`."""
    return Quantity(what, 0.0, unit, limit)


@dataclass(frozen=True, eq=False)
class Case:
    """`run` takes the name of an engine, and returns the numbers of the quantities in their order."""

    name: str
    run: Callable[[str], Sequence[float]]
    quantities: tuple[Quantity, ...]
    engines: tuple[str, ...] = PORT


@cache
def measured(case: Case, engine: str) -> dict[str, float]:
    """Return the measured numbers by the names of the quantities."""
    numbers = map(float, case.run(engine))
    return dict(zip((quantity.what for quantity in case.quantities), numbers, strict=True))


# Worlds as models


class WebotsEngine:
    """The objects and the ground of a world as a world of Webots: the methods of the port that cases need,
    with vectors to the east, north and up."""

    def __init__(self, world: WorldModel, engine: str) -> None:
        project: Any = SimpleNamespace(
            world=world,
            robots={},
            program=SimpleNamespace(name=""),
            timestep_ms=round(world.timestep * 1000),
        )
        info, *nodes = WorldWriter(project, {}, {}, "").nodes()
        self._turn = frames.IDENTITY_ROTATION
        if engine == NUE:
            self._turn = (-0.5, -0.5, -0.5, 0.5)
            info = NodeText(f'{info[:-1]} coordinateSystem "NUE" }}')
            nodes = [node("Pose", rotation=tuple(axis_angle(self._turn)), children=nodes)]
        scene_world = read(world_text([info, *nodes]))
        scene = build_scene(scene_world)
        scene_world.findings.require_none()
        self._simulation = Simulation(scene, scene_world.span)
        (self._simulation.current,) = scene.robots
        supervisor.activate(self._simulation)
        self._mirror = MirrorEngine(create("mujoco", world), supervisor.Supervisor(), world)

    def place(self, body: str, position: Any, orientation: Any, *velocities: Any) -> None:
        turned = (frames.rotate(self._turn, velocity) for velocity in velocities)
        self._mirror.place(body, position, orientation, *turned)

    def reset(self) -> None:
        self._simulation.physics.reset()

    def pose(self, body: str) -> Callable[[], Any]:
        return lambda: self._motion(body)[:2]

    def velocity(self, body: str) -> Callable[[], Any]:
        return lambda: self._motion(body)[2:]

    def _motion(self, body: str) -> tuple[Any, ...]:
        position, orientation, *velocities = self._mirror.motion_of(body)
        turned = frames.multiply(frames.inverse(self._turn), orientation)
        east_position, *east_velocities = (
            frames.rotate_back(self._turn, each) for each in (position, *velocities)
        )
        return east_position, turned, *east_velocities

    def contact_force(self, _: object) -> Callable[[], float]:
        return lambda: float("nan")

    def step(self, substeps: int) -> None:
        for _ in range(substeps):
            self._simulation.run_step()

    def close(self) -> None:
        supervisor.deactivate()


class Bench:
    """A world in an engine of the port, after a reset."""

    def __init__(self, engine: str, world: WorldModel) -> None:
        self.timestep = world.timestep
        self.batch = create_batch("mujoco", world, 2) if engine == "batch" else None
        self.engine: Any = WebotsEngine(world, engine) if engine in ("webots", NUE) else None
        self.engine = self.engine or (self.batch.members[1] if self.batch else create(engine, world))
        self.substeps = world.substeps
        self.reset()

    def reset(self) -> None:
        for engine in self.batch.members if self.batch else (self.engine,):
            engine.reset()
        self._has_begun = False

    def place(
        self,
        body: str,
        position: Sequence[float] = (0, 0, 0),
        rpy: Sequence[float] = (0, 0, 0),
        velocity: Sequence[float] = (0, 0, 0),
        spin: Sequence[float] = (0, 0, 0),
    ) -> None:
        self.engine.place(body, tuple(position), frames.quaternion(*rpy), tuple(velocity), tuple(spin))

    def read(self, reader: str, *of: Any, **options: Any) -> Callable[[], Any]:
        """Return a reader of the port; the name is that of its method."""
        bound = getattr(self.batch or self.engine, reader)(*of, **options)

        def read_second() -> Any:
            self._begin()
            return _of_second(bound())

        return read_second if self.batch else bound

    def motor(self, motor: str, *of: Any) -> Any:
        """Return a writer of motors; the name is that of its method."""
        return getattr(self.engine, motor)(*of)

    def _begin(self) -> None:
        if self.batch and not self._has_begun:
            self.batch.begin_episodes()
            self._has_begun = True

    def step(self, timesteps: int = 1) -> None:
        self._begin()
        for _ in range(timesteps):
            (self.batch or self.engine).step(self.substeps)

    def record(self, timesteps: int, look: Callable[[], Any]) -> Array:
        """Return what is seen after each of some timesteps."""
        rows = []
        for _ in range(timesteps):
            self.step()
            rows.append(look())
        return np.array(rows)

    def close(self) -> None:
        (self.batch or self.engine).close()


def _of_second(columns: Any) -> Any:
    """Return the numbers of the second world of nested columns."""
    is_column = isinstance(columns, np.ndarray) and columns.ndim == 1
    return columns[1] if is_column else tuple(map(_of_second, columns))


@contextmanager
def opened(engine: str, world: WorldModel) -> Iterator[Bench]:
    """Open a world in an engine."""
    with closing(Bench(engine, world)) as bench:
        yield bench


def mesh(name: str, text: str, scale: float = 1.0) -> Mesh:
    """Write a mesh file, and return it as a shape."""
    path = Path(FOLDER.name) / name
    path.write_text(text, encoding="utf-8")
    return Mesh(str(path), hashlib.sha256(path.read_bytes()).hexdigest(), (scale, scale, scale))


# Worlds as texts of scenarios

TEXT = """\
deepbots: 1
name: Trial
world: {{timestep: {timestep}, substeps: {substeps}{world}}}
objects: {{{objects}}}
robots: {{{robots}}}
action: {{push: -1 .. 1}}
augment: {{{augment}}}
observation: {{{observation}}}
reward: {{one: 1}}
truncation: {{max_steps: 1_000_000}}
reset: {{{reset}}}
disturbances: {{{disturbances}}}
"""
BYSTANDER = (
    "bystander: {urdf: cartpole_rail, base: fixed, pose: {x: 50 m, z: 50 m},"
    " actuators: {motor: {type: torque_motor, joint: slider}}, apply: {motor: push * 0 N}}"
)
"""A scenario has an action; this robot takes it where no other does."""


@dataclass(frozen=True)
class Trial:
    """A scenario that is running; its rows are in the units that the scenario names, one column for each
    thing seen."""

    environment: Any
    timestep: float
    is_batch: bool

    def run(self, ticks: int, push: float = 0.0, seed: int = 0) -> Array:
        """The observations after the reset and after each of some ticks, float64[ticks + 1, columns]."""
        action = np.full((2, 1) if self.is_batch else 1, push, np.float32)
        rows = [self.environment.reset(seed=seed)[0]]
        rows += [self.environment.step(action)[0] for _ in range(ticks)]
        return np.array([row[1] if self.is_batch else row for row in rows], np.float64)

    def times(self, ticks: int) -> Array:
        return self.timestep * np.arange(ticks + 1)


def flow(entries: Mapping[str, str]) -> str:
    return ", ".join(f"{name}: {value}" for name, value in entries.items())


@cache
def compiled(text: str, files: tuple[tuple[str, str], ...]) -> api.Compiled:
    folder = Path(tempfile.mkdtemp(dir=FOLDER.name))
    (folder / "pyproject.toml").touch()
    for file, content in (("trial.yaml", text), *files):
        (folder / file).write_text(content, encoding="utf-8")
    return api.compile(folder / "trial.yaml")


@contextmanager
def trial(
    engine: str,
    see: dict[str, tuple[str, str]],
    *,
    timestep: float = 0.02,
    substeps: int = 4,
    world: str = "",
    objects: str = "",
    robot: str = "",
    reset: str = "",
    disturbances: str = "",
    files: Mapping[str, str] = {},
) -> Iterator[Trial]:
    """Open a scenario with a robot `subject`, or without one.

    `see` gives each thing that is seen its expression and unit; one whose name has a dot is a field of a
    message.
    """
    robots = [*([f"subject: {{{robot}}}"] if robot else []), *([] if "apply:" in robot else [BYSTANDER])]
    text = TEXT.format(
        timestep=f"{timestep!r} s",
        substeps=substeps,
        world=world and f", {world}",
        objects=objects,
        robots=", ".join(robots),
        augment=flow({name: f"'{expression}'" for name, (expression, _) in see.items() if "." not in name}),
        observation=flow(
            {name: f"{{range: -1 .. 1{unit and ' ' + unit}, clip: false}}" for name, (_, unit) in see.items()}
        ),
        reset=reset,
        disturbances=disturbances,
    )
    program = compiled(text, tuple(files.items()))
    made = api.make_vec(program, 2) if engine == "batch" else api.make(program, engine=engine)
    with closing(made) as environment:
        yield Trial(environment, timestep, engine == "batch")
