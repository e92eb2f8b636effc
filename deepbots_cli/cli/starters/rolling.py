"""Tasks for what stands on wheels: drive to a mark, or stay upright."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, degrees, inf

from deepbots_cli import frames
from deepbots_cli.cli.starters.draft import Draft, figure, word
from deepbots_cli.cli.starters.parts import Robot, by_unit, train
from deepbots_cli.cli.starters.survey import Survey, Wheel
from deepbots_cli.frames import Triple
from deepbots_cli.robots.model import Joint

_TILTED = 30  # deg
_UP: Triple = (0.0, 0.0, 1.0)


def drive(survey: Survey, robot: Robot) -> Draft:
    """To a mark that lies somewhere around it."""
    draft = Draft("A robot on wheels drives to a mark.")
    speed = _speed(survey, survey.size)
    field = max(1.0, 4.0 * survey.size)
    heading = degrees(atan2(_forward(survey)[1], _forward(survey)[0]))
    draft.add(
        "parameters", f"top_speed: {figure(speed)} rad/s", f"near: {figure(max(0.5 * survey.size, 0.05))} m    # which counts as there"
    )
    draft.add("world", "timestep: 64 ms", "substeps: 16")
    draft.add("objects", f"mark: {{shape: sphere, radius: {figure(0.1 * survey.size)} m, colour: red, solid: false, fixed: true}}")
    wheels = _motors(survey, robot)
    steered = _steering(survey, robot)
    robot.add("sensors", f"speeds: {{type: joint_velocity, joints: {wheels}}}")
    robot.add("emit", "[speeds]")
    robot.hold(_others(survey))
    draft.add("action", "gas: -1 .. 1", "turn: -1 .. 1    # to the left is positive")
    seen = "bearing(robot, mark)" if abs(heading) < 1 else f"wrap(bearing(robot, mark) - {figure(heading)} deg)    # it drives that way"
    draft.add("augment", "apart: ground_distance(robot, mark)", f"angle: {seen}")
    draft.add("observation", f"apart: 0 .. {figure(3.0 * field)} m", "angle: -180 .. 180 deg", f"robot.speeds: {_range(1.5 * speed)} rad/s")
    draft.add("reward", "closer: -10 * delta(apart) / m    # what was gained in this step", "time:   -0.02", "found:  5 when found")
    draft.add("termination", "success: {found: apart < near}")
    span = figure(field)
    draft.add("truncation", f"max_time: {figure(max(10.0, round(12.0 * field / (speed * survey.wheels[0].radius))))} s")
    draft.add("reset", "place:", f"  mark: {{region: {{x: -{span} .. {span} m, y: -{span} .. {span} m}}, clearance: 10 cm}}")
    robot.into(draft)
    gas = "where(abs(angle) < 90 deg, 1, -0.3)" if steered else "where(abs(angle) < 30 deg, 1, 0)"
    draft.add("scripts", "towards:", f"  gas:  {gas}", "  turn: angle / rad")
    train(draft, "PPO", 300_000, 32)
    return draft


def balance(survey: Survey, robot: Robot) -> Draft:
    """On two wheels of one axle, or a pole on a hinge without a motor."""
    draft = Draft("A robot keeps upright what would fall.")
    tilts = not survey.inverted
    fall = _TILTED if tilts else 15
    draft.add("parameters", f"fall_angle: {fall} deg")
    draft.add("world", "timestep: 20 ms", "substeps: 10")
    draft.add("action", "push: -1 .. 1")
    draft.add("reward", "alive:  1", "effort: -0.1 * push^2")
    failures = []
    if survey.wheels:
        draft.add(
            "parameters", f"top_speed: {figure(_speed(survey, 4.0 * survey.size))} rad/s", "room: 1 m    # that it may roll, either way"
        )
        way = "x" if abs(_forward(survey)[0]) > 0.7 else "y"
        wheels = _motors(survey, robot, turns=False)
        _steering(survey, robot, turns=False)
        draft.add("augment", f"at:    position(robot).{way}", f"speed: velocity(robot).{way}")
        draft.add("observation", "at: -1.2 .. 1.2 m", "speed: -3 .. 3 m/s")
        failures.append("away:   abs(at) > room")
        robot.add("sensors", f"wheel_speeds: {{type: joint_velocity, joints: {wheels}}}")
        draft.add("observation", "robot.wheel_speeds: -60 .. 60 rad/s")
    else:
        failures += _pushed(survey, robot, draft)
    rested = _others(survey) if survey.wheels else ()
    if tilts:
        chassis = word(survey.chassis)
        robot.add("sensors", f"gyro: {{type: gyro, link: {chassis}}}", f"down: {{type: inclinometer, link: {chassis}}}")
        draft.add("observation", "robot.gyro: -5 .. 5 rad/s", "robot.down: -1 .. 1")
        failures.append("fallen: tilt(robot) > fall_angle")
        turn = "pitch" if abs(_forward(survey)[0]) > 0.7 else "roll"
        place = {turn: "uniform(-2 .. 2 deg)"}
    else:
        poles = robot.group("poles", survey.inverted)
        robot.add("sensors", f"angles: {{type: joint_position, joints: {poles}}}", f"rates: {{type: joint_velocity, joints: {poles}}}")
        draft.add("observation", "robot.angles: -20 .. 20 deg", "robot.rates: -3 .. 3 rad/s")
        failures.append("fallen: any(abs(robot.angles) > fall_angle)")
        robot.sets.append(f"robot.{poles}: uniform(-1 .. 1 deg)")
        place = {}
    names = [line.partition(":")[0] for line in robot.parts["sensors"]]
    robot.add("emit", f"[{', '.join(names)}]")
    robot.hold(rested)
    draft.add("termination", "failure:", *(f"  {line}" for line in failures))
    draft.add("truncation", "max_time: 10 s")
    robot.into(draft, place)
    train(draft, "PPO", 200_000, 32)
    return draft


def _pushed(survey: Survey, robot: Robot, draft: Draft) -> list[str]:
    """What has a motor is pushed; what ends an episode then."""
    failures = []
    for name, joints in by_unit(survey.driven):
        group = robot.group(name, joints)
        top, unit = (1.0, "m") if name == "slides" else (3.0, "rad")
        top = min(top, *(joint.limit.velocity or inf for joint in joints))
        robot.motor(f"drive_{name}", "velocity_motor", group, joints, f"push * {figure(top)} {unit}/s")
        robot.add(
            "sensors", f"{name}: {{type: joint_position, joints: {group}}}", f"{name}_speed: {{type: joint_velocity, joints: {group}}}"
        )
        ends = [min(abs(end), 5.0) for joint in joints for end in (joint.limit.lower, joint.limit.upper) if end]
        span = min(ends, default=3.0)
        draft.add("observation", f"robot.{name}: {_range(1.1 * span)} {unit}", f"robot.{name}_speed: {_range(1.5 * top)} {unit}/s")
        if ends:
            failures.append(f"at_end: any(abs(robot.{name}) > {figure(0.95 * span)} {unit})")
    return failures


def _motors(survey: Survey, robot: Robot, *, turns: bool = True) -> str:
    """A velocity motor for the wheels of each side, those whose axle points the other way apart; the group of all."""
    forward = _forward(survey)
    everything = robot.group("wheels", [wheel.joint for wheel in survey.wheels])
    left = frames.cross(_UP, forward)
    steered = bool(survey.steering) or not turns
    middle = sum(frames.dot(wheel.middle, left) for wheel in survey.wheels) / len(survey.wheels)
    groups: dict[tuple[str, bool], list[Wheel]] = {}
    for wheel in survey.wheels:
        off = frames.dot(wheel.middle, left) - middle
        side = "driven" if steered else "middle" if abs(off) < 0.1 * wheel.radius else "left" if off > 0 else "right"
        groups.setdefault((side, frames.dot(wheel.axle, left) < 0), []).append(wheel)
    for (side, mirrored), wheels in groups.items():
        name = f"{side}_wheels" + ("_mirrored" if mirrored and (side, False) in groups else "")
        joints = [wheel.joint for wheel in wheels]
        name, group = ("wheels", everything) if len(groups) == 1 else (name, robot.group(name, joints))
        command = {"left": "clamp(gas - turn, -1 .. 1)", "right": "clamp(gas + turn, -1 .. 1)"}.get(side, "gas") if turns else "push"
        robot.motor(f"drive_{name}", "velocity_motor", group, joints, f"{'-' if mirrored else ''}{command} * top_speed")
    return everything


def _steering(survey: Survey, robot: Robot, *, turns: bool = True) -> bool:
    """Position motors for the hinges that steer; whether there are any."""
    for mirrored in (False, True):
        joints = [joint for joint in survey.steering if (survey.axis(joint)[2] < 0) is mirrored]
        if joints:
            ends = [min(abs(end), 0.5) for joint in joints for end in (joint.limit.lower, joint.limit.upper) if end]
            name = "steering" + ("_mirrored" if mirrored else "")
            angle = f"{'-' if mirrored else ''}turn * {figure(degrees(min(ends, default=0.5)))} deg" if turns else "0 deg"
            robot.motor(name, "position_motor", robot.group(name, joints), joints, angle)
    return bool(survey.steering)


def _others(survey: Survey) -> Sequence[Joint]:
    """The joints with a motor that neither roll nor steer."""
    busy = {wheel.joint for wheel in survey.wheels} | set(survey.steering)
    return [joint for joint in survey.driven if joint not in busy]


def _forward(survey: Survey) -> Triple:
    """The way that it rolls, in the frame of the root: along x rather than against it."""
    axle = survey.wheels[0].axle
    way = frames.cross(axle, _UP)
    return way if way[0] + 0.1 * way[1] > 0 else frames.scaled(way, -1.0)


def _speed(survey: Survey, wanted: float) -> float:
    """Of a wheel in rad/s, for `wanted` m/s or 1.5 m/s at most, within the limits of the file."""
    limits = [wheel.joint.limit.velocity for wheel in survey.wheels if wheel.joint.limit.velocity]
    return min(min(wanted, 1.5) / max(wheel.radius for wheel in survey.wheels), *limits, 60.0)


def _range(end: float) -> str:
    return f"-{figure(end)} .. {figure(end)}"
