"""Registers scenarios with Gymnasium: the shipped ones by their names, and any other by its path.

    gymnasium.make("deepbots_cli.envs:deepbots/CartPole-v1")
    gymnasium.make("deepbots_cli.envs:deepbots/Scenario-v1", scenario="my.yaml",
    overrides=["fall_angle=10deg"])

Importing this module registers them. A scenario limits its own episodes, so Gymnasium adds no time limit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium

from deepbots_cli.api import make
from deepbots_cli.document import ScalarNode, load, shipped
from deepbots_cli.errors import UsageError
from deepbots_cli.runtime import Supervisor

ANY_SCENARIO = "deepbots/Scenario-v1"


def make_scenario(scenario: str | Path | None = None, **options: Any) -> Supervisor:
    """Return the environment of `scenario`, a path or the name of a shipped scenario; `options` are the other
    arguments of `deepbots_cli.make`.

    Raises:
        UsageError: `scenario` is None; also the errors of `deepbots_cli.make`.
    """
    if scenario is None:
        raise UsageError(
            f'{ANY_SCENARIO} needs a scenario: gymnasium.make("deepbots_cli.envs:{ANY_SCENARIO}",'
            ' scenario="my.yaml")'
        )
    return make(scenario, **options)


def _register() -> None:
    _register_one(ANY_SCENARIO, "deepbots_cli.envs:make_scenario", {})
    for short in shipped.scenario_names():
        path = shipped.scenario_path(short)
        root = load(path).root if path else None
        name = root.get("name") if root else None
        if isinstance(name, ScalarNode):
            _register_one(f"deepbots/{name.text}-v1", "deepbots_cli.api:make", {"source": short})


def _register_one(identifier: str, entry_point: str, options: dict[str, Any]) -> None:
    # Gymnasium warns of an identifier that is registered twice.
    if identifier not in gymnasium.registry:
        gymnasium.register(identifier, entry_point=entry_point, kwargs=options)


_register()
