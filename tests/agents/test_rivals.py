"""Policies of runs beside an agent, and match-ups of policies and scripts."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, ScenarioError, UsageError
from deepbots_cli.learning.agents.matches import play_matches
from deepbots_cli.learning.evaluation import evaluate, load_model
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.rollout.drivers import named_driver
from deepbots_cli.runtime.agents import driven
from deepbots_cli.runtime.forward_pass import FORWARD_BATCH_SIZE
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.plots import plot
from deepbots_cli.view.training_logs import read_logs
from tests.agents.test_multi_agent_training import SHARED, write_scenario
from tests.worlds import RAIL


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which both agents have learned, beside its scenario."""
    folder = tmp_path_factory.mktemp("rivals")
    deepbots_cli.train(write_scenario(folder, SHARED), run=folder / "run", seed=1)
    return folder / "run"


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
    policy = load_model(Run.open(trained), "best").learners["left"]
    with closing(api.build(scenario_with_rival(trained, "random").program)) as world:
        observed, _ = world.reset(seed=derive_seed(2, "evaluation", 0))
        total = 0.0
        ended = False
        while not ended:
            action, _ = policy.predict(observed[None], deterministic=True)
            observed, reward, terminated, truncated, _ = world.step(action[0])
            total = total + float(reward)
            ended = terminated or truncated
    assert result.outcomes[0].total_return == pytest.approx(total)


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
        wins = losses = 0
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
                wins += bool(infos[lean]["is_success"])
                losses += bool(infos[other]["is_success"])
    match = table.matches[2]
    assert (match.wins, match.losses, match.episodes) == (wins, losses, 10)


def test_agents_with_rewards_of_their_own_play_their_own_side(trained: Path, tmp_path: Path) -> None:
    text = SHARED.replace(
        "{like: left, robots: [right]}", "{like: left, robots: [right], reward: {alive: 1}}"
    )
    deepbots_cli.train(write_scenario(tmp_path, text), run=tmp_path / "run", total_timesteps=64)
    table = play_matches([tmp_path / "run"], episodes=2)
    assert not table.is_symmetric
    assert len(table.matches) == 9
    assert all(set(match.agents) == {"left", "right"} for match in table.matches)


def test_compare_prints_a_table_of_players(trained: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(trained), "--episodes", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("Carts: share of decided episodes that the row wins")
    assert [line.split()[0] for line in lines[3:6]] == ["policy", "lean", "random"]
    assert main(["compare", str(trained), "--episodes", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["agents"] == ["left", "right"]


def test_policies_play_in_another_scenario_of_the_same_agents(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = tmp_path / "short.yaml"
    short.write_text(f"deepbots: 1\nextends: {trained.parent / 'several.yaml'}\nname: Short\n")
    words = ["--scenario", str(short), "--allow-path", str(trained.parent)]
    assert main(["compare", str(trained), "--episodes", "1", *words]) == 0
    assert capsys.readouterr().out.startswith("Short: ")


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


def test_scripts_play_against_each_other_before_any_training(
    trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = str(trained.parent / "several.yaml")
    assert main(["compare", scenario, "--episodes", "3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[3:5]] == ["lean", "random"]
    assert main(["compare", scenario, "--episodes", "3", "--json"]) == 0
    (match,) = json.loads(capsys.readouterr().out)["matches"]
    assert sum(match["endings"].values()) == match["episodes"] == 6
    seconds = []
    for own, rival in (("lean", "random"), ("random", "lean")):
        role = f"role={{agent: left, others: {{right: {rival}}}}}"
        with closing(api.make(scenario, overrides=[role])) as world:
            for number in range(3):
                driver = named_driver(world, own) if own == "lean" else None
                seat = world.seat  # type: ignore[attr-defined]  # of an agent
                draw = driven(world.supervisor, seat, "random")  # type: ignore[attr-defined]
                seen, _ = world.reset(seed=derive_seed(0, "evaluation", number))
                steps = 0
                ended = False
                while not ended:
                    action = driver.act(seen) if driver is not None else draw(seen)
                    seen, _, terminated, truncated, _ = world.step(action)
                    steps = steps + 1
                    ended = terminated or truncated
                seconds.append(steps * 0.032)
    assert match["mean_seconds"] == pytest.approx(np.mean(seconds))


@pytest.mark.parametrize("words", [["cartpole"], ["tag", "--case", "easy"]])
def test_a_comparison_of_scripts_needs_two_agents_and_no_other_setting(words: list[str]) -> None:
    assert main(["compare", *words]) == 2


def test_a_match_of_one_agent_is_refused(tmp_path: Path) -> None:
    deepbots_cli.train(
        api.compile(
            RAIL, overrides=["reward={one: 1}", "train={algorithm: PPO, total_timesteps: 32, n_steps: 32}"]
        ),
        run=tmp_path / "run",
    )
    with pytest.raises(UsageError, match="two agents"):
        play_matches([tmp_path / "run"])


@pytest.mark.slow
def test_the_policy_of_each_agent_is_exported(trained: Path, tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    assert main(["eval", str(trained), "--episodes", "3"]) == 0
    folder = tmp_path / "bundle"
    assert main(["export", str(trained), "--agent", "right", "-o", str(folder)]) == 0
    described = json.loads((folder / "bundle.json").read_text())
    assert [part["name"] for part in described["action"]] == ["drive"]
    evaluated = json.loads((trained / "evaluations" / "0001.json").read_text())
    assert described["evaluation"]["mean_return"] == evaluated["agents"]["right"]["mean_return"]
    assert main(["export", str(folder), "--check", str(folder / "scenario.yaml")]) == 0


@pytest.mark.parametrize("command", ["export", "serve"])
def test_a_policy_of_several_agents_is_asked_for_by_name(
    trained: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, str(trained)]) == 2
    assert f"deepbots export {trained} --agent left" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "instead"),
    [
        (["compare", "RUN", "RUN", "--own"], "in one scenario; leave out --own\n"),
        (
            ["compare", "RUN", "RUN", "--workers", "2", "--cluster", "auto"],
            "leave out --workers and --cluster",
        ),
        (["compare", "RUN", "RUN", "--case", "heavy"], "leave out --case, and write a change"),
        (["robustness", "RUN"], "--agent NAME"),
        (["transfer", "RUN"], "--agent NAME"),
        (["eval", "RUN", "--min-return", "1"], "--agent NAME"),
    ],
)
def test_a_number_about_all_agents_that_compete_is_refused(
    trained: Path, words: list[str], instead: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([word.replace("RUN", str(trained)) for word in words]) == 2
    assert instead in capsys.readouterr().err


@pytest.mark.slow
def test_robustness_is_that_of_one_agent(trained: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["robustness", str(trained), "--agent", "left", "--episodes", "2", "--min-return", "-1000"]) == 0
    )
    assert "mass of" in capsys.readouterr().out


@pytest.mark.slow
def test_a_group_of_agents_that_compete_shows_the_return_of_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = write_scenario(tmp_path, SHARED)
    deepbots_cli.learning.train_group(
        api.compile(scenario), [1, 2], group=tmp_path / "group", total_timesteps=64
    )
    assert main(["eval", str(tmp_path / "group"), "--episodes", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["run", "left", "right"]
    assert [line.split()[0] for line in lines[3:5]] == ["seed-1", "seed-2"]


def test_an_agent_of_a_run_plays_against_the_policies_of_the_run(
    trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    together = evaluate(trained, episodes=3, seed=9)
    assert main(["eval", str(trained), "--agent", "right", "--episodes", "3", "--seed", "9", "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert alone["mean_return"] == pytest.approx(together.agents["right"].mean_return)
