"""ROS 1: two processes and a master on the loopback interface, where Debian's ros-core is installed."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

from tests.bundle.untrained import write_bundle

ROOT = Path(__file__).parents[2]
SYSTEM = "/usr/lib/python3/dist-packages"
"""Where Debian has rospy, which belongs to the Python of the system."""
PROGRAM = f"""
import runpy, sys
sys.path.append("{SYSTEM}")
sys.argv[:2] = sys.argv[1:2]
runpy.run_module(sys.argv[0], run_name="__main__")
"""


def has_rospy() -> bool:
    code = f"import sys; sys.path.append('{SYSTEM}'); import rospy, sensor_msgs.msg, nav_msgs.msg"
    return (
        shutil.which("rosmaster") is not None
        and subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0
    )


needs_ros = pytest.mark.skipif(
    not has_rospy(),
    reason="rospy is not installed: apt install ros-core python3-sensor-msgs python3-nav-msgs",
)


@pytest.fixture
def master(tmp_path: Path) -> Iterator[dict[str, str]]:
    """The environment of processes with a master of their own."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = {
        **os.environ,
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
        "ROS_IP": "127.0.0.1",
        "ROS_LOG_DIR": str(tmp_path / "ros"),
    }
    running = subprocess.Popen(
        ["rosmaster", "--core", "-p", str(port)],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        until = time.monotonic() + 30
        while socket.socket().connect_ex(("127.0.0.1", port)):
            assert time.monotonic() < until
            time.sleep(0.05)
        yield environment
    finally:
        running.terminate()
        running.wait(10)


def started(environment: dict[str, str], *words: object) -> subprocess.Popen[str]:
    words = (sys.executable, "-c", PROGRAM, *words)
    return subprocess.Popen(
        [*map(str, words)],
        cwd=ROOT,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


@needs_ros
def test_a_policy_acts_for_a_robot_over_ros_1_and_a_second_one_is_refused(
    master: dict[str, str], tmp_path: Path
) -> None:
    bundle = write_bundle(tmp_path / "bundle", "cartpole")
    serve = ("deepbots_robot", bundle, "--ros1", "--lockstep", "--json")
    policy = started(master, *serve)
    robot = started(
        master,
        "deepbots_cli",
        "serve",
        "cartpole",
        "--as-robot",
        "--ros1",
        "--lockstep",
        "--episodes",
        20,
        "--json",
    )
    out, err = robot.communicate(timeout=200)
    assert robot.returncode == 0, err
    driven = json.loads(out)
    second = started(master, *serve, "--seconds", 5)
    assert (
        "another program sends commands on /cart/joint_commands in ROS 1"
        in second.communicate(timeout=200)[1]
    )
    assert second.returncode == 1
    policy.send_signal(2)
    out, err = policy.communicate(timeout=30)
    served = json.loads(out)
    assert served["steps"] == driven["steps"]
    assert served["episodes"] == driven["episodes"] == 20
    assert served["refused"] == {}
    over_zmq = tmp_path / "link"
    policy = started(master, "deepbots_robot", bundle, "--zmq", f"ipc://{over_zmq}", "--lockstep")
    robot = started(
        master,
        "deepbots_cli",
        "serve",
        "cartpole",
        "--as-robot",
        "--zmq",
        f"ipc://{over_zmq}",
        "--lockstep",
        "--episodes",
        20,
        "--json",
    )
    again = json.loads(robot.communicate(timeout=200)[0])
    policy.kill()
    policy.communicate()
    assert (again["steps"], again["mean_return"]) == (driven["steps"], driven["mean_return"])


@needs_ros
@pytest.mark.slow
def test_after_the_table_the_process_ends_at_once_and_a_further_interrupt_prints_nothing(
    master: dict[str, str], tmp_path: Path
) -> None:
    bundle = write_bundle(tmp_path / "bundle", "cartpole")
    for further in (False, True):
        policy = started(master, "deepbots_cli", "serve", bundle, "--ros1", "--seconds", 60)
        assert policy.stderr is not None
        assert policy.stdout is not None
        assert "it waits for" in policy.stderr.readline()
        policy.send_signal(2)
        assert "ROS 1, master" in policy.stdout.readline()
        ended = time.monotonic()
        if further:
            time.sleep(0.05)
            policy.send_signal(2)
        assert "Traceback" not in policy.stderr.read()
        policy.wait(30)
        assert time.monotonic() - ended < 3.0
        policy.communicate()


@needs_ros
def test_all_message_types_of_ros_1_carry_their_parts() -> None:
    code = f"""
import sys; sys.path.append({SYSTEM!r})
import io, math, numpy as np
from deepbots_robot import ros, ros1
from deepbots_robot.topics import PARTS, first_mapping
from tests.robot.test_ros_messages import FIELDS
mapping, seen = first_mapping(FIELDS), set()
mapped = [(field, mapping[field.name]) for field in FIELDS]
for name, codec in ros.by_topic(mapped, ros1.empty).items():
    values = {{field.name: np.arange(field.count).reshape(field.shape) for field in codec.fields}}
    buffer = io.BytesIO(); codec.encode(values, 12.25).serialize(buffer)
    again = ros1.message_class(codec.type)().deserialize(buffer.getvalue())
    assert ros1._stamp_of(again) in (12.25, None)
    for field, value in codec.decode(again).items():
        np.testing.assert_array_equal(value, values[field])
for type, parts in PARTS.items():
    for part in ros.parts(type).values():
        holder, name = ros._holder(ros1.empty(type, 1.0, ""), part.path)
        assert hasattr(holder, name), (type, part)
print("done")
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout == "done\n", done.stderr


@needs_ros
def test_without_a_master_it_says_so(tmp_path: Path) -> None:
    bundle = write_bundle(tmp_path / "bundle", "cartpole")
    server = started(
        {**os.environ, "ROS_MASTER_URI": "http://127.0.0.1:9"}, "deepbots_robot", bundle, "--ros1"
    )
    assert (
        "no ROS master answers at http://127.0.0.1:9; start `roscore`, or set ROS_MASTER_URI"
        in server.communicate(timeout=200)[1]
    )


def test_without_rospy_it_says_where_it_belongs(tmp_path: Path) -> None:
    pytest.importorskip("msgspec")
    from deepbots_robot.serving import ServeError, Transport

    try:
        import rospy  # noqa: F401
    except ModuleNotFoundError:
        with pytest.raises(
            ServeError,
            match=r"is not installed for this Python; rospy is installed for the Python of the system",
        ):
            Transport(ros1=True).open([], [], robot=False)
