"""Damaged files of models."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from deepbots_cli.errors import RunError
from deepbots_cli.learning.agents.multi_agent import has_agents, own_model
from deepbots_cli.learning.model_files import steps_of

DATA = '{"num_timesteps": 128, "agents": ["left"]}'
SIZES_IN_DIRECTORY = 20
"""The place of the two sizes of a member in its entry in the directory of an archive."""


def archive_with(path: Path, compression: int = zipfile.ZIP_STORED, **members: str) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def test_a_model_tells_its_steps_and_whether_it_has_agents(tmp_path: Path) -> None:
    model = archive_with(tmp_path / "model.zip", data=DATA)
    assert (steps_of(model), has_agents(model)) == (128, True)


@pytest.mark.parametrize("read", [steps_of, has_agents])
def test_a_model_whose_compressed_data_is_damaged_is_refused(
    tmp_path: Path, read: Callable[[Path], object]
) -> None:
    model = archive_with(tmp_path / "model.zip", zipfile.ZIP_DEFLATED, data=DATA * 20)
    content = bytearray(model.read_bytes())
    content[40:50] = bytes([255] * 10)
    model.write_bytes(content)
    with pytest.raises(RunError, match="is damaged, or was not written by deepbots"):
        read(model)


@pytest.mark.parametrize("data", ['"agents"', '["agents"]'])
def test_a_file_whose_data_is_no_mapping_has_no_agents(tmp_path: Path, data: str) -> None:
    with pytest.raises(RunError, match="is damaged, or was not written by deepbots"):
        has_agents(archive_with(tmp_path / "model.zip", data=data))


def test_infinite_steps_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="is damaged, or was not written by deepbots"):
        steps_of(archive_with(tmp_path / "model.zip", data='{"num_timesteps": 1e999}'))


def test_an_agents_model_that_claims_to_be_larger_than_its_file_is_refused(tmp_path: Path) -> None:
    model = archive_with(tmp_path / "model.zip", **{"left.zip": "short"})
    content = bytearray(model.read_bytes())
    place = content.index(b"PK\x01\x02") + SIZES_IN_DIRECTORY
    struct.pack_into("<II", content, place, 10**6, 10**6)
    model.write_bytes(content)
    with pytest.raises(RunError, match="no model of the agent 'left'"), own_model(model, "left"):
        pass
