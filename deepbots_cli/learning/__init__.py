"""Learning: from a compiled scenario to a trained, evaluated policy in a directory of its own.

training.py              train and resume: joins all of the below
training_loop.py         a training from its last checkpoint to its end
learner.py               the interface of an algorithm, and a base for algorithms of other packages
callbacks.py             the callback of a training, when to stop, and the scalars that it logs
training_evaluations.py  the evaluations of a training, their confirmations, and the choice of its best model
checkpoints.py           the whole state of a training, from which it continues to the bit
checkpoint_files.py      the files of a checkpoint, and their valid content
model_files.py           the files of models: their archive, and the steps after which they were saved
report.py                the progress of a training and of a group
signals.py               Ctrl-C and SIGTERM

environments.py          the creation of worlds: one by one, or as a batch
shards.py                the worlds of a training, and shards of them with a copy of the policy
executor.py              executors of work: in this process, or on workers
calls.py                 calls of a function, and their watchers
failures.py              failures of an episode, kept to be reproduced
limits.py                checks that a training fits into the memory
scaling.py               the speed of a training with several numbers of shards

evaluation.py            evaluate: a policy on held-out starts, with intervals; loads the model of a run
held_out.py              held-out episodes: the worlds that play them, and their starts in a training
keeping.py               the best model of a run, chosen again on new starts or by hand
comparison.py            compare: groups of runs on the same starts; a group as one
robustness.py            a policy under changed conditions
policy.py                a trained policy as an object to call
scenario_tests.py        the tests of a scenario

runs/                    the directory of a run, and what follows from its files alone
campaigns/               several trainings of one scenario: groups, studies, and how they are listed
agents/                  several agents: their learners, and matches between them
teaching/                teachers: scripts, recordings and other policies
sb3/                     the learner of the built-in algorithms

The names below are imported on first use, because torch alone takes a second. For the same reason, commands
and modules of other packages import the modules that need torch within functions.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from deepbots_cli.errors import MissingExtraError

if TYPE_CHECKING:
    from deepbots_cli.learning.agents.matches import MatchTable, play_matches
    from deepbots_cli.learning.campaigns.group import resume_group, train_group
    from deepbots_cli.learning.comparison import Comparison, GroupResult, compare, evaluate_group
    from deepbots_cli.learning.evaluation import (
        evaluate,
        evaluate_baselines,
        evaluate_cases,
        evaluate_trained,
    )
    from deepbots_cli.learning.policy import Policy, load_policy
    from deepbots_cli.learning.robustness import Robustness, evaluate_robustness
    from deepbots_cli.learning.runs.evaluations import EvaluationResult
    from deepbots_cli.learning.runs.records import TrainingResult
    from deepbots_cli.learning.training import checked_settings, resume, train

_MODULES = {
    "comparison": ("Comparison", "GroupResult", "compare", "evaluate_group"),
    "evaluation": ("evaluate", "evaluate_baselines", "evaluate_cases", "evaluate_trained"),
    "campaigns.group": ("resume_group", "train_group"),
    "agents.matches": ("MatchTable", "play_matches"),
    "policy": ("Policy", "load_policy"),
    "robustness": ("Robustness", "evaluate_robustness"),
    "runs.evaluations": ("EvaluationResult",),
    "runs.records": ("TrainingResult",),
    "training": ("checked_settings", "resume", "train"),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}
__all__ = [
    "Comparison",
    "EvaluationResult",
    "GroupResult",
    "MatchTable",
    "Policy",
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
            "train", "training" if _HOMES[name] in ("campaigns.group", "training") else "evaluating"
        ) from error
