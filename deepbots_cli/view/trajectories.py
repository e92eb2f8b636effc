"""Trajectories: the moving parts of an episode and their paths, for pictures and reports.

The parts are chosen by the task: the bodies that the goal or a success reads, those that the reward reads,
those that a failure or the observation reads, and then the other robots. A free robot moves as its root link.
A robot with a fixed base moves as the links that the goal or a success reads, or else as the first link that
the task reads and that moves, or else as the link that goes farthest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.analysis import Analysis
from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar
from deepbots_cli.program import Program
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.view.frames import FrameLayout, LinkName, WorldFrame

Positions = Mapping[LinkName, NDArray[np.float64]]
"""The position of each link of each body, step by step: shape (n, 3) in m, nan while it was absent. The key
`("", agent)` is the goal of an agent."""

MAX_TRAJECTORIES = 8
_MIN_EXTENT_M = 1e-3  # m; a part that moves less stands still
_MIN_SHARE = 0.02  # share of the longest trajectory; a shorter one is a dot
_MIN_SHARE_OF_ROBOT = 0.1  # share of the path of the link that goes farthest


class Moving(NamedTuple):
    """The drawn parts of an episode: the parts that move, the one of the task first, and their goals."""

    parts: tuple[LinkName, ...]
    targets: tuple[LinkName, ...]


class _Subject(NamedTuple):
    """A body, and one of its links or joints (empty for the body as a whole), that the task reads.

    `rank` is 0 for a part that the goal or a success reads, 1 for the reward, 2 for anything else.
    """

    body: str
    part: str
    rank: int


def read_positions(layout: FrameLayout, frames: Iterable[WorldFrame]) -> Positions:
    """Return the positions of all links and of the desired goals in the frames of an episode."""
    rows = []
    for frame in frames:
        goals = {("", name): layout.goal_point(agent, "desired") for name, agent in frame.agents.items()}
        rows.append(
            {part: pose[0] for part, pose in frame.links.items()}
            | {part: point for part, point in goals.items() if point}
        )
    absent = (np.nan,) * 3
    return {
        part: np.array([row.get(part, absent) for row in rows])
        for part in dict.fromkeys(part for row in rows for part in row)
    }


def find_moving(program: Program, world: WorldModel, episodes: Sequence[Positions]) -> Moving:
    """Return the parts that move in at least one of these episodes of a program. `world` is the world of the
    environment, with all copies of a robot."""
    parts = dict.fromkeys(part for positions in episodes for part in positions)
    extents = {
        part: max(_extent(positions[part]) for positions in episodes if part in positions) for part in parts
    }
    analysis = Analysis(program).ideal
    subjects = _subjects(program, analysis)
    candidates: list[LinkName] = []
    named = {subject.body: None for subject in subjects} | {
        robot.name: None for robot in program.world.robots
    }
    for body in named:
        mine = [subject for subject in subjects if subject.body == body]
        for robot in world.robots:
            if robot.name.partition("#")[0] == body:
                candidates += _parts_of_robot(robot, mine, extents)
        candidates += [
            (object_body.name, object_body.name)
            for object_body in world.objects
            if object_body.name.partition("#")[0] == body and not object_body.fixed
        ]
    candidates = [part for part in dict.fromkeys(candidates) if part in extents]
    least = max(_MIN_EXTENT_M, _MIN_SHARE * max((extents[part] for part in candidates), default=0.0))
    moving = [part for part in candidates if extents[part] >= least] or candidates[:1]
    objects = {object_body.name.partition("#")[0] for object_body in world.objects}
    rank = min((subject.rank for subject in subjects if subject.body in objects), default=0)
    # Failures often read walls that must not be touched.
    failures = [value for value in program.endings if value.name in program.failures]
    avoided = {body for value in failures for body, _ in _read_by(analysis, value)} if rank else set()
    reached = {subject.body for subject in subjects if subject.rank == rank < 2} - avoided
    standing = [
        (object_body.name, object_body.name)
        for object_body in world.objects
        if object_body.name.partition("#")[0] in reached
    ]
    targets = [part for part in extents if not part[0]] + [
        part for part in standing if part in extents and part not in moving
    ]
    return Moving(tuple(moving[:MAX_TRAJECTORIES]), tuple(targets))


def describe(world: WorldModel, part: LinkName) -> str:
    """Return the name of a part, such as `block`, `epuck`, `panda.panda_hand` or `goal`. A copy of a robot or
    an object has the name in the scenario."""
    body, link = (name.partition("#")[0] for name in part)
    robot = next((robot for robot in world.robots if robot.name.partition("#")[0] == body), None)
    return f"{body}.{link}" if robot is not None and robot.fixed_base else body or "goal"


def has_moved(points: NDArray[np.float64]) -> bool:
    """Return whether positions (n, 3) differ by more than 1 mm."""
    return _extent(points) >= _MIN_EXTENT_M


def _extent(points: NDArray[np.float64]) -> float:
    """Return the diagonal of the box around positions, m."""
    finite = points[~np.isnan(points[:, 0])]
    return float(np.linalg.norm(np.ptp(finite, axis=0))) if len(finite) else 0.0


def _subjects(program: Program, analysis: Analysis) -> list[_Subject]:
    """Return the parts that the task reads, each once, in the order of the module's docstring."""
    agent = program.agent
    endings = [(0 if ending.name in agent.success else 2, ending) for ending in program.endings]
    goals = [(0, agent.goal.achieved), (2, agent.goal.desired)] if agent.goal else []
    values = [
        *goals,
        *endings,
        *((1, term) for term in agent.reward),
        *((2, entry.value) for entry in agent.observation),
    ]
    subjects: dict[tuple[str, str], _Subject] = {}
    for rank, value in sorted(values, key=lambda ranked: ranked[0]):
        for both in _read_by(analysis, value):
            subjects.setdefault(both, _Subject(*both, rank))
    return list(subjects.values())


def _read_by(analysis: Analysis, value: Expression) -> Iterator[tuple[str, str]]:
    """Yield the bodies that an expression reads, each with its link or joint (empty for the body as a
    whole)."""
    if not value.foreign:
        for tree in analysis.scalars(value):
            for node in analysis.walk_definitions(tree):
                for full_name in _full_names(analysis, node):
                    body, _, part = full_name.partition(".")
                    yield body.partition("#")[0], part


def _full_names(analysis: Analysis, node: Scalar) -> Iterator[str]:
    match node:
        case EngineRead(_, subjects):
            yield from subjects
        case Name() if sensor := analysis.sensor(node):
            yield from (f"{sensor[0]}.{subject}" for subject in sensor[1].subjects)


def _parts_of_robot(
    robot: RobotBody, subjects: Sequence[_Subject], extents: Mapping[LinkName, float]
) -> list[LinkName]:
    """Return the links whose positions represent the path of a robot."""
    links = [link.name for link in robot.model.links]
    if not robot.fixed_base:
        return [(robot.name, robot.model.root)]
    farthest = max(links, key=lambda link: extents[robot.name, link])
    least = _MIN_SHARE_OF_ROBOT * extents[robot.name, farthest]
    moving: dict[str, int] = {}
    for subject in subjects:
        driven = [joint.child for joint in robot.model.joints if joint.name == subject.part]
        below = (
            [subject.part]
            if subject.part in links
            else [link for child in driven for link in robot.model.links_below(child)]
        )
        link = max(below, key=lambda link: extents[robot.name, link], default=None)
        if link is not None and extents[robot.name, link] >= max(least, _MIN_EXTENT_M):
            moving.setdefault(link, subject.rank)
    deciding = [link for link, rank in moving.items() if rank == 0]
    return [(robot.name, link) for link in deciding or [*moving, farthest][:1]]
