"""Policies whose critic sees more than they do: `critic` of a scenario.

In the worlds of a training, the observation also has the values of the critic. The networks of the critic
take all of it, those of the policy only their own columns. An evaluation and an export see these columns
alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import (
    BaseFeaturesExtractor,
    CombinedExtractor,
    FlattenExtractor,
)
from torch import nn

from deepbots_cli.learning.sb3 import internals
from deepbots_cli.rollout.worlds import Array

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


class _OnPolicy(internals.Layers):
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


class _Recurrent(_OnPolicy):
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
        mixin = _Recurrent if internals.has_memory(policy) else _OnPolicy
    else:
        raise TypeError(f"{policy.__name__} has no critic of its own")
    return type(policy.__name__, (mixin, policy), {"columns": tuple(columns)})


def policy_extractor(extractor: Any) -> Any:
    """Return the features extractor for an observation of the policy."""
    return extractor.inner if isinstance(extractor, PolicyColumns) else extractor
