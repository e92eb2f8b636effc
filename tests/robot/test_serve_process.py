"""`deepbots serve` and `deepbots-robot serve` as processes: their imports, their memory, and their log after
a kill.

A bundle at one end of a link and the simulation at the other act as the policy in the environment does.

`deepbots try --robot`: the measurements of a robot are scored as the simulation would score them.
"""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
pytest.importorskip("zmq")
pytest.importorskip("mcap")

import zmq

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.document import shipped
from deepbots_cli.errors import UsageError
from deepbots_cli.insight.export.devices import with_probes
from deepbots_cli.insight.real_robot import RESET_BY_ROBOT, SILENT, scored, try_robot
from deepbots_cli.insight.robot import SimulatedRobot, robot_program, sent_readings, serve_robot
from deepbots_cli.program import Program
from deepbots_cli.program.topics import mapping
from deepbots_cli.rollout import Episode, Start, play, steps
from deepbots_cli.rollout.drivers import named_driver
from deepbots_cli.rollout.policies import PolicyDriver
from deepbots_robot import serving
from deepbots_robot.bundle import load
from deepbots_robot.log import read_log
from deepbots_robot.server import Server
from deepbots_robot.serving import (
    Transport,
    field_of,
    inputs_of,
    mapped,
    nothing_served,
    outputs_of,
    serve,
    stopping,
)
from deepbots_robot.topics import Field, Topic, action_field
from tests.bundle.untrained import untrained_bundle, write_bundle
from tests.commands import until
from tests.few import WORLDS, few

ROOT = Path(__file__).parents[2]
HEAVY = ("torch", "pybullet", "mujoco", "scipy", "gymnasium", "onnx", "matplotlib", "pandas")
MAX_MEMORY = 100  # MB


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bundle(tmp_path_factory.mktemp("serve") / "bundle", "cartpole")


@contextmanager
def running(*words: object) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, *map(str, words)],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


PROGRAM = """
import json, re, runpy, sys
sys.argv = ["deepbots_robot", *sys.argv[1:]]
try:
    runpy.run_module("{module}", run_name="__main__")
except SystemExit:
    pass
status = open("/proc/self/status").read() if sys.platform == "linux" else "VmHWM: 0 kB"
print(json.dumps({{"modules": sorted(sys.modules), "memory": int(re.search(r"VmHWM:\\s*(\\d+)", status)[1]) / 1024}}))
"""


@pytest.mark.parametrize("module", ["deepbots_robot", pytest.param("deepbots_cli", marks=pytest.mark.slow)])
@pytest.mark.parametrize("link", [("--ros", "--domain", 72), ("--zmq", "tcp://127.0.0.1:58731")])
def test_a_server_imports_no_simulator_and_takes_little_memory(
    bundle: Path, tmp_path: Path, module: str, link: tuple[object, ...]
) -> None:
    if "--ros" in link:
        pytest.importorskip("cyclonedds")
    words = ["serve", bundle, *link, "--seconds", 0.3, "--log", tmp_path / "a.mcap"]
    with running("-c", PROGRAM.format(module=module), *words) as process:
        out, err = process.communicate(timeout=60)
    report = json.loads(out.splitlines()[-1])
    assert "messages     0 received, 0 refused" in out, err
    assert not set(HEAVY) & set(report["modules"])
    assert ("deepbots_cli" in report["modules"]) == (module == "deepbots_cli")
    assert report["memory"] <= MAX_MEMORY


def test_a_killed_robot_ends_in_the_safe_posture_and_a_killed_server_leaves_a_log(
    bundle: Path, tmp_path: Path
) -> None:
    link = f"ipc://{tmp_path}/link"
    log = tmp_path / "a.mcap"
    serve = (*("-m", "deepbots_robot", "serve", bundle, "--zmq", link, "--log", log),)
    with (
        running(*serve) as server,
        running("-m", "deepbots_cli", "serve", "cartpole", "--as-robot", "--zmq", link) as robot,
    ):
        until(lambda: log.exists() and sum(topic == "/step" for topic, _, _ in read_log(log)) > 40)
        robot.send_signal(signal.SIGKILL)
        until(lambda: any(content.get("posture") == "safe" for _, _, content in read_log(log)))
        time.sleep(1.2)
        killed = time.time()
        server.send_signal(signal.SIGKILL)
        server.wait(10)
    entries = list(read_log(log))
    assert killed - entries[-1][1] <= 1.0
    last = entries[-1][2]
    assert {**last, "ages": {}} == {
        "inputs": {},
        "ages": {},
        "commands": {"cart.wheels": [0.0] * 4},
        "answer": 0.0,
        "posture": "safe",
    }
    assert min(last["ages"].values()) > 0.096  # beyond the age limit
    assert any(
        content["kind"] == "safe" and "no new value" in content["text"]
        for topic, _, content in entries
        if topic == "/event"
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nothing"], "nothing is not a bundle of `deepbots export`: there is no such folder"),
        (
            ["BUNDLE", "--ros", "--zmq", "tcp://127.0.0.1:5555"],
            "--ros and --zmq cannot be combined",
        ),
        (["BUNDLE", "--ros1"], "there is no option --ros1; use `--ros with ros1_bridge, --zmq ADDRESS"),
        (
            ["BUNDLE", "--zmq", "127.0.0.1:5555", "--log", "a.mcap"],
            "'127.0.0.1:5555' is not an address of ZeroMQ; write one like tcp://127.0.0.1:5555",
        ),
        (
            ["BUNDLE", "--zmq", "tcp://127.0.0.1:5555", "--domain", "3"],
            "--domain belongs to ROS 2; leave out --zmq",
        ),
        (["BUNDLE", "--interface", "<x>"], "'<x>' is not a network interface of this machine; it has"),
        (["BUNDLE", "--speed", "0"], "--speed 0: write a number above 0, at most 1000"),
        (["BUNDLE", "--episodes", "3"], "--episodes belongs to a simulated robot; add --as-robot"),
        (
            ["BUNDLE", "--zmq", "tcp://127.0.0.1:58733", "--seconds", "0.1"],
            "the policy did not act within 0.1 s: no value of position(cart),",
        ),
        (
            ["BUNDLE", "--log", "missing/a.mcap"],
            "missing/a.mcap cannot be written: no such file or directory",
        ),
        (
            ["cartpole", "--as-robot", "--log", "a.mcap"],
            "belongs to the policy; leave out --as-robot",
        ),
        (["multi_cartpole", "--as-robot"], "has copies of a robot"),
    ],
)
def test_a_bundle_that_cannot_be_served_is_refused_in_a_sentence(
    bundle: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    words: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["serve", *(str(bundle) if word == "BUNDLE" else word for word in words)]) != 0
    error = " ".join(capfd.readouterr().err.split())
    assert message in error
    assert "Traceback" not in error
    assert os.listdir(tmp_path) == []


def test_a_server_that_a_signal_ends_before_its_first_step_is_no_error(bundle: Path, tmp_path: Path) -> None:
    def interrupt(text: str) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    report = serve(load(bundle), Transport.at(f"ipc://{tmp_path}/link"), seconds=20.0, note=interrupt)
    assert (report["steps"], nothing_served(report, 20.0)) == (0, "")


def test_a_server_that_does_not_start_leaves_neither_link_nor_log_open(bundle: Path, tmp_path: Path) -> None:
    address, log = f"ipc://{tmp_path}/link", tmp_path / "a.mcap"

    def fail(text: str) -> None:
        raise RuntimeError(text)

    with pytest.raises(RuntimeError, match="it waits for the robot"):
        serve(load(bundle), Transport.at(address), log=log, note=fail)
    assert log.read_bytes().endswith(b"MCAP0\r\n")
    with zmq.Context() as context, context.socket(zmq.PAIR) as socket:
        socket.bind(address)


def test_signals_return_to_handlers_that_python_cannot_set_again(monkeypatch: pytest.MonkeyPatch) -> None:
    set_handler = signal.signal
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def set_handler_of_c(number: int, handler: Any) -> None:
        """`signal.signal` for a signal whose handler C code has installed."""
        set_handler(number, handler)

    monkeypatch.setattr(signal, "signal", set_handler_of_c)
    try:
        with stopping() as stopped:
            signal.raise_signal(signal.SIGTERM)
            assert stopped()
        assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    finally:
        for number, handler in handlers.items():
            set_handler(number, handler)


def test_a_simulated_robot_needs_no_torch() -> None:
    code = (
        "import sys, deepbots_cli.insight.robot, deepbots_cli.insight.real_robot; print('torch' in"
        " sys.modules)"
    )
    with running("-c", code) as process:
        assert process.communicate(timeout=60)[0] == "False\n"


STEPS = 40
SENSITIVE_AFTER = {"quadruped_rough": 8, "carry": 30}
"""Steps until a foot meets an edge of the terrain, or the bar slides on two robots: messages round actions by
1e-7, and which points touch then changes the motion by 1e-2."""
SINGLE = [name for name in shipped.scenario_names() if name != "multi_cartpole"]


@contextmanager
def served(scenario: str, transport: Transport, *, lockstep: bool = True) -> Iterator[Server]:
    """The untrained policy of a scenario, served in a thread."""
    step, _, bundle = untrained_bundle(scenario)
    topics = mapping(step.program)
    inputs = inputs_of(bundle.info)
    outputs = outputs_of(bundle.info)
    receives = mapped([each.field for each in inputs], topics)
    sends = [_action(step.program), *mapped([each.field for each in outputs], topics, commands=True)]
    link = transport.open(receives, sends, robot=False)
    server = Server(bundle.start(), inputs, outputs, link, bundle.info.rate_hz, lockstep=lockstep)
    done = threading.Event()
    thread = threading.Thread(target=server.run, args=(done.is_set,), daemon=True)
    thread.start()
    try:
        yield server
    finally:
        done.set()
        thread.join(5)
        link.close()


def _action(program: Program) -> tuple[Field, Topic]:
    return action_field(len(program.agent.choices) or len(program.agent.range_names))


def without_noise(program: Program) -> Program:
    """Without noise of the supervisor, which a bundle does not know."""
    from dataclasses import replace

    agent = program.agent
    goal = agent.goal and replace(agent.goal, achieved=replace(agent.goal.achieved, noise=None))
    program = program.with_agent(
        observation=tuple(replace(entry, noise=None) for entry in agent.observation), goal=goal
    )
    return replace(program, signals=tuple(replace(signal, noise=None) for signal in program.signals))


def arrays_of(observation: Any) -> list[np.ndarray[Any, Any]]:
    """The arrays of an observation."""
    parts = observation.values() if isinstance(observation, dict) else [observation]
    return [np.asarray(part, float) for part in parts]


@contextmanager
def robot_over_a_link(
    scenario: str, program: Program, folder: Path, **settings: Any
) -> Iterator[tuple[Any, SimulatedRobot]]:
    """The world of a program, and its robot, which obeys an untrained policy of the scenario."""
    outputs, readings = untrained_bundle(scenario)[0].outputs, sent_readings(program)
    transport = Transport(zmq=f"ipc://{folder}/link")
    with served(scenario, transport), closing(api.build(with_probes(program, readings))) as world:
        sends = [(field_of(reading.info), None) for reading in readings]
        receives = [_action(program), *((field_of(entry), None) for entry in outputs)]
        with closing(transport.open(receives, sends, robot=True)) as link:  # type: ignore[arg-type]
            yield world, SimulatedRobot(world, readings, outputs, link, patience=10, **settings)


@pytest.mark.parametrize("scenario", few(SINGLE, WORLDS))
def test_an_episode_over_a_link_is_that_of_the_environment(scenario: str, tmp_path: Path) -> None:
    step, learner, _ = untrained_bundle(scenario)
    count = SENSITIVE_AFTER.get(scenario, STEPS)
    program = without_noise(robot_program(step.program))
    with closing(api.build(program)) as world:
        alone = list(
            itertools.islice(steps(world, PolicyDriver(learner, world), Start.of_evaluation(3, 0)), count)
        )
    with robot_over_a_link(scenario, program, tmp_path, lockstep=True) as (world, robot):
        over_link = list(itertools.islice(steps(world, robot, Start.of_evaluation(3, 0)), count))
    assert [each.is_last for each in over_link] == [each.is_last for each in alone]
    for expected_step, actual_step in zip(alone, over_link, strict=True):
        assert actual_step.reward == pytest.approx(expected_step.reward, abs=1e-3)
        for expected, actual in zip(
            arrays_of(expected_step.observation), arrays_of(actual_step.observation), strict=True
        ):
            np.testing.assert_allclose(actual, expected, atol=2e-3, err_msg=f"step {expected_step.number}")
    assert robot.steps == len(alone) - 1


def test_a_step_after_a_late_one_is_not_shorter_and_the_late_one_is_counted(tmp_path: Path) -> None:
    program = robot_program(untrained_bundle("cartpole")[0].program)
    period, times = program.period / 0.2, []
    with robot_over_a_link("cartpole", program, tmp_path, speed=0.2) as (world, robot):
        for step in itertools.islice(steps(world, robot, Start.of_evaluation(3, 0)), 5):
            times.append(time.monotonic())
            time.sleep(1.7 * period if step.number == 2 else 0.0)
    assert robot.late_steps == 1
    assert times[4] - times[3] > 0.7 * period


def test_episodes_over_ros_topics(tmp_path: Path) -> None:
    pytest.importorskip("cyclonedds")
    program = untrained_bundle("cartpole")[0].program
    transport = Transport(domain=71)
    with served("cartpole", transport) as server:
        played = list(serve_robot(program, transport, episodes=3, lockstep=True, patience=10))
    lengths = [episode.length for episode, _ in played]
    assert server.episodes == 3
    assert server.steps == sum(lengths)
    with served("cartpole", Transport(zmq=f"ipc://{tmp_path}/link")):
        again = list(
            serve_robot(
                program, Transport(zmq=f"ipc://{tmp_path}/link"), episodes=3, lockstep=True, patience=10
            )
        )
    assert [episode.length for episode, _ in again] == lengths


def test_episodes_over_websocket() -> None:
    pytest.importorskip("websockets")
    program = untrained_bundle("cartpole")[0].program
    transport = Transport(websocket="58745")
    with served("cartpole", transport) as server:
        played = list(serve_robot(program, transport, episodes=2, lockstep=True, patience=10))
        again = list(
            serve_robot(program, transport, episodes=2, lockstep=True, patience=10)
        )  # a robot that comes back
    assert server.steps == 2 * sum(episode.length for episode, _ in played)
    assert [episode.length for episode, _ in again] == [episode.length for episode, _ in played]


def test_a_robot_without_a_policy_says_so(tmp_path: Path) -> None:
    program = api.compile("cartpole").program
    with pytest.raises(
        UsageError,
        match=r"nobody listens on ZeroMQ at ipc://.*; start the policy first: deepbots serve BUNDLE",
    ):
        next(serve_robot(program, Transport(zmq=f"ipc://{tmp_path}/nobody"), patience=0.1))
    with pytest.raises(UsageError, match="has copies of a robot"):
        next(serve_robot(api.compile("multi_cartpole").program, Transport(zmq=f"ipc://{tmp_path}/nobody")))
    with pytest.raises(UsageError, match="is not an address of ZeroMQ"):
        next(serve_robot(program, Transport(zmq="127.0.0.1:5555")))


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
    assert (there[0].length, here.length) == (
        pytest.approx(alone.length, abs=1),
        pytest.approx(alone.length, abs=2),
    )
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
    assert ([term.name for term in kept.agent.reward], [ending.name for ending in kept.endings]) == (
        ["time", "found"],
        ["found"],
    )
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
    assert ({episode["ended_by"] for episode in report["episodes"]}, report["link"]["refused"]) == (
        {"fallen"},
        {},
    )


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
        (["--lockstep"], "--lockstep needs --robot"),
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
