"""The section `ros`: what `inspect --ros` prints is a section that fits, and a bundle has it."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.document import shipped
from deepbots_robot.topics import Topic
from tests.few import WORLDS, few


@pytest.mark.parametrize("scenario", few(shipped.scenario_names(), (*WORLDS, "tag")))
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
