"""The learner that deepbots chooses for a scenario that names no algorithm.

The choice depends on the structure of the compiled scenario alone, never on the machine: results are a function of scenario, seed and
shards. docs/training.md shows the table with the measurements behind it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace

from deepbots_cli.diagnostics import Source
from deepbots_cli.document import Document, Entry, MappingNode, ScalarNode
from deepbots_cli.document.load import merge
from deepbots_cli.document.parse import parse
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.program import Program

SHORT_EPISODE = 256
"""Steps up to which a rollout of 512 steps holds two episodes."""
FEW_NUMBERS = 32
"""Numbers that the policy sees, up to which two layers of 64 units are enough."""
CHOSEN = "train, as chosen"
"""The name of the source of chosen values."""
_TRAIN, _ALGORITHM = "train", "algorithm"


@dataclass(frozen=True)
class Choice:
    """The keys of `train` that deepbots chooses, as a scenario writes them, and the reason for some of the keys."""

    settings: Mapping[str, object]
    reasons: Mapping[str, str]


def choose(program: Program) -> Choice:
    """The learner for a scenario."""
    agent = program.agent
    steps = program.truncation.max_episode_steps(program.period)
    numbers = len(agent.seen) + (2 * len(agent.goal.values) if agent.goal else 0)
    gamma = min(max(round(1 - 4 / steps, 2), 0.9), 0.99)
    horizon = f"gamma {gamma:g}: an episode has at most {steps:,} steps"
    if agent.goal is not None and not agent.choices:
        return Choice(
            {
                "algorithm": "SAC",
                "total_timesteps": 200_000,
                "environments": 4,
                "replay": "her",
                "batch_size": 256,
                "learning_rate": 1e-3,
                "gamma": gamma,
                "tau": 0.02,
                "network": {"hidden": [128, 128], "activation": "relu"},
            },
            {"algorithm": "SAC with hindsight replay: the scenario has a goal, and actions are ranges", "gamma": horizon},
        )
    masked = any(option.forbidden is not None for part in agent.choices for option in part.options)
    algorithm, why = ("MaskablePPO", "some choices are forbidden") if masked else ("PPO", "it takes choices and ranges")
    batch = program.engine is not None and ENGINES[program.engine].batch is not None
    if steps <= SHORT_EPISODE and numbers <= FEW_NUMBERS and not agent.images:
        pace = {"total_timesteps": 200_000, "environments": 8, "n_steps": 64, "batch_size": 128, "n_epochs": 10, "learning_rate": 1e-3}
        size = "an update every 512 steps: episodes are short, and the policy sees few numbers"
    elif batch:
        pace = {"total_timesteps": 5_000_000, "environments": 256, "n_steps": 24, "batch_size": 1536, "n_epochs": 5}
        size = "256 worlds: the engine steps them as one batch"
    else:
        pace = {"total_timesteps": 1_000_000, "environments": 16, "n_steps": 128, "batch_size": 256, "n_epochs": 5}
        size = "an update every 2,048 steps: episodes are long, or the policy sees much"
    return Choice(
        {
            "algorithm": algorithm,
            "learning_rate": "1e-3 -> 1e-4",
            **pace,
            "gamma": gamma,
            "gae_lambda": 0.95,
            "normalize": "reward",
            "network": {"hidden": [64, 64] if numbers <= FEW_NUMBERS else [128, 128]},
        },
        {"algorithm": f"{algorithm}: {why}", "environments": size, "gamma": horizon},
    )


def with_learner(document: Document, choice: Choice) -> tuple[Document, tuple[str, ...]]:
    """The document with these settings under `train`, as far as it does not give them itself, and the reasons for these."""
    text = "".join(f"{key}: {json.dumps(value)}\n" for key, value in choice.settings.items())
    section, root = parse(Source(CHOSEN, text), document.findings), document.root
    assert isinstance(section, MappingNode)
    assert root is not None
    written = root.entries.get(_TRAIN, Entry(ScalarNode(section.span, _TRAIN, _TRAIN), replace(section, entries={})))
    assert isinstance(written.value, MappingNode)  # as it was validated
    given = {key: entry for key, entry in written.value.entries.items() if key != _ALGORITHM}
    section = merge(section, replace(written.value, entries=given), _TRAIN)
    root = replace(root, entries=root.entries | {_TRAIN: Entry(written.key, section)})
    return replace(document, root=root), tuple(reason for key, reason in choice.reasons.items() if key not in given)
