"""The end of an episode: of the task, of one of several agents, by a limit, by a function of a user's Python
module, or by a failure; in one world, and as columns in a batch.
"""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Mapping
from importlib import import_module
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli.errors import EvaluationError, UsageError
from deepbots_cli.port import Engine
from deepbots_cli.program import generated
from deepbots_cli.program.members import AgentEnding
from deepbots_cli.program.task import Agent
from deepbots_cli.runtime.columns import where_running
from deepbots_cli.runtime.spaces import Column

if TYPE_CHECKING:
    from deepbots_cli.runtime.supervisor import Supervisor


def without_value(error: Exception, engine: Engine, step: int) -> Exception:
    """Return an `EvaluationError` that shows the generated line, or the error itself where it is a fault of
    ours."""
    frames = [
        frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename.startswith("<deepbots")
    ]
    if not frames or not isinstance(error, (ArithmeticError, ValueError, NameError)):
        return error
    engine.require_finite()  # a world that blew up is the engine's failure, not the expression's
    statement = generated.as_written(frames[-1].line or "")
    return EvaluationError(f"step {step}: no value for `{statement}`: {error}")


def infinite_reward(terms: Mapping[str, float]) -> str:
    """Return the message about the terms that make a reward infinite or NaN."""
    culprit = next(
        (f"the reward term '{name}'" for name, value in terms.items() if not math.isfinite(value)), None
    )
    return f"{culprit or 'the sum of the reward terms'} is not finite"


def without_option(agent: Agent, choice: str) -> str:
    """Return the message for a choice whose options are all forbidden by conditions of the scenario."""
    options = next(part.options for part in agent.choices if part.name == choice)
    return f"every option of '{choice}' is forbidden: {', '.join(option.name for option in options)}"


def python_function(
    noun: str, name: str, module: str, function: str, truth: bool
) -> Callable[[Supervisor], Any]:
    """Return the function of a user's module that computes a reward term or an ending from the supervisor.

    The returned function checks each value: a truth value if `truth`, otherwise a number. `noun` and `name`
    are those of the term or the ending, for messages.

    Raises:
        UsageError: There is no such function, or its module cannot be imported.
    """
    called = f"the {noun} '{name}' in Python ({module}:{function})"
    try:
        imported = getattr(import_module(module), function)
    except Exception as error:  # whatever the module does while it is imported
        raise UsageError(f"{called} cannot be imported: {type(error).__name__}: {error}") from error
    if not callable(imported):
        raise UsageError(f"{called} is not a function")

    def call(supervisor: Supervisor) -> Any:
        try:
            value = imported(supervisor)
        except Exception as error:  # whatever the function does
            raise EvaluationError(
                f"step {supervisor.step_count}: {called} failed: {type(error).__name__}: {error}"
            ) from error
        is_truth = isinstance(value, (bool, np.bool_))
        if is_truth != truth or not (is_truth or isinstance(value, Real)):
            expected = "True or False" if truth else "a number"
            raise EvaluationError(
                f"step {supervisor.step_count}: {called} gave {str(value)[:40]!r} instead of {expected}"
            )
        return bool(value) if truth else float(value)

    return call


class EpisodeEnd:
    """The end of the episode of a supervisor.

    Attributes:
        terminated: Whether the task ended, by success or failure.
        truncated: Whether a limit cut the episode short.
        is_success: Whether the task ended in success.
        ended_by: The name of the first ending that held, or of the limit; None while the episode goes on.
        endings: The names of all endings that held.
        agent_endings: The ends of the episodes of agents, while those of others go on.
    """

    step_count: int

    def forget_end(self) -> None:
        """Begin an episode, which has no end yet."""
        self.terminated = self.truncated = self.is_success = False
        self.ended_by: str | None = None
        self.endings: tuple[str, ...] = ()
        self.agent_endings: dict[str, AgentEnding] = {}

    def _terminate(self, endings: Mapping[str, bool], *, success: bool = False) -> None:
        """End the task by the endings that hold; the first of them is `ended_by`."""
        self.terminated = True
        self.is_success = success
        self.endings = tuple(name for name, holds in endings.items() if holds)
        self.ended_by = self.endings[0]

    def _end_agent(self, agent: str, endings: Mapping[str, bool], *, success: bool = False) -> bool:
        """End the episode of one of several agents by the endings that hold, while others go on. Returns
        True."""
        names = tuple(name for name, holds in endings.items() if holds)
        self.agent_endings[agent] = AgentEnding(names, success, self.step_count)
        return True

    def _end_with_agents(self) -> None:
        """End the task, since the episode of every agent has ended."""
        ends = self.agent_endings.values()
        newest = max(end.step for end in ends)
        last = [end for end in ends if end.step == newest]
        self.terminated = True
        self.is_success = all(end.is_success for end in ends)
        self.endings = tuple(dict.fromkeys(name for end in last for name in end.endings))
        self.ended_by = self.endings[0]

    def _truncate(self, limit: str) -> None:
        """Cut the episode short at a limit."""
        self.truncated = True
        self.ended_by = limit
        self.endings = (limit,)


class AgentColumns:
    """The ends of the episodes of one of several agents, while those of others go on, as columns.

    Attributes:
        ended: Whether the episode of the agent has ended.
        steps: The step in which it ended.
        holds: The endings that held then.
        success: Whether this was a success.
    """

    def __init__(self, count: int) -> None:
        self.ended = np.zeros(count, bool)
        self.success = np.zeros(count, bool)
        self.steps = np.zeros(count, np.int64)
        self.holds: dict[str, Column] = {}

    def end(self, now: Column, steps: Column, endings: Mapping[str, Any], success: Any) -> None:
        """Note the ends of this step, in the rows in which there is one `now`."""
        self.steps, self.success = np.where(now, steps, self.steps), np.where(now, success, self.success)
        for name, column in endings.items():
            self.holds[name] = np.where(now, column, self.holds.get(name, False))

    def ending(self, row: int) -> AgentEnding:
        """Return the end in a row."""
        names = tuple(name for name, column in self.holds.items() if column[row])
        return AgentEnding(names, bool(self.success[row]), int(self.steps[row]))


class EpisodeEnds:
    """The ends of the episodes of a batch, as columns.

    Attributes:
        running: The rows that take part in this step; None if all of them do.
        terminated: Where the task ended, by success or failure.
        truncated: Where a limit cut the episode short.
        is_success: Where the task ended in success.
        holds: The endings that held, by name.
        limit: The name of the newest limit.
        agent_ends: The ends of the episodes of agents, while those of others go on.
    """

    count: int
    step_count: Any
    running: Column | None

    def forget_ends(self) -> None:
        """Begin episodes in all rows, which have no end yet."""
        self.terminated, self.truncated, self.is_success = (np.zeros(self.count, bool) for _ in range(3))
        self.holds: dict[str, Column] = {}
        self.limit = ""
        self.agent_ends: dict[str, AgentColumns] = {}

    def _terminate(self, endings: dict[str, Any], *, success: Any = False) -> None:
        """End the task where one of the endings holds; the first of them determines the result."""
        self.holds = {
            name: where_running(
                self.running, np.broadcast_to(column, self.count), self.holds.get(name, False)
            )
            for name, column in endings.items()
        }
        ended = np.logical_or.reduce(list(self.holds.values()))
        self.is_success = where_running(self.running, ended & success, self.is_success)
        self.terminated = where_running(self.running, ended, self.terminated)

    def _end_agent(
        self, agent: str, ended: Column, ending: Any, endings: dict[str, Any], *, success: Any = False
    ) -> Column:
        """End the episodes of one of several agents where an ending of its own holds, while others go on.
        Returns where they have ended."""
        now = where_running(self.running, np.broadcast_to(ending, self.count) & ~ended, False)
        columns = self.agent_ends.setdefault(agent, AgentColumns(self.count))
        columns.end(now, self.step_count, endings, success)
        columns.ended = ended | now
        return columns.ended

    def _end_with_agents(self, reached: Any) -> None:
        """End the task where the episode of every agent has ended."""
        now = where_running(self.running, reached & ~self.terminated, False)
        success = np.logical_and.reduce([columns.success for columns in self.agent_ends.values()])
        self.terminated = self.terminated | now
        self.is_success = np.where(now, success, self.is_success)

    def agent_endings_of(self, row: int) -> dict[str, AgentEnding]:
        """Return the ends of the episodes of agents in a row."""
        ends = self.agent_ends.items()
        return {agent: columns.ending(row) for agent, columns in ends if columns.ended[row]}

    def _truncate(self, limit: str, reached: Any, success: Any = None) -> None:
        """Cut the episodes short that reached a limit."""
        self.limit = limit
        now = reached & ~self.terminated
        self.truncated = where_running(self.running, now, self.truncated)
        if success is not None:
            self.is_success = np.where(now, success, self.is_success)
