"""An algorithm: PPO with another default."""

from typing import Literal

from deepbots_cli.scenario.fields import PositiveInt
from deepbots_cli.scenario.training import PPO


class GentlePPO(PPO):
    """PPO that makes three passes over each roll-out."""

    algorithm: Literal["GentlePPO"]
    n_epochs: PositiveInt | None = 3
    """Passes over the samples of a roll-out."""
