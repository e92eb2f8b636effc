"""The changes that a scenario may make to a robot, an object or the world, and their bounds."""

from __future__ import annotations

import math

import pytest

from deepbots_cli import api

CART = "    sensors:"


def model(compiled):
    return compiled.program.world.robots[0].model


def with_cart(lines: str) -> tuple[str, str]:
    return CART, f"    {lines}\n{CART}"


def test_a_joint_takes_range_and_limits_from_the_scenario(workshop, cartpole) -> None:
    change = "joints: {pole_hinge: {range: -60 .. 45 deg, max_torque: 2 N*m, max_velocity: urdf / 4}}"
    limit = model(workshop.compile(cartpole(with_cart(change)))).joint("pole_hinge").limit
    assert limit.lower == pytest.approx(math.radians(-60))
    assert limit.upper == pytest.approx(math.radians(45))
    assert limit.effort == 2.0
    assert limit.velocity == 25.0


def test_the_range_of_a_joint_bounds_what_its_sensor_can_read(workshop, cartpole) -> None:
    text = cartpole(with_cart("joints: {pole_hinge: {range: -30 .. 30 deg}}"), ("-20 .. 20 deg", "auto"))
    lean = next(
        entry for entry in workshop.compile(text).program.agent.numbers if entry.name == "cart.pole_angle"
    )
    assert (lean.low, lean.high) == pytest.approx((-math.pi / 6, math.pi / 6))


def test_a_raised_limit_silences_the_warning_about_the_motor(workshop, cartpole) -> None:
    stronger = ("10 N*m", "15 N*m")
    assert workshop.codes(cartpole(stronger)) == ["DB304"]
    assert workshop.codes(cartpole(stronger, with_cart('joints: {"wheel_*": {max_torque: 15 N*m}}'))) == []


def test_a_pattern_changes_all_that_it_matches_from_the_figure_of_each(workshop, cartpole) -> None:
    plain = model(workshop.compile(cartpole()))
    heavier = model(workshop.compile(cartpole(with_cart('links: {"*": {mass: urdf * 2}}'))))
    for old, new in zip(plain.links, heavier.links, strict=True):
        assert new.inertial.mass == 2 * old.inertial.mass
        assert new.inertial.ixx == pytest.approx(2 * old.inertial.ixx)


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


WRONG = {
    "links: {pole: {mass: 0}}": "DB105",
    "links: {pole: {mass: 1 m}}": "DB503",
    "links: {pole: {mass: -1 kg}}": "DB105",
    "links: {poel: {mass: 1 kg}}": "DB201",
    'links: {"pol_*": {mass: 1 kg}}': "DB206",
    "links: {pole: {scale: 1 1 0}}": "DB105",
    "links: {wheel_front_left: {scale: 1 1 2}}": "DB105",
    "links: {pole: {friction: uniform(-0.5 .. 1)}}": "DB105",
    "links: {pole: {friction: -0.5}}": "DB105",
    "joints: {pole_hing: {damping: 1 N*m*s/rad}}": "DB302",
    "joints: {tip_mount: {damping: 1 N*m*s/rad}}": "DB303",
    "joints: {pole_hinge: {damping: 1 N*s/m}}": "DB503",
    "joints: {pole_hinge: {range: 1 .. 1 rad}}": "DB105",
    "joints: {pole_hinge: {range: -1 .. 1 m}}": "DB503",
    "joints: {pole_hinge: {range: -1 .. 1}}": "DB502",
    'joints: {"wheel_*": {range: -1 .. 1 rad}}': "DB203",
}


@pytest.mark.parametrize("change", WRONG)
def test_a_change_that_cannot_be_made_is_one_finding(workshop, cartpole, change: str) -> None:
    assert workshop.codes(cartpole(with_cart(change))) == [WRONG[change]]


# Every figure keeps the bounds of its field, also one with a unit, a parameter or a vector.
BEYOND = {
    "timestep: 32 ms": "timestep: 0 s",
    "timestep:  32 ms": "timestep: 2 min",
    "size: 1 1 m": "size: 1 0 m",
    "wall_height: 0.1 m": "wall_height: -10 cm",
    "friction: 1.0": "friction: track / m - 1",
    "max_torque: 10 N*m": "max_torque: -10 N*m",
    "{max_steps: 200}": "{max_steps: 200 / 3}",
    "{max_steps:  200}": "{max_time: -1 s}",
    "reset:": "reset:\n  settle: -1 s",
    "mean_return >= 195": "success_rate >= 150 %",
}


@pytest.mark.parametrize("old", BEYOND)
def test_a_figure_out_of_bounds_is_one_finding(workshop, cartpole, old: str) -> None:
    assert workshop.codes(cartpole((old.replace("  ", " "), BEYOND[old]))) == ["DB105"]


@pytest.mark.parametrize("figure", ["32 ms / 0", "1e300 s * 1e300", "sqrt(-1) * 1 s", "log(0) * 1 s"])
def test_a_figure_that_cannot_be_computed_is_an_error(workshop, cartpole, figure: str) -> None:
    findings = workshop.lint(cartpole(("timestep: 32 ms", f"timestep: {figure}")))
    assert [finding.code for finding in findings if finding.severity == "error"] == ["DB105"]


@pytest.mark.parametrize("figure", ["1 / 0", "1e300 * 1e300"])
def test_a_parameter_that_cannot_be_computed_is_an_error(workshop, cartpole, figure: str) -> None:
    findings = workshop.lint(cartpole(("track:       0.39 m", f"track: {figure} * 1 m")))
    assert [finding.code for finding in findings if finding.severity == "error"] == ["DB105"]


def test_an_object_has_the_density_of_water_unless_it_has_a_mass(workshop, cartpole) -> None:
    objects = (
        "objects:\n  a: {shape: box, size: 10 10 10 cm, pose: {x: 1 m}}\n  b: {shape: sphere, radius:"
        " 5 cm, mass: 0.3 kg}\nrobots:\n"
    )
    a, b = workshop.compile(cartpole(("robots:\n", objects))).program.world.objects
    assert a.mass == pytest.approx(1.0)
    assert b.mass == 0.3


def test_a_mark_is_seen_and_not_solid(workshop, cartpole) -> None:
    objects = (
        "objects:\n  spot: {shape: cylinder, radius: 2 cm, height: 1 mm, solid: false, color: red}\nrobots:\n"
    )
    (spot,) = workshop.compile(cartpole(("robots:\n", objects))).program.world.objects
    assert not spot.solid


def test_settling_takes_whole_timesteps(workshop, cartpole) -> None:
    assert workshop.codes(cartpole(("reset:", "reset:\n  settle: 50 ms"))) == ["DB308"]
    assert workshop.codes(cartpole(("reset:", "reset:\n  settle: 0.32 s"))) == []


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


def test_a_center_of_mass_is_moved_and_an_inertia_scaled(workshop, cartpole) -> None:
    before = model(workshop.compile(cartpole())).link("body").inertial
    change = "links: {body: {com: 1 0 -2 cm, inertia: 1.5}}"
    after = model(workshop.compile(cartpole(with_cart(change)))).link("body").inertial
    x, y, z = before.origin.xyz
    assert after.origin.xyz == pytest.approx((x + 0.01, y, z - 0.02))
    assert after.izz == pytest.approx(1.5 * before.izz)
    assert after.mass == before.mass


def test_of_two_patterns_the_later_one_moves_the_center_and_scales_the_inertia(workshop, cartpole) -> None:
    before = model(workshop.compile(cartpole())).link("wheel_front_left").inertial
    change = "links: {wheel_*: {com: 1 0 0 cm, inertia: 2}, wheel_front_left: {com: 0 2 0 cm, inertia: 3}}"
    after = model(workshop.compile(cartpole(with_cart(change)))).link("wheel_front_left").inertial
    assert after.origin.xyz == pytest.approx((before.origin.xyz[0], before.origin.xyz[1] + 0.02, 0.0))
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


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ("links: {body: {com: uniform(0 .. 1 cm)}}", "DB404"),
        ("links: {body: {inertia: 0}}", "DB105"),
        ("links: {body: {inertia: normal(1 +- 0.1)}}", "DB105"),
        ("joints: {pole_hinge: {armature: 0.1 kg}}", "DB503"),
        ("joints: {pole_hinge: {armature: -1 kg*m^2}}", "DB105"),
    ],
)
def test_an_impossible_property_is_a_finding(workshop, cartpole, change: str, code: str) -> None:
    assert [finding.code for finding in workshop.lint(cartpole(with_cart(change)))] == [code]


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
    ("keys", "message"),
    [
        ("stall_torque: 40 N*m", "`stall_torque` needs `no_load_speed`"),
        ("no_load_speed: 20 rad/s", "`no_load_speed` needs `stall_torque`"),
    ],
)
def test_a_torque_curve_needs_both_ends(keys: str, message: str) -> None:
    findings = api.lint("quadruped", overrides=[MOTOR % ("position_motor", keys)])
    assert [(finding.code, finding.headline) for finding in findings] == [("DB102", message)]


def test_a_servo_without_stiffness_has_no_torque_curve(workshop, cartpole) -> None:
    motor = "{type: position_motor, joint: pole_hinge, stall_torque: 1 N*m, no_load_speed: 5 rad/s}"
    findings = api.lint(
        workshop.write(cartpole()),
        overrides=[f"robots.cart.actuators.arm={motor}", "robots.cart.apply.arm=0 rad"],
    )
    assert [(finding.code, finding.headline) for finding in findings] == [
        ("DB102", "`stall_torque` needs `stiffness`")
    ]
