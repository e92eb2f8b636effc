"""`deepbots try --robot`: the measurements of a robot are scored as the simulation would score them."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest

pytest.importorskip("onnx")
pytest.importorskip("zmq")

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import UsageError
from deepbots_cli.insight.real_robot import RESET_BY_ROBOT, SILENT, scored, try_robot
from deepbots_cli.insight.robot import robot_program, sent_readings, serve_robot
from deepbots_cli.rollout import Episode, Start, play
from deepbots_cli.rollout.drivers import named_driver
from deepbots_robot import serving
from deepbots_robot.serving import Transport


@contextmanager
def simulated(
    scenario: str, transport: Transport, *, episodes: int = 1, seed: int = 3
) -> Iterator[list[Episode]]:
    """The simulation of a scenario as a robot, in a thread; the episodes that it played."""
    done: list[Episode] = []

    def play_all() -> None:
        running = serve_robot(
            api.compile(scenario).program, transport, episodes=episodes, seed=seed, lockstep=True, patience=10
        )
        with suppress(UsageError):  # as where no policy fits
            done.extend(episode for episode, _ in running)

    thread = threading.Thread(target=play_all, daemon=True)
    thread.start()
    yield done
    thread.join(20)


@pytest.mark.parametrize(
    ("scenario", "driver"),
    [
        ("cartpole", "backward*3,forward*2"),
        ("find_ball", "around"),
        pytest.param("panda_reach", "zero", marks=pytest.mark.slow),
        pytest.param("quadruped", "zero", marks=pytest.mark.slow),
    ],
)
def test_an_episode_on_a_robot_is_scored_as_in_the_simulation(
    scenario: str, driver: str, tmp_path: Path
) -> None:
    program = api.compile(scenario).program
    bare = robot_program(program)
    kept, _ = scored(bare, sent_readings(bare))
    transport = Transport(zmq=f"ipc://{tmp_path}/link")
    with closing(api.build(bare)) as world:
        alone = play(world, named_driver(world, driver), Start.of_evaluation(3, 0))
    with simulated(scenario, transport) as there:
        (here,), report = try_robot(
            program, transport, lambda world: named_driver(world, driver), lockstep=True, seconds=10
        )
    assert there[0].length == pytest.approx(alone.length, abs=1)
    assert here.length == pytest.approx(alone.length, abs=2)
    assert here.terms.keys() == {term.name for term in kept.agent.reward}
    for name, total in here.terms.items():
        assert total == pytest.approx(
            alone.terms[name], rel=0.02, abs=0.02 + abs(alone.terms[name]) / max(1, alone.length)
        ), name
    assert here.ended_by in (alone.ended_by, RESET_BY_ROBOT)
    assert report["steps"] >= here.length


def test_a_value_that_nothing_measures_is_named_and_left_out() -> None:
    bare = robot_program(api.compile("find_ball").program)
    kept, notes = scored(bare, sent_readings(bare))
    assert [term.name for term in kept.agent.reward] == ["time", "found"]
    assert [ending.name for ending in kept.endings] == ["found"]
    assert notes == [
        "reward.closer is left out: nothing measures path_distance(epuck, ball)",
        "reward.crash is left out: nothing measures collided(epuck)",
        "reward.scrape is left out: nothing measures clearance(epuck, box)",
        "termination.crashed is left out: nothing measures collided(epuck)",
    ]


def test_the_command_plays_further_episodes_when_the_robot_begins_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    address = f"ipc://{tmp_path}/link"
    with simulated("cartpole", Transport(zmq=address), episodes=3) as there:
        assert (
            main(
                [
                    "try",
                    "cartpole",
                    "--robot",
                    address,
                    "--driver",
                    "forward",
                    "--lockstep",
                    "--episodes",
                    "3",
                    "--json",
                ]
            )
            == 0
        )
    report = json.loads(capsys.readouterr().out)
    assert [episode["length"] for episode in report["episodes"]] == [episode.length for episode in there]
    assert {episode["ended_by"] for episode in report["episodes"]} == {"fallen"}
    assert report["link"]["refused"] == {}


@pytest.mark.slow
def test_a_robot_that_falls_silent_ends_the_episode(tmp_path: Path) -> None:
    transport = Transport(zmq=f"ipc://{tmp_path}/link")
    program = api.compile("pit_escape").program
    with simulated("pit_escape", transport):  # it ends when it is out of the pit, which it does not measure
        (here,), _ = try_robot(
            program, transport, lambda world: named_driver(world, "rocking"), lockstep=True, seconds=1
        )
    assert here.ended_by == SILENT
    assert here.length > 10
    with pytest.raises(UsageError, match=r"no value of roller.gyro, roller.accel came in 0.1 s"):
        try_robot(program, transport, lambda world: named_driver(world, "rocking"), seconds=0.1)


def test_a_robot_that_is_not_there_is_named_after_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serving, "QUIET", 0.25)
    transport = Transport(zmq=f"ipc://{tmp_path}/link")
    program = api.compile("pit_escape").program
    notes: list[str] = []
    with pytest.raises(UsageError, match="no value of"):
        try_robot(
            program, transport, lambda world: named_driver(world, "rocking"), seconds=0.7, note=notes.append
        )
    assert notes[-1] == "no step in 0.25 s: there is no value of roller.gyro, roller.accel yet"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--robot", "tcp://127.0.0.1:58751"], "--robot needs --driver NAME"),
        (
            ["--robot", "5555", "--driver", "zero"],
            "'5555' is not an address of a robot; write ros, ros:DOMAIN, tcp://HOST:PORT",
        ),
        (
            ["--robot", "ros1", "--driver", "zero"],
            "the link over ROS 1 is gone; use ROS 2 (from ROS 1 through ros1_bridge), ZeroMQ or WebSocket",
        ),
        (["--robot", "ros:999", "--driver", "zero"], "the domain 999 does not exist"),
        (["--robot", "ws://127.0.0.1:99999", "--driver", "zero"], "is not a port"),
        (
            ["--robot", "tcp://127.0.0.1:58751", "--driver", "zer"],
            "there is no driver 'zer' (did you mean zero?)",
        ),
        (["--lockstep"], "--lockstep and --speed need --robot"),
    ],
)
def test_options_that_do_not_fit_are_refused_in_a_sentence(
    capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    pytest.importorskip("cyclonedds")
    assert main(["try", "cartpole", *words]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_over_another_scenario_it_ends_with_a_sentence(tmp_path: Path) -> None:
    transport = Transport(zmq=f"ipc://{tmp_path}/link")
    with (
        simulated("cartpole", transport),
        pytest.raises(UsageError, match="the robot of CartPole at the other end does not fit this policy of"),
    ):
        try_robot(
            api.compile("find_ball").program, transport, lambda world: named_driver(world, "zero"), seconds=10
        )
