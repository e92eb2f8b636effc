"""PPO of RSL-RL behind the interface of `learning.learner`.

The networks, the rollout storage, the returns and the update are those of the library. A fragment of the
collector takes the place of its runner, for four reasons: shards, exact resumes, evaluations between two
updates, and the observation at a time limit, whose value is added to the last reward. The runner of the
library does not get this observation, and adds the value of the one before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium import spaces
from torch import nn

from deepbots_cli.errors import MissingExtraError, RunError, UsageError
from deepbots_cli.learning import limits
from deepbots_cli.learning.checkpoint_files import Array
from deepbots_cli.learning.learner import ArrayLearner, Setup
from deepbots_cli.learning.rsl.internals import validation_kept
from deepbots_cli.learning.sb3.defaults import default_values
from deepbots_cli.learning.sb3.models import NOT_FINITE, overflow_explained
from deepbots_cli.learning.sb3.networks import PolicyNetwork
from deepbots_cli.program.task import Training
from deepbots_cli.rollout.collector import Decision, Fragment

try:
    from rsl_rl.algorithms import PPO
    from rsl_rl.models import MLPModel
    from rsl_rl.modules import EmpiricalDiscountedVariationNormalization
    from rsl_rl.storage import RolloutStorage
    from tensordict import TensorDict
except ModuleNotFoundError as error:
    raise MissingExtraError("rsl", "training with rsl_rl.PPO") from error

_GROUPS = {"actor": ["policy"], "critic": ["critic"]}
"""The group of observations that each network gets: the numbers of the policy, and all numbers."""
_ACTIVATIONS = {"leaky_relu": "lrelu", "silu": "swish"}
"""The activation functions to which RSL-RL gives another name."""
_DISTRIBUTION = ("init_std", "std_type", "learn_std")
"""The settings of the distribution of actions."""
_MAX_REWARD = 10.0
"""The largest absolute value of a normalized reward, as in Stable-Baselines3."""


class RslLearner(ArrayLearner):
    """PPO of RSL-RL; `algorithm` is the object of the library."""

    acts_from_weights: ClassVar[bool] = True

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        training = setup.training
        self.check(training)
        _check_spaces(training, setup.observation_space, setup.action_space)
        rows = setup.rows if setup.collector is None else setup.collector.rows
        settings: dict[str, Any] = default_values(
            replace(training, environments=rows), setup.total_timesteps, setup.longest_episode
        ) | {entry.name: entry.value for entry in training.hyperparameters}
        self.fragment_steps = settings.pop("num_steps_per_env")
        # Without worlds, the policy acts only, and needs no room for experience.
        # A policy that only acts leaves the random numbers of its process as they are.
        with torch.random.fork_rng(devices=[]), validation_kept():
            torch.manual_seed(setup.seed)
            self.algorithm = _algorithm(
                setup, settings, rows, self.fragment_steps if setup.collector is not None else 1
            )
        self._rate = np.array([self.algorithm.learning_rate], float)
        self._reward_scale: Any = None
        if setup.collector is not None:
            _check_batches(self.algorithm, rows * self.fragment_steps)
            torch.manual_seed(setup.seed)
            _fill_optimizer(self.algorithm.optimizer)
            if training.normalize is not None:
                self._reward_scale = EmpiricalDiscountedVariationNormalization([], gamma=self.algorithm.gamma)
                # RSL-RL begins with None, which has no shape for a checkpoint. The averages are the same.
                self._reward_scale.disc_avg.avg = torch.zeros(rows)

    @classmethod
    def check(cls, training: Training) -> None:
        limits.check_size(training.network.hidden)
        if not training.network.hidden:
            raise UsageError(f"{training.algorithm} needs a hidden layer; write `network: {{hidden: [64]}}`")
        if training.device == "cuda":
            raise UsageError(f"{training.algorithm} trains on the CPU; leave out `device` under `train`")

    # Acting

    @torch.no_grad()
    def act(self, observations: Any, starts: Array, masks: Array | None) -> Decision:
        actor = self.algorithm.actor
        means = _outputs(actor, self._own(_tensor(observations)))
        if not means.isfinite().all():
            raise RunError(NOT_FINITE)
        with overflow_explained():
            actor.distribution.update(means)
        actions = actor.distribution.sample()
        columns = {"action": actions, "log_probs": actor.distribution.log_prob(actions)}
        columns |= {_parameter(index): part for index, part in enumerate(actor.distribution.params)}
        return Decision(
            self._clipped(actions), {name: column.numpy(force=True) for name, column in columns.items()}
        )

    @torch.no_grad()
    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
        action_masks: Any = None,
    ) -> tuple[Any, Any]:
        """Return the mean of the distribution of actions, or an action that is drawn from it.

        Raises:
            RunError: An action is not finite, because the weights of the run are too large.
        """
        actor = self.algorithm.actor
        actions = _outputs(actor, self._own(_tensor(observation)))
        if not actions.isfinite().all():
            raise RunError(NOT_FINITE)
        if not deterministic:
            with overflow_explained():
                actor.distribution.update(actions)
            actions = actor.distribution.sample()
        return self._clipped(actions), None

    def _clipped(self, actions: torch.Tensor) -> Array:
        """Return actions in the range of the agent. The loss is that of the actions before."""
        space = self.setup.action_space
        assert isinstance(space, spaces.Box)
        return np.asarray(np.clip(actions.numpy(), space.low, space.high))

    def _own(self, observations: torch.Tensor) -> torch.Tensor:
        """Return the numbers that the policy sees, of observations of a training or of the policy alone."""
        columns = self.setup.policy_columns
        if columns is None or observations.shape[-1] == len(columns):
            return observations
        return observations[..., list(columns)]

    def _grouped(self, observations: torch.Tensor) -> TensorDict:
        return _grouped(self._own(observations), observations)

    # Learning

    def update(self) -> None:
        algorithm, fragment = self.algorithm, self.fragment
        with overflow_explained():
            self._store(fragment)
            losses = algorithm.update()
        self._rate[0] = algorithm.learning_rate
        record = self.log.record
        record("train/value_loss", losses["value"])
        record("train/policy_gradient_loss", losses["surrogate"])
        # The names and the sign are those of Stable-Baselines3, which the reports read.
        record("train/entropy_loss", -losses["entropy"])
        record("train/learning_rate", algorithm.learning_rate)
        record("train/std", float(algorithm.actor.output_std.detach().mean()))
        record("train/explained_variance", self._explained_variance())

    def _explained_variance(self) -> float:
        """Return the share of the variance of the returns that the values before the update explain; NaN
        without any variance."""
        storage = self.algorithm.storage
        variance = float(storage.returns.var())
        return 1.0 - float((storage.returns - storage.values).var()) / variance if variance else float("nan")

    @torch.no_grad()
    def _store(self, fragment: Fragment) -> None:
        """Put a fragment into the storage, with returns and advantages."""
        algorithm = self.algorithm
        storage = self.algorithm.storage
        observations = _tensor(fragment.observations)
        values = algorithm.critic(self._grouped(observations.flatten(0, 1))).reshape(
            *fragment.rewards.shape, 1
        )
        ends = np.stack([*fragment.starts[1:], fragment.following_starts])
        rewards = self._rewards(fragment, ends)
        columns = {name: _tensor(column) for name, column in fragment.columns.items()}
        parameters = [name for name in columns if name.startswith(_parameter(""))]
        for step in range(len(rewards)):
            transition = RolloutStorage.Transition()
            transition.observations = self._grouped(observations[step])
            transition.actions = columns["action"][step]
            transition.actions_log_prob = columns["log_probs"][step]
            transition.distribution_params = tuple(columns[name][step] for name in parameters)
            transition.values = values[step]
            transition.rewards = rewards[step]
            transition.dones = torch.from_numpy(ends[step])
            storage.add_transition(transition)
        algorithm.compute_returns(self._grouped(_tensor(fragment.following)))

    def _rewards(self, fragment: Fragment, ends: Array) -> torch.Tensor:
        """Return the rewards, normalized if the scenario sets this. At a time limit, the value of the state
        after it is added."""
        rewards = torch.from_numpy(fragment.rewards.copy())
        scale = self._reward_scale
        if scale is not None:
            for step, ended in enumerate(ends):
                rewards[step] = scale(rewards[step]).clamp(-_MAX_REWARD, _MAX_REWARD)
                scale.disc_avg.avg[torch.from_numpy(ended)] = 0.0  # the average of RSL-RL knows no episodes
        limits = [(step, ending) for step, ending in fragment.endings if ending.timed_out]
        if limits:
            last = _tensor(np.stack([ending.observation for _, ending in limits]))
            values = self.algorithm.critic(self._grouped(last)).flatten()
            cells = tuple(torch.tensor([(step, ending.row) for step, ending in limits]).T)
            rewards[cells] += self.algorithm.gamma * values
        return rewards

    def recent(self) -> tuple[Any, Array, Array | None]:
        columns = self.fragment.columns
        return self.fragment.observations, columns["action"], columns["log_probs"]

    # Arrays

    def weights(self) -> dict[str, Array]:
        parts: dict[str, nn.Module] = {"actor": self.algorithm.actor, "critic": self.algorithm.critic}
        return {
            f"{name}.{key}": tensor.detach().numpy()
            for name, part in parts.items()
            for key, tensor in part.state_dict().items()
        }

    def memory(self) -> dict[str, Array]:
        states = self.algorithm.optimizer.state
        arrays = {
            f"optimizer/{index}/{name}": tensor.numpy()
            for index, parameter in enumerate(self._parameters())
            for name, tensor in states[parameter].items()
        }
        if self._reward_scale is not None:
            arrays |= {
                f"rewards/{name}": tensor.numpy() for name, tensor in self._reward_scale.state_dict().items()
            }
            arrays["rewards/discounted"] = self._reward_scale.disc_avg.avg.numpy()
        return arrays | {"learning_rate": self._rate}

    def _parameters(self) -> list[nn.Parameter]:
        return [parameter for group in self.algorithm.optimizer.param_groups for parameter in group["params"]]

    def restore(self, saved_state: Any, arrays: Mapping[str, Array], *, same: bool) -> None:
        super().restore(saved_state, arrays, same=same)
        self.algorithm.learning_rate = float(self._rate[0])
        for group in self.algorithm.optimizer.param_groups:
            group["lr"] = self.algorithm.learning_rate

    # For explanations

    @torch.no_grad()
    def values(self, observations: Sequence[Any]) -> Array | None:
        if not observations or self.setup.policy_columns is not None:  # they lack what the critic sees
            return None
        values = self.algorithm.critic(self._grouped(_tensor(np.stack(observations))))
        return np.asarray(values.flatten().numpy(), float)

    def network(self) -> PolicyNetwork:
        actor = self.algorithm.actor
        first, *layers = actor.mlp
        if actor.obs_normalization:
            first = _normalizing(first, actor.obs_normalizer)
        return PolicyNetwork(
            extractors=None,
            pictures=frozenset(),
            transposed=frozenset(),
            memory=None,
            layers=nn.Sequential(first, *layers),
        )


def _check_spaces(training: Training, observations: spaces.Space[Any], actions: spaces.Space[Any]) -> None:
    """Check that the policy observes a vector of numbers and acts by ranges.

    Raises:
        UsageError: The spaces are others.
    """
    if not (isinstance(observations, spaces.Box) and len(observations.shape) == 1):
        raise UsageError(
            f"{training.algorithm} observes a vector of numbers, without images and goals; write"
            " `algorithm: PPO` or `algorithm: SAC`"
        )
    if not (isinstance(actions, spaces.Box) and len(actions.shape) == 1):
        raise UsageError(
            f"{training.algorithm} acts by ranges, such as `drive: -1 .. 1`; for choices, write"
            " `algorithm: PPO`"
        )


def _check_batches(algorithm: PPO, samples: int) -> None:
    """Check that each batch has at least two samples, whose advantages have a standard deviation.

    Raises:
        UsageError: The batches are smaller.
    """
    if samples < 2 * algorithm.num_mini_batches:
        raise UsageError(
            f"a rollout of {samples} steps cannot be divided into {algorithm.num_mini_batches} batches of two"
            " or more; raise `num_steps_per_env` or lower `num_mini_batches`"
        )


def _algorithm(setup: Setup, settings: dict[str, Any], rows: int, steps: int) -> PPO:
    """Create the algorithm with its networks, and a storage for so many steps of each row."""
    training = setup.training
    (width,) = setup.observation_space.shape or ()
    own_width = width if setup.policy_columns is None else len(setup.policy_columns)
    example = _grouped(torch.zeros(rows, own_width), torch.zeros(rows, width))
    (actions,) = setup.action_space.shape or ()
    networks = {
        "hidden_dims": list(training.network.hidden),
        "activation": _ACTIVATIONS.get(training.network.activation, training.network.activation),
        "obs_normalization": settings.pop("obs_normalization"),
    }
    distribution = {name: settings.pop(name) for name in _DISTRIBUTION}
    distribution["class_name"] = "GaussianDistribution"
    actor = MLPModel(example, _GROUPS, "actor", actions, distribution_cfg=distribution, **networks)
    critic = MLPModel(example, _GROUPS, "critic", 1, **networks)
    return PPO(actor, critic, RolloutStorage("rl", rows, steps, example, [actions]), **settings)


def _fill_optimizer(optimizer: torch.optim.Optimizer) -> None:
    """Create the state of an optimizer, which torch creates in the first step: for a checkpoint, whose arrays
    have the shapes of those of a training that has just begun.

    A step with a learning rate of 0 changes no weight, and every state of the optimizers begins with 0.
    """
    rates = [group["lr"] for group in optimizer.param_groups]
    for group in optimizer.param_groups:
        group["lr"] = 0.0
        for parameter in group["params"]:
            parameter.grad = torch.zeros_like(parameter)
    optimizer.step()
    optimizer.zero_grad()
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        group["lr"] = rate
    for state in optimizer.state.values():
        for tensor in state.values():
            tensor.zero_()


def _outputs(model: Any, observations: torch.Tensor) -> torch.Tensor:
    """Return the outputs of a network for rows of observations, without the dictionary that the library wraps
    them in."""
    outputs: torch.Tensor = model.mlp(model.obs_normalizer(observations))
    return outputs


def _normalizing(layer: nn.Linear, normalizer: Any) -> nn.Linear:
    """Return a layer with the normalization of its inputs as part of its weights."""
    scale = normalizer.std + normalizer.eps
    combined = nn.Linear(layer.in_features, layer.out_features)
    with torch.no_grad():
        # (W / s) x + b - (W / s) m = W (x - m) / s + b, where s of RSL-RL is std + eps.
        combined.weight.copy_(layer.weight / scale)
        combined.bias.copy_(layer.bias - combined.weight @ normalizer.mean)
    return combined


def _grouped(policy: torch.Tensor, critic: torch.Tensor) -> TensorDict:
    return TensorDict({"policy": policy, "critic": critic}, batch_size=critic.shape[:1])


def _tensor(array: Array) -> torch.Tensor:
    return torch.from_numpy(np.asarray(array, np.float32))


def _parameter(index: int | str) -> str:
    """Return the name of the column with a parameter of the distribution of actions."""
    return f"parameter/{index}"
