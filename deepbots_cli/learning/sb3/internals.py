"""The private members of Stable-Baselines3 and sb3-contrib that deepbots uses. No other module names one.

deepbots calls `collect` and `update` in turn, and goes on from a checkpoint to the bit: the library has no
public names for the parts of its loop, and for its state between two steps. A test looks for each member in
the library.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from operator import attrgetter, methodcaller
from typing import Any, Literal

import numpy as np

from deepbots_cli.rollout.worlds import Array

# Counters of an algorithm, as checkpoints name them; each algorithm has some of them.
Counter = Literal[
    "num_timesteps",
    "_episode_num",
    "_n_updates",
    "_n_calls",
    "_current_progress_remaining",
    "exploration_rate",
]
# The numbers that the exploration of an off-policy algorithm depends on.
EXPLORATION = ("_current_progress_remaining", "exploration_rate", "learning_starts")

# Of an algorithm

# The share of the training that is left, from 1 to 0.
progress_remaining: Callable[[Any], float] = attrgetter("_current_progress_remaining")
# The names of the state dictionaries of a model, and of its further tensors.
saved_members: Callable[[Any], tuple[list[str], list[str]]] = methodcaller("_get_torch_save_params")
unsaved_members: Callable[[Any], list[str]] = methodcaller("_excluded_save_params")


def begin_learning(model: Any, total: int, callback: Any) -> Any:
    """Prepare the model as `learn` does before its loop. Returns the timesteps and the callback of the
    loop."""
    return model._setup_learn(total, callback)


def update_progress(model: Any, total: int) -> None:
    model._update_current_progress_remaining(model.num_timesteps, total)


def last(model: Any) -> tuple[Any, Array]:
    """Return the observations in which the algorithm acts next, and in which rows an episode begins."""
    return model._last_obs, model._last_episode_starts


def set_last(model: Any, observations: Any, starts: Array) -> None:
    """Set the observations in which the algorithm acts next; an episode begins in the rows of `starts`."""
    model._last_obs = observations
    model._last_episode_starts = starts


def continue_training(model: Any, starts: Array) -> None:
    """Continue from the present step, in the episodes of the worlds."""
    # `time/fps` divides the steps since then by the time of this process.
    model._num_timesteps_at_start = model.num_timesteps
    set_last(model, model.env.reset(), starts)
    if (normalizer := model.get_vec_normalize_env()) is not None:
        # With a normalizer, the library stores this observation in the replay buffer, not `_last_obs`.
        model._last_original_obs = normalizer.get_original_obs()


def memory(model: Any) -> Any:
    """Return the state of a recurrent policy between two steps: hidden state and cell of `pi` and of `vf`;
    None for others."""
    return getattr(model, "_last_lstm_states", None)


def set_memory(model: Any, states: Any) -> None:
    model._last_lstm_states = states


def explore(model: Any, *arguments: Any) -> Any:
    """Return the actions that an off-policy algorithm takes next, and these actions as its replay buffer
    stores them."""
    return model._sample_action(*arguments)


class Explorer:
    """A mixin for an off-policy algorithm: `explored` returns the result of `explore`, or replaces it."""

    explored: Callable[[Callable[[], Any]], Any]

    def _sample_action(self, *arguments: Any) -> Any:
        return self.explored(lambda: super(Explorer, self)._sample_action(*arguments))  # type: ignore[misc]


# Of policies


class Layers:
    """A mixin for the policy of an on-policy algorithm: `make_layers` makes its hidden layers, with the
    layers of the library as a function that it may call."""

    make_layers: Callable[[Callable[[], None]], None]

    def _build_mlp_extractor(self) -> None:
        self.make_layers(super()._build_mlp_extractor)  # type: ignore[misc]


def makes_layers(policy: type) -> bool:
    """Return whether a class of policies has a critic with layers of its own, as on-policy algorithms
    have."""
    return hasattr(policy, "_build_mlp_extractor")


def has_memory(policy: type) -> bool:
    """Return whether a class of policies is recurrent."""
    return hasattr(policy, "_process_sequence")


# Of buffers and statistics

# Of a buffer for hindsight: the rows in which the running episodes begin.
episode_starts: Callable[[Any], Array] = attrgetter("_current_ep_start")


def change_virtual_samples(buffer: Any, change: Callable[[Any], Any]) -> None:
    """Replace the samples with another goal of a buffer for hindsight by the result of `change`."""
    draw = buffer._get_virtual_samples
    buffer._get_virtual_samples = lambda *arguments: change(draw(*arguments))


@contextmanager
def samples_noted(buffer: Any, note: Callable[[Array], None]) -> Iterator[None]:
    """Context in which `note` is called with the rows of each batch that a rollout buffer returns."""
    draw = buffer._get_samples

    def noted(rows: Array, *arguments: Any) -> Any:
        note(rows)
        return draw(rows, *arguments)

    buffer._get_samples = noted
    try:
        yield
    finally:
        del buffer._get_samples


@contextmanager
def samples_chosen(buffer: Any, mask: Array) -> Iterator[None]:
    """Context in which a rollout buffer returns only chosen samples (truth values, steps x rows)."""
    usual = buffer.get
    # In the flattened buffer, all steps of a row come before those of the next row.
    numbers = np.flatnonzero(mask.T)

    def get(batch_size: int | None = None) -> Iterator[Any]:
        if not buffer.generator_ready:
            next(usual(1))  # it flattens the arrays
        order = np.random.permutation(numbers)
        size = batch_size or len(order)
        for first in range(0, len(order), size):
            yield buffer._get_samples(order[first : first + size])

    buffer.get = get
    try:
        yield
    finally:
        del buffer.get


def update_returns(normalizer: Any, rewards: Array) -> None:
    """Count the rewards of a step in the statistics that normalize rewards."""
    normalizer._update_reward(rewards)
