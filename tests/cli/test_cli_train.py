"""Training, evaluation and models.

* `deepbots train` and `deepbots eval`, on trainings of seconds.
* One way to name a model: every command that takes the policy of a run also takes one of its models.
"""

from __future__ import annotations

import contextlib
import csv
import json
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from dataclasses import replace
from importlib.metadata import version
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from xml.etree import ElementTree

import pytest

from deepbots_cli import api
from deepbots_cli.cli import main, terminal
from deepbots_cli.cli.command import Commands
from deepbots_cli.cli.commands import COMMANDS
from deepbots_cli.cli.commands.train import training_page
from deepbots_cli.document import Permissions, shipped
from deepbots_cli.errors import RunError
from deepbots_cli.insight.causes import causes_after
from deepbots_cli.learning import train
from deepbots_cli.learning.runs.origin import Commit
from deepbots_cli.learning.runs.run import Run, RunRecord, write_record
from deepbots_cli.learning.runs.verdict import run_verdict
from tests.commands import Deepbots, Ran
from tests.few import few

FAST = (
    *("--set", "train.n_epochs=1", "--set", "train.environments=2", "--set", "train.n_steps=64"),
    *("--set", "world.engine=mujoco"),  # half of the time
)
SOLVED = ("--set", "solved=mean_return >= 195 over 4 episodes")
TINY = ("train", "cartpole", "--timesteps", "200", *FAST, *SOLVED, "--set", "evaluation={episodes: 4}")


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A folder with a run of 256 steps, `mine`, with a model after 128 steps, and what its training printed."""
    folder = tmp_path_factory.mktemp("trained")
    out = StringIO()
    err = StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([*TINY, "--keep-checkpoints", "2", "--run", "mine"])
    assert code == 0, err.getvalue()
    return folder, Ran(code, out.getvalue(), err.getvalue())


@pytest.fixture
def trained(first, tmp_path):
    """The output of the training of `mine`; the run is copied to the working directory."""
    folder, ran = first
    shutil.copytree(folder / "mine", tmp_path / "mine")
    return ran


def test_a_training_ends_with_a_verdict_and_what_to_do_next(trained, tmp_path):
    assert "mean return" in trained.out
    assert trained.out.startswith("not solved: mean return ")
    assert len(trained.out.splitlines()) <= 12
    assert trained.err.rstrip().splitlines()[-1].startswith("  deepbots ")
    assert (
        "`deepbots lint cartpole --exploits` looks for ways to earn this reward without doing the task\n"
        in trained.err
    )
    assert json.loads((tmp_path / "mine" / "run.json").read_text())["status"] == "finished"


def test_a_repeated_training_gives_the_same_weights_or_says_what_differs(deepbots, trained, tmp_path):
    record = RunRecord.read(tmp_path / "mine")
    assert {"torch", "numpy"} <= set(record.origin.packages)
    assert "the same policy" in deepbots("repeat", "mine", "--run", "again").out
    packages = {**record.origin.packages, "torch": "1.0"}
    other = record.model_copy(
        update={
            "origin": record.origin.model_copy(update={"packages": packages}),
            "result": record.result.model_copy(update={"weights_digest": "0" * 64}),
        }
    )
    write_record(tmp_path / "mine", other)
    ran = deepbots("repeat", "mine", "--run", "third", code=1)
    assert "another policy" in ran.out
    assert "torch: 1.0, now " in ran.out


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
@pytest.mark.parametrize("name", ["evil", "a=b", "a\u2028b", b"\xff"])
def test_a_run_knows_the_commit_of_its_project_and_starts_no_program_of_it(tmp_path, name):
    def git(*words):
        author = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", *author, *words], cwd=tmp_path, check=True, capture_output=True)

    scenario = tmp_path / "mine.yaml"
    scenario.write_text("deepbots: 1\n")
    encoded = os.fsencode(name)
    (tmp_path / ".gitattributes").write_bytes(b"*.yaml filter=" + encoded + b"\n")
    git("init")
    git("add", ".")
    git("commit", "-m", "first")
    assert Commit.of(tmp_path).is_changed is False
    git("config", b"filter." + encoded + b".clean", "touch started; cat")
    git("config", "core.fsmonitor", "touch started")
    scenario.write_text("deepbots: 2\n")  # of the same size, so Git compares the content
    assert Commit.of(tmp_path).is_changed is True
    assert not (tmp_path / "started").exists()


def test_of_two_installations_a_run_records_the_version_that_python_imports(tmp_path):
    metadata = tmp_path / "numpy-0.1.dist-info" / "METADATA"
    metadata.parent.mkdir()
    metadata.write_text("Metadata-Version: 2.1\nName: numpy\nVersion: 0.1\n")
    code = "import sys; from deepbots_cli.learning.runs import origin; sys.path.append(sys.argv[1])"
    shown = "print(origin.Origin.of(origin.Path('.')).packages['numpy'])"
    command = [sys.executable, "-c", f"{code}; {shown}", str(tmp_path)]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == version("numpy")


def test_train_runs_and_inspect_name_the_step_of_the_best_model_and_what_chose_it(
    deepbots, trained, tmp_path
):
    """Nowhere was the step of the best model."""
    best = RunRecord.read(tmp_path / "mine").result.best
    assert 0 < best.steps <= 256
    assert best.text.startswith(f"after {best.steps} steps, by mean return ")
    assert best.text in deepbots("inspect", "mine").out
    (listed,) = json.loads(deepbots("runs", ".", "--json").out)
    assert (listed["best_steps"], listed["chosen_by"]) == (best.steps, best.chosen_by)
    header, _, row = deepbots("runs", ".").out.splitlines()[1:4]
    place = header.index("best_at")
    assert row[place : place + len("best_at")].strip() == str(best.steps)


def test_a_solved_task_is_to_be_seen_and_used_and_not_trained_twice_as_long(deepbots):
    ran = deepbots(*TINY, "--run", "mine", "--set", "solved=mean_return >= 1 over 4 episodes")
    assert ran.err.split("next:\n")[1].splitlines() == ["  deepbots report mine", "  deepbots view mine"]
    assert "deepbots resume" not in ran.err


def test_a_training_that_ends_unsolved_names_the_first_cause_and_one_command(deepbots, tmp_path, monkeypatch):
    words = [
        *TINY,
        "-q",
        "--set",
        "solved=mean_return >= 150 over 4 episodes",
        "--set",
        "train.learning_rate=0.5",
        "--run",
    ]
    monkeypatch.setattr(sys, "argv", ["deepbots", *words, "mine"])
    ran = deepbots(*words, "mine")
    assert "most likely cause (" in ran.out
    assert "the learning rate is too high" in ran.out
    advised = ran.err.split("next:\n")[1].splitlines()[1].split()
    assert advised[:5] == ["deepbots", "train", "cartpole", "--seed", "0"]
    assert "train.learning_rate=0.003" in advised
    assert "train.learning_rate=0.5" not in advised
    assert "train.n_steps=64" in advised
    files = {path: path.read_bytes() for path in (tmp_path / "mine").rglob("*") if path.is_file()}
    cause = causes_after(tmp_path / "mine")[0].as_json()
    assert files == {path: path.read_bytes() for path in (tmp_path / "mine").rglob("*") if path.is_file()}
    assert cause["settings"] == {"train.learning_rate": "0.003"}
    printed = json.loads(deepbots(*words, "again", "--json").out)["cause"]
    assert printed["settings"] == cause["settings"]
    assert "--set train.learning_rate=0.003" in printed["command"]


@pytest.mark.slow
def test_a_training_that_ends_unsolved_without_a_cause_names_where_to_look(deepbots):
    words = (
        "--set",
        "train.total_timesteps=400",
        "--set",
        "train.n_steps=50",
        "--set",
        "train.batch_size=50",
        "--set",
        "world.engine=mujoco",
        "--run",
        "mine",
        "-q",
    )
    ran = deepbots("train", "cartpole", "--seed", "1", *words)
    assert "no cause found; `eval --details` shows from which starts the policy fails" in ran.out
    assert ran.err.split("next:\n")[1].splitlines()[0] == "  deepbots eval mine --details"
    assert "deepbots eval mine --details" in deepbots("diagnose", "mine").err


@pytest.mark.slow
def test_the_next_commands_can_be_pasted_though_the_path_has_blanks(deepbots, tmp_path):
    ran = deepbots(*TINY, "--run", "my läufe/a b")
    assert "deepbots diagnose 'my läufe/a b'" in ran.err
    assert "deepbots resume 'my läufe/a b'" in ran.err
    assert (
        "deepbots lint 'to change/cartpole.yaml'"
        in deepbots("new", "cartpole", "to change", "--from", "cartpole").err
    )
    assert "cd 'to edit' &&" in deepbots("compile", "cartpole", "--project", "to edit").err


def awaited(capfd: pytest.CaptureFixture[str], pattern: str) -> str:
    """Return what is printed until this is."""
    output, end = "", time.monotonic() + 120
    while not re.search(pattern, output) and time.monotonic() < end:
        time.sleep(0.1)
        output += capfd.readouterr().err
    return output


@pytest.mark.slow
def test_the_address_of_the_page_of_a_training_is_shown_once_it_can_be_opened(trained, tmp_path, capfd):
    pytest.importorskip("viser")
    with training_page(enabled=True, permissions=Permissions()) as show_page:
        show_page(tmp_path / "mine")
        address = re.search(r"http://\S+", awaited(capfd, r"http://\S+\s"))[0]
        with urllib.request.urlopen(address) as answer:
            assert answer.status == 200


def test_the_page_of_a_training_does_not_run_a_typer_py_of_the_working_directory(
    tmp_path, monkeypatch, capfd
):
    pytest.importorskip("viser")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "typer.py").write_text("open(__file__ + '.ran', 'w').close()\n")
    with training_page(enabled=True, permissions=Permissions()) as show_page:
        show_page(tmp_path / "missing")
        assert awaited(capfd, "missing").startswith("error: ")
    assert not (tmp_path / "typer.py.ran").exists()


def test_a_trained_run_can_be_evaluated_listed_filmed_and_gone_on_with(deepbots, trained, tmp_path):
    report = json.loads(deepbots("eval", "mine", "--episodes", "2", "--json").out)
    assert report["episodes"] == 2
    assert report["solved"] is None
    deepbots("eval", "mine", "--episodes", "1", "--last")
    drawn = ("--engine", "pybullet") if find_spec("pybullet") else ()  # which draws on any machine
    deepbots("render", "mine", "--last", *drawn, "-o", "out.mp4")
    assert (tmp_path / "out.mp4").stat().st_size > 1000
    resumed = json.loads(deepbots("resume", "mine", "--timesteps", "400", "--quiet", "--json").out)
    assert resumed["training"]["steps"] >= 400
    assert resumed["evaluation"]["episodes"] == 4
    (row,) = json.loads(deepbots("runs", ".", "--json").out)
    assert (row["name"], row["state"], row["score"]) == ("mine", "finished", "evaluation")
    assert row["mean_return"] == resumed["evaluation"]["mean_return"]
    evaluations = json.loads(deepbots("runs", "mine", "--json").out)["evaluations"]
    assert [
        (evaluation["number"], evaluation["model"], evaluation["episodes"]) for evaluation in evaluations
    ] == [
        (1, "best", 4),
        (2, "best", 2),
        (3, "last", 1),
        (4, "best", 4),
    ]


@pytest.mark.slow
def test_a_run_is_evaluated_in_its_cases_too(deepbots, tmp_path):
    there = "there: {set: {termination.success: {there: x > 0.3 m}}, episodes: 2}"
    cases = (
        f"evaluation={{episodes: 4, cases: {{steep: {{set: {{fall_angle: 5 deg}}, episodes: 3}}, {there}}}}}"
    )
    train = ("train", "cartpole", "--timesteps", "200", *FAST, *SOLVED, "--quiet")
    rates = {
        line.split()[0]: "%" in line
        for line in deepbots(*train, "--set", cases, "--run", "mine").out.split("cases")[1].splitlines()
        if line.split()[:1] in (["steep"], ["there"])
    }
    assert rates == {"steep": False, "there": True}  # a success rate only where there is a success
    report = json.loads(deepbots("eval", "mine", "--json").out)
    assert (report["case"], report["episodes"]) == (None, 4)
    assert [(case["case"], case["episodes"]) for case in report["cases"]] == [("steep", 3), ("there", 2)]
    assert report["cases"][0]["mean_return"] < report["mean_return"]
    assert json.loads(deepbots("eval", "mine", "--case", "steep", "--json").out)["cases"] == []
    assert (
        deepbots("eval", "mine", "--case", "flat", code=2).err
        == "error: CartPole has no case 'flat'; there are: steep, there\n"
    )
    # More steps than those of the training, and than 100,000
    assert (
        "deepbots eval many"
        in deepbots(*train, "--set", cases.replace("episodes: 3", "episodes: 100_000"), "--run", "many").err
    )
    ran = json.loads(
        deepbots("try", "cartpole", "--set", cases, "--case", "steep", "--driver", "forward", "--json").out
    )
    assert all(episode["length"] < 15 for episode in ran["episodes"])


@pytest.fixture
def cases(monkeypatch):
    """The setting of two cases, of which the second is interrupted."""

    class InterruptedInSteep(terminal.ProgressBar):
        def __init__(self, total, unit, **options):
            if unit.startswith("episodes of case steep"):
                raise KeyboardInterrupt
            super().__init__(total, unit, **options)

    monkeypatch.setattr(terminal, "ProgressBar", InterruptedInSteep)
    return "evaluation.cases={short: {set: {truncation.max_steps: 7}}, steep: {set: {fall_angle: 5 deg}}}"


def test_an_interrupted_evaluation_shows_what_is_finished(deepbots, trained, cases):
    ran = deepbots("eval", "mine", "--episodes", "3", "--set", cases, "--json", code=130)
    report = json.loads(ran.out)
    assert ([case["case"] for case in report["cases"]], report["unfinished"]) == (["short"], ["case steep"])
    assert "not evaluated: case steep" in ran.err


def test_an_interruption_after_a_training_keeps_the_cases_that_are_evaluated(deepbots, cases):
    assert (
        "interrupted; the training is finished, evaluate it with: deepbots eval cut"
        in deepbots(*TINY, "--run", "cut", "--set", cases, code=130).err
    )
    (path,) = Path("cut/evaluations").glob("*.json")
    assert [case["case"] for case in json.loads(path.read_text("utf-8"))["cases"]] == ["short"]


def test_a_demanded_result_that_is_not_met_ends_with_1(deepbots, trained):
    ran = deepbots("eval", "mine", "--episodes", "2", "--require-solved", "--min-return", "1000", code=1)
    assert "not met: the task is solved (solved: unknown, because the criterion needs" in ran.err
    assert "not met: mean return of at least 1000" in ran.err
    ran = deepbots("eval", "mine", "--episodes", "40", "--min-return", "1", "--json")
    assert "met: mean return of at least 1 (" in ran.err
    report = json.loads(ran.out)
    assert report["episodes"] == 1, "no return is below 1"
    assert report["success_rate"] is None, "the scenario defines no success"
    assert report["success_interval"] is None, "the scenario defines no success"
    refused = deepbots("eval", "mine", "--min-success", "90%", code=2)
    assert "CartPole defines no success; use --min-return" in refused.err
    assert "write" not in deepbots("eval", "mine", "--min-success", "101%", code=2).err
    refused = deepbots("eval", "mine", "--min-success", "90", code=2)
    assert "write 90% for a percentage" in refused.err


def test_an_evaluation_whose_resets_draw_nothing_says_so(deepbots, trained):
    note = "note: a reset draws nothing, so all 3 episodes begin in the same state"
    fixed = ("--set", "parameters.fall_angle=15 deg", "--set", "reset.joints.cart.pole_hinge=0.01 rad")
    assert note in deepbots("eval", "mine", "--episodes", "3", *fixed).out
    assert "draws nothing" not in deepbots("eval", "mine", "--episodes", "3").out
    assert "draws nothing" not in deepbots("eval", "mine", "--episodes", "1", *fixed).out


def test_a_model_of_a_run_is_evaluated_by_its_path(deepbots, trained):
    report = json.loads(deepbots("eval", "mine/models/agent/last.zip", "--episodes", "2", "--json").out)
    assert (report["run"], report["model"]) == ("mine", "last")
    assert (
        deepbots("eval", "mine/models/agent/last.zip", "--last", code=2).err
        == "error: --last chooses a model of a run, but mine/models/agent/last.zip is already a model; leave it"
        " out\n"
    )


def test_a_run_that_is_named_without_its_folder_is_found_in_the_message(deepbots, tmp_path):
    (tmp_path / "runs" / "first").mkdir(parents=True)
    assert (
        deepbots("eval", "first", code=2).err
        == "error: no file, folder or shipped scenario is called 'first'; did you mean runs/first?\n"
    )


def test_two_runs_of_a_scenario_are_compared_on_the_same_starts(deepbots, trained):
    ran = deepbots("compare", "mine", "mine", "--episodes", "3", code=2)
    assert "at least two runs" in ran.err
    shutil.copytree("mine", "other")
    ran = deepbots("compare", "mine", "other", "--episodes", "3")
    assert ran.out.startswith("neither is better: other and mine have the same mean return of ")
    assert "each group has one run" in ran.out
    report = json.loads(deepbots("compare", "mine", "other", "--episodes", "3", "--json").out)
    assert report["differences"][0]["mean_return"] == {
        "mean": 0.0,
        "interval": [0.0, 0.0],
        "improvement": 0.5,
    }
    first, second = report["groups"]
    assert first["runs"][0]["outcomes"] == second["runs"][0]["outcomes"]


@pytest.mark.slow
def test_a_gate_without_a_success_is_decided_long_before_the_last_episode(deepbots, tmp_path):
    deepbots(*TINY, "--run", "mine", "--set", "termination.success={balanced: time > 1 h}")
    ran = deepbots(
        "eval",
        "mine",
        "--episodes",
        "100",
        "--min-success",
        "95%",
        "--json",
        "--junit",
        "gate.xml",
        "--csv",
        "episodes.csv",
        code=1,
    )
    report = json.loads(ran.out)
    assert report["episodes"] < 30
    assert (
        f"not met: success rate of at least 0.95 (0 of {report['episodes']} episodes succeed; 95 % confidence"
        " sequence" in ran.err
    )
    suite = ElementTree.parse(tmp_path / "gate.xml").getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("1", "1")
    assert suite.find("testcase").get("name") == "success rate of at least 0.95"
    with (tmp_path / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["return"]) for row in rows] == [
        episode["total_return"] for episode in report["outcomes"]
    ]
    assert [float(row["drawn.reset.joints.cart.pole_hinge"]) for row in rows] == [
        episode["drawn"]["reset.joints.cart.pole_hinge"] for episode in report["outcomes"]
    ]


def test_a_group_is_trained_listed_evaluated_and_compared_as_one(deepbots):
    ran = deepbots(
        "train",
        "cartpole",
        "--seeds",
        "0,2",
        "--timesteps",
        "300",
        *FAST[2:],
        *SOLVED,
        "--set",
        "evaluation={episodes: 2}",
        "--json",
    )
    report = json.loads(ran.out)
    assert "seed 2, 2 of 2" in ran.err
    assert [entry["run"] for entry in report["training"]["trained"]] == [
        f"runs/cartpole-seeds-1/seed-{seed}" for seed in (0, 2)
    ]
    assert len(report["evaluation"]["runs"]) == 2
    (row,) = json.loads(deepbots("runs", "--scenario", "cartpole", "--json").out)
    assert (row["name"], row["state"], row["seeds"]) == ("cartpole-seeds-1", "finished", [0, 2])
    assert (row["score"], row["mean_return"]) == ("evaluation", report["evaluation"]["mean_return"])
    assert [
        entry["name"] for entry in json.loads(deepbots("runs", "runs/cartpole-seeds-1", "--json").out)
    ] == [
        "seed-0",
        "seed-2",
    ]
    assert (
        deepbots("runs", "--live").err
        == "no run in runs matches these options; leave them out to list all runs\n"
    )
    group = "runs/cartpole-seeds-1"
    deepbots("eval", group, "--episodes", "2", "--min-return", "1000", "--latex", "group.tex", code=1)
    assert "\n2 seeds " in Path("group.tex").read_text()
    if find_spec("pybullet"):
        report = json.loads(
            deepbots("eval", group, "--episodes", "2", "--engine", "pybullet,mujoco", "--json").out
        )
        assert [[run["engine"] for run in entry["runs"]] for entry in report["groups"]] == [
            ["pybullet"] * 2,
            ["mujoco"] * 2,
        ]
        before, after = ([run["mean_return"] for run in entry["runs"]] for entry in report["groups"])
        assert report["differences"][0]["mean_return"]["mean"] == pytest.approx(
            sum(after) / 2 - sum(before) / 2
        )
    again = deepbots("repeat", f"{group}/seed-2").out
    assert f"{group}/seed-2 and runs/cartpole-2-1: the same policy" in again
    assert (
        "--baselines does not go with a group; name one of its runs"
        in deepbots("eval", group, "--baselines", code=2).err
    )
    shutil.copytree(group, "runs/other")
    ran = deepbots("compare", group, "runs/other", "--episodes", "5")
    assert any(words in ran.out for words in ("neither is clearly better", "neither is better"))
    assert json.loads(deepbots("resume", group, "--json").out)["training"]["skipped"] == [0, 2]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ("train cartpole --seeds 0,1 --view", "--view shows a single run; leave out --seeds"),
        ("transfer run --log log.mcap --seed 1", "with the simulation of one run; leave out --seed"),
    ],
)
def test_an_option_without_an_effect_is_refused(deepbots: Deepbots, arguments: str, reason: str) -> None:
    assert reason in deepbots(*arguments.split(), code=2).err


@pytest.mark.parametrize("verb", ["eval", "compare"])
def test_a_damaged_run_and_one_of_a_newer_version_are_refused_in_one_sentence(
    deepbots, trained, tmp_path, verb
):
    words = ("mine",) if verb == "eval" else ("mine", "mine2")
    shutil.copytree("mine", "mine2")
    record = json.loads((tmp_path / "mine" / "run.json").read_text())
    for changed, message in (
        (json.dumps(record | {"format": record["format"] + 1}), "but this version of deepbots reads format"),
        (
            json.dumps(record | {"seed": "zero"}),
            "mine/run.json is damaged: 'seed': Expected `int`, got `str`",
        ),
        ("", "mine/run.json is damaged: it is not valid JSON"),
    ):
        (tmp_path / "mine" / "run.json").write_text(changed)
        ran = deepbots(verb, *words, code=2)
        assert ran.err.count("\n") == 1
        assert message in ran.err


def test_a_run_is_not_evaluated_in_a_scenario_that_does_not_fit(deepbots, trained, tmp_path):
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    fitting = (tmp_path / "cartpole.yaml").read_text()
    deepbots("eval", "mine", "--scenario", "cartpole.yaml", "--episodes", "1")
    (tmp_path / "cartpole.yaml").write_text(fitting.replace("-0.8 .. 0.8 m/s", "-0.9 .. 0.9 m/s"))
    ran = deepbots("eval", "mine", "--scenario", "cartpole.yaml", code=2)
    assert "observation.speed" in ran.err
    assert "0.9" in ran.err


def test_an_evaluation_elsewhere_says_where_and_whether_that_is_another_world(deepbots, trained, tmp_path):
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    text = (tmp_path / "cartpole.yaml").read_text().replace("world:\n", "world:\n  engine: mujoco\n")
    (tmp_path / "cartpole.yaml").write_text(text)
    (tmp_path / "wider.yaml").write_text(text.replace("track:       0.39 m", "track:       0.42 m"))
    assert (
        "cartpole.yaml, with the same episodes as the training\n"
        in deepbots("eval", "mine", "--scenario", "cartpole.yaml", "--episodes", "1").out
    )
    assert (
        "wider.yaml, different from the training\n"
        in deepbots("eval", "mine", "--scenario", "wider.yaml", "--episodes", "1").out
    )
    assert "of the training" not in deepbots("eval", "mine", "--episodes", "1").out


def test_a_run_is_evaluated_under_other_settings(deepbots, trained):
    sharp = json.loads(deepbots("eval", "mine", "--set", "fall_angle=3 deg", "--json").out)
    usual = json.loads(deepbots("eval", "mine", "--json").out)
    assert (sharp["set"], usual["set"]) == (["fall_angle=3 deg"], [])
    assert sharp["episodes"] == usual["episodes"] == 4  # as --set said when it was trained
    assert sharp["mean_length"] < usual["mean_length"]
    assert (
        "of the run --set 'fall_angle=3 deg', different from the training"
        in deepbots("eval", "mine", "--set", "fall_angle=3 deg").out
    )


def test_a_requirement_met_by_a_changed_criterion_names_the_change_in_every_format(
    deepbots, trained, tmp_path
):
    changed = ("--set", "solved=mean_return >= 1 over 4 episodes", "--min-return", "0")
    ran = deepbots("eval", "mine", *changed, "--require-solved", "--junit", "gate.xml", "--csv", "gate.csv")
    remarks = "(--set 'solved=mean_return >= 1 over 4 episodes')"
    assert ran.out.splitlines()[0].startswith("solved: ")
    assert ran.out.splitlines()[0].endswith(remarks)
    suite = ElementTree.parse(tmp_path / "gate.xml").getroot()
    assert [case.get("name") for case in suite.iter("testcase")] == [
        f"the task is solved {remarks}",
        f"mean return of at least 0 {remarks}",
    ]
    named = {entry.get("name"): entry.get("value") for entry in suite.iter("property")}
    assert (named["run"], named["scenario"]) == ("mine", "CartPole")
    assert named["set"] == "solved=mean_return >= 1 over 4 episodes"
    with (tmp_path / "gate.csv").open(newline="") as stream:
        row = next(csv.DictReader(stream))
    assert (row["run"], row["set"]) == ("mine", "solved=mean_return >= 1 over 4 episodes")
    assert row["remarks"] == f"'{remarks[1:-1]}"  # which no spreadsheet reads as a formula
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    deepbots(
        "eval",
        "mine",
        "--scenario",
        "cartpole.yaml",
        "--min-return",
        "0",
        "--episodes",
        "3",
        "--junit",
        "other.xml",
    )
    suite = ElementTree.parse(tmp_path / "other.xml").getroot()
    assert suite.find("testcase").get("name") == "mean return of at least 0 (scenario cartpole.yaml)"
    assert json.loads(deepbots("runs", ".", "--json").out)[0]["solved"] is not True


def test_an_evaluation_of_too_few_episodes_names_the_number_that_solved_needs(deepbots, trained):
    ran = deepbots("eval", "mine", "--episodes", "1")
    assert "only 1 was evaluated; evaluate with `--episodes 4`" in ran.out
    assert re.search(r"episodes +1 held-out start from evaluation seed", ran.out)
    assert "a single episode shows no effect" in deepbots("eval", "mine", "--episodes", "1", "--details").out


def test_an_evaluation_has_as_many_episodes_as_solved_asks_for(deepbots, trained):
    more = json.loads(
        deepbots("eval", "mine", "--set", "solved=mean_return >= 1 over 6 episodes", "--json").out
    )
    assert more["episodes"] == 6
    assert more["solved"] is True


def test_a_requirement_is_judged_by_as_many_episodes_as_solved_asks_for(deepbots, trained):
    """The first `evaluation.episodes`, here 4 of 9, decided it."""
    solved = ("--set", "solved=mean_return >= 1 over 9 episodes", "--json")
    mean = json.loads(deepbots("eval", "mine", *solved).out)["mean_return"]
    ran = deepbots("eval", "mine", *solved, "--min-return", mean - 1e-6)
    assert (ran.code, json.loads(ran.out)["episodes"]) == (0, 9)
    ran = deepbots("eval", "mine", *solved, "--min-return", mean + 1e-6, code=1)
    assert "not met: mean return of at least" in ran.err


def test_a_requirement_that_the_scenario_does_not_define_names_those_that_it_does(
    deepbots, trained, tmp_path
):
    ran = deepbots("eval", "mine", "--min-success", "0.5", code=2)
    assert "CartPole defines no success; use --min-return or --require-solved, or add" in ran.err
    kept = tmp_path / "mine" / "resolved.yaml"
    kept.write_text(re.sub(r"(?m)^solved:.*\n", "", kept.read_text()))
    ran = deepbots("eval", "mine", "--min-success", "0.5", code=2)
    assert "CartPole defines no success; use --min-return, or add" in ran.err
    ran = deepbots("eval", "mine", "--require-solved", code=2)
    assert "CartPole has no `solved` criterion; use --min-return, or add" in ran.err


def test_a_training_whose_evaluation_fails_is_solved_nowhere(deepbots, trained, tmp_path):
    record = json.loads((tmp_path / "mine" / "run.json").read_text())
    at = {
        "episode": 3,
        "steps": 90,
        "simulated_hours": 0.1,
        "cpu_seconds": 1.0,
        "mean_return": 200.0,
        "success_rate": 0.0,
    }
    record["result"]["solved_at"] = at
    (tmp_path / "mine" / "run.json").write_text(json.dumps(record))
    kept = tmp_path / "mine" / "evaluations" / "0001.json"
    kept.write_text(json.dumps(json.loads(kept.read_text()) | {"solved": False}))
    assert json.loads(deepbots("runs", ".", "--json").out)[0]["solved"] is False
    assert json.loads(deepbots("inspect", "mine", "--json").out)["run"]["solved"] == "no"
    assert run_verdict(tmp_path / "mine", RunRecord.read(tmp_path / "mine")).text.endswith("; not solved")


@pytest.mark.slow
def test_engines_are_compared_from_the_same_starts(deepbots, trained):
    pytest.importorskip("pybullet")
    report = json.loads(deepbots("eval", "mine", "--engine", "pybullet,mujoco", "--json").out)
    first, second = report["evaluations"]
    assert ((first["engine"], second["engine"]), first["seed"]) == (("pybullet", "mujoco"), second["seed"])
    (difference,) = report["differences"]
    assert (difference["first"], difference["engine"]) == ("pybullet", "mujoco")
    assert difference["mean_return"]["mean"] == pytest.approx(second["mean_return"] - first["mean_return"])
    low, high = difference["mean_return"]["interval"]
    assert low <= difference["mean_return"]["mean"] <= high
    assert first["return_bounds"] == [1.0, 200.0]
    alone = json.loads(deepbots("eval", "mine", "--engine", "mujoco", "--json").out)
    assert alone["mean_return"] == second["mean_return"]
    output = deepbots("eval", "mine", "--engine", "pybullet,mujoco").out
    assert "trained in mujoco" in output
    assert "mujoco - pybullet" in output


@pytest.fixture
def confirmed(trained, tmp_path):
    """The run as if a confirmation of three episodes had ended its training."""
    path = tmp_path / "mine" / "run.json"
    record = json.loads(path.read_text())
    record["result"] |= {"confirmed_seed": 7, "confirmations": 1}
    record["result"]["best"] |= {"chosen_by": "confirmation", "episodes": 3}
    path.write_text(json.dumps(record))


@pytest.mark.parametrize(("options", "expected"), [((), (7, 3)), (("--episodes", "2"), (0, 2))])
def test_a_confirmed_policy_plays_the_same_starts_in_every_engine(deepbots, confirmed, options, expected):
    pytest.importorskip("pybullet")
    report = json.loads(deepbots("eval", "mine", "--engine", "mujoco,pybullet", *options, "--json").out)
    assert [(result["seed"], result["episodes"]) for result in report["evaluations"]] == [expected] * 2


def test_baselines_have_the_starts_of_a_confirmed_policy_that_a_requirement_stopped(deepbots, confirmed):
    report = json.loads(deepbots("eval", "mine", "--min-return", "1000", "--baselines", "--json", code=1).out)
    assert (report["seed"], report["episodes"]) == (7, 1)
    assert {(baseline["seed"], baseline["episodes"]) for baseline in report["baselines"]} == {(7, 1)}


def test_a_requirement_is_about_all_episodes_of_a_confirmed_policy(deepbots, confirmed):
    ran = deepbots("eval", "mine", "--require-solved", "--min-return", "2", code=1)
    assert "met: mean return of at least 2" in ran.err
    assert "in 3 episodes)" in ran.err


def test_settings_of_an_evaluation_apply_to_the_scenario_that_it_names(deepbots, trained):
    elsewhere = ("--scenario", "cartpole", "--episodes", "2", "--json")
    lengths = [
        json.loads(deepbots("eval", "mine", *elsewhere, *overrides).out)["mean_length"]
        for overrides in ((), ("--set", "fall_angle=3 deg"))
    ]
    assert lengths[1] < lengths[0]


def test_settings_that_change_what_a_policy_sees_are_refused(deepbots, trained):
    assert (
        "observation.x: run -0.4 .. 0.4 m, scenario -1 .. 1 m"
        in deepbots("eval", "mine", "--set", "observation.x=-1 .. 1 m", code=2).err
    )


def test_inspect_shows_what_a_run_is_and_the_scenario_that_it_was_trained_with(deepbots, trained):
    tables = json.loads(deepbots("inspect", "mine", "--json").out)
    run = tables["run"]
    assert (run["status"], run["seed"], run["solved"]) == ("finished", 0, "no")
    assert run["steps"] >= 200 == run["total_timesteps"]
    assert (run["best_model"], tables["training"]["evaluation_episodes"]) == ("mine/models/agent/best.zip", 4)
    assert {row["parameter"]: row["value"] for row in tables["parameters"]}["track"] == "0.39 m"
    assert "abs(cart.pole_angle) > fall_angle" in deepbots("inspect", "mine").out


def test_the_list_distinguishes_runs_of_scenarios_with_the_same_name(deepbots, trained, tmp_path):
    for name in ("one", "same"):
        shutil.copytree(tmp_path / "mine", tmp_path / "runs" / name)
    deepbots(*TINY, "--timesteps", "1", "--set", "fall_angle=3 deg", "--run", "runs/other")
    rows = {row["name"]: row["digest"] for row in json.loads(deepbots("runs", "--json").out)}
    assert rows["one"] == rows["same"] != rows["other"]


def test_the_list_names_the_script_that_teaches(deepbots, trained, tmp_path):
    record = tmp_path / "mine" / "run.json"
    assert "  teacher  " not in deepbots("runs", ".").out
    content = json.loads(record.read_text())
    content["task"]["teacher"] = "by_hand"
    record.write_text(json.dumps(content))
    assert json.loads(deepbots("runs", "mine", "--json").out)["teacher"] == "by_hand"
    assert "  teacher  " in deepbots("runs", ".").out


def test_warnings_about_another_scenario_are_mentioned_with_a_command_that_can_be_pasted(
    deepbots, trained, tmp_path
):
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    text = (tmp_path / "cartpole.yaml").read_text()
    (tmp_path / "my cart.yaml").write_text(
        text.replace("termination:", "signals: {spare: abs(x)}\n\ntermination:")
    )
    assert (
        "1 warning; see: deepbots lint 'my cart.yaml'"
        in deepbots("eval", "mine", "--scenario", "my cart.yaml", "--episodes", "1").err
    )


@pytest.mark.parametrize(
    "words", [["cartpole"], ["--seed", "1"], ["--set", "a=1"], ["--run", "x"], ["--engine", "exact"]]
)
def test_a_resumed_run_takes_no_other_scenario(deepbots, words):
    assert "Usage: deepbots resume" in deepbots("resume", "mine", *words, code=2).err


def read_until_closed(terminal: int) -> bytes:
    try:
        return os.read(terminal, 65_536)
    except OSError:  # how Linux says that the other end is closed
        return b""


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    """A folder with a run, `mine`, that Ctrl-C ended after its first checkpoint, and what it printed;
    standard error is a terminal.

    It is a process, whose start alone takes 4 s of CPU.
    """
    folder = tmp_path_factory.mktemp("interrupted")
    ours, theirs = pty.openpty()
    command = [
        sys.executable,
        "-m",
        "deepbots_cli",
        "train",
        "cartpole",
        "--full",
        "--timesteps",
        "10000000",
        *FAST,
        "--run",
        "mine",
    ]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=theirs, text=True)
    os.close(theirs)
    pieces: list[bytes] = []
    reading = threading.Thread(target=lambda: pieces.extend(iter(lambda: read_until_closed(ours), b"")))
    reading.start()  # a terminal holds 4 KiB, beyond which the training would wait for ever
    deadline = time.monotonic() + 600
    begun = False  # with a checkpoint, and the first progress shown
    while not begun and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
        begun = bool(list((folder / "mine" / "checkpoints").glob("0*"))) and "━".encode() in b"".join(pieces)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    reading.join(timeout=60)
    os.close(ours)
    return folder, Ran(process.returncode, out, b"".join(pieces).decode())


@pytest.mark.slow
def test_a_terminal_gets_a_progress_bar_and_stdout_stays_clean(interrupted):
    _, ran = interrupted
    assert "━" in ran.err
    assert ran.out.startswith("training interrupted\n")
    assert "━" not in ran.out


@pytest.mark.slow
def test_a_terminated_evaluation_ends_like_ctrl_c(trained, tmp_path):
    command = [sys.executable, "-m", "deepbots_cli", "eval", "mine", "--episodes", "100000"]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    time.sleep(6.0)
    process.terminate()
    _, err = process.communicate(timeout=60)
    # An interrupt that passes through exec(), as while torch is imported, makes CPython end itself by SIGINT;
    # a shell reports 130 for both.
    assert process.returncode in (130, -signal.SIGINT)
    assert err.strip() == "interrupted"


def test_ctrl_c_keeps_what_was_learned_and_says_how_to_go_on(interrupted):
    folder, ran = interrupted
    assert ran.code == 130, ran.err
    assert "deepbots resume mine" in ran.out
    assert "Traceback" not in ran.err
    assert (folder / "mine" / "models" / "agent" / "last.zip").exists()
    assert json.loads((folder / "mine" / "run.json").read_text())["status"] == "interrupted"


STEP = "mine/models/agent/step-000000128.zip"


@pytest.mark.slow
def test_a_run_is_compared_with_one_of_its_models(deepbots: Deepbots, trained: Ran) -> None:
    ran = deepbots("compare", "mine", STEP, "--episodes", "2")
    assert "mine (step-000000128)" in ran.out
    assert "after_steps" in ran.out
    report = json.loads(deepbots("compare", "mine", STEP, "--episodes", "2", "--json").out)
    assert [group["runs"][0]["model_steps"] for group in report["groups"]] == [256, 128]


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("eval", STEP, "--episodes", "1"),
        ("diagnose", STEP, "--episode", "0"),
        ("render", STEP, "-o", "one.mcap", "--steps", "2"),
        ("inspect", STEP),
        ("diff", STEP, "mine"),
        (*TINY, "--initialize-from", STEP, "--run", "other"),
    ],
)
def test_every_command_that_takes_a_policy_takes_a_checkpoint(
    deepbots: Deepbots, trained: Ran, words: tuple[str, ...]
) -> None:
    deepbots(*words)


@pytest.mark.slow
def test_robustness_of_a_checkpoint_is_that_of_the_checkpoint(deepbots: Deepbots, trained: Ran) -> None:
    report = json.loads(deepbots("robustness", STEP, "--episodes", "1", "--json", code=1).out)
    assert (report["nominal"]["model"], report["nominal"]["model_steps"]) == ("step-000000128", 128)


MESH = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MESHED = """\
deepbots: 1
extends: cartpole
name: Meshed
remove: [solved]
evaluation: {{episodes: 2}}
robots: {{cart: {{urdf: {robot}}}}}
train: {{algorithm: PPO, total_timesteps: 64, environments: 1, n_steps: 32, batch_size: 32, n_epochs: 1}}
"""
# The robot file and the mesh, from the folder of the project, and how the robot file names the mesh.
WAYS = {
    "the folder of the project": ("urdf/r.urdf", "meshes/m.obj", "package://arms/meshes/m.obj"),
    "a folder above the project": ("urdf/r.urdf", "meshes/m.obj", "package://home/arms/meshes/m.obj"),
    "a folder of --allow-path": ("../other/urdf/r.urdf", "../other/m.obj", "package://other/m.obj"),
    "a folder in that of --allow-path": ("../other/a/b/r.urdf", "../other/a/m.obj", "package://a/m.obj"),
    "below the robot file": ("urdf/r.urdf", "urdf/x/meshes/m.obj", "package://x/meshes/m.obj"),
    "two folders of --allow-path": ("../other/r.urdf", "../far/m.obj", "../far/m.obj"),
    "a sibling of the folder of the robot file": ("urdf/r.urdf", "meshes/m.obj", "../meshes/m.obj"),
    "another way round": ("urdf/r.urdf", "urdf/m.obj", "../urdf/./m.obj"),
    "where PyBullet looks above": ("a/urdf/r.urdf", "meshes/m.obj", "meshes/m.obj"),
    "three slashes": ("urdf/r.urdf", "meshes/m.obj", "file://{home}/meshes/m.obj"),
    "an absolute path": ("urdf/r.urdf", "../other/m.obj", "{home}/../other/m.obj"),
    "characters of XML": ("urdf/r.urdf", "meshes/a&b's.obj", "package://arms/meshes/a&amp;b&apos;s.obj"),
}


@pytest.fixture
def meshed(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, deepbots: Deepbots
) -> list[str]:
    """A project whose robot names its mesh in the way of the parameter; the options that allow it."""
    home = tmp_path / "home" / "arms"
    robot, mesh, reference = request.param
    text = shipped.robot_path("cartpole").read_text(encoding="utf-8")
    drawn = f"<mesh filename='{reference.format(home=home)}'/>"
    files = {robot: text.replace('<box size="0.20 0.05 0.08"/>', drawn, 1), mesh: MESH, "deepbots.toml": ""}
    for name, content in {**files, "t.yaml": MESHED.format(robot=robot)}.items():
        (home / name).parent.mkdir(parents=True, exist_ok=True)
        (home / name).write_text(content, encoding="utf-8")
    monkeypatch.chdir(home)
    return [f"--allow-path=../{name}" for name in ("other", "far") if (home / ".." / name).is_dir()]


@pytest.mark.parametrize(
    "meshed",
    [
        pytest.param(
            way,
            id=name,
            marks=() if name == "two folders of --allow-path" else pytest.mark.slow,
        )
        for name, way in WAYS.items()
    ],
    indirect=True,
)
def test_a_training_with_meshes_of_other_folders_is_not_lost_at_its_end(
    meshed: list[str], deepbots: Deepbots, tmp_path: Path
):
    folders = tuple(option.partition("=")[2] for option in meshed)
    digest = api.compile("t.yaml", permissions=Permissions(folders)).digest
    assert "DB903" not in deepbots("lint", "t.yaml", "--deep", *meshed, code=None).out
    deepbots("train", "t.yaml", *meshed, "--run", "r")
    home = Path.cwd().rename(tmp_path / "moved")  # nothing but the run is left in its place
    run = Run.open(home / "r")
    assert run.digest == run.record.digest == digest
    deepbots("eval", home / "r", "--episodes", 1)
    deepbots("render", home / "r", "-o", home / "r.png", "--steps", 2)
    deepbots("resume", home / "r", "--timesteps", 128)


@pytest.mark.parametrize("meshed", [WAYS["the folder of the project"]], indirect=True)
def test_a_project_of_compile_has_meshes_of_other_folders(meshed: list[str], deepbots: Deepbots):
    deepbots("compile", "t.yaml", "--project", "out")
    Path("meshes/m.obj").unlink()
    assert api.compile("out/resolved.yaml").program is not None


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [(b"", "does not compile: "), (MESH.replace(".1", ".2").encode(), "has changed since it was compiled")],
)
@pytest.mark.parametrize("meshed", [WAYS["the folder of the project"]], indirect=True)
def test_a_training_whose_copy_is_another_scenario_stops_before_its_first_step(
    meshed: list[str], mesh: bytes, reason: str
):
    compiled = api.compile("t.yaml")
    copies = {name: mesh if name.endswith(".obj") else each for name, each in compiled.inputs.items()}
    with pytest.raises(RunError, match=reason):
        train(replace(compiled, inputs=copies), run="r", on_start=lambda path: pytest.fail("has begun"))
    assert not Path("r").exists()


DOCUMENTS = {
    "new": "another --template pit",
    "try": "cartpole --episodes 1 --steps 5",
    "scenarios": "",
    "explain": "DB603",
    "lint": "cartpole",
    "inspect": "mine",
    "test": "cartpole",
    "diff": "mine cartpole",
    "eval": "mine --episodes 3",
    "runs": ".",
    "compare": f"mine {STEP} --episodes 2",
    "diagnose": "mine",
    "render": "cartpole -o a.mcap --steps 5",
    "replay": "a.mcap",
    "report": "mine -o a.html",
    "export": "mine -o bundle",
    "compile": "cartpole",
    "course": "",
    "doctor": "",
}
"""Commands that take --json, with arguments of a short call."""
LONG = {
    "train",
    "resume",
    "repeat",
    "tune",
    "apply",
    "robustness",
    "transfer",
    "bench",
    "grade",
    "serve",
    "webots",
}
"""Those that train, evaluate for long or serve, and `apply`, which needs a study."""
OF_TABLES = ("inspect", "diff", "eval", "runs", "compare", "replay")


def numbers_in(data):
    """Yield the numbers of JSON, and those within its texts."""
    if isinstance(data, dict | list):
        for item in data.values() if isinstance(data, dict) else data:
            yield from numbers_in(item)
    elif isinstance(data, str):
        yield from (float(re.sub("[,_]", "", number)) for number in re.findall(r"\d[\d_,]*(?:\.\d+)?", data))
    elif data is not None:
        yield abs(float(data))


@pytest.mark.parametrize("verb", few(DOCUMENTS, ("scenarios", "lint", "inspect", "diff", "eval", "runs")))
def test_json_is_one_document_that_has_the_numbers_of_the_table(deepbots, trained, verb):
    words = DOCUMENTS[verb].split()
    if verb == "replay":
        deepbots("render", *DOCUMENTS["render"].split())
    numbers = {
        95.0,
        *numbers_in(json.loads(deepbots(verb, *words, "--json", code=None).out)),
    }  # 95 % intervals
    shown = deepbots(verb, *words, code=None).out if verb in OF_TABLES else ""
    for number, decimals, percent in re.findall(r"(?<![\w.])(\d[\d,]*(?:\.(\d+))?)( ?%)?", shown):
        value, scales = float(number.replace(",", "")), (1, 100) if percent else (1,)
        nearest = min(abs(scale * other - value) for scale in scales for other in numbers)
        assert nearest <= 0.5000001 * 10 ** -len(decimals), f"{number} is not in the JSON"


def test_each_command_with_json_is_tried():
    takes = {
        verb
        for verb in COMMANDS
        if any("--json" in parameter.opts for parameter in Commands().get_command(None, verb).params)
    }
    assert takes == {*DOCUMENTS, *LONG}
