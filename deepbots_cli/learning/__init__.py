"""Learning: from a compiled scenario to a trained, evaluated policy in a directory of its own.

training.py      train and resume: joins all of the below
evaluation.py    evaluate: held-out episodes, intervals, the verdict
rollout.py       episodes of a trained policy
run.py           the run directory: what is kept, written atomically, read with suspicion
record.py        run.json: who, what, when, with which versions
atomic.py        whole files, and JSON read with suspicion
exclusive.py     one training at a time in a run
weights.py       networks and optimisers as plain arrays; no pickle is ever loaded
algorithms.py    the table of algorithms
defaults.py      the hyperparameters that a training takes: the scenario's, our defaults, the library's
noise.py         noise on the actions of algorithms that explore by it
environments.py  copies of one world, stepped in turn in one process
curriculum.py    the stages of a training
episodes.py      what an episode leaves behind: log, statistics, solved
summary.py       what several come to
callbacks.py     what happens during training: best model, checkpoints, logging
trials.py        what the networks of a moment do: they choose the best model, and confirm that a task is solved
interruption.py  Ctrl-C and SIGTERM end a training between two steps
intervals.py     confidence intervals
progress.py      how a training is reported
report.py        results as text and as JSON
video.py         one episode as mp4

The names below are imported on first use: torch alone takes a second.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from deepbots_cli.errors import MissingExtraError

if TYPE_CHECKING:
    from deepbots_cli.learning.evaluation import EvaluationResult, evaluate, evaluate_cases
    from deepbots_cli.learning.training import TrainingResult, resume, train

__all__ = ["EvaluationResult", "TrainingResult", "evaluate", "evaluate_cases", "resume", "train"]

_HOMES = {
    "EvaluationResult": "evaluation",
    "TrainingResult": "training",
    "evaluate": "evaluation",
    "evaluate_cases": "evaluation",
    "resume": "training",
    "train": "training",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("deepbots_cli"):
            raise
        raise MissingExtraError("train", "evaluating" if _HOMES[name] == "evaluation" else "training") from error
