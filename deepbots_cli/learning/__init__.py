"""Learning: from a compiled scenario to a trained, evaluated policy in a directory of its own.

training.py              train, resume and repeat: joins all of the below
training_loop.py         a training from its last checkpoint to its end
learner.py               the interface of an algorithm, and a base for algorithms of other packages
callbacks.py             the callback of a training: evaluations, confirmations, the best model, when to stop
checkpoints.py           the whole state of a training, from which it continues to the bit, and its files
report.py                the progress of a training and of a group

environments.py          the worlds of a training or an evaluation, held-out episodes, failures of an episode
shards.py                the worlds of a training, and shards of them with a copy of the policy
executor.py              executors of work, in this process or on workers; Ctrl-C and SIGTERM

evaluation.py            evaluate: a policy on held-out starts, with intervals; policies and scripts of
                         two agents against each other
comparison.py            compare: groups of runs on the same starts; a group as one
robustness.py            a policy under changed conditions
policy.py                the policies of runs: loaded, as objects to call, beside other agents
teaching.py              teachers: scripts, recordings and other policies
scenario_tests.py        the tests of a scenario

multi_agent.py           the learner of several agents: one for each of them
self_play.py             one policy for two equal agents, against itself and a pool of its past versions

runs/                    the directory of a run, and what follows from its files alone
campaigns/               several trainings of one scenario: groups, studies, and how they are listed
sb3/                     the learner of the built-in algorithms

The names below are imported on first use, because torch alone takes a second. For the same reason, commands
and modules of other packages import the modules that need torch within functions.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from deepbots_cli.errors import MissingExtraError

if TYPE_CHECKING:
    from deepbots_cli.learning.campaigns.group import resume_group, train_group
    from deepbots_cli.learning.comparison import Comparison, GroupResult, compare, evaluate_group
    from deepbots_cli.learning.evaluation import (
        MatchTable,
        evaluate,
        evaluate_baselines,
        evaluate_cases,
        evaluate_trained,
        play_matches,
    )
    from deepbots_cli.learning.policy import Policy, load_policy
    from deepbots_cli.learning.robustness import Robustness, evaluate_robustness
    from deepbots_cli.learning.runs.evaluations import EvaluationResult
    from deepbots_cli.learning.runs.run import TrainingResult
    from deepbots_cli.learning.training import Repetition, checked_settings, repeat, resume, train

_MODULES = {
    "comparison": ("Comparison", "GroupResult", "compare", "evaluate_group"),
    "evaluation": (
        "MatchTable",
        "evaluate",
        "evaluate_baselines",
        "evaluate_cases",
        "evaluate_trained",
        "play_matches",
    ),
    "campaigns.group": ("resume_group", "train_group"),
    "policy": ("Policy", "load_policy"),
    "robustness": ("Robustness", "evaluate_robustness"),
    "runs.evaluations": ("EvaluationResult",),
    "runs.run": ("TrainingResult",),
    "training": ("Repetition", "checked_settings", "repeat", "resume", "train"),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}
__all__ = [
    "Comparison",
    "EvaluationResult",
    "GroupResult",
    "MatchTable",
    "Policy",
    "Repetition",
    "Robustness",
    "TrainingResult",
    "checked_settings",
    "compare",
    "evaluate",
    "evaluate_baselines",
    "evaluate_cases",
    "evaluate_group",
    "evaluate_robustness",
    "evaluate_trained",
    "load_policy",
    "play_matches",
    "repeat",
    "resume",
    "resume_group",
    "train",
    "train_group",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("deepbots_cli"):
            raise
        raise MissingExtraError(
            "train",
            "training" if _HOMES[name] in ("campaigns.group", "training") else "evaluating",
        ) from error
