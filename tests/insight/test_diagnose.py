"""Diagnoses of trainings: planted causes come first, healthy trainings have none, and broken files are
refused in a sentence."""

from __future__ import annotations

import html
import json
import re
import shutil
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import EvaluationError, RunError
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.insight.causes import CAUSES, diagnose
from deepbots_cli.insight.episode import ROWS, explain, explanation_json
from deepbots_cli.insight.report import Report
from deepbots_cli.insight.scenario_facts import ScenarioFacts, linted_scenario, training_command
from deepbots_cli.insight.stages import common_miss
from deepbots_cli.insight.statements import quantity_text
from deepbots_cli.insight.trace import Trace, TraceRecorder, instrument_program, trace_episodes
from deepbots_cli.insight.training import read_training, run_probes
from deepbots_cli.learning import train
from deepbots_cli.learning.campaigns.group import GroupRecord
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.run import Run, write_record
from deepbots_cli.learning.runs.verdict import quoted_episodes
from deepbots_cli.rollout import Episode
from tests.few import few
from tests.insight.broken import BROKEN, all_causes
from tests.insight.logs import (
    SHUTTLE,
    causes_of,
    outcomes,
    returns_of,
    statement_of,
    train_shuttle,
    with_logs,
)

DOCS = Path(__file__).parents[2] / "docs" / "diagnose.md"
SEED = 1
WITH_SUCCESS = {
    "find_and_avoid": "apart",
    "find_ball": "apart",
    "line_follower": "driven",
    "pit_escape": "reach",
    "quadruped_rough": "running_max(gone)",
    "see_ball": "apart",
    "tag_scripted": "apart",
}
"""Shipped scenarios with a success, and the quantity that it compares."""


def test_an_evaluation_of_a_run_is_read(carriage, tmp_path):
    run = shutil.copytree(carriage, tmp_path / "run")
    assert (
        main(["eval", str(run), "--episodes", "9"]),
        len(read_training(Run.open(run)).final_episodes),
    ) == (0, 9)


def test_a_script_that_succeeds_where_the_policy_does_not_is_the_teacher(tmp_path):
    training = read_training(
        Run.open(train_shuttle(tmp_path, "scripts={by_hand: {drive: 4 * gap / m}, idle: {drive: 0}}"))
    )
    run_probes(training)
    assert {name: len(traces) for name, traces in training.scripts.items()} == {"by_hand": 8, "idle": 8}
    poor = [Episode(0.0, 60, k < 6, "max_steps") for k in range(100)]
    (statement,) = [
        each for each in diagnose(replace(training, final_episodes=poor)) if each.cause == "script_succeeds"
    ]
    assert statement.settings == {"train.teacher": "by_hand"}
    assert "'by_hand' succeeds in 100% (68% to 100%) of 8 episodes, and the policy in 6%" in statement.text
    good = [Episode(0.0, 60, k < 70, "parked") for k in range(100)]
    assert "script_succeeds" not in causes_of(replace(training, final_episodes=good))


def test_a_running_training_is_not_advised_to_resume(carriage, tmp_path, deepbots):
    run = Path(shutil.copytree(carriage, tmp_path / "run"))
    Run.open(run).update(status="running")
    with run_lock(run):
        text = deepbots("diagnose", run, "--only-logs").out
    assert "it still runs" in text
    assert "deepbots resume" not in text
    rising = returns_of(np.zeros(100), 0, 5)
    training = replace(with_logs(carriage, rising, np.full(100, 60)), is_running=True)
    training.run.record = training.run.record.model_copy(update={"total_timesteps": 48_000})
    (statement,) = diagnose(training)
    assert statement.advice == "Let it run: 6,000 of 48,000 steps have been made."
    assert "deepbots resume" in deepbots("diagnose", run, "--only-logs").out


def test_a_sensor_that_saw_nothing_is_not_advised_a_smaller_range(tmp_path):
    still = "robots.shuttle.sensors.ray={type: laser, link: carriage, rays: 1, range: 0 .. 30 cm}"
    overrides = [
        still,
        "robots.shuttle.emit=[place, ray]",
        "observation={shuttle.place: -0.5 .. 0.5 m, gap: -0.9 .. 0.9 m, shuttle.ray: auto}",
    ]
    training = read_training(Run.open(train_shuttle(tmp_path, *overrides)))
    run_probes(training)
    (statement,) = [each for each in diagnose(training) if each.cause == "sensor_without_reading"]
    assert "shuttle.ray.r0 always 0.3 m" in statement.text
    assert "Narrow their ranges" not in statement.advice
    assert "constant_observation" not in causes_of(training)


def _played(run: Run, mark: float, act: Callable[[int, float], float]) -> Trace:
    """An episode of the carriage, in which each action follows from the step and the distance to the mark."""
    watch = instrument_program(run.program, include_observation=True)
    with closing(TraceRecorder(api.build(watch.program, engine="mujoco"), watch)) as world:
        observation, _ = world.reset(seed=4, options={"mark": mark})
        is_over, step = False, 0
        while not is_over:
            action = np.array([act(step, 0.9 * observation[1])], np.float32)
            observation, _, failed, ended, _ = world.step(action)
            is_over, step = failed or ended, step + 1
        return world.trace("an episode")


def test_staying_near_the_success_is_named_where_it_pays_more(tmp_path):
    run = Run.open(train_shuttle(tmp_path, "reward.warm=max(0, 1 - abs(gap) / (15 cm))"))
    staying = _played(run, 0.3, lambda step, gap: np.sign(gap) if abs(gap) > 0.06 else 0.0)
    assert staying.outcome == "time limit"
    good = outcomes(400, 0.3, 0.05)
    training = with_logs(
        run.path, returns_of(good, 10, 30), np.full(400, 60), success=good, ending="max_steps"
    )
    first = diagnose(replace(training, policy=[staying]))[0]
    assert (first.cause, first.evidence["term"]) == ("loitering", "warm")
    assert 0.5 < first.evidence["per_step"] < 0.7
    # Two lucky successes do not contradict the headline, and are not compared.
    good = np.arange(400) < 2
    rare = with_logs(run.path, returns_of(good, 40, 30), np.full(400, 60), success=good, ending="max_steps")
    (text,) = (
        cause.text for cause in diagnose(replace(rare, policy=[staying])) if cause.cause == "loitering"
    )
    assert text.endswith("Of 400 episodes of the training, 2 succeeded.")


def test_a_training_that_stops_at_a_reset_has_this_cause_alone(tmp_path, deepbots):
    with pytest.raises(EvaluationError):
        train(
            api.compile(api.load("cartpole", overrides=["fall_angle=0.15 deg"])),
            total_timesteps=64,
            run=tmp_path / "run",
        )
    training = read_training(Run.open(tmp_path / "run"))
    run_probes(training)
    assert causes_of(training) == ["ending_at_reset"]
    assert "deepbots diagnose" in deepbots("diagnose", tmp_path / "run", "--episode", "0", code=2).err


def test_a_training_that_went_on_after_a_lost_episode_did_not_stop_with_an_error(short, tmp_path):
    run = shutil.copytree(short, tmp_path / "run")
    failure = {"error": "not stable", "step": 0, "episode": 1, "case": None, "stage": None, "start": 0}
    (run / "failures").mkdir()
    (run / "failures" / "0001.json").write_text(json.dumps({**failure, "actions": []}))
    assert causes_of(read_training(Run.open(run))) == causes_of(read_training(Run.open(short)))


@pytest.mark.slow
def test_an_action_without_effect_and_useless_ranges_are_found_in_short_episodes(tmp_path):
    overrides = [
        "robots.cart.apply.wheels=0 * drive * wheel_speed",
        "observation.x=-1e-6 .. 1e-6 m",
        "reward.alive=-1",
        "train.ent_coef=5",
    ]
    overrides += ["augment.tilt=max(abs(cart.pole_angle) / rad, 0.19)", "observation.tilt=0.2 .. 0.4"]
    training = read_training(
        Run.open(
            train(
                api.compile(api.load("cartpole", overrides=overrides)),
                total_timesteps=512,
                seed=2,
                run=tmp_path / "dead",
            ).run
        )
    )
    assert "action_without_effect" not in causes_of(training)
    run_probes(training)
    assert (causes_of(training)[0], {trace.ended_by for trace in training.policy}) == (
        "action_without_effect",
        {"fallen"},
    )
    (warned,) = [cause for cause in diagnose(training) if cause.cause == "lint_warns"]
    assert warned.evidence["likelihood"] > 0.9  # the required return is out of reach
    assert "the highest possible return is -1 (DB810)" in warned.text
    # Most values of both are beyond their range. Those of `tilt` hardly differ there, so clipping loses
    # nothing.
    (clipped,) = [cause for cause in diagnose(training) if cause.cause == "saturated_observation"]
    assert min(clipped.evidence["shares"]["x"], clipped.evidence["shares"]["tilt"]) > 0.4
    assert clipped.evidence["names"] == "x"
    # Its evaluations, which do not explore, may solve the task all the same.
    assert causes_of(replace(training, all_evaluations=[{"returns": [200.0], "successes": [False]}])) == [
        "exploration_too_large"
    ]


def test_a_diagnosis_is_printed_with_numbers_and_what_to_try(short, deepbots):
    text = deepbots("diagnose", short).out
    assert "the most likely first" in text
    assert "Try: " in text
    (diagnosis,) = json.loads(deepbots("diagnose", short, "--json", "--only-logs").out)["runs"]
    assert diagnosis["causes"]
    assert all(any(sign.isdigit() for sign in cause["text"]) for cause in diagnosis["causes"])
    likelihoods = [cause["evidence"]["likelihood"] for cause in diagnosis["causes"]]
    assert likelihoods == sorted(likelihoods, reverse=True)


def test_an_episode_of_a_run_is_explained_with_its_critic(short, deepbots):
    data = json.loads(deepbots("diagnose", short, "--json", "--episode", "3").out)
    assert 0 < data["moment"]["time"] < data["time"]
    assert data["end"]["margin"] > 0


def test_episodes_of_an_evaluation_are_repeated_to_the_bit(short, tmp_path, deepbots):
    """Also those that stand in another row of its forward passes."""
    run = shutil.copytree(short, tmp_path / "run")
    assert "keeps no evaluation" in deepbots("eval", run, "--episodes", "failed", code=2).err
    outcomes = json.loads(deepbots("eval", run, "--episodes", "10", "--json").out)["outcomes"]
    opened = Run.open(run)
    kept = quoted_episodes(opened)
    assert kept.failed(opened.program) == list(range(10))
    for trace, number in zip(trace_episodes(opened, (9, 3), **kept.replay_options), (9, 3), strict=True):
        outcome = outcomes[number]
        assert (trace.steps, trace.returns, trace.ended_by) == (
            outcome["length"],
            outcome["total_return"],
            outcome["ended_by"],
        )


def test_failed_episodes_that_a_time_limit_ended_print_no_blank_lines(tmp_path, deepbots):
    never = "termination.success={parked: abs(gap) < near and time > 60 s}"
    run = train_shuttle(tmp_path, "truncation.max_steps=5", never)
    assert main(["eval", str(run), "--episodes", "2"]) == 0
    lines = deepbots("eval", run, "--episodes", "failed").out.splitlines()
    assert lines[0].startswith("episode 0: 'max_steps' at 0.")
    assert lines[1].strip().startswith("The episode reached 5 of at most 5 (max_steps).")
    assert "'parked' requires" in lines[1]
    assert all(line.strip() for line in lines)


def test_a_critic_that_never_fell_names_no_moment(short):
    trace = next(trace_episodes(Run.open(short), [0], seed=5))
    trace.critic = np.linspace(1.0, 2.0, trace.steps)
    statements = explain(trace)
    assert explanation_json(trace, statements)["moment"] is None
    assert "rose from 1 to 2" in next(each.text for each in statements if each.cause == "unforeseen")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "timesteps"),
    [("cartpole", 2048), ("balancer", 6000), ("quadrotor", 6000), ("line_follower", 6000)],
)
def test_the_named_moment_precedes_the_end_of_fifty_failed_episodes(scenario, timesteps, tmp_path):
    """It is the largest drop of the critic's value, of a policy at the beginning of its training; 20 s of CPU
    time each."""
    run = Run.open(train(scenario, total_timesteps=timesteps, seed=711, run=tmp_path / scenario).run)
    episodes = trace_episodes(run, range(500), seed=712, model="last")
    failed = list(islice((trace for trace in episodes if trace.outcome == "failure"), 50))
    assert len(failed) == 50
    moments = [explanation_json(trace, explain(trace))["moment"] for trace in failed]
    for trace, moment in zip(failed, moments, strict=True):
        drops = [before - after for before, after in pairwise(trace.critic)]
        if moment is None:
            assert max(drops) <= 0
        else:
            assert drops[moment["step"] - 1] == max(drops) > 0
            assert 0 < moment["time"] < trace.time
    assert sum(moment is None for moment in moments) <= 2


@pytest.mark.slow
def test_failed_episodes_are_filmed(short, tmp_path, deepbots, monkeypatch):
    """A film takes 3 s of CPU time."""
    run = shutil.copytree(short, tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    assert main(["eval", str(run), "--episodes", "2"]) == 0
    failed = json.loads(deepbots("eval", run, "--episodes", "failed", "--json").out)["failed"]
    films = json.loads(deepbots("render", run, "--episodes", "failed", "-o", "failed.mp4", "--json").out)[
        "files"
    ]
    assert [each["file"] for each in films] == ["failed-0.mp4", "failed-1.mp4"]
    assert all(each["bytes"] > 1000 for each in films)
    filmed = [(episode["ended_by"], episode["steps"]) for each in films for episode in each["episodes"]]
    assert filmed == [(each["ended_by"], each["steps"]) for each in failed]


def test_a_folder_that_cannot_be_diagnosed_is_refused_in_a_sentence(short, tmp_path, deepbots):
    run = shutil.copytree(short, tmp_path / "run")
    kept = EvaluationResult.of_episodes(
        [Episode(9.0, 60, False, None)],
        evaluated="9999",
        model="best",
        seed=2,
        solved=None,
        success_defined=False,
    )
    (run / "evaluations" / "0001.json").write_text(kept.model_copy(update={"outcomes": ()}).model_dump_json())
    bare = shutil.copytree(short, tmp_path / "a run", ignore=shutil.ignore_patterns("models"))
    logs = ("empty", "damaged")
    head = "".join((run / "monitor.csv").read_text().splitlines(keepends=True)[:2])
    for name, rows in zip(logs, ("", "a,b,c,d,e,f,g,h,i,j\n"), strict=True):
        shutil.copytree(short, tmp_path / name)
        (tmp_path / name / "monitor.csv").write_text(head + rows)
    for words, *messages in (
        ([tmp_path / "empty"], "contains no finished episode yet"),
        ([tmp_path / "damaged"], "is damaged"),
        ([run, "--episode", "failed"], "0001.json is damaged: 'outcomes'"),
        ([bare, "--episode", "0"], "contains no model", f"deepbots resume '{bare}'"),
        ([tmp_path], "is not a run"),
    ):
        error = " ".join(deepbots("diagnose", *map(str, words), code=2).err.split())
        assert [message for message in messages if message not in error] == []


@pytest.mark.parametrize(
    ("line", "damaged"),
    [
        ('{"steps": 512, "returns": [9.0], "succ', False),  # a killed training leaves half a line
        ('{"steps": 512, "returns": [9.0], "succ\n', True),
        ('{"steps": 512, "returns": [], "successes": []}\n', True),
        ('{"steps": 512, "returns": [NaN], "successes": [true]}\n', True),
        ('{"steps": 512, "returns": [9.0], "successes": ["yes"]}\n', True),
    ],
)
def test_half_a_line_of_a_log_is_left_out_and_any_other_damage_is_an_error(short, tmp_path, line, damaged):
    run = Path(shutil.copytree(short, tmp_path / "run"))
    with (run / "evaluations" / "training.jsonl").open("a") as file:
        file.write(line)
    if damaged:
        with pytest.raises(RunError, match="one of its logs cannot be read"):
            read_training(Run.open(run))
    else:
        assert len(read_training(Run.open(run)).evaluations) == len(
            read_training(Run.open(short)).evaluations
        )


def test_a_damaged_seed_of_a_group_hides_no_other_seed(short, tmp_path, deepbots):
    group = tmp_path / "group"
    for seed in (0, 1):
        shutil.copytree(short, group / f"seed-{seed}")
    (group / "seed-0" / "run.json").write_text("{")
    record = {name: None for name, field in GroupRecord.model_fields.items() if field.is_required()} | {
        "format": 2, "deepbots": "", "scenario": "", "source": "", "engine": "pybullet", "seeds": [0, 1],
        "stop_when_solved": False, "keep_checkpoints": 0, "command": [], "started": "",
    }  # fmt: skip
    (group / "group.json").write_text(json.dumps(record))
    output = deepbots("diagnose", group, "--only-logs")
    assert "seed-0/run.json is damaged" in output.err
    assert "seed-1: " in output.out
    (group / "seed-1" / "run.json").write_text("{")
    assert (
        "contains no run that can be diagnosed"
        in deepbots("diagnose", group, "--only-logs", "--json", code=2).err
    )


def test_the_page_names_every_cause_and_every_planted_one_is_known():
    text = DOCS.read_text("utf-8")
    names = [cause.name for cause in CAUSES]
    assert [name for name in names if f"`{name}`" not in text] == []
    assert {entry["cause"] for entry in BROKEN} <= set(names)
    assert all("{" in row.text for row in (*CAUSES, *ROWS))


def test_the_commands_of_an_advice_name_nothing_to_fill_in_but_the_run():
    """The studio has a button for each of them."""
    commands = [command for cause in CAUSES for command in re.findall("`deepbots [^`]+`", cause.advice)]
    assert commands
    assert [command for command in commands if re.search(r"(?! RUN\b)[ /][A-Z]", command)] == []


@pytest.mark.slow
def test_the_planted_cause_comes_first_in_nineteen_of_twenty(tmp_path):
    """Five minutes of CPU time."""
    first = {entry["name"]: (entry["cause"], causes[0]) for entry, causes in all_causes(SEED, tmp_path)}
    wrong = {name: pair for name, pair in first.items() if pair[0] != pair[1]}
    assert len(first) == 20
    assert len(wrong) <= 1, wrong


"""Being at the mark pays in every step, and the success, which ends the episode, asks for staying there."""


# The reward against the success


SLOW = (
    "termination.success={parked: abs(gap) < near and abs(joint_velocity(shuttle.slide)) < 2 mm/s and"
    " step > 5}"
)


def test_the_condition_that_all_failed_episodes_miss_is_in_the_verdict_over_the_run(tmp_path):
    """`speed < 0.2 m/s` in 1 of 84 moments was only in `diagnose --episode failed`, and the advice for the
    run was to continue."""
    run = Run.open(train_shuttle(tmp_path, SLOW))
    # To the mark, and never slow there.
    drives = [0.8] * 12 + [1.0, -1.0] * 24
    failed = [_played(run, mark, lambda step, gap: drives[step]) for mark in (0.2, 0.21, 0.22, 0.23)]
    assert {trace.outcome for trace in failed} == {"time limit"}
    missed = common_miss(failed)
    assert missed is not None
    assert (missed.condition.text, missed.episodes, missed.of) == (
        "abs(joint_velocity(shuttle.slide)) < 2 mm/s",
        4,
        4,
    )
    good = outcomes(400, 0.5, 0.5)
    training = with_logs(run.path, returns_of(good, 0), np.full(400, 60), success=good)
    statement = statement_of(replace(training, failed=failed), "missed_condition")
    assert f"in {missed.true} of {missed.moments} moments; the nearest value is" in statement.text
    assert "and the threshold 2 mm/s" in statement.text
    assert statement.advice.startswith("Reward what brings")
    assert "`abs(gap) < near` is true in" in statement.text


# Lint as a cause


@pytest.mark.slow
def test_lint_as_a_cause_repeats_no_other_cause_and_names_the_file_of_the_user(tmp_path, monkeypatch):
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
    assert lint.text.endswith("the highest possible return is -1 (DB810).")
    assert f"`deepbots lint {own}` shows the lines" in lint.advice
    assert main(["lint", str(own)]) == 0
    own.write_text(own.read_text() + "# changed\n")
    copy = statement_of(with_logs(run, -30 + noise, 30 - noise), "lint_warns")
    assert "`deepbots lint run/inputs/mine.yaml` shows the lines" in copy.advice
    assert f"It is the copy that the training read: {own} was changed since then." in copy.advice


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
    own = [finding.span for finding in linted.findings if finding.span.source is linted.text]
    assert own
    for span in own:
        line = span.start_position.line
        shown = html.escape(span.source.line(line)).replace("&#x27;", "&#39;")
        assert f'<span class="marked"><b>{line}</b>{shown}</span>' in page


# The observation


def test_a_parameter_in_the_observation_is_not_a_sensor_that_detects_nothing(tmp_path):
    """`vx` always 0.5 m/s."""
    run = train_shuttle(tmp_path, "augment.wish=speed", "observation.wish=0 .. 1 m/s")
    training = read_training(Run.open(run))
    run_probes(training)
    # 0.5 m/s is the middle of the range.
    assert {float(trace.observations[0, -1]) for trace in training.random} == {0.0}
    assert "sensor_without_reading" not in causes_of(training)


@pytest.mark.parametrize(
    "successes",
    ["{far: abs(x) > 0.3 m, fast: speed > 1 m/s}", "{fast: speed > 1 m/s, far: abs(x) > 0.3 m}"],
)
def test_terms_towards_any_of_the_successes_count(successes):
    rewards = ["reward={near: abs(x) / m, quick: abs(speed) / (m/s), done: 9 when abs(x) > 0.3 m}"]
    compiled = api.compile("cartpole", overrides=[*rewards, f"termination.success={successes}"])
    facts = ScenarioFacts(compiled.program, compiled.units)
    assert set(facts.terms_towards_success) == {"near", "quick"}


@pytest.mark.parametrize("name", few(WITH_SUCCESS, ["pit_escape", "find_ball", "see_ball"]))
def test_only_a_reward_without_what_the_success_measures_gets_a_term_that_compiles(name):
    assert ScenarioFacts(api.compile(name).program).unpaid_quantity is None
    without = ScenarioFacts(api.compile(name, overrides=["reward={time: -1}"]).program)
    quantity, term = without.unpaid_quantity
    assert quantity == WITH_SUCCESS[name]
    paid = api.compile(name, overrides=["reward={time: -1}", f"reward.towards={term}"])
    assert ScenarioFacts(paid.program).terms_towards_success == ("towards",)


def test_a_value_is_shown_in_the_unit_of_the_file():
    sets = ["observation.x=-40 .. 40 cm", "parameters.fall_angle=0.2 rad"]
    compiled = api.compile("cartpole", overrides=sets)
    facts = ScenarioFacts(compiled.program, compiled.units)
    numbers = {number.full_name: number for number in compiled.program.agent.numbers}
    pole = numbers["cart.pole_angle"]
    scaled = 2 * (np.pi / 6 - pole.low) / (pole.high - pole.low) - 1
    assert (facts.seen_text(numbers["x"], 0.625), facts.seen_text(pole, scaled)) == ("25 cm", "30 deg")
    assert facts.units.of("rad", "abs(cart.pole_angle)", "fall_angle") == UNITS["rad"]
    assert (quantity_text(0.003, facts.units.of("m/s", "3 mm/s")), facts.units.of("m", "no unit").text) == (
        "3 mm/s",
        "m",
    )


# What changed since a solved run


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


def test_a_change_by_an_option_has_its_option_as_place_and_no_line(solved, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    setting = ("--set", "near=0.1 mm")
    monkeypatch.setattr(sys, "argv", ["deepbots", "train", "mine.yaml", *setting])
    run = _trained(tmp_path, "missed", TEXT, *setting)
    (cause,) = (cause for cause in _causes(run, capsys) if cause["cause"] == "changed_since_solved")
    assert "0.1 mm (--set near)" in cause["text"]


def test_a_training_that_is_shorter_than_a_solved_one_comes_before_other_changes(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    _trained(tmp_path, "longer", EASY, "--timesteps", "512", "--full")
    causes = _causes(_trained(tmp_path, "missed", HARD, "--set", "train.total_timesteps=512"), capsys)
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


@pytest.fixture
def short_copy(short: Path, tmp_path: Path) -> Path:
    return shutil.copytree(short, tmp_path / "short")


def command_of(folder: Path, *words: str) -> list[str]:
    """Return the command for a run that this command line has trained."""
    run = Run.open(folder)
    write_record(folder, run.record.model_copy(update={"command": ("deepbots", "train", "cartpole", *words)}))
    return training_command(Run.open(folder), ["train.gamma=0.9"])


def test_the_command_that_trains_again_has_the_options_of_the_run_and_further_values(
    short_copy: Path,
) -> None:
    words = command_of(short_copy, "--set", "train.gamma=0.5", "--set=train.n_steps=64", "--run", "runs/mine")
    assert (words[:3], words[words.index("--seed") + 1]) == (["deepbots", "train", "cartpole"], "2")
    settings = [words[index + 1] for index, word in enumerate(words) if word == "--set"]
    assert settings == ["train.n_steps=64", "train.gamma=0.9"]
    assert "--run" not in words
    assert "--allow-code" in command_of(short_copy, "--allow-code")
    shards = command_of(short_copy, "--shards", "auto")
    assert shards[shards.index("--shards") + 1] == "1"
    for option in ("--initialize-from", "--keep-checkpoints", "--callback", "--logger", "--allow-path"):
        for options in ([option, "value"], [f"{option}=value"]):
            command = command_of(short_copy, *options)
            assert command[command.index(option) + 1] == "value"
