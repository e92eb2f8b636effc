"""`deepbots new NAME --webots WORLD.wbt`: a project of Webots as a scenario."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.cli.starters.webots import Starter, from_webots
from deepbots_cli.diagnostics.findings import FILL_IN
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.geometry import ground_height
from deepbots_cli.robots.model import Box, Sphere
from deepbots_cli.scenario.fields.names import Name
from deepbots_cli.webots.imports import hints
from deepbots_cli.webots.imports.world import scenario_name
from tests.webots.worlds_of_webots import HEADER

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
    for name, text in (("cart", cart), ("judge", judge)):
        path = folder / "controllers" / name / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", errors="surrogateescape")
    path = folder / "worlds" / "world.wbt"
    path.parent.mkdir(exist_ok=True)
    path.write_text(HEADER + world if not world.startswith("#") else world, encoding="utf-8")
    return path


def imported(folder: Path, **parts: str) -> tuple[Starter, str]:
    """Return what `deepbots new` writes for a project, and the text of its scenario."""
    starter = from_webots(project(folder / "project", **parts), (), "cart", "Cart")
    (folder / "out").mkdir(exist_ok=True)
    for path, content in starter.files.items():
        (folder / "out" / path).write_bytes(content)
    return starter, (folder / "out" / "cart.yaml").read_text(encoding="utf-8")


def lines_of(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines()]


# Worlds


def test_a_project_with_plain_forms_only_leaves_no_place_and_runs(tmp_path: Path) -> None:
    starter, text = imported(tmp_path, solved="return np.mean(self.scores[-50:]) > 90")
    assert starter.todos == 0
    assert FILL_IN not in text
    assert [
        finding for finding in api.lint(tmp_path / "out" / "cart.yaml") if finding.severity == "error"
    ] == []
    env = api.make(tmp_path / "out" / "cart.yaml")
    observation, _ = env.reset(seed=0)
    assert observation.shape == (2,)
    assert observation[0] == pytest.approx(
        0.1 / 0.9, abs=0.02
    )  # the joint starts at its position in the world
    _, reward, *_ = env.step(0)
    assert reward == 1.0
    env.close()


def test_a_grid_of_heights_is_the_terrain(tmp_path: Path) -> None:
    """Rows are along x; the terrain of the scenario has the heights of the world at its corners."""
    grid = """Solid { translation -2 -1 0 boundingObject ElevationGrid { xDimension 3 yDimension 2
      xSpacing 2 ySpacing 2 height [ 0 0.1 0.2, 0.3 0.4 0.6 ] } }"""
    world = project(tmp_path, WORLD.replace("RectangleArena { floorSize 3 2 }", grid))
    starter = from_webots(world, [], "hills", "Hills")
    assert (
        "terrain: {type: heightfield, file: world_terrain.png, size: 4 2 m, height: 0.6 m}"
        in scenario_text(starter)
    )
    for path, content in starter.files.items():
        (tmp_path / path).write_bytes(content)
    terrain = api.compile(tmp_path / "hills.yaml").program.world.terrain
    height = ground_height(terrain)
    corners = [(-2, -1), (0, -1), (1.999, -1), (-2, 0.999), (0, 0.999), (1.999, 0.999)]
    assert [height(*corner) for corner in corners] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.6], abs=1e-3)


def two_robots(folder: Path, second: str) -> Starter:
    """Return the scenario of a project whose second cart has the controller `second`."""
    cart = WORLD[WORLD.index("DEF CART") :]
    twin = cart.replace("DEF CART", "DEF TWIN").replace('name "cart"', 'name "twin"')
    twin = twin.replace('controller "cart"', 'controller "twin"').replace("0 0 0.05", "0.5 0.5 0.05")
    world = project(folder, WORLD + twin)
    path = folder / "controllers" / "twin" / "twin.py"
    path.parent.mkdir(parents=True)
    path.write_text(second, encoding="utf-8")
    return from_webots(world, [], "twins", "Twins")


def test_all_robots_with_a_class_of_deepbots_are_read(tmp_path: Path) -> None:
    text = scenario_text(two_robots(tmp_path, CART))
    first, second = text[text.index("  cart:") :].split("  twin:", 1)
    for part in (first, second):
        assert "emit: [arm_angle]" in part
        assert "motors: {type: velocity_motor, joints: [left_motor_joint, right_motor_joint]}" in part
        assert "motors: command * 1 rad/s" in part


PLAIN_BASE = "from deepbots.robots import CSVRobot\n\nclass Cart(CSVRobot):"


@pytest.mark.parametrize(
    "head",
    [
        "from deepbots.robots import CSVRobot as Robot\n\nclass Cart(Robot):",
        "import deepbots.robots as robots\n\nclass Cart(robots.CSVRobot):",
        "import base\n\nclass Cart(base.Base):",
        "from . import base\n\nclass Cart(base.Base):",
        "from deepbots.robots import CSVRobot\nfrom base import Mixin\n\nclass Cart(CSVRobot, Mixin):",
    ],
)
def test_a_class_has_the_methods_of_all_its_bases(tmp_path: Path, head: str) -> None:
    first, rest = CART.index("    def create_message"), CART.index("    def use_message_data")
    message = CART[first:rest]
    folder = tmp_path / "project" / "controllers" / "cart"
    folder.mkdir(parents=True)
    (folder / "base.py").write_text(
        f"from deepbots.robots import CSVRobot\n\nclass Mixin:\n{message}\nclass Base(CSVRobot):\n{message}"
    )
    assert PLAIN_BASE in CART
    cart = CART if "base" not in head else CART.replace(message, "")
    _, text = imported(tmp_path, cart=cart.replace(PLAIN_BASE, head))
    assert "emit: [arm_angle]" in text
    assert "motors: command * 1 rad/s" in text


def test_a_robot_that_uses_the_action_in_another_way_is_left_to_a_person(tmp_path: Path) -> None:
    starter = two_robots(tmp_path, CART.replace("6.0 if choice == 0 else -6.0", "3.0 if choice else 2.0"))
    text = scenario_text(starter)
    assert "# FILL IN: what twin does with the action, from twin.py:19: def use_message_data" in text
    assert "speed = 3.0 if choice else 2.0" in text
    assert text.count("command * 1 rad/s") == 1


def scenario_text(starter: Starter) -> str:
    return next(content.decode() for path, content in starter.files.items() if path.suffix == ".yaml")


def test_the_world_has_its_timestep_gravity_arena_and_objects(tmp_path: Path) -> None:
    _, text = imported(tmp_path, world=WORLD.replace("gravity 9.81", "gravity 1.6"))
    lines = lines_of(text)
    assert "timestep: 16 ms" in lines
    assert "gravity: 0 0 -1.6 m/s^2" in lines
    assert "arena: {size: 3 2 m}" in lines
    assert "box: {shape: box, size: 0.2 0.2 0.2 m, mass: 0.4 kg, pose: {xyz: 1 0 0.1 m}}" in lines
    assert "goal:" not in text  # nothing reads it


def test_a_radar_is_named_as_a_device_without_a_sensor(tmp_path: Path) -> None:
    world = WORLD.replace("Gyro {", 'Radar { name "eye" } Gyro {')
    _, text = imported(tmp_path, world=world)
    assert "# deepbots has no such sensor: eye (Radar)" in lines_of(text)


def test_the_robot_has_the_masses_joints_and_limits_of_the_world(tmp_path: Path) -> None:
    imported(tmp_path)
    program = api.load(tmp_path / "out" / "cart.yaml").program
    assert program is not None
    model = program.world.robots[0].model
    assert model.mass == pytest.approx(1 + 0.1 + 0.1 + 0.2 + 0.05)
    arm = model.joint("rod_joint")
    assert (arm.limit.lower, arm.limit.upper, arm.damping) == (-1.0, 1.0, 0.01)
    wheel = model.joint("left_motor_joint")
    assert wheel.type == "continuous"
    assert wheel.limit.velocity == 20.0
    assert wheel.limit.effort == 2.0
    assert model.link("rod").inertial.origin.xyz[2] == pytest.approx((0.2 * 0.25 + 0.05 * 0.5) / 0.25)


def test_links_and_objects_look_as_their_shape_nodes(tmp_path: Path) -> None:
    red = "Shape { appearance PBRAppearance { baseColor 1 0 0 } geometry Sphere { radius 0.07 } }"
    world = WORLD.replace("translation 1 0 0.1", f"translation 1 0 0.1 children [ {red} ]")
    world = world.replace("children [ DEF TIP", f"children [ {red} DEF TIP")
    imported(tmp_path, world=world)
    program = api.load(tmp_path / "out" / "cart.yaml").program
    assert program is not None
    rod = program.world.robots[0].model.link("rod")
    assert [(visual.shape, visual.color) for visual in rod.visuals] == [(Sphere(0.07), (1.0, 0.0, 0.0, 1.0))]
    assert isinstance(rod.collisions[0].shape, Box)
    assert program.world.objects[0].color == (1.0, 0.0, 0.0, 1.0)


def test_a_solid_that_the_supervisor_watches_is_a_link(tmp_path: Path) -> None:
    judge = JUDGE.replace('self.getFromDef("CART")', 'self.getFromDef("TIP")')
    _, text = imported(tmp_path, judge=judge)
    assert "place: position(cart.tip).x" in lines_of(text)
    env = api.make(tmp_path / "out" / "cart.yaml")
    observation, _ = env.reset(seed=0)
    # The rod leans by 0.1 rad about an anchor 0.5 m below the tip in the world, which shows it upright.
    assert observation[1] == pytest.approx(0.0, abs=0.02)
    env.close()


# One form each


@pytest.mark.parametrize(
    ("call", "entry"),
    [
        ("normalize_to_range(v, -1.5, 1.5, -1.0, 1.0, clip=True)", "place: -1.5 .. 1.5 m"),
        ("normalize_to_range(v, -1.5, 1.5, -1.0, 1.0)", "place: {range: -1.5 .. 1.5 m, clip: false}"),
        (
            "normalize_to_range(value=v, min_val=0, max_val=2, new_min=0, new_max=1, clip=True)",
            "place: 0 .. 2 m",
        ),
    ],
)
def test_a_range(tmp_path: Path, call: str, entry: str) -> None:
    old = "normalize_to_range(self.cart.getPosition()[0], -1.5, 1.5, -1.0, 1.0)"
    judge = JUDGE.replace(old, call.replace("v,", "self.cart.getPosition()[0],"))
    _, text = imported(tmp_path, judge=judge)
    assert any(line.split("  #")[0].strip() == entry for line in lines_of(text))


@pytest.mark.parametrize(
    ("body", "entry"),
    [
        ("return 1", "alive: 1"),
        ("return -0.5", "each_step: -0.5"),
        ("return -abs(self.cart.getPosition()[0])", "task: (-abs(position(cart).x)) / m"),
        (
            "if self.cart.getPosition()[0] > 1.0:\n    return -10\nreturn 1",
            "task: -10 if position(cart).x > 1 m else 1",
        ),
        ("r = 1\nif self.getTime() > 3:\n    r += 2\nreturn r", "task: 3 if time > 3 s else 1"),
    ],
)
def test_a_reward(tmp_path: Path, body: str, entry: str) -> None:
    _, text = imported(tmp_path, reward=body)
    assert entry in lines_of(text)


@pytest.mark.parametrize(
    "value",
    [
        "-{x}",
        "{x} + 1",
        "2 * {x}",
        "{x} / 2",
        "{x} ** 2",
        "{x} / {x}",
        "abs({x})",
        "max({x}, 0.5)",
        "({x} if {x} > 0 else 0)",
    ],
)
def test_the_remark_about_rounding_stays_with_what_is_computed_from_it(tmp_path: Path, value: str) -> None:
    text = value.format(x="round(self.cart.getPosition()[0], 2)")
    _, scenario = imported(tmp_path, reward=f"return {text}")
    (line,) = (line for line in scenario.splitlines() if line.strip().startswith("task:"))
    assert "the project rounds to 2 digits" in line


@pytest.mark.parametrize(
    ("body", "entries"),
    [
        (
            "if abs(self.cart.getPosition()[0]) > 1.2:\n    return True\nreturn self.getTime() > 20",
            ["cart_limit: abs(position(cart).x) > 1.2 m", "max_time: 20 s"],
        ),
        ("self.steps += 1\nreturn self.steps > 300", ["max_steps: 301"]),
        (
            "done = False\nif self.cart.getPosition()[0] > 1:\n    done = True\nif done:\n    return True\nreturn False",
            ["cart_limit: position(cart).x > 1 m"],
        ),
        (
            "if self.cart.getPosition()[0] > 1:\n    print('goal reached')\n    return True\nreturn False",
            ["success:", "cart_limit: position(cart).x > 1 m"],
        ),
        (
            "if self.cart.getPosition()[0] > 1:\n    self.goal_missed = True\n    return True\nreturn False",
            ["failure:", "cart_limit: position(cart).x > 1 m"],
        ),
        # What keeps an episode alive stays a condition of the endings after it.
        (
            "if self.getTime() < 1:\n    return False\nreturn self.cart.getPosition()[0] > 1",
            ["cart_limit: (not (time < 1 s)) and (position(cart).x > 1 m)"],
        ),
        (
            "if not (abs(self.cart.getPosition()[0]) < 1):\n    return True\nreturn False",
            ["cart_limit: not (abs(position(cart).x) < 1 m)"],
        ),
    ],
)
def test_an_ending(tmp_path: Path, body: str, entries: list[str]) -> None:
    _, text = imported(tmp_path, done=body)
    for entry in entries:
        assert entry in lines_of(text)


@pytest.mark.parametrize(
    ("loop", "entry"),
    [
        ("for step in range(1, 201):\n    env.step([0])", "max_steps: 200"),
        ("for step in range(0, 1000, 4):\n    env.step([0])", "max_steps: 250"),
        ("for epoch in range(80):\n    optimizer.step()", "max_steps: 1000    # a placeholder"),
    ],
)
def test_the_loop_that_steps_the_environment_limits_an_episode(tmp_path: Path, loop: str, entry: str) -> None:
    _, text = imported(tmp_path, judge=JUDGE.replace("raise SystemExit", f"{loop}\nraise SystemExit"))
    assert [line for line in lines_of(text) if "max_steps" in line] == [entry]


def test_names_of_the_last_return_name_the_observation(tmp_path: Path) -> None:
    early = "        if self.message is None:\n            return [wrong, other]\n        place ="
    _, text = imported(
        tmp_path, judge=JUDGE.replace("        place =", early).replace("angle, place]", "angle, 2 * place]")
    )
    assert "wrong" not in text.partition("observation:")[2]


def test_solved(tmp_path: Path) -> None:
    body = "if len(self.scores) > 50:\n    if np.mean(self.scores[-50:]) > 90.0:\n        return True\nreturn False"
    _, text = imported(tmp_path, solved=body)
    assert "solved: mean_return >= 90 over 50 episodes" in lines_of(text)


def test_choices_set_motors_with_equal_commands_together(tmp_path: Path) -> None:
    _, text = imported(tmp_path)
    lines = lines_of(text)
    assert "motors: {type: velocity_motor, joints: [left_motor_joint, right_motor_joint]}" in lines
    assert "command: {choices: {action_0: 6, action_1: -6}}" in lines
    assert "messages: {format: csv, timing: delayed}" in lines
    assert "emit: [arm_angle]" in lines


def test_numbers_as_actions(tmp_path: Path) -> None:
    body = "speed = int(message[0])".replace("int", "float")
    cart = CART.replace("choice = int(message[0])", body)
    cart = cart.replace("speed = 6.0 if choice == 0 else -6.0", "speed = 4 * speed")
    judge = JUDGE.replace("self.action_space = 2", "self.action_space = Box(low=-2, high=2, shape=(1,))")
    _, text = imported(tmp_path, cart=cart, judge=judge)
    assert "action: -2 .. 2" in lines_of(text)
    assert "motors: (4 * action) * 1 rad/s" in lines_of(text)


def test_a_robot_supervisor_has_no_messages(tmp_path: Path) -> None:
    world = WORLD.replace('controller "judge" supervisor TRUE', 'controller "<none>"')
    world = world.replace('controller "cart"', 'controller "cart" supervisor TRUE')
    cart = """
from deepbots.supervisor import RobotSupervisorEnv
from gym.spaces import Discrete

class Both(RobotSupervisorEnv):
    def __init__(self):
        super().__init__()
        self.action_space = Discrete(2)
        self.arm = self.getDevice("armAngle")
        self.motor = self.getDevice("left motor")
        self.me = self.getSelf()

    def get_observations(self):
        return [normalize_to_range(self.arm.getValue(), -1, 1, -1, 1, True)]

    def get_reward(self, action):
        return 1

    def is_done(self):
        return abs(self.me.getVelocity()[5]) > 3

    def apply_action(self, action):
        self.motor.setTorque([0.5, -0.5][int(action[0])])
"""
    _, text = imported(tmp_path, world=world, cart=cart)
    lines = lines_of(text)
    assert "messages: {format: none}" in lines
    assert "cart.arm_angle: -1 .. 1 rad" in lines
    assert "left_motor: {type: torque_motor, joint: left_motor_joint}" in lines
    assert "me_limit: abs(angular_velocity(cart).z) > 3 rad/s" in lines


# Places that are left


@pytest.mark.parametrize(
    ("methods", "place"),
    [
        ({"reward": "return self.unheard_of(3)"}, "the reward, from judge.py:"),
        ({"done": "return clever(self.cart)"}, "an ending, from judge.py:"),
        ({"done": "while True:\n    if clever():\n        return True"}, "an ending, from judge.py:"),
        (
            {"done": "for i in range(3):\n    if self.getTime() > i:\n        break\nreturn False"},
            "an ending, from",
        ),
        ({"solved": "return self.judge_all()"}, "when the task is solved, from judge.py:"),
    ],
)
def test_what_has_no_plain_form_is_a_comment_with_its_python(
    tmp_path: Path, methods: dict[str, str], place: str
) -> None:
    starter, text = imported(tmp_path, **methods)
    todos = [line for line in lines_of(text) if line.startswith(FILL_IN)]
    assert starter.todos == len(todos) > 0
    assert any(place in line for line in todos)
    assert [
        finding for finding in api.lint(tmp_path / "out" / "cart.yaml") if finding.severity == "error"
    ] == []


def test_an_own_step_keeps_its_lines(tmp_path: Path) -> None:
    judge = JUDGE.replace("raise SystemExit", "\nraise SystemExit").replace(
        "    def solved",
        "    def step(self, action, repeat=4):\n        return self.repeat_it(action, repeat)\n\n    def solved",
    )
    _, text = imported(tmp_path, judge=judge)
    assert "#     return self.repeat_it(action, repeat)" in lines_of(text)


HELPERS = """
def unevenness(node):
    return node.getOrientation()[0] + node.getField("rotation").getSFRotation()[3]

class Judge("""


def hints_of(text: str) -> list[str]:
    return [line.strip("# ") for line in text.splitlines() if line.lstrip().startswith("#   Write ")]


def test_a_place_that_is_left_names_the_words_for_its_python(tmp_path: Path) -> None:
    _, text = imported(
        tmp_path,
        judge=JUDGE.replace("\nclass Judge(", HELPERS),
        init="self.tip, self.far, self.best = self.getFromDef('TIP'), 0.7, 0.0",
        reward="""before = self.best
self.best = max(self.best, unevenness(self.tip))
goal = self.getFromDef("GOAL")
touches = len(goal.getContactPoints()) + self.getTime() // self.far
return self.best - before + touches""",
    )
    angles = "roll({0}), pitch({0}), yaw({0}) or tilt({0})".format("cart.tip")
    assert hints_of(text) == [
        f"Write {angles} for node.getOrientation()",
        f"Write {angles} for node.getField('rotation').getSFRotation()",
        "Write contact(goal, OTHER) or collided(goal) for goal.getContactPoints()",
        "Write time for self.getTime()",
        "Write 0.7 for self.far",
        "Write previous(x), delta(x) or running_max(x) for values of earlier steps: self.best",
    ]
    assert "goal:" in text
    assert 'name="tip"' in (tmp_path / "out" / "cart_cart.urdf").read_text()


def test_hints_name_functions_of_the_language() -> None:
    sentences = [*hints._OF_NODES.values(), *hints._OF_FIELDS.values(), *hints._WORDS.values()]
    words = {word for sentence in sentences for word in re.findall(r"([a-z_0-9]+)\(", sentence)}
    assert len(words) > 10
    assert words <= {*FUNCTIONS}


REPEATED = """    def step(self, action, repeat=1):
        \"\"\"Do the same several times.\"\"\"
        if repeat < 1:
            raise ValueError("repeat must be positive")
        for _ in range(repeat):
            if super(CSVSupervisorEnv, self).step(self.timestep) == -1:
                exit()
            self.handle_emitter(action)
        return self.get_observations(), self.get_reward(action), self.is_done(), self.get_info()

    def solved"""


@pytest.mark.parametrize(
    ("changed", "calls", "is_left"),
    [
        (("", ""), "judge.step([1])", False),
        (("", ""), "again = 1\njudge.step([1], again)", False),
        (("", ""), "judge.step([1], repeat=4)", True),
        (("", ""), "again = 1\nagain += 1\njudge.step([1], again)", True),
        (("", ""), "judge.step(*arguments)", True),
        (("repeat=1", "repeat=4"), "", True),
        (("self.handle_emitter(action)", "self.handle_emitter([0])"), "", True),
        (("exit()", "self.stop()"), "", True),
        (("self.get_reward(action)", "0.5 * self.get_reward(action)"), "", True),
    ],
)
def test_a_step_that_does_what_that_of_deepbots_does_leaves_nothing_to_fill_in(
    tmp_path: Path, changed: tuple[str, str], calls: str, is_left: bool
) -> None:
    judge = JUDGE.replace("    def solved", REPEATED.replace(*changed)) + calls
    _, text = imported(tmp_path, judge=judge)
    assert ("an own step" in text) is is_left


@pytest.mark.parametrize(
    "cart",
    [
        "",
        "def (",
        "class Cart(CSVRobot):\n    pass",
        "\0",
        "x = " + "(" * 5000,
        "x = " + "-" * 5000 + "1",
        "x=" + "1+" * 9000 + "1",
    ],
)
def test_a_controller_that_cannot_be_read_leaves_the_actions_to_a_person(tmp_path: Path, cart: str) -> None:
    _, text = imported(tmp_path, cart=cart)
    assert "a placeholder for all motors" in text
    assert [
        finding for finding in api.lint(tmp_path / "out" / "cart.yaml") if finding.severity == "error"
    ] == []


@pytest.mark.parametrize(
    "body",
    [
        "return [0] * 10**9",
        "return 10**10**10",
        "return sum(range(10**12))",
        "return self.get_reward()",
        "x = 1\nfor i in range(1000):\n    for j in range(1000):\n        x = x * 3\nreturn x",
        "x = self.getTime()\nfor i in range(900):\n    x = x + x\nreturn x",
        "x = [self]\nx.append(x)\nreturn x",
        "return 1 if 'a' < 3 else 2",
        "return 1 / 0",
    ],
)
def test_code_without_end_is_left_to_a_person(tmp_path: Path, body: str) -> None:
    starter, _ = imported(tmp_path, reward=body)
    assert starter.todos >= 1


def test_a_world_without_motors_is_one_sentence(tmp_path: Path) -> None:
    world = project(tmp_path, world='WorldInfo { } DEF JUDGE Robot { supervisor TRUE controller "judge" }')
    with pytest.raises(DeepbotsError, match=r"no robot of .* has a motor"):
        from_webots(world, (), "cart", "Cart")


def test_nothing_outside_the_project_is_read(tmp_path: Path) -> None:
    world = project(tmp_path / "project")
    secret = tmp_path / "secret.py"
    secret.write_text("LIMIT = 123456\n")
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
    text = texts[which]
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text) - 1))
        size = data.draw(st.integers(0, 30))
        piece = data.draw(
            st.sampled_from(["", "(", "'", "1e999", "\n", "self", " if x else ", "[0]", "#", "\0", "é: {"])
        )
        text = text[:at] + piece + text[at + size :]
    try:
        starter, _ = imported(tmp_path, **{which: text})
    except DeepbotsError:
        return  # with a sentence; anything else fails this test
    assert starter.todos >= 0
    assert [
        finding for finding in api.lint(tmp_path / "out" / "cart.yaml") if finding.severity == "error"
    ] == []


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
