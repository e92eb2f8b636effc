"""Trainings.

* Training and going on with it.
* A scenario that names no algorithm is trained with the learner that deepbots chooses by its structure.
* Compiled scenarios of every kind of observation, learned from in the engine: for a moment, to see that all
  of it fits together.
* A number that is not finite, or a world that explodes, is located, and its episode can be repeated.
* The shipped scenarios are learned as the results page says; minutes, so run by `make results`.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import stand_in
from stable_baselines3.common.env_checker import check_env
from stand_in import hyper

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.cli.records import training_text
from deepbots_cli.compiler import check
from deepbots_cli.document import loads, shipped
from deepbots_cli.errors import DeepbotsError, EngineError, RunError, ScenarioError, UsageError
from deepbots_cli.installation import install_hint
from deepbots_cli.learning import (
    TrainingResult,
    evaluate,
    evaluate_cases,
    learner,
    resume,
    train,
)
from deepbots_cli.learning.environments import FailureRecorder, reproduce
from deepbots_cli.learning.report import ProgressReporter, TrainingProgress, longer_goal
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.episodes import read_evaluations
from deepbots_cli.learning.runs.order import Candidate
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3 import algorithms
from deepbots_cli.learning.sb3.logs import TrainingLog
from deepbots_cli.learning.training import training_of
from deepbots_cli.program.task import Network, Schedule, Solved, Training
from tests.commands import Deepbots
from tests.few import few
from tests.files import written
from tests.learning.interruption import At


def short(tmp_path: Path, **settings: Any) -> TrainingResult:
    """A training of 256 steps."""
    training = Training(
        "PPO",
        settings.pop("total", 200),
        environments=2,
        hyperparameters=hyper(n_steps=32, batch_size=32, n_epochs=1, **settings.pop("hyper", {})),
    )
    return train(
        stand_in.compiled(training=training, solved=settings.pop("solved", None)), runs=tmp_path, **settings
    )


def test_the_small_world_is_a_proper_environment() -> None:
    check_env(stand_in.build(stand_in.scenario()))


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(tmp_path: Path) -> None:
    digests = [short(tmp_path, seed=seed, build=stand_in.build).weights_digest for seed in (0, 0, 1)]
    assert digests[0] == digests[1] != digests[2]


def test_tensorboard_shows_returns_terms_and_simulated_time(trained: TrainingResult) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(trained.run / "tensorboard"))
    events.Reload()
    tags = set(events.Tags()["scalars"])
    assert {
        "rollout/ep_rew_mean",
        "rollout/simulated_hours",
        "reward/alive",
        "reward/center",
        "time/fps",
        "time/real_time_factor",
    } <= tags
    assert {
        "action/probability",
        "action/forward",
        "action/backward",
        "saturation/x",
        "saturation/cart.pole_angle",
    } <= tags
    assert events.Scalars("action/forward")[0].value + events.Scalars("action/backward")[
        0
    ].value == pytest.approx(1.0)
    assert 0.0 <= events.Scalars("saturation/x")[0].value <= 1.0
    assert {"scenario/text_summary", "_hparams_/experiment"} <= set(events.summary_metadata)
    assert (
        "rollout/success_rate" not in tags
    )  # no episode of this task ends in success: 0 % would look like a failure


def test_tensorboard_shows_a_success_rate_where_episodes_may_end_in_success(tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    result = train(stand_in.compiled(success=True), runs=tmp_path, build=stand_in.build, total_timesteps=256)
    events = EventAccumulator(str(result.run / "tensorboard"))
    events.Reload()
    assert "rollout/success_rate" in events.Tags()["scalars"]


def test_training_stops_when_solved_unless_an_option_continues_it(tmp_path: Path) -> None:
    easy = Solved(2, mean_return=5.0)
    stopped = short(tmp_path, total=5_000, solved=easy, build=stand_in.build)
    assert stopped.status == "finished"
    assert stopped.steps < 2_000
    assert stopped.solved_at is not None
    assert stopped.solved_at.cpu_seconds > 0
    further = short(tmp_path, total=600, solved=easy, stop_when_solved=False, build=stand_in.build)
    assert further.steps >= 600
    assert further.solved_at is not None


@pytest.mark.slow
def test_event_files_of_one_second_are_read_in_the_order_in_which_they_were_written(run_copy: Path) -> None:
    run = Run.open(run_copy)
    (present,) = run.tensorboard.iterdir()
    first = present.rename(run.tensorboard / f"events.out.tfevents.{int(time.time())}.host.1.9")
    training = run.program.agent.training
    assert training is not None
    TrainingLog(run).open(training, is_new=False)
    assert min(path.name for path in run.tensorboard.iterdir()) == first.name
    assert max(int(path.name.split(".")[3]) for path in run.tensorboard.iterdir()) > int(
        first.name.split(".")[3]
    )


def test_train_and_resume_take_paths_as_text(tmp_path: Path) -> None:
    first = short(str(tmp_path / "many"), build=stand_in.build)  # type: ignore[arg-type]
    assert first.run.parent == tmp_path / "many"
    assert short(tmp_path, run=str(tmp_path / "one"), build=stand_in.build).run == tmp_path / "one"
    assert resume(str(first.run), total_timesteps=first.steps + 1, build=stand_in.build).run == first.run


def test_a_new_total_says_what_becomes_of_the_learning_rate(tmp_path: Path) -> None:
    first = short(tmp_path, hyper={"learning_rate": Schedule(1e-3, 0.0)}, build=stand_in.build)
    progress = At(10**9)
    longer = resume(first.run, total_timesteps=2 * first.steps, progress=progress, build=stand_in.build)
    assert longer.status == "finished"
    assert progress.notes == [
        "`learning_rate: 0.001 -> 0` now ends at 512 steps instead of 200; at 256 steps, it changes from 0 to"
        " 0.0005"
    ]


@pytest.mark.parametrize(
    "number", few([signal.SIGINT, signal.SIGTERM], ["SIGINT"], lambda number: number.name)
)
def test_an_interrupted_training_keeps_what_was_learned_and_says_how_to_go_on(
    tmp_path: Path, number: int
) -> None:
    handler = signal.getsignal(number)
    progress = At(2_000, lambda: os.kill(os.getpid(), number))
    result = short(tmp_path, total=50_000, progress=progress, build=stand_in.build)
    assert result.interrupted
    assert any(f"continue with: deepbots resume {result.run}" in note for note in progress.notes)
    assert f"deepbots resume {result.run}" in training_text(result)
    assert json.loads((result.run / "run.json").read_text())["status"] == "interrupted"
    assert signal.getsignal(number) is handler
    assert evaluate(result.run, episodes=1, build=stand_in.build).episodes == 1
    again = resume(result.run, total_timesteps=result.steps + 100, build=stand_in.build)
    assert again.status == "finished"
    assert again.steps > result.steps


def test_a_stop_after_the_last_step_leaves_nothing_to_resume(tmp_path: Path) -> None:
    result = short(
        tmp_path, total=300, solved=Solved(10, mean_return=1e6), progress=At(300), build=stand_in.build
    )
    assert result.status == "finished"
    assert result.stop_requested is True
    assert result.steps > 300
    assert "deepbots resume" not in training_text(result)
    assert f"evaluate the policy with: deepbots eval {result.run}" in training_text(result)
    with pytest.raises(UsageError, match="is complete"):
        resume(result.run, build=stand_in.build)


def test_a_stop_after_the_last_step_leaves_the_last_evaluation_to_resume(tmp_path: Path) -> None:
    result = short(
        tmp_path, total=300, solved=Solved(2, mean_return=1e6), progress=At(300), build=stand_in.build
    )
    assert result.status == "interrupted"
    assert result.stop_requested is True
    assert result.steps > 300
    assert f"deepbots resume {result.run}" in training_text(result)
    evaluated = [each["steps"] for each in read_evaluations(result.run)]
    again = resume(result.run, build=stand_in.build)
    assert (again.status, again.steps) == ("finished", result.steps)
    assert [each["steps"] for each in read_evaluations(result.run)] == [*evaluated, result.steps]
    with pytest.raises(UsageError, match="is complete"):
        resume(result.run, build=stand_in.build)


@pytest.mark.slow
def test_a_full_training_that_was_confirmed_stops_at_the_next_confirmation_if_it_is_resumed_so(
    tmp_path: Path,
) -> None:
    easy = Solved(2, mean_return=5.0)
    full = short(tmp_path, total=1_000, solved=easy, stop_when_solved=False, build=stand_in.build)
    assert full.solved_at is not None
    again = resume(full.run, total_timesteps=50_000, stop_when_solved=True, build=stand_in.build)
    assert again.solved_at is not None
    assert full.steps < again.solved_at.steps == again.steps < 50_000


@pytest.mark.parametrize(
    ("steps", "goal"), [(300_032, 600_000), (500_736, 1_000_000), (600, 1_000), (7_500, 20_000), (1, 2)]
)
def test_suggested_steps_are_round_and_more_than_there_are(steps: int, goal: int) -> None:
    assert longer_goal(steps) == goal


def log_of(monkeypatch: pytest.MonkeyPatch, begun: int, reports: dict[float, TrainingProgress]) -> list[str]:
    """The lines of a log about a training, from its progress by the time in s."""
    stream, now = io.StringIO(), 0.0
    monkeypatch.setattr("deepbots_cli.learning.report.time.perf_counter", lambda: now)
    display = ProgressReporter(stream)
    display.start(TrainingProgress(begun, 1_000_000, 0, None, None))
    for now, progress in reports.items():  # noqa: B007  # the clock reads it
        display.update(progress)
    return stream.getvalue().splitlines()


def test_a_log_gets_a_line_every_half_minute_and_one_for_an_evaluation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reports = {
        float(second): TrainingProgress(second * 100, 1_000_000, 0, None, None, evaluations=second // 50)
        for second in range(120)
    }
    assert [int(line.split()[0].replace(",", "")) for line in log_of(monkeypatch, 0, reports)] == [
        3_000,
        5_000,
        8_000,
        10_000,
    ]  # after 30 s, an evaluation after 50 s, 30 s later, a second evaluation after 100 s


def test_the_speed_leaves_out_the_time_before_the_first_step(monkeypatch: pytest.MonkeyPatch) -> None:
    reports = {
        90.0 + step: TrainingProgress(500_000 + 1_000 * step, 1_000_000, 0, None, None) for step in range(61)
    }
    assert log_of(monkeypatch, 500_000, reports)[-1].endswith("1,000 steps/s  at most 7:20 min to go")


def test_an_impatient_keyboard_interrupt_keeps_what_was_learned_too(tmp_path: Path) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    result = short(tmp_path, total=50_000, progress=At(2_000, interrupt), build=stand_in.build)
    assert result.interrupted
    assert (result.run / "models" / "agent" / "last.zip").exists()


def test_training_works_outside_the_main_thread(tmp_path: Path) -> None:
    results: list[TrainingResult] = []
    thread = threading.Thread(target=lambda: results.append(short(tmp_path, build=stand_in.build)))
    thread.start()
    thread.join()
    assert results[0].status == "finished"


def test_a_training_that_diverges_says_so_and_keeps_the_last_good_model(tmp_path: Path) -> None:
    training = Training(
        "PPO", 20_000, environments=2, hyperparameters=hyper(learning_rate=9e29, n_steps=32, batch_size=32)
    )
    with pytest.raises(RunError, match="diverged"):
        train(stand_in.compiled(training=training), runs=tmp_path, build=stand_in.build)
    run = next(tmp_path.iterdir())
    assert json.loads((run / "run.json").read_text())["status"] == "failed"
    assert evaluate(run, episodes=1, build=stand_in.build).episodes == 1


def test_a_reward_that_is_not_a_number_ends_the_training_with_its_term(tmp_path: Path) -> None:
    with pytest.raises(DeepbotsError, match="center"):
        short(tmp_path, build=lambda program, render_mode=None: stand_in.Failing(program, render_mode))
    assert json.loads((next(tmp_path.iterdir()) / "run.json").read_text())["status"] == "failed"


@pytest.mark.parametrize(
    ("training", "reason"),
    [
        (Training("PPO", 0), "at least 1"),
        (Training("PPOO", 100), "did you mean PPO"),
        (Training("PPO", 100, network=Network((8,) * 17)), "hidden layers"),
        (Training("SAC", 100), "SAC does not accept"),
        (Training("PPO", 100, hyperparameters=hyper(tau=1.0)), "PPO does not accept .*tau"),
        (Training("PPO", 100, hyperparameters=hyper(batch_size=1)), "PPO does not accept"),
    ],
)
def test_settings_that_cannot_be_trained_with_are_refused(
    tmp_path: Path, training: Training, reason: str
) -> None:
    with pytest.raises(UsageError, match=reason) as caught:
        train(
            stand_in.altered(stand_in.compiled(), policy={"training": training}),
            runs=tmp_path,
            build=stand_in.build,
        )
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_world_that_cannot_be_built_leaves_no_run_behind(tmp_path: Path) -> None:
    with pytest.raises(EngineError, match="no equations"):
        train("cartpole", run=tmp_path / "run", engine="exact")
    assert list(tmp_path.iterdir()) == []


def test_a_scenario_without_a_train_section_is_refused() -> None:

    with pytest.raises(UsageError, match="no `train` section"):
        training_of(stand_in.scenario().with_agent(training=None), None)


def test_worlds_are_closed_after_success_and_failure(tmp_path: Path) -> None:
    worlds: list[stand_in.CartPole] = []

    def build(program: Any, *, render_mode: str | None = None) -> stand_in.CartPole:
        worlds.append((stand_in.CartPole if len(worlds) < 3 else stand_in.Failing)(program))
        return worlds[-1]

    short(tmp_path, build=build)
    with pytest.raises(DeepbotsError):
        short(tmp_path, build=build)
    assert [world.closed for world in worlds] == [1] * 6


def test_without_a_terminal_progress_is_a_line_for_every_tenth(tmp_path: Path) -> None:
    stream = io.StringIO()
    short(tmp_path, total=1_000, progress=ProgressReporter(stream), build=stand_in.build)
    lines = stream.getvalue().splitlines()
    assert 5 <= len(lines) <= 11
    assert all("steps/s" in line and "return" in line for line in lines)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_table_of_a_terminal_fits_80_columns_and_shows_a_success_rate_of_0(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    solved = Solved(100, mean_return=195.0, success_rate=0.9)
    stage = "crowded (2 of 3): success rate 0.45 of 0.7, of episodes with a very long name of the criterion"
    display = ProgressReporter(stream)
    best = Candidate(steps=12_000, episodes=20, success_rate=0.1, mean_return=31.0)
    display.start(TrainingProgress(0, 20_000, 0, None, 0.0, stage, solved))
    display.update(
        TrainingProgress(20_000, 20_000, 300, 26.6, 0.0, stage, solved, best, "success_rate", 0.032)
    )
    display.stop()
    lines = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", stream.getvalue()).splitlines()
    assert max(map(len, lines)) <= 80
    text = " ".join(" ".join(lines).split())
    results = (
        "success 0% (needs 90%)",
        "return 26.6 (needs 195)",
        "best evaluation success rate 10% at 12,000 steps",
    )
    assert all(part in text for part in (*results, "crowded (2 of 3)", "so far"))


def test_the_time_to_go_includes_evaluations_and_the_choice_of_the_best_model() -> None:
    progress = TrainingProgress(
        600, 1_000, 9, 1.0, None, evaluation_seconds=40.0, evaluation_seconds_left=30.0
    )
    assert progress.seconds_left(100, elapsed=90.0) == 400 * (90.0 - 40.0) / 500 + 30.0
    assert TrainingProgress(1_000, 1_000, 9, 1.0, None).seconds_left(0, elapsed=90.0) is None


def test_a_drawn_value_is_in_the_log_of_its_episode(tmp_path: Path) -> None:
    class Drawing(stand_in.CartPole):
        def reset(self, **settings: Any) -> Any:
            observation, info = super().reset(**settings)
            return observation, info | {"drawn": {"reset.joints.cart.pole_hinge": self.angle}}

    run = train(stand_in.compiled(), run=tmp_path / "run", build=Drawing).run
    with (run / "monitor.csv").open(newline="") as file:
        next(file)
        drawn = [json.loads(row["drawn"])["reset.joints.cart.pole_hinge"] for row in csv.DictReader(file)]
    assert len(set(drawn)) == len(drawn) > 5


NEEDS_EXTRA = """
import sys
sys.modules[sys.argv[1]] = None
import stand_in
import deepbots_cli.learning
try:
    deepbots_cli.learning.train(stand_in.compiled(), build=stand_in.build)
except deepbots_cli.learning.MissingExtraError as error:
    print(error)
"""


@pytest.mark.slow
@pytest.mark.parametrize("module", few(["torch", "stable_baselines3", "tensorboard"], ["torch"]))
def test_a_missing_extra_is_one_sentence_with_the_command(module: str, tmp_path: Path) -> None:
    message = python(NEEDS_EXTRA, module, folder=tmp_path)
    assert message == f"training needs the 'train' extra; {install_hint('train')}\n"
    assert not list(tmp_path.iterdir())


def test_importing_the_package_brings_neither_torch_nor_numpy(tmp_path: Path) -> None:
    code = (
        "import sys, deepbots_cli.learning.report\nprint([name for name in ('torch', 'numpy',"
        " 'gymnasium') if name in sys.modules])"
    )
    assert python(code, folder=tmp_path) == "[]\n"


def python(code: str, *arguments: str, folder: Path) -> str:
    """The output of a fresh interpreter."""
    places = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=60, check=True, cwd=folder, env=os.environ | places
    ).stdout


def test_results_are_json_and_text(trained: TrainingResult) -> None:
    assert json.loads(json.dumps(trained.model_dump(mode="json")))["run"] == str(trained.run)
    assert str(trained.run) in training_text(trained)


def test_networks_beyond_the_memory_are_refused_before_they_are_built() -> None:
    training = Training("PPO", 100, network=Network((8192,) * 16))
    with pytest.raises(UsageError, match="weights"):
        algorithms.check(training)


def test_a_first_layer_beyond_the_memory_is_refused_before_it_is_built() -> None:
    training = Training("PPO", 100, network=Network((8192,)))
    observations = gym.spaces.Box(-1.0, 1.0, (10_000,))
    with pytest.raises(
        UsageError, match="10,000 observed numbers and hidden layers of 8192 units has more than 50,000,000"
    ):
        learner.create(learner.Setup(training, observations, gym.spaces.Discrete(2)))


def test_the_check_of_an_algorithm_that_does_not_exist_names_those_that_do() -> None:
    with pytest.raises(UsageError, match=r"there is no algorithm 'PP0'; use one of .*PPO"):
        algorithms.check(Training("PP0", 100))


def test_worlds_beyond_the_memory_are_refused_before_they_are_built() -> None:
    algorithms.check_memory(8, memory=10**9)
    with pytest.raises(
        UsageError,
        match=r"1024 environments need about 29\.7 GB of memory, and this machine or container has"
        r" 8\.0 GB",
    ):
        algorithms.check_memory(1024, memory=8 * 10**9)


def test_the_memory_limit_of_a_container_is_its_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in (("none", "max\n"), ("some", "500000000\n")):
        (tmp_path / name).write_text(text)
    files = tmp_path / "missing", tmp_path / "none", tmp_path / "some"
    monkeypatch.setattr(algorithms, "CONTAINER_LIMITS", files)
    algorithms.check_memory(8)
    with pytest.raises(UsageError, match=r"or container has 0\.5 GB"):
        algorithms.check_memory(32)


def test_a_training_interrupted_during_set_up_goes_on_from_the_beginning(tmp_path: Path) -> None:
    builds = []

    def interrupted(*arguments: Any, **settings: Any) -> Any:
        builds.append(1)
        if len(builds) > 1:  # the first is the rehearsal, before there is a run
            raise KeyboardInterrupt
        return stand_in.build(*arguments, **settings)

    result = short(tmp_path, build=interrupted)
    assert (result.status, result.steps) == ("interrupted", 0)
    assert json.loads((result.run / "run.json").read_text())["status"] == "interrupted"
    gone_on = resume(result.run, build=stand_in.build)
    assert gone_on.weights_digest == short(tmp_path, build=stand_in.build).weights_digest


def test_a_training_that_was_killed_when_it_was_done_is_finished_by_resuming_it(
    run_copy: Path, trained: TrainingResult
) -> None:
    record = json.loads((run_copy / "run.json").read_text())
    (run_copy / "run.json").write_text(json.dumps(record | {"status": "running", "result": None}))
    events = {path.name: path.read_bytes() for path in (run_copy / "tensorboard").iterdir()}
    result = resume(run_copy, build=stand_in.build)
    assert (result.status, result.steps) == ("finished", trained.steps)
    assert result.weights_digest == trained.weights_digest
    assert (run_copy / "monitor.csv").read_bytes() == (trained.run / "monitor.csv").read_bytes()
    assert all((run_copy / "tensorboard" / name).read_bytes() == content for name, content in events.items())
    with pytest.raises(UsageError, match="is complete"):
        resume(run_copy, build=stand_in.build)


def test_a_finished_run_without_its_checkpoint_is_damaged_and_not_begun_again(run_copy: Path) -> None:
    shutil.rmtree(run_copy / "checkpoints")
    for name in ("models/agent/best.zip", "models/agent/last.zip"):
        (run_copy / name).unlink()
    with pytest.raises(RunError, match="checkpoint"):
        resume(run_copy, total_timesteps=100_000, build=stand_in.build)


@pytest.mark.parametrize("figures", [{"seed": -1}, {"seed": 2**63}, {"total_timesteps": 10**20}])
def test_a_run_whose_figures_could_not_be_read_back_is_refused_before_it_is_made(
    tmp_path: Path, figures: dict[str, int]
) -> None:
    with pytest.raises(UsageError, match=str(abs(next(iter(figures.values()))))):
        train(stand_in.compiled(), runs=tmp_path, build=stand_in.build, **figures)
    assert not list(tmp_path.iterdir())


def test_a_run_that_is_being_trained_is_not_resumed_by_a_second_process(run_copy: Path) -> None:
    (run_copy / ".lock").touch()
    before = {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()}
    with run_lock(run_copy), pytest.raises(UsageError, match="another process writes to"):
        resume(run_copy, total_timesteps=3_000, build=stand_in.build)
    assert {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()} == before
    assert (
        resume(run_copy, total_timesteps=2_100, stop_when_solved=False, build=stand_in.build).steps >= 2_100
    )


EXPECTED = {
    "balancer": ("PPO", 16),
    "cartpole": ("PPO", 8),
    "cartpole_continuous": ("PPO", 8),
    "find_and_avoid": ("MaskablePPO", 16),
    "find_ball": ("SAC", 8),
    "multi_cartpole": ("PPO", 1),
    "panda_push": ("SAC", 4),
    "panda_reach": ("SAC", 4),
    "quadruped": ("PPO", 256),
    "see_ball": ("PPO", 16),
}


def compiled(folder: Path, scenario: str, train: str | None = None) -> Compiled:
    """A shipped scenario with this `train` section instead of its own, with the learner that is chosen."""
    own = "" if train is None else f"train: {train}\n"
    written(folder / "base.yaml", f"deepbots: 1\nextends: {scenario}\nname: Base\nremove: [train]\n")
    file = written(folder / "mine.yaml", f"deepbots: 1\nextends: base.yaml\nname: Mine\n{own}")
    return api.with_learner(api.compile(file))


def test_the_reason_for_the_length_of_an_update_counts_the_copies() -> None:
    overrides = ["train={algorithm: auto}", "robots.cart.count=3"]
    chosen = api.with_learner(api.compile("multi_cartpole", overrides=overrides))
    assert any("updates every 384 steps" in reason for reason in chosen.learner)


def test_a_shorter_training_with_self_play_has_as_many_past_policies() -> None:
    training = "train={algorithm: PPO, total_timesteps: 1_000_000, self_play: {newest: 40 %}}"
    program = api.compile("sumo", overrides=[training]).program
    for total in (1_000_000, 20_000):
        shared = dict(training_of(program, total).agents)["red"]
        assert (shared.total_timesteps, shared.self_play and shared.self_play.every) == (total, total // 20)


def settings(chosen: Compiled) -> dict[str, Any]:
    training = chosen.program.agent.training
    assert training is not None
    return {entry.name: entry.value for entry in training.hyperparameters} | vars(training)


@pytest.mark.parametrize(
    "scenario", few(shipped.scenario_names(), ("cartpole", "find_ball", "panda_push", "quadruped", "tag"))
)
def test_every_shipped_scenario_without_train_can_be_trained(tmp_path: Path, scenario: str) -> None:
    chosen = compiled(tmp_path, scenario)
    assert chosen.findings == ()
    assert chosen.learner
    algorithm, worlds = EXPECTED.get(scenario, (None, None))
    assert algorithm is None or (settings(chosen)["algorithm"], settings(chosen)["environments"]) == (
        algorithm,
        worlds,
    )


@pytest.mark.slow
@pytest.mark.parametrize("scenario", few(EXPECTED, ("cartpole",)))
def test_a_chosen_learner_trains(tmp_path: Path, scenario: str) -> None:
    assert train(compiled(tmp_path, scenario), run=tmp_path / "run", total_timesteps=300).steps >= 300
    run = Run.open(tmp_path / "run")
    assert run.program.agent.training == compiled(tmp_path, scenario).program.agent.training
    assert run.record.learner == compiled(tmp_path, scenario).learner


def test_auto_is_the_same_as_none(tmp_path: Path) -> None:
    none, empty, auto = (
        compiled(tmp_path, "cartpole", text) for text in (None, "{gamma: 98 %}", "{algorithm: auto}")
    )
    assert none.digest == auto.digest == empty.digest
    assert none.resolved == auto.resolved


def test_with_a_teacher_the_policy_learns_by_imitation(tmp_path: Path) -> None:
    assert settings(compiled(tmp_path, "panda_push", "{teacher: by_hand}"))["algorithm"] == "PPO"
    assert settings(compiled(tmp_path, "quadruped", "{teacher: trot}"))["environments"] == 16


def test_given_values_stay_and_their_reasons_go(tmp_path: Path) -> None:
    values = {
        "gamma": 0.5,
        "n_epochs": 3,
        "environments": 3,
        "network": {"activation": "relu"},
        "total_timesteps": 1000,
        "learning_rate": "1e-3 -> 0",
    }
    chosen = compiled(tmp_path, "cartpole", json.dumps(values))
    chosen_settings = settings(chosen)
    assert (
        chosen_settings["gamma"],
        chosen_settings["environments"],
        chosen_settings["total_timesteps"],
    ) == (0.5, 3, 1000)
    assert (chosen_settings["network"].hidden, chosen_settings["network"].activation) == ((64, 64), "relu")
    assert (chosen_settings["learning_rate"].start, chosen_settings["learning_rate"].end) == (1e-3, 0)
    assert (chosen_settings["n_epochs"], chosen_settings["n_steps"]) == (3, 64)
    assert [reason.split(":")[0] for reason in chosen.learner] == [
        "PPO"
    ]  # those for `environments` and `gamma` are gone


def test_a_scenario_without_train_is_otherwise_as_before(tmp_path: Path) -> None:
    compiled(tmp_path, "cartpole")
    assert api.compile(tmp_path / "mine.yaml").program.agent.training is None


def test_what_no_algorithm_can_act_in_is_an_error(tmp_path: Path) -> None:
    base = compiled(tmp_path, "cartpole").source
    mixed = written(
        tmp_path / "mixed.yaml",
        f"deepbots: 1\nextends: {base.name}\nname: Mixed\naction: {{more: -1 .. 1}}\n",
    )
    with pytest.raises(ScenarioError, match="no algorithm supports choices and ranges"):
        train(mixed, run=tmp_path / "run")
    assert not (tmp_path / "run").exists()


KINDS = {
    "goal": """
remove: [reward.alive, solved]
parameters: {place: uniform(-0.3 .. 0.3 m)}
action: {drive: -1 .. 1}
goal: {achieved: x, desired: place, tolerance: 2 cm, range: -0.4 .. 0.4 m}
reward:
  near: 0 if goal_reached else -1
truncation: {max_steps: 40}
train: {algorithm: SAC, total_timesteps: 200, environments: 2, replay: her, network: {hidden: [8]}, learning_starts: 80}
""",
    "picture": """
robots:
  cart:
    sensors:
      eye: {type: camera, link: body, pose: {z: 5 cm}, resolution: 40 36}
    emit: [pole_angle, eye]
messages: {format: struct}
observation:
  cart.eye: {range: auto, history: 2}
train: {total_timesteps: 100, environments: 2, n_steps: 32, batch_size: 32, n_epochs: 1}
""",
    "memory": """
train: {algorithm: RecurrentPPO, lstm: 8, total_timesteps: 200, environments: 2, n_steps: 32, batch_size: 32, n_epochs: 1}
""",
    "team": """
robots: {cart: {count: 3, spacing: 0 0.5 0 m}}
agent: {each: cart}
world: {arena: {size: 4 4 m}}
train: {total_timesteps: 300, environments: 2, n_steps: 32, batch_size: 32, n_epochs: 1}
""",
    "masks": """
action:
  drive:
    choices: {forward: 1, backward: -1}
    forbid: {forward: x > 0.2 m}
train: {algorithm: MaskablePPO, total_timesteps: 200, environments: 2, n_steps: 32, batch_size: 32, n_epochs: 1}
""",
    "stages": """
curriculum:
  - {name: near, set: {track: 0.2 m}, until: 100 steps}
  - {name: late, set: {messages.timing: delayed}, until: mean_return >= 5 over 2 episodes}
  - {name: usual}
evaluation:
  cases:
    steep: {set: {fall_angle: 5 deg}, episodes: 2}
train: {total_timesteps: 400, environments: 2, n_steps: 32, batch_size: 32, n_epochs: 1}
""",
}


@pytest.mark.parametrize(
    "kind",
    [
        "goal",
        *(pytest.param(kind, marks=pytest.mark.slow) for kind in few(KINDS, ["stages"]) if kind != "goal"),
    ],
)
def test_it_is_trained_evaluated_and_gone_on_with(tmp_path: Path, kind: str) -> None:
    base = shipped.scenario_path("cartpole")
    assert base is not None
    scenario = written(tmp_path / f"{kind}.yaml", f"deepbots: 1\nextends: {base}\nname: Kind\n{KINDS[kind]}")
    compiled = api.compile(scenario, overrides=["world.engine=mujoco"])  # which is the faster
    result = train(compiled, run=tmp_path / "run")
    first, again = (evaluate(result.run, episodes=2) for _ in range(2))
    assert (first, first.success_defined) == (again, kind == "goal")
    assert [case.case for case in evaluate_cases(result.run)] == [
        case.name for case in compiled.program.cases
    ]
    assert result.stage == ("usual" if kind == "stages" else None)
    goal = result.steps + 64
    assert resume(result.run, total_timesteps=goal).steps >= goal


ODD = {
    "reward": "reward: {alive: 1, odd: 1 / (20 - step)}",
    "observation": "augment: {growth: exp(step * 4)}\nobservation: {growth: {range: 0 .. 1, clip: false}}",
}


def not_finite_after_some_steps(name: str) -> Compiled:
    """The CartPole, in which a reward term or an observed value has no value after some steps."""
    return api.compile(
        check(
            loads(
                f"deepbots: 1\nextends: cartpole.yaml\nname: Odd\n{ODD[name]}\n",
                base=Path("scenarios").absolute(),
            )
        )
    )


@pytest.mark.parametrize(("name", "field"), [("reward", "`odd = "), ("observation", "growth")])
@pytest.mark.parametrize("engine", [pytest.param("pybullet", marks=pytest.mark.slow), "mujoco"])
def test_a_value_that_is_not_finite_is_reported_with_its_place_and_repeated_from_a_file(
    tmp_path: Path, name: str, field: str, engine: str
) -> None:
    """On MuJoCo the worlds are a batch."""
    pytest.importorskip(engine)
    with pytest.raises(DeepbotsError) as caught:
        train(not_finite_after_some_steps(name), run=tmp_path / "run", total_timesteps=2_000, engine=engine)
    text = str(caught.value)
    notes = caught.value.full_message
    path = tmp_path / "run" / "failures" / "0001.json"
    failure, error = reproduce(path)
    assert all(
        part in text for part in (f"episode {failure.episode} (seed ", "step ", field, f"deepbots try {path}")
    )
    assert failure.error in text
    assert error is not None
    assert text.startswith(error)
    assert "nothing was learned before; run `deepbots lint --deep SCENARIO`" in notes
    assert "deepbots eval" not in notes


def hurled(push: str, shards: int = 1) -> Compiled:
    """The CartPole with a motor at its hinge that hurls the pole out of the range of numbers, in the episodes
    that draw a `push`."""
    text = f"""
deepbots: 1
extends: cartpole.yaml
name: Hurled
parameters: {{push: {push}}}
robots:
  cart:
    receive: {{push: push}}
    actuators: {{hinge: {{type: torque_motor, joint: pole_hinge, max_torque: 1e9 N*m}}}}
    apply: {{hinge: push * 1 N*m}}
termination: {{failure: {{fallen: abs(cart.pole_angle) > 10000 deg, off_track: abs(x) > 1e200 m}}}}
truncation: {{max_steps: 4}}
train: {{n_steps: 16, n_epochs: 1, shards: {shards}, environments: {8 * shards}}}
"""
    return api.compile(check(loads(text, base=Path("scenarios").absolute())))


def test_a_world_of_a_batch_that_becomes_infinite_is_reset_and_its_episode_is_kept(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    following = At(10**9)
    rarely = f"choice({' | '.join(['0'] * 30)} | 1e9)"
    done = train(
        hurled(rarely), run=tmp_path / "run", total_timesteps=256, engine="mujoco", progress=following
    )
    resets = [text for text in following.notes if "was reset" in text]
    files = sorted((tmp_path / "run" / "failures").iterdir())
    assert done.status == "finished"
    assert len(resets) == len(files) == (tmp_path / "run" / "monitor.csv").read_text().count("not_finite") > 0
    for text, path in zip(resets, files, strict=True):
        assert re.match(
            r"episode \d+ \(seed \d+\), step \d: (the pose of 'cart' became infinite or NaN|joint '\w+' of 'cart'"
            rf" turns at .*)\nreproduce .* {path}\n",
            text,
        )
        failure, error = reproduce(path)
        assert error is not None
        assert failure.error.endswith(error.partition("), ")[2])


def test_a_training_reports_each_lost_episode_of_a_batch_and_keeps_ten(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    following = At(10**9)
    rarely = f"choice({' | '.join(['0'] * 30)} | 1e9)"
    # No evaluation of this seed draws a push.
    train(
        hurled(rarely),
        run=tmp_path / "run",
        seed=1,
        total_timesteps=2_048,
        engine="mujoco",
        progress=following,
    )
    resets = [text for text in following.notes if "was reset" in text]
    _, _, *episodes = (tmp_path / "run" / "monitor.csv").read_text().splitlines()
    numbers = [number for number, line in enumerate(episodes, 1) if "not_finite" in line]
    assert [int(text.split()[1]) for text in resets] == numbers
    assert len(numbers) > 10
    assert len(list((tmp_path / "run" / "failures").iterdir())) == 10


@pytest.mark.parametrize("shards", [1, 2])
def test_a_training_stops_when_worlds_of_a_batch_are_lost_again_and_again(
    tmp_path: Path, shards: int
) -> None:
    pytest.importorskip("mujoco")
    with pytest.raises(
        EngineError,
        match="in 10 of the last 10 episodes the physics was not stable; the last one is episode 10 ",
    ) as caught:
        train(hurled("1e9", shards), run=tmp_path / "run", total_timesteps=2_000, engine="mujoco")
    files = sorted(path.name for path in (tmp_path / "run" / "failures").iterdir())
    assert len(files) == 10
    assert files[-1] in str(caught.value)


def test_an_evaluation_names_the_episode_and_its_seed(run_copy: Path) -> None:
    class Late(stand_in.Failing):
        """Fails in its second episode."""

        episodes = 0

        def reset(self, **settings: Any) -> Any:
            self.episodes += 1
            return super().reset(**settings)

        def step(self, action: Any) -> Any:
            return super().step(action) if self.episodes > 1 else stand_in.CartPole.step(self, action)

    with pytest.raises(DeepbotsError, match=r"episode 1 \(seed \d+\), step 5: .*'center'"):
        evaluate(run_copy, episodes=2, build=Late)
    assert (run_copy / "failures" / "0001.json").exists()


def test_an_observation_that_is_not_finite_is_named() -> None:
    class Blind(stand_in.CartPole):
        def _observation(self) -> Any:
            observation = super()._observation()
            observation[2] = np.nan if self.steps == 3 else observation[2]
            return observation

        def reset(self, **settings: Any) -> Any:
            self.steps = 0
            return super().reset(**settings)

    program = stand_in.scenario()
    world = FailureRecorder(Blind(program), program=program)
    world.reset(seed=1)
    for _ in range(2):
        world.step(0)
    with pytest.raises(DeepbotsError, match=r"step 3: the observation 'cart.pole_angle' is not finite"):
        world.step(0)


def test_a_damaged_file_is_refused(trained: TrainingResult, run_copy: Path) -> None:
    folder = run_copy / "failures"
    folder.mkdir()
    whole = (
        '{"error": "", "step": 1, "episode": 1, "case": null, "stage": null, "start": %s, "actions": [%s]}'
    )
    for content in (
        "{",
        whole % ('{"root": "x"}', "0"),
        whole % ("0", '"x"'),
        whole % ("-1", "0"),
        whole % ("0", "7"),
    ):
        (folder / "0001.json").write_text(content)
        with pytest.raises(RunError, match="damaged"):
            reproduce(folder / "0001.json")


@pytest.fixture
def failed(trained: TrainingResult, run_copy: Path) -> Path:
    """The file of a failed episode in a run of the CartPole."""
    folder = run_copy / "failures"
    folder.mkdir()
    content = {
        "error": "odd",
        "step": 2,
        "episode": 1,
        "case": None,
        "stage": None,
        "start": 0,
        "actions": [0, 1],
    }
    (folder / "0001.json").write_text(json.dumps(content))
    return folder / "0001.json"


@pytest.mark.parametrize(
    "words",
    [
        ("--engine", "mujoco"),
        ("--seed", "0"),
        ("--driver", "zero", "--episodes", "1"),
    ],
)
def test_a_kept_episode_takes_no_settings(failed: Path, words: tuple[str, ...], deepbots: Deepbots) -> None:
    message = deepbots("try", failed, *words, code=2).err
    assert "not go with the file of a failed episode; its start and its actions are its own" in message
    assert all(word in message for word in words if word.startswith("--"))


def test_a_kept_episode_is_repeated_from_within_its_folder(
    failed: Path, monkeypatch: pytest.MonkeyPatch, deepbots: Deepbots
) -> None:
    monkeypatch.chdir(failed.parent)
    assert "repeated 2 actions: the episode does not fail" in deepbots("try", failed.name).out


def test_a_kept_episode_without_its_run_is_refused(failed: Path, tmp_path: Path, deepbots: Deepbots) -> None:
    assert (
        "copy the file into the folder `failures` of the run"
        in deepbots("try", failed.rename(tmp_path / "sent.json"), code=2).err
    )


def test_a_scenario_in_json_is_not_a_kept_episode(tmp_path: Path, deepbots: Deepbots) -> None:
    scenario = written(tmp_path / "mine.json", '{"deepbots": 1, "extends": "cartpole", "name": "Mine"}')
    assert "episodes" in deepbots("try", scenario, "--episodes", "1").out
