"""A studio in a process of its own, and a tab of Chromium that writes in its editor."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from deepbots_cli.processes import python_command, python_environment
from tests.view.browser import Tab

ENTER, BACKSPACE, ESCAPE, TAB = ("Enter", 13), ("Backspace", 8), ("Escape", 27), ("Tab", 9)

_START_S = 90.0


class Served:
    """A running studio. `address` is the URL of its page, with the token."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.process = subprocess.Popen(
            python_command("deepbots_cli", "studio", *arguments),
            cwd=folder,
            env=python_environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self.process.stdout is not None
        # A studio that has not started within this time is ended; then it has no address.
        limit = threading.Timer(_START_S, self.process.kill)
        limit.start()
        self.address = self.process.stdout.readline().strip()
        limit.cancel()
        threading.Thread(target=self.process.stdout.read, daemon=True).start()

    @property
    def port(self) -> int:
        return int(self.address.rpartition(":")[2].partition("/")[0])

    @property
    def token(self) -> str:
        return self.address.rpartition("token=")[2]

    def stop(self, number: int = signal.SIGINT) -> None:
        if self.process.poll() is None:
            os.kill(self.process.pid, number)
        self.process.wait(20)


@contextmanager
def served(folder: Path, *arguments: str) -> Iterator[Served]:
    studio = Served(folder, *arguments)
    try:
        assert studio.address, f"the studio did not start within {_START_S:g} s, or has failed"
        yield studio
    finally:
        studio.stop()


class StudioTab:
    """The page of a studio in a tab."""

    def __init__(self, tab: Tab, address: str, width: int = 1000, height: int = 640) -> None:
        self.tab = tab
        tab.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        self.load(address)

    def load(self, address: str) -> None:
        self.tab.call("Page.navigate", url=address)
        self.tab.wait("document.querySelectorAll('.cm-line').length > 3", 60)

    def wait(self, script: str, seconds: float = 30.0) -> Any:
        return self.tab.wait(script, seconds)

    def type(self, text: str, *, then: str = "", seconds: float = 30.0) -> None:
        """Type a text, and wait until the script `then`, if any, is true."""
        self.tab.call("Input.insertText", text=text)
        if then:
            self.wait(then, seconds)

    def press(self, key: tuple[str, int], times: int = 1, modifiers: int = 0) -> None:
        name, code = key
        for _ in range(times):
            text = {"text": "\r"} if name == "Enter" and not modifiers else {}
            for kind in ("keyDown", "keyUp"):
                self.tab.call(
                    "Input.dispatchKeyEvent",
                    type=kind,
                    key=name,
                    code=f"Key{name.upper()}" if len(name) == 1 else name,
                    windowsVirtualKeyCode=code,
                    modifiers=modifiers,
                    **(text if kind == "keyDown" else {}),
                )

    def save(self) -> None:
        self.press(("s", 83), modifiers=2)

    def click_line(self, begin: str) -> None:
        """Put the cursor at the end of the first visible line that begins so."""
        script = """(() => { const line = [...document.querySelectorAll('.cm-line')].find(
            line => line.innerText.startsWith(%s)); line?.scrollIntoView({block: 'nearest'});
            if (!line) return null;  // the page loads
            document.querySelector('.cm-scroller').scrollLeft = 0;
            const range = document.createRange(); range.selectNodeContents(line);
            const box = range.getBoundingClientRect(); return [box.x + 2, box.y + box.height / 2]; })()"""
        x, y = self.wait(script % json.dumps(begin))
        for kind in ("mousePressed", "mouseReleased"):
            self.tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
        self.press(("End", 35))

    def click(self, label: str, tag: str = "button", *, then: str = "", seconds: float = 30.0) -> None:
        """Click on what has this label, and wait until the script `then`, if any, is true."""
        script = """(() => { const one = [...document.querySelectorAll('%s')].find(
            one => one.innerText.trim() == %s && one.offsetParent && !one.disabled); one?.click(); return !!one; })()"""
        self.wait(script % (tag, json.dumps(label)))
        if then:
            self.wait(then, seconds)

    def open_tab(self, label: str) -> None:
        self.click(label, "[role=tab]")

    @property
    def text(self) -> str:
        """The visible lines of the editor."""
        return str(
            self.tab.run("[...document.querySelectorAll('.cm-line')].map(l => l.innerText).join('\\n')")
        )

    def findings(self) -> list[str]:
        return list(self.tab.run("[...document.querySelectorAll('.studio-row')].map(row => row.innerText)"))
