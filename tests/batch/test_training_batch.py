"""Trainings over a batch of worlds: what learners see, snapshots, and when worlds are stepped one by one."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("deepbots_cli.engines.mujoco")
pytest.importorskip("stable_baselines3")

from deepbots_cli import api, learning
from deepbots_cli.learning.batch import BatchedWorlds, described
from deepbots_cli.learning.environments import VectorEnvironment, default_build, fingerprint
from deepbots_cli.learning.episodes import Episode
from deepbots_cli.program import Program

SEEDS = (3, 4, 5)


@pytest.fixture(scope="module")
def program() -> Program:
    return api.compile("cartpole").program


def test_a_learner_sees_the_same_of_a_batch_as_of_single_worlds(program: Program) -> None:
    told: dict[str, list[tuple[int, Episode]]] = {"batch": [], "single": []}
    batched = BatchedWorlds(api.build_batch(program, 3), SEEDS, on_episode=lambda world, episode: told["batch"].append((world, episode)))
    singles = [api.build(program, engine="mujoco") for _ in SEEDS]
    usual = VectorEnvironment(singles, SEEDS, on_episode=lambda world, episode: told["single"].append((world, episode)))
    with closing(batched), closing(usual):
        np.testing.assert_array_equal(batched.reset(), usual.reset())
        generator = np.random.default_rng(0)
        for _ in range(60):
            actions = generator.integers(0, 2, 3)
            for mine, other in zip(batched.step(actions)[:3], usual.step(actions)[:3], strict=True):
                np.testing.assert_array_equal(mine, other)
    assert told["batch"] == told["single"] != []


def test_a_running_batch_is_restored_exactly(program: Program) -> None:
    with (
        closing(BatchedWorlds(api.build_batch(program, 3), SEEDS)) as first,
        closing(BatchedWorlds(api.build_batch(program, 3), SEEDS)) as other,
    ):
        first.reset()
        generator = np.random.default_rng(1)
        plan = generator.integers(0, 2, (90, 3))
        for actions in plan[:50]:
            first.step(actions)
        assert len({len(history.actions) for history in first.histories()}) > 1
        assert fingerprint(other.repeat(first.histories())) == fingerprint(first.last_observations)
        for actions in plan[50:]:
            mine, again = first.step(actions), other.step(actions)
            np.testing.assert_array_equal(mine[0], again[0])
            assert [info.get("episode") for info in mine[3]] == [info.get("episode") for info in again[3]]


def test_why_worlds_are_stepped_one_by_one_is_told() -> None:
    camera, cart = api.compile("see_ball").program, api.compile("cartpole").program
    assert described(camera, 8, "mujoco", default_build("mujoco")) == "SeeBall steps its 8 worlds one by one: it has cameras"
    assert described(cart, 8, "mujoco", default_build("mujoco")) == "CartPole steps its 8 worlds together, as a batch"
    assert described(camera, 8, "pybullet", default_build("pybullet")) == ""


@pytest.mark.slow
def test_a_training_over_a_batch_resumes_to_the_bit(tmp_path: Path) -> None:
    sets = ["train.n_steps=32", "train.n_epochs=1"]
    compiled = api.compile("cartpole", sets=sets)
    whole = learning.train(compiled, run=tmp_path / "whole", total_timesteps=1024, engine="mujoco", stop_when_solved=False)
    learning.train(compiled, run=tmp_path / "parts", total_timesteps=512, engine="mujoco", stop_when_solved=False)
    parts = learning.resume(tmp_path / "parts", total_timesteps=1024, stop_when_solved=False)
    assert parts.inexact == ()
    assert parts.weights_digest == whole.weights_digest
