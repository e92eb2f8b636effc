"""The robot of the studio: a process that simulates it and serves its page, started again when it crashes."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from pydantic import ValidationError

from deepbots_cli.document import Permissions
from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.studio.robot_process import Command, RobotRequest, RobotState

_MAX_LINE_BYTES = 1 << 20
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
        self._process: asyncio.subprocess.Process | None = None
        self._tasks: set[asyncio.Task[None]] = set()
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

    async def close(self) -> None:
        """End the process."""
        await _canceled(list(self._tasks))
        await self._end()

    def _start(self) -> None:
        previous = list(self._tasks)

        async def run() -> None:
            await _canceled(previous)
            await self._end()
            await self._run()

        self.state, self.address, self.problem = None, "", ""
        task = asyncio.get_running_loop().create_task(run())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self._on_change()

    async def _run(self) -> None:
        """Run the process, and start it again after a crash."""
        while self.crashes < _MAX_CRASHES:
            self.state, self.address = None, ""
            try:
                process = self._process = await _open_process()
            except OSError as error:
                self.problem = f"the simulation cannot be started: {error.strerror}"
                break
            request = RobotRequest(
                reference=self.reference,
                driver=self.driver,
                allow_paths=tuple(map(str, self._permissions.folders)),
                allow_code=self._permissions.code,
                frame_rate=self.frame_rate,
            )
            self._write(f"{request.model_dump_json()}\n")
            self._ask(1)
            await self._listen(process)
            code = await process.wait()
            self._process = self._deadline = None
            if self.state is not None and self.state.state == "failed":
                self.problem = self.state.text
                break
            self.state = None
            self.crashes += 1
            if self.crashes < _MAX_CRASHES:
                self.problem = (
                    f"the process of the simulation ended ({_ended_by(code)}); it was started again"
                )
                self._on_change()
        else:
            self.problem = (
                f"the process of the simulation ended {_MAX_CRASHES} times; change the file, or press Restart"
            )
        self.state, self.address = None, ""
        self._on_change()

    async def _listen(self, process: asyncio.subprocess.Process) -> None:
        """Take the states that the process sends, until it ends."""
        assert process.stdout is not None
        while True:
            try:
                line = await process.stdout.readline()
            except ValueError:  # longer than the limit
                continue
            if not line:
                return
            try:
                state = RobotState.model_validate_json(line)
            except ValidationError:  # a print of a library
                continue
            is_newest = state.loaded >= self._loads
            if self.state is None and not is_newest and state.state != "failed":
                continue  # of what was shown before
            self.state, self.address = state, state.address
            if is_newest:
                self._deadline, self.problem = None, ""
            self._on_change()

    def _send(self, command: Command) -> None:
        self._write(f"{command.model_dump_json()}\n")

    def _write(self, line: str) -> None:
        if self._process is not None and self._process.stdin is not None:
            with suppress(OSError, RuntimeError):  # it has just ended
                self._process.stdin.write(line.encode())

    async def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None and process.returncode is None:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()


async def _canceled(tasks: Sequence[asyncio.Task[None]]) -> None:
    """Cancel tasks, and wait until they have ended."""
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def _open_process() -> asyncio.subprocess.Process:
    opening = asyncio.ensure_future(
        asyncio.create_subprocess_exec(
            *python_command("deepbots_cli.studio.robot_process"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            env=python_environment(),
            limit=_MAX_LINE_BYTES,
        )
    )
    try:
        # Python 3.11 can wait forever for a process whose opening was canceled.
        return await asyncio.shield(opening)
    except asyncio.CancelledError:
        (await opening).kill()
        raise


def _ended_by(code: int) -> str:
    return f"signal {-code}" if code < 0 and sys.platform != "win32" else f"exit code {code}"
