"""Algorithms: PPO with another default, for choices only, and one whose weights cannot be stored."""

from typing import Literal

from deepbots_cli.scenario.fields import PositiveInt
from deepbots_cli.scenario.training import PPO


class GentlePPO(PPO):
    """PPO that makes three passes over each roll-out."""

    algorithm: Literal["GentlePPO"]
    n_epochs: PositiveInt | None = 3
    """Passes over the samples of a roll-out."""


class ChoicePPO(PPO):
    """PPO for choices."""

    acts_by = frozenset({"choice", "choices"})

    algorithm: Literal["ChoicePPO"]


class NoTensors(PPO):
    """PPO with weights that torch does not know, as in JAX."""

    import_path = "acme.training:Elsewhere"

    algorithm: Literal["NoTensors"]
