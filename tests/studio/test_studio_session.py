"""The session of a studio with its processes, without a page.

Random walks over what a person does in the studio: after each step, all that is shown agrees with files.

The session is that of a page, without the page: its robot, its commands and its trainings are real processes.

What the studio says about the word at the cursor.
"""

from __future__ import annotations

import asyncio
import json
import os
import random
import re
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("viser")
pytest.importorskip("stable_baselines3")

from nicegui import Client, core
from nicegui.page import page

import deepbots_cli
from deepbots_cli import learning
from deepbots_cli.cli.starters.first_scenario import DroppedRobot
from deepbots_cli.course.lessons import shipped_lessons
from deepbots_cli.document.shipped import robot_path
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.campaigns.listing import read_listed
from deepbots_cli.learning.runs.episodes import read_evaluations
from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.studio import robot as robots
from deepbots_cli.studio import server
from deepbots_cli.studio import session as sessions
from deepbots_cli.studio.explain import explanation
from deepbots_cli.studio.files import OpenFile
from deepbots_cli.studio.lesson_tab import with_buttons
from deepbots_cli.studio.robot_pane import robot_text
from deepbots_cli.studio.runs_tab import RunsTab, _unbroken
from deepbots_cli.studio.server import studio
from deepbots_cli.studio.session import TABS, Session
from tests.studio.served import Served, served
from tests.studio.test_studio_page import SCENARIO


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")
    return tmp_path


class Running:
    """A session with its loop. `topics` are those that its listener got."""

    def __init__(self, folder: Path) -> None:
        self.session = Session(folder)
        self.topics: list[str] = []
        self.notices: list[str] = []

    async def __aenter__(self) -> tuple[Running, Session]:
        self.session.listen(self._heard)
        self._task = asyncio.create_task(self.session.run_forever())
        return self, self.session

    async def __aexit__(self, *error: object) -> None:
        self._task.cancel()
        await self.session.close()

    def _heard(self, topic: str) -> None:
        self.topics.append(topic)
        if topic == "notice":
            self.notices.append(self.session.shown.notice)

    async def until(self, condition: Callable[[], Any], seconds: float = 60.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, (
                self.session.robot.state,
                self.session.robot.problem,
                self.notices,
            )
            assert not self._task.done(), self._task.exception()
            await asyncio.sleep(0.05)

    async def checked(self, path: Path) -> None:
        file = self.session.files[path]
        language = self.session.language
        await self.until(lambda: language.checked_revision(path) == file.revision)

    async def runs(self) -> None:
        """Wait until the robot runs the files as they are."""
        robot = self.session.robot
        await self.until(lambda: robot.state is not None and robot.state.state == "running")

    @property
    def robot_pid(self) -> int:
        process = self.session.robot._process
        assert process is not None
        return process.pid


def _writes(session: Session, text: str) -> None:
    file = session.files[session.folder / "mine.yaml"]
    session.change(file, file.revision, text)
    session.save(file)


async def test_findings_follow_the_text_and_the_files_that_it_reads(folder):
    (folder / "base.yaml").write_text("reward:\n  alive: 1\n", encoding="utf-8")
    text = SCENARIO.replace("reward:\n  alive: 1\n", "extends: base.yaml\n")
    (folder / "mine.yaml").write_text(text, encoding="utf-8")

    async with Running(folder) as (running, session):
        file = session.open(Path("mine.yaml"))
        session.current = file.path
        await running.checked(file.path)
        assert not session.language.has_errors(file.path)
        session.change(file, file.revision, text.replace("15 deg", "15 parsec"))
        await running.checked(file.path)
        (finding,) = (each for each in session.language.findings(file.path) if each.severity == "error")
        assert finding.place == "4:18"
        assert "parsec" in finding.message
        session.change(file, file.revision, text.replace("15 deg", "15 kg"))
        await running.checked(file.path)
        (finding,) = (each for each in session.language.findings(file.path) if each.severity == "error")
        assert finding.message.endswith("; used here: line 21")
        with pytest.raises(UsageError, match="the scenario has errors"):
            session.saved_name()
        (folder / "other.yaml").write_text(SCENARIO, encoding="utf-8")
        base, other = (session.open(Path(name)) for name in ("base.yaml", "other.yaml"))
        for each, typed in ((file, text), (base, "reward:\n  alive: 2\n"), (other, "# typed\n")):
            session.change(each, each.revision, typed)
        session.saved_name()
        assert [each.path.read_text() for each in (file, base, other)] == [text, base.text, SCENARIO]
        # Another program damages the file that the scenario reads.
        (folder / "base.yaml").write_text("reward:\n  alive: 1 parsec\n", encoding="utf-8")
        await running.until(lambda: session.language.has_errors(file.path))


async def test_a_late_request_for_completions_does_not_hide_findings(folder):
    async with Running(folder) as (running, session):
        file = session.open(Path("mine.yaml"))
        await running.checked(file.path)
        words = SCENARIO.replace("alive: 1", "alive: 1 + q")
        for text in (words, words.replace("+ q", "+ qq")):
            session.change(file, file.revision, text)
        # The browser sent it before the second letter; it arrives after it.
        session.language.complete(file.path, words, 17, 14)
        await running.checked(file.path)
        assert "qq" in session.language.findings(file.path)[0].message


async def test_an_added_entry_is_removed_with_the_section_that_it_alone_is_in(folder):
    async with Running(folder) as (_, session):
        session.show(Path("mine.yaml"))
        file = session.files[session.current]
        task = session.commands.run(["lint", session.saved_name()])
        lines = session.write_values({"reward.bonus": "0.1", "robots.cart.links.pole": "{scale: 1 1 2}"})
        assert [file.text.split("\n")[line] for line in lines] == [
            "    links: {pole: {scale: 1 1 2}}",
            "  bonus: 0.1",
        ]
        assert session.is_outdated(task)
        session.write_values({"reward.bonus": "", "robots.cart.links.pole": ""})
        assert (file.text, session.is_outdated(task)) == (SCENARIO, False)
        with pytest.raises(UsageError, match="these values already"):
            session.write_values({"reward.bonus": ""})
        revision = file.revision
        with pytest.raises(UsageError, match="has no place for"):
            session.write_values({"reward.bonus": "0.2", "name.first": "3"})
        assert (file.text, file.revision) == (SCENARIO, revision)
        session.timesteps = "512"  # which would override the next value
        session.write_values({"train.total_timesteps": "1_024"})
        assert session.timesteps == ""


@pytest.mark.slow
async def test_a_run_says_what_it_changed_against_the_one_before(folder):
    texts = (SCENARIO, SCENARIO.replace("alive: 1", "alive: 2").replace("15 deg", "12 deg"))
    for number, text in enumerate(texts):
        (folder / "mine.yaml").write_text(text, encoding="utf-8")
        words = ("train", "mine.yaml", "--run", f"runs/{number}", "--timesteps", str(512 * (number + 1)))
        subprocess.run(
            python_command("deepbots_cli", *words, "--seed", str(number)),
            cwd=folder,
            env=python_environment(),
            check=True,
            capture_output=True,
        )

    async with Running(folder) as (running, session):
        await running.until(lambda: len(session.run_changes) == 2)
        changes = session.run_changes
        first, second = (changes[folder / "runs" / name] for name in ("0", "1"))
        assert first.text == "first run"
        expected = "reward.alive 1 -> 2; fall_angle 15 deg -> 12 deg; timesteps 512 -> 1_024; and 1 more"
        assert second.text == expected
        assert second.started >= first.started > 0


async def test_a_saved_text_and_a_changed_parameter_are_those_of_the_robot(folder):
    async with Running(folder) as (running, session):
        session.show(Path("mine.yaml"))
        robot = session.robot
        await running.runs()
        assert robot.state.parameters == {"fall_angle": "15 deg"}

        _writes(session, SCENARIO.replace("15 deg", "20 deg"))
        await running.until(lambda: robot.state.parameters == {"fall_angle": "20 deg"})
        assert robot.state.state == "running"
        assert running.notices == ["the robot has started again, with fall_angle 15 deg → 20 deg"]

        # A parameter changes in the running world, and is written into the text on request.
        session.robot.set_parameter("fall_angle", "0.3 rad")
        await running.until(lambda: robot.state.changed == {"fall_angle": "0.3 rad"})
        await running.until(lambda: robot.state.parameters == {"fall_angle": "0.3 rad"})
        # A mistyped one is refused, and is no error in the files.
        session.robot.set_parameter("fall_angle", "5 kg")
        await running.until(lambda: "fall_angle = 5 kg is refused: " in robot.state.note)
        assert (robot.state.state, robot.state.changed) == ("running", {"fall_angle": "0.3 rad"})
        file = session.files[folder / "mine.yaml"]
        assert not file.is_modified
        assert session.write_values({"parameters.fall_angle": "0.3 rad"}) == [3]
        assert "  fall_angle: 0.3 rad  # the largest lean\n" in file.text
        # The text wins once it is saved with another value.
        _writes(session, file.text.replace("0.3 rad", "0.4 rad"))
        await running.until(lambda: robot.state.parameters == {"fall_angle": "0.4 rad"})
        assert robot.state.changed == {}
        # A save of something else keeps a changed parameter.
        session.robot.set_parameter("fall_angle", "0.2 rad")
        await running.until(lambda: robot.state.parameters == {"fall_angle": "0.2 rad"})
        _writes(session, file.text.replace("alive: 1", "alive: 2"))
        loaded = robot.state.loaded
        await running.until(lambda: robot.state.loaded > loaded)
        assert robot.state.parameters == {"fall_angle": "0.2 rad"}


async def test_another_scenario_is_shown_by_the_same_process_until_one_cannot_be_opened(folder):
    (folder / "other.yaml").write_text(SCENARIO.replace("15 deg", "20 deg"), encoding="utf-8")
    (folder / "broken.yaml").write_text(SCENARIO.replace("15 deg", "15 parsec"), encoding="utf-8")

    async with Running(folder) as (running, session):
        robot = session.robot
        session.show(Path("mine.yaml"))
        await running.runs()
        pid, address = running.robot_pid, robot.address
        robot.set_parameter("fall_angle", "0.3 rad")
        await running.until(lambda: robot.state.changed == {"fall_angle": "0.3 rad"})

        robot.show(folder / "other.yaml", "zero")
        assert (robot.state, robot.address) == (None, address)
        await running.runs()
        assert (robot.state.driver, robot.state.changed, robot.state.parameters) == (
            "zero",
            {},
            {"fall_angle": "20 deg"},
        )

        session.shown.show_robot(folder / "broken.yaml")
        await running.until(lambda: robot.state is not None)
        assert robot.state.state == "errors"

        session.shown.show_robot(folder / "other.yaml")
        await running.runs()
        assert (running.robot_pid, robot.address, robot.state.driver) == (pid, address, "random")

        session.shown.show_robot(folder / "runs" / "gone")
        await running.until(lambda: robot.problem)
        assert "gone" in robot.problem
        session.shown.show_robot(folder / "mine.yaml")
        await running.runs()


async def test_a_correct_file_without_a_start_is_not_said_to_have_errors(folder: Path) -> None:
    (folder / "mine.yaml").write_text(SCENARIO.replace("15 deg", "15 parsec"), encoding="utf-8")

    async with Running(folder) as (running, session):
        session.show(Path("mine.yaml"))
        await running.until(lambda: "the file has errors" in robot_text(session))
        _writes(session, f"{SCENARIO}reset: {{require: position(cart).x > 5 m, attempts: 3}}\n")
        await running.until(lambda: "no start was found in 3 attempts" in robot_text(session))


@pytest.mark.parametrize("half", [False, True])
def test_the_process_of_the_robot_ends_with_a_studio_that_was_killed(folder: Path, half: bool) -> None:
    ended = subprocess.run(
        python_command("deepbots_cli.studio.robot_process"),
        input=f'{json.dumps({"reference": str(folder / "mine.yaml")})}\n{{"verb":' if half else "",
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.slow
async def test_a_crashed_robot_is_named_and_started_again(folder):
    async with Running(folder) as (running, session):
        session.show(Path("mine.yaml"))
        await running.runs()
        for number in range(3):
            await running.until(lambda: session.robot._process is not None)
            pid = running.robot_pid
            os.kill(pid, signal.SIGKILL)
            await running.until(lambda number=number: session.robot.crashes == number + 1)
        await running.until(lambda: "ended 3 times" in session.robot.problem)
        assert "ended (signal 9); it was started again" in running.notices[0]
        # The next save starts it again.
        _writes(session, SCENARIO.replace("15 deg", "20 deg"))
        await running.runs()


async def test_a_robot_that_takes_long_to_load_is_shown_as_soon_as_it_is_loaded(folder, monkeypatch):
    monkeypatch.setattr(robots, "_PATIENCE_S", 0.5)
    (folder / "other.yaml").write_text(SCENARIO.replace("15 deg", "20 deg"), encoding="utf-8")

    async with Running(folder) as (running, session):
        session.show(Path("mine.yaml"))
        await running.runs()
        os.kill(running.robot_pid, signal.SIGSTOP)
        session.shown.show_robot(folder / "other.yaml")
        await running.until(lambda: session.robot.is_late)
        sentence = "other.yaml takes long to load, and is shown as soon as it is; Restart begins anew"
        assert robot_text(session) == sentence
        assert session.shown.robot_starts
        os.kill(running.robot_pid, signal.SIGCONT)
        await running.runs()
        assert not session.shown.robot_starts
        assert (session.robot.state.parameters, running.notices) == ({"fall_angle": "20 deg"}, [])


@pytest.mark.slow
async def test_a_robot_that_does_not_answer_is_named_and_ended_by_the_next_save(folder, monkeypatch):
    monkeypatch.setattr(robots, "_PATIENCE_S", 1.0)

    async with Running(folder) as (running, session):
        session.show(Path("mine.yaml"))
        await running.runs()
        pid = running.robot_pid
        os.kill(pid, signal.SIGSTOP)
        begun = time.monotonic()
        for _ in range(200):  # 200 kB, which no pipe takes
            session.robot.set_parameter("fall_angle", "1" * 1_000)
        assert time.monotonic() - begun < 5.0
        _writes(session, SCENARIO.replace("15 deg", "20 deg"))
        await running.until(lambda: session.robot.is_late)
        _writes(session, SCENARIO.replace("15 deg", "25 deg"))
        await running.until(lambda: session.robot.state is None)
        await running.runs()
        assert running.robot_pid != pid
        assert session.robot.state.parameters == {"fall_angle": "25 deg"}


@pytest.mark.slow
async def test_a_start_that_is_drawn_without_end_leaves_the_editor_free(folder):
    never = "\nreset:\n  attempts: 100000\n  require: [abs(cart.pole_angle) < -1]\n"
    (folder / "mine.yaml").write_text(SCENARIO + never, encoding="utf-8")

    async with Running(folder) as (running, session):
        session.show(Path("mine.yaml"))
        file = session.files[folder / "mine.yaml"]
        await running.checked(file.path)
        longest = 0.0
        for number in range(20):
            session.change(file, file.revision, f"{SCENARIO}# {number}{never}")
            begin = time.monotonic()
            await asyncio.sleep(0.2)
            longest = max(longest, time.monotonic() - begin - 0.2)
        assert longest < 0.5
        await running.checked(file.path)


@pytest.mark.slow
async def test_a_training_outlives_the_session_and_is_found_again(folder):
    async with Running(folder) as (running, session):
        session.current = session.open(Path("mine.yaml")).path
        await running.checked(session.current)
        task = session.commands.train(session.saved_name(), ["--timesteps", "20000"])
        assert task.record.run == "runs/mine-1"
        await running.until(
            lambda: session.shown.training is not None and session.shown.training.log is not None,
            120,
        )
        points = len(session.shown.training.log.returns[0])

    async with Running(folder) as (running, session):
        assert [task.record.run for task in session.commands.tasks.running] == ["runs/mine-1"]
        await running.until(
            lambda: session.shown.training is not None and session.shown.training.log is not None
        )
        assert session.shown.training_task is session.shown.task
        await running.until(lambda: len(session.shown.training.log.returns[0]) > points, 120)
        assert session.shown.training.listed.state == "training"
        # Stop keeps the policy.
        session.shown.task.stop()
        await running.until(lambda: not session.shown.task.is_running)
        await running.until(lambda: session.shown.training.listed.state != "training")
        await running.until(lambda: any("mine-1: stopped" in notice for notice in running.notices))
        # The curve goes on when the training does.
        session.commands.run(["resume", "runs/mine-1", "--timesteps", "40000"], Path("runs/mine-1"))
        await running.until(lambda: getattr(session.shown.training.listed, "state", "") == "training", 120)
        session.shown.task.stop()
        await running.until(lambda: not session.shown.task.is_running)
        assert (folder / "runs" / "mine-1" / "models" / "agent" / "last.zip").is_file()
        await session.read_runs()
        assert [(run.path.name, run.problem) for run in session.runs] == [("mine-1", None)]

    assert [path.name for path in (folder / "runs").iterdir() if path.name[0] != "."] == ["mine-1"]


def test_a_run_directory_is_named_after_the_file(folder):
    name = "a [b]+.yaml"
    (folder / name).write_text(SCENARIO, encoding="utf-8")
    (folder / "runs" / "a_b_-1").mkdir(parents=True)
    assert Session(folder).commands.new_run(Path(name).stem) == Path("runs", "a_b_-2")


# Servers


def test_a_second_studio_of_a_folder_names_the_first(folder):
    first = studio(folder / "mine.yaml")
    with pytest.raises(UsageError) as refusal:
        studio(folder)
    address = first.address.partition("?")[0]
    assert str(refusal.value) == (
        f"another studio shows {folder}: {address} (process {os.getpid()}); open the address with the token"
        " that it printed, or end it first"
    )


def test_a_busy_port_is_passed_over(folder, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as busy:
        first = busy.getsockname()[1]
        monkeypatch.setattr(server, "FIRST_PORT", first)
        address = studio(folder).address
    assert first < int(address.removeprefix("http://127.0.0.1:").partition("/")[0]) < first + 20


def test_a_chosen_port_that_is_busy_is_one_sentence(folder):
    with socket.create_server(("127.0.0.1", 0)) as busy:
        port = busy.getsockname()[1]
        with pytest.raises(UsageError, match=f"port {port} of 127.0.0.1 is in use; choose another one"):
            studio(folder, port=port)


def test_a_folder_of_the_studio_with_links_is_refused(folder, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (folder / "runs" / ".studio").mkdir(parents=True)
    (folder / "runs" / ".studio" / "address").symlink_to(elsewhere / "written")
    with pytest.raises(UsageError, match="neither a file nor a directory"):
        studio(folder)
    assert not list(elsewhere.iterdir())


@pytest.mark.slow
def test_a_scenario_in_a_folder_of_the_present_one_is_served(folder):
    with (
        served(folder.parent, f"{folder.name}/mine.yaml") as running,
        socket.create_connection(("127.0.0.1", running.port), 60) as line,
    ):
        line.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert line.recv(20).startswith(b"HTTP/1.1 403")  # without the token


@pytest.mark.slow
def test_a_killed_studio_leaves_its_folder_to_the_next(folder):
    with served(folder, "mine.yaml") as first:
        first.stop(signal.SIGKILL)
        with served(folder, "mine.yaml") as second:
            assert second.address.startswith("http://127.0.0.1:")
            third = Served(folder, "mine.yaml")
            assert (third.address, third.process.wait(60)) == ("", 2)


TINY = SCENARIO.replace("max_steps: 100", "max_steps: 8").replace("128", "64\n  n_epochs: 1")
_ANGLE = re.compile(r"fall_angle: \"?(\d+ \w+)")
_STEPS = 8
_WALKS_OF_A_SESSION = 20


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two scenarios and two runs, whose evaluations differ; not to be changed."""
    folder = tmp_path_factory.mktemp("trained")
    (folder / "mine.yaml").write_text(TINY, encoding="utf-8")
    (folder / "other.yaml").write_text(TINY.replace("15 deg", "20 deg"), encoding="utf-8")
    compiled = deepbots_cli.compile(folder / "mine.yaml", overrides=["parameters.fall_angle=12 deg"])
    first = learning.train(compiled, run=folder / "runs" / "mine-1", total_timesteps=1536).run
    second = shutil.copytree(first, folder / "runs" / "mine-2")
    lines = (first / "evaluations" / "training.jsonl").read_text("utf-8").splitlines()
    entries = [json.loads(line) for line in lines]
    doubled = [{**entry, "returns": [2 * value for value in entry["returns"]]} for entry in entries]
    content = "".join(f"{json.dumps(entry)}\n" for entry in doubled)
    (second / "evaluations" / "training.jsonl").write_text(content, encoding="utf-8")
    return folder


def evaluations(run: Path) -> list[float]:
    return [fmean(entry["returns"]) for entry in read_evaluations(run)]


@dataclass(frozen=True)
class World:
    """What the robot is to be of, and its angle."""

    reference: Path
    angle: str

    @property
    def driver(self) -> str:
        return "policy" if self.reference.is_dir() else "random"


class Walk:
    """A person, and a second one in another browser, in front of one session."""

    def __init__(self, running: Running) -> None:
        self.running, self.session = running, running.session
        self.random = random.Random(0)
        self.world: World | None = None
        self.curve: Path | None = None
        self.done: list[str] = []
        self.false_notices: list[str] = []
        self.session.listen(self._judge)

    @property
    def file(self) -> OpenFile:
        return self.session.files[self.session.current]

    def angle(self, path: Path) -> str:
        """Return the angle of a file, or of the scenario of a run."""
        path = path / "resolved.yaml" if path.is_dir() else path
        return _ANGLE.search(path.read_text("utf-8"))[1]

    @property
    def runs(self) -> list[Path]:
        return sorted(path.parent for path in (self.session.folder / "runs").glob("*/run.json"))

    def _judge(self, topic: str) -> None:
        """Compare a notice with the files in the moment in which it is said."""
        notice = self.session.shown.notice
        if topic != "notice":
            return
        if notice.startswith("the robot has started again"):
            state, current = self.session.robot.state, self.session.current
            if (state.reference, state.parameters["fall_angle"]) != (str(current), self.angle(current)):
                self.false_notices.append(notice)
        for run in self.runs:
            says = {True: "solved", False: "not solved", None: "finished"}[read_listed(run).solved]
            if notice.startswith(f"Training of {run.name}: ") and not notice.endswith((says, "stopped")):
                self.false_notices.append(notice)

    # What the persons do

    def show(self, path: Path) -> None:
        if path == self.session.current:
            return
        self.session.show(path)
        self.world = World(path, self.angle(path)) if "parsec" not in self.file.saved else None
        self.curve = self.session.commands.newest_training(path.stem)

    def edit(self) -> None:
        unit = self.random.choice(["deg", "deg", "deg", "deg", "parsec"])
        text = _ANGLE.sub(f"fall_angle: {self.random.randint(2, 40)} {unit}", self.file.text)
        before, base, note = self.file.text, self.file.revision, f"# {self.random.random()}\n"
        assert self.session.change(self.file, base, text)
        # The second browser has not seen it, and sends its text again with the newer one.
        assert text == before or not self.session.change(self.file, base, before + note)
        assert self.session.change(self.file, self.file.revision, text + note)

    def save(self) -> None:
        if self.file.is_modified:
            self.session.save(self.file)
            self._saved()

    def _saved(self) -> None:
        angle = self.angle(self.file.path)
        if "parsec" not in angle:
            self.world = World(self.file.path, angle)

    def change_outside(self) -> None:
        if not self.file.is_modified:
            self.file.path.write_text(self.file.text.replace("name: M", "name: MM"), encoding="utf-8")
            self._saved()

    def open_other(self) -> None:
        self.save()
        self.show(self.session.folder / self.random.choice(["mine.yaml", "other.yaml"]))

    def watch(self) -> None:
        run = self.random.choice(self.runs)
        self.session.shown.show_robot(run)
        self.world = World(run, self.angle(run))

    def save_and_watch(self) -> None:
        """Watch before the robot of the saved text has come."""
        self.save()
        self.watch()

    def watch_and_save(self) -> None:
        self.watch()
        self.edit()
        self.save()

    def look_at_curve(self) -> None:
        self.curve = self.random.choice(self.runs)
        self.session.shown.show_training(self.curve)
        self.session.shown.open_tab("Train")

    def open_tab(self) -> None:
        self.session.shown.open_tab(self.random.choice(TABS))

    def follow(self) -> None:
        self.session.shown.follow(self.random.random() < 0.5)
        training = self.session.shown.training
        if self.session.shown.follows and training is not None:
            run = training.path
            self.world = World(run, self.angle(run))

    def train(self) -> None:
        if "parsec" in self.file.text:
            return
        session = self.session
        name, follows = session.saved_name(), session.shown.follows or session.robot.state.driver == "policy"
        self._saved()
        run = session.folder / session.commands.train(name, ["--timesteps", "512"]).record.run
        self.curve = run
        if follows:
            self.world = World(run, self.angle(self.file.path))

    def resume(self) -> None:
        run = self.runs[0]
        steps = str(512 + read_listed(run).total_timesteps)
        follows = self.session.shown.follows or self.session.robot.state.driver == "policy"
        self.session.commands.run(
            ["resume", f"runs/{run.name}", "--timesteps", steps], Path("runs", run.name)
        )
        self.curve = run
        if follows:
            self.world = World(run, self.angle(run))

    def compare(self) -> None:
        one, other = (f"runs/{run.name}" for run in self.random.sample(self.runs, 2))
        self.session.commands.run(["compare", one, other, "--episodes", "2"])

    QUICK: tuple[Callable[[Walk], None], ...] = (
        edit,
        save,
        change_outside,
        open_other,
        watch,
        save_and_watch,
        watch_and_save,
        look_at_curve,
        open_tab,
        follow,
    )
    COSTLY: tuple[Callable[[Walk], None], ...] = (train, resume, compare)

    async def go(self, steps: int, *, costs: bool) -> None:
        acts = self.random.choices(self.QUICK, k=steps)
        if costs:
            acts[steps // 2] = self.random.choice(self.COSTLY)
        for act in acts:
            self.done.append(act.__name__)
            act(self)
            if act in self.COSTLY:
                await self.running.until(lambda: not self.session.commands.tasks.running, 120)
                # Without a browser, no further episode begins by itself.
                await self.running.until(self._has_come)
                self.session.robot.restart()
            await self.settle()

    # What is shown

    def disagreements(self) -> list[str]:
        session, shown = self.session, self.session.shown
        state, training = session.robot.state, shown.training
        running = session.commands.tasks.running
        facts: dict[str, tuple[object, object]] = {
            "saved text": (self.file.saved, self.file.path.read_text("utf-8")),
            "checked": (session.language.checked_revision(self.file.path), self.file.revision),
            "curve": (training and training.path, self.curve),
            "robot starts": (shown.robot_starts, False),
            "trains": (
                shown.trains,
                any(session.commands.trained_run(task) == self.curve for task in running),
            ),
            "running": (len(running), 0),
            "problem": (session.robot.problem, ""),
        }
        if state is not None and self.world is not None:
            world = self.world
            facts["robot of"] = (shown.source, str(world.reference))
            facts["angle"] = (state.parameters.get("fall_angle"), world.angle)
            facts["driver"] = (state.driver, world.driver)
            name = world.reference.name
            by = f"the policy of {name}" if world.driver == "policy" else "random actions"
            is_outdated = "parsec" in self.angle(self.file.path) and state.state == "outdated"
            sentence = "the saved file has errors" if is_outdated else f"driven by {by}"
            facts["sentence"] = (robot_text(session)[: len(sentence)], sentence)
        elif state is not None:
            facts["state"] = (state.state, "errors")
        else:
            facts["state"] = (None, "a state")
        if training is not None and self.curve is not None:
            facts["listed"] = (training.listed, read_listed(self.curve))
            log = training.log
            drawn = [] if log is None or log.evaluations is None else list(log.evaluations[1])
            facts["drawn evaluations"] = (drawn, pytest.approx(evaluations(self.curve)))
        return [f"{name}: {one}, not {other}" for name, (one, other) in facts.items() if one != other]

    def _has_come(self) -> bool:
        state = self.session.robot.state
        return state is not None and (self.world is None or state.reference == str(self.world.reference))

    async def settle(self) -> None:
        """Wait until all that is shown agrees with the files."""
        try:
            await self.running.until(lambda: not self.disagreements(), 60)
        except AssertionError:
            raise AssertionError(self.done, self.disagreements()) from None
        assert not self.false_notices, self.done


@asynccontextmanager
async def walking(trained: Path, folder: Path) -> AsyncIterator[Walk]:
    """A walk whose first scenario is shown."""
    shutil.copytree(trained, folder, dirs_exist_ok=True)
    async with Running(folder) as (running, _):
        walk = Walk(running)
        walk.show(folder / "mine.yaml")
        yield walk


async def walked(trained: Path, folder: Path, numbers: range, *, costs: bool) -> None:
    async with walking(trained, folder) as walk:
        await walk.settle()
        for number in numbers:
            walk.random.seed(number)
            await walk.go(_STEPS, costs=costs and number % 10 == 0)


async def test_a_diagnosis_shows_each_of_several_agents(folder, monkeypatch):
    reports = [{"agent": one, "verdict": "solved", "causes": [], "solved": True} for one in ("fox", "hare")]
    monkeypatch.setattr(core, "loop", asyncio.get_running_loop())
    async with Running(folder) as (_, session):
        answer = (json.dumps({"runs": reports}), 0)
        monkeypatch.setattr(session.commands, "call", lambda _: asyncio.sleep(0, answer))
        with Client(page("/")) as client:
            await RunsTab(session, print, print).diagnose(Path("runs/tag"))
            shown = {getattr(element, "text", "") for element in client.elements.values()}
            assert {"fox: solved", "hare: solved"} <= shown


@pytest.fixture(autouse=True)
def looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions, "_WATCH_INTERVAL_S", 0.05)


async def test_a_save_while_a_finished_run_is_watched_brings_the_robot_of_the_text(trained, tmp_path):
    async with walking(trained, tmp_path) as walk:
        for name in ("watch", "edit", "save", "watch", "watch_and_save", *("watch", "look_at_curve") * 2):
            getattr(walk, name)()
            await walk.settle()


async def test_the_policy_of_a_run_drives_the_saved_text_until_another_observation_does_not_fit(
    trained, tmp_path
):
    shutil.copytree(trained, tmp_path, dirs_exist_ok=True)
    policy = f"policy of {tmp_path / 'runs' / 'mine-1'}"

    async with Running(tmp_path) as (running, session):
        robot = session.robot
        session.show(Path("mine.yaml"))
        await running.runs()
        robot.set_driver(policy)
        await running.until(lambda: robot.state.driver == policy)
        _writes(session, TINY.replace("15 deg", "20 deg"))
        await running.until(lambda: robot.state.parameters == {"fall_angle": "20 deg"})
        assert robot_text(session) == "driven by the policy of mine-1"

        _writes(session, TINY.replace("deg", "parsec"))
        await running.until(lambda: robot.state.state == "outdated")
        assert robot_text(session).startswith("the saved file has errors")

        _writes(session, TINY.replace("-20 .. 20 deg", "-30 .. 30 deg"))
        await running.until(lambda: robot.state.driver == "random")
        differs = "observation.cart.pole_angle: run -0.349066 .. 0.349066 rad, scenario -0.523599 .. 0.523599"
        assert differs in robot_text(session)
        robot.set_driver("random")
        await running.until(lambda: differs not in robot_text(session))
        robot.set_driver(policy)
        await running.until(lambda: differs in robot_text(session))
        assert robot.state.driver == "random"


@pytest.mark.slow
@pytest.mark.parametrize("session", range(10))
async def test_all_that_is_shown_agrees_with_the_files_in_random_walks(trained, tmp_path, session):
    first = session * _WALKS_OF_A_SESSION
    await walked(trained, tmp_path, range(first, first + _WALKS_OF_A_SESSION), costs=True)


@pytest.mark.slow
async def test_all_that_is_shown_agrees_with_the_files_in_a_walk(trained, tmp_path):
    await walked(trained, tmp_path, range(1000, 1001), costs=False)


@pytest.mark.parametrize(
    ("line_begins", "word", "says", "place"),
    [
        ("  fall_angle:", "fall_angle", "a parameter, an angle", ""),
        ("    fallen:", "fall_angle", "a parameter, an angle", "[line 4](#line:4)"),
        ("    fallen:", "pole_angle", "an angle", "[line 10](#line:10)"),
        ("truncation:", "max_steps", "**max_steps**", ""),
    ],
)
async def test_a_word_has_a_meaning_and_the_place_of_its_definition(folder, line_begins, word, says, place):
    line, text = next(entry for entry in enumerate(SCENARIO.split("\n")) if entry[1].startswith(line_begins))
    async with Running(folder) as (running, session):
        file = session.open(Path("mine.yaml"))
        await running.checked(file.path)
        meaning = session.language.meaning(file.path, file.text, line, text.index(word) + 1)
    assert says in meaning
    assert f"Defined in {place}." in meaning if place else "Defined" not in meaning


@pytest.mark.parametrize("phrase", ["pole length", "pole_angle"])
async def test_a_phrase_finds_names_of_the_text(folder, phrase):
    async with Running(folder) as (_, session):
        assert session.language.names_like(session.open(Path("mine.yaml")), phrase)[0] == ("pole_angle", 9)


@pytest.mark.parametrize(
    ("phrase", "entry"),
    [
        ("make the pole longer", "size and mass of a robot"),
        ("what is a policy", "policy"),
        ("my learning rate is too high", "learning rate"),
        ("drive to a ball", "wheeled"),
        ("quadrotor", "kind of a robot"),
        ("prismatic", "joint of a robot"),
    ],
)
def test_a_phrase_without_an_entry_gets_the_nearest_one_or_that_with_its_words_as_the_name(phrase, entry):
    assert f"**{entry}**" in explanation(phrase)


def test_a_link_to_the_documentation_opens_the_section_in_the_explanation():
    assert "(#explain:docs/language.md%23scripts)" in explanation("script")
    section = explanation("docs/language.md#scripts")
    assert section.startswith("### scripts\n")
    assert "\n### " not in section
    assert re.search(r"(?s)```text\n.*\]\(#explain:docs/", explanation("docs/what-is-rl.md"))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("pole2_2024 and runs/run_10_000", "pole2_2024 and runs/run_10_000"),
        ("10_000 steps (of 1_500_000)", "10,000 steps (of 1,500,000)"),
    ],
)
def test_commas_stand_in_numbers_and_not_in_names(text: str, shown: str) -> None:
    assert _unbroken(text) == shown


def test_the_commands_of_lessons_name_what_does_the_same_on_the_page() -> None:
    texts = [with_buttons(lesson.text("text.md")) for lesson in shipped_lessons()]
    lines = [line for text in texts for line in text.splitlines() if line.startswith("$ deepbots ")]
    for verb in ("lint", "render", "play", "explain", "course check"):
        assert [
            line for line in lines if line.startswith(f"$ deepbots {verb}") and "  # or " not in line
        ] == []
    assert "$ deepbots try mend.yaml --driver towards  # or choose Driver: towards" in lines
    # A driver of another engine, or of another case, cannot be chosen on the page.
    assert [line for line in lines if re.search("--(engine|case|seeds) .*# or ", line)] == []


def test_a_lesson_on_the_page_has_no_link_that_leads_away_from_it() -> None:
    text = with_buttons(
        "[Lesson 4](../04-endings/text.md), [RL](../../docs/what-is-rl.md) [1](https://example.org)."
    )
    assert text == "Lesson 4, [RL](#explain:docs/what-is-rl.md) [1](https://example.org)."
    shown = [with_buttons(lesson.text("text.md")) for lesson in shipped_lessons()]
    assert [link for text in shown for link in re.findall(r"\]\([^#)]*\.md\)", text)] == []


async def test_a_robot_file_in_millimeters_is_named_at_the_drop_and_in_the_text(folder):
    robot = robot_path("balancer").read_text("utf-8")
    wrong = re.sub(r'(<visual>.*?<box size=)"[^"]*"', r'\1"200 150 80"', robot, count=1, flags=re.DOTALL)
    assert wrong != robot
    dropped = [DroppedRobot.read(folder / "own.urdf", text.encode(), ()) for text in (robot, wrong)]
    assert [robot.build is not None for robot in dropped] == [True, True]
    assert (dropped[0].problem, "DB507" in dropped[1].problem) == ("", True)
    text = SCENARIO.replace("urdf: cartpole", "urdf: own.urdf  # own.urdf")
    (folder / "mine.yaml").write_text(text, encoding="utf-8")
    (folder / "own.urdf").write_text(wrong, encoding="utf-8")

    async with Running(folder) as (running, session):
        file = session.open(Path("mine.yaml"))
        await running.checked(file.path)
        found = [row for row in session.language.findings(file.path) if row.code == "DB507"]
        assert [text.splitlines()[row.start[0]].strip() for row in found] == ["urdf: own.urdf  # own.urdf"]
        assert found[0].message.startswith("own.urdf, line ")


async def test_an_error_in_a_base_or_in_a_robot_of_xacro_is_listed_where_the_scenario_names_the_file(folder):
    robot = robot_path("balancer").read_text("utf-8").replace("</robot>", '<link name="lost"/></robot>')
    (folder / "own.urdf.xacro").write_text(robot, encoding="utf-8")
    (folder / "robot.yaml").write_text(SCENARIO.replace("urdf: cartpole", "urdf: own.urdf.xacro"))
    (folder / "derived.yaml").write_text("deepbots: 1\nextends: cartpole\nremove: [augment.speed]\n")

    async with Running(folder) as (running, session):
        for name, line in (("robot.yaml", "urdf: own.urdf.xacro"), ("derived.yaml", "extends: cartpole")):
            file = session.open(Path(name))
            await running.checked(file.path)
            assert session.language.has_errors(file.path)
            found = session.language.findings(file.path)[0]
            assert (found.severity, file.text.splitlines()[found.start[0]].strip()) == ("error", line)
