"""The hyperparameters of a training: those of the scenario, our defaults, and the defaults of the library.

Our defaults suit small networks and light worlds on a CPU. Every other default is the one of
Stable-Baselines3 or sb3-contrib. It is read from the signature in the library's source, since importing the
library takes seconds.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from deepbots_cli.program import Program
from deepbots_cli.program.task import ActionNoise, Schedule, Training
from deepbots_cli.scenario.training import ALGORITHMS

_LIBRARY_TITLES = {
    "stable_baselines3": "Stable-Baselines3",
    "sb3_contrib": "sb3-contrib",
}

_MANY_ENVIRONMENTS = 16
"""The number of environments from which batches grow with their number, so that an epoch has 8 batches.
Larger batches cost less per row."""


class Default(NamedTuple):
    """A default of ours: its value, of the training, its timesteps in all and the steps of its longest
    episode; and in words."""

    value: Callable[[Training, int, int], object]
    description: str


class EffectiveHyperparameter(NamedTuple):
    """A hyperparameter as a training takes it; `source` is the scenario, deepbots, or the library. An unknown
    value is None."""

    name: str
    value: object
    source: str


def _roll_out(training: Training) -> int:
    # Small updates, often: a cart-pole for 10x10 units is solved in 26 000 steps; with 1024 steps and a rate
    # of 3e-4 in 69 000 to 97 000.
    return max(32, 256 // training.environments // 32 * 32)


def _batch(training: Training) -> int:
    rows = _roll_out(training) * training.environments
    if training.environments >= _MANY_ENVIRONMENTS:
        return rows // 8
    # Otherwise the last batch of an epoch is smaller, and its gradient noisier.
    return 64 if rows % 64 == 0 else 32


_PPO = {
    "n_steps": Default(
        lambda training, *_: _roll_out(training),
        "256 / `environments`, rounded down to a multiple of 32, at least 32",
    ),
    "batch_size": Default(
        lambda training, *_: _batch(training),
        "with up to 15 `environments`: 64, or 32 if the default `n_steps` times `environments` is not a"
        " multiple of 64; with 16 or more: an eighth of this product",
    ),
    "gae_lambda": Default(lambda *_: 0.9, "0.9"),
    # Narrow layers bear, and need, larger steps; 64x64 learns as fast at a third of the rate and is steadier
    # there.
    "learning_rate": Default(
        lambda training, *_: 3e-3 if max(training.network.hidden, default=0) <= 32 else 1e-3,
        "0.003 for layers of up to 32 units, otherwise 0.001",
    ),
}
_GAUSSIAN = {"init_std": Default(lambda *_: 1.0, "1.0")}
_OFF_POLICY = {
    # Hindsight takes goals from episodes that have ended, so learning waits for the first.
    "learning_starts": Default(
        lambda training, total, longest: (
            max(1_000, longest * training.environments) if training.replay else min(1_000, total // 10)
        ),
        "the smaller of 1_000 and a tenth of `total_timesteps`; with `replay: her`, `environments` times the"
        " steps of the longest episode, at least 1_000",
    ),
    "replay": Default(lambda *_: "uniform", "uniform"),
}
_DQN = {
    "buffer_size": Default(lambda _, total, __: min(total, 100_000), "`total_timesteps`, at most 100_000"),
    "target_update_interval": Default(lambda *_: 500, "500"),
    "exploration_fraction": Default(lambda *_: 0.2, "0.2"),
    **_OFF_POLICY,
}
_ACTOR_CRITIC = {
    "buffer_size": Default(
        lambda _, total, __: min(total, 1_000_000), "`total_timesteps`, at most 1_000_000"
    ),
    # As many updates as steps, however many copies there are.
    "gradient_steps": Default(lambda *_: -1, "-1"),
    **_OFF_POLICY,
}
_DETERMINISTIC = _ACTOR_CRITIC | {
    "action_noise": Default(
        lambda *_: ActionNoise("normal", Schedule(0.1, 0.1)), "{type: normal, sigma: 0.1}"
    )
}

DEFAULTS: Mapping[str, Mapping[str, Default]] = {
    "A2C": _GAUSSIAN,
    "DDPG": _DETERMINISTIC,
    "DQN": _DQN,
    "MaskablePPO": _PPO,
    "PPO": _PPO | _GAUSSIAN,
    "RecurrentPPO": _PPO | _GAUSSIAN | {"lstm": Default(lambda *_: 64, "64")},
    "SAC": _ACTOR_CRITIC,
    "TD3": _DETERMINISTIC,
    "TQC": _ACTOR_CRITIC,
}
"""Our defaults, by algorithm and hyperparameter; an algorithm without any is left out."""


def default_values(training: Training, total_timesteps: int, longest_episode: int) -> dict[str, object]:
    """Return the values of our defaults; `environments` of the training counts every copy that the policy
    acts for."""
    defaults = DEFAULTS.get(ALGORITHMS[training.algorithm].base(), {})
    return {
        name: default.value(training, total_timesteps, longest_episode) for name, default in defaults.items()
    }


def longest_episode(scenario: Program) -> int:
    """Return the number of steps of the longest episode of the agent, over the scenario and its stages."""
    stages = [scenario, *(stage.program for stage in scenario.curriculum)]
    return max(stage.truncation.max_episode_steps(stage.period) for stage in stages)


def effective_hyperparameters(scenario: Program, total_timesteps: int) -> list[EffectiveHyperparameter]:
    """Return every hyperparameter of the scenario's algorithm, in the order of the table of the language;
    empty for an unknown algorithm."""
    training = scenario.agent.training
    if scenario.members:
        return _hyperparameters_of_members(scenario, total_timesteps)
    if training is None or training.algorithm not in ALGORITHMS:  # a scenario of a run may name any
        return []
    values: dict[str, object] = {entry.name: entry.value for entry in training.hyperparameters}
    values |= {
        name: value
        for name, value in (("action_noise", training.action_noise), ("replay", training.replay))
        if value is not None
    }
    rows = training.environments * (scenario.agent.copies.count if scenario.agent.copies else 1)
    defaults = default_values(
        replace(training, environments=rows), total_timesteps, longest_episode(scenario)
    )
    base = ALGORITHMS[training.algorithm].base()
    library = library_defaults(base)
    title = "library default" if library is None else library_of(base)
    effective = []
    for name in ALGORITHMS[training.algorithm].hyperparameter_names():
        if name in values:
            effective.append(EffectiveHyperparameter(name, values[name], "scenario"))
        elif name in defaults:
            effective.append(EffectiveHyperparameter(name, defaults[name], "deepbots"))
        else:
            effective.append(EffectiveHyperparameter(name, (library or {}).get(name), title))
    return effective


def _hyperparameters_of_members(scenario: Program, total_timesteps: int) -> list[EffectiveHyperparameter]:
    """Return the hyperparameters of several agents: those that all have in common once, the others under the
    name of each agent."""
    by_agent = {
        name: effective_hyperparameters(member.program, total_timesteps)
        for name, member in scenario.members.items()
    }
    first, *other_agents = by_agent.values()
    common = [entry for entry in first if all(entry in entries for entries in other_agents)]
    per_agent = [
        entry._replace(name=f"{agent}.{entry.name}")
        for agent, entries in by_agent.items()
        for entry in entries
        if entry not in common
    ]
    return common + per_agent


def library_of(algorithm: str) -> str:
    """Return the title of the library that has the algorithm."""
    return _LIBRARY_TITLES[_package(algorithm)]


def _package(algorithm: str) -> str:
    """Return the package that has the algorithm; Stable-Baselines3 for one of a plug-in."""
    package = ALGORITHMS[algorithm].import_path.partition(":")[0]
    return package if package in _LIBRARY_TITLES else "stable_baselines3"


@cache
def library_defaults(algorithm: str) -> Mapping[str, object] | None:
    """Return the defaults in the signature of the algorithm's class; None where the library is not installed.

    A default that is not a literal is given as its text.
    """
    spec = find_spec(_package(algorithm))
    if spec is None or spec.origin is None:
        return None
    defined = re.compile(rf"^class {algorithm}[(:]", re.MULTILINE)
    for path in sorted(Path(spec.origin).parent.glob("*/*.py")):
        text = path.read_text(encoding="utf-8")
        if defined.search(text):
            (definition,) = (
                node
                for node in ast.parse(text).body
                if isinstance(node, ast.ClassDef) and node.name == algorithm
            )
            (start,) = (
                node
                for node in definition.body
                if isinstance(node, ast.FunctionDef) and node.name == "__init__"
            )
            # In `ast`, the defaults are those of the last positional arguments.
            keys = [argument.arg for argument in start.args.args][-len(start.args.defaults) :]
            return {key: _literal(default) for key, default in zip(keys, start.args.defaults, strict=True)}
    return None


def _literal(node: ast.expr) -> object:
    try:
        return ast.literal_eval(node)
    except ValueError:
        return ast.unparse(node)
