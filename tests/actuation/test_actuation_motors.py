"""Motors of scenarios against closed forms: strength, delay, lag, limits, and what an episode draws of
them."""

from __future__ import annotations

from math import ceil, exp, inf
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.engines import ENGINES
from deepbots_cli.program.robots import Motor
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.actuation import Response
from tests.worlds import RAIL, Make

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
    assert speeds[waits] == pytest.approx(1.0, abs=1e-6)
    assert speeds[:waits] == pytest.approx([0.0] * waits, abs=1e-6)


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
    torques = weak.engine.joint_torques("cart", ("slider",))
    assert torques()[0] == pytest.approx(7.0)


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
    speeds = cart_speeds(arm, 100)
    assert max(speeds) < 0.5 * 1.01
    assert arm.engine.joint_states("cart", ("slider",))()[0][0] == pytest.approx(0.3, abs=1e-3)


def test_figures_are_drawn_once_per_episode_and_come_again_with_the_seed(rail: Make):
    drawn = rail(
        *ENDLESS,
        strength="uniform(0.5 .. 1)",
        delay="uniform(0 .. 40 ms)",
        time_constant="uniform(10 .. 50 ms)",
        max_torque="uniform(5 .. 10 N)",
    )
    drive = drawn.robot_cart.drive_motor
    figures = []
    for seed in (1, 2, 1):
        first = cart_speeds(drawn, 8, seed=seed)
        figures.append(
            (*drive.strength, *drive.max_torque, drive.response.delay, drive.response.time_constant, first)
        )
    assert figures[0] == figures[2] != figures[1]
    fresh = rail(
        *ENDLESS,
        strength="uniform(0.5 .. 1)",
        delay="uniform(0 .. 40 ms)",
        time_constant="uniform(10 .. 50 ms)",
        max_torque="uniform(5 .. 10 N)",
    )
    assert cart_speeds(fresh, 8, seed=1) == figures[0][-1]


def test_a_drawn_strength_is_what_the_motor_then_exerts(rail: Make):
    drawn = rail(
        *ENDLESS, "robots.cart.apply.motor=drive * 6 N", type="torque_motor", strength="uniform(0.2 .. 1)"
    )
    torques = drawn.engine.joint_torques("cart", ("slider",))
    for seed in range(5):
        drawn.reset(seed=seed)
        drawn.step(FORWARD)
        (strength,) = drawn.robot_cart.drive_motor.strength
        assert torques()[0] == pytest.approx(6 * strength)


def test_commands_of_an_episode_do_not_reach_the_next(rail: Make):
    late = rail(*ENDLESS, delay="100 ms", max_torque="100 kN")
    once = cart_speeds(late, 8, FORWARD)
    again = cart_speeds(late, 8, BACKWARD)
    assert np.allclose(once, np.negative(again), atol=1e-6)


def test_a_perfect_motor_prints_the_writer_of_the_engine_and_nothing_of_a_device():
    plain = api.compile(RAIL).code
    assert 'self.drive_motor = engine.velocity_motor("cart", ("slider",), (10.0,))' in plain
    assert "release" not in plain
    weak = api.compile(RAIL, overrides=["robots.cart.actuators.motor.strength=0.5"]).code
    assert 'engine.velocity_motor("cart", ("slider",), (5.0,))' in weak


def test_actuators_hold_while_the_world_settles(rail: Make):
    tilted = "reset={joints: {cart.hinge: 90 deg}, settle: 0.4 s}"
    held = rail(ENDLESS[0], tilted, max_torque="100 kN")
    held.reset(seed=0)
    assert held.engine.joint_states("cart", ("slider",))()[0][0] == pytest.approx(0.0, abs=1e-6)
    spring = rail(
        ENDLESS[0], tilted, "robots.cart.apply.motor=drive * 1 m", type="position_motor", max_torque="100 kN"
    )
    spring.reset(seed=0)
    assert spring.engine.joint_states("cart", ("slider",))()[0][0] == pytest.approx(0.0, abs=1e-3)
    let_go = rail(ENDLESS[0], tilted, "robots.cart.apply.motor=drive * 1 N", type="torque_motor")
    let_go.reset(seed=0)
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
    held = rail(ENDLESS[0], *command, late, type=kind, max_torque="100 kN")
    held.reset(seed=0)
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
    weak = rail(f"world.substeps={substeps}", *ENDLESS, apply, engine="pybullet", strength="0.5", **motor)
    weak.reset(seed=0)
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
    speeds = cart_speeds(twins, 20)
    assert 0.8 < speeds[-1] < 1.0


@pytest.mark.parametrize("limit", ["20 N", "uniform(20 .. 30 N)"])
def test_a_limit_beyond_that_of_the_robot_file_has_no_effect(make: Make, limit: str):
    world = make(RAIL, f"robots.cart.actuators.motor.max_torque={limit}", *ENDLESS, engine="exact")
    own = make(RAIL, *ENDLESS, engine="exact")
    assert cart_speeds(world, 3) == cart_speeds(own, 3)


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


def test_a_lag_is_the_step_response_of_first_order():
    tau = 0.03
    response = Response(SUBSTEP, zero, time_constant=tau)
    response.send([2.0])
    for k, value in enumerate(followed_values(response, 40), start=1):
        assert value == pytest.approx(2.0 * (1 - exp(-k * SUBSTEP / tau)), abs=1e-12)


def test_a_lag_ends_at_the_command_and_then_has_nothing_to_do():
    response = Response(SUBSTEP, zero, time_constant=0.01)
    response.send([0.3])
    assert followed_values(response, 200)[-1] == pytest.approx(0.3, abs=1e-15)
    assert response.advance() is None


@pytest.mark.parametrize(
    ("delay", "waits"), [(0.0, 0), (0.001, 1), (0.005, 1), (0.0051, 2), (0.020, 4), (0.3, 60)]
)
def test_a_command_takes_effect_in_the_first_substep_that_begins_late_enough(delay: float, waits: int):
    response = Response(SUBSTEP, zero, delay=delay)
    response.send([1.0])
    values = followed_values(response, waits + 1)
    assert values[-1] == 1.0
    assert all(value != value for value in values[:-1])


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
        assert first == pytest.approx(0.1 + k * 2.0 * SUBSTEP)
        assert second == 5.0
    assert (response.advance() or (0.0,))[0] == pytest.approx(0.15)


def test_after_a_reset_nothing_is_left_of_earlier_commands_and_new_figures_are_in_force():
    response = Response(SUBSTEP, zero, delay=0.01, time_constant=0.1)
    response.send([1.0])
    followed_values(response, 10)
    response.delay, response.time_constant = 0.0, 0.0
    response.reset()
    assert response.advance() is None
    response.send([3.0])
    assert response.advance() == [3.0]


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
    beam = held_beam(make, tmp_path, engine, f"{{com: {offset} 0 0 m}}")
    beam.reset(seed=0)
    for _ in range(100):
        (share,), *_ = beam.step(np.zeros(1, np.float32))
    assert -50 * share == pytest.approx(2.0 * 9.81 * offset, rel=1e-3)


def test_bodies_and_joints_are_drawn_once_per_episode_and_come_again_with_the_seed(
    make: Make, tmp_path: Path
) -> None:
    pytest.importorskip("mujoco")
    link = "{com: uniform(-10 0 0 .. 10 0 0 cm), inertia: uniform(0.5 .. 2)}"
    beam = held_beam(make, tmp_path, "mujoco", link, "{armature: uniform(0 .. 0.1 kg*m^2)}")
    draws, torques = [], []
    for seed in (1, 2, 1):
        draws.append(beam.reset(seed=seed)[1]["drawn"])
        for _ in range(100):
            (share,), *_ = beam.step(np.zeros(1, np.float32))
        torques.append(-50 * share)
        offset = draws[-1]["robots.arm.links.beam.com.x"]
        assert torques[-1] == pytest.approx(2.0 * 9.81 * offset, rel=1e-3)
    assert set(draws[0]) == {
        "robots.arm.links.beam.com.x",
        "robots.arm.links.beam.com.y",
        "robots.arm.links.beam.com.z",
        "robots.arm.links.beam.inertia",
        "robots.arm.joints.hinge.armature",
    }
    assert draws[0] == draws[2] != draws[1]
    assert torques[0] == torques[2] != torques[1]


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
        beam = make(scenario)
        beam.reset(seed=0)
        for _ in range(5):
            beam.step(np.ones(1, np.float32))
        speeds.append(beam.engine.joint_states("arm", ("hinge",))()[0][1])
    rate = 4.0 / 10.0 / 0.02
    assert speeds == pytest.approx([10 * (1 - exp(-rate * 0.05)), 10 * (1 - exp(-rate * 0.025))], rel=0.03)
