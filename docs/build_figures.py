"""Draws the pictures of docs/figures, so that no picture goes stale.

python docs/build_figures.py
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]
NAMES = ("frames", "rays", "regions", "terrain", "channel", "value", "curriculum", "intervals", "loop")


def figures() -> dict[str, str]:
    """The text of each picture by its file name in docs/images."""
    return {f"{name}.svg": import_module(f"figures.{name}").draw() for name in NAMES}


if __name__ == "__main__":
    for name, text in figures().items():
        (ROOT / "docs" / "images" / name).write_text(text, encoding="utf-8")
