"""Chromium without a display, driven over its DevTools protocol; WebGL is drawn by software."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
_ANSWER_S = 180.0
FLAGS = (
    *(
        "--headless=new",
        "--no-sandbox",
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--hide-scrollbars",
    ),
    *(
        "--disable-dev-shm-usage",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
    ),
    *("--remote-debugging-port=0", "--remote-allow-origins=*"),
)


class Tab:
    """One page. `requests` are the addresses that it asked for, `errors` what its console reported."""

    def __init__(self, wire: Any) -> None:
        self._wire = wire
        self._number = 0
        self.requests: list[str] = []
        self.errors: list[str] = []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> Any:
        self._number += 1
        self._wire.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        end = time.monotonic() + _ANSWER_S  # events can arrive for ever
        while True:
            try:
                answer = json.loads(self._wire.recv(timeout=max(0.0, end - time.monotonic())))
            except TimeoutError:
                raise TimeoutError(f"Chromium did not answer {method} within {_ANSWER_S:g} s") from None
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]
            self._note(answer)

    def _note(self, event: dict[str, Any]) -> None:
        params = event.get("params", {})
        if event.get("method") in ("Network.requestWillBeSent", "Network.webSocketCreated"):
            self.requests.append(params["request"]["url"] if "request" in params else params["url"])
        elif event.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(f"{params['entry']['text']} {params['entry'].get('url', '')}")
        elif event.get("method") == "Runtime.exceptionThrown":
            self.errors.append(str(params["exceptionDetails"].get("text")))

    def run(self, script: str) -> Any:
        """The value of a script."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, script: str, seconds: float = 30.0) -> Any:
        """The first value of a script that is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            value = self.run(script)
            if value:
                return value
            time.sleep(0.1)
        raise AssertionError(f"never true: {script}\n{self.run('document.body.innerText')}\n{self.errors}")

    def open(self, address: str, width: int = 800, height: int = 500) -> None:
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        self.call("Page.navigate", url=address)
        self.wait("document.querySelector('canvas') != null")

    def see(self, path: str | None = None) -> np.ndarray[Any, Any]:
        """A picture of the page, uint8 (height, width, 3)."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path:
            with open(path, "wb") as file:
                file.write(data)
        return np.asarray(Image.open(BytesIO(data)).convert("RGB"))

    def key(self, code: str, *, down: bool) -> None:
        self.call(
            "Input.dispatchKeyEvent",
            type="keyDown" if down else "keyUp",
            code=code,
            key=code.removeprefix("Key").lower(),
        )

    def click(self, text: str) -> None:
        """Press the first button, tab, or checkbox beside a label that says `text`, with the mouse: tabs heed
        nothing else."""
        script = """(() => { const x = [...document.querySelectorAll('button, [role=tab], label')].find(
            x => x.innerText.trim() == %s && x.offsetParent); if (!x) return null;
            const y = x.tagName == 'LABEL' ? document.getElementById(x.htmlFor) || x : x;
            y.scrollIntoView({block: 'nearest', behavior: 'instant'}); const r = y.getBoundingClientRect();
            return [r.x + r.width / 2, r.y + r.height / 2]; })()"""
        x, y = self.wait(script % json.dumps(text))
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    @property
    def text(self) -> str:
        return str(self.run("document.body.innerText"))


@contextmanager
def browser() -> Iterator[Any]:
    """A function that opens a new tab."""
    from websockets.sync.client import connect

    assert CHROMIUM is not None
    with tempfile.TemporaryDirectory(
        ignore_cleanup_errors=True
    ) as folder:  # helpers of Chromium may still write there
        process = subprocess.Popen(
            [CHROMIUM, *FLAGS, f"--user-data-dir={folder}", "about:blank"],
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
        )
        wires = []
        try:
            assert process.stderr is not None
            line = next(line for line in process.stderr if "DevTools listening" in line)
            base = line.split("ws://")[1].split("/")[0]

            def tab() -> Tab:
                request = urllib.request.Request(f"http://{base}/json/new?about:blank", method="PUT")
                with urllib.request.urlopen(request) as answer:
                    target = json.load(answer)
                # Nobody reads the events of a page while a test waits for something else. With a full queue,
                # the library does not read the answers to its pings either, and gives the connection up.
                address = target["webSocketDebuggerUrl"]
                wires.append(connect(address, max_size=1 << 26, max_queue=None, ping_interval=None))
                return Tab(wires[-1])

            yield tab
        finally:
            for wire in wires:
                wire.close()
            process.terminate()
            process.wait()
