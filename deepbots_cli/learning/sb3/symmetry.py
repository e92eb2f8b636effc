"""Experience and its mirror image: data augmentation for tasks with a symmetry.

Each sample of a rollout is learned from twice, as it was and mirrored, with the same advantage, return and
probability under the policy that acted (Mittal et al., "Symmetry Considerations for Learning Task Symmetric
Robot Policies", arXiv:2403.04359).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from gymnasium import spaces

from deepbots_cli.program.task import Mirror, Symmetry
from deepbots_cli.rollout.worlds import Array

_COPIED = ("rewards", "returns", "episode_starts", "values", "log_probs", "advantages")


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
    for name in _COPIED:
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
