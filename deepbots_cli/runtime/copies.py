"""Copies of a robot in one world under one policy: a supervisor for each, and the one that contains them.

The generated supervisor of a scenario describes one agent. With a single agent it is the environment and its
own agent. With copies there is one such supervisor for each, over an engine in which the robot's name means
this copy, and `CopiesSupervisor` is the environment. The agents of an environment are in `Supervisor.agents`
by name, and the generated code of a robot does not depend on copies.

Only the loop over the world differs. A physics step acts on all copies at once, so no copy can call it by
itself: its `_advance` is a generator that waits there, with its local variables, until every copy has acted.

In a batch of worlds the copies are rows of the columns: `BatchOfCopies` is the engine as all of them see it.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

import numpy as np
from gymnasium.vector.utils import batch_space

from deepbots_cli.frames import Quaternion, Triple, add
from deepbots_cli.port import ZERO_VECTOR, BatchEngine, Engine, EngineProxy, MotorWriter, Part, Pusher, View
from deepbots_cli.program import Program
from deepbots_cli.program.task import RobotCopies
from deepbots_cli.program.world import WorldModel
from deepbots_cli.runtime.formulas import total
from deepbots_cli.runtime.placement import copy_offset
from deepbots_cli.runtime.spaces import Column, apply_to_parts, canonical_action, is_canonical, joined
from deepbots_cli.runtime.streams import NOTHING_CHOSEN, Drawn, Streams
from deepbots_cli.runtime.supervisor import Info, Supervisor

if TYPE_CHECKING:
    from deepbots_cli.runtime.batch import BatchStep, BatchSupervisor

_END = object()


def copy_name(copies: RobotCopies, number: int) -> str:
    """Return the name of a copy in the world, numbered from 1."""
    return f"{copies.robot}#{number}"


def world_with_copies(world: WorldModel, copies: RobotCopies) -> WorldModel:
    """Return the world with the copies in place of the robot."""
    original = next(robot for robot in world.robots if robot.name == copies.robot)
    other_robots = tuple(robot for robot in world.robots if robot is not original)
    return replace(
        world,
        robots=(
            *other_robots,
            *(replace(original, name=copy_name(copies, k + 1)) for k in range(copies.count)),
        ),
    )


def make_environment(
    supervisor_class: type[Supervisor],
    scenario: Program,
    create_engine: Callable[[WorldModel], Engine],
    render_mode: str | None = None,
) -> Supervisor:
    """Return the environment of a scenario with its generated supervisor."""
    copies = scenario.agent.copies
    if copies is None:
        return supervisor_class(scenario, create_engine(scenario.world), render_mode)
    engine = create_engine(world_with_copies(scenario.world, copies))
    return CopiesSupervisor(supervisor_class, scenario, copies, engine, render_mode)


def make_batch(
    supervisor_class: type[Supervisor],
    batch_class: type[BatchSupervisor],
    scenario: Program,
    create_engine: Callable[[WorldModel], BatchEngine],
) -> BatchSupervisor:
    """Return a batch of worlds with the generated supervisor of the batch, and that of each single world."""
    copies = scenario.agent.copies
    engine = create_engine(scenario.world if copies is None else world_with_copies(scenario.world, copies))

    def single(member: Engine) -> Supervisor:
        return make_environment(supervisor_class, scenario, lambda world: member)

    singles = list(map(single, engine.members))
    return batch_class(singles, engine if copies is None else BatchOfCopies(engine, copies))


class EngineOfCopy(EngineProxy):
    """The engine as one copy sees it: the robot's name means this copy, and its place is relative to the
    copy's place in the row.

    Values of the world, and of bodies other than the robot, are set by the first copy alone. `reset` and
    `step` leave the world to the supervisor of all copies; `settling` is the number of engine steps to make
    after the reset.
    """

    def __init__(self, engine: Engine, copies: RobotCopies, number: int) -> None:
        super().__init__(engine)
        self._robot = copies.robot
        self._copy = copy_name(copies, number)
        self._offset = copy_offset(copies, number)
        self._is_first = number == 1
        self.settling = 0

    def body(self, name: str) -> str:
        """Return the name of a body in the world of all copies."""
        return self._copy if name == self._robot else name

    def changing(self, body: str = "") -> Engine | None:
        """Return the engine to set a value of a body with; None for a value that the first copy sets, because
        each copy would draw another one."""
        return self.engine if self._is_first or body == self._robot else None

    def reset(self) -> None:
        self.settling = 0

    def step(self, substeps: int) -> None:
        self.settling = substeps

    def place(
        self,
        body: str,
        position: Triple,
        orientation: Quaternion,
        velocity: Triple = ZERO_VECTOR,
        angular_velocity: Triple = ZERO_VECTOR,
    ) -> None:
        at = add(position, self._offset) if body == self._robot else position
        super().place(body, at, orientation, velocity, angular_velocity)

    def pusher(self, part: Part, frame: Literal["world", "link"] = "world") -> Pusher:
        return super().pusher(part, frame) if self.changing(part[0]) else lambda _force, _torque: None


class BatchOfCopies:
    """The engine of a batch with a row for each copy, those of the first world first; the robot's name means
    the copy of a row.

    Members, and the worlds that begin episodes, are worlds.
    """

    def __init__(self, engine: BatchEngine, copies: RobotCopies) -> None:
        self._engine = engine
        self._count = copies.count
        self._views = [
            EngineOfCopy(cast("Engine", engine), copies, number + 1) for number in range(copies.count)
        ]
        self.name = engine.name
        self.capabilities = engine.capabilities
        self.gravity = engine.gravity
        self.members = engine.members
        self.begin = engine.begin
        self.begin_episodes = engine.begin_episodes
        self.non_finite_worlds = engine.non_finite_worlds
        self.close = engine.close
        self.write_mask: Any = None

    def step(self, substeps: int, running: Any = None) -> None:
        self._engine.step(substeps, None if running is None else running[:: self._count])

    def _reader(self, kind: str, *subjects: Any, **options: Any) -> Callable[[], Any]:
        readers = [getattr(view, kind)(*subjects, **options) for view in self._views]
        return lambda: _readings_by_row([read() for read in readers])

    def _motor(self, kind: str, *subjects: Any, **curve: Any) -> MotorWriter:
        writers = [getattr(view, kind)(*subjects, **curve) for view in self._views]

        def write(targets: Sequence[Any]) -> None:
            for index, write_copy in enumerate(writers):
                rows = slice(index, None, self._count)
                self._engine.write_mask = None if self.write_mask is None else self.write_mask[rows]
                write_copy([target[rows] if isinstance(target, np.ndarray) else target for target in targets])
            self._engine.write_mask = None

        return write

    def __getattr__(self, method: str) -> Callable[..., Any]:
        """Return the method that binds readers or motors for all copies."""
        if method.startswith("_") or not hasattr(EngineProxy, method):
            raise AttributeError(method)
        return partial(self._motor if method.endswith("_motor") else self._reader, method)


def _readings_by_row(readings: Sequence[Any]) -> Any:
    """Return the readings of all copies, columns with a number per world, as columns with a number per
    row."""
    first = readings[0]
    if isinstance(first, (tuple, list)):
        return tuple(_readings_by_row(parts) for parts in zip(*readings, strict=True))
    return np.stack(readings, axis=-1).reshape(*first.shape[:-1], -1)


class CopyResult(NamedTuple):
    """The result of a step for one copy."""

    reward: float
    terminated: bool
    truncated: bool
    info: Info


def result_of_all(copies: Sequence[CopyResult]) -> CopyResult:
    """Return the result of a step for the world of these copies."""
    terminated = [copy for copy in copies if copy.terminated]
    ended = terminated or [copy for copy in copies if copy.truncated]
    failed = [copy for copy in ended if not copy.info["is_success"]]
    per_copy = {
        "reward": tuple(copy.reward for copy in copies),
        "terminated": tuple(copy.terminated for copy in copies),
        "is_success": tuple(copy.info["is_success"] for copy in copies),
    }
    terms = {
        name: total(copy.info["reward_terms"][name] for copy in copies) / len(copies)
        for name in copies[0].info["reward_terms"]
    }
    info: Info = {
        "is_success": bool(ended) and not failed,
        "ended_by": (failed or ended)[0].info["ended_by"] if ended else None,
        "endings": tuple(dict.fromkeys(name for copy in ended for name in copy.info["endings"])),
        "reward_terms": terms,
        "each": per_copy,
    }
    return CopyResult(
        total(copy.reward for copy in copies) / len(copies),
        bool(terminated),
        bool(ended) and not terminated,
        info,
    )


class WorldRows:
    """The rows of a batch by world: a row is an agent, and a world with copies has a row for each copy."""

    def __init__(self, per_world: int, *, has_copies: bool) -> None:
        self._per_world = per_world
        self._has_copies = has_copies

    def of(self, worlds: Any) -> Any:
        """Return the numbers of the rows of these worlds."""
        if self._per_world == 1:
            return worlds
        return (self._per_world * np.asarray(worlds)[:, None] + np.arange(self._per_world)).ravel()

    def by_row(self, values: Any) -> Any:
        """Return actions or observations of worlds with a row per agent."""
        return (
            apply_to_parts(lambda part: part.reshape(-1, *part.shape[2:]), values)
            if self._has_copies
            else values
        )

    def by_world(self, values: Any) -> Any:
        """Return actions or observations with a row per agent as those of worlds."""
        if not self._has_copies:
            return values
        return apply_to_parts(lambda part: part.reshape(-1, self._per_world, *part.shape[1:]), values)

    def step_by_world(self, step: BatchStep) -> BatchStep:
        """Return the result of a step with one row per world, in the form that a single world with copies
        returns."""
        if not self._has_copies:
            return step
        per_world = self._per_world
        rewards, *terms = (
            reduce(operator.add, row.reshape(-1, per_world).T) / per_world
            for row in (step.rewards, *step.terms)
        )
        terminated, truncated = (
            np.any(column.reshape(-1, per_world), axis=1) for column in (step.terminated, step.truncated)
        )
        results = [
            CopyResult(float(step.rewards[row]), bool(step.terminated[row]), bool(step.truncated[row]), info)
            for row, info in zip(step.done.tolist(), step.infos, strict=True)
        ]
        return step._replace(
            observations=self.by_world(step.observations),
            rewards=rewards,
            terms=np.array(terms),
            terminated=terminated,
            truncated=truncated & ~terminated,
            done=step.done[::per_world] // per_world,
            final_observations=self.by_world(step.final_observations) if results else None,
            infos=[
                result_of_all(results[first : first + per_world]).info
                for first in range(0, len(results), per_world)
            ],
        )

    def any_in_world(self, flags: Column) -> Column:
        """Return whether a flag is set in any row of the world, for each row."""
        if self._per_world == 1:
            return flags
        return flags.reshape(-1, self._per_world).any(axis=1).repeat(self._per_world)


class CopiesSupervisor(Supervisor):
    """The environment of all copies: observations and actions have a row for each, in the order of `agents`.

    Each agent has its own rewards, endings, channels, and draws for its robot. Parameters, and draws for the
    world and for other bodies, have one value for all copies; the first copy draws it. If the episode ends
    for one copy, it ends for all. The reward is the mean over the copies. `info["each"]` contains the reward
    of each copy, whether it terminated, and whether it succeeded.
    """

    def __init__(
        self,
        supervisor_class: type[Supervisor],
        scenario: Program,
        copies: RobotCopies,
        engine: Engine,
        render_mode: str | None = None,
    ) -> None:
        self._engines = [EngineOfCopy(engine, copies, number + 1) for number in range(copies.count)]
        members = [supervisor_class(scenario, view) for view in self._engines]
        super().__init__(scenario, engine, render_mode)
        self._streams_of_agents: Streams | None = None
        self._chosen: Mapping[str, Mapping[str, Any]] = {}
        self._shared = [entry for entry in scenario.draws.noted if not entry.is_of_copy]
        self.world = world_with_copies(scenario.world, copies)
        self.agents = {copy_name(copies, number): member for number, member in enumerate(members, start=1)}
        self.copy_names = tuple(self.agents)
        self.observation_space = batch_space(members[0].observation_space, copies.count)
        self.action_space = batch_space(members[0].action_space, copies.count)

    @property
    def _first(self) -> Supervisor:
        return next(iter(self.agents.values()))

    def begin_robots(self, streams: Streams) -> None:
        for agent in self.agents.values():
            agent.begin_robots(agent.streams)

    def _begin(self) -> None:
        if self._streams_of_agents is not self.streams:
            self._streams_of_agents = self.streams
            for name, agent in self.agents.items():
                agent.streams = Streams(self.streams.root, name)
        self.engine.reset()
        shared: dict[str, Any] = {}
        for number, (name, agent) in enumerate(self.agents.items()):
            agent._forget()
            agent.streams.begin({**self._chosen.get(name, NOTHING_CHOSEN), **shared})
            agent.streams.is_follower = number > 0
            agent._begin()
            agent.note_draws()
            if number == 0:
                draws = agent.drawn()
                shared = {entry.key: draws[entry.name] for entry in self._shared if entry.name in draws}
        if self._engines[0].settling:
            self.engine.step(self._engines[0].settling)

    def choose_values(self, values: Mapping[str, Mapping[str, Any]] | None) -> None:
        self._chosen = values or {}

    def note_draws(self) -> None:
        """Keep the draws that all copies share, by name, and those of each copy after its name."""
        shared = {entry.name for entry in self._shared}
        self._drawn = {key: value for key, value in self._first.drawn().items() if key in shared}
        for name, agent in self.agents.items():
            copy_draws = {key: value for key, value in agent.drawn().items() if key not in shared}
            self._drawn |= {f"{name}.{key}": value for key, value in copy_draws.items()}

    def present_values(self) -> Drawn:
        parameters = {full for value in self.scenario.parameters for full, _ in value.numbers}
        return self._drawn | {
            name: value for name, value in self._first.episode_values.items() if name in parameters
        }

    def random_state(self) -> dict[str, Any]:
        begun = self._streams_of_agents is self.streams
        return {
            **super().random_state(),
            "agents": [agent.random_state() for agent in self.agents.values()] if begun else [],
        }

    def set_random_state(self, state: Mapping[str, Any]) -> None:
        super().set_random_state(state)
        # The list is empty in a state from before the first episode.
        for (name, agent), inner in zip(self.agents.items(), state["agents"], strict=False):
            agent.streams = Streams.restored(inner, name)
            self._streams_of_agents = self.streams

    def _start(self) -> None:
        for agent in self.agents.values():
            agent._start()
            agent.fill_frames()
        self._gather()

    def fill_frames(self) -> None:
        """Do nothing: the agents have frames of their own."""

    def _advance(self, action: Any) -> None:
        fitting = canonical_action(self.action_space, action)
        # Refused before any copy acts, because an action cannot be undone.
        if fitting is None or not is_canonical(fitting, action):
            raise ValueError("the action is not in the action space, or has another type")
        self.step_count += 1
        agents = self.agents.values()
        rows = (
            [{key: part[row] for key, part in action.items()} for row in range(len(agents))]
            if isinstance(action, dict)
            else action
        )
        turns = [agent._advance(row) for agent, row in zip(agents, rows, strict=True)]
        for turn in turns:
            next(turn)
        running = True
        while running:
            self.physics(self.scenario.world.substeps)
            # A list and not `any`, which would stop at the first copy that has ended.
            running = not [turn for turn in turns if next(turn, _END) is _END]
        for turn in turns:
            turn.close()
        self._gather()

    def _gather(self) -> None:
        """Take reward and endings from the agents."""
        agents = list(self.agents.values())
        self.step_count = agents[0].step_count
        self.timestep_count = agents[0].timestep_count
        results = [
            CopyResult(agent.reward, agent.terminated, agent.truncated, agent.get_info()) for agent in agents
        ]
        self.reward, self.terminated, self.truncated, self._info = result_of_all(results)
        self.is_success, self.endings, self.ended_by = (
            self._info[name] for name in ("is_success", "endings", "ended_by")
        )

    def scripted(self, name: str) -> Any:
        """Return the action of the script for every copy."""
        return joined([agent.scripted(name) for agent in self.agents.values()])

    def make_action(self, choices: Sequence[int], ranges: Sequence[float]) -> Any:
        """Return the same action for every copy."""
        return joined([agent.make_action(choices, ranges) for agent in self.agents.values()])

    def get_observations(self) -> Any:
        return joined([agent.get_observations() for agent in self.agents.values()])

    def get_info(self) -> Info:
        return dict(self._info)

    def view(self, width: int = 480, height: int = 320) -> View:
        return self._first.view(width, height)

    def allowed(self) -> tuple[tuple[bool, ...], ...]:
        return tuple(mask for agent in self.agents.values() for mask in agent.allowed())
