"""A policy as teacher: it labels the states of a training with the actions that it would take.

The policy that learns drives, and the teacher only labels (DAgger; S. Ross, G. Gordon, D. Bagnell, AISTATS
2011). The teacher usually sees more than the policy that learns. What it sees must be in the observation of
the training, or in its `critic`: then its observation consists of columns of that of the training.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME
from deepbots_cli.errors import StorageError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.environments import WorldFactory
from deepbots_cli.learning.held_out import EVALUATION_EPISODES, EvaluationWorlds
from deepbots_cli.learning.policy import loaded
from deepbots_cli.learning.runs.run import ModelRef, Run
from deepbots_cli.program import Program, identity
from deepbots_cli.program.task import Agent
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.source import RECORD_NAME
from deepbots_cli.rollout.worlds import Array
from deepbots_cli.scenario.training import ALGORITHMS

_FILES = (RECORD_NAME, RESOLVED_NAME)


class PolicyTeacher:
    """The policy of a run as a teacher of another training.

    Args:
        teacher: The run and its model.
        program: The scenario of the training.

    Raises:
        UsageError: The policy has a memory, another action, or sees something that the training does not
            compute.
    """

    def __init__(self, teacher: ModelRef, program: Program) -> None:
        self.name = teacher.label
        self._run = teacher.run
        self._columns = _columns(teacher, program)
        self._learner = loaded(teacher.run, teacher.name)

    def actions(self, observations: Array) -> Array:
        """Return the actions in observations of the training, both of shape (steps, rows, ...)."""
        inputs = observations[..., self._columns]
        actions, _ = self._learner.predict(inputs.reshape(-1, inputs.shape[-1]), deterministic=True)
        labels: Array = np.asarray(actions).reshape(*observations.shape[:2], *np.shape(actions)[1:])
        return labels

    takes_masks = False

    def predict(self, observation: Any, *arguments: Any, **settings: Any) -> tuple[Any, Any]:
        """Act in a world of the training."""
        return self._learner.predict(np.asarray(observation)[..., self._columns], deterministic=True)

    def play(self, program: Program, build: WorldFactory, engine: str, seeds: Sequence[int]) -> list[Episode]:
        """Play an episode from each seed in a scenario of the training."""
        worlds = EvaluationWorlds(build, self._run, engine=engine, batch=EVALUATION_EPISODES)
        worlds.enter(program.with_critic)
        random = torch.get_rng_state()  # a player seeds the generator for each episode
        try:
            return worlds.play(self, seeds)
        finally:
            torch.set_rng_state(random)
            worlds.close()


def copy_teacher(teacher: ModelRef, folder: Path) -> None:
    """Copy what a policy needs of its run, so that a training can continue without the run.

    Raises:
        StorageError: The folder cannot be written.
    """
    run = teacher.run.path
    copied = Run.model_below(folder)
    try:
        folder.mkdir()
        for name in _FILES:
            shutil.copyfile(run / name, folder / name)
        if (run / INPUTS_FOLDER).is_dir():
            shutil.copytree(run / INPUTS_FOLDER, folder / INPUTS_FOLDER)
        copied.parent.mkdir(parents=True)
        shutil.copyfile(teacher.path, copied)
    except OSError as error:
        raise StorageError(unwritable_message(folder, error)) from error


def _columns(teacher: ModelRef, program: Program) -> list[int]:
    """Return the places of what the teacher sees in an observation of the training."""
    agent = teacher.run.program.agent
    learner = program.with_critic.agent
    name = teacher.label
    training = agent.training
    if training is not None and ALGORITHMS[training.algorithm].is_recurrent:
        raise UsageError(f"the policy of {name} has a memory, which a teacher cannot have")
    for checked_agent, whose in ((agent, name), (learner, program.name)):
        if checked_agent.goal is not None or checked_agent.images or checked_agent.copies is not None:
            raise UsageError(
                f"{whose} has a goal, pictures or copies of a robot, with which a policy cannot be a teacher"
            )
    differ = [
        line for line in identity.differences(teacher.run.program, program) if line.startswith("action.")
    ]
    if differ:
        raise UsageError(
            f"the policy of {name} has another action than {program.name}:\n  " + "\n  ".join(differ)
        )
    indices = {observed: index for index, observed in enumerate(learner.inputs)}
    missing = [observed for observed in agent.inputs if observed not in indices]
    if missing:
        raise UsageError(_missing_text(name, missing[0].name, len(missing), learner))
    return [indices[observed] for observed in agent.inputs]


def _missing_text(name: str, first: str, count: int, learner: Agent) -> str:
    """Return the message about values that the teacher sees and the training does not compute."""
    more = f" and {count - 1} more" if count > 1 else ""
    if any(observed.name == first for observed in learner.inputs):
        return f"the teacher {name} sees `{first}`{more} with another range or history; write the same ones"
    return (
        f"the teacher {name} sees `{first}`{more}, which the training does not compute; list it under"
        " `critic` with the range that the teacher has"
    )
