"""Draws the pictures of docs and of lessons, so that no picture goes stale.

python docs/build_figures.py
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]
NAMES = ("frames", "rays", "regions", "terrain", "channel", "value", "curriculum", "intervals", "loop")
OF_LESSONS = {"axes": "course/01-sensors", "wheels": "course/02-motors"}
"""Pictures that students get with their lesson, and its folder."""


def figures() -> dict[str, str]:
    """The text of each picture by its path in the repository."""
    folders = {**dict.fromkeys(NAMES, "docs/images"), **OF_LESSONS}
    return {
        f"{folder}/{name}.svg": import_module(f"figures.{name}").draw() for name, folder in folders.items()
    }


if __name__ == "__main__":
    for name, text in figures().items():
        (ROOT / name).write_text(text, encoding="utf-8")
