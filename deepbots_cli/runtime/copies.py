"""Copies of a robot in one world under one policy: a supervisor for each, and the one that holds them.

The generated supervisor of a scenario describes one agent. With a single agent it is the environment and holds itself. With copies there is
one such supervisor for each, over an engine in which the robot's name means this copy, and `CopiesSupervisor` is the environment. Whoever
runs an environment finds its agents by name in `Supervisor.agents`, and the generated code of a robot does not know of copies.

Only the loop over the world differs. A physics step acts on all copies at once, so no copy can call it by itself: its `_advance` is a
generator that waits there, with its local variables, until every copy has acted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

from gymnasium.vector.utils import batch_space

from deepbots_cli.frames import Quaternion, Triple, add
from deepbots_cli.port import ZERO_VECTOR, Engine, EngineProxy, Part, Pusher
from deepbots_cli.program import Program
from deepbots_cli.program.task import RobotCopies
from deepbots_cli.program.world import WorldModel
from deepbots_cli.runtime.placement import copy_offset
from deepbots_cli.runtime.spaces import canonical_action, is_canonical, joined
from deepbots_cli.runtime.streams import NOTHING_CHOSEN, Drawn, Streams
from deepbots_cli.runtime.supervisor import Info, Supervisor

_END = object()


def copy_name(copies: RobotCopies, number: int) -> str:
    """The name of a copy in the world, numbered from 1."""
    return f"{copies.robot}#{number}"


def world_with_copies(world: WorldModel, copies: RobotCopies) -> WorldModel:
    """The world with the copies in place of the robot."""
    one = next(robot for robot in world.robots if robot.name == copies.robot)
    others = tuple(robot for robot in world.robots if robot is not one)
    return replace(world, robots=(*others, *(replace(one, name=copy_name(copies, k + 1)) for k in range(copies.count))))


def make_environment(
    kind: type[Supervisor], scenario: Program, create: Callable[[WorldModel], Engine], render_mode: str | None = None
) -> Supervisor:
    """The environment of a scenario whose generated supervisor is `kind`."""
    copies = scenario.agent.copies
    if copies is None:
        return kind(scenario, create(scenario.world), render_mode)
    return CopiesSupervisor(kind, scenario, copies, create(world_with_copies(scenario.world, copies)), render_mode)


class EngineOfCopy(EngineProxy):
    """The engine as one copy sees it: the robot's name means this copy, and its place is relative to the copy's place in the row.

    Values of the world, and of bodies other than the robot, are set by the first copy alone. `reset` and `step` leave the world to
    the supervisor of all copies; `settling` is how many engine steps the world shall make after the reset.
    """

    def __init__(self, engine: Engine, copies: RobotCopies, number: int) -> None:
        super().__init__(engine)
        self._robot, self._copy = copies.robot, copy_name(copies, number)
        self._offset = copy_offset(copies, number)
        self._is_first = number == 1
        self.settling = 0

    def body(self, name: str) -> str:
        return self._copy if name == self._robot else name

    def changing(self, body: str = "") -> Engine | None:
        return self.engine if self._is_first or body == self._robot else None

    def reset(self) -> None:
        self.settling = 0

    def step(self, substeps: int) -> None:
        self.settling = substeps

    def place(
        self, body: str, position: Triple, orientation: Quaternion, velocity: Triple = ZERO_VECTOR, angular_velocity: Triple = ZERO_VECTOR
    ) -> None:
        at = add(position, self._offset) if body == self._robot else position
        super().place(body, at, orientation, velocity, angular_velocity)

    def pusher(self, part: Part, frame: Literal["world", "link"] = "world") -> Pusher:
        return super().pusher(part, frame) if self.changing(part[0]) else lambda _force, _torque: None


class CopiesSupervisor(Supervisor):
    """The environment of all copies: observations and actions have a row for each, in the order of `agents`.

    Each agent has rewards, endings and channels of its own. Each copy draws for its own robot. Parameters, and draws for the world and for
    other bodies, have one value for all copies; the first copy draws it. The episode ends for all when it ends for one. The reward is the
    mean over the copies. `info["each"]` holds the reward of each copy, whether it terminated, and whether it succeeded.
    """

    def __init__(
        self, kind: type[Supervisor], scenario: Program, copies: RobotCopies, engine: Engine, render_mode: str | None = None
    ) -> None:
        self._engines = [EngineOfCopy(engine, copies, number + 1) for number in range(copies.count)]
        members = [kind(scenario, view) for view in self._engines]
        self._streams_of_agents: Streams | None = None
        super().__init__(scenario, engine, render_mode)
        self._chosen: Mapping[str, Mapping[str, Any]] = {}
        self._shared = [entry for entry in scenario.draws.noted if not entry.is_of_copy]
        self.world = world_with_copies(scenario.world, copies)
        self.agents = {copy_name(copies, number): member for number, member in enumerate(members, start=1)}
        self.observation_space = batch_space(members[0].observation_space, copies.count)
        self.action_space = batch_space(members[0].action_space, copies.count)

    def begin_robots(self) -> None:
        for agent in self.agents.values():
            agent.begin_robots()

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
            agent._drawn = agent._noted()
            if number == 0:
                shared = {entry.key: agent._drawn[entry.name] for entry in self._shared if entry.name in agent._drawn}
        if self._engines[0].settling:
            self.engine.step(self._engines[0].settling)

    def _copies(self) -> Sequence[str]:
        return tuple(self.agents)

    def _choose(self, chosen: Mapping[str, Mapping[str, Any]] | None) -> None:
        self._chosen = chosen or {}

    def _noted(self) -> Drawn:
        """The draws that all copies share, by name, and those of each copy after its name."""
        shared = {entry.name for entry in self._shared}
        first = next(iter(self.agents.values()))
        found = {place: value for place, value in first._drawn.items() if place in shared}
        for name, agent in self.agents.items():
            found |= {f"{name}.{place}": value for place, value in agent._drawn.items() if place not in shared}
        return found

    def present_values(self) -> Drawn:
        first = next(iter(self.agents.values()))
        parameters = {full for value in self.scenario.parameters for full, _ in value.numbers}
        return self._drawn | {name: value for name, value in first.episode_values.items() if name in parameters}

    def random_state(self) -> dict[str, Any]:
        begun = self._streams_of_agents is self.streams
        return {**super().random_state(), "agents": [agent.random_state() for agent in self.agents.values()] if begun else []}

    def set_random_state(self, state: Mapping[str, Any]) -> None:
        super().set_random_state(state)
        for (name, agent), inner in zip(self.agents.items(), state["agents"], strict=False):
            agent.streams = Streams.restored(inner, name)
            self._streams_of_agents = self.streams

    def _start(self) -> None:
        for agent in self.agents.values():
            agent._start()
            agent._fill_frames()
        self._gather()

    def _fill_frames(self) -> None:
        """The agents have frames of their own."""

    def _advance(self, action: Any) -> None:
        fitting = canonical_action(self.action_space, action)
        if fitting is None or not is_canonical(fitting, action):  # refused before any copy has acted: those that have cannot go back
            raise ValueError("no action of this space")
        self.step_count += 1
        agents = self.agents.values()
        rows = [{key: part[row] for key, part in action.items()} for row in range(len(agents))] if isinstance(action, dict) else action
        turns = [agent._advance(row) for agent, row in zip(agents, rows, strict=True)]
        for turn in turns:
            next(turn)
        running = True
        while running:
            self.engine.step(self.scenario.world.substeps)
            running = not [turn for turn in turns if next(turn, _END) is _END]
        for turn in turns:
            turn.close()
        self._gather()

    def _gather(self) -> None:
        """Take reward and endings from the agents."""
        agents = list(self.agents.values())
        self.step_count, self.timestep_count = agents[0].step_count, agents[0].timestep_count
        self.reward = sum(agent.reward for agent in agents) / len(agents)
        ended = [agent for agent in agents if agent.terminated]
        over = ended or [agent for agent in agents if agent.truncated]
        self.terminated, self.truncated = bool(ended), bool(over) and not ended
        self.is_success = bool(ended) and all(agent.is_success for agent in ended)
        self.endings = tuple(dict.fromkeys(name for agent in over for name in agent.endings))
        failed = [agent for agent in over if not agent.is_success]
        self.ended_by = (failed or over)[0].ended_by if over else None

    def scripted(self, name: str) -> Any:
        """Every copy follows the script."""
        return joined([agent.scripted(name) for agent in self.agents.values()])

    def make_action(self, choices: Sequence[int], ranges: Sequence[float]) -> Any:
        """Every copy takes the same action."""
        return joined([agent.make_action(choices, ranges) for agent in self.agents.values()])

    def get_observations(self) -> Any:
        return joined([agent.get_observations() for agent in self.agents.values()])

    def get_info(self) -> Info:
        agents = self.agents.values()
        infos = [agent.get_info() for agent in agents]
        return {
            "is_success": self.is_success,
            "ended_by": self.ended_by,
            "endings": self.endings,
            "reward_terms": {name: sum(info["reward_terms"][name] for info in infos) / len(infos) for name in infos[0]["reward_terms"]},
            "each": {what: tuple(getattr(agent, what) for agent in agents) for what in ("reward", "terminated", "is_success")},
        }

    def _view_shift(self) -> Triple:
        return next(iter(self.agents.values()))._view_shift()

    def allowed(self) -> tuple[tuple[bool, ...], ...]:
        return tuple(mask for agent in self.agents.values() for mask in agent.allowed())
