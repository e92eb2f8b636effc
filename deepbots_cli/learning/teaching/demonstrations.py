"""Demonstrations: the episodes of a recording, which teach a policy.

The episodes are run again in the scenario of the training, from their seeds with their actions. So
observations and rewards are those of this scenario, even if the recording was made in an earlier state of the
file.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from deepbots_cli import api
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.environments import WorldFactory
from deepbots_cli.program import Program, identity
from deepbots_cli.rollout import Episode, Start, Step, result_of, steps
from deepbots_cli.rollout.drivers import sequence_driver
from deepbots_cli.rollout.recordings import Recording, actions
from deepbots_cli.rollout.source import Source
from deepbots_cli.rollout.worlds import Array

_MAX_STEPS = 100_000


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """The steps of all episodes, in arrays of shape (steps, ...).

    Attributes:
        observations: The observations before each step; a dict of arrays for a policy with images or a goal.
        actions: The actions, in the action space.
        rewards: The rewards, of shape (steps,).
        following: The observations after each step.
        terminated: Whether an ending of the scenario, and not the time limit, came with the step; of shape
            (steps,).
        episodes: Their results.
    """

    observations: Any
    actions: Array
    rewards: Array
    following: Any
    terminated: Array
    episodes: Sequence[Episode]


def read_recording(path: str | Path, program: Program) -> Recording:
    """Read a recording whose observation, action and messages are those of a scenario.

    Raises:
        UsageError: They differ, the file cannot be read or is too long, or several agents act in it.
    """
    recording = Recording.read(Path(path))
    recorded = api.compile(Source.kept(recording.folder, Permissions())).program
    differ = identity.differences(recorded, program, words=("recording", "scenario"))
    if differ:
        raise UsageError(f"the actions of {path} do not fit {program.name}:\n  " + "\n  ".join(differ))
    if program.agent.copies is not None:
        raise UsageError(f"{path} cannot teach copies of a robot; leave out --teacher")
    if sum(len(episode.steps) for episode in recording.episodes) > _MAX_STEPS:
        raise UsageError(f"{path} has more than {_MAX_STEPS:,} steps; record fewer episodes")
    return recording


def demonstrate(path: str | Path, program: Program, build: WorldFactory) -> Demonstrations:
    """Run the episodes of a recording in a scenario.

    Args:
        path: The recording.
        program: The scenario of the training. Episodes of one of its stages run in this stage.
        build: Makes a world.

    Raises:
        UsageError: The recording is refused by `read_recording`; or `program` defines success, and no episode
            succeeds.
    """
    recording = read_recording(path, program)
    stage = recording.metadata.get("stage")
    scenario = (
        program.variant(None, stage) if stage in {entry.name for entry in program.curriculum} else program
    )
    played_steps: list[Step] = []
    observations: list[Any] = []
    episodes = []
    with closing(build(scenario.with_critic)) as world:
        for recorded in recording.episodes:
            shown_actions = list(actions(recording, recorded, world.action_space))
            episode = list(
                islice(
                    steps(world, sequence_driver(shown_actions), Start(recorded.seed)), len(shown_actions) + 1
                )
            )
            observations += [step.observation for step in episode[:-1]]
            played_steps += episode[1:]
            episodes.append(result_of(episode, recorded.seed))
    if not played_steps:
        raise UsageError(f"{path} contains no step; record an episode first")
    if program.defines_success and not any(episode.is_success for episode in episodes):
        count = (
            "its episode does not succeed"
            if len(episodes) == 1
            else f"none of its {len(episodes)} episodes succeeds"
        )
        raise UsageError(
            f"{path} cannot teach {program.name}: {count}; look at them with: deepbots replay {path}"
        )
    return Demonstrations(
        _stacked(observations),
        np.stack([step.action for step in played_steps]),
        np.array([step.reward for step in played_steps]),
        _stacked([step.observation for step in played_steps]),
        np.array([step.terminated for step in played_steps]),
        episodes,
    )


def _stacked(observations: Sequence[Any]) -> Any:
    first = observations[0]
    return (
        {key: np.stack([observation[key] for observation in observations]) for key in first}
        if isinstance(first, dict)
        else np.stack(observations)
    )
