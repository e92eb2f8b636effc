"""Files that commands write are whole or as they were, and nothing but a regular file is replaced."""

from __future__ import annotations

import os
import re
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
    assert path.read_text() == "two"
    assert path.stat().st_mode & 0o777 == 0o640
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
    target = tmp_path / "there" / "a.txt"
    link = tmp_path / "link.txt"
    target.write_text("one")
    link.symlink_to(target)
    put(link, "two")
    assert link.is_symlink()
    assert target.read_text() == "two"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_a_file_that_is_not_regular_is_written_to_and_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()), daemon=True)
    reader.start()
    put(pipe, "through")
    reader.join(10)
    assert read == ["through"]
    assert pipe.is_fifo()


def test_a_folder_that_is_not_there_is_wrong_usage(tmp_path):
    with pytest.raises(UsageError, match="cannot be written: no such file"):
        put(tmp_path / "nowhere" / "a.txt", "")


WRITING = {
    "lsp": ("lsp", "--schema", "-o", "mine.json"),
    "compile": ("compile", "cartpole", "-o", "mine.py"),
    "report": ("report", "run", "-o", "mine.html"),
    "report by its own name": ("report", "mine"),
    "plot": ("plot", "run", "-o", "mine.png"),
    **{
        f"render, {kind}": ("render", "cartpole", "-o", f"mine.{kind}")
        for kind in ("png", "gif", "mp4", "mcap")
    },
    "render by its own name": ("render", "mine.yaml"),
    "test": ("test", "cartpole", "--junit", "mine.xml"),
    "eval, CSV": ("eval", "run", "--csv", "mine.csv"),
    "eval, JUnit": ("eval", "run", "--min-return", "0", "--junit", "mine.xml"),
    "new": ("new", "mine", "--template", "pit"),
    "new, project": ("new", "mine", "--template", "pit", "--project", "."),
    "new, schema": ("new", "mine", "--template", "pit", "--schema"),
    "new, copy": ("new", "mine", "--from", "cartpole"),
    "compile, project": ("compile", "cartpole", "--project", "mine"),
    "export": ("export", "run", "-o", "mine"),
}
PRESENT = (
    "mine.json",
    "mine.py",
    "mine.html",
    "mine.png",
    "mine.gif",
    "mine.mcap",
    "mine.xml",
    "mine.csv",
    "mine.mp4",
    "mine.yaml",
)
"""The files of a user that the commands would write."""


@pytest.mark.parametrize("words", WRITING.values(), ids=WRITING)
def test_no_command_overwrites_a_file_without_force(deepbots, tmp_path, words):
    present = [tmp_path / name for name in (*PRESENT, "cartpole.yaml", "mine/kept.txt")]
    (tmp_path / "mine").mkdir()
    for path in present:
        path.write_text("of the user")
    ran = deepbots(*words, code=2)
    assert re.fullmatch(
        r"error: ((mine\S*|cartpole.yaml) already exists; overwrite it|mine is not empty; .*) with --force"
        r" .*\n",
        ran.err,
    )
    assert [path.read_text() for path in present] == ["of the user"] * len(present)
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == {*present}


def test_with_force_commands_overwrite(deepbots, tmp_path):
    for words in (
        ("lsp", "--schema", "-o", "mine.json"),
        ("compile", "cartpole", "-o", "mine.py"),
        ("new", "mine", "--template", "pit", "--schema"),
    ):
        for name in PRESENT:
            (tmp_path / name).write_text("of the user")
        (tmp_path / "mine.schema.json").write_text("of the user")
        deepbots(*words, "--force")
        written = {"lsp": "mine.json", "compile": "mine.py", "new": "mine.yaml"}[words[0]]
        assert (tmp_path / written).read_text() != "of the user"
    assert "of the user" not in (tmp_path / "mine.schema.json").read_text()
    deepbots("compile", "cartpole", "--project", ".", "--force")


def test_every_command_that_writes_a_file_has_force(deepbots):
    for words in WRITING.values():
        assert "--force" in deepbots(words[0], "--help").out
