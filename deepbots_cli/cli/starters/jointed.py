"""Tasks for what has limbs: reach for a place, walk, get about, or take up a posture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from math import hypot, radians

from deepbots_cli import frames
from deepbots_cli.cli.starters.draft import Draft, figure, word
from deepbots_cli.cli.starters.limbs import Limb, Positions, bring, centre, swing
from deepbots_cli.cli.starters.parts import Robot, by_unit, train
from deepbots_cli.cli.starters.survey import Survey
from deepbots_cli.frames import Quaternion, Triple, quaternion

_SIDES: Sequence[Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0))
_CLOSE = 0.02  # of its reach: so near a search must get
_CROUCHED = 0.75  # of its reach: how long a leg is made


def reach(survey: Survey, robot: Robot) -> Draft | None:
    """Bring the end of an arm to a place in space; nothing where no box of places is found that it can reach."""
    limb = survey.limbs[0]
    arm = [joint for joint in limb.moving if joint in survey.driven]
    found = next(_boxes(survey, limb), None)
    if found is None or len(arm) < len(limb.moving) or any(joint.type == "prismatic" for joint in arm):
        return None
    box, positions = found
    draft = Draft("An arm brings its end to a place in space.")
    draft.remarks.append("Each corner of the box that `target` is drawn from was reached from `ready` when this was written.")
    group = robot.group("arm", arm)
    robot.begin(group, "ready", positions, arm)
    robot.add("sensors", f"angles: {{type: joint_position, joints: {group}}}", f"tip: {{type: position, link: {word(limb.end)}}}")
    robot.add("emit", "[angles, tip]")
    robot.motor("motors", "position_motor", group, arm, "angles + stride * move    # each joint goes on from where it is")
    robot.hold([joint for joint in survey.driven if joint not in arm])
    low, high = (_vector(frames.add(corner, (0.0, 0.0, robot.height))) for corner in box)
    draft.add(
        "parameters",
        "stride: 0.05 rad    # what a joint turns by in a step, at most",
        f"precision: {figure(0.03 * limb.reach)} m    # so near is there",
        f"target: uniform({low} .. {high} m)    # drawn anew in every episode",
    )
    draft.add("world", "timestep: 40 ms", "substeps: 10")
    radius = figure(0.015 * limb.reach)
    draft.add("objects", f"mark: {{shape: sphere, radius: {radius} m, colour: red, solid: false, fixed: true, pose: {{xyz: target}}}}")
    draft.add("action", f"move: {{range: -1 .. 1, each: robot.{group}}}")
    draft.add("augment", "miss: target - robot.tip")
    bounded = all(joint.type != "continuous" and joint.limit.lower is not None and joint.limit.upper is not None for joint in arm)
    span = figure(1.2 * limb.reach)
    draft.add("observation", f"robot.angles: {'auto' if bounded else '-4 .. 4 rad'}", f"miss: -{span} .. {span} m")
    draft.add("signals", "away: norm(miss)")
    draft.add("reward", "closer:  -10 * delta(away) / m    # what was gained in this step", "time:    -0.02", "reached: 5 when reached")
    draft.add("termination", "success: {reached: away < precision}")
    draft.add("truncation", "max_steps: 150")
    robot.into(draft)
    train(draft, "TD3", 40_000, 128)
    return draft


def walk(survey: Survey, robot: Robot) -> Draft:
    """Along the line that most of the hips lie on, x or y, on legs."""
    draft = Draft("A robot on legs walks forwards.")
    turn, legs = _upright(survey), [joint for limb in survey.limbs for joint in limb.moving if joint in survey.driven]
    tilt = quaternion(radians(turn[0]), radians(turn[1]), 0.0)
    positions = _standing(survey, tilt)
    height, way = survey.height(positions, tilt), _way(survey, tilt)
    draft.add(
        "parameters",
        "swing: 0.3 rad    # that a joint leaves its posture by, at most",
        f"low: {figure(0.5 * height)} m    # so low is down",
    )
    draft.add("world", "timestep: 20 ms", "substeps: 10")
    group = robot.group("legs", legs)
    chassis = word(survey.chassis)
    robot.begin(group, "stand", positions, legs)
    robot.add(
        "sensors",
        f"angles: {{type: joint_position, joints: {group}}}",
        f"rates: {{type: joint_velocity, joints: {group}}}",
        f"gyro: {{type: gyro, link: {chassis}}}",
        f"down: {{type: inclinometer, link: {chassis}}}",
    )
    robot.add("emit", "{angles: angles - stand, rates: rates, gyro: gyro, down: down}")
    robot.motor("motors", "position_motor", group, legs, "stand + swing * stride")
    robot.hold([joint for joint in survey.driven if joint not in legs])
    draft.add("action", f"stride: {{range: -1 .. 1, each: robot.{group}}}")
    draft.add("augment", "v: velocity(robot)")
    draft.add("observation", "v: -2 .. 2 m/s", "robot.down: -1 .. 1", "robot.gyro: -8 .. 8 rad/s", "robot.angles: -1 .. 1 rad")
    draft.add("observation", "robot.rates: -20 .. 20 rad/s", "previous_action: auto")
    draft.add("reward", f"forward: clamp(v.{way} / (m/s), -1 .. 1)", "alive:   0.2", "jerk:    -0.05 * mean(delta(stride)^2)")
    draft.add("termination", "failure: {fell: duration(position(robot).z < low) > 0.2 s}")
    draft.add("truncation", "max_time: 10 s")
    place = {
        "z": f"{figure(height * 1.02)} m",
        **{name: f"{figure(angle)} deg" for name, angle in zip(("roll", "pitch"), turn, strict=True) if angle},
        "yaw": "uniform(-5 .. 5 deg)",
    }
    draft.add("reset", "settle: 0.3 s    # it lands before the episode begins")
    robot.into(draft, place)
    draft.remarks.append(f"Forwards is along {way}, the longer way from hip to hip; which end is the front, the file does not say.")
    draft.remarks.append("Its legs were bent so that the feet are below the hips; a better posture is worth more than a longer training.")
    train(draft, "PPO", 2_000_000, 128)
    return draft


def roam(survey: Survey, robot: Robot) -> Draft:
    """Get away from where it is, by whatever joints there are."""
    draft = Draft("A free body gets about by its joints.")
    draft.add("world", "timestep: 32 ms", "substeps: 8")
    chassis = word(survey.chassis)
    robot.add("sensors", f"gyro: {{type: gyro, link: {chassis}}}", f"down: {{type: inclinometer, link: {chassis}}}")
    for name, joints in by_unit(survey.driven):
        unit = "m" if name == "slides" else "rad"
        endless = [joint for joint in joints if joint.type == "continuous" or joint.limit.lower is None]
        others = [joint for joint in joints if joint not in endless]
        if endless:
            top = min(10.0, *(joint.limit.velocity or 10.0 for joint in endless))
            group = robot.group(f"turning_{name}", endless)
            robot.motor(f"spin_{name}", "velocity_motor", group, endless, f"spin_{name} * {figure(top)} {unit}/s")
            draft.add("action", f"spin_{name}: {{range: -1 .. 1, each: robot.{group}}}")
        if others:
            group = robot.group(f"bending_{name}", others)
            at = robot.begin(group, f"rest_{name}", {joint.name: centre(joint) for joint in others}, others)
            robot.motor(f"bend_{name}", "position_motor", group, others, f"{at} + {figure(swing(others))} {unit} * bend_{name}")
            draft.add("action", f"bend_{name}: {{range: -1 .. 1, each: robot.{group}}}")
    robot.add("emit", "[gyro, down]")
    draft.add("augment", "v: velocity(robot)")
    draft.add("observation", "v: -3 .. 3 m/s", "robot.gyro: -10 .. 10 rad/s", "robot.down: -1 .. 1", "previous_action: auto")
    draft.add("signals", "far: norm(position(robot).xy)    # from where it started")
    draft.add("reward", "away: delta(far) / m")
    draft.add("truncation", "max_time: 10 s")
    robot.into(draft, {"yaw": "any"})
    train(draft, "PPO", 300_000, 64)
    return draft


def posture(survey: Survey, robot: Robot) -> Draft:
    """Bring the joints of a mechanism to where a drawn figure says."""
    draft = Draft("A mechanism brings its joints to a posture.")
    draft.add("parameters", "wanted: uniform(-1 .. 1)    # of the way that a joint may go; drawn anew in every episode")
    draft.add("world", "timestep: 32 ms", "substeps: 8")
    draft.add("augment", "[wanted]")
    draft.add("observation", "wanted: -1 .. 1")
    misses = []
    for name, joints in by_unit(survey.driven):
        unit = "m" if name == "slides" else "rad"
        span = swing(joints)
        group = robot.group(f"moved_{name}", joints)
        at = robot.begin(group, f"rest_{name}", {joint.name: centre(joint) for joint in joints}, joints)
        robot.add("sensors", f"{name}: {{type: joint_position, joints: {group}}}")
        robot.add("emit", f"{name}: {name} - {at}")
        robot.motor(f"move_{name}", "position_motor", group, joints, f"{name} + {figure(0.2 * span)} {unit} * turn_{name}")
        draft.add("action", f"turn_{name}: {{range: -1 .. 1, each: robot.{group}}}")
        draft.add("observation", f"robot.{name}: -{figure(1.5 * span)} .. {figure(1.5 * span)} {unit}")
        misses.append(f"mean(abs(robot.{name} / ({figure(span)} {unit}) - wanted))")
    draft.add("signals", f"miss: {' + '.join(misses)}")
    draft.add("reward", "near: exp(-miss)")
    draft.add("truncation", "max_steps: 100")
    robot.into(draft)
    train(draft, "PPO", 200_000, 64)
    return draft


def _boxes(survey: Survey, limb: Limb) -> Iterator[tuple[tuple[Triple, Triple], Positions]]:
    """Boxes in front of an arm, or beside it, whose corners it reaches, with positions that bring its end into the middle."""
    start = survey.frames[limb.joints[0].parent]
    swinging = next((joint for joint in limb.moving if abs(survey.axis(joint)[2]) < 0.7), limb.moving[0])
    shoulder = survey.frames[swinging.child][0]
    bending = (limb.moving[0], *(joint for joint in limb.moving if abs(survey.axis(joint)[2]) < 0.3))
    far, floor = limb.reach, survey.lowest + 0.05 * limb.reach
    for half, side, rise in product((0.2, 0.12, 0.06), _SIDES, (0.1, 0.3, 0.0)):
        middle = frames.add(shoulder, frames.add(frames.scaled(side, 0.5 * far), (0.0, 0.0, rise * far)))
        size = half * far
        low = (middle[0] - size, middle[1] - size, max(middle[2] - size, floor))
        high = (middle[0] + size, middle[1] + size, middle[2] + size)
        positions, missing = bring(limb, start, middle, bending)
        if missing > _CLOSE * far:
            positions, missing = bring(limb, start, middle)
        corners = product((low[0], high[0]), (low[1], high[1]), (low[2], high[2]))
        if missing < _CLOSE * far and all(bring(limb, start, corner)[1] < _CLOSE * far for corner in corners):
            yield (low, high), positions


def _upright(survey: Survey) -> tuple[float, float]:
    """Roll and pitch (deg) that bring the legs below the body, where a file was drawn lying on its side."""
    sums = [0.0, 0.0, 0.0]
    for limb in survey.limbs:
        leg = frames.subtract(survey.frames[limb.end][0], survey.frames[limb.moving[0].child][0])
        length = hypot(*leg) or 1.0
        sums = [total + part / length / len(survey.limbs) for total, part in zip(sums, leg, strict=True)]
    x, y, _ = sums
    if abs(y) > 0.8:
        return (90.0 if y < 0 else -90.0), 0.0
    return (0.0, 90.0 if x > 0 else -90.0) if abs(x) > 0.8 else (0.0, 0.0)


def _way(survey: Survey, tilt: Quaternion) -> str:
    """The axis of the world, x or y, along which its hips lie farther apart."""
    hips = [frames.rotate(tilt, survey.frames[limb.moving[0].child][0]) for limb in survey.limbs]
    spread = [max(hip[axis] for hip in hips) - min(hip[axis] for hip in hips) for axis in (0, 1)]
    return "x" if spread[0] >= spread[1] else "y"


def _standing(survey: Survey, tilt: Quaternion) -> Positions:
    """Positions with the foot of each leg below its hip, the leg somewhat bent."""
    down = frames.rotate_back(tilt, (0.0, 0.0, -1.0))
    found: Positions = {}
    for limb in survey.limbs:
        hip, foot = survey.frames[limb.moving[0].child][0], survey.frames[limb.end][0]
        leg = frames.subtract(foot, hip)
        aside = frames.subtract(leg, frames.scaled(down, frames.dot(leg, down)))
        kept = aside if hypot(*aside) < 0.35 * limb.reach else (0.0, 0.0, 0.0)
        target = frames.add(hip, frames.add(kept, frames.scaled(down, _CROUCHED * limb.reach)))
        found |= bring(limb, survey.frames[limb.joints[0].parent], target)[0]
    return found


def _vector(values: Triple) -> str:
    return " ".join(figure(round(value, 3)) for value in values)
