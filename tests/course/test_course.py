"""Lessons, hand-ins and marks: a small lesson on a cart, marked in this process; limits, in processes."""

import csv
import io
import json
import os
import shutil
import stat
import zipfile
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.course.grading import Limits, Marks, as_csv, grade, hand_ins_of
from deepbots_cli.course.grading import _without_copies as without_copies
from deepbots_cli.course.hand_ins import HandInError, collect
from deepbots_cli.course.lessons import Lesson, lesson_named, read_lesson, shipped_lessons
from deepbots_cli.course.marking import CheckMark, Marker, StepMark, is_right
from deepbots_cli.course.proof import CHEATS, prove
from deepbots_cli.errors import UsageError
from tests.commands import Deepbots

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
            "sense.yaml lacks what the test needs: unknown name `cart.angle` (DB402); did you mean `cart.angel`?",
        ),
    ],
)
def test_a_failed_test_says_what_the_robot_of_the_student_did(
    lesson: Lesson, tmp_path: Path, step: str, text: str, reason: str
) -> None:
    put(tmp_path / "own", **{step: text})
    mark = Marker(lesson, tmp_path / "own", tmp_path / "work", takes_unchanged=True).mark(step)
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
        ("mend", "reward: [1]\n", "`reward` is not a mapping (mend.yaml:1:9)"),
        ("mend", "reward: {a: 1\n", "mend.yaml cannot be read: mend.yaml:"),
        ("mend", "reward: {a: *b}\n", "mend.yaml cannot be read: mend.yaml:"),
        ("mend", "# " + "x" * (2 << 20), "the file is larger than 1 MiB"),
        (
            "sense",
            SENSE % "{angle: {type: camera, link: cart}}",
            "a sensor of type `camera` is not allowed here",
        ),
        ("sense", None, "there is no sense.yaml"),
    ],
)
def test_a_part_that_no_part_may_be_earns_nothing(
    lesson: Lesson, tmp_path: Path, step: str, text: str | None, reason: str
) -> None:
    put(tmp_path / "own", **({} if text is None else {step: text}))
    mark = Marker(lesson, tmp_path / "own", tmp_path / "work").mark(step)
    assert mark.points == 0
    assert reason in mark.checks[0].reason


def test_what_the_task_has_itself_is_without_effect_and_named(lesson: Lesson, tmp_path: Path) -> None:
    softened = (
        STEP % "-1" + "truncation: {max_steps: 1}\ntests: {pays: {driver: zero}}\nextends: pit_escape\n"
    )
    put(tmp_path / "own", mend=softened.replace("-1 *", "-2 *"))
    mark = Marker(lesson, tmp_path / "own", tmp_path / "work").mark("mend")
    assert mark.points == 0
    assert mark.remarks == (
        "changes of `extends`, `tests`, `truncation` in mend.yaml have no effect on the marks",
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
        collect(path, "ada", tmp_path / "into", lesson)
    assert reason in str(error.value)


def test_a_zip_with_a_folder_around_and_a_link(lesson: Lesson, tmp_path: Path) -> None:
    members = {
        "ada/mend.yaml": STEP_BYTES,
        "ada/sense.yaml": b"/etc/passwd",
        "ada/run.py": b"1",
        "__MACOSX/a": b"",
    }
    path = archive(tmp_path / "ada.zip", members, link="ada/sense.yaml")
    (tmp_path / "into").mkdir()
    hand_in = collect(path, "ada", tmp_path / "into", lesson)
    assert sorted(file.name for file in hand_in.folder.iterdir()) == ["mend.yaml", "run.py"]
    assert hand_in.remarks[:2] == (
        "sense.yaml is a symbolic link, which is not followed",
        "run.py: programs are not run, so they have no effect",
    )


@given(st.binary(max_size=300))
def test_a_damaged_zip_is_refused_or_opened(
    lesson: Lesson, tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    folder = tmp_path_factory.mktemp("zip")
    whole = archive(folder / "ada.zip", {"mend.yaml": STEP_BYTES}).read_bytes()
    (folder / "ada.zip").write_bytes(data + whole[len(data) :])
    (folder / "into").mkdir()
    with suppress(HandInError):
        assert collect(folder / "ada.zip", "ada", folder / "into", lesson).folder == folder / "into"


def test_students_are_named_by_their_files(lesson: Lesson, tmp_path: Path) -> None:
    handed_in = tmp_path / "handed_in"
    put(handed_in / "ada", mend=STEP % "1")
    archive(handed_in / "ada.zip", {})
    archive(handed_in / "José ß.zip", {})
    (handed_in / ".DS_Store").touch()
    (handed_in / "notes.txt").touch()
    assert [name for name, _ in hand_ins_of(lesson, [handed_in])] == [
        "José ß",
        "ada",
        "ada (2)",
        "notes.txt",
    ]
    assert [name for name, _ in hand_ins_of(lesson, [handed_in / "ada"])] == ["ada"]


def test_a_step_beyond_its_limits_costs_that_student_that_step(lesson: Lesson, tmp_path: Path) -> None:
    endless = task(sensors="{include: handed_in/robots.cart.sensors.yaml}")
    shutil.copytree(lesson.folder, tmp_path / "2-endless")
    put(
        tmp_path / "2-endless" / "checks",
        sense=endless.replace("actions: [forward, forward]", "driver: random, episodes: 1000"),
    )
    slow = read_lesson(tmp_path / "2-endless")
    hand_ins = [("slow", lesson.folder / "solution"), ("gone", tmp_path / "gone")]
    marks = grade(slow, hand_ins, limits=Limits(cpu=4))
    assert [[step.points for step in one.steps] for one in marks] == [[3, 0, 2], [0, 0, 0]]
    assert marks[0].steps[1].checks[0].reason == "it took more than 4 s of CPU time"
    assert marks[1].refused == "not marked: it does not exist"


def given_marks(student: str, weights: str, remark: str = "", parts: str = "") -> Marks:
    step = lesson_named("reward").steps["complete"]
    checks = tuple(CheckMark(check.says, check.points, check.points) for check in step.checks)
    mark = StepMark("complete", checks, (), weights, parts)
    return Marks(student, "reward", (mark,), (remark,) if remark else ())


def test_a_policy_of_two_students_is_named_and_earns_nothing_where_their_parts_differ() -> None:
    handed_in = [("ada", "1", "p"), ("bob", "1", "q"), ("eve", "2", "r"), ("kim", "2", "r"), ("joe", "", "")]
    marks = [given_marks(name, weights, parts=parts) for name, weights, parts in handed_in]
    judged = without_copies(lesson_named("reward"), marks)
    assert [one.points for one in judged] == [3, 3, 5, 5, 5]
    assert judged[0].all_remarks == (
        "complete: the same policy as that of bob with other parts: ask who trained it",
    )
    assert judged[2].all_remarks == ("complete: the same policy as that of kim",)


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
    put(handed_in / "ada", answers="length: 0.35 m\nfair: no\n")
    os.mkfifo(handed_in / "bob.zip")
    (handed_in / os.fsdecode(b"eve\xff.zip")).write_bytes(b"PK")
    deep = handed_in / "joe"
    for _ in range(300):
        deep /= "d" * 10
    deep.mkdir(parents=True)
    marks = grade(lesson, hand_ins_of(lesson, [handed_in]))
    assert {one.student: one.points for one in marks} == {"ada": 2, "bob": 0, "eve?": 0, "joe": 0}
    assert as_csv(marks).encode()


@given(st.text(max_size=30), st.text(max_size=30))
def test_no_cell_of_a_class_is_a_formula(student: str, remark: str) -> None:
    rows = list(csv.reader(io.StringIO(as_csv([given_marks(student, "", remark)]))))
    assert all(cell.lstrip()[:1] not in ("=", "+", "-", "@") for row in rows for cell in row if cell.strip())
    assert (
        rows[1][0].removeprefix("'") == student.replace("\r\n", "\r\n") or "\r" in student or "\n" in student
    )


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
        content = {**yaml.safe_load(LESSON), **change}
        (tmp_path / "lesson.yaml").write_text(json.dumps(content))
        with pytest.raises(UsageError) as error:
            read_lesson(tmp_path)
        assert reason in str(error.value)


def test_a_lesson_is_started_checked_and_hinted_at(
    deepbots: Deepbots, tmp_path: Path, lesson: Lesson
) -> None:
    own = tmp_path / "own"
    deepbots("course", "start", lesson.folder, own)
    assert "is not empty" in deepbots("course", "start", lesson.folder, own, code=2).err
    assert "run `cd ..` first" in deepbots("course", "start", lesson.folder, own / "inner", code=2).err
    put(own, mend=STEP % "1", answers="length: 35 cm\nfair: maybe\n")
    checked = deepbots("course", "check", own, code=1)
    assert "lesson 1 Small: 4 of 7 points" in checked.out
    assert "`maybe` is not right (answers.yaml:2:7)" in checked.out
    hints = [deepbots("course", "hint", own, "--step", "mend").out.split()[-1] for _ in range(3)]
    assert hints == ["first", "second", "second"]
    assert json.loads((own / "course.json").read_text())["points"] == 4


@pytest.mark.slow
@pytest.mark.parametrize("number", [lesson.number for lesson in shipped_lessons()])
def test_a_shipped_lesson_is_proven(number: int) -> None:
    proven = list(prove(lesson_named(str(number)), train=False, workers=2))
    assert [one for one in proven if not one.is_right] == []
    assert len(CHEATS) == 20


def test_a_lesson_to_change_is_the_third(deepbots: Deepbots, tmp_path: Path) -> None:
    deepbots("new", "mine", tmp_path, "--lesson")
    assert read_lesson(tmp_path / "mine").steps == lesson_named("reward").steps
