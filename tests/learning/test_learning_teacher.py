"""A script teaches the policy: what it learns, and that it resumes and runs in shards to the bit."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from test_learning_resume import outcome
from test_learning_shards import Forgetful

from deepbots_cli import api
from deepbots_cli.analysis import unobserved_reads
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import evaluate, resume, train
from deepbots_cli.learning.report import Reporter, TrainingProgress
from deepbots_cli.learning.shards import THIS_PROCESS
from deepbots_cli.learning.teacher import Teaching
from deepbots_cli.program.task import Teacher
from tests.few import few

BALANCER = ["truncation.max_time=1s", "train.environments=4", "train.n_steps=32", "train.batch_size=64", "train.network.hidden=[16]"]
CASES = {
    "PPO": ("balancer", [*BALANCER, "train.teacher={script: lean, share: 0.5}"]),
    "PPO in stages": (
        "balancer",
        [
            *BALANCER,
            "train.teacher={script: lean, share: 0.7}",
            "curriculum=[{name: low, set: {limit: 20 deg}, until: mean_return >= 1 over 2 episodes}, {name: usual}]",
        ],
    ),
    "SAC": (
        "balancer",
        [
            "truncation.max_time=1s",
            "train={algorithm: SAC, total_timesteps: 1000, environments: 4, learning_starts: 200, network: {hidden: [16]}, teacher: lean}",
        ],
    ),
}
STEPS = 1024


def trained(name: str, folder: Path, changes: list[str] | None = None, **options: Any) -> dict[str, Any]:
    scenario, own = CASES[name]
    train(api.compile(scenario, overrides=[*own, *(changes or [])]), run=folder, total_timesteps=STEPS, stop_when_solved=False, **options)
    return outcome(folder)


class InterruptedAt(Reporter):
    def __init__(self, steps: int) -> None:
        self._steps = steps

    def update(self, progress: TrainingProgress) -> None:
        if progress.steps >= self._steps:
            self._steps = 10**9
            os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.parametrize("steps", few([200, 450, 700], ["450"]))
@pytest.mark.parametrize("name", CASES)
def test_an_interrupted_training_with_a_teacher_resumes_to_the_bit(tmp_path: Path, name: str, steps: int) -> None:
    whole = trained(name, tmp_path / "whole")
    trained(name, tmp_path / "parts", progress=InterruptedAt(steps))
    resumed = resume(tmp_path / "parts")
    assert (resumed.steps, resumed.inexact) == (STEPS, ())
    found = outcome(tmp_path / "parts")
    for part in whole:
        assert found[part] == whole[part], part


@pytest.mark.parametrize("name", CASES)
def test_shards_that_are_lost_with_every_fragment_are_taught_the_same(tmp_path: Path, name: str) -> None:
    two = ["train.shards=2"]
    kept = trained(name, tmp_path / "kept", two, placement=THIS_PROCESS)
    assert trained(name, tmp_path / "lost", two, placement=Forgetful()) == kept


def test_a_policy_imitates_its_teacher(tmp_path: Path) -> None:
    found = {}
    for name, changes in (("taught", ["train.teacher=lean"]), ("alone", [])):
        compiled = api.compile("balancer", overrides=[*BALANCER, "truncation.max_time=4s", *changes])
        result = train(compiled, run=tmp_path / name, total_timesteps=4_000, stop_when_solved=False)
        found[name] = evaluate(result.run, model="last", episodes=10).mean_length
    assert found["taught"] > 300
    assert found["alone"] < 150


@pytest.mark.parametrize(
    ("scenario", "script", "hidden"),
    [("find_ball_random", "along_path", ["path_bearing(epuck, ball)"]), ("panda_push", "by_hand", []), ("pit_escape", "rocking", [])],
)
def test_what_a_teacher_reads_and_the_policy_does_not_observe(scenario: str, script: str, hidden: list[str]) -> None:
    assert unobserved_reads(api.compile(scenario).program, script) == hidden


def test_a_teacher_that_never_succeeds_is_refused(tmp_path: Path) -> None:
    compiled = api.compile("pit_escape", overrides=["train.teacher=forward_only", "truncation.max_time=2s"])
    with pytest.raises(UsageError, match="the teacher `forward_only` succeeds in none of 20 episodes"):
        train(compiled, run=tmp_path / "run", total_timesteps=1000)


def test_a_script_drives_less_and_less_and_then_its_weight_fades() -> None:
    teaching = Teaching(Teacher("by_hand", 0.4), 1000, 8, on_policy=True)
    plans = [teaching.plan(steps) for steps in (0, 100, 199, 399, 400, 550, 700)]
    assert [plan.lesson.worlds if plan.lesson else None for plan in plans] == [8, 4, 0, 0, 0, 0, None]
    assert [plan.only for plan in plans] == [True, True, True, True, False, False, False]
    assert [round(plan.weight, 2) for plan in plans] == [1, 1, 1, 1, 1, 0.5, 0]


def test_with_a_replay_buffer_the_script_drives_all_worlds_at_first() -> None:
    teaching = Teaching(Teacher("by_hand", 0.6), 1000, 2, on_policy=False)
    driven = [plan.lesson.worlds if plan.lesson else 0 for plan in map(teaching.plan, range(0, 1000, 20))]
    assert driven == [2] * 10 + [0] * 40


def test_an_algorithm_that_cannot_imitate_is_refused_before_a_run_is_made(tmp_path: Path) -> None:
    changes = ["train={algorithm: RecurrentPPO, total_timesteps: 1000, teacher: rocking}"]
    with pytest.raises(UsageError, match="RecurrentPPO cannot learn from a teacher"):
        train(api.compile("pit_escape", overrides=changes), run=tmp_path / "run")
    assert not (tmp_path / "run").exists()
