"""Writes the JSON Schema of bundle.json: `python -m deepbots_robot.schema`."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec

from deepbots_robot.model import FORMAT, BundleInfo

PATH = Path("schemas") / f"bundle-{FORMAT}.schema.json"
_URL = "https://json-schema.org/draft/2020-12/schema"


def json_schema() -> str:
    """Return the schema of the records in `model.py`."""
    about = {"$schema": _URL, "title": f"Bundle of an exported policy (bundle.json), format {FORMAT}"}
    return json.dumps(about | msgspec.json.schema(BundleInfo), indent=1) + "\n"


if __name__ == "__main__":
    PATH.write_text(json_schema(), encoding="utf-8")
