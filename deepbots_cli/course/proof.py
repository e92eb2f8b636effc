"""The proof of a lesson: its starter earns nothing, its solution everything, each half solution some points in
the order of their names, and cheats earn nothing more than what they were added to.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import yaml

from deepbots_cli.course.grading import Marks, grade
from deepbots_cli.course.lessons import ANSWERS_NAME, HALF, SOLUTION, START, Lesson
from deepbots_cli.course.marking import UNCHANGED, Marker
from deepbots_cli.records import dataclass
from deepbots_cli.words import counted

Cheat = Callable[[Path], None]


@dataclass(frozen=True)
class Proven:
    """One thing that was tried: its points, whether they are as they must be, and what was expected."""

    tried: str
    points: int
    of: int
    is_right: bool
    expected: str
    reason: str = ""


def _changed(change: Callable[[str], str], *, worlds: bool = False) -> Cheat:
    """Return a cheat that changes the text of each step, or of the files that the steps extend."""

    def cheat(folder: Path) -> None:
        for path in _worlds(folder) if worlds else _steps(folder):
            path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")

    return cheat


def _appended(lines: str, *, worlds: bool = False) -> Cheat:
    """Return a cheat that adds a key, or entries to the key that a file has."""
    key = lines.partition(":")[0]

    def changed(text: str) -> str:
        if f"\n{key}:" not in text:
            return f"{text.rstrip()}\n{lines}\n"
        data, added = map(yaml.safe_load, (text, lines))
        merged = data[key] | added[key] if isinstance(data[key], dict) else added[key]
        return yaml.safe_dump(data | {key: merged}, sort_keys=False)

    return _changed(changed, worlds=worlds)


def _replaced(old: str, new: str) -> Cheat:
    return _changed(lambda text: text.replace(old, new))


def _linked(folder: Path) -> None:
    for path in _steps(folder):
        path.unlink()
        path.symlink_to("/etc/hostname")


def _program(folder: Path) -> None:
    (folder / "sitecustomize.py").write_text("raise SystemExit(0)\n", encoding="utf-8")
    (folder / "deepbots_cli").mkdir()
    (folder / "deepbots_cli" / "__init__.py").write_text("raise SystemExit(0)\n", encoding="utf-8")


def _marks(folder: Path) -> None:
    for name in ("marks.json", "course.json", "lesson.yaml"):
        (folder / name).write_text('{"points": 100, "of": 100}\n', encoding="utf-8")
    for name in ("checks", "handed_in", "solution"):
        (folder / name).mkdir(exist_ok=True)


def _run(folder: Path) -> None:
    for path in _steps(folder):
        run = folder / "runs" / f"{path.stem}-99-1"
        run.mkdir(parents=True)
        (run / "run.json").write_text(
            '{"format": 1, "solved": true, "success_rate": 1.0}\n', encoding="utf-8"
        )


def _steps(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.glob("*.yaml")) if "extends:" in path.read_text(encoding="utf-8")]


def _worlds(folder: Path) -> list[Path]:
    return [path for path in folder.glob("*.yaml") if path not in {*_steps(folder), folder / ANSWERS_NAME}]


CHEATS: Mapping[str, Cheat] = {
    "endings of its own": _appended("termination: {success: {now: true}}"),
    "`solved` of its own": _appended("solved: success_rate >= 0 % over 1 episodes"),
    "a limit of one step": _appended("truncation: {max_steps: 1}"),
    "tests of its own": _appended("tests: {easy: {driver: zero, expect: {mean_return: -1e9 .. 1e9}}}"),
    "starts of its own": _appended("reset: {require: 1 > 0}"),
    "other parameters": _appended("parameters: {near: 5 m, fall_angle: 90 deg}"),
    "removed tests": _appended("remove: [tests, termination]"),
    "a training of its own": _appended("train: {algorithm: PPO, total_timesteps: 1}"),
    "signals of the same names": _appended("augment: {apart: 0 m, angle: 0 deg}"),
    "another name": _replaced("name: ", "name: Solution"),
    "another scenario extended": _replaced("extends: world.yaml", "extends: cartpole"),
    "the solution extended": _replaced("extends: world.yaml", f"extends: ../{SOLUTION}/world.yaml"),
    "an easier world": _appended("truncation: {max_steps: 1}", worlds=True),
    "a large file": _appended("# " + "x" * (2 << 20)),
    "deep nesting": _appended("deep: " + "[" * 2000),
    "aliases that grow": _appended(
        "a: &a [1, 1, 1]\nb: &b [*a, *a, *a]\nc: &c [*b, *b, *b]\nd: [*c, *c, *c]"
    ),
    "a link in place of the file": _linked,
    "programs beside the files": _program,
    "marks and checks of its own": _marks,
    "a run whose record is written by hand": _run,
}
"""Cheats that need no knowledge of a lesson."""


def prove(
    lesson: Lesson,
    *,
    train: bool = True,
    workers: int = 1,
    on_marks: Callable[[Marks, int], object] = lambda marks, done: None,
) -> Iterator[Proven]:
    """Yield what each starter, solution, half solution and cheat earns. If the starter or the solution has
    other points than it must, that of the others means nothing, and cheats are not tried.

    Args:
        lesson: The lesson.
        train: Whether to train a policy where the solution and the half solutions need one; without it, these
            checks earn nothing, and are not expected to.
        workers: The number of hand-ins to mark at a time.
        on_marks: Called with the marks of each hand-in, and the number of hand-ins so far.
    """
    without = "" if train else " that need no policy"
    full = lesson.points - (0 if train else _policy_points(lesson))
    folders = [
        (SOLUTION, lesson.folder / SOLUTION),
        (START, lesson.folder / START),
        *(
            (f"{HALF}/{path.name}", path)
            for path in sorted((lesson.folder / HALF).glob("*"))
            if path.is_dir()
        ),
    ]
    graded = grade(lesson, folders, train=train, workers=workers, on_marks=on_marks)
    marks = dict(zip((name for name, _ in folders), graded, strict=True))
    yield _proven(START, marks[START], marks[START].points == 0, "nothing")
    yield from _guards(lesson)
    yield from (
        Proven(name, 0, 0, False, "its pictures", f"there is no {picture}")
        for name in ("text.md", "teacher.md")
        for picture in re.findall(r"!\[[^\]]*\]\(([^):]+)\)", lesson.text(name))
        if not (lesson.folder / picture).is_file()
    )
    yield _proven(
        SOLUTION, marks[SOLUTION], marks[SOLUTION].points == full, f"all {counted(full, 'point')}{without}"
    )
    if marks[START].points or marks[SOLUTION].points != full:
        return
    before = 0
    for name, _ in folders[2:]:
        points = marks[name].points
        # Without trainings, two may differ in their policies only.
        least, most = before + train, full - train
        yield _proven(name, marks[name], least <= points <= most, f"{least} to {most}")
        before = max(before, points)
    yield from _cheats(
        lesson, folders[-1][1], workers, lambda marks, done: on_marks(marks, len(folders) + done)
    )


def _cheats(
    lesson: Lesson, base: Path, workers: int, on_marks: Callable[[Marks, int], object]
) -> Iterator[Proven]:
    """Yield what each cheat that changes anything earns on top of a half solution without a policy."""
    with tempfile.TemporaryDirectory(prefix="deepbots-proof-") as name:
        folders = [("", base)]
        for number, (title, cheat) in enumerate(CHEATS.items()):
            folder = Path(name, str(number))
            shutil.copytree(lesson.folder / START, folder)
            shutil.copytree(base, folder, dirs_exist_ok=True)
            before = _contents(folder)
            cheat(folder)
            if _contents(folder) != before:
                folders.append((title, folder))
        honest, *cheats = grade(lesson, folders, workers=workers, on_marks=on_marks)
        for marks in cheats:
            # A run is read only for a step that was changed.
            is_named = bool(marks.all_remarks) or _reasons(marks) != _reasons(honest)
            is_right = marks.points <= honest.points and (is_named or CHEATS[marks.student] is _run)
            yield _proven(
                f"cheat: {marks.student}", marks, is_right, f"at most {honest.points}, and a remark"
            )


def _guards(lesson: Lesson) -> Iterator[Proven]:
    """Yield the checks that the files of `start` pass as they are, which are to be guards: a change that means
    nothing would earn them."""
    for name, step in lesson.steps.items():
        with tempfile.TemporaryDirectory(prefix="deepbots-proof-") as work:
            marker = Marker(lesson, lesson.folder / START, Path(work), takes_unchanged=True)
            mark = marker.mark(name)
        for check, earned in zip(step.checks, mark.checks, strict=True):
            if earned.points and not check.guard:
                yield Proven(
                    f"{name}: {check.says}",
                    earned.points,
                    earned.of,
                    False,
                    "not by start",
                    "start passes this check: change the files of start, or mark the check `guard: true`",
                )


def _contents(folder: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


def _reasons(marks: Marks) -> list[str]:
    return [check.reason for step in marks.steps for check in step.checks]


def _policy_points(lesson: Lesson) -> int:
    """Return the points of policies, and of guards that have no other check beside them."""
    points = 0
    for step in lesson.steps.values():
        own = [check for check in step.checks if check.kind != "answer" and not check.guard]
        policies = [check for check in step.checks if check.kind == "policy"]
        guards = [check for check in step.checks if check.guard and check not in policies]
        points += sum(check.points for check in (policies + guards if own == policies else policies))
    return points


def _proven(tried: str, marks: Marks, is_right: bool, expected: str) -> Proven:
    reasons = dict.fromkeys(
        f"{step.step}: {check.reason}"
        for step in marks.steps
        for check in step.checks
        if check.points < check.of and check.reason != UNCHANGED
    )
    return Proven(tried, marks.points, marks.of, is_right, expected, "; ".join(reasons))
