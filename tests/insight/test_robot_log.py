"""The log of a robot beside the simulation."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable
from contextlib import closing
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import UsageError
from deepbots_cli.insight.robot_log import compare_log, distance, logged_episodes
from deepbots_cli.learning import policy, train
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.rollout import robot_logs
from deepbots_cli.rollout.robot_logs import RobotLog
from deepbots_cli.view.episodes import Showing
from deepbots_cli.view.players import open_player

pytest.importorskip("onnxruntime")
BRIEF = (
    "train={algorithm: PPO, total_timesteps: 128, environments: 2, n_steps: 64, batch_size: 64, network:"
    " {hidden: [16]}}"
)
PERIOD = 0.032


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("runs") / "cartpole"
    train(
        api.compile("cartpole", overrides=[BRIEF, "evaluation.episodes=2", "world.engine=mujoco"]),
        run=folder,
        seed=3,
    )
    return Run.open(folder)


def logged(run: Run, path: Path, measured: Callable[[float, float], float], steps: int = 300) -> Path:
    """A log of a robot that moves as the simulation does; `measured` turns time and angle of the pole into
    what its sensor gives."""
    from deepbots_cli.insight.export.control import ControlStep
    from deepbots_cli.insight.export.recording import recorded_steps
    from deepbots_cli.rollout.policies import PolicyDriver
    from deepbots_robot.log import LogWriter

    learner = policy.loaded(run, "best")
    control = ControlStep(run.program, learner)
    writer = LogWriter(path, {})
    simulation = recorded_steps(control, lambda world: PolicyDriver(learner, world))
    for number, step in enumerate(islice(simulation, steps)):
        time = number * PERIOD
        angle = np.array([measured(time, float(step.inputs["cart.pole_angle"][0]))])
        writer.step(100.0 + time, {**step.inputs, "cart.pole_angle": angle}, step.commands, 0.001, "policy")
    writer.close()
    return path


@pytest.mark.slow
def test_a_robot_that_moves_as_the_simulation_differs_in_nothing(run: Run, tmp_path: Path) -> None:
    differences = compare_log(run, logged(run, tmp_path / "log.mcap", lambda time, angle: angle))
    assert not [difference for difference in differences if difference.is_different]


def test_a_bias_is_named_first_with_its_time_and_a_line_for_the_scenario(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = logged(run, tmp_path / "log.mcap", lambda time, angle: angle + (0.5 if time > 3.2 else 0.0))
    first = compare_log(run, log)[0]
    assert first.name == "cart.pole_angle"
    assert first.since == pytest.approx(3.2, abs=2 * PERIOD)
    assert first.robot[0] - first.simulated[0] == pytest.approx(0.5 * 199 / 300, abs=0.02)
    assert main(["transfer", str(run.path), "--log", str(log)]) == 0
    assert re.search(
        r"robots\.cart\.sensors\.pole_angle: \{bias: uniform\(0 \.\. 0\.3[1-5] rad\)\}",
        capsys.readouterr().out,
    )


@pytest.mark.slow
def test_noise_is_measured(run: Run, tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    log = logged(run, tmp_path / "log.mcap", lambda time, angle: angle + generator.normal(0.0, 0.3))
    (advice,) = {each.advice for each in compare_log(run, log) if each.advice}
    noise = float(advice.partition("noise: ")[2].split()[0])
    assert noise == pytest.approx(0.3, rel=0.15)


def test_the_distance_is_that_of_the_distribution_functions() -> None:
    assert distance(np.arange(10.0), np.arange(10.0)) == 0.0
    assert distance(np.arange(10.0), np.arange(10.0) + 5.0) == pytest.approx(0.5)
    assert distance(np.zeros(3), np.ones(7)) == 1.0


def test_a_log_of_another_policy_is_refused(run: Run, tmp_path: Path) -> None:
    damaged = tmp_path / "other.mcap"
    damaged.write_bytes(b"no log")
    with pytest.raises(UsageError, match="cannot be read as a log"):
        compare_log(run, damaged)
    with pytest.raises(UsageError, match="has 3 steps of a policy; a comparison needs at least 50"):
        compare_log(run, logged(run, tmp_path / "short.mcap", lambda time, angle: angle, steps=3))
    with pytest.raises(UsageError, match="cannot be read as a log"):
        compare_log(run, tmp_path / "missing.mcap")


def test_the_episodes_of_a_log_are_listed_and_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from deepbots_robot.log import LogWriter

    path = tmp_path / "log.mcap"
    writer = LogWriter(path, {}, clock=lambda: 0.0)
    values, commands = {"cart.pole_angle": np.zeros(1)}, {"cart.wheels": np.zeros(4)}
    for number, begun in enumerate((10.0, 20.0)):
        writer.event(begun, "episode", str(number))
        writer.step(begun + 0.45, values, commands, 0.0, "policy")  # answers no new value
        writer.step(begun + 0.5, values, commands, 0.002, "policy")
    writer.event(20.6, "safe", "no new value of cart.pole_angle")
    writer.step(20.6, {}, commands, 0.0, "safe")
    writer.close()
    assert main(["replay", str(path), "--json"]) == 0
    episodes = json.loads(capsys.readouterr().out)["episodes"]
    assert [
        (episode["number"], episode["begun"], episode["steps"], episode["safe_steps"]) for episode in episodes
    ] == [
        (0, 0.0, 2, 0),
        (1, 10.0, 2, 1),
    ]
    assert [episode["seconds"] for episode in episodes] == [
        0.5,
        0.5,
    ]  # without the time in which no policy acted
    assert main(["diagnose", str(path), "--episode", "1"]) == 0
    output = capsys.readouterr().out
    assert "episode 1: 2 steps of the policy in 0.5 s; median answer 2.00 ms, longest 2.00 ms" in output
    assert "0.60 s  safe posture: no new value of cart.pole_angle" in output
    for option, text in (
        (["--episode", "failed"], "a robot does not see which episodes fail"),
        (["--last"], "the log of a robot takes --episode and --json"),
    ):
        assert main(["diagnose", str(path), *option]) == 2
        assert text in capsys.readouterr().err
    assert main(["diagnose", str(path), "--episode", "7"]) == 2
    assert "has no episode 7; list them with: deepbots replay" in capsys.readouterr().err
    assert main(["view", str(path)]) == 2
    assert "is the log of a robot without the scenario" in capsys.readouterr().err


def test_a_log_of_a_robot_that_sent_nothing_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from deepbots_robot.log import LogWriter

    path = tmp_path / "log.mcap"
    LogWriter(path, {}).close()
    for words in (["diagnose", str(path)], ["replay", str(path)], ["diagnose", str(path), "--episode", "0"]):
        assert main(words) == 2
        output = capsys.readouterr()
        assert "contains no step: the robot sent no complete set of values" in output.err
        assert output.out == ""


def test_episodes_of_a_robot_that_restarts_have_numbers_of_their_own(tmp_path: Path) -> None:
    from deepbots_robot.log import LogWriter

    path = tmp_path / "log.mcap"
    writer = LogWriter(path, {}, clock=lambda: 0.0)
    writer.event(9.0, "refused", "a message")
    for begun in (10.0, 20.0, 30.0):
        writer.event(begun, "episode", "0")
        writer.step(begun + 1.0, {}, {"cart.wheels": np.zeros(4)}, 0.002, "policy")
    writer.close()
    episodes = logged_episodes(path)
    assert [(episode.number, episode.steps, len(episode.events)) for episode in episodes] == [
        (0, 1, 1),
        (1, 1, 0),
        (2, 1, 0),
    ]


@pytest.mark.slow
def test_a_log_that_a_kill_cut_is_used_with_a_note(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = logged(run, tmp_path / "whole.mcap", lambda time, angle: angle)
    cut = tmp_path / "cut.mcap"
    content = whole.read_bytes()
    cut.write_bytes(content[: len(content) // 2])
    for command in (
        ["replay", str(cut)],
        ["diagnose", str(cut)],
        ["transfer", str(run.path), "--log", str(cut)],
    ):
        assert main(command) == 0
        output = capsys.readouterr()
        counts = re.findall(
            r"cut.mcap has no end: its process was killed, or it is damaged; its first (\d+) messages are"
            r" used",
            output.err,
        )
        assert [100 < int(number) < 300 for number in counts] == [True]
        assert main([*command[:-1], str(whole)]) == 0
        assert "has no end" not in capsys.readouterr().err


# In the page


@pytest.fixture(scope="module")
def cut_log(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log with a step in each of two episodes, then silence; the process was killed."""
    from deepbots_cli.insight.export.bundle import bundle_files
    from deepbots_robot.bundle import load
    from deepbots_robot.log import LogWriter

    folder = tmp_path_factory.mktemp("bundle")
    for name, content in bundle_files(run, "best").items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    path = tmp_path_factory.mktemp("logs") / "killed.mcap"
    writer = LogWriter(path, {}, clock=lambda: 0.0, files=load(folder).description())
    values = {
        "position(cart)": np.array([0.3, 0.1, 0.04]),
        "cart.pole_angle": np.array([0.2]),
        "velocity(cart)": np.zeros(3),
    }
    for number, begun in enumerate((10.0, 20.0)):
        writer.event(begun, "episode", str(number))
        for step in range(3):
            commands = {"cart.wheels": np.full(4, float(step))}
            writer.step(begun + step * PERIOD, values, commands, 0.002, "policy", {"cart.pole_angle": 0.05})
    writer.event(20.2, "safe", "no new value of cart.pole_angle")
    for stamp in (20.2, 20.3):
        writer.step(stamp, {}, {"cart.wheels": np.zeros(4)}, 0.0, "safe", {"cart.pole_angle": 0.15})
    writer._file.flush()
    killed = path.with_name("cut.mcap")
    killed.write_bytes(path.read_bytes()[:-3])
    writer.close()
    return killed


def test_joints_and_poses_of_a_log_move_the_model_and_all_else_stands(cut_log: Path) -> None:
    with closing(open_player(Showing(str(cut_log)).open())) as player:
        frame = player.begin(0, 1)
        joints = dict(
            zip(
                (joint.name for joint in player.env.world.robots[0].model.moving_joints),
                frame.joints["cart"],
                strict=True,
            )
        )
        assert joints == pytest.approx({**dict.fromkeys(joints, 0.0), "pole_hinge": 0.2})
        root = player.env.world.robots[0].model.root
        assert frame.links["cart", root][0] == pytest.approx((0.3, 0.1, 0.04), abs=1e-6)
        assert "the log moves position(cart), cart.pole_angle" in player.note


def test_what_the_robot_reported_and_got_is_in_the_frames(cut_log: Path) -> None:
    with closing(open_player(Showing(str(cut_log)).open())) as player:
        player.begin(0, 1)
        rows = []
        for _ in range(2):
            frame = player.step()
            (agent,) = frame.agents.values()
            names = [field.name for field in player.reader.layout.observation]
            values = dict(zip(names, agent.observation, strict=True))
            rows.append(
                (
                    frame.time,
                    values["cart.pole_angle"],
                    values["answer time"],
                    values["age of cart.pole_angle"],
                    values["posture"],
                )
            )
            assert agent.action == (frame.step,) * 4
        assert rows == [
            pytest.approx(row) for row in ((PERIOD, 0.2, 2.0, 50.0, 0.0), (2 * PERIOD, 0.2, 2.0, 50.0, 0.0))
        ]


def test_the_page_plays_a_log_that_was_cut_up_to_its_last_whole_step(cut_log: Path) -> None:
    pytest.importorskip("viser")
    from deepbots_cli.view.page import Page

    with closing(Page(Showing(str(cut_log)), port=0, episode=1)) as page:
        page.seek(99)
        assert page.player is not None
        assert page.player.frame.ended_by == "end of the log"
        assert "safe posture: no new value of cart.pole_angle" in page.banner.content
        assert "return" not in page.banner.content
        assert "reported by the robot" in page.panel.values.content


def test_steps_beyond_the_limit_are_left_out_with_a_note(
    cut_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert RobotLog.read(cut_log).notes == ()
    monkeypatch.setattr(robot_logs, "MAX_STEPS", 4)
    log = RobotLog.read(cut_log)
    assert [len(episode.steps) for episode in log.episodes] == [3, 1]
    assert log.notes == ("the log is longer than 4 steps; later steps are left out",)
    with closing(open_player(Showing(str(cut_log)).open())) as player:
        player.begin(0, 1)
        assert log.notes[0] in player.note


def test_a_log_with_damaged_content_is_refused_in_one_sentence(
    cut_log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from deepbots_robot.log import LogWriter, read_attached

    unpacked = tmp_path / "unpacked"
    unpacked.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(unpacked))
    files = read_attached(cut_log)
    wrong = {
        "a description": {**files, "bundle.json": b"{}"},
        "a path": {**files, "inputs/../../evil.urdf": b""},
        "no step": files,
    }
    for number, attached in enumerate(wrong.values()):
        path = tmp_path / f"{number}.mcap"
        writer = LogWriter(path, {}, files=attached)
        writer.close()
        assert main(["view", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("cannot be read as the log of a robot: ") == 2
    assert "contains no step" in error
    assert list(unpacked.iterdir()) == []
