"""Writes the JSON Schema of bundle.json: `python -m deepbots_robot.schema`."""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import msgspec

from deepbots_robot.model import FORMAT, BundleInfo

PATH = Path("schemas") / f"bundle-{FORMAT}.schema.json"
_URL = "https://json-schema.org/draft/2020-12/schema"


def json_schema() -> str:
    """Return the schema of the records in `model.py`."""
    about = {"$schema": _URL, "title": f"Bundle of an exported policy (bundle.json), format {FORMAT}"}
    schema = msgspec.json.schema(BundleInfo)
    for record in schema["$defs"].values():  # before 0.23, msgspec leaves docstrings indented
        if "description" in record:
            record["description"] = inspect.cleandoc(record["description"])
    return json.dumps(about | schema, indent=1) + "\n"


if __name__ == "__main__":
    PATH.write_text(json_schema(), encoding="utf-8")
