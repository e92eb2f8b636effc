"""Imitation of a teacher by a policy.

With an on-policy algorithm, while the policy only imitates, `Lessons` keeps the visited states with the
teacher's action in each, and fits the policy to all of them (DAgger; S. Ross, G. Gordon, D. Bagnell, AISTATS
2011). The update of the library then trains the critic alone.

After this, a loss is added to that of the library, within `imitating`. Its algorithms read from their policy
values, log-probabilities and entropies of each batch (`evaluate_actions`), and add the entropies to the loss
with a weight: these then contain the imitation loss too.

With an off-policy algorithm that has an actor, the replay buffer keeps the teacher's action beside each
action (`keep_labels`). The loss of the actor is the negative value of its actions; within `imitating_labels`,
an imitation loss is subtracted from these values (TD3+BC; S. Fujimoto, S. S. Gu, NeurIPS 2021). While the
policy only imitates, the actor follows this loss alone, and the critic learns its value.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.her import HerReplayBuffer

from deepbots_cli.learning.sb3 import internals
from deepbots_cli.learning.teaching import Demonstrations
from deepbots_cli.rollout.worlds import Array

_MAX_BYTES = 200_000_000
_MAX_ROWS = 100_000
_BATCH_SIZE = 256
_STEPS_PER_ROW = 0.5
"""Gradient steps for each new state. On PandaPush with PPO, 0.5 gives 74 % success after 18,000 states."""
_LEARNING_RATE = 1e-3
_MAX_STD = 0.3
"""Largest standard deviation of actions while a policy imitates: with 1, where algorithms begin, it would
leave its teacher at once."""
_AGREES = 0.2
"""Largest difference of each range in [-1, 1] at which a policy agrees with its teacher."""
_FORBIDDEN_LOSS = 1e6
_BETA = 0.2
"""Distance from the teacher at which the loss turns from quadratic to linear."""
_SCALE = 1.0
"""Weight of the imitation loss beside the values of a critic, relative to their mean absolute value."""
_DEMONSTRATED_SHARE = 0.25
"""Share of each batch of a replay buffer that is drawn from demonstrations."""
_UNKNOWN = 2.0
"""A label in a replay buffer where there is none; actions are in [-1, 1]."""
_ONLY_SCALE = 10.0
"""Weight of the imitation loss of an actor that only imitates; SAC adds its entropy to it."""


class Lessons:
    """The last states, and the actions of the teacher in them. The arrays are those of a replay buffer, of
    shape (steps, rows, ...).

    Args:
        model: The algorithm, whose rollout buffer has the shapes.
        demonstrations: The demonstrations of a recording, if it is the teacher. Then its states are the only
            ones.
    """

    def __init__(self, model: Any, demonstrations: Demonstrations | None = None) -> None:
        self._model = model
        if demonstrations is not None:
            demonstrated = demonstrations.observations
            self.observations: Any = (
                {key: part[:, None] for key, part in demonstrated.items()}
                if isinstance(demonstrated, dict)
                else demonstrated[:, None]
            )
            self.actions = demonstrations.actions[:, None]
            self.buffer_size = len(self.actions)
            self.pos = 0
            self.full = True
            return
        model.rollout_buffer.reset()  # an update has reordered it
        observations = model.rollout_buffer.observations
        width = sum(
            part[0].nbytes
            for part in (observations.values() if isinstance(observations, dict) else [observations])
        )
        # At least the steps of a rollout, because `add` writes a whole rollout at once.
        self.buffer_size = max(model.n_steps, min(_MAX_ROWS // model.n_envs, _MAX_BYTES // width))

        def empty(array: Array) -> Array:
            return np.zeros((self.buffer_size, *array.shape[1:]), array.dtype)

        self.observations = (
            {key: empty(part) for key, part in observations.items()}
            if isinstance(observations, dict)
            else empty(observations)
        )
        space = model.action_space
        self.actions = np.zeros((self.buffer_size, model.n_envs, *space.shape), space.dtype)
        self.pos = 0
        self.full = False

    def add(self, taught: Array) -> None:
        """Add the states of the rollout buffer; `taught` has shape (steps, rows, ...)."""
        rows = (self.pos + np.arange(len(taught))) % self.buffer_size
        observations = self._model.rollout_buffer.observations
        if isinstance(self.observations, dict):
            for key, part in self.observations.items():
                part[rows] = observations[key]
        else:
            self.observations[rows] = observations
        self.actions[rows] = taught
        self.full |= self.pos + len(taught) >= self.buffer_size
        self.pos = (self.pos + len(taught)) % self.buffer_size

    def fit(self, new: int) -> float:
        """Fit the policy after `new` states were added. Returns the mean loss."""
        model = self._model
        policy = self._model.policy
        policy.set_training_mode(True)
        # With gSDE, `log_std` is a matrix of the noise on the last layer, not a deviation of actions.
        if isinstance(model.action_space, spaces.Box) and not model.use_sde:
            with torch.no_grad():
                policy.log_std.clamp_(max=math.log(_MAX_STD))
        for group in policy.optimizer.param_groups:  # the update of the library sets its own rate again
            group["lr"] = _LEARNING_RATE
        losses = []
        for _ in range(max(1, round(_STEPS_PER_ROW * new))):
            observations, taught = self.draw(_BATCH_SIZE)
            loss = _loss(model, policy.get_distribution(observations), taught).mean()
            policy.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]  # of the library
            policy.optimizer.step()
            losses.append(loss.item())
        return float(np.mean(losses))

    def draw(self, count: int) -> tuple[Any, torch.Tensor]:
        """Return observations and actions of `count` random states."""
        width = self.actions.shape[1]
        numbers = torch.randint((self.buffer_size if self.full else self.pos) * width, (count,)).numpy()
        at = numbers // width, numbers % width
        stored = self.observations
        batch: Any = (
            {key: part[at] for key, part in stored.items()} if isinstance(stored, dict) else stored[at]
        )
        observations, _ = self._model.policy.obs_to_tensor(batch)
        return observations, torch.as_tensor(self.actions[at], device=self._model.device)


@contextmanager
def only_imitating(model: Any, lessons: Lessons, taught: Array | None) -> Iterator[None]:
    """Context in which the update of an on-policy algorithm has gradients of the critic alone; afterwards,
    the policy is fitted to all lessons. The momentum of the fit before still moves the policy in an update.

    Args:
        taught: The teacher's actions in the states of the rollout buffer, of shape (steps, rows, ...); None
            with a recording.
    """
    if taught is not None:
        lessons.add(taught)  # before the update, which reorders the rollout buffer
    settings = {name: getattr(model, name) for name in ("ent_coef", "target_kl") if hasattr(model, name)}
    # Without advantages and entropy, the loss of the policy has no gradient.
    model.rollout_buffer.advantages[...] = 0.0
    model.ent_coef = 0.0
    if "target_kl" in settings:
        model.target_kl = None
    try:
        yield
    finally:
        for name, value in settings.items():
            setattr(model, name, value)
    model.logger.record("teacher/loss", lessons.fit(model.n_steps * model.n_envs))


@contextmanager
def imitating(model: Any, taught: Array | Lessons, weight: float) -> Iterator[None]:
    """Context in which updates of an on-policy algorithm also imitate.

    Args:
        model: The algorithm.
        taught: The teacher's actions in the states of the rollout buffer, of shape (steps, rows, ...), or the
            states of a recording.
        weight: The weight of the imitation loss.
    """
    policy, ent_coef = model.policy, model.ent_coef
    lessons = taught if isinstance(taught, Lessons) else None
    labels = torch.empty(0)
    if not isinstance(taught, Lessons):
        shape = (-1, *taught.shape[2:])
        # In the order of the flattened rollout buffer: all steps of the first row, then those of the next.
        labels = torch.as_tensor(
            np.ascontiguousarray(taught.swapaxes(0, 1)).reshape(shape), device=model.device
        )
    evaluate = policy.evaluate_actions
    batch: list[torch.Tensor] = []
    losses: list[float] = []
    entropies: list[float] = []

    def note(rows: Array) -> None:
        batch[:] = [labels[rows]] if lessons is None else []

    def evaluate_actions(
        observations: Any, actions: torch.Tensor, **options: Any
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        values, log_prob, entropy = evaluate(observations, actions, **options)
        if entropy is None:
            # As PPO of the library does for distributions without an analytical entropy.
            entropy = -log_prob
        if lessons is None:
            loss = _loss(model, policy.get_distribution(observations, **options), batch[0])
        else:
            taught_observations, targets = lessons.draw(len(actions))
            loss = _loss(model, policy.get_distribution(taught_observations), targets)
        losses.append(float(loss.detach().mean()))
        entropies.append(-float(entropy.detach().mean()))
        return values, log_prob, ent_coef * entropy - weight * loss

    policy.evaluate_actions = evaluate_actions
    # The entropies that `evaluate_actions` returns are weighted already.
    model.ent_coef = 1.0
    try:
        with internals.samples_noted(model.rollout_buffer, note):
            yield
    finally:
        # The attribute of the object hid the method of its class, which is visible again.
        del policy.evaluate_actions
        model.ent_coef = ent_coef
    model.logger.record("train/entropy_loss", float(np.mean(entropies)))
    model.logger.record("teacher/loss", float(np.mean(losses)))


def keep_labels(model: Any) -> None:
    """Make the replay buffer keep the teacher's action beside each action: its rows of actions have twice the
    width.

    A label is `_UNKNOWN` if the teacher was not used, and in transitions with another goal than that of the
    episode.
    """
    buffer = model.replay_buffer
    width = buffer.action_dim
    buffer.action_dim *= 2
    buffer.actions = np.zeros((*buffer.actions.shape[:2], 2 * width), buffer.actions.dtype)
    draw = buffer.sample

    def sample(*arguments: Any, **options: Any) -> Any:
        samples = draw(*arguments, **options)
        buffer.labels = samples.actions[:, width:]
        return samples._replace(actions=samples.actions[:, :width])

    buffer.sample = sample
    if isinstance(buffer, HerReplayBuffer):

        def unlabel(samples: Any) -> Any:
            samples.actions[:, width:] = _UNKNOWN
            return samples

        internals.change_virtual_samples(buffer, unlabel)


def mix_in(model: Any, demonstrations: Demonstrations) -> None:
    """Make the replay buffer draw a fixed share of each batch from demonstrations, whose actions are their
    labels."""
    buffer = model.replay_buffer
    draw = buffer.sample
    device = model.device
    current, following = (
        _tensors(observations, device)
        for observations in (demonstrations.observations, demonstrations.following)
    )
    count = len(demonstrations.actions)
    actions = torch.as_tensor(demonstrations.actions.reshape(count, -1), device=device)
    ends = torch.as_tensor(demonstrations.terminated[:, None], dtype=torch.float32, device=device)

    def sample(batch_size: int, env: Any = None) -> Any:
        samples = draw(batch_size, env=env)
        at = torch.from_numpy(np.random.randint(count, size=round(_DEMONSTRATED_SHARE * batch_size)))
        rewards = demonstrations.rewards[at.numpy(), None]
        # The buffer normalizes its own rewards with the statistics of the moment in which it is sampled, too.
        rewards = rewards if env is None else env.normalize_reward(rewards)
        columns = {
            "actions": actions[at],
            "rewards": torch.as_tensor(rewards, dtype=torch.float32, device=device),
            "dones": ends[at],
        }
        for name, part in columns.items():
            getattr(samples, name)[: len(at)] = part
        for mixed, source in ((samples.observations, current), (samples.next_observations, following)):
            for key, part in source.items() if isinstance(source, dict) else [(None, source)]:
                (mixed if key is None else mixed[key])[: len(at)] = part[at]
        if samples.discounts is not None:  # the samples span several steps, and demonstrations a single one
            samples.discounts[: len(at)] = model.gamma
        if hasattr(buffer, "labels"):
            buffer.labels[: len(at)] = actions[at]
        return samples

    buffer.sample = sample


def _tensors(observations: Any, device: Any) -> Any:
    return (
        {key: _tensors(part, device) for key, part in observations.items()}
        if isinstance(observations, dict)
        else torch.as_tensor(observations, device=device)
    )


def labeled(stored: Array, taught: Array | None) -> Array:
    """Return actions in the format of a replay buffer with labels. `taught` has the teacher's actions, and is
    None without a teacher."""
    return np.concatenate(
        [stored, np.full_like(stored, _UNKNOWN) if taught is None else np.clip(taught, -1.0, 1.0)], axis=1
    )


@contextmanager
def imitating_labels(model: Any, weight: float, *, only: bool, new: int) -> Iterator[None]:
    """Context in which the update of an off-policy algorithm also imitates.

    Args:
        model: The algorithm.
        weight: The weight of the imitation loss.
        only: Whether the actor only imitates. Then it is also fitted to labels afterwards.
        new: Number of states since the last update.
    """
    buffer, critic = model.replay_buffer, model.critic
    losses: list[float] = []

    def with_teacher(evaluate: Callable[..., Any]) -> Callable[..., Any]:
        def values(observations: Any, actions: torch.Tensor) -> Any:
            evaluated = evaluate(observations, actions)
            if not actions.requires_grad:  # the actions are from the replay buffer, not from the actor
                return evaluated
            loss = _distance(actions, buffer.labels)
            losses.append(float(loss.detach().mean()))
            parts = evaluated if isinstance(evaluated, tuple) else (evaluated,)
            scale = _ONLY_SCALE if only else _SCALE * parts[0].detach().abs().mean()
            penalty = (weight * scale * loss).reshape(-1, *[1] * (parts[0].ndim - 1))
            parts = tuple((0.0 if only else 1.0) * part - penalty for part in parts)
            return parts if isinstance(evaluated, tuple) else parts[0]

        return values

    # The actors of TD3 and DDPG are trained with the first critic alone, by `q1_forward`.
    names = [name for name in ("forward", "q1_forward") if hasattr(critic, name)]
    for name in names:
        setattr(critic, name, with_teacher(getattr(critic, name)))
    try:
        yield
    finally:
        for name in names:
            delattr(critic, name)
    if only:
        _fit_actor(model, max(1, round(_STEPS_PER_ROW * new)))
    if losses:
        model.logger.record("teacher/loss", float(np.mean(losses)))


def _fit_actor(model: Any, steps: int) -> None:
    """Fit the likeliest actions of an actor to the labels in the replay buffer."""
    actor, buffer = model.actor, model.replay_buffer
    for group in actor.optimizer.param_groups:  # the update of the library sets its own rate again
        group["lr"] = _LEARNING_RATE
    for _ in range(steps):
        observations = buffer.sample(_BATCH_SIZE, env=model.get_vec_normalize_env()).observations
        loss = _distance(model.policy(observations, deterministic=True), buffer.labels)
        actor.optimizer.zero_grad()
        loss.mean().backward()  # type: ignore[no-untyped-call]  # of the library
        actor.optimizer.step()


def _distance(actions: torch.Tensor, labels: torch.Tensor) -> torch.Tensor:
    """Return, per row, the distance of actions from their labels; 0 without a label."""
    distances = torch.nn.functional.smooth_l1_loss(actions, labels, beta=_BETA, reduction="none").sum(1)
    return distances * (labels[:, 0] != _UNKNOWN)


def agreement(model: Any, observations: Any, taught: Array) -> float:
    """Return the share of the states in which the policy, without exploration, agrees with the teacher.

    Args:
        model: The algorithm.
        observations: The observations, of shape (steps, rows, ...).
        taught: The teacher's actions in them, of the same shape.
    """
    parts = observations
    flat: Any = (
        {key: part.reshape(-1, *part.shape[2:]) for key, part in parts.items()}
        if isinstance(parts, dict)
        else parts.reshape(-1, *parts.shape[2:])
    )
    model.policy.set_training_mode(False)
    with torch.no_grad():
        batch = model.policy.obs_to_tensor(flat)[0]
        if hasattr(model, "rollout_buffer"):
            actions = model.policy.get_distribution(batch).mode().cpu().numpy()
        else:
            actions = model.policy(batch, deterministic=True).cpu().numpy()
    labels = taught.reshape(actions.shape)
    if isinstance(model.action_space, spaces.Box):
        agrees = np.abs(np.clip(actions, -1.0, 1.0) - np.clip(labels, -1.0, 1.0)) <= _AGREES
    else:
        agrees = actions == labels
    return float(agrees.reshape(len(agrees), -1).all(1).mean())


def _loss(model: Any, distribution: Any, taught: torch.Tensor) -> torch.Tensor:
    """Return, per row, the cross-entropy of choices, and in ranges the distance of the mean from the teacher.

    If the teacher is at the end of a range, a mean beyond it is as good: the action is clipped. On PandaPush,
    this and a linear loss for large distances give 74 % success after 18,000 states, where a quadratic loss
    gives 44 %.
    """
    if isinstance(model.action_space, spaces.Box):
        mean = distribution.mode()
        taught = taught.clamp(-1.0, 1.0).to(mean.dtype)
        is_beyond = (taught >= 1.0) & (mean > taught) | (taught <= -1.0) & (mean < taught)
        loss: torch.Tensor = torch.nn.functional.smooth_l1_loss(
            torch.where(is_beyond, taught, mean), taught, beta=_BETA, reduction="none"
        ).flatten(1)
        return loss.sum(1)
    log_loss: torch.Tensor = -distribution.log_prob(taught.long())
    # A mask gives a forbidden option a logarithm of -1e8: a teacher that chooses it teaches nothing there.
    return torch.where(log_loss < _FORBIDDEN_LOSS, log_loss, 0.0)
