"""The meaning of a scenario that the compiler fixes: order, when values are known, draws, endings,
messages.

Names: their meaning, the findings about unknown names, and the findings that are left out because they
only follow from others.

The files that a scenario was made from, and the scenario made again from their copies.

The names of a scenario, as editors offer them: complete, by kind, and each leading to where it is
defined.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.codegen import generate_module
from deepbots_cli.compiler.inputs import copy_names
from deepbots_cli.compiler.inventory import definition, names_at
from deepbots_cli.compiler.namespace import MAX_CHAIN
from deepbots_cli.document import shipped
from deepbots_cli.errors import ScenarioError
from deepbots_cli.expressions.scalar import Draw, EngineRead, Name, walk
from deepbots_cli.program.identity import digest, interface, to_json
from tests.named import constant


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
    assert (len(streams), len(set(streams))) == (3, 3)


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
    assert (plain.code, plain.program.robots[0].from_robot) == (
        listed.code,
        listed.program.robots[0].from_robot,
    )
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


REWARD = "  alive: 1"


def facts(compiled, name: str) -> set[EngineRead]:
    signal = next(signal for signal in compiled.program.signals if signal.name == name)
    return {node for value in signal.scalars for node in walk(value) if isinstance(node, EngineRead)}


def test_a_name_that_a_joint_and_a_link_share_means_what_the_function_needs(workshop, cartpole) -> None:
    text = cartpole(
        (
            "augment: ",
            "signals:\n  spin: joint_velocity(cart.wheel_front_left)\n  rise:"
            " velocity(cart.wheel_front_left).z\naugment: ",
        ),
        (REWARD, "  alive: 1 + 0 * spin / (rad/s) + 0 * rise / (m/s)"),
    )
    compiled = workshop.compile(text)
    assert facts(compiled, "spin") == {EngineRead("joint_velocity", ("cart.wheel_front_left",))}
    assert facts(compiled, "rise") == {EngineRead("velocity", ("cart.wheel_front_left",), "z")}


def test_such_a_name_is_offered_once_among_the_known_ones(workshop, cartpole) -> None:
    (finding,) = workshop.lint(cartpole(("velocity(cart.tip)", "velocity(cart.tipp)")))
    assert finding.help is not None
    assert finding.help.count("`cart.wheel_front_left`") == 1


def test_names_may_be_used_before_they_are_defined(workshop, cartpole) -> None:
    text = cartpole(
        ("  x:         position(cart).x", "  half: x / 2\n  x:         position(cart).x"),
        (REWARD, "  alive: half / m"),
    )
    assert (
        workshop.codes(text),
        [signal.name for signal in workshop.compile(text).program.signals].index("half"),
    ) == ([], 1)


def test_a_circle_is_reported_once_and_in_full(workshop, cartpole) -> None:
    text = cartpole(("  x:         position(cart).x", "  x: y + z\n  y: z\n  z: x"))
    (finding,) = workshop.lint(text)
    assert (finding.code, finding.notes) == ("DB207", ("the cycle is x -> y -> z -> x",))


def test_previous_does_not_break_a_circle_of_parameters(workshop, cartpole) -> None:
    (finding,) = workshop.lint(cartpole(("fall_angle:  15 deg", "fall_angle:  fall_angle")))
    assert finding.help == "define one of these values without the others"


@pytest.mark.parametrize("count", [60, 3000])
def test_long_chains_of_definitions_end_in_a_value_or_a_finding(workshop, cartpole, count: int) -> None:
    chain = "".join(f"  p{n}: p{n + 1} + 1 mm\n" for n in range(count)) + f"  p{count}: 1 mm\n"
    text = cartpole(("parameters:\n", f"parameters:\n{chain}"), ("-0.4 .. 0.4 m", "-0.4 m .. p0 + 0.4 m"))
    began = time.perf_counter()
    assert set(workshop.codes(text)) <= {"DB005"}
    assert time.perf_counter() - began < 10


def _chain(count: int, definition: str) -> tuple[tuple[str, str], ...]:
    """Return the changes that add a chain of parameters, `definition` with the name of the next one."""
    chain = "".join(f"  p{n}: {definition.replace('NEXT', f'p{n + 1}')}\n" for n in range(count - 1))
    return (
        ("parameters:\n", f"parameters:\n{chain}  p{count - 1}: 1 mm\n"),
        ("-0.4 .. 0.4 m", "-0.4 m .. p0 + 0.4 m"),
    )


@pytest.mark.parametrize(("count", "codes"), [(MAX_CHAIN, []), (MAX_CHAIN + 1, ["DB005"])])
def test_the_length_of_a_chain_of_definitions_is_limited(
    workshop, cartpole, count: int, codes: list[str]
) -> None:
    assert workshop.codes(cartpole(*_chain(count, "NEXT + 1 mm"))) == codes


def test_a_chain_of_nested_operations_is_a_finding_and_not_an_error(workshop, cartpole) -> None:
    nested = f"{'(1 mm - ' * 60}NEXT{')' * 60}"
    findings = workshop.lint(cartpole(*_chain(20, nested)))
    assert {finding.code for finding in findings} == {"DB005"}
    assert findings[0].headline == "`p0` depends on too long a chain of definitions"


# What one misspelled or broken piece takes away is not reported again where it is used.
BROKEN = {
    "parameters:": "parameter:",
    "augment:": "augmnt:",
    "termination:": "terminations:",
    "truncation:": "trunkation:",
    "robots:": "robot:",
    "\naction:": "\nactoin:",
    "    sensors:": "    sensor:",
    "    actuators:": "    actuator:",
    "    apply:": "    emits: [pole_angle]\n    apply:",
    "    urdf:": "    urfd:",
    "type: joint_position": "type: joint_angle",
    "joint: pole_hinge": "joint: pole",
    "fall_angle:  15 deg": "fall_angle:",
    "track:       0.39 m": "track:       [0.39 m]",
    "wheel_speed: 5 rad/s": "wheel_speed: 5 rd/s",
    "urdf: cartpole": "urdf: cart",
    "    urdf: cartpole": "    include: cart.yaml",
    "    apply: {wheels": "    emit: [pole_angel]\n    apply: {wheels",
    "x:         position(cart).x": "x:         position(cart).q",
    "forward: 1, backward: -1": "forward: {drive: 1}, backward: -1",
}


@pytest.mark.parametrize("old", BROKEN)
def test_one_broken_piece_is_one_finding(workshop, cartpole, old: str) -> None:
    assert len(workshop.lint(cartpole((old, BROKEN[old])))) == 1


def test_findings_far_apart_do_not_hide_each_other(workshop, cartpole) -> None:
    text = cartpole(
        ("    sensors:", "    sensor:"),
        ("-0.8 .. 0.8 m/s", "-0.8 .. 0.8"),
        (REWARD, "  alive: 1 - wobble"),
        ("algorithm: PPO", "algorithm: PP0"),
        ("{z: 0.04 m}", "{z: 0.04 kg}"),
    )
    assert sorted(workshop.codes(text)) == ["DB101", "DB104", "DB402", "DB502", "DB503"]


def test_a_list_under_augment_grants_what_it_names(workshop, rail) -> None:
    edits = (
        ("reward:", "signals: {lean: joint_position(cart.hinge)}\nreward:"),
        ("  cart.turn:", "  lean: -1 .. 1 rad\n  cart.turn:"),
    )
    assert (
        workshop.codes(rail(*edits)),
        workshop.codes(rail(*edits, ("reward:", "augment: [lean]\nreward:"))),
    ) == (["DB609"], [])


def test_groups_of_links_are_not_joints(workshop, cartpole) -> None:
    text = cartpole(
        ("    sensors:", "    groups: {upper: [pole, tip]}\n    sensors:"), ("[wheel_*]", "upper")
    )
    assert workshop.codes(text) == ["DB302"]


def test_a_group_is_made_of_groups_in_the_order_written(workshop, cartpole) -> None:
    groups = "    groups: {front: [wheel_front_*], rear: [wheel_rear_*], all: [rear, front]}\n    sensors:"
    compiled = workshop.compile(cartpole(("    sensors:", groups), ("[wheel_*]", "all")))
    (wheels,) = compiled.program.robots[0].actuators
    assert wheels.joints == ("wheel_rear_left", "wheel_rear_right", "wheel_front_left", "wheel_front_right")


def test_a_finding_about_a_value_absorbs_the_warning_about_its_spelling(workshop, cartpole) -> None:
    (finding,) = workshop.lint(cartpole(("100_000", "100_00")))
    assert (finding.code, finding.notes) == (
        "DB103",
        ("`100_00` is read as text, because its digits are not grouped in threes",),
    )


@pytest.mark.parametrize("joints", ["[*wheel]", "[wheel_front_left, *wheel]", "\n          - *wheel"])
def test_a_star_without_quotes_is_one_finding(workshop, cartpole, joints):
    text = cartpole(
        (
            "wheels: {type: velocity_motor, joints: [wheel_*], max_torque: 10 N*m}",
            f"wheels:\n        type: velocity_motor\n        joints: {joints}",
        )
    )
    (finding,) = workshop.lint(text)
    assert (finding.code, finding.span.text) == ("DB001", "*wheel")


def test_a_pose_with_a_wrong_value_is_one_finding_and_not_an_unknown_name_wherever_it_is_used() -> None:
    with pytest.raises(ScenarioError) as refused:
        api.compile("quadruped", overrides=['robots.dog.poses.stand={"*_joint": 45 cm}'])
    assert [finding.headline for finding in refused.value.findings] == [
        "`*_joint` must be an angle (rad); this is a length (m)"
    ]


def test_a_parameter_without_unit_in_a_product_is_named_with_the_line_that_sets_it(
    workshop, cartpole
) -> None:
    (finding,) = workshop.lint(cartpole(("wheel_speed: 5 rad/s", "wheel_speed: 5")))
    assert finding.code == "DB503"
    assert finding.help is not None
    assert finding.help.startswith("`wheel_speed` is 5, without a unit")
    assert finding.span.text == "5"
    (label,) = finding.labels
    assert (label.text, label.span.text) == ("used here", "drive * wheel_speed")


@pytest.mark.parametrize("value", ["15 kg", "15 m", "15"])
def test_a_wrong_unit_is_reported_and_corrected_where_the_parameter_is_defined(
    workshop, cartpole, value
) -> None:
    (finding,) = workshop.lint(cartpole(("fall_angle:  15 deg", f"fall_angle:  {value}")))
    assert finding.span.text == value
    assert finding.fix is not None
    assert [edit.text for edit in finding.fix.edits] == ["15 deg"]
    assert not finding.fix.safe


def test_a_unit_that_another_use_needs_is_not_corrected(workshop, cartpole) -> None:
    (finding,) = workshop.lint(cartpole(("> track", "> track or abs(cart.pole_angle) > track")))
    assert finding.code == "DB503"
    assert finding.fix is None


MESH = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def meshed(workshop, cartpole):
    """A project whose robot is drawn with a mesh that lies in a folder beside that of the robot."""
    folder = workshop.file.parent
    robot = shipped.robot_path("cartpole").read_text(encoding="utf-8")
    for name in ("robots", "meshes"):
        (folder / name).mkdir()
    (folder / "meshes" / "part.obj").write_bytes(MESH)
    (folder / "robots" / "mine.urdf").write_text(
        robot.replace('<box size="0.20 0.05 0.08"/>', '<mesh filename="../meshes/part.obj"/>', 1),
        encoding="utf-8",
    )
    (folder / "scenarios").mkdir()
    workshop.file = folder / "scenarios" / "scenario.yaml"
    return workshop.write(cartpole(("urdf: cartpole", "urdf: ../robots/mine.urdf")))


def test_another_mesh_is_another_scenario(meshed):
    before = api.compile(meshed).digest
    (meshed.parents[1] / "meshes" / "part.obj").write_bytes(MESH + b"v 2 2 2\n")
    assert api.compile(meshed).digest != before


def test_files_of_other_homes_get_folders_of_their_own():
    files = [
        Path(name)
        for name in (
            "/mine/a/x.yaml",
            "/ours/r/x.urdf",
            "/ours/m/x.stl",
            "/mine/b/y.yaml",
            "/far/z.urdf",
            "/mine/elsewhere_1/y.urdf",
            "/mine/a/x.yaml",
        )
    ]
    named = copy_names(files, (Path("/mine"), Path("/ours")))
    assert list(named.values()) == [
        "a/x.yaml",
        "b/y.yaml",
        "elsewhere_1/y.urdf",  # the project has such a folder
        "elsewhere_2/r/x.urdf",
        "elsewhere_2/m/x.stl",
        "elsewhere_3/z.urdf",
    ]


# The compiled scenario as canonical JSON, and its digest, which means what it says


def test_minus_zero_and_infinity_have_other_digests() -> None:
    cartpole = api.compile("cartpole").program
    first, *others = (
        digest(cartpole.with_agent(reward=(constant(value),)))
        for value in (0.0, -0.0, float("inf"), float("-inf"))
    )
    assert len({first, *others}) == 4


def test_the_text_is_json_with_sorted_keys() -> None:
    text = to_json(api.compile("cartpole").program)
    assert json.dumps(json.loads(text), sort_keys=True, separators=(",", ":")) == text


@pytest.mark.parametrize(
    ("sets", "robots"),
    [
        ((), ("hunter",)),
        (("signals.pull=turn", "robots.prey.receive={whim: whim + pull, threat: 0 rad}"), ("hunter", "prey")),
    ],
)
def test_an_agent_commands_the_robots_whose_messages_depend_on_its_action_and_agrees_with_them(
    sets, robots
) -> None:
    program = api.compile("tag_scripted", overrides=sets).program
    assert program.agent.robots == robots
    items = [name for name in interface(program)["agent"] if name.startswith("message")]
    assert {name.partition(".")[0].split()[-1] for name in items} == set(robots)


@pytest.mark.parametrize(
    "text", ['"""\nimport os\n"""', "'''", "\\", "\\u0022", "a\r\nb", "{x}", "\x00", 'Ends with a quote"']
)
def test_the_summary_stays_text_in_the_code(text: str) -> None:
    cartpole = api.compile("cartpole").program
    code = generate_module(replace(cartpole, summary=text))
    plain = generate_module(cartpole)
    assert len(code.splitlines()) == len(plain.splitlines())
    names = compile(code, "generated", "exec").co_names
    assert names == compile(plain, "generated", "exec").co_names


def digest_of(workshop, text: str) -> str:
    return workshop.compile(text).digest


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("15 deg", "15.1 deg"),
        ("substeps: 4", "substeps: 5"),
        ("alive: 1", "alive: 2"),
        ("alive: 1", "alife: 1"),
        ("format: csv", "format: json"),
        ("max_torque: 10 N*m", "max_torque: 9 N*m"),
        ("gamma: 0.98", "gamma: 0.99"),
        ("{z: 0.04 m}", "{z: 0.05 m}"),
        ("uniform(-1 .. 1 deg)", "uniform(-1 .. 2 deg)"),
        ("abs(x) > track", "abs(x) >= track"),
    ],
)
def test_the_digest_distinguishes_scenarios(workshop, cartpole, old: str, new: str) -> None:
    assert digest_of(workshop, cartpole()) != digest_of(workshop, cartpole((old, new)))


@pytest.fixture(scope="module")
def rocking():
    return api.load("pit_escape")


@pytest.fixture(scope="module")
def searching():
    return api.load("find_ball_random")


def test_the_parts_of_a_robot_go_by_short_names_inside_of_it_and_by_full_ones_elsewhere(rocking):
    inside = names_at(rocking, "joint", ("robots", "roller", "actuators", "pitch_motor", "joint"))
    assert ([entry.name for entry in inside], {entry.description for entry in inside}) == (
        ["pitch", "yaw"],
        {"a continuous joint"},
    )
    assert [entry.name for entry in names_at(rocking, "joints", ("reset", "joints"))] == [
        "roller.pitch",
        "roller.yaw",
    ]


@pytest.mark.parametrize(
    ("kind", "path", "expected"),
    [
        ("sensor", ("robots", "roller", "emit", 0), ["gyro", "accel"]),
        ("actuator", ("robots", "roller", "apply"), ["pitch_motor", "yaw_motor"]),
        ("action", ("scripts", "mine"), ["roll"]),
        ("choice", ("scripts", "mine", "roll"), ["forward", "backward", "turn_left", "turn_right"]),
        ("choice", ("action", "roll", "forbid"), ["forward", "backward", "turn_left", "turn_right"]),
        ("setting", ("curriculum", 0, "set"), ["radius", "time_limit", "speed"]),
        ("body", ("reset", "place"), ["roller"]),
        ("robot", ("agent", "each"), ["roller"]),
        ("layout", ("reset", "layout"), []),
    ],
)
def test_what_a_reference_may_name(rocking, kind, path, expected):
    assert [entry.name for entry in names_at(rocking, kind, path)] == expected


@pytest.mark.parametrize(
    ("scenario", "kind", "path", "expected"),
    [
        ("tag", "agent", ("agents", "prey", "like"), ["hunter", "prey"]),
        ("tag", "agent", ("tests", "the_prey_escapes", "agent"), ["hunter", "prey"]),
        ("tag", "agent", ("endings", "escaped", "success"), ["hunter", "prey", "all"]),
        ("tag", "driver", ("tests", "the_prey_escapes", "driver", "prey"), ["stroll", "random", "zero"]),
        (
            "tag",
            "ending",
            ("tests", "the_prey_escapes", "expect", "ends_by"),
            ["caught", "escaped", "max_time"],
        ),
        ("pit_escape", "parameter", ("curriculum", "levels", "set"), ["radius", "time_limit", "speed"]),
        ("find_ball_random", "object", ("reset", "place", "ball", "on"), ["ball", "obstacle"]),
    ],
)
def test_each_kind_of_reference_names_what_its_section_defines(scenario, kind, path, expected):
    assert [entry.name for entry in names_at(api.load(scenario), kind, path)] == expected


def test_a_robot_hears_what_others_send(tmp_path):
    scout = {"urdf": "cartpole", "sensors": {"tilt": {"type": "joint_position", "joint": "pole_hinge"}}}
    (tmp_path / "two.yaml").write_text(
        json.dumps({"deepbots": 1, "extends": "cartpole", "name": "Two", "robots": {"scout": scout}})
    )
    entries = names_at(api.load(tmp_path / "two.yaml"), "message field", ("robots", "cart", "hear", "mate"))
    assert [entry.name for entry in entries] == ["scout.tilt"]


def test_a_disturbance_may_push_links_and_a_touch_sensor_feels_bodies_and_the_ground(searching):
    assert "epuck.base_link" in [
        entry.name for entry in names_at(searching, "body or link", ("disturbances", "gust", "body"))
    ]
    against = [
        entry.name
        for entry in names_at(
            searching, "bodies or links", ("robots", "epuck", "sensors", "bumper", "against")
        )
    ]
    assert {"ball", "obstacle", "ground", "epuck.base_link"} <= set(against)


@pytest.mark.parametrize(
    ("name", "text", "place"),
    [
        ("radius", "radius: 2.7 m", "pit_escape.yaml"),
        ("roller.gyro.y", "gyro: {type: gyro", "pit_escape.yaml"),
        ("pitch", "pitch: 1,", "pit_escape.yaml"),
        ("roller.ball", 'ball">', "roller.urdf"),
        ("escaped", "escaped: reach", "pit_escape.yaml"),
    ],
)
def test_a_name_leads_to_its_definition(rocking, name, text, place):
    target = definition(rocking, name)
    assert text.startswith(target.span.text)
    assert target.span.source.text.startswith(text, target.span.start)
    assert target.span.source.name.endswith(place)


def test_on_board_the_names_of_the_robot_come_first(searching):
    assert definition(searching, "proximity", "epuck").span.location.endswith("epuck.yaml:4:3")
    assert definition(searching, "proximity") is None
    assert definition(searching, "nothing.at.all") is None


def test_a_scenario_that_cannot_be_read_has_no_names(tmp_path):
    broken = tmp_path / "broken.yaml"
    broken.write_text("deepbots: 1\nname: {")
    assert names_at(api.load(broken), "joint") == []
    assert definition(api.load(broken), "joint") is None
