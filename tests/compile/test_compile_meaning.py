"""The meaning of a scenario that the compiler fixes: order, when values are known, draws, endings,
messages."""

from __future__ import annotations

import math

import pytest

from deepbots_cli import api
from deepbots_cli.expressions.scalar import Draw, Name, walk


def draws(compiled) -> list[str]:
    """The streams of all draws of a scenario."""
    reset = compiled.program.reset
    values = [value for parameter in compiled.program.parameters for value in parameter.scalars]
    values += [value for place in reset.placements for value in (*place.xyz, *place.rpy)]
    values += [value for start in reset.joint_starts for _, *state in start.states for value in state]
    return [node.stream for value in values for node in walk(value) if isinstance(node, Draw)]


def first_observation(workshop, text: str, seed: int = 5):
    env = api.make(workshop.write(text), engine="exact")
    observation, _ = env.reset(seed=seed)
    env.close()
    return observation


# Parameters


def test_parameters_are_drawn_after_those_that_they_are_made_of(workshop, rail) -> None:
    text = rail(
        (
            "parameters: {cart_speed: 1 m/s}",
            "parameters:\n  near: 2 * far\n  far: uniform(1 .. 2)\n  cart_speed: 1 m/s",
        ),
        ("reward: {alive: 1}", "reward: {alive: near}"),
    )
    assert [parameter.name for parameter in workshop.compile(text).program.parameters] == ["far", "near"]


def test_what_is_fixed_is_folded_and_has_no_slot(workshop, rail) -> None:
    compiled = workshop.compile(rail(("{cart_speed: 1 m/s}", "{cart_speed: base * 2, base: 50 cm/s}")))
    assert compiled.program.parameters == ()
    assert "cart_speed" not in compiled.code


@pytest.mark.parametrize(
    ("field", "text"),
    [
        ("timestep: 20 ms", "timestep: drawn * 20 ms"),
        ("cart.place: -2.4 .. 2.4 m", "cart.place: -2.4 m .. drawn * 2.4 m"),
        ("max_steps: 300", "max_steps: drawn"),
        ("forward: 1,", "forward: drawn,"),
        ("reset:", "reset:\n  settle: drawn * 1 s"),
    ],
)
def test_what_shapes_spaces_and_time_must_be_fixed(workshop, rail, field: str, text: str) -> None:
    assert workshop.codes(rail((field, text), ("{cart_speed", "{drawn: uniform(1 .. 2), cart_speed"))) == [
        "DB407"
    ]


# Draws


def test_each_draw_as_written_has_a_stream_of_its_own(workshop, rail) -> None:
    text = rail(
        ("{cart_speed", "{gust: uniform(0 .. 1) + uniform(0 .. 1), cart_speed"),
        (
            "cart.hinge: uniform(-0.05 .. 0.05 rad)",
            "cart.hinge: gust * 1 deg, cart.slider: uniform(-0.1 .. 0.1 m)",
        ),
    )
    streams = draws(workshop.compile(text))
    assert len(streams) == 3
    assert len(set(streams)) == 3


def test_a_draw_for_a_group_is_drawn_for_each_of_its_joints(workshop, cartpole) -> None:
    text = cartpole(
        ("cart.pole_hinge: uniform(-1 .. 1 deg)", "cart.wheels: uniform(-1 .. 1 deg)"),
        ("    sensors:", '    groups: {wheels: ["wheel_*"]}\n    sensors:'),
    )
    assert len(set(draws(workshop.compile(text)))) == 4


def test_a_draw_is_shared_through_a_parameter(workshop, cartpole) -> None:
    text = cartpole(
        ("cart.pole_hinge: uniform(-1 .. 1 deg)", "cart.wheels: turn"),
        ("    sensors:", '    groups: {wheels: ["wheel_*"]}\n    sensors:'),
        ("parameters:\n", "parameters:\n  turn: uniform(-1 .. 1 deg)\n"),
    )
    compiled = workshop.compile(text)
    assert draws(compiled) == ["parameters.turn#0"]
    assert {position for start in compiled.program.reset.joint_starts for _, position, _ in start.states} == {
        Name("turn")
    }


def test_a_further_item_changes_no_other_draw(workshop, rail) -> None:
    plain = first_observation(workshop, rail())
    more = first_observation(
        workshop,
        rail(
            ("{cart_speed", "{gust: uniform(0 .. 1), cart_speed"),
            ("joints: {", "joints: {cart.slider: uniform(-0.1 .. 0.1 m), "),
            ("{alive: 1}", "{alive: gust}"),
        ),
    )
    assert more[2] == plain[2]
    assert more[0] != plain[0]


def test_any_yaw_is_drawn_from_the_whole_circle(workshop, cartpole) -> None:
    compiled = workshop.compile(cartpole(("{z: 0.04 m}", "{z: 0.04 m, yaw: any}")))
    (yaw,) = (place.rpy[2] for place in compiled.program.reset.placements)
    assert isinstance(yaw, Draw)
    assert [argument.value for argument in yaw.args] == [-math.pi, math.pi]


def test_a_drawn_vector_has_one_draw_per_component(workshop, cartpole) -> None:
    compiled = workshop.compile(cartpole(("{z: 0.04 m}", "{xyz: uniform(-0.1 -0.1 0.04 .. 0.1 0.1 0.04 m)}")))
    assert len(set(draws(compiled))) == 4


# Endings


def outcome(workshop, text: str):
    """The info of the last step, with the pole left to fall."""
    env = api.make(workshop.write(text), engine="exact")
    env.reset(seed=1)
    while True:
        _, reward, terminated, truncated, info = env.step(0)
        if terminated or truncated:
            env.close()
            return terminated, truncated, reward, info


def endings(success: str, failure: str) -> tuple[str, str]:
    old = (
        "termination:\n  failure:\n    fallen: abs(cart.lean) > 12 deg\n    off:    abs(cart.place) > 2.3 m\n"
    )
    return old, f"termination:\n  success: {{{success}}}\n  failure: {{{failure}}}\n"


def test_success_alone_is_success(workshop, rail) -> None:
    *_, info = outcome(workshop, rail(endings("late: time > 0.09 s", "later: time > 1 s")))
    assert info["ended_by"] == "late"
    assert info["is_success"] is True


def test_a_limit_truncates(workshop, rail) -> None:
    terminated, truncated, _, info = outcome(workshop, rail(("max_steps: 300", "max_time: 0.06 s")))
    assert truncated
    assert not terminated
    assert info["ended_by"] == "max_time"
    assert info["is_success"] is False


def test_endings_may_name_each_other_in_either_order(workshop, rail) -> None:
    text = rail(
        endings("done: time > 0.09 s and not lost", "lost: time > 0.09 s and (time > 2 s or not done_yet)"),
        ("reward:", "signals: {done_yet: time > 0 s}\nreward:"),
    )
    *_, info = outcome(workshop, text)
    assert info["is_success"] is True
    text = rail(endings("done: time > 0.09 s", "lost: done and time > 0.09 s"))
    *_, info = outcome(workshop, text)
    assert info["ended_by"] == "lost"


def test_endings_in_a_circle_are_an_error(workshop, rail) -> None:
    assert workshop.codes(rail(endings("done: not lost", "lost: not done"))) == ["DB207"]


def test_rewards_see_the_endings_of_their_step(workshop, rail) -> None:
    text = rail(
        endings("done: time > 0.09 s", "never: time < 0 s"),
        ("{alive: 1}", "{alive: 1, bonus: 5 when done, end: 10 when ended}"),
    )
    *_, reward, _ = outcome(workshop, text)
    assert reward == 16


# Messages


def test_a_robot_is_sent_the_action_variables_that_it_uses_and_what_it_asks_for(workshop, rail) -> None:
    text = rail(
        ("    emit:", "    receive: {top: cart_speed}\n    emit:"),
        ("drive * cart_speed", "drive * top"),
        ("1 m/s}", "uniform(0.5 .. 1 m/s)}"),
    )
    (robot,) = workshop.compile(text).program.robots
    assert [field.name for field in robot.to_robot.fields] == ["drive", "top"]
    assert [field.unit for field in robot.to_robot.fields] == ["1", "m/s"]


def test_what_is_asked_for_may_stand_in_for_an_action_variable(workshop, rail) -> None:
    text = rail(("    emit:", "    receive: {drive: drive / 2}\n    emit:"))
    (robot,) = workshop.compile(text).program.robots
    assert [field.name for field in robot.to_robot.fields] == ["drive"]
    assert robot.received[0].scalars != (Name("drive"),)


@pytest.mark.parametrize("emit", ["rate, place, lean, turn", "place, rate, lean, turn, joints"])
def test_the_stamp_of_a_message_changes_with_its_fields(workshop, rail, emit: str) -> None:
    sensors = ("    actuators:", "      joints: {type: joint_position, joints: [slider]}\n    actuators:")
    plain = workshop.compile(rail(sensors)).program.robots[0].from_robot
    other = (
        workshop.compile(rail(sensors, ("emit: [place, rate, lean, turn]", f"emit: [{emit}]")))
        .program.robots[0]
        .from_robot
    )
    assert plain.layout_hash != other.layout_hash


EMIT = "    emit: [place, rate, lean, turn]\n"
SPIN = ("    actuators:", "      spin: {type: joint_velocity, joint: hinge}\n    actuators:")


def sent_names(compiled: api.Compiled) -> list[str]:
    return [field.name for field in compiled.program.robots[0].emit]


def test_without_emit_a_robot_sends_the_sensors_that_the_supervisor_uses_in_the_order_of_their_declaration(
    workshop, rail
) -> None:
    listed = workshop.compile(rail())
    first = ("      place:", "      spin: {type: joint_velocity, joint: hinge}\n      place:")
    plain = workshop.compile(rail((EMIT, "")))
    assert plain.code == listed.code
    assert plain.program.robots[0].from_robot == listed.program.robots[0].from_robot
    assert sent_names(workshop.compile(rail((EMIT, ""), first))) == ["place", "rate", "lean", "turn"]
    for use in (
        "signals: {spun: delta(cart.spin)}",
        "scripts: {mine: {drive: {forward: cart.spin > 0 rad/s, backward: true}}}",
    ):
        assert sent_names(workshop.compile(rail((EMIT, ""), first, ("reset:", f"{use}\nreset:")))) == [
            "spin",
            "place",
            "rate",
            "lean",
            "turn",
        ]


def test_a_case_sends_what_the_scenario_sends_even_if_it_does_not_use_it(workshop, rail) -> None:
    ends = "evaluation: {cases: {far: {set: {termination.failure: {off: abs(cart.place) > 9 m}}}}}\nreset:"
    text = rail(
        (EMIT, ""), SPIN, ("    fallen:", "    wild: cart.spin > 99 rad/s\n    fallen:"), ("reset:", ends)
    )
    (case,) = workshop.compile(text).program.cases
    assert [field.name for field in case.program.robots[0].emit] == ["place", "rate", "lean", "turn", "spin"]


def test_a_finding_about_a_missing_sensor_has_the_whole_line_to_write(workshop, rail) -> None:
    case = "evaluation: {cases: {wild: {set: {termination.failure: {off: cart.spin > 9 rad/s}}}}}\nreset:"
    test = "tests: {calm: {driver: zero, expect: {always: cart.spin < 9 rad/s}}}\nreset:"
    for use, code in ((case, "DB613"), (test, "DB407")):
        (finding,) = workshop.lint(rail((EMIT, ""), SPIN, ("reset:", use)))
        assert finding.code == code
        assert (finding.help or "").endswith("`emit: [place, rate, lean, turn, spin]`")
