"""Episodes that `try` runs and shows as tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from statistics import fmean
from typing import TYPE_CHECKING, Any

from deepbots_cli import rollout
from deepbots_cli.analysis import possible_returns
from deepbots_cli.cli import records, terminal
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.learning.runs.episodes import Summary, agent_scores
from deepbots_cli.rollout import Driver, Episode
from deepbots_cli.rollout.episode import own_episode

if TYPE_CHECKING:
    from deepbots_cli.program import Program
    from deepbots_cli.runtime import Supervisor

MAX_SHOWN = 20
"""The largest number of episodes that are listed one by one. Of more episodes, only the first
`FIRST_EPISODES` are listed."""
FIRST_EPISODES = 5


def run_episodes(
    environment: Supervisor,
    driver: Driver,
    *,
    count: int,
    seed: int,
    max_steps: int | None,
    options: dict[str, Any] | None = None,
) -> Iterator[Episode]:
    """Run up to `count` episodes with the `options` of `reset`, the first with `seed`.

    `ended_by` is `--steps` for an episode that `max_steps` ends.
    """
    left = max_steps
    for number in range(count):
        start = rollout.Start(seed if number == 0 else None, options)
        running = rollout.steps(environment, driver, start)
        episode = rollout.result_of(islice(running, None if left is None else left + 1), start.seed)
        yield episode if episode.ended_by else replace(episode, ended_by="--steps")
        left = None if left is None else left - episode.length
        if left == 0:
            return


def show_episodes(
    program: Program, outcomes: list[Episode], data: dict[str, Any], more: Sequence[str], *, as_json: bool
) -> None:
    summary = Summary.of_episodes(outcomes, possible_returns(program))
    data = {"scenario": program.name, **data, "episodes": list(map(_row, outcomes))}
    agents = agent_scores(program.members, outcomes)
    first = "" if agents else f"{records.result_sentence(summary, success_defined=program.defines_success)}\n"
    totals = "\n" + records.summary_text(summary, success_defined=program.defines_success, agents=agents)
    data["summary"] = {"success_defined": program.defines_success, **vars(summary)}
    if agents:
        data["summary"]["agents"] = agents
    if program.others is not None:
        terminal.note(f"{program.others.agent} acts against {program.others.text}")
    terminal.show(
        data,
        *filter(None, (first, *_lines(program, outcomes))),
        *([totals] if len(outcomes) > 1 else []),
        *more,
        as_json=as_json,
    )


def _row(episode: Episode) -> Row:
    return {
        "return": episode.total_return,
        "length": episode.length,
        "ended_by": episode.ended_by,
        "success": episode.is_success,
        "reward_terms": dict(episode.terms),
        "drawn": dict(episode.drawn),
    }


def _agent_columns(program: Program, episode: Episode) -> Row:
    """Return the columns of an episode of several agents: the return of each, and who succeeded."""
    agent_episodes = {name: own_episode(member, episode) for name, member in program.members.items()}
    succeeded = [name for name, agent_episode in agent_episodes.items() if agent_episode.is_success]
    return {
        **{f"return of {name}": agent_episode.total_return for name, agent_episode in agent_episodes.items()},
        "length": episode.length,
        "ended_by": episode.ended_by,
        "success": ", ".join(succeeded) or "no",
    }


def _lines(program: Program, outcomes: list[Episode]) -> Iterator[str]:
    first_episodes = outcomes if len(outcomes) <= MAX_SHOWN else outcomes[:FIRST_EPISODES]
    rows = [
        {"episode": number, **(_agent_columns(program, episode) if program.members else _row(episode))}
        for number, episode in enumerate(first_episodes)
    ]
    listed = [
        {name: value for name, value in row.items() if name not in ("reward_terms", "drawn")} for row in rows
    ]
    yield "episodes\n" + table(listed)
    if len(first_episodes) < len(outcomes):
        yield f"  and {len(outcomes) - len(first_episodes):,} more"
    if outcomes[0].terms:
        yield "\nreward terms\n" + table([_term(outcomes, name) for name in outcomes[0].terms])


def _term(outcomes: list[Episode], name: str) -> Row:
    sums = [episode.terms[name] for episode in outcomes]
    steps = sum(episode.length for episode in outcomes)
    per_step = sum(sums) / max(1, steps)  # a robot may restart before the first step
    return {
        "term": name,
        "per_episode": fmean(sums),
        "min_episode": min(sums),
        "max_episode": max(sums),
        "per_step": per_step,
    }
