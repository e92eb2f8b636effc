"""The tables of `deepbots inspect`: the values of a compiled scenario, a run or a robot file, and the ages
of actions and observations.

A table is a list of rows, or one row; values are in SI units. Expressions are shown as the scenario writes
them: the tree `root` holds its text.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from collections.abc import Mapping as Dictionary
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.compiler.agents import sections_of_agents
from deepbots_cli.compiler.learner import CHOSEN
from deepbots_cli.compiler.robots import joint_moves_link
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.render import render
from deepbots_cli.document import Node
from deepbots_cli.document.nodes import entries_at, node_at, text_at
from deepbots_cli.expressions.scalar import Const, Name, Scalar, State, children, names_in
from deepbots_cli.expressions.text import formula_text
from deepbots_cli.frames import roll_pitch_yaw
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import run_verdict
from deepbots_cli.learning.sb3.defaults import EffectiveHyperparameter, effective_hyperparameters
from deepbots_cli.program import SEPARATOR, Program, identity
from deepbots_cli.program.resets import OfLink, OfSensor, RandomizedParameter
from deepbots_cli.program.robots import (
    Actuator,
    Cartesian,
    MessageField,
    MessageLayout,
    Motor,
    NoiseModel,
    Robot,
    Route,
    Thrust,
)
from deepbots_cli.program.task import (
    ActionNoise,
    ActionRange,
    AdaptiveRate,
    Choices,
    Hindsight,
    ImageObservation,
    Schedule,
)
from deepbots_cli.program.world import whole_timesteps
from deepbots_cli.robots.build import Build
from deepbots_cli.robots.kinds import judge
from deepbots_cli.robots.kinematics import box_sides, resting_height, robot_bounds
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Geometry, Joint, Mesh, RobotModel, Sphere
from deepbots_cli.robots.reader import RobotFile

if TYPE_CHECKING:
    from deepbots_cli.runtime import Supervisor


Row = Dictionary[str, object]
Tables = Dictionary[str, Row | list[Row]]

_DIGITS = 6
"""The number of digits of a pose, for um and udeg."""
_DIRECTIONS = ("to_robot", "from_robot", "between_robots")
_SENSOR_SETTINGS = (
    *("pose", "align", "grid", "spacing"),
    *("noise", "bias", "drift", "range", "resolution", "period", "latency"),
)
"""The keys of a sensor that are shown as they are written."""


def scenario_tables(
    scenario: Program, root: Node, run: Run | None = None, learner: Sequence[str] = ()
) -> Tables:
    """Return the tables of a compiled scenario, and of the run that it comes from; empty ones are left out.

    `learner` are the reasons for a learner that deepbots chose.
    """
    goal = {key: text_at(root, "goal", key) for key in ("achieved", "desired", "tolerance", "range", "noise")}
    return _filled(
        {
            "run": _run(run) if run else {},
            "scenario": _scenario(scenario),
            **_world(scenario),
            "parameters": _parameters(scenario, root),
            "sensors": _sensors(scenario, root),
            **_commands(scenario, root),
            "signals": _signals(scenario, root),
            "goal": {key: text for key, text in goal.items() if text} if scenario.agent.goal else {},
            "observation": _observation(scenario),
            "critic": _critic(scenario),
            "mirror_images": _mirror_images(scenario),
            "timing": timing(scenario),
            **_course(scenario, root),
            **_training(scenario, root, run, learner),
        }
    )


def in_written_units(tables: Tables, scenario: Program, root: Node) -> Tables:
    """Return the tables in the words of the file: draws as it writes them, and ranges of observations and
    actions in its units."""
    units = ShownUnits(root)

    def converted(row: Row) -> Row:
        low, high = row.get("low"), row.get("high")
        if not isinstance(low, float) or not isinstance(high, float):
            return row
        unit = units.of_entry(str(row.get("name", row.get("action", ""))), str(row["unit"]))
        ends = {key: float(f"{unit.from_si(end):.10g}") for key, end in (("low", low), ("high", high))}
        return {**row, **ends, "unit": unit.text}

    changed: Dictionary[str, list[Row]] = {
        section: [converted(row) for row in rows]
        for section, rows in tables.items()
        if section in ("observation", "critic", "action") and isinstance(rows, list)
    }
    drawn = tables.get("drawn", [])
    assert isinstance(drawn, list)
    pairs = zip(drawn, scenario.reset.variations, strict=False)
    rows_in_written_units = [
        row if entry.what == "color" else {**row, "from": " ".join(entry.value.text.split())}
        for row, entry in pairs
    ]
    return {**tables, **changed, **({"drawn": rows_in_written_units} if rows_in_written_units else {})}


def robot_tables(file: RobotFile, findings: list[Finding]) -> Tables:
    """Return the tables of a robot file: the whole, its links and joints, and the findings; all joints are at
    0."""
    model = file.model
    listed = json.loads(render(findings, "json"))
    return _filled(
        {
            "robot": {
                "name": model.name,
                "file": file.source.name,
                "kind": str(judge(Build(model))),
                "digest": file.digest,
                **_counts(model),
                "size_m": [round(side, 6) for side in box_sides(robot_bounds(model))],
                "root_above_ground_m": round(resting_height(model), 6) + 0.0,  # no -0
                "meshes": len(file.meshes),
            },
            "links": link_rows(model),
            "joints": [_joint(joint, whole=True) for joint in model.joints],
            "findings": [
                {key: row[key] for key in ("code", "severity", "file", "line", "message") if key in row}
                for row in (listed["findings"] if isinstance(listed, dict) else listed)
            ],
        }
    )


def _filled(tables: Dictionary[str, Row | list[Row]]) -> Tables:
    return {name: rows for name, rows in tables.items() if rows}


# Robots


def _counts(model: RobotModel) -> Row:
    return {
        "root": model.root,
        "links": len(model.links),
        "joints": len(model.joints),
        "moving_joints": len(model.moving_joints),
        "mass_kg": model.mass,
    }


def _drawn_mass(scenario: Program, robot: str) -> Row:
    """Return a mark where `mass_kg` is the mean of masses that are drawn in every episode."""
    is_drawn = any(entry.what == "mass" and entry.of[:1] == (robot,) for entry in scenario.reset.variations)
    return {"mass": "the mean; drawn in every episode"} if is_drawn else {}


def link_rows(model: RobotModel) -> list[Row]:
    """Return the links of a robot, each with the joint that moves it, its mass and its shapes in m."""
    above = {joint.child: joint.name for joint in model.joints}
    return [
        {
            "link": link.name,
            "joint": above.get(link.name, ""),
            "mass_kg": link.inertial.mass if link.inertial else None,
            "collides_as": [_shape(geometry) for geometry in link.collisions],
            "seen_as": [_shape(geometry) for geometry in link.visuals],
            "friction": link.friction.lateral,
        }
        for link in model.links
    ]


def _shape(geometry: Geometry) -> str:
    match geometry.shape:
        case Box(size):
            return f"box {_numbers(size)}"
        case Sphere(radius):
            return f"sphere r {radius:.4g}"
        case Cylinder(radius, length):
            return f"cylinder r {radius:.4g} l {length:.4g}"
        case Capsule(radius, length):
            return f"capsule r {radius:.4g} l {length:.4g}"
        case Mesh(path=path):
            return f"mesh {Path(path).name}"


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value:.4g}" for value in values)


def _joint(joint: Joint, *, whole: bool = False) -> Row:
    """Return a joint and its limits; as a `whole` with its origin, damping and friction."""
    limit, unit = joint.limit, "m" if joint.type == "prismatic" else "rad"
    more: Row = {
        "damping": joint.damping or None,
        "friction": joint.friction or None,
        "armature": joint.armature or None,
        "follows": _law(joint),
    }
    return {
        "joint": joint.name,
        "type": joint.type,
        "parent": joint.parent,
        "child": joint.child,
        **({"origin_m": _numbers(joint.origin.xyz)} if whole else {}),
        "axis": _numbers(joint.axis) if joint.moves else "",
        "unit": unit if joint.moves else "",
        "lower": limit.lower,
        "upper": limit.upper,
        "max_velocity": limit.velocity,
        "max_effort": limit.effort,
        **(more if whole else {}),
    }


def _law(joint: Joint) -> str:
    """Return the law of a joint that follows another one, such as `-1 * left + 0.01`."""
    if joint.mimic is None:
        return ""
    law = f"{joint.mimic.multiplier:.4g} * {joint.mimic.joint}"
    if not joint.mimic.offset:
        return law
    sign = "-" if joint.mimic.offset < 0.0 else "+"
    return f"{law} {sign} {abs(joint.mimic.offset):.4g}"


# Scenarios


def _run(run: Run) -> Row:
    """Return the row of a run, and the progress of its training. Steps count over all copies of the
    environment."""
    record, result, best = run.record, run.record.result, run.model("best")
    verdict = {True: "yes", False: "no", None: "unknown"}[run_verdict(run.path, record).solved]
    fields = ("status", "source", "seed", "engine", "deepbots", "started", "updated", "total_timesteps")
    return {
        "run": str(run.path),
        "command": " ".join(record.command),
        **{name: getattr(record, name) for name in fields},
        **{name: result and getattr(result, name) for name in ("steps", "episodes", "mean_return")},
        "success_rate": result.success_rate if result and run.program.defines_success else None,
        "best_model": str(best) if best.is_file() else None,
        "best_chosen": result.best.text if result and result.best else None,
        "solved": verdict if run.program.agent.solved else "the scenario has no `solved` criterion",
        "notes": run.notes(),
    }


def _scenario(scenario: Program) -> Row:
    world = scenario.world
    return {
        "name": scenario.name,
        "summary": scenario.summary,
        "digest": identity.digest(scenario),
        "timestep_s": world.timestep,
        "substeps": world.substeps,
        "physics_step_s": world.timestep / world.substeps,
        "gravity": list(world.gravity),
        "messages": scenario.format,
        "message_timing": scenario.timing,
        "observation_space": _view(scenario),
        "action_space": _space(scenario),
        "max_steps": scenario.truncation.max_steps,
        "max_time_s": scenario.truncation.max_time,
        "copies": f"{copies.count} of {copies.robot}" if (copies := scenario.agent.copies) else None,
        "solved": scenario.agent.solved.description if scenario.agent.solved else "",
    }


def _view(scenario: Program) -> str:
    numbers = len(scenario.agent.seen)
    parts = [f"Box({numbers})"] if numbers or not scenario.agent.images else []
    parts += [f"{entry.key} {_image_size_text(entry, scenario)}" for entry in scenario.agent.images]
    if scenario.agent.goal is not None:
        parts.append(f"two goals of {len(scenario.agent.goal.low)}")
    return ", ".join(parts)


def _image_size_text(entry: ImageObservation, scenario: Program) -> str:
    rows, columns, channels = entry.shape
    return f"{rows} x {columns} x {channels * len(entry.ages(scenario.agent.frame_stack))}"


def _space(scenario: Program) -> str:
    sizes = [len(choice.options) for choice in scenario.agent.choices]
    width = len(scenario.agent.range_names)
    spaces = [f"Box({width})"] if width else []
    if sizes:
        spaces.append(
            f"Discrete({sizes[0]})" if len(sizes) == 1 else f"MultiDiscrete({', '.join(map(str, sizes))})"
        )
    return " and ".join(spaces)


def _world(scenario: Program) -> Tables:
    """Return the tables of draws, robots and objects."""
    return {
        "drawn": [
            {
                "drawn": entry.what.replace("_", " "),
                "of": ".".join(filter(None, entry.of)),
                "from": _draws(entry),
            }
            for entry in scenario.reset.variations
        ],
        "robots": [
            {
                "robot": body.name,
                "model": body.model.name,
                **_counts(body.model),
                **_drawn_mass(scenario, body.name),
                "base": "fixed" if body.fixed_base else "free",
            }
            for body in scenario.world.robots
        ],
        "links": [
            {"robot": body.name, **row} for body in scenario.world.robots for row in link_rows(body.model)
        ],
        "joints": [
            {"robot": body.name, **_joint(joint)}
            for body in scenario.world.robots
            for joint in body.model.joints
        ],
        "objects": _objects(scenario),
    }


def _commands(scenario: Program, root: Node) -> Tables:
    """Return the tables from the action of the agent to the actuators, with the messages in between."""
    return {
        "actuators": [
            row
            for robot in scenario.robots
            for actuator in robot.actuators
            for row in _driven_parts(robot.name, actuator)
        ],
        "messages": [_message(layout, scenario.format) for layout in _layouts(scenario)],
        "message_fields": [_field(layout, field) for layout in _layouts(scenario) for field in layout.fields],
        "routes": [row for direction in _DIRECTIONS for row in _route(root, direction)],
        "action": [_action(part) for part in scenario.agent.action],
    }


def _ending(scenario: Program, root: Node, name: str) -> Row:
    """Return the row of an ending: what it is for the agent, or for each of several agents."""
    outcome = "success" if name in scenario.agent.success else "failure"
    of_agents = {
        agent: "success" if name in member.program.agent.success else "failure"
        for agent, member in scenario.members.items()
    }
    when = text_at(root, "endings", name, "when") or text_at(root, "termination", outcome, name)
    return {"ending": name, **(of_agents or {"outcome": outcome}), "when": when}


def _course(scenario: Program, root: Node) -> Tables:
    """Return the tables of reward, endings and starts of the episodes, and of the changes between them."""
    agents = sections_of_agents(root)
    return {
        "reward": [
            {"term": term.name, "is": _own_text(root, agents, "reward", term.name)}
            for term in scenario.agent.reward
        ],
        "endings": [_ending(scenario, root, ending.name) for ending in scenario.endings],
        "reset": _reset(scenario, root),
        "cases": [
            {"case": case.name, "set": text_at(root, "evaluation", "cases", case.name, "set")}
            for case in scenario.cases
        ],
        "curriculum": [
            {
                "stage": stage.name,
                **{key: text_at(root, "curriculum", index, key) for key in ("set", "until")},
            }
            for index, stage in enumerate(scenario.curriculum)
        ],
        "levels": [
            {"level": level, **{name: values[level] for name, values in levels.values}}
            for levels in ([scenario.levels] if scenario.levels else [])
            for level in range(levels.count)
        ],
        "scripts": [
            {
                "script": script.name,
                "action": part.name,
                "is": _own_text(root, agents, "scripts", script.name, part.name),
            }
            for script in scenario.agent.scripts
            for part in scenario.agent.action
            if not agents or _agent_of(script.name) == _agent_of(part.name)
        ],
    }


def _agent_of(name: str) -> str:
    return name.partition(SEPARATOR)[0]


def _own_text(root: Node, agents: Mapping[str, Node], section: str, *names: str) -> str:
    """Return the text of an entry; the name of one of several agents begins with the agent."""
    agent = _agent_of(names[0])
    if agent not in agents or agent == names[0]:
        return text_at(root, section, *names)
    return text_at(agents[agent], section, *(name.removeprefix(f"{agent}{SEPARATOR}") for name in names))


def _objects(scenario: Program) -> list[Row]:
    drawn = {(entry.of, entry.what): _draws(entry) for entry in scenario.reset.variations}
    return [
        {
            "object": body.name,
            "shape": type(body.shape).__name__.lower(),
            "mass_kg": drawn.get((OfLink(body.name), "mass"), body.mass),
            "fixed": body.fixed,
            "solid": body.solid,
            "friction": drawn.get((OfLink(body.name), "lateral_friction"), body.friction),
        }
        for body in scenario.world.objects
    ]


def _draws(entry: RandomizedParameter) -> str:
    """Return the expressions that are drawn; a single one if all components or parts have the same."""
    if entry.what == "color":
        return f"one of {(len(entry.scalars) - 1) // 3} colors"
    return ", ".join(dict.fromkeys(formula_text(value, digits=5) for value in entry.scalars))


def _parameters(scenario: Program, root: Node) -> list[Row]:
    how_often = ("in every episode", "repeatedly", "in every step")
    often: dict[str, int] = {}
    for entry in scenario.parameters:
        reads = [often.get(leaf.name, 0) for value in entry.scalars for leaf in names_in(value)]
        often[entry.name] = 1 if entry.period else max([2 if entry.redraw else 0, *reads])
    names = entries_at(root, "parameters")
    return [
        {
            "parameter": name,
            "value": text_at(root, "parameters", name),
            "drawn": how_often[often[name]] if name in often else "never",
        }
        for name in names
    ]


def _sensors(scenario: Program, root: Node) -> list[Row]:
    return [
        {
            "robot": robot.name,
            "sensor": sensor.name,
            "type": sensor.kind,
            "of": list(sensor.subjects),
            "unit": sensor.unit,
            **{
                key: text_at(root, "robots", robot.name.partition("#")[0], "sensors", sensor.name, key)
                for key in _SENSOR_SETTINGS
            },
        }
        for robot in scenario.robots
        for sensor in robot.sensors
    ]


def _driven_parts(robot: str, actuator: Actuator) -> list[Row]:
    """Return one row for each part that an actuator drives; all have the same columns."""
    parts: Iterable[tuple[str, float | None, float | None]]
    if isinstance(actuator, Thrust):
        kind = "thrust"
        parts = ((link, None, None) for link in actuator.links)
        thrust = [actuator.low, actuator.high]
    else:
        kind, thrust = "cartesian" if isinstance(actuator, Cartesian) else actuator.kind, None
        parts = zip(actuator.joints, actuator.max_torque, actuator.max_velocity, strict=True)
    response = actuator.response
    strength = response.strength if response.strength != 1.0 else None
    motor = actuator if isinstance(actuator, Motor) else None
    answers: Row = {
        "stall_torque": motor.stall_torque if motor else None,
        "no_load_speed": motor.no_load_speed if motor else None,
        "strength": strength,
        "delay_s": response.delay or None,
        "time_constant_s": response.time_constant or None,
    }
    described: Row = {"robot": robot, "actuator": actuator.name, "type": kind}
    return [
        {**described, "part": part, "max_torque": torque, "max_velocity": speed, "thrust": thrust, **answers}
        for part, torque, speed in parts
    ]


def end_links(scenario: Program) -> list[tuple[str, str]]:
    """Return robots and their links whose pose at the start is of interest: those that `cartesian` actuators
    or position sensors name.

    For a robot without any, these are the last links below a joint that the reset sets.
    """
    links: list[tuple[str, str]] = []
    models = {body.name: body.model for body in scenario.world.robots}
    for robot in scenario.robots:
        model = models[robot.name]
        robot_links = [actuator.link for actuator in robot.actuators if isinstance(actuator, Cartesian)]
        robot_links += [
            link
            for sensor in robot.sensors
            if sensor.kind == "position"
            for link in sensor.subjects
            if link != model.root
        ]
        if not robot_links:
            moved_joints = [
                model.joint(joint)
                for start in scenario.reset.joint_starts
                if start.robot == robot.name
                for joint in start.joints
            ]
            parents = {joint.parent for joint in model.joints}
            leaves = [link.name for link in model.links if link.name not in parents]
            robot_links = [
                leaf for leaf in leaves if any(joint_moves_link(model, joint, leaf) for joint in moved_joints)
            ]
        links += [(robot.name, link) for link in dict.fromkeys(robot_links)]
    return links


def poses(environment: Supervisor, links: list[tuple[str, str]]) -> list[Row]:
    """Return the present poses of links in the world frame; with copies of a robot, those of the first."""
    engine = next(iter(environment.agents.values())).engine
    rows: list[Row] = []
    for robot, link in links:
        position, orientation = engine.pose(robot, link)()
        angles = [_rounded(math.degrees(angle)) for angle in roll_pitch_yaw(orientation)]
        # Half a turn is 180 deg, regardless of its sign.
        values = [*map(_rounded, position), *(180.0 if angle == -180.0 else angle for angle in angles)]
        columns = zip(("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg"), values, strict=True)
        rows.append({"robot": robot, "link": link, **dict(columns)})
    return rows


def _rounded(value: float) -> float:
    """Round without negative zeros."""
    return round(value, _DIGITS) + 0.0


def _layouts(scenario: Program) -> list[MessageLayout]:
    robots = scenario.robots if scenario.format != "none" else ()
    return [layout for robot in robots for layout in (robot.to_robot, robot.from_robot)]


def _message(layout: MessageLayout, format: str) -> Row:
    return {
        "robot": layout.robot,
        "direction": layout.direction.replace("_", " "),
        "format": format,
        "values": sum(max(1, len(field.components)) for field in layout.fields),
        "layout_hash": f"{layout.layout_hash:08x}",
        "bytes": message_size(layout, format) or "varies",
    }


def message_size(layout: MessageLayout, format: str) -> int | None:
    """Return the number of bytes of a message: the stamp and the values; None if it depends on the digits of
    the values."""
    if format not in ("struct", "msgpack"):
        return None
    from deepbots_cli.runtime.messages import codec, zero_values

    return len(codec(layout, format).encode(*zero_values(layout)))


def _field(layout: MessageLayout, field: MessageField) -> Row:
    return {
        "robot": layout.robot,
        "direction": layout.direction.replace("_", " "),
        "field": field.name,
        "components": list(field.components),
        "dtype": field.dtype + "".join(f" x {count}" for count in field.shape),
        "unit": field.unit,
    }


def _route(root: Node, direction: str) -> list[Row]:
    """Return the settings of the scenario about the way of messages, if any."""
    row: Row = {
        key: text_at(root, "messages", direction, key)
        for key in ("latency", "loss", "burst", "range", "order", "on_loss")
    }
    return [{"direction": direction.replace("_", " "), **row}] if any(row.values()) else []


def _action(part: Choices | ActionRange) -> Row:
    if isinstance(part, ActionRange):
        return {
            "action": part.name,
            "kind": "range",
            "of": list(part.components),
            "low": part.low,
            "high": part.high,
            "unit": part.unit,
        }
    options = [
        (
            option.name,
            (f"{name} = {value:g}" for name, value in zip(part.variables, option.values, strict=True)),
        )
        for option in part.options
    ]
    texts = (f"{name} ({', '.join(values)})" for name, values in options)
    return {"action": part.name, "kind": "choice", "options": " | ".join(texts)}


def _signals(scenario: Program, root: Node) -> list[Row]:
    observed = {entry.full_name.partition(".")[0] for entry in scenario.agent.numbers}
    has_noise = any(entry.noise for entry in scenario.signals)
    written = partial(_own_text, root, sections_of_agents(root))
    rows: list[Row] = []
    for entry in scenario.signals:
        augmented = written("augment", entry.name, "value") or written("augment", entry.name)
        rows.append(
            {
                "signal": entry.name,
                "components": list(entry.components),
                "is": augmented or written("signals", entry.name),
                **({"noise": written("augment", entry.name, "noise")} if has_noise else {}),
                "policy_may_see_it": bool(augmented) or entry.name in observed,
            }
        )
    return rows


def _observation(scenario: Program) -> list[Row]:
    """Return a row per observed number; with histories, with its age in steps before the last one."""
    entries = [(scenario.agent.numbers[index], ago) for index, ago in scenario.agent.seen]
    remembers = any(ago for _, ago in entries)
    rows: list[Row] = []
    for index, (entry, ago) in enumerate(entries):
        bounds = "-1 .. 1" if entry.clip else "-1 .. 1, not clipped"
        rows.append(
            {
                "index": index,
                "name": entry.full_name,
                **({"steps_ago": ago} if remembers else {}),
                "low": entry.low,
                "high": entry.high,
                "unit": entry.unit,
                "seen_as": "0 or 1" if entry.is_truth else bounds,
            }
        )
    images = [(entry.key, _image_size_text(entry, scenario)) for entry in scenario.agent.images]
    return rows + [{"index": None, "name": key, "seen_as": f"{size} of 0 .. 255"} for key, size in images]


def _critic(scenario: Program) -> list[Row]:
    """Return a row per number that only the critic gets, in the order of its observation in a training."""
    wide = scenario.with_critic
    columns = set(wide.agent.policy_columns or range(len(wide.agent.inputs)))
    return [
        {key: value for key, value in row.items() if key != "index"}
        for index, row in enumerate(_observation(wide))
        if index < len(wide.agent.inputs) and index not in columns
    ]


def _mirror_images(scenario: Program) -> list[Row]:
    """Return a row per number of the observation and the action, and per option, with its mirror image and
    the sign of that; none without `symmetry`."""
    members = {name: member.program for name, member in scenario.members.items()} or {"": scenario}
    return [
        {**({"agent": name} if name else {}), **row}
        for name, program in members.items()
        for row in _mirror_images_of(program)
    ]


def _mirror_images_of(scenario: Program) -> Iterator[Row]:
    training = scenario.agent.training
    if training is None or training.symmetry is None:
        return
    symmetry = training.symmetry
    inputs = scenario.with_critic.agent.inputs
    observed = [f"{entry.name}{f', {ago} steps ago' if (ago := entry.steps_ago) else ''}" for entry in inputs]
    acted = list(scenario.agent.range_names)
    for section, names, mirror in (
        ("observation", observed, symmetry.observation),
        ("action", acted, symmetry.ranges),
    ):
        for name, source, factor in zip(names, mirror.sources, mirror.factors, strict=True):
            yield {
                "of": section,
                "name": name,
                "mirror_image": names[source],
                "sign": -1 if factor < 0 else 1,
            }
    choices = scenario.agent.choices
    for choice, source, options in zip(choices, symmetry.choices, symmetry.options, strict=True):
        for option, image in zip(choices[source].options, options, strict=True):
            image_name = f"{choice.name}.{choice.options[image].name}"
            yield {
                "of": "action",
                "name": f"{choices[source].name}.{option.name}",
                "mirror_image": image_name,
            }


def _reset(scenario: Program, root: Node) -> list[Row]:
    settle: list[Row] = (
        [{"reset": "settle", "of": "everything", "to": f"{scenario.reset.settle:g} s"}]
        if scenario.reset.settle
        else []
    )
    return [
        {"reset": section, "of": name, "to": text_at(root, "reset", section, name)}
        for section in ("place", "joints")
        for name in entries_at(root, "reset", section)
    ] + settle


def _training(scenario: Program, root: Node, run: Run | None, learner: Sequence[str]) -> Tables:
    """Return the training, and its hyperparameters with the source of each value."""

    def source(name: str) -> str:
        node = node_at(root, "train", *name.split("."))
        return "deepbots" if node is None or node.span.source.name == CHOSEN else "scenario"

    training = scenario.agent.training
    if training is None:
        return {}
    total = run.record.total_timesteps if run else training.total_timesteps
    network = {"network.hidden": training.network.hidden, "network.activation": training.network.activation}
    rows = [
        EffectiveHyperparameter(name, value, source(name))
        for name, value in {"environments": training.environments, **network}.items()
    ]
    rows += [
        row._replace(source=source(row.name)) if row.source == "scenario" else row
        for row in effective_hyperparameters(scenario, total)
    ]
    about = {
        "algorithm": training.algorithm,
        "total_timesteps": total,
        "evaluation_episodes": scenario.evaluation_episodes(),
    }
    about |= {"chosen": "; ".join(learner)} if learner else {}
    listed: list[Row] = [
        {"hyperparameter": row.name, "value": _setting(row.value), "from": row.source} for row in rows
    ]
    return {"training": about, "hyperparameters": listed}


def _setting(value: object) -> object:
    match value:
        case Schedule(start=start, end=end):
            return start if start == end else value.text
        case AdaptiveRate(kl=kl, start=start):
            return f"{{kl: {kl:g}, start: {start:g}}}"
        case ActionNoise(type=kind, sigma=sigma, theta=theta):
            drift = f", theta: {theta:g}" if kind == "ornstein_uhlenbeck" else ""
            return f"{{type: {kind}, sigma: {_setting(sigma)}{drift}}}"
        case Hindsight(goals=goals, strategy=strategy):
            return f"{{type: her, n_sampled_goal: {goals}, goal_selection_strategy: {strategy}}}"
        case tuple():
            return list(value)
        case _:
            return value


Ages = dict[str, float]
"""The age of each named value in timesteps; infinite where it varies."""


def timing(scenario: Program) -> list[Mapping[str, object]]:
    """Return, for step n of the agent, from 0, the physics step from which its action acts, and the one after
    which each observation is measured.

    Physics steps count from 1 in each episode. An observation is as old as the oldest value
    that it is computed from: routes, `timing: delayed`, the latency of sensors and `previous` add to its age.
    Other functions with a memory (`delta`, `low_pass`) have the age of their argument. The age varies where a
    delay is drawn, messages may be lost, or a sensor measures less often than the supervisor.
    """
    substeps, timestep, repeat = scenario.world.substeps, scenario.world.timestep, scenario.action_repeat
    rows: list[Mapping[str, object]] = []
    for part in scenario.agent.action:
        routes, waits = [], [0.0]
        for robot in scenario.robots:
            if {*part.variables} & {entry.name for entry in robot.received}:
                routes.append(robot.to_route)
            waits += [
                _wait(scenario, robot.name, command.actuator)
                for command in robot.commands
                if {*part.variables} & {leaf.name for value in command.scalars for leaf in names_in(value)}
            ]
        steps = _whole(substeps * _slowest(scenario, routes) + max(waits))
        acts = "varies" if steps is None else f"{substeps * repeat}n + {steps + 1}"
        age = None if steps is None else steps * timestep / substeps
        rows.append(
            {"what": "action", "name": part.name, "moment": "acts from", "physics_step": acts, "age_s": age}
        )
    senders: dict[str, frozenset[str]] = {}
    sent: Ages = {}
    ages: Ages = {}
    for robot in scenario.robots:
        made = {f"{robot.name}.{name}": age for name, age in _sent(scenario, robot).items()}
        senders |= dict.fromkeys(made, frozenset({robot.name}))
        sent |= made
        ages |= {name: _slowest(scenario, [robot.from_route]) + age for name, age in made.items()}
    for link in scenario.links:
        delay = 1 + _delay(scenario, link.route)
        heard = {f"{link.receiver}.{value.name}": _oldest(value.scalars, sent) for value in link.values}
        senders |= dict.fromkeys(heard, frozenset({link.sender}))
        ages |= {name: delay + age for name, age in heard.items()}
    for signal in scenario.signals:  # in order of evaluation, so what a signal reads is known
        ages[signal.name] = _oldest(signal.scalars, ages)
        senders[signal.name] = _senders(signal.scalars, senders)
    observed = [(entry.full_name, entry.scalar) for entry in scenario.agent.numbers]
    observed += [(entry.name, entry.value.scalar) for entry in scenario.agent.images]
    for name, scalar in observed:
        ticks = _whole(_age(scalar, ages))
        after = 0 if ticks is None else substeps * (repeat - ticks)
        behind = f" {'-' if after < 0 else '+'} {abs(after)}" if after else ""
        rows.append(
            {
                "what": "observation",
                "name": name,
                "moment": "measured after",
                "physics_step": "varies" if ticks is None else f"{substeps * repeat}n{behind}",
                "age_s": None if ticks is None else ticks * timestep,
                "by": ", ".join(sorted(_senders((scalar,), senders))) or "supervisor",
            }
        )
    return rows


def _whole(ticks: float) -> int | None:
    return None if math.isinf(ticks) else int(ticks)


def _sent(scenario: Program, robot: Robot) -> Ages:
    """Return the ages of the values that a robot sends, when it sends them."""
    varied = {
        entry.of.sensor
        for entry in scenario.reset.variations
        if isinstance(entry.of, OfSensor) and (entry.of.robot, entry.of.field) == (robot.name, "latency")
    }
    sensed = {
        sensor.name: math.inf
        if sensor.name in varied or faults.period > 1
        else float(whole_timesteps(faults.latency, scenario.world.timestep))
        for sensor in robot.sensors
        for faults in (sensor.faults or NoiseModel(),)
    }
    return {entry.name: _oldest(entry.scalars, sensed) for entry in robot.emitted}


def _wait(scenario: Program, robot: str, actuator: Actuator) -> float:
    """Return the physics steps from a command to its effect; infinite if its delay is drawn."""
    is_drawn = any(
        entry.of == (robot, actuator.name) and entry.what == "actuator_delay"
        for entry in scenario.reset.variations
    )
    substep = scenario.world.timestep / scenario.world.substeps
    return math.inf if is_drawn else whole_timesteps(actuator.response.delay, substep)


def _slowest(scenario: Program, routes: Iterable[Route]) -> float:
    """Return the ticks of the slowest route, 0 without one; infinite if that varies."""
    if scenario.format == "none":
        return 0
    late = scenario.timing == "delayed"
    return max((late + _delay(scenario, route) for route in routes), default=0.0)


def _delay(scenario: Program, route: Route) -> float:
    """Return the ticks of the latency of a route; infinite if messages are late by chance or may be lost."""
    latency = route.latency.scalar if route.latency else Const(0.0)
    if not isinstance(latency, Const) or route.loses or route.range is not None:
        return math.inf
    return whole_timesteps(latency.value, scenario.world.timestep)


def _oldest(values: Sequence[Scalar], ages: Ages) -> float:
    return max((_age(value, ages) for value in values), default=0.0)


def _age(scalar: Scalar, ages: Ages) -> float:
    """Return the ticks since the oldest input of a value was measured."""
    if isinstance(scalar, Name):
        return ages.get(scalar.name, 0.0)
    late = 1.0 if isinstance(scalar, State) and scalar.function == "previous" else 0.0
    return late + _oldest(children(scalar), ages)


def _senders(values: Iterable[Scalar], senders: dict[str, frozenset[str]]) -> frozenset[str]:
    """Return the robots whose messages the values are computed from."""
    return frozenset().union(
        *(senders.get(leaf.name, frozenset()) for value in values for leaf in names_in(value))
    )
