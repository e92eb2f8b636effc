"""`deepbots course` and `deepbots grade`: lessons that mark themselves, and the marks of a class."""

from __future__ import annotations

import os
from contextlib import suppress
from datetime import date
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepbots_cli import __version__
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    MAX_SEED,
    OUTPUT,
    Force,
    Json,
    Workers,
    check_options,
    integer,
    option,
)
from deepbots_cli.cli.exits import FAILED, INTERRUPTED
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write, check_folder, check_output, read_at_most
from deepbots_cli.processes import available_cores
from deepbots_cli.words import counted, shell_word

if TYPE_CHECKING:
    from deepbots_cli.course.grading import Marks, Started
    from deepbots_cli.course.lessons import Lesson


class Action(StrEnum):
    """What `deepbots course` does."""

    LIST = "list"
    START = "start"
    CHECK = "check"
    HINT = "hint"
    NEXT = "next"
    VERIFY = "verify"


def command(
    ctx: typer.Context,
    action: Annotated[
        Action, typer.Argument(metavar="[list|start|check|hint|next|verify]", help="What to do.")
    ] = Action.LIST,
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="LESSON|DIR",
            help="The lesson to start: its folder, number or name; else the folder of a started lesson, by"
            " default this one; for verify, the folder of a lesson.",
        ),
    ] = None,
    folder: Annotated[
        Path | None, typer.Argument(metavar="DIR", help="For start and next: the new folder.")
    ] = None,
    step: Annotated[
        str | None, option("--step NAME", "For hint: the step, by default the first that lacks points.")
    ] = None,
    solution: Annotated[
        str | None,
        option(
            "--with NAME",
            "For start: add the files of a solution, such as `solution` or `half/1-way`.",
            ADVANCED,
        ),
    ] = None,
    quick: Annotated[
        bool, option("--no-train", "For verify: leave out the checks that train a policy.", ADVANCED)
    ] = False,
    workers: Workers = None,
    as_json: Json = False,
) -> None:
    """Learn in ten lessons that mark themselves."""
    check_options(ctx, action)
    match action:
        case Action.LIST:
            _list(Path(what or "."), as_json=as_json)
        case Action.START:
            if what is None:
                raise UsageError("name a lesson, such as `deepbots course start 1`")
            _start(what, folder, solution, as_json=as_json)
        case Action.CHECK:
            _check(Path(what or "."), workers or 1, as_json=as_json)
        case Action.HINT:
            _hint(Path(what or "."), step, as_json=as_json)
        case Action.NEXT:
            _next(Path(what or "."), folder, solution, as_json=as_json)
        case Action.VERIFY:
            _verify(what or ".", workers or available_cores(), train=not quick, as_json=as_json)


def _list(folder: Path, *, as_json: bool) -> None:
    from deepbots_cli.course.grading import started_in
    from deepbots_cli.course.lessons import shipped_lessons

    folders = (folder, *sorted(path for path in folder.glob("*/") if path.is_dir()))
    started = {one.reference: one for place in folders if (one := started_in(place)) is not None}
    rows: list[Row] = []
    for lesson in shipped_lessons():
        own = started.get(lesson.name)
        rows.append(
            {
                "lesson": lesson.number,
                "title": lesson.content.title,
                "about": lesson.content.summary,
                "minutes": lesson.content.minutes,
                "points": "" if own is None else f"{own.points} of {lesson.points}",
                "folder": "" if own is None else str(own.folder),
            }
        )
    commands = [
        f"check {shell_word(str(row['folder']))}"
        for row in rows
        if len({*str(row["points"]).split(" of ")}) == 2
    ]
    commands += [f"start {row['lesson']}" for row in rows if not row["points"]]
    terminal.show(
        rows,
        table(rows, is_prose=True),
        as_json=as_json,
        next_commands=[f"deepbots course {command}" for command in commands[:1]],
    )


def _start(name: str, folder: Path | None, solution: str | None, *, as_json: bool) -> None:
    from deepbots_cli.course.grading import start
    from deepbots_cli.course.lessons import ANSWERS_NAME, lesson_named

    lesson = lesson_named(name)
    folder = folder or Path(f"lesson-{lesson.number}-{lesson.name}" if lesson.number else lesson.name)
    start(lesson, folder, solution)
    rows = [
        {"step": step_name, "points": step.points, "goal": step.goal}
        for step_name, step in lesson.steps.items()
    ]
    # A step with nothing but answers has no scenario.
    scenario = next((name for name in lesson.step_files if name != ANSWERS_NAME), ".")
    terminal.show(
        {"lesson": lesson.name, "folder": folder, "steps": rows},
        f"lesson {lesson.label}, about {lesson.content.minutes} minutes, in {folder}"
        f"{'; its text is README.md' if lesson.text('text.md') else ''}\n",
        table(rows, is_prose=True),
        as_json=as_json,
        next_commands=[
            f"cd {shell_word(folder)}",
            f"deepbots studio {shell_word(scenario)} --open",
            "deepbots course check",
        ],
    )


def _opened(folder: Path) -> Started:
    """Return the lesson that was started in a folder."""
    from deepbots_cli.course.grading import PROGRESS_NAME, started_in

    started = started_in(folder)
    if started is None:
        raise UsageError(
            f"no lesson was started in {folder if str(folder) != '.' else 'this folder'}: it has no"
            f" {PROGRESS_NAME}; start one with `deepbots course start 1`"
        )
    return started


def _check(folder: Path, workers: int, *, as_json: bool) -> None:
    started = _opened(folder)
    with terminal.transient_line("checking ..."):
        marks = started.check(workers)
    open_step = next((step for step in marks.steps if step.points < step.of), None)
    following = ["next"] if open_step is None else ["hint", "--step", open_step.step]
    following[1:1] = [] if folder == Path() else [shell_word(folder)]
    lines = _lines(started.lesson(), marks)
    terminal.show(
        marks.data(), *lines, as_json=as_json, next_commands=[f"deepbots course {' '.join(following)}"]
    )
    if open_step is not None:
        raise typer.Exit(FAILED)


def _lines(lesson: Lesson, marks: Marks) -> list[str]:
    """Return the marks of a student as text: each check with its points, and the reason for missing ones."""
    lines = [f"lesson {lesson.label}: {marks.score if marks.is_open else f'{marks.score} points'}"]
    for step in marks.steps:
        lines += ["", f"  {step.step}  {step.score}"]
        for check in step.checks:
            lines.append(f"    {'+' if check.points == check.of else '-'} {check.score}  {check.says}")
            if check.reason and not step.common_reason:
                lines.append(f"           {check.reason}")
        if step.common_reason:
            lines.append(f"           {step.common_reason}")
    remarks = (*marks.copies, *marks.all_remarks)
    lines += ["", *(f"  note: {remark}" for remark in remarks)] if remarks else []
    return lines


def _hint(folder: Path, name: str | None, *, as_json: bool) -> None:
    started = _opened(folder)
    if name is None:
        with terminal.transient_line("checking ..."):
            marks = started.check()
        started = _opened(folder)  # with the points of the check
        name = next((step.step for step in marks.steps if step.points < step.of), None)
        if name is None:
            terminal.show({}, "all points are reached; go on with `deepbots course next`", as_json=as_json)
            return
    number, hint = started.next_hint(name)
    count = len(started.lesson().steps[name].hints)
    more = "" if number == count else "; the next call leads further"
    data = {"step": name, "number": number, "of": count, "hint": hint}
    terminal.show(data, f"{name}, hint {number} of {count}{more}\n\n  {hint}", as_json=as_json)


def _next(folder: Path, into: Path | None, solution: str | None, *, as_json: bool) -> None:
    from deepbots_cli.course.lessons import shipped_lessons

    lesson = _opened(folder).lesson()
    following = next((other for other in shipped_lessons() if other.number == lesson.number + 1), None)
    if following is None or not lesson.is_shipped:
        last = "this was the last lesson" if lesson.is_shipped else f"no lesson follows {lesson.label}"
        terminal.show({}, f"{last}; `deepbots course` lists those of deepbots", as_json=as_json)
        return
    into = into or folder.resolve().parent / f"lesson-{following.number}-{following.name}"
    _start(str(following.folder), into, solution, as_json=as_json)


def _verify(name: str, workers: int, *, train: bool, as_json: bool) -> None:
    from deepbots_cli.course.lessons import HALF, lesson_named
    from deepbots_cli.course.proof import CHEATS, Proven, prove

    lesson = lesson_named(name)
    # with start, solution, and one to cheat with
    total = len(CHEATS) + 3 + len([*(lesson.folder / HALF).glob("*/")])
    with terminal.progress("hand-ins", always=False) as show:
        show(0, total)
        proven, is_complete = list[Proven](), True
        marked = prove(lesson, train=train, workers=workers, on_marks=lambda _, done: show(done, total))
        try:
            proven.extend(marked)
        except KeyboardInterrupt:
            is_complete = False
    rows = [
        {
            "tried": one.tried,
            "points": f"{one.points} of {one.of}" if one.of else "",
            "expected": one.expected,
            "result": "right" if one.is_right else "WRONG",
            "why": "" if one.is_right else one.reason,
        }
        for one in proven
    ]
    wrong = sum(not one.is_right for one in proven)
    verdict = "the lesson is proven" if train else "the lesson is proven without the checks of policies"
    if wrong:
        verdict = f"{counted(wrong, 'line')} above {'is' if wrong == 1 else 'are'} wrong"
        if not any(one.tried.startswith("cheat") for one in proven):
            verdict += "; cheats are tried once start and solution earn the right points"
    if not is_complete:
        verdict = f"interrupted after {counted(len(proven), 'hand-in')}"
    verdict += f"; {sum(os.times()[:4]):.0f} s of CPU time"
    terminal.show([vars(one) for one in proven], table(rows, is_prose=True), "", verdict, as_json=as_json)
    if wrong or not is_complete:
        raise typer.Exit(FAILED if is_complete else INTERRUPTED)


def command_grade(
    lesson_name: Annotated[
        str, typer.Argument(metavar="LESSON", help="The folder, number or name of a lesson.")
    ],
    hand_ins: Annotated[
        list[Path],
        typer.Argument(
            metavar="HANDED_IN...",
            help="What students handed in, named after them: folders, zips, or a folder with all of them.",
        ),
    ],
    seed: Annotated[
        int, integer("--seed N", "Root seed of evaluations; take one that students do not know.", 0, MAX_SEED)
    ] = 0,
    train: Annotated[
        bool,
        option("--train", "Train a policy for each hand-in, in place of the one that was handed in."),
    ] = False,
    csv: Annotated[
        Path | None, option("--csv FILE", "Write a table with a line for each student.", OUTPUT)
    ] = None,
    html: Annotated[
        Path | None, option("--html DIR", "Write a page for each student into a new folder.", OUTPUT)
    ] = None,
    force: Force = False,
    workers: Workers = None,
    as_json: Json = False,
) -> None:
    """Mark what students handed in."""
    from deepbots_cli.course.grading import (
        Interrupted,
        as_csv,
        grade,
        hand_ins_of,
        heading,
        row_of,
    )
    from deepbots_cli.course.lessons import lesson_named

    lesson = lesson_named(lesson_name)
    check_output(*filter(None, (csv,)), force=force)
    if html is not None:
        check_folder(html)
        if html.exists() and any(html.iterdir()) and not force:
            raise UsageError(f"{html} is not empty; name another folder, or add --force")
    students = hand_ins_of(lesson, hand_ins, filter(None, (csv, html)))
    finished: list[Marks] = []

    def save(marks: list[Marks]) -> None:
        if csv is not None and marks:
            with atomic_write(csv) as draft:
                draft.write_text(as_csv(marks), encoding="utf-8-sig")

    with terminal.progress("hand-ins", always=False) as show:

        def keep(marks: Marks, done: int) -> None:
            show(done, len(students))
            finished.append(marks)
            with suppress(UsageError):  # a full disk, which the last save reports
                save(finished)

        show(0, len(students))  # a training takes minutes
        try:
            cores, is_complete = workers or available_cores(), True
            marks = grade(lesson, students, seed=seed, train=train, workers=cores, on_marks=keep)
        except Interrupted as interruption:
            marks, is_complete = interruption.marks, False
    lines = [heading(lesson, marks, seed)]
    lines += (
        _lines(lesson, marks[0])[1:] if len(marks) == 1 else [table([*map(row_of, marks)], is_prose=True)]
    )
    if not seed:
        terminal.note("students can try seed 0: --seed N takes starts that they do not know")
    about = {"seed": seed, "date": str(date.today()), "version": __version__}
    terminal.show([{**one.data(), **about} for one in marks], *lines, as_json=as_json)
    save(marks)
    if html is not None:
        _write_pages(html, lesson, marks, seed)
    if not is_complete:
        terminal.note(f"interrupted: {len(finished)} of {counted(len(students), 'hand-in')} are marked")
        raise typer.Exit(INTERRUPTED)
    if any(one.is_open for one in marks):
        terminal.note("mark the hand-ins again that are `not marked`")
        raise typer.Exit(FAILED)


def _write_pages(folder: Path, lesson: Lesson, all_marks: list[Marks], seed: int) -> None:
    """Write a page for each student in place of those of an earlier class."""
    from deepbots_cli.course.grading import PAGE_HEAD, as_page

    folder.mkdir(parents=True, exist_ok=True)
    for page in folder.glob("*.html"):
        if page.is_file() and read_at_most(page, len(PAGE_HEAD)) == PAGE_HEAD.encode():
            page.unlink()
    for number, marks in enumerate(all_marks, 1):
        name = "".join(c if c.isalnum() or c in "-_ " else "_" for c in marks.student)[:60]
        (folder / f"{number:02} {name}.html").write_text(as_page(lesson, marks, seed), encoding="utf-8")
