"""The learner of several agents that act in the same worlds: each agent has a learner of its own.

All of them act in each step. After a fragment, each learner gets its part of the experience, and learns from
it as if the other agents belonged to the world (independent learners; M. Tan, ICML 1993).
"""

from __future__ import annotations

import json
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, ClassVar

import gymnasium as gym
from pydantic import Field
from pydantic_core import to_jsonable_python

from deepbots_cli.errors import RunError, StorageError, UsageError
from deepbots_cli.files import atomic_write
from deepbots_cli.learning import learner as learners
from deepbots_cli.learning.callbacks import TrainingCallback
from deepbots_cli.learning.checkpoints import Array, CheckpointState
from deepbots_cli.learning.learner import Initialization, Learner, Setup
from deepbots_cli.learning.runs.run import DATA, data_of, opened_archive
from deepbots_cli.learning.sb3.logs import AgentLog
from deepbots_cli.program import Program
from deepbots_cli.program.task import Training
from deepbots_cli.rollout.collector import (
    MultiAgentActor,
    PolicyActor,
    SeatCollector,
    joined_actions,
    own_entries,
    own_name,
)
from deepbots_cli.rollout.worlds import WorldsStep
from deepbots_cli.runtime.agents import SeatLayout
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.scenario.training import ALGORITHMS

SHARED = ("total_timesteps", "environments", "shards", "device", "staleness", "turns")
"""The settings that agents that learn in the same worlds have in common."""


class MultiAgentState(CheckpointState):
    """The JSON part of a checkpoint; `learners` has that of each agent."""

    learners: Annotated[dict[str, dict[str, Any]], Field(max_length=64)]


class MultiAgentLearner(Learner):
    """The learners of several agents.

    Attributes:
        learners: The learner of each agent, by its name.
    """

    State: ClassVar[type[CheckpointState]] = MultiAgentState
    takes_callbacks = False

    def __init__(self, setup: Setup) -> None:
        assert setup.program is not None
        self.setup = setup
        self.steps = 0
        self.check(setup.training)
        if isinstance(setup.action_space, gym.spaces.Dict):
            raise UsageError(
                "agents with choices and agents with ranges cannot learn in the same worlds yet; train one"
                " of them: --agent NAME"
            )
        self._check_ends(setup)
        program = setup.program
        critic_program = setup.program.with_critic
        self._trainings = dict(setup.training.agents)
        self._policies = agents_by_policy(program, self._trainings)
        for names in self._policies.values():
            check_shared(self._trainings, names)
        self._policy_seats = {
            name: SeatLayout(member, program.agent) for name, member in program.members.items()
        }
        self._critic_seats = {
            name: SeatLayout(member, critic_program.agent) for name, member in critic_program.members.items()
        }
        self._collectors: dict[str, SeatCollector] = {}
        self.learners = self._create_learners()
        self._masked = [name for name, learner in self.learners.items() if learner.takes_masks]
        self.takes_masks = bool(self._masked)
        self.is_off_policy = any(learner.is_off_policy for learner in self.learners.values())
        if setup.collector is not None:
            self.fragment_steps = _common_steps(self._distinct_learners)

    def _create_learners(self) -> dict[str, Learner]:
        collector = self.setup.collector
        if collector is None:
            return {name: self._create(name, training, None) for name, training in self._trainings.items()}
        created: dict[str, Learner] = {}
        for first, names in self._policies.items():
            self._collectors[first] = self._seat_collector(names)
            created |= dict.fromkeys(
                names, self._create(first, self._trainings[first], self._collectors[first])
            )
        return {name: created[name] for name in self._trainings}

    def _seat_collector(self, agents: Sequence[str]) -> SeatCollector:
        """Return the collector of the agents with one policy."""
        return SeatCollector([self._critic_seats[name] for name in agents], self.setup.collector)

    def _create(self, agent: str, training: Training, collector: SeatCollector | None) -> Learner:
        """Return a learner for an agent."""
        setup = self.setup
        seat = self._critic_seats[agent]
        return learners.create(
            Setup(
                training,
                seat.observation_space,
                seat.action_space,
                derive_seed(setup.seed, agent),
                setup.total_timesteps,
                setup.longest_episode,
                collector,  # type: ignore[arg-type]  # checkpoints are of all agents
                rows=setup.rows,
                policy_columns=seat.member.program.agent.policy_columns,
            )
        )

    @property
    def _distinct_learners(self) -> Mapping[str, Learner]:
        """The learners that are updated, by agent. Agents that share a policy have one learner, under the
        name of the first."""
        if self.setup.collector is None:
            return self.learners
        return {first: self.learners[first] for first in self._policies}

    @classmethod
    def check(cls, training: Training) -> None:
        _, first = training.agents[0]
        for name, agent_training in training.agents:
            for key in SHARED:
                if getattr(agent_training, key) != getattr(first, key):
                    raise UsageError(
                        f"the agents have different `{key}` ({getattr(first, key)}, and"
                        f" {getattr(agent_training, key)} of `{name}`), but they learn in the same worlds;"
                        " write it under `train` at the top level, or train one of them: --agent NAME"
                    )
            if agent_training.teacher is not None:
                raise UsageError(
                    f"`{name}` has a teacher, which is not supported where several agents learn; remove"
                    f" `train.teacher`, or train it alone: --agent {name}"
                )
            learners.class_of(agent_training).check(agent_training)

    def _check_ends(self, setup: Setup) -> None:
        """Check that agents whose episode may end before that of others learn by an algorithm that supports
        it."""
        assert setup.program is not None
        for name, agent_training in setup.training.agents:
            alone = setup.program.members[name].alone
            is_recurrent = ALGORITHMS[agent_training.algorithm].is_recurrent
            if alone and (is_recurrent or not learners.class_of(agent_training).learns_from_parts):
                raise UsageError(
                    f"`{min(alone)}` ends the episode of `{name}` alone, which {agent_training.algorithm}"
                    " does not support; use PPO, A2C or MaskablePPO, or let the ending end the episode of all"
                    " agents"
                )

    @property
    def log(self) -> Any:
        return self._log

    @log.setter
    def log(self, log: Any) -> None:
        self._log = log
        for name, learner in self._distinct_learners.items():
            # The part of the log that learners use.
            learner.log = AgentLog(log, name, lambda: self.steps)  # type: ignore[assignment]

    # Acting and learning

    def begin(self, total: int, monitor: TrainingCallback, followers: Sequence[Any] = ()) -> None:
        self._monitor = monitor
        assert self.setup.program is not None
        members = self.setup.program.members
        for name, learner in self._distinct_learners.items():
            seat: Any = _SeatMonitor(members[name].program.defines_success)
            learner.begin(self._steps_of_learner(learner, total), seat)

    def _steps_of_learner(self, learner: Learner, steps: int) -> int:
        """Convert steps of all worlds into steps of a learner, which may have several rows per world."""
        collector = learner.setup.collector
        of_all = self.setup.collector
        assert collector is not None
        assert of_all is not None
        return steps * collector.rows // of_all.rows

    def start(self) -> None:
        for learner in self._distinct_learners.values():
            learner.start()

    def collect(self) -> bool:
        collector = self.setup.collector
        assert collector is not None

        def on_step(step: WorldsStep) -> bool:
            self.steps += len(step.ended)
            return self._monitor.on_step()

        actor = self.actor()
        actor.begin()
        fragment = collector.collect(actor, self.fragment_steps, on_step, with_masks=self.takes_masks)
        if fragment is None:
            return False
        self._last = fragment
        for name, learner in self._distinct_learners.items():
            self._collectors[name].offer(fragment)
            learner.collect()
        self._monitor.on_collected()
        return True

    def actor(self) -> PolicyActor:
        return MultiAgentActor(
            self._critic_seats,
            {name: learner.actor() for name, learner in self.learners.items()},
            self._masked,
        )

    def update(self) -> None:
        turns = self.setup.training.turns
        turn_learners = list(self._distinct_learners.values())
        if turns is not None:
            begun = self.steps - self.fragment_steps * self.setup.training.environments
            turn_learners = [turn_learners[begun // turns % len(turn_learners)]]
        for learner in turn_learners:
            learner.update()

    def end(self) -> None:
        for learner in self._distinct_learners.values():
            learner.end()
        self._monitor.on_end()

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
        action_masks: Any = None,
    ) -> tuple[Any, Any]:
        """See `Learner.predict`. Observations, actions and masks are those of all agents in a row, `state` is
        the memory of each agent by its name."""
        example = next(iter(observation.values())) if isinstance(observation, dict) else observation
        space = self.setup.observation_space
        example_space = next(iter(space.values())) if isinstance(space, gym.spaces.Dict) else space
        is_single = example.ndim == len(example_space.shape or ())
        actions = []
        states = {}
        for name, learner in self.learners.items():
            seat = self._policy_seats[name]
            masks = (
                action_masks[..., seat.masks] if name in self._masked and action_masks is not None else None
            )
            agent_actions, states[name] = learner.predict(
                seat.observation(observation),
                None if state is None else state[name],
                episode_start,
                deterministic,
                masks,
            )
            actions.append(agent_actions[None] if is_single else agent_actions)
        of_all = joined_actions(actions)
        return (of_all[0] if is_single else of_all), states

    def recent(self) -> tuple[Any, Array, Array | None]:
        return self._last.observations, self._last.actions, None

    def weights(self) -> dict[str, Array]:
        return {
            own_name(name, key): array
            for name, learner in self.learners.items()
            for key, array in learner.weights().items()
        }

    # Models

    def save(self, path: Path) -> None:
        """Write a model: a zip file with the model of each agent under its name."""
        with (
            tempfile.TemporaryDirectory() as folder,
            atomic_write(path, StorageError) as draft,
            zipfile.ZipFile(draft, "w", zipfile.ZIP_STORED) as archive,
        ):
            archive.writestr(DATA, json.dumps({"num_timesteps": self.steps, "agents": [*self.learners]}))
            for name, learner in self.learners.items():
                learner.save(Path(folder) / _member(name))
                archive.write(Path(folder) / _member(name), _member(name))

    def load(self, path: Path) -> None:
        for name, learner in self.learners.items():
            with own_model(path, name) as file:
                learner.load(file)

    def initialize(self, path: Path) -> Initialization:
        copied: list[str] = []
        not_copied: dict[str, str] = {}
        for name, learner in self.learners.items():
            with own_model(path, name) as file:
                initialization = learner.initialize(file)
            copied += [own_name(name, key) for key in initialization.copied]
            not_copied |= {own_name(name, key): reason for key, reason in initialization.not_copied.items()}
        return Initialization(tuple(copied), not_copied)

    # Checkpoints

    def attach(self, folder: Path) -> None:
        for name, learner in self._distinct_learners.items():
            learner.attach(folder / name)

    def state(self) -> dict[str, Any]:
        return {
            "learners": {
                name: to_jsonable_python(learner.state()) for name, learner in self._distinct_learners.items()
            }
        }

    def shared_files(self) -> Iterable[Path]:
        return chain.from_iterable(learner.shared_files() for learner in self._distinct_learners.values())

    def arrays(self) -> dict[str, Array]:
        return {
            _array_name(name, key): array
            for name, learner in self._distinct_learners.items()
            for key, array in learner.arrays().items()
        }

    def restore(self, saved_state: Any, arrays: Mapping[str, Array], *, same: bool) -> None:
        self.steps = saved_state.steps
        for name, learner in self._distinct_learners.items():
            learner.restore(
                self._own_state(saved_state, name, learner),
                own_entries(arrays, _array_name(name, "")[:-1]),
                same=same,
            )

    def _own_state(self, state: Any, name: str, learner: Learner) -> Any:
        """Return the state of a checkpoint as the learner of an agent has it.

        Raises:
            ValueError: The agent has no state, or a damaged one.
        """
        if name not in state.learners:
            raise ValueError(f"there is no state of the agent '{name}'")
        common = state.model_dump(mode="json", include=set(CheckpointState.model_fields))
        common["statistics"]["steps"] = self._steps_of_learner(learner, state.steps)
        return learner.State.model_validate_json(json.dumps({**common, **state.learners[name]}))


def _array_name(agent: str, name: str) -> str:
    """Return the name in a checkpoint of an array of an agent. The prefix keeps it apart from the arrays of
    the whole training."""
    return own_name(f"agents/{agent}", name)


def _member(agent: str) -> str:
    return f"{agent}.zip"


def has_agents(path: Path) -> bool:
    """Return whether a file is a model of several agents.

    Raises:
        RunError: The file is not a model.
    """
    return "agents" in data_of(path)


@contextmanager
def own_model(path: Path, agent: str) -> Iterator[Path]:
    """Context with the file of the model of one agent, from that of all agents.

    Raises:
        RunError: The file is missing, damaged, or has no model of the agent.
    """
    if not path.is_file():
        raise RunError(f"{path} is missing; `deepbots resume RUN` continues a training without a model")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / _member(agent)
        try:
            with opened_archive(path, path.stat().st_size) as archive:
                target.write_bytes(archive.read(_member(agent)))
        except Exception as error:  # reading a damaged file raises a dozen kinds of exceptions
            raise RunError(f"{path} has no model of the agent '{agent}'") from error
        try:
            yield target
        except RunError as error:
            renamed = RunError(str(error).replace(f"{folder}/", f"{path}, "))
            for note in getattr(error, "__notes__", ()):
                renamed.add_note(note)
            raise renamed from error


def agents_by_policy(program: Program, trainings: Mapping[str, Training]) -> dict[str, list[str]]:
    """Return the agents that have each policy, by the first of them."""
    first, training = next(iter(trainings.items()))
    agents: dict[str, list[str]] = {}
    for name, member in program.members.items():
        policy = member.policy or name if training.self_play is None else first
        agents.setdefault(policy, []).append(name)
    return agents


def check_shared(
    trainings: Mapping[str, Training],
    agents: Sequence[str],
    sharing: str = "a policy that several agents share",
) -> None:
    """Check that agents with one policy learn it in the same way, by an algorithm that supports `sharing`."""
    first = trainings[agents[0]]
    model = ALGORITHMS[first.algorithm]
    if len(agents) > 1 and (not model.on_policy or model.is_recurrent):
        raise UsageError(f"{first.algorithm} does not support {sharing}; use PPO")
    if any(replace(trainings[name], agents=()) != first for name in agents):
        raise UsageError(
            f"agents that share a policy must have the same `train`; write it at the top level, or for"
            f" `{agents[0]}`"
        )


def _common_steps(learners: Mapping[str, Learner]) -> int:
    """Return how many steps each learner collects between two updates."""
    steps = {name: learner.fragment_steps for name, learner in learners.items()}
    if len(set(steps.values())) > 1:
        step_counts = ", ".join(f"{number} of `{name}`" for name, number in steps.items())
        raise UsageError(
            "agents that learn in the same worlds must collect the same number of steps between two updates,"
            f" not {step_counts}; write `n_steps` (`train_freq` of SAC, TD3 and DQN) for each of them"
        )
    return next(iter(steps.values()))


class _SeatMonitor:
    """The monitor of the learner of one agent. The monitor of the training counts the steps of all agents."""

    def __init__(self, defines_success: bool) -> None:
        self.defines_success = defines_success
        self.active = SimpleNamespace(statistics=SimpleNamespace(mean_return=None, success_rate=None))

    def on_step(self) -> bool:
        return True

    def on_collected(self) -> None:
        """Do nothing: the training counts fragments of all agents."""

    def on_end(self) -> None:
        """Do nothing: the training ends for all agents."""
