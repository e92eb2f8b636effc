"""Random walks over what a person does in the studio: after each step, all that is shown agrees with files.

The session is that of a page, without the page: its robot, its commands and its trainings are real processes.
"""

from __future__ import annotations

import asyncio
import json
import random
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("viser")
pytest.importorskip("stable_baselines3")

import deepbots_cli
from deepbots_cli import learning
from deepbots_cli.learning.campaigns.listing import read_listed
from deepbots_cli.learning.runs.episodes import read_evaluations
from deepbots_cli.studio import session as sessions
from deepbots_cli.studio.files import OpenFile
from deepbots_cli.studio.robot_pane import robot_text
from deepbots_cli.studio.shown import TABS
from deepbots_cli.studio.trainings import result_text
from tests.studio.test_studio_page import SCENARIO
from tests.studio.test_studio_session import Running

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
    """What the robot is to be of, and its angle. `until` are the evaluations of a run when it was shown."""

    reference: Path
    angle: str
    until: tuple[float, ...] = ()

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
            if notice.startswith(f"runs/{run.name}: ") and not notice.endswith(result_text(read_listed(run))):
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
        self.session.change(self.file, base, text)
        # The second browser has not seen it.
        self.session.change(self.file, base, before + note)
        assert _ANGLE.search(self.file.text)[1] == _ANGLE.search(text)[1]
        assert self.file.text.endswith(note)

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
        self.world = World(run, self.angle(run), tuple(evaluations(run)))

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
            self.world = World(run, self.angle(run), tuple(evaluations(run)))

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
            facts["evaluations"] = (state.evaluations[: len(world.until)], world.until)
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
            drawn = [value for _, value in training.curves.evaluations]
            facts["drawn evaluations"] = (drawn, pytest.approx(evaluations(self.curve)))
        return [f"{name}: {one}, not {other}" for name, (one, other) in facts.items() if one != other]

    async def settle(self) -> None:
        """Wait until all that is shown agrees with the files."""
        try:
            await self.running.until(lambda: not self.disagreements(), 60)
        except AssertionError:
            raise AssertionError(self.done, self.disagreements()) from None
        assert not self.false_notices, self.done


def walked(trained: Path, folder: Path, numbers: range, *, costs: bool) -> None:
    shutil.copytree(trained, folder, dirs_exist_ok=True)

    async def run() -> None:
        async with Running(folder) as running:
            walk = Walk(running)
            walk.show(folder / "mine.yaml")
            await walk.settle()
            for number in numbers:
                walk.random.seed(number)
                await walk.go(_STEPS, costs=costs and number % 10 == 0)

    asyncio.run(run())


@pytest.fixture(autouse=True)
def looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions, "_WATCH_INTERVAL_S", 0.05)


def test_a_save_while_a_finished_run_is_watched_brings_the_robot_of_the_text(trained, tmp_path):
    shutil.copytree(trained, tmp_path, dirs_exist_ok=True)

    async def run() -> None:
        async with Running(tmp_path) as running:
            walk = Walk(running)
            walk.show(tmp_path / "mine.yaml")
            for act in (
                walk.watch,
                walk.edit,
                walk.save,
                walk.watch,
                walk.watch_and_save,
                walk.look_at_curve,
            ):
                act()
                await walk.settle()

    asyncio.run(run())


@pytest.mark.slow
@pytest.mark.parametrize("session", range(10))
def test_all_that_is_shown_agrees_with_the_files_in_random_walks(trained, tmp_path, session):
    first = session * _WALKS_OF_A_SESSION
    walked(trained, tmp_path, range(first, first + _WALKS_OF_A_SESSION), costs=True)


def test_all_that_is_shown_agrees_with_the_files_in_a_walk(trained, tmp_path):
    walked(trained, tmp_path, range(1000, 1001), costs=False)
