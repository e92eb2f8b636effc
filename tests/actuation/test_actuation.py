"""Motors of scenarios against closed forms: strength, delay, lag, limits, and what an episode draws of
them.

Arms that receive poses of their hand as commands: they reach them, stay in their ranges, and open their
fingers.

Disturbances: momentum is force times time, pushes come when they are due, and come again with the seed.

Rotors against closed forms: a quadrotor hovers, climbs, turns and lags as its figures say.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import ceil, exp, inf, isclose, pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.engines import ENGINES
from deepbots_cli.program.robots import Motor
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.actuation import Push, Response
from tests.worlds import RAIL, SCENARIOS, Make, begun

STRONG = "robots.cart.joints={slider: {max_torque: 100 kN}}"
"""The limit of the robot file is 10 N, and a greater one of an actuator has no effect."""

TICK = 0.02
FORWARD, BACKWARD = 0, 1
ENDLESS = ("termination={failure: {off: abs(cart.place) > 1000 m}}", "reset={joints: {cart.hinge: 180 deg}}")


@pytest.fixture
def rail(make: Make) -> Make:
    """The cart on a rail with settings of its motor, as in `rail(time_constant="20 ms")`."""

    def make_rail(*overrides: str, engine: str = "exact", **motor: str) -> Supervisor:
        keys = [f"robots.cart.actuators.motor.{key}={value}" for key, value in motor.items()]
        return make(RAIL, STRONG, *overrides, *keys, engine=engine)

    return make_rail


def cart_speeds(environment: Supervisor, ticks: int, action: int = FORWARD, seed: int = 0) -> list[float]:
    """The velocity of the cart after each substep of some ticks."""
    environment.reset(seed=seed)
    read = environment.engine.joint_states("cart", ("slider",))
    speeds: list[float] = []
    substeps = environment.scenario.world.substeps

    def one_by_one(number: int) -> None:
        assert number == substeps
        for _ in range(number):
            environment.engine.step(1)
            speeds.append(read()[0][1])

    environment.physics = one_by_one
    for _ in range(ticks):
        environment.step(action)
    return speeds


@pytest.mark.parametrize("substeps", [1, 2, 4, 8])
def test_a_lagging_motor_follows_the_exponential_after_every_substep(rail: Make, substeps: int):
    motor = rail(f"world.substeps={substeps}", *ENDLESS, time_constant="50 ms", max_torque="100 kN")
    for k, speed in enumerate(cart_speeds(motor, 10), start=1):
        assert speed == pytest.approx(1 - exp(-k * TICK / substeps / 0.05), abs=1e-6)


@pytest.mark.parametrize("substeps", [1, 2, 4, 8])
@pytest.mark.parametrize("delay", [0.0, 0.003, 0.01, 0.02, 0.034])
def test_a_delay_counts_in_substeps_whatever_the_tick(rail: Make, substeps: int, delay: float):
    motor = rail(f"world.substeps={substeps}", *ENDLESS, delay=f"{delay} s", max_torque="100 kN")
    waits = ceil(delay / TICK * substeps - 1e-9)
    speeds = cart_speeds(motor, 5)
    assert (speeds[waits], speeds[:waits]) == (
        pytest.approx(1.0, abs=1e-6),
        pytest.approx([0.0] * waits, abs=1e-6),
    )


def test_an_acceleration_limit_gives_a_ramp(rail: Make):
    speeds = cart_speeds(rail(*ENDLESS, max_acceleration="5 m/s^2", max_torque="100 kN"), 15)
    assert speeds == pytest.approx([min(1.0, 5.0 * k * TICK / 4) for k in range(1, 61)], abs=1e-6)


@pytest.mark.parametrize("substeps", [1, 2, 8])
@pytest.mark.parametrize("kind", ["torque_motor", "velocity_motor"])
def test_strength_multiplies_what_a_motor_exerts_whatever_the_substeps(rail: Make, substeps: int, kind: str):
    command = "drive * 10 N" if kind == "torque_motor" else "drive * 1000 m/s"
    weak = rail(
        f"world.substeps={substeps}",
        *ENDLESS,
        f"robots.cart.apply.motor={command}",
        type=kind,
        strength="0.7",
    )
    full = rail(
        f"world.substeps={substeps}",
        *ENDLESS,
        f"robots.cart.apply.motor={command.replace('10 N', '7 N')}",
        type=kind,
    )
    if kind == "velocity_motor":
        full.engine.close()
        full = rail(
            f"world.substeps={substeps}",
            *ENDLESS,
            f"robots.cart.apply.motor={command}",
            type=kind,
            max_torque="7 N",
        )
    assert cart_speeds(weak, 5) == pytest.approx(cart_speeds(full, 5), rel=1e-12)
    assert weak.engine.joint_torques("cart", ("slider",))()[0] == pytest.approx(7.0)


def test_strength_multiplies_the_spring_its_damper_and_its_limit(rail: Make):
    spring = {"type": "position_motor", "max_torque": "8 N"}
    apply = "robots.cart.apply.motor=drive * 0.2 m"
    weak = rail(*ENDLESS, apply, stiffness="50 N/m", damping="4 N*s/m", strength="0.5", **spring)
    half = rail(
        *ENDLESS, apply, stiffness="25 N/m", damping="2 N*s/m", type="position_motor", max_torque="4 N"
    )
    assert cart_speeds(weak, 20) == pytest.approx(cart_speeds(half, 20), rel=1e-12)


def test_a_position_motor_moves_its_target_no_faster_than_its_velocity_limit(rail: Make):
    arm = rail(
        *ENDLESS,
        "robots.cart.apply.motor=drive * 0.3 m",
        type="position_motor",
        max_velocity="0.5 m/s",
        max_torque="100 kN",
    )
    assert max(cart_speeds(arm, 100)) < 0.5 * 1.01
    assert arm.engine.joint_states("cart", ("slider",))()[0][0] == pytest.approx(0.3, abs=1e-3)


def test_a_perfect_motor_prints_the_writer_of_the_engine_and_nothing_of_a_device():
    plain = api.compile(RAIL).code
    assert 'self.drive_motor = engine.velocity_motor("cart", ("slider",), (10.0,))' in plain
    assert "release" not in plain
    weak = api.compile(RAIL, overrides=["robots.cart.actuators.motor.strength=0.5"]).code
    assert 'engine.velocity_motor("cart", ("slider",), (5.0,))' in weak


def test_actuators_hold_while_the_world_settles(rail: Make):
    tilted = "reset={joints: {cart.hinge: 90 deg}, settle: 0.4 s}"
    held = begun(rail(ENDLESS[0], tilted, max_torque="100 kN"))
    assert held.engine.joint_states("cart", ("slider",))()[0][0] == pytest.approx(0.0, abs=1e-6)
    spring = begun(
        rail(
            ENDLESS[0],
            tilted,
            "robots.cart.apply.motor=drive * 1 m",
            type="position_motor",
            max_torque="100 kN",
        )
    )
    assert spring.engine.joint_states("cart", ("slider",))()[0][0] == pytest.approx(0.0, abs=1e-3)
    let_go = begun(rail(ENDLESS[0], tilted, "robots.cart.apply.motor=drive * 1 N", type="torque_motor"))
    assert abs(let_go.engine.joint_states("cart", ("slider",))()[0][0]) > 0.01


@pytest.mark.parametrize("target", ["1 m/s", "1 m"], ids=["velocity", "position"])
@pytest.mark.parametrize(
    "late",
    [
        "messages.to_robot={latency: 100 ms}",
        "messages.timing=delayed",
        "robots.cart.actuators.motor.delay=100 ms",
    ],
)
def test_a_motor_holds_until_its_first_command_takes_effect(rail: Make, target: str, late: str):
    command = (
        f"robots.cart.apply.motor=drive * {target}",
        "reset={joints: {cart.hinge: 45 deg, cart.slider: 0.3 m}}",
    )
    kind = {"1 m/s": "velocity_motor", "1 m": "position_motor"}[target]
    held = begun(rail(ENDLESS[0], *command, late, type=kind, max_torque="100 kN"))
    held.step(FORWARD)
    assert held.engine.joint_states("cart", ("slider",))()[0][0] == pytest.approx(0.3, abs=1e-6)


def test_a_torque_motor_exerts_nothing_until_its_first_command_arrives(rail: Make):
    limp = rail(
        *ENDLESS,
        "robots.cart.apply.motor=drive * 1 N",
        "messages.to_robot={latency: 100 ms}",
        type="torque_motor",
    )
    torque = limp.engine.joint_torques("cart", ("slider",))
    limp.reset(seed=0)
    torques = []
    for _ in range(6):
        limp.step(FORWARD)
        torques.append(torque()[0])
    assert torques == [0.0] * 5 + [1.0]


def test_the_target_of_a_spring_jumps_unless_the_scenario_bounds_how_fast_it_moves():
    servo = [
        "robots.cart.apply.motor=drive * 0.2 m",
        "robots.cart.actuators.motor={type: position_motor, joint: slider}",
    ]
    spring = [*servo, "robots.cart.actuators.motor.stiffness=50 N/m"]
    assert "engine.position_motor(" in api.compile(RAIL, overrides=spring).code
    assert (
        "rates=(1.0,)"
        in api.compile(RAIL, overrides=[*spring, "robots.cart.actuators.motor.max_velocity=1 m/s"]).code
    )
    assert "rates=(100.0,)" in api.compile(RAIL, overrides=servo).code


@pytest.mark.parametrize("substeps", [1, 2, 8])
@pytest.mark.parametrize(
    ("target", "motor"),
    [
        ("1000 m/s", {"type": "velocity_motor"}),
        ("1000 N", {"type": "torque_motor"}),
        ("1000 m", {"type": "position_motor", "stiffness": "50 N/m"}),
    ],
    ids=["velocity", "torque", "spring"],
)
def test_a_limit_times_strength_is_all_that_a_motor_exerts_whatever_the_substeps(
    rail: Make, target: str, motor: dict[str, str], substeps: int
):
    apply = f"robots.cart.apply.motor=drive * {target}"
    weak = begun(
        rail(f"world.substeps={substeps}", *ENDLESS, apply, engine="pybullet", strength="0.5", **motor)
    )
    weak.step(FORWARD)
    ((_, speed, *_),) = weak.engine.joint_states("cart", ("slider",))()
    # The rod hangs still at first, and a quarter of its mass moves along.
    assert speed == pytest.approx(5.0 * TICK / (1.0 + 0.1 / 4), rel=1e-2)


def test_an_actuator_may_be_called_like_a_sensor(rail: Make):
    twins = rail(
        *ENDLESS,
        "robots.cart.actuators={place: {type: velocity_motor, joint: slider, time_constant: 20 ms}}",
        "robots.cart.apply={place: drive * 1 m/s - 0.1 * place / s}",
    )
    assert 0.8 < cart_speeds(twins, 20)[-1] < 1.0


@pytest.mark.parametrize("limit", ["20 N", "uniform(20 .. 30 N)"])
def test_a_limit_beyond_that_of_the_robot_file_has_no_effect(make: Make, limit: str):
    world = make(RAIL, f"robots.cart.actuators.motor.max_torque={limit}", *ENDLESS, engine="exact")
    assert cart_speeds(world, 3) == cart_speeds(make(RAIL, *ENDLESS, engine="exact"), 3)


def test_a_limit_over_several_joints_tightens_those_that_allow_more():
    program = api.compile(
        "quadruped", overrides=["robots.dog.urdf=package://pybullet_data/a1/a1.urdf"]
    ).program
    legs = program.robots[0].actuators[0]
    files = {joint.name: joint.limit.effort for joint in program.world.robots[0].model.moving_joints}
    assert isinstance(legs, Motor)
    assert {files[name]: most for name, most in zip(legs.joints, legs.max_torque, strict=True)} == {
        20.0: 20.0,
        55.0: 33.5,
    }


# Commands on their way: the closed forms of delay, lag and a limited rate


SUBSTEP = 0.005


def followed_values(response: Response, substeps: int) -> list[float]:
    """The value that is followed in each of the next substeps; NaN before the first command takes effect."""
    values = []
    now = float("nan")
    for _ in range(substeps):
        position = response.advance()
        now = now if position is None else position[0]
        values.append(now)
    return values


def zero() -> list[float]:
    return [0.0]


def test_a_lag_ends_at_the_command_and_then_has_nothing_to_do():
    response = Response(SUBSTEP, zero, time_constant=0.01)
    response.send([0.3])
    assert followed_values(response, 200)[-1] == pytest.approx(0.3, abs=1e-15)
    assert response.advance() is None


@pytest.mark.parametrize("substeps", [1, 2, 4, 8])
def test_a_delay_longer_than_a_tick_keeps_commands_in_order(substeps: int):
    response = Response(SUBSTEP, zero, delay=2.5 * SUBSTEP)
    changes = {}
    for tick in range(10):
        response.send([float(tick)])
        for k in range(substeps):
            position = response.advance()
            if position is not None:
                changes[tick * substeps + k] = position[0]
    assert changes == {
        tick * substeps + 3: float(tick) for tick in range(10) if tick * substeps + 3 < 10 * substeps
    }


def test_a_rate_bounds_every_change_and_the_command_is_reached_exactly():
    response = Response(SUBSTEP, lambda: [0.1, 0.0], rates=[2.0, inf])
    response.send([0.15, 5.0])
    for k in range(1, 5):
        first, second = response.advance() or ()
        assert (first, second) == (pytest.approx(0.1 + k * 2.0 * SUBSTEP), 5.0)
    assert (response.advance() or (0.0,))[0] == pytest.approx(0.15)


def test_figures_below_zero_count_as_zero():
    response = Response(SUBSTEP, zero, delay=-1.0, time_constant=-1.0)
    response.send([1.0])
    assert response.advance() == [1.0]


BEAM = """<robot name="beam">
  <link name="stand"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="beam">
    <inertial><mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="hinge" type="continuous">
    <parent link="stand"/><child link="beam"/><axis xyz="0 1 0"/><limit effort="1000" velocity="100"/>
  </joint>
</robot>
"""
HELD = """deepbots: 1
name: Held
world: {timestep: 10 ms, substeps: 5, engine: %s}
robots:
  arm:
    urdf: beam.urdf
    base: fixed
    links: {beam: %s}
    joints: {hinge: %s}
    actuators: {hinge: {type: position_motor, joint: hinge, stiffness: 2000 N*m/rad, damping: 5 N*m*s/rad}}
    apply: {hinge: 0 rad * push}
action: {push: -1 .. 1}
augment: [torque]
signals: {torque: joint_torque(arm.hinge)}
observation: {torque: {range: -50 .. 50 N*m, clip: false}}
reward: {one: 1}
truncation: {max_steps: 1000}
"""


def held_beam(make: Make, tmp_path: Path, engine: str, link: str, joint: str = "{}") -> Supervisor:
    """A beam of 2 kg that a stiff motor holds level."""
    (tmp_path / "beam.urdf").write_text(BEAM, encoding="utf-8")
    scenario = tmp_path / "held.yaml"
    scenario.write_text(HELD % (engine, link, joint), encoding="utf-8")
    return make(scenario)


@pytest.mark.parametrize("engine", sorted(ENGINES))
@pytest.mark.parametrize("offset", [0.2, -0.1])
def test_a_motor_holds_the_weight_of_a_link_at_its_center_of_mass(
    make: Make, tmp_path: Path, engine: str, offset: float
) -> None:
    beam = begun(held_beam(make, tmp_path, engine, f"{{com: {offset} 0 0 m}}"))
    for _ in range(100):
        (share,), *_ = beam.step(np.zeros(1, np.float32))
    assert -50 * share == pytest.approx(2.0 * 9.81 * offset, rel=1e-3)


@pytest.mark.parametrize("engine", sorted(ENGINES))
def test_strength_multiplies_the_stall_torque(make: Make, tmp_path: Path, engine: str) -> None:
    """A motor at half strength approaches its no-load speed half as fast."""
    motor = "{type: torque_motor, joint: hinge, stall_torque: 4 N*m, no_load_speed: 10 rad/s%s}"
    speeds = []
    for strength in ("", ", strength: 0.5"):
        (tmp_path / "beam.urdf").write_text(BEAM, encoding="utf-8")
        scenario = tmp_path / "spun.yaml"
        text = HELD % (engine, "{}", "{}")
        head, tail = text.index("    actuators"), text.index("    apply")
        text = f"{text[:head]}    actuators: {{hinge: {motor % strength}}}\n{text[tail:]}"
        scenario.write_text(text.replace("0 rad * push", "1000 N*m * push"), encoding="utf-8")
        beam = begun(make(scenario))
        for _ in range(5):
            beam.step(np.ones(1, np.float32))
        speeds.append(beam.engine.joint_states("arm", ("hinge",))()[0][1])
    rate = 4.0 / 10.0 / 0.02
    assert speeds == pytest.approx([10 * (1 - exp(-rate * 0.05)), 10 * (1 - exp(-rate * 0.025))], rel=0.03)


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
    panda = begun(make(ARM, "reset.joints={panda.arm: 0 deg}"))
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
    panda = begun(make(ARM, f"{HAND}}}"))
    act(panda, (-1.0, 0.5, 1.0), ticks=60)
    assert panda.engine.pose("panda", "panda_grasptarget")()[0] == pytest.approx(
        target_of((-1, 0.5, 1)), abs=1e-3
    )


def test_a_target_out_of_reach_is_approached(make: Make):
    panda = begun(make(ARM, "robots.panda.apply.hand=vector(5 m, 0 m, 0.4 m) + 1 m * reach"))
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
    panda = begun(make(ARM, f"{HAND}, rpy: 180 0 90 deg}}"))
    act(panda, (0.0, 0.0, 0.0), ticks=80)
    x, y, _, _ = panda.engine.pose("panda", "panda_grasptarget")()[1]
    assert 2 * np.arctan2(y, x) % (2 * pi) == pytest.approx(pi / 2, abs=1e-3)


DRONE = SCENARIOS / "drone.yaml"
MASS = 0.02572680943 + 4 * 0.0005
DRONE_TICK = 0.01
ALONE = (
    "world.gravity=0 0 0 m/s^2",
    "parameters.hover=0 N",
    "reset={place: {drone: {z: 1 m}}}",
    "robots.drone.actuators.rotors.time_constant=0 ms",
)


@pytest.fixture
def pushed(make: Make) -> Make:
    """A quadrotor that floats, with rotors at rest, under the given disturbances."""

    def float_under(disturbances: str, *overrides: str) -> Supervisor:
        return make(DRONE, *ALONE, *overrides, f"disturbances={disturbances}")

    return float_under


def velocities(environment: Supervisor, ticks: int, seed: int = 0) -> list[tuple[float, float, float]]:
    """The velocity after each tick."""
    environment.reset(seed=seed)
    read = environment.engine.velocity("drone")
    per_tick = []
    for _ in range(ticks):
        environment.step(np.zeros(4, np.float32))
        per_tick.append(read()[0])
    return per_tick


def test_pushes_repeat_after_their_interval_and_the_first_comes_after_one(pushed: Make):
    often = pushed("{push: {body: drone, force: 0 0.01 0 N, every: 0.2 s, duration: 20 ms}}")
    speeds = [speed[1] for speed in velocities(often, 100)]
    jumps = [k for k in range(1, 100) if speeds[k] > speeds[k - 1] + 1e-6]
    assert jumps == [k for start in (20, 40, 60, 80) for k in (start, start + 1)]


def test_at_says_when_the_first_of_many_pushes_comes(pushed: Make):
    often = pushed("{push: {body: drone, force: 0 0.01 0 N, at: 0 s, every: 0.5 s, duration: 10 ms}}")
    speeds = [speed[1] for speed in velocities(often, 100)]
    assert [k for k in range(100) if speeds[k] > (speeds[k - 1] if k else 0.0) + 1e-6] == [0, 50]


def test_nothing_pushes_while_the_world_settles(pushed: Make):
    settled = pushed(
        "{push: {body: drone, force: 0 0.01 0 N, at: 0 s, duration: 10 ms}}", "reset.settle=0.5 s"
    )
    assert settled.reset(seed=0)
    assert settled.engine.velocity("drone")()[0] == pytest.approx((0, 0, 0), abs=1e-12)
    assert velocities(settled, 3)[-1][1] == pytest.approx(0.01 * 0.01 / MASS, rel=1e-3)


def test_a_drawn_parameter_may_set_the_force_of_all_pushes_of_an_episode(pushed: Make):
    windy = pushed(
        "{push: {body: drone, force: 'vector(wind, 0 N, 0 N)', every: 0.1 s, duration: 50 ms}}",
        "parameters.wind=uniform(1 .. 20 mN)",
    )
    speeds = velocities(windy, 40, seed=3)
    assert speeds[19][0] > 0
    assert speeds[39][0] == pytest.approx(3 * speeds[19][0], rel=1e-3)


@pytest.mark.parametrize(("duration", "interval"), [(1.25, 2.1), (1.4, 1.4), (0.3, 0.7)])
def test_pushes_that_end_within_a_substep_lose_nothing_over_many(duration: float, interval: float):
    forces: list[float] = []
    acts: list[Callable[[], object]] = []
    engine: Any = SimpleNamespace(
        pusher=lambda part: lambda force, torque: forces.append(force[0]), before_substep=acts.append
    )
    push = Push(engine, ("body", None), lambda: ((2.0, 0.0, 0.0), (0.0, 0.0, 0.0), duration, interval), 1.0)
    push.reset(0.0, 0)
    for _ in range(2100):
        acts[0]()
    assert isclose(sum(forces), 2100 * 2.0 * duration / interval, rel_tol=2e-3)


GRAVITY = 9.81
LEVEL = "reset={place: {drone: {z: 1 m}}}"
PERFECT = (
    "robots.drone.actuators.rotors={type: thrust, links: [prop_*], range: 0 .. 0.15 N,"
    " moment_constant: 16 mm, spin: 1}"
)
BALANCED = PERFECT.replace("spin: 1", "spin: {prop_fl: 1, prop_fr: -1, prop_rl: -1, prop_rr: 1}")
EXACT_HOVER = f"parameters.hover={MASS * GRAVITY / 4!r} N"


@pytest.fixture
def drone(make: Make) -> Make:
    return partial(make, DRONE, LEVEL, "disturbances={}")


def fly(environment: Supervisor, ticks: int, pushes: tuple[float, ...] = (0.0,) * 4, seed: int = 0) -> None:
    environment.reset(seed=seed)
    for _ in range(ticks):
        environment.step(np.array(pushes, np.float32))


def test_uneven_thrust_tilts_towards_the_weaker_side(drone: Make):
    tilting = drone(BALANCED, EXACT_HOVER)
    fly(tilting, 3, (-0.3, -0.3, 0.3, 0.3))  # front, front, rear, rear: the nose goes down
    _, (roll_rate, pitch_rate, _) = tilting.engine.velocity("drone")()
    assert pitch_rate > 1.0
    assert roll_rate == pytest.approx(0.0, abs=1e-3)


def test_commands_beyond_the_range_are_brought_to_its_end(drone: Make):
    falling = drone(PERFECT, "parameters.hover=-10 N")
    fly(falling, 20)
    (_, _, speed), _ = falling.engine.velocity("drone")()
    assert speed == pytest.approx(-GRAVITY * 20 * DRONE_TICK, rel=1e-3)


def test_lagging_rotors_follow_the_exponential(drone: Make):
    lag = 0.03
    substep = DRONE_TICK / 4
    slow = drone(PERFECT.replace("spin: 1", "spin: 1, time_constant: 30 ms"), EXACT_HOVER)
    fly(slow, 10)
    (_, _, speed), _ = slow.engine.velocity("drone")()
    shares = [1 - exp(-k * substep / lag) for k in range(1, 41)]
    assert speed == pytest.approx(GRAVITY * substep * sum(share - 1 for share in shares), rel=1e-3)


def test_rotors_stand_still_from_a_reset_to_the_first_command(drone: Make):
    late = drone(PERFECT.replace("spin: 1", "spin: 1, delay: 50 ms"), EXACT_HOVER)
    for _ in range(2):
        fly(late, 5)
        (_, _, speed), _ = late.engine.velocity("drone")()
        assert speed == pytest.approx(-GRAVITY * 5 * DRONE_TICK, rel=1e-3)
