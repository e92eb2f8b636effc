"""The session of a studio with its processes, without a page."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("viser")

from deepbots_cli.errors import UsageError
from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.studio import robot as robots
from deepbots_cli.studio import server
from deepbots_cli.studio.robot_pane import robot_text
from deepbots_cli.studio.server import studio
from deepbots_cli.studio.session import Session
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

    async def __aenter__(self) -> Running:
        self.session.listen(self._heard)
        self._task = asyncio.create_task(self.session.run_forever())
        return self

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
            await asyncio.sleep(0.02)

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


def test_findings_follow_the_text_and_the_files_that_it_reads(folder):
    (folder / "base.yaml").write_text("reward:\n  alive: 1\n", encoding="utf-8")
    text = SCENARIO.replace("reward:\n  alive: 1\n", "extends: base.yaml\n")
    (folder / "mine.yaml").write_text(text, encoding="utf-8")

    async def run() -> None:
        async with Running(folder) as running:
            session = running.session
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
            _writes(session, text)
            # Another program damages the file that the scenario reads.
            (folder / "base.yaml").write_text("reward:\n  alive: 1 parsec\n", encoding="utf-8")
            await running.until(lambda: session.language.has_errors(file.path))

    asyncio.run(run())


def test_a_late_request_for_completions_does_not_hide_findings(folder):
    async def run() -> None:
        async with Running(folder) as running:
            session = running.session
            file = session.open(Path("mine.yaml"))
            await running.checked(file.path)
            words = SCENARIO.replace("alive: 1", "alive: 1 + q")
            for text in (words, words.replace("+ q", "+ qq")):
                session.change(file, file.revision, text)
            # The browser sent it before the second letter; it arrives after it.
            session.language.complete(file.path, words, 17, 14)
            await running.checked(file.path)
            assert "qq" in session.language.findings(file.path)[0].message

    asyncio.run(run())


def test_a_removed_file_is_offered_by_the_next_studio_until_it_is_discarded(folder):
    async def run() -> None:
        async with Running(folder) as running:
            session = running.session
            file = session.open(Path("mine.yaml"))
            session.change(file, file.revision, SCENARIO.replace("name: Mine", "name: Minecraft"))
        file.path.unlink()
        async with Running(folder) as running:
            session = running.session
            assert list(session.removed_drafts()) == [file.path]
            again = session.open(Path("mine.yaml"))
            assert (again.text, again.is_gone) == (file.text, True)
            session.close_file(again.path)
            assert not session.removed_drafts()
            with pytest.raises(UsageError, match="is not a file"):
                session.open(Path("mine.yaml"))

    asyncio.run(run())


def test_an_added_entry_is_removed_with_the_section_that_it_alone_is_in(folder):
    async def run() -> None:
        async with Running(folder) as running:
            session = running.session
            session.show(Path("mine.yaml"))
            file = session.files[session.current]
            session.write_values({"reward.bonus": "0.1", "robots.cart.links.pole": "{scale: 1 1 2}"})
            assert "  bonus: 0.1\n" in file.text
            session.write_values({"reward.bonus": "", "robots.cart.links.pole": ""})
            assert file.text == SCENARIO
            with pytest.raises(UsageError, match="these values already"):
                session.write_values({"reward.bonus": ""})
            revision = file.revision
            with pytest.raises(UsageError, match="has no place for it"):
                session.write_values({"reward.bonus": "0.2", "name.first": "3"})
            assert (file.text, file.revision) == (SCENARIO, revision)
            session.training_options["--timesteps"] = "512"  # which would override the next value
            session.write_values({"train.total_timesteps": "1_024"})
            assert session.training_options["--timesteps"] == ""

    asyncio.run(run())


@pytest.mark.slow
def test_a_run_says_what_it_changed_against_the_one_before(folder):
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

    async def run() -> None:
        async with Running(folder) as running:
            await running.until(lambda: len(running.session.run_changes) == 2)
            changes = running.session.run_changes
            first, second = (changes[folder / "runs" / name] for name in ("0", "1"))
            assert first.text == "first run"
            expected = "reward.alive 1 -> 2; fall_angle 15 deg -> 12 deg; timesteps 512 -> 1_024; and 1 more"
            assert second.text == expected
            assert second.started >= first.started > 0

    asyncio.run(run())


@pytest.mark.slow
def test_the_robot_follows_the_newest_policy_of_a_training_until_a_text_is_saved(folder):
    async def run() -> None:
        async with Running(folder) as running:
            session = running.session
            session.show(Path("mine.yaml"))
            await running.runs()
            session.shown.follow(True)
            session.commands.train("mine.yaml", ["--timesteps", "1_000_000"])
            robot, training = session.robot, session.shown.training_task
            assert training is not None
            await running.until(lambda: robot.reference == str(folder / "runs" / "mine-1"))
            await running.until(lambda: robot.state is not None and "policy" in robot.state.note)
            await running.until(lambda: robot.state is not None and "policy after" in robot.state.note, 120)
            assert robot.state.driver == "policy"
            _writes(session, SCENARIO.replace("15 deg", "20 deg"))
            await running.runs()
            assert robot.reference == str(folder / "mine.yaml")
            # The page offers to follow the training again, while it runs.
            assert session.shown.may_follow
            training.stop()
            await running.until(lambda: not training.is_running, 120)
            assert not session.shown.may_follow

            # A training that has just ended is shown, too.
            session.shown.follow(True)
            await running.until(lambda: robot.reference == str(folder / "runs" / "mine-1"))
            await running.runs()

            # From a robot that shows a policy, the next training is followed without being asked.
            session.shown.follow(False)
            assert robot.reference == str(folder / "runs" / "mine-1")
            session.commands.train("mine.yaml", ["--timesteps", "512"])
            await running.until(lambda: robot.reference == str(folder / "runs" / "mine-2"))
            await running.runs()
            await running.until(lambda: not session.commands.tasks.running, 120)

    asyncio.run(run())


def test_saving_restarts_the_robot_and_errors_keep_the_last_world(folder):
    async def run() -> None:
        async with Running(folder) as running:
            session = running.session
            session.show(Path("mine.yaml"))
            robot = session.robot
            await running.runs()
            assert robot.state.parameters == {"fall_angle": "15 deg"}

            _writes(session, SCENARIO.replace("15 deg", "20 deg"))
            await running.until(lambda: robot.state.parameters == {"fall_angle": "20 deg"})
            assert robot.state.state == "running"
            assert running.notices == ["the robot has started again, with fall_angle 15 deg → 20 deg"]

            _writes(session, SCENARIO.replace("15 deg", "15 parsec"))
            await running.until(lambda: robot.state.state == "outdated")
            assert robot.state.parameters == {"fall_angle": "20 deg"}

            _writes(session, SCENARIO)
            await running.runs()
            await running.until(lambda: robot.state.parameters == {"fall_angle": "15 deg"})

            # A parameter changes in the running world, and is written into the text on request.
            session.robot.set_parameter("fall_angle", "0.3 rad")
            await running.until(lambda: robot.state.changed == {"fall_angle": "0.3 rad"})
            await running.until(lambda: robot.state.parameters == {"fall_angle": "0.3 rad"})
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

    asyncio.run(run())


def test_another_scenario_is_shown_by_the_same_process_until_one_cannot_be_opened(folder):
    (folder / "other.yaml").write_text(SCENARIO.replace("15 deg", "20 deg"), encoding="utf-8")
    (folder / "broken.yaml").write_text(SCENARIO.replace("15 deg", "15 parsec"), encoding="utf-8")

    async def run() -> None:
        async with Running(folder) as running:
            session, robot = running.session, running.session.robot
            session.show(Path("mine.yaml"))
            await running.runs()
            pid, address = running.robot_pid, robot.address
            robot.set_parameter("fall_angle", "0.3 rad")
            await running.until(lambda: robot.state.changed == {"fall_angle": "0.3 rad"})

            robot.show(folder / "other.yaml", "zero")
            assert (robot.state, robot.address) == (None, address)
            await running.runs()
            assert (robot.state.driver, robot.state.changed) == ("zero", {})
            assert robot.state.parameters == {"fall_angle": "20 deg"}

            session.shown.show_robot(folder / "broken.yaml")
            await running.until(lambda: robot.state is not None)
            assert robot.state.state == "errors"

            session.shown.show_robot(folder / "other.yaml")
            await running.runs()
            assert (running.robot_pid, robot.address) == (pid, address)
            assert robot.state.driver == "random"

            session.shown.show_robot(folder / "runs" / "gone")
            await running.until(lambda: robot.problem)
            assert "gone" in robot.problem
            session.shown.show_robot(folder / "mine.yaml")
            await running.runs()

    asyncio.run(run())


@pytest.mark.slow
def test_a_crashed_robot_is_named_and_started_again(folder):
    async def run() -> None:
        async with Running(folder) as running:
            session = running.session
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

    asyncio.run(run())


def test_a_robot_that_takes_long_to_load_is_shown_as_soon_as_it_is_loaded(folder, monkeypatch):
    monkeypatch.setattr(robots, "_PATIENCE_S", 0.5)
    (folder / "other.yaml").write_text(SCENARIO.replace("15 deg", "20 deg"), encoding="utf-8")

    async def run() -> None:
        async with Running(folder) as running:
            session = running.session
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
            assert session.robot.state.parameters == {"fall_angle": "20 deg"}
            assert running.notices == []

    asyncio.run(run())


@pytest.mark.slow
def test_a_robot_that_does_not_answer_is_named_and_ended_by_the_next_save(folder, monkeypatch):
    monkeypatch.setattr(robots, "_PATIENCE_S", 1.0)

    async def run() -> None:
        async with Running(folder) as running:
            session = running.session
            session.show(Path("mine.yaml"))
            await running.runs()
            pid = running.robot_pid
            os.kill(pid, signal.SIGSTOP)
            _writes(session, SCENARIO.replace("15 deg", "20 deg"))
            await running.until(lambda: session.robot.is_late)
            _writes(session, SCENARIO.replace("15 deg", "25 deg"))
            await running.until(lambda: session.robot.state is None)
            await running.runs()
            assert running.robot_pid != pid
            assert session.robot.state.parameters == {"fall_angle": "25 deg"}

    asyncio.run(run())


@pytest.mark.slow
def test_a_start_that_is_drawn_without_end_leaves_the_editor_free(folder):
    never = "\nreset:\n  attempts: 100000\n  require: [abs(cart.pole_angle) < -1]\n"
    (folder / "mine.yaml").write_text(SCENARIO + never, encoding="utf-8")

    async def run() -> None:
        async with Running(folder) as running:
            session = running.session
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

    asyncio.run(run())


@pytest.mark.slow
def test_a_training_outlives_the_session_and_is_found_again(folder):
    async def first() -> int:
        async with Running(folder) as running:
            session = running.session
            session.current = session.open(Path("mine.yaml")).path
            await running.checked(session.current)
            task = session.commands.train(session.saved_name(), ["--timesteps", "20000"])
            assert task.record.run == "runs/mine-1"
            await running.until(
                lambda: session.shown.training is not None and session.shown.training.curves.returns,
                120,
            )
            return len(session.shown.training.curves.returns)

    async def second(points: int) -> None:
        async with Running(folder) as running:
            session = running.session
            assert [task.record.run for task in session.commands.tasks.running] == ["runs/mine-1"]
            await running.until(
                lambda: session.shown.training is not None and session.shown.training.curves.returns
            )
            assert session.shown.training_task is session.shown.task
            await running.until(lambda: len(session.shown.training.curves.returns) > points, 120)
            assert session.shown.training.listed.state == "training"
            # Stop keeps the policy.
            session.shown.task.stop()
            await running.until(lambda: not session.shown.task.is_running)
            await running.until(lambda: session.shown.training.listed.state != "training")
            await running.until(lambda: any("mine-1 was stopped" in notice for notice in running.notices))
            # The curve goes on when the training does.
            session.commands.run(["resume", "runs/mine-1", "--timesteps", "40000"], Path("runs/mine-1"))
            await running.until(
                lambda: getattr(session.shown.training.listed, "state", "") == "training", 120
            )
            session.shown.task.stop()
            await running.until(lambda: not session.shown.task.is_running)
            assert (folder / "runs" / "mine-1" / "models" / "agent" / "last.zip").is_file()
            await session.read_runs()
            assert [(run.path.name, run.problem) for run in session.runs] == [("mine-1", None)]

    asyncio.run(second(asyncio.run(first())))
    assert [path.name for path in (folder / "runs").iterdir() if path.name[0] != "."] == ["mine-1"]


def test_a_run_directory_is_named_after_the_file(folder):
    name = "a [b]+.yaml"
    (folder / name).write_text(SCENARIO, encoding="utf-8")
    (folder / "runs" / "a_b_-1").mkdir(parents=True)
    session = Session(folder)
    assert session.commands.new_run(Path(name).stem) == Path("runs", "a_b_-2")


# Servers


def test_a_second_studio_of_a_folder_names_the_first(folder):
    first = studio(folder / "mine.yaml")
    with pytest.raises(UsageError) as refusal:
        studio(folder)
    address = first.address.partition("?")[0]
    assert str(refusal.value) == (
        f"another studio shows {folder}: {address} (process {os.getpid()}); use its page, or end it first"
    )


def test_a_busy_port_is_passed_over(folder, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as busy:
        first = busy.getsockname()[1]
        monkeypatch.setattr(server, "FIRST_PORT", first)
        address = studio(folder).address
    port = int(address.removeprefix("http://127.0.0.1:").partition("/")[0])
    assert first < port < first + 20


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
def test_studios_that_start_together_take_different_ports(tmp_path):
    for name in ("one", "two", "three"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.yaml").write_text(SCENARIO, encoding="utf-8")
    begun = [
        subprocess.Popen(
            python_command("deepbots_cli", "studio", "mine.yaml"),
            cwd=tmp_path / name,
            env=python_environment(),
            stdout=subprocess.PIPE,
            text=True,
        )
        for name in ("one", "two", "three")
    ]
    try:
        addresses = [process.stdout.readline().partition("?")[0] for process in begun]
        assert len(set(addresses)) == 3
    finally:
        for process in begun:
            process.send_signal(signal.SIGINT)
            process.wait(60)
            process.stdout.close()


@pytest.mark.slow
def test_a_killed_studio_leaves_its_folder_to_the_next(folder):
    with served(folder, "mine.yaml") as first:
        first.stop(signal.SIGKILL)
        with served(folder, "mine.yaml") as second:
            assert second.address.startswith("http://127.0.0.1:")
            third = Served(folder, "mine.yaml")
            assert third.address == ""
            assert third.process.wait(60) == 2
