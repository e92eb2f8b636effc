"""Exported networks act as Stable-Baselines3 does. `deepbots export` describes the files that it writes, and
refuses scenarios that do not fit."""

from __future__ import annotations

import hashlib
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
import onnxruntime
import torch
import yaml

import deepbots_robot
from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import UsageError
from deepbots_cli.insight.export import network
from deepbots_cli.insight.export.network import Graph
from deepbots_cli.learning import learner as learners
from deepbots_cli.program.task import Network, Training
from deepbots_cli.runtime.spaces import action_space, observation_space

slow = pytest.mark.slow


def _untrained(scenario: str, algorithm: str, activation: str = "tanh", frame_stack: int = 1):
    """A program, and an untrained policy whose weights are spread, so that its actions differ."""
    program = api.compile(scenario).program
    training = Training(algorithm, 1000, network=Network((32, 32), activation))
    program = program.with_agent(training=training, frame_stack=frame_stack)
    learner = learners.create(
        learners.Setup(training, observation_space(program.agent), action_space(program.agent))
    )
    with torch.no_grad():
        for weight in learner.model.policy.parameters():
            weight.mul_(1.5).add_(0.05 * torch.randn_like(weight))
    return program, learner


def _session(graph: bytes):
    return onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])


@pytest.mark.parametrize(
    ("scenario", "algorithm", "activation"),
    [
        ("cartpole", "PPO", "tanh"),
        ("cartpole", "DQN", "gelu"),
        ("find_and_avoid", "MaskablePPO", "elu"),
        ("cartpole", "RecurrentPPO", "tanh"),
        ("find_ball", "SAC", "silu"),
        ("panda_reach", "TD3", "leaky_relu"),
        pytest.param("find_ball", "DDPG", "relu", marks=slow),
        pytest.param("find_ball", "TQC", "relu", marks=slow),
        pytest.param("find_ball", "RecurrentPPO", "relu", marks=slow),
        pytest.param("cartpole", "A2C", "tanh", marks=slow),
        pytest.param("cartpole", "MaskablePPO", "tanh", marks=slow),
        pytest.param("panda_push", "SAC", "relu", marks=slow),
        pytest.param("tag_scripted", "PPO", "tanh", marks=slow),
    ],
)
def test_actions_are_those_of_stable_baselines3(scenario, algorithm, activation):
    program, learner = _untrained(scenario, algorithm, activation)
    graph = network.policy_graph(learner, program)
    session = _session(graph)
    assert (
        network.largest_difference(learner, program, graph, 10_000, lambda feeds: session.run(None, feeds))
        <= network.TOLERANCE
    )


@pytest.mark.slow
def test_pictures_are_seen_as_stable_baselines3_sees_them():
    program, learner = _untrained("see_ball", "PPO")
    graph = network.policy_graph(learner, program)
    session = _session(graph)
    assert (
        network.largest_difference(learner, program, graph, 200, lambda feeds: session.run(None, feeds))
        <= network.TOLERANCE
    )


def test_older_values_stand_where_the_environment_puts_them():
    program, learner = _untrained("cartpole", "PPO", frame_stack=3)
    assert _session(network.policy_graph(learner, program)).get_inputs()[0].shape == ["batch", 12]
    assert [entry.steps_ago for entry in program.agent.inputs][::4] == [2, 1, 0]


# torch warns that an odd zero costs it a copy.
@pytest.mark.filterwarnings("ignore:Using padding=.same")
@pytest.mark.parametrize("padding", ["same", "valid", (2, 1)])
def test_a_convolution_has_the_padding_of_torch(padding: str | tuple[int, int]):
    layer = torch.nn.Conv2d(3, 2, (4, 3), padding=padding, dilation=(1, 2))
    images = torch.rand(2, 3, 9, 8)
    expected = layer(images).detach().numpy()
    graph = Graph()
    result = network.layers(graph, layer, graph.input("images", np.float32, *images.shape))
    graph.output("result", result, np.float32, *expected.shape)
    (output,) = _session(graph.model("convolution")).run(None, {"images": images.numpy()})
    assert output == pytest.approx(expected, abs=1e-5)


def test_a_layer_that_is_not_known_is_named():
    program, learner = _untrained("cartpole", "PPO")
    learner.model.policy.mlp_extractor.policy_net[1] = torch.nn.Dropout()
    with pytest.raises(UsageError, match="layer Dropout"):
        network.policy_graph(learner, program)


def test_a_rate_has_a_unit_and_a_plain_number_none():
    rates = ["augment.rate=1 / (1 s + time)", "augment.share=x / track"]
    ranges = ["observation.rate=0 .. 1 Hz", "observation.share=-1 .. 1"]
    program = api.compile("cartpole", overrides=[*rates, *ranges]).program
    units = {entry.name: entry.unit for entry in program.agent.inputs}
    assert (units["rate"], units["share"]) == ("1/s", "")


@pytest.fixture(scope="session")
def bundle(run, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("bundles") / "cartpole-bundle"
    assert main(["export", str(run), "-o", str(folder)]) == 0
    return folder


def test_the_bundle_describes_its_inputs_its_outputs_and_its_evaluation(bundle):
    description = json.loads((bundle / "bundle.json").read_text())
    inputs = {entry["name"]: entry for entry in description["inputs"]}
    angle, place = inputs["cart.pole_angle"], inputs["position(cart)"]
    assert (angle["source"], angle["sensor"], angle["joints"], angle["unit"]) == (
        "sensor",
        "joint_position",
        ["pole_hinge"],
        "rad",
    )
    assert (place["source"], place["components"], place["unit"], place["frame"]) == (
        "supervisor",
        ["x", "y", "z"],
        "m",
        "world",
    )
    (wheels,) = description["outputs"]
    assert (wheels["name"], wheels["kind"], wheels["unit"], wheels["safe"]) == (
        "cart.wheels",
        "velocity",
        "rad/s",
        [0.0] * 4,
    )
    assert wheels["range"] == [[-10.0] * 4, [10.0] * 4]  # of the URDF
    assert description["action"] == [
        {
            "name": "drive",
            "unit": "",
            "low": None,
            "high": None,
            "options": description["action"][0]["options"],
        }
    ]
    assert description["action"][0]["options"] == {"forward": {"drive": 1.0}, "backward": {"drive": -1.0}}
    assert (description["rate_hz"], description["evaluation"]["episodes"]) == (31.25, 12)
    urdf = (bundle / "inputs" / description["scenario"]["robots"]["cart"]["file"]).read_bytes()
    assert description["scenario"]["robots"]["cart"]["digest"] == hashlib.sha256(urdf).hexdigest()
    text = (bundle / "README.md").read_text()
    assert "| cart.pole_angle | 0 | pole_hinge | rad | no limit | yes | sensor (joint_position) |" in text
    assert (
        "The policy acts on 4 numbers: `position(cart)` (x), `velocity(cart)` (x), `cart.pole_angle`,"
        " `velocity(cart.tip)` (x)." in text
    )
    assert f"mean return {description['evaluation']['mean_return']:.4g} (95 % interval " in text


def test_a_folder_for_a_model_hub_has_a_card_the_model_a_video_and_the_bundle(
    run, tmp_path, monkeypatch, deepbots
):
    folder = tmp_path / "hub"
    assert (
        f"\n  hf upload YOUR_NAME/hub {folder}\n" in deepbots("export", run, "--to", "hub", "-o", folder).err
    )
    _, metadata, card = (folder / "README.md").read_text(encoding="utf-8").split("---\n", 2)
    known = yaml.safe_load(metadata)
    assert known["library_name"] == "stable-baselines3"
    (result,) = known["model-index"][0]["results"]
    description = json.loads((folder / "bundle" / "bundle.json").read_text())
    assert result["metrics"][0]["value"] == description["evaluation"]["mean_return"]
    assert (folder / "replay.mp4").read_bytes()[4:8] == b"ftyp"
    deepbots_robot.load(folder / "bundle")
    monkeypatch.chdir(folder)
    (program,) = re.findall(r"```python\n(.*?)```", card, re.DOTALL)
    names: dict[str, object] = {}
    exec(program, names)
    assert names["action"] in (0, 1)


def test_a_machine_that_writes_no_videos_makes_a_folder_for_a_hub_without_one(
    run, tmp_path, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    folder = tmp_path / "hub"
    assert main(["export", str(run), "--to", "hub", "-o", str(folder)]) == 0
    assert not (folder / "replay.mp4").exists()
    assert "replay.mp4" not in (folder / "README.md").read_text(encoding="utf-8")
    assert "there is no video" in capsys.readouterr().err


def test_the_programs_of_the_readme_and_of_the_docs_run(bundle, monkeypatch):
    page = Path(__file__).parents[2] / "docs" / "robot.md"
    for place, text in ((bundle, bundle / "README.md"), (bundle.parent, page)):
        monkeypatch.chdir(place)
        for code in re.findall(r"```python[^\n]*\n(.*?)```", text.read_text(encoding="utf-8"), re.DOTALL):
            names: dict[str, object] = {}
            exec(code, names)
            assert np.shape(names["commands"]["cart.wheels"]) == (4,)


def test_the_next_command_that_checks_a_new_bundle_runs_as_printed(run, tmp_path, deepbots):
    printed = deepbots("export", run, "-o", tmp_path / "new").err
    assert "fits" in deepbots(*shlex.split(printed.rpartition("\n  deepbots ")[2])).out


def test_a_bundle_that_does_not_fit_is_refused_item_by_item(bundle, deepbots):
    assert "fits cartpole" in deepbots("export", "--check", "cartpole", bundle).out
    output = deepbots("export", "--check", "cartpole", bundle, "--set", "observation.x=-1 .. 1 m", code=1).out
    assert "observation.x: bundle -0.4 .. 0.4 m, scenario -1 .. 1 m" in output
    assert "cart.pole_angle" not in output
    assert (
        "leave out --agent" in deepbots("export", "--check", "cartpole", bundle, "--agent", "one", code=2).err
    )
    output = deepbots("export", "--check", "cartpole", bundle, "--set", "world.timestep=16ms").err
    assert "0.032 s" in output
    command = shlex.split(output.strip().rpartition("deepbots ")[2])  # its robot file is in the bundle
    assert "world.timestep" in deepbots(*command, code=1).out
    assert (
        deepbots("export", "--check", bundle / "scenario.yaml", bundle, "--set", "train.gamma=0.9").err == ""
    )


def test_nothing_is_overwritten_and_a_group_is_refused(bundle, run, tmp_path, deepbots):
    (tmp_path / "file").write_text("")
    (tmp_path / "group.json").write_text("{}")
    replaced = "is not empty; choose another folder, or replace files of the same name with --force"
    for source, target, options, message in (
        (run, bundle, [], replaced),
        (run, tmp_path / "file" / "new", [], "is not a directory"),
        (tmp_path, tmp_path / "new", [], ""),
        (run, tmp_path / "new", ["--to", "isaac-lab"], "choices, goals, images, copies"),
    ):
        assert message in deepbots("export", source, "-o", target, *options, code=2).err
    assert not (tmp_path / "new").exists()


def test_export_to_isaac_lab_refuses_before_it_imports_torch_and_reads_the_model(run, tmp_path):
    """With both, the refusal of a scenario that does not fit took seven seconds."""
    code = (
        "import sys; from deepbots_cli.cli import main; print(main(sys.argv[1:]), [m for m in ('torch',"
        " 'onnx') if m in sys.modules])"
    )
    words = ["export", str(run), "--to", "isaac-lab", "-o", str(tmp_path / "new")]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)
    assert "choices, goals, images, copies" in done.stderr
    assert done.stdout == "2 []\n"
