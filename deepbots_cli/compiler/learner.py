"""The learner that deepbots chooses for a scenario that names no algorithm.

The choice depends on the structure of the compiled scenario alone, never on the machine: results are a
function of scenario, seed and shards. docs/training.md shows the table.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from deepbots_cli.diagnostics import Source
from deepbots_cli.document import Document, Entry, MappingNode, ScalarNode
from deepbots_cli.document.load import merge
from deepbots_cli.document.parse import parse
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.program import Program

SHORT_EPISODE = 256
"""The number of steps up to which a rollout of 512 steps contains two episodes."""
FEW_NUMBERS = 32
"""The count of numbers in the observation up to which two layers of 64 units are enough."""
LONG_STEP_S = 0.1
"""The time between two actions (s) from which on an off-policy algorithm needs far fewer steps."""
CHOSEN = "train, as chosen"
"""The name of the source of chosen values."""
_SAC: dict[str, Any] = {
    "algorithm": "SAC",
    "total_timesteps": 100_000,
    "batch_size": 256,
    "learning_rate": 1e-3,
    "network": {"hidden": [128, 128], "activation": "relu"},
}
_PPO: dict[str, Any] = {
    "algorithm": "PPO",
    "total_timesteps": 500_000,
    "learning_rate": "1e-3 -> 1e-4",
    "gae_lambda": 0.95,
    "normalize": "reward",
}
_TRAIN = "train"
_ALGORITHM = "algorithm"


@dataclass(frozen=True)
class Choice:
    """The keys of `train` that deepbots chooses, as a scenario writes them, and reasons by the keys that they
    are about."""

    settings: Mapping[str, Any]
    reasons: Mapping[str, str]


def choose(program: Program, *, has_teacher: bool = False) -> Choice:
    """Return the learner for a scenario: the first row that fits. With a teacher it is PPO, which imitates in
    the least CPU time."""
    row = _first_row(program, has_teacher=has_teacher)
    settings, reasons = dict(row.settings), dict(row.reasons)
    agent = program.agent
    steps = program.truncation.max_episode_steps(program.period)
    if settings["algorithm"] == "PPO":
        is_masked = any(option.forbidden is not None for part in agent.choices for option in part.options)
        algorithm = "MaskablePPO" if is_masked else "PPO"
        if is_masked:
            why = "some choices are forbidden"
        elif has_teacher:
            why = "it imitates a teacher"
        else:
            why = "it suits any action"
        reasons = {"algorithm": f"{algorithm}: {why}"} | reasons
        settings |= {
            "algorithm": algorithm,
            "network": {"hidden": [64, 64] if _observed_numbers(program) <= FEW_NUMBERS else [128, 128]},
        }
    if agent.copies is not None:
        settings["environments"] = max(1, settings["environments"] // agent.copies.count)
    # The horizon 1 / (1 - gamma) is a quarter of the episode.
    settings["gamma"] = min(max(round(1 - 4 / steps, 2), 0.9), 0.99)
    reasons["gamma"] = (
        f"gamma {settings['gamma']:g}: it looks {1 / (1 - settings['gamma']):.0f} of at most {steps:,} steps"
        " ahead"
    )
    return Choice(settings, reasons)


def _observed_numbers(program: Program) -> int:
    goal = program.agent.goal
    return len(program.agent.seen) + (2 * len(goal.values) if goal is not None else 0)


def _first_row(program: Program, *, has_teacher: bool) -> Choice:
    """Return the first row of the table that fits."""
    agent = program.agent
    steps = program.truncation.max_episode_steps(program.period)
    numbers = _observed_numbers(program)
    may_be_off_policy = not agent.choices and not has_teacher
    if may_be_off_policy and agent.goal is not None:
        why = "SAC with hindsight replay: the scenario has a goal"
        return Choice({**_SAC, "environments": 4, "replay": "her", "tau": 0.02}, {"algorithm": why})
    if may_be_off_policy and program.period >= LONG_STEP_S:
        why = f"SAC, which learns from each step many times: a step takes {program.period:g} s"
        return Choice({**_SAC, "environments": 8, "gradient_steps": 4}, {"algorithm": why})
    has_batches = program.engine is not None and ENGINES[program.engine].batch is not None
    if steps <= SHORT_EPISODE and numbers <= FEW_NUMBERS and not agent.images:
        why = (
            f"updates every 512 steps: an episode has at most {steps:,} steps, and the policy sees {numbers}"
            " numbers"
        )
        settings: dict[str, Any] = {"environments": 8, "n_steps": 64, "batch_size": 128, "n_epochs": 10}
        settings |= {"learning_rate": 1e-3, "total_timesteps": 200_000}
    elif has_batches and not agent.images and not has_teacher:
        why = f"256 worlds: the engine {program.engine} steps them as one batch"
        settings = {"environments": 256, "n_steps": 24, "batch_size": 1536, "n_epochs": 5}
        settings |= {"total_timesteps": 3_000_000}
    else:
        much = "images" if agent.images else f"{numbers} numbers"
        why = f"updates every 2,048 steps: an episode has at most {steps:,} steps, and the policy sees {much}"
        settings = {"environments": 16, "n_steps": 128, "batch_size": 256, "n_epochs": 5}
        settings |= {"learning_rate": 5e-4} if agent.images else {}
    return Choice(_PPO | settings, {"environments n_steps": why})


def with_learner(document: Document, choice: Choice) -> tuple[Document, tuple[str, ...]]:
    """Return the document with these settings under `train`, as far as it does not give them itself, and the
    reasons for these."""
    text = "".join(f"{key}: {json.dumps(value)}\n" for key, value in choice.settings.items())
    section = parse(Source(CHOSEN, text), document.findings)
    root = document.root
    assert isinstance(section, MappingNode)
    assert root is not None
    train_entry = root.entries.get(
        _TRAIN, Entry(ScalarNode(section.span, _TRAIN, _TRAIN), replace(section, entries={}))
    )
    assert isinstance(train_entry.value, MappingNode)  # the validation has checked it
    hyperparameters = {key: entry for key, entry in train_entry.value.entries.items() if key != _ALGORITHM}
    section = merge(section, replace(train_entry.value, entries=hyperparameters), _TRAIN)
    root = replace(root, entries=root.entries | {_TRAIN: Entry(train_entry.key, section)})
    return replace(document, root=root), tuple(
        reason for keys, reason in choice.reasons.items() if hyperparameters.keys().isdisjoint(keys.split())
    )
