"""The private members that deepbots uses for RSL-RL. No other module names one. A test looks for each member
in its library."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from torch.distributions import Distribution


@contextmanager
def validation_kept() -> Iterator[None]:
    """Context after which the distributions of torch check their parameters as before.

    A distribution of RSL-RL turns these checks off for the whole process, and the algorithms of
    Stable-Baselines3 find parameters that are not finite by them.
    """
    before = Distribution._validate_args
    try:
        yield
    finally:
        Distribution.set_default_validate_args(before)
