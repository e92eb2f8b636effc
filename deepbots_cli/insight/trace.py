"""An episode that runs again, with the observation, action, reward and measurements of each step.

Runs keep the seeds of their evaluations, recordings their actions, failures both: each of them gives the same
episode once more.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from shlex import quote
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli import api
from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError, UsageError
from deepbots_cli.insight.conditions import (
    InstrumentedProgram,
    MeasuredComparison,
    StepValues,
    deciding_comparison,
    instrument_program,
)
from deepbots_cli.learning import environments
from deepbots_cli.learning.runs.run import ModelName, Run
from deepbots_cli.program import Program
from deepbots_cli.rollout import Start, play, steps
from deepbots_cli.rollout.drivers import sequence_driver
from deepbots_cli.rollout.recordings import RecordedEpisode, Recording, actions
from deepbots_cli.runtime import Supervisor
from deepbots_cli.view.episodes import ShowingState
from deepbots_cli.view.frames import successful_agents, value_of_row
from deepbots_cli.view.recordings import observation_hash
from deepbots_cli.view.replay import observation_hash_at, version_changes

Array = NDArray[np.float64]


@dataclass(eq=False)
class Trace:
    """An episode of an agent. For a team, it is that of the agent that ended the episode, or of the first
    one.

    Step k lies between moment k - 1 and moment k; moment 0 is the reset. `observations` (moments, numbers)
    has the newest value of each number as observed, and `values` the values that the conditions of the
    endings compare in each moment. `terms` (steps) are the reward terms, and `actions` the actions in the
    action space. `critic` holds the critic's value of each moment but the last; None for a policy without a
    critic or with a memory, and for recordings and failures.
    """

    title: str
    instrumented: InstrumentedProgram
    observations: Array
    actions: Sequence[Any]
    terms: Mapping[str, Array]
    values: Sequence[StepValues]
    ended_by: str | None
    outcome: Literal["success", "failure", "time limit", "error", "not ended"]
    time: float
    error: str = ""
    agent: str = ""
    succeeded: Sequence[str] = ()
    """Of several agents, those for which the episode is a success."""
    critic: Array | None = None
    notes: Sequence[str] = ()
    units: ShownUnits = field(default_factory=ShownUnits)
    """The units that the scenario file uses."""

    @property
    def program(self) -> Program:
        return self.instrumented.program

    @property
    def steps(self) -> int:
        return len(self.actions)

    @property
    def returns(self) -> float:
        return float(sum(term.sum() for term in self.terms.values()))

    def time_at(self, step: int) -> float:
        """Return the time of a moment, in s."""
        return self.time if step == self.steps else step * self.program.period

    @cached_property
    def end(self) -> MeasuredComparison | None:
        """The comparison that ended the episode; None if an episode limit ended it, or the ending has
        no tree."""
        # At a limit, only a scenario with a goal has a success.
        at_limit = self.outcome == "success" and self.ended_by in (
            "max_steps",
            "max_time",
        )
        condition = self.instrumented.conditions.get("goal_reached" if at_limit else self.ended_by or "")
        if condition is None or self.outcome in ("time limit", "error", "not ended"):
            return None
        return deciding_comparison(
            condition, self.values[-2] if len(self.values) > 1 else None, self.values[-1]
        )

    def action_array(self, key: Literal["choices", "ranges"]) -> Array:
        """Return the numbers of the options, or the numbers of ranges in [-1, 1], of the actions: (steps,
        numbers)."""
        rows = [action[key] if isinstance(action, dict) else action for action in self.actions]
        return np.array([np.asarray(row, float).reshape(-1) for row in rows]).reshape(
            len(rows), -1 if rows else 0
        )


class TraceRecorder(gym.Wrapper[Any, Any, Any, Any]):
    """A world that records each step of an episode; a reset starts a new record. The wrapper closes the
    world."""

    def __init__(
        self, world: Supervisor, instrumented: InstrumentedProgram, units: ShownUnits | None = None
    ) -> None:
        super().__init__(world)
        self.world, self.instrumented, self.units = world, instrumented, units or ShownUnits()
        self.observations: list[Any] = []
        self.actions: list[Any] = []
        self._terms: list[list[Mapping[str, float]]] = []
        self._values: list[list[StepValues]] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        self.observations, self.actions, self._terms, self._values = [observation], [], [], []
        self._note()
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        outcome = self.env.step(action)
        self.observations.append(outcome[0])
        self.actions.append(action)
        self._terms.append([agent.get_info()["reward_terms"] for agent in self.world.agents.values()])
        self._note()
        return outcome

    def _note(self) -> None:
        self._values.append([self.instrumented.read(agent) for agent in self.world.agents.values()])

    def trace(self, title: str, *, error: str = "", notes: Sequence[str] = ()) -> Trace:
        """Return the episode so far."""
        world, program = self.world, self.instrumented.program
        names, team = list(world.agents), len(world.agents) > 1
        row = next(
            (
                n
                for n, agent in enumerate(world.agents.values())
                if agent.ended_by and agent.ended_by == world.ended_by
            ),
            0,
        )
        agent_observations = [
            value_of_row(observation, row) if team else observation for observation in self.observations
        ]
        newest = [index for index, value in enumerate(program.agent.inputs) if value.steps_ago == 0]
        vectors = [
            observation.get("observation", np.zeros(0)) if isinstance(observation, dict) else observation
            for observation in agent_observations
        ]
        observations = np.array([np.asarray(vector, float)[newest] for vector in vectors]).reshape(
            len(vectors), len(newest)
        )
        outcome: Any = "error" if error else "not ended"
        if world.ended_by is not None and not error:
            if world.is_success:
                outcome = "success"
            elif world.truncated:
                outcome = "time limit"
            else:
                outcome = "failure"
        return Trace(
            title=title,
            instrumented=self.instrumented,
            observations=observations,
            actions=[value_of_row(action, row) if team else action for action in self.actions],
            terms={
                term.name: np.array([terms[row][term.name] for terms in self._terms], float)
                for term in program.agent.reward
            },
            values=[values[row] for values in self._values],
            ended_by=world.ended_by,
            outcome=outcome,
            time=(world.timestep_count or world.step_count * program.action_repeat) * program.world.timestep,
            error=error,
            agent=names[row] if team else "",
            succeeded=successful_agents(program, world.endings, world.agent_endings),
            notes=notes,
            units=self.units,
        )


# Runs


def trace_episodes(
    run: Run,
    numbers: Sequence[int],
    *,
    seed: int,
    model: ModelName = "best",
    deterministic: bool = True,
    permissions: Permissions = Permissions(),
) -> Iterator[Trace]:
    """Run the episodes of the evaluation of a run with this root seed again.

    Raises:
        RunError: The run has no model, or one that does not fit.
    """
    from deepbots_cli.learning.policy import load_model
    from deepbots_cli.learning.sb3.algorithms import torch_settings
    from deepbots_cli.rollout.policies import PolicyDriver

    if not run.model(model).is_file():
        path = quote(str(run.path))
        if run.record.status == "failed":
            raise RunError(
                f"the training of {run.path} failed before it saved a model; find the cause with: deepbots"
                f" diagnose {path}"
            )
        raise RunError(
            f"{run.path} contains no model '{model}'; train it first, with: deepbots resume {path}"
        )
    watch = instrument_program(run.program)
    with (
        torch_settings(),
        closing(_world(watch, run.engine_for(run.program), permissions, run.compiled.units)) as world,
    ):
        policy = load_model(run, model, world)
        for number in numbers:
            play(
                world,
                PolicyDriver(policy, world, deterministic=deterministic),
                Start.of_evaluation(seed, number),
            )
            trace = world.trace(f"episode {number} of {run.path}", notes=run.notes())
            row = list(world.world.agents).index(trace.agent) if trace.agent else None
            observations = [
                observation if row is None else value_of_row(observation, row)
                for observation in world.observations[:-1]
            ]
            trace.critic = policy.values(observations)
            yield trace


def _world(
    watch: InstrumentedProgram, engine: str | None, permissions: Permissions, units: ShownUnits
) -> TraceRecorder:
    return TraceRecorder(api.build(watch.program, engine=engine, permissions=permissions), watch, units)


# Recordings and failures


def trace_recorded(opened: ShowingState, episodes: Sequence[RecordedEpisode]) -> Iterator[Trace]:
    """Run episodes of an open recording again, each with its actions.

    Raises:
        RecordingError: A step is damaged.
        UsageError: An episode differs when its actions run here.
    """
    recording: Recording = opened.recording
    # A recording that does not compile is refused when it is opened.
    assert opened.program is not None
    showing, units = opened.shown, opened.checked().units
    with closing(
        _world(instrument_program(opened.program), showing.engine, showing.permissions, units)
    ) as world:
        for recorded in episodes:
            again = steps(
                world, sequence_driver(actions(recording, recorded, world.action_space)), Start(recorded.seed)
            )
            for index in range(len(recorded.steps)):
                try:
                    step = next(again, None)
                except UsageError:  # the action does not fit this scenario
                    step = None
                if step is None or observation_hash_at(recording, recorded, index) != observation_hash(
                    step.observation
                ):
                    reason = (
                        "; ".join(version_changes(recording))
                        or "it was made on another machine, or changed since then"
                    )
                    problem = f"{recording.path}: the episode differs from its recording at step {index}"
                    raise UsageError(f"{problem}, so it cannot be explained here: {reason}")
            yield world.trace(f"episode {recorded.number} of {recording.path}")


def trace_failure(path: Path, *, permissions: Permissions = Permissions()) -> Trace:
    """Run the episode of a file in the folder `failures` of a run again.

    Raises:
        RunError: The file is damaged, or does not lie in the folder of a run.
    """
    failure, run, program = environments.read_failure(path)
    error = ""
    with closing(
        _world(instrument_program(program), run.record.engine, permissions, run.compiled.units)
    ) as world:
        try:
            for _ in environments.repeat_steps(failure, program, world, path):
                pass
        except RunError:
            raise
        except DeepbotsError as raised:
            error = str(raised)
        return world.trace(f"episode {failure.episode} of {path}", error=error)
