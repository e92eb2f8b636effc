"""Algorithms: PPO with another default, for choices only, one whose weights cannot be stored, and one with
its own learner."""

from typing import Literal

from deepbots_cli.scenario.quantities import PositiveInt
from deepbots_cli.scenario.training import PPO, Training


class GentlePPO(PPO):
    """PPO that makes three passes over each rollout."""

    algorithm: Literal["GentlePPO"]
    n_epochs: PositiveInt | None = 3
    """Passes over the samples of a rollout."""


class ChoicePPO(PPO):
    """PPO for choices."""

    acts_by = frozenset({"choice", "choices"})

    algorithm: Literal["ChoicePPO"]


class NoTensors(PPO):
    """PPO with weights that torch does not know, as in JAX."""

    import_path = "acme.training:Elsewhere"

    algorithm: Literal["NoTensors"]


class CrossEntropy(Training):
    """Tries linear policies, and draws the next ones near the best."""

    import_path = "acme.cem:CrossEntropyMethod"
    acts_by = frozenset({"choice"})

    algorithm: Literal["CrossEntropy"]
    population: PositiveInt | None = 24
    """Policies between two updates."""
