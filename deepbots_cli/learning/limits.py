"""Checks that networks, environments and replay buffers fit into the memory, before they are created."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np

from deepbots_cli.errors import UsageError

_MAX_LAYERS = 16
_MAX_WEIGHTS = 50_000_000  # per network; with gradients and moments, actor and critic then take 1.6 GB
_BYTES_PER_ENVIRONMENT = 29_000_000  # measured for a cart-pole in PyBullet


def check_size(hidden: Sequence[int], inputs: int = 0) -> None:
    """Check the sizes of the hidden layers of a network; `inputs` is 0 if it is not known yet.

    Raises:
        UsageError: The network would be larger than any memory.
    """
    if len(hidden) > _MAX_LAYERS:
        raise UsageError(f"a policy has at most {_MAX_LAYERS} hidden layers")
    if sum(width * next_width for width, next_width in pairwise((inputs, *hidden))) > _MAX_WEIGHTS:
        observed = f"{inputs:,} observed numbers and " if inputs else ""
        raise UsageError(
            f"a policy with {observed}hidden layers of {', '.join(map(str, hidden))} units has more than"
            f" {_MAX_WEIGHTS:,} weights"
        )


def check_memory(environments: int, memory: int | None = None) -> None:
    """Check that this number of environments fits into the memory of this machine. `memory` is in bytes, by
    default all memory of the machine.

    Raises:
        UsageError: They do not fit.
    """
    _require_memory(f"{environments} environments need about", environments * _BYTES_PER_ENVIRONMENT, memory)


def check_replay(settings: Mapping[str, Any], space: gym.Space[Any], memory: int | None = None) -> None:
    """Check that the replay buffer fits into the memory of this machine; `memory` as for `check_memory`.

    Raises:
        UsageError: It does not fit.
    """
    steps = settings.get("buffer_size", 0)
    # The library stores each observation twice, as the present and as the next one.
    needed = (
        2
        * steps
        * sum(
            math.prod(part.shape or ()) * (part.dtype or np.dtype(np.float32)).itemsize
            for part in _parts_of(space)
        )
    )
    subject = f"a replay buffer of {steps:,} steps needs"
    _require_memory(subject, needed, memory, "; lower 'buffer_size' under 'train'")


def _require_memory(subject: str, needed: int, memory: int | None, hint: str = "") -> None:
    if memory is None and hasattr(os, "sysconf"):  # not on Windows
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if memory is not None and needed > memory:
        raise UsageError(
            f"{subject} {needed / 1e9:.1f} GB of memory, and this machine has {memory / 1e9:.1f} GB{hint}"
        )


def numbers_in(space: gym.Space[Any]) -> int:
    """Return how many numbers an observation has. Layers of filters reduce its pictures before the first
    hidden layer."""
    return sum(math.prod(part.shape or ()) for part in _parts_of(space) if len(part.shape or ()) == 1)


def _parts_of(space: gym.Space[Any]) -> Iterable[gym.Space[Any]]:
    return space.spaces.values() if isinstance(space, gym.spaces.Dict) else [space]
