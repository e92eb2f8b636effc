"""The policies of runs: loaded for a world, as an object to call, and as the other agents beside the one that
is trained or evaluated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import learner as learners
from deepbots_cli.learning.environments import random_numbers_kept
from deepbots_cli.learning.learner import Learner, Setup
from deepbots_cli.learning.multi_agent import has_agents, own_model
from deepbots_cli.learning.runs.run import ModelName, ModelRef, Run
from deepbots_cli.program import Others, Program
from deepbots_cli.program.task import ActionRange, Choices
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.worlds import has_copies
from deepbots_cli.runtime.spaces import Observer, action_space, observation_space
from deepbots_cli.words import unit_text


@dataclass(frozen=True)
class ActionValue:
    """A part of the action: a choice of one of `options`, or a number in [-1, 1] that is mapped to `low` ..
    `high` in `unit`."""

    name: str
    options: tuple[str, ...] = ()
    unit: str = ""
    low: float = -1.0
    high: float = 1.0


class Policy:
    """The policy of a run; made by `load_policy`.

    Attributes:
        scenario: The name of the scenario.
        observation_space: The space of one observation.
        action_space: The space of one action.
        observation: The numbers of the observation vector, in order.
        goal: The numbers of a goal, in order; none for a policy without a goal.
        values: The names that `observe` takes: those of `observation`, and with a goal also those from which
            the achieved goal is computed.
        action: The parts of the action, in order.
    """

    def __init__(self, program: Program, model: Learner) -> None:
        self.scenario = program.name
        self.observation_space = observation_space(program.agent)
        self.action_space = action_space(program.agent)
        self.observation = program.agent.inputs
        self.goal = program.agent.goal.values if program.agent.goal else ()
        self._observer = Observer(program)
        self.values = self._observer.values
        self.action = tuple(value for part in program.agent.action for value in _values(part))
        self._model = model
        self.reset()

    def reset(self) -> None:
        """Begin an episode: a recurrent policy forgets the previous one."""
        self._memory: Any = None
        self._begins = True

    def predict(self, observation: Any, *, deterministic: bool = True, action_mask: Any = None) -> Any:
        """Return the action for an observation.

        Args:
            observation: An observation of the environment, or several as rows (n, k); see `observe` for
                values in units.
            deterministic: Whether to take the most likely action; otherwise the policy samples with torch's
                random generator.
            action_mask: Which options are allowed, as `env.unwrapped.action_masks()` returns it; only
                MaskablePPO takes it.

        Returns:
            An action in the action space, or one per row.

        Raises:
            UsageError: The observation contains a value that is not finite.
        """
        for part in observation.values() if isinstance(observation, dict) else (observation,):
            numbers = np.atleast_1d(part)
            wrong = np.argwhere(~np.isfinite(numbers))
            if len(wrong):
                index = int(wrong[0][-1])
                name = (
                    f" of {self.observation[index].name}"
                    if part is observation and index < len(self.observation)
                    else ""
                )
                raise UsageError(
                    f"the observation contains a value{name} that is infinite or NaN:"
                    f" {numbers[tuple(wrong[0])]}"
                )
        masks = action_mask if self._model.takes_masks else None
        action, self._memory = self._model.predict(
            observation, self._memory, np.full(self._rows(observation), self._begins), deterministic, masks
        )
        self._begins = False
        return action

    __call__ = predict

    def _rows(self, observation: Any) -> int:
        """Return the number of rows of an observation; 1 for a single observation."""
        part = observation
        space = self.observation_space
        if isinstance(space, gym.spaces.Dict):
            name, space = next(iter(space.spaces.items()))
            part = observation[name]
        return len(part) if np.ndim(part) > len(space.shape or ()) else 1

    def observe(self, values: Mapping[str, float], desired: Sequence[float] | None = None) -> Any:
        """Return the observation for values by name, in their units (SI). Values beyond a range are clipped.

        Args:
            values: A value for each name of `self.values`.
            desired: The goal in its unit, a number for each entry of `self.goal`; only for a policy with a
                goal.

        Returns:
            float32 of shape (k,). With a goal, a dictionary of `observation`, `achieved_goal` and
            `desired_goal`, as in environments.

        Raises:
            UsageError: A name is missing or unknown, a value is not finite, the goal is missing or has
                another size, or the policy has images or older values in its observation.
        """
        return self._observer.observe(values, desired)

    def named(self, action: Any) -> dict[str, float | str]:
        """Return an action by name: the chosen option of a choice, or the number in its unit."""
        return {
            value.name: value.options[int(number)]
            if value.options
            else value.low + (number + 1.0) / 2.0 * (value.high - value.low)
            for value, number in zip(self.action, np.asarray(action).reshape(-1).tolist(), strict=True)
        }

    def __repr__(self) -> str:
        return (
            f"<policy of {self.scenario}: {len(self.observation)} numbers to"
            f" {', '.join(value.name for value in self.action)}>"
        )


def load_policy(run: str | Path, *, model: ModelName = "best") -> Policy:
    """Load the policy of a run: its best model, the one called `model`, or the one whose file `run` names.

    Loading unpickles nothing and does not change global random generators. Call `torch.set_num_threads(1)`
    before your own loop: networks of this size are many times slower on several threads. deepbots does not
    change the number of threads of your process.

    Raises:
        RunError: The folder is not a run, or is damaged.
        MissingExtraError: The extra `train` is not installed.
    """
    ref = ModelRef.open(run, model=model)
    return Policy(ref.run.program, loaded(ref.run, ref.name))


def loaded(run: Run, model: ModelName) -> Learner:
    """Load the model of a run without a world. The random generators of the caller stay as they are.

    Raises:
        RunError: There is no such model, or it is damaged.
    """
    with random_numbers_kept():  # a library may seed the global generators when it makes a model
        return load_model(run, model)


def _values(part: Choices | ActionRange) -> list[ActionValue]:
    if isinstance(part, Choices):
        return [ActionValue(part.name, tuple(option.name for option in part.options))]
    return [ActionValue(name, (), unit_text(part.unit), part.low, part.high) for name in part.names]


def load_model(run: Run, name: ModelName, world: gym.Env[Any, Any] | None = None) -> Learner:
    """Load the model of a run: built from its scenario for the spaces of `world`, with the weights of
    `models/agent/<name>.zip`.

    Raises:
        RunError: The file is missing, damaged, or fits another policy.
    """
    training = run.program.agent.training
    if training is None:
        raise RunError(f"{run.path} contains a scenario without a `train` section")
    agent = run.program.with_critic.agent
    columns = agent.policy_columns
    if world is None or columns is not None:
        spaces = observation_space(agent), action_space(agent)
    else:
        player = next(iter(world.get_wrapper_attr("agents").values())) if has_copies(world) else world
        spaces = player.observation_space, player.action_space
    loaded = learners.create(Setup(training, *spaces, policy_columns=columns, program=run.program))
    others = run.program.others
    if others is None:
        loaded.load(run.model(name))
        return loaded
    with model_of(run.model(name), others.agent) as file:
        loaded.load(file)
    return loaded


def load_rival(others: Others, agent: str) -> Learner:
    """Load the policy of an agent that acts beside the one of a program. Its `train` has the algorithm and
    the layers.

    Raises:
        UsageError: The scenario has no `train` for the agent, or the model has other layers, or is one of
            another scenario.
        RunError: The model is damaged.
    """
    program = others.world.members[agent].program
    path = others.models[agent]
    training = program.agent.training
    critic_agent = program.with_critic.agent
    if training is None:
        raise UsageError(
            f"`{agent}` has no `train`, so the layers of its policy in {path} are unknown; write it as in the"
            " scenario of that run"
        )
    with random_numbers_kept():
        policy = learners.create(
            Setup(
                replace(training, device="cpu"),
                observation_space(critic_agent),
                action_space(critic_agent),
                policy_columns=critic_agent.policy_columns,
                program=program,
            )
        )
        with model_of(path, agent) as file:
            try:
                policy.load(file)
            except RunError as error:
                error.add_note(
                    f"the policy of `{agent}` needs the observation, the action and the `train` of the"
                    " scenario that it was trained in"
                )
                raise
    return policy


@contextmanager
def model_of(path: Path, agent: str) -> Iterator[Path]:
    """Context with the file of the model of an agent: `path` itself, or the part of a model of all agents.

    Raises:
        RunError: The model is one of other agents.
    """
    if not has_agents(path):
        yield path
        return
    with own_model(path, agent) as file:
        yield file
