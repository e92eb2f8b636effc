"""Match-ups: policies and scripts of two agents against each other, all on the same held-out starts.

Every player of the first agent meets every player of the second one. Where one agent mirrors the other,
a player takes both sides: each pair plays every start twice, with the sides swapped.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from itertools import combinations, product
from pathlib import Path
from statistics import fmean
from typing import Any

from pydantic import BaseModel

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.policy import loaded
from deepbots_cli.learning.runs.episodes import Scores, agent_scores
from deepbots_cli.learning.runs.run import ModelRef, Run
from deepbots_cli.learning.runs.statistics import Interval, wilson
from deepbots_cli.learning.sb3.algorithms import torch_settings
from deepbots_cli.program import RANDOM, Program, identity
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode, Start, play
from deepbots_cli.rollout.drivers import AgentsDriver
from deepbots_cli.rollout.episode import OnEpisode, own_episode
from deepbots_cli.runtime.spaces import Predictor
from deepbots_cli.words import rate_text

POLICY = "policy"
"""The name of the policy of the first run among the players."""


class Match(BaseModel, frozen=True):
    """The episodes of two players.

    Attributes:
        row: The player of the first agent.
        column: The player of the second agent.
        episodes: The number of episodes; twice that of the starts where players take both sides.
        endings: The number of episodes that each ending ended, by its name.
        mean_seconds: The mean duration of an episode in s of simulated time.
        agents: The scores of each agent by name; empty where players take both sides.
        wins: The number of episodes that are a success for the row alone; None unless players take both
            sides. `losses` are successes of the column alone.
        win_rate: The share of the wins among wins and losses, with `win_interval` at 95 %; None without any.
    """

    row: str
    column: str
    episodes: int
    endings: Mapping[str, int]
    mean_seconds: float
    agents: Mapping[str, Scores] = {}
    wins: int | None = None
    losses: int | None = None
    win_rate: float | None = None
    win_interval: Interval | None = None


class MatchTable(BaseModel, frozen=True):
    """The matches of all players.

    Attributes:
        scenario: The name of the scenario.
        agents: The first and the second agent.
        rows: The players of the first agent; `columns` those of the second one.
        is_symmetric: Whether every player takes both sides.
        success_defined: Whether an ending is a success for the first agent.
        starts: The number of held-out starts of each match, from `seed`.
        notes: A sentence for each policy that is not clearly better than random actions.
    """

    scenario: str
    agents: tuple[str, str]
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    is_symmetric: bool
    success_defined: bool
    starts: int
    seed: int
    matches: tuple[Match, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Player:
    """A policy, or the name of a driver, for each agent that it can play."""

    name: str
    drivers: Mapping[str, str | Predictor]


def play_matches(
    runs: Sequence[str | Path | ModelRef],
    *,
    scenario: str | Path | Compiled | None = None,
    episodes: int | None = None,
    seed: int | None = None,
    engine: str | None = None,
    on_episode: OnEpisode | None = None,
    permissions: Permissions = Permissions(),
) -> MatchTable:
    """Play the policies of runs, the scripts of the scenario and random actions against each other.

    Args:
        runs: Runs of all agents or of one of them, or models of such runs.
        scenario: The scenario, which scripts alone play without `runs`; by default that of the first run.
        episodes: The number of starts of each match; by default that of the scenario.
        seed: Root seed of the starts; by default that of the evaluation of the first run, or 0.
        engine: The physics engine; by default that of the first training, or of the scenario.
        on_episode: Called after each episode with the number of finished episodes, and of all.
        permissions: From which folders a `scenario` may read, and whether its Python functions, or those of
            the first run, may be run.

    Raises:
        RunError: One of these is not a run, or is damaged.
        ScenarioError: The scenario has findings at error level.
        UsageError: The scenario does not have two agents, or the agents of a run are others.
    """
    refs = [run if isinstance(run, ModelRef) else ModelRef.open(run) for run in runs]
    first = refs[0].run if refs else None
    program = _played_program(first, scenario, permissions)
    if seed is None:
        seed = 0 if first is None else first.evaluation_seed
    starts = [
        Start.of_evaluation(seed, number) for number in range(episodes or program.evaluation_episodes())
    ]
    first_agent, second_agent = program.members
    is_symmetric = program.is_symmetric
    policies = _policies(program, refs, is_symmetric=is_symmetric)
    players = [*policies, *_scripted(program)]
    if is_symmetric:
        players = [player for player in players if len(player.drivers) == len(program.members)]
    rows = [player for player in players if first_agent in player.drivers]
    columns = [player for player in players if second_agent in player.drivers]
    pairs = [*combinations(rows, 2)] if is_symmetric else [*product(rows, columns)]
    count = 0
    total = len(pairs) * len(starts) * (2 if is_symmetric else 1)

    def counted(outcomes: Iterator[Episode]) -> Iterator[Episode]:
        nonlocal count
        for episode in outcomes:
            count += 1
            if on_episode is not None:
                on_episode(count, total)
            yield episode

    matches: list[Match] = []
    engine = engine or (None if first is None else first.record.engine)
    with torch_settings(), closing(api.build(program, engine=engine, permissions=permissions)) as world:

        def played(as_one: Player, as_two: Player) -> list[Episode]:
            driver = AgentsDriver(
                world, {first_agent: as_one.drivers[first_agent], second_agent: as_two.drivers[second_agent]}
            )
            return [*counted(play(world, driver, start) for start in starts)]

        for a, b in pairs:
            outcomes = played(a, b)
            if is_symmetric:
                matches.append(_both_sides(program, a, b, outcomes, played(b, a)))
            else:
                matches.append(
                    _match(program, a, b, outcomes, agents=agent_scores(program.members, outcomes))
                )
    return MatchTable(
        scenario=program.name,
        agents=(first_agent, second_agent),
        rows=tuple(player.name for player in rows),
        columns=tuple(player.name for player in columns),
        is_symmetric=is_symmetric,
        success_defined=program.members[first_agent].defines_success,
        starts=len(starts),
        seed=seed,
        matches=tuple(matches),
        notes=tuple(_like_random(program, [player.name for player in policies], matches)),
    )


def _share(rate: float | None, low: float, high: float) -> str:
    return f"{rate_text(rate or 0.0)} ({rate_text(low)} .. {rate_text(high)})"


def _like_random(program: Program, policies: Sequence[str], matches: Sequence[Match]) -> Iterator[str]:
    """Yield a sentence for each policy whose success is not clearly above that of random actions."""
    for name in policies:
        for match in matches:
            if match.win_interval is not None and (match.row, match.column) == (name, RANDOM):
                low, high = match.win_interval
                if low <= 0.5:
                    yield (
                        f"{name} is not clearly better than random actions: against them, it wins"
                        f" {_share(match.win_rate, low, high)} of the decided episodes"
                    )
        for agent, side in zip(program.members, ("row", "column"), strict=True):
            acting, random = (
                [match.agents[agent] for match in matches if match.agents and getattr(match, side) == player]
                for player in (name, RANDOM)
            )
            if not acting or not random or acting[0].success_rate is None:
                continue
            episodes = sum(scores.episodes for scores in acting)
            rate, chance = (
                fmean(scores.success_rate or 0.0 for scores in group) for group in (acting, random)
            )
            low, high = wilson(round(rate * episodes), episodes)
            if low <= chance:
                yield (
                    f"as {agent}, {name} is not clearly better than random actions: against all opponents, it"
                    f" succeeds in {_share(rate, low, high)}, random actions in {rate_text(chance)}"
                )


def _played_program(
    run: Run | None, scenario: str | Path | Compiled | None, permissions: Permissions
) -> Program:
    """Return the program of both agents: of the scenario, or of the run."""
    if scenario is not None:
        program = _world_of(api.compile(scenario, permissions=permissions).program)
    elif run is not None:
        program = _world_of(run.program)
    else:
        raise UsageError("a match needs a run or a scenario")
    if len(program.members) != 2:
        raise UsageError(
            f"a match needs a scenario with two agents; {program.name} has {max(1, len(program.members))}"
        )
    return program


def _world_of(program: Program) -> Program:
    """Return the program of all agents."""
    return program if program.others is None else program.others.world


def _policies(program: Program, refs: Sequence[ModelRef], *, is_symmetric: bool) -> list[Player]:
    """Return the player of each model; of several with one label, the path is the name."""
    labels = [POLICY if ref is refs[0] else ref.label for ref in refs]
    return [
        Player(
            label if labels.count(label) == 1 else str(ref.shown_path),
            _drivers(program, ref, is_symmetric=is_symmetric),
        )
        for label, ref in zip(labels, refs, strict=True)
    ]


def _scripted(program: Program) -> list[Player]:
    """Return the scripts of both agents as players, and random actions."""
    scripts: dict[str, dict[str, str | Predictor]] = {}
    for agent, member in program.members.items():
        for name in (*(script.name for script in member.program.agent.scripts), RANDOM):
            scripts.setdefault(name, {})[agent] = name
    return [Player(name, drivers) for name, drivers in scripts.items()]


def _drivers(program: Program, ref: ModelRef, *, is_symmetric: bool) -> dict[str, str | Predictor]:
    """Return the policies in a model: of all agents, or of the one that its run trained."""
    run = ref.run
    world = _world_of(ref.run.program)
    if differing := identity.differences(world, program):
        lines = "\n  ".join(differing)
        raise UsageError(f"the agents of {run.path} are others than those of {program.name}:\n  {lines}")
    if run.program.others is None:
        model: Any = loaded(run, ref.name)
        return dict(model.learners)
    agent = run.program.others.agent
    policies: dict[str, str | Predictor] = {agent: loaded(run, ref.name)}
    if is_symmetric:
        policies |= dict.fromkeys(program.members, policies[agent])
    return policies


def _both_sides(
    program: Program, a: Player, b: Player, as_first: Sequence[Episode], as_second: Sequence[Episode]
) -> Match:
    """Return the match of two players: the episodes with `a` as the first agent, and as the second one."""
    first, second = program.members.values()
    wins = losses = 0
    for episodes, side, opponent in ((as_first, first, second), (as_second, second, first)):
        for episode in episodes:
            won, lost = (own_episode(member, episode).is_success for member in (side, opponent))
            wins += won and not lost
            losses += lost and not won
    decided = wins + losses
    return _match(
        program,
        a,
        b,
        [*as_first, *as_second],
        wins=wins,
        losses=losses,
        win_rate=wins / decided if decided else None,
        win_interval=wilson(wins, decided) if decided else None,
    )


def _match(program: Program, a: Player, b: Player, episodes: Sequence[Episode], **results: Any) -> Match:
    """Return the match of two players with these episodes and `results`."""
    return Match(
        row=a.name,
        column=b.name,
        episodes=len(episodes),
        endings=dict(Counter(str(episode.ended_by) for episode in episodes).most_common()),
        mean_seconds=fmean(episode.length for episode in episodes) * program.period,
        **results,
    )
