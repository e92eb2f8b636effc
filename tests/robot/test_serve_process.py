"""`deepbots serve` and `deepbots-robot serve` as processes: their imports, their memory, and their log after
a kill."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
pytest.importorskip("zmq")
pytest.importorskip("mcap")

import zmq

from deepbots_cli.cli import main
from deepbots_robot.bundle import load
from deepbots_robot.log import read_log
from deepbots_robot.serving import Transport, serve, stopping
from tests.bundle.untrained import write_bundle

ROOT = Path(__file__).parents[2]
HEAVY = ("torch", "pybullet", "mujoco", "scipy", "gymnasium", "onnx", "matplotlib", "pandas")
MAX_MEMORY = 100  # MB


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bundle(tmp_path_factory.mktemp("serve") / "bundle", "cartpole")


@contextmanager
def running(*words: object) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, *map(str, words)],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


PROGRAM = """
import json, re, runpy, sys
sys.argv = ["deepbots_robot", *sys.argv[1:]]
try:
    runpy.run_module("{module}", run_name="__main__")
except SystemExit:
    pass
status = open("/proc/self/status").read() if sys.platform == "linux" else "VmHWM: 0 kB"
print(json.dumps({{"modules": sorted(sys.modules), "memory": int(re.search(r"VmHWM:\\s*(\\d+)", status)[1]) / 1024}}))
"""


@pytest.mark.parametrize("module", ["deepbots_robot", pytest.param("deepbots_cli", marks=pytest.mark.slow)])
@pytest.mark.parametrize("link", [("--ros", "--domain", 72), ("--zmq", "tcp://127.0.0.1:58731")])
def test_a_server_imports_no_simulator_and_takes_little_memory(
    bundle: Path, tmp_path: Path, module: str, link: tuple[object, ...]
) -> None:
    if "--ros" in link:
        pytest.importorskip("cyclonedds")
    words = ["serve", bundle, *link, "--seconds", 0.3, "--log", tmp_path / "a.mcap"]
    with running("-c", PROGRAM.format(module=module), *words) as process:
        out, err = process.communicate(timeout=60)
    report = json.loads(out.splitlines()[-1])
    assert "messages     0 received, 0 refused" in out, err
    assert not set(HEAVY) & set(report["modules"])
    assert ("deepbots_cli" in report["modules"]) == (module == "deepbots_cli")
    assert report["memory"] <= MAX_MEMORY


def test_a_killed_robot_ends_in_the_safe_posture_and_a_killed_server_leaves_a_log(
    bundle: Path, tmp_path: Path
) -> None:
    link = f"ipc://{tmp_path}/link"
    log = tmp_path / "a.mcap"
    serve = (*("-m", "deepbots_robot", "serve", bundle, "--zmq", link, "--log", log),)
    with (
        running(*serve) as server,
        running("-m", "deepbots_cli", "serve", "cartpole", "--as-robot", "--zmq", link) as robot,
    ):
        _until(lambda: log.exists() and sum(topic == "/step" for topic, _, _ in read_log(log)) > 40)
        robot.send_signal(signal.SIGKILL)
        _until(lambda: any(content.get("posture") == "safe" for _, _, content in read_log(log)))
        time.sleep(1.2)
        killed = time.time()
        server.send_signal(signal.SIGKILL)
        server.wait(10)
    entries = list(read_log(log))
    assert killed - entries[-1][1] <= 1.0
    last = entries[-1][2]
    assert {**last, "ages": {}} == {
        "inputs": {},
        "ages": {},
        "commands": {"cart.wheels": [0.0] * 4},
        "answer": 0.0,
        "posture": "safe",
    }
    assert min(last["ages"].values()) > 0.096  # beyond the age limit
    assert any(
        content["kind"] == "safe" and "no new value" in content["text"]
        for topic, _, content in entries
        if topic == "/event"
    )


def _until(holds: object) -> None:
    until = time.monotonic() + 30
    while time.monotonic() < until:
        if holds():  # type: ignore[operator]
            return
        time.sleep(0.1)
    pytest.fail("it did not happen within 30 s")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nothing"], "nothing is not a bundle of `deepbots export`: there is no such folder"),
        (
            ["BUNDLE", "--ros", "--zmq", "tcp://127.0.0.1:5555"],
            "--ros and --zmq are different links; choose one",
        ),
        (["BUNDLE", "--ros1"], "there is no option --ros1; use `--ros with ros1_bridge, --zmq ADDRESS"),
        (
            ["BUNDLE", "--zmq", "127.0.0.1:5555"],
            "'127.0.0.1:5555' is not an address of ZeroMQ; write one like tcp://127.0.0.1:5555",
        ),
        (
            ["BUNDLE", "--zmq", "tcp://127.0.0.1:5555", "--domain", "3"],
            "--interface and --domain belong to ROS 2",
        ),
        (["BUNDLE", "--interface", "<x>"], "'<x>' is not a network interface of this machine; it has"),
        (["BUNDLE", "--speed", "0"], "--speed 0: write a number above 0, at most 1000"),
        (["BUNDLE", "--episodes", "3"], "belong to a simulated robot; add --as-robot or leave them out"),
        (
            ["BUNDLE", "--zmq", "tcp://127.0.0.1:58733", "--seconds", "0.1"],
            "the policy did not act within 0.1 s: no value of position(cart),",
        ),
        (
            ["BUNDLE", "--log", "missing/a.mcap"],
            "missing/a.mcap cannot be written: no such file or directory",
        ),
        (
            ["cartpole", "--as-robot", "--log", "a.mcap"],
            "--log, --seconds and --trusted belong to the policy",
        ),
        (["multi_cartpole", "--as-robot"], "has copies of a robot"),
    ],
)
def test_a_bundle_that_cannot_be_served_is_refused_in_a_sentence(
    bundle: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    words: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["serve", *(str(bundle) if word == "BUNDLE" else word for word in words)]) != 0
    error = " ".join(capfd.readouterr().err.split())
    assert message in error
    assert "Traceback" not in error
    assert os.listdir(tmp_path) == []


def test_a_server_that_does_not_start_leaves_neither_link_nor_log_open(bundle: Path, tmp_path: Path) -> None:
    address, log = f"ipc://{tmp_path}/link", tmp_path / "a.mcap"

    def fail(text: str) -> None:
        raise RuntimeError(text)

    with pytest.raises(RuntimeError, match="it waits for the robot"):
        serve(load(bundle), Transport.at(address), log=log, note=fail)
    assert log.read_bytes().endswith(b"MCAP0\r\n")
    with zmq.Context() as context, context.socket(zmq.PAIR) as socket:
        socket.bind(address)


def test_signals_return_to_handlers_that_python_cannot_set_again(monkeypatch: pytest.MonkeyPatch) -> None:
    set_handler = signal.signal
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def set_handler_of_c(number: int, handler: Any) -> None:
        """`signal.signal` for a signal whose handler C code has installed."""
        set_handler(number, handler)

    monkeypatch.setattr(signal, "signal", set_handler_of_c)
    try:
        with stopping() as stopped:
            signal.raise_signal(signal.SIGTERM)
            assert stopped()
        assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    finally:
        for number, handler in handlers.items():
            set_handler(number, handler)


def test_a_simulated_robot_needs_no_torch() -> None:
    code = (
        "import sys, deepbots_cli.insight.robot, deepbots_cli.insight.real_robot; print('torch' in"
        " sys.modules)"
    )
    with running("-c", code) as process:
        assert process.communicate(timeout=60)[0] == "False\n"
