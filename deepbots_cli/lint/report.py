"""What the process that simulated has told, as data. Names in it are only ever looked up in the scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from deepbots_cli.lint.rays import Aim

End = Literal["success", "failure", "limit", "left"]
"""How an episode ended: by the task, by a limit, or left because enough was seen."""


class Where(NamedTuple):
    """A policy (or `build`, `reset`), a seed, and the number of a step, from 1."""

    doing: str
    seed: int
    step: int


@dataclass(frozen=True)
class Halt:
    """The process ended early: the engine took it down, a step did not come back, memory or the whole time ran out."""

    kind: Literal["crash", "hang", "memory", "slow", "killed"]
    what: str


@dataclass(frozen=True)
class Overlap:
    """Two bodies within each other in the first moment of an episode: names of body and link, m."""

    one: tuple[str, str]
    other: tuple[str, str]
    depth: float
    seed: int


@dataclass(frozen=True)
class Played:
    """One episode; `worth` is the discounted return."""

    by: str
    seed: int
    steps: int
    total: float
    worth: float
    end: End
    ended_by: str | None


@dataclass(frozen=True)
class Missed:
    """The first command of an episode to a `cartesian` actuator that the inverse kinematics does not reach, and how many there are (`out`).

    `distance` (m) and `angle` (rad) are what is missing; `stops` are the joints that end at a limit, with that limit (rad or m). With
    `turn` (rad) it is instead a first command that the arm reaches by turning its link in place; `start` (roll, pitch, yaw in rad) is
    the attitude of the link before it.
    """

    robot: str
    actuator: str
    distance: float
    angle: float
    stops: Mapping[str, float]
    turn: float = 0.0
    start: Sequence[float] = ()
    by: str = ""
    seed: int = 0
    step: int = 0
    out: int = 0
    commands: int = 0


class Seen(NamedTuple):
    """A number of the observation under one policy, from -1 to 1, and in how many steps it was at either end."""

    low: float
    high: float
    at_low: int
    at_high: int


class Paid(NamedTuple):
    """A term of the reward under one policy: its sum, that of its sizes, in how many steps it was not 0, and its range."""

    total: float
    size: float
    fired: int
    least: float
    most: float


@dataclass(frozen=True)
class Measured:
    """All episodes of one policy. `rows` is `steps` times the copies of a team."""

    steps: int
    rows: int
    seen: tuple[Seen, ...]
    terms: tuple[Paid, ...]


@dataclass
class Report:
    """Filled line by line; `done` says whether the plan was gone through to its end, `fault` which exception of deepbots ended it."""

    where: Where = Where("build", 0, 0)
    fastest: tuple[str, float] | None = None
    overlaps: list[Overlap] = field(default_factory=list)
    early: dict[str, list[int]] = field(default_factory=dict)
    missed: list[Missed] = field(default_factory=list)
    played: list[Played] = field(default_factory=list)
    measured: dict[str, Measured] = field(default_factory=dict)
    still: tuple[int, ...] = ()
    silent: tuple[int, ...] = ()
    over: dict[tuple[str, str], Aim] = field(default_factory=dict)
    stop: Mapping[str, Any] | None = None
    halt: Halt | None = None
    fault: str | None = None
    done: bool = False

    @property
    def step(self) -> int:
        return self.where.step

    @step.setter
    def step(self, number: int) -> None:
        self.where = self.where._replace(step=number)

    @property
    def whole(self) -> bool:
        """Whether nothing stopped it, so that what was not seen can be told."""
        return self.done and self.stop is None

    def take(self, told: Mapping[str, Any]) -> None:  # one case per kind of line  # noqa: C901
        """One line of the other process."""
        match told:
            case {"at": [str() as doing, int() as seed]}:
                self.where, self.fastest = Where(doing, seed, 0), None
            case {"fast": [str() as body, int() | float() as speed]}:
                self.fastest = (body, speed)
            case {"overlap": {"one": [str() as a, str() as b], "other": [str() as c, str() as d], "depth": float() as depth, "seed": seed}}:
                self.overlaps.append(Overlap((a, b), (c, d), depth, int(seed)))
            case {"early": {"ending": str() as ending, "seed": int() as seed}}:
                self.early.setdefault(ending, []).append(seed)
            case {"missed": Mapping() as row}:
                self.missed.append(Missed(**row))
            case {"episode": Mapping() as row}:
                self.played.append(Played(**row))
            case {"measured": Mapping() as rows}:
                self.measured = {by: _measured(row) for by, row in rows.items()}
            case {"still": still, "silent": silent}:
                self.still, self.silent = tuple(still), tuple(silent)
            case {"over": rows}:
                self.over = {(robot, sensor): Aim(*aim) for robot, sensor, *aim in rows}
            case {"stop": Mapping() as stop}:
                self.stop = stop
            case {"fault": str() as fault}:
                self.fault = fault
            case {"done": True}:
                self.done = True


def _measured(row: Mapping[str, Any]) -> Measured:
    seen, terms = (Seen(*entry) for entry in row["seen"]), (Paid(*entry) for entry in row["terms"])
    return Measured(row["steps"], row["rows"], tuple(seen), tuple(terms))
