"""How the policy is trained: one model per algorithm, made from the table of hyperparameters."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal

from deepbots_cli.scenario.hyperparameters import ALGORITHMS
from deepbots_cli.scenario.part import Kinds, Many, Part, field
from deepbots_cli.scenario.plain import Count, Word
from deepbots_cli.scenario.quantity import Prose


class Policy(Part):
    """The network of the policy."""

    hidden: Many[Annotated[int, Count(maximum=8192)]] = field(
        default=(64, 64), description="Units of each hidden layer, such as `[64, 64]`."
    )
    activation: Annotated[Literal["tanh", "relu", "elu", "leaky_relu", "gelu", "silu"], Word()] = field(
        default="tanh", description="Activation between the layers."
    )


class Training(Part):
    """What all algorithms have in common; the hyperparameters are fields of the model of each."""

    algorithm: Prose = field(description="The learning algorithm.")
    total_timesteps: Annotated[int, Count(maximum=10**12)] = field(
        description="Steps of the agent to train for, summed over all environments."
    )
    environments: Annotated[int, Count(maximum=1024)] = field(
        default=1, description="Copies of the environment that are trained in at once."
    )
    policy: Policy = field(default=Policy(), description="The network of the policy.")

    @property
    def hyperparameters(self) -> Mapping[str, Any]:
        """What the user set of the algorithm's own, by its names, in the order of the table."""
        return {name: getattr(self, name) for name in ALGORITHMS[self.algorithm] if name in self.given}


@cache
def training_with(algorithm: str) -> type[Training]:
    """The model of `train` for an algorithm of the table."""
    own = {name: field(default=None, description=entry.description) for name, entry in ALGORITHMS[algorithm].items()}
    annotations = {name: entry.annotation | None for name, entry in ALGORITHMS[algorithm].items()}
    return type(f"{algorithm}Training", (Training,), {**own, "__annotations__": annotations, "__module__": __name__})


_ACTS = {
    "PPO": "On-policy; choices or ranges. The first to try.",
    "A2C": "On-policy; choices or ranges. Plainer than PPO.",
    "DQN": "Off-policy; one choice.",
    "SAC": "Off-policy; ranges. Explores by entropy.",
    "TD3": "Off-policy; ranges. DDPG with two critics and delayed updates.",
    "DDPG": "Off-policy; ranges.",
    "MaskablePPO": "PPO that heeds forbidden choices.",
    "RecurrentPPO": "PPO with a memory (LSTM); choices or ranges.",
    "TQC": "Off-policy; ranges. SAC with critics of many quantiles.",
}
AnyTraining = Annotated[Training, Kinds("algorithm", tuple(ALGORITHMS), training_with, sentences=tuple(_ACTS[name] for name in ALGORITHMS))]
