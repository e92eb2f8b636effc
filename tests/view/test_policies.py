"""Policies of runs in the page: masked and recurrent ones, and the newest one of a training that goes on."""

from __future__ import annotations

import json
import os
import shutil
from contextlib import closing

import numpy as np
import pytest

pytest.importorskip("sb3_contrib")
import deepbots_cli
from deepbots_cli import learning
from deepbots_cli.errors import RunError
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.rollout.drivers import POLICY
from deepbots_cli.view.episodes import Showing
from deepbots_cli.view.players import open_player

SMALL = ["train.environments=1", "train.n_steps=64", "train.batch_size=64", "train.n_epochs=1"]


def _trained(folder, name, *overrides):
    compiled = deepbots_cli.compile(name, overrides=[*SMALL, *overrides])
    return learning.train(compiled, run=folder / "run", total_timesteps=64).run


@pytest.mark.parametrize(
    ("name", "algorithm"),
    [pytest.param("find_and_avoid", "MaskablePPO", marks=pytest.mark.slow), ("cartpole", "RecurrentPPO")],
)
def test_the_policy_of_the_page_acts_as_in_an_evaluation(tmp_path, name, algorithm):
    run = _trained(tmp_path, name, f"train.algorithm={algorithm}")
    evaluated = learning.evaluate(run, episodes=2, seed=5)
    with closing(open_player(Showing(str(run)).open())) as player:
        for number, episode in enumerate(evaluated.outcomes):
            *_, last = player.episode(5, number)
            assert player.driver_name == POLICY
            assert (last.step, last.ended_by) == (episode.length, episode.ended_by)
            assert last.agents["agent"].episode_return == pytest.approx(episode.total_return)


def test_a_training_is_followed_to_its_newest_policy(tmp_path):
    run = Run.open(_trained(tmp_path, "cartpole"))
    kept = tmp_path / "kept.zip"
    shutil.copyfile(run.model("last"), kept)
    for name in ("best", "last"):
        run.model(name).unlink(missing_ok=True)
    with pytest.raises(RunError, match="has no model yet"):
        open_player(Showing(str(run.path)).open())
    run.update(status="running")
    with run_lock(run.path), closing(open_player(Showing(str(run.path)).open())) as player:
        player.begin(0, 0)
        assert "no policy yet" in player.driver.note
        player.step()
        for name, time in (("last", 1_000), ("best", 2_000)):
            shutil.copyfile(kept, run.model(name))
            os.utime(run.model(name), (time, time))
            before = player.driver._policy
            player.begin(0, 0)
            assert player.driver._policy is not before
            assert player.driver.note == "policy after 64 steps"
            assert np.isfinite(player.step().agents["agent"].reward)
        before = player.driver._policy
        player.begin(0, 1)
        assert player.driver._policy is before


def test_the_named_model_drives_a_batch_too(tmp_path):
    run = Run.open(_trained(tmp_path, "cartpole"))
    run.model("best").write_bytes(b"")  # which would be refused
    for worlds in (None, 2):
        shown = Showing(str(run.path), engine="mujoco", worlds=worlds, model="last")
        with closing(open_player(shown.open())) as player:
            player.begin(0, 0)
            assert player.step().step == 1


def test_the_page_of_a_training_marks_the_stages_of_its_curriculum(tmp_path):
    pytest.importorskip("viser")
    from deepbots_cli.view.page import Page

    stages = "curriculum=[{name: wide, set: {fall_angle: 8 deg}, until: 24 steps}, {name: usual}]"
    run = Run.open(_trained(tmp_path, "cartpole", stages))
    run.update(status="running")
    with run_lock(run.path), closing(Page(Showing(str(run.path)), port=0)) as page:
        assert page.player.note == "policy after 64 steps, the training is in stage usual"
        text = page.panel.training.text.content
    (done,) = run.record.result.stages
    assert text.index("1. wide") < text.index(">0<") < text.index("2. usual") < text.index(f">{done.steps}<")


def test_the_tab_training_shows_the_evaluations_of_the_run_that_is_shown_now(tmp_path):
    pytest.importorskip("viser")
    from deepbots_cli.view.page import Page

    first = _trained(tmp_path, "cartpole")
    second = shutil.copytree(first, tmp_path / "second")
    for run, value in ((first, 8.0), (second, 9.0)):
        line = {"steps": 64, "stage": None, "returns": [value], "lengths": [8], "successes": [False]}
        (run / "evaluations" / "training.jsonl").write_text(json.dumps(line) + "\n")
    with closing(Page(Showing(str(first)), port=0)) as page:
        panel = page.panel
        page.show_source(str(second))
        assert page.panel is panel
        assert panel.training.mean_returns == (9.0,)
        assert "return 9<" in panel.training.text.content


def test_a_run_whose_log_is_damaged_is_still_shown(tmp_path):
    pytest.importorskip("viser")
    from deepbots_cli.view.page import Page

    run = Run.open(_trained(tmp_path, "cartpole"))
    run.monitor.write_text("#\nr,l,steps,is_success,ended_by\nx,1,1,0,fallen\n")
    with closing(Page(Showing(str(run.path)), port=0)) as page:
        assert "monitor.csv is not a log of episodes" in page.panel.training.text.content
        assert page.player.driver_name == POLICY


def test_a_parameter_of_a_run_changes_its_world_and_a_policy_that_does_not_fit_is_refused(tmp_path):
    run = str(_trained(tmp_path, "cartpole"))
    assert Showing(run).open().parameters["fall_angle"] == "15 deg"
    with closing(open_player(Showing(run, overrides=["parameters.fall_angle=1 deg"]).open())) as player:
        *_, last = player.episode(0, 0)
        assert (player.driver_name, last.ended_by) == (POLICY, "fallen")
        assert last.agents["agent"].episode_return < 60
    with pytest.raises(RunError, match="does not fit the changed scenario"):
        open_player(Showing(run, overrides=["action.drive.choices.stop=0"]).open())
    assert Showing(run, overrides=["parameters.fall_angle=1 kg"]).open().program is None
