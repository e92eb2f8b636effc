"""Agents against each other, and reports of each agent.

* Policies of runs beside an agent, and match-ups of policies and scripts.
* One policy for two equal agents, which plays against itself and against past versions of itself.
* `diagnose` and `report` of each agent of a run by itself.
"""

from __future__ import annotations

import json
import shutil
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, ScenarioError, UsageError
from deepbots_cli.insight.causes import causes_after, diagnose
from deepbots_cli.insight.training import TrainingEvidence, read_training, read_trainings, run_probes
from deepbots_cli.learning import self_play
from deepbots_cli.learning.checkpoints import latest_checkpoint
from deepbots_cli.learning.evaluation import evaluate, play_matches
from deepbots_cli.learning.policy import load_model
from deepbots_cli.learning.runs.run import PoolGames, Run
from deepbots_cli.learning.self_play import SelfPlayLearner, Sides, SidesCollector
from deepbots_cli.rollout.collector import Decision, LocalCollector
from deepbots_cli.rollout.worlds import SingleWorlds
from deepbots_cli.runtime.agents import SeatLayout
from deepbots_cli.runtime.spaces import FORWARD_BATCH_SIZE
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.view import recordings
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.plots import plot
from deepbots_cli.view.replay import ReplayPlayer, open_player
from deepbots_cli.view.training_logs import read_logs
from tests.agents.carts import write_scenario
from tests.agents.test_multi_agent_training import SHARED
from tests.commands import Deepbots
from tests.learning.interruption import becomes_the_same


def scenario_with_rival(trained: Path, driver: str | Path) -> api.Compiled:
    """The scenario of the left agent, with a driver for the right one."""
    role = f"role={{agent: left, others: {{right: {json.dumps(str(driver))}}}}}"
    permissions = Permissions(folders=(trained,))
    return api.compile(trained.parent / "several.yaml", overrides=[role], permissions=permissions)


def test_the_policy_of_a_run_acts_for_the_other_agent(trained: Path) -> None:
    policy = load_model(Run.open(trained), "best").learners["right"]
    scenario = trained.parent / "several.yaml"
    with (
        closing(api.build(scenario_with_rival(trained, trained).program)) as world,
        closing(deepbots_cli.parallel_env(scenario)) as all_agents,
    ):
        own, _ = world.reset(seed=4)
        observed, _ = all_agents.reset(seed=4)
        for step in range(20):
            assert own.tolist() == observed["left"].tolist()
            action = np.array([np.sin(step)], np.float32)
            rows = np.repeat(observed["right"][None], FORWARD_BATCH_SIZE, axis=0)
            right, _ = policy.predict(rows, deterministic=True)
            own, reward, *_ = world.step(action)
            observed, rewards, *_ = all_agents.step({"left": action, "right": right[0]})
            assert reward == pytest.approx(rewards["left"])


def test_a_run_keeps_the_policy_that_acts_beside_it(trained: Path, tmp_path: Path) -> None:
    deepbots_cli.train(scenario_with_rival(trained, trained), run=tmp_path / "run", total_timesteps=64)
    moved = tmp_path / "moved"
    (tmp_path / "run").rename(moved)
    kept = Run.open(moved)
    assert kept.digest == kept.record.digest
    assert next(iter(kept.program.others.models.values())).is_relative_to(moved)  # type: ignore[union-attr]
    assert evaluate(moved, episodes=2).episodes == 2


def test_a_model_has_the_digest_of_its_bytes_and_not_of_its_path(trained: Path, tmp_path: Path) -> None:
    model = trained / "models" / "agent" / "best.zip"
    assert scenario_with_rival(trained, trained).digest == scenario_with_rival(trained, model).digest
    assert scenario_with_rival(trained, trained).digest != scenario_with_rival(trained, "random").digest


@pytest.mark.parametrize("path", ["runs/nothing", "nothing/best.zip"])
def test_a_policy_that_does_not_exist_is_a_finding_at_its_place(trained: Path, path: str) -> None:
    with pytest.raises(ScenarioError, match="does not exist"):
        scenario_with_rival(trained, path)


def test_a_policy_with_other_layers_is_refused_with_the_reason(trained: Path, tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, SHARED.replace("hidden: [8]", "hidden: [16]"))
    role = f"role={{agent: left, others: {{right: {json.dumps(str(trained))}}}}}"
    program = api.compile(scenario, overrides=[role], permissions=Permissions(folders=(trained,))).program
    with pytest.raises(RunError, match="right") as refused:
        api.build(program)
    assert "the `train` of the scenario that it was trained in" in refused.value.full_message


def test_an_agent_of_a_run_is_evaluated_against_a_driver(trained: Path) -> None:
    result = evaluate(trained, scenario=scenario_with_rival(trained, "random"), episodes=3, seed=2)
    assert set(result.term_means) == {"upright", "calm"}  # of the left agent alone


def test_an_agent_of_a_run_is_shown_with_its_own_return(trained: Path) -> None:
    overrides = ("role={agent: left, others: {right: lean}}",)
    with closing(Player(Showing(str(trained), overrides=overrides).open())) as player:
        seen = [next(iter(frame.agents.values())) for frame in player.episode(1, 0)]
        assert [*seen[-1].terms] == [term.name for term in player.program.agent.reward]
    assert seen[-1].episode_return == pytest.approx(sum(sum(seat.terms.values()) for seat in seen[1:]))


def test_players_of_equal_agents_take_both_sides(trained: Path) -> None:
    table = play_matches([trained], episodes=5, seed=3)
    assert table.is_symmetric
    assert table.rows == table.columns == ("policy", "lean", "random")
    assert {(match.row, match.column) for match in table.matches} == {
        ("policy", "lean"),
        ("policy", "random"),
        ("lean", "random"),
    }
    with closing(deepbots_cli.parallel_env(trained.parent / "several.yaml")) as environment:
        wins = losses = steps = 0
        for number in range(5):
            for lean, other in (("left", "right"), ("right", "left")):
                environment.reset(seed=derive_seed(3, "evaluation", number))
                infos: dict[str, dict[str, object]] = {}
                while environment.agents:
                    seats = environment._seats
                    generator = environment.world.streams[f"agents.{other}.random"]
                    actions = {
                        lean: seats[lean].script("lean"),
                        other: generator.uniform(-1.0, 1.0, 1).astype(np.float32),
                    }
                    *_, infos = environment.step(actions)
                    steps += 1
                wins += bool(infos[lean]["is_success"])
                losses += bool(infos[other]["is_success"])
    match = table.matches[2]
    assert (match.wins, match.losses, match.episodes) == (wins, losses, 10)
    assert match.mean_seconds == pytest.approx(steps * 0.032 / 10)


def test_policies_of_runs_with_one_name_are_different_players(trained: Path, tmp_path: Path) -> None:
    copies = [shutil.copytree(trained, tmp_path / folder / "run") for folder in ("a", "b")]
    table = play_matches([trained, *copies], episodes=1)
    assert table.rows == ("policy", *map(str, copies), "lean", "random")


@pytest.mark.slow
def test_agents_with_rewards_of_their_own_play_their_own_side(trained: Path, tmp_path: Path) -> None:
    text = SHARED.replace(
        "{like: left, robots: [right]}", "{like: left, robots: [right], reward: {alive: 1}}"
    )
    deepbots_cli.train(write_scenario(tmp_path, text), run=tmp_path / "run", total_timesteps=64)
    table = play_matches([tmp_path / "run"], episodes=2)
    assert not table.is_symmetric
    assert len(table.matches) == 9
    assert all(set(match.agents) == {"left", "right"} for match in table.matches)


def test_compare_prints_a_table_of_players(trained: Path, deepbots: Deepbots) -> None:
    lines = deepbots("compare", trained, "--episodes", "2").out.splitlines()
    assert lines[0].startswith("Carts: share of decided episodes that the row wins")
    assert [line.split()[0] for line in lines[3:6]] == ["policy", "lean", "random"]
    assert json.loads(deepbots("compare", trained, "--episodes", "2", "--json").out)["agents"] == [
        "left",
        "right",
    ]


def test_policies_play_in_another_scenario_of_the_same_agents(
    trained: Path, tmp_path: Path, deepbots: Deepbots
) -> None:
    short = tmp_path / "short.yaml"
    short.write_text(f"deepbots: 1\nextends: {trained.parent / 'several.yaml'}\nname: Short\n")
    words = ["--scenario", str(short), "--allow-path", str(trained.parent)]
    assert deepbots("compare", trained, "--episodes", "1", *words).out.startswith("Short: ")


def test_scripts_of_a_scenario_with_python_play_where_code_is_allowed(
    tmp_path: Path, deepbots: Deepbots
) -> None:
    file = write_scenario(tmp_path, SHARED.replace("{upright: ", "{code: {python: builtins:hash}, upright: "))
    assert deepbots("compare", file, "--episodes", "1", "--allow-code").out.startswith("Carts: ")


def test_a_policy_that_random_actions_equal_is_named(trained: Path) -> None:
    (note,) = play_matches([trained], episodes=4).notes  # 64 steps of training
    assert note.startswith("policy is not clearly better than random actions: against them, it wins")


def test_a_plot_has_the_returns_and_terms_of_each_agent(trained: Path) -> None:
    logs = read_logs([trained], by_agent=True)
    assert [(log.name, log.agent) for log in logs] == [("left", "left"), ("right", "right")]
    panels = plot(logs).axes
    assert [line.get_label() for line in panels[0].lines[:1]] == ["left"]
    titles = [panel.get_title(loc="left") for panel in panels]
    assert titles.count("endings, share of episodes") == 1
    assert "right: reward terms of an episode" in titles


def test_scripts_play_against_each_other_before_any_training(trained: Path, deepbots: Deepbots) -> None:
    scenario = str(trained.parent / "several.yaml")
    lines = deepbots("compare", scenario, "--episodes", "3").out.splitlines()
    assert [line.split()[0] for line in lines[3:5]] == ["lean", "random"]
    (match,) = json.loads(deepbots("compare", scenario, "--episodes", "3", "--json").out)["matches"]
    assert sum(match["endings"].values()) == match["episodes"] == 6


@pytest.mark.parametrize("words", [["cartpole"], ["tag", "--case", "easy"]])
def test_a_comparison_of_scripts_needs_two_agents_and_no_other_setting(words: list[str]) -> None:
    assert main(["compare", *words]) == 2


@pytest.mark.slow
def test_the_policy_of_each_agent_is_exported(trained: Path, tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    run = shutil.copytree(trained, tmp_path / "run")
    assert main(["eval", str(run), "--episodes", "3"]) == 0
    folder = tmp_path / "bundle"
    assert main(["export", str(run), "--agent", "right", "-o", str(folder)]) == 0
    described = json.loads((folder / "bundle.json").read_text())
    assert [part["name"] for part in described["action"]] == ["drive"]
    evaluated = json.loads((run / "evaluations" / "0001.json").read_text())
    assert described["evaluation"]["mean_return"] == evaluated["agents"]["right"]["mean_return"]
    assert main(["export", str(folder), "--check", str(folder / "scenario.yaml")]) == 0


@pytest.mark.parametrize("command", ["export", "serve"])
def test_a_policy_of_several_agents_is_asked_for_by_name(
    trained: Path, command: str, deepbots: Deepbots
) -> None:
    assert f"deepbots export {trained} --agent left" in deepbots(command, trained, code=2).err


@pytest.mark.parametrize(
    ("words", "instead"),
    [
        (["compare", "RUN", "RUN", "--own"], "--own does not go with agents that compete"),
        (["compare", "RUN", "RUN", "--workers", "2"], "--workers does not go with agents that compete"),
        (["compare", "RUN", "RUN", "--case", "heavy"], "--case does not go with agents that compete"),
        (["robustness", "RUN"], "--agent NAME"),
        (["transfer", "RUN"], "--agent NAME"),
        (["eval", "RUN", "--min-return", "1"], "--agent NAME"),
    ],
)
def test_a_number_about_all_agents_that_compete_is_refused(
    trained: Path, words: list[str], instead: str, deepbots: Deepbots
) -> None:
    assert instead in deepbots(*[word.replace("RUN", str(trained)) for word in words], code=2).err


@pytest.mark.slow
def test_robustness_is_that_of_one_agent(trained: Path, deepbots: Deepbots) -> None:
    assert (
        "mass of"
        in deepbots("robustness", trained, "--agent", "left", "--episodes", "2", "--min-return", "-1000").out
    )


@pytest.mark.slow
def test_a_group_of_agents_that_compete_shows_the_return_of_each(tmp_path: Path, deepbots: Deepbots) -> None:
    deepbots_cli.learning.train_group(
        api.compile(write_scenario(tmp_path, SHARED)), [1, 2], group=tmp_path / "group", total_timesteps=64
    )
    lines = deepbots("eval", tmp_path / "group", "--episodes", "2").out.splitlines()
    assert lines[1].split() == ["run", "left", "right"]
    assert [line.split()[0] for line in lines[3:5]] == ["seed-1", "seed-2"]


@pytest.mark.slow
def test_an_agent_of_a_run_plays_against_the_policies_of_the_run(trained: Path, deepbots: Deepbots) -> None:
    together = evaluate(trained, episodes=3, seed=9)
    alone = json.loads(
        deepbots("eval", trained, "--agent", "right", "--episodes", "3", "--seed", "9", "--json").out
    )
    assert alone["mean_return"] == pytest.approx(together.agents["right"].mean_return)


PLAYED = SHARED.replace(
    "total_timesteps: 768,",
    "total_timesteps: 1536, environments: 4, self_play: {every: 256, pool: 3, newest: 50 %},",
).replace("n_steps: 64", "n_steps: 32")


SCRIPTED = PLAYED.replace("newest: 50 %", "newest: 25 %, scripts: 50 %").replace(
    "5 * left.angle / rad}", "5 * left.angle / rad}, ahead: {drive: 1}"
)


@given(worlds=st.integers(1, 200), newest=st.floats(0, 1), scripts=st.floats(0, 1))
def test_the_policy_plays_one_or_both_sides_of_each_world(worlds: int, newest: float, scripts: float) -> None:
    sides = Sides.divided(worlds, newest, scripts)
    assert set(sides.scripted) <= set(sides.others)
    assert len(sides.scripted) == min(len(sides.others), round(scripts * worlds))
    first, second, past = set(sides.first), set(sides.second), set(sides.others)
    assert first | second == set(range(worlds))
    assert past == first ^ second  # there another policy plays the other side
    assert abs(len(first) - len(second)) <= 1
    assert len(past) == worlds - round(newest * worlds)


def test_the_policy_learns_from_the_sides_that_it_plays(tmp_path: Path) -> None:
    program = api.compile(write_scenario(tmp_path, PLAYED)).program
    generator = np.random.default_rng(0)

    def act(observations: np.ndarray, starts: np.ndarray, masks: None) -> Decision:
        return Decision(generator.uniform(-1, 1, (4, 2)).astype(np.float32))

    seats = [SeatLayout(member, program.agent) for member in program.members.values()]
    sides = Sides.divided(4, 0.5)
    assert (sides.first.tolist(), sides.second.tolist()) == ([0, 1, 2], [0, 1, 3])
    with closing(SingleWorlds([api.build(program) for _ in range(4)], range(4))) as worlds:
        of_all = LocalCollector(worlds)
        fragment = of_all.collect(act, 40)
        collector = SidesCollector(of_all, seats, sides)
        assert fragment is not None
        part = collector.part_of(fragment)
    for row, (world, side, name) in enumerate(
        [(0, 0, "left"), (1, 0, "left"), (2, 0, "left"), (0, 1, "right"), (1, 1, "right"), (3, 1, "right")]
    ):
        seen = seats[side].observation(fragment.observations)
        assert part.observations[:, row].tolist() == seen[:, world].tolist()
        assert part.actions[:, row, 0].tolist() == fragment.actions[:, world, side].tolist()
        assert part.rewards[:, row].tolist() == fragment.agent_rewards[name][:, world].tolist()
        assert part.starts[:, row].tolist() == fragment.starts[:, world].tolist()
    ended = [(number, ending.row) for number, ending in fragment.endings]
    expected = [
        (number, row) for number, world in ended for row in {0: (0, 3), 1: (1, 4), 2: (2,), 3: (5,)}[world]
    ]
    assert [(number, ending.row) for number, ending in part.endings] == sorted(expected)


@pytest.mark.parametrize(
    ("text", "worlds"),
    [
        pytest.param(PLAYED, 4, id="past policies", marks=pytest.mark.slow),
        pytest.param(SCRIPTED, 4, id="scripts too", marks=pytest.mark.slow),
        pytest.param(SCRIPTED, 16, id="scripts in a batch", marks=pytest.mark.slow),
    ],
)
def test_an_interrupted_training_with_self_play_becomes_the_same(
    tmp_path: Path, text: str, worlds: int
) -> None:
    scenario = write_scenario(tmp_path, text.replace("environments: 4", f"environments: {worlds}"))
    assert becomes_the_same(scenario, tmp_path, 900, seed=2)["result"]["ratings"]


@pytest.mark.slow
def test_both_agents_of_a_model_have_the_same_policy(tmp_path: Path) -> None:
    result = deepbots_cli.train(write_scenario(tmp_path, PLAYED), run=tmp_path / "run", seed=2)
    weights = load_model(Run.open(tmp_path / "run"), "best").weights()
    left = {name.partition("/")[2]: array for name, array in weights.items() if name.startswith("left/")}
    assert left
    for name, array in left.items():
        assert np.array_equal(weights[f"right/{name}"], array)
    assert [rating.steps for rating in result.ratings] == [256, 512, 768, 1024, 1280, 1536, 1536]
    assert result.ratings[0].mean == 25.0  # nobody was in the pool
    assert result.ratings[-1].deviation < 25 / 3


@pytest.mark.slow
def test_past_policies_act_with_the_weights_of_their_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pools: list[list[int]] = []
    act = SelfPlayLearner._let_opponents_act

    def watched(learner: SelfPlayLearner, *arguments: Any) -> None:
        pools.append([past.rating.steps for past in learner.pool])
        for past in learner.pool:
            assert past.policy.digest() == digests.setdefault(past.rating.steps, past.policy.digest())
        act(learner, *arguments)

    digests: dict[int, str] = {}
    monkeypatch.setattr(SelfPlayLearner, "_let_opponents_act", watched)
    deepbots_cli.train(write_scenario(tmp_path, PLAYED), run=tmp_path / "run", seed=2)
    assert pools[0] == []
    assert pools[-1] == [768, 1024, 1280]  # a pool of three, the oldest ones gone
    assert len(set(digests.values())) == len(digests) == 5


@pytest.mark.slow
@pytest.mark.parametrize("engine", [pytest.param("pybullet", marks=pytest.mark.slow), "mujoco"])
def test_scripts_of_the_scenario_play_the_other_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, engine: str
) -> None:
    seen = []
    collect = SelfPlayLearner.collect

    def watched(learner: SelfPlayLearner) -> bool:
        collected = collect(learner)
        seen.append((learner._last.columns["opponents"], learner._last.actions, learner._sides))
        return collected

    monkeypatch.setattr(SelfPlayLearner, "collect", watched)
    text = SCRIPTED.replace("environments: 4", "environments: 16").replace(
        "arena:", f"engine: {engine}, arena:"
    )
    deepbots_cli.train(write_scenario(tmp_path, text), run=tmp_path / "run", seed=2)
    ahead = 0
    for opponents, actions, sides in seen:
        assert set(np.unique(opponents[:, sides.scripted])) <= {-2, -3}  # lean and ahead
        assert opponents[:, sides.others].max() < 3
        for side, worlds in ((1, sides.others[::2]), (0, sides.others[1::2])):
            is_ahead = opponents[:, worlds] == -3
            ahead += is_ahead.sum()
            assert (actions[:, worlds, side][is_ahead] == 1).all()
    assert ahead > 100


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("newest: 50 %, scripts: 20 %", "newest: 50 %, scripts: 60 %", "`scripts` of `self_play` are shares"),
        ("scripts: {lean: {drive: 5 * left.angle / rad}}", "", "needs agents with `scripts`"),
        (
            "{like: left, robots: [right]}",
            "{like: left, robots: [right], reward: {alive: 1}}",
            "two equal agents",
        ),
        (
            "{like: left, robots: [right]}",
            "{like: left, robots: [right], train: {n_epochs: 2}}",
            "same `train`",
        ),
        ("algorithm: PPO", "algorithm: RecurrentPPO", "use PPO"),
        ("environments: 4,", "environments: 4, shards: 2,", "`shards`"),
    ],
)
def test_self_play_of_unequal_agents_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = PLAYED.replace("newest: 50 %", "newest: 50 %, scripts: 20 %") if "scripts" in message else PLAYED
    assert old in text
    with pytest.raises(UsageError, match=message):
        deepbots_cli.train(write_scenario(tmp_path, text.replace(old, new)), run=tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_damaged_pool_is_refused(tmp_path: Path) -> None:
    deepbots_cli.train(write_scenario(tmp_path, PLAYED), run=tmp_path / "run", seed=2)
    folder = latest_checkpoint(Run.open(tmp_path / "run"))
    assert folder is not None
    arrays = dict(np.load(folder / "arrays.npz"))
    arrays["opponents"] = arrays["opponents"] + 7
    np.savez(folder / "arrays.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(RunError, match="damaged"):
        deepbots_cli.resume(tmp_path / "run", total_timesteps=3_000)


def test_a_rating_follows_the_results_of_games() -> None:
    rater = self_play._Rater()
    winner, loser = rater.new(), rater.new()
    for _ in range(20):
        winner, loser = rater.rated(winner, loser, 1)
    assert winner.mean > 25 > loser.mean
    assert winner.deviation < rater.new().deviation
    assert rater.rated(rater.new(), rater.new(), 0)[0].mean == 25.0


HOPELESS = SHARED.replace("right_fell: {when: tilt(right.pole) > 30 deg", "late: {when: step > 13")
"""The right agent has failed after 14 steps, whatever it does."""


@pytest.fixture(scope="module")
def hopeless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which the right agent cannot succeed; not to be changed."""
    folder = tmp_path_factory.mktemp("hopeless")
    deepbots_cli.train(write_scenario(folder, HOPELESS), run=folder / "run", seed=1)
    assert main(["eval", str(folder / "run"), "--episodes", "20"]) == 0
    return folder / "run"


def evidence_of(run: Path, agent: str) -> TrainingEvidence:
    (training,) = [each for each in read_trainings(Run.open(run)) if each.agent == agent]
    return training


def test_each_agent_has_its_own_returns_successes_and_curves(hopeless: Path) -> None:
    of_all, left, right = read_training(Run.open(hopeless)), *read_trainings(Run.open(hopeless))
    assert (left.agent, right.agent) == ("left", "right")
    total = left.all_episodes.returns + right.all_episodes.returns
    assert total == pytest.approx(of_all.all_episodes.returns, abs=1e-5)
    assert (left.all_episodes.successes.mean(), right.all_episodes.successes.mean()) == (1, 0)
    assert left.evaluations[-1]["returns"] == [each.total_return for each in left.final_episodes]
    assert {term.name for term in right.program.agent.reward} == {"upright", "calm"}
    for training in (left, right):
        assert len(training.curve("train/approx_kl"))
        assert len(training.curve("reward/upright"))
    assert left.curve("train/approx_kl").tolist() != right.curve("train/approx_kl").tolist()


def test_short_episodes_of_an_agent_are_beside_the_policies_of_the_others(hopeless: Path) -> None:
    training = evidence_of(hopeless, "right")
    run_probes(training)
    assert {*training.constant_actions} == {"drive"}
    assert training.policy
    assert not training.scripts  # a training of several agents has no teacher
    assert len(training.failed) == 6
    for trace, episode in zip(training.failed, training.final_episodes, strict=False):
        assert trace.returns == pytest.approx(episode.total_return)


def test_a_rival_that_is_too_strong_is_named_first(hopeless: Path) -> None:
    cause = diagnose(evidence_of(hopeless, "right"))[0]
    assert cause.cause == "rival_too_strong"
    assert "`right` succeeds in 0%" in cause.text
    assert "`left` in 100%" in cause.text
    assert "rival_too_strong" not in [each.cause for each in diagnose(evidence_of(hopeless, "left"))]
    named = [each.text.partition(":")[0] for each in causes_after(hopeless) if each.cause == cause.cause]
    assert named == ["right"]


@pytest.mark.parametrize(("own", "other"), [(0.3, 0.7), (0.0, 0.5)])
def test_a_rival_that_is_only_better_is_not_too_strong(hopeless: Path, own: float, other: float) -> None:
    training = evidence_of(hopeless, "right")
    draw = np.random.default_rng(0).uniform(size=len(training.all_episodes))
    training.all_episodes.successes = draw < own
    planted = replace(training, rivals={"left": (draw > 1 - other).astype(float)})
    assert "rival_too_strong" not in [each.cause for each in diagnose(planted)]


def test_a_rival_that_got_better_is_not_a_fall_of_the_policy(hopeless: Path) -> None:
    training = evidence_of(hopeless, "right")
    count = len(training.all_episodes)
    wins = np.isin(np.arange(count), np.array_split(np.arange(count), 4)[1])
    training.all_episodes.successes = wins
    planted = replace(training, rivals={"left": (~wins).astype(float)})
    causes = {cause.cause: cause for cause in diagnose(planted)}
    begin, since = (int(training.all_episodes.steps[index]) for index in np.flatnonzero(wins)[[0, -1]])
    assert f"in 100% of the episodes from {begin:,} to {since:,} steps" in causes["rival_improved"].text
    assert "`left` went from 0% to 100%" in causes["rival_improved"].text
    assert "fell_apart" not in causes


def with_games(run: Path, *games: PoolGames) -> TrainingEvidence:
    training = evidence_of(run, "left")
    result = training.run.record.result
    assert result is not None
    record = training.run.record.model_copy(
        update={"result": result.model_copy(update={"pool_games": games})}
    )
    return replace(training, run=Run(run, record, training.run.compiled))


def test_strategies_that_go_round_in_a_circle_are_a_cause(hopeless: Path) -> None:
    games = PoolGames(100, 8, 32), PoolGames(200, 20, 20), PoolGames(300, 34, 6)
    causes = {each.cause: each for each in diagnose(with_games(hopeless, *games))}
    assert "wins 20% of its decided games against the version of 100 steps" in causes["strategies_cycle"].text
    assert "85% against the later version of 300 steps" in causes["strategies_cycle"].text


@pytest.mark.slow
@pytest.mark.parametrize(
    "games",
    [
        (PoolGames(100, 34, 6), PoolGames(300, 8, 32)),  # it has got worse than the newest ones
        (PoolGames(100, 2, 6), PoolGames(300, 6, 2)),  # too few games
        (PoolGames(100, 17, 23), PoolGames(300, 34, 6)),  # by chance
        (),
    ],
)
def test_games_without_a_circle_are_not_a_cause(hopeless: Path, games: tuple[PoolGames, ...]) -> None:
    assert "strategies_cycle" not in [each.cause for each in diagnose(with_games(hopeless, *games))]


def test_advice_for_an_agent_is_a_setting_of_this_agent(hopeless: Path) -> None:
    training = evidence_of(hopeless, "right")
    training.all_episodes.successes[:] = 0
    steps = np.arange(20.0)
    curves = {"train/clip_fraction": (steps, np.full(20, 0.9)), "train/approx_kl": (steps, np.full(20, 0.5))}
    planted = replace(training, rivals={}, scalars=curves)
    planted.__dict__["settings"] = {**training.settings, "learning_rate": 0.1}
    (cause,) = [each for each in diagnose(planted) if each.cause == "learning_rate_too_high"]
    assert [*cause.settings] == ["agents.right.train.learning_rate"]
    assert "--set agents.right.train.learning_rate=" in cause.command


def test_diagnose_prints_the_causes_of_each_agent(hopeless: Path, deepbots: Deepbots) -> None:
    reports = json.loads(deepbots("diagnose", hopeless, "--only-logs", "--json").out)["runs"]
    assert [each["agent"] for each in reports] == ["left", "right"]
    assert reports[1]["causes"][0]["cause"] == "rival_too_strong"
    assert (
        deepbots("diagnose", hopeless, "--only-logs", "--agent", "right")
        .out.splitlines()[0]
        .startswith(f"{hopeless}, right: ")
    )
    assert "its agents are left, right" in deepbots("diagnose", hopeless, "--agent", "middle", code=2).err


def test_an_episode_is_explained_for_one_agent(hopeless: Path, deepbots: Deepbots) -> None:
    explained = json.loads(
        deepbots("diagnose", hopeless, "--agent", "right", "--episode", "failed", "--json").out
    )
    assert explained["episode"].startswith("episode 0 of ")
    assert explained["outcome"] == "failure"
    assert (
        "none of the 20 episodes"
        in deepbots("diagnose", hopeless, "--agent", "left", "--episode", "failed", code=2).err
    )


@pytest.mark.slow
def test_a_recording_has_the_episodes_that_one_agent_failed(
    hopeless: Path, tmp_path: Path, deepbots: Deepbots
) -> None:
    arguments = ["render", str(hopeless), "-o", str(tmp_path / "failed.mcap"), "--episodes", "failed"]
    assert "--agent left|right" in deepbots(*arguments, code=2).err
    (recording,) = json.loads(deepbots(*arguments, "--agent", "right", "--json").out)["files"]
    evaluated = evidence_of(hopeless, "right").final_episodes
    assert [each["return"] for each in recording["episodes"]] == pytest.approx(
        [each.total_return for each in evaluated]
    )


def test_a_log_without_the_agents_is_refused_with_the_reason(hopeless: Path, tmp_path: Path) -> None:
    run = shutil.copytree(hopeless, tmp_path / "run")
    lines = (run / "monitor.csv").read_text().splitlines()
    lines[1] = lines[1].removesuffix(",agents")
    (run / "monitor.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(RunError, match="an older version wrote it"):
        read_trainings(Run.open(run))


@pytest.mark.slow
def test_a_report_has_the_figures_and_the_causes_of_each_agent(
    hopeless: Path, tmp_path: Path, deepbots: Deepbots
) -> None:
    pytest.importorskip("viser")
    page, figures = tmp_path / "run.html", tmp_path / "figures"
    words = ["report", str(hopeless), "-o", str(page), "--no-clips", "--episodes", "3", "--json"]
    data = json.loads(deepbots(*words, "--figures", figures).out)
    assert data["agents"]["right"]["causes"][0]["cause"] == "rival_too_strong"
    assert "success rate 0.0%" in data["agents"]["right"]["result"]
    assert {file.stem for file in figures.glob("*-*.png")} == {
        f"{agent}-{name}" for agent in ("left", "right") for name in ("returns", "shares", "actions")
    } | {"left-successes"}
    text = page.read_text()
    assert "<h2>left</h2>" in text
    assert "The rival is too strong" in text


def test_the_model_of_agents_that_compete_is_called_the_newest(hopeless: Path, deepbots: Deepbots) -> None:
    output = deepbots("eval", hopeless, "--episodes", "2").out
    assert "run (newest, after 768 steps)" in output
    assert "2 held-out starts from evaluation seed 1, which no training uses" in output
    assert " newest " in deepbots("runs", hopeless).out


def test_the_caption_of_a_picture_names_the_agent_that_succeeds(hopeless: Path, tmp_path: Path) -> None:
    pytest.importorskip("viser")
    pytest.importorskip("mcap")
    player = open_player(Showing(str(hopeless)).open())
    with closing(player):
        last = [*player.episode(1, 0)][-1]
        recordings.record(player, tmp_path / "one.mcap", 1, [0])
    with closing(ReplayPlayer(Showing(str(tmp_path / "one.mcap")).open())) as replayed:
        recorded = [*replayed.episode(1, 0)][-1]
    assert last.ending == recorded.ending == "success of left: late"
