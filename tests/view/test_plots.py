"""Pictures, clips, plots and pictures.

* Plots of trainings, by the data of their lines.
* Pictures and clips: by their pixels, and read back.
* Trajectories of the bodies that move in an episode and matter to its task.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from contextlib import closing
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.runs.curriculum import CompletedStage
from deepbots_cli.learning.runs.episodes import read_log
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.run import FORMAT, RunRecord, RunResult, TaskRecord, write_record
from deepbots_cli.learning.runs.statistics import Statistic
from deepbots_cli.port import View
from deepbots_cli.robots.kinematics import robot_bounds
from deepbots_cli.rollout import Episode
from deepbots_cli.runtime.overview import overview
from deepbots_cli.view import pictures, plots, training_logs
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.pictures import (
    Viewpoint,
    projection,
    render_picture,
    write_clip,
    write_gif,
)

pytest.importorskip("matplotlib")
pytest.importorskip("tensorboard")


def _events(folder, **scalars):
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.compat.proto.summary_pb2 import Summary
    from tensorboard.summary.writer.event_file_writer import EventFileWriter

    writer = EventFileWriter(str(folder))
    for tag, values in scalars.items():
        for step, value in values:
            writer.add_event(
                Event(
                    step=step,
                    summary=Summary(value=[Summary.Value(tag=tag.replace("__", "/"), simple_value=value)]),
                )
            )
    writer.close()
    return folder


def _run(
    folder,
    digest,
    returns,
    endings=("found", "crashed", "crashed", "crashed"),
    stages=("",) * 4,
    completed=None,
):
    """A run directory as far as it is plotted; `completed` are the steps after which each stage was done."""
    folder.mkdir()
    result = (
        None
        if completed is None
        else RunResult(
            status="finished",
            steps=100,
            total_timesteps=100,
            episodes=4,
            mean_return=0.0,
            success_rate=0.0,
            simulated_hours=0.1,
            evaluation_steps=0,
            solved_at=None,
            cpu_seconds=1.0,
            wall_seconds=1.0,
            weights_digest="",
            stage=stages[-1],
            stages=tuple(CompletedStage(name, steps, 1, 0.5) for name, steps in completed.items()),
        )
    )
    record = RunRecord(
        format=FORMAT,
        deepbots="0",
        status="running",
        scenario="FindBall",
        source="",
        digest=digest,
        interface={},
        inputs={},
        engine="pybullet",
        seed=0,
        seeds={},
        total_timesteps=100,
        stop_when_solved=False,
        first_stage=None,
        keep_checkpoints=0,
        initialized_from=None,
        command=(),
        versions={},
        platform="",
        started="",
        updated="",
        resumed_at=(),
        result=result,
        task=TaskRecord(defines_success=True, solved=None, teacher=None),
    )
    write_record(folder, record)
    each = enumerate(zip(returns, endings, stages, strict=True), 1)
    rows = [f"{r},10,0.1,{n},{10 * n},0.1,{int(e == 'found')},{e},{s}" for n, (r, e, s) in each]
    head = "r,l,t,episode,steps,simulated_hours,is_success,ended_by,stage"
    (folder / "monitor.csv").write_text(
        "\n".join(['#{"t_start": 0}', head, *rows]) + "\n7,1"
    )  # the last line is being written
    (folder / "evaluations").mkdir()
    evaluation = {"steps": 30, "returns": [1.0, 3.0], "successes": [False, True]} | (
        {"stage": stages[2]} if stages[2] else {}
    )
    (folder / "evaluations" / "training.jsonl").write_text(json.dumps(evaluation) + "\n")
    _events(folder / "tensorboard", reward__closer=[(10, 1.0), (40, 4.0)])


@pytest.fixture
def runs(tmp_path):
    for name, digest, returns in (
        ("a0", "x", [0, 2, 4, 6]),
        ("a1", "x", [2, 4, 6, 8]),
        ("b0", "y", [5, 5, 5, 5]),
    ):
        _run(tmp_path / name, digest, returns)
    return tmp_path


def test_curves_are_means_over_the_window_and_the_band_holds_all_seeds(runs):
    logs = training_logs.read_logs([runs], window=2)
    assert [log.name for log in logs] == ["a0", "a0", "b0"]
    steps, values = logs[0].returns
    assert (list(steps), list(values)) == ([10, 20, 30, 40], [0, 1, 3, 5])
    assert [tuple(map(float, axis)) for axis in logs[0].evaluations] == [(30.0,), (2.0,)]
    figure = plots.plot(logs)
    lines = {line.get_label(): line.get_data() for line in figure.axes[0].lines}
    at, mean = lines["a0 (2 seeds)"]
    assert np.interp([10, 20, 30, 40], at, mean) == pytest.approx([1, 2, 4, 6], abs=0.02)
    band = figure.axes[0].collections[0].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == pytest.approx((0, 7))
    assert np.interp(25, *figure.axes[2].lines[0].get_data()) == pytest.approx(2.5, abs=0.02)


def test_a_statistic_over_seeds_has_a_bootstrap_interval_in_the_plot_and_in_the_data(tmp_path):
    for seed in range(8):
        _run(tmp_path / f"a{seed}", "a", [seed, seed, seed, 100.0 if seed == 7 else seed])
    logs = training_logs.read_logs([tmp_path], window=1)
    rows = [row for row in plots.curve_rows(logs, Statistic.iqm) if row["curve"] == "return"]
    assert rows[-1]["value"] == pytest.approx(3.5)
    assert 0 < rows[-1]["low"] < 3.5 < rows[-1]["high"] < 50
    line = plots.plot(logs, statistic=Statistic.iqm).axes[0].lines[0]
    assert line.get_label().endswith("(IQM, 95 % interval of 8 seeds)")
    assert line.get_ydata().tolist() == [row["value"] for row in rows]


def test_a_seed_that_never_succeeds_counts_as_0(tmp_path):
    for name, ending in (("a0", "found"), ("a1", "lost")):
        _run(tmp_path / name, "x", [0, 2, 4, 6], endings=[ending] * 4)
    assert {
        row["value"]
        for row in plots.curve_rows(training_logs.read_logs([tmp_path]))
        if row["curve"] in ("success_rate", "ended_by.found", "ended_by.lost")
    } == {0.5}


def test_groups_with_runs_of_the_same_seeds_are_lines_of_their_own(tmp_path):
    for group, digest in (("slow", "x"), ("fast", "y")):
        (tmp_path / group).mkdir()
        (tmp_path / group / "group.json").write_text("{}")
        for seed in (0, 1):
            _run(tmp_path / group / f"seed-{seed}", digest, [seed, 2, 4, 6])
    figure = plots.plot(training_logs.read_logs([tmp_path / "slow", tmp_path / "fast"]))
    assert [line.get_label() for line in figure.axes[0].get_legend_handles_labels()[0]] == [
        "slow (2 seeds)",
        "fast (2 seeds)",
    ]


def test_runs_of_one_folder_name_are_distinguished_by_their_paths(tmp_path):
    paths = [tmp_path / folder / "run" for folder in ("slow", "fast")]
    for path in paths:
        path.parent.mkdir()
        _run(path, path.parent.name, [0, 2, 4, 6])
    assert [log.name for log in training_logs.read_logs(paths)] == [str(path) for path in paths]


def test_reward_terms_of_scenarios_share_their_scale_and_no_place_is_left_for_unknown_successes(runs):
    _events(runs / "b0" / "tensorboard", reward__closer=[(10, 50.0), (40, 90.0)])
    logs = training_logs.read_logs([runs / "a0", runs / "b0"])
    figure = plots.plot(logs)
    assert figure.axes[2].get_ylim() == figure.axes[4].get_ylim()
    assert figure.axes[2].get_ylim()[1] >= 90.0
    for log in logs:
        log.successes = log.evaluated_successes = None
    assert [axes.get_title(loc="left").split(" ")[0] for axes in plots.plot(logs).axes][:2] == [
        "return",
        "a0:",
    ]


def test_terms_of_scenarios_that_have_none_in_common_have_a_scale_each(runs):
    logs = training_logs.read_logs([runs / "a0", runs / "b0"])
    logs[1].terms = {"found": (np.array([10.0, 40.0]), np.array([50.0, 90.0]))}
    figure = plots.plot(logs)
    assert figure.axes[2].get_ylim()[1] < 10.0 < figure.axes[4].get_ylim()[1]


def test_an_ending_has_one_color_in_a_plot_of_two_runs(tmp_path):
    _run(tmp_path / "a", "x", [0, 2, 4, 6], endings=["found", "crashed", "crashed", "crashed"])
    _run(tmp_path / "b", "y", [0, 2, 4, 6], endings=["crashed", "found", "found", "lost"])
    figure = plots.plot(training_logs.read_logs([tmp_path / "a", tmp_path / "b"]))
    colors = [
        {area.get_label(): tuple(area.get_facecolor()[0]) for area in panel.collections}
        for panel in (figure.axes[3], figure.axes[5])
    ]
    assert (len(set(colors[1].values())), {name: colors[1][name] for name in colors[0]}) == (3, colors[0])


def test_more_endings_than_colors_have_a_color_each(tmp_path):
    names = [f"ending_{number}" for number in range(12)]
    _run(tmp_path / "a", "x", [0.0] * 12, endings=names, stages=[""] * 12)
    assert len(set(plots.ending_colors(training_logs.read_logs([tmp_path / "a"])).values())) == 12


@pytest.mark.slow
def test_a_legend_hides_no_curve_and_leaves_the_figure_nowhere(runs):
    log = runs / "b0" / "monitor.csv"
    log.write_text(log.read_text().replace("crashed", "crashed_" + "into_a_thing_" * 6))
    logs = training_logs.read_logs([runs / "a0", runs / "b0"])
    logs[-1].name = "a folder with a name that is long" * 4
    figure = plots.plot(logs)
    FigureCanvasAgg(figure).draw()
    legends = [(panel, panel.get_legend().get_window_extent()) for panel in figure.axes if panel.get_legend()]
    assert len(legends) == 5
    for panel, box in legends:
        assert box.y1 <= panel.xaxis.get_tightbbox().y0 + 1
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.x1
        assert box.y0 >= 0
        assert not any(box.overlaps(other.get_tightbbox()) for other in figure.axes if other is not panel)


STAGES = ("open", "open", "crowded", "crowded")


@pytest.mark.parametrize(
    ("completed", "begun"), [({"open": 22}, 22.0), (None, 30.0)]
)  # while it trains, the first episode says it
def test_the_stages_of_a_curriculum_are_marked_with_their_names(tmp_path, completed, begun):
    _run(tmp_path / "a", "x", [0, 2, 40, 60], stages=STAGES, completed=completed)
    logs = training_logs.read_logs([tmp_path / "a"])
    assert logs[0].stages == [("open", 0.0), ("crowded", begun)]
    for panel in plots.plot(logs).axes:
        assert [text.get_text() for text in panel.texts] == ["open", "crowded"]
        assert [list(line.get_xdata()) for line in panel.lines].count([begun, begun]) == 1


def test_a_log_with_a_stage_for_each_episode_is_plotted_in_time(tmp_path):
    names = [f"stage_{number}" for number in range(20_000)]
    _run(
        tmp_path / "a",
        "x",
        [0.0] * 20_000,
        endings=["crashed"] * 20_000,
        stages=names,
        completed={"stage_0": 2**63 - 1},
    )
    assert len(training_logs.read_logs([tmp_path / "a"])[0].stages) <= 100


def test_a_curve_does_not_join_the_stages_of_a_curriculum_and_an_evaluation_has_the_mark_of_its_stage(
    tmp_path,
):
    _run(tmp_path / "a", "x", [0, 2, 40, 60], stages=STAGES, completed={"open": 22})
    logs = training_logs.read_logs([tmp_path / "a"])
    assert [list(part) for part in logs[0].returns] == [
        [10, 20, 22, 30, 40],
        pytest.approx([0, 1, np.nan, 40, 50], nan_ok=True),
    ]
    returns, _, terms, endings = plots.plot(logs).axes
    for panel in (returns, terms):
        at, values = panel.lines[0].get_data()
        assert np.isnan(values[at == 22.0]).all()
    assert len(endings.collections[0].get_paths()) == 2
    marks = {line.get_label(): (line.get_marker(), line.get_xydata().tolist()) for line in returns.lines}
    assert marks["evaluations in stage crowded"] == ("s", [[30.0, 2.0]])


def test_a_log_without_endings_has_no_empty_chart_of_them(tmp_path):
    _run(tmp_path / "a", "x", [0, 2, 4, 6])
    (log,) = training_logs.read_logs([tmp_path / "a"])
    log.endings = {}
    titles = [panel.get_title(loc="left") for panel in plots.plot([log]).axes]
    assert [title for title in titles if "endings" in title or not title] == []
    assert any("reward terms" in title for title in titles)


def test_a_stage_whose_name_has_no_room_is_a_number_with_a_key(tmp_path):
    _run(
        tmp_path / "a",
        "x",
        [0, 2, 40, 60],
        stages=("open", "a_narrow_one", "crowded", "crowded"),
        completed={"open": 11, "a_narrow_one": 14},
    )
    panel = plots.plot(training_logs.read_logs([tmp_path / "a"])).axes[0]
    assert [text.get_text() for text in panel.texts] == ["1", "2", "crowded"]
    assert panel.get_xlabel() == "timesteps; stage 1 open, 2 a_narrow_one"


def test_a_wide_panel_has_room_for_a_long_name_of_a_stage(tmp_path):
    long_name = "another_name_of_a_stage_that_is_long"
    _run(tmp_path / "a", "x", [0, 2, 40, 60], stages=("open", "open", long_name, long_name))
    (log,) = training_logs.read_logs([tmp_path / "a"])
    assert [text.get_text() for text in plots.plot([log]).axes[0].texts] == ["open", "2"]
    log.successes = None
    log.evaluated_successes = None
    log.evaluation = None
    assert [text.get_text() for text in plots.plot([log]).axes[0].texts] == ["open", long_name]


@pytest.mark.parametrize(
    ("steps", "covered"),
    [
        (([0, 100], [200, 300]), None),
        (([0, 100], [50, 300]), (50, 100)),
        (([5, 20], [10]), (10, 11)),
        (([10], [5, 20]), (10, 11)),
    ],
)
def test_a_mean_covers_the_timesteps_of_all_curves(steps, covered):
    panel = Figure().subplots()
    plots.plot_band(panel, [(np.array(s, float), np.ones(len(s))) for s in steps], {"color": "red"})
    drawn = panel.lines[0].get_xdata()
    assert (min(drawn), max(drawn)) == covered if covered else not len(drawn)


def _taught(folder, teacher, **scalars):
    record = RunRecord.read(folder)
    task = TaskRecord(defines_success=True, solved=None, teacher=teacher)
    write_record(folder, record.model_copy(update={"task": task}))
    _events(folder / "tensorboard", **{f"teacher__{name}": values for name, values in scalars.items()})


def test_the_score_of_a_teacher_is_a_line_and_its_lessons_have_a_panel(runs):
    _taught(
        runs / "a0",
        "by_hand",
        mean_return=[(10, 7.0), (40, 7.0)],
        success_rate=[(10, 0.75), (40, 0.75)],
        weight=[(10, 1.0), (40, 0.0)],
    )
    returns, successes, lessons, *_ = plots.plot(training_logs.read_logs([runs / "a0"])).axes
    for panel, score in ((returns, 7.0), (successes, 0.75)):
        (line,) = (line for line in panel.lines if line.get_label() == "teacher by_hand")
        assert line.get_xydata().tolist() == [[0, score], [10, score], [40, score]]
    assert lessons.get_title("left") == "teacher by_hand"
    assert [line.get_label() for line in lessons.lines] == ["loss weight"]
    assert lessons.get_subplotspec().colspan == range(2)


def test_trainings_with_a_teacher_have_a_panel_each_beside_one_without(runs):
    _taught(runs / "a0", "by_hand", agreement=[(10, 0.5), (40, 1.0)])
    _taught(runs / "b0", "by_hand", agreement=[(10, 0.5), (40, 1.0)])
    _run(runs / "c0", "z", [1, 2, 3, 4])
    titles = [
        panel.get_title("left")
        for panel in plots.plot(training_logs.read_logs([runs / "a0", runs / "b0", runs / "c0"])).axes
    ]
    assert titles[2:5] == ["a0: teacher by_hand", "b0: teacher by_hand", "a0: reward terms of an episode"]


def test_a_training_that_a_recording_teaches_has_a_line_of_its_own(runs):
    _taught(runs / "a1", "demonstrations.mcap")
    logs = training_logs.read_logs([runs / "a0", runs / "a1"])
    assert [(log.name, log.teacher) for log in logs] == [("a0", None), ("a1", "demonstrations.mcap")]


def test_the_success_rates_of_evaluations_are_dots_too(runs):
    successes = plots.plot(training_logs.read_logs([runs / "a0"])).axes[1]
    assert [line.get_xydata().tolist() for line in successes.lines if line.get_marker() == "o"] == [
        [[30.0, 0.5]]
    ]


def test_endings_are_shares_of_episodes(runs):
    figure = plots.plot(training_logs.read_logs([runs / "a0"]))
    tops = [area.get_paths()[0].vertices[:, 1].max() for area in figure.axes[3].collections]
    assert tops == pytest.approx([0.75, 1.0])
    assert [area.get_label() for area in figure.axes[3].collections] == ["crashed", "found"]


def test_a_part_of_the_training_with_one_episode_is_not_a_spike_of_endings(runs):
    lines = [
        f"1,10,0.1,{n},{n if n < 99 else 900 + n},0.1,{int(n == 99)},{'found' if n == 99 else 'crashed'},"
        for n in range(100)
    ]
    head = "r,l,t,episode,steps,simulated_hours,is_success,ended_by,stage"
    (runs / "a0" / "monitor.csv").write_text("\n".join(['#{"t_start": 0}', head, *lines, ""]))
    areas = plots.plot(training_logs.read_logs([runs / "a0"])).axes[3].collections
    crashed = areas[0].get_paths()[0].vertices[:, 1]
    assert [area.get_label() for area in areas] == ["crashed", "found"]
    assert crashed[crashed > 0].min() == pytest.approx(0.99)


def _evaluated(run, **further):
    episodes = [Episode(3.5, 9, number % 2 == 0, None) for number in range(8)]
    evaluation = EvaluationResult.of_episodes(
        episodes,
        outcomes=episodes,
        evaluated="9",
        model="best",
        seed=0,
        success_defined=True,
        solved=None,
        **further,
    )
    (run / "evaluations" / "0001.json").write_text(evaluation.model_dump_json())
    record = RunRecord.read(run)
    write_record(run, record.model_copy(update={"status": "finished"}).with_evaluation(1, evaluation))


@pytest.mark.parametrize(("further", "at"), [({}, 40), ({"model_steps": 17}, 17)])  # of the best model
def test_an_evaluation_after_the_training_is_a_diamond_at_its_step_and_dots_are_named(runs, further, at):
    figure = plots.plot(training_logs.read_logs([runs / "a0"]))
    assert figure.axes[0].get_title("left") == "return of training episodes; dots: evaluations"
    (runs / "a0" / "evaluations" / "training.jsonl").unlink()
    _evaluated(runs / "a0", **further)
    figure = plots.plot(training_logs.read_logs([runs / "a0"]))
    returns, successes = figure.axes[:2]
    assert returns.get_title("left") == "return of training episodes; diamond: evaluations"
    assert returns.lines[-1].get_xydata().tolist() == [[at, 3.5]]
    assert successes.lines[-1].get_xydata().tolist() == [[at, 0.5]]


def test_files_of_other_programs_are_plotted(tmp_path, deepbots):
    folder = _events(tmp_path / "sb3", rollout__ep_rew_mean=[(0, 1.0), (100, 3.0)])
    for suffix, content in ((".png", b"\x89PNG\r"), (".svg", b">timesteps</text>"), (".pdf", b"/FontFile2")):
        out = tmp_path / f"plot{suffix}"
        deepbots("plot", folder, "--dark", "--output", out)
        assert content in out.read_bytes()
    deepbots("plot", folder, "--output", tmp_path / "plot.csv")
    with (tmp_path / "plot.csv").open(newline="") as file:
        points = [
            (row["curve"], float(row["timesteps"]), float(row["value"])) for row in csv.DictReader(file)
        ]
    assert (points[0], points[-1]) == (("return", 0.0, 1.0), ("return", 100.0, 3.0))
    assert (
        "must end in .png, .svg, .pdf or .csv"
        in deepbots("plot", folder, "--output", tmp_path / "plot.gif", code=2).err
    )


def test_trainings_of_other_programs_are_not_joined_by_a_folder_or_its_name(tmp_path, monkeypatch):
    for value, folder in enumerate(["a/PPO_1", "a/PPO_2", "b/PPO_1"]):
        _events(tmp_path / folder, rollout__ep_rew_mean=[(0, value), (100, value)])
    logs = training_logs.read_logs([tmp_path / "a", tmp_path / "b" / "PPO_1"])
    assert [(log.name, *log.returns[1]) for log in logs] == [
        (str(tmp_path / "a" / "PPO_1"), 0, 0),
        ("PPO_2", 1, 1),
        (str(tmp_path / "b" / "PPO_1"), 2, 2),
    ]
    monkeypatch.chdir(tmp_path / "b" / "PPO_1")
    assert [log.name for log in training_logs.read_logs(["."])] == ["PPO_1"]


def test_runs_that_cannot_be_plotted_are_an_error(tmp_path, runs):
    with pytest.raises(RunError, match="neither a run nor a folder"):
        training_logs.read_logs([tmp_path / "nothing"])
    with pytest.raises(RunError, match="hold none of"):
        training_logs.read_logs([_events(tmp_path / "other", loss=[(0, 1.0)])])
    (runs / "a0" / "monitor.csv").write_text("#{}\nr,l,t\n")
    with pytest.raises(RunError, match="no finished episode"):
        training_logs.read_logs([runs / "a0"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("#{}\na,b\n1,2\n", "is not a log of episodes: the names of its columns must include r, l, t"),
        ("#{}\nr,l,t\n" + "1,1,1\n" * 1_000_001, "has more than 1,000,000 episodes"),
        ("#{}\nr,l,t\n" + "1" * 300_000, "it has a line of more than 262,144 bytes"),
        ('#{}\nr,l,t\n1,1,"' + "1\n" * 100_000, "field larger than field limit"),
    ],
)
def test_a_file_that_is_not_a_log_of_episodes_is_refused_in_a_sentence(tmp_path, text, message):
    (tmp_path / "monitor.csv").write_text(text)
    with pytest.raises(RunError, match=message):
        list(read_log(tmp_path / "monitor.csv"))


def test_names_of_endings_that_are_all_different_are_refused(runs):
    rows = "".join(f"1,10,0.1,{n},{10 * n},0.1,0,{n:09}{'x' * 90},\n" for n in range(1, 11_000))
    log = runs / "a0" / "monitor.csv"
    log.write_text(log.read_text().rpartition("\n")[0] + "\n" + rows)
    with pytest.raises(
        RunError, match="the names of its stages and endings have more than 1,000,000 letters"
    ):
        training_logs.read_logs([runs / "a0"])


def test_evaluations_in_a_training_that_take_gigabytes_are_refused(runs):
    line = json.dumps({"steps": 30, "returns": [1] * 40_000, "successes": [1] * 40_000})
    log = runs / "a0" / "evaluations" / "training.jsonl"
    for text, reason in (
        (f"{line}\n" * 30, "has more than 1,000,000 episodes"),
        (f"{line}\n" * 100, "is larger than 16 MiB"),
        (line.replace("1", "1.0") + "\n", "has a line of more than 262,144 bytes"),
    ):
        log.write_text(text)
        with pytest.raises(RunError, match=reason):
            training_logs.read_logs([runs / "a0"])


@pytest.mark.parametrize("name", ["tags", "values", "broken"])
def test_tensorboard_files_of_many_tags_or_values_are_refused(tmp_path, name):
    """Two megabytes of tags took 480 MB."""
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.summary.writer.record_writer import RecordWriter

    event = Event(step=1)
    for number in range(3_000):
        event.summary.value.add(tag=f"{number * (name == 'tags')}", simple_value=1.0)
    with (tmp_path / "events.out.tfevents.1.x").open("wb") as stream:
        RecordWriter(stream).write(b"\xff" * 9 if name == "broken" else event.SerializeToString())
    message = {"tags": "more than 2,000 tags", "values": "more values than", "broken": "is damaged"}[name]
    with pytest.raises(RunError, match=message):
        training_logs.scalars_of(tmp_path)


def test_a_long_log_is_drawn_by_some_of_its_means(runs):
    rows = "".join(f"{n % 2},10,0.1,{n},{10 * n},0.1,0,found,\n" for n in range(5, 50_000))
    log = runs / "a0" / "monitor.csv"
    log.write_text(log.read_text().rpartition("\n")[0] + "\n" + rows)
    steps, values = training_logs.read_logs([runs / "a0"], window=100)[0].returns
    assert (len(steps), steps[0], steps[-1], values[-1]) == (20_000, 10, 499_990, 0.5)


@pytest.mark.parametrize("steps", ["nan", "inf", "-9"])
def test_a_log_with_impossible_steps_is_damaged(runs, steps):
    log = runs / "a0" / "monitor.csv"
    log.write_text(log.read_text().replace(",40,", f",{steps},"))
    with pytest.raises(RunError, match="one of its logs cannot be read"):
        training_logs.read_logs([runs / "a0"])


@pytest.mark.parametrize(
    "name", ["monitor.csv", "evaluations/training.jsonl", "tensorboard/events.out.tfevents.9"]
)
def test_a_pipe_in_the_place_of_a_log_is_not_opened(runs, name):
    (runs / "a0" / name).unlink(missing_ok=True)
    os.mkfifo(runs / "a0" / name)
    with pytest.raises(RunError, match="not a regular file"):
        training_logs.read_logs([runs / "a0"])


def test_names_of_others_are_text_and_not_formulas(runs, tmp_path):
    log = runs / "a0" / "monitor.csv"
    rows = [f"1,10,0.1,{n},{10 * n},0.1,0,{f'ending {n}' if n > 1 else 'others'}," for n in range(1, 100)]
    log.write_text(log.read_text().replace("crashed", r"$\frac{$") + "\n" + "\n".join(rows) + "\n")
    assert main(["plot", str(runs / "a0"), "--output", str(tmp_path / "plot.png")]) == 0
    labels = plots.plot(training_logs.read_logs([runs / "a0"])).axes[3].get_legend_handles_labels()[1]
    assert len(labels) == 21
    assert {"others", "other endings"} < set(labels)


@pytest.mark.slow
def test_the_settings_of_matplotlib_in_a_strangers_folder_are_not_used(runs, tmp_path):
    """A process of its own, since matplotlib reads them once."""
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\nfigure.dpi: 100000\nnot a key: [\n")
    script = "import sys; from deepbots_cli.cli import main; sys.exit(main(sys.argv[1:]))"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    run = runs / "a0"
    done = subprocess.run(
        [sys.executable, "-c", script, "plot", str(run), "-o", "a.png"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert "matplotlibrc" not in done.stdout + done.stderr
    assert (tmp_path / "a.png").stat().st_size < 1_000_000


def _yellow(image):
    red, green, blue = np.moveaxis(np.asarray(image.convert("RGB")).astype(int), -1, 0)
    return (
        (red > 60) & (green > 0.7 * red) & (blue < 0.6 * red)
    )  # also in the shade, which is darker in MuJoCo


def test_a_point_is_projected_to_where_the_engine_draws_it():
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        player.begin(0, 0)
        view = View((0.9, -1.2, 1.0), (0.1, 0.1, 0.0), 640, 480)
        rows, columns = np.nonzero(
            _yellow(render_picture(player, Viewpoint(640, 480, view.eye, view.target)))
        )
        assert projection(view)(player.frame.links["ball", "ball"][0]) == pytest.approx(
            (columns.mean(), rows.mean()), abs=4
        )
        assert projection(view)((3.0, -6.0, 3.0)) is None


def test_labels_and_rays_are_painted():
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        player.begin(0, 0)
        shots = [
            render_picture(
                player, Viewpoint(400, 300, (-0.5, -0.8, 0.4), (-0.38, -0.38, 0.0)), **{what: True}
            )
            for what in ("labels", "rays")
        ]
        plain = render_picture(player, Viewpoint(400, 300, (-0.5, -0.8, 0.4), (-0.38, -0.38, 0.0)))
    for shot in shots:
        assert np.abs(np.asarray(shot).astype(int) - np.asarray(plain)).max() > 60


def test_a_followed_robot_stays_in_the_middle_and_large(tmp_path):
    shot = Viewpoint(160, 120, follow="epuck")
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        eyes = []
        robot = player.env.world.robots[0]
        write_clip(
            player,
            tmp_path / "clip.gif",
            shot,
            seed=0,
            episode=0,
            seconds=3.0,
            on_frame=lambda frame: eyes.append(
                (frame.links[robot.name, robot.model.root][0], shot.now(player, player.view(160, 120)))
            ),
        )
        whole = player.view(160, 120)
    (first, viewpoint), (last, last_viewpoint) = eyes[0], eyes[-1]
    assert np.linalg.norm(np.subtract(first, last)) > 0.05
    assert np.subtract(last_viewpoint.eye, last) == pytest.approx(np.subtract(viewpoint.eye, first), abs=1e-3)
    assert np.linalg.norm(np.subtract(viewpoint.eye, first)) < 0.7 * np.linalg.norm(
        np.subtract(whole.eye, whole.target)
    )
    with pytest.raises(UsageError, match=r"--follow: there is no robot 'dog'; there is epuck"):
        Viewpoint(follow="dog").now(player, whole)


def test_a_camera_that_is_placed_without_a_target_looks_at_the_robot():
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        *_, frame = player.episode(0, 0, 0)
        robot = player.env.world.robots[0]
        placed = Viewpoint(eye=(0.4, -0.2, 0.3)).now(player, player.view(160, 120))
        assert placed.eye == (0.4, -0.2, 0.3)
        assert placed.target == frame.links[robot.name, robot.model.root][0]


@pytest.mark.parametrize("suffix", [pytest.param(".gif", marks=pytest.mark.slow), ".mp4"])
def test_a_clip_can_be_read_and_moves(tmp_path, suffix):
    out = tmp_path / f"clip{suffix}"
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        last = write_clip(player, out, Viewpoint(160, 120), seed=0, episode=0, seconds=2.0)
    assert last.time == pytest.approx(2.048, abs=0.13)
    if suffix == ".gif":
        with Image.open(out) as image:
            pictures = []
            for number in range(image.n_frames):
                image.seek(number)
                pictures.append(np.asarray(image.convert("RGB")))
    else:
        imageio = pytest.importorskip("imageio.v2")
        pictures = [np.asarray(image) for image in imageio.get_reader(out)]
    assert (len(pictures), pictures[0].shape) == (last.step + 1, (120, 160, 3))
    assert np.abs(pictures[0].astype(int) - pictures[-1]).max() > 60
    assert out.stat().st_size < 100_000


def test_a_gif_keeps_the_color_of_a_small_robot(tmp_path):
    shades = np.random.default_rng(0).integers(0, 256, (1, 160, 1)) * np.array(
        [[[0.9, 0.95, 1.0]]]
    )  # a floor of many shades
    image = np.broadcast_to(shades, (120, 160, 3)).astype(np.uint8).copy()
    image[50:58, 60:68] = (30, 90, 200)
    write_gif(tmp_path / "clip.gif", iter([image, image[::-1]]), 10.0)
    with Image.open(tmp_path / "clip.gif") as clip:
        assert np.abs(np.asarray(clip.convert("RGB")).astype(int)[54, 64] - (30, 90, 200)).max() < 20


@pytest.mark.parametrize("rate", [12.5, 1 / 0.096, 1 / 0.067])
def test_a_gif_is_as_long_as_the_episode(tmp_path, rate):
    shades = np.random.default_rng(0).integers(0, 256, (50, 16, 16, 3), np.uint8)
    write_gif(tmp_path / "clip.gif", iter(shades), rate)
    with Image.open(tmp_path / "clip.gif") as clip:
        pauses = [clip.info["duration"] for number in range(49) if not clip.seek(number)]
    assert sum(pauses) == pytest.approx(49_000 / rate, abs=6)


def test_an_offline_page_ends_as_the_episode_does(tmp_path, monkeypatch):
    scene = pytest.importorskip("deepbots_cli.view.scene")
    set_frame, draw = scene.WorldScene.set_frame, scene.WorldScene.draw
    shown = []

    def spy(world, frame, **options):
        shown.append(frame)
        set_frame(world, frame, **options)

    def drawing(world, share):
        drawn.append(shown[-1])
        draw(world, share)

    drawn = []
    monkeypatch.setattr(scene.WorldScene, "set_frame", spy)
    monkeypatch.setattr(scene.WorldScene, "draw", drawing)
    fast = Showing("cartpole", ("world.timestep=8 ms", "world.substeps=1"))
    with closing(Player(fast.open(), "zero")) as player:
        last = write_clip(player, tmp_path / "clip.html", Viewpoint(), seed=0, episode=0)
    assert last.ended_by == drawn[-1].ended_by == "fallen"


def test_an_offline_page_contains_the_episode(tmp_path):
    pytest.importorskip("viser")
    out = tmp_path / "clip.html"
    with closing(Player(Showing("cartpole").open(), "zero")) as player:
        write_clip(player, out, Viewpoint(), seed=0, episode=0, seconds=1.0)
    text = out.read_text()
    assert "__VISER_EMBED_DATA__" in text
    assert "<title>CartPole</title>" in text
    assert out.stat().st_size < 1_500_000


def test_the_commands_write_their_files_and_refuse_what_they_cannot(tmp_path, deepbots, monkeypatch):
    monkeypatch.chdir(tmp_path)
    deepbots("render", "cartpole", "--size", "120x90", "--output", "a.png")
    with Image.open("a.png") as image:
        assert image.size == (120, 90)
    assert (
        "a.gif" in deepbots("render", "cartpole", "--size", "120x90", "--seconds", "0.3", "-o", "a.gif").out
    )
    deepbots(
        "render", "cartpole", "--size", "120x90", "--seconds", "0.1", "--episodes", "2", "-o", "each.gif"
    )
    assert sorted(path.name for path in tmp_path.glob("each*")) == ["each-0.gif", "each-1.gif"]
    for words, message in (
        (["render", "cartpole", "--last"], "--last chooses a model of a run, but cartpole is not a run"),
        (
            ["render", "cartpole", "-o", "a.jpg"],
            "a.jpg must end in .png, .mp4, .gif, .html or .mcap; the suffix says what is made",
        ),
        (["render", "cartpole", "-o", "none/a.gif"], "no directory"),
        (["render", "cartpole", "--size", "9x9"], "is not a size"),
        (
            ["render", "cartpole", "--size", "333x202", "-o", "odd.mp4"],
            "odd.mp4: an MP4 has an even width and height; write --size 334x202, or name a .gif",
        ),
        (["render", "cartpole", "--from", "1,2"], "is not a point"),
        (
            ["render", "cartpole", "--from", "1,2,1", "--follow", "cart"],
            "--follow moves the camera; leave out --from",
        ),
        (["render", "cartpole", "--from", "nan,0,0"], "not a number"),
        (["render", "cartpole", "--from", "1,1,1", "--at", "1,1,1"], "at the point that it looks at"),
        (["render", "find_ball", "--driver", "nobody", "-o", "b.gif"], "there is no driver 'nobody'"),
        (["render", "cartpole", "--driver", "policy", "-o", "b.gif"], "only a run has a policy"),
        (
            ["render", "cartpole", "--driver", "you", "-o", "b.gif"],
            "you can drive in the browser only; use `deepbots play`",
        ),
        (
            ["render", "cartpole", "--labels", "-o", "b.gif"],
            "b.gif: --labels is for .png; leave it out, or name another file",
        ),
        (
            ["render", "cartpole", "--rays", "--seconds", "1", "-o", "b.mcap"],
            "b.mcap: --rays is for .png; --seconds is for .mp4, .gif, .html; leave them out, or name another"
            " file",
        ),
        (
            ["render", "cartpole", "--episodes", "failed", "-o", "b.gif"],
            "--episodes failed repeats an evaluation of a run",
        ),
        (["render", "epuck", "-o", "b.gif"], "epuck is a robot file"),
        (["render", "epuck", "--seed", "0"], "--seed does not go with a robot file; it takes"),
        (["render", "epuck", "--last"], "--last does not go with a robot file; it takes"),
        (["render", "cartpole", "--size", "9" * 5000 + "x100"], "is not a size"),
    ):
        assert message in " ".join(deepbots(*words, code=2).err.split())


@pytest.fixture(scope="module")
def push():
    """The arm that pushes a block, and its world."""
    program = api.compile(api.load("panda_push")).program
    return program, program.world


def _positions(world, **ways):
    """Positions of all bodies in four steps, of which those in `ways` go so far (m) along x."""
    names = [(robot.name, link.name) for robot in world.robots for link in robot.model.links] + [
        (o.name, o.name) for o in world.objects
    ]
    steps = np.arange(4.0)[:, None] / 3 * np.array([[1.0, 0.0, 0.0]])
    return {part: ways.get(part[1], 0.0) * steps for part in names}


def test_the_path_of_an_arm_is_not_a_dot_at_its_base(push):
    program, world = push
    moving = pictures.find_moving(
        program, world, [_positions(world, block=0.1, panda_grasptarget=0.4, panda_link7=0.3)]
    )
    assert moving.parts == (("panda", "panda_grasptarget"), ("block", "block"))
    assert [pictures.describe(world, part) for part in moving.parts] == [
        "panda.panda_grasptarget",
        "block",
    ]


def test_a_block_that_no_episode_moves_has_no_path(push):
    program, world = push
    moving = pictures.find_moving(program, world, [_positions(world, panda_grasptarget=0.3)] * 2)
    assert moving.parts == (("panda", "panda_grasptarget"),)


def test_a_target_that_moves_is_followed():
    overrides = ("goal.desired=vector(0.5 m, 0.2 m * sin(90 deg/s * time), 0.5 m)",)
    with closing(Player(Showing("panda_reach", overrides=overrides).open(), "zero")) as player:
        positions = pictures.read_positions(player.reader.layout, player.episode(0, 0, 5))
        assert pictures.find_moving(player.program, player.env.world, [positions]).targets == (("", "agent"),)
    assert positions["", "agent"][:, 1] == pytest.approx(
        0.2 * np.sin(np.pi / 2 * 0.04 * np.arange(6)), abs=1e-6
    )
    assert pictures.has_moved(positions["", "agent"])


def test_a_wall_that_a_failure_reads_is_not_a_target():
    overrides = ["objects.post={shape: box, size: 5 5 5 cm, fixed: true}", "reset.place.post={x: 0.3 m, y:"
                                                                           " 0.3 m}",
                 "termination.failure.hit=contact(cart, post)", "reward.hit=-5 when hit"]  # fmt: skip
    program = api.compile(api.load("cartpole", overrides=overrides)).program
    moving = pictures.find_moving(program, program.world, [_positions(program.world, base_link=0.2)])
    assert moving.targets == ()


def test_the_view_does_not_cut_off_an_arm_that_reaches_out(push):
    model = push[1].robots[0].model
    view = overview(api.compile(api.load("panda_reach")).program, 300, 200)
    low, high = robot_bounds(model, {"panda_joint2": 0.4, "panda_joint4": -1.2, "panda_joint6": 1.6})
    for corner in product(*zip(low, high, strict=True)):
        x, y = projection(view)(corner)
        assert 0 < x < 300
        assert 0 < y < 200
