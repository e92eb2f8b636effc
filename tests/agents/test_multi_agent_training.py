"""Several agents that learn in the same worlds."""

from __future__ import annotations

import json
import shutil
import zipfile
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cluster import Cluster
from deepbots_cli.cluster.local_processes import LocalProcesses
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.agents.multi_agent import own_model
from deepbots_cli.learning.evaluation import evaluate, load_model
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.rollout.batch_worlds import BatchWorlds
from deepbots_cli.rollout.collector import Decision, LocalCollector
from deepbots_cli.rollout.episode import own_episode
from deepbots_cli.rollout.seats import SeatCollector
from deepbots_cli.rollout.worlds import SingleWorlds
from deepbots_cli.runtime.agents import SeatLayout
from tests.agents.test_agents import SEVERAL
from tests.learning.interruption import At, outcome

PPO = (
    "train: {algorithm: PPO, total_timesteps: 768, n_steps: 64, n_epochs: 1,"
    " batch_size: 32, network: {hidden: [8]}}"
)
SAC = "train: {algorithm: SAC, total_timesteps: 256, train_freq: 4, learning_starts: 20, network: {hidden: [8]}}"
OWN = (
    "train:\n      {algorithm: PPO, total_timesteps: 256, n_steps: 64, n_epochs: 1,"
    " batch_size: 32, network: {hidden: [8]}}"
)
SHARED = SEVERAL.replace(f"    {OWN}\n", "") + PPO + "\n"
"""The training of all agents at the top level."""
TOGETHER = SEVERAL.replace("success: right, failure: left", "failure: all").replace(
    "right_fell: {when: tilt(right.pole) > 30 deg, success: left, failure: right}",
    "near: {when: apart < 0.9 m, success: all}",
)


def write_scenario(folder: Path, text: str) -> Path:
    file = folder / "several.yaml"
    file.write_text(text)
    return file


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which both agents have learned."""
    folder = tmp_path_factory.mktemp("multi_agent")
    deepbots_cli.train(write_scenario(folder, SHARED), run=folder / "run", seed=1)
    return folder / "run"


def test_each_agent_learns_from_its_own_part_of_each_step(tmp_path: Path) -> None:
    program = api.compile(write_scenario(tmp_path, SHARED)).program
    generator = np.random.default_rng(0)

    def act(observations: np.ndarray, starts: np.ndarray, masks: None) -> Decision:
        return Decision(generator.uniform(-1, 1, (1, 2)).astype(np.float32))

    terms = {name: [*member.terms.values()] for name, member in program.members.items()}
    with closing(SingleWorlds([api.build(program)], [7], agent_terms=terms)) as worlds:
        collector = LocalCollector(worlds)
        fragment = collector.collect(act, 50)
    assert fragment is not None
    assert fragment.endings
    with closing(deepbots_cli.parallel_env(tmp_path / "several.yaml")) as environment:
        for name, member in program.members.items():
            seat = SeatCollector(SeatLayout(member, program.agent), collector)
            seat.offer(fragment)
            own = seat.fetch(None, 50)  # type: ignore[arg-type]  # it has acted already
            observed, _ = environment.reset(seed=7)
            for number in range(fragment.endings[0][0] + 1):
                assert own.observations[number, 0].tolist() == observed[name].tolist()
                actions = {
                    other: fragment.actions[number, 0, [place]] for place, other in enumerate(observed)
                }
                assert own.actions[number, 0].tolist() == actions[name].tolist()
                observed, rewards, *_, infos = environment.step(actions)
                assert own.rewards[number, 0] == pytest.approx(rewards[name])
            ending = own.endings[0][1]
            assert ending.observation.tolist() == observed[name].tolist()
            assert ending.episode.is_success == infos[name]["is_success"]
            assert ending.episode.total_return == pytest.approx(own.rewards[: number + 1].sum(), rel=1e-4)


def test_a_batch_pays_each_agent_what_single_worlds_do(tmp_path: Path) -> None:
    program = api.compile(write_scenario(tmp_path, SHARED), overrides=["world.engine=mujoco"]).program
    terms = {name: [*member.terms.values()] for name, member in program.members.items()}
    actions = np.random.default_rng(0).uniform(-1, 1, (30, 8, 2)).astype(np.float32)
    single = SingleWorlds([api.build(program) for _ in range(8)], range(8), agent_terms=terms)
    batch = BatchWorlds(
        lambda stage: api.build_batch(program, 8, engine="mujoco"), range(8), agent_terms=terms
    )
    with closing(single), closing(batch):
        for worlds in (single, batch):
            worlds.reset()
        for step in actions:
            of_single, of_batch = single.step_all(step).agent_rewards, batch.step_all(step).agent_rewards
            assert {*of_single} == {*of_batch} == {"left", "right"}
            for name in of_single:
                assert of_batch[name] == pytest.approx(of_single[name], rel=1e-5, abs=1e-6)


def test_all_agents_learn_in_one_run(trained: Path) -> None:
    run = Run.open(trained)
    result = run.record.result
    assert result is not None
    assert {*result.agents} == {"left", "right"}
    assert sum(result.agents.values()) == pytest.approx(result.mean_return)
    assert result.best is not None
    assert (result.best.chosen_by, result.best.steps) == ("newest", result.steps)  # the agents compete
    weights = load_model(run, "best").weights()
    assert {name.partition("/")[0] for name in weights} == {"left", "right"}
    layer = "mlp_extractor.policy_net.0.weight"
    assert not np.array_equal(weights[f"left/{layer}"], weights[f"right/{layer}"])


def test_an_evaluation_has_the_scores_of_each_agent(trained: Path) -> None:
    result = evaluate(trained, episodes=4, seed=5)
    program = Run.open(trained).program
    for name, member in program.members.items():
        own = [own_episode(member, episode) for episode in result.outcomes]
        assert result.agents[name].mean_return == pytest.approx(np.mean([each.total_return for each in own]))
        assert result.agents[name].success_rate == np.mean([each.is_success for each in own])
    assert json.loads(result.model_dump_json())["agents"]["left"]["episodes"] == 4


@pytest.mark.parametrize(
    "training",
    [
        pytest.param(PPO, id="PPO", marks=pytest.mark.slow),
        pytest.param(SAC, id="SAC", marks=pytest.mark.slow),
    ],
)
def test_an_interrupted_training_of_all_agents_becomes_the_same(tmp_path: Path, training: str) -> None:
    scenario = write_scenario(tmp_path, SEVERAL.replace(OWN, training))
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    deepbots_cli.train(scenario, run=whole, seed=2)
    assert deepbots_cli.train(scenario, run=cut, seed=2, progress=At(100)).interrupted
    deepbots_cli.resume(cut)
    assert outcome(cut) == outcome(whole)


@pytest.mark.slow
def test_shards_of_all_agents_give_the_same_weights_wherever_they_run(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, SHARED.replace("n_steps", "environments: 2, shards: 2, n_steps"))
    here = deepbots_cli.train(scenario, run=tmp_path / "here", seed=3)
    with Cluster(workers=2) as cluster, LocalProcesses(2) as processes:
        cluster._pool = processes
        there = deepbots_cli.train(scenario, run=tmp_path / "there", seed=3, executor=cluster)
    assert here.weights_digest == there.weights_digest


@pytest.mark.slow
def test_agents_with_a_success_in_common_keep_the_best_model(tmp_path: Path) -> None:
    program = api.compile(write_scenario(tmp_path, TOGETHER)).program
    assert program.defines_success
    assert not program.has_rivals
    result = deepbots_cli.train(tmp_path / "several.yaml", run=tmp_path / "run", seed=1)
    assert result.success_rate is not None
    assert result.best is None or result.best.chosen_by != "newest"


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ("train: {environments: 2}", "different `environments`"),
        ("train: {n_steps: 32}", "write `n_steps`"),
    ],
)
def test_agents_that_cannot_learn_in_the_same_worlds_are_refused_with_what_to_write(
    tmp_path: Path, own: str, message: str
) -> None:
    text = SHARED.replace("{like: left, robots: [right]}", f"{{like: left, robots: [right], {own}}}")
    with pytest.raises(UsageError, match=message):
        deepbots_cli.train(write_scenario(tmp_path, text), run=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_agents_learn_in_turns(tmp_path: Path) -> None:
    text = SHARED.replace("n_steps: 64", "n_steps: 64, turns: 128").replace("768", "192")
    deepbots_cli.train(write_scenario(tmp_path, text), run=tmp_path / "run", seed=1, keep_checkpoints=3)
    run = Run.open(tmp_path / "run")
    weights = [load_model(run, f"step-{steps:09d}").weights() for steps in (64, 128, 192)]
    layer = "mlp_extractor.policy_net.0.weight"
    changed = [
        {name for name in ("left", "right") if not np.array_equal(a[f"{name}/{layer}"], b[f"{name}/{layer}"])}
        for a, b in pairwise(weights)
    ]
    assert changed == [{"left"}, {"right"}]


def test_an_agent_begins_with_its_policy_of_a_run_of_all(trained: Path, tmp_path: Path) -> None:
    alone = api.compile(write_scenario(tmp_path, SHARED), overrides=["role={agent: right}"])
    result = deepbots_cli.train(alone, run=tmp_path / "run", total_timesteps=64, initialize_from=trained)
    assert result.initialized_from is not None
    with own_model(trained / "models" / "agent" / "best.zip", "right") as file:
        assert (tmp_path / "run" / "models" / "agent" / "initial.zip").read_bytes() == file.read_bytes()


def test_a_teacher_of_all_agents_is_refused(trained: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--agent left"):
        deepbots_cli.train(write_scenario(tmp_path, SHARED), run=tmp_path / "run", demonstrations=trained)


def test_an_agent_adds_keys_to_the_training_of_all(tmp_path: Path) -> None:
    own = "train: {learning_rate: 1e-5}"
    text = SHARED.replace("{like: left, robots: [right]}", f"{{like: left, robots: [right], {own}}}")
    members = api.compile(write_scenario(tmp_path, text)).program.members
    settings = {
        name: {entry.name: entry.value for entry in member.program.agent.training.hyperparameters}  # type: ignore[union-attr]
        for name, member in members.items()
    }
    assert settings["left"]["n_steps"] == settings["right"]["n_steps"] == 64
    assert "learning_rate" not in settings["left"]
    assert settings["right"]["learning_rate"] == 1e-5
    in_python = deepbots_cli.Scenario.from_yaml(tmp_path / "several.yaml")
    assert api.compile(in_python).digest == api.compile(tmp_path / "several.yaml").digest


def test_a_damaged_model_of_an_agent_is_refused_by_its_name(trained: Path, tmp_path: Path) -> None:
    copied = shutil.copytree(trained, tmp_path / "run")
    model = copied / "models" / "agent" / "best.zip"
    with zipfile.ZipFile(trained / "models" / "agent" / "best.zip") as whole:
        parts = {name: whole.read(name) for name in whole.namelist()}
    with zipfile.ZipFile(model, "w") as archive:
        archive.writestr("data", parts["data"])
        archive.writestr("left.zip", parts["left.zip"])
        archive.writestr("right.zip", parts["right.zip"][:200])
    with pytest.raises(RunError, match="right"):
        load_model(Run.open(copied), "best")
    with (
        pytest.raises(RunError, match="no model of the agent 'left'"),
        own_model(copied / "run.json", "left"),
    ):
        pass
