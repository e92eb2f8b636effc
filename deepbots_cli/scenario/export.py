"""The JSON Schema of a scenario, for editors that complete, explain and check while one types.

It is made from the same specs as the models, and says what the file may look like before `extends` and
`include` are resolved: a file that extends another may leave out anything, so every part exists twice, complete
and as a fragment. With what is `Known` of a scenario it lists the names of that one as well.
"""

from __future__ import annotations

import json
from pathlib import Path

from deepbots_cli.scenario.fields import JsonSchema
from deepbots_cli.scenario.known import LANGUAGE, Known
from deepbots_cli.scenario.lowering import Lowering, annotated
from deepbots_cli.scenario.scenario import VERSION, Scenario

FILE_NAME = f"deepbots-{VERSION}.schema.json"
_GENERAL = Known()


def json_schema(known: Known = _GENERAL) -> JsonSchema:
    """The schema (draft 2020-12), in stable order; without names of a scenario it is the one that is committed."""
    definitions: dict[str, JsonSchema] = {}
    names = {**LANGUAGE, **known.everywhere}
    whole, part = (Lowering(definitions, known, names, fragment=fragment).reference(Scenario) for fragment in (False, True))
    sentence = "A file with the value of this mapping; what stands beside it is merged over it."
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **({"$id": FILE_NAME} if known is _GENERAL else {}),
        "title": "deepbots scenario",
        "if": {"required": ["extends"]},
        "then": part,
        "else": whole,
        "$defs": {"include": annotated({"type": "string"}, sentence, "include: parts/arena.yaml"), **definitions},
    }


def to_text(known: Known = _GENERAL) -> str:
    """The schema as it is written to a file."""
    return json.dumps(json_schema(known), indent=1) + "\n"


def main() -> None:
    """Write the schema to `schemas/` below the working directory."""
    target = Path("schemas") / FILE_NAME
    target.parent.mkdir(exist_ok=True)
    target.write_text(to_text(), encoding="utf-8")


if __name__ == "__main__":
    main()
