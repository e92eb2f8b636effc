"""Learning: from a compiled scenario to a trained, evaluated policy in a directory of its own.

training.py              train and resume: joins all of the below
training_loop.py         a training from its last checkpoint to its end
evaluation.py            evaluate: a policy on held-out starts, with intervals; loads the model of a run
held_out.py              held-out episodes: the worlds that play them, and their starts in a training
verdict.py               the evaluation of a run that is quoted, and whether the run is solved
run.py                   the run directory, written atomically and checked when read; models of runs
records.py               the content of `run.json` and of the evaluations of a run
directories.py           directories of runs, groups and studies: names, locks, files that are written whole
learner.py               the interface of an algorithm, and a base for algorithms of other packages
sb3/                     the learner of the built-in algorithms
rsl/                     the learner of rsl_rl.PPO
checkpoints.py           the whole state of a training, from which it continues to the bit
checkpoint_files.py      the files of a checkpoint, and their valid content
active.py                the parts of a training that runs in this process
callbacks.py             the callback of a training, and when to stop
training_evaluations.py  the evaluations of a training, and the choice of its best model
confirmations.py         the confirmations of a training
confirmation_rule.py     how a confirmation is judged, which may end the training
scalars.py               the scalars that a training logs
signals.py               Ctrl-C and SIGTERM
order.py                 the order of policies, and the best models of a training
keeping.py               the best model of a run, chosen again on new starts or by hand
decline.py               whether the last evaluations of a training are worse than earlier ones
environments.py          the creation of worlds: one by one, or as a batch
shards.py                the worlds of a training, and shards of them with a copy of the policy
teacher.py               a script or a recording as teacher: when the policy imitates it, and how much
multi_agent.py           the learner of several agents: one for each of them
self_play.py             one policy for two equal agents, against itself and a pool of its past versions
rivals.py                policies that act for other agents
matches.py               policies and scripts of two agents against each other
policy_teacher.py        a policy of another run as teacher
demonstrations.py        the episodes of a recording, run again to teach
scaling.py               the speed of a training with several numbers of shards
curriculum.py            the stages of a training
generations.py           windows over training episodes, equally many of each world
scenario_tests.py        the tests of a scenario
episodes.py              results of episodes: log, statistics, solved, summaries with intervals
draws.py                 the effect of drawn values on episodes
campaign.py              several trainings in one folder: the base of groups and studies
group.py                 groups: a folder with a run per seed, trained one after the other or on workers
changes.py               what a run changed against an earlier one, and the run that was solved before it
calls.py                 calls of a function, and their watchers
executor.py              executors of work: in this process, or on workers
journal_file.py          the file in which Optuna keeps a study, which a crash does not damage
study.py                 studies: searches over values of a scenario, a group for each trial
trials.py                how a process takes, trains, scores and prunes trials
listing.py               the state of runs, groups and studies from their files, even while they train
comparison.py            compare: groups of runs on the same starts; a group as one
robustness.py            a policy under changed conditions
statistics.py            intervals, gates that may stop early, comparisons of groups of runs
report.py                the progress of a training and of a group
failures.py              failures of an episode, kept to be reproduced
policy.py                a trained policy as an object to call

The names below are imported on first use, because torch alone takes a second. For the same reason, commands
and modules of other packages import the modules that need torch within functions.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from deepbots_cli.errors import MissingExtraError

if TYPE_CHECKING:
    from deepbots_cli.learning.comparison import Comparison, GroupResult, compare, evaluate_group
    from deepbots_cli.learning.evaluation import (
        EvaluationResult,
        evaluate,
        evaluate_baselines,
        evaluate_cases,
        evaluate_trained,
    )
    from deepbots_cli.learning.group import resume_group, train_group
    from deepbots_cli.learning.matches import MatchTable, play_matches
    from deepbots_cli.learning.policy import Policy, load_policy
    from deepbots_cli.learning.records import TrainingResult
    from deepbots_cli.learning.robustness import Robustness, evaluate_robustness
    from deepbots_cli.learning.training import checked_settings, resume, train

_MODULES = {
    "comparison": ("Comparison", "GroupResult", "compare", "evaluate_group"),
    "evaluation": (
        "EvaluationResult",
        "evaluate",
        "evaluate_baselines",
        "evaluate_cases",
        "evaluate_trained",
    ),
    "group": ("resume_group", "train_group"),
    "matches": ("MatchTable", "play_matches"),
    "policy": ("Policy", "load_policy"),
    "robustness": ("Robustness", "evaluate_robustness"),
    "records": ("TrainingResult",),
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
            "train", "training" if _HOMES[name] in ("group", "training") else "evaluating"
        ) from error
