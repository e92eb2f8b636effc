"""Learning: from a compiled scenario to a trained, evaluated policy in a directory of its own, on Stable-Baselines3.

training.py      train and resume: joins all of the below
evaluation.py    evaluate: episodes of a policy on held-out starts, intervals, the verdict
run.py           the run directory: what is kept, written atomically, read with suspicion
models.py        models as Stable-Baselines3's zip files, read without unpickling
checkpoints.py   the whole state of a training, from which it goes on to the bit
callbacks.py     what happens during training: evaluations, the best model, scalars, when to stop
algorithms.py    algorithms made for a scenario, action noise
defaults.py      the hyperparameters that a training takes: the scenario's, our defaults, the library's
environments.py  a vector environment over several worlds
batch.py         the same over a batch of worlds
curriculum.py    the stages of a training
episodes.py      what episodes leave behind: log, statistics, solved, summaries with intervals
comparison.py    compare: groups of runs on the same starts
statistics.py    intervals, gates that may stop early, comparisons of groups of runs
report.py        results as text and as JSON, progress
video.py         one episode as mp4

The names below are imported on first use: torch alone takes a second.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from deepbots_cli.errors import MissingExtraError

if TYPE_CHECKING:
    from deepbots_cli.learning.comparison import Comparison, compare
    from deepbots_cli.learning.evaluation import EvaluationResult, evaluate, evaluate_cases
    from deepbots_cli.learning.run import TrainingResult
    from deepbots_cli.learning.training import resume, train

__all__ = ["Comparison", "EvaluationResult", "TrainingResult", "compare", "evaluate", "evaluate_cases", "resume", "train"]

_HOMES = {
    "Comparison": "comparison",
    "EvaluationResult": "evaluation",
    "TrainingResult": "run",
    "compare": "comparison",
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
