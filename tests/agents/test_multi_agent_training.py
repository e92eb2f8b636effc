"""Several agents that learn.

* Several agents that learn in the same worlds.
* Learning of agents whose episodes end while those of others go on.
* `critic` of an agent that is trained beside others.
* Agents with one policy.
* One agent in a batch of worlds, beside agents that act by themselves: the same as in single worlds.
"""

from __future__ import annotations

import json
import shutil
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cluster import Cluster
from deepbots_cli.cluster.worker_pool import LocalProcesses
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.campaigns.listing import read_listed
from deepbots_cli.learning.environments import EvaluationWorlds, supervisor_factory
from deepbots_cli.learning.evaluation import evaluate
from deepbots_cli.learning.multi_agent import own_model
from deepbots_cli.learning.policy import load_model
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3.internals import samples_chosen
from deepbots_cli.program import Program
from deepbots_cli.rollout.collector import Decision, LocalCollector, SeatCollector
from deepbots_cli.rollout.episode import own_episode
from deepbots_cli.rollout.worlds import BatchWorlds, SingleWorlds, Worlds, observation_digest
from deepbots_cli.runtime.agents import SeatLayout
from deepbots_cli.view.frames import FrameReader
from tests.agents.carts import CARTS, scenario_fixture, write_scenario
from tests.agents.test_agents import ALONE, SEVERAL
from tests.few import few
from tests.learning.interruption import becomes_the_same

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


def test_each_agent_learns_from_its_own_part_of_each_step(tmp_path: Path) -> None:
    program = api.compile(write_scenario(tmp_path, SHARED)).program
    generator = np.random.default_rng(0)

    def act(observations: np.ndarray, starts: np.ndarray, masks: None) -> Decision:
        return Decision(generator.uniform(-1, 1, (1, 2)).astype(np.float32))

    with closing(SingleWorlds([api.build(program)], [7])) as worlds:
        collector = LocalCollector(worlds)
        fragment = collector.collect(act, 50)
    assert fragment is not None
    assert fragment.endings
    with closing(deepbots_cli.parallel_env(tmp_path / "several.yaml")) as environment:
        for name, member in program.members.items():
            seat = SeatCollector([SeatLayout(member, program.agent)], collector)
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


def test_agents_that_compete_are_listed_without_a_mean_return_while_they_train(
    trained: Path, tmp_path: Path
) -> None:
    run = Path(shutil.copytree(trained, tmp_path / "run"))
    assert Run.open(run).program.has_rivals
    assert read_listed(run).mean_return is None
    Run.open(run).update(status="running", result=None)
    with run_lock(run):
        listed = read_listed(run)
    assert (listed.state, listed.mean_return, listed.success_rate) == ("training", None, None)
    assert listed.episodes is not None
    assert listed.episodes > 0


def test_an_evaluation_has_the_scores_of_each_agent(trained: Path) -> None:
    result = evaluate(trained, episodes=4, seed=5)
    for name, member in Run.open(trained).program.members.items():
        own = [own_episode(member, episode) for episode in result.outcomes]
        assert result.agents[name].mean_return == pytest.approx(np.mean([each.total_return for each in own]))
        assert result.agents[name].success_rate == np.mean([each.is_success for each in own])
    assert json.loads(result.model_dump_json())["agents"]["left"]["episodes"] == 4


@pytest.mark.slow
@pytest.mark.parametrize("case", ["PPO", "SAC", "older weights", "one policy", "ends of its own"])
def test_an_interrupted_training_of_all_agents_becomes_the_same(tmp_path: Path, case: str) -> None:
    text = {
        "PPO": SEVERAL.replace(OWN, PPO),
        "SAC": SEVERAL.replace(OWN, SAC),
        "older weights": SHARED.replace("n_steps", "environments: 2, shards: 2, staleness: 1, n_steps"),
        "one policy": SHARED_POLICY + PPO_512,
        "ends of its own": LEARNING,
    }[case]
    becomes_the_same(write_scenario(tmp_path, text), tmp_path, 500 if text == LEARNING else 100, seed=2)
    assert {*evaluate(tmp_path / "whole", episodes=4, seed=5).agents} == {"left", "right"}


@pytest.mark.slow
@pytest.mark.parametrize("case", ["policies", "one policy"])
def test_shards_of_all_agents_give_the_same_weights_wherever_they_run(tmp_path: Path, case: str) -> None:
    text = SHARED if case == "policies" else SHARED_POLICY + PPO_512
    scenario = write_scenario(tmp_path, text.replace("n_steps", "environments: 2, shards: 2, n_steps"))
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
    assert read_listed(result.run).success_rate is not None
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


LEARNING = ALONE + PPO.replace("768", "1024") + "\n"
NAMES = ["left", "right"]


carts = scenario_fixture(LEARNING)


def _worlds(file: Path, kind: str, count: int) -> Worlds:
    program = api.compile(file, overrides=["world.engine=mujoco"]).program
    if kind == "batch":
        return BatchWorlds(lambda stage: api.build_batch(program, count, engine="mujoco"), range(count))
    return SingleWorlds([api.build(program) for _ in range(count)], range(count))


def _ahead(observations: np.ndarray, starts: np.ndarray, masks: None) -> Decision:
    return Decision(np.tile(np.float32([1.0, 0.2]), (len(starts), 1)))


def test_the_episodes_of_an_agent_end_where_it_ends(carts: Path) -> None:
    fragments = {}
    for kind in ("single", "batch"):
        with closing(_worlds(carts, kind, 3)) as worlds:
            collector = LocalCollector(worlds)
            fragments[kind] = collector.collect(_ahead, 90)
            program = worlds.worlds[0].get_wrapper_attr("scenario")
    of_all = fragments["single"]
    assert of_all is not None
    assert fragments["batch"] is not None
    for name in NAMES:
        assert of_all.agent_phases[name].tolist() == fragments["batch"].agent_phases[name].tolist()
        assert fragments["batch"].agent_rewards[name] == pytest.approx(
            of_all.agent_rewards[name], rel=1e-5, abs=1e-6
        )
    seat = SeatCollector([SeatLayout(program.members["left"], program.agent)], collector)
    seat.offer(of_all)
    own = seat.fetch(None, 90)  # type: ignore[arg-type]  # it has acted already
    assert own.taking_part is not None
    assert 0 < own.taking_part.sum() < own.taking_part.size
    assert not own.rewards[~own.taking_part].any()
    ended = of_all.agent_phases["left"] == 1
    assert own.starts[1:][ended[:-1]].all()
    assert (own.starts[1:] == (of_all.starts[1:] | ended[:-1])).all()
    for number, ending in own.endings:
        part = own.taking_part[: number + 1, ending.row]
        begun = np.flatnonzero(of_all.starts[: number + 1, ending.row])[-1]
        assert (ending.episode.length, ending.episode.ended_by) == (part[begun:].sum(), "left_fell")
        assert not ending.timed_out
        assert ending.episode.total_return == pytest.approx(
            own.rewards[begun : number + 1, ending.row].sum(), rel=1e-4
        )


@pytest.mark.slow
def test_a_learner_bootstraps_no_value_after_the_end_and_leaves_out_what_follows(
    carts: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from deepbots_cli.learning.sb3.learner import OnPolicyLearner

    seen = []
    usual = OnPolicyLearner.update

    def update(learner: OnPolicyLearner) -> None:
        buffer, part = learner.model.rollout_buffer, learner._participation
        assert part is not None
        ends = part[:-1] & ~part[1:]
        seen.append((ends.sum(), part.sum(), part.size))
        assert buffer.returns[:-1][ends] == pytest.approx(buffer.rewards[:-1][ends], rel=1e-5)
        drawn = []
        draw = buffer._get_samples
        monkeypatch.setattr(buffer, "_get_samples", lambda rows: drawn.append(rows) or draw(rows))
        usual(learner)
        monkeypatch.delattr(buffer, "_get_samples")
        # The first sample is drawn to flatten the arrays, and is not learned from.
        assert set(np.concatenate(drawn[1:]).tolist()) == set(np.flatnonzero(part.T).tolist())

    monkeypatch.setattr(OnPolicyLearner, "update", update)
    deepbots_cli.train(carts, run=tmp_path / "run", seed=1)
    assert sum(ends for ends, *_ in seen) > 0
    assert sum(size - part for _, part, size in seen) > 0


def test_mirror_images_are_left_out_too() -> None:
    from gymnasium.spaces import Box
    from stable_baselines3.common.buffers import RolloutBuffer

    buffer = RolloutBuffer(3, Box(-1, 1, (1,)), Box(-1, 1, (1,)), n_envs=2)
    buffer.rewards[...] = np.arange(6).reshape(3, 2)
    buffer.values[...] = buffer.rewards
    buffer.full = True
    with samples_chosen(buffer, np.array([[True, False], [True, True], [False, True]])):
        batches = [batch.old_values.tolist() for batch in buffer.get(3)]
    assert sorted(value for batch in batches for value in batch) == [0.0, 2.0, 3.0, 5.0]
    assert [len(batch) for batch in batches] == [3, 1]


CRITIC = CARTS.replace(
    "    reward: {upright", "    critic: {gap: 0 .. 4 m, spin: -5 .. 5 rad/s}\n    reward: {upright"
).replace(
    "augment: {speed: velocity(left).x}",
    "augment: {speed: velocity(left).x, gap: apart, spin: angular_velocity(left.pole).y}",
)
PPO_CRITIC_ALONE = (
    "train: {algorithm: PPO, total_timesteps: 64, environments: 8, n_steps: 8, n_epochs: 1,"
    " network: {hidden: [8]}}\n"
)
ROLE = "role={agent: right, others: {left: lean}}"


@pytest.fixture
def carts_with_critic(tmp_path: Path) -> api.Compiled:
    return api.compile(
        write_scenario(tmp_path, CRITIC + PPO_CRITIC_ALONE), overrides=[ROLE, "world.engine=mujoco"]
    )


def test_the_worlds_of_the_training_show_what_its_own_critic_sees(
    carts_with_critic: api.Compiled,
) -> None:
    program = carts_with_critic.program.with_critic
    assert program.agent.policy_columns == (0, 1)
    with closing(api.build(program)) as single, closing(api.build_batch(program, 2)) as batch:
        seen, _ = single.reset(seed=3)
        assert (seen.shape, batch.reset([3, 4])[0].tolist()) == ((4,), seen.tolist())
        after, *_, info = single.step([0.5])
        assert after[2] == pytest.approx(2 * (-10 * info["reward_terms"]["near"]) / 4 - 1)
        assert after.tolist() == batch.step([[0.5], [0.5]]).observations[0].tolist()
    with closing(api.build(carts_with_critic.program)) as world:
        assert world.observation_space.shape == (2,)


def test_a_world_of_the_batch_of_one_agent_is_shown_from_its_reset(carts_with_critic: api.Compiled) -> None:
    with closing(api.build_batch(carts_with_critic.program, 2)) as batch:
        seen = batch.reset([3, 4])
        shown = FrameReader(batch.singles[1]).read(seen[1])
    assert list(shown.agents["agent"].terms) == list(batch.TERMS)


def test_a_critic_learns_from_more_than_the_policy_sees(
    carts_with_critic: api.Compiled, tmp_path: Path
) -> None:
    deepbots_cli.train(carts_with_critic, run=tmp_path / "run", seed=1)
    model = load_model(Run.open(tmp_path / "run"), "best").model  # type: ignore[attr-defined]  # of Stable-Baselines3
    assert model.policy.mlp_extractor.policy_net[0].in_features == 2
    assert model.policy.mlp_extractor.value_net[0].in_features == 4
    assert evaluate(tmp_path / "run", episodes=2).episodes == 2


PPO_512 = PPO.replace("768", "512") + "\n"


def _changed(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text


SHARED_POLICY = _changed(
    CARTS, ("right: {like: left, robots: [right]}", "right: {like: left, robots: [right], policy: left}")
)
SHARED_ALONE = _changed(
    SHARED_POLICY,
    ("success: right, failure: left}", "ends: left, failure: left}"),
    ("success: left, failure: right}", "ends: right, failure: right}"),
)

sharing_carts = scenario_fixture(SHARED_POLICY + PPO_512)


@pytest.mark.parametrize("text", [SHARED_POLICY, SHARED_ALONE], ids=["together", "alone"])
def test_the_experience_of_both_agents_is_joined(tmp_path: Path, text: str) -> None:
    program = api.compile(write_scenario(tmp_path, text)).program
    alone = any(member.alone for member in program.members.values())

    def act(observations: np.ndarray, starts: np.ndarray, masks: None) -> Decision:
        actions = np.tile(np.float32([1.0, 0.1]), (2, 1))
        return Decision(
            actions, {f"{name}/values": actions[:, place] for place, name in enumerate(program.members)}
        )

    with closing(SingleWorlds([api.build(program) for _ in range(2)], [7, 8])) as worlds:
        collector = LocalCollector(worlds)
        fragment = collector.collect(act, 80)
        assert fragment is not None
        seats = [SeatLayout(member, program.agent) for member in program.members.values()]
        parts = [SeatCollector([seat], collector).part_of(fragment) for seat in seats]
        shared = SeatCollector(seats, collector)
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
        assert (part.taking_part is not None) == alone
        if part.taking_part is not None:
            assert both.taking_part is not None
            assert both.taking_part[:, rows].tolist() == part.taking_part.tolist()


@pytest.mark.parametrize(
    ("text", "algorithm", "message"),
    [
        (ALONE, "SAC", "`left_fell` ends the episode of `left` alone, which SAC"),
        (ALONE, "RecurrentPPO", "`left_fell` ends the episode of `left` alone, which RecurrentPPO"),
        (SHARED_POLICY, "SAC", "SAC does not support a policy that several agents share"),
    ],
)
def test_an_algorithm_without_support_is_refused_in_one_sentence(
    tmp_path: Path, text: str, algorithm: str, message: str
) -> None:
    scenario = write_scenario(tmp_path, f"{text}train: {{algorithm: {algorithm}, total_timesteps: 256}}\n")
    with pytest.raises(UsageError, match=message):
        deepbots_cli.train(scenario, run=tmp_path / "run", seed=1)


@pytest.mark.parametrize("text", [SHARED_POLICY, SHARED_ALONE], ids=["together", "alone"])
def test_both_agents_act_by_the_same_weights(sharing_carts: Path, tmp_path: Path, text: str) -> None:
    sharing_carts.write_text(text + PPO_512)
    assert deepbots_cli.train(sharing_carts, run=tmp_path / "run", seed=1, total_timesteps=128).steps == 128
    weights = load_model(Run.open(tmp_path / "run"), "best").weights()
    left = {name.partition("/")[2]: array for name, array in weights.items() if name.startswith("left/")}
    assert left
    assert all(np.array_equal(array, weights[f"right/{name}"]) for name, array in left.items())
    assert {*evaluate(tmp_path / "run", episodes=2).agents} == {"left", "right"}


WORLDS = 9
"""One more than a forward pass has rows."""
CHOOSING = (
    SEVERAL.replace(
        "  right: {like: left, robots: [right]}\n",
        """\
  right:
    robots: [right]
    action:
      go: {choices: {ahead: 1, back: -1, rest: 0}, forbid: {ahead: apart < 0.95 m}}
    augment: {gap: apart}
    observation: {right.angle: -1 .. 1 rad, gap: 0 .. 2 m}
    reward: {upright: cos(right.angle)}
    scripts:
      lean: {go: {ahead: right.angle > 1 deg, rest: right.angle > -1 deg, back: true}}
    train:
      {algorithm: MaskablePPO, total_timesteps: 64, n_steps: 64, n_epochs: 1, batch_size: 32,
       network: {hidden: [8]}}
""",
    )
    .replace("apply: {wheels: drive * 5 rad/s}", "apply: {wheels: go * 5 rad/s}", 2)
    .replace("apply: {wheels: go * 5 rad/s}", "apply: {wheels: drive * 5 rad/s}", 1)
)
"""The right agent chooses between options, one of which may be forbidden."""
ROLES = {
    "script": "agent: left, others: {right: lean}",
    "random": "agent: left, others: {right: random}",
    "zero": "agent: left, others: {right: zero}",
    "chooser": "agent: right, others: {left: lean}",
}


def compare(program: Program, steps: int = 80) -> int:
    """Assert that a batch and single worlds show the same, also after they are brought back. Return the
    number of episodes."""
    single = SingleWorlds([api.build(program, engine="mujoco") for _ in range(WORLDS)], range(WORLDS))
    batch = BatchWorlds(lambda stage: api.build_batch(program, WORLDS), range(WORLDS))
    single.action_space.seed(1)
    episodes = 0
    with closing(single), closing(batch):
        assert observation_digest(single.reset()) == observation_digest(batch.reset())
        for step in range(steps + 20):
            masks = single.action_masks() if program.agent.choices else None
            if masks is not None:
                assert masks.tolist() == batch.action_masks().tolist()
                actions = np.array([np.random.default_rng(step).choice(np.flatnonzero(row)) for row in masks])
            else:
                actions = np.stack([single.action_space.sample() for _ in range(WORLDS)])
            of_single, of_batch = single.step_all(actions), batch.step_all(actions)
            assert observation_digest(of_single.observations) == observation_digest(of_batch.observations)
            assert of_single.rewards.tolist() == of_batch.rewards.tolist()
            assert [(end.row, end.episode) for end in of_single.endings] == [
                (end.row, end.episode) for end in of_batch.endings
            ]
            episodes += len(of_single.endings)
            if step == steps:
                kept = batch.histories()
                seen = observation_digest(of_batch.observations)
                assert observation_digest(batch.repeat(kept)) == seen
    return episodes


@pytest.mark.parametrize(
    "case",
    few(
        [(role, kind) for role in ROLES for kind in ("ranges", "choices")],
        ["script-ranges", "chooser-choices"],
        "-".join,
    ),
)
def test_an_agent_beside_others_sees_the_same_in_a_batch(tmp_path: Path, case: tuple[str, str]) -> None:
    role, kind = case
    text = SEVERAL if kind == "ranges" else CHOOSING
    program = api.compile(write_scenario(tmp_path, text), overrides=[f"role={{{ROLES[role]}}}"]).program
    assert compare(program) > 0


@pytest.fixture(scope="module", params=["PPO", pytest.param("RecurrentPPO", marks=pytest.mark.slow)])
def trained_alike(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which both agents have learned, beside its scenario."""
    if request.param == "RecurrentPPO":
        pytest.importorskip("sb3_contrib")
    folder = tmp_path_factory.mktemp("policies")
    deepbots_cli.train(
        write_scenario(folder, SHARED.replace("algorithm: PPO", f"algorithm: {request.param}")),
        run=folder / "run",
        seed=1,
        total_timesteps=128,
    )
    return folder / "run"


def scenario_with_rival(trained_alike: Path, *overrides: str) -> api.Compiled:
    role = f"role={{agent: left, others: {{right: {json.dumps(str(trained_alike))}}}}}"
    return api.compile(
        trained_alike.parent / "several.yaml",
        overrides=[role, "world.engine=mujoco", *overrides],
        permissions=Permissions(folders=(trained_alike,)),
    )


@pytest.mark.slow
def test_a_policy_that_takes_masks_acts_the_same_in_a_batch(tmp_path: Path) -> None:
    pytest.importorskip("sb3_contrib")
    scenario = write_scenario(tmp_path, CHOOSING)
    deepbots_cli.train(api.compile(scenario, overrides=["role.agent=right"]), run=tmp_path / "run")
    role = f"role={{agent: left, others: {{right: {json.dumps(str(tmp_path / 'run'))}}}}}"
    allowed = Permissions(folders=(tmp_path,))
    compare(api.compile(scenario, overrides=[role], permissions=allowed).program)


@pytest.mark.slow
def test_an_evaluation_beside_a_policy_is_the_same_in_a_batch(trained_alike: Path, tmp_path: Path) -> None:
    program = scenario_with_rival(trained_alike).program
    deepbots_cli.train(scenario_with_rival(trained_alike), run=tmp_path / "run", total_timesteps=64)
    model = load_model(Run.open(tmp_path / "run"), "last")
    build = supervisor_factory("mujoco")
    played = []
    for setting in ({"engine": "mujoco", "batch": 20}, {}):
        worlds = EvaluationWorlds(build, **setting)  # type: ignore[arg-type]  # the settings of each
        with closing(worlds):
            worlds.enter(program)
            assert worlds.has_batch_for(20) == ("batch" in setting)
            played.append(worlds.play(model, range(20)))
    assert played[0] == played[1]
