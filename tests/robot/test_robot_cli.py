"""`deepbots-robot check` and the keys of `deepbots export`, as a user runs them.

The section `ros`: what `inspect --ros` prints is a section that fits, and a bundle has it.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.document import shipped
from deepbots_robot import bundle, signature
from deepbots_robot.__main__ import main as robot
from deepbots_robot.topics import Topic
from tests.bundle.untrained import write_bundle
from tests.few import few


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bundle(tmp_path_factory.mktemp("bundle") / "cartpole", "cartpole")


def test_a_check_says_what_the_bundle_is_and_whether_it_is_signed(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "--new-key", str(tmp_path / "key")]) == 0
    public = tmp_path / "key.pub"
    signed = shutil.copytree(folder, tmp_path / "signed")
    description = (signed / bundle.BUNDLE_NAME).read_bytes()
    (signed / bundle.SIGNATURE_NAME).write_bytes(signature.sign(description, tmp_path / "key"))
    capsys.readouterr()
    assert robot(["check", str(signed), "--trusted", str(public)]) == 0
    assert "signed with a trusted key: yes" in capsys.readouterr().out
    assert robot(["check", str(folder)]) == 0
    assert "signed with a trusted key: not checked (--trusted FILE)" in capsys.readouterr().out
    assert robot(["check", str(folder), "--trusted", str(public)]) == 1
    assert "bundle.sig is missing; export the run again with --sign KEY" in capsys.readouterr().err
    assert main(["serve", str(folder), "--trusted", str(public), "--zmq", "tcp://127.0.0.1:58799"]) == 2
    assert "bundle.sig is missing" in capsys.readouterr().err
    assert robot(["check", str(signed), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["signature_checked"] is False


def test_trusted_keys_that_cannot_be_read_are_no_reason_to_export_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert robot(["check", str(folder), "--trusted", str(tmp_path / "missing.pub")]) == 1
    assert capsys.readouterr().err.endswith("missing.pub is not a file\n")


def test_ros_1_is_gone_and_the_error_names_the_links_that_remain(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert robot(["serve", "bundle", "--ros1"]) == 1
    error = capsys.readouterr().err
    assert all(word in error for word in ("ROS 1 is gone", "ros1_bridge", "ZeroMQ", "WebSocket"))


@pytest.mark.parametrize(
    ("words", "code", "error"),
    [
        (["--websocket", "5598"], 2, "argument --websocket: not allowed with argument --zmq"),
        (["--domain", "0"], 1, "--domain belong to ROS 2; leave out --zmq"),
    ],
)
def test_an_option_of_another_link_is_refused_and_not_dropped(
    words: list[str], code: int, error: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        ended = robot(["serve", "bundle", "--zmq", "tcp://127.0.0.1:5599", *words])
    except SystemExit as usage:
        ended = usage.code
    assert (ended, error in capsys.readouterr().err) == (code, True)


def test_the_check_runs_nothing_that_lies_in_the_folder(folder: Path, tmp_path: Path) -> None:
    """`python -c "import deepbots_robot"` in the folder of a bundle imported its `json.py`."""
    place = shutil.copytree(folder, tmp_path / "bundle")
    for name in ("json", "argparse", "numpy", "msgspec"):
        (place / f"{name}.py").write_text("raise SystemExit('this ran')\n")
    script = Path(sys.executable).with_name("deepbots-robot")
    if not script.exists():
        pytest.skip("the package is not installed")
    done = subprocess.run([script, "check", "."], cwd=place, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_terminal_of_another_encoding_gets_escapes(folder: Path) -> None:
    """The name of a scenario with other letters ended in a traceback under LC_ALL=C."""
    code = (
        "import sys; from deepbots_robot.__main__ import main; print('\\u03bb', end='') if"
        " main(sys.argv[1:]) else print('\\u03bb')"
    )
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    words = [sys.executable, "-P", "-c", code, "check", str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, env=environment)
    assert (done.returncode, done.stdout.splitlines()[-1], done.stderr) == (0, "\\u03bb", "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "package", "words", "extra"),
    [
        ("zmq", "pyzmq", ["serve", "BUNDLE", "--zmq", "tcp://127.0.0.1:58798"], "zmq"),
        ("websockets", "websockets", ["serve", "BUNDLE", "--websocket", "58798"], "websocket"),
        ("cyclonedds", "cyclonedds", ["serve", "BUNDLE"], "ros"),
        ("mcap", "mcap", ["serve", "BUNDLE", "--log", "a.mcap"], "log"),
        ("cryptography", "cryptography", ["check", "BUNDLE", "--trusted", "key.pub"], "sign"),
    ],
)
def test_a_package_that_is_missing_on_the_robot_is_named_with_its_extra(
    folder: Path, tmp_path: Path, module: str, package: str, words: list[str], extra: str
) -> None:
    """A robot was asked to install pyzmq where `deepbots-robot[zmq]` has the version that fits."""
    pytest.importorskip("cryptography")
    signed = shutil.copytree(folder, tmp_path / "signed")
    signature.write_key(tmp_path / "key")
    (signed / bundle.SIGNATURE_NAME).write_bytes(
        signature.sign((signed / bundle.BUNDLE_NAME).read_bytes(), tmp_path / "key")
    )
    program = (
        f"import sys; sys.modules[{module!r}] = None; from deepbots_robot.__main__ import main;"
        " sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", program, *(str(signed) if word == "BUNDLE" else word for word in words)]
    environment = os.environ | {"PYTHONPATH": str(Path(bundle.__file__).parents[1])}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1
    assert package in done.stderr
    assert "is not installed" in done.stderr
    assert done.stderr.endswith(f'pip install "deepbots-robot[{extra}]"\n')
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["export", "--new-key", "KEY", "run"], "give it alone"),
        (["export"], "write what to export"),
        (["export", "run", "--sign", "KEY", "--to", "lerobot"], "--sign signs a bundle"),
        (["serve", "cartpole", "--as-robot", "--trusted", "KEY"], "belongs to the policy"),
    ],
)
def test_options_of_keys_that_do_not_fit_are_refused(
    words: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    "scenario", few(shipped.scenario_names(), ("multi_cartpole", "see_ball", "panda_reach", "tag"))
)
def test_what_inspect_prints_is_a_section_without_findings(
    scenario: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["inspect", scenario, "--ros"]) == 0
    printed = capfd.readouterr().out
    Path("mine.yaml").write_text(f"deepbots: 1\nextends: {scenario}\n{printed}")
    assert not [finding for finding in api.lint("mine.yaml") if finding.severity == "error"]
    compiled = api.compile("mine.yaml")
    assert len(compiled.program.ros) == len(printed.splitlines()) - 1
    assert compiled.digest == api.compile(scenario).digest  # topics do not change a policy


def test_a_topic_of_no_agent_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    topics = "ros:\n  blue.left_wheel: {topic: /b, type: sensor_msgs/JointState}\n"
    wrong = topics + "  blue.left_whel: {topic: /c, type: sensor_msgs/JointState}\n"
    Path("mine.yaml").write_text(f"deepbots: 1\nextends: sumo\n{wrong}")
    (finding,) = [finding for finding in api.lint("mine.yaml") if finding.severity == "error"]
    assert finding.headline == "there is no sensor, reading or actuator `blue.left_whel`"


def test_a_bundle_has_the_topics_of_its_scenario() -> None:
    pytest.importorskip("onnx")
    from deepbots_cli.insight.export.bundle import ros_topics

    program = api.compile(
        "cartpole",
        overrides=["ros={cart.pole_angle: {topic: /pole, type: sensor_msgs/JointState, part: position}}"],
    ).program
    topics = {
        name: Topic(topic.topic, topic.type, topic.part)
        for name, topic in ros_topics(program, {"cart.pole_angle", "position(cart)"}).items()
    }
    assert topics == {
        "cart.pole_angle": Topic("/pole", "sensor_msgs/JointState", "position"),
        "position(cart)": Topic("/supervisor/position_cart", "geometry_msgs/PoseStamped"),
    }
