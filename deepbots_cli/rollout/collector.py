"""Experience for a learner, fragment by fragment.

A `Collector` returns the next fragment for the learner: the rows of some steps, and the episodes that ended.
`LocalCollector` steps worlds in this process.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np

from deepbots_cli.rollout.worlds import Array, Ending, Worlds, WorldsStep, observation_digest
from deepbots_cli.runtime.batch import EpisodeHistory
from deepbots_cli.runtime.spaces import apply_to_parts

_NOISE = 0.1
"""The standard deviation of the noise on ranges while a script drives, in the agent's [-1, 1]."""


class Decision(NamedTuple):
    """The output of an actor: `actions` for the worlds, one per row, and further arrays (`columns`) to store
    in the fragment."""

    actions: Array
    columns: Mapping[str, Array] = {}


Actor = Callable[[Any, Array, Array | None], Decision]
"""Acts on the observations of all rows, given which rows begin an episode, and which options are allowed
(None: all)."""


class Lesson(NamedTuple):
    """The lesson of a script in a fragment: its actions become the column `taught`, and it drives the first
    `worlds`."""

    script: str
    worlds: int


class PolicyActor(Protocol):
    """An actor with the policy of a learner, of which shards have copies."""

    def __call__(self, observations: Any, starts: Array, masks: Array | None) -> Decision: ...

    def begin(self) -> None:
        """Called before each fragment."""

    def parameters(self) -> Mapping[str, Any]:
        """Return the values that copies in shards must have in common with the actor: weights, and numbers
        such as the rate of exploration."""

    def memory(self) -> Mapping[str, Array]:
        """Return the memory of the policy between two fragments: arrays with a row for each agent."""

    def load(self, parameters: Mapping[str, Any]) -> None:
        """Take over the parameters of another actor."""

    def remember(self, memory: Mapping[str, Array]) -> None:
        """Take over a memory."""


OnStep = Callable[[WorldsStep], bool]
"""Called after each step of all rows; returns whether to continue."""


@dataclass(frozen=True)
class Fragment:
    """The experience of some steps: arrays of shape (steps, rows, ...), or a dictionary of arrays for
    observations with parts.

    Attributes:
        observations: The observations on which the agents acted.
        actions: The actions of the agents.
        rewards: float32.
        starts: Whether an episode began with the observation.
        columns: Further arrays of the actor, such as values and log-probabilities.
        following: The observations after the last step, of shape (rows, ...).
        following_starts: Whether an episode begins with them.
        endings: The episodes that ended, each with the number of the step, in the order of steps and rows.
        agent_rewards: The rewards of each of several agents in a world, as `rewards`.
        agent_phases: The phases of those agents whose episode may end while others go on (`Phase`).
        taking_part: In the fragment of one of several agents, the steps of its own episodes; None if these
            are all steps.
    """

    observations: Any
    actions: Array
    rewards: Array
    starts: Array
    columns: Mapping[str, Array]
    following: Any
    following_starts: Array
    endings: Sequence[tuple[int, Ending]]
    agent_rewards: Mapping[str, Array] = field(default_factory=dict)
    agent_phases: Mapping[str, Array] = field(default_factory=dict)
    taking_part: Array | None = None


class ShardState(NamedTuple):
    """The running episode of each world, and the digest of the present observations."""

    episodes: list[EpisodeHistory]
    observed: str


@dataclass
class CollectTimes:
    """The time of the parts of a collector, in seconds by the clock, added up over its fragments.

    Attributes:
        worlds: Steps of the worlds; with shards in several processes, the mean of these processes.
        waiting: The time that the slowest process took longer than the mean.
        transfer: The time of orders and answers beside the work of the slowest process.
    """

    worlds: float = 0.0
    waiting: float = 0.0
    transfer: float = 0.0


class Collector(Protocol):
    """Collects the experience of a learner."""

    rows: int
    times: CollectTimes
    observation_space: gym.Space[Any]
    action_space: gym.Space[Any]
    stale: Mapping[str, Array]
    """The weights with which the next fragment is collected, if they are not the newest ones."""

    def collect(
        self,
        actor: Actor,
        steps: int,
        on_step: OnStep,
        *,
        with_masks: bool = False,
        lesson: Lesson | None = None,
    ) -> Fragment | None:
        """Collect the next `steps` of every row; None if `on_step` ended them before. With `with_masks`, the
        actor gets the allowed options."""

    def state(self) -> ShardState:
        """Return the state from which another collector with the same worlds continues, between two
        fragments."""

    def restore(self, state: ShardState, seeds: Sequence[int]) -> bool:
        """Continue from a state. Returns False if the observations differ; the worlds then restart from
        `seeds`."""


class LocalCollector:
    """Collects from worlds in this process."""

    def __init__(self, worlds: Worlds) -> None:
        self.worlds = worlds
        self.rows = worlds.rows
        self.observation_space = worlds.observation_space
        self.action_space = worlds.action_space
        self.times = CollectTimes()
        self.stale: Mapping[str, Array] = {}
        self.starts = np.ones(self.rows, bool)
        """Whether an episode begins with the observations on which the agents act next."""

    @property
    def agents(self) -> Sequence[Any]:
        """The agent of each row."""
        return self.worlds.agents

    def action_masks(self) -> Array | None:
        """Return which options are allowed in each row; None if the worlds have no masks."""
        return self.worlds.action_masks()

    def begin(self) -> Any:
        """Return the observations on which the agents act next. The first episodes begin if none has."""
        return self.worlds.reset() if self.worlds.observations is None else self.worlds.observations

    def collect(
        self,
        actor: Actor,
        steps: int,
        on_step: OnStep = lambda step: True,
        *,
        with_masks: bool = False,
        lesson: Lesson | None = None,
    ) -> Fragment | None:
        observations = self.begin()
        starts = self.starts
        observation_rows = []
        decisions = []
        rewards = []
        begun = []
        endings = []
        agent_rewards: list[Mapping[str, Array]] = []
        agent_phases: list[Mapping[str, Array]] = []
        for number in range(steps):
            decision = actor(observations, starts, self.action_masks() if with_masks else None)
            if lesson is not None:
                decision = self.taught(decision, lesson)
            observation_rows.append(observations)
            decisions.append(decision)
            begun.append(starts)
            step = self.step_all(decision.actions)
            if not on_step(step):
                return None
            rewards.append(step.rewards)
            agent_rewards.append(step.agent_rewards)
            agent_phases.append(step.agent_phases)
            endings += [(number, ending) for ending in step.endings]
            observations, starts = step.observations, step.ended
        columns = {
            name: np.stack([decision.columns[name] for decision in decisions])
            for name in decisions[0].columns
        }
        actions = np.stack([decision.actions for decision in decisions])
        return Fragment(
            join_observations(np.stack, observation_rows),
            actions,
            np.stack(rewards),
            np.stack(begun),
            columns,
            observations,
            starts,
            endings,
            {name: np.stack([rewards[name] for rewards in agent_rewards]) for name in agent_rewards[0]},
            {name: np.stack([phases[name] for phases in agent_phases]) for name in agent_phases[0]},
        )

    def taught(self, decision: Decision, lesson: Lesson) -> Decision:
        """Return the decision in a step of a lesson. Noise is added to the actions of the script, so that the
        fragment contains more states."""
        taught = self.worlds.scripted(lesson.script)
        columns = {**decision.columns, "taught": taught}
        actions = np.array(decision.actions)
        lesson_actions = taught[: lesson.worlds]
        if lesson.worlds:
            if isinstance(self.action_space, gym.spaces.Box):
                # Each shard seeds the global generator of numpy anew for a fragment.
                lesson_actions = np.clip(
                    lesson_actions + np.random.normal(0.0, _NOISE, lesson_actions.shape), -1.0, 1.0
                )
            actions[: lesson.worlds] = lesson_actions
            # The replay buffer of an off-policy learner takes the actions from this column.
            if "stored" in columns:
                columns["stored"] = np.array(columns["stored"])
                columns["stored"][: lesson.worlds] = lesson_actions
        return Decision(actions, columns)

    def step_all(self, actions: Any) -> WorldsStep:
        """Make one step, for a learner that steps by itself."""
        began = perf_counter()
        outcome = self.worlds.step_all(actions)
        self.times.worlds += perf_counter() - began
        self.starts = outcome.ended
        return outcome

    def state(self) -> ShardState:
        return ShardState(self.worlds.histories(), observation_digest(self.worlds.observations))

    def repeat(self, episodes: Sequence[EpisodeHistory]) -> Any:
        """Continue from the running episode of each world. Returns the observations."""
        self.starts = np.repeat([not episode.actions for episode in episodes], self.rows // len(episodes))
        return self.worlds.repeat(episodes)

    def restore(self, state: ShardState, seeds: Sequence[int]) -> bool:
        if observation_digest(self.repeat(state.episodes)) == state.observed:
            return True
        self.worlds.seeds = list(seeds)
        self.worlds.reset()
        self.starts = np.ones(self.rows, bool)
        return False


def join(fragments: Sequence[Fragment]) -> Fragment:
    """Join the fragments of shards 0, 1, 2, ..., with the rows of the first shard first."""
    offsets = np.cumsum([0, *(fragment.rewards.shape[1] for fragment in fragments)])
    endings = [
        (number, ending._replace(row=ending.row + int(offset)))
        # The last offset is the number of all rows, and belongs to no fragment.
        for fragment, offset in zip(fragments, offsets, strict=False)
        for number, ending in fragment.endings
    ]

    def side_by_side(parts: Sequence[Any]) -> Any:
        return np.concatenate(parts, axis=1)

    return Fragment(
        join_observations(side_by_side, [fragment.observations for fragment in fragments]),
        side_by_side([fragment.actions for fragment in fragments]),
        side_by_side([fragment.rewards for fragment in fragments]),
        side_by_side([fragment.starts for fragment in fragments]),
        {
            name: side_by_side([fragment.columns[name] for fragment in fragments])
            for name in fragments[0].columns
        },
        join_observations(np.concatenate, [fragment.following for fragment in fragments]),
        np.concatenate([fragment.following_starts for fragment in fragments]),
        # The order in which a single process meets them, on which the statistics depend.
        sorted(endings, key=lambda entry: (entry[0], entry[1].row)),
        {
            name: side_by_side([fragment.agent_rewards[name] for fragment in fragments])
            for name in fragments[0].agent_rewards
        },
        {
            name: side_by_side([fragment.agent_phases[name] for fragment in fragments])
            for name in fragments[0].agent_phases
        },
    )


def join_observations(join_arrays: Callable[[Sequence[Any]], Any], observations: Sequence[Any]) -> Any:
    """Join observations array by array."""
    return apply_to_parts(lambda *parts: join_arrays(parts), *observations)
