"""The networks of a policy of Stable-Baselines3, by its family: for evaluations, an export, shards, and the
values of its critic."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.torch_layers import FlattenExtractor, NatureCNN
from torch import nn

from deepbots_cli.errors import UsageError
from deepbots_cli.learning.sb3.asymmetric import PolicyColumns, policy_extractor
from deepbots_cli.program.task import Training
from deepbots_cli.rollout.worlds import Array
from deepbots_cli.words import sentence_list


def likeliest_actions(policy: Any, observations: Any) -> Array | None:
    """Return the likeliest actions for rows of observations, equal to the bit to those of `policy.predict`.

    `predict` sets the mode of every module, checks every observation and makes a distribution: 0.36 ms for 8
    rows, where this takes 0.07. Returns None for a policy that has more than layers over an array, and for an
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
        inputs = torch.from_numpy(observations).to(policy.action_net.weight.device, torch.float32)
        logits = policy.action_net(policy.mlp_extractor.policy_net(inputs))
        if not logits.isfinite().all():
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
    parts = observations[0].keys() if isinstance(observations[0], dict) else None
    stacked = (
        {key: np.stack([observation[key] for observation in observations]) for key in parts}
        if parts
        else np.stack(observations)
    )
    with torch.no_grad():
        inputs, _ = policy.obs_to_tensor(stacked)
        values = family.values(policy, inputs).min(dim=1).values
    return np.asarray(values.cpu().numpy(), float)
