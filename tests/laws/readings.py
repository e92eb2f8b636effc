"""A world of a scenario that shows all it can: each sensor without faults, and each function of the world.

The laws of mechanics compare such worlds. Of the scenario they keep the world, the objects, the robots with
sensors and actuators, and the reset; commands come from the action alone, and no message is late.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

from deepbots_cli import api, frames
from deepbots_cli.engines.mechanics import forms_of, is_movable
from deepbots_cli.errors import ScenarioError
from deepbots_cli.expressions.functions import FUNCTIONS, Family, Form, Function
from deepbots_cli.expressions.scalar import Const
from deepbots_cli.expressions.types import Constant, Context, Kind, ValueType
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.program import Program, generated
from deepbots_cli.program.resets import JointStart, Placement, Reset
from deepbots_cli.program.values import Expression
from deepbots_cli.runtime import Supervisor
from deepbots_cli.scenario.sensors import SENSORS, RayScan
from tests.laws.expressions import Draw, Names, chance, pick
from tests.laws.law import Case, reference
from tests.laws.scenarios import BODIES, EVERY, Author

Array = np.ndarray[Any, Any]
Readings = dict[str, Array]
"""The numbers of each sensor and of each function, in SI units, by the name of its signal."""

KEPT = ("deepbots", "name", "parameters", "world", "objects", "robots", "action", "reset")
"""The sections of a scenario that make its world."""
LEFT_OUT = ("receive", "hear", "emit", "sensors")
"""The keys of a robot that its motion does not need."""
FAULTS = ("period", "latency", "noise", "bias", "drift", "resolution")
CALLS = 3
"""The number of calls of each function."""
LEVER = "_lever"
"""The end of the name of a signal that is the distance at which a bearing is measured: at 0, it may be any
angle."""
MAX_SPEED = 100.0
"""rad/s or m/s. Only a joint that another link threw out before the start is faster."""
_COMMAND = re.compile(r"clamp\(.*, (\S+) \.\. (\S+?)( [^ ]+)?\)")
_GROUPS = (Kind.OBJECTS, Kind.LINKS, Kind.JOINTS)
_VECTOR = "velocity({})"
"""The vector that a function of a vector takes: in the world frame, as each of them is."""


@dataclass(frozen=True, order=True)
class Call:
    """A signal that is a function of the world, of these subjects."""

    function: str
    subjects: tuple[str, ...]
    text: str


@dataclass(frozen=True)
class Reader:
    """A signal that is a sensor of a robot."""

    robot: str
    sensor: str
    kind: str


Source = Call | Reader


def shown_world(case: Case, left_out: Sequence[str] = ()) -> tuple[dict[str, Any], dict[str, Source]]:
    """Return the data of a scenario that shows the drawn world, and what each of its signals is.

    `left_out` are the kinds of sensors and the functions that it does not show.
    """
    drawn = copy.deepcopy(case.drawn.data)
    data = {key: drawn[key] for key in KEPT if key in drawn}
    data |= {"messages": {"format": "none"}, "observation": {"previous_action": "auto"}}
    data |= {"reward": {"none": 0}, "truncation": {"max_steps": 1000}}
    for thing in data.get("objects", {}).values():
        if thing.pop("count", None) is not None:
            data.get("reset", {}).pop("require", None)  # it may need the objects as a group
    sources: dict[str, Source] = {}
    for name, robot in data["robots"].items():
        sensors = _sensors(robot, ("camera", *left_out))
        sources |= {f"{key}_of_{name}": Reader(name, key, sensor["type"]) for key, sensor in sensors.items()}
        commands = robot.get("apply", {}).items()
        action = _number_of_action(data["action"])
        changed = {"sensors": sensors, "emit": list(sensors)} if sensors else {}
        changed["apply"] = {actuator: _command(command, action) for actuator, command in commands}
        data["robots"][name] = {key: robot[key] for key in robot if key not in LEFT_OUT} | changed
    data["signals"] = {key: f"{source.robot}.{source.sensor}" for key, source in sources.items()}
    for key, call in _calls(case, data, left_out):
        sources[key] = call
        data["signals"][key] = call.text
    return data, sources


def _sensors(robot: Mapping[str, Any], left_out: Sequence[str]) -> dict[str, Any]:
    """Return the sensors of a robot, without faults; the ranges of those that do not need one clip
    readings."""
    sensors = {}
    for name, sensor in robot.get("sensors", {}).items():
        faults = FAULTS if issubclass(SENSORS[sensor["type"]], RayScan) else (*FAULTS, "range")
        if sensor["type"] not in left_out:
            kept = sensors[name] = {key: value for key, value in sensor.items() if key not in faults}
            if "lookup" in kept:
                kept["lookup"] = {key: kept["lookup"][key] for key in ("distance", "value")}
    return sensors


def _calls(case: Case, data: Mapping[str, Any], left_out: Sequence[str]) -> Iterator[tuple[str, Call]]:
    """Draw a call of each function of the world."""
    names = names_of(case, data)
    for function in FUNCTIONS.values():
        if function.family is not Family.WORLD or function.name in ("visible", *left_out):
            continue
        calls = {_call(case.draw, function, names) for _ in range(CALLS)}
        for number, call in enumerate(sorted(filter(None, calls))):
            yield f"of_{function.name}{number}", call
            if function.name == "bearing":
                text = call.text.replace("bearing", "ground_distance")
                yield f"of_bearing{number}{LEVER}", Call("ground_distance", call.subjects, text)


def names_of(case: Case, data: Mapping[str, Any]) -> Names:
    """Return the parts of the world by kind, and its joints."""
    author = Author(case.draw, EVERY)
    author.data = dict(data)
    author.bodies = {
        name: next(body for body in BODIES if body.urdf == robot["urdf"])
        for name, robot in data["robots"].items()
    }
    author.groups = {name: {} for name in author.bodies}
    return author.names(Context.SIGNAL)


def _number_of_action(actions: Mapping[str, Any]) -> str:
    """Return an expression of the number that the policy chooses first."""
    name, action = next(iter(actions.items()))
    if "each" in action:
        return f"max({name})"
    option = action["choices"]["left"] if "choices" in action else None
    return next(iter(option)) if isinstance(option, dict) else name


def _command(text: Any, action: str) -> Any:
    """Return a command from the action alone, within the bounds of the drawn one."""
    match = _COMMAND.fullmatch(str(text))
    if match is None:
        return text
    low, high, unit = match[1], match[2], match[3] or ""
    return f"clamp({action} * {high}{unit}, {low} .. {high}{unit})"


def _call(draw: Draw, function: Function, names: Names) -> Call | None:
    """Draw a call of a function of the world; None where the world has nothing for it."""
    taken: list[str] = []
    texts: list[str] = []
    for param in function.params:
        if param.form is Form.SUBJECT:
            subjects = [
                name
                for kind in sorted(param.kinds)
                if kind not in _GROUPS
                for name in names.subjects.get(kind, ())
                if name not in taken
            ]
            subjects += list(names.joints) if Kind.JOINT in param.kinds else []
            if not subjects:
                return None
            taken.append(pick(draw, subjects))
            texts.append(taken[-1])
        elif param.components:
            body = pick(draw, [*names.subjects[Kind.LINK]])
            taken.append(body)
            texts.append(_VECTOR.format(body))
        else:  # x and y of a point
            taken = taken or [pick(draw, [*names.subjects[Kind.LINK]])]
            texts.append(f"position({taken[0]}).{param.name}")
    return Call(function.name, tuple(taken), f"{function.name}({', '.join(texts)})")


# Worlds


def watched(program: Program, sources: Mapping[str, Source]) -> Program:
    """Return the program whose supervisor stores the signals."""
    return replace(program, stored_signals=frozenset(sources))


def readings(environment: Supervisor, sources: Mapping[str, Source]) -> Readings:
    """Return the values of the signals in the last step, or at the reset."""
    return {
        name: np.atleast_1d(np.asarray(getattr(environment, generated.last(name)), float)) for name in sources
    }


def contact_reader(environment: Supervisor) -> Callable[[], bool]:
    """Return a reader of whether anything touched anything in the last step, bound before it."""
    engine, world = environment.engine, environment.scenario.world
    touching = [engine.contact((body.name, None)) for body in (*world.robots, *world.objects)]
    return lambda: any(touched() for touched in touching)


@dataclass(frozen=True)
class Start:
    """The state of a world when an episode begins: the frame and the velocities of each body, and the
    position and the velocity of each joint, in SI units."""

    bodies: Mapping[str, tuple[Frame, tuple[Triple, Triple]]]
    joints: Mapping[tuple[str, str], tuple[float, float]]


def start_of(environment: Supervisor) -> Start:
    """Read the state of a world, for a placement of the same state."""
    world, engine = environment.scenario.world, environment.engine
    bodies = {}
    for body in (*world.robots, *world.objects):
        if " " in body.name:  # a piece of a wall
            continue
        (x, y, z), rotation = engine.pose(body.name)()
        above = z - environment.ground_height(x, y)
        bodies[body.name] = (((x, y, above), rotation), engine.velocity(body.name)())
    joints = {}
    for robot in world.robots:
        free = [joint.name for joint in robot.model.moving_joints if joint.name not in robot.model.followers]
        states = engine.joint_states(robot.name, free)() if free else ()
        joints |= {(robot.name, name): (state[0], state[1]) for name, state in zip(free, states, strict=True)}
    return Start(bodies, joints)


def lively(case: Case, program: Program, start: Start, percent: int = 50) -> Start:
    """Draw a start in which all moves: bodies fly, 3 m higher, and turn; joints are anywhere within their
    ranges. Other starts, by default half of them, stay as they are."""
    if not chance(case.draw, percent):
        return start
    random = np.random.default_rng(case.draw(st.integers(0, 99)))
    world = program.world
    models = {robot.name: robot.model for robot in world.robots}
    flying = {robot.name for robot in world.robots if not robot.fixed_base}
    flying |= {body.name for body in world.objects for form in forms_of(body).values() if is_movable(form)}
    bodies, joints = dict(start.bodies), {}
    for name in sorted(flying & bodies.keys()):
        ((x, y, z), rotation), _ = bodies[name]
        velocity, turning = random.uniform(-1.0, 1.0, (2, 3)).tolist()
        bodies[name] = (((x, y, z + 3.0), rotation), (tuple(velocity), tuple(turning)))
    for robot, name in start.joints:
        low, high = models[robot].joint(name).ends(1.0)
        part = random.uniform(0.3, 0.7)
        joints[robot, name] = (low + part * (high - low), float(random.uniform(-0.5, 0.5)))
    return Start(bodies, joints)


def beginning(program: Program, start: Start) -> Program:
    """Return the program whose episodes begin in a state."""
    span = program.agent.observation[0].value.span

    def constant(owner: str, *values: float) -> Expression:
        components = ("x", "y", "z") if len(values) == 3 else None
        typed = Constant(ValueType(components=components), 0, 0, values)
        return Expression("", span, "", typed, owner, lowered=tuple(Const(float(value)) for value in values))

    fixed = {body.name for body in program.world.robots if body.fixed_base}
    placements = []
    for body, ((position, rotation), (velocity, turning)) in start.bodies.items():
        coordinates = dict(
            zip(
                ("x", "y", "z", "roll", "pitch", "yaw"),
                (*position, *frames.roll_pitch_yaw(rotation)),
                strict=True,
            )
        )
        owner = f"reset.place.{body}"
        place = Placement(
            body, {key: constant(f"{owner}.{key}", value) for key, value in coordinates.items()}, owner=owner
        )
        if body not in fixed and any((*velocity, *turning)):
            place = replace(
                place,
                velocity=constant(f"{owner}.velocity", *velocity),
                angular_velocity=constant(f"{owner}.angular_velocity", *turning),
            )
        placements.append(place)
    joints = tuple(
        JointStart(
            robot, (joint,), constant(f"{robot}.{joint}", position), constant(f"{robot}.{joint}.v", speed)
        )
        for (robot, joint), (position, speed) in start.joints.items()
    )
    return replace(program, reset=Reset(tuple(placements), joints, variations=program.reset.variations))


@contextmanager
def opened(program: Program, engine: str | None = None) -> Iterator[Supervisor]:
    with closing(api.make(program, engine=engine)) as environment:
        yield environment


def prepared(
    case: Case, left_out: Sequence[str] = (), change: Any = None
) -> tuple[Program, dict[str, Source], Start]:
    """Return the program of the world that shows all, its signals, and the state in which its first episode
    begins."""
    data, sources = shown_world(case, left_out)
    if change is not None:
        change(data)
    try:
        compiled = case.compile(case.write(data, "shown.yaml"))
    except ScenarioError:
        case.compile()  # rejects a drawn scenario that is not valid
        raise
    program = watched(compiled.program, sources)
    with opened(program) as environment, reference():
        environment.reset(seed=0)
        start = start_of(environment)
    if any(abs(speed) > MAX_SPEED for _, speed in start.joints.values()):
        reject()
    return program, sources, start
