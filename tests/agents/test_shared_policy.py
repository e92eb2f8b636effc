"""Agents with one policy."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cluster import Cluster
from deepbots_cli.cluster.local_processes import LocalProcesses
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.evaluation import evaluate, load_model
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.rollout.collector import Decision, LocalCollector
from deepbots_cli.rollout.seats import SeatCollector, SharedCollector
from deepbots_cli.rollout.worlds import SingleWorlds
from deepbots_cli.runtime.agents import SeatLayout
from tests.agents.carts import CARTS
from tests.learning.interruption import At, outcome

PPO = (
    "train: {algorithm: PPO, total_timesteps: 512, n_steps: 64, n_epochs: 1,"
    " batch_size: 32, network: {hidden: [8]}}\n"
)


def _changed(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text


SHARED = _changed(
    CARTS, ("right: {like: left, robots: [right]}", "right: {like: left, robots: [right], policy: left}")
)
ALONE = _changed(
    SHARED,
    ("success: right, failure: left}", "ends: left, failure: left}"),
    ("success: left, failure: right}", "ends: right, failure: right}"),
)
TEAM = _changed(
    SHARED,
    ("success: right, failure: left", "failure: all"),
    ("success: left, failure: right", "failure: all"),
    ("policy: left}\n", "policy: left}\n  third: {like: left, robots: [third], policy: left}\n"),
    (
        "signals:",
        """\
  third:
    urdf: cartpole
    pose: {y: -1 m}
    sensors: {angle: {type: joint_position, joint: pole_hinge}}
    actuators: {wheels: {type: velocity_motor, joints: [wheel_*]}}
    apply: {wheels: drive * 5 rad/s}
signals:""",
    ),
)
"""Three equal robots, each of which has an agent."""


@pytest.fixture
def carts(tmp_path: Path) -> Path:
    file = tmp_path / "carts.yaml"
    file.write_text(SHARED + PPO)
    return file


@pytest.mark.parametrize("text", [SHARED, ALONE], ids=["together", "alone"])
def test_the_experience_of_both_agents_is_joined(tmp_path: Path, text: str) -> None:
    file = tmp_path / "carts.yaml"
    file.write_text(text)
    program = api.compile(file).program
    terms = {name: [*member.terms.values()] for name, member in program.members.items()}
    alone = [name for name, member in program.members.items() if member.alone]

    def act(observations: np.ndarray, starts: np.ndarray, masks: None) -> Decision:
        actions = np.tile(np.float32([1.0, 0.1]), (2, 1))
        return Decision(actions, {f"{name}/values": actions[:, place] for place, name in enumerate(terms)})

    worlds = SingleWorlds(
        [api.build(program) for _ in range(2)], [7, 8], agent_terms=terms, agents_alone=alone
    )
    with closing(worlds):
        collector = LocalCollector(worlds)
        fragment = collector.collect(act, 80)
        assert fragment is not None
        seats = [SeatLayout(member, program.agent) for member in program.members.values()]
        parts = [SeatCollector(seat, collector).part_of(fragment) for seat in seats]
        shared = SharedCollector(seats, collector)
        both = shared.part_of(fragment)
    assert shared.rows == 4
    assert both.endings
    for side, part in enumerate(parts):
        rows = slice(2 * side, 2 * side + 2)
        assert both.observations[:, rows].tolist() == part.observations.tolist()
        assert both.rewards[:, rows].tolist() == part.rewards.tolist()
        assert both.starts[:, rows].tolist() == part.starts.tolist()
        assert both.columns["values"][:, rows].tolist() == part.columns["values"].tolist()
        own = [(number, end.row - 2 * side) for number, end in both.endings if end.row // 2 == side]
        assert own == [(number, end.row) for number, end in part.endings]
        assert (part.taking_part is not None) == bool(alone)
        if part.taking_part is not None:
            assert both.taking_part is not None
            assert both.taking_part[:, rows].tolist() == part.taking_part.tolist()


@pytest.mark.parametrize("text", [SHARED, ALONE], ids=["together", "alone"])
def test_both_agents_act_by_the_same_weights(carts: Path, tmp_path: Path, text: str) -> None:
    carts.write_text(text + PPO)
    result = deepbots_cli.train(carts, run=tmp_path / "run", seed=1)
    assert result.steps == 512
    weights = load_model(Run.open(tmp_path / "run"), "best").weights()
    left = {name.partition("/")[2]: array for name, array in weights.items() if name.startswith("left/")}
    assert left
    assert all(np.array_equal(array, weights[f"right/{name}"]) for name, array in left.items())
    assert {*evaluate(tmp_path / "run", episodes=2).agents} == {"left", "right"}


@pytest.mark.slow
def test_an_interrupted_training_of_a_shared_policy_becomes_the_same(carts: Path, tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    deepbots_cli.train(carts, run=whole, seed=2)
    assert deepbots_cli.train(carts, run=cut, seed=2, progress=At(100)).interrupted
    deepbots_cli.resume(cut)
    assert outcome(cut) == outcome(whole)


@pytest.mark.slow
def test_shards_give_the_same_weights_wherever_they_run(carts: Path, tmp_path: Path) -> None:
    carts.write_text(SHARED + PPO.replace("n_steps", "environments: 2, shards: 2, n_steps"))
    here = deepbots_cli.train(carts, run=tmp_path / "here", seed=3)
    with Cluster(workers=2) as cluster, LocalProcesses(2) as processes:
        cluster._pool = processes
        there = deepbots_cli.train(carts, run=tmp_path / "there", seed=3, executor=cluster)
    assert here.weights_digest == there.weights_digest


@pytest.mark.slow
def test_an_algorithm_without_support_is_refused(carts: Path, tmp_path: Path) -> None:
    carts.write_text(SHARED + "train: {algorithm: SAC, total_timesteps: 256}\n")
    with pytest.raises(UsageError, match="SAC does not support a policy that several agents share"):
        deepbots_cli.train(carts, run=tmp_path / "run", seed=1)


@pytest.mark.parametrize(
    ("right", "headline"),
    [
        ("{like: left, robots: [right], policy: middle}", "there is no other agent `middle`"),
        ("{like: left, robots: [right], policy: right}", "there is no other agent `right`"),
        (
            "{like: left, robots: [right], policy: left, action: {drive: -0.5 .. 1}}",
            "`right` cannot share the policy of `left`, because it does not mirror it exactly",
        ),
    ],
)
def test_a_mistake_about_a_shared_policy_is_one_finding(carts: Path, right: str, headline: str) -> None:
    carts.write_text(CARTS.replace("{like: left, robots: [right]}", right))
    errors = [finding.headline for finding in api.lint(carts) if finding.severity == "error"]
    assert errors == [headline]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:We recommend agents to be named", "ignore:Observation numpy array is all")
def test_a_team_of_equal_robots_is_an_environment_and_learns_one_policy(tmp_path: Path) -> None:
    pytest.importorskip("pettingzoo")
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, render_test
    from pettingzoo.utils import parallel_to_aec

    file = tmp_path / "team.yaml"
    file.write_text(TEAM + PPO)
    with closing(deepbots_cli.parallel_env(file)) as environment:
        assert environment.possible_agents == ["left", "right", "third"]
        parallel_api_test(environment, num_cycles=100)
        api_test(parallel_to_aec(environment), num_cycles=20)
    parallel_seed_test(lambda: deepbots_cli.parallel_env(file), num_cycles=10)
    with pytest.warns(RuntimeWarning, match="there is no display"):
        render_test(
            lambda render_mode: parallel_to_aec(deepbots_cli.parallel_env(file, render_mode=render_mode))
        )
    deepbots_cli.train(file, run=tmp_path / "run", seed=1, total_timesteps=64)
    learners = load_model(Run.open(tmp_path / "run"), "best").learners  # type: ignore[attr-defined]  # of several
    weights = [learner.weights() for learner in learners.values()]
    for name, tensor in weights[0].items():
        assert all(np.array_equal(tensor, other[name]) for other in weights[1:])
