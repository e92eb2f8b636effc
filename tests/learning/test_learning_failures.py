"""A number that is not finite, or a world that explodes, is located, and its episode can be repeated."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import stand_in

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.cli import main
from deepbots_cli.compiler import check
from deepbots_cli.document import loads
from deepbots_cli.errors import DeepbotsError, EngineError, RunError
from deepbots_cli.learning import TrainingResult, evaluate, train
from deepbots_cli.learning.failures import FailureRecorder, reproduce
from deepbots_cli.learning.report import Reporter

ODD = {
    "reward": "reward: {alive: 1, odd: 1 / (20 - step)}",
    "observation": "augment: {growth: exp(step * 4)}\nobservation: {growth: {range: 0 .. 1, clip: false}}",
}


def not_finite_after_some_steps(name: str) -> Compiled:
    """The CartPole, in which a reward term or an observed value has no value after some steps."""
    return api.compile(
        check(
            loads(
                f"deepbots: 1\nextends: cartpole.yaml\nname: Odd\n{ODD[name]}\n",
                base=Path("scenarios").absolute(),
            )
        )
    )


@pytest.mark.parametrize(("name", "field"), [("reward", "`odd = "), ("observation", "growth")])
@pytest.mark.parametrize("engine", [pytest.param("pybullet", marks=pytest.mark.slow), "mujoco"])
def test_a_value_that_is_not_finite_is_reported_with_its_place_and_repeated_from_a_file(
    tmp_path: Path, name: str, field: str, engine: str
) -> None:
    """On MuJoCo the worlds are a batch."""
    pytest.importorskip(engine)
    with pytest.raises(DeepbotsError) as caught:
        train(not_finite_after_some_steps(name), run=tmp_path / "run", total_timesteps=2_000, engine=engine)
    text = str(caught.value)
    notes = caught.value.full_message
    path = tmp_path / "run" / "failures" / "0001.json"
    failure, error = reproduce(path)
    assert all(
        part in text for part in (f"episode {failure.episode} (seed ", "step ", field, f"deepbots try {path}")
    )
    assert failure.error in text
    assert error is not None
    assert text.startswith(error)
    assert "nothing was learned before; run `deepbots lint --deep SCENARIO`" in notes
    assert "deepbots eval" not in notes


def hurled(push: str) -> Compiled:
    """The CartPole with a motor at its hinge that hurls the pole out of the range of numbers, in the episodes
    that draw a `push`."""
    text = f"""
deepbots: 1
extends: cartpole.yaml
name: Hurled
parameters: {{push: {push}}}
robots:
  cart:
    receive: {{push: push}}
    actuators: {{hinge: {{type: torque_motor, joint: pole_hinge, max_torque: 1e9 N*m}}}}
    apply: {{hinge: push * 1 N*m}}
termination: {{failure: {{fallen: abs(cart.pole_angle) > 10000 deg, off_track: abs(x) > 1e200 m}}}}
truncation: {{max_steps: 4}}
train: {{n_steps: 16, n_epochs: 1}}
"""
    return api.compile(check(loads(text, base=Path("scenarios").absolute())))


class Notes(Reporter):
    """Keeps the notes to the user."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def note(self, text: str) -> None:
        self.texts.append(text)


def test_a_world_of_a_batch_that_becomes_infinite_is_reset_and_its_episode_is_kept(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    notes = Notes()
    rarely = f"choice({' | '.join(['0'] * 5)} | 1e9)"
    done = train(hurled(rarely), run=tmp_path / "run", total_timesteps=256, engine="mujoco", progress=notes)
    resets = [text for text in notes.texts if "was reset" in text]
    files = sorted((tmp_path / "run" / "failures").iterdir())
    assert done.status == "finished"
    assert len(resets) == len(files) == (tmp_path / "run" / "monitor.csv").read_text().count("not_finite") > 0
    for text, path in zip(resets, files, strict=True):
        assert re.match(
            r"episode \d+ \(seed \d+\), step \d: the pose of 'cart' became infinite or NaN\nreproduce .*"
            rf" {path}\n",
            text,
        )
        failure, error = reproduce(path)
        assert error is not None
        assert failure.error.endswith(error.partition("), ")[2])


def test_a_training_stops_when_worlds_of_a_batch_are_lost_again_and_again(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    with pytest.raises(
        EngineError,
        match=r"in 10 of the last \d+ episodes the state became infinite or NaN; the last one is episode",
    ) as caught:
        train(hurled("1e9"), run=tmp_path / "run", total_timesteps=2_000, engine="mujoco")
    files = sorted(path.name for path in (tmp_path / "run" / "failures").iterdir())
    assert len(files) == 10
    assert files[-1] in str(caught.value)


def test_a_reward_that_is_not_finite_names_its_term(tmp_path: Path) -> None:
    with pytest.raises(
        DeepbotsError, match=r"episode 1 \(seed \d+\), step 5: the reward term 'center' is not finite"
    ):
        train(stand_in.compiled(), run=tmp_path / "run", build=stand_in.Failing)


def test_an_evaluation_names_the_episode_and_its_seed(run_copy: Path) -> None:
    class Late(stand_in.Failing):
        """Fails in its second episode."""

        episodes = 0

        def reset(self, **settings: Any) -> Any:
            self.episodes += 1
            return super().reset(**settings)

        def step(self, action: Any) -> Any:
            return super().step(action) if self.episodes > 1 else stand_in.CartPole.step(self, action)

    with pytest.raises(DeepbotsError, match=r"episode 2 \(seed \d+\), step 5: .*'center'"):
        evaluate(run_copy, episodes=2, copies=1, build=Late)
    assert (run_copy / "failures" / "0001.json").exists()


def test_an_observation_that_is_not_finite_is_named() -> None:
    class Blind(stand_in.CartPole):
        def _observation(self) -> Any:
            observation = super()._observation()
            observation[2] = np.nan if self.steps == 3 else observation[2]
            return observation

        def reset(self, **settings: Any) -> Any:
            self.steps = 0
            return super().reset(**settings)

    program = stand_in.scenario()
    world = FailureRecorder(Blind(program), program=program)
    world.reset(seed=1)
    for _ in range(2):
        world.step(0)
    with pytest.raises(DeepbotsError, match=r"step 3: the observation 'cart.pole_angle' is not finite"):
        world.step(0)


def test_a_damaged_file_is_refused(trained: TrainingResult, run_copy: Path) -> None:
    folder = run_copy / "failures"
    folder.mkdir()
    whole = (
        '{"error": "", "step": 1, "episode": 1, "case": null, "stage": null, "start": %s, "actions": [%s]}'
    )
    for content in ("{", whole % ('{"root": "x"}', "0"), whole % ("0", '"x"'), whole % ("-1", "0")):
        (folder / "0001.json").write_text(content)
        with pytest.raises(RunError, match="damaged"):
            reproduce(folder / "0001.json")


@pytest.mark.slow
def test_actions_after_the_end_of_the_episode_are_not_repeated(
    trained: TrainingResult, run_copy: Path
) -> None:
    (run_copy / "failures").mkdir()
    content = {
        "error": "",
        "step": 1,
        "episode": 1,
        "case": None,
        "stage": None,
        "start": 0,
        "actions": [0] * 1_000_000,
    }
    (run_copy / "failures" / "0001.json").write_text(json.dumps(content))
    failure, error = reproduce(run_copy / "failures" / "0001.json")
    assert error is None
    assert len(failure.actions) < 1000


@pytest.fixture
def failed(trained: TrainingResult, run_copy: Path) -> Path:
    """The file of a failed episode in a run of the CartPole."""
    folder = run_copy / "failures"
    folder.mkdir()
    content = {
        "error": "odd",
        "step": 2,
        "episode": 1,
        "case": None,
        "stage": None,
        "start": 0,
        "actions": [0, 1],
    }
    (folder / "0001.json").write_text(json.dumps(content))
    return folder / "0001.json"


@pytest.mark.parametrize(
    "words",
    [
        ("--engine", "mujoco"),
        ("--lockstep",),
        ("--speed", "5"),
        ("--seed", "0"),
        ("--driver", "zero", "--episodes", "1"),
    ],
)
def test_a_kept_episode_takes_no_settings(
    failed: Path, words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["try", str(failed), *words]) == 2
    message = capsys.readouterr().err
    assert "already contains its scenario, start and actions" in message
    assert all(word in message for word in words if word.startswith("--"))


def test_a_kept_episode_is_repeated_from_within_its_folder(
    failed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(failed.parent)
    assert main(["try", failed.name]) == 0
    assert "repeated 2 actions: the episode does not fail" in capsys.readouterr().out


def test_a_kept_episode_without_its_run_is_refused(
    failed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = failed.rename(tmp_path / "sent.json")
    assert main(["try", str(copy)]) == 2
    assert "copy the file into the folder `failures` of the run" in capsys.readouterr().err


def test_a_scenario_in_json_is_not_a_kept_episode(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = tmp_path / "mine.json"
    scenario.write_text('{"deepbots": 1, "extends": "cartpole", "name": "Mine"}')
    assert main(["try", str(scenario), "--episodes", "1"]) == 0
    assert "episodes" in capsys.readouterr().out
