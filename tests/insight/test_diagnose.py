"""Diagnoses of trainings: planted causes come first, healthy trainings have none, and broken files are told in a sentence."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("stable_baselines3")

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import DeepbotsError, EvaluationError, RunError
from deepbots_cli.insight.diagnosis import CAUSES, diagnose
from deepbots_cli.insight.episode import ROWS, explain, explanation_json
from deepbots_cli.insight.trace import trace_episodes
from deepbots_cli.insight.training import TrainingEvidence, read_training, run_probes
from deepbots_cli.learning import train
from deepbots_cli.learning.group import GroupRecord
from deepbots_cli.learning.run import Run
from deepbots_cli.learning.verdict import quoted_episodes

DOCS = Path(__file__).parents[2] / "docs" / "diagnose.md"
BROKEN = yaml.safe_load(Path(__file__).with_name("broken.yaml").read_text("utf-8"))
SEED = 1


@pytest.fixture(scope="session")
def short(tmp_path_factory) -> Path:
    """A training of two roll-outs; not to be changed."""
    return train("cartpole", total_timesteps=1024, seed=2, run=tmp_path_factory.mktemp("runs") / "short").run


def _logs(short: Path, returns, lengths=None, ending="fallen", success=False, **scalars) -> TrainingEvidence:
    """A training with these logs in the place of its own, and without short episodes."""
    returns = np.asarray(returns, float)
    lengths = returns if lengths is None else np.asarray(lengths, float)
    columns = [np.cumsum(lengths), returns, lengths, np.full(len(returns), float(success)), np.full(len(returns), ending, object)]
    episodes = np.rec.fromarrays(columns, names="steps, returns, lengths, successes, endings")
    curves = {name.replace("__", "/"): (np.arange(len(values), dtype=float), np.asarray(values, float)) for name, values in scalars.items()}
    return replace(read_training(Run.open(short)), episodes=episodes, scalars=curves, evaluations=[])


def _causes(training: TrainingEvidence) -> list[str]:
    return [cause.cause for cause in diagnose(training)]


def test_logs_alone_tell_some_causes(short):
    noise = np.random.default_rng(0).normal(0, 3, 200)
    assert _causes(_logs(short, -30 + noise, 30 - noise))[0] == "ending_early_pays"
    assert _causes(_logs(short, np.full(50, 3.0)))[0] == "ending_at_once"
    assert _causes(_logs(short, 30 + np.arange(200) / 4 + noise))[0] == "too_few_steps"
    assert "too_few_steps" not in _causes(_logs(short, 100 - 70 * np.exp(-np.arange(200) / 40) + noise))  # it levels off
    # 1 % of the planned timesteps: later episodes may end in other ways, or succeed
    assert _causes(_logs(short, 30 + noise)) == ["short_training"]
    assert "exploration_collapsed" in _causes(_logs(short, 30 + noise, train__entropy_loss=[-0.6] * 4 + [-0.001] * 10))


@pytest.fixture(scope="session")
def aiming(tmp_path_factory) -> Path:
    """A training of all its timesteps in a task with a success; not to be changed."""
    sets = ["termination.success={there: x > 0.3 m}", "train.total_timesteps=512"]
    compiled = api.compile(api.load("cartpole", overrides=sets))
    return train(compiled, total_timesteps=512, seed=2, run=tmp_path_factory.mktemp("runs") / "aiming").run


def test_a_training_that_stays_at_a_local_optimum_is_told_the_term_that_pays_it(aiming):
    returns = 100 - 70 * np.exp(-np.arange(200) / 20) + np.random.default_rng(0).normal(0, 3, 200)
    first = diagnose(_logs(aiming, returns, np.full(200, 100), reward__alive=returns))[0]
    assert (first.cause, first.evidence["term"], first.evidence["term_share"]) == ("success_never_seen", "alive", 1.0)
    assert "'alive' pays 100% of what late episodes gain" in first.text
    assert "a term that pays for coming nearer" not in first.advice
    assert "path_distance" in first.advice


def test_a_training_without_a_success_is_not_first_told_to_train_on(aiming):
    rising = 30 + np.arange(200) / 4 + np.random.default_rng(0).normal(0, 3, 200)
    causes = _causes(_logs(aiming, rising, np.full(200, 100), reward__alive=rising))
    assert causes.index("success_never_seen") < causes.index("too_few_steps")


def test_a_policy_that_succeeds_in_a_later_evaluation_is_not_told_to_train_on(aiming, tmp_path, capsys):
    training = _logs(aiming, 30 + np.arange(200) / 4, np.full(200, 100))

    def evaluated(mean_return: float) -> list:
        last = {"returns": [mean_return] * 30, "successes": [True] * 29 + [False]}
        return diagnose(replace(training, evaluations=[last]))

    first = evaluated(100.0)[0]
    assert first.cause == "exploration_hides_success"
    assert "in 97% of 30 episodes" in first.text
    assert evaluated(300.0) == []  # which solves the task
    run = shutil.copytree(aiming, tmp_path / "run")
    assert main(["eval", str(run), "--episodes", "9"]) == 0
    assert len(read_training(Run.open(run)).evaluations[-1]["successes"]) == 9


def test_steps_beyond_the_plan_read_sensibly(short):
    training = _logs(short, 30 + np.arange(200) / 4 + np.random.default_rng(0).normal(0, 3, 200))
    (found,) = [cause for cause in diagnose(training) if cause.cause == "too_few_steps"]
    assert "after 1,024 steps; the scenario plans 100,000" in found.text


def test_a_training_that_stops_at_a_reset_has_this_cause_alone(tmp_path, capsys):
    with pytest.raises(EvaluationError):
        train(api.compile(api.load("cartpole", overrides=["fall_angle=0.15 deg"])), total_timesteps=64, run=tmp_path / "run")
    training = read_training(Run.open(tmp_path / "run"))
    run_probes(training)
    assert _causes(training) == ["ending_at_reset"]
    assert main(["explain-episode", str(tmp_path / "run")]) == 2
    assert "deepbots diagnose" in capsys.readouterr().err


def test_a_training_that_solves_its_task_has_no_causes(short):
    """The same logs as a collapsed exploration, and an evaluation that meets `solved`."""
    training = _logs(short, np.full(200, 200.0), ending="max_steps", train__entropy_loss=[-0.001] * 20)
    evaluation = {"returns": [200.0] * 20, "successes": [False] * 20}
    assert _causes(replace(training, evaluations=[evaluation])) == []


def test_an_action_without_effect_and_useless_ranges_are_found_in_short_episodes(short, tmp_path):
    overrides = ["robots.cart.apply.wheels=0 * drive * wheel_speed", "observation.x=-1e-6 .. 1e-6 m", "reward.alive=-1", "train.ent_coef=5"]
    overrides += ["augment.tilt=max(abs(cart.pole_angle) / rad, 0.19)", "observation.tilt=0.2 .. 0.4"]
    compiled = api.compile(api.load("cartpole", overrides=overrides))
    training = read_training(Run.open(train(compiled, total_timesteps=512, seed=2, run=tmp_path / "dead").run))
    assert "action_without_effect" not in _causes(training)
    run_probes(training)
    assert _causes(training)[0] == "action_without_effect"
    assert {trace.ended_by for trace in training.policy} == {"fallen"}
    (warned,) = [cause for cause in diagnose(training) if cause.cause == "lint_warns"]
    assert warned.evidence["likelihood"] > 0.9  # the required return is out of reach
    assert "the highest possible return is -1 (DB810)" in warned.text
    # Most values of both are beyond their range. Those of `tilt` hardly differ there, so clipping loses nothing.
    (clipped,) = [cause for cause in diagnose(training) if cause.cause == "saturated_observation"]
    assert min(clipped.evidence["shares"]["x"], clipped.evidence["shares"]["tilt"]) > 0.4
    assert clipped.evidence["names"] == "x"
    # Its evaluations, which do not explore, may solve the task all the same.
    assert _causes(replace(training, evaluations=[{"returns": [200.0], "successes": [False]}])) == ["exploration_too_large"]


def test_a_diagnosis_is_printed_with_numbers_and_what_to_try(short, capsys):
    assert main(["diagnose", str(short)]) == 0
    text = capsys.readouterr().out
    assert "the most likely first" in text
    assert "Try: " in text
    assert main(["diagnose", str(short), "--json", "--only-logs"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["runs"]
    assert all(any(sign.isdigit() for sign in cause["text"]) for cause in found["causes"])
    likelihoods = [cause["evidence"]["likelihood"] for cause in found["causes"]]
    assert likelihoods == sorted(likelihoods, reverse=True)


def test_an_episode_of_a_run_is_explained_with_its_critic(short, capsys):
    assert main(["explain-episode", str(short), "--json", "--episode", "3"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert 0 < data["moment"]["time"] < data["time"]
    assert data["end"]["margin"] > 0


def test_episodes_of_an_evaluation_are_repeated_to_the_bit(short, tmp_path, capsys):
    """Also those that stand in another row of its forward passes."""
    run = shutil.copytree(short, tmp_path / "run")
    assert main(["eval", str(run), "--episodes", "failed"]) == 2
    assert "keeps no evaluation" in capsys.readouterr().err
    assert main(["eval", str(run), "--episodes", "10", "--json"]) == 0
    outcomes = json.loads(capsys.readouterr().out)["outcomes"]
    opened = Run.open(run)
    _, kept = quoted_episodes(opened)
    assert kept.failed(opened.program) == list(range(10))
    for trace, number in zip(trace_episodes(opened, (9, 3), **kept.replay_options), (9, 3), strict=True):
        known = outcomes[number]
        assert (trace.steps, trace.returns, trace.ended_by) == (known["length"], known["total_return"], known["ended_by"])


def test_failed_episodes_that_a_time_limit_ended_print_no_blank_lines(short, tmp_path, capsys):
    run = shutil.copytree(short, tmp_path / "run")
    resolved, record = run / "resolved.yaml", json.loads((run / "run.json").read_text())
    resolved.write_text(resolved.read_text().replace("failure:", "success:\n    kept: time > 60 s\n  failure:"))
    text = resolved.read_text()
    resolved.write_text(re.sub(r"max_steps: \d+", "max_steps: 5", text))
    (run / "run.json").write_text(json.dumps(record | {"digest": Run.open(run).digest}))
    assert main(["eval", str(run), "--episodes", "2"]) == 0
    capsys.readouterr()
    assert main(["eval", str(run), "--episodes", "failed"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "episode 0: 'max_steps' at 0.16 s"
    assert lines[1].strip().startswith("The episode reached 5 of at most 5 (max_steps).")
    assert "'kept' needs" in lines[1]
    assert all(line.strip() for line in lines)


def test_a_critic_that_never_fell_names_no_moment(short):
    run = Run.open(short)
    trace = next(trace_episodes(run, [0], seed=5))
    trace.critic = np.linspace(1.0, 2.0, trace.steps)
    statements = explain(trace)
    assert explanation_json(trace, statements)["moment"] is None
    assert "rose from 1 to 2" in next(each.text for each in statements if each.cause == "unforeseen")


@pytest.mark.slow
@pytest.mark.parametrize(("scenario", "timesteps"), [("cartpole", 2048), ("balancer", 6000), ("quadrotor", 6000), ("line_follower", 6000)])
def test_the_named_moment_precedes_the_end_of_fifty_failed_episodes(scenario, timesteps, tmp_path):
    """It is the largest drop of the critic's value, of a policy at the beginning of its training; 20 s of CPU time each."""
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
def test_failed_episodes_are_filmed(short, tmp_path, capsys, monkeypatch):
    """A film takes 3 s of CPU time."""
    run = shutil.copytree(short, tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    assert main(["eval", str(run), "--episodes", "2"]) == 0
    capsys.readouterr()
    assert main(["eval", str(run), "--episodes", "failed", "--video", "failed.mp4", "--json"]) == 0
    failed = json.loads(capsys.readouterr().out)["failed"]
    assert all(Path(each["film"]).stat().st_size > 1000 for each in failed)
    assert [each["film"] for each in failed] == ["failed-0.mp4", "failed-1.mp4"]


def test_what_cannot_be_diagnosed_is_told_in_a_sentence(short, tmp_path, capsys):
    run = shutil.copytree(short, tmp_path / "run")
    log = run / "monitor.csv"
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:2]))
    assert main(["diagnose", str(run)]) == 2
    assert "holds no finished episode yet" in capsys.readouterr().err
    log.write_text(log.read_text() + "a,b,c,d,e,f,g,h,i,j\n")
    assert main(["diagnose", str(run)]) == 2
    assert "is damaged" in capsys.readouterr().err
    shutil.copy(short / "monitor.csv", log)
    evaluation = run / "evaluations" / "0001.json"
    kept = {"evaluated": "9999", "model": "best", "seed": 2, "episodes": 1, "mean_return": 9.0, "return_interval": None, "solved": None,
            "success_defined": False, "success_rate": 0.0, "success_interval": [0.0, 1.0], "outcomes": None}  # fmt: skip
    evaluation.write_text(json.dumps(kept))
    assert main(["explain-episode", str(run)]) == 2
    assert "0001.json is damaged: 'outcomes'" in capsys.readouterr().err
    evaluation.unlink()
    shutil.rmtree(run / "models")
    assert main(["explain-episode", str(run)]) == 2
    assert "holds no model" in capsys.readouterr().err
    assert main(["diagnose", str(tmp_path)]) == 2
    assert "is not a run" in capsys.readouterr().err


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
def test_half_a_line_of_a_log_is_left_out_and_any_other_damage_is_told(short, tmp_path, line, damaged):
    run = Path(shutil.copytree(short, tmp_path / "run"))
    with (run / "evaluations" / "training.jsonl").open("a") as file:
        file.write(line)
    if damaged:
        with pytest.raises(RunError, match="one of its logs cannot be read"):
            read_training(Run.open(run))
    else:
        assert len(read_training(Run.open(run)).evaluations) == len(read_training(Run.open(short)).evaluations)


def test_a_damaged_seed_of_a_group_hides_no_other_seed(short, tmp_path, capsys):
    group = tmp_path / "group"
    for seed in (0, 1):
        shutil.copytree(short, group / f"seed-{seed}")
    (group / "seed-0" / "run.json").write_text("{")
    record = {name: None for name, field in GroupRecord.model_fields.items() if field.is_required()} | {
        "format": 1, "deepbots": "", "scenario": "", "source": "", "engine": "pybullet", "seeds": [0, 1],
        "stop_when_solved": False, "keep_checkpoints": 0, "command": [], "started": "",
    }  # fmt: skip
    (group / "group.json").write_text(json.dumps(record))
    assert main(["diagnose", str(group), "--only-logs"]) == 0
    told = capsys.readouterr()
    assert "seed-0/run.json is damaged" in told.err
    assert "seed-1: " in told.out
    (group / "seed-1" / "run.json").write_text("{")
    assert main(["diagnose", str(group), "--only-logs", "--json"]) == 2
    assert "holds no run that can be diagnosed" in capsys.readouterr().err


def test_the_page_names_every_cause_and_every_planted_one_is_known():
    text, names = DOCS.read_text("utf-8"), [cause.__name__ for cause in CAUSES]
    assert [name for name in names if f"`{name}`" not in text] == []
    assert {entry["cause"] for entry in BROKEN} <= set(names)
    assert all("{" in (row.__doc__ or "") for row in (*CAUSES, *ROWS))


@pytest.mark.slow
def test_the_planted_cause_comes_first_in_nine_of_twelve(tmp_path):
    """Two minutes of CPU time."""
    first = {}
    for entry in BROKEN:
        run = tmp_path / entry["name"]
        compiled = api.compile(api.load(entry["scenario"], overrides=entry["set"]))
        try:
            train(compiled, total_timesteps=entry["timesteps"], seed=SEED, run=run)
        except DeepbotsError:
            assert entry.get("fails")
        training = read_training(Run.open(run))
        run_probes(training)
        first[entry["name"]] = (_causes(training) or ["none"])[0]
    wrong = {entry["name"]: first[entry["name"]] for entry in BROKEN if first[entry["name"]] != entry["cause"]}
    assert len(wrong) <= 3, wrong
