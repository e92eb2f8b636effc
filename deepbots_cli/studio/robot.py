"""The robot of the studio: a process that simulates it and serves its page, started again when it crashes."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from pydantic import ValidationError

from deepbots_cli.document import Permissions
from deepbots_cli.processes import Process
from deepbots_cli.studio.robot_process import Command, RobotRequest, RobotState

_FRAME_RATE, _FRAME_RATE_OF_SOFTWARE = 30, 8
"""The pictures per second, and those for browsers without a graphics card: at 30, drawing by software took
both cores, and a letter typed in the text was shown after a second."""
_START_S, _PATIENCE_S = 40.0, 10.0
"""The times in s after which a process that has not started, or has not read its files, is late: the next
save or *Restart* ends it."""
_MAX_CRASHES = 3
"""The number of crashes without a reload in between after which the process is not started again."""


class Robot:
    """The process of the robot.

    Attributes:
        reference: The scenario or run that it shows.
        address: The URL of its page; empty while there is none.
        state: The last state that it has sent about `reference`; None before.
        crashes: How often it has crashed since it was last asked for something else.
        problem: A sentence if there is no process.
    """

    def __init__(self, permissions: Permissions, on_change: Callable[[], None]) -> None:
        """`on_change` is called after each change of the attributes."""
        self._permissions, self._on_change = permissions, on_change
        self._process: Process | None = None
        self._sender = ThreadPoolExecutor(1)
        self._starts = 0
        """The number of processes so far; the news of earlier ones are late."""
        self._loads = 0
        self._deadline: float | None = None
        self.reference = self.address = ""
        self.driver: str | None = None
        self.frame_rate = _FRAME_RATE
        self.state: RobotState | None = None
        self.crashes = 0
        self.problem = ""

    def show(self, reference: str | Path, driver: str | None = None) -> None:
        """Show a scenario or a run, in the process that runs, if there is one."""
        self.reference, self.driver, self.crashes = str(reference), driver, 0
        if self._process is None or self.is_late or self.state is None:
            self._start()
        else:
            self.state = None
            self._send(Command(verb="show", name=self.reference, value=driver or ""))
            self._ask(self._loads + 1)
            self._on_change()

    def save(self, scenario: Path, changed: tuple[str, ...]) -> None:
        """Read the files of a scenario again, or for the first time in place of another source, whose world
        stays while they have errors; the parameters `changed` take the values of the file."""
        if self.reference != str(scenario):
            self.reference, self.driver = str(scenario), None
        self.crashes = 0
        if self._process is None or self.is_late:
            self._start()
        else:
            self._send(Command(verb="reload", name=self.reference, names=changed))
            self._ask(self._loads + 1)
            self._on_change()

    @property
    def is_current(self) -> bool:
        """Whether the world is that of the files, as they were when they were to be read last."""
        state = self.state
        if state is None or state.state != "running" or state.text or state.reference != self.reference:
            return False
        return state.loaded >= self._loads

    @property
    def is_late(self) -> bool:
        """Whether the process has not read the files long after it was asked to: it may still do so, for
        example on a slow machine that loads a policy, or draw a start forever."""
        return self._deadline is not None and time.monotonic() > self._deadline

    def _ask(self, loads: int) -> None:
        """Note that the process is to read the files."""
        self._loads = loads
        wait = _START_S if loads == 1 else _PATIENCE_S
        if self._deadline is None or loads == 1:
            self._deadline = time.monotonic() + wait
        asyncio.get_running_loop().call_later(wait + 1.0, self._look)

    def _look(self) -> None:
        if self.is_late:
            self._on_change()

    def set_driver(self, name: str) -> None:
        self.driver = name
        self._send(Command(verb="driver", name=name))

    def set_parameter(self, name: str, value: str) -> None:
        self._send(Command(verb="parameter", name=name, value=value))

    def slow_down(self) -> None:
        """Send fewer pictures, for a browser that draws without a graphics card."""
        if self.frame_rate != _FRAME_RATE_OF_SOFTWARE:
            self.frame_rate = _FRAME_RATE_OF_SOFTWARE
            self._send(Command(verb="frame_rate", value=str(self.frame_rate)))

    def restart(self) -> None:
        """Begin the episode anew; a process that is gone is started."""
        if self._process is None or self.is_late:
            self.crashes = 0
            self._start()
        else:
            self._send(Command(verb="restart"))

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        self._starts += 1
        if process is not None:
            process.end()
        self._sender.shutdown(wait=False, cancel_futures=True)

    def _start(self) -> None:
        """Start a process in place of the present one."""
        self.close()
        self.problem = ""
        self._open_process()
        self._on_change()

    def _open_process(self) -> None:
        self.state, self.address = None, ""
        request = RobotRequest(
            reference=self.reference,
            driver=self.driver,
            allow_paths=tuple(map(str, self._permissions.folders)),
            allow_code=self._permissions.code,
            frame_rate=self.frame_rate,
        )
        self._starts += 1
        loop, number = asyncio.get_running_loop(), self._starts

        def tell(act: Callable[..., None], news: object) -> None:
            with suppress(RuntimeError):  # the server has ended
                loop.call_soon_threadsafe(act, number, news)

        try:
            self._process = Process(
                "deepbots_cli.studio.robot_process",
                hear=lambda line: tell(self._hear, line),
                on_end=lambda code: tell(self._ended, code),
                quiet=True,
            )
        except OSError as error:
            self.problem = f"the simulation cannot be started: {error.strerror}"
            return
        # A process that is stopped reads nothing, and a message to it waits once its pipe is full.
        self._sender = ThreadPoolExecutor(1)
        self._send(request)
        self._ask(1)

    def _hear(self, number: int, line: bytes) -> None:
        """Take a state that a process has sent."""
        if number != self._starts:
            return
        try:
            state = RobotState.model_validate_json(line)
        except ValidationError:  # a print of a library
            return
        is_newest = state.loaded >= self._loads
        if self.state is None and not is_newest and state.state != "failed":
            return  # of what was shown before
        self.state, self.address = state, state.address
        if is_newest:
            self._deadline, self.problem = None, ""
        self._on_change()

    def _ended(self, number: int, code: int) -> None:
        """Start the process again after a crash."""
        if number != self._starts:
            return
        state, self._process, self._deadline = self.state, None, None
        self.state, self.address = None, ""
        if state is not None and state.state == "failed":
            self.problem = state.text
        else:
            self.crashes += 1
            self._recover(code)
        self._on_change()

    def _recover(self, code: int) -> None:
        """Start the process again, unless it has crashed too often."""
        if self.crashes == _MAX_CRASHES:
            self.problem = f"the simulation ended {_MAX_CRASHES} times; change the file, or press Restart"
        else:
            self.problem = f"the process of the simulation ended ({_ended_by(code)}); it was started again"
            self._open_process()

    def _send(self, message: RobotRequest | Command) -> None:
        if self._process is not None:
            self._sender.submit(self._process.send, f"{message.model_dump_json()}\n".encode())


def _ended_by(code: int) -> str:
    return f"signal {-code}" if code < 0 and sys.platform != "win32" else f"exit code {code}"
