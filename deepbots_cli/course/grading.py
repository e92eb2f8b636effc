"""The marks of many hand-ins: each step in a process of its own, with limits on CPU time, memory, the clock,
and the size of its folder. A hand-in that hangs, crashes or fills the disk loses that step only. The folder
of a student who has started a lesson is marked as a hand-in.

Tests and replays give the same marks in every run on machines of one kind. A training is judged by its
evaluation on starts that nobody knew, whose 95 % interval the marks name.
"""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import asdict, field, replace
from datetime import date
from itertools import accumulate, count, islice
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from deepbots_cli.course.copies import without_copies
from deepbots_cli.course.hand_ins import collect
from deepbots_cli.course.lessons import SOLUTION, START, Lesson, lesson_named, shipped_lesson
from deepbots_cli.course.marking import CheckMark, StepMark, guarded, unfinished
from deepbots_cli.errors import StorageError, UsageError
from deepbots_cli.files import atomic_write, check_folder, csv_text, read_at_most
from deepbots_cli.processes import Process, ending
from deepbots_cli.records import dataclass
from deepbots_cli.words import counted, printable

_SUFFIXES = (".zip", ".yaml", ".yml")
"""The suffixes that are not part of the name of a student."""


@dataclass(frozen=True)
class Limits:
    """Limits of the process that marks a step. A step takes 2 to 10 s; a training up to 3 minutes.

    Attributes:
        cpu: s of CPU time.
        clock: s by the clock in which the process uses less than 1 s of CPU time: it hangs, or the machine is
            too busy. The step is then not marked.
        memory: MiB of address space, most of which PyTorch reserves.
        disk: MiB of files that the process writes.
    """

    cpu: int = 60
    clock: float = 300.0
    memory: int = 8192
    disk: int = 500


TRAINING_LIMITS = Limits(cpu=900)


@dataclass(frozen=True)
class Marks:
    """The marks of a student. `refused` is the reason why nothing was marked, and `copies` are remarks for the
    teacher, which name other students."""

    student: str
    lesson: str
    steps: tuple[StepMark, ...]
    remarks: tuple[str, ...] = ()
    refused: str = ""
    copies: tuple[str, ...] = ()

    @property
    def points(self) -> int:
        return sum(step.points for step in self.steps)

    @property
    def of(self) -> int:
        return sum(step.of for step in self.steps)

    @property
    def is_open(self) -> bool:
        """Whether a step was not marked."""
        return any(step.is_open for step in self.steps)

    @property
    def score(self) -> str:
        return "not marked" if self.is_open else f"{self.points} of {self.of}"

    @property
    def all_remarks(self) -> tuple[str, ...]:
        """The remarks about the hand-in and about its steps, each once."""
        if self.refused:
            return (_readable(self.refused), *map(_readable, self.remarks))
        own = [remark for step in self.steps for remark in step.remarks]
        own += [
            f"{step.step}: {check.reason}" for step in self.steps for check in step.checks if check.is_open
        ]
        return tuple(dict.fromkeys(map(_readable, (*self.remarks, *own))))

    @property
    def for_teacher(self) -> tuple[str, ...]:
        """All remarks, those about other students, and the reasons for steps that earn nothing."""
        lost = (
            _readable(f"{step.step}: {step.common_reason}")
            for step in self.steps
            if step.common_reason and not step.points and not self.refused
        )
        return tuple(dict.fromkeys((*self.copies, *self.all_remarks, *lost)))

    def data(self) -> dict[str, Any]:
        """Return the marks as JSON."""
        steps = [
            {key: value for key, value in asdict(step).items() if key not in ("policy", "models", "parts")}
            for step in self.steps
        ]
        return {
            "student": self.student,
            "lesson": self.lesson,
            "points": None if self.is_open else self.points,
            "of": self.of,
            "steps": steps,
            "remarks": [*self.for_teacher],
        }


class Interrupted(KeyboardInterrupt):
    """Ctrl-C while a class is marked; `marks` are those of the hand-ins that were begun."""

    def __init__(self, marks: list[Marks]) -> None:
        self.marks = marks


def hand_ins_of(
    lesson: Lesson, paths: Sequence[Path], outputs: Iterable[Path] = ()
) -> list[tuple[str, Path]]:
    """Return hand-ins with the names of their students: those of files and folders, numbered where two are
    the same. A folder with several entries, and no file of the lesson, stands for all that is in it. The
    `outputs` of an earlier call are none."""
    left_out = set(map(os.path.abspath, outputs))

    def is_hand_in(path: Path) -> bool:
        return os.path.abspath(path) not in left_out

    single: list[Path] = []
    for path in filter(is_hand_in, paths):
        inside = [] if path.is_symlink() or not path.is_dir() else sorted(path.iterdir())
        visible = [entry for entry in filter(is_hand_in, inside) if not entry.name.startswith(".")]
        is_class = len(visible) > 1 and not any((path / name).is_file() for name in lesson.step_files)
        single += visible if is_class else [path]
    named: dict[str, Path] = {}
    for path in single:
        name = _readable(path.stem if path.suffix.lower() in _SUFFIXES else Path(os.path.abspath(path)).name)
        numbers = (f"{name} ({number})" for number in count(2))
        named[next(free for free in (name, *islice(numbers, len(single))) if free not in named)] = path
    return list(named.items())


def _readable(text: str) -> str:
    """Return a text of a file system, whose names may be any bytes, as letters that can be printed."""
    return printable(text.encode("utf-8", "replace").decode())


def grade(
    lesson: Lesson,
    hand_ins: Sequence[tuple[str, Path]],
    *,
    seed: int = 0,
    train: bool = False,
    workers: int = 1,
    limits: Limits | None = None,
    on_marks: Callable[[Marks, int], object] = lambda marks, done: None,
) -> list[Marks]:
    """Return the marks of hand-ins, in their order.

    Args:
        lesson: The lesson.
        hand_ins: Names of students, and what they handed in.
        seed: The root seed of evaluations.
        train: Whether to train policies in place of those that were handed in.
        workers: The number of hand-ins to mark at a time.
        limits: The limits of each step.
        on_marks: Called with the marks of a student once they are known, and the number of students so far.
    """
    limits = limits or (TRAINING_LIMITS if train else Limits())
    lock, stop = threading.Lock(), threading.Event()
    done = 0

    def marked(entry: tuple[str, Path]) -> Marks:
        nonlocal done
        marks = _mark_one(lesson, *entry, {"seed": seed, "train": train}, limits, stop)
        with lock:
            if not stop.is_set():
                done += 1
                on_marks(marks, done)
        return marks

    with ThreadPoolExecutor(max_workers=max(1, workers)) as pool:
        futures = [pool.submit(marked, entry) for entry in hand_ins]
        try:
            # A signal that comes just before a wait does not interrupt it.
            while wait(futures, timeout=1.0).not_done:
                pass
            marks = [future.result() for future in futures]
        except BaseException as error:
            stop.set()
            begun = [future for future in futures if not future.cancel()]
            if not isinstance(error, KeyboardInterrupt):
                raise
            raise Interrupted(judged_together(lesson, [future.result() for future in begun])) from None
    return judged_together(lesson, marks)


def judged_together(lesson: Lesson, marks: Sequence[Marks]) -> list[Marks]:
    """Return the marks of a class: a policy that was copied earns nothing, nor do guards beside it alone."""
    judged = []
    for one in without_copies(lesson, marks):
        steps = (replace(step, checks=guarded(lesson.steps[step.step], step.checks)) for step in one.steps)
        judged.append(replace(one, steps=tuple(steps)))
    return judged


def _mark_one(
    lesson: Lesson,
    student: str,
    path: Path,
    options: Mapping[str, Any],
    limits: Limits,
    stop: threading.Event,
) -> Marks:
    with tempfile.TemporaryDirectory(prefix="deepbots-marks-", ignore_cleanup_errors=True) as name:
        folder = Path(name, "handed_in")
        # One folder for each step, or a step that fills its own would cost the points of the others.
        works = {step: Path(name, "work", step) for step in lesson.steps}
        try:
            folder.mkdir()
            for work in works.values():
                work.mkdir(parents=True)
            files, remarks = collect(path, folder, lesson)
        except Exception as error:  # noqa: BLE001 - libraries raise anything for damaged archives
            is_clear = isinstance(error, UsageError | OSError)
            reason = str(error) if is_clear else f"it is damaged ({type(error).__name__})"
            is_full = isinstance(error, StorageError | OSError)
            steps = tuple(unfinished(*step, reason, is_open=is_full) for step in lesson.steps.items())
            return Marks(student, lesson.name, steps, refused=f"nothing is marked: {reason}")
        request = {"lesson": str(lesson.folder.resolve()), "folder": str(files)}
        marks = [
            _mark_step(lesson, step, {**request, **options, "step": step, "work": str(work)}, limits, stop)
            for step, work in works.items()
        ]
        started = started_in(files)
    if started is not None and lesson.is_shipped and started.reference != lesson.name:
        other = f"it was started as the lesson `{started.reference[:40]}`"
        if not any(mark.points or mark.is_open for mark in marks):
            marks = [unfinished(*step, other) for step in lesson.steps.items()]
            return Marks(student, lesson.name, tuple(marks), refused=f"nothing is right: {other}")
        remarks = (other, *remarks)
    return Marks(student, lesson.name, tuple(marks), remarks)


def _mark_step(
    lesson: Lesson, step: str, request: Mapping[str, Any], limits: Limits, stop: threading.Event
) -> StepMark:
    """Return the marks of a step, which a process of its own finds."""
    heard: dict[str, Any] = {"cpu": 0.0, "checks": []}
    ended: Future[int] = Future()
    work = Path(request["work"])
    process = Process(
        "deepbots_cli.course.marking_process",
        *map(str, (limits.cpu, limits.memory, limits.disk)),
        hear=lambda line: heard.update(json.loads(line)),
        on_end=ended.set_result,
        environment={"TMPDIR": str(work), "OMP_NUM_THREADS": "1", "HOME": str(work)},
        quiet=True,
        apart=True,
    )
    process.send(json.dumps(request).encode() + b"\n")
    used, used_at = 0.0, time.monotonic()
    reason, is_open = "", False
    too_long = f"it took more than {limits.cpu} s of CPU time"
    while not reason and not wait([ended], timeout=1.0).done:
        if heard["cpu"] >= used + 1.0:
            used, used_at = heard["cpu"], time.monotonic()
        if stop.is_set():
            reason, is_open = "not marked: interrupted", True
        elif time.monotonic() - used_at > limits.clock:
            reason, is_open = f"not marked: no CPU time for {limits.clock:.0f} s; mark it again", True
        elif heard["cpu"] > limits.cpu:
            reason = too_long
        elif _size(work) > limits.disk * 2**20:
            reason = f"it wrote more than {limits.disk} MiB"
    process.end()
    word = ending(ended.result())
    if not reason and "step" in heard:
        return TypeAdapter(StepMark).validate_python(heard)
    if not reason and ("failed" in heard or word in ("SIGHUP", "SIGINT", "SIGTERM")):
        reason = f"not marked: {heard.get('failed') or f'its process was ended ({word})'}; mark it again"
        is_open = True
    reasons = {"SIGXCPU": too_long, "SIGKILL": "it took too much time or memory"}
    reason = reason or reasons.get(word, f"the program that marks it ended ({word})")
    finished = (CheckMark(**check) for check in heard["checks"])
    return unfinished(step, lesson.steps[step], reason, [*finished], is_open=is_open)


def _size(folder: Path) -> int:
    total = 0
    # `rglob` fails if the process removes a folder meanwhile, and `walk` does not.
    for place, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):  # a file that it removed
                total += Path(place, name).lstat().st_size
    return total


# Tables


def row_of(marks: Marks) -> dict[str, object]:
    """Return the row of a student in the table of a class."""
    return {
        "student": marks.student,
        "points": marks.score,
        **{step.step: step.score.replace(" of ", "/") for step in marks.steps},
        "remarks": "; ".join(marks.for_teacher),
    }


def as_csv(marks: Iterable[Marks]) -> str:
    """Return a table whose cells no spreadsheet takes for formulas."""
    rows = [
        {
            "student": student_marks.student,
            "points": "" if student_marks.is_open else student_marks.points,
            "of": student_marks.of,
            **{step.step: "" if step.is_open else step.points for step in student_marks.steps},
            "remarks": "; ".join(student_marks.for_teacher),
        }
        for student_marks in marks
    ]
    return csv_text(rows)


PAGE_HEAD = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="generator" content="deepbots grade">
"""
"""The beginning of a page by which `grade` recognizes its own."""
_PAGE = """<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 46rem; margin: 2rem auto; padding: 0 1rem;
       color-scheme: light dark; }}
h1 {{ font-size: 1.4rem; }} h2 {{ font-size: 1.1rem; margin-top: 2rem; }}
table {{ border-collapse: collapse; width: 100%; }}
td {{ border-top: 1px solid #8884; padding: .4rem .6rem .4rem 0; vertical-align: top; }}
td:first-child {{ white-space: nowrap; font-weight: 600; width: 4rem; }}
small {{ opacity: .75; overflow-wrap: anywhere; }}
</style>
<h1>{title}</h1><p><b>{score}</b></p>
{body}
</html>
"""


def heading(lesson: Lesson, marks: Sequence[Marks], seed: int) -> str:
    """Return what points depend on: the lesson with its bars, the date, the seed and the engines."""
    bars = [
        f"{name} {', '.join(map(str, check.policy))}"
        for name, step in lesson.steps.items()
        for check in step.checks
        if check.policy
    ]
    engines = sorted({step.engine for one in marks for step in one.steps if step.engine})
    return (
        f"lesson {lesson.label}, {counted(lesson.points, 'point')}; {date.today()}, seed {seed}"
        + "".join(f", {engine}" for engine in engines)
        + (f"; policies earn points from {'; '.join(bars)}" if bars else "")
    )


def as_page(lesson: Lesson, marks: Marks, seed: int) -> str:
    """Return one page of HTML with the marks of a student, without scripts and links."""
    parts = [f"<p><small>{html.escape(heading(lesson, [marks], seed))}</small></p>"]
    for step in marks.steps:
        rows = "".join(
            f"<tr><td>{check.score}</td><td>{html.escape(check.says)}"
            + (f"<br><small>{html.escape(check.reason)}</small>" if not step.common_reason else "")
            + "</td></tr>"
            for check in step.checks
        )
        goal, reason = html.escape(lesson.steps[step.step].goal), html.escape(step.common_reason)
        parts.append(
            f"<h2>{html.escape(step.step)}: {step.score}</h2><p>{goal}</p><table>{rows}</table>"
            f"<small>{reason}</small>"
        )
    if marks.all_remarks:
        items = "".join(f"<li>{html.escape(remark)}</li>" for remark in marks.all_remarks)
        parts.append(f"<h2>Remarks</h2><ul>{items}</ul>")
    title = html.escape(f"{lesson.label}: {marks.student}")
    score = marks.score if marks.is_open else f"{marks.score} points"
    return PAGE_HEAD + _PAGE.format(title=title, score=score, body="\n".join(parts))


PROGRESS_NAME = "course.json"
_MAX_PROGRESS_BYTES = 65_536


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
        is_folder = Path(self.reference).is_absolute()
        return lesson_named(self.reference) if is_folder else shipped_lesson(self.reference)

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
        """Mark the folder, and keep the points; those of before if it could not be marked."""
        (marks,) = grade(self.lesson(), [(self.folder.resolve().name, self.folder)], workers=workers)
        if not marks.is_open:
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
        data = json.loads(read_at_most(folder / PROGRESS_NAME, _MAX_PROGRESS_BYTES))
        hints = {
            step: max(0, count) for step, count in data.get("hints", {}).items() if isinstance(count, int)
        }
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
    if not solved.is_dir() or lesson.folder.resolve() not in solved.resolve().parents:
        raise UsageError(f"{lesson.folder} has no folder '{solution}'; write `--with {SOLUTION}`")
    check_folder(folder)
    if any(started_in(parent) is not None for parent in folder.resolve().parents):
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
    reference = lesson.name if lesson.is_shipped else str(lesson.folder.resolve())
    Started(folder, reference).write()
