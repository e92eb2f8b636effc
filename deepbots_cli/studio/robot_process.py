"""The process behind the robot of the studio: a page of `deepbots view`, driven by lines of JSON.

The first line of standard input is a `RobotRequest`; each further line is a `Command`. Each line of standard
output is a `RobotState`. The process ends with its standard input.
"""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import IO, Literal

from pydantic import BaseModel, ValidationError

from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.processes import message_streams
from deepbots_cli.rollout.drivers import HAND
from deepbots_cli.view.episodes import Showing
from deepbots_cli.view.page import Page

_STATE_INTERVAL_S = 0.2
"""The time between two looks at the state."""


class RobotRequest(BaseModel, strict=True, frozen=True):
    """What the process shows: a scenario file, or a run whose newest policy drives.

    Attributes:
        driver: Who drives, None for the default.
        frame_rate: The pictures per second.
    """

    reference: str
    driver: str | None = None
    allow_paths: tuple[str, ...] = ()
    allow_code: bool = False
    frame_rate: int = 30


class Command(BaseModel, strict=True, frozen=True):
    """A command to the process.

    `show` shows the scenario or run `name`, driven by `value`, or by its default if that is empty. `reload`
    reads the files of `name`, after the parameters `names` have returned to the values of the file; while
    they have errors, the world before stays.
    """

    verb: Literal["show", "reload", "driver", "parameter", "restart", "frame_rate"]
    name: str = ""
    value: str = ""
    names: tuple[str, ...] = ()


class RobotState(BaseModel, strict=True, frozen=True):
    """The state of the robot's page.

    Attributes:
        address: The URL of the page, with its token.
        reference: The scenario or run of the world; empty while there is none.
        state: `running`; `outdated`, if the files have errors and the world is an earlier one; `errors`, if
            there is no world; `failed`, if the process could not start.
        text: The reason of `failed`, and why the simulation has stopped or could not begin; empty for files
            with errors.
        loaded: The number of times that files were read.
        changes: What the files changed when they were read last, against the world before; empty for nothing.
        changed: The values that replace parameters of the file.
        note: What the driver says about itself, such as the steps of a policy in training; or why a parameter
            is refused.
        keys: The names of keys that drive, with what they do, while a person drives; empty otherwise.
        waiting: Whether the episode waits for the first key of the person.
        paused: Whether time stands still until the person continues.
        ended: How the last episode of the present driver ended; empty before.
        last, best: The returns of the last and of its best episode, None before one.
        goal: The mean return with which the task is solved, None without one.
    """

    address: str = ""
    reference: str = ""
    state: Literal["running", "outdated", "errors", "failed"]
    text: str = ""
    loaded: int = 0
    changes: str = ""
    driver: str = ""
    drivers: tuple[str, ...] = ()
    parameters: dict[str, str] = {}
    changed: dict[str, str] = {}
    note: str = ""
    keys: tuple[tuple[tuple[str, ...], str], ...] = ()
    waiting: bool = False
    paused: bool = False
    ended: str = ""
    last: float | None = None
    best: float | None = None
    goal: float | None = None


def serve(request: RobotRequest, commands: Iterable[bytes], output: IO[bytes]) -> None:
    """Serve the page until the commands end."""
    page = Page(
        Showing(
            request.reference,
            (),
            Permissions(tuple(map(Path, request.allow_paths)), code=request.allow_code),
        ),
        driver=request.driver,
        port=0,
        embedded=True,
        frame_rate=request.frame_rate,
    )
    lines: queue.SimpleQueue[Command | None] = queue.SimpleQueue()

    def read() -> None:
        with suppress(ValidationError):  # half a line, of a studio that was killed
            for line in commands:
                lines.put(Command.model_validate_json(line))
        lines.put(None)

    threading.Thread(target=read, daemon=True).start()
    loaded, looks, shown = 1, 0, ""
    refusals: list[DeepbotsError] = []

    def obey(command: Command) -> None:
        nonlocal loaded, looks
        try:
            _obey(page, command)
        except DeepbotsError as error:
            if command.verb != "show":
                raise
            refusals.append(error)
        finally:
            loaded += command.verb in ("show", "reload")
            looks = -1

    def must_end() -> bool:
        nonlocal looks, shown
        while not lines.empty():
            command = lines.get()
            if command is None:
                return True
            page.submit(lambda command=command: obey(command))  # type: ignore[misc]
        if refusals:
            raise refusals[0]
        looks += 1
        is_due = looks % max(1, round(_STATE_INTERVAL_S * page.frame_rate)) == 0
        if is_due and (text := _state(page, loaded).model_dump_json()) != shown:
            shown = text
            _send(output, text)
        return False

    try:
        page.run(until=must_end)
    finally:
        page.close()


def _obey(page: Page, command: Command) -> None:
    if command.verb == "show":
        page.show_source(command.name, command.value or None)
    elif command.verb == "reload":
        page.reload_source(command.name, command.names)
    elif command.verb == "parameter":
        page.change_parameter(command.name, command.value)
    elif command.verb == "frame_rate":
        page.frame_rate = max(1, min(60, int(command.value)))
    elif page.player is not None and command.verb == "driver":
        page.set_driver(command.name)
    elif page.player is not None:
        page.playback.begin()


def _state(page: Page, loaded: int) -> RobotState:
    player, playback = page.player, page.playback
    if player is None:
        return RobotState(address=page.address, state="errors", text=page.reason, loaded=loaded)
    return RobotState(
        address=page.address,
        reference=player.opened.shown.reference,
        state="outdated" if page.outdated else "running",
        text=page.reason if playback.stopped else "",
        loaded=loaded,
        changes=page.changes,
        driver=player.driver_name,
        drivers=tuple(player.opened.drivers),
        parameters=dict(player.opened.parameters),
        changed=dict(page.changed_parameters),
        note=player.driver.note,
        keys=tuple(playback.manual_input.effects()) if player.driver_name == HAND else (),
        waiting=playback.waiting,
        paused=playback.paused,
        ended=playback.last_ending,
        last=playback.last_return,
        best=playback.best_return if playback.last_return is not None else None,
        goal=solved.mean_return if (solved := player.program.agent.solved) is not None else None,
    )


def _send(output: IO[bytes], text: str) -> None:
    output.write(f"{text}\n".encode())
    output.flush()


def main() -> int:
    """Serve what the first line of standard input requests."""
    source, output = message_streams()
    lines = iter(source.readline, b"")
    try:
        for line in lines:
            serve(RobotRequest.model_validate_json(line), lines, output)
    except DeepbotsError as error:
        _send(output, RobotState(state="failed", text=str(error)).model_dump_json())
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
