"""A project of Webots, which tests run."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

from tests.webots.exported_projects import HEADER, ROOT

CART = """
    from controller import Robot
    robot = Robot()
    emitter, receiver = robot.getDevice("emitter"), robot.getDevice("receiver")
    receiver.enable(32)
    while robot.step(32) != -1:
        while receiver.getQueueLength():
            emitter.send(receiver.getString() + "!")
            receiver.nextPacket()
    print("the end")
"""

BOSS = """
    from controller import Supervisor
    boss = Supervisor()
    emitter, receiver = boss.getDevice("emitter"), boss.getDevice("receiver")
    receiver.enable(32)
    for number in range(4):
        emitter.send(str(number))
        boss.step(32)
        words = []
        while receiver.getQueueLength():
            words.append(receiver.getString())
            receiver.nextPacket()
        print(number, words)
"""

WORLD = """WorldInfo { basicTimeStep 32 }
Robot { name "boss" supervisor TRUE controller "boss" children [ Emitter { } Receiver { } ] }
DEF CART Robot { name "cart" controller "cart" children [ Emitter { } Receiver { } ] }"""


class Project:
    """A project with one world, in a folder of a test."""

    def __init__(self, folder: Path, deepbots: Any) -> None:
        self.folder, self._deepbots = folder, deepbots
        self.words = ["webots", str(folder / "worlds" / "w.wbt"), "--allow-code"]
        self.write("worlds/w.wbt", HEADER + WORLD)
        self.controller("cart", CART)
        self.controller("boss", BOSS)

    def write(self, name: str, text: str) -> None:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(textwrap.dedent(text), encoding="utf-8")

    def controller(self, name: str, text: str) -> None:
        self.write(f"controllers/{name}/{name}.py", text)

    def run(self, *options: str, allow: bool = True, code: int = 0) -> Any:
        """Run the world, and assert the exit code."""
        return self._deepbots(*(self.words if allow else self.words[:-1]), *options, code=code)

    def start(self, *options: str) -> subprocess.Popen[str]:
        """Run the world in a process of its own."""
        words = [sys.executable, "-m", "deepbots_cli", *self.words, *options]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        return subprocess.Popen(words, cwd=self.folder, env=environment, text=True, **pipes)


@pytest.fixture
def project(tmp_path: Path, deepbots: Any) -> Project:
    return Project(tmp_path, deepbots)
