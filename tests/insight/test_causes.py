"""Causes that were once false or in the wrong place: each test is named after the right diagnosis.

A training that is not solved names what it changed since the run that was.

Why a training fell apart: the setting that explains the fall comes first, and its advice is a value that
the scenario does not have.

The command that trains the scenario of a run again.

The changes of a scenario that a phrase asks for.
"""

from __future__ import annotations

import json
import shutil
from contextlib import closing
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("stable_baselines3")

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.document import shipped
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.insight.collapse import suspects
from deepbots_cli.insight.conditions import instrument_program
from deepbots_cli.insight.diagnosis import causes_after, diagnose, has_learned
from deepbots_cli.insight.linted import linted_scenario
from deepbots_cli.insight.missed import common_miss
from deepbots_cli.insight.probes import run_probes
from deepbots_cli.insight.report import Report
from deepbots_cli.insight.scenario_facts import ScenarioFacts
from deepbots_cli.insight.statements import Statement, quantity_text
from deepbots_cli.insight.suggestions import Suggestion, suggestions
from deepbots_cli.insight.trace import Trace, TraceRecorder
from deepbots_cli.insight.train_command import training_command
from deepbots_cli.insight.training import TrainingEvidence, read_training
from deepbots_cli.learning import train
from deepbots_cli.learning.runs.episodes import SolvedAt
from deepbots_cli.learning.runs.records import write_record
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import Decline
from deepbots_cli.rollout import Episode
from tests.few import few
from tests.insight.collapses import CASES, has_fallen, named, trained
from tests.insight.logs import (
    SHUTTLE,
    causes_of,
    evaluations_with,
    outcomes,
    returns_of,
    train_shuttle,
    with_logs,
)

FLAT = np.full(400, 60)
HELD = (
    "signals={there: abs(gap) < near}",
    "scripts={by_hand: {drive: 4 * gap / m}}",
    "termination.success={held: duration(there) > 0.5 s}",
    "reward={closer: -10 * delta(abs(gap)) / m, time: -0.02, parked: 10 when there}",
)
"""Being at the mark pays in every step, and the success, which ends the episode, asks for staying there."""


def statement_of(training: TrainingEvidence, cause: str) -> Statement:
    (statement,) = [each for each in diagnose(training) if each.cause == cause]
    return statement


def _played(run: Run, actions: list[float], mark: float) -> Trace:
    """An episode of the carriage with these actions."""
    watch = instrument_program(run.program, include_observation=True)
    with closing(TraceRecorder(api.build(watch.program, engine="mujoco"), watch)) as world:
        world.reset(seed=4, options={"mark": mark})
        for action in actions:
            if any(world.step(np.array([action], np.float32))[2:4]):
                break
        return world.trace("an episode")


# The reward against the success


@pytest.fixture(scope="module")
def held(tmp_path_factory) -> Path:
    """A training of the shuttle that holds its mark; not to be changed."""
    return train_shuttle(tmp_path_factory.mktemp("held"), *HELD)


def test_a_reward_that_cheats_is_named_first_with_the_term_that_pays(held):
    """Returns of 268 against the 57.6 of the script, with a success rate of 9 %, once had no diagnosis."""
    training = read_training(Run.open(held))
    run_probes(training)
    script = np.mean([trace.returns for trace in training.scripts["by_hand"]])
    good = outcomes(400, 0.2, 0.09, 0.09)
    curves = {"reward__parked": np.linspace(50, 5 * script, 20), "reward__closer": [2.0] * 20}
    logged = with_logs(training.run.path, np.linspace(0, 5 * script, 400), FLAT, success=good, **curves)
    cheating = replace(logged, scripts=training.scripts, policy=training.policy, random=training.random)
    first = diagnose(cheating)[0]
    assert (first.cause, first.evidence["term"], first.evidence["example"]) == (
        "reward_exploited",
        "parked",
        "the script 'by_hand'",
    )
    assert "the script in 100% (68% to 100%) of 8 episodes" in first.text
    assert "Let 'parked' pay once" in first.advice
    poorer = with_logs(training.run.path, np.linspace(0, 0.5 * script, 400), FLAT, success=good, **curves)
    assert "reward_exploited" not in causes_of(replace(poorer, scripts=training.scripts))
    succeeds = with_logs(training.run.path, np.full(400, 5 * script), FLAT, success=1.0, **curves)
    assert "reward_exploited" not in causes_of(replace(succeeds, scripts=training.scripts))


def test_an_exploit_that_only_the_exploration_uses_is_named_although_the_policy_succeeds(held):
    """The policy succeeded in all episodes with 295, and those of the training returned 829 without a
    success."""
    curves = {"reward__parked": np.linspace(50, 800, 20), "reward__closer": [2.0] * 20}
    logged = with_logs(held, np.linspace(0, 829, 400), FLAT, success=0.0, **curves)
    succeeding = [Episode(295.0, 117, True, "found", {"parked": 242.0, "closer": 3.0}) for _ in range(100)]
    solved = replace(logged, final_episodes=succeeding, verdict=replace(logged.verdict, solved=True))
    named = statement_of(solved, "reward_exploited")
    assert (
        "more than the 295 of the successful episodes of the evaluation, but the policy succeeds in 0%"
        in named.text
    )
    assert "'parked' pays most of the difference" in named.text
    fewer = with_logs(held, np.full(400, 250.0), FLAT, success=0.5, **curves)
    assert "reward_exploited" not in causes_of(
        replace(fewer, final_episodes=succeeding, verdict=solved.verdict)
    )


def test_a_reward_that_disagrees_with_the_success_comes_before_the_noise_on_the_actions(carriage):
    """88 % with and 41 % without exploration once came first."""
    good = outcomes(400, 0.5, 0.7, 0.7)
    done = evaluations_with(*[0.2] * 20)
    training = with_logs(carriage, returns_of(good, 5) - 12 * good, FLAT, success=good, evaluations=done)
    causes = causes_of(training)
    assert causes.index("reward_apart_from_success") < causes.index("success_needs_exploration")


def test_previous_action_is_not_advised_to_a_scenario_that_has_it(carriage, tmp_path):
    good = outcomes(400, 0.2, 0.9, 1.0, 1.0)
    poor = [Episode(0.0, 60, k < 29, "max_steps") for k in range(100)]

    def advice_for(run: Path) -> str:
        training = with_logs(
            run, returns_of(good, 0), FLAT, success=good, evaluations=evaluations_with(*[0.3] * 20)
        )
        return statement_of(replace(training, final_episodes=poor), "success_needs_exploration").advice

    without = advice_for(carriage)
    assert "`previous_action: auto`" in without
    assert "--timesteps 50_000`. The noise" in without  # the sentence had no end
    assert "`previous_action" not in advice_for(train_shuttle(tmp_path, "observation.previous_action=auto"))


def test_a_term_for_progress_is_not_advised_to_a_scenario_that_has_one(carriage, tmp_path):
    seldom = np.zeros(2706)
    seldom[1200] = 1
    lengths = np.full(2706, 60)
    own = statement_of(
        with_logs(carriage, returns_of(seldom, 0), lengths, success=seldom), "success_never_seen"
    )
    assert "Add a reward term for progress" not in own.advice
    assert "'closer', which leads towards success" in own.advice
    sparse = train_shuttle(tmp_path, "reward={time: -0.02, parked: 5 when parked}")
    none = statement_of(
        with_logs(sparse, returns_of(seldom, 0), lengths, success=seldom), "success_never_seen"
    )
    assert "Add a reward term for progress" in none.advice


@pytest.mark.slow
def test_noise_that_is_large_already_is_raised_and_not_lowered(tmp_path):
    noisy = "train={algorithm: TD3, total_timesteps: 24000, action_noise: {type: normal, sigma: 0.5}}"
    training = with_logs(
        train_shuttle(tmp_path, noisy), returns_of(np.zeros(400), 0), FLAT, train__std=[0.01] * 20
    )
    assert statement_of(training, "exploration_collapsed").settings == {"train.action_noise.sigma": "1"}


# Failing


def test_the_terms_that_make_an_early_failure_pay_are_named(tmp_path):
    """The diagnosis was once that success is rare, with the advice to add a term for progress, which the
    scenario has."""
    hit = "termination.failure={hit: abs(shuttle.place) > 0.49 m}"
    lengths = np.concatenate([np.full(60, 60.0), np.full(340, 20.0)]) + np.random.default_rng(3).normal(
        0, 1, 400
    )
    returns = -0.5 * lengths + np.random.default_rng(4).normal(0, 6, 400)
    run = train_shuttle(tmp_path, hit, "reward.effort=-0.5 * drive^2")
    ending = np.array(["max_steps"] * 60 + ["hit"] * 340, object)
    curves = {
        "reward__effort": [-28.0] + [-9.0] * 19,
        "reward__closer": [1.0] * 20,
        "reward__time": [-1.2] + [-0.4] * 19,
    }
    first = diagnose(with_logs(run, returns, lengths, ending=ending, **curves))[0]
    assert first.cause == "ending_early_pays"
    assert (
        "'hit' ends 100% of them after 20 steps on average; the first episodes of the training lasted 60"
        in first.text
    )
    assert "'effort' went from -28 to -9 per episode and 'time' went from -1.2 to -0.4" in first.text
    paid = {**curves, "reward__effort": [-9.0] * 20, "reward__closer": [-9.0] + [9.0] * 19}
    training = with_logs(run, -returns, lengths, ending=ending, **paid)
    assert "ending_early_pays" not in causes_of(training)  # it drives there, which pays


# The ceiling of the return


def test_a_return_that_every_episode_reaches_has_no_advice_to_explore_more(tmp_path):
    """39.2 in all of 100 episodes, where `solved` asks for 60 and the speed of the wheels allows 40."""
    sets = [
        "termination={}",
        "reward={far: 10 * delta(shuttle.place) / m}",
        "solved=mean_return >= 60 over 100 episodes",
    ]
    run = train_shuttle(tmp_path, *sets)
    grown = 39.2 - 30 * np.exp(-np.arange(400) / 20) + np.random.default_rng(2).normal(0, 0.02, 400)
    ending = {"ending": "max_steps", "train__std": [0.5] + [0.01] * 19}
    first = diagnose(with_logs(run, grown, FLAT, **ending))[0]
    assert first.cause == "return_at_ceiling"
    assert "`solved` asks for 60" in first.text
    assert "mean_return >= 38" in first.advice
    assert "exploration_collapsed" not in causes_of(with_logs(run, grown, FLAT, **ending))
    stuck = with_logs(run, np.where(np.arange(400) == 9, 50.0, grown), FLAT, **ending)
    assert "exploration_collapsed" in causes_of(stuck)  # an episode returned more


def test_a_return_near_its_bound_is_not_said_to_be_the_same_in_all_episodes(tmp_path):
    """58.2 of 60 on average, and 45 in every eighth episode."""
    run = train_shuttle(tmp_path, "termination={}", "reward={alive: 1}")
    uneven = np.where(np.arange(400) % 8 == 0, 45.0, 60.0)
    ceiling = statement_of(with_logs(run, uneven, FLAT, ending="max_steps"), "return_at_ceiling")
    assert "58.2 on average in 100 late episodes of the training (from 45 to 60)" in ceiling.text
    rising = np.linspace(50, 60, 400)
    assert "return_at_ceiling" not in causes_of(with_logs(run, rising, FLAT, ending="max_steps"))
    possible = train_shuttle(
        tmp_path / "asked",
        "termination={}",
        "reward={alive: 1}",
        "solved=mean_return >= 59 over 100 episodes",
    )
    assert "return_at_ceiling" not in causes_of(with_logs(possible, uneven, FLAT, ending="max_steps"))


# Teachers and conditions


def test_a_teacher_that_fails_itself_is_named_when_its_pupil_does_as_well(tmp_path):
    """55 % of its own, and 51 % of the pupil."""
    halves = "scripts={by_hand: {drive: 4 * gap / m if mark > 0 m else 0}}"
    run = train_shuttle(tmp_path, halves, "train.teacher=by_hand")
    good = outcomes(400, 0.3, 0.51, 0.51)
    done = [*evaluations_with(0.5, 0.5, 0.5)]
    curves = {"teacher__success_rate": [0.55]}
    pupil = with_logs(run, returns_of(good, 0), FLAT, success=good, evaluations=done, **curves)
    statement = statement_of(pupil, "teacher_fails")
    assert "'by_hand' succeeds in 55% (34% to 74%) of 20 episodes" in statement.text
    assert statement.command == f"deepbots try {SHUTTLE} --driver by_hand --episodes 20"
    able = with_logs(
        run, returns_of(good, 0), FLAT, success=good, evaluations=done, teacher__success_rate=[1.0]
    )
    assert "teacher_fails" not in causes_of(able)
    poor = [Episode(0.0, 60, k < 10, "max_steps") for k in range(100)]
    assert "teacher_fails" not in causes_of(replace(pupil, final_episodes=poor))


SLOW = (
    "termination.success={parked: abs(gap) < near and abs(joint_velocity(shuttle.slide)) < 2 mm/s and"
    " step > 5}"
)


def test_the_condition_that_all_failed_episodes_miss_is_in_the_verdict_over_the_run(tmp_path):
    """`speed < 0.2 m/s` in 1 of 84 moments was only in `diagnose --episode failed`, and the advice for the
    run was to continue."""
    run = Run.open(train_shuttle(tmp_path, SLOW))
    drives = [0.8] * 12 + [1, -1] * 24  # to the mark, and never slow there
    failed = [_played(run, drives, mark) for mark in (0.2, 0.21, 0.22, 0.23)]
    assert {trace.outcome for trace in failed} == {"time limit"}
    missed = common_miss(failed)
    assert missed is not None
    assert (missed.condition.text, missed.episodes, missed.of) == (
        "abs(joint_velocity(shuttle.slide)) < 2 mm/s",
        4,
        4,
    )
    good = outcomes(400, 0.5, 0.5)
    training = with_logs(run.path, returns_of(good, 0), FLAT, success=good)
    statement = statement_of(replace(training, failed=failed), "missed_condition")
    assert f"in {missed.true} of {missed.moments} moments; the nearest value is" in statement.text
    assert "and the threshold 2 mm/s" in statement.text
    assert statement.advice.startswith("Reward what brings")
    assert "`abs(gap) < near` is true in" in statement.text


# Lint as a cause


@pytest.mark.slow
def test_lint_as_a_cause_says_that_falling_early_pays_and_names_the_file_of_the_user(tmp_path, monkeypatch):
    """It read "Lint reports 1 warning", and its command named the copy in the run, which a student then
    edited."""
    monkeypatch.chdir(tmp_path)
    text = api.compile("cartpole", overrides=["reward.alive=-1"]).resolved
    own = tmp_path / "mine.yaml"
    own.write_text(
        text.replace("inputs/robots", str(Path(api.compile("cartpole").source).parents[1] / "robots"))
    )
    monkeypatch.chdir(tmp_path)
    run = train(api.compile("mine.yaml"), total_timesteps=64, seed=2, run=Path("run")).run
    noise = np.random.default_rng(0).normal(0, 3, 200)
    lint = statement_of(with_logs(run, -30 + noise, 30 - noise), "lint_warns")
    assert lint.text.startswith("Failing early pays: continuing an episode costs at least ")
    assert "Lint reports" not in lint.text
    assert lint.command == f"deepbots lint {own}"
    assert main(lint.command.split()[1:]) == 0
    own.write_text(own.read_text() + "# changed\n")
    copy = statement_of(with_logs(run, -30 + noise, 30 - noise), "lint_warns")
    assert copy.command == "deepbots lint run/inputs/mine.yaml"
    assert f"It is the copy that the training read: {own} was changed since then." in copy.advice


def test_lint_is_not_a_likely_cause_where_the_training_shows_the_opposite(tmp_path):
    """ "Avoiding the success pays more" was the first cause of a training whose successes returned 383, and
    the others 117."""
    run = train_shuttle(tmp_path, "reward.stay=1")
    noise = np.random.default_rng(0).normal(0, 3, 200)
    success = np.arange(200) % 2
    refuted = with_logs(run, 117 + 266 * success + noise, np.full(200, 30), success=success)
    assert statement_of(refuted, "lint_warns").text.startswith("Lint warns about ")
    assert statement_of(refuted, "lint_warns").evidence["likelihood"] < 0.5
    confirmed = with_logs(run, 117 - 66 * success + noise, np.full(200, 30), success=success)
    assert statement_of(confirmed, "lint_warns").text.startswith(
        "Avoiding the success pays more than the success: "
    )


@pytest.mark.slow
def test_a_folder_is_allowed_only_where_the_copy_reads_beyond_its_own(short, tmp_path):
    """`--allow-path climb1/inputs` was advised where it was not needed."""
    run = Run.open(short)
    assert linted_scenario(run).arguments == "cartpole"
    moved = replace(run, record=run.record.model_copy(update={"source": "gone.yaml"}))
    arguments = linted_scenario(moved).arguments
    assert (
        arguments == f"{short}/inputs/scenarios/cartpole.yaml --allow-path {short}/inputs"
    )  # it names ../robots
    own = Run.open(train(SHUTTLE, total_timesteps=64, run=tmp_path / "run").run)
    gone = replace(own, record=own.record.model_copy(update={"source": "gone.yaml"}))
    assert linted_scenario(gone).arguments == f"{tmp_path}/run/inputs/shuttle.yaml"


def test_a_report_has_the_causes_of_an_unsolved_training(carriage, tmp_path):
    run = Path(shutil.copytree(carriage, tmp_path / "run"))
    assert main(["eval", str(run), "--episodes", "9"]) == 0
    report = Report.read(run)
    report.find_causes()
    assert "too_few_steps" in [each.cause for each in report.causes]
    page = report.html()
    assert "Why it is not solved" in page
    assert report.causes[0].text.split(".")[0] in page


@pytest.mark.slow
def test_the_line_of_a_finding_in_a_report_is_that_of_the_listing_below(tmp_path):
    warned = train_shuttle(
        tmp_path, "reward.time=-2", "termination.failure={hit: abs(shuttle.place) > 0.49 m}"
    )
    assert main(["eval", str(warned), "--episodes", "9"]) == 0
    page = Report.read(warned).html()
    linted = linted_scenario(Run.open(warned))
    assert linted.findings
    for finding in linted.findings:
        if finding.span.source is linted.text:
            line = finding.span.start_position.line
            shown = (
                finding.span.source.line(line).replace("'", "&#39;").replace(">", "&gt;").replace("<", "&lt;")
            )
            assert f'<span class="marked"><b>{line}</b>{shown}</span>' in page


# The observation


def test_a_parameter_in_the_observation_is_not_a_sensor_that_detects_nothing(tmp_path):
    """`vx` always 0.5 m/s."""
    training = read_training(
        Run.open(train_shuttle(tmp_path, "augment.wish=speed", "observation.wish=0 .. 1 m/s"))
    )
    run_probes(training)
    assert {float(trace.observations[0, -1]) for trace in training.random} == {
        0.0
    }  # 0.5 m/s is the middle of the range
    assert "sensor_without_reading" not in causes_of(training)


@pytest.mark.parametrize(
    "successes", ["{far: abs(x) > 0.3 m, hit: collided(cart)}", "{hit: collided(cart), far: abs(x) > 0.3 m}"]
)
def test_terms_towards_any_of_the_successes_count(successes):
    rewards = ["reward={near: abs(x) / m, bump: 1 when collided(cart)}"]
    compiled = api.compile("cartpole", overrides=[*rewards, f"termination.success={successes}"])
    facts = ScenarioFacts(compiled.program, compiled.units)
    assert set(facts.terms_towards_success) == {"near", "bump"}


def test_a_value_is_shown_in_the_unit_of_the_file(tmp_path):
    compiled = api.compile(
        "cartpole", overrides=["observation.x=-40 .. 40 cm", "parameters.fall_angle=0.2 rad"]
    )
    facts = ScenarioFacts(compiled.program, compiled.units)
    numbers = {number.full_name: number for number in compiled.program.agent.numbers}
    assert (
        facts.range_text(numbers["x"], 0.25),
        facts.range_text(numbers["cart.pole_angle"], np.pi / 6),
    ) == ("25 cm", "30 deg")
    assert facts.units.of("rad", "abs(cart.pole_angle)", "fall_angle") == UNITS["rad"]
    assert (quantity_text(0.003, facts.units.of("m/s", "3 mm/s")), facts.units.of("m", "no unit").text) == (
        "3 mm/s",
        "m",
    )


# One verdict


def test_a_confirmation_counts_as_an_evaluation_and_not_as_episodes_of_the_training(tmp_path):
    """A confirmation does not explore, and it was taken for episodes of the training."""
    run = train_shuttle(tmp_path, "solved=success_rate >= 90 % over 100 episodes")
    training = with_logs(run, returns_of(np.zeros(400), 0), FLAT, evaluations=evaluations_with(1.0, 1.0))
    record = training.run.record
    at = SolvedAt(episode=9, steps=9, simulated_hours=1.0, cpu_seconds=1.0, mean_return=4.0, success_rate=1.0)
    confirmed = record.result.model_copy(update={"solved_at": at, "confirmations": 1})
    training.run.record = record.model_copy(update={"result": confirmed})
    assert has_learned(training) == "evaluated"


SHORT = (
    SHUTTLE.read_text("utf-8")
    .replace("environments: 16", "environments: 2")
    .replace("n_steps: 64", "n_steps: 32")
)
TEXT = f"""{SHORT}
solved: success_rate >= 50 % over 20 episodes
"""
EASY = TEXT.replace("near:  4 cm", "near:  5 m")
HARD = TEXT.replace("near:  4 cm", "near:  0.1 mm").replace("  time: ", "  bonus: 0.001\n  time: ")


def _trained(folder: Path, name: str, text: str, *options: str) -> Path:
    folder.mkdir(exist_ok=True)
    shutil.copy(SHUTTLE.with_name("shuttle.urdf"), folder)
    (folder / "mine.yaml").write_text(text, encoding="utf-8")
    run = folder / "runs" / name
    options = ("--timesteps", "128", *options)
    assert main(["train", str(folder / "mine.yaml"), "--run", str(run), "--quiet", *options]) == 0
    return run


def _causes(run: Path, capsys) -> list[dict]:
    capsys.readouterr()
    assert main(["diagnose", str(run), "--only-logs", "--json"]) == 0
    return json.loads(capsys.readouterr().out)["runs"][0]["causes"]


@pytest.fixture(scope="module")
def easy(tmp_path_factory) -> Path:
    """A project with a run that solved its scenario; not to be changed."""
    return _trained(tmp_path_factory.mktemp("easy"), "solved", EASY).parents[1]


@pytest.fixture
def solved(easy, tmp_path) -> Path:
    shutil.copytree(easy, tmp_path, dirs_exist_ok=True)
    return tmp_path / "runs" / "solved"


def test_what_changed_since_a_solved_run_is_named_with_its_places(solved, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = _trained(tmp_path, "missed", HARD)
    shown = capsys.readouterr().out
    causes = _causes(run, capsys)
    (cause,) = (cause for cause in causes if cause["cause"] == "changed_since_solved")
    # The earlier run needed no more steps, so the length of the training is not a cause.
    assert "too_few_steps" not in {other["cause"] for other in causes}
    lines = HARD.splitlines()
    places = [f"mine.yaml:{lines.index(line) + 1}" for line in ("  bonus: 0.001", "  near:  0.1 mm")]
    assert cause["text"] == (
        f"Changed since runs/solved, which was solved: reward.bonus (none) -> 0.001 ({places[0]})"
        f" and near 5 m -> 0.1 mm ({places[1]})."
    )
    assert cause["text"] in " ".join(shown.split())
    assert "most likely cause: Changed" not in shown
    assert cause["command"] == f"deepbots diff {Path('runs/solved')} {Path('runs/missed')}"
    assert all(change["is_written"] for change in cause["evidence"]["changes"])

    # The fact comes first, unless a cause is certain.
    before = [each["evidence"]["likelihood"] for each in _causes(run, capsys)]
    assert before == sorted(before, reverse=True)

    # After the file has changed, the places are those of the copy in the run.
    (tmp_path / "mine.yaml").write_text(f"# a comment\n{HARD}", encoding="utf-8")
    (cause,) = (cause for cause in _causes(run, capsys) if cause["cause"] == "changed_since_solved")
    assert f"(runs/missed/inputs/{places[1]})" in cause["text"]


def test_a_single_change_is_not_called_one_of_several(solved, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = _trained(tmp_path, "missed", TEXT.replace("near:  4 cm", "near:  0.1 mm"))
    (cause,) = (cause for cause in _causes(run, capsys) if cause["cause"] == "changed_since_solved")
    assert cause["advice"].startswith("Set it back and train again")


def test_a_training_that_is_shorter_than_a_solved_one_comes_before_other_changes(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    _trained(tmp_path, "longer", EASY, "--timesteps", "512", "--full")
    run = _trained(tmp_path, "missed", HARD, "--set", "train.total_timesteps=512")
    causes = _causes(run, capsys)
    assert [cause["cause"] for cause in causes][:2] == ["too_few_steps", "changed_since_solved"]
    assert causes[0]["text"].startswith(
        f"The training is shorter than {Path('runs/longer')}, which made 512 steps and was solved"
    )


@pytest.mark.slow
def test_the_nearest_of_the_solved_runs_is_compared(solved, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _trained(tmp_path, "newer", EASY.replace("  time: ", "  other: 0.002\n  time: "))
    run = _trained(tmp_path, "missed", HARD)
    (cause,) = (cause for cause in _causes(run, capsys) if cause["cause"] == "changed_since_solved")
    assert cause["evidence"]["earlier"] == str(Path("runs/solved"))


def test_a_solved_run_of_another_name_or_folder_is_not_compared(solved, tmp_path, capsys):
    renamed = _trained(tmp_path, "renamed", HARD.replace("name: Shuttle", "name: Other"))
    assert "changed_since_solved" not in [cause["cause"] for cause in _causes(renamed, capsys)]
    elsewhere = _trained(tmp_path / "elsewhere", "hard", HARD)
    assert "changed_since_solved" not in [cause["cause"] for cause in _causes(elsewhere, capsys)]


MEANS = (20, 60, 200, 200, 195, 200, 60, 40, 30, 50)


def _lines(means=MEANS, every: int = 6000) -> list[dict]:
    """Evaluations of 20 episodes whose returns have these means."""
    spread = np.linspace(-3, 3, 20)
    return [
        {
            "steps": every * (number + 1),
            "stage": "",
            "is_best": False,
            "returns": (mean + spread).tolist(),
            "successes": [0.0] * 20,
        }
        for number, mean in enumerate(means)
    ]


def _fallen(
    run: Path, *settings: str, scenario: str = "cartpole", means=MEANS, **scalars
) -> TrainingEvidence:
    """A training of another scenario and with other logs, in the folder of a short one."""
    training = read_training(Run.open(run))
    opened = replace(
        training.run,
        record=training.run.record.model_copy(update={"total_timesteps": 60_000}),
        compiled=api.compile(api.load(scenario, overrides=settings)),
    )
    curves = {
        name.replace("__", "/"): (np.linspace(0, 60_000, len(values)), np.asarray(values, float))
        for name, values in scalars.items()
    }
    return replace(training, run=opened, all_evaluations=_lines(means), scalars=curves)


@pytest.mark.parametrize(
    ("settings", "path", "advised"),
    [
        (["train.learning_rate=2e-2"], "train.learning_rate", "0.003 -> 0.0003"),
        pytest.param(["train.n_epochs=100"], "train.n_epochs", "10", marks=pytest.mark.slow),
        pytest.param(["train.ent_coef=0.2"], "train.ent_coef", "0.01", marks=pytest.mark.slow),
        pytest.param(["train.clip_range=0.9"], "train.clip_range", "0.2", marks=pytest.mark.slow),
        (["train.batch_size=8"], "train.batch_size", "256"),
        pytest.param(["train.max_grad_norm=50"], "train.max_grad_norm", "0.5", marks=pytest.mark.slow),
        (["train.gamma=0.5"], "train.gamma", "0.98"),
    ],
)
def test_the_setting_that_is_far_from_usual_comes_first(short, settings, path, advised):
    training = _fallen(
        short, *settings, train__approx_kl=[0.01, 0.2] * 10, train__entropy_loss=[-0.6, -0.4, -0.5, -0.65]
    )
    first = diagnose(training)[0]
    assert (first.cause, first.evidence["suspects"][0]["path"], first.settings) == (
        "fell_apart",
        path,
        {path: advised},
    )
    assert f"`{path}: {advised}`" in first.advice
    assert first.text.startswith(
        "The training got worse: the mean return of its evaluations fell from 200 at 36,000 steps"
    )


def test_large_rewards_are_named(short):
    means = [100 * mean for mean in MEANS]
    training = _fallen(short, "reward.alive=100", means=means, train__explained_variance=[0.1] * 20)
    assert diagnose(training)[0].settings == {"train.normalize": "reward"}
    normalized = _fallen(
        short, "reward.alive=100", "train.normalize=reward", means=means, train__explained_variance=[0.1] * 20
    )
    assert "train.normalize" not in diagnose(normalized)[0].settings


@pytest.mark.parametrize(
    ("settings", "path"),
    [
        ("algorithm: DQN", None),
        ("algorithm: DQN, buffer_size: 500", "train.buffer_size"),
        ("algorithm: DQN, target_update_interval: 1", "train.target_update_interval"),
        ("algorithm: DQN, learning_rate: 1e-2", "train.learning_rate"),
        ("algorithm: A2C", None),
    ],
)
def test_defaults_are_not_suspected_and_values_far_from_them_are(short, settings, path):
    first = diagnose(_fallen(short, f"train={{{settings}, total_timesteps: 60_000, environments: 8}}"))[0]
    assert [suspect["path"] for suspect in first.evidence["suspects"]][:1] == ([] if path is None else [path])


def test_with_usual_settings_the_advice_is_smaller_updates(short):
    first = diagnose(_fallen(short))[0]
    assert (first.cause, first.evidence["suspects"], first.settings) == (
        "fell_apart",
        [],
        {"train.learning_rate": "0.005 -> 0.0005"},
    )


def test_a_success_that_is_given_up_for_more_reward_is_not_a_matter_of_settings(short):
    """As where a policy learns to stay beside the mark, which pays more than the mark."""
    training = _fallen(
        short, "train.n_epochs=100", scenario="pit_escape", means=(1, 3, 9, 9, 9, 10, 20, 30, 31, 34)
    )
    for number, each in enumerate(training.all_evaluations):
        each["successes"] = [float(2 <= number <= 5)] * 20
    solved = replace(training.run.program.agent, solved=None)
    opened = replace(training.run.compiled, program=replace(training.run.program, agent=solved))
    training = replace(training, run=replace(training.run, compiled=opened))
    (cause,) = [cause for cause in diagnose(training) if cause.cause == "fell_apart"]
    assert cause.settings == {}
    assert "Meanwhile the mean return rose from" in cause.text


def test_a_training_that_gets_worse_after_its_teacher_ended_is_named(short):
    """A training with a teacher that got much worse after its best evaluation once had no diagnosis."""
    taught = (
        [1.0] * 12 + [0.5] * 2 + [0.0] * 6
    )  # the weight falls from 37,900 steps on, the evaluations from 42,000
    first = diagnose(_fallen(short, teacher__weight=taught))[0]
    assert first.cause == "fell_apart"
    assert "It fell after the teacher had ended, at 37,894 steps" in first.text
    assert first.settings == {"train.learning_rate": "0.001"}
    during = diagnose(_fallen(short, teacher__weight=[1.0] * 20))[0]
    assert during.cause == "fell_apart"
    assert "teacher" not in during.text


@pytest.mark.parametrize("scenario", few(shipped.scenario_names(), ["find_ball", "panda_push", "pit_escape"]))
def test_no_setting_of_a_shipped_scenario_is_suspected(short, scenario):
    training = _fallen(short, scenario=scenario)
    fall = Decline("mean_return", 200.0, 36_000, 40.0, 42_000, 20, 60, "the last quarter", 45_000)
    assert suspects(replace(training, all_evaluations=[]), fall) == []


def test_a_healthy_training_has_not_fallen_apart(short):
    assert "fell_apart" not in [
        cause.cause for cause in diagnose(_fallen(short, means=(20, 60, 150, 190, 200, 195, 200, 198)))
    ]


@pytest.fixture
def fallen(short, tmp_path) -> Path:
    """A run whose evaluations fell, of a training that records nothing else of it."""
    run = Path(shutil.copytree(short, tmp_path / "fallen"))
    (run / "evaluations" / "training.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in _lines()))
    return run


@pytest.mark.slow
def test_every_command_prints_the_same_sentence(fallen, tmp_path, capsys):
    sentence = "the training got worse: the mean return of its evaluations fell from 200 at 36,000 steps to"
    assert main(["runs", str(fallen.parent)]) == 0
    assert f"fallen: {sentence}" in capsys.readouterr().err
    assert main(["runs", str(fallen.parent), "--json"]) == 0
    (listed,) = json.loads(capsys.readouterr().out)
    assert listed["decline"]["text"].startswith(sentence)
    assert (listed["decline"]["measure"], listed["decline"]["best_steps"]) == ("mean_return", 36_000)
    assert main(["diagnose", str(fallen), "--only-logs"]) == 0
    assert sentence[1:] in capsys.readouterr().out
    assert main(["eval", str(fallen), "--episodes", "2"]) == 0
    assert main(["report", str(fallen), "-o", str(tmp_path / "page.html")]) == 0
    assert sentence in (tmp_path / "page.html").read_text("utf-8")


def test_a_training_that_fell_apart_after_it_was_solved_has_the_cause_of_its_fall(fallen):
    training = read_training(Run.open(fallen))
    assert training.solved  # by an evaluation
    assert causes_after(fallen)[0].cause == "fell_apart"


@pytest.mark.slow
def test_the_planted_setting_is_among_the_first_two(tmp_path):
    """Ten minutes of CPU time."""
    right = fell = 0
    for case in CASES:
        run = trained(case, tmp_path / case.name)
        is_named, paths = named(run)
        if case.planted and has_fallen(run):
            assert is_named, case
            fell += 1
            right += bool(set(paths[:2]) & set(case.planted))
        elif not case.planted and not has_fallen(run):
            assert not is_named, case
    assert fell > 0
    assert right >= 0.8 * fell


@pytest.fixture
def short_copy(short: Path, tmp_path: Path) -> Path:
    return shutil.copytree(short, tmp_path / "short")


def command_of(folder: Path, *words: str) -> list[str]:
    """Return the command for a run that this command line has trained."""
    run = Run.open(folder)
    write_record(folder, run.record.model_copy(update={"command": ("deepbots", "train", "cartpole", *words)}))
    return training_command(Run.open(folder), ["train.gamma=0.9"])


def test_it_has_the_seed_the_settings_and_further_values(short_copy):
    words = command_of(short_copy, "--set", "train.gamma=0.5", "--set=train.n_steps=64")
    assert (words[:3], words[words.index("--seed") + 1]) == (["deepbots", "train", "cartpole"], "2")
    settings = [words[index + 1] for index, word in enumerate(words) if word == "--set"]
    assert settings == ["train.n_steps=64", "train.gamma=0.9"]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("--initialize-from", "runs/a"),
        ("--keep-checkpoints", "5"),
        ("--callback", "own"),
        ("--logger", "csv"),
        ("--allow-path", "/data/robots"),
    ],
)
def test_an_option_of_the_run_is_kept(short_copy, name: str, value: str):
    for words in ([name, value], [f"{name}={value}"]):
        command = command_of(short_copy, *words)
        assert command[command.index(name) + 1] == value


def test_the_shards_are_those_that_were_chosen(short_copy):
    words = command_of(short_copy, "--shards", "auto")
    assert words[words.index("--shards") + 1] == "1"


def test_permissions_for_code_are_kept_and_the_folder_of_the_run_is_not(short_copy):
    command = command_of(short_copy, "--run", "runs/mine", "--allow-code")
    assert "--allow-code" in command
    assert "--run" not in command


_SCALE = "robots.cart.links.pole.scale"
_MASS = "robots.cart.links.pole.mass"


def _suggestions(phrase: str, *overrides: str) -> list[Suggestion]:
    return suggestions(api.load("cartpole", overrides=overrides), phrase)


def _override(path: str, value: str) -> str:
    section, _, place = path.partition(".links.")
    link, _, key = place.partition(".")
    return f"{section}.links={{{link}: {{{key}: {value}}}}}" if key else f"{path}={value}"


@pytest.mark.parametrize(
    ("phrase", "path", "value"),
    [
        ("make the pole longer", _SCALE, "1 1 1.5"),
        ("make the pole 2 times as long", _SCALE, "1 1 2"),
        ("pole 0.75x", _SCALE, "1 1 0.75"),
        ("half the pole", _SCALE, "1 1 0.5"),
        ("a pole that is half as heavy", _MASS, "urdf * 0.5"),
        ("make the pole 2 times lighter", _MASS, "urdf * 0.5"),
        ("a pole 4x shorter", _SCALE, "1 1 0.25"),
        ("a smaller and shorter pole", _SCALE, "1 1 0.666667"),
        ("make the pole heavier", _MASS, "urdf * 1.5"),
        ("make the cart faster", "parameters.wheel_speed", "7.5 rad/s"),
        ("go twice as fast", "parameters.wheel_speed", "10 rad/s"),
        ("a larger fall angle", "parameters.fall_angle", "22.5 deg"),
        ("make the pole 2 m long", _SCALE, "1 1 2"),
        ("pole length 150 cm", _SCALE, "1 1 1.5"),
        ("a pole of 0.5 kg", _MASS, "0.5 kg"),
        ("how do I make the training longer", "train.total_timesteps", "150_000"),
        ("make the training half as long, shorter", "train.total_timesteps", "50_000"),
        ("make the training 3 times shorter", "train.total_timesteps", "33_333"),
        ("make the pole 1,000 g", _MASS, "1 kg"),
        ("make the wheels twice as slow", "parameters.wheel_speed", "2.5 rad/s"),
    ],
)
def test_a_phrase_names_a_part_or_a_parameter_and_how_much_it_changes(phrase, path, value):
    (suggestion,) = _suggestions(phrase)
    assert (suggestion.path, suggestion.value) == (path, value)
    assert not api.load("cartpole", overrides=[_override(path, value)]).findings.errors


@pytest.mark.parametrize(
    ("phrase", "written", "value"),
    [
        ("make the pole longer", "1 1 1.5", "1 1 2.25"),
        ("make the pole 2 m long", "1 1 1.5", "1 1 2"),
        ("make the pole shorter", "1 1 1.5", "1 1 1"),
        ("make the pole longer", "1 1 stretch", "1 1 stretch"),
        ("make the pole longer", "1 1 uniform(1 .. 2)", "1 1 uniform(1 .. 2)"),
    ],
)
def test_a_phrase_changes_the_written_size_unless_it_is_drawn_or_a_formula(phrase, written, value):
    (suggestion,) = _suggestions(phrase, _override(_SCALE, written))
    assert suggestion.value == value
    assert f"The file has `scale: {written}`." in suggestion.text


@pytest.mark.parametrize(
    "phrase",
    [
        "why does the pole fall",
        "reset the pole",
        "pole",
        "make the pole 20 cm longer",
        "make the pole 100 g heavier",
        "make the pole 0,5 kg",
        "make the pole 0.5 longer",
        "make the pole a third longer",
        "make the pole 2 and a half times longer",
        "make the pole 2 m wide",
        "make the pole longer and heavier",
        "make the pole lighter and the cart faster",
        "more friction of the pole",
        "make the pole hinge 2 times stiffer",
        "the pole no longer falls",
    ],
)
def test_a_phrase_without_a_clear_change_has_what_it_is_about(phrase):
    suggestion, *others = _suggestions(phrase)
    assert not any(other.value for other in others)
    assert suggestion.text.startswith("`pole` is a link of the robot `cart`: box 0.02 0.02 1 m, 0.2 kg")
    assert suggestion.value == ""


@pytest.mark.parametrize(
    "phrase", ["fall_angle", "what is a policy", "how does it learn faster", "", "a larger drawn"]
)
def test_a_phrase_that_asks_for_no_change_or_that_of_a_drawn_value_has_no_suggestion(phrase):
    assert _suggestions(phrase, "parameters.drawn=uniform(0.3 .. 0.4 m)") == []


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("-1e-3 m", "-0.0015 m"),
        ("2 m/s^2", "3 m/s^2"),
        ("50 %", "75 %"),
        ("1_000 ms", "1_500 ms"),
        ("0.000_5 m", "0.00075 m"),
    ],
)
def test_a_value_of_one_number_keeps_its_sign_and_unit(written, value):
    (suggestion,) = _suggestions("a larger extra", f"parameters={{extra: {written}}}")
    assert suggestion.value == value


def _mass_and_sizes(checked, name):
    link = next(iter(checked.robots.values())).model.link(name)
    return np.hstack([link.inertial.mass, *astuple(link.visuals[0].shape)])


@settings(max_examples=40)
@given(
    st.sampled_from([("cartpole", "body"), ("quadruped", "FR_toe"), ("balancer", "left_wheel")]),
    st.sampled_from(
        [
            ("longer", "long", "shorter", "short", (1, 1)),
            ("heavier", "heavy", "lighter", "light", (1, 0)),
            ("bigger", "big", "smaller", "small", (3, 1)),
        ]
    ),
    st.sampled_from([("", 1.5), ("2 times ", 2), ("three times ", 3), ("twice as ", 2), ("half as ", 0.5)]),
    st.booleans(),
)
def test_a_value_that_is_offered_compiles_with_the_direction_and_amount_of_the_phrase(
    part, words, amount, grows
):
    word = words[2 * (not grows) + amount[0].endswith("as ")]
    before = api.load(part[0])
    for suggestion in suggestions(before, f"make the {part[1]} {amount[0]}{word}"):
        if suggestion.value:
            after = api.load(part[0], overrides=[_override(suggestion.path, suggestion.value)])
            old, new = (_mass_and_sizes(checked, part[1]) for checked in (before, after))
            ratios = (new / old)[[0, 1 + np.argmax(old[1:])]]  # of the mass, and of the longest side
            expected = (amount[1] if grows else 1 / amount[1]) ** np.array(words[4], float)
            assert not after.findings.errors
            assert ratios == pytest.approx(expected, rel=1e-4)
