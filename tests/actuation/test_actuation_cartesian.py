"""Arms that receive poses of their hand as commands: they reach them, stay in their ranges, and open their
fingers."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from deepbots_cli.runtime import Supervisor
from tests.worlds import SCENARIOS, Make

ARM = SCENARIOS / "arm.yaml"
HAND = "robots.panda.actuators.hand={type: cartesian, link: panda_grasptarget, joints: arm"
JOINTS = tuple(f"panda_joint{number}" for number in range(1, 8))


def act(
    environment: Supervisor, reach: tuple[float, float, float], opening: float = -1.0, ticks: int = 1
) -> None:
    for _ in range(ticks):
        environment.step(np.array([*reach, opening], np.float32))


def target_of(reach: tuple[float, float, float]) -> tuple[float, float, float]:
    """The place in the world that belongs to an action."""
    return (0.6 + 0.15 * reach[0], 0.2 + 0.15 * reach[1], 0.3 + 0.15 * reach[2])


@pytest.mark.slow
def test_the_hand_reaches_places_of_the_world_within_a_millimeter_and_keeps_its_attitude(make: Make):
    panda = make(ARM)
    read = panda.engine.pose("panda", "panda_grasptarget")
    states = panda.engine.joint_states("panda", JOINTS)
    model = panda.scenario.world.robots[0].model
    panda.reset(seed=0)
    rng = np.random.default_rng(3)
    for _ in range(4):
        x, y, z = (float(value) for value in rng.uniform(-1, 1, 3))
        act(panda, (x, y, z), ticks=60)
        position, orientation = read()
        assert position == pytest.approx(target_of((x, y, z)), abs=1e-3)
        assert abs(orientation[0]) == pytest.approx(1.0, abs=1e-4)  # half a turn about x
        for name, state in zip(JOINTS, states(), strict=True):
            limit = model.joint(name).limit
            assert limit.lower is not None
            assert limit.upper is not None
            assert limit.lower - 1e-3 <= state[0] <= limit.upper + 1e-3


@pytest.mark.slow
def test_a_stretched_arm_finds_a_way_to_bend(make: Make):
    panda = make(ARM, "reset.joints={panda.arm: 0 deg}")
    panda.reset(seed=0)
    act(panda, (0.0, 0.0, -1.0), ticks=80)
    assert panda.engine.pose("panda", "panda_grasptarget")()[0] == pytest.approx(
        target_of((0, 0, -1)), abs=1e-3
    )


def test_joints_move_no_faster_than_their_limits(make: Make):
    panda = make(ARM, f"{HAND}, rpy: 180 0 0 deg, max_velocity: 0.3 rad/s}}")
    states = panda.engine.joint_states("panda", JOINTS)
    panda.reset(seed=0)
    fastest = 0.0
    for _ in range(20):
        act(panda, (1.0, 1.0, -1.0))
        fastest = max(fastest, *(abs(state[1]) for state in states()))
    assert 0.2 < fastest < 0.33


def test_without_an_attitude_only_the_place_counts(make: Make):
    panda = make(ARM, f"{HAND}}}")
    panda.reset(seed=0)
    act(panda, (-1.0, 0.5, 1.0), ticks=60)
    assert panda.engine.pose("panda", "panda_grasptarget")()[0] == pytest.approx(
        target_of((-1, 0.5, 1)), abs=1e-3
    )


def test_a_target_out_of_reach_is_approached(make: Make):
    panda = make(ARM, "robots.panda.apply.hand=vector(5 m, 0 m, 0.4 m) + 1 m * reach")
    panda.reset(seed=0)
    act(panda, (0.0, 0.0, 0.0), ticks=60)
    x, y, _ = panda.engine.pose("panda", "panda_grasptarget")()[0]
    assert x > 0.7
    assert abs(y) < 0.2


@pytest.mark.slow
def test_a_gripper_goes_from_closed_to_open(make: Make):
    panda = make(ARM, "robots.panda.apply.grip=2 * open - 0.5")
    fingers = panda.engine.joint_states("panda", ("panda_finger_joint1", "panda_finger_joint2"))
    panda.reset(seed=0)
    for action, opening in ((-1.0, 0.0), (0.0, 0.02), (1.0, 0.04), (-0.5, 0.0)):
        act(panda, (0.0, 0.0, 0.0), action, ticks=20)
        assert [state[0] for state in fingers()] == pytest.approx([opening] * 2, abs=5e-4)


@pytest.mark.slow
def test_the_same_commands_give_the_same_motion_after_any_past(make: Make):
    used, fresh = make(ARM), make(ARM)
    used.reset(seed=1)
    act(used, (0.3, -0.7, 0.5), ticks=17)
    states = []
    for panda in (used, fresh):
        panda.reset(seed=2)
        act(panda, (-0.4, 0.2, 0.9), 0.3, ticks=15)
        states.append(panda.engine.joint_states("panda", JOINTS)())
    assert [state[:2] for state in states[0]] == [state[:2] for state in states[1]]


@pytest.mark.slow
@pytest.mark.parametrize("route", ["latency: 1 s", "loss: 100 %"])
def test_an_arm_whose_first_command_is_late_or_lost_does_not_fall(make: Make, route: str):
    panda = make(
        ARM, f"messages.to_robot={{{route}}}", "reset.joints={panda.arm: ready, panda.fingers: 30 mm}"
    )
    states = panda.engine.joint_states("panda", (*JOINTS, "panda_finger_joint1"))
    panda.reset(seed=0)
    before = [state[0] for state in states()]
    act(panda, (0.0, 0.0, -1.0), ticks=20)
    assert [state[0] for state in states()] == pytest.approx(before, abs=2e-3)


@pytest.mark.slow
def test_a_late_spring_holds_with_its_own_stiffness_and_sags_as_it_would_under_that_command(make: Make):
    spring = (
        "robots.panda.actuators.hand={type: position_motor, joints: arm, stiffness: 500 N*m/rad,"
        " damping: 50 N*m*s/rad}"
    )
    steady = ("robots.panda.apply={hand: ready + 1e-9 rad * reach, grip: open}", "action.reach.range=-1 .. 1")
    late, prompt = (
        make(ARM, spring, *steady, f"messages.to_robot={{latency: {latency}}}") for latency in ("10 s", "0 s")
    )
    states = []
    for panda in (late, prompt):
        panda.reset(seed=0)
        for _ in range(20):
            panda.step(0 * panda.action_space.sample())
        states.append([state[0] for state in panda.engine.joint_states("panda", JOINTS)()])
    assert states[0] == pytest.approx(
        states[1], abs=1e-8
    )  # the solver stops at 1e-7; one finger follows the other
    assert states[0] != pytest.approx([0, -np.pi / 6, 0, -np.pi / 1.5, 0, np.pi / 2, np.pi / 4], abs=1e-4)


def test_the_attitude_is_that_of_roll_pitch_and_yaw_in_the_world(make: Make):
    panda = make(ARM, f"{HAND}, rpy: 180 0 90 deg}}")
    panda.reset(seed=0)
    act(panda, (0.0, 0.0, 0.0), ticks=80)
    x, y, _, _ = panda.engine.pose("panda", "panda_grasptarget")()[1]
    assert 2 * np.arctan2(y, x) % (2 * pi) == pytest.approx(pi / 2, abs=1e-3)
