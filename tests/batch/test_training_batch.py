"""Trainings over a batch of worlds: what learners see, snapshots, and when worlds are stepped one by one."""

from __future__ import annotations

import csv
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("deepbots_cli.engines.mujoco")
pytest.importorskip("stable_baselines3")

from deepbots_cli import api, learning
from deepbots_cli.errors import EvaluationError
from deepbots_cli.learning import learner
from deepbots_cli.learning.environments import EvaluationWorlds, stepping_text, supervisor_factory
from deepbots_cli.learning.sb3.rollouts import CollectorEnvironment
from deepbots_cli.program import Program
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.collector import LocalCollector
from deepbots_cli.rollout.policies import ordered_episodes, play_batch, play_episodes
from deepbots_cli.rollout.worlds import BatchWorlds, SingleWorlds, Worlds, observation_digest
from deepbots_cli.runtime import Supervisor

SEEDS = (3, 4, 5)
MASKED = (
    "action={drive: {choices: {forward: 1, backward: -1}, forbid: {backward: x > 3 mm}}}",
    "train={algorithm: MaskablePPO, total_timesteps: 1000, environments: 8, n_steps: 32, n_epochs: 1}",
)


@pytest.fixture(scope="module")
def program() -> Program:
    return api.compile("cartpole").program


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        pytest.param("cartpole", (), id="alone"),
        pytest.param("cartpole", MASKED, id="masked", marks=pytest.mark.slow),
        pytest.param("multi_cartpole", MASKED, id="copies"),
    ],
)
def test_a_learner_sees_the_same_of_a_batch_as_of_single_worlds(
    name: str, overrides: tuple[str, ...]
) -> None:
    program = api.compile(name, overrides=overrides).program
    episodes: dict[str, list[tuple[int, Episode]]] = {"batch": [], "single": []}
    batched = BatchWorlds(
        lambda stage: api.build_batch(program, 3),
        SEEDS,
        on_episode=lambda world, episode: episodes["batch"].append((world, episode)),
    )
    singles = [api.build(program, engine="mujoco") for _ in SEEDS]
    usual = SingleWorlds(
        singles, SEEDS, on_episode=lambda world, episode: episodes["single"].append((world, episode))
    )
    with closing(batched), closing(usual):
        np.testing.assert_array_equal(batched.reset(), usual.reset())
        generator = np.random.default_rng(0)
        for _ in range(60):
            actions = generator.integers(0, 2, usual.rows)
            for of_batch, of_singles in zip(
                batched.step_all(actions)[:3], usual.step_all(actions)[:3], strict=True
            ):
                np.testing.assert_array_equal(of_batch, of_singles)
            np.testing.assert_array_equal(batched.action_masks(), usual.action_masks())
    masks = CollectorEnvironment(LocalCollector(batched)).env_method("action_masks")
    np.testing.assert_array_equal(masks, batched.action_masks())
    assert batched.action_masks().all() == (not overrides)
    assert episodes["batch"] == episodes["single"] != []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "overrides"), [("cartpole", []), ("multi_cartpole", ["robots.cart.count=2"])]
)
def test_worlds_of_a_batch_enter_another_stage_one_by_one(name: str, overrides: list[str]) -> None:
    """When three episodes have ended, each at the end of its own, as single worlds do."""
    program, harder = (
        api.compile(name, overrides=[*overrides, *more]).program for more in ([], ["fall_angle=8 deg"])
    )
    programs = [program, harder]
    steps: list[list[object]] = []
    kinds: list[list[int]] = []

    def stage_of(done: int) -> int:
        return int(done >= 3)

    for is_batch in (True, False):
        done: list[int] = []
        stages = [0, 0, 0]

        def enter(world: int, done: list[int] = done, stages: list[int] = stages) -> int | None:
            if stages[world] == stage_of(len(done)):
                return None
            stages[world] = 1
            return 50 + world

        def next_world(
            world: int, enter: Callable[[int], int | None] = enter
        ) -> tuple[Supervisor, int] | None:
            seed = enter(world)
            return None if seed is None else (api.build(harder, engine="mujoco"), seed)

        def count(world: int, episode: Episode, done: list[int] = done) -> None:
            done.append(world)

        env: Worlds
        if is_batch:
            env = BatchWorlds(
                lambda stage: api.build_batch(programs[stage], 3),
                SEEDS,
                stages,
                on_episode=count,
                next_seed=enter,
            )
        else:
            singles = [api.build(program, engine="mujoco") for _ in SEEDS]
            env = SingleWorlds(singles, SEEDS, on_episode=count, next_world=next_world)
        transitions: list[object] = [env.reset().tolist()]
        of_stages = []
        with closing(env):
            generator = np.random.default_rng(1)
            for _ in range(120):
                step = env.step_all(generator.integers(0, 2, env.rows))
                transitions.append(
                    (
                        step.observations.tolist(),
                        step.rewards.tolist(),
                        step.ended.tolist(),
                        [ending.episode for ending in step.endings],
                    )
                )
                of_stages.append(sum(stages))
            if is_batch:
                histories = env.histories()
                with closing(
                    BatchWorlds(lambda stage: api.build_batch(programs[stage], 3), SEEDS, stages)
                ) as other:
                    assert observation_digest(other.repeat(histories)) == observation_digest(env.observations)
        steps.append(transitions)
        kinds.append(of_stages)
    assert steps[0] == steps[1]
    assert kinds[0] == kinds[1]
    assert {0, 1, 2, 3} == set(kinds[0])


def test_a_running_batch_is_restored_exactly(program: Program) -> None:
    with (
        closing(BatchWorlds(lambda stage: api.build_batch(program, 3), SEEDS)) as first,
        closing(BatchWorlds(lambda stage: api.build_batch(program, 3), SEEDS)) as restored,
    ):
        first.reset()
        generator = np.random.default_rng(1)
        plan = generator.integers(0, 2, (90, 3))
        for actions in plan[:50]:
            first.step_all(actions)
        assert len({len(history.actions) for history in first.histories()}) > 1
        assert observation_digest(restored.repeat(first.histories())) == observation_digest(
            first.observations
        )
        for actions in plan[50:]:
            mine, again = first.step_all(actions), restored.step_all(actions)
            np.testing.assert_array_equal(mine[0], again[0])
            assert [ending.episode for ending in mine.endings] == [ending.episode for ending in again.endings]


def evaluated(
    name: str, worlds: int, seeds: list[int], overrides: tuple[str, ...] = ()
) -> tuple[list[Episode], list[Episode]]:
    """Episodes of an untrained policy in a batch, and in two single worlds."""
    program = api.compile(name, overrides=overrides).program
    assert program.agent.training is not None
    singles = [api.build(program, engine="mujoco") for _ in range(2)]
    numbers = range(len(seeds))
    with closing(SingleWorlds(singles, [0, 0])), closing(api.build_batch(program, worlds)) as many:
        policy = learner.create(
            learner.Setup(program.agent.training, many.observation_space, many.action_space)
        )
        apart = play_episodes(policy, singles, seeds, deterministic=True, numbers=numbers)
        return ordered_episodes(play_batch(policy, many, seeds), numbers), ordered_episodes(apart, numbers)


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("cartpole", ("action={drive: -1 .. 1}", "truncation.max_steps=20")),  # episodes of many lengths
        pytest.param("cartpole", (*MASKED, "truncation.max_steps=20"), marks=pytest.mark.slow),
        pytest.param("multi_cartpole", ("truncation.max_steps=12",), marks=pytest.mark.slow),
        ("multi_cartpole", (*MASKED, "robots.cart.count=3", "truncation.max_steps=12")),
        (
            "quadrotor",
            ("truncation={max_steps: 2}",),
        ),  # several timesteps in a step, and functions that numpy rounds otherwise
    ],
)
def test_an_evaluation_in_a_batch_gives_the_episodes_of_single_worlds(
    name: str, overrides: tuple[str, ...]
) -> None:
    together, apart = evaluated(name, worlds=10, seeds=list(range(21)), overrides=overrides)
    assert together == apart


def test_an_evaluation_in_which_a_world_fails_is_left_to_single_worlds() -> None:
    """They say which episode it is, and keep it."""
    program = api.compile("cartpole", overrides=("reward.odd=1/(5 - step)",)).program
    assert program.agent.training is not None
    with closing(EvaluationWorlds(supervisor_factory("mujoco"), engine="mujoco", batch=8)) as worlds:
        worlds.enter(program)
        assert worlds.has_batch_for(8)
        policy = learner.create(
            learner.Setup(program.agent.training, worlds.first.observation_space, worlds.first.action_space)
        )
        with pytest.raises(EvaluationError, match=r"episode 0 \(seed 0\), .*step 5"):
            worlds.play(policy, range(8))


def test_a_note_says_why_worlds_are_stepped_one_by_one() -> None:
    camera, cart = api.compile("see_ball").program, api.compile("cartpole").program
    assert (
        stepping_text(camera, 8, "mujoco", supervisor_factory("mujoco"))
        == "SeeBall steps its 8 worlds one by one: it has cameras, whose pictures are drawn world by world"
    )
    assert (
        stepping_text(cart, 8, "mujoco", supervisor_factory("mujoco"))
        == "CartPole steps its 8 worlds together, as a batch"
    )
    assert stepping_text(camera, 8, "pybullet", supervisor_factory("pybullet")) == ""


def test_a_batch_enters_the_next_stage_after_an_evaluation(tmp_path: Path) -> None:
    stages = (
        "curriculum=[{name: easy, set: {truncation.max_steps: 3}, until: mean_return >= 2 in"
        " evaluation}, {name: hard}]"
    )
    changes = [
        stages,
        "truncation.max_steps=5",
        "train.n_steps=32",
        "train.n_epochs=1",
        "solved=mean_return >= 195 over 8 episodes",
    ]
    result = learning.train(
        api.compile("cartpole", overrides=changes),
        run=tmp_path / "run",
        total_timesteps=1024,
        engine="mujoco",
    )
    (done,) = result.stages
    rows = list(csv.DictReader((tmp_path / "run" / "monitor.csv").read_text().splitlines()[1:]))
    assert (done.value, done.steps % 8) == (3.0, 0)
    assert {(row["stage"], row["l"]) for row in rows if int(row["steps"]) > done.steps + 24} == {
        ("hard", "5")
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("cartpole", ()),
        (
            "cartpole",
            ("curriculum=[{name: easy, set: {fall_angle: 20 deg}, until: 480 steps}, {name: hard}]",),
        ),
        ("cartpole", MASKED),
        ("multi_cartpole", ()),
    ],
    ids=["alone", "curriculum", "masked", "copies"],
)
def test_a_training_over_a_batch_resumes_to_the_bit(
    tmp_path: Path, name: str, changes: tuple[str, ...]
) -> None:
    compiled = api.compile(name, overrides=[*changes, "train.n_steps=32", "train.n_epochs=1"])
    whole = learning.train(
        compiled, run=tmp_path / "whole", total_timesteps=1024, engine="mujoco", stop_when_solved=False
    )
    learning.train(
        compiled, run=tmp_path / "parts", total_timesteps=512, engine="mujoco", stop_when_solved=False
    )
    parts = learning.resume(tmp_path / "parts", total_timesteps=1024, stop_when_solved=False)
    assert parts.inexact == ()
    assert parts.weights_digest == whole.weights_digest
