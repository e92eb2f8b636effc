"""The interface between a training and an algorithm.

A training calls `collect` of its `Learner` for a fragment of experience, then `update`, and between the two
it reads the state from which a resumed training continues bit for bit. An evaluation calls `predict`.
`learning/sb3` has the learner of the built-in algorithms. An algorithm of another package, whose model is
derived from `scenario.training.Training` itself, needs its own learner: a class derived from `ArrayLearner`
or `Learner`, under the `import_path` of its model.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from deepbots_cli.errors import RunError, StorageError, UsageError
from deepbots_cli.files import atomic_write
from deepbots_cli.learning.checkpoints import (
    Array,
    CheckpointState,
    check_alike,
    read_arrays,
    write_arrays,
)
from deepbots_cli.plugins import import_attribute
from deepbots_cli.program import Program
from deepbots_cli.program.task import Training
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.collector import Collector, Decision, Fragment, PolicyActor, ShardedCollector
from deepbots_cli.rollout.worlds import WorldsStep
from deepbots_cli.scenario.training import ALGORITHMS

if TYPE_CHECKING:
    import gymnasium as gym

    from deepbots_cli.learning.callbacks import TrainingCallback
    from deepbots_cli.learning.runs.run import PoolGames, Rating
    from deepbots_cli.learning.sb3.logs import TrainingLog
    from deepbots_cli.learning.teaching import Demonstrations, Plan, PolicyTeacher

# By whether the algorithm is on-policy; imported when it is used.
_SB3_LEARNERS = {
    True: "deepbots_cli.learning.sb3.learner:OnPolicyLearner",
    False: "deepbots_cli.learning.sb3.learner:OffPolicyLearner",
}
# By whether agents share a policy that plays against itself.
_MULTI_AGENT_LEARNERS = {
    False: "deepbots_cli.learning.multi_agent:MultiAgentLearner",
    True: "deepbots_cli.learning.self_play:SelfPlayLearner",
}


@dataclass(frozen=True)
class Setup:
    """Arguments of a learner.

    `longest_episode` is in steps, `collector` is None for a policy that does not learn but acts in `rows`,
    and `demonstrations` come from a recording that teaches. `policy_columns` are the places of the numbers
    that the policy sees, where an observation has further ones that only a critic may see; None if the policy
    sees all. An evaluation calls `predict` with these numbers alone. `teacher` is a policy that teaches.
    `program` is that of the scenario, which a learner of several agents needs.
    """

    training: Training
    observation_space: gym.Space[Any]
    action_space: gym.Space[Any]
    seed: int = 0
    total_timesteps: int = 1
    longest_episode: int = 1
    collector: Collector | None = None
    rows: int = 1
    demonstrations: Demonstrations | None = None
    policy_columns: tuple[int, ...] | None = None
    teacher: PolicyTeacher | None = None
    program: Program | None = None


@dataclass(frozen=True)
class Initialization:
    """The tensors of a policy that were copied from another model; `not_copied` has the reason for each of
    the others."""

    copied: tuple[str, ...]
    not_copied: Mapping[str, str]


class Learner(ABC):
    """An algorithm with its policy.

    A training calls `begin`, restores a checkpoint if there is one, and calls `start`. It then calls
    `collect` and `update` in turn, and finally `end`.

    Attributes:
        setup: The arguments that it was created with.
        fragment_steps: The steps of each row between two updates.
        ratings: The ratings of a policy that plays against past versions of itself.
        pool_games: The recent games of such a policy against each version in its pool.
        steps: Timesteps, summed over all rows.
        log: The log for scalars.
        device: Device of the policy, by the name that torch uses.
    """

    State: ClassVar[type[CheckpointState]] = CheckpointState
    """The part of a checkpoint that is JSON."""
    takes_masks = False
    """Whether `predict` uses action masks."""
    takes_callbacks = True
    """Whether the learner calls the `followers` of `begin`."""
    learns_from_parts = False
    """Whether it leaves out the steps in which one of several agents does not take part."""
    is_off_policy = False
    """Whether the learner has a replay buffer, so that a step of the training takes much longer than one of
    an evaluation."""
    device = "cpu"
    ratings: Sequence[Rating] = ()
    pool_games: Sequence[PoolGames] = ()
    fragment_steps: int
    setup: Setup
    steps: int
    log: TrainingLog

    @abstractmethod
    def __init__(self, setup: Setup) -> None: ...

    @classmethod
    def check(cls, training: Training) -> None:
        """Check the settings as far as they do not depend on the world.

        Raises:
            UsageError: The settings are invalid.
        """
        if training.normalize is not None:
            raise UsageError(
                f"{training.algorithm} does not normalize rewards; leave out 'normalize' under 'train'"
            )

    @abstractmethod
    def begin(self, total: int, monitor: TrainingCallback, followers: Sequence[Any] = ()) -> None:
        """Prepare for training up to `total` steps.

        Args:
            total: Timesteps, summed over all rows.
            monitor: Call its `on_step` after each step of all rows (it returns whether to continue), its
                `on_collected` after each fragment, before the update, and its `on_end` after the last update.
            followers: The callbacks of other packages.
        """

    def start(self) -> None:  # noqa: B027  # most learners do nothing here
        """Called before the first fragment of this process."""

    @abstractmethod
    def collect(self) -> bool:
        """Collect the next fragment; False if the monitor of the training stopped it before."""

    agreement: float | None = None
    """The share of the states of the last fragment in which the policy agrees with its teacher; None before
    an update that imitates."""

    def be_taught(self, plan: Plan) -> None:
        """Called before each fragment of a training with a teacher.

        Raises:
            UsageError: The algorithm cannot learn from a teacher.
        """
        raise UsageError(
            f"{self.setup.training.algorithm} cannot learn from a teacher; leave out `teacher` under `train`"
        )

    def actor(self) -> PolicyActor:
        """Return the acting policy; shards have copies of it.

        Raises:
            UsageError: The algorithm does not support shards.
        """
        raise UsageError(
            f"{self.setup.training.algorithm} does not support shards; leave out `shards` under `train`"
        )

    @abstractmethod
    def update(self) -> None:
        """Learn from the last fragment."""

    @abstractmethod
    def end(self) -> None:
        """Called after the last update."""

    @abstractmethod
    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
        action_masks: Any = None,
    ) -> tuple[Any, Any]:
        """Return the actions for an observation, or for rows of them, and the memory of a recurrent policy
        after it."""

    @abstractmethod
    def recent(self) -> tuple[Any, Array, Array | None]:
        """Return recent observations and actions, rows last but one, and the log-probabilities of the actions
        if they are known."""

    @abstractmethod
    def weights(self) -> dict[str, Array]:
        """Return the arrays of the policy."""

    def digest(self) -> str:
        """Return the SHA-256 over names, shapes and bytes of the weights, which is equal for equal policies
        only."""
        total = hashlib.sha256()
        for name, array in sorted(self.weights().items()):
            # With type and shape, because different arrays may have the same bytes.
            total.update(f"policy/{name} {array.dtype.str} {array.shape}\n".encode())
            total.update(array.tobytes())
        return total.hexdigest()

    def not_finite(self) -> str | None:
        """Return the name of the first array of the policy that contains infinite or NaN values."""
        return next((name for name, array in self.weights().items() if not np.isfinite(array).all()), None)

    # Models

    @abstractmethod
    def save(self, path: Path) -> None:
        """Write a model: a zip file, in which `data` is JSON with the number of steps as `num_timesteps`.

        Raises:
            RunError: The file cannot be written.
        """

    @abstractmethod
    def load(self, path: Path) -> None:
        """Take over a model from its file.

        Raises:
            RunError: The file is missing, damaged, or of another policy.
        """

    def initialize(self, path: Path) -> Initialization:
        """Begin with the weights of another model.

        Raises:
            RunError: The file is missing or damaged.
            UsageError: The learner cannot do this, or nothing fits.
        """
        raise UsageError(f"{self.setup.training.algorithm} does not support --initialize-from; leave it out")

    # Checkpoints

    def attach(self, folder: Path) -> None:
        """Called before the first checkpoint, with the folder of the checkpoints."""
        self.checkpoint_folder = folder

    def state(self) -> dict[str, Any]:
        """Return the fields of `State` that `CheckpointState` does not have."""
        return {}

    def shared_files(self) -> Iterable[Path]:
        """Files in the folder of the checkpoints that the present one needs beside its own."""
        return ()

    @abstractmethod
    def arrays(self) -> dict[str, Array]:
        """Return the arrays of a checkpoint beside the model."""

    @abstractmethod
    def restore(self, saved_state: Any, arrays: Mapping[str, Array], *, same: bool) -> None:
        """Continue from a checkpoint, after `load`, in restored worlds; `same` is true if their observations
        are the same as before."""

    # For explanations

    def values(self, observations: Sequence[Any]) -> Array | None:
        """Return the critic's value of each observation; None without a critic."""
        return None

    def network(self) -> Any:
        """Return the layers of the policy, for an export (`learning.sb3.networks.PolicyNetwork`).

        Raises:
            UsageError: The policy cannot be exported.
        """
        raise UsageError(f"policies of {self.setup.training.algorithm} cannot be exported")


class ArrayLearner(Learner):
    """A learner whose state consists of arrays that it changes in place. Models and checkpoints store these
    arrays without further code.

    A subclass defines `act`, `update`, `predict` and `weights`, and `memory` if the next update depends on
    further arrays. If `act` depends on nothing but `weights` and the global random generators, the subclass
    sets `acts_from_weights`, and shards can have copies of the policy.

    Attributes:
        fragment: The experience of the last `collect`.
    """

    fragment_steps = 64
    takes_callbacks = False
    acts_from_weights: ClassVar[bool] = False
    """Whether the actions depend on `weights` and on the global generators of random numbers only."""
    fragment: Fragment

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.steps = 0

    @abstractmethod
    def act(self, observations: Any, starts: Array, masks: Array | None) -> Decision:
        """Return actions to learn from, one per row. `starts` is true in rows in which an episode begins."""

    def memory(self) -> dict[str, Array]:
        """Return further arrays, besides `weights`, on which the next update depends."""
        return {}

    def begin(self, total: int, monitor: TrainingCallback, followers: Sequence[Any] = ()) -> None:
        self._monitor = monitor

    def collect(self) -> bool:
        collector = self.setup.collector
        if collector is None:
            raise RuntimeError("a learner without worlds cannot collect")

        def on_step(step: WorldsStep) -> bool:
            self.steps += len(step.ended)
            return self._monitor.on_step()

        actor = self.actor() if isinstance(collector, ShardedCollector) else self.act
        fragment = collector.collect(actor, self.fragment_steps, on_step, with_masks=self.takes_masks)
        if fragment is None:
            return False
        self.fragment = fragment
        self._monitor.on_collected()
        statistics = self._monitor.active.statistics
        if statistics.mean_return is not None:
            self.log.record("rollout/ep_rew_mean", statistics.mean_return)
        if self._monitor.defines_success and statistics.success_rate is not None:
            self.log.record("rollout/success_rate", statistics.success_rate)
        self.log.dump(self.steps)
        return True

    def actor(self) -> PolicyActor:
        return _ArrayActor(self) if self.acts_from_weights else super().actor()

    def end(self) -> None:
        self._monitor.on_end()

    def recent(self) -> tuple[Any, Array, Array | None]:
        return self.fragment.observations, self.fragment.actions, None

    def save(self, path: Path) -> None:
        with atomic_write(path, StorageError) as draft:
            write_arrays(draft, self.weights(), data=json.dumps({"num_timesteps": self.steps}))

    def load(self, path: Path) -> None:
        arrays = read_arrays(path)
        try:
            check_alike(arrays, self.weights())
        except ValueError as error:
            raise RunError(f"{path} is damaged ({error})") from error
        _overwrite(self.weights(), arrays)

    def arrays(self) -> dict[str, Array]:
        return self.memory()

    def restore(self, saved_state: Any, arrays: Mapping[str, Array], *, same: bool) -> None:
        self.steps = saved_state.steps
        _overwrite(self.memory(), arrays)


class _ArrayActor(PolicyActor):
    """The actor of an `ArrayLearner` whose actions depend on its weights only."""

    def __init__(self, learner: ArrayLearner) -> None:
        self._learner = learner

    def __call__(self, observations: Any, starts: Array, masks: Array | None) -> Decision:
        return self._learner.act(observations, starts, masks)

    def parameters(self) -> Mapping[str, Any]:
        return self._learner.weights()

    def load(self, parameters: Mapping[str, Any]) -> None:
        _overwrite(self._learner.weights(), parameters)


def class_of(training: Training) -> type[Learner]:
    """Return the learner class of the algorithm that the scenario names.

    Raises:
        UsageError: The class of another package cannot be imported, or is not a learner.
    """
    if training.agents:
        has_self_play = any(agent_training.self_play is not None for _, agent_training in training.agents)
        learner: type[Learner] = import_attribute(_MULTI_AGENT_LEARNERS[has_self_play])
        return learner
    model = ALGORITHMS.get(training.algorithm)
    if model is None or model.is_derived():
        stable: type[Learner] = import_attribute(_SB3_LEARNERS[model is None or model.on_policy])
        return stable
    try:
        learner_class = import_attribute(model.import_path)
    except (ImportError, AttributeError) as error:
        raise UsageError(
            f"the learner of {training.algorithm} ({model.import_path}) cannot be imported: {error}"
        ) from error
    if not (isinstance(learner_class, type) and issubclass(learner_class, Learner)):
        raise UsageError(
            f"{model.import_path}, the learner of {training.algorithm}, is not derived from"
            " deepbots_cli.learning.learner.Learner"
        )
    return learner_class


def create(setup: Setup) -> Learner:
    """Create a learner that has learned nothing yet.

    Raises:
        UsageError: The algorithm is unknown, or refuses the settings or the spaces.
        MissingExtraError: The algorithm is of a package that is not installed.
    """
    return class_of(setup.training)(setup)


def _overwrite(arrays: Mapping[str, Array], values: Mapping[str, Array]) -> None:
    for name, array in arrays.items():
        array[...] = values[name]
