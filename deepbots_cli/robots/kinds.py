"""The kind of a robot, with its evidence: decided by structure, and by names only where two kinds have the
same structure.

`judge` tries the kinds of `_TESTS` in turn. Each test returns the evidence as a phrase, or an empty text.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from enum import StrEnum
from functools import partial
from itertools import pairwise
from math import dist, inf

from deepbots_cli import frames
from deepbots_cli.records import dataclass
from deepbots_cli.robots.build import Build, Limb, names_of_limb
from deepbots_cli.robots.kinematics import box_sides, robot_bounds

_EXOSKELETON = re.compile(r"exo(?:skelet|suit|_|-|$)", re.IGNORECASE)
_FLYING = re.compile(r"(?:quad|hexa|octo|multi)(?:ro)?(?:tor|copter)|drone|uav|flying", re.IGNORECASE)
_UNDERWATER = re.compile(r"thruster|underwater|auv|(?<![a-z])rov|submarine", re.IGNORECASE)
_MECANUM = re.compile(r"mecanum|omni|swedish", re.IGNORECASE)
_HAND = re.compile(r"finger|thumb|palm|knuckle|gripper|grasp|jaw|claw|(?<![a-z])hand", re.IGNORECASE)
_MAX_HAND_SIZE = 0.6
"""The longest side (m) of a hand, with its forearm."""
_MAX_PALM_SIZE = 0.4
"""The longest side (m) of a hand without the names of one."""
_MAX_PARALLEL_ANGLE_COSINE = 0.94
"""The cosine of 20 deg: wheels whose axles differ by more roll in different directions."""
_ARM_SHARE = 0.4
"""The least reach of an arm of two joints, as a share of the size of the robot."""
_ROVER_WHEELS = 6
_SNAKE_JOINTS = 6
_SNAKE_HEIGHT_SHARE = 0.3
"""The largest height of a snake, as a share of its length."""
_SNAKE_SPREAD = 3.0
"""The largest distance between neighboring joints of a snake, and mass of a link, in the smallest one."""


class Kind(StrEnum):
    """What a robot is. `deepbots new --kind` takes these words."""

    drone = "drone"
    underwater = "underwater"
    balance = "balance"
    omni = "omni"
    rover = "rover"
    car = "car"
    skid = "skid"
    differential = "differential"
    arm_on_base = "arm_on_base"
    humanoid = "humanoid"
    biped = "biped"
    quadruped = "quadruped"
    hexapod = "hexapod"
    hand = "hand"
    exoskeleton = "exoskeleton"
    snake = "snake"
    arm = "arm"
    arm_with_gripper = "arm_with_gripper"
    two_arms = "two_arms"
    mechanism = "mechanism"


NOUNS = {
    Kind.drone: "a drone",
    Kind.underwater: "an underwater vehicle",
    Kind.balance: "a robot that has to balance",
    Kind.omni: "an omnidirectional base",
    Kind.rover: "a rover",
    Kind.car: "a car",
    Kind.skid: "a skid-steered base",
    Kind.differential: "a differential drive",
    Kind.arm_on_base: "an arm on a base with wheels",
    Kind.humanoid: "a humanoid",
    Kind.biped: "a biped",
    Kind.quadruped: "a quadruped",
    Kind.hexapod: "a robot on many legs",
    Kind.hand: "a hand",
    Kind.exoskeleton: "an exoskeleton",
    Kind.snake: "a snake",
    Kind.arm: "an arm",
    Kind.arm_with_gripper: "an arm with a gripper",
    Kind.two_arms: "a robot with several arms",
    Kind.mechanism: "a mechanism",
}
"""Each kind as the object of a sentence."""


@dataclass(frozen=True)
class Judgment:
    """The kind of a robot, or None where none is sure, and the parts that speak for it as a phrase."""

    kind: Kind | None
    evidence: str

    def __str__(self) -> str:
        noun = NOUNS[self.kind] if self.kind else "no kind that deepbots is sure of"
        return f"{noun}: {self.evidence}"


def judge(build: Build) -> Judgment:
    """Return the kind of a robot."""
    for kind, test in _TESTS.items():
        if evidence := test(build):
            return Judgment(kind, evidence)
    count = len(build.driven)
    joints = "1 joint moves" if count == 1 else f"{count} joints move"
    return Judgment(None, f"{joints}, without wheels, legs, propellers or an arm")


def _drone(build: Build) -> str:
    if build.legs or build.wheels or len(build.rotors) < len(build.propellers):
        return ""
    count = len(build.rotors)
    return f"{count} propellers point up and no leg reaches the ground" if count else ""


def _underwater(build: Build) -> str:
    propellers = build.propellers
    if build.legs or build.wheels or not propellers:
        return ""
    tilted = len(propellers) - len(build.rotors)
    names = [build.model.name, *(link.name for link in build.model.links)]
    if tilted > 1 and (len(build.rotors) < 3 or any(map(_UNDERWATER.search, names))):
        return f"{len(propellers)} propellers push in different directions"
    return ""


def _flying(build: Build) -> str:
    """Return the evidence of a drone whose propellers are tilted, or missing in the file."""
    if build.legs or build.wheels:
        return ""
    if build.propellers:
        return f"{len(build.propellers)} propellers push in different directions"
    names = [build.model.name, *build.trunk]
    return "its name says so; the file has no propellers" if any(map(_FLYING.search, names)) else ""


def _balance(build: Build) -> str:
    if build.balances:
        return "it stands on two wheels of one axle and on nothing else"
    if build.poles and (build.wheels or build.is_fixed) and not build.arms:
        return f"hinge {build.poles[0].name} has no motor and carries its mass above itself"
    return ""


def _arm_on_base(build: Build) -> str:
    if not build.wheels:
        return ""
    arms = [arm for arm in build.arms if len(arm.joints) > 3 or arm.fingers]
    if not arms:
        return ""
    return f"{len(build.wheels)} wheels carry {_limbs(arms, 'arm')}"


def _omni(build: Build) -> str:
    steered = {name for joint in build.steering for name in build.rigid(joint.child)}
    wheels = [wheel for wheel in build.wheels if wheel.joint.parent not in steered]
    if len(wheels) < 3:
        return ""
    if sum(wheel.rollers > 0 for wheel in wheels) > 2:
        return f"{len(wheels)} wheels have rollers"
    axle = wheels[0].axle
    if any(abs(frames.dot(axle, wheel.axle)) < _MAX_PARALLEL_ANGLE_COSINE for wheel in wheels):
        return f"the axles of its {len(wheels)} wheels point in different directions"
    names = [build.model.name, *(wheel.joint.child for wheel in wheels)]
    if any(map(_MECANUM.search, names)):
        return f"its {len(wheels)} wheels are named after rollers"
    return ""


def _rover(build: Build) -> str:
    if len(build.all_wheels) < _ROVER_WHEELS and not (build.rockers and build.wheels):
        return ""
    rockers = f" on {len(build.rockers)} rockers" if build.rockers else ""
    return f"{len(build.all_wheels)} wheels{rockers}" if len(build.wheels) > 3 else ""


def _car(build: Build) -> str:
    if not build.steering or not build.wheels:
        return ""
    count = len(build.steering)
    hinges = "1 upright hinge steers" if count == 1 else f"{count} upright hinges steer"
    return f"{hinges} and {len(build.wheels)} wheels have motors"


def _skid(build: Build) -> str:
    count = len(build.wheels)
    return f"{count} wheels with parallel axles and no steering" if count > 3 else ""


def _differential(build: Build) -> str:
    count = len(build.wheels)
    return f"{count} wheels with motors, the rest slides or rolls along" if count else ""


def _exoskeleton(build: Build) -> str:
    names = [build.model.name, *(link.name for link in build.model.links)]
    if len(build.limbs) > 1 and any(map(_EXOSKELETON.search, names)):
        return f"its names say so, and it has {len(build.limbs)} limbs"
    return ""


def _humanoid(build: Build) -> str:
    if len(build.legs) != 2 or not build.arms:
        return ""
    return (
        f"{_limbs(build.legs, 'leg')} carry the trunk and {_limbs(build.arms, 'arm')} do not reach the ground"
    )


def _legged(fewest: int, most: float, build: Build) -> str:
    return f"{_limbs(build.legs, 'leg')} carry the trunk" if fewest <= len(build.legs) <= most else ""


def _hand(build: Build) -> str:
    if build.wheels or build.size > _MAX_HAND_SIZE or len(build.model.moving_joints) < 2:
        return ""
    limbs = build.limbs
    named = [limb for limb in limbs if _HAND.search(names_of_limb(limb))]
    is_named = any(map(_HAND.search, [build.model.name, *build.trunk])) or 2 * len(named) > len(limbs)
    if is_named and len(limbs) == 1 and limbs[0].fingers and len(limbs[0].joints) < 3:
        return f"a wrist carries {len(limbs[0].fingers)} joints of fingers"
    slides = [joint for limb in limbs for joint in limb.joints if joint.type == "prismatic"]
    if len(slides) == len(build.model.moving_joints) == 2 and frames.dot(*map(build.axis, slides)) < 0.0:
        return "two jaws slide against each other"
    if len(limbs) > 1 and (is_named or _are_fingers(build)):
        return f"{len(limbs)} fingers begin at a palm of {build.size:.2g} m"
    return ""


def _are_fingers(build: Build) -> bool:
    """Whether a robot has several limbs and no legs, and is too small to have arms."""
    if len(build.limbs) < 3 or build.legs or any(len(limb.joints) < 2 for limb in build.limbs):
        return False
    return not build.arms or build.size < _MAX_PALM_SIZE


def _snake(build: Build) -> str:
    joints = build.model.moving_joints
    if len(joints) < _SNAKE_JOINTS or build.model.root == "world" or len(build.limbs) > 2:
        return ""
    if sum(len(limb.joints) for limb in build.limbs) < len(joints):
        return ""
    sides = box_sides(robot_bounds(build.model))
    if sides[2] > _SNAKE_HEIGHT_SHARE * max(sides[:2]):
        return ""
    places = [build.frames[joint.child][0] for limb in build.limbs for joint in limb.joints]
    steps = [dist(*pair) for pair in pairwise(places)]
    masses = [build.model.link(joint.child).mass for limb in build.limbs for joint in limb.joints]
    masses.append(sum(build.model.link(name).mass for name in build.trunk))
    if any(min(values) * _SNAKE_SPREAD < max(values) for values in (steps, masses)):
        return ""
    return f"{len(joints)} joints at equal distances along a body on the ground"


def _two_arms(build: Build) -> str:
    arms = [arm for arm in build.arms if len(arm.joints) > 3]
    return f"{_limbs(arms, 'arm')} and no wheels or legs" if len(arms) > 1 and not build.legs else ""


def _arm_with_gripper(build: Build) -> str:
    if len(build.arms) != 1 or not build.arms[0].fingers:
        return ""
    (arm,) = build.arms
    count = len(arm.fingers)
    joints = f"joint {arm.fingers[0].name} is" if count == 1 else f"{count} joints are"
    return f"a chain of {len(arm.joints)} joints, and {joints} its gripper"


def _arm(build: Build) -> str:
    limbs = build.arms or [
        limb for limb in build.limbs if len(limb.joints) > 1 and limb.reach > _ARM_SHARE * build.size
    ]
    if len(limbs) != 1 or not (build.is_fixed or build.arms):
        return ""
    return f"a chain of {len(limbs[0].joints)} joints on a base that does not move"


def _mechanism(build: Build) -> str:
    count = len(build.driven)
    if not build.is_fixed or not count:
        return ""
    return f"its base does not move, and {count} joint{' moves' if count == 1 else 's move'}"


def _limbs(limbs: list[Limb], noun: str) -> str:
    """Return a number of limbs with the number of joints of each."""
    counts = sorted({len(limb.joints) for limb in limbs})
    span = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    number = f"1 {noun}" if len(limbs) == 1 else f"{len(limbs)} {noun}s"
    return f"{number} of {span} joints"


_TESTS: dict[Kind, Callable[[Build], str]] = {
    Kind.underwater: _underwater,
    Kind.drone: lambda build: _drone(build) or _flying(build),
    Kind.arm_on_base: _arm_on_base,
    Kind.balance: _balance,
    Kind.omni: _omni,
    Kind.rover: _rover,
    Kind.car: _car,
    Kind.skid: _skid,
    Kind.differential: _differential,
    Kind.exoskeleton: _exoskeleton,
    Kind.hand: _hand,
    Kind.humanoid: _humanoid,
    Kind.biped: partial(_legged, 2, 2),
    Kind.quadruped: partial(_legged, 4, 4),
    Kind.hexapod: partial(_legged, 3, inf),
    Kind.snake: _snake,
    Kind.two_arms: _two_arms,
    Kind.arm_with_gripper: _arm_with_gripper,
    Kind.arm: _arm,
    Kind.mechanism: _mechanism,
}
