"""Names that the user may choose, and those that are taken."""

from __future__ import annotations

import re
from dataclasses import dataclass

from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.scenario.fields import JsonSchema, Leaf
from deepbots_cli.scenario.refusal import problem

# Every scenario has these values; what they hold is the compiler's business.
BUILT_IN = frozenset(
    {"time", "step", "episode_return", "previous_action", "previous_reward", "terminated", "truncated", "ended", "goal_reached"}
    | {"ground", "arena", "pi", "true", "false"}
)
# The expression language reads these as part of its grammar, the fields as values of their own.
GRAMMAR = frozenset(["and", "or", "not", "when", "every", "each", "auto", "any", "urdf"])

NAME = r"[a-z_][a-z0-9_]*"
LONGEST = 64


@dataclass(frozen=True)
class Name(Leaf):
    """A name in lower case; a `shared` one lies in the flat namespace of the scenario, where some are taken."""

    shared: bool = False

    noun = "a name"

    def examine(self, value: object) -> None:
        name = str(value)
        if not re.fullmatch(NAME, name):
            suggestion = re.sub(r"[^a-z0-9_]+", "_", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name[:LONGEST]).lower()).strip("_")
            likely = f", such as `{suggestion}`" if re.fullmatch(NAME, suggestion) else ""
            raise problem(
                "DB105", f"`{name[:40]}` cannot be a name", f"use lower-case letters, digits and `_`, and do not begin with a digit{likely}"
            )
        if len(name) > LONGEST:
            raise problem("DB105", f"a name of {len(name)} characters", f"use at most {LONGEST}")
        if self.shared:
            _examine_taken(name)

    def json_schema(self) -> JsonSchema:
        about = "A name of your choice: lower-case letters, digits and `_`, not beginning with a digit."
        return {"pattern": f"^{NAME}$", "title": "name", "description": about, "patternErrorMessage": about}


def _examine_taken(name: str) -> None:
    if name in UNITS:
        raise problem("DB105", f"`{name}` is the name of a unit", "choose another name")
    if name in BUILT_IN:
        raise problem("DB105", f"`{name}` is built in", "choose another name")
    if name in GRAMMAR:
        raise problem("DB105", f"`{name}` is a word of the language", "choose another name")
