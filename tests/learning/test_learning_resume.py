"""Trainings that are interrupted, in shards, taught, or followed by other packages.

* A training that is killed at any moment, and resumed, becomes the same as one that was never interrupted, to
  the bit.
* The worlds of a training in shards: the result depends on their number, and not on where and how often they
  begin.
* A script teaches the policy: what it learns, and that it resumes and runs in shards to the bit.
* A policy that sees more teaches one that sees less.
* Callbacks and loggers of other packages follow a training and keep it exact; one that fails is named.
* The measurement of trainings with several numbers of shards.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import resource
import shutil
import signal
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import stand_in
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.envs import BitFlippingEnv
from stable_baselines3.common.vec_env import DummyVecEnv
from stable_baselines3.her import HerReplayBuffer
from stand_in import hyper

from deepbots_cli import api
from deepbots_cli.analysis import unobserved_reads
from deepbots_cli.cli.records import training_text
from deepbots_cli.errors import PluginError, RunError, UsageError
from deepbots_cli.learning import (
    TrainingResult,
    checkpoints,
    evaluate,
    load_policy,
    resume,
    train,
    train_group,
)
from deepbots_cli.learning.campaigns.listing import read_listed
from deepbots_cli.learning.environments import WorldFactory
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.learning.policy import load_model
from deepbots_cli.learning.runs.run import Run, RunRecord
from deepbots_cli.learning.sb3.imitation import keep_labels, labeled
from deepbots_cli.learning.shards import LocalShards, Shard, world_numbers
from deepbots_cli.learning.teaching import Teaching
from deepbots_cli.program.task import (
    ActionNoise,
    AdaptiveRate,
    Hindsight,
    Network,
    Schedule,
    Solved,
    Teacher,
    Training,
)
from deepbots_cli.rollout.collector import EvaluationOrder, Order, RunningEpisode, ShardPool
from deepbots_cli.rollout.worlds import Array
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.recordings import record
from tests.few import few
from tests.learning.interruption import At, becomes_the_same, outcome
from tests.plugins import test_plugins

SMALL = Network((16,))


FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(["stand_in", "deepbots_cli.learning.training"])


def work(name: str, run: Path) -> None:
    """Begin a training, or continue it; checkpoints follow each other fast, and their times change nothing in
    the result."""
    checkpoints.INTERVAL_S, checkpoints.MIN_INTERVAL_PER_COST = 0.02, 2
    if (run / "run.json").exists():
        if Run.open(run).record.status != "finished":
            resume(run, build=build_of(name))
    else:
        shutil.rmtree(run, ignore_errors=True)  # killed while it was made
        train(compiled_of(name), run=run, build=build_of(name))


def in_a_process(name: str, run: Path, kill_after: float) -> int:
    """Work in a process of its own, and kill it; its exit code."""
    process = FORKS.Process(target=work, args=(name, run))
    process.start()
    process.join(kill_after)
    if process.is_alive():
        os.kill(process.pid or 0, signal.SIGKILL)
    process.join(60)
    assert process.exitcode is not None
    return process.exitcode


def survives(name: str, folder: Path, kills: int) -> None:
    """Train twice, once with kills at random moments."""
    whole, parts = folder / "whole", folder / "parts"
    generator = random.Random(0)
    began = time.perf_counter()
    assert in_a_process(name, whole, 1800.0) == 0
    took = time.perf_counter() - began
    for _ in range(kills):
        in_a_process(name, parts, generator.uniform(0.1, 1.2) * took / 2)
        if (parts / "run.json").exists():
            Run.open(parts)
    assert in_a_process(name, parts, 1800.0) == 0
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


_SMALL_PPO = (
    "algorithm: PPO, environments: 8, n_steps: 16, batch_size: 64, n_epochs: 2, network: {hidden: [16]}"
)
AGENTS = {
    "Carry": ("carry", f"{_SMALL_PPO}, total_timesteps: 3200"),
    "Sumo, self-play": (
        "sumo",
        f"{_SMALL_PPO}, total_timesteps: 800, self_play: {{every: 128, pool: 3, newest: 50 %}}",
    ),
}
"""Shipped scenarios with several agents: the scenario, and its section `train`."""


def compiled_of(name: str) -> api.Compiled:
    if name in AGENTS:
        scenario, section = AGENTS[name]
        return api.compile(scenario, overrides=[f"train={{{section}}}", "evaluation.episodes=5"])
    return stand_in.compiled(**{"solved": Solved(30, mean_return=190.0)} | CASES[name])


def build_of(name: str) -> Any:
    if name in AGENTS:
        return None
    return stand_in.Reach if name == "HER" else stand_in.build


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


def test_a_file_that_its_writer_names_in_bytes_as_tensorboard_does_is_named(tmp_path: Path) -> None:
    def write(*_: object) -> None:
        os.truncate(b"no/such/file", 0)

    with pytest.raises(RunError, match="no/such/file cannot be written: no such file"):
        train(compiled_of("PPO"), run=tmp_path / "run", build=stand_in.build, on_evaluation=write)


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """Within, writing more bytes into a file fails, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("size", [0, 20_000])
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


def test_the_threads_of_torch_are_those_of_the_caller_afterwards(tmp_path: Path) -> None:
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        run = train(compiled_of("PPO"), run=tmp_path / "run", total_timesteps=96, build=stand_in.build).run
        evaluate(run, episodes=1, build=stand_in.build)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)


ALGORITHMS = [name for name in CASES if name not in ("DDPG", "TQC", "older weights")]


class Forgetful:
    """Shards that are lost with every fragment: others continue from the state that the collector keeps."""

    def shards(
        self, stack: ExitStack, run: Run, training: Training, build: WorldFactory, note: Any
    ) -> ShardPool:
        class Pool(LocalShards):
            def work(
                self,
                order: Order | EvaluationOrder | None,
                episodes: Sequence[Sequence[RunningEpisode]],
                memories: Sequence[Mapping[str, Array]],
            ) -> Callable[[], list[Any]]:
                if isinstance(order, Order):
                    self.close()
                    self._shards = [
                        Shard(run, build, number, worlds)
                        for number, worlds in enumerate(world_numbers(training))
                    ]
                    super().work(None, episodes, memories)
                return super().work(order, episodes, memories)

        pool = Pool(
            [Shard(run, build, number, worlds) for number, worlds in enumerate(world_numbers(training))]
        )
        stack.callback(pool.close)
        return pool


def trained(
    name: str, folder: Path, executor: Executor, shards: int = 2, staleness: int = 0
) -> dict[str, Any]:
    settings = {"solved": Solved(30, mean_return=190.0)} | CASES[name]
    training: Training = settings["training"]
    total = min(training.total_timesteps, 600)
    settings["training"] = replace(
        training,
        environments=max(3, training.environments),
        shards=shards,
        total_timesteps=total,
        staleness=staleness,
    )
    compiled = stand_in.compiled(**settings)
    section = compiled.program.agent.training
    assert section is not None
    assert (section.shards, section.staleness) == (shards, staleness)
    train(compiled, run=folder, build=build_of(name), executor=executor)
    return outcome(folder)


@pytest.mark.slow
@pytest.mark.parametrize("name", few(ALGORITHMS, ["TD3"]))
def test_shards_that_are_lost_with_every_fragment_give_the_same(tmp_path: Path, name: str) -> None:
    kept, lost = trained(name, tmp_path / "kept", SERIAL), trained(name, tmp_path / "lost", Forgetful())
    for part in kept:
        assert lost[part] == kept[part], part


@pytest.mark.slow
@pytest.mark.parametrize("name", few(ALGORITHMS, ["curriculum"]))
def test_with_older_weights_too(tmp_path: Path, name: str) -> None:
    kept = trained(name, tmp_path / "kept", SERIAL, staleness=1)
    lost = trained(name, tmp_path / "lost", Forgetful(), staleness=1)
    for part in kept:
        assert lost[part] == kept[part], part
    assert kept["models"] != trained(name, tmp_path / "newest", SERIAL)["models"]


def test_the_first_shards_have_one_world_more_if_the_sizes_differ() -> None:
    assert world_numbers(Training("PPO", 1, environments=7, shards=3)) == [range(3), range(3, 5), range(5, 7)]


BALANCER = [
    "truncation.max_time=0.4s",
    "train.environments=4",
    "train.n_steps=16",
    "train.batch_size=64",
    "train.network.hidden=[16]",
]
TAUGHT = {
    "PPO": ("balancer", [*BALANCER, "train.teacher={script: lean, share: 0.5}"]),
    "PPO in stages": (
        "balancer",
        [
            *BALANCER,
            "train.teacher={script: lean, share: 0.7}",
            "curriculum=[{name: low, set: {limit: 20 deg}, until: mean_return >= 1 over 2 episodes}, {name:"
            " usual}]",
        ],
    ),
    "SAC": (
        "balancer",
        [
            "truncation.max_time=0.4s",
            "train={algorithm: SAC, total_timesteps: 500, environments: 4, learning_starts: 100,"
            " train_freq: 8, gradient_steps: 4, "
            "network: {hidden: [16]}, teacher: {script: lean, share: 0.5}}",
        ],
    ),
}
STEPS = 512


def taught(name: str, folder: Path, changes: list[str] | None = None, **options: Any) -> dict[str, Any]:
    scenario, own = TAUGHT[name]
    train(
        api.compile(scenario, overrides=[*own, *(changes or [])]),
        run=folder,
        total_timesteps=STEPS,
        stop_when_solved=False,
        **options,
    )
    return outcome(folder)


@pytest.mark.slow
@pytest.mark.parametrize("steps", few([100, 225, 350], ["225"]))
@pytest.mark.parametrize("name", few(TAUGHT, ["PPO in stages"]))
def test_an_interrupted_training_with_a_teacher_resumes_to_the_bit(
    tmp_path: Path, name: str, steps: int
) -> None:
    scenario, changes = TAUGHT[name]
    compiled = api.compile(scenario, overrides=changes)
    options: dict[str, Any] = {"total_timesteps": STEPS, "stop_when_solved": False}
    whole = becomes_the_same(compiled, tmp_path, steps, **options)
    assert {"teacher/weight", "teacher/driven_worlds", "teacher/mean_return"} <= whole["scalars"].keys()


def test_a_policy_imitates_its_teacher(tmp_path: Path) -> None:
    lengths = {}
    for name, changes in (("taught", ["train.teacher=lean"]), ("alone", [])):
        compiled = api.compile(
            "balancer", overrides=[*BALANCER, "world.engine=mujoco", "truncation.max_time=2s", *changes]
        )
        result = train(compiled, run=tmp_path / name, total_timesteps=2_000, stop_when_solved=False)
        lengths[name] = evaluate(result.run, model="last", episodes=5).mean_length
    assert lengths["taught"] > 150
    assert lengths["alone"] < 100


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["SAC", "TD3", "TQC"])
def test_an_actor_with_a_replay_buffer_imitates_its_teacher(tmp_path: Path, algorithm: str) -> None:
    learner = (
        "total_timesteps: 1600, environments: 4, learning_starts: 200, network: {hidden: [32]},"
        " teacher: {script: lean, share: 1.0}"
    )
    compiled = api.compile(
        "balancer", overrides=["truncation.max_time=4s", f"train={{algorithm: {algorithm}, {learner}}}"]
    )
    result = train(compiled, run=tmp_path / "run", stop_when_solved=False)
    assert evaluate(result.run, model="last", episodes=10).mean_length > 300


@pytest.mark.slow
def test_with_a_teacher_evaluations_decide_what_exploration_spoils(tmp_path: Path) -> None:
    learner = (
        "total_timesteps: 1600, environments: 4, learning_starts: 200, train_freq: 4, gradient_steps: 4,"
        " network: {hidden: [32]}, action_noise: {type: normal, sigma: 1.0}"
    )
    train_ = f"train={{algorithm: TD3, {learner}, teacher: {{script: lean, share: 0.9}}}}"
    compiled = api.compile(
        "balancer",
        overrides=[
            "world.engine=mujoco",
            "truncation.max_time=0.5s",
            "solved=mean_return >= 47 over 10 episodes",
            train_,
        ],
    )
    result = train(compiled, run=tmp_path / "run")
    assert result.solved_at is not None
    assert result.mean_return is not None
    assert result.mean_return < 47 <= result.solved_at.mean_return
    assert result.confirmed_seed is not None


def test_labels_in_a_replay_buffer_apply_to_the_goal_of_their_episode_only() -> None:
    env = DummyVecEnv([lambda: BitFlippingEnv(n_bits=4, continuous=True, max_steps=4)])
    hindsight = {"n_sampled_goal": 3}
    model: Any = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs=hindsight,
        buffer_size=100,
    )
    keep_labels(model)
    observation: Any = env.reset()
    goals = set()
    for _ in range(60):
        action = np.array([env.action_space.sample()])
        step: Any = env.step(action)
        model.replay_buffer.add(dict(observation), dict(step[0]), labeled(action, -action), *step[1:])
        goals.add((*action[0].tolist(), *observation["desired_goal"][0].tolist()))
        observation = step[0]
    drawn = model.replay_buffer.sample(64, env=None)
    labeled_rows = (model.replay_buffer.labels.numpy() <= 1.0).all(1)
    assert labeled_rows.sum() == 16
    assert (model.replay_buffer.labels.numpy()[labeled_rows] == -drawn.actions.numpy()[labeled_rows]).all()
    pairs = zip(
        drawn.actions.numpy()[labeled_rows].tolist(),
        drawn.observations["desired_goal"].numpy()[labeled_rows].tolist(),
        strict=True,
    )
    assert {(*action, *goal) for action, goal in pairs} <= goals


@pytest.mark.parametrize(
    ("scenario", "script", "hidden"),
    [
        ("find_ball_random", "along_path", ["path_bearing(epuck, ball)"]),
        ("panda_push", "by_hand", []),
        ("pit_escape", "rocking", []),
    ],
)
def test_what_a_teacher_reads_and_the_policy_does_not_observe(
    scenario: str, script: str, hidden: list[str]
) -> None:
    assert unobserved_reads(api.compile(scenario).program, script) == hidden


def test_of_a_signal_the_parts_are_named_that_are_not_observed() -> None:
    changes = [
        "signals.tilt=yaw(roller)",
        "signals.turned=tilt / rad + 1",
        "scripts.turn.roll={forward: turned > 1, backward: true}",
    ]
    assert unobserved_reads(api.compile("pit_escape", overrides=changes).program, "turn") == ["yaw(roller)"]


@pytest.mark.parametrize(
    ("scenario", "changes", "reads"),
    [
        (
            "find_ball",
            [
                "augment.along=velocity(epuck).x * cos(yaw(epuck)) + velocity(epuck).y * sin(yaw(epuck))",
                "observation.along=-0.2 .. 0.2 m/s",
                "scripts.turn={gas: 1 if along > 0 m/s else 0.5, wheel: yaw(epuck) / rad}",
            ],
            ["yaw(epuck)"],
        ),
        (
            "pit_escape",
            [
                "augment={east: cos(yaw(roller)), north: sin(yaw(roller))}",
                "observation.east=-1 .. 1",
                "observation.north=-1 .. 1",
                "scripts.turn.roll={forward: yaw(roller) > 1 rad, backward: true}",
            ],
            [],
        ),
    ],
    ids=["a speed along it", "its cosine and sine"],
)
def test_what_shows_a_heading(scenario: str, changes: list[str], reads: list[str]) -> None:
    assert unobserved_reads(api.compile(scenario, overrides=changes).program, "turn") == reads


def test_a_teacher_that_never_succeeds_is_refused(tmp_path: Path) -> None:
    compiled = api.compile("pit_escape", overrides=["train.teacher=forward_only", "truncation.max_time=2s"])
    with pytest.raises(
        UsageError,
        match=r"the teacher `forward_only` succeeds in none of 20 episodes \(mean return .*, ended by \w+"
        r" 20\)",
    ):
        train(compiled, run=tmp_path / "run", total_timesteps=1000)


def test_a_script_drives_less_and_less_and_then_its_weight_fades() -> None:
    teaching = Teaching(Teacher("by_hand", 0.4), 1000, 8, imitates=True)
    plans = [teaching.plan(steps) for steps in (0, 100, 199, 399, 400, 550, 700)]
    assert [plan.lesson.worlds if plan.lesson else None for plan in plans] == [8, 4, 0, 0, 0, 0, None]
    assert [plan.only for plan in plans] == [True, True, True, True, False, False, False]
    assert [round(plan.weight, 2) for plan in plans] == [1, 1, 1, 1, 1, 0.5, 0]


def test_for_a_policy_that_cannot_imitate_the_script_drives_all_worlds_at_first() -> None:
    teaching = Teaching(Teacher("by_hand", 0.6), 1000, 2, imitates=False)
    driven = [plan.lesson.worlds if plan.lesson else 0 for plan in map(teaching.plan, range(0, 1000, 20))]
    assert driven == [2] * 10 + [0] * 40


def recorded(scenario: str, driver: str, path: Path) -> Path:
    with closing(Player(Showing(scenario).open(), driver)) as player:
        record(player, path, 1, [0, 1], steps=80)
    return path


RECORDED = {
    "PPO": (*TAUGHT["PPO"], "lean"),
    "SAC": (*TAUGHT["SAC"], "lean"),
    "DQN": ("pit_escape", ["train={algorithm: DQN, total_timesteps: 1000, learning_starts: 100}"], "rocking"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", few(RECORDED, ["PPO"]))
def test_a_recording_teaches_and_its_training_resumes_to_the_bit(tmp_path: Path, name: str) -> None:
    scenario, changes, driver = RECORDED[name]
    path = recorded(scenario, driver, tmp_path / "drive.mcap")
    options: dict[str, Any] = {"total_timesteps": STEPS, "stop_when_solved": False, "demonstrations": path}
    compiled = api.compile(scenario, overrides=changes)
    whole = becomes_the_same(compiled, tmp_path, 225, path.unlink, **options)  # the run has a copy
    assert {tag for tag in whole["scalars"] if tag.startswith("teacher/")} >= {
        "teacher/weight",
        "teacher/mean_return",
    }
    assert read_listed(tmp_path / "whole").teacher == "demonstrations.mcap"
    assert "teacher/driven_worlds" not in whole["scalars"]


def test_a_recording_that_does_not_fit_is_refused_before_a_run_is_made(tmp_path: Path) -> None:
    path = recorded("pit_escape", "forward_only", tmp_path / "drive.mcap")
    for scenario, message in (
        ("cartpole", "do not fit CartPole"),
        ("pit_escape", "cannot teach PitEscape: none of its 2 episodes succeeds"),
    ):
        with pytest.raises(UsageError, match=message):
            train(scenario, run=tmp_path / "run", total_timesteps=1000, demonstrations=path)
    with pytest.raises(UsageError, match="there is no recording"):
        train("cartpole", run=tmp_path / "run", total_timesteps=1000, demonstrations=tmp_path / "none.mcap")
    assert not (tmp_path / "run").exists()


def test_an_algorithm_that_cannot_imitate_is_refused_before_a_run_is_made(tmp_path: Path) -> None:
    program = api.compile("pit_escape", overrides=["train={algorithm: RecurrentPPO, total_timesteps: 1000}"])
    with pytest.raises(UsageError, match="RecurrentPPO cannot learn from a teacher"):
        train(program, run=tmp_path / "run", demonstrations=tmp_path / "drive.mcap")
    assert not (tmp_path / "run").exists()


TEACHER = """
deepbots: 1
extends: cartpole
name: Knowing
world: {engine: mujoco}
evaluation: {episodes: 4}
train: {total_timesteps: 512, n_steps: 64}
"""
STUDENT = """
deepbots: 1
extends: cartpole
name: Sensing
world: {engine: mujoco}
evaluation: {episodes: 4}
remove: [observation.speed, observation.tip_speed]
observation: {cart.pole_angle: {range: -20 .. 20 deg, history: 3}}
critic: {CRITIC}
solved: mean_return >= 1000000 over 2 episodes
train: {total_timesteps: 1024, algorithm: {algorithm}}
"""
CRITIC = "{speed: -0.8 .. 0.8 m/s, tip_speed: -2 .. 2 m/s}"


@pytest.fixture(scope="module")
def teacher(tmp_path_factory: pytest.TempPathFactory) -> TrainingResult:
    folder = tmp_path_factory.mktemp("teacher")
    (folder / "teacher.yaml").write_text(TEACHER)
    return train(folder / "teacher.yaml", run=folder / "run")


def student(folder: Path, critic: str = CRITIC, algorithm: str = "PPO") -> Path:
    path = folder / "student.yaml"
    path.write_text(STUDENT.replace("{CRITIC}", critic).replace("{algorithm}", algorithm))
    return path


def test_a_policy_imitates_one_that_sees_more(
    teacher: TrainingResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = train(
        student(tmp_path),
        run=tmp_path / "run",
        demonstrations=teacher.run,
        loggers=["csv"],
        progress=True,
    )
    assert "note: the teacher, a policy: " in capsys.readouterr().err
    rows = [line.split(",") for line in (result.run / "logs" / "scalars.csv").read_text().splitlines()[1:]]
    assert max([float(value) for _, name, value in rows if name == "teacher/agreement"]) > 0.8
    assert any(name == "teacher/mean_return" for _, name, _ in rows)
    assert [entry.name for entry in load_policy(result.run).observation] == ["x"] + 3 * ["cart.pole_angle"]


@pytest.mark.slow
def test_an_interrupted_training_continues_without_the_run_of_its_teacher(
    teacher: TrainingResult, tmp_path: Path
) -> None:
    copy = shutil.copytree(teacher.run, tmp_path / "teacher")
    compiled = api.compile(student(tmp_path), overrides=["train.n_steps=32", "world.engine=pybullet"])
    remove = partial(shutil.rmtree, copy)
    becomes_the_same(compiled, tmp_path, 300, remove, demonstrations=copy, total_timesteps=768)


@pytest.mark.parametrize(
    ("critic", "words"),
    [
        (
            "{speed: -0.8 .. 0.8 m/s}",
            "sees `tip_speed`, which the training does not compute; list it under `critic`",
        ),
        ("{speed: -1 .. 1 m/s, tip_speed: -2 .. 2 m/s}", "sees `speed` with another range or history"),
    ],
)
def test_the_training_computes_all_that_the_teacher_sees(
    teacher: TrainingResult, tmp_path: Path, critic: str, words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        train(student(tmp_path, critic), run=tmp_path / "run", demonstrations=teacher.run)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ([], "has another action than CartPoleContinuous"),
        (
            ["train={algorithm: SAC, total_timesteps: 1000}"],
            "SAC cannot learn from the policy of a run; use PPO",
        ),
    ],
    ids=["another action", "off-policy"],
)
def test_a_teacher_that_cannot_teach_is_refused(
    teacher: TrainingResult, tmp_path: Path, overrides: list[str], message: str
) -> None:
    compiled = api.compile("cartpole_continuous", overrides=overrides)
    with pytest.raises(UsageError, match=message):
        train(compiled, run=tmp_path / "run", demonstrations=teacher.run)


GROUPS = ("deepbots.callbacks", "deepbots.loggers")
TASK = stand_in.compiled(training=Training("PPO", 256, 2, hyper(n_steps=32, batch_size=32)))


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The entries that the package of the tests registers for trainings."""
    site = tmp_path_factory.mktemp("site")
    groups = tomllib.loads((test_plugins.PACKAGE / "pyproject.toml").read_text())["project"]["entry-points"]
    test_plugins.installed(site, {group: groups[group] for group in GROUPS})
    sys.path[:0] = [str(site), str(test_plugins.PACKAGE)]
    yield
    del sys.path[:2]


def short(folder: Path, **settings: Any) -> TrainingResult:
    return train(TASK, run=folder, build=stand_in.build, **settings)


def lines(run: Path, name: str) -> list[str]:
    """Those of a log, without times."""
    return [line for line in (run / "logs" / name).read_text().splitlines() if ",time/" not in line]


@pytest.mark.slow
def test_a_training_that_was_interrupted_calls_and_logs_as_one_that_was_not(
    tmp_path: Path, installed: None
) -> None:
    names: dict[str, Any] = {"callbacks": ["explore_less"], "loggers": ["csv", "json_lines"]}
    whole = short(tmp_path / "whole", **names)
    assert short(tmp_path / "parts", **names, progress=At(128)).interrupted
    with (tmp_path / "parts" / "logs" / "scalars.csv").open("a") as file:
        file.write("140,written after the checkpoint,1\n")
    parts = resume(tmp_path / "parts", build=stand_in.build)
    assert (parts.weights_digest, parts.inexact) == (whole.weights_digest, ())
    assert whole.weights_digest != short(tmp_path / "without").weights_digest
    for name in ("scalars.csv", "scalars.jsonl"):
        assert lines(whole.run, name) == lines(parts.run, name)
    saved = PPO.load(whole.run / "logs" / "whole.zip")
    last: Any = load_model(Run.open(whole.run), "last")
    last.model = saved
    assert last.digest() == whole.weights_digest
    rows = [line.split(",") for line in lines(whole.run, "scalars.csv")]
    assert rows[0] == ["steps", "name", "value"]
    assert {"acme/norm", "rollout/ep_rew_mean", "reward/alive"} <= {row[1] for row in rows}


def test_a_name_that_no_package_registers_is_refused_with_the_nearest(
    tmp_path: Path, installed: None
) -> None:
    with pytest.raises(
        UsageError,
        match=r"^there is no callback 'explore_les'; the known ones are .*failing.* \(did you mean"
        r" explore_less\?\)$",
    ):
        short(tmp_path / "run", callbacks=["explore_les"])
    with pytest.raises(
        UsageError,
        match=r"^there is no logger 'cvs'; the known ones are csv, json_lines, full_disk \(did you mean"
        r" csv\?\)$",
    ):
        short(tmp_path / "run", loggers=["cvs"])
    with pytest.raises(UsageError, match="given twice"):
        short(tmp_path / "run", loggers=["csv", "csv"])
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        (
            {"callbacks": ["failing"]},
            r"the callback 'failing' failed after 100 steps: KeyError: 'no such gauge' \(.*training.py:\d+\)",
        ),
        ({"callbacks": ["odd"]}, "the callback 'odd' is a str, and not a BaseCallback of Stable-Baselines3"),
        (
            {"loggers": ["full_disk"]},
            r"the logger 'full_disk' failed after \d+ steps: OSError: .*No space left on device \(.*\)",
        ),
    ],
)
def test_one_that_fails_is_named_and_the_training_can_go_on(
    tmp_path: Path, names: dict[str, Any], sentence: str, installed: None
) -> None:
    with pytest.raises(PluginError, match=f"^{sentence}(?m:$)") as caught:
        short(tmp_path / "run", **names)
    if "odd" not in sentence:
        assert "the last checkpoint" in caught.value.full_message
        assert f"deepbots resume {tmp_path / 'run'}" in caught.value.full_message
    assert RunRecord.read(tmp_path / "run").status == "failed"


def test_a_callback_may_end_the_training(tmp_path: Path, installed: None) -> None:
    result = short(tmp_path / "run", callbacks=["impatient"])
    assert (result.status, result.steps, result.stopped_by) == ("finished", 100, "impatient")
    assert "stopped by" in training_text(result)
    assert "the callback impatient" in training_text(result)


def test_a_resumed_run_and_the_seeds_of_a_group_keep_them(tmp_path: Path, installed: None) -> None:
    group = train_group(
        TASK, [0, 1], group=tmp_path / "group", build=stand_in.build, callbacks=["impatient"], loggers=["csv"]
    )
    assert [result.stopped_by for result in group.trained] == ["impatient"] * 2
    run = group.trained[0].run
    assert lines(run, "scalars.csv")
    content = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps(content | {"callbacks": ["gone"]}))
    with pytest.raises(UsageError, match="there is no callback 'gone'") as caught:
        resume(run, build=stand_in.build)
    assert "--callback none" in caught.value.full_message
    rest = resume(run, build=stand_in.build, total_timesteps=200, callbacks=(), loggers=())
    assert rest.steps >= 200
    assert rest.stopped_by is None
    assert rest.inexact == ("the callbacks changed at 0 steps from gone to none",)
    assert (RunRecord.read(run).callbacks, RunRecord.read(run).loggers) == ((), ())
