"""The experience of each of several agents in the same worlds.

The worlds of several agents are stepped by one collector, with the actions of all agents in a row. A
`SeatCollector` has the part of the agents with one policy in the last fragment, so that their learner learns
from it as from worlds of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from deepbots_cli.rollout.collector import (
    Decision,
    FetchingCollector,
    Fragment,
    Lesson,
    PolicyActor,
    join,
)
from deepbots_cli.rollout.episode import own_episode
from deepbots_cli.rollout.worlds import Array, Ending, Phase
from deepbots_cli.runtime.agents import SeatLayout
from deepbots_cli.runtime.spaces import apply_to_parts

_SEPARATOR = "/"
"""Between the name of an agent and a name of its own, in names of columns, weights and memories."""


def own_name(agent: str, name: str) -> str:
    """Return a name of an agent among those of all agents."""
    return f"{agent}{_SEPARATOR}{name}"


def own_entries(entries: Mapping[str, Any], agent: str) -> dict[str, Any]:
    """Return the entries of an agent under their own names."""
    prefix = own_name(agent, "")
    return {name.removeprefix(prefix): value for name, value in entries.items() if name.startswith(prefix)}


class _NoWorld:
    """The world of an agent whose learner does not step it: only what a vector environment asks for."""

    render_mode = None

    def get_wrapper_attr(self, name: str) -> Any:
        return getattr(self, name)


class SeatCollector(FetchingCollector):
    """The parts of the agents with one policy in the fragments of all agents, which are offered to it. A row
    is an agent in a world: first the worlds of the first agent.

    Args:
        seats: The places of these agents, which have equal spaces.
        collector: The collector of the worlds.
        worlds: The worlds in which each of them has the policy; by default all.
    """

    def __init__(
        self, seats: Sequence[SeatLayout], collector: Any, worlds: Sequence[Array] | None = None
    ) -> None:
        self._seats = seats
        self._collector = collector
        self._worlds = worlds
        self.rows = len(seats) * collector.rows if worlds is None else sum(map(len, worlds))
        self.stale = {}
        self.agents = (_NoWorld(),)
        self.observation_space, self.action_space = seats[0].observation_space, seats[0].action_space
        self._fragment: Fragment | None = None

    @property
    def starts(self) -> Array:
        """For each row, whether an episode begins with the observations on which the agent acts next."""
        starts: Array = self.rows_of([self._collector.starts] * len(self._seats))
        return starts

    def begin(self) -> Any:
        return self.seen(self._collector.begin())

    def rows_of(self, parts: Sequence[Any]) -> Any:
        """Return the rows of the policy, given those of each agent in all worlds."""
        worlds = self._worlds

        def rows(*agent_rows: Array) -> Array:
            if worlds is None:
                return np.concatenate(agent_rows)
            return np.concatenate(
                [part.take(chosen, 0) for part, chosen in zip(agent_rows, worlds, strict=True)]
            )

        return apply_to_parts(rows, *parts)

    def seen(self, observations: Any) -> Any:
        """Return the observations of the policy, given those of all agents in all worlds."""
        return self.rows_of([seat.observation(observations) for seat in self._seats])

    def part_of(self, fragment: Fragment) -> Fragment:
        """Return the part of a fragment of all agents."""
        parts = [_own_part(seat, fragment) for seat in self._seats]
        if self._worlds is not None:
            parts = [_in_worlds(part, worlds) for part, worlds in zip(parts, self._worlds, strict=True)]
        if len(parts) == 1:
            return parts[0]
        if all(part.taking_part is None for part in parts):
            return join(parts)
        # An agent without rests takes part in every step.
        taking_part = [
            np.ones(part.rewards.shape, bool) if part.taking_part is None else part.taking_part
            for part in parts
        ]
        return replace(join(parts), taking_part=np.concatenate(taking_part, axis=1))

    def offer(self, fragment: Fragment) -> None:
        """Take the part of a fragment of all agents, which `fetch` then returns."""
        self._fragment = self.part_of(fragment)

    def fetch(
        self, actor: PolicyActor, steps: int, *, with_masks: bool = False, lesson: Lesson | None = None
    ) -> Fragment:
        fragment = self._fragment
        if fragment is None or len(fragment.rewards) != steps:
            raise RuntimeError("no fragment of this length was offered to the agent")
        self._replay = fragment.steps()
        return fragment


def own_ending(seat: SeatLayout, ending: Ending) -> Ending:
    """Return the last step of an episode as it was for an agent."""
    has_ended = seat.member.name in ending.episode.agent_endings
    return ending._replace(
        episode=own_episode(seat.member, ending.episode),
        observation=seat.observation(ending.observation),
        # The episode of an agent that ended alone was over before the limit of the world.
        timed_out=ending.timed_out and not has_ended,
    )


def _own_part(seat: SeatLayout, fragment: Fragment) -> Fragment:
    """Return the part of an agent in a fragment of all agents."""
    name = seat.member.name
    return replace(
        _own_course(fragment, fragment.agent_phases.get(name)),
        observations=seat.observation(fragment.observations),
        actions=seat.actions(fragment.actions),
        rewards=fragment.agent_rewards[name],
        columns=own_entries(fragment.columns, name),
        following=seat.observation(fragment.following),
        endings=[(number, own_ending(seat, ending)) for number, ending in fragment.endings],
        agent_rewards={},
        agent_phases={},
    )


def _in_worlds(fragment: Fragment, worlds: Array) -> Fragment:
    """Return a fragment with the rows of these worlds alone, without the columns of the actor."""

    def rows(array: Array) -> Array:
        return array.take(worlds, 1)

    places = {int(world): row for row, world in enumerate(worlds)}
    return replace(
        fragment,
        observations=apply_to_parts(rows, fragment.observations),
        actions=rows(fragment.actions),
        rewards=rows(fragment.rewards),
        starts=rows(fragment.starts),
        columns={},
        following=apply_to_parts(lambda array: array.take(worlds, 0), fragment.following),
        following_starts=fragment.following_starts.take(worlds),
        endings=[
            (number, ending._replace(row=places[ending.row]))
            for number, ending in fragment.endings
            if ending.row in places
        ],
    )


def _own_course(fragment: Fragment, phases: Array | None) -> Fragment:
    """Return a fragment with the episodes of an agent, which may end while others go on. The rest of the
    episode of the world is an episode in which the agent does not take part."""
    if phases is None:
        return fragment
    ends = phases == Phase.ENDS
    # A copy, because the parts of the other agents come from the same arrays.
    starts = fragment.starts.copy()
    starts[1:] |= ends[:-1]
    return replace(
        fragment,
        starts=starts,
        following_starts=fragment.following_starts | ends[-1],
        taking_part=phases != Phase.RESTS,
    )


class MultiAgentActor(PolicyActor):
    """Acts for several agents in the same worlds, each with its own actor.

    Args:
        seats: The place of each agent, by name.
        actors: The actor of each agent.
        masked: The agents whose actors take masks of the allowed options.
    """

    def __init__(
        self, seats: Mapping[str, SeatLayout], actors: Mapping[str, PolicyActor], masked: Sequence[str] = ()
    ) -> None:
        self._seats = seats
        self._actors = actors
        self._masked = masked

    def begin(self) -> None:
        for actor in self._actors.values():
            actor.begin()

    def __call__(self, observations: Any, starts: Array, masks: Array | None) -> Decision:
        decisions = {
            name: actor(
                self._seats[name].observation(observations),
                starts,
                masks[:, self._seats[name].masks] if masks is not None and name in self._masked else None,
            )
            for name, actor in self._actors.items()
        }
        columns = {
            own_name(name, column): array
            for name, decision in decisions.items()
            for column, array in decision.columns.items()
        }
        return Decision(joined_actions([decision.actions for decision in decisions.values()]), columns)

    def parameters(self) -> Mapping[str, Any]:
        return self._joined_entries(lambda actor: actor.parameters())

    def load(self, parameters: Mapping[str, Any]) -> None:
        for name, actor in self._actors.items():
            actor.load(own_entries(parameters, name))

    def memory(self) -> Mapping[str, Array]:
        return self._joined_entries(lambda actor: actor.memory())

    def remember(self, memory: Mapping[str, Array]) -> None:
        for name, actor in self._actors.items():
            actor.remember(own_entries(memory, name))

    def _joined_entries(self, entries: Any) -> dict[str, Any]:
        return {
            own_name(name, key): value
            for name, actor in self._actors.items()
            for key, value in entries(actor).items()
        }


def joined_actions(actions: Sequence[Array]) -> Array:
    """Return the actions of all agents in a row, given those of each, of shape (rows, ...)."""
    return np.concatenate([part.reshape(len(part), -1) for part in actions], axis=1)
