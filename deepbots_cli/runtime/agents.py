"""Several agents in one world or in a batch: what each of them sees and does, and environments for one or
for all of them.

One generated supervisor steps the world. Its action and its observation are those of all agents in a row
(`program/__init__.py`); a `Seat` has the part of one agent.

In a batch, one agent acts on the worlds and the others act by themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import UsageError
from deepbots_cli.program import RANDOM, ZERO, Member, Program, qualified_name
from deepbots_cli.program.task import Agent
from deepbots_cli.runtime.batch import (
    BatchStep,
    BatchSupervisor,
    EpisodeHistories,
    EpisodeHistory,
    advance_and_begin,
)
from deepbots_cli.runtime.copies import WorldRows
from deepbots_cli.runtime.spaces import (
    FORWARD_BATCH_SIZE,
    Column,
    ForwardPass,
    Predictor,
    action_space,
    apply_to_parts,
    canonical_action,
    compose_action,
    compose_rows,
    mask_of_space,
    observation_space,
    parts_of_rows,
)
from deepbots_cli.runtime.supervisor import Info, ResetNeededError, Supervisor

Array = NDArray[Any]
Act = Callable[[Any], Any]
"""Returns an action for an observation of an agent."""


class SeatLayout:
    """The columns of one agent in the observations and the actions of all agents.

    Attributes:
        member: The agent.
        observation_space, action_space: The spaces of the agent, as in a scenario with this agent alone.
        shape: The shape of an action; None for one with choices and ranges.
        masks: The slice of its options in a row of truth values about the options of all agents.
    """

    def __init__(self, member: Member, of_all: Agent) -> None:
        self.member = member
        agent = member.program.agent
        self.observation_space, self.action_space = observation_space(agent), action_space(agent)
        self.shape = self.action_space.shape
        self._columns = _column_index(member.columns)
        self._pictures = {
            entry.key: qualified_name(member.name, entry.name).replace(".", "_") for entry in agent.images
        }
        self._choices = len(agent.choices)
        first, last = member.choices
        counts = [len(part.options) for part in of_all.choices]
        self.masks = slice(sum(counts[:first]), sum(counts[:last]))

    def observation(self, of_all: Any) -> Any:
        """Return what the agent sees, given what all agents see."""
        if not isinstance(of_all, dict):
            return of_all[..., self._columns]
        numbers = of_all["observation"][..., self._columns] if "observation" in of_all else None
        if not self._pictures:
            return numbers
        pictures = {key: of_all[name] for key, name in self._pictures.items()}
        has_numbers = numbers is not None and numbers.shape[-1] > 0
        return {"observation": numbers, **pictures} if has_numbers else pictures

    def actions(self, of_all: Array) -> Array:
        """Return the part of the agent in actions of all agents, whose last axis has their choices or their
        ranges."""
        first, last = self.member.choices if self._choices else self.member.ranges
        return of_all[..., first:last].reshape(*of_all.shape[:-1], *(self.shape or ()))


def _column_index(columns: Sequence[int]) -> slice | NDArray[np.intp]:
    """Return columns as an index of an array: a slice if they follow one another, which is six times as
    fast."""
    first = columns[0] if columns else 0
    if list(columns) == list(range(first, first + len(columns))):
        return slice(first, first + len(columns))
    return np.array(columns, np.intp)


class Seat(SeatLayout):
    """The seat of one agent in a world of several."""

    def __init__(self, world: Supervisor, member: Member) -> None:
        super().__init__(member, world.agent)
        self._world = world

    def parts(self, action: Any) -> tuple[list[int], list[float]]:
        """Return the options of the choices and the numbers of the ranges in an action of the agent.

        Raises:
            UsageError: The action is not in the action space.
        """
        fitting = canonical_action(self.action_space, action)
        if fitting is None:
            raise UsageError(
                f"action {str(action)[:80]} of '{self.member.name}' does not fit {self.action_space}"
            )
        choices = fitting["choices"] if isinstance(fitting, dict) else fitting
        ranges = fitting["ranges"] if isinstance(fitting, dict) else fitting
        return (
            np.atleast_1d(choices).tolist() if self._choices else [],
            np.asarray(ranges).tolist() if isinstance(fitting, dict) or not self._choices else [],
        )

    @property
    def still(self) -> Any:
        """The first option of each choice, and the middle of each range."""
        agent = self.member.program.agent
        return compose_action(self.action_space, [0] * len(agent.choices), [0.0] * len(agent.range_names))

    def own_action(self, of_all: Any) -> Any:
        """Return the part of the agent in an action of all agents."""
        choices = of_all["choices"] if isinstance(of_all, dict) else of_all
        ranges = of_all["ranges"] if isinstance(of_all, dict) else of_all
        (first, last), (low, high) = self.member.choices, self.member.ranges
        return compose_action(
            self.action_space,
            np.atleast_1d(choices)[first:last].tolist() if last > first else (),
            np.asarray(ranges)[low:high].tolist() if high > low else (),
        )

    def action_mask(self) -> np.ndarray[Any, Any]:
        """Return which options the agent may choose next, as truth values in a row."""
        return self._world.action_masks()[self.masks]

    def script(self, name: str) -> Any:
        """Return the next action of a script of the agent.

        Raises:
            UsageError: The agent has no such script, or no episode has begun.
        """
        self.member.program.script(name)
        return self.own_action(self._world.script(qualified_name(self.member.name, name)))

    def info(self, of_all: Mapping[str, Any]) -> Info:
        """Return the info of a step as it is for the agent."""
        info = own_info(self.member, of_all)
        if "action_mask" in info:
            info["action_mask"] = mask_of_space(
                self.action_space,
                [np.array(mask, np.int8) for mask in self._world.allowed()[slice(*self.member.choices)]],
            )
        return info

    def reward(self, of_all: Mapping[str, Any]) -> float:
        """Return the reward of the last step."""
        return self.member.reward(of_all["reward_terms"])


def own_info(member: Member, of_all: Mapping[str, Any]) -> Info:
    """Return the info of a step as it is for an agent, with the masks of all agents."""
    terms = of_all["reward_terms"]
    info: Info = {
        **of_all,
        "is_success": member.has_succeeded(of_all["endings"]),
        "reward_terms": {own_name: terms[name] for own_name, name in member.terms.items()},
    }
    ends = info.pop("agent_endings", None)
    if ends and (end := ends.get(member.name)) is not None:
        info |= {"is_success": end.is_success, "ended_by": end.endings[0], "endings": end.endings}
    return info


def seats_of(world: Supervisor) -> dict[str, Seat]:
    """Return the seat of each agent, by name."""
    return {name: Seat(world, member) for name, member in world.scenario.members.items()}


def combined_action(world: Supervisor, seats: Mapping[str, Seat], actions: Mapping[str, Any]) -> Any:
    """Return the action of all agents, given that of each.

    Raises:
        UsageError: The action of an agent is missing, or does not fit its action space.
    """
    for name in seats:
        if name not in actions:
            raise UsageError(f"there is no action of the agent '{name}'")
    if isinstance(world.action_space, gym.spaces.Box):
        # A third of the time of the general way; the world refuses what is not finite.
        arrays = [np.asarray(actions[name]) for name in seats]
        if [array.shape for array in arrays] == [seat.shape for seat in seats.values()]:
            return np.concatenate(arrays)
    choices: list[int] = []
    ranges: list[float] = []
    for name, seat in seats.items():
        options, numbers = seat.parts(actions[name])
        choices += options
        ranges += numbers
    return compose_action(world.action_space, choices, ranges)


class AgentEnvironment(gym.Env[Any, Any]):
    """The environment of one of several agents, beside which the others act by themselves. It has the
    interface of a supervisor; what it does not define is the same for all agents.

    Attributes:
        supervisor: The supervisor of the world.
        scenario: The program of the agent.
        number: The number of the next episode, or of the world among others: policies that act for other
            agents then act as in a batch, to the bit (`spaces.py`).

    Args:
        rebuild: Makes a copy of the environment in another process.
        policies: The policies that act for other agents, by the name of the agent.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        scenario: Program,
        rebuild: Callable[[], Any] | None = None,
        policies: Mapping[str, Predictor] = MappingProxyType({}),
    ) -> None:
        others = scenario.others
        assert others is not None
        self.supervisor = supervisor
        self.scenario = scenario
        self.rebuild = rebuild
        self.number = 0
        self._seats = seats_of(supervisor)
        self._own = others.agent
        self.seat = self._seats[others.agent]
        self._policies = {name: PolicyAct(policy, self._seats[name]) for name, policy in policies.items()}
        self._acts: dict[str, Act] = {
            name: self._policies.get(name) or driven(supervisor, self._seats[name], driver)
            for name, driver in others.drivers.items()
        }
        self.agent = scenario.agent
        self.agents = {self.agent.name: self}
        self.observation_space, self.action_space = self.seat.observation_space, self.seat.action_space
        self.metadata = supervisor.metadata
        self.render_mode = supervisor.render_mode
        self._observed: Any = None
        self._result: tuple[float, Info] = (0.0, {})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """See `Supervisor.reset`."""
        self._observed, info = self.supervisor.reset(seed=seed, options=options)
        for act in self._policies.values():
            act.begin(self.number)
        if seed is not None:
            self.action_space.seed(seed)
        self.begin(info)
        return self.get_observations(), self.get_info()

    def begin(self, info: Info) -> None:
        """Take the info of a reset of the world, in which a batch resets it."""
        self._result = 0.0, self.seat.info(info)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """See `Supervisor.step`."""
        if self._observed is None or self._own in self.supervisor.agent_endings:
            raise ResetNeededError("call reset() before step()")
        actions = {
            name: act(self._seats[name].observation(self._observed)) for name, act in self._acts.items()
        }
        actions[self._own] = action
        together = combined_action(self.supervisor, self._seats, actions)
        self._observed, _, _, _, info = self.supervisor.step(together)
        self._result = self.seat.reward(info), self.seat.info(info)
        return self.get_observations(), self.get_reward(), self.terminated, self.truncated, self.get_info()

    # The end of the episode of the agent, which may be before that of the world

    @property
    def terminated(self) -> bool:
        return self.supervisor.terminated or self._own in self.supervisor.agent_endings

    @property
    def truncated(self) -> bool:
        return self.supervisor.truncated and self._own not in self.supervisor.agent_endings

    @property
    def ended_by(self) -> str | None:
        """The ending that ended the episode; None while it goes on."""
        name: str | None = self._result[1].get("ended_by")
        return name

    @property
    def is_success(self) -> bool:
        return bool(self._result[1].get("is_success"))

    def get_observations(self) -> Any:
        return self.seat.observation(self._observed)

    @property
    def reward(self) -> float:
        """The reward of the agent for the last step."""
        return self._result[0]

    def get_reward(self) -> float:
        return self.reward

    def get_info(self) -> Info:
        return dict(self._result[1])

    def script(self, name: str) -> Any:
        """See `Supervisor.script`."""
        return self.seat.script(name)

    scripted = script

    def make_action(self, choices: Sequence[int], ranges: Sequence[float]) -> Any:
        """See `Supervisor.make_action`."""
        return compose_action(self.action_space, choices, ranges)

    def action_masks(self) -> Any:
        """See `Supervisor.action_masks`."""
        if not self.agent.choices:
            raise UsageError("action masks need an action with `choices`, but this agent has none")
        return self.seat.action_mask()

    def allowed(self) -> tuple[tuple[bool, ...], ...]:
        """See `Supervisor.allowed`."""
        first, last = self.seat.member.choices
        return self.supervisor.allowed()[first:last]

    def render(self) -> Any:
        """See `Supervisor.render`."""
        return self.supervisor.render()

    def close(self) -> None:
        """Release the engine."""
        self.supervisor.close()

    def __getattr__(self, name: str) -> Any:
        # Before `__init__` has set `supervisor`, the lookup below would call itself without end.
        if name.startswith("_") or name == "supervisor":
            raise AttributeError(name)
        kind, separator, value_name = name.partition("_")
        attribute = (
            f"{kind}{separator}{qualified_name(self._own, value_name)}"  # such as `last_hunter__angle`
        )
        return getattr(self.supervisor, attribute if hasattr(self.supervisor, attribute) else name)

    def __reduce__(self) -> tuple[Any, ...]:
        if self.rebuild is None:
            raise UsageError("this environment was built by hand and cannot be copied to another process")
        return self.rebuild, ()


def forward_pass(policy: Predictor, seat: SeatLayout) -> ForwardPass:
    """Return a forward pass of a policy that acts for an agent."""
    options = sum(len(part.options) for part in seat.member.program.agent.choices)
    return ForwardPass(seat.observation_space, options if policy.takes_masks else None)


class PolicyAct:
    """Acts for an agent with a policy, which takes its most likely action, in one row of a forward pass."""

    def __init__(self, policy: Predictor, seat: Seat) -> None:
        self._policy = policy
        self._seat = seat
        self.begin()

    def begin(self, number: int = 0) -> None:
        """Begin the episode of this number: a recurrent policy forgets the previous one."""
        # The row that `_PolicyRows` of a batch gives to the world of this number.
        self._row = number % FORWARD_BATCH_SIZE
        self._forward = forward_pass(self._policy, self._seat)

    def __call__(self, observation: Any) -> Any:
        masks = self._seat.action_mask() if self._policy.takes_masks else None
        self._forward.put(self._row, observation, masks)
        return self._forward.predict(self._policy, deterministic=True)[self._row]


def driven(world: Supervisor, seat: Seat, driver: str) -> Act:
    """Return who acts for an agent: a script, `random` or `zero`."""
    agent = seat.member.program.agent
    if driver == ZERO:
        still = seat.still
        return lambda _: still
    if driver != RANDOM:
        return lambda _: seat.script(driver)

    def act(_: Any) -> Any:
        """Draw an action from a stream of the world, so that a repeated episode has the same actions."""
        generator = world.streams[f"agents.{seat.member.name}.{RANDOM}"]
        return compose_action(
            seat.action_space,
            [int(generator.integers(len(part.options))) for part in agent.choices],
            generator.uniform(-1.0, 1.0, len(agent.range_names)).tolist(),
        )

    return act


_Parts = tuple[Column, Column]
"""Actions of one agent in all worlds: options by number (world, choice), and numbers (world, range)."""
_Act = Callable[[Any, Column], _Parts]
"""Acts for an agent in all worlds, given the observations of all agents and which worlds act."""


class AgentBatch:
    """The batch of one of several agents. It has the interface of a batch, with a row per world; what it does
    not define is the same for all agents.

    Attributes:
        world: The batch of all agents.
        scenario: The program of the agent.

    Args:
        policies: The policies that act for other agents, by the name of the agent.
    """

    copies = 1

    def __init__(
        self,
        world: BatchSupervisor,
        scenario: Program,
        policies: Mapping[str, Predictor] = MappingProxyType({}),
    ) -> None:
        others = scenario.others
        assert others is not None
        self.world = world
        self.scenario = scenario
        self.agent = scenario.agent
        self.singles = [AgentEnvironment(single, scenario, policies=policies) for single in world.singles]
        self.count = len(self.singles)
        self.rows = WorldRows(1, has_copies=False)
        members = world.scenario.members
        self._seats = {name: SeatLayout(member, world.agent) for name, member in members.items()}
        self._own = self._seats[others.agent]
        self.observation_space, self.action_space = self._own.observation_space, self._own.action_space
        self.TERMS = tuple(self._own.member.terms)
        self._terms = [world.TERMS.index(name) for name in self._own.member.terms.values()]
        self.histories = EpisodeHistories(self.count)
        choices = self.agent.choices
        self.forbids_options = any(option.forbidden for part in choices for option in part.options)
        names = {part.name: qualified_name(others.agent, part.name) for part in choices}
        self.options = world.options.of_agent(self.agent, names)
        self._policies = {
            name: _PolicyRows(policy, self._seats[name], world) for name, policy in policies.items()
        }
        self._acts: dict[str, _Act] = {
            name: self._policies.get(name) or _driven(world, self._seats[name], driver)
            for name, driver in others.drivers.items()
        }

    def __getattr__(self, name: str) -> Any:
        # Before `__init__` has set `world`, the lookup below would call itself without end.
        if name.startswith("_") or name == "world":
            raise AttributeError(name)
        return getattr(self.world, name)

    # Course

    def reset(self, seeds: Sequence[int | None], options: dict[str, Any] | None = None) -> Any:
        """See `BatchSupervisor.reset`."""
        if options:
            self.world.singles[0].require_drawable(options)
        self.begin_all(seeds, [options] * self.count)
        return self.observations()

    def begin_all(self, seeds: Sequence[int | None], options: Sequence[Mapping[str, Any] | None]) -> None:
        """See `BatchSupervisor.begin_all`."""
        self.world.begin_all(seeds, options)
        self._begun(range(self.count))

    def begin(
        self,
        worlds: Sequence[int],
        seeds: Sequence[int | None],
        options: Sequence[Mapping[str, Any] | None] | None = None,
    ) -> None:
        """See `BatchSupervisor.begin`."""
        self.world.begin(worlds, seeds, options)
        self._begun(worlds)

    def _begun(self, worlds: Sequence[int]) -> None:
        for world in worlds:
            self.histories.starts[world] = self.world.histories.starts[world]
            self.histories.options[world] = self.world.histories.options[world]
            self.singles[world].begin(self.world.singles[world].get_info())
        self.histories.begin(worlds)
        self._begin_policies(worlds)

    def _begin_policies(self, worlds: Sequence[int]) -> None:
        for policy in self._policies.values():
            policy.begin(worlds)

    def step(self, action: Any) -> BatchStep:
        """See `BatchSupervisor.step`."""
        return advance_and_begin(self, action)

    def advance(self, action: Any, resting: Column | None = None) -> BatchStep:
        """See `BatchSupervisor.advance`."""
        together = self._of_all(action, np.ones(self.count, bool) if resting is None else ~resting)
        outcome = self.world.advance(together, resting)
        terms = outcome.terms[self._terms]
        return outcome._replace(
            observations=self._own.observation(outcome.observations),
            rewards=terms.sum(axis=0),
            terms=terms,
            final_observations=(
                None
                if outcome.final_observations is None
                else self._own.observation(outcome.final_observations)
            ),
            infos=[
                self._info(world, info)
                for world, info in zip(outcome.done.tolist(), outcome.infos, strict=True)
            ],
        )

    def _of_all(self, action: Any, acting: Column) -> Any:
        """Return the actions of all agents, given those of the agent, which are recorded."""
        action = apply_to_parts(np.array, action)
        self.histories.actions.append(action)
        observations = self.world.observations()
        parts = [
            self._acts[name](observations, acting) if name in self._acts else parts_of_rows(action)
            for name in self._seats
        ]
        choices, ranges = (np.concatenate(columns, axis=1) for columns in zip(*parts, strict=True))
        return compose_rows(self.world.action_space, choices, ranges)

    def restore(
        self, episodes: Sequence[EpisodeHistory], on_step: Callable[[Column], None] = lambda acting: None
    ) -> Any:
        """See `BatchSupervisor.restore`. The other agents act again."""
        self.histories.actions = []
        acting = np.ones(self.count, bool)
        self.world.restore(
            episodes,
            on_step,
            on_begin=self._begin_policies,
            complete=lambda action: self._of_all(action, acting),
        )
        self.histories.replace(episodes)
        return self.observations()

    # Results of the last step

    def observations(self) -> Any:
        return self._own.observation(self.world.observations())

    def rewards(self) -> Column:
        rewards: Column = self.terms().sum(axis=0)
        return rewards

    def terms(self) -> Column:
        return self.world.terms()[self._terms]

    def action_masks(self) -> Column:
        return self.options.by_row()

    def _info(self, world: int, of_all: Mapping[str, Any]) -> dict[str, Any]:
        info = own_info(self._own.member, of_all)
        info.pop("action_mask", None)
        if self.forbids_options:
            info["action_mask"] = self.options.of_space(self.action_space, world)
        return info

    def close(self) -> None:
        """Release all worlds."""
        self.world.close()


class _PolicyRows:
    """Acts for an agent with a policy, which takes its most likely actions, in all worlds: world i in row i
    mod `FORWARD_BATCH_SIZE` of one of several forward passes."""

    def __init__(self, policy: Predictor, seat: SeatLayout, world: BatchSupervisor) -> None:
        self._policy = policy
        self._seat = seat
        self._world = world
        count = len(world.singles)
        self._slices = [
            slice(first, min(first + FORWARD_BATCH_SIZE, count))
            for first in range(0, count, FORWARD_BATCH_SIZE)
        ]
        self._passes: list[ForwardPass] = [forward_pass(policy, seat) for _ in self._slices]

    def begin(self, worlds: Sequence[int]) -> None:
        """Begin episodes: a recurrent policy forgets the previous ones."""
        for world in worlds:
            self._passes[world // FORWARD_BATCH_SIZE].starts[world % FORWARD_BATCH_SIZE] = True

    def __call__(self, of_all: Any, acting: Column) -> _Parts:
        observations = self._seat.observation(of_all)
        masks = self._world.action_masks()[:, self._seat.masks] if self._policy.takes_masks else None
        answers = []
        for rows, forward in zip(self._slices, self._passes, strict=True):
            forward.put_all(observations, rows, masks)
            answer = forward.predict(self._policy, deterministic=True)
            answers.append(apply_to_parts(itemgetter(slice(rows.stop - rows.start)), answer))
        return parts_of_rows(apply_to_parts(lambda *parts: np.concatenate(parts), *answers))


def _driven(world: BatchSupervisor, seat: SeatLayout, driver: str) -> _Act:
    """Return who acts for an agent in all worlds: a script, `random` or `zero`."""
    member = seat.member
    agent = seat.member.program.agent
    count = len(world.singles)
    options = [len(part.options) for part in agent.choices]
    width = len(agent.range_names)
    still = np.zeros((count, len(options)), np.int64), np.zeros((count, width), np.float32)
    if driver == ZERO:
        return lambda observations, acting: still
    if driver == RANDOM:

        def draw(observations: Any, acting: Column) -> _Parts:
            """Draw from the streams of the worlds, as `agents.driven` does."""
            choices, ranges = (part.copy() for part in still)
            for row in np.flatnonzero(acting).tolist():
                generator = world.singles[row].streams[f"agents.{member.name}.{RANDOM}"]
                choices[row] = [generator.integers(many) for many in options]
                ranges[row] = generator.uniform(-1.0, 1.0, width)
            return choices, ranges

        return draw
    script = qualified_name(member.name, driver)

    def follow(observations: Any, acting: Column) -> _Parts:
        with np.errstate(all="ignore"):
            choices, ranges = parts_of_rows(world.script(script))
        return choices[:, slice(*member.choices)], ranges[:, slice(*member.ranges)]

    return follow
