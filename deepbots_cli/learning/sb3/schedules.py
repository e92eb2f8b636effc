"""Hyperparameters and noise that change during a training."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.noise import ActionNoise

from deepbots_cli.program.task import ActionNoise as NoiseSettings
from deepbots_cli.program.task import AdaptiveRate, Hyperparameter, Schedule

_MIN_RATE, _MAX_RATE = 1e-5, 1e-2


def value_of(hyperparameter: Hyperparameter) -> object:
    """Return the value of a hyperparameter as Stable-Baselines3 takes it."""
    if hyperparameter.name == "train_freq" and isinstance(hyperparameter.value, str):
        count, _, unit = hyperparameter.value.partition(" ")
        # `TrainFrequencyUnit` of the library has the units in the singular, `step` and `episode`.
        return int(count), unit.rstrip("s")
    if isinstance(hyperparameter.value, AdaptiveRate):
        return DivergenceRate(hyperparameter.value)
    if not isinstance(hyperparameter.value, Schedule):
        return hyperparameter.value
    start, end = hyperparameter.value.start, hyperparameter.value.end
    # The library passes the share of the training that is left, from 1 to 0.
    return lambda remaining: end + (start - end) * remaining


class DivergenceRate:
    """A learning rate that keeps the KL divergence of an update near a target.

    The rule and its numbers are those of RSL-RL (Schwarke et al., arXiv:2509.10771), applied after each
    update instead of each batch.
    """

    def __init__(self, settings: AdaptiveRate) -> None:
        self.kl = settings.kl
        self.rate = settings.start

    def __call__(self, remaining: float) -> float:
        return self.rate

    def follow(self, divergence: float) -> None:
        """Change the rate after an update with this divergence."""
        if divergence > 2.0 * self.kl:
            self.rate = max(_MIN_RATE, self.rate / 1.5)
        elif 0.0 < divergence < 0.5 * self.kl:
            self.rate = min(_MAX_RATE, self.rate * 1.5)


class DecayingNoise(ActionNoise):
    """Noise on the actions of an off-policy algorithm, with a standard deviation that may change over the
    training.

    Draws come from numpy's global generator, which the training seeds. Drifting noise (`ornstein_uhlenbeck`)
    is sampled exactly: n' = a n + sigma sqrt(1 - a^2) w with a = exp(-theta) and w of unit variance, so that
    its deviation is sigma whatever theta is (D. T. Gillespie, Phys. Rev. E 54, 1996, p. 2084). The first
    value of an episode has the same distribution as all others.

    Args:
        settings: The settings of the scenario.
        size: The shape of an action.
        remaining: Returns the share of the training that is left, from 1 to 0.
    """

    def __init__(
        self, settings: NoiseSettings, size: tuple[int, ...], remaining: Callable[[], float]
    ) -> None:
        super().__init__()
        self._settings = settings
        self._size = size
        self._remaining = remaining
        self._factor = math.exp(-settings.theta) if settings.type == "ornstein_uhlenbeck" else None
        self.drift: npt.NDArray[np.float64] | None = None
        """The last value of drifting noise of unit deviation; None at the start of an episode."""

    @property
    def sigma(self) -> float:
        """The standard deviation at this point of the training, in the agent's [-1, 1]."""
        start, end = self._settings.sigma.start, self._settings.sigma.end
        return end + (start - end) * self._remaining()

    def __call__(self) -> npt.NDArray[np.float32]:
        if self._factor is None:
            return np.random.normal(0.0, self.sigma, self._size).astype(np.float32)
        noise = np.random.normal(0.0, 1.0, self._size)
        self.drift = (
            noise
            if self.drift is None
            else self._factor * self.drift + math.sqrt(1.0 - self._factor**2) * noise
        )
        return (self.sigma * self.drift).astype(np.float32)

    def reset(self) -> None:
        self.drift = None
