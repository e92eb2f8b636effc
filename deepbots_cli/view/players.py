"""Players of one world or a batch, of a recording, or of the log of a robot."""

from __future__ import annotations

from contextlib import closing

from deepbots_cli.errors import UsageError
from deepbots_cli.rollout.drivers import HAND
from deepbots_cli.rollout.recordings import RobotLog
from deepbots_cli.view.episodes import BatchPlayer, Player, Showing, ShowingState
from deepbots_cli.view.replay import LogPlayer, ReplayPlayer


def open_player(opened: ShowingState, driver: str | None = None) -> Player:
    """Open a player of a shown source.

    Raises:
        ScenarioError, EngineError, UsageError: As for `Player`.
    """
    if opened.shown.worlds:
        return BatchPlayer(opened, driver)
    if opened.recording is None:
        return Player(opened, driver)
    if driver not in (None, *opened.drivers):
        raise UsageError(f"a recording already contains its actions; leave out --driver {driver}")
    return LogPlayer(opened) if isinstance(opened.recording, RobotLog) else ReplayPlayer(opened)


def closing_player(showing: Showing, driver: str | None) -> closing[Player]:
    """Open a player of a shown source without a page, to be used in a `with` statement.

    Raises:
        ScenarioError: The scenario has errors.
        UsageError: There is no such driver, or a person would have to act.
    """
    if driver == HAND:
        raise UsageError("you can drive in the browser only; use `deepbots play`")
    return closing(open_player(showing.open(), driver))
