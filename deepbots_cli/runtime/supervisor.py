"""The base of generated supervisors: a Gymnasium environment that sees and resets the whole world, scores,
and exchanges messages with robots; the end of an episode.

An episode ends by its task, for one of several agents, by a limit, by a function of a user's Python module,
or by a failure; in one world, and as columns in a batch.
"""

from __future__ import annotations

import math
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from importlib import import_module
from numbers import Real
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from deepbots_cli.engine_kinds import diagonal_of
from deepbots_cli.errors import EndsAtResetError, EvaluationError, UsageError
from deepbots_cli.geometry import Height, ground_height
from deepbots_cli.port import Engine, View
from deepbots_cli.program import AgentEnding, Program, generated
from deepbots_cli.program.task import Agent
from deepbots_cli.runtime.actuation import SupervisedRobots
from deepbots_cli.runtime.columns import column_of, where_running
from deepbots_cli.runtime.formulas import clip
from deepbots_cli.runtime.messages import excerpt
from deepbots_cli.runtime.overview import FollowingView
from deepbots_cli.runtime.spaces import (
    Column,
    ObservedFrames,
    action_space,
    canonical_action,
    compose_action,
    is_canonical,
    mask_of_space,
    observation_space,
)
from deepbots_cli.runtime.streams import Streams, SupervisedDraws


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
            name: where_running(self.running, column_of(column, self.count), self.holds.get(name, False))
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
        now = where_running(self.running, column_of(ending, self.count) & ~ended, False)
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


# Supervisors


Observation = NDArray[np.float32]
Info = dict[str, Any]


class ResetNeededError(UsageError, gym.error.ResetNeeded):
    """A step before the first reset, or after the end of an episode."""


class LimitedSpec:
    """The `spec` of an environment, which has the number of steps after which an episode is cut short.

    `gymnasium.make` and `make_vec` set a spec without this number, since they add no time limit.
    """

    scenario: Program
    _limited_spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        return self._limited_spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._limited_spec = spec and replace(spec, max_episode_steps=self.max_episode_steps)

    @property
    def max_episode_steps(self) -> int | None:
        """The number of steps after which an episode is cut short; None without a limit."""
        limits = self.scenario.truncation
        return limits.max_episode_steps(self.scenario.period) if limits.limits else None


_CLOSED = "the environment is closed; make a new one"
STEPS_PER_CHECK = 15
"""The steps between checks of the speeds of joints; an unstable spring may stand still in every 2nd or 4th
step. A check takes 5 to 15 us."""


class Supervisor(
    SupervisedRobots,
    SupervisedDraws,
    ObservedFrames,
    EpisodeEnd,
    LimitedSpec,
    gym.Env[Observation, Any],
    ABC,
):
    """Base of the generated supervisor classes.

    A generated class adds `bind` (robots, channels, and readers from the engine), `_begin` (draws and placing
    at reset), `_start` and `_advance` (the first moment of an episode, and a step), `_observe`, which both of
    them call and which computes everything once per timestep, and the paper's methods, which only read its
    results, so calling one twice changes nothing.

    Its robots, draws, observation and the end of its episode are those of the base classes, since generated
    code calls them on `self`.
    """

    def __init__(self, scenario: Program, engine: Engine, render_mode: str | None = None) -> None:
        """Take over `engine`, which has the scenario's world, and close it with this environment.

        Raises:
            UsageError: `render_mode` is neither None nor "rgb_array", or the engine cannot draw.
        """
        if render_mode not in (None, "rgb_array"):
            window = (
                "; for a window, wrap the environment in `gymnasium.wrappers.HumanRendering`"
                if render_mode == "human"
                else ""
            )
            raise UsageError(f"render mode {render_mode!r} is unknown; use 'rgb_array' or None{window}")
        if render_mode and "rendering" not in engine.capabilities:
            raise UsageError(
                f"the engine '{engine.name}' cannot render; use the engine 'pybullet' for pictures"
            )
        SupervisedRobots.__init__(self, scenario, engine)
        SupervisedDraws.__init__(self, scenario)
        ObservedFrames.__init__(self, scenario.agent)
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": ["rgb_array"] if "rendering" in engine.capabilities else [],
            "render_fps": max(1, round(1 / scenario.period)),
        }
        self.observation_space = observation_space(self.agent)
        self.action_space = action_space(self.agent)
        self.world = scenario.world
        """The world of the engine: with copies of a robot, each under its own name."""
        self.agents: dict[str, Supervisor] = {self.agent.name: self}
        """The supervisor of each copy of the agent, by name; without copies this one, under the name of the
        agent."""
        self._ranges = len(self.agent.range_names)
        self.physics = engine.step
        self.rebuild: Callable[[], Supervisor] | None = None
        self._view = FollowingView(scenario, engine)
        self._closed = False
        self._go_on: Callable[[Any], None] = self._refuse
        self._forget()
        self.bind(engine)

    # Gymnasium

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Begin an episode. A seed determines this episode and all following ones until the next seed.

        Args:
            seed: The root of all random streams, a whole number from 0.
            options: Values of this episode in place of draws, by the names of `drawn`: parameters (`mark.x`),
                poses and joints (`reset.place.block.x`), and all other draws. Numbers are in SI units, a
                vector (`mark`) is a sequence. Other draws do not change. `options=info["drawn"]` repeats the
                start of that episode.

        Returns:
            The observation, float32 in the observation space, and the info of a step. This info also contains
            `drawn`: the drawn values in SI units, a number or a word for each name. The name of a parameter
            is its own (`mark.x`), other names are paths in the scenario (`reset.joints.cart.pole_hinge`).
            Values that change within an episode, and noise, are left out.

        Raises:
            EvaluationError: An expression has no value, or the episode would end before its first step; the
                message names it.
            UsageError: `options` contains an unknown name, or a value that the episode cannot draw. The
                running episode continues.
        """
        self.place_world(seed, options)
        self.observe_start()
        return self.get_observations(), {**self.get_info(), "drawn": self.drawn()}

    def place_world(self, seed: int | None, options: Mapping[str, Any] | None) -> None:
        """Draw and place the start of an episode; the first half of `reset`."""
        if self._closed:
            raise UsageError(_CLOSED)
        values = self.require_drawable(options) if options else None
        super().reset(seed=seed)
        # A reset that raises an exception leaves no episode: steps are refused until a reset succeeds.
        self._go_on = self._refuse
        if seed is not None:
            self.streams = Streams(seed)
            # Gymnasium leaves this to the caller. Here, a seed also repeats random actions.
            self.action_space.seed(seed)
        self.choose_values(values)
        self._forget()
        try:
            self._begin()
            self.note_draws()
        except (ArithmeticError, ValueError, NameError) as error:
            raise without_value(error, self.engine, self.step_count) from error

    def observe_start(self) -> None:
        """Take the first readings of an episode; the second half of `reset`."""
        try:
            self.begin_robots(self.streams)
            self._start()
            self.fill_frames()
        except (ArithmeticError, ValueError, NameError) as error:
            raise without_value(error, self.engine, self.step_count) from error
        alone = [name for end in self.agent_endings.values() for name in end.endings]
        if self.terminated or alone:
            raise EndsAtResetError(
                f"the ending '{self.ended_by or alone[0]}' is already true at reset (seed"
                f" {self.streams.root}); change the start or the ending"
            )
        self._go_on = self._advance

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, Info]:
        """Advance by one step of the agent: act, simulate a timestep, observe and score.

        Raises:
            ResetNeededError: Before the first reset, or after the end of the episode.
            UsageError: With an action outside the action space.
            EngineError: The state of the world contains infinite or NaN values, or a joint moves
                faster than a motor or a fall could make it.
            EvaluationError: An expression has no value, or the reward is not finite; the message shows which.
            MessageError: A message does not fit its layout.
        """
        # The form of the action is not checked: a valid one pays nothing, and another one fails before
        # anything has changed.
        try:
            self._go_on(action)
        except (ArithmeticError, ValueError, LookupError, NameError, TypeError, AttributeError) as error:
            self._try_again(action, error)
        terminated, truncated = self.is_done()
        # A world that blew up has rewards without meaning.
        if terminated or truncated or self.step_count % STEPS_PER_CHECK == 0:
            self.engine.require_finite()
            if terminated or truncated:
                self._go_on = self._refuse
        return self.get_observations(), self.get_reward(), terminated, truncated, self.get_info()

    def render(self) -> Any:
        """Return an image of the world (uint8, height x width x 3), or None without a render mode."""
        if self.render_mode is None:
            return None
        return self.engine.render(self.view())

    def view(self, width: int = 480, height: int = 320) -> View:
        """Return the view of `render` in another size: it shows the whole scene, and follows a robot that may
        leave it."""
        return self._view.view(width, height)

    def close(self) -> None:
        """Release the engine; may be called twice."""
        if not self._closed:
            self._closed = True
            self._go_on = self._refuse
            self.engine.close()

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which options may be chosen next: the truth values of all choices in a row, in the form of
        sb3-contrib.

        Raises:
            UsageError: The action has no choice.
        """
        masks = self.allowed()
        if not masks:
            raise UsageError("action masks need an action with `choices`, but this scenario has none")
        return np.array([may for mask in masks for may in mask])

    def action_mask(self) -> Any:
        """Return the masks of `action_masks` in the form that `action_space.sample` takes."""
        return mask_of_space(self.action_space, [np.array(mask, np.int8) for mask in self.allowed()])

    def script(self, name: str) -> Any:
        """Return the next action of a script of the scenario, in the action space; this changes nothing.

        Raises:
            UsageError: There is no such script, or no episode has begun.
            EvaluationError: An expression of it has no value; shows which.
        """
        self.scenario.script(name)
        if self._go_on == self._refuse and self.ended_by is None:
            raise UsageError(_CLOSED if self._closed else "call reset() before script()")
        try:
            return self.scripted(name)
        except (ArithmeticError, ValueError, NameError) as error:
            raise without_value(error, self.engine, self.step_count) from error

    def scripted(self, name: str) -> Any:
        """Return the next action of a script, without a check that the script exists."""
        return getattr(self, generated.script(name))()

    def tested(self, test: str, question: generated.TestQuestion) -> tuple[Any, ...]:
        """Return whether each condition of a test holds after the last step, or the values that the
        conditions compare, in SI units.

        Raises:
            EvaluationError: An expression has no value; shows which.
        """
        try:
            values: tuple[Any, ...] = getattr(self, generated.test(test, question))()
        except (ArithmeticError, ValueError, NameError) as error:
            raise without_value(error, self.engine, self.step_count) from error
        return values

    def make_action(self, choices: Sequence[int], ranges: Sequence[float]) -> Any:
        """Return an action of these options, by number, and these values from -1 to 1."""
        return compose_action(self.action_space, choices, ranges)

    @cached_property
    def ground_height(self) -> Height:
        """The height (m) of the ground at x, y (m) of the world frame."""
        return ground_height(self.scenario.world.terrain, diagonal_of(self.engine.name))

    # Methods that the compiler prints

    def allowed(self) -> tuple[tuple[bool, ...], ...]:
        """Return which options of each choice may be chosen next; all of them unless the scenario forbids
        some."""
        return tuple((True,) * len(part.options) for part in self.agent.choices)

    @abstractmethod
    def get_observations(self) -> Observation:
        """Return the observation, of `observation_space`; a copy."""

    def get_reward(self) -> float:
        """Return the reward of the last step: the sum of its terms."""
        return self.reward

    def is_done(self) -> tuple[bool, bool]:
        """Return whether the task ended (success or failure), and whether a limit cut the episode short."""
        return self.terminated, self.truncated

    @abstractmethod
    def get_info(self) -> Info:
        """Return `is_success`, `ended_by` (the first ending, or the limit), all `endings` that hold,
        `reward_terms` by name."""

    @abstractmethod
    def _begin(self) -> None:
        """Draw the random values of the episode, and set the world to its initial state."""

    @abstractmethod
    def _start(self) -> None:
        """Observe the start of an episode."""

    @abstractmethod
    def _advance(self, action: Any) -> Any:
        """Advance by one step: act, simulate, and observe.

        With copies of the robot it is a generator that yields before each timestep is simulated
        (`copies.py`).
        """

    # Methods for generated code

    def ranges(self, action: Any) -> list[float]:
        """Return the numbers of an array from the action space, each within [-1, 1].

        Raises:
            ValueError: There are more or fewer than the action has.
            FloatingPointError: One is not a number.
        """
        values = [x if -1.0 <= x <= 1.0 else clip(x) for x in action.tolist()]
        if len(values) != self._ranges:
            raise ValueError(f"{len(values)} numbers")
        return values

    # Failures: off the fast path

    def _nothing_allowed(self, choice: str) -> None:
        """Raise the error for a choice whose options are all forbidden while the episode goes on."""
        raise EvaluationError(f"step {self.step_count}: {without_option(self.agent, choice)}")

    def _forget(self) -> None:
        self.step_count = self.timestep_count = self.newest = 0
        self.reward = self.previous_reward = self.episode_return = 0.0
        self.forget_end()
        self.episode_values = {}
        self._view.restart()

    def _refuse(self, action: Any) -> None:
        """Refuse a step; this replaces `_advance` while no episode runs."""
        if self._closed:
            raise UsageError(_CLOSED)
        over = "" if self.ended_by is None else f"the episode has ended ('{self.ended_by}'); "
        raise ResetNeededError(f"{over}call reset() before step()")

    def _not_finite(self) -> None:
        """Raise the error for a reward that is not finite."""
        self.engine.require_finite()
        raise EvaluationError(f"step {self.step_count}: {infinite_reward(self.get_info()['reward_terms'])}")

    def _try_again(self, action: Any, error: Exception) -> None:
        """Advance by an action in a form that the fast path does not take, or raise its error.

        A list, or the array without axes that a policy predicts, fails there before anything has changed.
        """
        fitting = canonical_action(self.action_space, action)
        if fitting is None:
            raise UsageError(f"action {excerpt(action)} does not fit {self.action_space}") from None
        if is_canonical(fitting, action):
            raise without_value(error, self.engine, self.step_count) from error
        try:
            self._go_on(fitting)
        except (ArithmeticError, ValueError) as second:
            raise without_value(second, self.engine, self.step_count) from second

    def __reduce__(self) -> tuple[Any, ...]:
        if self.rebuild is None:
            raise UsageError("this environment was built by hand and cannot be copied to another process")
        return self.rebuild, ()
