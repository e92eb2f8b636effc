"""A bundle at one end of a link and the simulation at the other act as the policy in the environment does."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
pytest.importorskip("zmq")

from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.errors import UsageError
from deepbots_cli.insight.export.recording import with_probes
from deepbots_cli.insight.robot import SimulatedRobot, robot_program, sent_readings, serve_robot
from deepbots_cli.program import Program
from deepbots_cli.program.topics import mapping
from deepbots_cli.rollout import Start, steps
from deepbots_cli.rollout.policies import PolicyDriver
from deepbots_robot.server import Server
from deepbots_robot.serving import Transport, field_of, inputs_of, mapped, outputs_of
from deepbots_robot.topics import Field, Topic, action_field
from tests.bundle.untrained import untrained_bundle
from tests.few import WORLDS, few

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


@pytest.mark.parametrize("scenario", few(SINGLE, WORLDS))
def test_an_episode_over_a_link_is_that_of_the_environment(scenario: str, tmp_path: Path) -> None:
    step, learner, _ = untrained_bundle(scenario)
    count = SENSITIVE_AFTER.get(scenario, STEPS)
    program = without_noise(robot_program(step.program))
    with closing(api.build(program)) as world:
        alone = list(
            itertools.islice(steps(world, PolicyDriver(learner, world), Start.of_evaluation(3, 0)), count)
        )
    readings = sent_readings(program)
    transport = Transport(zmq=f"ipc://{tmp_path}/link")
    with served(scenario, transport), closing(api.build(with_probes(program, readings))) as world:
        outputs = step.outputs
        sends = [(field_of(reading.info), None) for reading in readings]
        receives = [_action(program), *((field_of(entry), None) for entry in outputs)]
        link = transport.open(receives, sends, robot=True)  # type: ignore[arg-type]
        with closing(link):
            robot = SimulatedRobot(world, readings, outputs, link, lockstep=True, patience=10)
            over_link = list(itertools.islice(steps(world, robot, Start.of_evaluation(3, 0)), count))
    assert [each.is_last for each in over_link] == [each.is_last for each in alone]
    for expected_step, actual_step in zip(alone, over_link, strict=True):
        assert actual_step.reward == pytest.approx(expected_step.reward, abs=1e-3)
        for expected, actual in zip(
            arrays_of(expected_step.observation), arrays_of(actual_step.observation), strict=True
        ):
            np.testing.assert_allclose(actual, expected, atol=2e-3, err_msg=f"step {expected_step.number}")
    assert robot.steps == len(alone) - 1


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
