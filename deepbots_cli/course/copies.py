"""Policies that two students of a class handed in, also under the names of other steps or with weights that
were changed a little.

A policy is compared with every model of the other students, by two sketches. The weights are read as numbers,
without the pickle beside them, and 64 sums of them with random signs are kept: the distance of two such
sketches is that of the weights, to about a fifth (M. Charikar et al., Theor. Comput. Sci. 312, 2004, p. 3). What
the network answers to observations of one number each is the same for neurons and observations in another
order, and for other bytes beside them.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepbots_cli.course.lessons import Lesson, Step
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.records import dataclass
from deepbots_cli.words import sentence_list

if TYPE_CHECKING:
    from deepbots_cli.course.grading import Marks
    from deepbots_cli.course.marking import StepMark

_POLICY = "policy.pth"
"""The file of a model of Stable-Baselines3 with its weights."""
_STORAGE = re.compile(r"[^/]+/data/(\d{1,6})")
"""The numbers of a tensor in a file of PyTorch."""
_MAX_MODELS = 200
_MAX_BYTES = 50 * 2**20
_SUMS = 64
_NEAR = 0.01
"""The relative distance up to which two policies count as one."""


@dataclass(frozen=True)
class Weights:
    """The weights of a model. `place` is the name of its run with its file, `size` is in bytes, `sketch` are
    sums of weights with random signs, and `answers` are those of its network to observations of one number,
    none for a network of another form."""

    place: str
    size: int
    sketch: tuple[float, ...]
    answers: tuple[float, ...] = ()

    def is_near(self, other: Weights) -> bool:
        has_near_weights = self.size == other.size and _are_near(self.sketch, other.sketch)
        return has_near_weights or _are_near(self.answers, other.answers)


def _are_near(some: Sequence[float], others: Sequence[float]) -> bool:
    norm = math.hypot(*some)
    return norm > 0 and len(some) == len(others) and math.dist(some, others) <= _NEAR * norm


def weights_of(folder: Path, models: Sequence[Path]) -> list[Weights]:
    """Return the weights of models in the folder of runs; those of damaged files are left out."""
    return [
        Weights(path.relative_to(folder).as_posix().replace("/models/agent/", "/"), *sketch, _answers(path))
        for path in models[:_MAX_MODELS]
        if (sketch := _sketch(path)) is not None
    ]


def _sketch(model: Path) -> tuple[int, tuple[float, ...]] | None:
    """Return the size of the weights of a model in bytes and their sketch; None for a damaged file."""
    import numpy as np

    from deepbots_cli.learning.runs.run import opened_archive

    try:
        size = model.stat().st_size
        if size > _MAX_BYTES:
            return None
        with opened_archive(model, size) as archive:
            content = archive.read(_POLICY)
        with opened_archive(io.BytesIO(content), len(content)) as inner:
            storages = {
                int(match[1]): name for name in inner.namelist() if (match := _STORAGE.fullmatch(name))
            }
            numbers = b"".join(inner.read(storages[number]) for number in sorted(storages))
    except (OSError, KeyError, ValueError, NotImplementedError, RuntimeError, zipfile.BadZipFile):
        return None
    weights = np.frombuffer(numbers[: len(numbers) // 4 * 4], "<f4").astype(float)
    signs = np.random.default_rng(0).integers(0, 2, weights.size) * 2 - 1
    signed = np.resize(np.nan_to_num(weights) * signs, (-(-weights.size // _SUMS), _SUMS))
    return len(numbers), tuple(signed.sum(axis=0).tolist())


def _answers(model: Path) -> tuple[float, ...]:
    """Return what the network of a policy answers to observations of one number: the values of ranges, or by
    how much it prefers each option. The size of the values does not count."""
    import numpy as np

    from deepbots_cli.learning.policy import loaded
    from deepbots_cli.learning.runs.run import Run
    from deepbots_cli.learning.sb3.networks import probed_answers

    try:
        learner: Any = loaded(Run.open(model.parents[2]), model.stem)
        answers = probed_answers(learner.model.policy)
    except (DeepbotsError, AttributeError, ValueError):  # a damaged run, or an algorithm of a plug-in
        return ()
    return () if answers is None else tuple((answers / (np.linalg.norm(answers) or 1.0)).ravel().tolist())


def without_copies(lesson: Lesson, marks: Sequence[Marks]) -> list[Marks]:
    """Name every policy that is also a model of another student. Two that were handed in for other parts or
    other steps earn nothing: one of them was not trained as its run says. Equal parts give equal policies,
    since a training repeats itself."""
    return [_judged(lesson, one, marks) for one in marks]


def _judged(lesson: Lesson, own: Marks, marks: Sequence[Marks]) -> Marks:
    steps, copies = [], []
    for step in own.steps:
        if same := [*_same_elsewhere(lesson, step, own, marks)]:
            first = {student: place for student, place, _ in reversed(same)}
            texts = [f"{place} of {student}" for student, place in first.items()]
            others = [f"{len(texts) - 1} others"] if texts[2:] else texts[1:]
            reason = f"the same policy as {sentence_list([texts[0], *others])}"
            if any(is_other for *_, is_other in same):
                other = "handed in for another reward or task: ask who trained it"
                reason += f", {other}"
                step = _without_policy(step, lesson.steps[step.step], f"the same policy was {other}")
            copies.append(f"{step.step}: {reason}")
        steps.append(step)
    return replace(own, steps=tuple(steps), copies=tuple(copies))


def _same_elsewhere(
    lesson: Lesson, step: StepMark, own: Marks, marks: Sequence[Marks]
) -> Iterator[tuple[str, str, bool]]:
    """Yield the other students with a model that is the policy of a step, the name of this model, and whether
    that student has points for it in another step or with other parts."""
    if step.policy is None:
        return
    for theirs, student in ((theirs, one.student) for one in marks if one is not own for theirs in one.steps):
        place = next((model.place for model in theirs.models if step.policy.is_near(model)), None)
        if place is not None:
            is_handed_in = theirs.policy is not None and step.policy.is_near(theirs.policy)
            pairs = zip(theirs.checks, lesson.steps[theirs.step].checks, strict=True)
            has_points = any(mark.points and check.kind == "policy" for mark, check in pairs)
            is_same_task = (theirs.step, theirs.parts) == (step.step, step.parts)
            yield student, place, is_handed_in and has_points and not is_same_task


def _without_policy(mark: StepMark, step: Step, reason: str) -> StepMark:
    """Return marks in which the policy earns nothing."""
    checks = (
        replace(earned, points=0, reason=reason) if check.kind == "policy" else earned
        for earned, check in zip(mark.checks, step.checks, strict=True)
    )
    return replace(mark, checks=tuple(checks))
