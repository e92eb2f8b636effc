"""The meaning of a scenario that the compiler fixes: order, when values are known, draws, endings,
messages.

Names: their meaning, the findings about unknown names, and the findings that are left out because they
only follow from others.

The files that a scenario was made from, and the scenario made again from their copies.

The names of a scenario, as editors offer them: complete, by kind, and each leading to where it is
defined.

Cases of the evaluation: the scenario once more, under other settings.

The changes that a scenario may make to a robot, an object or the world, and their bounds.

Findings about a curriculum of levels: at their place, with what to write instead.

What users of other tools write is refused with what to write here instead.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from pathlib import Path

import pytest

from deepbots_cli import api, frames
from deepbots_cli.codegen import generate_module
from deepbots_cli.compiler import check
from deepbots_cli.compiler.inputs import copy_names
from deepbots_cli.compiler.inventory import definition, names_at, namespace_at
from deepbots_cli.compiler.namespace import RobotScope, SupervisorScope
from deepbots_cli.diagnostics import MAX_FINDINGS, RULES, Finding
from deepbots_cli.document import shipped
from deepbots_cli.document.load import load
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.errors import ScenarioError, UsageError
from deepbots_cli.expressions.scalar import Draw, EngineRead, Name, walk
from deepbots_cli.expressions.types import Context
from deepbots_cli.program import identity
from deepbots_cli.program.identity import digest, interface, to_json
from deepbots_cli.scenario.actuators import ACTUATORS
from deepbots_cli.scenario.documentation import synonyms, word_for
from deepbots_cli.scenario.objects import OBJECTS
from deepbots_cli.scenario.sensors import SENSORS
from deepbots_cli.scenario.terrains import TILES
from tests.compile.conftest import shipped_text
from tests.few import every
from tests.golden.cases import mistakes
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
    (robot,) = workshop.compile(
        rail(("    emit:", "    receive: {drive: drive / 2}\n    emit:"))
    ).program.robots
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
    (finding,) = workshop.lint(cartpole(("  x:         position(cart).x", "  x: y + z\n  y: z\n  z: x")))
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


# What one misspelled or broken piece takes away is not reported again where it is used.


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
    assert compile(code, "generated", "exec").co_names == compile(plain, "generated", "exec").co_names


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
    target = definition(SupervisorScope(rocking.namespace, Context.REWARD), name)
    assert text.startswith(target.span.text)
    assert target.span.source.text.startswith(text, target.span.start)
    assert target.span.source.name.endswith(place)


def test_on_board_the_names_of_the_robot_come_first(searching):
    on_board = RobotScope(searching.namespace, Context.APPLY, "epuck", {})
    supervisor = SupervisorScope(searching.namespace, Context.REWARD)
    assert definition(on_board, "proximity").span.location.endswith("epuck.yaml:4:3")
    assert definition(supervisor, "proximity") is None
    assert definition(supervisor, "nothing.at.all") is None


def test_a_scenario_that_cannot_be_read_has_no_names(tmp_path):
    broken = tmp_path / "broken.yaml"
    broken.write_text("deepbots: 1\nname: {")
    assert names_at(api.load(broken), "joint") == []
    assert namespace_at(api.load(broken), ()) is None


# Cases of the evaluation: the scenario once more, under other settings


SOLVED = "solved: mean_return"
CRATES = (
    "robots:",
    """objects:
  crate: {count: 2, fixed: true, one_of: {cube: {shape: box, size: 5 5 5 cm}, plank: {shape: box, size: 2 20 5 cm}}}
robots:""",
)
SCATTERED = ("place: {", "place: {crate: {region: {x: -0.4 .. 0.4 m, y: 0.2 .. 0.4 m}}, ")


def with_cases(cases: str) -> tuple[str, str]:
    return SOLVED, f"evaluation: {{episodes: 30, cases: {{{cases}}}}}\n{SOLVED}"


def test_a_case_has_as_many_episodes_as_the_evaluation_unless_it_says_otherwise(workshop, cartpole) -> None:
    (case,) = workshop.compile(cartpole(with_cases("steep: {set: {fall_angle: 10 deg}}"))).program.cases
    assert case.episodes == 30


def test_the_scenario_itself_does_not_change_by_its_cases(workshop, cartpole) -> None:
    plain = workshop.compile(cartpole((SOLVED, f"evaluation: {{episodes: 30}}\n{SOLVED}")))
    cased = workshop.compile(cartpole(with_cases("steep: {set: {fall_angle: 10 deg}}")))
    assert to_json(replace(cased.program, cases=())) == to_json(plain.program)
    assert cased.digest != plain.digest


def test_a_missing_case_is_refused_with_the_cases_that_exist(workshop, cartpole) -> None:
    program = workshop.compile(cartpole(with_cases("steep: {set: {fall_angle: 10 deg}}"))).program
    assert program.case("steep") is program.cases[0]
    with pytest.raises(UsageError, match="no case 'flat'; there are: steep"):
        program.case("flat")


def test_a_case_that_adds_a_robot_and_a_message_is_a_finding(workshop, rail) -> None:
    robot = "{urdf: cartpole_rail, base: fixed, pose: {y: 1 m}}"
    ends = "{off: abs(cart.place) > 9 m, wild: cart.spin > 99 rad/s}"
    cases = f"evaluation: {{cases: {{two: {{set: {{robots.other: {robot}, termination.failure: {ends}}}}}}}}}"
    spin = ("    actuators:", "      spin: {type: joint_velocity, joint: hinge}\n    actuators:")
    text = rail(("    emit: [place, rate, lean, turn]\n", ""), spin, ("reset:", f"{cases}\nreset:"))
    (finding,) = workshop.lint(text)
    assert finding.code == "DB613"
    assert (finding.help or "").endswith("`emit: [place, rate, lean, turn, spin]`")


def test_a_test_of_a_case_may_be_longer_than_the_scenario_and_end_in_its_own_way(workshop, cartpole) -> None:
    cases = "long: {set: {truncation.max_steps: 400, termination.success: {won: step >= 300}}}"
    script = "scripts: {hold: {drive: {forward: cart.pole_angle > 0 rad, backward: true}}}"
    test = "{driver: hold, case: long, expect: {success_rate: 100 %, ends_by: won, eventually: step >= 250}}"
    assert workshop.codes(cartpole(with_cases(cases), ("tests:", f"{script}\ntests:\n  one: {test}"))) == []
    one, *_ = api.load(workshop.file, tests=True).tests
    assert (one.name, one.case, one.steps) == ("one", "long", 400)


def test_a_case_may_exchange_the_kinds_of_a_group(workshop, cartpole) -> None:
    others = "round: {set: {objects.crate.one_of: {can: {shape: cylinder, radius: 3 cm, height: 8 cm}}}}"
    program = workshop.compile(cartpole(CRATES, SCATTERED, with_cases(others))).program
    kinds = [
        [variant.name for variant in world.objects[0].variants]
        for world in (program.world, program.case("round").program.world)
    ]
    assert kinds == [["cube", "plank"], ["can"]]


# Scenarios that ask for more than any machine can give are refused while they are read


@pytest.mark.slow
def test_a_reward_of_thousands_of_terms_compiles_and_adds_up(workshop, rail) -> None:
    terms = "".join(f"  r{index}: {index}\n" for index in range(3000))
    env = api.make(workshop.write(rail(("reward: {alive: 1}", f"reward:\n{terms}"))), engine="exact")
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[1] == sum(range(3000))
    env.close()


def findings_at_the_limit(workshop, text: str) -> list[Finding]:
    findings = workshop.lint(text)
    assert MAX_FINDINGS <= len(findings) <= MAX_FINDINGS + 1
    return findings


def test_findings_are_cut_at_the_limit(
    workshop,
) -> None:
    findings = findings_at_the_limit(workshop, "<<: *a\n" * 40_000)
    assert {finding.code for finding in findings} == {"DB001", "DB005", "DB101"}
    assert [finding.headline for finding in findings if finding.code == "DB005"] == ["more than 500 findings"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("action:", "".join(f"trainn{index}: {index}\n" for index in range(3000)) + "action:"),
        ("reward: {alive: 1}", "reward:\n" + "".join(f"  r{index}: alvie{index}\n" for index in range(3000))),
    ],
    ids=["unknown keys", "unknown names"],
)
def test_thousands_of_mistakes_are_cut_at_the_limit_with_a_finding_that_says_so(
    workshop, rail, old: str, new: str
) -> None:
    findings = findings_at_the_limit(workshop, rail((old, new)))
    assert "more than 500 findings" in {finding.headline for finding in findings}


def test_thousands_of_warnings_are_cut_at_the_limit_with_the_number_of_the_others(workshop, rail) -> None:
    unused = "".join(f"  p{index}: {index}\n" for index in range(3000))
    findings = findings_at_the_limit(workshop, rail(("world:", f"signals:\n{unused}world:")))
    assert {finding.severity for finding in findings} == {"warning"}
    assert [note for finding in findings for note in finding.notes if "not shown" in note] == [
        "2,499 more findings are not shown"
    ]


def test_errors_come_before_warnings_where_there_are_too_many_findings(workshop, rail) -> None:
    unused = "".join(f"  p{index}: {index}\n" for index in range(1000))
    findings = findings_at_the_limit(
        workshop, rail(("world:", f"signals:\n{unused}world:")) + "# deepbots: ignore\n" * 1000 + "odd: 1\n"
    )
    assert [finding.headline for finding in findings if finding.severity == "error"] == [
        "unknown key `odd` at the top level"
    ]


@pytest.mark.parametrize(
    ("first", "step", "condition"),
    [
        ("cart.place > 5 cm", "{0} and {0}", "{0}"),
        ("cart.place > 5 cm", "duration({0}) > 1 s or not {0}", "{0}"),
        ("cart.place / m", "{0} * {0}", "{0} > 1"),
        ("cart.place / m", "{0} if {0} > 0.5 else 1 - {0}", "{0} > 1"),
    ],
)
def test_signals_that_use_the_one_before_twice_are_followed_once_by_every_rule(
    workshop, rail, first: str, step: str, condition: str
) -> None:
    chain = "".join(f"  s{index}: {step.format(f's{index - 1}')}\n" for index in range(1, 38))
    signals = f"signals:\n  unused: cart.place\n  s0: {first}\n{chain}"
    ends = f"termination:\n  success: {{done: {condition.format('s37')}}}\n"
    findings = api.lint(
        workshop.write(rail(("reward:", f"{signals}reward:"), ("termination:\n", ends))), preview=True
    )
    assert "DB205" in {
        finding.code for finding in findings
    }  # which it comes to, instead of following 2^37 paths


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        (
            {"reward:": "signals: {lean: cart.lean}\nreward:", "abs(cart.lean)": "step > 500 and lean"},
            "DB804",
        ),
        ({"fallen: abs(cart.lean)": "late: step > 500\n    lean: abs(cart.lean)"}, "DB804"),
        (
            {
                "reward:": "signals: {lean: cart.lean}\nreward:",
                "alive: 1": "alive: 1, up: lean / rad * weight, no: 1 when step < 0",
                "{cart_speed": "{weight: 0, cart_speed",
            },
            "DB704",
        ),
    ],
)
def test_rules_follow_a_signal_or_an_ending_that_has_the_name_of_the_noisy_sensor_it_reads(
    workshop, rail, changes: dict[str, str], code: str
) -> None:
    noisy = ("joint_position, joint: hinge}", "joint_position, joint: hinge, noise: 0.1 deg}")
    assert workshop.codes(rail(noisy, *changes.items())) == [code]


def test_a_condition_of_a_robot_is_judged_by_its_sensors_and_not_by_signals_of_their_names(
    workshop, rail
) -> None:
    text = rail(
        ("emit: [place, rate, lean, turn]", "emit: {near: place > 2 m, rate: rate, lean: lean, turn: turn}"),
        ("  cart.place: -2.4 .. 2.4 m\n", ""),
        ("reward:", "signals: {place: position(cart.pole).z}\nreward:"),
        ("off:    abs(cart.place) > 2.3 m", "far: cart.near\n    low: place > 1.5 m"),
    )
    assert workshop.codes(text) == []


def test_a_command_is_judged_by_the_value_that_the_robot_receives_and_not_by_the_signal_of_its_name(
    workshop, rail
) -> None:
    text = rail(
        ("reward:", "signals: {aim: 100 * drive}\nreward:"),
        (
            "apply: {motor: drive * cart_speed}",
            "receive: {aim: 0.01 * aim}\n    apply: {motor: aim * cart_speed}",
        ),
        ("max_torque: 10 N", "max_torque: 10 N, max_velocity: 1 m/s"),
    )
    assert api.lint(workshop.write(text), preview=True) == []


def test_a_value_heard_from_another_robot_is_not_its_value_of_this_timestep(workshop, cartpole) -> None:
    rival = "{urdf: cartpole, pose: {y: 0.3 m, z: 0.04 m}, sensors: {lean: {type: joint_position, joint: pole_hinge}}}"
    text = cartpole(
        ("robots:\n  cart:\n", f"robots:\n  rival: {rival}\n  cart:\n    hear: {{other: rival.lean}}\n"),
        ("alive: 1", "alive: 1\n  change: abs(rival.lean - cart.other) / rad"),
    )
    assert workshop.codes(text) == []


CART = "    sensors:"


def model(compiled):
    return compiled.program.world.robots[0].model


def with_cart(lines: str) -> tuple[str, str]:
    return CART, f"    {lines}\n{CART}"


def test_the_range_of_a_joint_bounds_what_its_sensor_can_read(workshop, cartpole) -> None:
    text = cartpole(with_cart("joints: {pole_hinge: {range: -30 .. 30 deg}}"), ("-20 .. 20 deg", "auto"))
    lean = next(
        entry for entry in workshop.compile(text).program.agent.numbers if entry.name == "cart.pole_angle"
    )
    assert (lean.low, lean.high) == pytest.approx((-math.pi / 6, math.pi / 6))


def test_a_pattern_changes_all_that_it_matches_from_the_figure_of_each(workshop, cartpole) -> None:
    plain = model(workshop.compile(cartpole()))
    heavier = model(workshop.compile(cartpole(with_cart('links: {"*": {mass: urdf * 2}}'))))
    for old, new in zip(plain.links, heavier.links, strict=True):
        assert (new.inertial.mass, new.inertial.ixx) == (
            2 * old.inertial.mass,
            pytest.approx(2 * old.inertial.ixx),
        )


def test_a_group_may_stand_for_the_joints_that_change(workshop, cartpole) -> None:
    change = "groups: {front: [wheel_front_*]}\n    joints: {front: {damping: 0.1 N*m*s/rad}}"
    joints = model(workshop.compile(cartpole(with_cart(change)))).joints
    assert [joint.name for joint in joints if joint.damping] == ["wheel_front_left", "wheel_front_right"]


def test_a_stretch_may_be_one_factor_for_all_axes(workshop, cartpole) -> None:
    pole = model(
        workshop.compile(
            cartpole(with_cart("links: {pole: {scale: size}}"), ("parameters:", "parameters:\n  size: 2"))
        )
    )
    assert pole.link("pole").inertial.mass == pytest.approx(8 * 0.2)


def test_a_drawn_figure_is_drawn_for_each_link_that_a_pattern_means(workshop, cartpole) -> None:
    varied = workshop.compile(
        cartpole(with_cart('links: {"wheel_*": {mass: urdf * uniform(0.8 .. 1.2)}}'))
    ).program
    assert [(v.what, v.of) for v in varied.reset.variations] == [
        ("mass", ("cart", f"wheel_{end}_{side}")) for end in ("front", "rear") for side in ("left", "right")
    ]
    assert len({str(v.scalars) for v in varied.reset.variations}) == 4
    assert varied.world.robots[0].model.link("wheel_rear_left").inertial.mass == pytest.approx(0.1005)


def test_a_later_figure_of_the_same_link_replaces_a_draw(workshop, cartpole) -> None:
    varied = workshop.compile(
        cartpole(with_cart('links: {"*": {friction: uniform(0.5 .. 1)}, pole: {friction: 0.3}}'))
    ).program
    assert ("cart", "pole") not in [v.of for v in varied.reset.variations]
    assert varied.world.robots[0].model.link("pole").friction.lateral == 0.3


def test_a_color_of_a_link_is_seen_on_all_of_it(workshop, cartpole) -> None:
    cart = model(workshop.compile(cartpole(with_cart("links: {wheel_rear_left: {color: red}}"))))
    assert {visual.color for visual in cart.link("wheel_rear_left").visuals} == {(0.85, 0.2, 0.2, 1.0)}


# Every figure keeps the bounds of its field, also one with a unit, a parameter or a vector.


def test_an_object_has_the_density_of_water_unless_it_has_a_mass(workshop, cartpole) -> None:
    objects = (
        "objects:\n  a: {shape: box, size: 10 10 10 cm, pose: {x: 1 m}}\n  b: {shape: sphere, radius:"
        " 5 cm, mass: 0.3 kg}\nrobots:\n"
    )
    a, b = workshop.compile(cartpole(("robots:\n", objects))).program.world.objects
    assert (a.mass, b.mass) == (pytest.approx(1.0), 0.3)


def test_a_mark_is_seen_and_not_solid(workshop, cartpole) -> None:
    objects = (
        "objects:\n  spot: {shape: cylinder, radius: 2 cm, height: 1 mm, solid: false, color: red}\nrobots:\n"
    )
    (spot,) = workshop.compile(cartpole(("robots:\n", objects))).program.world.objects
    assert not spot.solid


def test_a_longer_pole_is_a_few_lines_upon_the_shipped_scenario() -> None:
    plain, long = api.compile("cartpole"), api.compile("cartpole_long")
    pole = long.program.world.robots[0].model.link("pole")
    old = plain.program.world.robots[0].model.link("pole")
    assert pole.inertial is not None
    assert old.inertial is not None
    assert pole.inertial.mass == pytest.approx(1.5 * old.inertial.mass)
    assert pole.inertial.ixx == pytest.approx(1.5**3 * old.inertial.ixx, rel=2e-3)
    assert long.program.world.robots[0].model.joint("tip_mount").origin.xyz == (0.0, 0.0, 1.5)
    assert long.digest != plain.digest


def test_of_two_patterns_the_later_one_moves_the_center_and_scales_the_inertia(workshop, cartpole) -> None:
    before = model(workshop.compile(cartpole())).link("wheel_front_left").inertial
    change = "links: {wheel_*: {com: 1 0 0 cm, inertia: 2}, wheel_front_left: {com: 3 2 -1 cm, inertia: 3}}"
    after = model(workshop.compile(cartpole(with_cart(change)))).link("wheel_front_left").inertial
    assert after.origin.xyz == pytest.approx(frames.add(before.origin.xyz, (0.03, 0.02, -0.01)))
    assert after.ixx == pytest.approx(3 * before.ixx)


def test_drawn_properties_leave_the_model_as_it_is(workshop, cartpole) -> None:
    before = model(workshop.compile(cartpole())).link("body").inertial
    change = "links: {body: {com: uniform(0 0 0 .. 4 4 4 cm), inertia: uniform(1 .. 3)}}"
    compiled = workshop.compile(cartpole(with_cart(change)))
    assert model(compiled).link("body").inertial == before
    assert [(entry.what, tuple(entry.of)) for entry in compiled.program.reset.variations] == [
        ("center_of_mass", ("cart", "body")),
        ("inertia", ("cart", "body")),
    ]


@pytest.mark.parametrize("key", ["com: 0 0 1 cm", "inertia: 2"])
def test_a_link_without_mass_has_no_center_and_no_inertia_to_change(key: str) -> None:
    """The hand of the Panda has a frame without mass; a pattern passes over it."""
    bare = next(link.name for link in model(api.compile("panda_reach")).links if link.inertial is None)
    refused = f"robots.panda.links={{{bare}: {{{key}}}}}"
    assert [finding.code for finding in api.lint("panda_reach", overrides=[refused])] == ["DB105"]
    assert api.lint("panda_reach", overrides=[f"robots.panda.links={{'*': {{{key}}}}}"]) == []


MOTOR = (
    "robots.dog.actuators={legs: {type: %s, joints: legs, stiffness: 40 N*m/rad, damping: 1 N*m*s/rad, %s}}"
)


@pytest.mark.parametrize(
    ("scenario", "overrides", "message"),
    [
        (
            "quadruped",
            [MOTOR % ("position_motor", "stall_torque: 40 N*m")],
            "`stall_torque` needs `no_load_speed`",
        ),
        (
            "quadruped",
            [MOTOR % ("position_motor", "no_load_speed: 20 rad/s")],
            "`no_load_speed` needs `stall_torque`",
        ),
        (
            "cartpole",
            [
                "robots.cart.actuators.arm={type: position_motor, joint: pole_hinge, stall_torque: 1 N*m,"
                " no_load_speed: 5 rad/s}",
                "robots.cart.apply.arm=0 rad",
            ],
            "`stall_torque` needs `stiffness`",
        ),
    ],
)
def test_a_torque_curve_needs_both_ends_and_a_stiffness(
    scenario: str, overrides: list[str], message: str
) -> None:
    findings = api.lint(scenario, overrides=overrides)
    assert [(finding.code, finding.headline) for finding in findings] == [("DB102", message)]


SCENARIO = Path(__file__).parents[1] / "data" / "scenarios" / "levels.yaml"


KIND = "curriculum.per_world=kind;parameters.kind"
SPOT = "parameters.spot=uniform(0 -1 .. 10 1 m);curriculum.set="


@pytest.mark.parametrize(
    ("overrides", "code", "place", "headline", "help"),
    [
        ("curriculum.set={lvl: 0 .. 5}", "DB201", "lvl", "there is no parameter `lvl`", "level"),
        (
            "curriculum.set={truncation.max_steps: 10 .. 20}",
            "DB201",
            "truncation.max_steps",
            "there is no parameter `truncation.max_steps`",
            "level",
        ),
        ("curriculum.set={mark: 1 .. 2 cm}", "DB407", "mark", "computed from other parameters", "those"),
        ("curriculum.levels=4", "DB105", "0 .. 5", "4 levels do not divide the range", "levels: 6"),
        (
            "curriculum.set={level: 0.5 .. 3.5}",
            "DB105",
            "0.5 .. 3.5",
            "the ends of its range are not",
            "write whole ends",
        ),
        ("curriculum.set={level: 0 .. 10}", "DB105", "0 .. 10", "the scenario draws 0 to 5", "wider range"),
        ("curriculum.set={level: 0 .. 5 cm}", "DB503", "5 cm", "must be a plain number", ""),
        ("curriculum.levels=1", "DB105", "1", "below the smallest", ""),
        ("curriculum.levels=101", "DB105", "101", "above the largest", ""),
        ("curriculum.down=termination", "DB407", "termination", "after `arrived`", "remove `arrived`"),
        (
            "curriculum.down=[arrived, fallen]",
            "DB407",
            "[arrived, fallen]",
            "after `arrived`",
            "remove `arrived`",
        ),
        ("curriculum.up=arived", "DB201", "arived", "there is no ending `arived`", "arrived"),
        ("curriculum.start=6", "DB105", "6", "`start` is 6", "0 to 5"),
        ("curriculum.start=3 .. 1", "DB105", "3 .. 1", "`start` is 3 .. 1", "0 .. 5"),
        ("curriculum.at_top=top", "DB104", "top", "unknown word `top`", "stay"),
        ("curriculum.set={level: 3}", "DB103", "3", "expected a range", ".."),
        (
            "curriculum.per_world=level",
            "DB407",
            "level",
            "`level` has a value in each level",
            "remove `level`",
        ),
        ("parameters.level=integer(0 .. nothing)", "DB402", "nothing", "unknown name `nothing`", ""),
        ("curriculum.per_world=mark", "DB407", "mark", "computed from other parameters", "those"),
        ("curriculum.per_world=lvl", "DB201", "lvl", "there is no parameter `lvl`", "level"),
        (
            "parameters.level=integer(0 .. 5) every 1 s",
            "DB407",
            "level",
            "`level` changes within an episode",
            "remove `every`",
        ),
        (
            "curriculum.set={fall_angle: 5 .. 15 deg}",
            "DB205",
            "fall_angle",
            "one value in all episodes",
            "draw it from all levels, for example `fall_angle: uniform(5 .. 15 deg)`",
        ),
        (
            "curriculum.per_world=fall_angle",
            "DB205",
            "fall_angle",
            "one value in all episodes",
            "or remove `per_world`",
        ),
        (
            f"{KIND}=uniform(0 .. 3)",
            "DB407",
            "kind",
            "`kind` is not drawn from single values",
            "integer(0 .. 5)",
        ),
        (
            f"{KIND}=integer(0 .. 3) every 1 s",
            "DB407",
            "kind",
            "`kind` changes within an episode",
            "remove `every`",
        ),
        (
            f"{KIND}=integer(0 .. 4)",
            "DB407",
            "kind",
            "`kind` has 5 values, but the training has only 4",
            "train.environments: 5",
        ),
        (f"{KIND}=integer(0 .. 1_000_000_000)", "DB407", "kind", "1000000001 values", "fewer values"),
        (f"{KIND}=integer(0 .. 1e20)", "DB407", "kind", "100000000000000000001 values", "fewer values"),
        (f"{SPOT}{{spot.y: -1 .. 9 m}}", "DB105", "-1 .. 9 m", "draws -1 to 1", "keep the range within it"),
    ],
)
def test_a_mistake_is_found_where_it_is(
    overrides: str, code: str, place: str, headline: str, help: str
) -> None:
    (finding,) = check(load(SCENARIO, overrides=overrides.split(";"))).findings
    assert (finding.code, finding.severity, finding.span.text) == (code, RULES[code].severity, place)
    assert headline in finding.headline
    assert help in (finding.help or "")


def test_a_scenario_without_success_cannot_go_up_by_it() -> None:
    findings = check(load(SCENARIO, overrides=["termination={failure: {far: x > 1 m}}"])).findings.errors
    assert [finding.headline for finding in findings if finding.code == "DB407"] == [
        "no episode of the scenario ends by `success`"
    ]


def test_the_levels_of_one_component_lie_in_its_own_range() -> None:
    assert check(load(SCENARIO, overrides=f"{SPOT}{{spot.y: -1 .. 1 m}}".split(";"))).findings.errors == []


def test_levels_have_the_choices_themselves() -> None:
    """The middle level of 13 from -0.7 to 0.5 is 0 but for rounding, which a reset would refuse."""
    choices = tuple(number / 10 for number in range(-7, 6))
    overrides = [
        f"parameters.tilt=choice({' | '.join(map(str, choices))})",
        "curriculum.set={tilt: -0.7 .. 0.5}",
        "curriculum.levels=13",
    ]
    levels = api.compile(SCENARIO, overrides=overrides).program.levels
    assert levels is not None
    assert levels.values == (("tilt", choices),)


def test_up_and_down_cannot_both_follow_a_goal() -> None:
    overrides = ["curriculum={set: {target.x: 0.4 .. 0.6 m}, levels: 3, up: success, down: success}"]
    (finding,) = api.lint("panda_reach", overrides=overrides)
    assert finding.headline == "after `success` a world cannot be one level higher and one level lower"


def test_a_parameter_with_one_value_is_not_divided() -> None:
    by_set = ["parameters.kind=integer(0 .. 3)", "curriculum.per_world=kind", "kind=2"]
    levels = api.compile(SCENARIO, overrides=by_set).program.levels
    assert levels is not None
    assert levels.per_world is None


def test_one_value_by_set_replaces_the_levels() -> None:
    program = api.compile(SCENARIO, overrides=["level=3"]).program
    assert program.levels is None
    assert program.parameters == ()


def test_a_parameter_with_one_value_by_set_leaves_the_levels_of_the_others() -> None:
    spec = "curriculum={set: {level: 0 .. 5, size: 2 .. 4 cm}, levels: 6, up: success, down: failure}"
    drawn = ["parameters.size=uniform(1 .. 5 cm)", spec]
    both = api.compile(SCENARIO, overrides=drawn).program.levels
    one = api.compile(SCENARIO, overrides=[*drawn, "size=3 cm"]).program.levels
    assert both is not None
    assert one is not None
    assert one.values == both.values[:1]


def test_levels_count_for_the_training_alone() -> None:
    plain = api.compile(SCENARIO).program
    changed = api.compile(SCENARIO, overrides=["curriculum.up=truncation", "curriculum.down=failure"]).program
    assert identity.digest(plain) != identity.digest(changed)
    assert identity.task_digest(plain) == identity.task_digest(changed)


@pytest.fixture
def head(workshop) -> str:
    (workshop.file.parent / "cartpole.yaml").write_text(shipped_text("cartpole"), encoding="utf-8")
    return "deepbots: 1\nextends: cartpole.yaml\nname: Habits\n"


@pytest.mark.parametrize(
    "word", ["ik", "IK", "inverse_kinematics", "inverse-kinematics", "end_effector", "osc"]
)
def test_a_word_for_inverse_kinematics_is_corrected_to_cartesian(workshop, head, word):
    text = (
        f"{head}robots: {{cart: {{actuators: {{hand: {{type: {word}, link: pole, joints: pole_hinge}}}}}}}}\n"
    )
    (finding,) = (finding for finding in workshop.lint(text) if finding.code == "DB104")
    assert finding.help.startswith("did you mean `cartesian`?")
    assert [edit.text for edit in finding.fix.edits] == ["cartesian"]
    assert not finding.fix.safe


def test_synonyms_name_words_of_the_language_and_are_not_words_themselves():
    words = {*ACTUATORS, *SENSORS, *OBJECTS, *TILES, *ENGINES, "any"}
    assert words.issuperset(synonyms().words)
    for kinds in (tuple(ACTUATORS), tuple(SENSORS), tuple(OBJECTS), tuple(TILES)):
        assert not [kind for kind in kinds if word_for(kind, kinds)]


@pytest.mark.parametrize(
    "line",
    [
        "world: {ground: {COLOR: red}}",
        "world: {arena: {size: 1 1 m, COLOR: red}}",
        "world: {walls: {fence: {points: [0.3 0.3 m, 0.3 0.4 m], height: 10 cm, COLOR: red}}}",
        "world: {lines: {stripe: {points: [0 0 m, 0.3 0 m], width: 2 cm, COLOR: red}}}",
        "robots: {cart: {links: {pole: {COLOR: red}}}}",
        "objects: {ball: {shape: sphere, radius: 5 cm, COLOR: red, pose: {x: 0.3 m, z: 5 cm}}}",
    ],
)
def test_a_british_colour_is_corrected(workshop, head, line):
    (finding,) = (
        finding
        for finding in workshop.lint(f"{head}{line}\n".replace("COLOR", "colour"))
        if finding.code == "DB101"
    )
    assert (finding.help, [edit.text for edit in finding.fix.edits]) == ("write `color: red`", ["color"])
    assert finding.fix.safe is True
    assert "DB101" not in workshop.codes(f"{head}{line}\n".replace("COLOR", "color"))


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("kuka_iiwa/model.urdf", "kuka_iiwa/model.urdf"),
        ("racecar/racecar.urdf", "racecar/racecar.urdf"),
        ("r2d2", "r2d2.urdf"),
        ("pybullet_data/r2d2.urdf", "r2d2.urdf"),
    ],
)
def test_a_robot_of_pybullet_data_has_a_finding_with_its_reference(workshop, head, written, meant):
    pytest.importorskip("pybullet_data")
    finding = next(
        finding
        for finding in workshop.lint(f"{head}robots: {{cart: {{urdf: {written}}}}}\n")
        if finding.code == "DB204"
    )
    assert finding.help == f"did you mean `package://pybullet_data/{meant}`?"


@pytest.mark.parametrize(
    "written", ["../pybullet/r2d2.urdf", "pybullet_data/../../r2d2.urdf", "no/such.urdf", "x" * 5000]
)
def test_a_file_that_pybullet_data_does_not_have_is_not_suggested(workshop, head, written):
    finding = next(
        finding
        for finding in workshop.lint(f"{head}robots: {{cart: {{urdf: {written}}}}}\n")
        if finding.code == "DB204"
    )
    assert "package://" not in (finding.help or "")


# Wherever a share of something is asked for, `80 %` means `0.8`


SUCCESS = "termination: {success: {there: position(cart).x > 0.3 m}}\n"
LAYOUTS = (
    "reset: {layouts: {left: {cart: {x: -0.1 m, z: 0.04 m}}, right: {cart: {x: 0.1 m, z: 0.04 m}}}, layout: "
)
PLACES = {
    "solved": SUCCESS + "solved: success_rate >= SHARE over 30 episodes",
    "until": SUCCESS
    + "curriculum: [{name: one, until: success_rate >= SHARE over 30 episodes}, {name: two}]",
    "the ground's restitution": "world: {ground: {restitution: SHARE}}",
    "a link's restitution": "robots: {cart: {links: {body: {restitution: SHARE}}}}",
    "an object's restitution": "objects: {ball: {shape: sphere, radius: 5 cm, pose: {x: 1 m}, restitution:"
    " SHARE}}",
    "a drawn share": "objects: {ball: {shape: sphere, radius: 5 cm, pose: {x: 1 m}, restitution: uniform(0"
    " .. SHARE)}}",
    "the reflectance of a line": "world: {lines: {stripe: {points: [0 0 m, 1 0 m], width: 2 cm, reflectance:"
    " SHARE}}}",
    "the lumps of a terrain": "world: {terrain: {type: pit, height: 0.5 m, noise: SHARE}}",
    "the loss of messages": "messages: {to_robot: {loss: SHARE}}",
    "the shares of layouts": LAYOUTS + "{left: SHARE, right: 1 - SHARE}}",
    "a parameter": "parameters: {fall_angle: SHARE * 15 deg}",
    "a condition": "termination: {failure: {lost: cart.pole_angle / rad > SHARE}}",
    "gamma": "train: {gamma: SHARE}",
    "gae_lambda": "train: {gae_lambda: SHARE}",
    "tau": "train: {algorithm: DQN, total_timesteps: 1000, tau: SHARE}",
    "exploration_fraction": "train: {algorithm: DQN, total_timesteps: 1000, exploration_fraction: SHARE}",
    "exploration_initial_eps": "train: {algorithm: DQN, total_timesteps: 1000, exploration_initial_eps:"
    " SHARE}",
    "exploration_final_eps": "train: {algorithm: DQN, total_timesteps: 1000, exploration_final_eps: SHARE}",
}


@pytest.mark.parametrize("place", every(3, PLACES))
def test_a_share_may_be_written_in_percent(workshop, head, place):
    text = f"{head}{PLACES[place]}\n"
    plain, percent, half_of_it = (
        to_json(workshop.compile(text.replace("SHARE", share)).program) for share in ("0.8", "80 %", "0.7")
    )
    assert percent == plain
    assert percent != half_of_it


@pytest.mark.parametrize(
    "line", ["train: {gamma: 120 %}", "train: {gamma: -5 %}", "train: {gamma: lots}", "train: {gamma: 1 % 2}"]
)
def test_a_percentage_out_of_bounds_or_none_is_refused(workshop, head, line):
    assert set(workshop.codes(f"{head}{line}\n")) <= {"DB103", "DB105"}
    assert workshop.codes(f"{head}{line}\n")


@pytest.mark.parametrize(
    ("line", "code", "headline", "help"),
    [pytest.param(*row, id=row[0]) for row in mistakes("instead")],
)
def test_a_habit_is_one_error_that_says_what_to_write_instead(workshop, head, line, code, headline, help):
    """Numbers without units, words of other tools and other spellings."""
    (error,) = (finding for finding in workshop.lint(f"{head}{line}\n") if finding.severity == "error")
    assert (error.code, headline in error.headline, help in error.help) == (code, True, True)
