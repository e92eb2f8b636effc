"""A teacher, which is a script, a recording or another policy: when the policy imitates it, and how much.

At first the policy only imitates: the script drives some of the worlds, fewer and fewer with time and
agreement, and provides its action in every state (DAgger; S. Ross, G. Gordon, D. Bagnell, AISTATS 2011). The
critic learns meanwhile. This ends when an evaluation shows that the policy is about as good as the script, or
after a share of all timesteps. Then the algorithm learns as usual, with an imitation loss whose weight fades.
A recording does not drive; the policy imitates its actions in its states. Another policy does not drive
either: it provides its action in every state.

The episodes of a recording are run again in the scenario of the training, from their seeds with their
actions. So observations and rewards are those of this scenario, even if the recording was made in an earlier
state of the file.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, Field

from deepbots_cli import api
from deepbots_cli.analysis import unobserved_reads
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME
from deepbots_cli.document import Permissions
from deepbots_cli.errors import StorageError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.environments import (
    EVALUATION_EPISODES,
    EvaluationWorlds,
    Evaluator,
    WorldFactory,
    play_script,
    random_numbers_kept,
)
from deepbots_cli.learning.runs.episodes import Summary
from deepbots_cli.learning.runs.run import ModelRef, Run
from deepbots_cli.program import Program, identity
from deepbots_cli.program.task import Agent, Teacher
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode, Start, Step, result_of, steps
from deepbots_cli.rollout.collector import Lesson
from deepbots_cli.rollout.drivers import sequence_driver
from deepbots_cli.rollout.recordings import Recording, actions
from deepbots_cli.rollout.source import RECORD_NAME, Source
from deepbots_cli.rollout.worlds import Array
from deepbots_cli.scenario.training import ALGORITHMS
from deepbots_cli.words import number_text, rate_text, shell_word

ENOUGH = 0.95
"""The share of the script's success rate at which imitation alone ends."""
_FADE_SHARE = 0.3
"""The share of all timesteps in which the weight of the imitation loss falls to 0."""
_DEMONSTRATES_SHARE = 1 / 3
"""The share of the time of imitation in which the script drives all worlds of an algorithm without an actor.
A critic with experience of the script alone overrates other actions: on PandaPush with SAC, the policy
succeeds in 5 % after 12,200 such steps, and in 95 % after 20,000 with 4,800."""
_DRIVES_SHARE = 0.5
"""The share of the time of imitation in which the script drives some of the worlds."""


@dataclass(frozen=True)
class Plan:
    """The plan of a teacher for the next fragment.

    Attributes:
        lesson: The lesson for the collector; None when the teacher is done, or is not a script.
        weight: The weight of the imitation loss.
        only: Whether the policy only imitates.
    """

    lesson: Lesson | None = None
    weight: float = 0.0
    only: bool = False


class TeacherState(BaseModel, strict=True, allow_inf_nan=False):
    """The state of the teacher in a checkpoint."""

    stage: Annotated[int, Field(ge=0)]
    imitated_until: Annotated[int, Field(ge=-1)]
    drives: bool
    agreement: Annotated[float, Field(ge=0, le=1)]


class Teaching:
    """Follows a training with a teacher.

    Args:
        teacher: The teacher of the scenario.
        total: Timesteps of the training.
        worlds: Number of its worlds.
        imitates: Whether the policy can imitate; otherwise the script only drives, and its steps stay in the
            replay buffer.
        demonstrations: The demonstrations of a recording, which is the teacher then.
        policy: The policy that is the teacher then.
    """

    def __init__(
        self,
        teacher: Teacher,
        total: int,
        worlds: int,
        *,
        imitates: bool,
        demonstrations: Demonstrations | None = None,
        policy: PolicyTeacher | None = None,
    ) -> None:
        self.teacher = teacher
        self._total = total
        self._worlds = worlds
        self._has_loss = imitates
        self.demonstrations = demonstrations
        self.policy = policy
        self._is_script = demonstrations is None and policy is None
        self._has_stages = demonstrations is None
        self.score: Summary | None = None
        """The score of the script from the starts of the evaluations."""
        self.drives = False
        """Whether the script drives some of the worlds."""
        self.agreement = 0.0
        """The share of the newest states in which a policy that imitates agrees with the script."""
        self._stage = 0
        self._imitated_until = -1
        self._is_able = True

    @property
    def imitates(self) -> bool:
        """Whether the lessons continue: no evaluation, and no limit, has ended them."""
        return self._imitated_until < 0

    def knows(self, stage: int) -> bool:
        """Return whether the score of the script in a stage of the curriculum is known."""
        return self.score is not None and (self._stage == stage or not self._has_stages)

    def play(
        self, scenario: Program, evaluator: Evaluator, engine: str
    ) -> tuple[Sequence[Episode], list[str]]:
        """Play the teacher from the starts of the evaluations; a recording has its own episodes. Returns the
        episodes, and the values that a script reads and the policy does not observe."""
        if self.demonstrations is not None:
            return self.demonstrations.episodes, []
        if self.policy is not None:
            return self.policy.play(scenario, evaluator.build, engine, evaluator.starts), []
        script = self.teacher.script
        return (
            play_script(evaluator.build, scenario, script, evaluator.starts),
            unobserved_reads(scenario, script),
        )

    def begin(self, stage: int, episodes: Sequence[Episode], defines_success: bool) -> str:
        """Take over the episodes of the script in a stage of the curriculum. Returns its score in a sentence.
        A new stage begins with lessons.

        If none of them succeeds, the script does not teach in this stage.
        """
        self.score = summary = Summary.of_episodes(episodes)
        name = f"the teacher {self.teacher.script}"
        if not self._is_script:
            name = f"the teacher, a {'policy' if self.demonstrations is None else 'recording'}"
        if stage != self._stage and (self._has_stages or self._stage < 0):
            self._stage = stage
            self._imitated_until = -1
            self.agreement = 0.0
        self._is_able = bool(summary.success_rate) or not defines_success
        success = f"success {rate_text(summary.success_rate)}, " if defines_success else ""
        explores = (
            "; training episodes explore, so they may succeed much less often than evaluations"
            if self._is_able
            else ""
        )
        return (
            f"{name}: {success}mean return {number_text(summary.mean_return, 3)} in {len(episodes)}"
            f" episodes{explores}"
        )

    def plan(self, steps: int) -> Plan:
        """Return the plan for a fragment after `steps` timesteps."""
        plan = self._plan(steps)
        self.drives = plan.lesson is not None and plan.lesson.worlds > 0
        return plan

    def _plan(self, steps: int) -> Plan:
        if not self._is_able:
            return Plan()
        limit = self.teacher.share * self._total
        if not self._has_loss:
            limit *= _DEMONSTRATES_SHARE
        if self._imitated_until < 0 and steps >= limit:
            self._imitated_until = steps
        if not self._has_loss:
            return Plan(self._lesson(self._worlds)) if self.imitates else Plan()
        if self.imitates:
            driven = min(max(0.0, 1.0 - steps / max(1.0, _DRIVES_SHARE * limit)), 1.0 - self.agreement)
            return Plan(self._lesson(round(driven * self._worlds)), 1.0, True)
        weight = 1.0 - (steps - self._imitated_until) / (_FADE_SHARE * self._total)
        return Plan(self._lesson(0), weight) if weight > 0.0 else Plan()

    def _lesson(self, worlds: int) -> Lesson | None:
        return Lesson(self.teacher.script, worlds) if self._is_script else None

    def on_evaluation(self, summary: Summary, steps: int, *, defines_success: bool, is_solved: bool) -> None:
        """Called with the summary of each evaluation, and whether it meets `solved`."""
        if self._imitated_until >= 0 or self.score is None:
            return
        if defines_success:
            enough = (summary.success_rate or 0.0) >= ENOUGH * (self.score.success_rate or 0.0)
        else:
            target = self.score.mean_return
            enough = summary.mean_return >= target - (1.0 - ENOUGH) * abs(target)
        if enough or is_solved:
            self._imitated_until = steps

    def state(self) -> TeacherState:
        return TeacherState(
            stage=self._stage,
            imitated_until=self._imitated_until,
            drives=self.drives,
            agreement=self.agreement,
        )

    def restore(self, state: TeacherState) -> None:
        self._stage = state.stage
        self._imitated_until = state.imitated_until
        self.drives = state.drives
        self.agreement = state.agreement


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
        UsageError: They differ, the file cannot be read or is too long, it is of a case, or several agents
            act in it.
    """
    if not Path(path).exists():
        raise UsageError(
            f"there is no recording {path}; `deepbots play SCENARIO -o {shell_word(path)}` records one"
        )
    recording = Recording.read(Path(path))
    if case := recording.metadata.get("case"):
        raise UsageError(
            f"{path} cannot teach {program.name}: its episodes ran in the case '{case}', which is another"
            " task; record them without --case"
        )
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
            f"{path} cannot teach {program.name}: {count}; look at them with: deepbots replay {shell_word(path)}"
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


_FILES = (RECORD_NAME, RESOLVED_NAME)


class PolicyTeacher:
    """The policy of a run as a teacher of another training.

    The policy that learns drives, and the teacher only labels (DAgger; S. Ross, G. Gordon, D. Bagnell,
    AISTATS 2011). The teacher usually sees more than the policy that learns. What it sees must be in the
    observation of the training, or in its `critic`: then its observation consists of columns of that of the
    training.

    Args:
        teacher: The run and its model.
        program: The scenario of the training.

    Raises:
        UsageError: The policy has a memory, another action, or sees something that the training does not
            compute.
    """

    def __init__(self, teacher: ModelRef, program: Program) -> None:
        self._run = teacher.run
        self._columns = _columns(teacher, program)
        from deepbots_cli.learning.policy import loaded  # which imports the checkpoints, and so this module

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
        evaluation_worlds = EvaluationWorlds(build, self._run, engine=engine, batch=EVALUATION_EPISODES)
        # A player seeds the generators for each episode.
        with closing(evaluation_worlds) as worlds, random_numbers_kept():
            worlds.enter(program.with_critic)
            return worlds.play(self, seeds)


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
