"""Reports show the numbers of the files of the run, in a file that loads nothing.

Explanations of recorded episodes.
"""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("tensorboard")
pytest.importorskip("mcap")


from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.frames import IDENTITY_FRAME
from deepbots_cli.insight.episode import explain, explanation_json
from deepbots_cli.insight.figures import lessons, outline, trajectories
from deepbots_cli.insight.report import Report
from deepbots_cli.insight.trace import Trace, trace_recorded
from deepbots_cli.learning.campaigns.group import GroupRecord
from deepbots_cli.learning.runs.statistics import mean_interval
from deepbots_cli.program.world import WorldModel
from deepbots_cli.robots.model import Box, Capsule, Mesh, Sphere
from deepbots_cli.view import recordings
from deepbots_cli.view.episodes import Showing
from deepbots_cli.view.replay import closing_player
from deepbots_cli.view.training_logs import StageStart
from tests.view.browser import CHROMIUM, browser


@pytest.fixture(scope="module")
def written_report(run, tmp_path_factory):
    """The report of the run without clips, and the folder with its figures."""
    folder = tmp_path_factory.mktemp("reports")
    options = ["--figures", str(folder / "figures"), "--episodes", "3", "--no-clips"]
    assert main(["report", str(run), "-o", str(folder / "report.html"), *options]) == 0
    return folder / "report.html", folder / "figures"


@pytest.fixture(scope="module")
def filmed(run, tmp_path_factory):
    """The report with clips."""
    path = tmp_path_factory.mktemp("filmed") / "report.html"
    assert main(["report", str(run), "-o", str(path), "--episodes", "3"]) == 0
    return path


@pytest.fixture
def group(run, tmp_path) -> Path:
    """Three seeds, of which the second is damaged and the third has no evaluation."""
    folder = tmp_path / "cartpole-seeds-1"
    folder.mkdir()
    for seed in range(3):
        shutil.copytree(run, folder / f"seed-{seed}")
    (folder / "seed-1" / "run.json").write_text("{")
    shutil.rmtree(folder / "seed-2" / "evaluations")
    record = {name: None for name, field in GroupRecord.model_fields.items() if field.is_required()} | {
        "format": 2,
        "deepbots": "0",
        "scenario": "CartPole",
        "source": "cartpole",
        "engine": "pybullet",
        "seeds": [0, 1, 2],
        "stop_when_solved": True,
        "keep_checkpoints": 0,
        "command": [],
        "started": "",
    }
    (folder / "group.json").write_text(json.dumps(record))
    return folder


def test_the_page_shows_the_result_of_the_run_and_loads_nothing(run, written_report):
    text = written_report[0].read_text(encoding="utf-8")
    kept = json.loads((run / "evaluations" / "0001.json").read_text())
    low, high = kept["return_interval"]
    expected = (
        f"mean return {kept['mean_return']:.4g} (95 % interval {low:.4g} .. {high:.4g}; all returns are"
        " equal)"
    )
    assert expected in text
    assert set(re.findall(r'(?:src|srcset|href)="([a-z]+:)', text)) == {"data:"}
    assert not re.search(r"<script|https?://", text.lower())
    assert "deepbots train &#39;&lt;b&gt;cartpole&lt;/b&gt;&#39;" in text
    assert len(text) < 8_000_000


def test_every_figure_is_a_file_too(written_report):
    assert {path.name for path in written_report[1].iterdir()} == {
        "returns.png",
        "endings.png",
        "starts.png",
        "trajectories.png",
    }
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in written_report[1].iterdir())


def test_best_median_and_worst_are_those_of_the_evaluation_and_happen_again(run):
    report = Report.read(run)
    chosen = report.choose_episodes(6)
    assert len(chosen) == 6
    returns = sorted(
        episode["total_return"]
        for episode in json.loads((run / "evaluations" / "0001.json").read_text())["outcomes"]
    )
    assert [each.outcome.total_return for each in chosen if each.label] == [
        returns[-1],
        returns[len(returns) // 2 - 1],
        returns[0],
    ]
    report.repeat_episodes(chosen, lambda done, of: None, clips=False)
    assert report.notes == []  # a return that differs now would be noted
    assert report.moving.parts == (("cart", "body"),)
    assert [len(each.positions["cart", "body"]) - 1 for each in report.episodes] == [
        each.outcome.length for each in chosen
    ]


def test_of_two_episodes_the_second_is_the_worst(run):
    (shown,) = Report.read(run).runs
    evaluation = shown.evaluation.model_copy(update={"outcomes": shown.evaluation.outcomes[:2]})
    report = Report(run, [replace(shown, evaluation=evaluation)])
    assert [episode.label for episode in report.choose_episodes()] == ["best", "worst"]


def test_the_stages_of_a_curriculum_are_listed_with_their_last_evaluation(run):
    report = Report.read(run)
    assert report.stages == []
    (log,) = (member.log for member in report.runs)
    log.stages = [StageStart("wide", 0.0), StageStart("usual", 4096.0)]
    log.evaluation_stages = ["wide", "wide"]
    log.evaluations = np.array([2000.0, 4000.0]), np.array([20.0, 35.5])
    assert [row[1:] for row in report.stages] == [("wide", "0", "", "35.5"), ("usual", "4,096", "", "")]


@pytest.mark.slow
def test_the_script_that_taught_the_policy_is_named_with_its_score_and_drawn(run):
    report = Report.read(run)
    (log,) = (member.log for member in report.runs)
    assert report.teacher == ""
    assert lessons([log], "light") is None
    log.teacher = "by_hand"
    assert report.teacher == "The script by_hand taught the policy."  # before its score was logged
    at = np.array([100.0, 200.0])
    log.lessons = {
        "success_rate": (at, np.array([0.9, 0.95])),
        "mean_return": (at, np.array([7.0, 7.25])),
        "agreement": (at, at / 400.0),
    }
    assert report.teacher.endswith(
        "the evaluations during the training: success rate 95.0%, mean return 7.25."
    )
    drawn = {name: figure for name, _, figure in report.figures("light")}
    assert [line.get_label() for line in drawn["returns"].axes[0].lines][-1] == "teacher by_hand"
    assert [line.get_label() for line in drawn["teacher"].axes[0].lines] == ["agreement"]
    assert report.teacher in report.html()


def panels(run: Path, points: list[list[float]], *fixed: Any, world: WorldModel | None = None) -> Any:
    """The panels of the trajectory of one episode, in which the body of the cart moves along these points."""
    report = Report.read(run)
    report.repeat_episodes(report.choose_episodes(3)[:1], lambda done, of: None, clips=False)
    report.episodes[0].positions = {("cart", "body"): np.array(points)}
    own = report.runs[0].run.program.world
    return trajectories(report.episodes, report.moving, world or own, fixed, "light").axes


def test_a_closed_line_is_drawn_closed(run):
    world = api.compile(api.load("line_follower")).program.world
    (panel,) = panels(run, [[0.0, 0.0, 0.0], [0.3, 0.2, 0.0]], world=world)
    drawn = [line.get_xydata().tolist() for line in panel.lines]
    (points,) = (line.points for line in world.lines)
    assert [list(point) for point in (*points, points[0])] in drawn


def test_a_motion_along_a_line_is_drawn_over_time(run):
    """That of a cart was a zigzag in 7 mm."""
    (panel,) = panels(run, [[0.0, 0.0, 0.1], [0.3, 0.001, 0.1], [0.1, 0.002, 0.1]])
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("time, s", "x, m")
    assert [0.032, 0.3] in panel.lines[0].get_xydata().tolist()


def test_an_object_that_reaches_into_the_picture_is_whole(run):
    """A parking bay was cut off."""
    bay = [(0.09, 0.05, 0.0), (0.18, 0.05, 0.0), (0.18, 0.1, 0.0), (0.09, 0.1, 0.0)]
    (panel,) = panels(run, [[0.0, 0.0, 0.1], [0.1, 0.1, 0.1]], bay)
    assert panel.get_xlim()[0] < 0.0
    assert panel.get_xlim()[1] > 0.18


def test_a_trajectory_that_climbs_is_drawn_from_the_side_too(run):
    above, side = panels(run, [[0.0, 0.0, 0.0], [0.05, 0.1, 0.15], [0.1, 0.2, 0.3]])
    assert (side.get_xlabel(), side.get_ylabel(), above.get_xlabel()) == ("y, m", "z, m", "x, m")
    assert [0.2, 0.3] in side.lines[0].get_xydata().tolist()


def test_a_return_that_is_another_one_now_is_noted(run):
    report = Report.read(run)
    (episode,) = report.choose_episodes(3)[:1]
    outcomes = [*episode.shown.evaluation.outcomes]
    outcomes[episode.number] = replace(episode.outcome, total_return=99.0)
    evaluation = episode.shown.evaluation.model_copy(update={"outcomes": tuple(outcomes)})
    report.runs = [replace(episode.shown, evaluation=evaluation)]
    report.repeat_episodes(report.choose_episodes(3)[:1], lambda done, of: None, clips=False)
    assert "99 in the evaluation" in report.notes[0]


def test_a_group_leaves_damaged_seeds_out_and_says_so(group):
    report = Report.read(group)
    assert (len(report.runs), [note[:20] for note in report.notes]) == (
        1,
        ["seed 1 is left out: ", "seed 2 is left out: "],
    )
    assert "deepbots eval" in report.notes[1]
    assert "1 seed with 12 held-out episodes" in report.result
    assert "success" not in report.result  # the scenario defines none


def test_the_interval_of_a_group_is_over_its_seeds_and_within_the_possible_returns(group, run):
    for seed in (1, 2):
        shutil.rmtree(group / f"seed-{seed}")
        shutil.copytree(run, group / f"seed-{seed}")
    path = group / "seed-1" / "evaluations" / "0001.json"
    kept = json.loads(path.read_text())
    path.write_text(json.dumps(kept | {"mean_return": kept["mean_return"] + 3.0}))
    values = [kept["mean_return"] + more for more in (0.0, 3.0, 0.0)]
    low, high = mean_interval(values, kept["return_bounds"])
    assert high < mean_interval(values)[1]
    assert (
        f"{kept['mean_return'] + 1:.4g} (95 % interval over seeds {low:.4g} .. {high:.4g})"
        in Report.read(group).result
    )


def test_a_folder_that_cannot_be_reported_is_refused_in_a_sentence(run, tmp_path, deepbots, group):
    copy = Path(shutil.copytree(run, tmp_path / "copy"))
    shutil.rmtree(copy / "evaluations")
    (tmp_path / "empty").mkdir()
    shutil.rmtree(group / "seed-0")
    for folder, message in (
        (
            copy,
            "contains no evaluation of its best model after the training; create one with: deepbots eval"
            f" {copy}",
        ),
        (tmp_path / "empty", "is not a run"),
        (group, "contains no run that can be reported; seed 0 is left out"),
    ):
        err = deepbots("report", folder, "-o", tmp_path / "x.html", code=2).err
        assert message in err
        assert err.count("\n") == 1
    assert not (tmp_path / "x.html").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"outcomes": []}, "0001.json is damaged: 'outcomes'"),
        ({"mean_return": float("nan")}, "0001.json is damaged: it is not valid JSON"),
        ({"total_return": 1e300}, "0001.json is damaged: 'outcomes[3].total_return'"),
        (
            {"drawn": {"mass": "heavy"}},
            "0001.json is damaged: 'outcomes': Value error, a drawn value is a number in one episode and a name"
            " in another",
        ),
    ],
)
def test_an_evaluation_that_cannot_be_drawn_is_refused_in_a_sentence(
    run, tmp_path, deepbots, change, message
):
    copy = Path(shutil.copytree(run, tmp_path / "copy"))
    path = copy / "evaluations" / "0001.json"
    evaluation = json.loads(path.read_text())
    for episode in evaluation["outcomes"]:
        episode["drawn"]["mass"] = 1.0
    evaluation["outcomes"][3] |= change
    path.write_text(json.dumps(evaluation | {key: change[key] for key in change if key in evaluation}))
    assert message in deepbots("report", copy, "-o", tmp_path / "x.html", code=2).err


def test_a_quick_evaluation_does_not_replace_the_result_of_a_report(run, tmp_path):
    copy = shutil.copytree(run, tmp_path / "run")
    before = Report.read(copy).result
    kept = json.loads((copy / "evaluations" / "0001.json").read_text())
    quick = kept | {
        "episodes": 3,
        "planned": 3,
        "mean_return": 99.0,
        "solved": True,
        "outcomes": kept["outcomes"][:3],
    }
    (copy / "evaluations" / "0002.json").write_text(json.dumps(quick))
    assert Report.read(copy).result == before
    (copy / "evaluations" / "0001.json").unlink()
    (copy / "evaluations" / "0002.json").write_text(json.dumps(quick | {"planned": 12}))
    assert (
        "over 3 held-out episodes of the model after 256 steps, from evaluation seed 3 (stopped by a requirement after"
        " 3 of 12 episodes)" in Report.read(copy).result
    )


def test_a_place_that_cannot_be_written_to_is_refused_before_anything_runs(
    run, tmp_path, monkeypatch, deepbots
):
    monkeypatch.chdir(tmp_path)
    Path("cartpole.html").write_text("mine")
    Path("x.html").mkdir()
    Path("figures").write_text("")
    for options, message in (
        ([], "cartpole.html already exists; overwrite it with --force"),
        (["-o", "report.pdf"], "must end in .html"),
        (["-o", "x.html"], "it is a directory"),
        (["-o", "y.html", "--figures", "figures"], "is not a directory"),
    ):
        assert message in deepbots("report", run, *options, code=2).err
    assert Path("cartpole.html").read_text() == "mine"


def test_the_outline_of_an_object_is_as_it_stands():
    half = math.sqrt(0.5)
    turned = (0.0, 0.0, math.sin(math.pi / 8), math.cos(math.pi / 8))  # 45 degrees about z
    corners = outline(Box((0.2, 0.6, 0.3)), ((1.0, 2.0, 0.15), turned))
    assert sorted((round(x, 6), round(y, 6)) for x, y, _ in corners) == sorted(
        (round(1.0 + half * (a - b), 6), round(2.0 + half * (a + b), 6))
        for a in (-0.1, 0.1)
        for b in (-0.3, 0.3)
    )


def test_the_outline_of_a_flat_mesh_is_a_line(tmp_path):
    file = tmp_path / "board.obj"
    file.write_text("v 0 -1 0\nv 0 1 0\nv 0 1 1\nv 0 -1 1\nf 1 2 3 4\n")
    mesh = Mesh(str(file), sha256(file.read_bytes()).hexdigest())
    ys = [y for _, y, _ in outline(mesh, IDENTITY_FRAME)]
    assert (min(ys), max(ys)) == (-1.0, 1.0)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
@pytest.mark.parametrize(("shape", "angle"), [(Sphere(0.3), 45), (Capsule(0.3, 0.8), 180)])
def test_the_outline_of_a_round_object_is_a_circle(shape, angle, axis):
    half = math.radians(angle) / 2
    turned = (*(part * math.sin(half) for part in axis), math.cos(half))
    distances = [math.dist(point[:2], (1.0, 2.0)) for point in outline(shape, ((1.0, 2.0, 0.0), turned))]
    assert len(distances) >= 24
    assert distances == pytest.approx([0.3] * len(distances))


def test_the_outline_of_a_lying_capsule_has_its_length():
    lying = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))  # 90 degrees about x
    points = outline(Capsule(0.3, 0.8), ((1.0, 2.0, 0.0), lying))
    sides = [max(ends) - min(ends) for ends in list(zip(*points, strict=True))[:2]]
    assert sides == pytest.approx([0.6, 1.4])


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_browser_shows_everything_and_asks_for_nothing(filmed, scheme):
    with browser() as new_tab:
        tab = new_tab()
        tab.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        tab.call(
            "Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=1, mobile=False
        )
        tab.call("Page.navigate", url=filmed.as_uri())
        tab.wait("document.readyState == 'complete' && document.images.length == 4")
        assert tab.run("[...document.images].every(image => image.naturalWidth > 0)")
        assert tab.run("document.documentElement.scrollWidth") <= 390  # wide parts scroll by themselves
        tab.wait(
            "[...document.querySelectorAll('video')].length == 3 &&"
            " [...document.querySelectorAll('video')].every(v => v.duration > 0.1)"
        )
        ground = tab.run("getComputedStyle(document.body).backgroundColor")
        assert ground == {"light": "rgb(255, 255, 255)", "dark": "rgb(22, 24, 28)"}[scheme]
        assert [address for address in tab.requests if not address.startswith("data:")] == [filmed.as_uri()]
        assert tab.errors == []


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "cartpole.mcap"
    with closing_player(Showing("cartpole"), "random") as world:
        recordings.record(world, path, 3, [0, 1])
    return path


def _traced(path: Path, number: int = 0) -> Trace:
    opened = Showing(str(path)).open()
    return next(trace_recorded(opened, [opened.recording.episode(number)]))


def _played(folder: Path, *overrides: str) -> Trace:
    """An episode of random actions in a changed CartPole, recorded and run again."""
    with closing_player(Showing("cartpole", overrides=overrides), "random") as world:
        recordings.record(world, folder / "one.mcap", 3, [0])
    return _traced(folder / "one.mcap")


def test_every_sentence_has_a_number(recording):
    statements = explain(_traced(recording, 1))
    assert {"ending", "margin", "terms", "choices"} <= {each.cause for each in statements}
    assert all(any(sign.isdigit() for sign in each.text) for each in statements)


def test_endings_with_and_or_and_not(tmp_path):
    """Of a condition with several comparisons, the one that has just become true is named, with `not` taken
    into its sign."""
    ending = "not (abs(x) <= track) or (abs(cart.pole_angle) > fall_angle and step >= 3)"
    trace = _played(tmp_path, f"termination.failure={{over: {ending}}}")
    end = explanation_json(trace, explain(trace))["end"]
    assert end["condition"] == "abs(cart.pole_angle) > fall_angle"
    assert end["bound"] == pytest.approx(math.radians(15))
    assert end["margin"] > 0


def test_an_episode_that_is_another_one_here_is_refused(recording):
    """As if another version had recorded it: the same file, read as if its observations were others."""
    opened = Showing(str(recording)).open()
    first, second = opened.recording.episodes
    swapped = type(first)(first.number, first.seed, [first.steps[0], *second.steps[1:]])
    with pytest.raises(Exception, match="differs from its recording at step 1"):
        list(trace_recorded(opened, [swapped]))


def test_an_argument_that_is_not_an_episode_is_refused_in_a_sentence(recording, tmp_path, capsys):
    data = recording.read_bytes()
    for length in (0.3, 0.9):
        (tmp_path / f"cut{length}.mcap").write_bytes(data[: int(len(data) * length)])
    for words, message in (
        ([tmp_path], "is not a run"),
        (["nothing.mcap"], "no file, folder or shipped scenario"),
        (["nothing.json"], "is missing"),
        ([recording, "--episode", "9"], "contains no episode 9; it contains 0, 1"),
        ([tmp_path / "cut0.3.mcap"], "cut short or damaged"),
        ([tmp_path / "cut0.9.mcap"], "cut short or damaged"),
    ):
        assert main(["diagnose", *map(str, words)]) in (1, 2)
        assert message in capsys.readouterr().err


def test_json_has_the_same_statements(recording, deepbots):
    data = json.loads(deepbots("diagnose", recording, "--json").out)
    assert [each["text"] for each in data["statements"]] == [
        each.text for each in explain(_traced(recording))
    ]
    assert data["end"]["margin"] > 0


@pytest.mark.parametrize(
    ("success", "needed", "value"),
    [
        (
            "time > 0.1 s and abs(cart.pole_angle) < 0.001 deg",
            "abs(cart.pole_angle) < 0.001 deg",
            "deg",
        ),  # time held in the end
        ("abs(x) < 1 m and time > 60 s", "time > 60 s", "s"),
        ("time > 0.1 s and (x > 1 m or tip_speed > 99 m/s)", "x > 1 m", "m"),
    ],
)
def test_the_condition_that_a_missed_success_lacks_is_named_and_not_one_that_held(
    tmp_path, success, needed, value
):
    trace = _played(tmp_path, f"termination.success={{kept: {success}}}")
    assert trace.outcome == "failure"
    (statement,) = [each for each in explain(trace) if each.cause == "nearest"]
    assert f"'kept' requires {needed}; " in statement.text
    assert not statement.evidence["holds"]
    assert statement.evidence["margin"] < 0
    assert f" {value}, at " in statement.text


def test_a_missed_duration_is_explained_by_the_comparisons_inside_it(tmp_path):
    sets = [
        "signals={rest: duration(abs(x) < 1 mm and abs(speed) < 0.001 mm/s)}",
        "termination.success={rested: rest > 0.3 s}",
    ]
    trace = _played(tmp_path, *sets)
    (statement,) = [each for each in explain(trace) if each.cause == "conditions"]
    near, slow = statement.evidence["conditions"]
    assert (near["condition"], near["bound"], near["step"]) == ("abs(x) < 1 mm", pytest.approx(1e-3), 0)
    assert (slow["condition"], slow["bound"]) == ("abs(speed) < 0.001 mm/s", pytest.approx(1e-6))
    assert near["steps"] > 0
    assert "`abs(x) < 1 mm` was true in" in statement.text
    assert " at 0.00 s, threshold 0.001 m" in statement.text


def test_the_time_in_which_a_cost_arose_is_named(tmp_path):
    sets = ["reward={alive: 0.01, late: -1 when step > 5 and step < 9}"]
    trace = _played(tmp_path, *sets)
    (statement,) = [each for each in explain(trace) if each.cause == "concentrated_rewards"]
    begin, end = statement.evidence["spans"]["late"]
    assert end - begin == pytest.approx(3 * trace.program.period)
    assert f"late from {begin:.2f} s to {end:.2f} s" in statement.text
