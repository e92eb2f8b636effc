"""A training that is killed at any moment, and resumed, becomes the same as one that was never interrupted,
to the bit."""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import resource
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import stand_in
import torch
import yaml
from stand_in import hyper

from deepbots_cli import api
from deepbots_cli.cli.records import training_text
from deepbots_cli.document import Permissions, shipped
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import checkpoints, evaluate, resume, train
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3.state import StableState
from deepbots_cli.program import Program
from deepbots_cli.program.task import (
    ActionNoise,
    AdaptiveRate,
    Hindsight,
    Network,
    Schedule,
    Solved,
    Training,
)
from deepbots_cli.rollout.source import Source
from deepbots_cli.rollout.worlds import SingleWorlds, observation_digest
from deepbots_cli.runtime.batch import EpisodeHistory
from deepbots_cli.scenario import Scenario
from tests.few import few
from tests.learning.interruption import outcome

SMALL = Network((16,))


FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(["stand_in", "deepbots_cli.learning.training"])


def work(name: str, run: Path, seed: int) -> None:
    """Begin a training, or continue it; checkpoints follow each other fast, and their times change nothing in
    the result."""
    checkpoints.INTERVAL_S, checkpoints.MIN_INTERVAL_PER_COST = (0.5, 10) if name in SHIPPED else (0.02, 2)
    if (run / "run.json").exists():
        if Run.open(run).record.status != "finished":
            resume(run, build=build_of(name))
    else:
        shutil.rmtree(run, ignore_errors=True)  # killed while it was made
        train(
            compiled_of(name), run=run, seed=seed, stop_when_solved=name not in SHIPPED, build=build_of(name)
        )


def in_a_process(name: str, run: Path, kill_after: float, number: int = signal.SIGKILL, seed: int = 0) -> int:
    """Work in a process of its own, and kill it; its exit code."""
    process = FORKS.Process(target=work, args=(name, run, seed))
    process.start()
    process.join(kill_after)
    if process.is_alive():
        os.kill(process.pid or 0, number)
    process.join(60)
    assert process.exitcode is not None
    return process.exitcode


def survives(name: str, folder: Path, kills: int, seed: int = 0, number: int = signal.SIGKILL) -> None:
    """Train twice, once with kills at random moments; a shipped scenario takes its seed, the small ones have
    a single uninterrupted run."""
    root = seed if name in SHIPPED else 0
    whole = folder / f"whole-{root}"
    parts = folder / f"parts-{seed}"
    generator = random.Random(seed)
    began = time.perf_counter()
    if not whole.exists():
        assert in_a_process(name, whole, 1800.0, seed=root) == 0
        (folder / f"seconds-{root}").write_text(str(time.perf_counter() - began))
    took = float((folder / f"seconds-{root}").read_text())
    code = 1
    for _ in range(kills):
        code = in_a_process(name, parts, generator.uniform(0.1, 1.2) * took / 2, number, root)
        if code == 0 and number == signal.SIGKILL:
            break
        assert code == -number or number == signal.SIGINT
        if (parts / "run.json").exists():
            Run.open(parts)
    if code != 0 or ((parts / "run.json").exists() and Run.open(parts).record.status != "finished"):
        assert in_a_process(name, parts, 1800.0, seed=root) == 0
    expected, continued = outcome(whole), outcome(parts)
    for part in expected:
        assert continued[part] == expected[part], part


OFF_POLICY = {"learning_starts": 100}
CASES: dict[str, dict[str, Any]] = {
    "PPO": {
        "training": Training(
            "PPO", 1_500, 3, hyper(n_steps=32, batch_size=32, n_epochs=2, learning_rate=Schedule(3e-3, 0.0))
        )
    },
    "TD3": {
        "training": Training(
            "TD3",
            400,
            2,
            hyper(**OFF_POLICY, buffer_size=500),
            SMALL,
            ActionNoise("ornstein_uhlenbeck", Schedule(0.5, 0.1)),
            normalize="reward",
        ),
        "continuous": True,
    },
    "DDPG": {"training": Training("DDPG", 700, 1, hyper(**OFF_POLICY), SMALL), "continuous": True},
    "SAC": {
        "training": Training("SAC", 500, 2, hyper(**OFF_POLICY, use_sde=True), SMALL),
        "continuous": True,
    },
    "DQN": {"training": Training("DQN", 1_000, 2, hyper(**OFF_POLICY, buffer_size=300), SMALL)},
    "adaptive rate": {
        "training": Training(
            "PPO", 1_200, 2, hyper(n_steps=32, batch_size=32, learning_rate=AdaptiveRate(0.01, 1e-3)), SMALL
        )
    },
    "A2C": {"training": Training("A2C", 1_500, 2, normalize="reward")},
    "RecurrentPPO": {
        "training": Training("RecurrentPPO", 800, 2, hyper(lstm=8, n_steps=32, batch_size=32), SMALL)
    },
    "MaskablePPO": {"training": Training("MaskablePPO", 2_000, 2, hyper(n_steps=32, batch_size=32), SMALL)},
    "TQC": {"training": Training("TQC", 300, 1, hyper(**OFF_POLICY), SMALL), "continuous": True},
    "HER": {
        "training": Training(
            "SAC", 700, 2, hyper(learning_starts=200, buffer_size=500), SMALL, None, Hindsight()
        ),
        "continuous": True,
        "max_steps": 30,
        "more": "goal: {achieved: x, desired: 0.1 m, tolerance: 2 cm, range: -0.4 .. 0.4 m}\n",
    },
    "older weights": {
        "training": Training(
            "TD3",
            400,
            2,
            hyper(**OFF_POLICY, buffer_size=500),
            SMALL,
            ActionNoise("normal", 0.2),
            shards=2,
            staleness=1,
        ),
        "continuous": True,
    },
    "curriculum": {
        "training": Training("PPO", 1_200, 3, hyper(n_steps=32, batch_size=32)),
        "more": "curriculum:\n"
        "  - {name: a, set: {truncation.max_steps: 5}, until: mean_return >= 4.5 over 20 episodes}\n"
        "  - {name: b, set: {truncation.max_steps: 20}, until: 500 steps}\n"
        "  - {name: c}\n",
    },
}

_CARTPOLE = "n_steps: 64, batch_size: 64, learning_rate: 3e-3 -> 0"
SHIPPED = {
    "CartPole PPO": ("cartpole", f"algorithm: PPO, total_timesteps: 20000, environments: 4, {_CARTPOLE}"),
    "FindBall PPO": ("find_ball_random", "algorithm: PPO, total_timesteps: 20000, environments: 4"),
    **{
        f"CartPole {algorithm}": (
            "cartpole_continuous",
            f"algorithm: {algorithm}, total_timesteps: 3000, environments: 2",
        )
        for algorithm in ("TD3", "SAC", "DDPG")
    },
    **{
        f"FindBall {algorithm}": (
            "find_ball_random",
            f"algorithm: {algorithm}, total_timesteps: 2400, environments: 2",
        )
        for algorithm in ("TD3", "SAC", "DDPG")
    },
    "FindBall PPO, teacher": (
        "find_ball_random",
        "algorithm: PPO, total_timesteps: 8000, environments: 4, n_steps: 64, batch_size: 64, teacher:"
        " {script: along_path, share: 0.6}",
    ),
    "FindBall SAC, teacher": (
        "find_ball_random",
        "algorithm: SAC, total_timesteps: 2400, environments: 2, teacher: along_path",
    ),
}
"""Shipped scenarios in the simulator: the scenario, and its section `train`. FindBall goes through its
curriculum by steps."""

_SMALL_PPO = (
    "algorithm: PPO, environments: 8, n_steps: 16, batch_size: 64, n_epochs: 2, network: {hidden: [16]}"
)
AGENTS = {
    "Carry": ("carry", f"{_SMALL_PPO}, total_timesteps: 3200"),
    "Sumo, self-play": (
        "sumo",
        f"{_SMALL_PPO}, total_timesteps: 1600, self_play: {{every: 256, pool: 3, newest: 50 %}}",
    ),
}
"""Shipped scenarios with several agents: the scenario, and its section `train`."""


def compiled_of(name: str) -> api.Compiled:
    if name in AGENTS:
        scenario, section = AGENTS[name]
        return api.compile(scenario, overrides=[f"train={{{section}}}", "evaluation.episodes=5"])
    if name in SHIPPED:
        return _shipped(*SHIPPED[name])
    return stand_in.compiled(**{"solved": Solved(30, mean_return=190.0)} | CASES[name])


def _shipped(scenario: str, section: str) -> api.Compiled:
    """A scenario with another section `train`; the stages of its curriculum end after a quarter of the steps
    each."""
    base = Scenario.from_yaml(Source.open(scenario).path)
    training = yaml.safe_load(f"{{{section}}}")
    changes: dict[str, Any] = {"train": training, "evaluation": {"episodes": 5}, "tests": {}}
    if base.curriculum:
        stages = [stage.model_dump(exclude_unset=True) for stage in base.curriculum]
        changes["curriculum"] = [
            stage | {"until": f"{training['total_timesteps'] // 4} steps"} if "until" in stage else stage
            for stage in stages
        ]
    return api.compile(Scenario(**base.model_dump(exclude_unset=True) | changes))


def build_of(name: str) -> Any:
    if name in SHIPPED or name in AGENTS:
        return None
    return Reach if name == "HER" else stand_in.build


class Reach(stand_in.CartPole):
    """The cart-pole, for a policy with goals."""

    def __init__(self, program: Program, render_mode: str | None = None) -> None:
        super().__init__(program, render_mode)
        goal = gym.spaces.Box(-1, 1, (1,), np.float32)
        self.observation_space = gym.spaces.Dict(
            {"observation": self.observation_space, "achieved_goal": goal, "desired_goal": goal}
        )

    def _observation(self) -> Any:
        achieved, desired = np.array([self.x / 0.4], np.float32), np.array([0.25], np.float32)
        return {"observation": super()._observation(), "achieved_goal": achieved, "desired_goal": desired}

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
        return -(np.abs(achieved - desired)[..., 0] > 0.05).astype(np.float32)


@pytest.mark.parametrize("name", few(list(CASES), ["TD3"]))
def test_a_training_that_is_killed_becomes_the_same_as_one_that_is_not(tmp_path: Path, name: str) -> None:
    survives(name, tmp_path, 1)


@pytest.mark.parametrize(
    ("name", "kills"),
    [("Sumo, self-play", 1), *(pytest.param(name, 5, marks=pytest.mark.slow) for name in AGENTS)],
)
def test_so_does_every_agent_of_several(tmp_path: Path, name: str, kills: int) -> None:
    survives(name, tmp_path, kills)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "trainings"), [("PPO", 20), ("TD3", 5), ("SAC", 5), ("DDPG", 5)])
def test_so_do_many(tmp_path: Path, name: str, trainings: int) -> None:
    for seed in range(trainings):
        survives(name, tmp_path, 3, seed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"),
    [(f"{task} PPO", seed) for task in ("CartPole", "FindBall") for seed in range(10)]
    + [
        (f"{task} {name}", seed)
        for name in ("TD3", "SAC", "DDPG")
        for task, count in (("CartPole", 3), ("FindBall", 2))
        for seed in range(count)
    ]
    + [(f"FindBall {name}, teacher", seed) for name in ("PPO", "SAC") for seed in range(5)],
)
def test_so_does_a_training_in_the_simulator(tmp_path: Path, name: str, seed: int) -> None:
    survives(name, tmp_path, 1 + seed % 3, seed)


@pytest.mark.slow
def test_a_run_can_be_opened_after_any_of_two_hundred_kills(tmp_path: Path) -> None:
    generator = random.Random(0)
    run = tmp_path / "run"
    kills = 0
    with_checkpoint = 0
    began = time.perf_counter()
    assert in_a_process("PPO", tmp_path / "whole", 120.0) == 0
    took = time.perf_counter() - began
    while kills < 200:
        code = in_a_process("PPO", run, generator.uniform(0.0, took))
        kills += code == -signal.SIGKILL
        if (run / "run.json").exists():
            opened = Run.open(run)
            if (last := checkpoints.latest_checkpoint(opened)) is not None:
                checkpoints.read_state(last, StableState)
                assert all(path.is_file() for path in (opened.model("best"), opened.model("last")))
                with_checkpoint += 1
        if code == 0:
            shutil.rmtree(run)
    assert with_checkpoint > 50


@pytest.mark.slow
@pytest.mark.parametrize("name", few(shipped.scenario_names(), ["find_and_avoid"]))
def test_a_shipped_world_is_brought_back_in_the_middle_of_an_episode(name: str) -> None:
    """In a fresh world, from the states of its random generators as JSON and the actions of the episode."""
    compiled = api.compile(name, permissions=Permissions(code=True))
    with closing(SingleWorlds([api.build(compiled.program, permissions=Permissions(code=True))], [7])) as env:
        env.reset()
        env.action_space.seed(1)
        ended, steps = 0, 0
        while steps < 12 or (not ended and steps < 3_000):
            actions = np.array([env.action_space.sample() for _ in range(env.rows)])
            dones = env.step_all(actions)[2]
            ended = ended + bool(dones[0])
            steps = 0 if dones[0] else steps + 1
        (history,) = env.histories()
        digest = observation_digest(env.observations)
    kept = EpisodeHistory(json.loads(json.dumps(history.start)), list(np.array(history.actions)))
    with closing(SingleWorlds([api.build(compiled.program, permissions=Permissions(code=True))], [8])) as env:
        env.reset()
        assert observation_digest(env.repeat([kept])) == digest


@pytest.mark.slow
def test_a_world_that_does_not_repeat_itself_is_noted_and_the_training_goes_on(tmp_path: Path) -> None:
    class Moody(stand_in.CartPole):
        """No two episodes begin alike."""

        def reset(self, **settings: Any) -> Any:
            _, info = super().reset(**settings)
            self.angle += random.uniform(0.0, 1e-3)
            return self._observation(), info

    run = train(compiled_of("PPO"), run=tmp_path / "run", total_timesteps=400, build=Moody).run
    result = resume(run, total_timesteps=800, build=Moody)
    assert "new episodes began" in result.inexact[0]
    assert f"note: {result.inexact[0]}" in training_text(result)


@pytest.mark.slow
def test_a_training_with_a_higher_goal_may_remember_more(tmp_path: Path) -> None:
    training = Training(
        "DQN", 200, 2, hyper(learning_starts=50), SMALL
    )  # whose buffer holds as many steps as the goal
    run = train(stand_in.compiled(training=training), run=tmp_path / "run", build=stand_in.build).run
    assert resume(run, total_timesteps=400, build=stand_in.build).steps == 400
    assert resume(run, total_timesteps=480, build=stand_in.build).steps == 480


@pytest.mark.slow
def test_checkpoints_are_kept_at_equal_distances_and_can_be_used(tmp_path: Path) -> None:
    run = train(
        compiled_of("PPO"),
        run=tmp_path / "run",
        total_timesteps=1_000,
        keep_checkpoints=4,
        build=stand_in.build,
    ).run
    kept = sorted(path.name for path in (run / "models" / "agent").glob("step-*.zip"))
    assert len(kept) == 4
    assert kept[0] == "step-000000288.zip"  # the first rollout of 96 steps that ends after 250


def test_a_training_begins_with_the_policy_of_another_run_and_says_what_it_took_over(tmp_path: Path) -> None:
    first = train(compiled_of("PPO"), run=tmp_path / "first", total_timesteps=500, build=stand_in.build)
    same = train(
        compiled_of("PPO"),
        run=tmp_path / "same",
        total_timesteps=96,
        initialize_from=first.run,
        build=stand_in.build,
    )
    assert same.initialized_from == f"{first.run}: 12 of 12 tensors"
    assert "initialized from" in training_text(same)
    wider = stand_in.compiled(
        training=Training("PPO", 96, 3, hyper(n_steps=32, batch_size=32), Network((64, 32)))
    )
    taken = train(
        wider, run=tmp_path / "wider", initialize_from=first.run, build=stand_in.build
    ).initialized_from
    assert taken is not None
    assert "new: " in taken
    unlike = stand_in.compiled(training=Training("DQN", 96, 1, hyper(learning_starts=50), Network((7,))))
    with pytest.raises(UsageError, match="no tensor"):
        train(unlike, run=tmp_path / "other", initialize_from=first.run, build=stand_in.build)
    assert not (tmp_path / "other").exists()


def test_a_folder_that_cannot_be_written_leaves_the_last_good_state(tmp_path: Path) -> None:
    run = train(compiled_of("PPO"), run=tmp_path / "run", total_timesteps=200, build=stand_in.build).run
    before = checkpoints.latest_checkpoint(Run.open(run))
    (run / "checkpoints" / "new").write_text("in the way")
    (run / "models" / "agent" / "last.zip").unlink()
    (run / "models" / "agent" / "last.zip").mkdir()
    with pytest.raises(RunError, match=r"cannot be written.*") as caught:
        resume(run, total_timesteps=400, build=stand_in.build)
    assert f"is kept; continue from there with: deepbots resume {run}" in caught.value.full_message
    assert checkpoints.latest_checkpoint(Run.open(run)) == before
    assert evaluate(run, episodes=1, build=stand_in.build).episodes == 1


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """Within, writing more bytes into a file fails, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("size", [0, 8_000])
def test_a_training_without_room_for_its_first_files_names_one_and_can_begin_again(
    tmp_path: Path, size: int
) -> None:
    """No byte fits, or the inputs and no model."""
    run = tmp_path / "run"
    with files_of_at_most(size), pytest.raises(UsageError, match=r"cannot be written: file too large"):
        train(compiled_of("PPO"), run=run, total_timesteps=500, build=stand_in.build)
    if size:
        assert resume(run, build=stand_in.build).status == "finished"
    else:
        assert not run.exists()


@pytest.mark.slow
def test_a_training_without_room_for_a_checkpoint_keeps_the_last_one_and_becomes_the_same(
    tmp_path: Path,
) -> None:
    whole = train(compiled_of("PPO"), run=tmp_path / "whole", total_timesteps=200, build=stand_in.build).run
    cut = shutil.copytree(whole, tmp_path / "cut")
    with (
        files_of_at_most(8_000),
        pytest.raises(UsageError, match=r"cannot be written: file too large") as caught,
    ):
        resume(cut, total_timesteps=400, build=stand_in.build)
    assert f"is kept; continue from there with: deepbots resume {cut}" in caught.value.full_message
    for run in (whole, cut):
        resume(run, total_timesteps=400, build=stand_in.build)
    for part in ("models", "monitor", "scalars"):
        assert outcome(cut)[part] == outcome(whole)[part]


def test_the_threads_of_torch_are_those_of_the_caller_afterwards(tmp_path: Path) -> None:
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        run = train(compiled_of("PPO"), run=tmp_path / "run", total_timesteps=96, build=stand_in.build).run
        evaluate(run, episodes=1, build=stand_in.build)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)
