"""The table of policies and scripts of two agents that play against each other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from deepbots_cli.cli import records
from deepbots_cli.cli.tables import table
from deepbots_cli.words import number_text, rate_text

if TYPE_CHECKING:
    from deepbots_cli.learning.matches import Match, MatchTable


def match_lines(result: MatchTable) -> Iterator[str]:
    """Yield a row for each player of the first agent, with its result against each of the second one."""
    first_agent, second_agent = result.agents
    starts = records.held_out(result.starts)
    if result.is_symmetric:
        measured = "share of decided episodes that the row wins against the column"
        where = f"on {starts} from evaluation seed {result.seed}, both sides of each"
        yield f"{result.scenario}: {measured}, {where}"
    else:
        measured = "success rate" if result.success_defined else "mean return"
        yield f"{result.scenario}: {measured} of {first_agent} (rows) against {second_agent} (columns)"
        yield f"{starts} of each match, from evaluation seed {result.seed}"
    cells = {(match.row, match.column): _cell(result, match) for match in result.matches}
    if result.is_symmetric:
        cells |= {(match.column, match.row): _cell(result, _swapped(match)) for match in result.matches}
    head = "" if result.is_symmetric else first_agent
    yield table(
        [
            {head or "player": row, **{column: cells.get((row, column), "") for column in result.columns}}
            for row in result.rows
        ]
    )
    yield "in parentheses: intervals at 95 %"
    yield from (f"note: {note}" for note in result.notes)


def _cell(result: MatchTable, match: Match) -> str:
    """Return the measure of the row in a match, with its interval."""
    if result.is_symmetric:
        if match.win_rate is None:
            return f"none of {match.episodes} decided"
        undecided = match.episodes - (match.wins or 0) - (match.losses or 0)
        text = _with_interval(match.win_rate, match.win_interval)
        return f"{text}, {undecided} undecided" if undecided else text
    scores = match.agents[result.agents[0]]
    if scores.success_rate is not None:
        return _with_interval(scores.success_rate, scores.success_interval)
    interval = records.interval_text(scores.return_interval)
    return f"{number_text(scores.mean_return)}{f' ({interval})' if interval else ''}"


def _with_interval(share: float, interval: tuple[float, float] | None) -> str:
    return f"{rate_text(share)} ({records.interval_text(interval, rate_text)})"


def _swapped(match: Match) -> Match:
    """Return a match of both sides as it was for the column."""
    if match.win_rate is None or match.win_interval is None:
        return match
    low, high = match.win_interval
    return match.model_copy(
        update={
            "wins": match.losses,
            "losses": match.wins,
            "win_rate": 1 - match.win_rate,
            "win_interval": (1 - high, 1 - low),
        }
    )
