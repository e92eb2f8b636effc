"""How on-policy algorithms imitate a teacher.

While the policy only imitates, `Lessons` keeps the states that it met, with what the teacher would do in each, and fits the policy to all
of them (DAgger; S. Ross, G. Gordon, D. Bagnell, AISTATS 2011). The update of the library then trains the critic alone.

After this, a loss is added to that of the library, within `imitating`. Its algorithms ask their policy for values, log-probabilities and
entropies of each batch (`evaluate_actions`), and add the entropies to the loss with a weight: these then contain the imitation loss too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from gymnasium import spaces

from deepbots_cli.rollout.worlds import Array

_MAX_BYTES = 200_000_000
_MAX_ROWS = 100_000
_BATCH_SIZE = 256
_STEPS_PER_ROW = 0.5
"""Gradient steps for each new state. On PandaPush with PPO, 0.5 gives 74 % success after 18,000 states."""
_LEARNING_RATE = 1e-3
_MAX_STD = 0.3
"""Largest standard deviation of actions while a policy imitates: with 1, where algorithms begin, it would leave its teacher at once."""
_AGREES = 0.2
"""Largest difference of each range in [-1, 1] at which a policy agrees with its teacher."""
_BETA = 0.2
"""Distance from the teacher at which the loss turns from quadratic to linear."""


class Lessons:
    """The last states, and the actions of the teacher in them. Its arrays are those of a replay buffer, of shape (steps, rows, ...).

    Args:
        model: The algorithm, whose rollout buffer has the shapes.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        model.rollout_buffer.reset()  # an update has reordered it
        seen = model.rollout_buffer.observations
        width = sum(part[0].nbytes for part in (seen.values() if isinstance(seen, dict) else [seen]))
        self.buffer_size = max(model.n_steps, min(_MAX_ROWS // model.n_envs, _MAX_BYTES // width))

        def empty(like: Array) -> Array:
            return np.zeros((self.buffer_size, *like.shape[1:]), like.dtype)

        self.observations = {key: empty(part) for key, part in seen.items()} if isinstance(seen, dict) else empty(seen)
        space = model.action_space
        self.actions = np.zeros((self.buffer_size, model.n_envs, *space.shape), space.dtype)
        self.pos = 0
        self.full = False

    def add(self, taught: Array) -> None:
        """Add the states of the rollout buffer; `taught` has shape (steps, rows, ...)."""
        rows = (self.pos + np.arange(len(taught))) % self.buffer_size
        seen = self._model.rollout_buffer.observations
        if isinstance(self.observations, dict):
            for key, part in self.observations.items():
                part[rows] = seen[key]
        else:
            self.observations[rows] = seen
        self.actions[rows] = taught
        self.full |= self.pos + len(taught) >= self.buffer_size
        self.pos = (self.pos + len(taught)) % self.buffer_size

    def fit(self, new: int) -> float:
        """Fit the policy after `new` states were added; the mean loss."""
        model, policy = self._model, self._model.policy
        size, width = self.buffer_size if self.full else self.pos, model.n_envs
        policy.set_training_mode(True)
        if isinstance(model.action_space, spaces.Box) and not model.use_sde:
            with torch.no_grad():
                policy.log_std.clamp_(max=math.log(_MAX_STD))
        for group in policy.optimizer.param_groups:  # the update of the library sets its own rate again
            group["lr"] = _LEARNING_RATE
        losses = []
        for _ in range(max(1, round(_STEPS_PER_ROW * new))):
            chosen = torch.randint(size * width, (_BATCH_SIZE,)).numpy()
            at = chosen // width, chosen % width
            seen = self.observations
            batch: Any = {key: part[at] for key, part in seen.items()} if isinstance(seen, dict) else seen[at]
            observations, _ = policy.obs_to_tensor(batch)
            taught = torch.as_tensor(self.actions[at], device=model.device)
            loss = _loss(model, policy.get_distribution(observations), taught).mean()
            policy.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]  # of the library
            policy.optimizer.step()
            losses.append(loss.item())
        return float(np.mean(losses))


@contextmanager
def only_imitating(model: Any, lessons: Lessons, taught: Array) -> Iterator[None]:
    """Within, the update of an on-policy algorithm trains the critic alone; afterwards, the policy is fitted to all lessons.

    Args:
        taught: What the teacher would do in the states of the rollout buffer, of shape (steps, rows, ...).
    """
    lessons.add(taught)  # before the update, which reorders the rollout buffer
    own = {name: getattr(model, name) for name in ("ent_coef", "target_kl") if hasattr(model, name)}
    model.rollout_buffer.advantages[...] = 0.0
    model.ent_coef = 0.0
    if "target_kl" in own:
        model.target_kl = None
    try:
        yield
    finally:
        for name, value in own.items():
            setattr(model, name, value)
    model.logger.record("teacher/loss", lessons.fit(taught.shape[0] * taught.shape[1]))


@contextmanager
def imitating(model: Any, taught: Array, weight: float) -> Iterator[None]:
    """Within, updates of an on-policy algorithm also imitate: `taught` are the actions of the teacher, of shape (steps, rows, ...)."""
    buffer, policy, ent_coef = model.rollout_buffer, model.policy, model.ent_coef
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
        return values, log_prob, ent_coef * entropy - weight * loss

    buffer._get_samples, policy.evaluate_actions, model.ent_coef = get_samples, evaluate_actions, 1.0
    try:
        yield
    finally:
        del buffer._get_samples, policy.evaluate_actions
        model.ent_coef = ent_coef
    model.logger.record("train/entropy_loss", float(np.mean(entropies)))
    model.logger.record("teacher/loss", float(np.mean(losses)))
    model.logger.record("teacher/weight", weight)


def agreement(model: Any, taught: Array) -> float:
    """The share of the states of the rollout buffer in which the policy, without exploration, does what the teacher would do."""
    seen = model.rollout_buffer.observations
    flat: Any = (
        {key: part.reshape(-1, *part.shape[2:]) for key, part in seen.items()}
        if isinstance(seen, dict)
        else seen.reshape(-1, *seen.shape[2:])
    )
    model.policy.set_training_mode(False)
    with torch.no_grad():
        found = model.policy.get_distribution(model.policy.obs_to_tensor(flat)[0]).mode().cpu().numpy()
    wanted = taught.reshape(found.shape)
    if isinstance(model.action_space, spaces.Box):
        same = np.abs(np.clip(found, -1.0, 1.0) - np.clip(wanted, -1.0, 1.0)) <= _AGREES
    else:
        same = found == wanted
    return float(same.reshape(len(same), -1).all(1).mean())


def _loss(model: Any, distribution: Any, taught: torch.Tensor) -> torch.Tensor:
    """Per row: the cross-entropy of choices, and in ranges the distance of the mean from the teacher.

    Where the teacher is at the end of a range, a mean beyond it is as good: the action is clipped. On PandaPush, this and a linear loss for
    large distances give 74 % success after 18,000 states, where a quadratic loss gives 44 %.
    """
    if isinstance(model.action_space, spaces.Box):
        mean = distribution.mode()
        taught = taught.clamp(-1.0, 1.0).to(mean.dtype)
        is_beyond = (taught >= 1.0) & (mean > taught) | (taught <= -1.0) & (mean < taught)
        found: torch.Tensor = torch.nn.functional.smooth_l1_loss(
            torch.where(is_beyond, taught, mean), taught, beta=_BETA, reduction="none"
        ).flatten(1)
        return found.sum(1)
    chosen: torch.Tensor = -distribution.log_prob(taught.long())
    return chosen
