"""Laws of parameters and devices: a drawn value is the written one, an override is an edited robot file, and
a device does what the text of the scenario says, by a second implementation that begins with the text."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from deepbots_cli.api import Compiled
from deepbots_cli.document import shipped
from deepbots_cli.errors import ScenarioError
from deepbots_cli.program import Program
from deepbots_cli.robots.model import RobotModel
from deepbots_cli.runtime import Supervisor
from deepbots_cli.scenario.actuators import ACTUATORS
from tests.laws.episodes import actions, played
from tests.laws.expressions import chance, pick
from tests.laws.frames import SMALL_LEVER
from tests.laws.law import Case, law, reference, same
from tests.laws.readings import (
    Array,
    Call,
    Reader,
    Readings,
    Source,
    Start,
    beginning,
    contact_reader,
    lively,
    opened,
    readings,
    shown_world,
    start_of,
    watched,
)
from tests.laws.scenarios import BODIES, PLAIN, model_of
from tests.laws.sensors import COMPUTED, Truth, of_pose
from tests.laws.writing import canonical, require_equal

STEPS = 5

Parameter = tuple[str, str, str | float]
DRAWN_PARAMETERS: Mapping[str, tuple[Parameter, ...]] = {
    "world": (("gravity", "0 0 -10 .. 0 0 -9 m/s^2", "0 0 -9.25 m/s^2"),),
    "world.ground": (("friction", "0.2 .. 1", 0.4), ("restitution", "0 .. 0.8", 0.3)),
    "world.arena": (("friction", "0.2 .. 1", 0.4),),
    "objects.*": (
        ("mass", "0.5 .. 3.5 kg", "1 kg"),
        ("friction", "0.2 .. 1", 0.4),
        ("restitution", "0 .. 0.8", 0.3),
        ("spinning_friction", "0 .. 0.01", 0.002),
        ("rolling_friction", "0 .. 0.01", 0.002),
    ),
    "objects.*.pose": (
        ("x", "-1 .. 3 m", "2.5 m"),
        ("y", "3 .. 5 m", "4.5 m"),
        ("yaw", "-1 .. 1 rad", "0.5 rad"),
    ),
    "robots.*.pose": (("y", "-0.2 .. 0.2 m", "0.1 m"), ("yaw", "-1 .. 1 rad", "0.5 rad")),
    "robots.*.links.*": (
        ("mass", "0.125 .. 0.875 kg", "0.25 kg"),
        ("inertia", "0.5 .. 3", 2.0),
        ("com", "-0.01 -0.01 -0.01 .. 0.01 0.01 0.01 m", "0.005 -0.005 0.005 m"),
        ("friction", "0.2 .. 1", 0.4),
        ("restitution", "0 .. 0.8", 0.3),
        ("spinning_friction", "0 .. 0.01", 0.002),
        ("rolling_friction", "0 .. 0.01", 0.002),
    ),
    "robots.*.joints.*": (
        ("damping", "0 .. 0.2 {damping}", "0.05 {damping}"),
        ("friction", "0 .. 0.1 {effort}", "0.02 {effort}"),
        ("armature", "0.001 .. 0.01 {armature}", "0.004 {armature}"),
    ),
    "robots.*.actuators.*": (
        ("strength", "0.3 .. 0.9", 0.5),
        ("delay", "0 .. 0.04 s", "0.03 s"),
        ("time_constant", "0 .. 0.04 s", "0.01 s"),
    ),
    "robots.*.sensors.*": (
        ("latency", "0 .. 0.04 s", "0.03 s"),
        ("bias", "0 .. 10 %", "2 %"),
        ("noise", "0 .. 10 %", "2 %"),
    ),
}
"""What an episode may draw, by its section: the key, a range, and a value within it, in SI units. The value is not
in the middle of the range, which a world is built with."""
OF_MUJOCO = ("com", "armature")
"""Keys that PyBullet cannot change from episode to episode."""
WEIGHTS = ("mass", "inertia", "com", "armature")
"""Keys of links and joints from which engines compute gains of servos, and PyBullet the damping of joints, when
a robot is loaded. Without both, a value of an episode has the effect of a written one."""
UNITS = (
    {"effort": "N*m", "damping": "N*m*s/rad", "armature": "kg*m^2"},
    {"effort": "N", "damping": "N*s/m", "armature": "kg"},
)
"""Units of a turning, and of a sliding joint."""


MADE = ("ground", "pose", "links", "joints")
"""Sections that a scenario has without writing them."""


def sections_of(case: Case, data: dict[str, Any], pattern: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the sections that a pattern means, with their paths: of the links or joints of a robot, one."""
    sections: list[tuple[str, Any]] = [("", data)]
    for key in pattern.split("."):
        sections = [
            (f"{path}.{name}".lstrip("."), section.setdefault(name, {}))
            for path, section in sections
            for name in _names(case, data, path, section, key)
        ]
    return sections


def _names(case: Case, data: dict[str, Any], path: str, section: Any, key: str) -> list[str]:
    *above, kind = path.split(".")
    if key == "*" and kind in ("links", "joints"):
        model = model_of(data["robots"][above[1]]["urdf"])
        parts = model.moving_joints if kind == "joints" else [link for link in model.links if link.mass]
        return [pick(case.draw, [part.name for part in parts])] if parts else []
    if key == "*":
        return list(section)
    return [key] if key in section or key in MADE else []


def drawn_parameters(case: Case, data: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any], Parameter]]:
    """Draw parameters of the scenario: the path and the section of each, its key, a range, and a value."""
    is_weighed = chance(case.draw, 50)
    for robot in data["robots"].values() if is_weighed else ():
        for name, actuator in [*robot.get("actuators", {}).items()]:
            if actuator["type"] not in ("torque_motor", "thrust"):
                del robot["actuators"][name], robot["apply"][name]
    for pattern, parameters in DRAWN_PARAMETERS.items():
        if pattern == "world.ground" and "terrain" in data["world"]:
            continue
        for path, section in sections_of(case, data, pattern):
            kind, name, part, member = (path.split(".") + [""] * 3)[:4]
            model = model_of(data["robots"][name]["urdf"]) if kind == "robots" else None
            left_out = without_effect(data, path, section, is_weighed=is_weighed)
            if part == "pose":
                section.pop("xyz", None), section.pop("rpy", None)
            units = UNITS[part == "joints" and model is not None and model.joint(member).type == "prismatic"]
            for key, interval, value in parameters:
                if key not in left_out and chance(case.draw, 50):
                    written = value.format(**units) if isinstance(value, str) else value
                    yield path, section, (key, interval.format(**units), written)


def without_effect(data: dict[str, Any], path: str, section: Any, *, is_weighed: bool) -> set[str]:
    """Return the keys that a section cannot have, or whose value of an episode has another effect."""
    kind, name, part, member = (path.split(".") + [""] * 3)[:4]
    is_mujoco = data["world"].get("engine") == "mujoco"
    left_out = set() if is_mujoco else {*OF_MUJOCO}
    if section.get("fixed") or not section.get("solid", True):
        left_out.add("mass")
    if section.get("type") == "touch":
        left_out |= {"bias", "noise"}
    if kind == "robots" and part in ("links", "joints"):
        model = model_of(data["robots"][name]["urdf"])
        # What damps joints in PyBullet has the inertia with which a world was loaded: with twice the inertia
        # of a pole, its cart was 0.1 % faster after 5 steps.
        changes = data["robots"][name].get("joints", {}).values()
        is_damped = any("damping" in change for change in changes) or any(one.damping for one in model.joints)
        is_damped &= not is_mujoco
        # A base that stands still keeps its mass.
        is_still = member == model.root and data["robots"][name].get("base") == "fixed"
        left_out |= {*WEIGHTS} if is_damped or is_still or not is_weighed else set()
        left_out |= set() if is_mujoco or not is_weighed else {"damping"}
    return left_out


def si_value(value: str | float, component: str) -> float:
    """Return the number of a text in SI units, or that of a component."""
    if not isinstance(value, str):
        return value
    *numbers, unit = value.split()
    index = "xyz".index(component[-1]) if len(numbers) > 1 else 0
    return float(numbers[index]) / (100.0 if unit == "%" else 1.0)


@law(cost=550, profile=PLAIN)
def a_drawn_parameter_is_that_parameter(case: Case) -> None:
    """Where a reset sets what an episode draws, the episode is that of a scenario with these values written
    out, also after episodes with other values, and where another parameter computes the value."""
    data, sources = shown_world(case)
    if data["world"].get("terrain", {}).get("type") != "mesh":
        data["world"]["engine"] = pick(case.draw, ("mujoco", "pybullet"))
    for name, robot in data["robots"].items():
        felt = {"type": "accelerometer", "link": model_of(robot["urdf"]).root}
        robot["sensors"] = robot.get("sensors", {}) | {"felt": felt}
        robot["emit"] = list(robot["sensors"])
        data["signals"][f"felt_of_{name}"] = f"{name}.felt"
        sources[f"felt_of_{name}"] = Reader(name, "felt", "accelerometer")
    drawn = list(drawn_parameters(case, data))
    weights = {key for _, _, (key, *_) in drawn} & {*WEIGHTS}
    for _, section, (key, _, value) in drawn:
        section[key] = value
    fixed = compiled(case, data, "fixed.yaml")
    values = {}
    for number, (path, section, (key, interval, value)) in enumerate(drawn):
        owner = path.removesuffix(".pose")
        place = f"reset.place.{owner.partition('.')[2]}.{key}" if path.endswith(".pose") else f"{path}.{key}"
        section[key] = f"uniform({interval})"
        if "%" not in str(value) and chance(case.draw, 40):
            place = f"drawn{number}"
            data.setdefault("parameters", {})[place] = section[key]
            section[key] = f"its{number}"
            data["parameters"][section[key]] = f"{place} * 1"
        values[place] = value
    random = compiled(case, data, "random.yaml")
    programs = [watched(one.program, sources) for one in (fixed, random)]
    if weights:
        programs = in_flight(case, programs)
    with opened(programs[0]) as world, reference():
        episodes = [shown_episode(world, sources, seed) for seed in (3, 4)]
        others = world.reset(seed=3)[1]["drawn"]
    with opened(programs[1]) as world, reference():
        _, info = world.reset(seed=5)
        options = {}
        for name in info["drawn"].keys() - others.keys():
            place = max((place for place in values if f"{name}.".startswith(f"{place}.")), key=len)
            options[name] = si_value(values[place], name)
        shown_episode(world, sources, 5)
        for seed, expected in zip((3, 4), episodes, strict=True):
            require_alike(shown_episode(world, sources, seed, options), expected, is_exact=not weights)


def in_flight(case: Case, programs: Sequence[Program]) -> list[Program]:
    """Return the programs with one start, in which bodies fly: a solver of contacts ends at a tolerance that
    depends on the masses with which a world was loaded, and contacts enlarge such a difference."""
    with opened(programs[0]) as world, reference():
        world.reset(seed=3)
        start = lively(case, programs[0], start_of(world), percent=100)
    flying = [beginning(program, start) for program in programs]
    with opened(flying[0]) as world, reference():
        touches = contact_reader(world)
        world.reset(seed=3)
        for _, action in zip(range(STEPS), actions(world, 3), strict=False):
            world.step(action)
            if touches():
                reject()
    return flying


def compiled(case: Case, data: dict[str, Any], name: str) -> Compiled:
    """Compile a scenario that a law made of the drawn one, which may lack what its changes need."""
    try:
        return case.compile(case.write(data, name))
    except ScenarioError:
        reject()


Episode = tuple[list[Readings], Start]
"""The readings of each step, and the state at the end."""


def shown_episode(
    world: Supervisor, sources: Mapping[str, Source], seed: int, options: Any = None
) -> Episode:
    """Return the readings of an episode with random actions, and the state at its end."""
    world.reset(seed=seed, options=options)
    shown = [readings(world, sources)]
    for _, action in zip(range(STEPS), actions(world, seed), strict=False):
        world.step(action)
        shown.append(readings(world, sources))
    return shown, start_of(world)


NEGLIGIBLE = 1e-100
"""PyBullet reports 1e-200 N for a motor without force, or 0."""
ROUNDED = {"rtol": 1e-4, "atol": 1e-4}
"""The tolerance of a state after masses were drawn: a solver of the limits and the friction of joints ends at
one that depends on the masses with which a world was loaded."""


def require_alike(actual: Episode, expected: Episode, *, is_exact: bool) -> None:
    """Require two episodes to be equal: to the bit, or in the state after them."""
    if not is_exact:
        np.testing.assert_allclose(state_of(actual[1]), state_of(expected[1]), **ROUNDED)
        return
    for step, (one, other) in enumerate(zip(actual[0], expected[0], strict=True)):
        for name, values in other.items():
            np.testing.assert_allclose(one[name], values, 0.0, NEGLIGIBLE, err_msg=f"step {step}, {name}")
    assert actual[1] == expected[1]


def state_of(start: Start) -> Array:
    """Return all numbers of a state."""
    bodies = [np.concatenate([*frame, *motion]) for frame, motion in start.bodies.values()]
    return np.concatenate([*bodies, *map(np.array, start.joints.values())])


# Overrides


def written(element: Element, tag: str, **values: float) -> None:
    """Write attributes of a part of an element of a robot file, which is made where it is absent."""
    part = element.find(tag)
    part = SubElement(element, tag) if part is None else part
    for name, value in values.items():
        part.set(name, repr(value))


def edited_link(case: Case, link: Element) -> dict[str, Any]:
    """Draw overrides of a link, and write their numbers into its element. Factors are powers of 2, with
    which all orders of multiplication have the same result."""
    override: dict[str, Any] = {}
    inertial = link.find("inertial")
    if inertial is not None:
        weight, tensor, origin = (inertial.find(tag) for tag in ("mass", "inertia", "origin"))
        mass, inertia = (pick(case.draw, (1.0, 0.5, 2.0)) for _ in range(2))
        if mass != 1.0:
            override["mass"] = pick(case.draw, (f"urdf * {mass}", f"urdf + urdf * {mass - 1.0}"))
        if inertia != 1.0:
            override["inertia"] = pick(case.draw, (inertia, f"{100 * inertia} %"))
        weight.set("value", repr(float(weight.get("value")) * mass))
        for name, value in tensor.items():
            tensor.set(name, repr(float(value) * mass * inertia))
        if chance(case.draw, 40):
            override["com"] = "0 2 -1 cm"
            at = "0 0 0" if origin is None else origin.get("xyz", "0 0 0")
            x, y, z = map(float, at.split())
            written(inertial, "origin")
            inertial.find("origin").set("xyz", f"{x!r} {y + 0.02!r} {z - 0.01!r}")
    for key, value in (
        ("friction", 0.3),
        ("restitution", 0.4),
        ("spinning_friction", 0.003),
        ("rolling_friction", 0.002),
    ):
        if chance(case.draw, 30):
            override[key] = value
            written(link, "contact")
            written(link.find("contact"), "lateral_friction" if key == "friction" else key, value=value)
    return override


def edited_joint(case: Case, joint: Element) -> dict[str, Any]:
    """Draw overrides of a joint, and write their numbers into its element."""
    sliding = joint.get("type") == "prismatic"
    unit, effort, at = ("m", "N", 0.1) if sliding else ("rad", "N*m", 1.0)
    ways: tuple[tuple[str, str, str, dict[str, float]], ...] = (
        ("damping", f"0.02 {UNITS[sliding]['damping']}", "dynamics", {"damping": 0.02}),
        ("friction", f"0.01 {effort}", "dynamics", {"friction": 0.01}),
        ("max_torque", f"1.5 {effort}", "limit", {"effort": 1.5}),
        ("max_velocity", f"2 {unit}/s", "limit", {"velocity": 2.0}),
        ("range", f"{-at} .. {2 * at} {unit}", "limit", {"lower": -at, "upper": 2 * at}),
    )
    override = {}
    for key, text, tag, values in ways:
        if chance(case.draw, 50) and not (key == "range" and joint.get("type") == "continuous"):
            override[key] = text
            written(joint, tag, **values)
    return override


@law(cost=220, profile=PLAIN)
def an_override_is_an_edited_robot_file(case: Case) -> None:
    """`links` and `joints` of a robot replace numbers of its file, so a scenario with overrides is that with
    a robot file in which the numbers are changed: with all limits and ranges that follow from them."""
    data = copy.deepcopy(case.drawn.data)
    edited = copy.deepcopy(data)
    for name, robot in data["robots"].items():
        tree = ElementTree.parse(shipped.robot_path(robot["urdf"]))
        robot["links"] = {link.get("name"): edited_link(case, link) for link in tree.findall("link")}
        robot["joints"] = {
            joint.get("name"): edited_joint(case, joint)
            for joint in tree.findall("joint")
            if joint.get("type") != "fixed"
        }
        for key in ("links", "joints"):
            edited["robots"][name].pop(key, None)
        edited["robots"][name]["urdf"] = f"{name}.urdf"
        tree.write(case.folder / f"{name}.urdf")
    one, other = compiled(case, data, "overrides.yaml"), compiled(case, edited, "edited.yaml")
    require_equal(canonical(one.program), canonical(other.program))
    with case.environment(one) as environment, reference():
        expected = played(environment, 3), start_of(environment)
    with case.environment(other) as environment:
        same((played(environment, 3), start_of(environment)), expected)


LIMITS = (("max_torque", ("N*m", "N")), ("max_velocity", ("rad/s", "m/s")))
SPRING = ("stiffness", "damping", "stall_torque", "no_load_speed")


@law(cost=90, profile=PLAIN)
def the_tighter_limit_counts(case: Case) -> None:
    """Each joint has the tighter of the limits of robot file and actuator, so an actuator with a limit is one
    without it on joints with the tighter one."""
    data = copy.deepcopy(case.drawn.data)
    for robot in data["robots"].values():
        for section in robot.get("actuators", {}).values():
            for key in SPRING:
                section.pop(key, None)  # a spring has no largest velocity by default
    tight = copy.deepcopy(data)
    key, units = pick(case.draw, LIMITS)
    of_file, own = pick(case.draw, ((1.0, 2.0), (2.0, 1.0)))
    for name, robot in data["robots"].items():
        joints = {joint.name: joint.type == "prismatic" for joint in model_of(robot["urdf"]).moving_joints}
        for each, limit in ((robot, of_file), (tight["robots"][name], min(of_file, own))):
            each["joints"] = {joint: {key: f"{limit} {units[sliding]}"} for joint, sliding in joints.items()}
        for actuator, section in [*robot.get("actuators", {}).items()]:
            parts = section.get("joint") or section.get("joints")
            if not parts or key not in ACTUATORS[section["type"]].model_fields:
                for each in (robot, tight["robots"][name]):
                    del each["actuators"][actuator], each["apply"][actuator]
                continue
            first = parts if isinstance(parts, str) else parts[0]
            sliding = joints[robot.get("groups", {}).get(first, [first])[0]]
            section[key] = f"{own} {units[sliding]}"
            tight["robots"][name]["actuators"][actuator].pop(key, None)
    one, other = compiled(case, data, "own.yaml"), compiled(case, tight, "tight.yaml")
    require_equal(canonical(one.program)["robots"], canonical(other.program)["robots"])


# Time


BLANK = {
    "deepbots": 1,
    "name": "Made",
    "messages": {"format": "none"},
    "action": {"act0": {"range": "-1 .. 1"}},
    "observation": {"previous_action": "auto"},
    "reward": {"none": 0},
    "truncation": {"max_steps": 1000},
}
"""What a scenario needs beside its world, its robots and its signals."""


@contextmanager
def made(
    case: Case, world: dict[str, Any], robot: dict[str, Any], signals: Sequence[str], **sections: Any
) -> Iterator[tuple[Supervisor, Callable[[], list[Array]]]]:
    """Open a world of one robot, with a reader of expressions."""
    names = {f"sig{number}": text for number, text in enumerate(signals)}
    data = BLANK | {"world": world, "robots": {"one": robot}, "signals": names} | sections
    if "sensors" in robot:
        robot["emit"] = list(robot["sensors"])
    sources = {name: Call("", (), text) for name, text in names.items()}
    program = watched(case.compile(case.write(data, "made.yaml")).program, sources)
    with opened(program) as environment:
        environment.reset(seed=0)
        yield environment, lambda: list(readings(environment, sources).values())


def drawn_world(case: Case, **keys: Any) -> dict[str, Any]:
    timestep = case.drawn.data["world"]["timestep"]
    substeps = case.draw(st.integers(1, 6))
    return {"timestep": timestep, "substeps": substeps, "engine": pick(case.draw, ENGINES), **keys}


ENGINES = ("mujoco", "pybullet")


@law(cost=65, profile=PLAIN)
def a_motor_responds_in_the_time_that_is_written(case: Case) -> None:
    """A command acts `delay` after it was sent, in the first substep at or after this time; from there on,
    the followed value approaches it with `time_constant`, in each substep by 1 - exp(-h / time_constant)."""
    world = drawn_world(case)
    period = float(world["timestep"].split()[0]) / 1000.0
    delay, constant = (case.draw(st.integers(0, 50)) / 1000.0 for _ in range(2))
    repeat, strength = case.draw(st.integers(1, 3)), pick(case.draw, (0.5, 1.0))
    motor = {"type": "torque_motor", "joint": "left_wheel", "delay": f"{delay * 1000} ms"}
    motor |= {"time_constant": f"{constant} s", "strength": strength}
    robot = {
        "urdf": "epuck",
        "joints": {"left_wheel": {"max_torque": "1 N*m"}},
        "actuators": {"motor": motor},
        "apply": {"motor": "act0 * 0.001 N*m"},
        "sensors": {"felt": {"type": "joint_torque", "joint": "left_wheel"}},
    }
    substep = period / world["substeps"]
    wait = math.ceil(delay / substep - 1e-9)
    share = 1.0 - math.exp(-substep / constant) if constant else 1.0
    sent: list[float] = []
    followed = 0.0
    with made(case, world, robot, ["one.felt"], agent={"action_repeat": repeat}) as (environment, read):
        for _, action in zip(range(6), actions(environment, 0), strict=False):
            sent += [0.001 * float(action[0])] * repeat * world["substeps"]
            environment.step(action)
            for number in range(len(sent) - repeat * world["substeps"], len(sent)):
                if number >= wait:
                    # A command is sent at the beginning of a timestep.
                    followed += share * (sent[number - wait] - followed)
            np.testing.assert_allclose(read()[0], strength * followed, 1e-6, 1e-12)


@law(cost=70, profile=PLAIN)
def rays_lead_where_the_text_says(case: Case) -> None:
    """The rays of a fan divide its angles evenly, from the first to the last, and have the names r0, r1, ...:
    each reading is the distance of the wall in its direction."""
    count, first, last = (case.draw(st.integers(*ends)) for ends in ((1, 7), (-170, 170), (-170, 170)))
    turned, yaw = (case.draw(st.integers(-180, 180)) for _ in range(2))
    if first == last:
        reject()
    robot = {
        "urdf": "epuck",
        "pose": {"yaw": f"{turned} deg"},
        "sensors": {
            "scan": {
                "type": pick(case.draw, ("lidar", "infrared", "sonar", "laser")),
                "link": "base_link",
                "pose": {"z": "5 cm", "yaw": f"{yaw} deg"},
                "rays": count,
                "angle_range": f"{first} .. {last} deg",
                "range": "0 .. 20 m",
            }
        },
    }
    width, depth = 4.0, 2.5
    world = drawn_world(case, arena={"size": f"{width} {depth} m"})
    with made(case, world, robot, [f"one.scan.r{number}" for number in range(count)]) as (_, read):
        parts = np.arange(count) / (count - 1) if count > 1 else np.array([0.5])
        angles = np.deg2rad(turned + yaw + first + (last - first) * parts)
        with np.errstate(divide="ignore"):
            wanted = np.minimum(width / 2 / abs(np.cos(angles)), depth / 2 / abs(np.sin(angles)))
        np.testing.assert_allclose(np.concatenate(read()), wanted, atol=1e-4)


def names_in(sensor: Mapping[str, Any], groups: Mapping[str, list[str]]) -> list[str]:
    """Return the names of the components of a sensor; none where it has one value."""
    parts = sensor.get("joints") or sensor.get("links")
    if parts:
        parts = [parts] if isinstance(parts, str) else parts
        return list(dict.fromkeys(member for part in parts for member in groups.get(part, [part])))
    if sensor.get("measure", "each") != "each":
        return []
    if "grid" in sensor:
        columns, rows = map(int, sensor["grid"].split())
        return [f"r{column}_{row}" for column in range(columns) for row in range(rows)]
    rays = sensor.get("rays", ())
    return (
        [f"r{number}" for number in range(rays)]
        if isinstance(rays, int)
        else [*rays, *AXES.get(sensor["type"], "")]
    )


AXES = {"orientation": "xyzw"} | dict.fromkeys(
    (
        *("gyro", "accelerometer", "projected_gravity", "position", "velocity", "angular_velocity"),
        *("reaction_force", "reaction_torque"),
    ),
    "xyz",
)
"""The components of sensors that measure vectors."""


@law(cost=270, profile=PLAIN)
def components_have_the_names_of_the_text(case: Case) -> None:
    """A sensor of a list of joints or links has a value of each, by its name, also of a single one; a sensor
    of a joint or a link has one value, and a vector those of its axes."""
    case.compile()
    data, sources = shown_world(case)
    parts: dict[str, tuple[str, int]] = {}
    for name, source in sources.items():
        if isinstance(source, Reader):
            robot = data["robots"][source.robot]
            for number, component in enumerate(
                names_in(robot["sensors"][source.sensor], robot.get("groups", {}))
            ):
                data["signals"][f"part{len(parts)}"] = f"{source.robot}.{source.sensor}.{component}"
                parts[f"part{len(parts)}"] = name, number
    program = case.compile(case.write(data, "parts.yaml")).program
    for robot in program.robots:
        for sensor in robot.sensors:
            written = data["robots"][robot.name]
            assert [*sensor.components] == names_in(
                written["sensors"][sensor.name], written.get("groups", {})
            )
    sources |= {part: sources[name] for part, (name, _) in parts.items()}
    with opened(watched(program, sources)) as world, reference():
        for values in shown_episode(world, sources, 3)[0]:
            for part, (name, number) in parts.items():
                np.testing.assert_array_equal(values[part], values[name][[number]], part)


def amid(model: RobotModel, speed: float) -> dict[str, dict[str, str]]:
    """Return the start of all joints of a robot between their limits, at a speed in rad/s or m/s. Near 0,
    yourdfpy rounds."""
    return {
        f"one.{joint.name}": {
            "position": f"{0.4 * joint.ends(1.0)[0] + 0.6 * joint.ends(1.0)[1]} {unit}",
            "velocity": f"{speed} {unit}/s",
        }
        for joint in model.moving_joints
        for unit in ["m" if joint.type == "prismatic" else "rad"]
        if joint.name not in model.followers
    }


MOUNT = {"x": "3 cm", "y": "-2 cm", "z": "5 cm", "roll": "0.4 rad", "pitch": "-0.7 rad", "yaw": "1.1 rad"}
ARM, TURN = np.array([0.03, -0.02, 0.05]), Rotation.from_euler("xyz", [0.4, -0.7, 1.1])


@law(cost=75, profile=PLAIN)
def a_sensor_measures_where_it_is_mounted(case: Case) -> None:
    """The readings of a sensor with a pose follow from those at the origin of its link: along its own axes, a
    torque about its own place is M - r x F, and a velocity there is v + w x r."""
    body = pick(case.draw, [body for body in BODIES if model_of(body.urdf).moving_joints])
    model = model_of(body.urdf)
    link = pick(case.draw, [joint.child for joint in model.moving_joints])
    kinds = ("reaction_force", "reaction_torque", "position", "orientation", "velocity", "angular_velocity")
    sensors: dict[str, Any] = {}
    for kind in (*kinds, "gyro"):
        sensors |= {f"{kind}0": {"type": kind, "link": link}}
        sensors |= {f"{kind}1": {"type": kind, "link": link, "pose": MOUNT}}
    robot = {"urdf": body.urdf, "base": body.base, "sensors": sensors}
    reset = {"joints": amid(model, 0.5), "place": {"one": {"z": "1 m", "roll": "0.3 rad"}}}
    with made(case, drawn_world(case), robot, [f"one.{name}" for name in sensors], reset=reset) as (
        world,
        read,
    ):
        for _, action in zip(range(4), actions(world, 0), strict=False):
            world.step(action)
            force, torque, place, turned, speed, turning, rate = read()[::2]
            link_frame = Rotation.from_quat(turned)
            arm = link_frame.apply(ARM)
            orientation = (link_frame * TURN).as_quat()
            wanted = (
                TURN.inv().apply(force),
                TURN.inv().apply(torque - np.cross(ARM, force)),
                place + arm,
                orientation * np.sign(orientation @ read()[7]),
                speed + np.cross(turning, arm),
                turning,
                TURN.inv().apply(rate),
            )
            for name, value, expected in zip(kinds, read()[1::2], wanted, strict=False):
                np.testing.assert_allclose(
                    value, expected, 1e-6, 1e-6 * (1 + abs(expected).max()), err_msg=name
                )


STEP = 1e-4
"""s: so short that a link turns by less than 1e-3 rad in it."""


@law(cost=95, profile=PLAIN)
def rotors_push_and_turn_a_robot(case: Case) -> None:
    """In a time dt, rotors give a flying robot the momentum F dt, and the angular momentum of F about its
    center of mass with the drag torques about their axes: motors and joints within the robot change neither."""
    body = pick(case.draw, [body for body in BODIES if body.base == "free"])
    model = model_of(body.urdf)
    links = case.draw(
        st.lists(st.sampled_from([link.name for link in model.links]), min_size=1, max_size=3, unique=True)
    )
    axis, constant, thrust = (
        pick(case.draw, "xyz"),
        case.draw(st.integers(0, 40)),
        pick(case.draw, (0.05, 0.2)),
    )
    spins = {link: case.draw(st.integers(-2, 2)) / 2 for link in links}
    robot = {
        "urdf": body.urdf,
        "actuators": {
            "jets": {
                "type": "thrust",
                "links": links,
                "range": "-1 .. 1 N",
                "axis": axis,
                "moment_constant": f"{constant} mm",
                "spin": spins,
            }
        },
        "apply": {"jets": f"{thrust} N"},
    }
    world = {"timestep": "0.1 ms", "engine": pick(case.draw, ENGINES), "gravity": "0 0 0 m/s^2"}
    place = {"z": "3 m", "roll": "0.3 rad", "pitch": "-0.6 rad", "yaw": "2 rad"}
    reset = {"joints": amid(model, 0.0), "place": {"one": place}}
    with made(case, world, robot, [], reset=reset) as (environment, _):
        before = Truth(environment.scenario, start_of(environment), np.zeros(3))
        environment.step(environment.action_space.sample())
        start = start_of(environment)
        frame, motion = start.bodies["one"]
        start = Start(
            {"one": (frame, tuple(np.array(motion) / STEP))},
            {key: (position, speed / STEP) for key, (position, speed) in start.joints.items()},
        )
        after = Truth(environment.scenario, start, np.zeros(3))  # moves at the mean acceleration
    centers, masses, speeds = [], [], []
    for link in model.links:
        if link.inertial is not None and link.inertial.mass:
            mount = of_pose(link.inertial.origin)
            masses.append(link.inertial.mass)
            centers.append((before.frames[f"one.{link.name}"] @ mount)[:3, 3])
            speeds.append(after.twist(f"one.{link.name}", mount)[0])
    center = np.average(centers, axis=0, weights=masses)
    pushes, turns = np.zeros(3), np.zeros(3)
    for link, spin in spins.items():
        frame = before.frames[f"one.{link}"]
        inertial = model.link(link).inertial
        if inertial is not None and not inertial.mass:
            frame = frame @ of_pose(inertial.origin)
        force = thrust * frame[:3, "xyz".index(axis)]
        pushes += force
        turns += np.cross(frame[:3, 3] - center, force) + spin * constant / 1000 * force
    momentum = masses @ np.array(speeds)
    turning = COMPUTED["angular_momentum"](after, Call("angular_momentum", ("one",), ""))
    for gained, impulse, scale in ((momentum, pushes, thrust), (turning, turns, thrust * SMALL_LEVER)):
        assert np.linalg.norm(gained - impulse) <= 1e-4 * (scale + np.linalg.norm(impulse)), (gained, impulse)
