"""Compares the predictions of the critic of an off-policy algorithm with the return that followed.

A critic that is trained on its own predictions may overestimate: its errors are chosen by a policy that
maximizes it (S. Fujimoto, H. van Hoof, D. Meger, ICML 2018). On FindBall, DDPG predicts 11.9 where 2.7
follow; with the smaller one of two critics, 9.1 are predicted and 9.2 follow.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3.common.preprocessing import get_action_dim

from deepbots_cli.learning.sb3.networks import Family, family_of, lowest
from deepbots_cli.rollout.worlds import Array

_SAMPLES = 256
"""The number of steps that are compared at a time, in one forward pass."""
_MIN_SAMPLES = 32
_WINDOW = 4_000
"""The largest number of compared rows of the replay buffer; a row has a step of each copy of the
environment."""
_UNKNOWN = 0.05
"""The largest weight of the rewards that are not known yet, or that a time limit cut off."""


class CriticCheck(NamedTuple):
    """Means over the same steps: `value` as the critic predicts it now, and `followed`, the discounted return
    since then.

    The rewards are those of the learner, with `normalize: reward` divided by their standard deviation. The
    policy that acted was a few thousand steps younger, and explored. The value of SAC and TQC includes the
    reward for entropy.
    """

    value: float
    followed: float


def check_critic(model: Any) -> CriticCheck | None:
    """Compare the newest steps in the replay buffer whose return is known; None while there are too few of
    them, and for a policy of no family.

    No random number is drawn, and nothing is changed.
    """
    family = family_of(model.policy)
    if family is None:
        return None
    buffer = model.replay_buffer
    # Three times the horizon leave 1 - exp(-2) of the steps with a known return.
    horizon = math.ceil(math.log(_UNKNOWN) / math.log(model.gamma)) if 0 < model.gamma < 1 else _WINDOW
    count = min(buffer.size(), _WINDOW, max(3 * horizon, _SAMPLES))
    rows = np.arange(buffer.pos - count, buffer.pos) % buffer.buffer_size
    rewards = buffer.rewards[rows].astype(float)
    if (normalizer := model.get_vec_normalize_env()) is not None:
        rewards = normalizer.normalize_reward(rewards)
    timeouts = getattr(buffer, "timeouts", None)
    followed, unknown = discounted_returns(
        rewards,
        buffer.dones[rows] > 0,
        np.zeros(rewards.shape, bool) if timeouts is None else timeouts[rows] > 0,
        model.gamma,
    )
    steps, copies = np.nonzero(unknown <= _UNKNOWN)
    if len(steps) < _MIN_SAMPLES:
        return None
    samples = np.linspace(0, len(steps) - 1, min(_SAMPLES, len(steps))).round().astype(int)
    steps, copies = steps[samples], copies[samples]
    cells = rows[steps], copies
    values = _values(family, model, buffer, cells)
    return CriticCheck(float(values.mean()), float(followed[steps, copies].mean()))


def discounted_returns(rewards: Array, dones: Array, timeouts: Array, gamma: float) -> tuple[Array, Array]:
    """Return the discounted return from each step (rows, copies), and the weight of the rewards that are
    missing in it."""
    followed = np.zeros(rewards.shape)
    unknown = np.ones(rewards.shape)
    later = np.zeros(rewards.shape[1])
    missing = np.ones(rewards.shape[1])
    for step in range(len(rewards) - 1, -1, -1):
        # In the library, `dones` includes time limits. The rewards that would follow them are missing.
        cut = dones[step] & timeouts[step]
        later = rewards[step] + gamma * np.where(dones[step], 0.0, later)
        missing = gamma * np.where(cut, 1.0, np.where(dones[step], 0.0, missing))
        followed[step], unknown[step] = later, missing
    return followed, unknown


def _values(family: Family, model: Any, buffer: Any, cells: tuple[Array, Array]) -> Array:
    """Return the critic's values of stored steps, the smaller one of two critics."""
    contents: Any = buffer.observations
    stored = (
        {key: part[cells] for key, part in contents.items()}
        if isinstance(contents, dict)
        else contents[cells]
    )
    # The columns behind the actions are labels of a teacher.
    actions = buffer.actions[cells][:, : get_action_dim(model.action_space)]
    with torch.no_grad():
        observations, _ = model.policy.obs_to_tensor(stored)
        columns = torch.as_tensor(actions, device=model.device)
        return lowest(family.values(model.policy, observations, columns))
