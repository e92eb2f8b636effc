"""Imitation of a teacher by on-policy algorithms: a loss that is added to that of the library.

The algorithms of the library ask their policy for values, log-probabilities and entropies of each batch (`evaluate_actions`), and add the
entropies to the loss with a weight. Within `imitating`, these entropies contain the imitation loss too, so the update of the library learns
both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from gymnasium import spaces

from deepbots_cli.learning.teacher import Plan
from deepbots_cli.rollout.worlds import Array


@contextmanager
def imitating(model: Any, taught: Array, plan: Plan) -> Iterator[None]:
    """Within, updates of an on-policy algorithm also imitate: `taught` are the actions of the teacher, of shape (steps, rows, ...)."""
    buffer, policy = model.rollout_buffer, model.policy
    own = {name: getattr(model, name) for name in ("ent_coef", "max_grad_norm", "target_kl") if hasattr(model, name)}
    ent_coef = model.ent_coef
    shape = (-1, *taught.shape[2:])
    labels = torch.as_tensor(np.ascontiguousarray(taught.swapaxes(0, 1)).reshape(shape), device=model.device)
    samples, evaluate = buffer._get_samples, policy.evaluate_actions
    batch: list[torch.Tensor] = []
    losses: list[float] = []
    entropies: list[float] = []

    def get_samples(indices: Array, *rest: Any) -> Any:
        batch[:] = [labels[indices]]
        return samples(indices, *rest)

    def evaluate_actions(observations: Any, actions: torch.Tensor, **options: Any) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        values, log_prob, entropy = evaluate(observations, actions, **options)
        if entropy is None:
            entropy = -log_prob
        loss = _loss(model, policy.get_distribution(observations, **options), batch[0])
        losses.append(float(loss.detach().mean()))
        entropies.append(-float(entropy.detach().mean()))
        return values, log_prob, ent_coef * entropy - plan.weight * loss

    buffer._get_samples, policy.evaluate_actions, model.ent_coef = get_samples, evaluate_actions, 1.0
    if plan.only:
        buffer.advantages[...] = 0.0
        if "target_kl" in own:
            model.target_kl = None
        model.max_grad_norm = math.inf  # or the loss of the critic, which grows with the returns, would leave the actor little of the norm
    try:
        yield
    finally:
        del buffer._get_samples, policy.evaluate_actions
        for name, value in own.items():
            setattr(model, name, value)
    model.logger.record("train/entropy_loss", float(np.mean(entropies)))
    model.logger.record("teacher/loss", float(np.mean(losses)))
    model.logger.record("teacher/weight", plan.weight)


def _loss(model: Any, distribution: Any, taught: torch.Tensor) -> torch.Tensor:
    """Per row: the cross-entropy of choices, and the squared distance of the mean from the teacher in ranges."""
    if isinstance(model.action_space, spaces.Box):
        mean = distribution.mode()
        loss: torch.Tensor = ((mean - taught.clamp(-1.0, 1.0).to(mean.dtype)) ** 2).flatten(1).sum(1)
        return loss
    found: torch.Tensor = -distribution.log_prob(taught.long())
    return found
