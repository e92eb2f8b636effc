"""Experience for a learner, fragment by fragment: from worlds of this process, and from shards.

A `Collector` returns the next fragment for the learner: the rows of some steps, and the episodes that ended.
`LocalCollector` steps worlds in this process. The worlds of several agents are stepped by one collector, with
the actions of all agents in a row, and a `SeatCollector` has the part of the agents with one policy.

`ShardedCollector` gathers the fragments of shards. Each shard steps some of the worlds with its own copy of
the policy, in this process or in another one (`ShardPool`). The experience does not depend on where shards
run, because:

- The worlds of a shard have their own seeds and random streams. The policy of a shard draws from generators
that are seeded anew for each fragment, with the number of the shard and of the steps before.
- Fragments are joined by the number of their shard (`join`), never by the order in which they arrive.
- The collector keeps the start and the actions of each running episode. Another shard can continue from there
exactly.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from operator import itemgetter
from typing import Any, NamedTuple, Protocol, cast

import gymnasium as gym
import numpy as np

from deepbots_cli.records import dataclass
from deepbots_cli.rollout.episode import Episode, own_episode
from deepbots_cli.rollout.worlds import Array, Ending, Phase, Worlds, WorldsStep, observation_digest
from deepbots_cli.runtime.agents import SeatLayout
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


class PolicyActor(ABC):
    """An actor with the policy of a learner, of which shards have copies."""

    @abstractmethod
    def __call__(self, observations: Any, starts: Array, masks: Array | None) -> Decision: ...

    @abstractmethod
    def parameters(self) -> Mapping[str, Any]:
        """Return the values that copies in shards must have in common with the actor: weights, and numbers
        such as the rate of exploration."""

    @abstractmethod
    def load(self, parameters: Mapping[str, Any]) -> None:
        """Take over the parameters of another actor."""

    def begin(self) -> None:  # noqa: B027  # some actors do nothing here
        """Called before each fragment."""

    def memory(self) -> Mapping[str, Array]:
        """Return the memory of the policy between two fragments: arrays with a row for each agent. By
        default, it has none."""
        return {}

    def remember(self, memory: Mapping[str, Array]) -> None:  # noqa: B027  # of a policy with a memory
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

    def steps(self) -> Iterator[WorldsStep]:
        """Yield the steps in their order, without infos."""
        endings: dict[int, list[Ending]] = {}
        for number, ending in self.endings:
            endings.setdefault(number, []).append(ending)
        for number, rewards in enumerate(self.rewards):
            is_last = number + 1 == len(self.rewards)
            following = (
                self.following if is_last else apply_to_parts(itemgetter(number + 1), self.observations)
            )
            ended = self.following_starts if is_last else self.starts[number + 1]
            yield WorldsStep(following, rewards, ended, [{}] * len(rewards), endings.get(number, []))


class ShardState(NamedTuple):
    """The running episode of each world, and the digest of the present observations."""

    episodes: list[EpisodeHistory]
    observed: str


class Collector(Protocol):
    """Collects the experience of a learner."""

    rows: int
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
        outcome = self.worlds.step_all(actions)
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


@dataclass(frozen=True)
class Order:
    """A request to a shard for `steps` of each row.

    Attributes:
        parameters: The parameters of the actor.
        begun: Steps of the training before the fragment, summed over all rows.
        next_episode: The number of the next episode of the training, from 1.
        stage: The number of the present stage of the curriculum.
        with_masks: Whether the actor uses masks of the allowed options.
        lesson: The lesson of a script; its `worlds` are counted over all shards.
    """

    parameters: Mapping[str, Any]
    steps: int
    begun: int
    next_episode: int
    stage: int
    with_masks: bool
    lesson: Lesson | None = None


@dataclass(frozen=True)
class EvaluationOrder:
    """An evaluation of the policy, which the shards divide among them.

    Attributes:
        parameters: The parameters of the actor.
        seeds: The start of each episode.
        stage: The name of the stage of the curriculum; None without stages.
    """

    parameters: Mapping[str, Any]
    seeds: Sequence[int]
    stage: str | None


@dataclass(frozen=True, kw_only=True)
class Answer:
    """The answer of a shard.

    Attributes:
        notes: Notes for the user, such as lost episodes.
        cpu_seconds: CPU time, if the shard runs in another process.
    """

    notes: Sequence[str] = ()
    cpu_seconds: float = 0.0


@dataclass(frozen=True)
class Evaluated(Answer):
    """The episodes of an evaluation that a shard has played, by their numbers."""

    episodes: Mapping[int, Episode]


@dataclass(frozen=True)
class ShardResult(Answer):
    """The experience that a shard has collected for an order.

    Attributes:
        fragment: The experience of its rows.
        memory: The memory of its actor after the fragment.
        ended: For each ending of the fragment, the stage of the episode, and its drawn values.
        begun: For each world that has begun another episode, by its number in the shard, the start of this
            episode, and its stage.
    """

    fragment: Fragment
    memory: Mapping[str, Array]
    ended: Sequence[tuple[int, Mapping[str, Any]]]
    begun: Mapping[int, tuple[int | dict[str, Any], int]]


class RunningEpisode(NamedTuple):
    """The running episode of a world, and the stage of the curriculum that it belongs to; `actions` has the
    shape (steps, ...)."""

    start: int | dict[str, Any]
    actions: Array
    stage: int

    @property
    def history(self) -> EpisodeHistory:
        return EpisodeHistory(self.start, list(self.actions))


class ShardPool(Protocol):
    """The shards of a training, wherever they run."""

    def work(
        self,
        order: Order | EvaluationOrder | None,
        episodes: Sequence[Sequence[RunningEpisode]],
        memories: Sequence[Mapping[str, Array]],
    ) -> Callable[[], list[Any]]:
        """Request the answer of each shard to an order: a `ShardResult`, or its part of an evaluation
        (`Evaluated`). `episodes` are those after the last result. Without an order, the worlds are brought to
        their end, and the answers are the observations. The returned function waits for the answers."""


class ShardListener(Protocol):
    """The training, as a listener that counts the experience of shards."""

    def present(self) -> tuple[int, int, int]:
        """Return the steps so far, the number of the next episode, and the number of the present stage of the
        curriculum."""

    def on_row(self) -> None:
        """Called for each row of each step."""

    def on_episode(self, world: int, episode: Episode, stage: int, draws: Mapping[str, Any]) -> None:
        """Called for each episode with the number of its world, in the order of steps and rows."""

    def on_answer(self, answer: Answer) -> None:
        """Called with each answer of a shard, before its episodes are counted."""


class FetchingCollector(ABC):
    """A collector whose worlds have acted before its steps are counted: `fetch` returns a fragment, and
    `step_all` then counts its steps one by one."""

    rows: int
    observation_space: gym.Space[Any]
    action_space: gym.Space[Any]
    stale: Mapping[str, Array]
    agents: Sequence[Any]
    _replay: Iterator[WorldsStep] = iter(())

    @abstractmethod
    def begin(self) -> Any:
        """Return the observations on which the agents act next. The first episodes begin if none has."""

    @abstractmethod
    def fetch(
        self, actor: PolicyActor, steps: int, *, with_masks: bool = False, lesson: Lesson | None = None
    ) -> Fragment:
        """Fetch the next `steps` of every row, which `step_all` then counts one by one."""

    def step_all(self, actions: Any) -> WorldsStep:
        """Return the next step of the fragment that was fetched. The worlds have acted already."""
        return next(self._replay)

    def collect(
        self,
        actor: Actor,
        steps: int,
        on_step: OnStep = lambda step: True,
        *,
        with_masks: bool = False,
        lesson: Lesson | None = None,
    ) -> Fragment | None:
        """Collect a fragment with a `PolicyActor`; see `Collector.collect`."""
        policy_actor = cast(PolicyActor, actor)
        fragment = self.fetch(policy_actor, steps, with_masks=with_masks, lesson=lesson)
        if not all(on_step(step) for step in self._replay):
            return None
        self.ask_ahead(policy_actor, steps, with_masks=with_masks)
        return fragment

    def ask_ahead(  # noqa: B027  # most collectors do nothing here
        self, actor: PolicyActor, steps: int, *, with_masks: bool = False
    ) -> None:
        """Called after the steps of a fragment are counted. A collector whose next fragment may have older
        weights requests it."""


class ShardedCollector(FetchingCollector):
    """Gathers the fragments of shards, and then counts their steps and episodes as if all worlds were in this
    process.

    Args:
        pool: The shards.
        seeds: The seed of the first episode of each world; worlds belong to shards in the order of their
            numbers.
        stages: The stage of each world, which is kept up to date.
        sizes: The number of worlds of each shard.
        agents: The agents of a world in this process, which computes the rewards of hindsight.
        listener: The training.
        is_ahead: Whether each fragment is collected during the update before it, with the weights before this
            update.
    """

    def __init__(
        self,
        pool: ShardPool,
        seeds: Sequence[int],
        stages: list[int],
        sizes: Sequence[int],
        agents: Sequence[Any],
        listener: ShardListener,
        *,
        is_ahead: bool = False,
    ) -> None:
        self._pool = pool
        self._is_ahead = is_ahead
        self._listener = listener
        self._sizes = sizes
        self._no_memories: list[Mapping[str, Array]] = [{} for _ in sizes]
        self._stages = stages
        self.agents = agents
        self._anew(seeds)
        self._width = len(agents)
        self.rows = self._width * len(seeds)
        self.observation_space, self.action_space = agents[0].observation_space, agents[0].action_space
        self.starts = np.ones(self.rows, bool)
        self.stale: Mapping[str, Array] = {}
        self._requested: Callable[[], list[ShardResult]] | None = None
        self._observations: Any = None

    def _anew(self, seeds: Sequence[int]) -> None:
        """Begin new episodes."""
        self.episodes = [
            RunningEpisode(seed, np.array([]), stage) for seed, stage in zip(seeds, self._stages, strict=True)
        ]

    def _by_shard(self, items: Any, width: int = 1) -> list[Any]:
        """Return items of worlds, or of rows with `width` rows for each world, for each shard."""
        ends = np.cumsum(self._sizes) * width
        return [items[end - size * width : end] for size, end in zip(self._sizes, ends, strict=True)]

    def begin(self) -> Any:
        if self._observations is None:
            self._observations = self._begun()
        return self._observations

    def _begun(self) -> Any:
        self.starts = np.repeat([not len(episode.actions) for episode in self.episodes], self._width)
        return join_observations(
            np.concatenate, self._pool.work(None, self._by_shard(self.episodes), self._no_memories)()
        )

    def fetch(
        self, actor: PolicyActor, steps: int, *, with_masks: bool = False, lesson: Lesson | None = None
    ) -> Fragment:
        answer = self._requested or self._ask(actor, steps, with_masks, lesson)
        results = answer()
        self._requested = None
        self.stale = {}
        actor.remember(
            {name: np.concatenate([result.memory[name] for result in results]) for name in results[0].memory}
        )
        for result in results:
            self._listener.on_answer(result)
        fragment = join([result.fragment for result in results])
        self._note_episodes(fragment, results)
        self._replay = self._steps(fragment, iter(_details(results)))
        return fragment

    def ask_ahead(self, actor: PolicyActor, steps: int, *, with_masks: bool = False) -> None:
        """Request the next fragment, which `fetch` then returns, with the present weights. Workers collect it
        during the next update."""
        if not self._is_ahead:
            return
        parameters = actor.parameters().items()
        # Copies, because the arrays share the memory of the weights, which the update changes.
        self.stale = {name: value.copy() for name, value in parameters if isinstance(value, np.ndarray)}
        self._requested = self._ask(actor, steps, with_masks, None)

    def _ask(
        self, actor: PolicyActor, steps: int, with_masks: bool, lesson: Lesson | None
    ) -> Callable[[], list[ShardResult]]:
        self.begin()
        memory = {name: self._by_shard(array, self._width) for name, array in actor.memory().items()}
        memories = [
            {name: parts[shard] for name, parts in memory.items()} for shard in range(len(self._sizes))
        ]
        begun, next_episode, stage = self._listener.present()
        # A resumed training has the older weights of its checkpoint here, without a request of its own.
        order = Order(
            {**actor.parameters(), **self.stale}, steps, begun, next_episode, stage, with_masks, lesson
        )
        return self._pool.work(order, self._by_shard(self.episodes), memories)

    def evaluate(self, actor: PolicyActor, seeds: Sequence[int], stage: str | None) -> list[Episode]:
        """Play an episode of the policy from each seed, in the order of the seeds."""
        order = EvaluationOrder(actor.parameters(), seeds, stage)
        episodes_by_number: dict[int, Episode] = {}
        for answer in self._pool.work(order, self._by_shard(self.episodes), self._no_memories)():
            self._listener.on_answer(answer)
            episodes_by_number.update(answer.episodes)
        return [episodes_by_number[number] for number in range(len(seeds))]

    def _note_episodes(self, fragment: Fragment, results: Sequence[ShardResult]) -> None:
        """Keep the start of the running episode of each world, and its actions."""
        begun = [
            result.begun.get(world)
            for result, size in zip(results, self._sizes, strict=True)
            for world in range(size)
        ]
        for world, beginning in enumerate(begun):
            first = world * self._width
            actions = (
                fragment.actions[:, first : first + self._width]
                if self._width > 1
                else fragment.actions[:, first]
            )
            if beginning is None:
                before = self.episodes[world]
                actions = np.concatenate([before.actions, actions]) if len(before.actions) else actions
                self.episodes[world] = before._replace(actions=actions)
            else:
                starts = np.flatnonzero(
                    np.append(fragment.starts[:, first], fragment.following_starts[first])
                )
                self.episodes[world] = RunningEpisode(beginning[0], actions[starts[-1] :], beginning[1])
        # In place, because this is the list of the curriculum.
        self._stages[:] = [episode.stage for episode in self.episodes]

    def _steps(
        self, fragment: Fragment, details: Iterator[tuple[int, Mapping[str, Any]]]
    ) -> Iterator[WorldsStep]:
        """Yield the steps of a fragment in their order. Each is counted when it is read."""
        for step in fragment.steps():
            endings = {ending.row: ending for ending in step.endings}
            for row in range(self.rows):
                self._listener.on_row()
                if row in endings:
                    stage, draws = next(details)
                    self._listener.on_episode(row // self._width, endings[row].episode, stage, draws)
            self.starts, self._observations = step.ended, step.observations
            yield step

    def state(self) -> ShardState:
        return ShardState([episode.history for episode in self.episodes], observation_digest(self.begin()))

    def restore(self, state: ShardState, seeds: Sequence[int]) -> bool:
        for world, history in enumerate(state.episodes):
            self.episodes[world] = RunningEpisode(
                history.start, np.array(history.actions), self.episodes[world].stage
            )
        self._observations = self._begun()
        if observation_digest(self._observations) == state.observed:
            return True
        self._anew(seeds)
        self._observations = self._begun()
        return False


def _details(results: Sequence[ShardResult]) -> list[tuple[int, Mapping[str, Any]]]:
    """Return stage and drawn values of each ending, in the order of the endings of the joined fragment."""
    details = [
        (number, shard, ending.row, detail)
        for shard, result in enumerate(results)
        for (number, ending), detail in zip(result.fragment.endings, result.ended, strict=True)
    ]
    # Without the details in the key: dictionaries have no order.
    return [detail for *_, detail in sorted(details, key=lambda entry: entry[:3])]


def own_name(agent: str, name: str) -> str:
    """Return a name of an agent among those of all agents."""
    return f"{agent}/{name}"


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
