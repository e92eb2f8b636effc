"""Names: their meaning, the findings about unknown names, and the findings that are left out because they
only follow from others."""

from __future__ import annotations

import time

import pytest

from deepbots_cli import api
from deepbots_cli.compiler.namespace import MAX_CHAIN
from deepbots_cli.errors import ScenarioError
from deepbots_cli.expressions.scalar import EngineRead, walk

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
    assert workshop.codes(text) == []
    assert [signal.name for signal in workshop.compile(text).program.signals].index("half") == 1


def test_a_circle_is_reported_once_and_in_full(workshop, cartpole) -> None:
    text = cartpole(("  x:         position(cart).x", "  x: y + z\n  y: z\n  z: x"))
    (finding,) = workshop.lint(text)
    assert finding.code == "DB207"
    assert finding.notes == ("the cycle is x -> y -> z -> x",)


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
    assert workshop.codes(rail(*edits)) == ["DB609"]
    assert workshop.codes(rail(*edits, ("reward:", "augment: [lean]\nreward:"))) == []


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
    assert finding.code == "DB103"
    assert finding.notes == ("`100_00` is read as text, because its digits are not grouped in threes",)


@pytest.mark.parametrize(
    ("old", "new"),
    [("alive: 1", "alive: 1,5"), ("alive: 1", "alive: 0x10"), ("timestep: 32 ms", "timestep: 0:32")],
)
def test_so_does_one_about_a_part_of_the_value(workshop, cartpole, old, new):
    (finding,) = workshop.lint(cartpole((old, new)))
    assert finding.severity == "error"
    assert len(finding.notes) == 1


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
    assert label.text == "used here"
    assert label.span.text == "drive * wheel_speed"


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
