"""Noise on the actions while an off-policy algorithm explores, with a deviation that may change over the training."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.noise import ActionNoise as Noise

from deepbots_cli.program.task import ActionNoise

Actions = npt.NDArray[np.float32]
Remaining = Callable[[], float]
"""The share of the training that is left, from 1 to 0."""


class NormalNoise(Noise):
    """Independent in every step. Draws come from numpy's global generator, which the training seeds."""

    def __init__(self, kind: ActionNoise, size: tuple[int, ...], remaining: Remaining) -> None:
        super().__init__()
        self._kind = kind
        self._size = size
        self._remaining = remaining

    @property
    def sigma(self) -> float:
        """The standard deviation at this point of the training, in the agent's [-1, 1]."""
        start, end = self._kind.sigma.start, self._kind.sigma.end
        return end + (start - end) * self._remaining()

    def __call__(self) -> Actions:
        return np.random.normal(0.0, self.sigma, self._size).astype(np.float32)


class DriftingNoise(NormalNoise):
    """An Ornstein-Uhlenbeck process, sampled exactly: it returns to zero by the factor exp(-theta) in every step.

    n' = a n + sigma sqrt(1 - a^2) w with a = exp(-theta) and w of unit variance, so that its deviation is sigma whatever theta is
    (D. T. Gillespie, Phys. Rev. E 54, 1996, p. 2084). An episode begins anywhere in the course of it.
    """

    def __init__(self, kind: ActionNoise, size: tuple[int, ...], remaining: Remaining) -> None:
        super().__init__(kind, size, remaining)
        self._factor = float(np.exp(-kind.theta))
        self._unit: npt.NDArray[np.float64] | None = None

    def __call__(self) -> Actions:
        fresh = np.random.normal(0.0, 1.0, self._size)
        self._unit = fresh if self._unit is None else self._factor * self._unit + sqrt(1.0 - self._factor**2) * fresh
        return (self.sigma * self._unit).astype(np.float32)

    def reset(self) -> None:
        self._unit = None


def noise(kind: ActionNoise, size: tuple[int, ...], remaining: Remaining) -> Noise:
    """The process of the settings, for actions of the shape `size`."""
    return (DriftingNoise if kind.type == "ornstein_uhlenbeck" else NormalNoise)(kind, size, remaining)
