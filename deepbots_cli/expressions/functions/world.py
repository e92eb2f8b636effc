"""Functions of the world: poses, distances, paths, contacts, joints and lines.

`runtime` reads them from the engine, or computes them from readings.
"""

from __future__ import annotations

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions import world_trees
from deepbots_cli.expressions.dimensions import ANGLE, FORCE, LENGTH, NUMBER, TIME, TORQUE
from deepbots_cli.expressions.functions.record import (
    Family,
    Form,
    Function,
    Param,
    fixed_dimension,
    fixed_interval,
    interval_of_first,
)
from deepbots_cli.expressions.types import QUATERNION, SPACE, Kind


def _subject(name: str, *kinds: Kind) -> Param:
    return Param(name, Form.SUBJECT, kinds=frozenset(kinds))


_PLACED = (Kind.ROBOT, Kind.LINK, Kind.OBJECT, Kind.WALL)
_PLACES = (*_PLACED, Kind.LINKS, Kind.OBJECTS)
_BODY = _subject("body", *_PLACED)
_LINKS = _subject("body", *_PLACED, Kind.LINKS)
_BODIES = _subject("body", *_PLACES, Kind.WALLS)
_OTHER = _subject("other", *_PLACES)
_SURFACE = _subject("body", *_PLACED, Kind.WALLS)
_OTHER_SURFACE = _subject("other", *_PLACES, Kind.WALLS)
_TOUCHED = _subject("other", *_PLACES, Kind.WALLS, Kind.GROUND)
_PUSHED = _subject("body", Kind.ROBOT, Kind.LINK, Kind.LINKS, Kind.OBJECT, Kind.OBJECTS)
_VISIBLE = _subject("body", Kind.ROBOT, Kind.OBJECT, Kind.OBJECTS, Kind.WALL, Kind.WALLS)
_JOINT = _subject("joint", Kind.JOINT, Kind.JOINTS)
_LINE = _subject("line", Kind.LINE)
_CAMERA = _subject("camera", Kind.CAMERA)
_ROBOT = _subject("robot", Kind.ROBOT)

OF_WORLD = (
    Function(
        "position",
        Family.WORLD,
        (_LINKS,),
        doc="The position of the origin of a body or link, in the world frame.",
        example="position(rover.left_wheel)",
        result=fixed_dimension(LENGTH),
        components=SPACE,
        reads_link_pose=True,
    ),
    Function(
        "velocity",
        Family.WORLD,
        (_LINKS,),
        doc="The velocity of the origin of a body or link, in the world frame.",
        example="velocity(ball)",
        result=fixed_dimension(LENGTH / TIME),
        components=SPACE,
        reads_link_pose=True,
    ),
    Function(
        "angular_velocity",
        Family.WORLD,
        (_LINKS,),
        doc="The angular velocity of a body or link, in the world frame.",
        example="angular_velocity(rover).z",
        result=fixed_dimension(ANGLE / TIME),
        components=SPACE,
        reads_link_pose=True,
    ),
    Function(
        "angular_momentum",
        Family.WORLD,
        (_ROBOT,),
        doc="The angular momentum of a robot about its center of mass, in the world frame.",
        example="norm(angular_momentum(rover))",
        result=fixed_dimension(TORQUE * TIME),
        components=SPACE,
    ),
    Function(
        "orientation",
        Family.WORLD,
        (_LINKS,),
        doc="The orientation of a body or link in the world as a quaternion (x, y, z, w).",
        example="orientation(rover)",
        result=fixed_dimension(NUMBER),
        interval=fixed_interval(iv.SIGNED_UNIT),
        components=QUATERNION,
        reads_link_pose=True,
    ),
    Function(
        "roll",
        Family.WORLD,
        (_LINKS,),
        doc="The roll angle of a body or link: its rotation about the forward axis.",
        example="roll(rover)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.TURN),
        tree=world_trees.roll,
        reads_link_pose=True,
    ),
    Function(
        "pitch",
        Family.WORLD,
        (_LINKS,),
        doc="The pitch angle of a body or link: its rotation about the sideways axis; nose down is positive.",
        example="pitch(rover)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.QUARTER_TURNS),
        tree=world_trees.pitch,
        reads_link_pose=True,
    ),
    Function(
        "yaw",
        Family.WORLD,
        (_LINKS,),
        doc="The yaw angle of a body or link: its rotation about the vertical axis; left is positive.",
        example="yaw(rover)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.TURN),
        tree=world_trees.yaw,
        reads_link_pose=True,
    ),
    Function(
        "tilt",
        Family.WORLD,
        (_LINKS,),
        doc="The angle between the z axis of a body or link and the vertical: 0 if it is upright.",
        example="tilt(rover)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.HALF_TURN),
        tree=world_trees.tilt,
        reads_link_pose=True,
    ),
    Function(
        "to_body_frame",
        Family.WORLD,
        (_BODY, Param("v", components=SPACE)),
        doc="A vector of the world frame, rotated into the frame of a body.",
        example="to_body_frame(rover, velocity(rover))",
        components=SPACE,
        reads_link_pose=True,
    ),
    Function(
        "distance",
        Family.WORLD,
        (_LINKS, _OTHER),
        doc="The distance between the origins of two bodies or links.",
        example="distance(rover, ball)",
        result=fixed_dimension(LENGTH),
        interval=fixed_interval(iv.POSITIVE),
        tree=world_trees.distance,
        reads_link_pose=True,
    ),
    Function(
        "ground_distance",
        Family.WORLD,
        (_LINKS, _OTHER),
        doc="The horizontal distance between the origins of two bodies or links.",
        example="ground_distance(rover, ball)",
        result=fixed_dimension(LENGTH),
        interval=fixed_interval(iv.POSITIVE),
        tree=world_trees.ground_distance,
        reads_link_pose=True,
    ),
    Function(
        "bearing",
        Family.WORLD,
        (_BODY, _OTHER),
        doc="The horizontal angle from the forward axis of a body to another body; left is positive.",
        example="bearing(rover, ball)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.TURN),
        tree=world_trees.bearing,
        reads_link_pose=True,
    ),
    Function(
        "clearance",
        Family.WORLD,
        (_SURFACE, _OTHER_SURFACE),
        doc="The smallest distance between the surfaces of two bodies.",
        example="clearance(rover, ball)",
        result=fixed_dimension(LENGTH),
        interval=fixed_interval(iv.POSITIVE),
        pieces_operator="min",
    ),
    Function(
        "height",
        Family.WORLD,
        (Param("x", dimension=LENGTH), Param("y", dimension=LENGTH)),
        doc=(
            "The height of the ground at a point of the world frame, without objects. Beyond a terrain, it"
            " is the height of its nearest edge; on a plane, it is 0."
        ),
        example="position(rover).z - height(position(rover).x, position(rover).y)",
        result=fixed_dimension(LENGTH),
        method="ground_height",
    ),
    Function(
        "path_distance",
        Family.WORLD,
        (_BODY, _OTHER),
        doc="The length of the shortest path around solid objects.",
        example="path_distance(rover, ball)",
        result=fixed_dimension(LENGTH),
        interval=fixed_interval(iv.POSITIVE),
    ),
    Function(
        "path_bearing",
        Family.WORLD,
        (_BODY, _OTHER),
        doc=(
            "The horizontal angle from the forward axis of a body to where the shortest path leads; left is"
            " positive."
        ),
        example="path_bearing(rover, ball)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.TURN),
    ),
    Function(
        "reachable",
        Family.WORLD,
        (_BODY, _OTHER),
        doc="Whether there is a path around solid objects.",
        example="reachable(rover, ball)",
        result=fixed_dimension(NUMBER),
        boolean=True,
    ),
    Function(
        "visible",
        Family.WORLD,
        (_CAMERA, _VISIBLE),
        doc="Whether the newest image of a camera shows a body.",
        example="visible(rover.eye, ball)",
        result=fixed_dimension(NUMBER),
        boolean=True,
    ),
    Function(
        "contact",
        Family.WORLD,
        (_BODIES, _TOUCHED),
        doc=(
            "Whether two bodies touched in this timestep. A robot counts with all of its links. Two links of"
            " one robot touch only with `self_collision: true`."
        ),
        example="contact(ball, ground)",
        result=fixed_dimension(NUMBER),
        boolean=True,
    ),
    Function(
        "collided",
        Family.WORLD,
        (_BODIES,),
        doc="Whether a body touched anything other than the ground in this timestep.",
        example="collided(rover)",
        result=fixed_dimension(NUMBER),
        boolean=True,
    ),
    Function(
        "contact_force",
        Family.WORLD,
        (_PUSHED,),
        doc="The sum of the normal forces on a body, from all that it touches.",
        example="contact_force(ball)",
        result=fixed_dimension(FORCE),
        interval=fixed_interval(iv.POSITIVE),
    ),
    Function(
        "contact_force_vector",
        Family.WORLD,
        (_PUSHED,),
        doc=(
            "The sum of the contact forces on a body, in the world frame: normal forces and friction, from"
            " all else that it touches."
        ),
        example="contact_force_vector(ball).xy",
        result=fixed_dimension(FORCE),
        components=SPACE,
    ),
    Function(
        "joint_position",
        Family.WORLD,
        (_JOINT,),
        doc="The position of a joint: an angle or a length.",
        example="joint_position(rover.left_wheel)",
        interval=interval_of_first,
    ),
    Function(
        "joint_velocity",
        Family.WORLD,
        (_JOINT,),
        doc="The velocity of a joint.",
        example="joint_velocity(rover.wheels)",
        result=lambda d: d / TIME,
    ),
    Function(
        "joint_torque",
        Family.WORLD,
        (_JOINT,),
        doc="The torque or force of a joint's actuator.",
        example="joint_torque(rover.wheels)",
        result=lambda d: FORCE if d == LENGTH else TORQUE,
    ),
    Function(
        "cross_track_error",
        Family.WORLD,
        (_BODY, _LINE),
        doc="The signed distance of a body from a line; left of the line is positive.",
        example="cross_track_error(rover, track)",
        result=fixed_dimension(LENGTH),
        reads_link_pose=True,
    ),
    Function(
        "arc_length",
        Family.WORLD,
        (_BODY, _LINE),
        doc=(
            "The distance that a body has traveled along a line since the reset; backward travel is"
            " subtracted."
        ),
        example="arc_length(rover, track)",
        result=fixed_dimension(LENGTH),
        reads_link_pose=True,
    ),
)
