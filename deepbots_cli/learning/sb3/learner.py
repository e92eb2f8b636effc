"""The learners of the built-in algorithms: Stable-Baselines3 and sb3-contrib behind the interface of
`learning.learner`.

On-policy algorithms take fragments of a collector (`rollouts.py`). Off-policy algorithms step the worlds by
their own `collect_rollouts`, which draws noise, stores steps and counts episodes in ways of its own; a
fragment is what they collect between two updates. So do algorithms of other packages that have a
`collect_rollouts` of their own. With shards, the fragment is fetched first, and `collect_rollouts` then steps
through it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.preprocessing import get_action_dim
from stable_baselines3.common.type_aliases import RolloutReturn
from stable_baselines3.common.vec_env import VecNormalize
from stable_baselines3.her import HerReplayBuffer

from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.callbacks import TrainingCallback
from deepbots_cli.learning.checkpoints import Array
from deepbots_cli.learning.learner import Initialization, Learner, Setup
from deepbots_cli.learning.sb3 import algorithms, internals, models, networks, rollouts
from deepbots_cli.learning.sb3.algorithms import DivergenceRate
from deepbots_cli.learning.sb3.imitation import (
    Lessons,
    agreement,
    imitating,
    imitating_labels,
    keep_labels,
    labeled,
    mix_in,
    only_imitating,
)
from deepbots_cli.learning.sb3.logs import encoded, number_of
from deepbots_cli.learning.sb3.networks import mirrored_experience, widened
from deepbots_cli.learning.sb3.rollouts import CollectorEnvironment, spaces_only, with_library_infos
from deepbots_cli.learning.teaching import Demonstrations, Plan
from deepbots_cli.program.task import Training
from deepbots_cli.rollout.collector import (
    Decision,
    FetchingCollector,
    Fragment,
    LocalCollector,
    PolicyActor,
)
from deepbots_cli.rollout.worlds import WorldsStep

AGREEMENT_STEPS = 64
"""The number of steps of each copy of the environment after which an off-policy algorithm measures the
agreement with a teacher."""
SCALAR_WINDOW_STEPS = 256
"""The number of steps of each copy of the environment that the scalars of an off-policy algorithm
describe."""


class SavesPlainly:
    """A mixin for an algorithm."""

    def save(self, path: str | Path, *_: Any, **__: Any) -> None:
        """Write the model as a run keeps it, for a callback: Stable-Baselines3 would also pickle the
        worlds."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        path = path if path.suffix else path.with_suffix(".zip")
        models.save(path, self)  # type: ignore[arg-type]  # of the algorithm


class StableLearner(Learner):
    """An algorithm of Stable-Baselines3; `model` is the algorithm itself."""

    State = models.StableState
    actor_kind: type[rollouts.RolloutActor | rollouts.ExplorationActor] = rollouts.RolloutActor
    mixin = SavesPlainly

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.check(setup.training)
        self._collector = collector = setup.collector
        rows = setup.rows if collector is None else collector.rows
        env: Any = spaces_only(setup.observation_space, setup.action_space, rows)
        if isinstance(collector, LocalCollector | FetchingCollector):
            env = CollectorEnvironment(collector)
        if collector is not None and setup.training.normalize is not None:
            # 0.99 is the default of every algorithm of the library.
            gamma: Any = next((h.value for h in setup.training.hyperparameters if h.name == "gamma"), 0.99)
            # Only rewards are normalized: observations already lie in [-1, 1].
            env = VecNormalize(env, norm_obs=False, gamma=gamma)
        self.model: Any = algorithms.create(
            setup.training,
            env,
            seed=setup.seed,
            total_timesteps=setup.total_timesteps,
            longest_episode=setup.longest_episode,
            to_learn=setup.collector is not None,
            mixin=self.mixin,
            policy_columns=setup.policy_columns,
        )
        self.takes_masks = algorithms.takes_masks(self.model)
        self._takes_fragments = not self.is_off_policy and algorithms.collects_as_usual(
            setup.training, self.model
        )
        self._demonstrations = self._prepared(setup.demonstrations)
        self._actor = self.actor_kind(self.model)
        if isinstance(collector, FetchingCollector):
            self.actor()
        elif not (self._takes_fragments or collector is None or isinstance(collector, LocalCollector)):
            raise UsageError(f"{setup.training.algorithm} needs its worlds in the training process")
        self._followers: Sequence[BaseCallback] = ()
        self._plan = Plan()
        if collector is None:
            self.model.policy.set_training_mode(False)

    @classmethod
    def check(cls, training: Training) -> None:
        algorithms.check(training)

    @property
    def steps(self) -> int:  # type: ignore[override]  # the algorithm counts
        return int(self.model.num_timesteps)

    @property
    def fragment_steps(self) -> int:  # type: ignore[override]  # a hyperparameter of the algorithm
        return int(self.model.train_freq.frequency if self.is_off_policy else self.model.n_steps)

    # Acting and learning

    def begin(self, total: int, monitor: TrainingCallback, followers: Sequence[Any] = ()) -> None:
        self.model.set_logger(self.log)
        self._followers = followers
        callbacks = [_MonitorCallback(monitor), *followers]
        self._total, self._callback = internals.begin_learning(
            self.model, total, callbacks if followers else callbacks[0]
        )
        self._log_interval = signature(type(self.model).learn).parameters["log_interval"].default

    def start(self) -> None:
        self._callback.on_training_start(
            {"self": self.model, "total_timesteps": self._total, "callback": self._callback}, {}
        )

    def actor(self) -> PolicyActor:
        if not algorithms.collects_as_usual(self.setup.training, self.model):
            raise UsageError(
                f"{self.setup.training.algorithm} collects experience in a way of its own, which shards do"
                " not support"
            )
        return self._actor

    def _measure_agreement(self, observations: Any, teacher_actions: Array) -> None:
        self.agreement = agreement(self.model, observations, teacher_actions)
        self.model.logger.record("teacher/agreement", self.agreement)

    def _prepared(self, demonstrations: Demonstrations | None) -> Demonstrations | None:
        """Return demonstrations in the format of the policy, with the channels of images first."""
        if demonstrations is None:
            return None
        observations, following = (
            rollouts.prepared(self.model, part)
            for part in (demonstrations.observations, demonstrations.following)
        )
        return replace(demonstrations, observations=observations, following=following)

    def end(self) -> None:
        self._callback.on_training_end()

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
        action_masks: Any = None,
    ) -> tuple[Any, Any]:
        """Return the action that the algorithm chooses.

        Raises:
            RunError: An action is not finite, because the weights of the run are too large.
        """
        actions = (
            networks.likeliest_actions(self.model.policy, observation)
            if deterministic and action_masks is None
            else None
        )
        if actions is not None:
            return actions, None
        if self.setup.policy_columns is not None:
            observation = widened(self.model.observation_space, self.setup.policy_columns, observation)
        masks = {} if action_masks is None else {"action_masks": action_masks}
        with models.overflow_explained():
            actions, state = self.model.predict(
                observation, state=state, episode_start=episode_start, deterministic=deterministic, **masks
            )
            if not np.isfinite(actions).all():
                raise RunError(models.NOT_FINITE)
        return actions, state

    # Numbers

    def weights(self) -> dict[str, Array]:
        return {
            name: tensor.detach().cpu().numpy() for name, tensor in self.model.policy.state_dict().items()
        }

    def save(self, path: Path) -> None:
        models.save(path, self.model)

    def load(self, path: Path) -> None:
        models.load(path, self.model)

    def initialize(self, path: Path) -> Initialization:
        return models.initialize(path, self.model)

    # Checkpoints

    def attach(self, folder: Path) -> None:
        self._replay = models.ReplayFiles(folder / "replay")

    def state(self) -> dict[str, Any]:
        model, buffer = self.model, self._buffer
        if buffer is not None:
            self._replay.append(buffer, self.steps // model.n_envs)
        return {
            "counts": {
                name: getattr(model, name) for name in get_args(internals.Counter) if hasattr(model, name)
            },
            "infos": [
                models.EpisodeInfo(r=encoded(info["r"]), l=encoded(info["l"]))
                for info in model.ep_info_buffer or ()
            ],
            "successes": [bool(success) for success in model.ep_success_buffer or ()],
            "action_space": model.action_space.np_random.bit_generator.state,
            "segments": self._replay.segments,
            "replay": (0 if buffer is None else buffer.buffer_size, self._replay.offset),
        }

    def shared_files(self) -> Iterable[Path]:
        return self._replay.paths()

    def arrays(self) -> dict[str, Array]:
        model = self.model
        drifts = enumerate(noise.drift for noise in self._actor.noises)
        arrays: dict[str, Array] = {f"noise/{index}": drift for index, drift in drifts if drift is not None}
        arrays |= {f"lstm/{index}": tensor.cpu().numpy() for index, tensor in enumerate(self._memory)}
        if (normalizer := model.get_vec_normalize_env()) is not None:
            statistics = normalizer.ret_rms
            arrays |= {
                "returns": normalizer.returns,
                "return_statistics": np.array([statistics.mean, statistics.var, statistics.count]),
            }
        if isinstance(buffer := self._buffer, HerReplayBuffer):
            arrays["episode_starts"] = internals.episode_starts(buffer)
        return arrays

    def restore(self, saved_state: Any, arrays: Mapping[str, Array], *, same: bool) -> None:
        model = self.model
        for counter, value in saved_state.counts.items():
            setattr(model, counter, type(getattr(model, counter))(value))
        model.ep_info_buffer.extend(
            {"r": number_of(info.r), "l": number_of(info.l)} for info in saved_state.infos
        )
        model.ep_success_buffer.extend(saved_state.successes)
        internals.continue_training(model, model.env.unwrapped.collector.starts)
        for index, tensor in enumerate(self._memory):
            tensor.copy_(torch.from_numpy(arrays[f"lstm/{index}"]))
        for index, noise in enumerate(self._actor.noises):
            noise.drift = arrays.get(f"noise/{index}")
        if (normalizer := model.get_vec_normalize_env()) is not None:
            mean, var, count = arrays["return_statistics"]
            if var < 0 or count <= 0:
                raise ValueError("the statistics of the returns are impossible")
            normalizer.ret_rms.mean = mean
            normalizer.ret_rms.var = var
            normalizer.ret_rms.count = float(count)
            # After `continue_training`, whose reset sets the returns to 0.
            normalizer.returns = arrays["returns"]
        model.action_space.np_random.bit_generator.state = saved_state.action_space.model_dump()
        if self._buffer is not None:
            starts = arrays.get("episode_starts") if same else None
            self._replay.refill(
                self._buffer, saved_state, self.steps // model.n_envs, starts, model.action_space
            )

    @property
    def _buffer(self) -> Any:
        """The store of earlier fragments: a replay buffer, lessons, or nothing (None)."""
        return self.model.replay_buffer

    @property
    def _memory(self) -> list[torch.Tensor]:
        """The state of a recurrent policy between two steps."""
        states = internals.memory(self.model)
        return [] if states is None else [*states.pi, *states.vf]

    @property
    def device(self) -> str:  # type: ignore[override]
        return str(self.model.device.type)

    # For explanations

    def values(self, observations: Any) -> Array | None:
        if self.setup.policy_columns is not None:  # the observations lack what the critic sees
            return None
        return networks.critic_values(self.model.policy, observations)

    def network(self) -> networks.PolicyNetwork:
        return networks.policy_network(self.setup.training, self.model.policy)


class OnPolicyLearner(StableLearner):
    """The learner of PPO, A2C, MaskablePPO and RecurrentPPO, which learn from the experience of the present
    policy."""

    learns_from_parts = True

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._demonstration_lessons = (
            None if self._demonstrations is None else Lessons(self.model, self._demonstrations)
        )
        self._teacher_actions: Array | None = None
        self._participation: Array | None = None
        self._lessons: Lessons | None = None
        rate = self.model.learning_rate
        self._adaptive_rate = rate if isinstance(rate, DivergenceRate) else None

    def be_taught(self, plan: Plan) -> None:
        if not self._takes_fragments or self._memory:
            super().be_taught(plan)
        self._plan = plan
        if self._demonstration_lessons is None and plan.only != (self._lessons is not None):
            self._lessons = Lessons(self.model) if plan.only else None
            self._replay.forget(self.steps // self.model.n_envs)

    def collect(self) -> bool:
        model, collector = self.model, self._collector
        with models.overflow_explained():
            if collector is None or not self._takes_fragments:
                return bool(
                    model.collect_rollouts(
                        model.env,
                        self._callback,
                        model.rollout_buffer,
                        n_rollout_steps=model.n_steps,
                    )
                )
            self._actor.begin()
            self._callback.on_rollout_start()
            fragment = collector.collect(
                self._actor,
                model.n_steps,
                self._on_step,
                with_masks=self.takes_masks,
                lesson=self._plan.lesson,
            )
            if fragment is None:
                return False
            rollouts.fill(model, fragment)
            self._participation = fragment.taking_part
            self._teacher_actions = fragment.columns.get("taught")
            if self.setup.teacher is not None and self._plan.weight:
                self._teacher_actions = self.setup.teacher.actions(fragment.observations)
        self._callback.on_rollout_end()
        return True

    def _on_step(self, step: WorldsStep) -> bool:
        model = self.model
        model.num_timesteps += len(step.ended)
        if self._followers:
            observations, rewards, dones, infos = with_library_infos(step)
            self._callback.update_locals(
                {"new_obs": observations, "rewards": rewards, "dones": dones, "infos": infos}
            )
        # The order of `collect_rollouts`: the callback comes before the statistics of ended episodes.
        if not self._callback.on_step():
            return False
        for ending in step.endings:
            model.ep_info_buffer.append({"r": ending.episode.total_return, "l": ending.episode.length})
            model.ep_success_buffer.append(ending.episode.is_success)
        return True

    def update(self) -> None:
        model = self.model
        with models.overflow_explained():
            internals.update_progress(model, self._total)
            # As in the loop of `OnPolicyAlgorithm.learn`, which this replaces.
            count = model.num_timesteps // (model.n_steps * model.n_envs)
            if count % self._log_interval == 0:
                model.dump_logs(count)
            if self._participation is None or self._participation.any():
                with self._imitation(), self._samples():
                    model.train()
        divergence = model.logger.name_to_value.get("train/approx_kl")
        if self._adaptive_rate is not None and divergence is not None:
            self._adaptive_rate.follow(divergence)

    def _samples(self) -> AbstractContextManager[None]:
        """Return the context in which the algorithm learns from the steps in which the agent took part."""
        buffer = self.model.rollout_buffer
        if self._participation is None:
            return nullcontext()
        images = buffer.n_envs // self.model.n_envs  # with mirror images, the buffer has twice as many rows
        return internals.samples_chosen(buffer, np.tile(self._participation, images))

    def _imitation(self) -> AbstractContextManager[None]:
        """Return the context of an update: with a teacher, or with mirror images."""
        model, plan = self.model, self._plan
        if (symmetry := self.setup.training.symmetry) is not None:
            return mirrored_experience(model, symmetry)
        if self._demonstration_lessons is not None:
            if plan.only:
                return only_imitating(model, self._demonstration_lessons, None)
            return (
                imitating(model, self._demonstration_lessons, plan.weight) if plan.weight else nullcontext()
            )
        if self._teacher_actions is None:
            return nullcontext()
        if self._lessons is not None:
            self._measure_agreement(model.rollout_buffer.observations, self._teacher_actions)
            return only_imitating(model, self._lessons, self._teacher_actions)
        return imitating(model, self._teacher_actions, plan.weight)

    def recent(self) -> tuple[Any, Array, Array | None]:
        """Return the experience of the last rollout."""
        buffer = self.model.rollout_buffer
        return buffer.observations, buffer.actions, buffer.log_probs

    def state(self) -> dict[str, Any]:
        rate = self._adaptive_rate
        return super().state() | {"learning_rate": None if rate is None else rate.rate}

    def restore(self, saved_state: Any, arrays: Mapping[str, Array], *, same: bool) -> None:
        if self._adaptive_rate is not None and saved_state.learning_rate is not None:
            self._adaptive_rate.rate = saved_state.learning_rate
        is_taught = self.setup.training.teacher is not None or self.setup.teacher is not None
        if self._takes_fragments and is_taught and saved_state.replay[0]:
            # Before the base class restores, which refills the lessons as its `_buffer`.
            self._lessons = Lessons(self.model)
        super().restore(saved_state, arrays, same=same)

    @property
    def _buffer(self) -> Lessons | None:
        return self._lessons


class _Explorer(internals.Explorer, SavesPlainly):
    """An algorithm whose shards have acted already, or whose teacher drives some of the worlds.

    Attributes:
        recorded: The fragment of the shards, through which it steps; None without shards.
        teach: Returns a decision after the teacher replaced some of it; None without a lesson.
        keeps_labels: Whether the replay buffer keeps the actions of a teacher.
    """

    recorded: Fragment | None = None
    teach: Callable[[Decision], Decision] | None = None
    keeps_labels = False
    _repeated = 0

    def explored(self, draw: Callable[[], tuple[Array, Array]]) -> tuple[Array, Array]:
        if self.recorded is not None:
            step = self._repeated % len(self.recorded.actions)
            self._repeated += 1
            decision = Decision(
                self.recorded.actions[step],
                {name: column[step] for name, column in self.recorded.columns.items()},
            )
        else:
            actions, stored = draw()
            decision = Decision(actions, {"stored": stored})
            decision = decision if self.teach is None else self.teach(decision)
        stored = decision.columns["stored"]
        if self.keeps_labels:
            stored = labeled(stored, decision.columns.get("taught"))
        return decision.actions, stored


class OffPolicyLearner(StableLearner):
    """The learner of DQN, SAC, TD3, DDPG and TQC, which learn from a replay buffer."""

    is_off_policy = True
    actor_kind = rollouts.ExplorationActor
    mixin = _Explorer

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        is_taught = setup.training.teacher is not None or setup.demonstrations is not None
        if is_taught and setup.collector is not None and hasattr(self.model, "actor"):
            keep_labels(self.model)
            self.model.keeps_labels = True
        if self._demonstrations is not None:
            mix_in(self.model, self._demonstrations)

    def be_taught(self, plan: Plan) -> None:
        self._plan = plan
        if isinstance(self._collector, LocalCollector):
            self.model.teach = plan.lesson and partial(self._collector.taught, lesson=plan.lesson)

    def collect(self) -> bool:
        model = self.model
        fetching = self._collector if isinstance(self._collector, FetchingCollector) else None
        with models.overflow_explained():
            if fetching is not None:
                model.recorded = fetching.fetch(
                    self._actor, model.train_freq.frequency, lesson=self._plan.lesson
                )
                memory = self._actor.memory()
            self._rollout: RolloutReturn = model.collect_rollouts(
                model.env,
                train_freq=model.train_freq,
                action_noise=model.action_noise,
                callback=self._callback,
                learning_starts=model.learning_starts,
                replay_buffer=model.replay_buffer,
                log_interval=self._log_interval,
            )
            # At the end of an episode, the library has reset the noise of the next one.
            if fetching is not None:
                model.recorded = None  # the model draws the actions of the next fragment
                self._actor.remember(memory)
                fetching.ask_ahead(self._actor, model.train_freq.frequency)
            return bool(self._rollout.continue_training)

    def update(self) -> None:
        model = self.model
        # As in the loop of `OffPolicyAlgorithm.learn`, which this replaces.
        steps = model.gradient_steps if model.gradient_steps >= 0 else self._rollout.episode_timesteps
        if model.num_timesteps > model.learning_starts and steps > 0:
            with models.overflow_explained(), self._imitation():
                model.train(batch_size=model.batch_size, gradient_steps=steps)

    def _imitation(self) -> AbstractContextManager[None]:
        """Return the context of an update with a teacher."""
        model, plan = self.model, self._plan
        if not model.keeps_labels:
            return nullcontext()
        new = self._rollout.episode_timesteps
        period = AGREEMENT_STEPS * model.n_envs
        if (
            plan.only
            and self.steps // period > (self.steps - new) // period
            and self.setup.demonstrations is None
        ):
            columns = self._recent_rows(model.replay_buffer.actions)
            self._measure_agreement(self.recent()[0], columns[..., get_action_dim(model.action_space) :])
        return imitating_labels(model, plan.weight, only=plan.only, new=new) if plan.weight else nullcontext()

    def recent(self) -> tuple[Any, Array, Array | None]:
        """Return the newest experience of the replay buffer."""
        stored = self.model.replay_buffer.observations
        rows = self._recent_rows
        width = get_action_dim(self.model.action_space)
        observations = (
            {key: rows(part) for key, part in stored.items()} if isinstance(stored, dict) else rows(stored)
        )
        return observations, rows(self.model.replay_buffer.actions)[..., :width], None

    def _recent_rows(self, column: Array) -> Array:
        """Return the last rows of a column of the replay buffer."""
        buffer = self._buffer
        rows = (
            np.arange(buffer.pos - min(SCALAR_WINDOW_STEPS, buffer.size()), buffer.pos) % buffer.buffer_size
        )
        recent: Array = column[rows]
        return recent


class _MonitorCallback(BaseCallback):
    """Passes the calls of Stable-Baselines3 on to the monitor of the training."""

    def __init__(self, monitor: TrainingCallback) -> None:
        super().__init__()
        self._monitor = monitor

    def _on_training_start(self) -> None:
        if not self._monitor.defines_success:
            # Otherwise TensorBoard would show a success rate of 0 beside any return.
            self.model.ep_success_buffer = deque(maxlen=0)

    def _on_step(self) -> bool:
        return self._monitor.on_step()

    def _on_rollout_end(self) -> None:
        self._monitor.on_collected()

    def _on_training_end(self) -> None:
        self._monitor.on_end()
