"""A lesson that a student has started: its folder, the points so far, and the hints that were shown."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from dataclasses import field, replace
from itertools import accumulate
from pathlib import Path

from deepbots_cli.course.grading import Marks, grade
from deepbots_cli.course.lessons import SOLUTION, START, Lesson, course_folder, lesson_named
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write, check_folder, read_at_most
from deepbots_cli.records import dataclass

PROGRESS_NAME = "course.json"
_MAX_BYTES = 65_536


@dataclass(frozen=True)
class Started:
    """A started lesson. `hints` counts the hints that were shown, by step.

    The file in the folder is the student's own, so its points are for the list of lessons only.
    """

    folder: Path
    reference: str
    points: int = 0
    hints: Mapping[str, int] = field(default_factory=dict)

    def lesson(self) -> Lesson:
        """Return the lesson.

        Raises:
            UsageError: It is not here: a teacher keeps the checks of an own lesson.
        """
        return lesson_named(self.reference)

    def write(self) -> None:
        data = {"lesson": self.reference, "points": self.points, "hints": dict(self.hints)}
        with atomic_write(self.folder / PROGRESS_NAME) as draft:
            draft.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")

    @property
    def scenario(self) -> Path:
        """The scenario of the first step that the points so far do not fill; that of the last step after it.

        Raises:
            UsageError: As for `lesson`.
        """
        steps = [*self.lesson().steps.items()]
        done = sum(end <= self.points for end in accumulate(step.points for _, step in steps))
        return self.folder / f"{steps[min(done, len(steps) - 1)][0]}.yaml"

    def check(self, workers: int = 1) -> Marks:
        """Mark the folder, and keep the points."""
        (marks,) = grade(self.lesson(), [(self.folder.resolve().name, self.folder)], workers=workers)
        replace(self, points=marks.points).write()
        return marks

    def shown_hints(self, step: str) -> tuple[str, ...]:
        """Return the hints of a step that the student has seen."""
        return tuple(self.lesson().steps[step].hints[: self.hints.get(step, 0)])

    def next_hint(self, step: str) -> tuple[int, str]:
        """Return the number of the next hint of a step and the hint, and count it; the last one stays.

        Raises:
            UsageError: The lesson has no such step, or the step no hints.
        """
        lesson = self.lesson()
        if step not in lesson.steps:
            raise UsageError(f"there is no step '{step}'; the steps are {', '.join(lesson.steps)}")
        hints = lesson.steps[step].hints
        if not hints:
            raise UsageError(f"{step} has no hints; README.md explains what it needs")
        number = min(self.hints.get(step, 0) + 1, len(hints))
        replace(self, hints={**self.hints, step: number}).write()
        return number, hints[number - 1]


def started_in(folder: Path) -> Started | None:
    """Return the lesson that was started in a folder; None without one."""
    try:
        data = json.loads(read_at_most(folder / PROGRESS_NAME, _MAX_BYTES))
        hints = {step: count for step, count in data.get("hints", {}).items() if isinstance(count, int)}
        return Started(folder, str(data["lesson"]), int(data.get("points", 0)), hints)
    except (OSError, OverflowError, ValueError, RecursionError, KeyError, AttributeError, TypeError):
        return None


def start(lesson: Lesson, folder: Path, solution: str | None = None) -> None:
    """Write the files of a lesson for a student into a new folder, perhaps with those of a solution.

    Args:
        lesson: The lesson.
        folder: The new folder.
        solution: The folder of the solution in that of the lesson, such as `half/1-range`.

    Raises:
        UsageError: The folder is not empty, is within that of a lesson, or cannot be written; there is no such
            solution.
    """
    solved = lesson.folder / (solution or START)
    if not solved.is_dir():
        raise UsageError(f"{lesson.folder} has no folder '{solution}'; write `--with {SOLUTION}`")
    check_folder(folder)
    if started_in(folder.resolve().parent) is not None:
        raise UsageError(f"{folder} would be in the folder of another lesson; run `cd ..` first")
    if folder.exists() and any(folder.iterdir()):
        raise UsageError(
            f"{folder} is not empty; name another folder, or go on there with `deepbots course check`"
        )
    for files in (lesson.folder / START, solved):
        shutil.copytree(files, folder, dirs_exist_ok=True)
    if text := lesson.text("text.md"):
        # The pages of links such as `../04-endings/text.md` are not in the folder.
        text = re.sub(r"\[([^\]]+)\]\(\.\./[^)]*\)", r"\1", text)
        (folder / "README.md").write_text(text, encoding="utf-8")
    for picture in (*lesson.folder.glob("*.png"), *lesson.folder.glob("*.svg")):
        shutil.copy(picture, folder)
    reference = lesson.name if lesson.folder.parent == course_folder() else str(lesson.folder.resolve())
    Started(folder, reference).write()
