"""Policies of other agents: those that act beside an agent that is trained or evaluated."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import learner as learners
from deepbots_cli.learning.agents.multi_agent import has_agents, own_model
from deepbots_cli.learning.learner import Learner, Setup
from deepbots_cli.learning.shards import random_numbers_kept
from deepbots_cli.program import Others
from deepbots_cli.runtime.spaces import action_space, observation_space


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
