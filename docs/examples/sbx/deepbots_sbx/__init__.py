"""PPO and SAC of sbx for deepbots: what a scenario may write. `deepbots lint` loads this module, so it
imports no JAX."""

from typing import Literal

from deepbots_cli.scenario.training import PPO, SAC


class JaxPPO(PPO):
    """PPO of sbx, in JAX."""

    import_path = "deepbots_sbx.algorithms:JaxPPO"

    algorithm: Literal["JaxPPO"]


class JaxSAC(SAC):
    """SAC of sbx, in JAX."""

    import_path = "deepbots_sbx.algorithms:JaxSAC"

    algorithm: Literal["JaxSAC"]
