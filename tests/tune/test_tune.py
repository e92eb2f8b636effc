"""Studies: trials as groups, drivers that are killed or work side by side, pruning, scores, and the best
values in a file."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.campaigns import trials
from deepbots_cli.learning.campaigns.group import Group
from deepbots_cli.learning.campaigns.listing import list_runs, read_listed
from deepbots_cli.learning.campaigns.study import (
    SeedScore,
    Study,
    StudyReporter,
    StudyTrial,
    TrialProgress,
    TrialResult,
    create_study,
)
from deepbots_cli.learning.campaigns.trials import end_trial, next_trial, run_study, score
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.run import RunRecord
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout.source import Source
from tests.commands import Deepbots
from tests.files import written

SCENARIO = """\
deepbots: 1
extends: cartpole
name: Short
parameters: {fall_angle: 3 deg}       # where the pole has fallen
train: {total_timesteps: 256, environments: 1, n_steps: 64, batch_size: 64, n_epochs: 1, learning_rate: 1e-3}   # quick
evaluation: {episodes: 2}
solved: mean_return >= 195 over 5 episodes
world: {engine: mujoco}
tune:
  search: {train.learning_rate: 1e-4 .. 1e-2 :log, fall_angle: 1 deg | 3 deg}
  trials: 2
  seeds: 1
"""

DRIVER = """\
import os, sys
from deepbots_cli.cli.commands import compare, train
from deepbots_cli.learning.campaigns import study, trials
assert "optuna" not in sys.modules

class Killed(study.StudyReporter):
    def update(self, number, progress):
        if (number, progress.seed) == (1, 0) and progress.training.steps > 150:
            os._exit(9)

trials.run_study(study.Study.open(sys.argv[1]), reporter=Killed())
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("scenario") / "short.yaml", SCENARIO)


def new_study(file: Path, folder: Path, *overrides: str, **settings: object) -> Study:
    return create_study(api.load(file, overrides=overrides, tests=True), folder=folder, **settings)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def whole(file: Path, tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A study that one process has finished; not to be changed."""
    study = new_study(file, tmp_path_factory.mktemp("studies") / "whole", prune=False)
    states: list[str] = []

    class Watcher(StudyReporter):
        def begin_trial(self, trial: StudyTrial) -> None:
            states.append(read_listed(study.path).state)

        end_trial = begin_trial

    assert read_listed(study.path).state == "interrupted"
    assert run_study(study, reporter=Watcher())
    assert states == ["training"] * 4
    return study


@pytest.fixture(scope="module")
def killed(file: Path, tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A study whose process was killed in the last trial; not to be changed."""
    study = new_study(file, tmp_path_factory.mktemp("studies") / "killed", prune=False)
    driver = subprocess.run(
        [sys.executable, "-c", DRIVER, str(study.path)], check=False, capture_output=True, text=True
    )
    assert driver.returncode == 9, driver.stderr
    return study


def results(study: Study) -> list[object]:
    return [(trial.number, trial.state, trial.values, trial.score, trial.seeds) for trial in study.trials()]


def weights(study: Study) -> list[str]:
    runs = [run for group in study.runs for run in Group.open(group).runs]
    return [result.weights_digest for run in runs if (result := RunRecord.read(run).result) is not None]


@pytest.mark.slow
def test_a_study_whose_driver_was_killed_continues_to_the_same_trials(
    killed: Study, whole: Study, tmp_path: Path
) -> None:
    study = Study.open(shutil.copytree(killed.path, tmp_path / "killed"))
    assert [trial.state for trial in study.trials()] == ["complete", "running"]
    assert run_study(study)
    assert results(study) == results(whole)
    assert weights(study) == weights(whole)
    assert len(RunRecord.read(study.path / "trial-1" / "seed-0").resumed_at) == 1


@pytest.mark.slow
def test_a_study_that_was_killed_in_its_last_trial_is_listed_as_interrupted(killed: Study) -> None:
    """It was listed as finished, because all trials have a folder."""
    assert read_listed(killed.path).state == "interrupted"


def test_a_study_with_a_failed_trial_without_a_folder_is_listed_as_finished(
    file: Path, tmp_path: Path
) -> None:
    """It was listed as interrupted for ever."""
    study = new_study(file, tmp_path / "study", trials=2, seeds=(0,))
    journal = study.connect()
    for result in (
        TrialResult("complete", tuple(_seeds([0.5]))),
        TrialResult("failed", reason="it diverged"),
    ):
        number = next_trial(study, journal)
        assert number is not None
        end_trial(journal, number, result)
    assert run_study(study)
    assert read_listed(study.path).state == "finished"
    assert main(["resume", str(study.path), "--trials", "2", "-q"]) == 0
    assert read_listed(study.path).state == "finished"


@pytest.mark.parametrize(
    "settings",
    [
        {"seeds": [0, 0]},
        {"seeds": [3, 1, 3]},
        {"seeds": []},
        {"seeds": [-1]},
        {"seeds": range(1001)},
        {"trials": 0},
        {"timesteps": -1},
        {"seed": 2**63},
    ],
    ids=str,
)
def test_a_study_that_could_not_be_opened_is_refused_before_anything_is_written(
    file: Path, tmp_path: Path, settings: dict[str, object]
) -> None:
    """`create_study(seeds=[0, 0])` wrote a study that `Study.open` called damaged."""
    with pytest.raises(UsageError, match="the settings of the trainings do not fit: "):
        new_study(file, tmp_path / "study", **settings)
    assert list(tmp_path.iterdir()) == []


def test_a_study_of_an_older_format_is_refused_with_the_version_that_reads_it(
    whole: Study, tmp_path: Path, deepbots: Deepbots
) -> None:
    study = Path(shutil.copytree(whole.path, tmp_path / "study"))
    for record in (study / "study.json", study / "trial-0" / "group.json"):
        written = json.loads(record.read_text()) | {"format": 1, "deepbots": "0.0.9"}
        record.write_text(json.dumps(written))
    for command, folder in (("resume", study), ("apply", study), ("eval", study / "trial-0")):
        message = deepbots(command, folder, code=2).err
        assert "of format 1, but this version of deepbots reads format 2; use deepbots 0.0.9" in message
    assert read_listed(study).state == "unreadable"
    assert read_listed(study / "trial-0" / "seed-0").state == "finished"


def test_the_report_of_a_study_names_optuna_dashboard(whole: Study, deepbots: Deepbots) -> None:
    assert f"`optuna-dashboard {whole.path / 'journal.log'}`" in deepbots("report", whole.path, code=2).err


@pytest.mark.slow
def test_a_full_disk_ends_tune_with_an_error_and_the_trial_continues_later(
    file: Path, whole: Study, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ended with exit code 0, and the trial was failed for ever."""
    study = new_study(file, tmp_path / "full", prune=False)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(
        resource.RLIMIT_FSIZE, (20_000, before[1])
    )  # which is enough for the journal, and not for a model
    try:
        assert main(["resume", str(study.path), "--quiet"]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "cannot be written: file too large" in capsys.readouterr().err
    assert [trial.state for trial in study.trials()] == ["running"]
    assert run_study(study)
    assert results(study) == results(whole)


@pytest.mark.parametrize(
    ("forge", "message"),
    [
        (os.mkfifo, "is missing, or is not a regular file"),
        (os.mkdir, "is missing, or is not a regular file"),
        (lambda path: None, "is missing, or is not a regular file"),
        (lambda path: path.symlink_to("/etc/passwd"), "is a symbolic link"),
        (lambda path: (path.touch(), os.truncate(path, 10**9)), "is larger than"),
    ],
    ids=["pipe", "folder", "missing", "link", "large"],
)
def test_a_journal_that_deepbots_did_not_write_is_refused_at_once(
    file: Path, tmp_path: Path, forge: Callable[[Path], object], message: str
) -> None:
    """Resuming a study whose journal is a pipe waited for ever."""
    study = new_study(file, tmp_path / "forged")
    journal = study.path / "journal.log"
    journal.unlink()
    forge(journal)
    with pytest.raises(RunError, match=message):
        Study.open(study.path).connect()


@pytest.mark.slow
def test_trials_on_workers_give_the_same_after_a_worker_was_killed(
    file: Path, whole: Study, tmp_path: Path
) -> None:
    from deepbots_cli.cluster import Cluster
    from tests.cluster.test_cluster_workers import workers as pids

    killed: list[int] = []

    class Killer(StudyReporter):
        def update(self, number: int, progress: TrialProgress) -> None:
            if not killed:
                os.kill(pids()[0], signal.SIGKILL)
                killed.append(number)

    study = new_study(file, tmp_path / "workers", prune=False)
    with Cluster(workers=2) as workers:
        assert run_study(study, reporter=Killer(), executor=workers)
    assert killed
    assert results(study) == results(whole)
    assert weights(study) == weights(whole)


def test_the_first_trial_has_the_values_of_the_scenario(whole: Study) -> None:
    assert whole.trials()[0].values == {"train.learning_rate": "0.001", "fall_angle": "3 deg"}


def test_a_trial_is_a_group_and_a_study_is_listed_with_the_values_of_its_trials(whole: Study) -> None:
    (listed,) = (run for run in list_runs(whole.path.parent) if run.path == whole.path)
    assert listed.state == "finished"
    assert listed.planned == 2
    assert len(listed.runs) == 2
    first = read_listed(whole.path / "trial-0")
    assert first.settings == ("train.learning_rate=0.001", "fall_angle=3 deg")
    assert [run.evaluated_episodes for run in first.runs] == [5]
    assert [round(each.score, 9) for each in whole.trials()[0].seeds] == [
        round(score("solved", Solved(5, mean_return=195.0), run.mean_return or 0.0, 0.0, None), 9)
        for run in first.runs
    ]


def test_a_study_is_not_a_run_and_the_message_names_a_trial(whole: Study) -> None:
    with pytest.raises(
        RunError, match=r"is a study of `deepbots tune`.*name one of its trials, such as .*/trial-0"
    ):
        Group.open(whole.path)


def test_a_study_has_one_process_which_takes_each_trial_once_and_first_those_that_were_left(
    file: Path, tmp_path: Path
) -> None:
    study = new_study(file, tmp_path / "study", trials=2)
    journal = study.connect()
    assert [next_trial(study, journal, taken) for taken in ((), (0,), (0, 1))] == [0, 1, None]
    values = [trial.values for trial in study.trials()]
    assert next_trial(study, study.connect()) == 0
    assert [trial.values for trial in study.trials()] == values
    with run_lock(study.path), pytest.raises(UsageError, match="another process writes to"):
        run_study(study)


@pytest.mark.slow
def test_a_trial_that_is_worse_than_the_median_trains_no_further_seed(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trials, "MIN_COMPARED", 1)
    study = new_study(
        file,
        tmp_path / "study",
        'tune={"search": {"fall_angle": "3 deg | 1 deg"}}',
        trials=2,
        seeds=(0, 1),
        objective="mean_return",
        seed=1,
    )
    assert run_study(study)
    by_value = {trial.values["fall_angle"]: trial for trial in study.trials()}
    assert (by_value["3 deg"].state, by_value["1 deg"].state) == ("complete", "pruned")
    assert [run.name for run in Group.open(by_value["1 deg"].path).runs] == ["seed-0"]


def test_a_solved_training_scores_below_any_that_is_not_and_distance_counts() -> None:
    solved = Solved(100, mean_return=195.0)
    ordered = [
        score("solved", solved, mean, 0.0, share)
        for mean, share in [(200, 0.2), (200, 1.0), (194, None), (100, None), (-1e9, None)]
    ]
    assert ordered == sorted(ordered)
    assert ordered[0] == 0.2
    assert ordered[1] == 1.0 < ordered[2]
    assert ordered[3] == pytest.approx(1 + (95 / 195) / (1 + 95 / 195))
    assert ordered[4] < 2.0
    assert score("solved", Solved(100, success_rate=0.5), 0.0, 0.25, None) == pytest.approx(1.25)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--param", "train.lerning_rate=1..2"],
            "--param train.lerning_rate=1..2: unknown key `lerning_rate` in `train`; did you mean",
        ),
        (
            ["--param", "fall_angl=1..2deg"],
            "--param fall_angl=1..2deg: there is no parameter `fall_angl`; did you mean `fall_angle`?",
        ),
        (["--param", "train.gamma=0.9..1.5"], "`1.5` is above the largest allowed value"),
        (["--param", "observation.x=-1..1m | -2..2m"], "changes the interface of the policy"),
        (["--param", "fall_angle"], "write PATH=VALUES"),
        (["--param", "fall_angle=3deg"], "expected a range or choices"),
        (["--objective", "fast"], "there is no objective 'fast'"),
        (["--objective", "success_rate"], "needs a success"),
    ],
)
def test_a_wrong_search_is_refused_in_one_sentence_before_anything_starts(
    file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    deepbots: Deepbots,
    options: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (line,) = deepbots("tune", file, *options, code=2).err.splitlines()
    assert message in line
    assert list(tmp_path.iterdir()) == []


def test_apply_writes_the_best_values_with_a_comment_and_changes_nothing_else(
    whole: Study, tmp_path: Path, deepbots: Deepbots
) -> None:
    best = whole.ranked(whole.trials())[0]
    target = written(tmp_path / "mine.yaml", SCENARIO)
    for _ in range(2):  # a second time replaces the comment
        assert json.loads(deepbots("apply", whole.path, target, "--json").out)["values"] == best.values
    changed = dict(enumerate(target.read_text().splitlines()))
    old = SCENARIO.splitlines()
    assert {number for number, line in changed.items() if line != old[number]} == {3, 4}
    note = f"  # set by whole, trial-{best.number}"
    assert changed[3] == old[3].replace("3 deg", best.values["fall_angle"]) + note
    assert changed[4] == old[4].replace("1e-3", best.values["train.learning_rate"]) + note


def test_apply_adds_keys_that_a_file_inherits(whole: Study, tmp_path: Path) -> None:
    target = written(tmp_path / "mine.yaml", "deepbots: 1\nextends: cartpole\nname: Mine\nparameters: {}")
    assert main(["apply", str(whole.path), str(target)]) == 0
    best = whole.ranked(whole.trials())[0].values
    document = Source.open(target, Permissions()).document()
    assert target.read_text().startswith("deepbots: 1\nextends: cartpole\nname: Mine\nparameters: {")
    assert (
        api.compile(target).digest
        == api.compile("cartpole", overrides=["name=Mine", *map("=".join, best.items())]).digest
    )
    assert document.findings.errors == []


def test_a_shipped_scenario_is_not_changed(whole: Study, deepbots: Deepbots) -> None:
    assert (
        "comes with deepbots; copy it with `deepbots new mine --from cartpole`"
        in deepbots("apply", whole.path, "cartpole", code=2).err
    )


FORGED = (
    "{\n",
    '{"op_code": 9}\n',
    '{"op_code":4,"worker_id":"x","study_id":0}\n',
    "123\n",
    "[]\n",
    "null\n",
    '{"op_code":1e999}\n',
    '{"op_code":' + "9" * 5000 + "}\n",
    "[" * 100_000 + "\n",
    '{"op_code":4,"worker_id":"x","study_id":0,"datetime_start":1e308}\n',
)


@pytest.mark.parametrize("damage", FORGED, ids=lambda text: text[:40].strip())
def test_a_damaged_journal_is_refused_in_one_sentence(file: Path, tmp_path: Path, damage: str) -> None:
    study = new_study(file, tmp_path / "study")
    with (study.path / "journal.log").open("a") as journal:
        journal.write(damage + '{"op_code":4,"worker_id":"x","study_id":0}\n')
    with pytest.raises(
        UsageError,
        match=r"journal.log is damaged, or was not written by deepbots$",
    ):
        study.trials()


NUMBERS = (
    '"score": 1e999',
    '"score": NaN',
    '"score": ' + "9" * 400,
    '"seed": 7',
    '"steps": ' + "9" * 400,
    '"success_rate": "x"',
)


@pytest.mark.parametrize("forged", NUMBERS, ids=lambda text: text[:25])
def test_a_score_that_no_training_has_is_refused_in_one_sentence(
    file: Path, tmp_path: Path, forged: str, deepbots: Deepbots
) -> None:
    study = _study_with_scores(file, tmp_path / "study", [SeedScore(0, 0.5, 100, 5.0, 0.5)])
    journal = study.path / "journal.log"
    name = forged.partition(":")[0]
    text = journal.read_text()
    changed = re.sub(f"{name}:[^,}}]+", forged.replace(": ", ":"), text, count=1)
    assert changed != text
    journal.write_text(changed)
    assert (
        "journal.log is damaged: trial 0 does not fit the study"
        in deepbots("resume", study.path, "-q", code=2).err
    )


@pytest.mark.parametrize("rest", [-1, -40, 0.5, "\0\0\0\0"])
def test_a_last_line_that_a_crash_cut_loses_no_trial(file: Path, tmp_path: Path, rest: float | str) -> None:
    """The study was lost: the next line was written behind the piece, and the whole journal was refused."""
    study = _study_with_scores(
        file, tmp_path / "study", *[[SeedScore(0, value, 100, 5.0, 0.5)] for value in (0.5, 0.4)]
    )
    path = study.path / "journal.log"
    text = path.read_text()
    last = text.splitlines(keepends=True)[-1]
    cut = rest if isinstance(rest, str) else last[: int(rest) if rest < 0 else int(rest * len(last))]
    path.write_text(text.removesuffix(last) + cut)
    journal = study.connect(to_write=True)
    assert [trial.state for trial in study.trials(journal)] == ["complete", "running"]
    assert next_trial(study, journal) == 1
    end_trial(journal, 1, TrialResult("complete", (SeedScore(0, 0.3, 100, 5.0, 0.5),)))
    assert [trial.score for trial in study.trials()] == [0.5, 0.3]


def test_reading_a_study_does_not_write_to_it(file: Path, tmp_path: Path) -> None:
    study = _study_with_scores(file, tmp_path / "study", [SeedScore(0, 0.5, 100, 5.0, 0.5)])
    before = (study.path / "journal.log").read_bytes()
    (study.path / "journal.log").write_bytes(before[:-1])
    study.trials()
    assert (study.path / "journal.log").read_bytes() == before[:-1]


def _study_with_scores(file: Path, path: Path, *trials: Sequence[SeedScore]) -> Study:
    """A study whose trials have these scores; nothing was trained."""
    study = new_study(file, path, trials=len(trials), seeds=tuple(range(len(trials[0]))))
    journal = study.connect()
    for number, scores in enumerate(trials):
        assert next_trial(study, journal) == number
        end_trial(journal, number, TrialResult("complete", tuple(scores)))
    return study


def _seeds(scores: Sequence[float], mean_return: float = 0.0, success_rate: float = 0.0) -> list[SeedScore]:
    return [SeedScore(seed, value, None, mean_return, success_rate) for seed, value in enumerate(scores)]


def test_where_no_trial_has_a_success_the_higher_return_is_the_best_and_apply_is_not_advised(
    file: Path, tmp_path: Path, deepbots: Deepbots
) -> None:
    trials = [_seeds([1.5] * 3, mean_return=value) for value in (10.0, 30.0, 20.0)]
    study = _study_with_scores(file, tmp_path / "study", *trials)
    assert [trial.number for trial in study.ranked(study.trials())] == [1, 2, 0]
    text = (ran := deepbots("resume", study.path, "-q")).out + ran.err
    assert (
        "best: trial 1, score 1.5; 2 other trials have this score, and the success rate, then the return"
        " chose the best one" in text
    )
    assert "not clearly better than the values of the scenario itself (trial 0, score 1.5)" in text
    assert "deepbots apply" not in text
    assert "deepbots train" not in text


def test_of_equal_scores_the_success_rate_comes_before_the_return(file: Path, tmp_path: Path) -> None:
    study = _study_with_scores(file, tmp_path / "study", _seeds([1.5], 90.0, 0.1), _seeds([1.5], 10.0, 0.2))
    assert [trial.number for trial in study.ranked(study.trials())] == [1, 0]


def test_unsolved_seeds_score_by_their_mean_success_rate() -> None:
    solved = Solved(100, success_rate=0.9)
    means = [
        sum(score("solved", solved, 0.0, rate, None) for rate in rates) / 2
        for rates in ((0.0, 0.8), (0.4, 0.4), (0.3, 0.4))
    ]
    assert means[0] == pytest.approx(means[1])
    assert means[2] > means[1]


def test_apply_is_advised_where_the_best_trial_is_clearly_better_than_the_values_of_the_scenario(
    file: Path, tmp_path: Path, deepbots: Deepbots
) -> None:
    study = _study_with_scores(file, tmp_path / "study", _seeds([0.9, 0.92, 0.88]), _seeds([0.3, 0.32, 0.28]))
    text = (ran := deepbots("resume", study.path, "-q")).out + ran.err
    assert "it is clearly better than the values of the scenario itself (trial 0, score 0.9)" in text
    assert f"deepbots apply {study.path}" in text


def test_the_luckiest_of_many_trials_is_not_clearly_better(
    file: Path, tmp_path: Path, deepbots: Deepbots
) -> None:
    scores = [[0.8, 0.9, 0.7], *([0.6, 0.95, 0.8] for _ in range(18)), [0.7, 0.6, 0.5]]
    study = _study_with_scores(file, tmp_path / "study", *map(_seeds, scores))
    over_first = json.loads(deepbots("resume", study.path, "-q", "--json").out)["over_first"]
    assert over_first["is_clear"] is False
    assert over_first["difference"]["mean"] == pytest.approx(-0.2)


def test_a_trial_with_one_seed_is_never_clearly_better(
    file: Path, tmp_path: Path, deepbots: Deepbots
) -> None:
    study = _study_with_scores(file, tmp_path / "study", _seeds([0.9]), _seeds([0.1]))
    text = (ran := deepbots("resume", study.path, "-q")).out + ran.err
    assert "one seed, or a few with equal scores, do not show it" in text
    assert "deepbots apply" not in text


@pytest.mark.parametrize("sizes", ["16 .. 1024", "64 .. 16384"])
def test_a_key_of_whole_numbers_is_searched_in_whole_numbers(tmp_path: Path, sizes: str) -> None:
    file = written(
        tmp_path / "a.yaml",
        f"deepbots: 1\nextends: cartpole\nname: A\ntune: {{search: {{train.batch_size: {sizes} :log}}}}\n",
    )
    assert api.load(file).search["train.batch_size"].whole
