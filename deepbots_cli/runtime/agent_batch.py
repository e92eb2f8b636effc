"""A batch of worlds of several agents, as one of them has it: the others act by themselves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from types import MappingProxyType
from typing import Any

import numpy as np

from deepbots_cli.program import Program
from deepbots_cli.program.members import RANDOM, ZERO, qualified_name
from deepbots_cli.runtime.agents import AgentEnvironment, SeatLayout, forward_pass, own_info
from deepbots_cli.runtime.batch import (
    BatchStep,
    BatchSupervisor,
    EpisodeHistories,
    EpisodeHistory,
    advance_and_begin,
)
from deepbots_cli.runtime.copies import WorldRows
from deepbots_cli.runtime.forward_pass import FORWARD_BATCH_SIZE, ForwardPass, Predictor
from deepbots_cli.runtime.spaces import Column, apply_to_parts, compose_rows, parts_of_rows

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
