"""The layers of a policy, the values of its critic, policies whose critic sees more, and experience with its
mirror image.

Each sample of a rollout is learned from twice, as it was and mirrored, with the same advantage, return and
probability under the policy that acted (Mittal et al., "Symmetry Considerations for Learning Task Symmetric
Robot Policies", arXiv:2403.04359).

In the worlds of a training, the observation also has the values of the critic. The networks of the critic
take all of it, those of the policy only their own columns. An evaluation and an export see these columns
alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.torch_layers import (
    BaseFeaturesExtractor,
    CombinedExtractor,
    FlattenExtractor,
    NatureCNN,
)
from torch import nn

from deepbots_cli.errors import UsageError
from deepbots_cli.learning.sb3 import internals
from deepbots_cli.program.task import Mirror, Symmetry, Training
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.worlds import Array
from deepbots_cli.words import sentence_list


def mirrored_observations(symmetry: Symmetry, observations: Array) -> Array:
    """Return the mirror images of observations (..., numbers)."""
    return _mirrored(symmetry.observation, observations)


def mirrored_actions(symmetry: Symmetry, space: spaces.Space[Any], actions: Array) -> Array:
    """Return the mirror images of actions (..., numbers), of ranges or of the numbers of options."""
    if isinstance(space, spaces.Box):
        return _mirrored(symmetry.ranges, actions)
    images = np.empty_like(actions)
    for index, (source, options) in enumerate(zip(symmetry.choices, symmetry.options, strict=True)):
        images[..., index] = np.array(options)[actions[..., source].astype(int)]
    return images


def _mirrored(mirror: Mirror, values: Array) -> Array:
    factors, offsets = np.array(mirror.factors, values.dtype), np.array(mirror.offsets, values.dtype)
    images: Array = values[..., list(mirror.sources)] * factors + offsets
    return images


@contextmanager
def mirrored_experience(model: Any, symmetry: Symmetry) -> Iterator[None]:
    """Context in which the rollout buffer of a model has the mirror image of each sample, too.

    A batch is twice as large, so that an update takes as many steps as without mirror images.
    """
    buffer = model.rollout_buffer
    doubled_buffer = type(buffer)(
        buffer.buffer_size,
        buffer.observation_space,
        buffer.action_space,
        device=buffer.device,
        gae_lambda=buffer.gae_lambda,
        gamma=buffer.gamma,
        n_envs=2 * buffer.n_envs,
    )
    for name in ("rewards", "returns", "episode_starts", "values", "log_probs", "advantages"):
        getattr(doubled_buffer, name)[...] = np.tile(getattr(buffer, name), 2)
    doubled_buffer.observations[:, : buffer.n_envs] = buffer.observations
    doubled_buffer.observations[:, buffer.n_envs :] = mirrored_observations(symmetry, buffer.observations)
    doubled_buffer.actions[:, : buffer.n_envs] = buffer.actions
    doubled_buffer.actions[:, buffer.n_envs :] = mirrored_actions(
        symmetry, model.action_space, buffer.actions
    )
    # `get` of a rollout buffer asserts that it is full.
    doubled_buffer.pos = buffer.buffer_size
    doubled_buffer.full = True
    batch_size = getattr(model, "batch_size", None)
    model.rollout_buffer = doubled_buffer
    if batch_size is not None:
        model.batch_size = 2 * batch_size
    try:
        yield
    finally:
        model.rollout_buffer = buffer
        if batch_size is not None:
            model.batch_size = batch_size


def likeliest_actions(policy: Any, observations: Any) -> Array | None:
    """Return the likeliest actions for rows of observations, equal to the bit to those of `policy.predict`.

    `predict` sets the mode of every module, checks every observation and makes a distribution: 0.36 ms for 8
    rows, where this takes 0.05. Returns None for a policy that has more than layers over an array, and for an
    output that is not finite. The caller then calls `predict`, which reports it.
    """
    space = policy.action_space
    if not _is_layers(policy):
        return None
    is_rows = (
        isinstance(observations, np.ndarray)
        and observations.ndim == 2
        and observations.shape[1] == policy.pi_features_extractor.features_dim
    )
    if not is_rows:
        return None
    with torch.no_grad():
        logits = torch.from_numpy(observations).to(policy.action_net.weight.device, torch.float32)
        # `forward` alone: a call of a module looks for hooks, which a policy does not have.
        for layer in (*policy.mlp_extractor.policy_net, policy.action_net):
            logits = layer.forward(logits)
        if not np.isfinite(logits.cpu().numpy()).all():
            return None
        if isinstance(space, spaces.Box):
            return np.asarray(np.clip(logits.cpu().numpy(), space.low, space.high))
        # As `Categorical` does: rounding may make two probabilities equal whose logits are not.
        chances = nn.functional.softmax(logits - logits.logsumexp(-1, keepdim=True), -1)
        return np.asarray(chances.argmax(1).cpu().numpy())


def sampled_actions(
    policy: Any, observations: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor] | None:
    """Draw actions for rows of observations. Returns actions, values and log-probabilities, equal to the bit
    to those of `policy(observations)`.

    The random numbers are the same, too. A call of the policy makes modules and distributions ready: 0.32 ms
    for 8 rows, where this takes 0.17. Returns None for a policy that has more than layers over an array, and
    for an output that is not finite. The caller then calls the policy, which reports it.
    """
    if not _is_layers(policy) or observations.ndim != 2 or observations.dtype != torch.float32:
        return None
    layers, extractor = policy.mlp_extractor, policy.pi_features_extractor
    inputs = extractor.own(observations) if isinstance(extractor, PolicyColumns) else observations
    scores = policy.action_net(layers.policy_net(inputs))
    values = policy.value_net(layers.value_net(observations))
    if not scores.isfinite().all():
        return None
    if isinstance(policy.action_space, spaces.Discrete):  # as `Categorical` does
        logits = scores - scores.logsumexp(-1, keepdim=True)
        samples = torch.multinomial(nn.functional.softmax(logits, -1), 1, True)
        return samples.squeeze(-1), values, logits.gather(-1, samples).squeeze(-1)
    deviations = torch.ones_like(scores) * policy.log_std.exp()  # as `Normal` does
    actions = scores + torch.normal(torch.zeros_like(scores), torch.ones_like(scores)) * deviations
    log_probs = (
        -((actions - scores) ** 2) / (2 * deviations**2) - deviations.log() - math.log(math.sqrt(2 * math.pi))
    )
    return actions, values, log_probs.sum(dim=1)


def _is_layers(policy: Any) -> bool:
    """Return whether a policy consists only of layers over an array, for one choice or for ranges."""
    extractor = getattr(policy, "pi_features_extractor", None)
    # `asymmetric` makes the class from a mixin and, last, the class of the library.
    policy_class = type(policy).__bases__[-1] if isinstance(extractor, PolicyColumns) else type(policy)
    # A subclass may compute more than its layers, such as that of RecurrentPPO.
    if policy_class is not ActorCriticPolicy or type(policy_extractor(extractor)) is not FlattenExtractor:
        return False
    space = policy.action_space
    is_vector = isinstance(space, spaces.Box) and len(space.shape) == 1
    return (
        (is_vector or isinstance(space, spaces.Discrete)) and not policy.squash_output and not policy.use_sde
    )


class Family(Protocol):
    """How the policies of some algorithms are built.

    Attributes:
        name: The attribute of such a policy, and of no other one, with the network that chooses actions.
    """

    name: str

    def layers(self, policy: Any) -> tuple[Any, nn.Module]:
        """Return the extractor of the policy, and its layers up to the logits of choices or the values of
        ranges."""

    def values(self, policy: Any, inputs: Any) -> torch.Tensor:
        """Return the value of each row of observations: a column for each critic, shape (rows, critics).

        The value is V, or Q of the actions of the policy.
        """


class _OnPolicy:
    """PPO, A2C, MaskablePPO, RecurrentPPO."""

    name = "action_net"

    def layers(self, policy: Any) -> tuple[Any, nn.Module]:
        layers = nn.Sequential(policy.mlp_extractor.policy_net, policy.action_net)
        return policy.pi_features_extractor, layers

    def values(self, policy: Any, inputs: Any) -> torch.Tensor:
        values: torch.Tensor = policy.predict_values(inputs)
        return values


class _OfChoices:
    """DQN."""

    name = "q_net"

    def layers(self, policy: Any) -> tuple[Any, nn.Module]:
        return policy.q_net.features_extractor, policy.q_net.q_net

    def values(self, policy: Any, inputs: Any) -> torch.Tensor:
        values: torch.Tensor = policy.q_net(inputs).max(dim=1, keepdim=True).values
        return values


class _OfRanges:
    """SAC, TD3, DDPG, TQC."""

    name = "actor"

    def layers(self, policy: Any) -> tuple[Any, nn.Module]:
        actor = policy.actor
        if not hasattr(actor, "latent_pi"):  # TD3 and DDPG: the last layer of `mu` is a Tanh
            return actor.features_extractor, actor.mu
        return actor.features_extractor, nn.Sequential(actor.latent_pi, actor.mu, nn.Tanh())

    def values(self, policy: Any, inputs: Any) -> torch.Tensor:
        # Without `deterministic`, the actor of SAC and TQC would sample.
        predicted = policy.critic(inputs, policy(inputs, deterministic=True))
        # TQC has an array of quantiles (rows, critics, quantiles), others a tuple of columns.
        if isinstance(predicted, torch.Tensor):
            return predicted.mean(dim=2)
        return torch.cat(predicted, dim=1)


_FAMILIES: tuple[Family, ...] = (_OnPolicy(), _OfChoices(), _OfRanges())


def family_of(policy: Any) -> Family | None:
    """Return the family of a policy; None for one of another library, or of an unknown kind."""
    return next((family for family in _FAMILIES if hasattr(policy, family.name)), None)


@dataclass(frozen=True)
class PolicyNetwork:
    """The computation of a policy, as modules of torch.

    Attributes:
        extractors: The first layers of each part of an observation, by name; None if the parts enter the
            layers as they are.
        pictures: The parts that are divided by 255.
        transposed: The parts whose channels come first in the network.
        memory: The LSTM of a recurrent policy, after the extractors.
        layers: The layers up to the logits of choices or the values of ranges.
    """

    extractors: Mapping[str, nn.Module] | None
    pictures: frozenset[str]
    transposed: frozenset[str]
    memory: nn.LSTM | None
    layers: nn.Module


def policy_network(training: Training, policy: Any) -> PolicyNetwork:
    """Return the layers of the policy that an algorithm made.

    Raises:
        UsageError: The policy has no modules of torch, or is of no family.
    """
    if next(policy.parameters(), None) is None:
        raise UsageError(
            f"the policy of {training.algorithm} has no networks in torch, and cannot be exported"
        )
    family = family_of(policy)
    if family is None:
        raise UsageError(unknown_networks(policy, "cannot be exported"))
    extractor, layers = family.layers(policy)
    space: Any = extractor.space if isinstance(extractor, PolicyColumns) else policy.observation_space
    # An observation with several parts has an extractor for each of them.
    extractors = getattr(policy_extractor(extractor), "extractors", None)
    parts = space.spaces if extractors is not None else {"observation": space}
    images = frozenset(name for name, part in parts.items() if is_image_space(part))
    return PolicyNetwork(
        extractors=None
        if extractors is None
        else {name: _plain(module) for name, module in extractors.items()},
        pictures=images if policy.normalize_images else frozenset(),
        transposed=images,
        memory=getattr(policy, "lstm_actor", None),
        layers=layers,
    )


def unknown_networks(policy: Any, consequence: str) -> str:
    """Return a sentence about a policy without a family."""
    names = sentence_list([f"`{family.name}`" for family in _FAMILIES], "or")
    return f"the policy {type(policy).__name__} {consequence}: it has no network {names}"


def _plain(module: nn.Module) -> nn.Module:
    return nn.Sequential(module.cnn, module.linear) if isinstance(module, NatureCNN) else module


def critic_values(policy: Any, observations: Sequence[Any]) -> Array | None:
    """Return the critic's value of each observation: V, or Q of the action of the policy, the smaller one of
    two critics.

    The result is None for a policy of no family, or with a memory.
    """
    family = family_of(policy)
    if not observations or family is None or hasattr(policy, "lstm_actor"):
        return None
    with torch.no_grad():
        values = family.values(policy, _stacked(policy, observations)).min(dim=1).values
    return np.asarray(values.cpu().numpy(), float)


_PROBES = np.linspace(-1.0, 1.0, 10)


def probed_answers(policy: Any) -> Array | None:
    """Return the logits of choices less their mean, or the values of ranges, of norm 1 for each range, for
    observations of which one number is not zero, shape (numbers x 10, outputs). The order of the rows does
    not depend on that of the numbers. For other spaces than vectors, the result is None as for
    `critic_values`."""
    family = family_of(policy)
    space = policy.observation_space
    if family is None or hasattr(policy, "lstm_actor") or not isinstance(space, spaces.Box):
        return None
    extractor, layers = family.layers(policy)
    largest = np.where(np.isfinite(space.high), space.high, 1.0).ravel()
    observations = np.einsum("nm,p->nmp", np.diag(largest), _PROBES).swapaxes(1, 2)
    with torch.no_grad():
        tensor = policy.obs_to_tensor(observations.reshape(-1, *space.shape).astype(space.dtype))[0]
        answers = layers(policy.extract_features(tensor, extractor)).cpu().numpy().astype(float)
    if isinstance(policy.action_space, spaces.Box):
        answers /= np.maximum(np.linalg.norm(answers, axis=0), 1e-9)
    else:
        answers -= answers.mean(axis=1, keepdims=True)
    rows = answers.reshape(len(largest), -1)
    order = np.argsort(rows @ np.random.default_rng(0).normal(size=rows.shape[1]))
    return np.asarray(rows[order].reshape(answers.shape))


def _stacked(policy: Any, observations: Sequence[Any]) -> Any:
    """Return observations as the tensors that a policy takes."""
    parts = observations[0].keys() if isinstance(observations[0], dict) else None
    stacked = (
        {key: np.stack([observation[key] for observation in observations]) for key in parts}
        if parts
        else np.stack(observations)
    )
    return policy.obs_to_tensor(stacked)[0]


_NUMBERS = "observation"
"""The part of an observation with several parts that has the numbers."""


class PolicyColumns(BaseFeaturesExtractor):
    """The features extractor of a policy, which passes on only the columns of the policy, of an observation
    of shape (rows, numbers).

    Attributes:
        inner: The features extractor for an observation of the policy.
        space: The space of such an observation.
    """

    columns: torch.Tensor

    def __init__(self, space: gym.Space[Any], columns: Sequence[int]) -> None:
        inner_space = policy_space(space, columns)
        inner: BaseFeaturesExtractor
        inner = (
            CombinedExtractor(inner_space)
            if isinstance(inner_space, spaces.Dict)
            else FlattenExtractor(inner_space)
        )
        super().__init__(space, inner.features_dim)
        self.inner = inner
        self.space = inner_space
        # Not in the state dictionary: model files have weights only, and the scenario gives the columns.
        self.register_buffer("columns", torch.tensor(list(columns)), persistent=False)

    def forward(self, observations: Any) -> torch.Tensor:
        features: torch.Tensor = self.inner(self.own(observations))
        return features

    def own(self, observations: Any) -> Any:
        """Return the columns of the policy."""
        if not isinstance(observations, dict):
            return observations.index_select(-1, self.columns)
        parts = dict(observations)
        numbers = parts.pop(_NUMBERS)
        # A policy may see images alone. Its space then has no part for numbers.
        if len(self.columns):
            parts[_NUMBERS] = numbers.index_select(-1, self.columns)
        return parts


def policy_space(space: gym.Space[Any], columns: Sequence[int]) -> gym.Space[Any]:
    """Return the space of the observation of the policy, within that of a training."""
    numbers = space[_NUMBERS] if isinstance(space, spaces.Dict) else space
    assert isinstance(numbers, spaces.Box)
    box = spaces.Box(numbers.low[list(columns)], numbers.high[list(columns)], dtype=np.float32)
    if not isinstance(space, spaces.Dict):
        return box
    parts = {name: part for name, part in space.spaces.items() if name != _NUMBERS}
    return spaces.Dict(parts | {_NUMBERS: box} if columns else parts)


def widened(space: gym.Space[Any], columns: Sequence[int], observation: Any) -> Any:
    """Return an observation of the policy, or rows of them, in the space of a training; the values of the
    critic are 0. An observation that is in this space already stays as it is."""
    if isinstance(space, spaces.Dict):
        image = next(name for name in space.spaces if name != _NUMBERS)
        rows = observation[image].shape[: observation[image].ndim - len(space[image].shape or ())]
        numbers = observation.get(_NUMBERS, np.zeros((*rows, 0), np.float32))
        return {**observation, _NUMBERS: _padded(space[_NUMBERS], columns, numbers)}
    return _padded(space, columns, np.asarray(observation))


def _padded(space: gym.Space[Any], columns: Sequence[int], numbers: Array) -> Array:
    width = int((space.shape or (0,))[0])
    if numbers.shape[-1] == width:
        return numbers
    padded = np.zeros((*numbers.shape[:-1], width), np.float32)
    padded[..., list(columns)] = numbers
    return padded


class _OnPolicyMixin(internals.Layers):
    """A mixin for the policies of on-policy algorithms, with `columns` on the class."""

    columns: tuple[int, ...]

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        # A shared extractor would leave out the columns that only the critic sees.
        super().__init__(*arguments, **settings, share_features_extractor=False)  # type: ignore[call-arg]

    def make_layers(self: Any, build: Callable[[], None]) -> None:
        """Make layers of the policy for its columns, and layers of the critic for all."""
        # In the library, too, `features_extractor` is the one of the policy if none is shared.
        self.pi_features_extractor = self.features_extractor = PolicyColumns(
            self.observation_space, self.columns
        )
        # The library makes layers of policy and critic for one width: they are made for each width in turn.
        full_width, self.features_dim = self.features_dim, self.features_extractor.features_dim
        build()
        own_layers = self.mlp_extractor.policy_net
        self.features_dim = full_width
        build()
        self.mlp_extractor.policy_net = own_layers


class _Recurrent(_OnPolicyMixin):
    """A mixin for the policies of RecurrentPPO."""

    def __init__(self, space: Any, actions: Any, lr_schedule: Any, *arguments: Any, **settings: Any) -> None:
        super().__init__(space, actions, lr_schedule, *arguments, **settings)
        policy: Any = self
        size, layers = policy.lstm_actor.hidden_size, policy.lstm_actor.num_layers
        width = policy.pi_features_extractor.features_dim
        # The library makes this LSTM for the width of the critic, and an optimizer with its weights.
        policy.lstm_actor = nn.LSTM(width, size, num_layers=layers, **policy.lstm_kwargs).to(policy.device)
        policy.optimizer = policy.optimizer_class(
            policy.parameters(), lr=lr_schedule(1), **policy.optimizer_kwargs
        )

    def make_layers(self: Any, build: Callable[[], None]) -> None:
        """Make layers of the same size for both: they come after the LSTMs."""
        build()
        self.pi_features_extractor = self.features_extractor = PolicyColumns(
            self.observation_space, self.columns
        )


class _OffPolicy:
    """A mixin for the policies of off-policy algorithms, with `columns` on the class."""

    columns: tuple[int, ...]

    def make_actor(self: Any, features_extractor: Any = None) -> Any:
        """Return an actor that sees only its own columns."""
        return super().make_actor(PolicyColumns(self.observation_space, self.columns))  # type: ignore[misc]


def asymmetric(policy: type, columns: Sequence[int]) -> type:
    """Return the class of a policy whose critic sees all columns of an observation.

    Raises:
        TypeError: `policy` is not a policy class of Stable-Baselines3 or sb3-contrib with its own critic.
    """
    if hasattr(policy, "make_actor"):
        mixin: type = _OffPolicy
    elif internals.makes_layers(policy):
        mixin = _Recurrent if internals.has_memory(policy) else _OnPolicyMixin
    else:
        raise TypeError(f"{policy.__name__} has no critic of its own")
    return type(policy.__name__, (mixin, policy), {"columns": tuple(columns)})


def policy_extractor(extractor: Any) -> Any:
    """Return the features extractor for an observation of the policy."""
    return extractor.inner if isinstance(extractor, PolicyColumns) else extractor
