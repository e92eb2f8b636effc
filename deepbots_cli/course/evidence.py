"""Whether the record of a training explains the policy in it.

The grader repeats the starts on which a training evaluated its policy. The policy of another training has
other returns there. An evaluation that untrained policies repeat, too, such as one of two steps, explains no
policy. Only a training of the grader's own finds records that are all written by hand.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from typing import Any

from deepbots_cli.learning.environments import Evaluator, supervisor_factory
from deepbots_cli.learning.executor import Interruption
from deepbots_cli.learning.policy import load_model
from deepbots_cli.learning.runs.episodes import read_evaluations
from deepbots_cli.learning.runs.run import Run, steps_of
from deepbots_cli.learning.sb3.algorithms import torch_settings

_TOLERANCE = 0.01
"""The relative difference of returns and lengths on machines of two kinds. On one machine, they are equal. The
returns of a reward for progress are almost those of any other policy, but the lengths are not."""

_UNTRAINED_EPISODES = 5
"""Untrained policies play until the time limit, so they play few episodes."""


def unexplained(run: Run) -> str:
    """Return why the records of a training do not explain its best policy; empty if they do."""
    steps = steps_of(run.model("best"))
    evaluations = [one for one in read_evaluations(run.path) if one["steps"] == steps]
    if not evaluations:
        return f"its policy was saved after {steps:,} steps, after which the training has no evaluation"
    recorded = [*zip(evaluations[-1]["returns"], evaluations[-1]["lengths"], strict=False)]
    stage = evaluations[-1]["stage"] or None
    program = run.program.variant(None, stage)
    evaluator = Evaluator(supervisor_factory(run.record.engine), run.record.seed)
    model = load_model(run, "best")

    def repeated(count: int) -> int:
        """Return how many of the first episodes have the return and length of the record."""
        episodes = evaluator.play(model, program, Interruption(), evaluator.starts[:count], stage)
        return sum(
            math.isclose(episode.total_return, total, rel_tol=_TOLERANCE, abs_tol=1e-3)
            and math.isclose(episode.length, length, rel_tol=_TOLERANCE, abs_tol=1)
            for episode, (total, length) in zip(episodes, recorded, strict=False)
        )

    with torch_settings(), closing(evaluator):
        count = len(evaluator.starts)
        same = repeated(count)
        if 2 * same < count:  # a robot in contact may do anything else
            return f"only {same} of {count} episodes of its evaluation after {steps:,} steps repeat"
        untrained = [2 * repeated(_UNTRAINED_EPISODES) >= _UNTRAINED_EPISODES for _ in _random_weights(model)]
    if sum(untrained) > 1:  # one of three may do what a policy does that has learned little
        return f"an untrained policy repeats its evaluation after {steps:,} steps as well"
    return ""


def _random_weights(model: Any) -> Iterator[None]:
    """Give the network of a policy other weights three times, zeros first; never for an algorithm of a
    plug-in."""
    import torch

    policy: Any = getattr(getattr(model, "model", None), "policy", None)
    random = torch.Generator().manual_seed(0)
    for scale in () if policy is None else (0, 1, 1):
        with torch.no_grad():
            for tensor in policy.parameters():
                tensor.copy_(scale * torch.randn(tensor.shape, generator=random))
        yield
