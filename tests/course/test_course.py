"""Lessons, hand-ins and marks: a small lesson on a cart, marked in this process; limits, in processes."""

import csv
import io
import json
import os
import re
import shutil
import signal
import stat
import subprocess
import threading
import zipfile
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.course import grading
from deepbots_cli.course.copies import Weights, weights_of, without_copies
from deepbots_cli.course.evidence import unexplained
from deepbots_cli.course.grading import Limits, Marks, as_csv, as_page, grade, hand_ins_of, judged_together
from deepbots_cli.course.hand_ins import HandInError, collect, read_step, write_parts
from deepbots_cli.course.hand_ins import _mentions as mentions
from deepbots_cli.course.lessons import Lesson, course_folder, lesson_named, read_lesson, shipped_lessons
from deepbots_cli.course.marking import CheckMark, Marker, StepMark, is_right
from deepbots_cli.course.proof import CHEATS, prove
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import train
from deepbots_cli.learning.policy import loaded
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3.models import save
from deepbots_cli.processes import Process, python_command, python_environment
from tests.commands import Deepbots, until
from tests.few import few

LESSON = """
title: Small
summary: A cart.
steps:
  mend:
    goal: Mend the reward.
    parts: [reward, augment]
    forbidden: [velocity]
    checks:
      - {test: pays, points: 2, says: driving forward pays, fails: {mean_return: "it earns {measured}"}}
      - {without: DB101, guard: true, points: 1, says: no unknown keys}
    hints: [first, second]
  sense:
    goal: Add a sensor.
    parts: [robots.cart.sensors]
    sensors: [joint_position]
    checks: [{test: sees, points: 2, says: the sensor sees the pole, fails: {eventually: "`angle` reads {abs(cart.angle)}"}}]
  know:
    goal: Answer.
    checks:
      - {answer: length, right: [30 .. 40 cm], points: 1, says: the length}
      - {answer: fair, right: ["no"], points: 1, says: whether it is fair}
"""
TASK = """
deepbots: 1
extends: cartpole
name: Task
remove: [augment, observation, robots.cart.sensors, reward, solved, train, termination]
augment: {AUGMENT}
robots: {cart: {sensors: {SENSORS}}}
observation: {cart.angle: -20 .. 20 deg}
reward: {REWARD}
tests:
  pays: {actions: [forward, forward, forward], expect: {mean_return: 0.001 .. 1e9}}
  sees: {actions: [forward, forward], expect: {eventually: abs(cart.angle) > 0 rad}}
"""
SENSOR = "{angle: {type: joint_position, joint: pole_hinge}}"
STEP = "deepbots: 1\nname: Own\n\naugment: {x: position(cart).x}\nreward:\n  onward: %s * delta(x) / m\n"
SENSE = "deepbots: 1\nname: Own\nrobots:\n  cart:\n    sensors: %s\n"


def put(folder: Path, **files: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / f"{name}.yaml").write_text(text)
    return folder


def task(augment: str = "{x: position(cart).x}", sensors: str = SENSOR, reward: str = "{alive: 1}") -> str:
    return TASK.replace("{AUGMENT}", augment).replace("{SENSORS}", sensors).replace("{REWARD}", reward)


@pytest.fixture(scope="module")
def lesson(tmp_path_factory: pytest.TempPathFactory) -> Lesson:
    folder = tmp_path_factory.mktemp("lessons") / "1-small"
    put(folder, lesson=LESSON)
    own = "{include: handed_in/reward.yaml}"
    put(
        folder / "checks",
        mend=task(augment="{include: handed_in/augment.yaml}", reward=own),
        sense=task(sensors="{include: handed_in/robots.cart.sensors.yaml}"),
    )
    put(folder / "start", mend=STEP % "-1", sense=SENSE % "{}", answers="length:\nfair:\n")
    put(folder / "solution", mend=STEP % "1", sense=SENSE % SENSOR, answers="length: 0.35 m\nfair: No\n")
    put(folder / "half" / "1-reward", mend=STEP % "1", sense=SENSE % "{}")
    return read_lesson(folder)


def marks_of(lesson: Lesson, folder: Path, work: Path) -> list[StepMark]:
    return [Marker(lesson, folder, work / name).mark(name) for name in lesson.steps]


def test_a_starter_earns_nothing_a_solution_everything_and_a_half_solution_its_part(
    lesson: Lesson, tmp_path: Path
) -> None:
    earned = {
        name: [
            mark.points for mark in marks_of(lesson, lesson.folder / name, tmp_path / name.replace("/", "-"))
        ]
        for name in ("start", "solution", "half/1-reward")
    }
    assert earned == {"start": [0, 0, 0], "solution": [3, 2, 2], "half/1-reward": [3, 0, 0]}


def test_a_finding_names_the_line_of_the_student(lesson: Lesson, tmp_path: Path) -> None:
    put(tmp_path / "own", mend=STEP.replace("delta(x)", "delta(y)") % "1")
    mark = Marker(lesson, tmp_path / "own", tmp_path / "work").mark("mend")
    assert mark.points == 0
    assert mark.checks[0].reason.startswith("mend.yaml:6:21: unknown name `y` (DB402)")


@pytest.mark.parametrize(
    ("step", "text", "reason"),
    [
        ("mend", STEP % "-1", "it earns -"),
        (
            "sense",
            SENSE % SENSOR.replace("pole_hinge", "pole_hinge, range: 0 .. 0.001 deg"),
            "`angle` reads 0 deg",
        ),
        (
            "sense",
            SENSE % SENSOR.replace("angle", "angel"),
            "sense.yaml does not fit a test of the teacher (checks/sense.yaml:8): unknown name `cart.angle` (DB402);"
            " did you mean `cart.angel`?",
        ),
    ],
)
def test_a_failed_test_says_what_the_robot_of_the_student_did(
    lesson: Lesson, tmp_path: Path, step: str, text: str, reason: str
) -> None:
    own = put(tmp_path / "own", **{step: text})
    mark = Marker(lesson, own, tmp_path / "work", takes_unchanged=True).mark(step)
    assert mark.checks[0].reason.startswith(reason)


@pytest.mark.parametrize(
    ("step", "text", "reason"),
    [
        (
            "mend",
            STEP % "1" + "  include: other.yaml\n",
            "`include` may not stand in `reward` (mend.yaml:7:12)",
        ),
        (
            "mend",
            STEP.replace("position(cart).x", "velocity(cart).x") % "1",
            "`velocity` may not be used in `augment`",
        ),
        ("mend", "reward: [1]\n", "mend.yaml:1:9: "),
        ("mend", "reward: {a: 1\n", "mend.yaml cannot be read: mend.yaml:"),
        ("mend", "reward: {a: *b}\n", "mend.yaml cannot be read: mend.yaml:"),
        ("mend", "# " + "x" * (2 << 20), "the file is larger than 1 MiB"),
        (
            "sense",
            SENSE % "{angle: {type: camera, link: cart}}",
            "a sensor of type `camera` is not allowed",
        ),
        ("sense", None, "there is no sense.yaml"),
    ],
)
def test_a_part_that_no_part_may_be_earns_nothing(
    lesson: Lesson, tmp_path: Path, step: str, text: str | None, reason: str
) -> None:
    own = put(tmp_path / "own", **({} if text is None else {step: text}))
    mark = Marker(lesson, own, tmp_path / "work").mark(step)
    assert mark.points == 0
    assert reason in mark.checks[0].reason


def test_a_lesson_may_name_what_its_parts_use(lesson: Lesson, tmp_path: Path) -> None:
    text = LESSON.replace("forbidden: [velocity]", "allowed: [x, delta, position, cart]")
    put(tmp_path / "lesson", lesson=text)
    for name in ("start", "checks"):
        shutil.copytree(lesson.folder / name, tmp_path / "lesson" / name)
    earned = {}
    for number, reward in enumerate(("delta(x)", "ground_distance(cart, cart)")):
        own = put(tmp_path / str(number), mend=STEP.replace("delta(x)", reward) % "1")
        marker = Marker(read_lesson(tmp_path / "lesson"), own, tmp_path / f"work{number}")
        mark = marker.mark("mend")
        earned[reward] = mark.points, mark.checks[0].reason[:17]
    assert earned == {"delta(x)": (3, ""), "ground_distance(cart, cart)": (0, "`ground_distance`")}


@pytest.mark.parametrize(
    ("text", "word", "is_used"),
    [
        ("velocity(car).x", "x", False),
        ("cart.tip.angle", "cart.angle", False),
        ("stepped", "step", False),
        ("2 * cart . angle", "cart.angle", True),
        ("cart.angle", "cart", True),
        ("reached: x > 1 m", "x", True),
    ],
)
def test_a_forbidden_name_is_one_that_the_parser_finds(text: str, word: str, is_used: bool) -> None:
    assert mentions(text, word) == is_used


def test_a_part_may_use_an_alias(lesson: Lesson, tmp_path: Path) -> None:
    text = STEP.replace("name: Own", "name: &way delta(x) / m").replace("%s * delta(x) / m", "*way")
    assert Marker(lesson, put(tmp_path / "own", mend=text), tmp_path / "work").mark("mend").points == 3


def test_a_key_that_is_indented_too_little_is_named(lesson: Lesson, tmp_path: Path) -> None:
    text = SENSE.replace("name: Own", "extends: cartpole\nname: Own") % "{}"
    put(tmp_path / "own", sense=text + "    angle: {type: joint_position, joint: pole_hinge}\n")
    mark = Marker(lesson, tmp_path / "own", tmp_path / "work").mark("sense")
    assert mark.points == 0
    assert mark.checks[0].reason.startswith("not changed yet; sense.yaml:7:5: ")


def test_a_world_that_is_not_handed_in_is_no_mistake_of_an_unchanged_file(
    lesson: Lesson, tmp_path: Path
) -> None:
    own = put(tmp_path / "own", sense=SENSE.replace("name: Own", "extends: world.yaml\nname: Own") % "{}")
    mark = Marker(lesson, own, tmp_path / "work").mark("sense")
    assert {check.reason for check in mark.checks} == {"not changed yet"}


@pytest.mark.parametrize("lesson", shipped_lessons(), ids=lambda lesson: lesson.name)
def test_a_sentence_of_a_failed_check_has_only_values_that_its_test_compares(
    lesson: Lesson, tmp_path: Path
) -> None:
    for name, step in lesson.steps.items():
        tests = [check for check in step.checks if check.fails]
        if not tests:
            continue
        solution = lesson.folder / "solution"
        for folder in ("start", "checks"):
            shutil.copytree(lesson.folder / folder, tmp_path / name / folder)
        (tmp_path / name / "deepbots.toml").touch()
        written = read_step(solution, name, step, lesson.folder / "start")
        write_parts(written, step, solution, tmp_path / name / "checks")
        compiled = api.load(tmp_path / name / "checks" / f"{name}.yaml", tests=True)
        by_name = {test.name: test for test in compiled.tests}
        for check in tests:
            for expected in by_name[check.test or ""].expected:
                used = set(re.findall(r"{(.*?)}", check.fails.get(expected.key, "")))
                assert used <= {"measured", *(value.text for value in expected.compared)}, check.says


def test_what_the_task_has_itself_is_without_effect_and_named(lesson: Lesson, tmp_path: Path) -> None:
    softened = (
        STEP % "-1" + "truncation: {max_steps: 1}\ntests: {pays: {driver: zero}}\nextends: pit_escape\n"
    )
    put(tmp_path / "own", mend=softened.replace("-1 *", "-2 *"))
    mark = Marker(lesson, tmp_path / "own", tmp_path / "work").mark("mend")
    assert mark.points == 0
    assert mark.remarks == (
        "changes of `extends`, `tests.pays`, `truncation.max_steps` in mend.yaml have no effect on the marks",
    )


@pytest.mark.parametrize(
    ("answer", "right", "expected"),
    [
        ("0.35 m", "30 .. 40 cm", True),
        ("35", "30 .. 40 cm", False),
        ("35 s", "30 .. 40 cm", False),
        ("3.5", "3 .. 4", True),
        ("90 deg", "1.5 .. 1.6 rad", True),
        ("35 %", "0.3 .. 0.4", True),
        (" The  Left wheel", "the left wheel", True),
        ("nan", "3 .. 4", False),
        ("3 .. 4", "3 .. 4", False),
        ("true", True, True),
        ("true", "yes", True),
        ("2", 2, True),
        ("", "no", False),
    ],
)
def test_an_answer_is_right_in_any_unit_of_its_kind(answer: str, right: str | float, expected: bool) -> None:
    assert is_right(answer, right) is expected


def archive(path: Path, members: dict[str, bytes], link: str | None = None) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for name, content in members.items():
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            if name == link:
                info.external_attr = (stat.S_IFLNK | 0o777) << 16
            out.writestr(info, content)
    return path


STEP_BYTES = (STEP % "1").encode()


@pytest.mark.parametrize(
    ("members", "reason"),
    [
        ({"../mend.yaml": b"a: 1"}, "the zip has a file outside of it: ../mend.yaml"),
        ({"/etc/mend.yaml": b"a: 1"}, "the zip has a file outside of it"),
        ({"C:\\mend.yaml": b"a: 1"}, "the zip has a file outside of it"),
        ({"mend.yaml": STEP_BYTES, "big.bin": bytes(201 << 20)}, "it is larger than 200 MiB when unpacked"),
        ({f"{number}.txt": b"" for number in range(2001)}, "it has more than 2,000 files"),
        (
            {"notes.txt": b"nothing"},
            "it has none of the files of this lesson: mend.yaml, sense.yaml, answers.yaml",
        ),
        ({}, "it is empty"),
    ],
)
def test_a_zip_that_cannot_be_marked(
    lesson: Lesson, tmp_path: Path, members: dict[str, bytes], reason: str
) -> None:
    path = archive(tmp_path / "ada.zip", members)
    (tmp_path / "into").mkdir()
    with pytest.raises(HandInError) as error:
        collect(path, tmp_path / "into", lesson)
    assert reason in str(error.value)


def test_a_zip_with_a_folder_around_and_a_link(lesson: Lesson, tmp_path: Path) -> None:
    members = {
        "ada/mend.yaml": STEP_BYTES,
        "ada/sense.yaml": b"/etc/passwd",
        "ada/run.py": b"1",
        "ada/notes 10:30.png": b"",
        "__MACOSX/a": b"",
    }
    path = archive(tmp_path / "ada.zip", members, link="ada/sense.yaml")
    (tmp_path / "into").mkdir()
    files, remarks = collect(path, tmp_path / "into", lesson)
    assert sorted(file.name for file in files.iterdir()) == ["mend.yaml", "notes 10:30.png", "run.py"]
    assert remarks[:2] == (
        "sense.yaml is a symbolic link, which is not followed",
        "run.py: programs are not run, so they have no effect",
    )


def test_a_zip_in_a_folder_of_a_learning_platform_is_opened(lesson: Lesson, tmp_path: Path) -> None:
    (tmp_path / "Ada_1234_file").mkdir()
    with zipfile.ZipFile(tmp_path / "Ada_1234_file" / "lesson 1.ZIP", "w") as archive:
        archive.writestr("lesson-1/mend.yaml", STEP % "1")
    (tmp_path / "into").mkdir()
    folder, remarks = collect(tmp_path / "Ada_1234_file", tmp_path / "into", lesson)
    assert ((folder / "mend.yaml").read_text(), remarks) == (STEP % "1", ())


def test_the_hidden_files_of_a_folder_get_no_remark(lesson: Lesson, tmp_path: Path) -> None:
    put(tmp_path / "ada", mend=STEP % "1")
    (tmp_path / "ada" / ".DS_Store").touch()
    (tmp_path / "into").mkdir()
    assert collect(tmp_path / "ada", tmp_path / "into", lesson)[1] == ()


@given(st.binary(max_size=300))
def test_a_damaged_zip_is_refused_or_opened(
    lesson: Lesson, tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    folder = tmp_path_factory.mktemp("zip")
    whole = archive(folder / "ada.zip", {"mend.yaml": STEP_BYTES}).read_bytes()
    (folder / "ada.zip").write_bytes(data + whole[len(data) :])
    (folder / "into").mkdir()
    with suppress(HandInError):
        assert collect(folder / "ada.zip", folder / "into", lesson)[0] == folder / "into"


def test_students_are_named_by_their_files(lesson: Lesson, tmp_path: Path) -> None:
    handed_in = tmp_path / "handed_in"
    put(handed_in / "ada", mend=STEP % "1")
    (handed_in / "lea").symlink_to(handed_in / "ada")
    archive(handed_in / "ada.zip", {})
    archive(handed_in / "José ß.ZIP", {})
    (handed_in / ".DS_Store").touch()
    (handed_in / "notes.txt").touch()
    assert [name for name, _ in hand_ins_of(lesson, [handed_in])] == [
        "José ß",
        "ada",
        "ada (2)",
        "lea",
        "notes.txt",
    ]
    assert [name for name, _ in hand_ins_of(lesson, [handed_in / "ada"])] == ["ada"]


@pytest.fixture(scope="module")
def slow(lesson: Lesson, tmp_path_factory: pytest.TempPathFactory) -> Lesson:
    """Return the lesson with a second check in its second step that takes minutes."""
    folder = tmp_path_factory.mktemp("lessons") / "2-slow"
    shutil.copytree(lesson.folder, folder)
    end_of_checks = '(cart.angle)}"}}'
    more = end_of_checks + ", {test: endless, points: 3, says: it takes long}"
    put(folder, lesson=LESSON.replace(end_of_checks, more))
    text = task(sensors="{include: handed_in/robots.cart.sensors.yaml}")
    endless = "  endless: {driver: random, episodes: 1000, expect: {mean_return: 0.001 .. 1e9}}\n"
    put(folder / "checks", sense=text + endless)
    return read_lesson(folder)


def test_a_step_beyond_its_limits_keeps_the_checks_that_were_finished(slow: Lesson, tmp_path: Path) -> None:
    hand_ins = [("slow", slow.folder / "solution"), ("gone", tmp_path / "gone")]
    marks = grade(slow, hand_ins, limits=Limits(cpu=4))
    assert [[step.points for step in one.steps] for one in marks] == [[3, 2, 2], [0, 0, 0]]
    assert marks[0].steps[1].checks[1].reason == "it took more than 4 s of CPU time"
    assert marks[1].refused == "nothing is marked: it does not exist"


def test_a_step_that_a_busy_machine_did_not_mark_is_no_zero(slow: Lesson) -> None:
    (marks,) = grade(slow, [("ada", slow.folder / "solution")], limits=Limits(clock=0.0))
    assert (marks.is_open, marks.data()["points"]) == (True, None)
    student, points, of, _, sense, *_ = [*csv.reader(io.StringIO(as_csv([marks])))][1]
    assert (student, points, of, sense) == ("ada", "", "10", "")
    assert "not marked: no CPU time for 0 s" in as_page(slow, marks, 0)


@pytest.mark.skipif(os.name == "nt", reason="there is no such limit")
def test_a_disk_that_is_full_leaves_steps_unmarked_and_no_zeros(lesson: Lesson) -> None:
    (marks,) = grade(lesson, [("ada", lesson.folder / "solution")], limits=Limits(disk=0))
    assert [step.score for step in marks.steps] == ["not marked", "not marked", "2 of 2"]
    assert marks.all_remarks[0].startswith("mend: not marked: [Errno 27] File too large")


@pytest.mark.skipif(os.name == "nt", reason="there is no such signal")
def test_a_process_that_another_program_ends_leaves_its_step_unmarked(
    slow: Lesson, monkeypatch: pytest.MonkeyPatch, deepbots: Deepbots
) -> None:
    def ended(*arguments: str, **options: Any) -> Process:
        process = Process(*arguments, **options)
        threading.Timer(0.1, end, (process.pid,)).start()
        return process

    def end(number: int) -> None:
        with suppress(ProcessLookupError):  # it has ended by itself
            os.kill(number, signal.SIGTERM)

    monkeypatch.setattr(grading, "Process", ended)
    (marks,) = json.loads(deepbots("grade", slow.folder, slow.folder / "solution", "--json", code=1).out)
    assert marks["points"] is None
    assert marks["remarks"][0] == "mend: not marked: its process was ended (SIGTERM); mark it again"


def test_the_progress_of_a_class_begins_before_the_first_hand_in_is_marked(
    lesson: Lesson, deepbots: Deepbots, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[int] = []
    monkeypatch.setattr("deepbots_cli.cli.terminal._LINE_INTERVAL_S", 0.0)
    monkeypatch.setattr("deepbots_cli.cli.terminal.ProgressBar.update", lambda _, count: shown.append(count))
    deepbots("grade", lesson.folder, "gone")
    assert shown == [0, 1]


def test_pages_of_students_of_an_earlier_class_are_not_left_among_those_of_this_one(
    lesson: Lesson, deepbots: Deepbots, tmp_path: Path
) -> None:
    for name in ("ada", "bob"):
        (tmp_path / name).mkdir()
        put(tmp_path / "marks", notes="mine")
        deepbots("grade", lesson.folder, name, "--html", "marks", "--force")
    assert sorted(path.name for path in (tmp_path / "marks").iterdir()) == ["01 bob.html", "notes.yaml"]


@pytest.mark.skipif(os.name == "nt", reason="there is no such signal")
@pytest.mark.parametrize(
    "number", few([signal.SIGINT, signal.SIGTERM], ["SIGTERM"], lambda number: number.name)
)
def test_an_interrupted_class_keeps_the_marks_of_the_finished_hand_ins(
    slow: Lesson, tmp_path: Path, number: signal.Signals
) -> None:
    handed_in = tmp_path / "handed_in"
    put(handed_in / "ada", answers="length: 0.35 m\nfair: no\n")
    shutil.copytree(slow.folder / "solution", handed_in / "bob")
    arguments = ["grade", str(slow.folder), str(handed_in), "--csv", "marks.csv", "--workers", "1"]
    process = subprocess.Popen(
        python_command("deepbots_cli", *arguments),
        env=python_environment(),
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell ignores the signal in the background, and so would the process.
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    )
    table = tmp_path / "marks.csv"
    until(table.is_file, 120)
    assert table.read_text().splitlines()[1].startswith("ada,2,10,")
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted: 1 of 2 hand-ins are marked" in err
    assert "not marked" in next(line for line in out.splitlines() if "bob" in line)
    assert [line[:4] for line in table.read_text().splitlines()[1:]] == ["ada,", "bob,"]


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="only Linux lists the children of a process")
def test_a_grader_that_is_killed_leaves_no_process(slow: Lesson, tmp_path: Path) -> None:
    process = subprocess.Popen(
        python_command("deepbots_cli", "grade", str(slow.folder), str(slow.folder / "solution")),
        env=python_environment({"TMPDIR": str(tmp_path)}),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    tasks = Path(f"/proc/{process.pid}/task")
    started = until(lambda: " ".join(task.read_text() for task in tasks.glob("*/children")).split())
    process.kill()
    process.wait()
    assert until(lambda: not any(Path("/proc", number).is_dir() for number in started))


def given_marks(
    student: str,
    policy: float | None = None,
    parts: str = "",
    step: str = "complete",
    extra: float | None = None,
) -> Marks:
    """Return full marks for a step, with a policy and another model whose weights are these numbers."""
    checks = tuple(
        CheckMark(check.says, check.points, check.points)
        for check in lesson_named("reward").steps[step].checks
    )
    judged, other = (
        None if number is None else Weights(f"{step}-0-1/{name}.zip", 8, (number, 1.0))
        for name, number in (("best", policy), ("step", extra))
    )
    models = tuple(filter(None, (judged, other)))
    return Marks(student, "reward", (StepMark(step, checks, (), judged, models, parts),))


def test_a_policy_of_two_students_is_named_and_earns_nothing_where_their_parts_or_steps_differ() -> None:
    class_marks = [
        given_marks("ada", 1.0, "p"),
        given_marks("bob", 1.001, "q"),  # a copy with weights that were changed a little
        given_marks("eve", 2.0, "r"),
        given_marks("kim", 2.0, "r", extra=5.0),
        given_marks("lea", 3.0, "s"),
        given_marks("max", 3.0, "s", "invent"),
        given_marks("zoe", 5.0, "t"),
        given_marks("joe"),
    ]
    judged = without_copies(lesson_named("reward"), class_marks)
    assert [one.points for one in judged] == [3, 3, 5, 5, 3, 1, 5, 5]
    assert [one.copies[0] for one in judged[:3]] == [
        "complete: the same policy as complete-0-1/best.zip of bob, handed in for another reward or task: ask who"
        " trained it",
        "complete: the same policy as complete-0-1/best.zip of ada, handed in for another reward or task: ask who"
        " trained it",
        "complete: the same policy as complete-0-1/best.zip of kim",
    ]
    assert "bob" not in as_page(lesson_named("reward"), judged[0], 0)
    step = class_marks[0].steps[0]
    refused = replace(step, checks=tuple(replace(check, points=0) for check in step.checks))
    copied = [replace(class_marks[0], steps=(refused,)), class_marks[1]]
    assert [one.points for one in without_copies(lesson_named("reward"), copied)] == [0, 5]
    assert judged[6].copies == ("complete: the same policy as complete-0-1/step.zip of kim",)


def test_others_with_the_same_policy_are_students_and_not_their_files() -> None:
    bob = [given_marks("bob", 1.0, "p", step).steps[0] for step in ("complete", "invent", "invent")]
    class_marks = [given_marks("ada", 1.0, "p"), replace(given_marks("bob"), steps=tuple(bob))]
    (remark,) = without_copies(lesson_named("reward"), class_marks)[0].copies
    assert remark.startswith("complete: the same policy as complete-0-1/best.zip of bob, handed in")


def test_a_guard_beside_a_policy_that_was_copied_earns_nothing() -> None:
    class_marks = []
    for one in (given_marks("ada", 1.0, "p"), given_marks("bob", 1.0, "q")):
        step = one.steps[0]
        checks = (replace(step.checks[0], points=0), *step.checks[1:])
        class_marks.append(replace(one, steps=(replace(step, checks=checks),)))
    assert [one.points for one in class_marks] == [4, 4]
    assert [one.points for one in judged_together(lesson_named("reward"), class_marks)] == [0, 0]


POLICY_LESSON = """
title: Trained
summary: A cart.
steps:
  drive: &step
    goal: Choose a reward, and train.
    parts: [reward]
    checks:
      - {policy: [-1e6], points: 2, episodes: 20, says: the policy}
      - {test: free, guard: true, points: 1, says: standing is free}
  hurry: *step
  helped:
    goal: Learn from a teacher.
    parts: [reward]
    teacher: true
    checks: [{policy: [-1e6], points: 3, episodes: 2, says: the policy}]
"""
HAND_IN = Path(__file__).parents[1] / "data" / "hand_in.zip"
RETURN_ELSEWHERE = 17.333556903134074
ALIVE = "cos(cart.pole_angle)"
DRIVE = "deepbots: 1\nextends: cartpole\nname: Drive\nreward: {alive: %s}\ntruncation: {max_steps: %s}\n"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a lesson, with a hand-in beside it whose run was trained for its first step, on another machine;
    UPDATE_GOLDEN=1 trains it here."""
    folder = tmp_path_factory.mktemp("trained")
    tests = "tests: {free: {driver: zero, episodes: 1, expect: {mean_return: -1e9 .. 1e9}}}\n"
    for name, reward, limit in (("drive", ALIVE, 200), ("hurry", ALIVE, 100), ("helped", ALIVE, 200)):
        put(folder / "lesson" / "start", **{name: DRIVE % (0, limit)})
        task = DRIVE % (0, limit)
        own = task.replace("reward: {alive: 0}", "remove: [reward]\nreward: {include: handed_in/reward.yaml}")
        put(folder / "lesson" / "checks", **{name: own + tests})
        put(folder / "own", **{name: DRIVE % (reward, limit)})
    put(folder / "lesson", lesson=POLICY_LESSON)
    if os.environ.get("UPDATE_GOLDEN"):
        run = folder / "own" / "runs" / "drive-0-1"
        train(api.compile(folder / "own" / "drive.yaml"), run=run, total_timesteps=1024)
        record = json.loads((run / "run.json").read_text())
        record |= {"source": "drive.yaml", "platform": "", "origin": None}
        (run / "run.json").write_text(json.dumps(record))
        for part in ("checkpoints", "tensorboard"):
            shutil.rmtree(run / part)
        shutil.make_archive(str(HAND_IN.with_suffix("")), "zip", folder / "own")
    shutil.unpack_archive(HAND_IN, folder / "own")
    return folder


def handed_in(trained: Path, into: Path, step: str = "drive", teacher: str | None = None) -> StepMark:
    """Return the marks of a step for a copy of the run of the first one."""
    shutil.copytree(trained / "own", into, dirs_exist_ok=True)
    if step != "drive":
        (into / "runs" / "drive-0-1").rename(into / "runs" / f"{step}-0-1")
    record = into / "runs" / f"{step}-0-1" / "run.json"
    content = json.loads(record.read_text())
    content["task"]["teacher"] = teacher
    record.write_text(json.dumps(content))
    return Marker(read_lesson(trained / "lesson"), into, into.parent / "work").mark(step)


def test_a_run_earns_points_if_it_was_trained_with_what_is_handed_in(trained: Path, tmp_path: Path) -> None:
    mark = handed_in(trained, tmp_path / "own")
    assert mark.points == 3, mark
    assert mark.checks[0].measured == pytest.approx(RETURN_ELSEWHERE, rel=1e-9)
    assert [model.place for model in mark.models if mark.policy and mark.policy.is_near(model)]
    put(tmp_path / "own", drive=DRIVE % (2, 200))
    changed = Marker(read_lesson(trained / "lesson"), tmp_path / "own", tmp_path / "again").mark("drive")
    assert changed.points == 0
    assert changed.checks[0].reason.startswith(
        "drive-0-1 was trained in another task than this step: `reward.alive` differs"
    )


@pytest.mark.parametrize(
    ("file", "old", "new", "reason"),
    [
        ("models/agent/best.zip", b'"num_timesteps": ', b'"num_timesteps": 9', "has no evaluation"),
        ("evaluations/training.jsonl", b'"returns": [', b'"returns": [500.0, ', "episodes of its evaluation"),
        (
            "evaluations/training.jsonl",
            b'"lengths": [',
            b'"lengths": [' + b"500, " * 20,
            "episodes of its evaluation",
        ),
        ("evaluations/training.jsonl", b'"returns": [', b'"lost": [', "one of its logs cannot be read"),
    ],
)
def test_a_policy_that_its_training_does_not_explain_earns_nothing(
    trained: Path, tmp_path: Path, file: str, old: bytes, new: bytes, reason: str
) -> None:
    shutil.copytree(trained / "own", tmp_path / "own")
    path = tmp_path / "own" / "runs" / "drive-0-1" / file
    if path.suffix == ".zip":
        with zipfile.ZipFile(path) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        with zipfile.ZipFile(path, "w") as out:
            for name, content in members.items():
                out.writestr(name, content.replace(old, new))
    else:
        path.write_bytes(path.read_bytes().replace(old, new))
    mark = Marker(read_lesson(trained / "lesson"), tmp_path / "own", tmp_path / "work").mark("drive")
    assert mark.points == 0
    assert reason in mark.checks[0].reason


def test_an_evaluation_of_fewer_episodes_explains_no_policy(trained: Path, tmp_path: Path) -> None:
    run = shutil.copytree(trained / "own" / "runs" / "drive-0-1", tmp_path / "run")
    path = run / "evaluations" / "training.jsonl"
    path.write_text(re.sub(r'("returns": \[[^],]*)[^]]*', r"\1", path.read_text()))
    assert unexplained(Run.open(run)).startswith("only 1 of 20 episodes")


def test_an_evaluation_that_any_policy_repeats_explains_none(tmp_path: Path) -> None:
    put(tmp_path, short=DRIVE % (1, 2))
    train(api.compile(tmp_path / "short.yaml"), run=tmp_path / "run", total_timesteps=1024)
    reason = "an untrained policy repeats its evaluation after 1,024 steps as well"
    assert unexplained(Run.open(tmp_path / "run")) == reason


def test_the_run_that_was_trained_last_is_judged(trained: Path, tmp_path: Path) -> None:
    older = tmp_path / "own" / "runs" / "drive-7" / "run.json"
    shutil.copytree(trained / "own" / "runs" / "drive-0-1", older.parent)
    older.write_text(re.sub('"(digest|updated)": "[^"]*"', r'"\1": "0"', older.read_text()))
    assert handed_in(trained, tmp_path / "own").points == 3


def test_a_policy_with_its_neurons_in_another_order_and_larger_answers_is_the_same(
    trained: Path, tmp_path: Path
) -> None:
    run = Run.open(shutil.copytree(trained / "own" / "runs" / "drive-0-1", tmp_path / "runs" / "drive-0-1"))
    model = loaded(run, "best").model
    first, _, second, *_ = model.policy.mlp_extractor.policy_net
    for tensor, axes in ((first.weight, (0, 1)), (first.bias, 0), (second.weight, 1)):
        tensor.data = tensor.data.flip(axes)
    answers = model.policy.action_net
    for tensor in (answers.weight, answers.bias):
        tensor.data[0] *= 1.3
    save(run.model("last"), model)
    one, other = weights_of(tmp_path / "runs", [run.model("best"), run.model("last")])
    assert one.is_near(other)
    assert not one.is_near(replace(other, answers=tuple(-value for value in other.answers)))


def test_a_run_of_another_step_earns_nothing(trained: Path, tmp_path: Path) -> None:
    mark = handed_in(trained, tmp_path / "own", "hurry")
    assert mark.points == 0
    assert "in another task than this step: `truncation.max_steps` differs" in mark.checks[0].reason


def test_a_teacher_earns_nothing_unless_the_lesson_allows_it(trained: Path, tmp_path: Path) -> None:
    refused = handed_in(trained, tmp_path / "own", teacher="balance")
    assert refused.points == 0
    assert refused.checks[0].reason.startswith(
        "drive-0-1 learned from `balance`, which this step does not allow"
    )
    assert handed_in(trained, tmp_path / "helped", "helped", teacher="balance").points == 3


def test_a_policy_that_was_not_evaluated_yet_is_not_accused(trained: Path, tmp_path: Path) -> None:
    shutil.copytree(trained / "own", tmp_path / "own")
    (tmp_path / "own" / "runs" / "drive-0-1" / "evaluations" / "training.jsonl").unlink()
    mark = Marker(read_lesson(trained / "lesson"), tmp_path / "own", tmp_path / "work").mark("drive")
    assert "ended before its first evaluation: go on with" in mark.checks[0].reason
    assert not any("explain" in remark for remark in mark.remarks)


def test_a_bar_within_the_interval_is_named_and_a_guard_says_what_is_right(
    trained: Path, tmp_path: Path
) -> None:
    def marked(name: str, bar: str) -> StepMark:
        shutil.copytree(trained / "lesson", tmp_path / name)
        put(tmp_path / name, lesson=POLICY_LESSON.replace("-1e6", bar))
        return Marker(read_lesson(tmp_path / name), trained / "own", tmp_path / f"{name}-work").mark("drive")

    assert marked("near", "17.3").remarks[0].startswith("drive: near the bar of 17.3: ")
    far = marked("far", "1e6")
    assert far.remarks == ()
    assert far.checks[1].reason == "this is right, and counts once another check of this step earns points"


def test_a_check_that_the_starter_passes_counts_only_beside_another_one(
    lesson: Lesson, tmp_path: Path
) -> None:
    put(tmp_path / "own", mend=STEP % "-2")
    checks = yaml.safe_load(LESSON)["steps"]["mend"]["checks"]
    assert [check.get("guard", False) for check in checks] == [False, True]
    assert Marker(lesson, tmp_path / "own", tmp_path / "work").mark("mend").points == 0


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
def test_what_is_no_file_is_refused_and_the_others_are_marked(lesson: Lesson, tmp_path: Path) -> None:
    handed_in = tmp_path / "handed_in"
    put(handed_in / "ada", answers="length: 0.35 m\nfair:\n")
    os.mkfifo(handed_in / "bob.zip")
    (handed_in / os.fsdecode(b"eve\xff.zip")).write_bytes(b"PK")
    deep = handed_in / "joe"
    for _ in range(300):
        deep /= "d" * 10
    deep.mkdir(parents=True)
    marks = grade(lesson, hand_ins_of(lesson, [handed_in]))
    assert {one.student: one.points for one in marks} == {"ada": 1, "bob": 0, "eve?": 0, "joe": 0}
    assert as_csv(marks).encode()


@given(st.text(max_size=30), st.text(max_size=30))
def test_no_cell_of_a_class_is_a_formula(student: str, remark: str) -> None:
    rows = list(csv.reader(io.StringIO(as_csv([replace(given_marks(student), remarks=(remark,))]))))
    assert all(cell.lstrip()[:1] not in ("=", "+", "-", "@") for row in rows for cell in row if cell.strip())
    assert rows[1][0] in (student, f"'{student}") or "\r" in student or "\n" in student


def test_a_lesson_that_is_none_is_refused_with_its_mistake(tmp_path: Path) -> None:
    for change, reason in (
        ({"minutes": -1}, "`minutes`: input should be greater than"),
        ({"steps": {}}, "`steps`: dictionary should have at least 1 item"),
        (
            {"steps": {"a": {"goal": "x", "checks": [{"says": "x", "points": 1}]}}},
            "a check has one of `test`",
        ),
        (
            {
                "steps": {
                    "a": {
                        "goal": "x",
                        "parts": ["reward"],
                        "checks": [{"says": "x", "points": 1, "test": "t"}],
                    }
                }
            },
            "has no checks/a.yaml",
        ),
    ):
        (tmp_path / "lesson.yaml").write_text(json.dumps({**yaml.safe_load(LESSON), **change}))
        with pytest.raises(UsageError) as error:
            read_lesson(tmp_path)
        assert reason in str(error.value)


@pytest.mark.parametrize(
    ("file", "old", "new", "reason"),
    [
        (
            "lesson",
            "title: Small",
            "title: Small\ntitle: Large",
            "lesson.yaml:3:1: the key `title` is given twice",
        ),
        ("checks/mend", "tests:", "tests: [", "checks/mend.yaml:"),
        (
            "checks/sense",
            "sees:",
            "seen:",
            "checks/sense.yaml has no test `sees`, which the step `sense` checks",
        ),
    ],
)
def test_a_slip_of_a_teacher_is_named_with_its_file(
    lesson: Lesson, tmp_path: Path, file: str, old: str, new: str, reason: str
) -> None:
    shutil.copytree(lesson.folder, tmp_path / "lesson")
    path = tmp_path / "lesson" / f"{file}.yaml"
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(UsageError) as error:
        read_lesson(tmp_path / "lesson")
    assert reason in str(error.value)


def test_a_part_that_is_a_value_replaces_that_of_the_task(lesson: Lesson, tmp_path: Path) -> None:
    own = tmp_path / "lesson"
    shutil.copytree(lesson.folder, own)
    put(own, lesson=LESSON.replace("[reward, augment]", "[world.timestep, reward]"))
    step = STEP % "1" + "\nworld:\n  timestep: %s\n"
    put(own / "start", mend=step % "20 ms")
    test = "pays: {actions: [forward], expect: {eventually: abs(time - 10 ms) < 1 ms}}"
    put(own / "checks", mend=re.sub("pays: .*", test, task(reward="{include: handed_in/reward.yaml}")))
    marks = {}
    for value in ("10 ms", "30 ms", "10 m", "[10 ms]"):
        put(tmp_path / value, mend=step % value)
        marks[value] = Marker(read_lesson(own), tmp_path / value, tmp_path / f"{value} work").mark("mend")
    points = {value: mark.points for value, mark in marks.items()}
    assert points == {"10 ms": 3, "30 ms": 0, "10 m": 0, "[10 ms]": 0}
    assert marks["10 m"].checks[0].reason.startswith("mend.yaml:9:13: `timestep` must be a duration")


def test_a_lesson_is_started_checked_and_hinted_at(
    deepbots: Deepbots, tmp_path: Path, lesson: Lesson
) -> None:
    own = tmp_path / "my own"
    deepbots("course", "start", lesson.folder, own)
    deepbots("course", "start", lesson.folder, tmp_path / "solved", "--with", "solution")
    assert (tmp_path / "solved" / "mend.yaml").read_text() == STEP % "1"
    assert "is not empty" in deepbots("course", "start", lesson.folder, own, code=2).err
    for inner in (own / "inner", own / "far" / "inner"):
        assert "run `cd ..` first" in deepbots("course", "start", lesson.folder, inner, code=2).err
    out = deepbots("course", "start", lesson.folder, tmp_path / "out", "--with", "..", code=2).err
    assert "has no folder '..'" in out
    put(own, mend=STEP % "1", answers="length: 35 cm\nfair: maybe\n")
    checked = deepbots("course", "check", own, code=1)
    assert "lesson 1 Small: 4 of 7 points" in checked.out
    assert "`maybe` is not right (answers.yaml:2:7)" in checked.out
    assert f"deepbots course hint '{own}' --step " in checked.err
    hints = [deepbots("course", "hint", own, "--step", "mend").out.split()[-1] for _ in range(3)]
    assert hints == ["first", "second", "second"]
    assert json.loads(deepbots("course", "hint", own, "--step", "mend", "--json").out)["number"] == 2
    assert "--step does not go with check" in deepbots("course", "check", own, "--step", "mend", code=2).err
    assert json.loads((own / "course.json").read_text())["points"] == 4


def test_a_folder_with_a_lesson_comes_before_the_lesson_of_deepbots_with_its_name(
    deepbots: Deepbots, tmp_path: Path, lesson: Lesson
) -> None:
    deepbots("course", "start", "motors", "shipped")
    shutil.copytree(lesson.folder, tmp_path / "motors")
    for name in ("motors", "./motors"):
        assert "lesson Small," in deepbots("course", "start", name, f"own {len(name)}").out
        assert "lesson Small, 7 points" in deepbots("grade", name, lesson.folder / "solution").out
    assert "lesson 2 Actions and motors" in deepbots("course", "check", "shipped", code=1).out
    assert "folders with a lesson.yaml" in deepbots("course", "verify", "shipped", code=2).err


def test_no_lesson_of_deepbots_follows_one_of_a_teacher(
    deepbots: Deepbots, tmp_path: Path, lesson: Lesson
) -> None:
    deepbots("course", "start", lesson.folder, "own")
    assert "no lesson follows 1 Small; `deepbots course` lists" in deepbots("course", "next", "own").out
    deepbots("course", "start", lesson_named("sensors").folder, "first")
    deepbots("course", "next", "first")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["first", "lesson-2-motors", "own"]


def test_the_list_of_lessons_goes_on_with_an_open_one_then_a_new_one_and_ends(
    deepbots: Deepbots, tmp_path: Path
) -> None:
    def points(lesson: Lesson, missing: int = 0) -> None:
        folder = tmp_path / lesson.folder.name
        folder.mkdir(exist_ok=True)
        grading.Started(folder, lesson.name, lesson.points - missing).write()

    first, *others = shipped_lessons()
    points(first)
    assert "deepbots course start 2" in deepbots("course").err
    for lesson in others:
        points(lesson, missing=1)
    assert f"deepbots course check {others[0].folder.name}" in deepbots("course").err
    for lesson in others:
        points(lesson)
    assert deepbots("course").err == ""


def test_the_files_of_an_earlier_call_are_no_hand_ins(
    deepbots: Deepbots, tmp_path: Path, lesson: Lesson
) -> None:
    for name in ("ada", "bob"):
        put(tmp_path / "class" / name, answers="length: 35 cm\n")
    line = ("grade", lesson.folder, "class", "--csv", "class/marks.csv", "--html", "class/pages")
    deepbots(*line)
    for names in (["class"], sorted((tmp_path / "class").iterdir())):
        again = deepbots("grade", lesson.folder, *names, *line[3:], "--force", "--json").out
        assert [one["student"] for one in json.loads(again)] == ["ada", "bob"]


def test_the_text_in_a_started_lesson_has_no_link_out_of_its_folder(
    deepbots: Deepbots, tmp_path: Path
) -> None:
    started = deepbots("course", "start", "reward", "own")
    text = (tmp_path / "own" / "README.md").read_text(encoding="utf-8")
    assert "in own; its text is README.md\n" in started.out
    assert started.err.endswith("\n  cd own\n  deepbots studio mend.yaml --open\n  deepbots course check\n")
    assert "  deepbots studio . --open\n" in deepbots("course", "start", "chance", "answers_only").err
    assert "](.." not in text
    assert "What is reinforcement learning? (`docs" in text


@pytest.mark.slow
@pytest.mark.parametrize("folder", sorted(course_folder().glob("*/")), ids=lambda folder: folder.name)
def test_a_shipped_lesson_is_proven(folder: Path) -> None:
    proven = list(prove(read_lesson(folder), train=False, workers=2))
    assert [one for one in proven if not one.is_right] == []
    assert len(CHEATS) == 20


def test_a_reward_for_staying_away_from_the_ball_loses_points(tmp_path: Path) -> None:
    put(tmp_path / "own", invent="reward: {found: 5 when found, near: 1 - apart / m}\n")
    mark = Marker(lesson_named("reward"), tmp_path / "own", tmp_path / "work").mark("invent")
    assert mark.checks[0].reason.startswith("invent.yaml:1:37: an episode that avoids `found` can collect")


def test_verify_names_a_missing_picture_and_a_missing_solution(deepbots: Deepbots, tmp_path: Path) -> None:
    own = tmp_path / "mine"
    deepbots("new", "mine", tmp_path, "--lesson")
    (own / "teacher.md").write_text("# Mine\n\n![the robot](robot.png)\n")
    (own / "solution" / "reward.yaml").unlink()
    result = deepbots("course", "verify", own, "--no-train", code=1)
    assert "there is no robot.png" in result.out
    assert "2 lines above are wrong; cheats are tried once start and solution earn" in result.out


def test_a_hand_in_of_another_lesson_says_only_this(deepbots: Deepbots, tmp_path: Path) -> None:
    deepbots("course", "start", "endings", tmp_path / "ben")
    (marks,) = json.loads(deepbots("grade", "reward", tmp_path / "ben", "--json").out)
    assert marks["remarks"] == ["nothing is right: it was started as the lesson `endings`"]
    assert {check["reason"] for step in marks["steps"] for check in step["checks"]} == {
        "it was started as the lesson `endings`"
    }
