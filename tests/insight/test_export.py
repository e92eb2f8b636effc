"""Exported policies act as Stable-Baselines3 does, in the units that the card says; bundles that do not fit are refused item by item."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
import onnxruntime
import torch

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import UsageError
from deepbots_cli.insight import export
from deepbots_cli.learning import learner as learners
from deepbots_cli.learning.policy import Policy, load_policy
from deepbots_cli.program.task import Network, Training
from deepbots_cli.runtime.spaces import action_space, observation_space

slow = pytest.mark.slow


def _made(scenario: str, algorithm: str, activation: str = "tanh", frame_stack: int = 1):
    """A program, and an untrained policy whose weights are spread, so that its actions differ."""
    program = api.compile(scenario).program
    training = Training(algorithm, 1000, network=Network((32, 32), activation))
    program = program.with_agents(training=training, frame_stack=frame_stack)
    learner = learners.create(learners.Setup(training, observation_space(program.agent), action_space(program.agent)))
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
        pytest.param("tag", "PPO", "tanh", marks=slow),
    ],
)
def test_actions_are_those_of_stable_baselines3(scenario, algorithm, activation):
    program, learner = _made(scenario, algorithm, activation)
    graph = export.networks(learner, program)["policy.onnx"]
    session = _session(graph)
    assert export.largest_difference(learner, program, graph, 10_000, lambda feeds: session.run(None, feeds)) <= export.TOLERANCE


@pytest.mark.slow
def test_pictures_are_seen_as_stable_baselines3_sees_them():
    program, learner = _made("see_ball", "PPO")
    graph = export.networks(learner, program)["policy.onnx"]
    session = _session(graph)
    assert export.largest_difference(learner, program, graph, 200, lambda feeds: session.run(None, feeds)) <= export.TOLERANCE


@pytest.mark.parametrize(("scenario", "algorithm"), [("cartpole", "PPO"), ("find_ball", "SAC")])
def test_in_si_units_values_and_commands_mean_what_the_scenario_says(scenario, algorithm):
    """Also beyond the ranges, where the environment clips."""
    program, learner = _made(scenario, algorithm)
    policy, session = Policy(program, learner), _session(export.networks(learner, program)["policy_si.onnx"])
    dice = np.random.default_rng(1)
    for _ in range(20):
        values = {n.name: dice.uniform(1.5 * n.low - 0.5 * n.high, 1.5 * n.high - 0.5 * n.low) for n in policy.observation}
        action = policy.predict(policy.observe(values))
        (command,) = session.run(["command"], {"observation": np.array([list(values.values())], np.float32)})
        named = policy.named(action)
        wanted = [{"forward": 1.0, "backward": -1.0}[name] for name in named.values()] if scenario == "cartpole" else list(named.values())
        assert command[0] == pytest.approx(wanted, abs=1e-4)


def test_older_values_stand_where_the_environment_puts_them():
    program, learner = _made("cartpole", "PPO", frame_stack=3)
    graph = export.networks(learner, program)["policy.onnx"]
    assert _session(graph).get_inputs()[0].shape == ["batch", 12]
    assert [entry.steps_ago for entry in program.agent.inputs][::4] == [2, 1, 0]


def test_a_layer_that_is_not_known_is_named():
    program, learner = _made("cartpole", "PPO")
    learner.model.policy.mlp_extractor.policy_net[1] = torch.nn.Dropout()
    with pytest.raises(UsageError, match="layer Dropout"):
        export.networks(learner, program)


@pytest.fixture(scope="session")
def bundle(run, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("bundles") / "cartpole-onnx"
    assert main(["export", str(run), "--to", "onnx", "-o", str(folder)]) == 0
    return folder


def test_the_card_tells_what_goes_in_and_out_and_how_good_it_is(bundle):
    known = json.loads((bundle / "card.json").read_text())
    angle = known["observation"][2]
    assert (angle["name"], angle["unit"], angle["high"]) == ("cart.pole_angle", "rad", pytest.approx(np.radians(20)))
    assert known["action"][0]["options"] == {"forward": {"drive": 1.0}, "backward": {"drive": -1.0}}
    assert known["control_rate_hz"] == 31.25
    assert known["result"]["episodes"] == 12
    low, high = known["result"]["return_interval"]
    assert low <= known["result"]["mean_return"] <= high
    text = (bundle / "README.md").read_text()
    assert "| 2 | cart.pole_angle | rad | -0.349066 .. 0.349066 | -1 .. 1 | 0 |" in text
    assert f"mean return {known['result']['mean_return']:.4g} in every episode (95 % interval, from" in text


def test_the_programs_of_the_readme_and_of_the_docs_run(bundle, run, monkeypatch):
    monkeypatch.chdir(bundle)
    page = (Path(__file__).parents[2] / "docs" / "report.md").read_text(encoding="utf-8")
    for text in ((bundle / "README.md").read_text(), page):
        (code,) = re.findall(r"```python[^\n]*\n(.*?)```", text, re.DOTALL)
        names: dict[str, object] = {}
        exec(code, names)
        assert np.shape(names["command"]) == (1, 1)


def test_the_bundle_drives_the_environment_as_the_policy_does(bundle, run):
    session, policy = _session((bundle / "policy.onnx").read_bytes()), load_policy(run)
    with api.make(run / "resolved.yaml") as env:
        seen, done = env.reset(seed=1)[0], False
        while not done:
            (action,) = session.run(["action"], {"observation": seen[None]})
            assert action[0] == policy(seen)
            seen, _, terminated, truncated, _ = env.step(action[0])
            done = terminated or truncated


def test_a_bundle_that_does_not_fit_is_refused_item_by_item(bundle, capsys):
    assert main(["export", "--check", "cartpole", str(bundle)]) == 0
    assert "fits cartpole" in capsys.readouterr().out
    assert main(["export", "--check", "cartpole", str(bundle), "--set", "observation.x=-1 .. 1 m"]) == 1
    told = capsys.readouterr().out
    assert "observation.x: bundle -0.4 .. 0.4 m, scenario -1 .. 1 m" in told
    assert "cart.pole_angle" not in told
    assert main(["export", "--check", "cartpole", str(bundle), "--set", "world.timestep=16ms"]) == 0
    told = capsys.readouterr().err
    assert "0.032 s" in told
    command = shlex.split(told.strip().rpartition("deepbots ")[2])  # its robot file is in the bundle
    assert main(command) == 1
    assert "world.timestep" in capsys.readouterr().out
    assert main(["export", "--check", str(bundle / "scenario.yaml"), str(bundle), "--set", "train.gamma=0.9"]) == 0
    assert capsys.readouterr().err == ""


def _edit_card(folder: Path, **changes: object) -> None:
    card = folder / "card.json"
    card.write_text(json.dumps(json.loads(card.read_text()) | changes))


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda folder: (folder / "policy.onnx").write_bytes(b"other"), "not the file that was exported"),
        (lambda folder: (folder / "policy_si.onnx").unlink(), "is missing"),
        (lambda folder: (folder / "policy.onnx").rename(folder / "x") and (folder / "policy.onnx").symlink_to("x"), "no regular file"),
        (lambda folder: _edit_card(folder, files={}), "not the file that was exported"),
        (lambda folder: _edit_card(folder, control_period_s=float("nan")), "'control_period_s'"),
        (lambda folder: (folder / "card.json").write_text("{"), "is damaged"),
        (lambda folder: (folder / "card.json").write_text('{"format": 99}'), "format 99"),
        (lambda folder: (folder / "card.json").unlink(), "is not a bundle"),
    ],
)
def test_a_spoiled_bundle_is_told_in_a_sentence(bundle, tmp_path, capsys, spoil, told):
    folder = Path(shutil.copytree(bundle, tmp_path / "copy"))
    spoil(folder)
    assert main(["export", "--check", "cartpole", str(folder)]) == 2
    told_now = capsys.readouterr().err
    assert told in told_now
    assert told_now.count("\n") == 1


def test_nothing_is_overwritten_and_a_group_is_refused(bundle, run, tmp_path, capsys):
    assert main(["export", str(run), "-o", str(bundle)]) == 2
    assert "is not empty; choose another folder, or replace files of the same name with --force" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert main(["export", str(run), "-o", str(tmp_path / "file" / "new")]) == 2
    assert "is not a directory" in capsys.readouterr().err
    (tmp_path / "group.json").write_text("{}")
    assert main(["export", str(tmp_path), "-o", str(tmp_path / "new")]) == 2
    assert not (tmp_path / "new").exists()
