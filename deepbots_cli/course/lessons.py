"""A lesson: a folder with `lesson.yaml`, the files that a student starts from, and checks that only the
teacher has.

    lesson.yaml   title, steps, checks, points, hints
    text.md       what the student reads
    teacher.md    usual mistakes, minutes
    start/        the files of the student; their world is in a file of its own, which the steps extend
    checks/       for each step the teacher's task, with its tests. It includes the parts of the student, such
                  as `reward: {include: handed_in/reward.yaml}`
    solution/     the files of `start` as the teacher would hand them in; half/NAME: with some of the points
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from deepbots_cli.document import MappingNode, shipped, to_data
from deepbots_cli.document.load import read_alone
from deepbots_cli.document.nodes import entries_at
from deepbots_cli.errors import UsageError
from deepbots_cli.files import is_file, read_at_most
from deepbots_cli.program.task import ExpectedKey
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.quantities import read_fraction

LESSON_NAME = "lesson.yaml"
START, CHECKS, SOLUTION, HALF = "start", "checks", "solution", "half"
HANDED_IN = "handed_in"
"""The folder, beside the teacher's tasks, in which they find the parts of the student."""
ANSWERS_NAME = "answers.yaml"
_NUMBERED = re.compile(r"(\d+)-(.+)")
_MAX_BYTES = 2**20
_FILE = r"^[A-Za-z0-9_-]+\.(urdf|obj|stl)$"
_NAME = r"^[a-z][a-z0-9_-]{0,39}$"

StepName = Annotated[str, Field(pattern=_NAME)]
Text = Annotated[str, Field(min_length=1, max_length=400)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Check(_Part):
    """One thing that a step is marked for. Exactly one of `test`, `without`, `answer`, and `policy` is set.

    Attributes:
        says: What is checked, in words that a student reads before and after.
        points: The points for it.
        fails: What the student reads if an expectation of the test is not met, by its key, such as `always`.
            Values that it compares stand in braces, as in `{rover.ahead}`; `{measured}` is another result.
        test: The name of a test of the teacher's task.
        without: A code of lint, such as `DB705`, that the task must not have.
        answer: A key of `answers.yaml`; `right` are the accepted values: texts, or ranges such as `3 .. 4`.
        policy: The success rates (`80 %`) or mean returns (`150`) for equal shares of the points. The policy
            is that of the run that was handed in, or that the grader trains.
        guard: Whether the files that the student starts from pass the check, too. It then counts only together
            with another check of the step.
        case: The case of the task in which the policy is evaluated.
        episodes: The number of episodes of the evaluation.
    """

    says: Text
    points: int = Field(ge=1, le=100)
    fails: Mapping[ExpectedKey, Text] = {}
    test: str | None = None
    without: str | None = None
    answer: str | None = None
    right: tuple[str | int | float | bool, ...] = ()
    policy: tuple[str | int | float, ...] = ()
    guard: bool = False
    case: str | None = None
    episodes: int = Field(default=40, ge=1, le=1000)

    @model_validator(mode="after")
    def _one_kind(self) -> Check:
        kinds = [name for name in ("test", "without", "answer", "policy") if getattr(self, name)]
        if len(kinds) != 1:
            raise ValueError("a check has one of `test`, `without`, `answer`, and `policy`")
        if (self.answer is not None) != bool(self.right):
            raise ValueError("`answer` and `right` belong together")
        for bar in self.policy:
            rate_or_return(bar)
        return self

    @property
    def kind(self) -> Literal["test", "without", "answer", "policy"]:
        if self.policy:
            return "policy"
        if self.answer is not None:
            return "answer"
        return "test" if self.test is not None else "without"


def rate_or_return(bar: str | float) -> tuple[bool, float]:
    """Return whether a bar is a success rate, and its number."""
    if isinstance(bar, str) and bar.rstrip().endswith("%"):
        return True, read_fraction(bar)
    return False, float(bar)


class Step(_Part):
    """A step of the exercise.

    Attributes:
        goal: What the student does, in a sentence.
        parts: The sections that the teacher's task takes from the file of the student, such as `reward` or
            `robots.rover.sensors`. The task includes mappings; a value, such as `world.timestep`, replaces
            its own.
        files: Files that the task takes beside them, such as `robot.urdf`; of at most 1 MiB.
        only: The keys that may stand directly in the parts; all, if empty.
        sensors: The types of sensors that the parts may have; None allows all.
        teacher: Whether the run may have learned from a teacher, a recording or another policy.
        forbidden: Names that no expression of the parts may use, such as the position that the robot cannot
            know.
        allowed: The names and functions that expressions of the parts may use; all, if empty.
        checks: What is marked.
        hints: Hints, each of which leads further than the one before.
    """

    goal: Text
    parts: tuple[str, ...] = ()
    files: tuple[Annotated[str, Field(pattern=_FILE)], ...] = ()
    only: tuple[str, ...] = ()
    sensors: tuple[str, ...] | None = None
    teacher: bool = False
    forbidden: tuple[str, ...] = ()
    allowed: tuple[str, ...] = ()
    checks: tuple[Check, ...] = Field(min_length=1)
    hints: tuple[Text, ...] = ()

    @property
    def points(self) -> int:
        return sum(check.points for check in self.checks)

    @model_validator(mode="after")
    def _has_parts(self) -> Step:
        if not self.parts and any(check.kind != "answer" for check in self.checks):
            raise ValueError("a step with a test, a policy or a code of lint has `parts`")
        return self


class _Lesson(_Part):
    title: Text
    summary: Text
    minutes: int = Field(default=45, ge=1, le=600)
    version: int = Field(default=1, ge=1)
    steps: Mapping[StepName, Step] = Field(min_length=1)


@dataclass(frozen=True)
class Lesson:
    """A lesson on disk. `name` is that of the folder without its number, which is 0 for one without."""

    folder: Path
    name: str
    number: int
    content: _Lesson

    @property
    def steps(self) -> Mapping[str, Step]:
        return self.content.steps

    @property
    def points(self) -> int:
        return sum(step.points for step in self.steps.values())

    @property
    def is_shipped(self) -> bool:
        """Whether the lesson comes with deepbots."""
        return self.folder.resolve().parent == course_folder()

    @property
    def label(self) -> str:
        return f"{self.number} {self.content.title}" if self.number else self.content.title

    @property
    def step_files(self) -> tuple[str, ...]:
        """The files that a student edits: one for each step with parts, and that of the answers."""
        steps = self.steps.values()
        has_answers = any(check.kind == "answer" for step in steps for check in step.checks)
        files = (f"{name}.yaml" for name, step in self.steps.items() if step.parts)
        return (*files, *([ANSWERS_NAME] if has_answers else []))

    def text(self, name: Literal["text.md", "teacher.md"]) -> str:
        """Return a page of the lesson; empty if it has none."""
        path = self.folder / name
        return read_at_most(path, _MAX_BYTES).decode("utf-8", "replace") if path.is_file() else ""


def read_mapping(path: Path, display: str | None = None) -> MappingNode:
    """Return a YAML file as a mapping without its `include`s.

    Raises:
        OSError: The file cannot be read.
        UsageError: It has a mistake, whose line the message names, or is not a mapping.
    """
    node, findings = read_alone(path, display)
    for error in findings.errors:
        raise UsageError("; ".join(filter(None, (f"{error.span.location}: {error.headline}", error.help))))
    if not isinstance(node, MappingNode):
        raise UsageError(f"{display or path}: it is not a mapping")
    return node


def data_of(path: Path) -> dict[str, Any]:
    """Return a YAML file as data without its `include`s.

    Raises:
        OSError, UsageError: As for `read_mapping`.
    """
    data: Any = to_data(read_mapping(path))
    return dict(data)


def read_lesson(folder: Path) -> Lesson:
    """Read a lesson.

    Raises:
        UsageError: The folder is not a lesson, or `lesson.yaml` or a task has a mistake.
    """
    path = folder / LESSON_NAME
    if not path.is_file():
        raise UsageError(
            f"{folder} is not a lesson: it has no {LESSON_NAME}; `deepbots new --lesson NAME` writes one"
        )
    try:
        content = _Lesson.model_validate(data_of(path))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise UsageError(f"{path}: `{where}`: {first['msg'].removeprefix('Value error, ').lower()}") from None
    numbered = _NUMBERED.fullmatch(folder.resolve().name)
    lesson = Lesson(
        folder,
        numbered[2] if numbered else folder.resolve().name,
        int(numbered[1]) if numbered else 0,
        content,
    )
    for name, step in content.steps.items():
        task = folder / CHECKS / f"{name}.yaml"
        if step.parts and not task.is_file():
            raise UsageError(f"{folder} has no {CHECKS}/{name}.yaml, the task of its step `{name}`")
        tests = entries_at(read_mapping(task), "tests") if step.parts else {}
        for check in step.checks:
            if check.test is not None and check.test not in tests:
                raise UsageError(f"{task} has no test `{check.test}`, which the step `{name}` checks")
    return lesson


def course_folder() -> Path:
    """Return the folder of the lessons that come with deepbots."""
    return shipped.data_dir() / "course"


def shipped_lessons() -> list[Lesson]:
    """Return the lessons that come with deepbots, in their order."""
    folders = sorted(path.parent for path in course_folder().glob(f"[0-9]*/{LESSON_NAME}"))
    return [read_lesson(folder) for folder in folders]


def shipped_lesson(name: str) -> Lesson:
    """Return a lesson that comes with deepbots, by its number or its name.

    Raises:
        UsageError: There is no such lesson.
    """
    lessons = shipped_lessons()
    for lesson in lessons:
        if name in (str(lesson.number), lesson.name):
            return lesson
    numbers = f"1 to {len(lessons)}" if lessons else "none"
    raise UsageError(
        f"there is no lesson '{name}'; the lessons are {numbers}, which `deepbots course` lists, and folders"
        f" with a {LESSON_NAME}, which `deepbots new --lesson NAME` writes"
    )


def lesson_named(name: str) -> Lesson:
    """Return the lesson in a folder, or else the one of this number or name that comes with deepbots.

    Raises:
        UsageError: There is no such lesson, or it has a mistake.
    """
    return read_lesson(Path(name)) if is_file(Path(name, LESSON_NAME)) else shipped_lesson(name)


def settings_of(data: Any, path: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the values of a mapping by their dotted paths, two levels deep."""
    if isinstance(data, dict) and len(path) < 2 and data:
        return {
            dotted: value
            for key, inner in data.items()
            for dotted, value in settings_of(inner, (*path, str(key))).items()
        }
    return {".".join(path): data}
