"""Whether the record of a training explains the policy in it.

The starts on which a training evaluated its policy are repeated: a policy that another training made has other
returns there. Who can write all records of a run by hand is found by a training of the grader's own alone.
"""

from __future__ import annotations

import math
from contextlib import closing

from deepbots_cli.learning.environments import Evaluator, supervisor_factory
from deepbots_cli.learning.executor import Interruption
from deepbots_cli.learning.policy import load_model
from deepbots_cli.learning.runs.episodes import read_evaluations
from deepbots_cli.learning.runs.run import Run, steps_of
from deepbots_cli.learning.sb3.algorithms import torch_settings

_TOLERANCE = 0.01
"""The relative difference of returns and lengths on machines of two kinds. On one machine, they are equal. The
returns of a reward for progress are almost those of any other policy, but the lengths are not."""


def unexplained(run: Run) -> str:
    """Return why the records of a training do not explain its best policy; empty if they do."""
    steps = steps_of(run.model("best"))
    evaluations = [one for one in read_evaluations(run.path) if one["steps"] == steps]
    if not evaluations:
        return f"its policy was saved after {steps:,} steps, after which the training has no evaluation"
    stage = evaluations[-1]["stage"] or None
    evaluator = Evaluator(supervisor_factory(run.record.engine), run.record.seed)
    with torch_settings(), closing(evaluator):
        episodes = evaluator.evaluate(
            load_model(run, "best"), run.program.variant(None, stage), Interruption(), stage
        )
    recorded = zip(evaluations[-1]["returns"], evaluations[-1]["lengths"], strict=False)
    same = sum(
        math.isclose(episode.total_return, total, rel_tol=_TOLERANCE, abs_tol=1e-3)
        and math.isclose(episode.length, length, rel_tol=_TOLERANCE, abs_tol=1)
        for episode, (total, length) in zip(episodes, recorded, strict=False)
    )
    if 2 * same >= len(episodes):  # a robot in contact may do anything else
        return ""
    return f"only {same} of {len(episodes)} episodes of its evaluation after {steps:,} steps repeat"
