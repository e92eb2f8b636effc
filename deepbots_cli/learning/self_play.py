"""One policy for two equal agents, which plays against itself and against past versions of itself.

In some worlds both agents are the present policy, and it learns from both sides. In the others it plays one
side, against a member of a pool of past policies that is drawn anew for each episode (fictitious self-play;
J. Heinrich, M. Lanctot, D. Silver, ICML 2015), or against a script of the scenario. The results of the
episodes against past policies give ratings (OpenSkill, in the model of Plackett and Luce; R. Weng, C.-J. Lin,
JMLR 2011).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, ClassVar, NamedTuple, cast

import numpy as np
from pydantic import Field, NonNegativeInt

from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.learning.checkpoints import Array, CheckpointPart, CheckpointState
from deepbots_cli.learning.learner import Learner, Setup
from deepbots_cli.learning.multi_agent import MultiAgentLearner, MultiAgentState, check_shared
from deepbots_cli.learning.runs.run import PoolGames, Rating
from deepbots_cli.program import qualified_name
from deepbots_cli.program.task import SelfPlay, Training
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.collector import (
    Decision,
    Fragment,
    LocalCollector,
    MultiAgentActor,
    PolicyActor,
    SeatCollector,
    joined_actions,
)
from deepbots_cli.rollout.episode import own_episode
from deepbots_cli.runtime.agents import SeatLayout
from deepbots_cli.runtime.spaces import apply_to_parts

_OPPONENTS = "opponents"
"""The column of a fragment with the opponent in each world: its place in the pool, or `_PRESENT`."""
_PRESENT = -1
"""The opponent of a world without one from the pool: the present policy."""
_FIRST_SCRIPT = -2
"""The opponent that is the first script; the next one is -3."""


class Sides(NamedTuple):
    """The worlds in which the policy plays each side.

    Attributes:
        first: The worlds in which it learns as the first agent.
        second: The worlds in which it learns as the second agent.
        others: The worlds in which a past policy or a script plays the other side.
        scripted: Those of them in which it is a script.
    """

    first: Array
    second: Array
    others: Array
    scripted: Array

    @classmethod
    def divided(cls, worlds: int, newest: float, scripts: float = 0.0) -> Sides:
        """Divide the worlds: in the first ones the policy plays against itself, and in the last ones against
        scripts. Where it plays one side, it takes each side in turn."""
        self_play_count = min(worlds, round(newest * worlds))
        opponent_worlds = np.arange(self_play_count, worlds)
        return cls(
            np.concatenate([np.arange(self_play_count), opponent_worlds[::2]]),
            np.concatenate([np.arange(self_play_count), opponent_worlds[1::2]]),
            opponent_worlds,
            opponent_worlds[len(opponent_worlds) - min(len(opponent_worlds), round(scripts * worlds)) :],
        )


class SidesCollector(SeatCollector):
    """The part of the learning policy in the fragments of two equal agents: a row for each side that it
    plays, those of the first agent first."""

    def __init__(self, collector: Any, seats: Sequence[SeatLayout], sides: Sides) -> None:
        super().__init__(seats, collector, [sides.first, sides.second])

    def part_of(self, fragment: Fragment) -> Fragment:
        columns = {name: array for name, array in fragment.columns.items() if name != _OPPONENTS}
        return replace(super().part_of(fragment), columns=columns)


@dataclass
class PastPolicy:
    """A member of the pool, with the recent wins and losses of the present policy against it."""

    rating: Rating
    weights: Mapping[str, Array]
    policy: Learner
    wins: float = 0.0
    losses: float = 0.0


_MAX_RATINGS = 10_000


class RatingState(CheckpointPart):
    """A rating in a checkpoint."""

    steps: NonNegativeInt
    mean: float
    deviation: Annotated[float, Field(gt=0)]

    @property
    def rating(self) -> Rating:
        return Rating(self.steps, self.mean, self.deviation)


class PastState(RatingState):
    """A member of the pool in a checkpoint."""

    wins: Annotated[float, Field(ge=0)] = 0.0
    losses: Annotated[float, Field(ge=0)] = 0.0


class SelfPlayState(MultiAgentState):
    """The JSON part of a checkpoint; `pool` has the ratings of the members of the pool, and `ratings` those
    of the policy so far, the present one last."""

    pool: Annotated[list[PastState], Field(max_length=100)]
    ratings: Annotated[list[RatingState], Field(min_length=1, max_length=_MAX_RATINGS)]


class SelfPlayLearner(MultiAgentLearner):
    """The learner of two equal agents with one policy.

    Attributes:
        ratings: The ratings of the policy each time that it became a member of the pool, and now.
        pool: The past policies, the oldest one first.
    """

    State: ClassVar[type[CheckpointState]] = SelfPlayState
    ratings: list[Rating]

    def __init__(self, setup: Setup) -> None:
        self.pool: list[PastPolicy] = []
        super().__init__(setup)
        if setup.collector is not None:
            self.ratings = [self._rater.new()]
            self._opponents = np.full(setup.training.environments, _PRESENT)

    @classmethod
    def check(cls, training: Training) -> None:
        agents = dict(training.agents)
        first, *_ = agents.values()
        check_shared(agents, [*agents], "`self_play`")
        if first.shards > 1:
            raise UsageError("`self_play` does not support `shards`; leave one of them out")
        super().check(training)

    def _check_ends(self, setup: Setup) -> None:
        assert setup.program is not None
        for member in setup.program.members.values():
            if member.alone:
                raise UsageError(
                    f"`{min(member.alone)}` ends the episode of `{member.name}` alone, which `self_play` does"
                    " not support; let it end the episode of all agents"
                )

    @property
    def _settings(self) -> SelfPlay:
        _, training = self.setup.training.agents[0]
        assert training.self_play is not None
        return training.self_play

    def _seat_collector(self, agents: Sequence[str]) -> SeatCollector:
        setup, settings = self.setup, self._settings
        assert setup.program is not None
        if not setup.program.is_symmetric:
            raise UsageError(
                "`self_play` needs two equal agents: `like` with no action, observation or reward of its own,"
                " and as many successes and failures for each; without it, each agent learns a policy of its"
                " own"
            )
        self._rater = _Rater()
        seats = [self._critic_seats[agent] for agent in agents]
        self._scripts = {
            agent: [qualified_name(agent, script.name) for script in seat.member.program.agent.scripts]
            for agent, seat in self._critic_seats.items()
        }
        self._sides = Sides.divided(setup.training.environments, settings.newest, settings.scripts)
        if settings.newest + settings.scripts > 1:
            raise UsageError("`newest` and `scripts` of `self_play` are shares, so together at most 100 %")
        if settings.scripts and not all(self._scripts.values()):
            raise UsageError(
                "`scripts` of `self_play` needs agents with `scripts`; write one, or leave it out"
            )
        self._collector = SidesCollector(setup.collector, seats, self._sides)
        return self._collector

    @property
    def _learner(self) -> Learner:
        return next(iter(self.learners.values()))

    @property
    def pool_games(self) -> Sequence[PoolGames]:  # type: ignore[override]  # an attribute of the base
        return [PoolGames(past.rating.steps, past.wins, past.losses) for past in self.pool]

    def actor(self) -> PolicyActor:
        return _SidesActor(self, self._critic_seats, self._learner.actor())

    def decide(self, observations: Any, starts: Array, masks: Array | None) -> Decision:
        """Return the actions of both agents in all worlds, to learn from."""
        names = [*self.learners]
        seats = [self._critic_seats[name] for name in names]
        own_masks = [None, None] if masks is None else [masks[:, seat.masks] for seat in seats]
        self._draw_opponents(starts)
        collector, sides = self._collector, self._sides
        decision = self._learner.actor()(
            collector.seen(observations),
            collector.rows_of([starts, starts]),
            None if masks is None else collector.rows_of(own_masks),
        )
        shape = (len(starts), *decision.actions.shape[1:])
        actions = [np.zeros(shape, decision.actions.dtype) for _ in names]
        actions[0][sides.first] = decision.actions[: len(sides.first)]
        actions[1][sides.second] = decision.actions[len(sides.first) :]
        # In the first of the worlds with another opponent, the policy is the first agent.
        for side, worlds in ((1, sides.others[::2]), (0, sides.others[1::2])):
            self._let_opponents_act(worlds, seats[side], observations, own_masks[side], actions[side])
        columns = {**decision.columns, _OPPONENTS: self._opponents.copy()}
        return Decision(joined_actions(actions), columns)

    def _draw_opponents(self, starts: Array) -> None:
        """Draw an opponent in each world in which an episode against another one than the present policy
        begins."""
        sides = self._sides
        scripts = min(len(names) for names in self._scripts.values())
        # By the global generator of numpy, whose state is part of each checkpoint.
        for world in sides.others[starts[sides.others]]:
            if world in sides.scripted:
                self._opponents[world] = _FIRST_SCRIPT - np.random.randint(scripts)
            else:
                self._opponents[world] = np.random.randint(len(self.pool)) if self.pool else _PRESENT

    def _let_opponents_act(
        self, worlds: Array, seat: SeatLayout, observations: Any, masks: Array | None, actions: Array
    ) -> None:
        """Write the actions of an agent in some worlds: those of scripts, and of past policies, each of which
        samples from its distribution."""
        own = seat.observation(observations)
        for opponent in np.unique(self._opponents[worlds]):
            rows = worlds[self._opponents[worlds] == opponent]
            if opponent <= _FIRST_SCRIPT:
                name = self._scripts[seat.member.name][_FIRST_SCRIPT - opponent]
                worlds_of_all = cast("LocalCollector", self.setup.collector).worlds
                actions[rows] = seat.actions(worlds_of_all.scripted(name)[rows])
                continue
            policy = self._learner if opponent == _PRESENT else self.pool[opponent].policy
            actions[rows], _ = policy.predict(
                apply_to_parts(lambda part, rows=rows: part[rows], own),
                action_masks=None if masks is None or not policy.takes_masks else masks[rows],
            )

    def collect(self) -> bool:
        if not super().collect():
            return False
        self._rate()
        return True

    def update(self) -> None:
        super().update()
        interval = self._settings.every
        before = self.steps - self.fragment_steps * self.setup.training.environments
        if self.steps // interval > before // interval:
            self._add_to_pool()

    # Ratings and the pool

    def _rate(self) -> None:
        """Rate the policies by the results of the episodes against past policies."""
        first, second = (self._critic_seats[name].member for name in self.learners)
        fragment = self._last
        wins = losses = 0
        against_scripts = []
        for number, ending in fragment.endings:
            index = int(fragment.columns[_OPPONENTS][number, ending.row])
            if index == _PRESENT:
                continue
            is_first = ending.row in self._sides.first
            member, opponent = (first, second) if is_first else (second, first)
            won, lost = (own_episode(one, ending.episode).is_success for one in (member, opponent))
            score = int(won) - int(lost)
            if index <= _FIRST_SCRIPT:
                against_scripts.append(score)
                continue
            wins, losses = wins + (score > 0), losses + (score < 0)
            past = self.pool[index]
            past.wins, past.losses = past.wins + (score > 0), past.losses + (score < 0)
            self.ratings[-1], past.rating = self._rater.rated(self.ratings[-1], past.rating, score)
        self.ratings[-1] = self.ratings[-1]._replace(steps=self.steps)
        self.log.record("self_play/rating", self.ratings[-1].mean)
        self.log.record("self_play/pool", len(self.pool))
        if wins + losses:
            self.log.record("self_play/win_rate", wins / (wins + losses))
        if any(against_scripts):
            decided = [score for score in against_scripts if score]
            self.log.record("self_play/win_rate_against_scripts", decided.count(1) / len(decided))

    def _add_to_pool(self) -> None:
        """Make the present policy a member of the pool, with its rating."""
        rating = self.ratings[-1]._replace(steps=self.steps)
        # Copies, because `weights` may return views of the tensors that the next update changes.
        weights = {name: np.array(array) for name, array in self._learner.weights().items()}
        for member in self.pool:
            # Halved, so that the counts are mostly those of recent games.
            member.wins, member.losses = member.wins / 2, member.losses / 2
        self.pool.append(self._past(rating, weights))
        self.ratings.append(rating)
        if len(self.ratings) > _MAX_RATINGS:
            del self.ratings[1:-1:2]
        if len(self.pool) > self._settings.pool:
            self.pool.pop(0)
            # The episodes against the removed member go on against the one that is now the oldest.
            opponents = self._opponents
            opponents[:] = np.where(opponents < 0, opponents, np.maximum(opponents - 1, 0))

    def _past(self, rating: Rating, weights: Mapping[str, Array]) -> PastPolicy:
        from deepbots_cli.learning.environments import random_numbers_kept

        name, training = self.setup.training.agents[0]
        # A new learner seeds the global generators and draws weights from them.
        with random_numbers_kept():
            policy = self._create(name, training, None)
        policy.actor().load(weights)
        return PastPolicy(rating, weights, policy)

    # Checkpoints

    def state(self) -> dict[str, Any]:
        return super().state() | {
            "pool": [
                {**past.rating._asdict(), "wins": past.wins, "losses": past.losses} for past in self.pool
            ],
            "ratings": [rating._asdict() for rating in self.ratings],
        }

    def arrays(self) -> dict[str, Array]:
        return super().arrays() | {
            _OPPONENTS: self._opponents,
            **{
                _pool_name(number, name): array
                for number, past in enumerate(self.pool)
                for name, array in past.weights.items()
            },
        }

    def restore(self, saved_state: Any, arrays: Mapping[str, Array], *, same: bool) -> None:
        super().restore(saved_state, arrays, same=same)
        names = [*self._learner.weights()]
        self.pool = []
        for number, past in enumerate(saved_state.pool):
            weights = {name: arrays[_pool_name(number, name)] for name in names}
            member = self._past(past.rating, weights)
            self.pool.append(replace(member, wins=past.wins, losses=past.losses))
        self.ratings = [state.rating for state in saved_state.ratings]
        opponents = arrays[_OPPONENTS]
        scripts = min(len(names) for names in self._scripts.values())
        if opponents.min() <= _FIRST_SCRIPT - scripts or opponents.max() >= len(self.pool):
            raise ValueError("an opponent is neither a member of the pool nor a script")
        self._opponents[:] = opponents


class _SidesActor(MultiAgentActor):
    """The actor of a learner that plays against itself."""

    def __init__(self, learner: SelfPlayLearner, seats: Mapping[str, SeatLayout], actor: PolicyActor) -> None:
        super().__init__(seats, dict.fromkeys(seats, actor))
        self._decide = learner.decide

    def __call__(self, observations: Any, starts: Array, masks: Array | None) -> Decision:
        return self._decide(observations, starts, masks)


class _Rater:
    """Ratings of two players by the results of their games."""

    def __init__(self) -> None:
        try:
            from openskill.models import PlackettLuce
        except ModuleNotFoundError as error:
            raise MissingExtraError("agents", "self-play") from error
        self._model = PlackettLuce()

    def new(self) -> Rating:
        """Return the rating of a player before its first game."""
        fresh = self._model.rating()
        return Rating(0, fresh.mu, fresh.sigma)

    def rated(self, first: Rating, second: Rating, score: int) -> tuple[Rating, Rating]:
        """Return the ratings after a game, in which `score` is 1 if `first` has won, -1 if `second` has, else
        0."""
        teams = [[self._model.rating(mu=rating.mean, sigma=rating.deviation)] for rating in (first, second)]
        # In openskill the lower rank wins, and equal ranks are a draw.
        ((a,), (b,)) = self._model.rate(teams, ranks=[1 + (score < 0), 1 + (score > 0)])
        return (
            first._replace(mean=a.mu, deviation=a.sigma),
            second._replace(mean=b.mu, deviation=b.sigma),
        )


def _pool_name(number: int, name: str) -> str:
    return f"pool/{number}/{name}"
