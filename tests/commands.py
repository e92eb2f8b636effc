"""Commands of deepbots: what one that runs in this process has printed, and whether a line is one; a wait for what
other processes do."""

import shlex
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Ran:
    """The exit code and the output of a command."""

    code: int
    out: str
    err: str


Deepbots = Callable[..., Ran]

WORDS = {"K": "3", "N": "3", "NAME,NAME": "mujoco,pybullet"}
"""What stands for a value in the commands of messages and pages, and such a value."""


def until(holds: Callable[[], Any], seconds: float = 30.0) -> Any:
    """Wait until a function returns what is true or not empty, and return it."""
    end = time.monotonic() + seconds
    while not (value := holds()):
        assert time.monotonic() < end, f"it did not happen within {seconds:g} s"
        time.sleep(0.01)
    return value


def refusal(place: str, line: str) -> str:
    """What is wrong with a command at a place; empty if it parses."""
    try:
        parse(line)
    except Exception as error:  # noqa: BLE001  # of typer, which has a copy of click, or of click
        return f"{place}: {line}: {error!r}"
    return ""


def parse(line: str) -> None:
    """Parse a command as the program does; a command that is only named, without its arguments, is one too."""
    verb, *words = shlex.split(line)[1:]
    words = [WORDS.get(word, word) for word in words if word not in ("...", "--help")]
    from deepbots_cli.cli.command import Commands

    command = Commands().get_command(None, verb)
    if not words or (len(words) == 1 and words[0].startswith("-")):
        assert {*words} <= {name for parameter in command.params for name in parameter.opts}, line
        return
    command.make_context(verb, words).close()
