"""`deepbots new NAME --webots WORLD.wbt`: a project of Webots as a scenario.

Worlds as text: nodes, and findings about damaged worlds.

Worlds that mean harm: small texts that stand for much, and texts at the limits of size.

The tables of docs/webots.md name every node and every class with missing functions.
"""

from __future__ import annotations

import os
import re
import textwrap
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.cli.command import Starter
from deepbots_cli.diagnostics import Source
from deepbots_cli.diagnostics.findings import FILL_IN
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.geometry import ground_height
from deepbots_cli.scenario.fields import Name
from deepbots_webots.imports.starter import from_webots
from deepbots_webots.imports.world import scenario_name
from deepbots_webots.nodes import child, children, node_types, number, numbers, text, vector, walk
from deepbots_webots.project import (
    LIBRARY,
    MAX_LEVELS,
    Files,
    equivalent,
    read_world,
    world_of_source,
)
from deepbots_webots.scene import MAX_POINTS, build_scene
from deepbots_webots.sensors import MISSING
from deepbots_webots.syntax import (
    MAX_DEPTH,
    MAX_NODES,
    MAX_NUMBERS,
    MAX_TOKENS,
    Node,
    WorldError,
    parse,
)
from tests.files import written
from tests.webots.exported_projects import HEADER, node, read, simulation_of

WORLD = """
WorldInfo { basicTimeStep 16 gravity 9.81 }
RectangleArena { floorSize 3 2 }
DEF BOX Solid { translation 1 0 0.1 boundingObject Box { size 0.2 0.2 0.2 } physics Physics { density -1 mass 0.4 } }
DEF GOAL Solid { translation -1 0.5 0 }
DEF JUDGE Robot { name "judge" controller "judge" supervisor TRUE children [ Emitter { } Receiver { } ] }
DEF CART Robot { translation 0 0 0.05 controller "cart" name "cart" children [
    Emitter { } Receiver { }
    Gyro { translation 0.01 0 0 }
    HingeJoint { jointParameters HingeJointParameters { axis 0 1 0 anchor 0 0.1 0 }
      device [ RotationalMotor { name "left motor" maxVelocity 20 maxTorque 2 } ]
      endPoint Solid { translation 0 0.1 0 rotation 1 0 0 1.5708 name "left"
        boundingObject DEF WHEEL Cylinder { radius 0.05 height 0.02 } physics Physics { density -1 mass 0.1 } } }
    HingeJoint { jointParameters HingeJointParameters { axis 0 1 0 anchor 0 -0.1 0 }
      device [ RotationalMotor { name "right motor" maxVelocity 20 maxTorque 2 } ]
      endPoint Solid { translation 0 -0.1 0 rotation 1 0 0 1.5708 name "right"
        boundingObject USE WHEEL physics Physics { density -1 mass 0.1 } } }
    DEF ARM HingeJoint { jointParameters HingeJointParameters { axis 0 1 0 anchor 0 0 0.05 position 0.1
        minStop -1 maxStop 1 dampingConstant 0.01 }
      device [ PositionSensor { name "armAngle" } ]
      endPoint DEF ROD Solid { translation 0 0 0.3 name "rod"
        children [ DEF TIP Solid { translation 0 0 0.25 name "tip" boundingObject Sphere { radius 0.02 }
          physics Physics { density -1 mass 0.05 } } ]
        boundingObject Box { size 0.02 0.02 0.5 } physics Physics { density -1 mass 0.2 } } }
  ]
  boundingObject Pose { translation 0 0 0.02 children [ Box { size 0.2 0.1 0.04 } ] }
  physics Physics { density -1 mass 1 } }
"""
CART = """
from deepbots.robots import CSVRobot

class Cart(CSVRobot):
    def __init__(self):
        super().__init__()
        self.arm = self.getDevice("armAngle")
        self.arm.enable(self.timestep)
        self.motors = []
        for name in ["left motor", "right motor"]:
            motor = self.getDevice(name)
            motor.setPosition(float("inf"))
            motor.setVelocity(0.0)
            self.motors.append(motor)

    def create_message(self):
        return [str(self.arm.getValue())]

    def use_message_data(self, message):
        choice = int(message[0])
        speed = 6.0 if choice == 0 else -6.0
        for motor in self.motors:
            motor.setVelocity(speed)

Cart().run()
"""
JUDGE = """
from deepbots.supervisor import CSVSupervisorEnv

def normalize_to_range(value, low, high, new_low, new_high, clip=False):
    raise RuntimeError("no code of the project runs")

class Judge(CSVSupervisorEnv):
    def __init__(self):
        super().__init__()
        self.action_space = 2
        self.cart = self.getFromDef("CART")
        self.message = None
        self.scores = []
        self.steps = 0
        __INIT__

    def get_observations(self):
        self.message = self.handle_receiver()
        if self.message is not None:
            angle = normalize_to_range(float(self.message[0]), -0.9, 0.9, -1.0, 1.0, clip=True)
        else:
            angle = 0.0
        place = normalize_to_range(self.cart.getPosition()[0], -1.5, 1.5, -1.0, 1.0)
        return [angle, place]

    def get_reward(self, action=None):
        __REWARD__

    def is_done(self):
        __DONE__

    def solved(self):
        __SOLVED__

raise SystemExit("no code of the project runs")
"""
DONE = "return abs(float(self.message[0])) > 0.8"
SOLVED = "return len(self.scores) > 50 and sum(self.scores) > 1"


def project(folder: Path, world: str = WORLD, cart: str = CART, judge: str = JUDGE, **methods: str) -> Path:
    """Write a project; `methods` are the bodies of `init`, `reward`, `done` and `solved`. Returns the
    world."""
    bodies = {"init": "pass", "reward": "return 1", "done": DONE, "solved": SOLVED} | methods
    for name, body in bodies.items():
        inside = textwrap.indent(textwrap.dedent(body).strip(), "        ").strip()
        judge = judge.replace(f"__{name.upper()}__", inside)
    for name, code in (("cart", cart), ("judge", judge)):
        encoded = code.encode("utf-8", "surrogateescape")
        written(folder / "controllers" / name / f"{name}.py", encoded)
    return written(folder / "worlds" / "world.wbt", world if world.startswith("#") else HEADER + world)


def imported(folder: Path, **parts: str) -> tuple[Starter, str]:
    """Return what `deepbots new` writes for a project, and the text of its scenario."""
    starter = from_webots(project(folder / "project", **parts), (), "cart", "Cart")
    for path, content in starter.files.items():
        written(folder / "out" / path, content)
    return starter, (folder / "out" / "cart.yaml").read_text(encoding="utf-8")


def lines_of(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines()]


def compiled(folder: Path) -> Any:
    """Return the scenario of `imported`."""
    return api.compile(folder / "out" / "cart.yaml").program


# Worlds


def errors_of(folder: Path) -> list[str]:
    """Return the errors that `lint` finds in the scenario of `imported`."""
    findings = api.lint(folder / "out" / "cart.yaml")
    return [finding.headline for finding in findings if finding.severity == "error"]


def test_the_scenario_of_a_project_runs_before_a_person_writes_it(tmp_path: Path) -> None:
    imported(tmp_path)
    env = api.make(tmp_path / "out" / "cart.yaml")
    observation, _ = env.reset(seed=0)
    assert observation.shape == (2,)
    _, reward, *_ = env.step([0.5])
    assert reward == 1.0
    env.close()


def test_each_place_of_a_person_is_a_finding_with_the_python_of_the_project(tmp_path: Path) -> None:
    starter, text = imported(tmp_path)
    places = [line for line in lines_of(text) if line.startswith(FILL_IN)]
    assert [place.removeprefix(f"{FILL_IN}: ") for place in places] == [
        "the message: `emit` with names of sensors, from cart.py:16: def create_message",
        "what motors do, from cart.py:19: def use_message_data",
        "the action, which robots get under `apply`",
        "the observation, from judge.py:17: def get_observations",
        "angle, from judge.py:20",
        "place, from judge.py:23",
        "the endings, from judge.py:29: def is_done",
        "the time limit of an episode, which the loop of the project's training may have",
        "when the task is solved, from judge.py:32: def solved",
    ]
    findings = [finding for finding in api.lint(tmp_path / "out" / "cart.yaml") if finding.code == "DB109"]
    assert len(findings) == len(places) == starter.todos
    assert "#     speed = 6.0 if choice == 0 else -6.0" in lines_of(text)
    assert text.startswith("# From world.wbt of Webots.")


@pytest.mark.parametrize(
    ("other", "place", "warning"),
    [
        ("judge", "the endings, from judge.py:29: def is_done", "is controllers/judge"),
        ("plan", "the observation", "name it: its folder in the field `controller` of the world"),
    ],
)
def test_a_controller_that_is_started_by_hand_is_read_if_one_folder_fits(
    tmp_path: Path, other: str, place: str, warning: str
) -> None:
    written(tmp_path / "project" / "controllers" / other / f"{other}.py", "")
    by_hand = WORLD.replace('name "judge" controller "judge"', 'name "umpire" controller "<extern>"')
    starter, text = imported(tmp_path, world=by_hand)
    assert f"{FILL_IN}: {place}" in lines_of(text)
    assert any(warning in each for each in starter.warnings)


def test_a_world_without_a_class_of_deepbots_has_a_place_for_each_placeholder(tmp_path: Path) -> None:
    starter, text = imported(tmp_path, cart="", judge="")
    assert starter.todos == 5
    for placeholder in (
        "action * 20 rad/s",
        "action: -1 .. 1",
        "previous_action: auto",
        "each_step: 0",
        "max_steps: 1000",
    ):
        lines = lines_of(text)
        position = next(number for number, line in enumerate(lines) if placeholder in line)
        assert any(line.startswith(FILL_IN) for line in lines[position - 2 : position])


def test_a_grid_of_heights_is_the_terrain(tmp_path: Path) -> None:
    """Rows are along x; the terrain of the scenario has the heights of the world at its corners."""
    grid = """Solid { translation -2 -1 0 boundingObject ElevationGrid { xDimension 3 yDimension 2
      xSpacing 2 ySpacing 2 height [ 0 0.1 0.2, 0.3 0.4 0.6 ] } }"""
    _, text = imported(tmp_path, world=WORLD.replace("RectangleArena { floorSize 3 2 }", grid))
    assert "terrain: {type: heightfield, file: world_terrain.png, size: 4 2 m, height: 0.6 m}" in text
    height = ground_height(compiled(tmp_path).world.terrain)
    corners = [(-2, -1), (0, -1), (1.999, -1), (-2, 0.999), (0, 0.999), (1.999, 0.999)]
    assert [height(*corner) for corner in corners] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.6], abs=1e-3)


def test_all_robots_with_a_class_of_deepbots_are_read(tmp_path: Path) -> None:
    cart = WORLD[WORLD.index("DEF CART") :]
    twin = cart.replace("DEF CART", "DEF TWIN").replace("0 0 0.05", "0.5 0.5 0.05", 1)
    _, text = imported(tmp_path, world=WORLD + twin)
    for part in text[text.index("  cart:") :].split("  twin:", 1):
        assert "left_motor: {type: velocity_motor, joint: left_motor_joint}" in part
        assert "def use_message_data" in part


PLAIN_BASE = "from deepbots.robots import CSVRobot\n\nclass Cart(CSVRobot):"


@pytest.mark.parametrize(
    "head",
    [
        "from deepbots.robots import CSVRobot as Robot\n\nclass Cart(Robot):",
        "import deepbots.robots as robots\n\nclass Cart(robots.CSVRobot):",
        "import base\n\nclass Cart(base.Base):",
        "from base import Base as Cart\n\nclass Cart(Cart):",
        "from . import base\n\nclass Cart(base.Base):",
        "from deepbots.robots import CSVRobot\nfrom base import Mixin\n\nclass Cart(CSVRobot, Mixin):",
    ],
)
def test_a_class_has_the_methods_of_all_its_bases(tmp_path: Path, head: str) -> None:
    first, rest = CART.index("    def create_message"), CART.index("    def use_message_data")
    message = CART[first:rest]
    written(
        tmp_path / "project" / "controllers" / "cart" / "base.py",
        f"from deepbots.robots import CSVRobot\n\nclass Mixin:\n{message}\nclass Base(CSVRobot):\n{message}",
    )
    assert PLAIN_BASE in CART
    cart = CART if "base" not in head else CART.replace(message, "")
    _, text = imported(tmp_path, cart=cart.replace(PLAIN_BASE, head))
    assert "def create_message" in text
    assert "def use_message_data" in text


BOTH = """
from deepbots.supervisor import RobotSupervisorEnv

class Both(RobotSupervisorEnv):
    def __init__(self):
        super().__init__()
        self.arm = self.getDevice("armAngle")

    def get_observations(self):
        return [normalize_to_range(self.arm.getValue(), -1, 1, -1, 1, True)]

    def apply_action(self, action):
        self.motor.setTorque([0.5, -0.5][int(action[0])])
"""
ANEW = """    def step(self, action, repeat=4):
        return self.repeat_it(action, repeat)

    def reset(self):
        self.far = 0

"""


@pytest.mark.parametrize(
    ("parts", "lines", "absent"),
    [
        pytest.param(
            {"world": WORLD.replace("gravity 9.81", "gravity 1.6")},
            [
                "timestep: 16 ms",
                "gravity: 0 0 -1.6 m/s^2",
                "arena: {size: 3 2 m, wall_height: 0.1 m, wall_thickness: 0.01 m}",
                "box: {shape: box, size: 0.2 0.2 0.2 m, mass: 0.4 kg, pose: {xyz: 1 0 0.1 m}}",
            ],
            "goal:",  # nothing reads it
            id="timestep, gravity, arena and objects",
        ),
        pytest.param(
            {"world": WORLD.replace("Gyro {", 'Radar { name "eye" } Gyro {')},
            ["# deepbots has no such sensor: eye (Radar)"],
            "radar:",
            id="a device without a sensor",
        ),
        pytest.param(
            {},
            [
                "arm_angle: {type: joint_position, joint: rod_joint}",
                "#   gyro: {type: gyro, link: cart, pose: {xyz: 0.01 0 0 m}}",
            ],
            "radar:",
            id="sensors that the project does not name are comments",
        ),
        pytest.param(
            {"judge": JUDGE.replace("    def solved", f"{ANEW}    def solved"), "done": "return False"},
            ["#     return self.repeat_it(action, repeat)", "#     self.far = 0"],
            "termination",
            id="methods of deepbots that the project writes anew",
        ),
        pytest.param(
            {
                "world": WORLD.replace('controller "judge" supervisor TRUE', 'controller "<none>"').replace(
                    'controller "cart"', 'controller "cart" supervisor TRUE'
                ),
                "cart": BOTH,
            },
            ["messages: {format: none}", "value_0: -1 .. 1"],
            "format: csv",
            id="a robot supervisor has no messages",
        ),
        *(
            pytest.param({"reward": reward}, [entry], "def get_reward", id=entry)
            for reward, entry in (("return 1", "alive: 1"), ("return -0.5", "each_step: -0.5"))
        ),
    ],
)
def test_a_scenario_has_what_the_project_has(
    tmp_path: Path, parts: dict[str, str], lines: list[str], absent: str
) -> None:
    _, text = imported(tmp_path, **parts)
    assert [line for line in lines if line not in lines_of(text)] == []
    assert absent not in text


def test_the_robot_has_the_masses_joints_and_limits_of_the_world(tmp_path: Path) -> None:
    imported(tmp_path)
    model = compiled(tmp_path).world.robots[0].model
    assert model.mass == pytest.approx(1 + 0.1 + 0.1 + 0.2 + 0.05)
    arm = model.joint("rod_joint")
    assert (arm.limit.lower, arm.limit.upper, arm.damping) == (-1.0, 1.0, 0.01)
    wheel = model.joint("left_motor_joint")
    assert (wheel.type, wheel.limit.velocity, wheel.limit.effort) == ("continuous", 20.0, 2.0)
    assert model.link("rod").inertial.origin.xyz[2] == pytest.approx((0.2 * 0.25 + 0.05 * 0.5) / 0.25)


def test_a_solid_that_a_controller_names_is_a_link_or_a_marker(tmp_path: Path) -> None:
    judge = JUDGE.replace('self.getFromDef("CART")', 'self.getFromDef("TIP"), self.getFromDef("GOAL")')
    _, text = imported(tmp_path, judge=judge)
    assert {"#   TIP: cart.tip", "#   GOAL: goal", "#   armAngle: cart.arm_angle"} <= {*lines_of(text)}
    assert "getPosition(): position(BODY)" in text
    assert "goal: {shape: sphere, radius: 1 cm, solid: false, fixed: true, pose: {xyz: -1 0.5 0 m}}" in text
    assert "tip" in [link.name for link in compiled(tmp_path).world.robots[0].model.links]


# What is plainly constant


@pytest.mark.parametrize(
    ("call", "entry"),
    [
        ("normalize_to_range(v, -1.5, 1.5, -1.0, 1.0, clip=True)", "place: -1.5 .. 1.5"),
        ("normalize_to_range(v, -1.5, 1.5, -1.0, 1.0)", "place: {range: -1.5 .. 1.5, clip: false}"),
        (
            "normalize_to_range(value=v, min_val=0, max_val=2, new_min=0, new_max=1, clip=True)",
            "place: 0 .. 2",
        ),
        ("tools.normalize_to_range(v, 0, 2, 0, 1, True)", "place: 0 .. 2"),
        ("normalize_to_range(v, 0, self.far, 0, 1, True)", ""),
        ("normalize_to_range(v, 0, LIMIT, 0, 1, True)", ""),
        ("normalize_to_range(v, 0, len(self.scores), 0, 1, True)", ""),
        ("normalize_to_range(v, 0, 2, 0, 1, self.far)", ""),
        ("normalize_to_range(v, 0, 2, **more)", ""),
        ("normalize_to_range(v, 2, 0, 0, 1, True)", ""),
        ("normalize_to_range(v, 0, 1e999, 0, 1, True)", ""),
    ],
)
def test_a_constant_range_of_an_observation_is_filled_in(tmp_path: Path, call: str, entry: str) -> None:
    old = "normalize_to_range(self.cart.getPosition()[0], -1.5, 1.5, -1.0, 1.0)"
    judge = JUDGE.replace(old, call.replace("v,", "self.cart.getPosition()[0],"))
    _, text = imported(tmp_path, judge=judge)
    ranges = text.partition("\nobservation:\n")[2].partition("\n\n")[0]
    assert [line.strip() for line in ranges.splitlines()] == [
        "angle: -0.9 .. 0.9",
        *([entry] if entry else []),
    ]


@pytest.mark.parametrize(
    "reward",
    [
        "return X",
        "return True",
        "return 1e999",
        "if FAST:\n    return 1\nreturn 2",
        "r = 1\nreturn r",
        "return 1\n\ndef get_reward(self, action=None):\n    return 2",
        "return self.get_reward()",
    ],
)
def test_a_method_that_does_more_than_return_a_number_is_quoted(tmp_path: Path, reward: str) -> None:
    _, text = imported(tmp_path, reward=reward)
    assert "def get_reward" in text
    assert "each_step: 0" in lines_of(text)
    assert errors_of(tmp_path) == []


def test_a_file_that_no_controller_imports_is_not_read(tmp_path: Path) -> None:
    written(tmp_path / "project" / "controllers" / "judge" / "another_copy.py", JUDGE)
    _, text = imported(tmp_path, reward="return 20")
    assert "alive: 20" in lines_of(text)


@pytest.mark.parametrize(
    "cart",
    [
        "",
        "def (",
        "class Cart(CSVRobot):\n    pass",
        "class Cart(Cart, Cart, Cart, Cart, Cart, CSVRobot):\n    pass",
        "\0",
        "x = " + "(" * 5000,
        "x = " + "-" * 5000 + "1",
        "x=" + "1+" * 9000 + "1",
    ],
)
def test_a_controller_that_cannot_be_read_leaves_the_actions_to_a_person(tmp_path: Path, cart: str) -> None:
    _, text = imported(tmp_path, cart=cart)
    assert f"{FILL_IN}: what motors do" in lines_of(text)
    assert errors_of(tmp_path) == []


def test_a_world_without_motors_is_one_sentence(tmp_path: Path) -> None:
    world = project(tmp_path, world='WorldInfo { } DEF JUDGE Robot { supervisor TRUE controller "judge" }')
    with pytest.raises(DeepbotsError, match=r"no robot of .* has a motor"):
        from_webots(world, (), "cart", "Cart")


def test_nothing_outside_the_project_is_read(tmp_path: Path) -> None:
    world = project(tmp_path / "project", judge=f"import secret\n{JUDGE}")
    secret = written(tmp_path / "secret.py", "LIMIT = 123456\n")
    (world.parent.parent / "controllers" / "judge" / "secret.py").symlink_to(secret)
    starter = from_webots(world, (), "cart", "Cart")
    assert not any("123456" in content.decode() for content in starter.files.values())
    assert any("outside the project" in warning for warning in starter.warnings)


# Damage


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_python_and_worlds_end_in_a_scenario_or_one_sentence(
    tmp_path: Path, data: st.DataObject
) -> None:
    texts = {"world": WORLD, "cart": CART, "judge": JUDGE}
    which = data.draw(st.sampled_from(sorted(texts)))
    pieces = ["", "(", "'", "1e999", "\n", "self", " if x else ", "[0]", "#", "\0", "é: {"]
    try:
        starter, _ = imported(tmp_path, **{which: damaged(data, texts[which], st.sampled_from(pieces), 4)})
    except DeepbotsError:
        return  # with a sentence; anything else fails this test
    assert starter.todos > 0
    assert errors_of(tmp_path) == []


def damaged(data: st.DataObject, text: str, pieces: st.SearchStrategy[str], times: int = 1) -> str:
    """Return a text with pieces in place of up to 40 characters, up to so many times."""
    for _ in range(data.draw(st.integers(1, times))):
        start, length = data.draw(st.integers(0, len(text) - 1)), data.draw(st.integers(0, 40))
        text = text[:start] + data.draw(pieces) + text[start + length :]
    return text


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("polePosSensor", "pole_pos_sensor"),
        ("wheel 1", "wheel_1"),
        ("1st", "part_1st"),
        ("velocity", "velocity"),  # a function, whose name a value may have too
        ("kg", "part_kg"),
        ("when", "part_when"),
        ("yes", "part_yes"),
        ("x", "part_x"),
        ("é", "part"),
    ],
)
def test_names_of_webots_become_names_that_a_scenario_accepts(text: str, name: str) -> None:
    assert scenario_name(text) == name
    Name(shared=True).check(name)


EXAMPLE = """#VRML_SIM R2023b utf8
EXTERNPROTO "https://raw.githubusercontent.com/cyberbotics/webots/R2023b/projects/objects/floors/protos/RectangleArena.proto"
PROTO Wheel [ field SFFloat radius 0.04 field SFString name "wheel" field MFNode extra [ ] ]
{ Solid { name IS name children IS extra boundingObject Cylinder { radius IS radius height 0.02 } physics Physics { } } }
WorldInfo { basicTimeStep 16 info [ "a", "b" ] contactProperties [ ContactProperties { coulombFriction 0.5 } ] }
Viewpoint { orientation 0 0 1 0.5 position -1 0 1 }
RectangleArena { floorSize 2 2 } # a comment
DEF ROBOT Robot { translation 0 0 .1 children [ DEF SHAPE Shape { geometry Box { size 0.2 0.1 0.1 } }
  HingeJoint { jointParameters HingeJointParameters { axis 0 1 0 anchor 0 0.1 0 }
    device [ RotationalMotor { name "motor" }, PositionSensor { } ] endPoint Wheel { radius 0.05 } } ]
  boundingObject USE SHAPE physics Physics { density -1 mass 1 } controller "c" supervisor TRUE }
"""


def test_a_comment_between_the_numbers_of_a_field_is_left_out():
    (body,) = parse(Source("a.wbt", "#VRML_SIM R2023b utf8\nSolid { translation 1 2 # up\n 3 }")).nodes
    assert body.fields["translation"].items == [1.0, 2.0, 3.0]


def errors(text: str) -> list[tuple[str, str]]:
    """Return the errors of a world that cannot run, each with the text that it points to."""
    try:
        world = read(text)
        build_scene(world)
        findings = world.findings.errors
    except WorldError as error:
        findings = error.findings
    return [(each.headline, each.span.source.text[each.span.start : each.span.end]) for each in findings]


# What is read


def test_a_world_is_a_tree_of_nodes_with_places():
    document = parse(Source("w.wbt", EXAMPLE))
    assert [entry.type for entry in document.nodes] == ["WorldInfo", "Viewpoint", "RectangleArena", "Robot"]
    assert [*document.externs] == ["RectangleArena"]
    robot = document.nodes[-1]
    assert (robot.name, robot.span.start_position, vector(robot, "translation")) == (
        "ROBOT",
        (8, 11),
        (0, 0, 0.1),
    )
    assert child(robot, "boundingObject").name == "SHAPE"


def test_a_definition_is_used_by_reference_and_defaults_are_those_of_webots():
    world = read(EXAMPLE)
    info, _, _, robot = world.nodes
    assert (number(info, "basicTimeStep"), number(info, "ERP"), text(robot, "window")) == (
        16,
        0.2,
        "<generic>",
    )
    motor = next(motor_node for motor_node in walk(world.nodes) if motor_node.type == "RotationalMotor")
    assert (number(motor, "maxVelocity"), number(motor, "maxTorque"), numbers(motor, "controlPID")) == (
        10,
        10,
        [10, 0, 0],
    )


def test_a_proto_keeps_its_fields_and_becomes_its_body():
    wheel = next(entry for entry in walk(read(EXAMPLE).nodes) if entry.type == "Wheel")
    assert number(wheel, "radius") == 0.05
    cylinder = child(wheel.body, "boundingObject")
    assert (number(cylinder, "radius"), text(wheel.body, "name")) == (0.05, "wheel")


def test_nodes_in_a_field_of_a_proto_take_their_place_in_its_body():
    world = read(
        HEADER
        + "PROTO A [ field MFNode slot [ ] ] { Solid { translation 1 0 0 children [ Group { children IS slot } ] } }"
        + " A { slot [ DEF INNER Solid { translation 0 2 0 } ] }"
    )
    assert node(simulation_of(world), "INNER").getPosition() == pytest.approx([1, 2, 0])


def test_a_proto_of_the_project_is_read_from_its_file(tmp_path: Path):
    proto = "PROTO Ball [ field SFFloat radius 1 ] { Solid { boundingObject Sphere { radius IS radius } } }"
    world = using(tmp_path, "../protos/Ball.proto", proto, "Ball { radius 0.5 }")
    assert build_scene(read_world(world)).bodies[0].geometries[0].shape.radius == 0.5


def using(folder: Path, address: str, proto: str, use: str) -> Path:
    """Write a PROTO and a world that uses it, and return the world."""
    written(folder / "worlds" / address, HEADER + proto)
    return written(folder / "worlds" / "w.wbt", f'{HEADER}EXTERNPROTO "{address}"\n{use}')


def test_a_copy_of_webots_has_further_protos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    proto = "PROTO Duck [ ] { Solid { boundingObject Sphere { radius 0.1 } } }"
    written(tmp_path / "webots" / "projects" / "objects" / "toys" / "Duck.proto", HEADER + proto)
    path = written(
        tmp_path / "project" / "worlds" / "w.wbt",
        HEADER + 'EXTERNPROTO "webots://projects/objects/toys/Duck.proto"\nDuck { }',
    )
    missing = read_world(path).findings.errors
    assert [finding.headline for finding in missing] == ["PROTO Duck is not available"]
    assert not read_world(path, [tmp_path / "webots"]).findings.errors
    monkeypatch.setenv("WEBOTS_HOME", str(tmp_path / "webots"))
    assert not read_world(path).findings.errors


# Findings


@pytest.mark.parametrize(
    ("text", "headline"),
    [
        ("", "the first line is not a header of Webots"),
        (
            "#VRML_SIM V8.5 utf8\nWorldInfo { }",
            "a world of V8.5; deepbots reads those of V8.6 and later",
        ),
        (HEADER + "WorldInfo {", "the end of the file in the place of the name of a field or '}'"),
        (HEADER + "WorldInfo { title }", "'}' in the place of a value"),
        (HEADER + 'WorldInfo { title "a }', "a string without its end"),
        (HEADER + "Robot { children [ Solid { ] }", "']' in the place of the name of a field or '}'"),
        (HEADER + "Robot { boundingObject USE BOX }", "USE of 'BOX', which no DEF names before"),
        (HEADER + "Solid { name 1 name 2 }", "the field name is written twice"),
        (HEADER + "1 2 3", "'1' in the place of a node"),
        (HEADER + "PROTO A [ field SFOdd x 1 ] { Solid { } }", "there is no type SFOdd"),
        (HEADER + "PROTO A [ ] { }", "PROTO A has no node"),
        (HEADER + "Solid { children [ " * (MAX_DEPTH + 1), f"nodes are more than {MAX_DEPTH} levels deep"),
    ],
)
def test_a_text_that_is_not_a_world_is_one_finding(text: str, headline: str):
    with pytest.raises(WorldError) as caught:
        world_of_source(Source("w.wbt", text), Path("/n/worlds/w.wbt"), Files(Path("/n")))
    (finding,) = caught.value.findings
    assert finding.headline == headline
    assert str(finding).startswith("w.wbt:")


@pytest.mark.parametrize(
    ("text", "headline"),
    [
        ("Robt { }", "PROTO Robt is not available"),
        ("Solid { translation 1 2 }", "Solid.translation is 2 numbers, and not three numbers"),
        ("Solid { translation [ 1 2 3 ] }", "Solid.translation is a list, and not three numbers"),
        ("Solid { name 3 }", "Solid.name is not a text in quotes"),
        ("Robot { supervisor 1 }", "Robot.supervisor is not TRUE or FALSE"),
        ("Solid { translation 1e999 0 0 }", "Solid.translation is too large a number"),
        ("Solid { translation IS place }", "Solid.translation is IS place, outside of a PROTO"),
        (
            "Solid { boundingObject Sphere { radius -1 } }",
            "a Sphere whose size is not positive, or is above 1000 km",
        ),
        ("Solid { physics Physics { density -1 } }", "Physics with neither a density nor a mass"),
        ("WorldInfo { basicTimeStep 0 }", "basicTimeStep is 0 ms; it is between 1 and 10,000"),
        ('WorldInfo { coordinateSystem "UP" }', "coordinateSystem 'UP' is none of ENU, NUE and EUN"),
        ("Track { }", "the node Track is not implemented"),
        ("PROTO A [ ] { A { } } A { }", "PROTO A contains itself"),
        ("PROTO A [ ] { Solid { name IS x } } A { }", "the PROTO has no field 'x'"),
        ('EXTERNPROTO "webots://projects/a/B.proto" B { }', "PROTO B is not available"),
        ("Gadget { } Widget { } Gadget { }", "the PROTOs Gadget and Widget are not available"),
        (
            "PROTO A [ ] { Solid { translation %<= 1 >% 0 0 } } A { }",
            "PROTO A is a template with code, which deepbots does not run",
        ),
        (
            'Solid { boundingObject Mesh { url "../../etc/passwd" } }',
            "the mesh '../../etc/passwd' is not a file of the project",
        ),
        (
            f'Solid {{ boundingObject Mesh {{ url "{"x" * 300}.stl" }} }}',
            f"the mesh '{'x' * 80}' is not a file of the project",
        ),
        (f'EXTERNPROTO "{"x" * 300}.proto" {"x" * 300} {{ }}', f"PROTO {'x' * 300} is not available"),
        (
            "Solid { boundingObject ElevationGrid { } }",
            "an ElevationGrid with less than two rows or columns, or without spacing",
        ),
        (
            "Solid { boundingObject IndexedFaceSet { coord Coordinate { point [ 0 0 0 ] } coordIndex [ 0 1 2 ] } }",
            "an IndexedFaceSet whose coordIndex names a point that does not exist",
        ),
        (
            "Solid { physics Physics { density -1 mass 1 inertiaMatrix [ 1 1 9, 0 0 0 ] } }",
            "inertiaMatrix is none of a rigid body",
        ),
        (
            "Robot { children [ HingeJoint { jointParameters HingeJointParameters { axis 0 0 0 } endPoint Solid { } } ] }",
            "the axis of a HingeJoint is zero",
        ),
        (
            "Robot { children [ Propeller { slowHelix Box { } } ] }",
            "Propeller.slowHelix is a Box, and not a Solid",
        ),
        ("Robot { children [ Propeller { device Brake { } } ] }", "a Brake does not turn a Propeller"),
    ],
)
def test_a_world_that_cannot_run_says_why(text: str, headline: str):
    assert [error for error, _ in errors(text)] == [headline]


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n" + b"f 1 2 3\n" * 3_800_000, "more than 400,000"),
        ("a.stl", b"x" * 80 + (500_000).to_bytes(4, "little") + bytes(50 * 500_000), "it has 500,000 faces"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 3\nelement face 3800000\n",
            "it has 3,800,000 faces",
        ),
    ],
)
@pytest.mark.timeout(60)
def test_a_mesh_of_millions_of_faces_is_refused_before_it_is_loaded(
    tmp_path: Path, name: str, data: bytes, reason: str
):
    written(tmp_path / "worlds" / name, data)
    world = read(f'Solid {{ boundingObject Mesh {{ url "{name}" }} }}', tmp_path)
    build_scene(world)
    (finding,) = world.findings.errors
    assert reason in finding.headline


@pytest.mark.parametrize(
    ("text", "headline"),
    [
        ("Solid { colour 1 }", "Solid has no field 'colour'"),
        ("RectangleArena { floorSise 1 1 }", "RectangleArena has no field 'floorSise'"),
        (
            'EXTERNPROTO "https://x/Rust.proto" Solid { children [ Shape { appearance Rust { } } ] }',
            "the appearance Rust is not available",
        ),
        ("Solid { boundingObject Cone { } }", "Cone cannot collide"),
        (
            "Robot { children [ GPS { } GPS { } ] }",
            "the robot 'robot' has two devices 'gps'; the first one is used",
        ),
        (
            "Robot { children [ HingeJoint { device [ RotationalMotor { } LinearMotor { } ] endPoint Solid { } } ] }",
            "an axis with two motors; the first one is used",
        ),
        (
            "E-puck { kinematic TRUE } Pit { perlinNOctaves 3 } SolidBox { physics Physics { } }",
            "E-puck.kinematic is not implemented",
        ),
    ],
)
def test_a_world_runs_without_what_it_warns_of(text: str, headline: str):
    world = read(text)
    build_scene(world)
    assert [finding.headline for finding in world.findings.warnings] == [headline]


def test_findings_have_their_place_and_a_suggestion():
    (finding,) = read(HEADER + 'WorldInfo { }\nSolid {\n  naem "a"\n}').findings.warnings
    assert str(finding) == "world.wbt:4:8: warning: Solid has no field 'naem'\n  help: did you mean 'name'?"


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_nothing_is_read_outside_of_the_project(tmp_path: Path):
    secret = written(tmp_path / "Secret.proto", HEADER + "PROTO Secret [ ] { Solid { } }")
    (tmp_path / "project" / "protos").mkdir(parents=True)
    (tmp_path / "project" / "protos" / "Secret.proto").symlink_to(secret)
    for address in ("../protos/Secret.proto", "../../Secret.proto"):
        text = HEADER + f'EXTERNPROTO "{address}"\nSecret {{ }}'
        path = written(tmp_path / "project" / "worlds" / "w.wbt", text)
        assert [finding.headline for finding in read_world(path).findings.errors] == [
            "PROTO Secret is not available"
        ]


# Damage


def survives(text: str) -> None:
    """Build and run a world, which may end in findings and in nothing else."""
    try:
        world = world_of_source(Source("w.wbt", text), Path("/n/worlds/w.wbt"), Files(Path("/n")))
        simulation = simulation_of(world)
        for _ in range(2):
            simulation.run_step()
    except (DeepbotsError, FloatingPointError):
        pass


@given(st.data())
def test_a_damaged_world_ends_in_findings(data: st.DataObject):
    words = [
        "{",
        "}",
        "[",
        "]",
        '"',
        "IS x",
        "USE ROBOT",
        "DEF A",
        "NULL",
        "TRUE",
        "-1",
        "1e308",
        "0",
        "nan",
        "#",
    ]
    pieces = st.one_of(st.text(max_size=12), st.sampled_from([*words, "PROTO B [", "%<"]))
    survives(damaged(data, EXAMPLE, pieces))


ENDS_S = 60
"""A bound against what takes quadratic time: the slowest world takes 1 s on an idle core."""
BOX = "Shape { geometry Box { } }"
PAIR = "PROTO Pair [ field MFNode x [ ] ] { Group { children [ Group { children IS x } Group { children IS x } ] } } "
MANY_NODES = f"the world has more than {MAX_NODES:,} nodes, each as often as USE and PROTO repeat it"
MANY_POINTS = f"the world has more than {MAX_POINTS:,} points of meshes and grids"
MANY_LEVELS = f"the world has more than {MAX_LEVELS} levels of nodes"


def doubled(levels: int, leaf: str = BOX) -> str:
    """Return a text in which each definition uses the previous one twice."""
    first = f"DEF A0 Group {{ children [ {leaf} ] }} "
    return first + "".join(
        f"DEF A{i} Group {{ children [ USE A{i - 1} USE A{i - 1} ] }} " for i in range(1, levels)
    )


def protos(count: int, uses: int, body: str = "Group { children [ %s ] }") -> str:
    """Return PROTOs that each contain the previous one, and a node of the last one."""
    texts = [f"PROTO P{i} [ ] {{ {body % (f'P{i - 1} {{ }} ' * uses if i else '')} }} " for i in range(count)]
    return "".join(texts) + f"P{count - 1} {{ }}"


@pytest.mark.parametrize(
    ("text", "headline", "place"),
    [
        pytest.param(doubled(18), MANY_NODES, "Group", id="USE that doubles"),
        pytest.param(doubled(14, "Solid { }"), MANY_NODES, "Group", id="USE that doubles solids"),
        pytest.param(doubled(1000), f"nodes are more than {MAX_DEPTH} levels deep", "USE", id="USE in USE"),
        pytest.param("DEF A Group { children [ USE A ] }", "USE of 'A' within itself", "USE", id="USE of itself"),
        pytest.param(
            "PROTO P [ ] { DEF A Solid { boundingObject USE A } } P { }",
            "USE of 'A' within itself",
            "USE",
            id="USE of itself in a PROTO",
        ),
        pytest.param(
            "PROTO A [ ] { Group { children [ A { } A { } ] } } A { }",
            "PROTO A contains itself",
            "A",
            id="PROTO of itself",
        ),
        pytest.param(
            "PROTO A [ field SFNode x A { } ] { Group { children IS x } } A { }",
            "PROTO A contains itself",
            "A",
            id="PROTO in its default",
        ),
        pytest.param(
            "PROTO A [ ] { Group { children B { } } } PROTO B [ ] { Group { children [ A { } A { } ] } } B { }",
            "PROTO B contains itself",
            "B",
            id="PROTOs of each other",
        ),
        pytest.param(protos(17, 2), MANY_NODES, "P2", id="PROTO that doubles"),
        pytest.param(protos(300, 1), MANY_LEVELS, "P224", id="PROTO in PROTO"),
        pytest.param(
            protos(19, 1, "Solid { children [ " * 30 + "%s" + "] } " * 30), MANY_LEVELS, "Solid", id="deep PROTOs"
        ),
        pytest.param(
            f"{PAIR}{'Pair { x [ ' * 30}{BOX}{' ] }' * 30}", MANY_NODES, "Group", id="IS that doubles"
        ),
        pytest.param(
            "".join(
                f"PROTO P{i} [ field SFNode x DEF D{i} Group {{ children [ {f'USE D{i - 1} ' * 2 if i else ''} ] }} ]"
                " { Group { children IS x } } "
                for i in range(25)
            )
            + "P24 { }",
            MANY_NODES,
            "Group",
            id="USE in defaults that doubles",
        ),
        pytest.param("Group { }" * (MAX_NODES + 1), f"the file has more than {MAX_NODES:,} nodes", "Group", id="nodes"),
        pytest.param(
            "Solid { boundingObject Group { children [ DEF G ElevationGrid { xDimension 1000 yDimension 1000 }"
            + "USE G " * 100
            + "] } }",
            MANY_POINTS,
            "ElevationGrid",
            id="USE of a grid",
        ),
        pytest.param(
            "".join(f"Pit {{ xDimension 400 yDimension 400 randomSeed {i} }}" for i in range(100)),
            "the PROTOs of the world are larger than 4 MiB",
            "Pit",
            id="large PROTOs of the library",
        ),
        pytest.param(
            f"Solid {{ {' '.join(f'field{i} 1' for i in range(200))} }} Robt {{ }}",
            "PROTO Robt is not available",
            "Robt",
            id="an error after a hundred warnings",
        ),
    ],
)  # fmt: skip
@pytest.mark.timeout(ENDS_S)
def test_a_small_text_that_stands_for_much_is_a_finding_at_its_place(text: str, headline: str, place: str):
    assert errors(text) == [(headline, place)]


NUMBERS = "1 1 1 " * (MAX_NUMBERS // 3)


@pytest.mark.parametrize(
    "text",
    [
        pytest.param('WorldInfo { title "' + r"\a" * 4_000_000 + '" }', id="escapes"),
        pytest.param("#\n" * 4_000_000, id="comments"),
        pytest.param("Group { " + " ".join(f"childrem{i} 1" for i in range(MAX_TOKENS // 2 - 9)) + "}", id="unknown fields"),
        pytest.param(" ".join(f"Groupp{i} {{ }}" for i in range(MAX_NODES)), id="unknown nodes", marks=pytest.mark.slow),
        pytest.param("Groupp { } " * MAX_NODES, id="one unknown node"),
        pytest.param("".join(f"PROTO A{i} [ ] {{ Group {{ }} }} " for i in range(MAX_NODES)), id="PROTOs"),
        pytest.param(
            "PROTO A [ field MFFloat x [ ] ] { Group { } } PROTO B [ ] { A { x [ " + NUMBERS + "] } }"
            + "B { }" * (MAX_NODES // 6),
            id="numbers in a field of a PROTO",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "PROTO A [ ] { Shape { geometry PointSet { coord Coordinate { point [ " + NUMBERS + "] } } } }"
            + "A { }" * (MAX_NODES // 5),
            id="numbers in the body of a PROTO",
        ),
        pytest.param("Solid { boundingObject Sphere { } physics Physics { } }" * 1990, id="bodies"),
        pytest.param("E-puck { }" * 280, id="robots of the library", marks=pytest.mark.slow),
    ],
)  # fmt: skip
@pytest.mark.timeout(ENDS_S)
def test_a_world_at_the_limits_of_size_is_read(text: str):
    errors(text)


def test_use_names_the_nearest_def_before_it_also_if_that_was_inside_of_another_of_its_name():
    text = "DEF A Group { children [ DEF A Solid { } ] } Group { children [ USE A ] }"
    outer, other = read(HEADER + text).nodes
    assert children(other) == children(outer)


def test_use_inside_of_a_def_names_an_earlier_one_of_the_same_name_as_in_webots():
    first, second = read(HEADER + "DEF A Solid { } DEF A Group { children [ USE A ] }").nodes
    assert children(second) == [first]


def test_a_template_of_a_proto_is_a_finding_that_says_what_to_do(tmp_path: Path):
    proto = "PROTO Thing [ ] { %< let x = 1; >% Solid { translation %<= x >% 0 0 } }"
    (finding,) = read_world(using(tmp_path, "../protos/Thing.proto", proto, "Thing { }")).findings.errors
    assert finding.headline == "PROTO Thing is a template with code, which deepbots does not run"
    assert "Convert to Base Node(s)" in finding.help


@pytest.mark.parametrize(
    ("text", "boxes"),
    [
        ("Wall { size 0.1 2 0.5 }", [((0, 0, 0.25), (0.1, 2, 0.5))]),
        (
            "Table { size 1 2 0.8 feetPadding 0.1 }",
            [
                ((0, 0, 0.775), (1, 2, 0.05)),
                *(
                    ((x, y, 0.375), (0.1, 0.1, 0.75))
                    for x, y in ((0.35, 0.85), (-0.35, 0.85), (-0.35, -0.85), (0.35, -0.85))
                ),
            ],
        ),
    ],
)
def test_furniture_of_boxes_stands_on_the_ground(text: str, boxes: list):
    (body,) = build_scene(read(HEADER + text)).bodies
    assert [(geometry.frame[0], geometry.shape.size) for geometry in body.geometries] == [
        (pytest.approx(place), pytest.approx(size)) for place, size in boxes
    ]


PAGE = (Path(__file__).parents[2] / "docs" / "webots.md").read_text(encoding="utf-8")
WORDS = set(re.findall(r"[\w-]+", PAGE))
EQUIVALENTS = sorted(path.stem for path in LIBRARY.glob("*.proto"))
APPEARANCES = {"Parquetry", "ChequeredParquetry", "SandyGround", "BrushedAluminium", "Grass", "Asphalt"}


def test_each_node_and_each_equivalent_of_a_proto_is_in_a_table():
    assert {*node_types(), *EQUIVALENTS} - APPEARANCES - WORDS == set()


@pytest.mark.parametrize("name", EQUIVALENTS)
def test_each_field_of_an_equivalent_has_an_effect_or_is_named_as_missing(name: str):
    proto = equivalent(name)
    body = (LIBRARY / f"{name}.proto").read_text("utf-8").split("] {\n")[1]
    rendered = proto.text(Node(name, proto.span, interface=proto.interface))
    used = {*re.findall(r"\bIS (\w+)", body + rendered), *re.findall(r'"(\w+)"', body)}
    assert set(proto.interface) - used <= {
        *proto.missing,
        *(
            "texture",
            "luminosity",
            "castShadows",
            "skyColor",
            "colorOverride",
            "textureTransform",
            "IBLStrength",
        ),
        *("type", "tileSize", "floorTileSize", "wallTileSize", "wallAppearance", "wallColor"),
        *(
            "subdivision",
            "curvatureFactor",
            "edgeSubdivision",
            "tireAppearance",
            "rimAppearance",
            "rimRadius",
        ),
        *("rimBeamNumber", "rimBeamWidth", "rimBeamThickness", "rimBeamOffset", "wheelSide", "engineSound"),
        *("centralInnerRadius", "centralOuterRadius"),
    }


def test_a_function_that_is_missing_is_not_there():
    from deepbots_webots import devices, imaging, sensors, supervisor, tree

    modules = (devices, imaging, sensors, supervisor, tree)
    classes = {name: value for module in modules for name, value in vars(module).items()}
    for owner, names in MISSING.items():
        for name in names.split():
            assert name not in vars(classes[owner]), f"{owner}.{name}"
