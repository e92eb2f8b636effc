"""A script teaches the policy: what it learns, and that it resumes and runs in shards to the bit."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3 import SAC
from stable_baselines3.common.envs import BitFlippingEnv
from stable_baselines3.common.vec_env import DummyVecEnv
from stable_baselines3.her import HerReplayBuffer
from test_learning_shards import Forgetful

from deepbots_cli import api
from deepbots_cli.analysis import unobserved_reads
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import evaluate, resume, train
from deepbots_cli.learning.campaigns.listing import read_listed
from deepbots_cli.learning.executor import SERIAL
from deepbots_cli.learning.sb3.imitation import keep_labels, labeled
from deepbots_cli.learning.teaching.teacher import Teaching
from deepbots_cli.program.task import Teacher
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.recordings import record
from tests.few import few
from tests.learning.interruption import At, outcome

BALANCER = [
    "truncation.max_time=0.4s",
    "train.environments=4",
    "train.n_steps=16",
    "train.batch_size=64",
    "train.network.hidden=[16]",
]
CASES = {
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


def trained(name: str, folder: Path, changes: list[str] | None = None, **options: Any) -> dict[str, Any]:
    scenario, own = CASES[name]
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
@pytest.mark.parametrize("name", few(CASES, ["PPO in stages"]))
def test_an_interrupted_training_with_a_teacher_resumes_to_the_bit(
    tmp_path: Path, name: str, steps: int
) -> None:
    whole = trained(name, tmp_path / "whole")
    trained(name, tmp_path / "parts", progress=At(steps))
    resumed = resume(tmp_path / "parts")
    assert (resumed.steps, resumed.inexact) == (STEPS, ())
    parts = outcome(tmp_path / "parts")
    for part in whole:
        assert parts[part] == whole[part], part
    assert {"teacher/weight", "teacher/driven_worlds", "teacher/mean_return"} <= whole["scalars"].keys()


@pytest.mark.slow
@pytest.mark.parametrize("name", few(CASES, ["PPO in stages"]))
def test_shards_that_are_lost_with_every_fragment_are_taught_the_same(tmp_path: Path, name: str) -> None:
    two = ["train.shards=2"]
    kept = trained(name, tmp_path / "kept", two, executor=SERIAL)
    assert trained(name, tmp_path / "lost", two, executor=Forgetful()) == kept


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
    compiled = api.compile("pit_escape", overrides=changes)
    assert unobserved_reads(compiled.program, "turn") == ["yaw(roller)"]


def test_a_speed_along_a_heading_shows_no_heading() -> None:
    changes = [
        "augment.along=velocity(epuck).x * cos(yaw(epuck)) + velocity(epuck).y * sin(yaw(epuck))",
        "observation.along=-0.2 .. 0.2 m/s",
        "scripts.turn={gas: 1 if along > 0 m/s else 0.5, wheel: yaw(epuck) / rad}",
    ]
    assert unobserved_reads(api.compile("find_ball", overrides=changes).program, "turn") == ["yaw(epuck)"]


def test_the_cosine_and_sine_of_a_heading_show_it() -> None:
    changes = [
        "augment={east: cos(yaw(roller)), north: sin(yaw(roller))}",
        "observation.east=-1 .. 1",
        "observation.north=-1 .. 1",
        "scripts.turn.roll={forward: yaw(roller) > 1 rad, backward: true}",
    ]
    assert unobserved_reads(api.compile("pit_escape", overrides=changes).program, "turn") == []


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
    "PPO": (*CASES["PPO"], "lean"),
    "SAC": (*CASES["SAC"], "lean"),
    "DQN": ("pit_escape", ["train={algorithm: DQN, total_timesteps: 1000, learning_starts: 100}"], "rocking"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", few(RECORDED, ["PPO"]))
def test_a_recording_teaches_and_its_training_resumes_to_the_bit(tmp_path: Path, name: str) -> None:
    scenario, changes, driver = RECORDED[name]
    path = recorded(scenario, driver, tmp_path / "drive.mcap")
    options: dict[str, Any] = {"total_timesteps": STEPS, "stop_when_solved": False, "demonstrations": path}
    compiled = api.compile(scenario, overrides=changes)
    train(compiled, run=tmp_path / "whole", **options)
    train(compiled, run=tmp_path / "parts", progress=At(225), **options)
    path.unlink()  # the run has a copy
    assert resume(tmp_path / "parts").inexact == ()
    assert outcome(tmp_path / "parts") == (whole := outcome(tmp_path / "whole"))
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
    with pytest.raises(UsageError, match="cannot be read"):
        train("cartpole", run=tmp_path / "run", total_timesteps=1000, demonstrations=tmp_path / "none.mcap")
    assert not (tmp_path / "run").exists()


def test_an_algorithm_that_cannot_imitate_is_refused_before_a_run_is_made(tmp_path: Path) -> None:
    changes = ["train={algorithm: RecurrentPPO, total_timesteps: 1000, teacher: rocking}"]
    with pytest.raises(UsageError, match="RecurrentPPO cannot learn from a teacher"):
        train(api.compile("pit_escape", overrides=changes), run=tmp_path / "run")
    assert not (tmp_path / "run").exists()
