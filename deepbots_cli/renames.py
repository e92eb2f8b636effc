"""Renamed words of the language. The finding DB109, its fix, `deepbots upgrade`, `explain` and the documentation read this table."""

from __future__ import annotations

from typing import NamedTuple


class Rename(NamedTuple):
    """A renamed key, word or function.

    Attributes:
        reason: Where the new name comes from.
        section: The class of the section (`scenario`) that has the key, or whose `key` takes the word; empty for a function.
        key: The key that takes the word; empty for a key or a function.
    """

    old: str
    new: str
    reason: str
    section: str = ""
    key: str = ""

    @property
    def what(self) -> str:
        return "word" if self.key else "key" if self.section else "function"


RENAMES = (
    Rename("quantise", "resolution", "the term of data sheets of sensors", "Sensor"),
    Rename("beside", "cross_track_error", "the term of path following"),
    Rename("along", "arc_length", "the term of path following"),
    Rename("gap", "clearance", "the term of motion planning, and the key of a placement that means the same"),
    Rename("through", "points", "the word for the corners of a polyline", "Wall"),
    Rename("through", "points", "the word for the corners of a polyline", "Line"),
    Rename("fan", "angle_range", "after angle_min and angle_max of laser scans in ROS", "RayScan"),
    Rename("stretch", "scale", "the word of URDF and MuJoCo, and of meshes here", "LinkOverride"),
    Rename("lag", "time_constant", "the term of control engineering", "Actuator"),
    Rename("drag", "moment_constant", "the term of models of rotors; air drag is a force", "Thrust"),
    Rename("repeat", "action_repeat", "the term of environments, as in dm_control", "Agent"),
    Rename("stack", "frame_stack", "the term of environments, as in Gymnasium", "Agent"),
    Rename("within", "tolerance", "the term of goals in ROS", "Goal"),
    Rename("lasts", "duration", "the noun, as in other keys", "Disturbance"),
    Rename(
        "inclinometer", "projected_gravity", "the term of tasks for legged robots; an inclinometer measures angles", "LinkSensor", "type"
    ),
    Rename("grey", "grayscale", "the term of Gymnasium", "Camera", "channels"),
    Rename("mask", "segmentation", "the term of simulators", "Camera", "channels"),
    Rename("paper", "delayed", "says what it does", "Messages", "timing"),
    Rename("smooth", "low_pass", "the term of signal processing"),
    Rename("rising", "rising_edge", "the term of signal processing"),
    Rename("fresh", "message_received", "says what has arrived"),
    Rename("local", "to_body_frame", "the term of simulators for velocities and errors"),
)

FUNCTIONS = {rename.old: rename for rename in RENAMES if rename.what == "function"}
KEYS_AND_WORDS = frozenset(rename.old for rename in RENAMES if rename.section)


def renames_of(word: str) -> tuple[Rename, ...]:
    """The renames of an old word."""
    return tuple(rename for rename in RENAMES if rename.old == word)


def headline(rename: Rename) -> str:
    return f"the {rename.what} `{rename.old}` is called `{rename.new}` now"
