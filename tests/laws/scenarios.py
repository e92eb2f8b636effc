"""Strategies for whole valid scenarios, from the models of the language.

Each section is drawn from the fields of its model: required keys always, others by chance, as many of them as
its `key_rules` allow. What one section takes from another (names, joints, the timestep) is in `Author`.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import yaml
from hypothesis import strategies as st

from deepbots_cli.diagnostics import Findings
from deepbots_cli.document import shipped
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, MASS, NUMBER, TIME, Dimension
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.types import SPACE, Components, Context, Kind, Known, ValueType
from deepbots_cli.robots.model import RobotModel
from deepbots_cli.robots.reader import read
from deepbots_cli.scenario.actuators import ACTUATORS
from deepbots_cli.scenario.base import Forms, Kinds, ListOf, MappingOf, Section, Shape, section_fields
from deepbots_cli.scenario.documentation import example_of
from deepbots_cli.scenario.fields import FieldType, Reference
from deepbots_cli.scenario.robots import Messages, Robot
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.sensors import SENSORS, RayScan
from deepbots_cli.scenario.task import MapLayout, PythonTerm, Reset
from deepbots_cli.scenario.world import World
from tests.laws import tasks
from tests.laws.expressions import (
    CONDITION,
    SCALARS,
    Draw,
    Expressions,
    Names,
    UnavailableError,
    chance,
    literal,
    literal_range,
    number_text,
    pick,
    units_of,
)
from tests.laws.fields import Place, Values, plain

# Robots


@dataclass(frozen=True)
class Body:
    """A shipped robot: how it stands, and the kinds of its actuators."""

    urdf: str
    base: str
    actuators: tuple[str, ...]
    z: str = ""


_MOTORS = ("velocity_motor", "position_motor", "torque_motor")
BODIES = (
    Body("cartpole_rail", "fixed", _MOTORS, "50 cm"),
    Body("epuck", "free", _MOTORS),
    Body("quadrotor", "free", ("thrust",), "60 cm"),
    Body("panda", "fixed", (*_MOTORS, "cartesian", "gripper")),
    Body("biped", "free", _MOTORS),
)


@cache
def model_of(urdf: str) -> RobotModel:
    """Return the model of a shipped robot."""
    path = shipped.robot_path(urdf)
    assert path is not None
    robot = read(path, path.name, Findings())
    assert robot is not None
    return robot.model


def joint_dimension(model: RobotModel, name: str) -> Dimension:
    return LENGTH if model.joint(name).type == "prismatic" else ANGLE


# Scenarios


@dataclass(frozen=True)
class Drawn:
    """A scenario that was drawn: its data, and its text."""

    data: dict[str, Any]

    @property
    def text(self) -> str:
        return as_text(self.data)

    def _repr_pretty_(self, printer: Any, _cycle: bool) -> None:
        """Print the text: Hypothesis calls this for a failure."""
        printer.text(f"\n{self.text}")


def as_text(data: dict[str, Any]) -> str:
    return str(yaml.dump(data, Dumper=yaml.CSafeDumper, sort_keys=False, allow_unicode=True, width=110))


def _timed(author: Author, _data: Mapping[str, Any], _place: Place) -> str:
    return f"{author.timestep * author.draw(st.integers(1, 4))} ms"


def _points(author: Author, _data: Mapping[str, Any], _place: Place) -> list[str]:
    corners = ("-0.3 0 m", "0.3 0.1 m", "20 45 cm", "-0.5 0.6 m")
    return list(corners[: author.draw(st.integers(2, 4))])


def _is_movable(data: Mapping[str, Any]) -> bool:
    return bool(data.get("solid", True)) and not data.get("fixed")


GIVEN: dict[tuple[str, str], Callable[[Author, Mapping[str, Any], Place], Any]] = {
    ("World", "timestep"): lambda author, *_: f"{author.timestep} ms",
    ("World", "substeps"): lambda author, *_: author.substeps,
    ("World", "engine"): lambda author, *_: pick(author.draw, author.profile.engines),
    ("World", "gravity"): lambda author, *_: pick(
        author.draw,
        ("0 0 -9.81 m/s^2", "0 0 -1.62 m/s^2", "uniform(0 0 -10 .. 0 0 -9 m/s^2)", "0 0 -980 cm/s^2"),
    ),
    ("Arena", "size"): lambda author, *_: pick(author.draw, ("4 4 m", "300 250 cm")),
    ("Sensor", "period"): _timed,
    ("Wall", "points"): _points,
    ("Line", "points"): _points,
    ("Camera", "resolution"): lambda author, *_: pick(author.draw, ("4 3", "8 6")),
    ("ReactionSensor", "link"): lambda author, _data, place: author.carried_link(place.robot),
    ("VariedObject", "mass"): lambda *_: "0.5 kg",
    ("ShapedBody", "mass"): lambda author, data, _: pick(
        author.draw, ("0.5 kg", "800 g", *(("uniform(0.3 .. 0.6 kg)",) if _is_movable(data) else ()))
    ),
    ("Material", "color"): lambda author, *_: pick(author.draw, ("red", "#ffa500", "choice(red | green)")),
    ("Observed", "range"): lambda author, _data, place: author.wide_range(place),
    ("PlacedBody", "count"): lambda author, *_: pick(author.draw, (2, 3)),
    ("RaySensor", "range"): lambda author, data, _: author.ray_range(data),
    ("CalibrationTable", "value"): lambda *_: "300 200 100",
    ("LinkOverride", "com"): lambda author, _data, place: author.center_of_mass(place),
    ("LinkOverride", "density"): lambda author, _data, place: author.density(place),
    ("LinkOverride", "inertia"): lambda author, _data, place: author.inertia(place),
    ("LinkOverride", "scale"): lambda author, *_: pick(author.draw, ("1.2 1.2 1.2", "0.9 0.9 0.9")),
    ("JointOverride", "armature"): lambda author, _data, place: author.armature(place),
    ("Formula", "heights"): lambda author, *_: pick(
        author.draw, ("3 cm * sin(x / m * 90 deg)", "clamp(x / 20, -1 .. 1 cm)", "1 cm")
    ),
    ("Formula", "size"): lambda *_: "4 4 m",
    ("Placement", "clearance"): lambda author, *_: pick(author.draw, ("1 cm", "2 mm")),
    ("Placement", "grid"): lambda author, *_: pick(author.draw, ("20 cm", "0.25 m")),
    ("Region", "x"): lambda *_: "-1.5 .. 1.5 m",
    ("Region", "y"): lambda *_: "0 .. 1.5 m",
    ("Reset", "settle"): _timed,
    ("Reset", "require"): lambda author, *_: author.requirement(),
    ("Placement", "on"): lambda author, _data, place: author.table(place),
    ("HeightScan", "range"): lambda *_: "-1 .. 1 m",
    ("Gripper", "open"): lambda *_: "4 cm",
    ("Gripper", "closed"): lambda *_: "0 mm",
    ("Gripper", "max_torque"): lambda author, *_: pick(author.draw, ("20 N", "uniform(10 .. 30 N)")),
    ("MeshObject", "file"): lambda *_: "package://pybullet_data/cube.obj",
    ("MeshObject", "mass"): lambda *_: "0.5 kg",
    ("MeshObject", "scale"): lambda author, *_: pick(author.draw, ("0.1 0.1 0.1", "0.2 0.1 0.1")),
    ("MeshTerrain", "file"): lambda *_: "package://pybullet_data/plane.obj",
    ("MeshTerrain", "scale"): lambda *_: "0.3 0.3 1",
    ("Thrust", "spin"): lambda author, *_: pick(author.draw, (1, -1, 0.5)),
    ("RayScan", "angle_range"): lambda author, data, _: author.fan(data),
    ("Disturbance", "body"): lambda author, *_: tasks.pushed(author),
    ("Disturbance", "every"): lambda author, *_: pick(author.draw, ("0.1 s", "uniform(100 .. 300 ms)")),
    ("Disturbance", "duration"): lambda author, *_: pick(author.draw, ("40 ms", "uniform(20 .. 100 ms)")),
    ("Route", "loss"): lambda author, *_: pick(author.draw, (0.1, "20 %", "uniform(0 .. 0.3) each step")),
    ("Route", "burst"): lambda author, *_: pick(author.draw, (2, 3)),
    ("Cartesian", "link"): lambda *_: "panda_hand",
    ("Cartesian", "joints"): lambda *_: [f"panda_joint{number}" for number in range(1, 8)],
    ("Gripper", "joints"): lambda *_: ["panda_finger_joint1", "panda_finger_joint2"],
    ("JointOverride", "range"): lambda author, data, place: author.joint_range(place),
}
"""Values of keys that depend on other sections, or that a plausible world needs."""
PLACES: dict[tuple[str, str], Callable[[Place], Place]] = {
    ("Sensor", "drift"): lambda place: replace(place, kind=ValueType(place.kind.dimension / TIME)),
    ("CalibrationTable", "value"): lambda place: replace(place, kind=ValueType()),
}
"""Keys whose value has another dimension than what the section measures."""
BY_EXAMPLE = ("Tile", "TileTerrain", "Pit")
"""Sections whose keys have the values of their examples: a wrong terrain has no room for a robot."""
EXCLUSIVE: dict[str, tuple[tuple[str, ...], ...]] = {
    "Placement": (("on", "region"), ("on", "grid")),
    "GridScan": (("grid", "rays"), ("grid", "angle_range")),
    "LinkOverride": (("mass", "density"), ("scale", "density"), ("inertia", "density"), ("com", "density")),
}
"""Keys that the compiler does not combine."""
TOGETHER: dict[str, tuple[tuple[str, ...], ...]] = {
    "SpeedLimitedMotor": (("stall_torque", "no_load_speed"),),
    "MeshObject": (("scale",), ("mass",)),
    "MeshTerrain": (("scale",),),
    "PositionMotor": (("stiffness", "damping"), ("stall_torque", "no_load_speed", "stiffness", "damping")),
    "Route": (("burst", "loss"),),
    "RayScan": (("angle_range", "rays"),),
    "Placement": (("grid", "region"),),
    "GridScan": (("spacing", "grid"), ("align", "grid")),
    "RaySensor": (("range",),),
    "HeightScan": (("range",),),
}
"""Keys that need each other, or that the compiler requires."""
LEFT_OUT = {
    "Scenario": {"role", "tune", "ros", "deploy"},
    "Camera": {"noise", "bias", "drift", "range"},
    "Placement": {"spacing", "at_most"},
    "Touch": {"noise", "bias", "drift", "range", "resolution"},
}
"""Keys that the compiler refuses in a section."""
_CHANGING = r"\b(act|sense|says|sig|aug|one|two|thing|time|step)"
"""The beginnings of names whose values change."""
_OPTIONS_LEFT_OUT = (PythonTerm, MapLayout)
_FIRST = ("solid", "fixed", "lookup", "measure", "rays", "grid")
"""Keys on which others depend."""


class Author(Values):
    """Draws the sections of one scenario, and remembers their names."""

    def __init__(self, draw: Draw, profile: Profile) -> None:
        super().__init__(draw)
        self.profile = profile
        self.data: dict[str, Any] = {"deepbots": 1, "name": "Drawn"}
        self.timestep = 20
        self.substeps = 4
        self.bodies: dict[str, Body] = {}
        self.driven: dict[str, set[str]] = {}
        self.parameters: dict[str, ValueType] = {}
        self.actions: dict[str, ValueType] = {}
        self.supervised: dict[str, ValueType] = {}
        """Values of the supervisor: entries of `augment`, signals."""
        self.seen: dict[str, ValueType] = {}
        """Values that the policy observes, by name."""
        self.sent: dict[str, ValueType] = {}
        """What robots send or hear, as `cart.angle`: a policy may observe it."""
        self.said: dict[str, ValueType] = {}
        """What robots send, which others may hear."""
        self.on_board: dict[str, dict[str, ValueType]] = {}
        """Sensors and received values of each robot."""
        self.groups: dict[str, dict[str, tuple[str, ...]]] = {}
        """The groups of joints of each robot."""
        self.endings: list[str] = []
        self.drawn: list[tuple[dict[str, Any], str, Callable[[], Any]]] = []
        """The numbers of sections: the section, the key, and a function that draws another value."""
        self.layouts: tuple[str, ...] = ()
        self.tables: tuple[str, ...] = ()
        self.count = 0
        self.has_several_agents = False
        self.has_copies = False
        """Whether one policy drives several copies of the robot."""

    # Names

    def new_name(self) -> str:
        """Return a name that nothing else has."""
        self.count += 1
        return f"n{self.count}"

    def names(self, context: Context, robot: str = "") -> Names:
        values = dict(self.parameters)
        if context in (Context.EMIT, Context.APPLY):
            values = {name: kind for name, kind in values.items() if kind.known is Known.FIXED}
            values |= self.on_board.get(robot, {})
            if context is Context.APPLY:
                values |= self.actions
        elif context is Context.FORBID:
            values |= {name: kind for name, kind in self.seen.items() if not kind.picture}
        elif context not in (Context.FIXED, Context.PARAMETER, Context.FIELD, Context.RESET, Context.REQUIRE):
            step = Known.STEP
            values |= self.supervised | self.sent | self.actions
            values |= {"time": ValueType(TIME, known=step), "step": ValueType(known=step)}
            if context in (Context.REWARD, Context.ENDING, Context.TEST):
                values |= {name: CONDITION._replace(known=step) for name in self.endings}
        return Names(context, values, self._subjects(), self._joints())

    def members(self, robot: str, parts: Any) -> tuple[str, ...]:
        """Return the joints or links that a name, a group, or a list of them stand for."""
        names = parts if isinstance(parts, list) else [parts]
        groups = self.groups.get(robot, {})
        return tuple(member for name in names for member in groups.get(name, (name,)))

    def _subjects(self) -> dict[Kind, list[str]]:
        subjects: dict[Kind, list[str]] = {Kind.GROUND: ["ground"], Kind.ROBOT: list(self.bodies)}
        for robot, body in self.bodies.items():
            model = model_of(body.urdf)
            subjects.setdefault(Kind.JOINTS, []).extend(f"{robot}.{name}" for name in self.groups[robot])
            names = self.data["robots"][robot].get("groups", {}).keys() - self.groups[robot].keys()
            subjects.setdefault(Kind.LINKS, []).extend(f"{robot}.{name}" for name in sorted(names))
            subjects.setdefault(Kind.LINK, []).extend(f"{robot}.{link.name}" for link in model.links)
            for name, sensor in self.sensors(robot).items():
                if self.has_several_agents and f"{robot}.{name}" not in self.sent:
                    continue
                kind = Kind.CAMERA if sensor["type"] == "camera" else Kind.SENSOR
                subjects.setdefault(kind, []).append(f"{robot}.{name}")
        for name, entry in self.data.get("objects", {}).items():
            subjects.setdefault(Kind.OBJECTS if "count" in entry else Kind.OBJECT, []).append(name)
        subjects[Kind.LINE] = list(self.data.get("world", {}).get("lines", {}))
        for name, wall in self.data.get("world", {}).get("walls", {}).items():
            is_one = len(wall["points"]) == 2 and not wall.get("closed")
            subjects.setdefault(Kind.WALL if is_one else Kind.WALLS, []).append(name)
        return subjects

    def _joints(self) -> dict[str, Dimension]:
        """Return the dimension of the position of each joint, and of each group of joints."""
        return {
            f"{robot}.{name}": joint_dimension(model_of(body.urdf), self.members(robot, name)[0])
            for robot, body in self.bodies.items()
            for name in (*[joint.name for joint in model_of(body.urdf).moving_joints], *self.groups[robot])
        }

    def sensors(self, robot: str) -> Mapping[str, Any]:
        return self.data.get("robots", {}).get(robot, {}).get("sensors", {})

    def references(self, kind: str, robot: str) -> list[str]:
        """Return the names that a reference of this kind may have: of `robot`, unless it is empty."""
        world, objects = self.data.get("world", {}), self.data.get("objects", {})
        bodies = [*self.bodies, *objects]
        names: dict[str, list[str]] = {
            "joints": list(self._joints()),
            # A table stays where it is, level.
            "body": [name for name in bodies if name not in self.tables],
            "body or link": [*bodies, *self._subjects().get(Kind.LINK, ())],
            "bodies or links": ["ground", *objects],
            "robot": list(self.bodies),
            "object": list(objects),
            "line": list(world.get("lines", {})),
            "sensor": list(self.sensors(robot)),
            "action": list(self.actions),
            "layout": list(self.layouts),
            "region": ["arena"] if "arena" in world else [],
        }
        if robot:
            model = model_of(self.bodies[robot].urdf)
            names["joint"] = [joint.name for joint in model.moving_joints]
            names["joints"] = [*names["joint"], *self.groups[robot]]
            names["link"] = names["links"] = [link.name for link in model.links]
        return names.get(kind, [])

    # Shapes

    def value(self, shape: Shape, place: Place) -> Any:
        """Draw a value of a shape."""
        match shape:
            case FieldType():
                return self.value_of(shape, place)
            case ListOf(item=item):
                return [self.value(item, place) for _ in range(self.draw(st.integers(1, 2)))]
            case MappingOf():
                return self.mapping(shape, place)
            case Forms(options=options):
                return self._first_available(
                    [
                        lambda o=option: self.value(o, place)
                        for option in options
                        if option not in _OPTIONS_LEFT_OUT
                    ]
                )
            case Kinds():
                return self._first_available(
                    [lambda n=name: self.kind(shape, n, place) for name in shape.models]
                )
            case type():
                return self.section(shape, place)
        raise TypeError(shape)

    def _first_available(self, ways: list[Callable[[], Any]]) -> Any:
        """Draw one of the ways; the next one where the scenario has nothing for it."""
        first = self.draw(st.integers(0, len(ways) - 1))
        for way in (*ways[first:], *ways[:first]):
            try:
                return way()
            except UnavailableError:
                continue
        raise UnavailableError

    def kind(self, kinds: Kinds, word: str, place: Place) -> dict[str, Any]:
        """Draw a section of the kind `word`."""
        return self.section(kinds.models[word], place, {kinds.key: word})

    def mapping(self, shape: MappingOf, place: Place, most: int = 2) -> dict[str, Any]:
        mapping: dict[str, Any] = {}
        for _ in range(self.draw(st.integers(1, most))):
            key = self.value_of(shape.key, place)
            if isinstance(key, str) and key not in mapping:
                mapping[key] = self.value(shape.value, self.place_of_key(shape.key, key, place))
        return mapping

    def place_of_key(self, kind: FieldType, key: str, place: Place) -> Place:
        """Return the place of the value under a key that names a joint or a value."""
        name = key if "." in key else f"{place.robot}.{key}"
        dimension = self._joints().get(name)
        if dimension is None:
            return replace(place, body=key)
        return replace(place, body=key, second=dimension == LENGTH, joint=name)

    def section(self, model: type[Section], place: Place, given: Mapping[str, Any] = {}) -> dict[str, Any]:
        """Draw a section: its required keys, and others by chance."""
        shapes = section_fields(model)
        data = dict(given)
        for key in self._chosen(model, given):
            if key in data:
                continue
            inner = self.place_of_section(model, data, place)
            try:
                data[key] = self._entry(model, key, shapes[key], data, inner)
                if tasks.numeric(shapes[key]) and len(data) > len(given):
                    self._remember(model, key, shapes[key], data, inner)
            except UnavailableError:
                if model.model_fields[key].is_required():
                    raise
        if any(len(data.keys() & set(rule.names)) < rule.min for rule in model.key_rules):
            raise UnavailableError
        return data

    def _remember(
        self, model: type[Section], key: str, shape: Shape, data: dict[str, Any], place: Place
    ) -> None:
        self.drawn.append((data, key, lambda: self._entry(model, key, shape, data, place)))

    def leaves(self) -> list[tuple[tuple[str, ...], Callable[[], Any]]]:
        """Return the paths of the numbers of sections, each with a function that draws another value."""
        paths: dict[int, tuple[str, ...]] = {}

        def visit(value: Any, path: tuple[str, ...]) -> None:
            if isinstance(value, dict):
                paths[id(value)] = path
                for key, inner in value.items():
                    visit(inner, (*path, key))

        visit(self.data, ())
        return [
            ((*paths[id(data)], key), again)
            for data, key, again in self.drawn
            if id(data) in paths and key in data and key != "timestep"
        ]

    def condition(self, context: Context) -> str:
        """Draw a condition that may be true or false."""
        return Expressions(self.draw, self.names(context)).condition()

    def _entry(
        self, model: type[Section], key: str, shape: Shape, data: Mapping[str, Any], place: Place
    ) -> Any:
        for base in model.__mro__:
            if (base.__name__, key) in GIVEN:
                return GIVEN[base.__name__, key](self, data, place)
            if base.__name__ in BY_EXAMPLE and (example := example_of(model, key)):
                return example.data
            if (base.__name__, key) in PLACES:
                place = PLACES[base.__name__, key](place)
        return self.value(shape, place)

    def _chosen(self, model: type[Section], given: Mapping[str, Any]) -> Iterator[str]:
        """Yield the keys to draw: names of other things first, since the others depend on them."""
        fields = section_fields(model)
        chosen = {
            key
            for key, info in model.model_fields.items()
            if key not in given
            and key not in LEFT_OUT.get(model.__name__, ())
            and (info.is_required() or chance(self.draw, 25))
        }
        names = [base.__name__ for base in model.__mro__]
        for keys in (keys for name in names for keys in TOGETHER.get(name, ())):
            if not chosen.isdisjoint(keys) or len(keys) == 1:
                chosen.update(key for key in keys if key in fields)
        for keys in (keys for name in names for keys in EXCLUSIVE.get(name, ())):
            if chosen.issuperset(keys):
                chosen.discard(keys[1])
        chosen -= {key for key in chosen if key in given}
        for rule in model.key_rules:
            present = [name for name in rule.names if name in chosen or name in given]
            for name in present[rule.max :]:
                chosen.discard(name)
            if len(present) < rule.min:
                chosen.add(pick(self.draw, [name for name in rule.names if name in fields]))

        def order(key: str) -> tuple[bool, int]:
            return not (isinstance(fields[key], Reference) or key in _FIRST), list(fields).index(key)

        yield from sorted(chosen, key=order)

    def place_of_section(self, model: type[Section], data: Mapping[str, Any], place: Place) -> Place:
        """Return the place of the keys of a sensor or an actuator, with what it measures or commands."""
        if not place.robot or not hasattr(model, "dimension"):
            return place
        robot = model_of(self.bodies[place.robot].urdf)
        joint = data.get("joint", data.get("joints"))
        if joint is not None and hasattr(model, "dimension_of"):
            joint = robot.joint(self.members(place.robot, joint)[0])
            kind = ValueType(model.dimension_of(joint))
            return replace(place, kind=kind, second=joint.type == "prismatic")
        return replace(place, kind=ValueType(NUMBER if "lookup" in data else model.dimension))

    def carried_link(self, robot: str) -> str:
        """Draw a link that a joint carries."""
        return pick(self.draw, [joint.child for joint in model_of(self.bodies[robot].urdf).joints])

    def requirement(self) -> str:
        """Draw a condition on the start that nearly every start meets."""
        names = self.names(Context.REQUIRE)
        names = replace(
            names, subjects={kind: names.subjects.get(kind, ()) for kind in (Kind.ROBOT, Kind.LINK)}
        )
        functions = [
            FUNCTIONS[name] for name in ("position", "yaw", "tilt", "distance", "clearance", "height")
        ]
        text, dimension = Expressions(self.draw, names).changing(functions)
        usual = f"{text} > {literal(self.draw, dimension, low=-9.0, high=-8.0)}"
        return f"{usual} or {self.condition(Context.REQUIRE)}" if chance(self.draw, 50) else usual

    def armature(self, place: Place) -> str:
        """Draw the inertia of a rotor, which PyBullet does not take."""
        if self.data["world"].get("engine") != "mujoco":
            raise UnavailableError
        unit = "kg" if place.second else "kg*m^2"
        return pick(self.draw, (f"0.01 {unit}", f"uniform(0.002 .. 0.004 {unit})"))

    def inertia(self, place: Place) -> Any:
        """Draw a factor of the inertia of a link that has one."""
        if model_of(self.bodies[place.robot].urdf).link(place.body).inertial is None:
            raise UnavailableError
        return pick(self.draw, (1.5, "80 %", "uniform(0.8 .. 1.2)", "auto"))

    def density(self, place: Place) -> str:
        """Draw a density of a link that has a shape."""
        link = model_of(self.bodies[place.robot].urdf).link(place.body)
        if not link.visuals and not link.collisions:
            raise UnavailableError
        return literal(self.draw, MASS / LENGTH**3, low=300.0, high=2000.0)

    def center_of_mass(self, place: Place) -> str:
        """Draw the offset of the center of a mass, which PyBullet cannot vary."""
        if model_of(self.bodies[place.robot].urdf).link(place.body).inertial is None:
            raise UnavailableError
        drawn = ("uniform(0 0 -1 .. 1 1 1 cm)",) if self.data["world"].get("engine") == "mujoco" else ()
        return pick(self.draw, ("1 0 0 cm", "0 5 -5 mm", *drawn))

    def table(self, place: Place) -> str:
        """Draw an object with a level top that is wide enough for a small body."""
        return pick(self.draw, [name for name in self.tables if name != place.body])

    def ray_range(self, data: Mapping[str, Any]) -> str:
        return pick(self.draw, ("0 .. 250", "120 .. 280") if "lookup" in data else ("0 .. 2 m", "5 .. 80 cm"))

    def fan(self, data: Mapping[str, Any]) -> str:
        """Draw the angles of a fan of rays."""
        if not isinstance(data.get("rays"), int):
            raise UnavailableError
        return pick(self.draw, ("90 .. -90 deg", "-1 .. 1 rad"))

    def joint_range(self, place: Place) -> str:
        """Draw a range of a joint that has limits."""
        robot, _, name = place.joint.partition(".")
        if not name or model_of(self.bodies[robot].urdf).joint(name).type == "continuous":
            raise UnavailableError
        return "-0.1 .. 0.1 m" if place.second else "-1 .. 1 rad"

    def wide_range(self, place: Place) -> str:
        """Draw a range that is wide enough for most values of an expression."""
        unit = pick(self.draw, units_of(place.kind.dimension))
        end = number_text(unit.from_si(pick(self.draw, (1000.0, 300.0))))
        return f"-{end} .. {end} {unit.text}".strip()

    # The whole scenario

    def scenario(self) -> Drawn:
        """Draw all sections in the order in which they take names from each other."""
        agents = ("one", "two", "three")[: min(pick(self.draw, (1, 1, 1, 2, 3)), self.profile.agents)]
        self.has_several_agents = len(agents) > 1
        self.has_copies = len(agents) == 1 and self.profile.has_copies and chance(self.draw, 20)
        self._world()
        self.define(self.data, "parameters", self._parameter, 3)
        self._objects()
        several = len(agents) == 1 and not self.has_copies and chance(self.draw, 20)
        robots = ("one", "two") if several else agents
        like = len(agents) > 1 and chance(self.draw, 30)
        for name in robots:
            self._robot(name, like="one" if like and name != "one" else "")
        if self.has_copies:
            self.data["robots"]["one"] |= {"count": pick(self.draw, (2, 3)), "spacing": "0 1.5 0 m"}
        if chance(self.draw, 60):
            self.data["messages"] = self.section(Messages, Place())
            if self.data["messages"].get("format") == "none":
                self.data["messages"] = {"format": "none"}
        acting = self._act(agents, like=like)
        if not self.has_copies:
            self._reset()
        sent = self.sent
        if len(agents) > 1:
            self.sent = {}  # values of one agent are no values of all
        self.define(self.data, "signals", self.signal, 3)
        self.sent = sent
        if len(agents) > 1:
            self._agents(acting, like=like)
        else:
            self._agent(acting[""])
        if self.profile.is_plain:
            self.data["truncation"] = {"max_steps": self.draw(st.integers(5, 30))}
        else:
            self.data["truncation"] = tasks.truncation(self)
            self._around(agents if len(agents) > 1 else ())
        return Drawn(self.data)

    def _world(self) -> None:
        """Draw the world, with a ground that its engine and the robots can have."""
        self.timestep = pick(self.draw, (20, 10, 32))
        self.substeps = pick(self.draw, (4, 8))
        world = self.data["world"] = self.section(World, Place())
        engines = self.profile.engines
        is_mesh = world.get("terrain", {}).get("type") == "mesh"
        if self.has_copies or (is_mesh and "pybullet" not in engines):
            world.pop("terrain", None)
        elif is_mesh:
            world["engine"] = "pybullet"
        if engines[0] != "pybullet":
            world.setdefault("engine", engines[0])

    def _act(self, agents: tuple[str, ...], *, like: bool) -> dict[str, dict[str, Any]]:
        """Draw the actions of each agent, and the messages of its robots, which use them."""
        several = len(agents) > 1
        acting: dict[str, dict[str, Any]] = {}
        robots = {name: (name,) for name in agents} if several else {"": tuple(self.bodies)}
        for name, own in robots.items():
            if like and name != "one":
                continue
            count = self.draw(st.integers(1, 2))
            acts = [
                f"{name}act{number}" if several and not like else f"act{number}" for number in range(count)
            ]
            acting[name] = {"action": tasks.actions(self, acts, own)}
            for robot in own:
                with tasks.seen_by(self, robot) if several else nullcontext():
                    fields = self._messages_of(robot)
                self.sent |= fields
        if several:
            self.actions = {}
        if like:
            for other in agents[1:]:
                self.data["robots"][other] |= tasks.mirrored(
                    {
                        key: self.data["robots"]["one"][key]
                        for key in ("receive", "emit", "apply")
                        if key in self.data["robots"]["one"]
                    },
                    "one",
                    other,
                )
        return acting

    def _agent(self, acting: dict[str, Any]) -> None:
        """Draw what the only agent sees and wants."""
        data = self.data
        self.define(data, "augment", self.signal, 3)
        data["action"] = acting["action"]
        augmented = {name: self.supervised[name] for name in data.get("augment", {})}
        self.seen = self.sent | augmented
        data["observation"] = tasks.observed(self, self.seen, 60) or {"previous_action": "auto"}
        is_plain = self.profile.is_plain
        if not is_plain:
            tasks.forbid(self, data["action"])
        words = ("success", "failure")
        if not is_plain and chance(self.draw, 15):
            critic = tasks.observed(self, self.seen | self.supervised, 20)
            data["critic"] = {
                name: entry for name, entry in critic.items() if name not in data["observation"]
            }
        drawn = tasks.endings(self, words)
        if drawn:
            data["termination"] = {name.rstrip("0"): {name: text} for name, text in drawn.items()}
        self.endings = list(drawn)
        if not (is_plain or self.has_copies) and chance(self.draw, 15):
            data["goal"], reward = tasks.goal(self)
            data["reward"] = {"term0": reward}
        else:
            reward = section_fields(Scenario)["reward"].value
            terms = range(self.draw(st.integers(1, 3)))
            data["reward"] = {f"term{number}": self.value(reward, Place()) for number in terms}
        if not is_plain and chance(self.draw, 40):
            data["scripts"] = {"written": tasks.script(self, data["action"])}
        if not is_plain and chance(self.draw, 20):
            # Hindsight cannot recompute the reward of several timesteps.
            repeat = 1 if "goal" in data else self.draw(st.integers(1, 3))
            data["agent"] = {
                "action_repeat": repeat,
                "frame_stack": self.draw(st.integers(1, 2)),
            }
        if self.has_copies:
            data["agent"] = data.get("agent", {}) | {"each": "one"}

    def _agents(self, acting: dict[str, dict[str, Any]], *, like: bool) -> None:
        """Draw what each agent sees and wants."""
        data = self.data
        data["agents"] = {}
        for name, drawn in acting.items():
            data["agents"][name] = {"robots": [name], **drawn}
            tasks.agent(self, name, data["agents"][name])
        if like:
            for other in [name for name in self.bodies if name != "one"]:
                data["agents"][other] = {"like": "one", "robots": [other]}
        self.sent = {}
        if ends := tasks.outcomes(self, list(self.bodies)):
            data["endings"] = ends
            self.endings = list(ends)
        if chance(self.draw, 40):
            data["role"] = {"agent": "two"}
            if chance(self.draw, 50):
                data["role"]["others"] = {"one": pick(self.draw, ("random", "zero"))}

    def _around(self, agents: tuple[str, ...]) -> None:
        """Draw what is about a whole scenario: how it is disturbed, varied, trained, and tested."""
        data = self.data
        if chance(self.draw, 15) and (pushes := tasks.disturbances(self)):
            data["disturbances"] = pushes
        if chance(self.draw, 15):
            data["evaluation"] = tasks.evaluation(self)
        if not agents and chance(self.draw, 15):
            data["curriculum"] = tasks.curriculum(self)
        if not agents and chance(self.draw, 15):
            data["solved"] = tasks.solved(self)
        first = data if not agents else data["agents"][agents[0]]
        if not agents and chance(self.draw, 30):
            data["train"] = tasks.training(self, first)
        elif agents and "like" in data["agents"][agents[-1]] and chance(self.draw, 40):
            data["train"] = tasks.self_play(self, first)
            if chance(self.draw, 25):
                data["tune"] = tasks.search(self)
        if not agents and chance(self.draw, 15):
            robot = pick(self.draw, tuple(self.bodies))
            data["deploy"] = {"supplied_by": {f"position({robot})": "motion capture"}}
        if chance(self.draw, 15):
            data["tests"] = {"test0": tasks.check(self, first, self.endings, agents[0] if agents else "")}

    def define(
        self, data: dict[str, Any], section: str, define: Callable[[str], Any], most: int, prefix: str = ""
    ) -> None:
        """Draw up to `most` definitions of a section."""
        entries = data.setdefault(section, {})
        for number in range(self.draw(st.integers(0, most))):
            name = f"{prefix or section[:3]}{number}"
            entries[name] = define(name)
        if not entries:
            del data[section]

    def _parameter(self, name: str) -> str:
        dimensions = [kind.dimension for kind in self.parameters.values()]
        dimension = pick(self.draw, dimensions if dimensions and chance(self.draw, 50) else SCALARS)
        latest = pick(self.draw, (Known.FIXED, Known.FIXED, Known.EPISODE, Known.EPISODE, Known.STEP))
        kind = ValueType(dimension, known=latest)
        text = self.parameter_text(name, kind)
        self.parameters[name] = kind
        return text

    def parameter_text(self, name: str, kind: ValueType) -> str:
        """Draw the value of a parameter: from those above it, or at random in each episode or more often."""
        has_changing = any(other.known is Known.STEP for other in self.parameters.values())
        percent = 80 if kind.known is Known.STEP and has_changing else 30
        if kind.known is Known.FIXED or chance(self.draw, percent):
            context = Context.FIXED if kind.known is Known.FIXED else Context.PARAMETER
            names = self.names(context).known_by(kind.known)
            above = dict(itertools.takewhile(lambda item: item[0] != name, names.values.items()))
            latest = max((other.known for other in above.values()), default=Known.FIXED)
            alike = [
                other
                for other, its in above.items()
                if its.dimension == kind.dimension and its.known == latest
            ]
            if alike and chance(self.draw, 60):
                return f"{pick(self.draw, alike)} * {pick(self.draw, ('2', '0.5'))}"
            return plain(Expressions(self.draw, replace(names, values=above)).text(kind))
        unit = pick(self.draw, units_of(kind.dimension)).text
        ways = [f"normal(1 +- 0.1 {unit})", f"choice(1 {unit} | 2 {unit})"]
        ways += ["integer(1 .. 3)"] if kind.dimension == NUMBER else []
        text = f"uniform({literal_range(self.draw, kind.dimension, 0.5, 2.0)})"
        if chance(self.draw, 25):
            text = pick(self.draw, ways).replace(" )", ")")
        again = pick(self.draw, (" each step", " every 0.1 s")) if kind.known is Known.STEP else ""
        return text + again

    def _objects(self) -> None:
        objects = {}
        for number in range(self.draw(st.integers(0, 2))):
            body = self.value(section_fields(Scenario)["objects"].value, Place())
            if self.has_copies:
                body.pop("count", None)
            objects[f"thing{number}"] = body
            self.data["objects"] = objects
        if objects and chance(self.draw, 30):
            objects["table0"] = {"shape": "box", "size": "9 9 0.1 m", "fixed": True, "pose": {"y": "-9 m"}}
            self.tables = ("table0",)

    def _robot(self, name: str, like: str = "") -> None:
        x = {"one": "0 m", "two": "1 m", "three": "2 m"}[name]
        if like:
            self.bodies[name] = self.bodies[like]
            self.groups[name] = self.groups[like]
            self.on_board[name] = tasks.mirrored(self.on_board[like], like, name)
            robot = tasks.mirrored(self.data["robots"][like], like, name)
            self.data["robots"][name] = robot | {"pose": robot["pose"] | {"x": x}}
            return
        body = pick(self.draw, self.profile.bodies)
        self.bodies[name] = body
        self.on_board[name] = {}
        self.driven[name] = set()
        self.groups[name] = {}
        place = Place(robot=name)
        robot: dict[str, Any] = {"urdf": body.urdf, "pose": {"x": x}}
        if body.base == "fixed":
            robot["base"] = "fixed"
        if body.z:
            robot["pose"]["z"] = body.z
        self.data.setdefault("robots", {})[name] = robot
        if chance(self.draw, 30):
            self._groups(name)
        messages = ("receive", "hear", "emit", "apply")
        written_elsewhere = (*robot, "xacro", "count", "spacing", "groups", "poses", *messages)
        for key, shape in section_fields(Robot).items():
            if key in written_elsewhere:
                continue
            if key in ("sensors", "actuators"):
                self._devices(name, key, place)
            elif chance(self.draw, 15):
                with suppress(UnavailableError):
                    robot[key] = self.value(shape, place)

    def _devices(self, robot: str, key: str, place: Place) -> None:
        """Draw the sensors or the actuators of a robot."""
        data = self.data["robots"][robot]
        data[key] = {}
        if key == "sensors":
            for number in range(self.draw(st.integers(1, 3))):
                self._sensor(robot, f"sense{number}", place)
            return
        for number in range(self.draw(st.integers(1, 2))):
            self._actuator(robot, f"move{number}", place)
        if not data[key]:
            del data[key]

    def _groups(self, robot: str) -> None:
        """Name some joints, some links, and positions of the joints."""
        data, model = self.data["robots"][robot], model_of(self.bodies[robot].urdf)
        links = [link.name for link in model.links]
        data["groups"] = {"parts": links[: self.draw(st.integers(1, 3))]}
        names = [joint.name for joint in model.moving_joints if joint.name not in model.followers]
        if not names:
            return
        first = joint_dimension(model, pick(self.draw, names))
        alike = [name for name in names if joint_dimension(model, name) == first]
        members = alike[: self.draw(st.integers(1, 3))]
        data["groups"]["some"] = members
        data["poses"] = {"ready": dict.fromkeys(members, "0.01 m" if first == LENGTH else "5 deg")}
        self.groups[robot] = {"some": tuple(members)}
        self.on_board[robot]["ready"] = ValueType(first, tuple(members), known=Known.FIXED)

    def _sensor(self, robot: str, name: str, place: Place) -> None:
        word = pick(self.draw, tuple(SENSORS.built_in))
        model = SENSORS[word]
        try:
            data = self.section(model, place, {"type": word})
        except UnavailableError:
            return
        self.data["robots"][robot]["sensors"][name] = data
        kind = self.place_of_section(model, data, place).kind
        components: Components | None = model.components or None
        if issubclass(model, RayScan) and data.get("measure", "each") == "each":
            rays = data.get("rays")
            if "grid" in data:
                components = ("grid", "of rays")
            elif isinstance(rays, int):
                components = tuple(f"r{number}" for number in range(rays))
            elif rays:
                components = tuple(rays)
        picture = (1, 1, 1) if word == "camera" else None
        if "joints" in data or "links" in data:
            components = self.members(robot, data.get("joints", data.get("links")))
        kind = ValueType(kind.dimension, components, model.boolean, known=Known.STEP, picture=picture)
        self.on_board[robot][name] = kind

    def _actuator(self, robot: str, name: str, place: Place) -> None:
        word = pick(self.draw, self.bodies[robot].actuators)
        try:
            data = self.section(ACTUATORS[word], place, {"type": word})
        except UnavailableError:
            return
        joints = data.get("joint", data.get("joints", data.get("link", data.get("links"))))
        parts = set(self.members(robot, joints))
        if parts & self.driven[robot]:
            return
        self.driven[robot] |= parts
        self.data["robots"][robot]["actuators"][name] = data

    def _messages_of(self, robot: str) -> dict[str, ValueType]:
        """Draw what a robot receives, sends and does; return what it sends."""
        sent: dict[str, ValueType] = {}
        data = self.data["robots"][robot]
        place = Place(robot=robot)
        others = [name for name in self.said if not name.startswith(f"{robot}.")]
        has_messages = self.data.get("messages", {}).get("format") != "none"
        if others and has_messages and chance(self.draw, 30):
            name = f"{robot}_heard"
            data["hear"] = {name: pick(self.draw, others)}
        if chance(self.draw, 30):
            data["receive"] = {}
            for number in range(self.draw(st.integers(1, 2))):
                dimension = pick(self.draw, SCALARS)
                name = f"{robot}_got{number}"
                data["receive"][name] = self.expression(Context.RECEIVE, ValueType(dimension))
                self.on_board[robot][name] = ValueType(dimension, known=Known.STEP)
        sensors = list(data.get("sensors", {}))
        if chance(self.draw, 70):
            data["emit"] = sensors
            for name in sensors:
                sent[f"{robot}.{name}"] = self.on_board[robot][name]
        else:
            data["emit"] = {}
            for number in range(self.draw(st.integers(1, 2))):
                dimension = pick(self.draw, SCALARS)
                received = {name: self.on_board[robot].pop(name) for name in data.get("receive", {})}
                data["emit"][f"says{number}"] = self.expression(Context.EMIT, ValueType(dimension), robot)
                self.on_board[robot] |= received
                sent[f"{robot}.says{number}"] = ValueType(dimension, known=Known.STEP)
        if data.get("actuators"):
            data["apply"] = {name: self._command(robot, name, place) for name in data["actuators"]}
        self.said |= {name: kind for name, kind in sent.items() if not kind.picture}
        return sent | {f"{robot}.{name}": self.said[other] for name, other in data.get("hear", {}).items()}

    def _command(self, robot: str, name: str, place: Place) -> str:
        actuator = self.data["robots"][robot]["actuators"][name]
        model = ACTUATORS[actuator["type"]]
        kind = self.place_of_section(model, actuator, place).kind
        low, high = {"cartesian": (0.2, 0.5), "gripper": (0.0, 1.0), "thrust": (0.0, 0.1)}.get(
            actuator["type"], (-1.0, 1.0)
        )
        wanted = ValueType(kind.dimension, SPACE if model.components else None)
        text = self.expression(Context.APPLY, wanted, robot)
        if wanted.components:
            return text
        return f"clamp({text}, {literal_range(self.draw, kind.dimension, low, high)})"

    def _reset(self) -> None:
        """Place all groups of objects, as the compiler requires, and what chance draws."""
        groups = {
            name: {"region": {"x": "-2 .. 2 m", "y": "0.5 .. 3 m"}}
            for name, entry in self.data.get("objects", {}).items()
            if "count" in entry
        }
        if not groups and chance(self.draw, 30):
            layouts = self.value(section_fields(Reset)["layouts"], Place())
            self.layouts = tuple(layouts)
            data = self.section(Reset, Place(), {"layouts": layouts, "layout": self.layouts[0]})
        else:
            data = self.section(Reset, Place(), {"place": groups, "layout": None, "layouts": None})
        data = {key: value for key, value in data.items() if value}
        if data:
            self.data["reset"] = data

    def signal(self, name: str) -> Any:
        kind = ValueType(pick(self.draw, SCALARS), pick(self.draw, (None, None, None, SPACE)))
        if chance(self.draw, 20):
            kind = CONDITION
        text = self.expression(Context.SIGNAL, kind)
        changes = re.search(_CHANGING, str(text)) is not None
        self.supervised[name] = kind._replace(known=Known.STEP if changes else Known.FIXED)
        return text


@dataclass(frozen=True)
class Profile:
    """Which scenarios a law is about.

    Attributes:
        engines: The engines that the scenario may name.
        bodies: The robots.
        agents: The largest number of agents.
        is_plain: There is only what an episode needs: no goal, cases, trainings, and the like.
        has_copies: One policy may drive several copies of a robot.
    """

    engines: tuple[str, ...] = ("pybullet", "mujoco")
    bodies: tuple[Body, ...] = BODIES
    agents: int = 3
    is_plain: bool = False
    has_copies: bool = True


EVERY = Profile()
ALONE = Profile(has_copies=False)
PLAIN = Profile(agents=1, is_plain=True, has_copies=False)


@st.composite
def scenarios(draw: Draw, profile: Profile = EVERY) -> Drawn:
    """Draw a whole scenario."""
    return Author(draw, profile).scenario()
