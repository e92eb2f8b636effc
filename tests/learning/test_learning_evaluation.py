"""Evaluating a run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import stand_in

from deepbots_cli.api import Compiled, compile, make
from deepbots_cli.cli.records import case_rows, evaluation_text, summary_text
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.expressions.dimensions import LENGTH
from deepbots_cli.learning import TrainingResult, evaluate, evaluate_baselines, evaluate_cases, train
from deepbots_cli.learning.runs.episodes import Summary
from deepbots_cli.learning.runs.verdict import solved_verdict
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout import Episode


def figures(trained: TrainingResult, **settings: object) -> dict[str, object]:
    return evaluate(trained.run, build=stand_in.build, **settings).model_dump(mode="json")  # type: ignore[arg-type]


@pytest.mark.parametrize("deterministic", [True, False])
def test_the_result_does_not_depend_on_how_many_worlds_run_at_once(
    trained: TrainingResult, deterministic: bool
) -> None:
    results = [
        figures(trained, episodes=13, copies=copies, deterministic=deterministic) for copies in (1, 3, 8)
    ]
    assert results[0] == results[1] == results[2]
    assert results[0]["least_return"] != results[0]["greatest_return"]


def test_evaluate_takes_the_path_of_a_run_as_text(trained: TrainingResult) -> None:
    assert evaluate(str(trained.run), episodes=1, build=stand_in.build) == evaluate(
        trained.run, episodes=1, build=stand_in.build
    )
    assert evaluate_cases(str(trained.run), build=stand_in.build) == ()


def test_evaluate_takes_another_scenario_by_its_path_as_train_does(trained: TrainingResult) -> None:
    with pytest.raises(RunError, match="was trained with other observations"):
        evaluate(trained.run, episodes=1, scenario="cartpole", build=stand_in.build)


def test_other_seeds_are_other_starts(trained: TrainingResult) -> None:
    assert figures(trained, episodes=20, seed=0) != figures(trained, episodes=20, seed=1)
    assert figures(trained, episodes=20, seed=0) == figures(trained, episodes=20, seed=0)


def test_the_figures_belong_together(trained: TrainingResult) -> None:
    result = evaluate(trained.run, build=stand_in.build)
    assert result.episodes == 20
    assert sum(result.endings.values()) == 20
    assert (
        result.mean_return == pytest.approx(result.mean_length) == pytest.approx(result.term_means["alive"])
    )
    assert result.return_interval is not None
    assert result.return_interval[0] <= result.mean_return <= result.return_interval[1]
    assert result.success_interval[0] <= result.success_rate <= result.success_interval[1]
    assert result.least_return <= result.mean_return <= result.greatest_return
    text = evaluation_text(result)
    assert "95 %" in text
    assert text.splitlines()[-1] == result.verdict
    assert json.loads(json.dumps(result.model_dump(mode="json")))["episodes"] == 20


def test_on_episode_is_called_after_each_episode(trained: TrainingResult) -> None:
    progress: list[tuple[int, int]] = []
    evaluate(
        trained.run,
        episodes=10,
        build=stand_in.build,
        on_episode=lambda done, of: progress.append((done, of)),
    )
    assert progress == [(done, 10) for done in range(1, 11)]


def test_a_single_episode_has_no_standard_deviation(trained: TrainingResult) -> None:
    result = evaluate(trained.run, episodes=1, build=stand_in.build)
    assert result.std_return is None
    assert "standard deviation" not in evaluation_text(result)


def episodes(count: int, total_return: float, successes: int = 0) -> list[Episode]:
    return [Episode(total_return, 1, number < successes, None) for number in range(count)]


def test_the_verdict_follows_the_scenario() -> None:
    solved = Solved(100, mean_return=195.0)
    assert solved_verdict(solved, episodes(100, 199.0)) == (
        True,
        "solved: mean return 199 where 195 is required",
        100,
    )
    assert solved_verdict(solved, episodes(100, 190.0))[0] is False
    assert solved_verdict(solved, episodes(20, 199.0))[0] is None
    assert solved_verdict(None, episodes(100, 199.0))[0] is None
    assert solved_verdict(Solved(10, mean_return=1.0, success_rate=0.9), episodes(10, 5.0, 5))[0] is False


def test_after_failed_confirmations_an_evaluation_that_just_meets_the_criterion_does_not_solve_the_task() -> (
    None
):
    """`train` noted "not confirmed", and ended with "solved: success rate 92.0% where 90.0% is required"."""
    solved = Solved(100, success_rate=0.9)
    met, text, required = solved_verdict(solved, episodes(100, 1.0, 92), number=2)
    assert met is None
    assert required == 200
    assert text.endswith("may be luck in 100 episodes; evaluate with `--episodes 200`")
    met, text, _ = solved_verdict(solved, episodes(200, 1.0, 184), number=2)
    assert met is False
    assert text.endswith("and to confirm it, at least 187 of 200 successes must be reached")
    assert solved_verdict(solved, episodes(200, 1.0, 187), number=2).solved is True
    assert (
        solved_verdict(solved, episodes(100, 1.0, 92))[0] is True
    )  # of a policy that a confirmation has shown to be good enough


def test_a_scenario_that_no_longer_fits_is_refused_field_by_field(trained: TrainingResult) -> None:
    with pytest.raises(RunError) as caught:
        evaluate(trained.run, scenario=stand_in.compiled(speed_range=2.0), build=stand_in.build)
    assert "observation.speed: run -0.8 .. 0.8 m/s, scenario -2 .. 2 m/s" in str(caught.value)
    assert "observation.x" not in str(caught.value)


def test_reordered_observations_and_other_actions_are_refused(trained: TrainingResult) -> None:
    compiled = stand_in.compiled()
    turned = stand_in.altered(compiled, policy={"observation": compiled.program.agent.observation[::-1]})
    with pytest.raises(RunError, match=r"order: run observation\.x"):
        evaluate(trained.run, scenario=turned, build=stand_in.build)
    with pytest.raises(
        RunError, match=r"action\.drive: run forward \(1\) \| backward \(-1\) sets drive, scenario -1 .. 1"
    ):
        evaluate(trained.run, scenario=stand_in.compiled(continuous=True), build=stand_in.build)


def test_changed_messages_are_refused(trained: TrainingResult) -> None:
    compiled = stand_in.compiled()
    robot = compiled.program.robots[0]
    typed = robot.emit[0].typed
    length = typed._replace(type=typed.type._replace(dimension=LENGTH))
    renamed = replace(robot, emit=(replace(robot.emit[0], typed=length),))
    with pytest.raises(
        RunError, match=r"message from robot cart\.pole_angle: run float64 rad, scenario float64 m"
    ):
        evaluate(trained.run, scenario=stand_in.altered(compiled, robots=(renamed,)), build=stand_in.build)


def test_a_policy_may_be_tried_in_a_scenario_with_other_rules(trained: TrainingResult) -> None:
    result = evaluate(
        trained.run, episodes=3, scenario=stand_in.compiled(max_steps=7, name="Short"), build=stand_in.build
    )
    assert result.scenario == "Short"
    assert result.greatest_return == 7


@pytest.mark.parametrize(
    ("episodes", "seed", "words"), [(0, 0, "episodes"), (-1, 0, "episodes"), (1, -1, "seed")]
)
def test_senseless_numbers_are_refused(trained: TrainingResult, episodes: int, seed: int, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        evaluate(trained.run, episodes=episodes, seed=seed, build=stand_in.build)


def test_an_evaluation_under_another_timing_says_so(trained: TrainingResult) -> None:
    later = stand_in.altered(stand_in.compiled(), timing="delayed")
    result = evaluate(trained.run, episodes=3, scenario=later, build=stand_in.build)
    assert "trained with timing immediate, evaluated with delayed" in evaluation_text(result)
    assert evaluate(trained.run, episodes=3, build=stand_in.build).notes == ()


def evaluation_json() -> Compiled:
    """The stand-in with a case `short`, of three episodes of seven steps, and one that changes nothing of
    it."""
    return stand_in.compiled(
        cases="short: {set: {truncation.max_steps: 7}, episodes: 3}, same: {set: {world.substeps: 4}}"
    )


def test_every_case_is_evaluated_from_the_same_starts(tmp_path: Path) -> None:
    run = train(evaluation_json(), run=tmp_path / "run", total_timesteps=200, build=stand_in.build).run
    base = evaluate(run, build=stand_in.build)
    short, same = evaluate_cases(run, build=stand_in.build)
    assert short.case == "short"
    assert short.episodes == 3
    assert short.greatest_return == 7.0
    plain = {"case": None, "circumstances": [], "verdict": base.verdict}
    assert same.model_dump(mode="json") | plain == base.model_dump(mode="json")
    assert evaluate(run, case="short", build=stand_in.build) == short
    assert evaluate(run, case="short", episodes=5, build=stand_in.build).episodes == 5
    assert "case short" in evaluation_text(short)
    assert [row["case"] for row in case_rows([base, short, same])] == [
        "(the scenario itself)",
        "short",
        "same",
    ]
    with pytest.raises(UsageError, match="no case 'long'; there are: short, same"):
        evaluate(run, case="long", build=stand_in.build)


def test_a_run_with_a_case_for_another_policy_is_refused(tmp_path: Path) -> None:
    run = train(evaluation_json(), run=tmp_path / "run", total_timesteps=200, build=stand_in.build).run
    resolved = run / "resolved.yaml"
    text = (run / "resolved.yaml").read_text()
    for forged in ("observation.speed: -2 .. 2 m/s", "evaluation.episodes: 3"):
        resolved.write_text(text.replace("truncation.max_steps: 7", forged))
        with pytest.raises(RunError, match="does not compile"):
            evaluate(run, build=stand_in.build)


def test_small_returns_are_shown_with_four_decimals() -> None:
    done = [Episode(value, 10, False, "max_time") for value in (0.1423, 0.1431)]
    assert (
        "mean return         0.1427 (95 %: 0.1376 .. 0.1478)\n  standard deviation  0.0006"
        in summary_text(Summary.of_episodes(done), success_defined=False)
    )
    assert "mean return       14.27" in summary_text(
        Summary.of_episodes([Episode(14.27, 10, False, None)]), success_defined=False
    )


def test_an_evaluation_that_already_excludes_what_is_asked_for_says_so() -> None:
    solved = Solved(100, success_rate=0.95)
    met, verdict, _ = solved_verdict(solved, episodes(30, 0.0))
    assert met is False
    assert verdict.startswith("not solved: a success rate of 95.0% is required, and 0 of 30 episodes succeed")
    assert solved_verdict(solved, episodes(30, 0.0, 29))[0] is None


def test_an_episode_keeps_the_seed_and_what_its_reset_drew(tmp_path: Path) -> None:
    task = compile(
        "find_ball",
        overrides=[
            "train.environments=1",
            "train.n_steps=32",
            "train.batch_size=32",
            "truncation.max_steps=50",
        ],
    )
    run = train(task, run=tmp_path / "run", total_timesteps=1).run
    result = evaluate(run, episodes=2)
    with make("find_ball") as env:
        for episode in result.outcomes:
            assert env.reset(seed=episode.seed)[1]["drawn"] == episode.drawn != {}
    assert list(result.outcomes[0].drawn) == list(result.outcomes[1].drawn)


@pytest.mark.slow
def test_baselines_and_the_policy_have_the_same_starts(tmp_path: Path) -> None:
    task = compile(
        "pit_escape", overrides=["train.environments=1", "train.n_steps=32", "train.batch_size=32"]
    )
    run = train(task, run=tmp_path / "run", total_timesteps=1).run
    results = evaluate_baselines(
        run, episodes=2, seed=5, scenario=compile("pit_escape", overrides=["truncation.max_steps=20"])
    )
    assert [result.model for result in results] == ["random", "zero", "script forward_only", "script rocking"]
    policy = evaluate(
        run, episodes=2, seed=5, scenario=compile("pit_escape", overrides=["truncation.max_steps=20"])
    )
    for result in results:
        assert [episode.drawn for episode in result.outcomes] == [
            episode.drawn for episode in policy.outcomes
        ]
