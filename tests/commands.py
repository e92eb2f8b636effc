"""What a command of deepbots that runs in this process has printed."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Ran:
    """The exit code and the output of a command."""

    code: int
    out: str
    err: str


Deepbots = Callable[..., Ran]
