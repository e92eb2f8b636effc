"""The tables of docs/webots.md name every node and every class with missing functions."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from deepbots_cli.webots.library import LIBRARY
from deepbots_cli.webots.nodes import node_types
from deepbots_cli.webots.unimplemented import MISSING

PAGE = (Path(__file__).parents[2] / "docs" / "webots.md").read_text(encoding="utf-8")
WORDS = set(re.findall(r"[\w-]+", PAGE))
APPEARANCES = {"Parquetry", "ChequeredParquetry", "SandyGround", "BrushedAluminium", "Grass", "Asphalt"}


@pytest.mark.parametrize("name", sorted(node_types()))
def test_each_node_is_in_a_table(name: str):
    assert name in WORDS


@pytest.mark.parametrize("name", sorted(set(LIBRARY) - APPEARANCES))
def test_each_equivalent_of_a_proto_is_named(name: str):
    assert name in WORDS


def test_a_function_that_is_missing_is_not_there():
    import deepbots_cli.webots.devices as devices
    from deepbots_cli.webots import cameras, joints, ranging, sensors, supervisor, tree

    modules = (cameras, devices, joints, ranging, sensors, supervisor, tree)
    classes = {name: value for module in modules for name, value in vars(module).items()}
    for owner, names in MISSING.items():
        for name in names.split():
            assert name not in vars(classes[owner]), f"{owner}.{name}"
