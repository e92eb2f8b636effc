"""Files that commands write are whole or as they were, and nothing but a regular file is replaced."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write


def put(path: Path, text: str) -> None:
    with atomic_write(path) as draft:
        draft.write_text(text)


def test_a_file_is_replaced_as_a_whole_and_keeps_its_permissions(tmp_path):
    path = tmp_path / "a.txt"
    put(path, "one")
    path.chmod(0o640)
    put(path, "two")
    assert (path.read_text(), path.stat().st_mode & 0o777) == ("two", 0o640)
    assert [*tmp_path.iterdir()] == [path]


def test_an_exception_leaves_the_file_as_it_was(tmp_path):
    path = tmp_path / "a.txt"
    put(path, "one")
    with pytest.raises(TypeError, match="str"):
        put(path, 2)  # after the draft was opened for writing
    assert path.read_text() == "one"
    assert [*tmp_path.iterdir()] == [path]


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "a.txt", tmp_path / "link.txt"
    target.write_text("one")
    link.symlink_to(target)
    put(link, "two")
    assert link.is_symlink()
    assert target.read_text() == "two"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_what_is_no_regular_file_is_written_to_and_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    put(pipe, "through")
    reader.join(10)
    assert (read, pipe.is_fifo()) == (["through"], True)


def test_a_folder_that_is_not_there_is_wrong_usage(tmp_path):
    with pytest.raises(UsageError, match="cannot be written: no such file"):
        put(tmp_path / "nowhere" / "a.txt", "")
