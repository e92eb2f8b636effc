"""Registers the shipped scenarios with Gymnasium.

    gymnasium.make("deepbots_cli.envs:deepbots/CartPole-v1")

Importing this module is all it takes. A scenario limits its own episodes, so no time limit is wrapped
around it.
"""

from __future__ import annotations

import gymnasium

from deepbots_cli.source import Scalar, load, shipped


def _register() -> None:
    for short in shipped.scenario_names():
        path = shipped.scenario_path(short)
        root = load(path).root if path else None
        name = root.get("name") if root else None
        if isinstance(name, Scalar):
            identifier = f"deepbots/{name.text}-v1"
            if identifier not in gymnasium.registry:
                gymnasium.register(identifier, entry_point="deepbots_cli.api:make", kwargs={"source": short})


_register()
