"""The word that was meant: the known word that is most like a misspelt one, and the new word for a former one.

The finding DB109, its fix, `deepbots upgrade`, `explain` and the documentation read `RENAMES`.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from typing import NamedTuple

# A file can hold thousands of names and thousands of misspellings.
_MAX_COMPARED = 300
_MAX_LENGTH = 64

_MIN_SLIP = 4
"""Letters of a word for which one slip can be told from another word; `x` is one slip away from `y`."""
_MIN_PREFIX = 3
"""Letters from which on a word may be the beginning of a longer one, as `left` of `left_hinge`."""


class Replacement(NamedTuple):
    """The replacement of a word, and whether it is certain."""

    text: str
    safe: bool


def nearest_word(word: str, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The `known` word most like `word`, ignoring case, or else the only one that begins with it; None if there is none."""
    from difflib import get_close_matches  # its import takes 4 ms, and only messages need it

    by_lower = {name.lower(): name for name in islice(known, _MAX_COMPARED)}
    close = get_close_matches(word[:_MAX_LENGTH].lower(), by_lower, 1, cutoff)
    if close:
        return by_lower[close[0]]
    longer = [name for lower, name in by_lower.items() if lower.startswith(word.lower())] if len(word) >= _MIN_PREFIX else []
    return longer[0] if len(longer) == 1 else None


def suggest_replacement(word: str, known: Iterable[str], *, of_language: bool = False) -> Replacement | None:
    """The nearest of the `known` words as a replacement.

    It is certain only among words of the language (`of_language`), and only if exactly one of them is a slip away. Names that a
    user chose may differ by a letter on purpose (`left_1`, `left_2`).
    """
    words = tuple(islice(known, _MAX_COMPARED))
    near = nearest_word(word, words)
    if near is None:
        return None
    return Replacement(near, of_language and [other for other in words if is_typo(word, other)] == [near])


def is_typo(word: str, other: str) -> bool:
    """Whether two words differ only by case, by underscores, or by one letter: replaced, missing, added, or two swapped."""
    word, other = (text[:_MAX_LENGTH].lower().replace("_", "").replace("-", "") for text in (word, other))
    if word == other:
        return True
    short, long = sorted((word, other), key=len)
    if len(short) < _MIN_SLIP or len(long) - len(short) > 1:
        return False
    at = next((i for i, (a, b) in enumerate(zip(short, long, strict=False)) if a != b), len(short))
    if len(short) < len(long):
        return short[at:] == long[at + 1 :]
    return short[at + 1 :] == long[at + 1 :] or (short[at : at + 2] == long[at : at + 2][::-1] and short[at + 2 :] == long[at + 2 :])


# Former words


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
    def kind(self) -> str:
        return "word" if self.key else "key" if self.section else "function"

    @property
    def headline(self) -> str:
        return f"the {self.kind} `{self.old}` is called `{self.new}` now"


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

FORMER_FUNCTIONS = {rename.old: rename for rename in RENAMES if rename.kind == "function"}
FORMER_KEYS_AND_WORDS = frozenset(rename.old for rename in RENAMES if rename.section)


def renames_of(word: str) -> tuple[Rename, ...]:
    """The renames of an old word."""
    return tuple(rename for rename in RENAMES if rename.old == word)
