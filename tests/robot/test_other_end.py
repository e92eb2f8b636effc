"""A misfit at the other end of a link is reported in a sentence, on both sides."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

pytest.importorskip("zmq")
pytest.importorskip("msgspec")

import msgspec

from deepbots_robot.link import About, Link, differences, misfit, with_fields
from deepbots_robot.serving import ServeError, Transport
from deepbots_robot.topics import Field, Topic

ANGLE = Field("cart.angle", "cart", "joint_position", "rad", (1,), ("pole",))
PLACE = Field("cart.place", "cart", "joint_position", "m", (1,), ("slider",))
DRIVE = Field("cart.drive", "cart", "velocity", "rad/s", (2,), ("left", "right"))
STATES = Topic("/cart/joint_states", "sensor_msgs/JointState")
COMMANDS = Topic("/cart/joint_commands", "sensor_msgs/JointState")
POLICY = About("policy", "CartPole", "aa", "at speed 1")
ROBOT = About("robot", "CartPole", "aa", "at speed 1")


def policy_end(transport: Transport, about: About = POLICY) -> Link:
    return transport.open([(ANGLE, STATES)], [(DRIVE, COMMANDS)], robot=False, about=about)


def robot_end(
    transport: Transport, about: About = ROBOT, sends: Field = ANGLE, topic: Topic = STATES
) -> Link:
    return transport.open([(DRIVE, COMMANDS)], [(sends, topic)], robot=True, about=about)


def remarks_of(link: Link, until: Callable[[list[str]], bool] = bool) -> list[str]:
    """The remarks of a link, as soon as they satisfy `until`, or after 5 s."""
    ending = time.monotonic() + 5.0
    while time.monotonic() < ending:
        link.take()
        texts = [remark.text for remark in link.remarks()]
        if until(texts):
            break
        time.sleep(0.02)
    return texts


@pytest.mark.parametrize(
    ("sends", "problem"),
    [
        ((PLACE,), "the policy needs cart.angle (1 number in rad), which the robot does not send"),
        ((ANGLE, PLACE), "the robot sends cart.place (1 number in m), which the policy does not know"),
        (
            (Field("cart.angle", "cart", "orientation", "rad", (3,)),),
            "the robot sends cart.angle as 3 numbers in rad, and the policy takes 1 number in rad",
        ),
    ],
)
def test_fields_that_differ_are_named(sends: tuple[Field, ...], problem: str) -> None:
    policy, robot = with_fields(POLICY, [DRIVE], [ANGLE]), with_fields(ROBOT, sends, [DRIVE])
    assert (
        misfit(robot, policy)
        == f"the policy of CartPole at the other end does not fit this robot of CartPole: {problem}"
    )
    assert problem in misfit(policy, robot)
    assert misfit(policy, with_fields(ROBOT, [ANGLE], [DRIVE])) == ""


@pytest.mark.parametrize(
    ("other", "problem"),
    [
        (
            About("robot", "FindBall", "bb", "at speed 1"),
            "the robot of FindBall at the other end is of another scenario than this policy",
        ),
        (About("robot", "CartPole", "bb", "at speed 1"), "is of another version of the scenario"),
        (
            About("robot", "CartPole", "aa", "in lockstep"),
            "the robot runs in lockstep, and this policy at speed 1; give --lockstep, or",
        ),
        (
            About("robot", "CartPole", "aa", "at speed 2"),
            "the robot runs at speed 2, and this policy at speed 1",
        ),
    ],
)
def test_ends_that_work_together_but_differ_are_named(other: About, problem: str) -> None:
    (difference,) = differences(POLICY, other)
    assert problem in difference


def test_rates_that_differ_are_named_on_both_sides() -> None:
    policy, robot = (
        msgspec.structs.replace(each, rate=rate) for each, rate in ((POLICY, 31.25), (ROBOT, 62.5))
    )
    assert (
        differences(policy, robot)
        == differences(robot, policy)
        == ["the robot steps at 62.5 Hz, the policy acts at 31.25 Hz"]
    )
    assert (
        differences(policy, msgspec.structs.replace(robot, rate=1 / 0.032)),
        differences(policy, ROBOT),
    ) == ([], [])


def test_over_zeromq_nothing_of_another_scenario_is_used_and_both_ends_say_so(tmp_path: Path) -> None:
    transport = Transport(zmq=f"ipc://{tmp_path}/link")
    with (
        closing(policy_end(transport)) as policy,
        closing(robot_end(transport, About("robot", "Slider", "bb", "at speed 1"), PLACE)) as robot,
    ):
        while not robot.connected():
            time.sleep(0.01)
        robot.reset(0, 1.0)
        assert remarks_of(policy) == [
            "the robot of Slider at the other end does not fit this policy of CartPole:"
            " the policy needs cart.angle (1 number in rad), which the robot does not send"
        ]
        robot.send({"cart.place": [0.5]}, 1.0)  # type: ignore[dict-item]
        assert (
            "the policy of CartPole at the other end does not fit this robot of Slider"
            in remarks_of(robot)[0]
        )
        policy.wait(1.0)
        assert list(policy.take()) == []


@pytest.mark.parametrize("kind", ["ipc", "tcp", "websocket", "ros"])
def test_a_second_policy_is_refused(tmp_path: Path, kind: str) -> None:
    pytest.importorskip({"websocket": "websockets", "ros": "cyclonedds"}.get(kind, "zmq"))
    transport = {
        "ipc": Transport(zmq=f"ipc://{tmp_path}/link"),
        "tcp": Transport(zmq="tcp://127.0.0.1:58741"),
        "websocket": Transport(websocket="58742"),
        "ros": Transport(domain=74),
    }[kind]
    with closing(policy_end(transport)) as first:
        with pytest.raises(
            ServeError,
            match="another program sends commands on /cart/joint_commands"
            if kind == "ros"
            else "already in use",
        ):
            policy_end(transport)
        with closing(robot_end(transport)) as robot:  # the first one goes on
            until = time.monotonic() + 10.0
            while not robot.connected():
                assert time.monotonic() < until
            robot.reset(3, 1.0)
            first.wait(5.0)
            assert [each.number for each in first.take() if each.kind == "reset"] == [3]


def test_over_ros_types_and_second_senders_are_noticed() -> None:
    pytest.importorskip("cyclonedds")
    transport = Transport(domain=75)
    plain = Topic(STATES.name, "std_msgs/Float64MultiArray")
    with closing(policy_end(transport)) as policy, closing(robot_end(transport, topic=plain)) as robot:
        types = "/cart/joint_states has messages of the type {} at the other end, and {} here"
        assert types.format("std_msgs/Float64MultiArray", "sensor_msgs/JointState") in remarks_of(policy)
        assert remarks_of(robot) == [types.format("sensor_msgs/JointState", "std_msgs/Float64MultiArray")]
        assert all(remark.is_misfit for remark in robot.remarks())
        with closing(robot_end(transport)):
            twice = " ".join(remarks_of(policy, lambda texts: "programs send" in " ".join(texts)))
            assert "2 programs send on /cart/joint_states" in twice
            assert "(a program that was killed counts for 10 s)" in twice
            assert "2 programs send on /deepbots/episode" in " ".join(
                remarks_of(robot, lambda texts: "episode" in " ".join(texts))
            )
        assert "programs send" not in " ".join(
            remarks_of(policy, lambda texts: "programs send" not in " ".join(texts))
        )


@pytest.mark.slow
def test_over_ros_a_robot_that_has_ended_is_not_a_second_sender() -> None:
    pytest.importorskip("cyclonedds")
    transport = Transport(domain=78)
    with closing(policy_end(transport)) as policy:
        first = robot_end(transport)
        until = time.monotonic() + 5.0
        while not policy.others():
            assert policy.remarks() == []
            assert time.monotonic() < until
        first.close()
        with closing(robot_end(transport)) as second:
            while not second.connected():
                assert time.monotonic() < until
            settled = time.monotonic() + 0.5
            assert remarks_of(policy, lambda texts: time.monotonic() > settled) == []
        del first  # an ended link may live on in a variable


@pytest.mark.slow
def test_over_ros_another_scenario_in_the_domain_is_named_unless_the_own_one_is_there_too() -> None:
    pytest.importorskip("cyclonedds")
    transport = Transport(domain=76)
    other = Field("dog.angle", "dog", "joint_position", "rad", (1,), ("knee",))
    with closing(policy_end(transport)) as policy:
        dog = About("robot", "Dog", "bb", "at speed 1")
        with closing(
            robot_end(transport, dog, other, Topic("/dog/joint_states", "sensor_msgs/JointState"))
        ) as robot:
            problem = (
                "the policy needs cart.angle (1 number in rad), which the robot does not send; give"
                " each robot its own --domain"
            )
            assert (
                f"the robot of Dog at the other end does not fit this policy of CartPole: {problem}"
                in remarks_of(policy)[0]
            )
            assert (
                f"the policy of CartPole at the other end does not fit this robot of Dog: {problem}"
                in remarks_of(robot)[0]
            )
            assert [remark.is_misfit for remark in robot.remarks()] == [True]
            with closing(robot_end(transport, About("robot", "CartPole", "aa", "in lockstep"))):
                assert "the robot runs in lockstep" in " ".join(
                    remarks_of(policy, lambda texts: "lockstep" in " ".join(texts))
                )
                assert "Dog" not in " ".join(remark.text for remark in policy.remarks())


@pytest.mark.slow
def test_over_ros_a_scenario_of_another_name_fits_if_its_fields_do() -> None:
    pytest.importorskip("cyclonedds")
    transport = Transport(domain=79)
    with (
        closing(policy_end(transport)),
        closing(robot_end(transport, About("robot", "Cart", "bb", "at speed 1"))) as robot,
    ):
        assert remarks_of(robot) == [
            "the policy of CartPole at the other end is of another scenario than this robot of Cart"
        ]
        assert not robot.remarks()[0].is_misfit


def test_a_listener_that_asks_for_reliable_sensor_data_is_noticed() -> None:
    """As a subscriber of ROS 2 does by default."""
    pytest.importorskip("cyclonedds")
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic as DdsTopic

    from deepbots_robot import dds, ros

    with closing(robot_end(Transport(domain=77))) as robot:
        participant = DomainParticipant(77)
        listener = DataReader(
            participant,
            DdsTopic(participant, "rt/cart/joint_states", ros.TYPES["sensor_msgs/JointState"]),
            qos=dds.COMMANDS,
        )
        assert remarks_of(robot) == [
            "another program asks for reliable messages on /cart/joint_states, which is sent with best"
            " effort: none arrives there"
        ]
        del listener


def test_an_interface_that_does_not_exist_is_refused() -> None:
    pytest.importorskip("cyclonedds")
    with pytest.raises(ServeError, match=r"'nope0' is not a network interface of this machine; it has lo"):
        policy_end(Transport(interface="nope0"))
