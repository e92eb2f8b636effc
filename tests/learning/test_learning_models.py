"""Files of runs and models.

* Model files: those of Stable-Baselines3, of which only tensors that fit are read.
* The run directory: made once, complete, and read with suspicion.
* A run from someone else may hold anything. Resuming it ends in one sentence, and changes no file.
* Damaged files of models.
"""

from __future__ import annotations

import base64
import io
import json
import math
import os
import pickle
import re
import shutil
import struct
import sys
import zipfile
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
import pytest
import stable_baselines3
import stand_in
import torch
from filelock import FileLock
from pydantic import BaseModel
from stable_baselines3 import PPO

from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.insight.export.network import policy_graph
from deepbots_cli.learning import TrainingResult, evaluate, learner, load_policy, resume, train
from deepbots_cli.learning.multi_agent import has_agents
from deepbots_cli.learning.policy import load_model
from deepbots_cli.learning.runs.directories import (
    new_directory,
    numbered_files,
    read_json,
    run_lock,
    write_numbered,
)
from deepbots_cli.learning.runs.run import Run, steps_of
from deepbots_cli.learning.sb3.networks import sampled_actions
from deepbots_cli.program.task import Hyperparameter, Network, Schedule, Training
from deepbots_cli.robots.model import Mesh
from deepbots_cli.runtime.spaces import action_space, observation_space
from tests.few import few

BEST = Path("models", "agent", "best.zip")
WEIGHT = "action_net.weight"


class Bomb:
    """Leaves a trace when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.trace,))


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def rewrite(path: Path, content: Mapping[str, bytes], compression: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in content.items():
            archive.writestr(name, data)


def saved(value: Any) -> bytes:
    stream = io.BytesIO()
    torch.save(value, stream)
    return stream.getvalue()


def changed(path: Path, part: str, change: Callable[[dict[str, Any]], None]) -> None:
    """Change the state dictionary of a part of a model."""
    state = torch.load(io.BytesIO(members(path)[f"{part}.pth"]), weights_only=True)
    change(state)
    rewrite(path, members(path) | {f"{part}.pth": saved(state)})


def assert_refused(run: Path, reason: str) -> None:
    with pytest.raises(RunError, match=reason) as caught:
        evaluate(run, episodes=1, build=stand_in.build)
    assert "\n" not in str(caught.value)


def refusal(run: Path) -> str:
    """Why a run's best model is refused; nothing if it can be evaluated."""
    try:
        evaluate(run, episodes=1, build=stand_in.build)
    except RunError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("algorithm", few(["PPO", "TD3", "DDPG", "SAC", "A2C", "DQN"], ["PPO", "TD3"]))
def test_plain_stable_baselines_loads_a_model_and_acts_the_same(tmp_path: Path, algorithm: str) -> None:
    observations = np.random.default_rng(0).uniform(-1, 1, (1000, 4)).astype(np.float32)
    settings = {} if algorithm in ("PPO", "A2C") else {"learning_starts": 50}
    hyperparameters = (
        *(Hyperparameter(*pair) for pair in settings.items()),
        Hyperparameter("learning_rate", Schedule(1e-3, 1e-4)),
    )
    training = Training(algorithm, 150, 2, hyperparameters, Network((8,), "relu"))
    task = stand_in.compiled(training=training, continuous=algorithm != "DQN")
    run = Run.open(train(task, run=tmp_path / algorithm, build=stand_in.build).run)
    ours = load_model(run, "best", stand_in.build(run.program)).predict(observations, deterministic=True)[0]
    with pytest.MonkeyPatch.context() as patched:
        for name in [name for name in sys.modules if name.partition(".")[0] == "deepbots_cli"]:
            patched.setitem(sys.modules, name, None)  # an import of it fails
        plain = getattr(stable_baselines3, algorithm).load(
            tmp_path / algorithm / "models/agent/best.zip", device="cpu"
        )
        assert np.array_equal(plain.predict(observations, deterministic=True)[0], ours)


def test_a_pickle_in_place_of_a_model_is_refused_and_never_run(run_copy: Path, tmp_path: Path) -> None:
    trace, path = tmp_path / "trace", run_copy / BEST
    path.write_bytes(pickle.dumps(Bomb(trace)))
    assert_refused(run_copy, "damaged")
    torch.save({"weights": Bomb(trace)}, path)
    assert_refused(run_copy, "lacks|damaged")
    assert not trace.exists()


@pytest.mark.parametrize("member", ["policy.pth", "data"])
def test_a_pickle_inside_a_model_is_never_run(run_copy: Path, tmp_path: Path, member: str) -> None:
    trace, path = tmp_path / "trace", run_copy / BEST
    pickled = base64.b64encode(pickle.dumps(Bomb(trace))).decode()
    data = json.dumps(
        json.loads(members(path)["data"]) | {"policy_class": {":type:": "", ":serialized:": pickled}}
    ).encode()
    rewrite(
        path,
        members(path) | {member: data if member == "data" else saved({"action_net.weight": Bomb(trace)})},
    )
    assert bool(refusal(run_copy)) == (member == "policy.pth")
    assert not trace.exists()


@pytest.mark.parametrize(
    ("tensor", "reason"),
    [
        (torch.zeros(3, 64), "size mismatch for action_net.weight"),
        (torch.full((2, 64), math.nan), "infinite or NaN"),
        (torch.full((2, 64), math.inf), "infinite or NaN"),
        (torch.zeros(1).expand(2, 10**12), "size mismatch"),
        ("text", "does not fit the policy"),
    ],
)
def test_a_tensor_that_does_not_fit_is_refused(run_copy: Path, tensor: Any, reason: str) -> None:
    changed(run_copy / BEST, "policy", lambda state: state.update({WEIGHT: tensor}))
    assert_refused(run_copy, reason)


def test_missing_and_strange_tensors_are_named(run_copy: Path) -> None:
    path = run_copy / BEST
    whole = members(run_copy / BEST)
    changed(path, "policy", lambda state: state.pop(WEIGHT))
    assert_refused(run_copy, "action_net.weight")
    rewrite(path, whole)
    changed(path, "policy", lambda state: state.update(backdoor=torch.zeros(1)))
    assert_refused(run_copy, "backdoor")
    rewrite(path, whole | {"backdoor.pth": saved({"x": torch.zeros(1)})})
    assert_refused(run_copy, "has the parts backdoor, policy")


def test_a_zip_bomb_is_refused_outside_and_inside(run_copy: Path, tmp_path: Path) -> None:
    path = run_copy / BEST
    whole = members(run_copy / BEST)
    rewrite(path, whole | {"policy.pth": bytes(50_000_000)}, zipfile.ZIP_DEFLATED)
    assert_refused(run_copy, "compressed")
    (tmp_path / "inner").write_bytes(saved({WEIGHT: torch.zeros(10_000_000)}))
    rewrite(tmp_path / "inner", members(tmp_path / "inner"), zipfile.ZIP_DEFLATED)
    rewrite(path, whole | {"policy.pth": (tmp_path / "inner").read_bytes()})
    assert_refused(run_copy, "compressed")
    rewrite(path, whole | {f"{index}.pth": b"" for index in range(100)})
    assert_refused(run_copy, "members")


@pytest.mark.parametrize("name", ["state.json", "arrays.npz", "model.zip"])
def test_a_damaged_checkpoint_is_refused_and_the_models_stay(run_copy: Path, name: str) -> None:
    (damaged,) = (run_copy / "checkpoints").glob(f"0*/{name}")
    damaged.write_bytes(b"PK\x03\x04 no archive")
    with pytest.raises(RunError, match="damaged"):
        resume(run_copy, total_timesteps=100_000, build=stand_in.build)
    assert evaluate(run_copy, episodes=1, build=stand_in.build).episodes == 1


def test_an_array_with_a_size_beyond_its_data_costs_no_memory(run_copy: Path) -> None:
    (path,) = (run_copy / "checkpoints").glob("0*/arrays.npz")
    whole = members(path)
    name = "torch.npy"
    rewrite(path, whole | {name: whole[name].replace(b"(5056,), }" + b" " * 7, b"(99999999999,), }")})
    with pytest.raises(RunError, match="damaged"):
        resume(run_copy, total_timesteps=100_000, build=stand_in.build)


def test_a_checkpoint_of_another_network_is_refused(run_copy: Path) -> None:
    resolved = run_copy / "resolved.yaml"
    text = resolved.read_text()
    resolved.write_text(re.sub(r"hidden:\n(\s+- \d+\n)+", "hidden: [8]\n", text))
    assert resolved.read_text() != text
    with pytest.raises(RunError, match="does not fit the policy of this scenario"):
        resume(run_copy, total_timesteps=100_000, build=stand_in.build)


OPTIMIZERS: dict[str, Callable[[dict[Any, Any]], object]] = {
    "lacks a count": lambda state: state[2].pop("step"),
    "lacks a moment": lambda state: state[2].pop("exp_avg_sq"),
    "counts below zero": lambda state: state[0].update(step=torch.tensor(-1.0)),
    "has a moment of another shape": lambda state: state[0].update(exp_avg=torch.zeros(3)),
}


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_a_checkpoint_with_moments_of_another_training_is_refused(run_copy: Path, name: str) -> None:
    (path,) = (run_copy / "checkpoints").glob("0*/model.zip")
    changed(path, "policy.optimizer", lambda state: OPTIMIZERS[name](state["state"]))
    with pytest.raises(RunError, match=r"has moments of another training|does not fit"):
        resume(run_copy, total_timesteps=3_000, build=stand_in.build)


KINDS: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {
    "meta": lambda tensor: tensor.to("meta"),
    "sparse": lambda tensor: tensor.to_sparse(),
    "quantized": lambda tensor: torch.quantize_per_tensor(tensor, 0.1, 0, torch.qint8),
    "fp8": lambda tensor: tensor.to(torch.float8_e4m3fn),
    "complex": lambda tensor: tensor.to(torch.complex64),
}


@pytest.mark.filterwarnings("ignore:torch.quantize_per_tensor")
@pytest.mark.parametrize("kind", KINDS)
def test_a_tensor_of_a_kind_that_no_policy_has_is_refused(run_copy: Path, kind: str) -> None:
    changed(run_copy / BEST, "policy", lambda state: state.update({WEIGHT: KINDS[kind](state[WEIGHT])}))
    assert_refused(run_copy, "damaged, or was not written by deepbots")
    with pytest.raises(RunError, match="damaged, or was not written by deepbots"):
        train(
            run_copy / "resolved.yaml", run=run_copy / "new", initialize_from=run_copy, build=stand_in.build
        )


def test_a_pickle_that_asks_for_memory_is_refused(run_copy: Path) -> None:
    class Large:
        def __reduce__(self) -> tuple[object, ...]:
            return (bytearray, (10**15,))

    path = run_copy / BEST
    rewrite(path, members(path) | {"policy.pth": saved({WEIGHT: Large()})})
    assert_refused(run_copy, "contains objects other than plain tensors")


def test_weights_that_lead_to_no_finite_action_are_one_sentence(run_copy: Path) -> None:
    def enlarge(state: dict[str, torch.Tensor]) -> None:
        state.update({name: tensor.clamp(-1, 1) * 3e38 for name, tensor in state.items()})

    changed(run_copy / BEST, "policy", enlarge)
    assert_refused(run_copy, "the policy gives actions that are not finite")
    run = Run.open(run_copy)
    with pytest.raises(RunError, match="the policy gives actions that are not finite"):
        policy_graph(load_model(run, "best", stand_in.build(run.program)), run.program)


@pytest.mark.parametrize("steps", ["Infinity", "NaN", "1e999", "9" * 5000])
def test_a_model_with_steps_without_end_is_damaged(run_copy: Path, steps: str) -> None:
    path = run_copy / BEST
    data = re.sub(rb'"num_timesteps": \d+', f'"num_timesteps": {steps}'.encode(), members(path)["data"])
    assert data != members(path)["data"]
    rewrite(path, members(path) | {"data": data})
    with pytest.raises(RunError, match="damaged, or was not written by deepbots"):
        steps_of(path)


def test_a_policy_acts_like_the_model_by_names_and_units_and_leaves_the_generators_alone(
    trained: TrainingResult,
) -> None:
    before = np.random.get_state()[1].sum(), torch.get_rng_state().sum()  # type: ignore[union-attr]
    policy = load_policy(trained.run)
    assert (np.random.get_state()[1].sum(), torch.get_rng_state().sum()) == before  # type: ignore[union-attr]
    assert [(value.name, value.unit) for value in policy.observation][:2] == [("x", "m"), ("speed", "m/s")]
    observation = policy.observe({"x": 0.2, "speed": -0.4, "cart.pole_angle": 0.35, "tip_speed": 9.0})
    assert observation.tolist() == pytest.approx([0.5, -0.5, 1.0, 1.0])
    plain = PPO.load(trained.run / "models" / "agent" / "best.zip")
    assert (
        policy(observation)
        == policy.predict(observation)
        == plain.predict(observation, deterministic=True)[0]
    )
    assert policy.predict(np.stack([observation] * 3)).shape == (3,)
    assert policy.named(0) == {"drive": "forward"}
    with pytest.raises(UsageError, match="tip_speed"):
        policy.observe({"x": 0.0})


def test_a_policy_refuses_a_value_that_is_not_finite_and_names_it(trained: TrainingResult) -> None:
    policy = load_policy(trained.run)
    with pytest.raises(UsageError, match=r"^the value of speed is nan; it must be finite$"):
        policy.observe({"x": 0.0, "speed": float("nan"), "cart.pole_angle": 0.0, "tip_speed": 0.0})
    with pytest.raises(
        UsageError,
        match=r"^the observation contains a value of cart\.pole_angle that is infinite or NaN: inf$",
    ):
        policy(np.array([[0, 0, 0, 0], [0, 0, np.inf, 0]], np.float32))


@pytest.mark.parametrize("scenario", ["cartpole", "cartpole_continuous"])
def test_likeliest_actions_of_rows_are_those_of_the_library_to_the_bit(scenario):
    program = api.compile(scenario).program
    training = Training("PPO", 1000, network=Network((32, 32), "tanh"))
    policy = learner.create(
        learner.Setup(training, observation_space(program.agent), action_space(program.agent))
    )
    generator = np.random.default_rng(0)
    for scale in (0.01, 1.0, 30.0):
        rows = (scale * generator.normal(size=(8, *policy.setup.observation_space.shape))).astype(np.float32)
        ours = policy.predict(rows, deterministic=True)[0]
        (theirs, _) = policy.model.predict(rows, deterministic=True)
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("scenario", ["cartpole", "cartpole_continuous"])
def test_sampled_actions_of_rows_are_those_of_the_library_to_the_bit(scenario):
    """So are their values and log-probabilities, and the random numbers that they take."""
    program = api.compile(scenario).program
    training = Training("PPO", 1000, network=Network((32, 32), "tanh"))
    policy = learner.create(
        learner.Setup(training, observation_space(program.agent), action_space(program.agent))
    ).model.policy
    generator = np.random.default_rng(0)
    for scale in (0.01, 1.0, 30.0):
        rows = torch.from_numpy(
            (scale * generator.normal(size=(8, *policy.observation_space.shape))).astype(np.float32)
        )
        with torch.no_grad():
            before = torch.get_rng_state()
            theirs = policy(rows)
            after = torch.get_rng_state()
            torch.set_rng_state(before)
            ours = sampled_actions(policy, rows)
        assert torch.equal(torch.get_rng_state(), after)
        for own, of_library in zip(ours, theirs, strict=True):
            assert torch.equal(own, of_library)


def test_a_run_keeps_everything_that_it_was_made_from(trained: TrainingResult) -> None:
    files = {str(path.relative_to(trained.run)) for path in trained.run.rglob("*") if path.is_file()}
    assert {
        "run.json",
        "resolved.yaml",
        "environment.py",
        "monitor.csv",
        "models/agent/best.zip",
        "models/agent/last.zip",
        "inputs/tests/learning/stand_in.yaml",
        "inputs/robots/urdf/cartpole.urdf",
    } <= files
    assert any(name.startswith("tensorboard/events") for name in files)
    record = json.loads((trained.run / "run.json").read_text())
    assert (record["status"], record["command"]) == ("finished", ["deepbots", "train", "stand_in"])
    assert record["seed"] == 3
    assert {"python", "torch", "stable-baselines3", "numpy", "gymnasium", "pybullet"} <= set(
        record["versions"]
    )
    assert record["result"]["steps"] == trained.steps


def test_a_run_is_never_overwritten(trained: TrainingResult) -> None:
    before = stand_in.tree_digest(trained.run)
    with pytest.raises(UsageError, match="not overwritten"):
        train(stand_in.compiled(), run=trained.run, build=stand_in.build)
    assert stand_in.tree_digest(trained.run) == before


def test_new_runs_are_numbered_past_all_that_exist(tmp_path: Path) -> None:
    (tmp_path / "cart_pole-0-7").mkdir()
    (tmp_path / "cart_pole-0-x").mkdir()
    assert [new_directory(None, tmp_path, "Cart Pole", 0).name for _ in range(2)] == [
        "cart_pole-0-8",
        "cart_pole-0-9",
    ]
    assert new_directory(None, tmp_path, "../..", 0).parent == tmp_path
    assert new_directory(None, tmp_path / "new" / "runs", "Cart Pole", 0).is_dir()


def test_a_folder_that_is_not_a_run_is_refused_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "empty").mkdir()
    for name, reason in (
        ("nothing", "no file, folder or shipped scenario"),
        ("file", "is a file"),
        ("empty", "without run.json"),
    ):
        with pytest.raises(RunError, match=reason) as caught:
            Run.open(tmp_path / name)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("version", [0, 2, 99])
def test_a_run_of_another_format_is_refused(run_copy: Path, version: int) -> None:
    edit(run_copy, format=version)
    with pytest.raises(RunError, match=f"format {version}"):
        evaluate(run_copy, build=stand_in.build)


def test_a_run_of_another_deepbots_warns(run_copy: Path) -> None:
    edit(run_copy, deepbots="9.9")
    assert "9.9" in evaluate(run_copy, episodes=1, build=stand_in.build).notes[0]


def test_a_scenario_that_was_changed_after_the_training_warns(run_copy: Path) -> None:
    rewrite_scenario(run_copy, "15 deg", "12 deg")
    (note,) = evaluate(run_copy, episodes=1, build=stand_in.build).notes
    assert "because it was changed after the training" in note
    edit(run_copy, deepbots="9.9")
    assert "with this version of deepbots" in Run.open(run_copy).notes()[1]


def test_a_changed_file_of_a_run_warns(run_copy: Path) -> None:
    robot = run_copy / "inputs" / "robots" / "urdf" / "cartpole.urdf"
    robot.write_text(robot.read_text().replace('<mass value="', '<mass value="1', 1))
    assert "because it was changed after the training" in Run.open(run_copy).notes()[0]


def test_a_scenario_that_no_longer_fits_its_policy_is_refused_item_by_item(run_copy: Path) -> None:
    rewrite_scenario(run_copy, "-0.8 .. 0.8 m/s", "-0.9 .. 0.8 m/s")
    with pytest.raises(
        RunError, match=r"observation\.speed: trained -0\.8 \.\. 0\.8 m/s, now -0\.9 \.\. 0\.8 m/s"
    ) as caught:
        evaluate(run_copy, build=stand_in.build)
    assert str(caught.value).count("\n") == 1


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("timestep: 32 ms", "timestep: 0 s"),
        ("timestep: 32 ms", "timestep: 1e-320 s"),
        ("timestep: 32 ms", "timestep: 1e308 s"),
        ("substeps: 4", "substeps: 1000000000000"),
        ("max_steps: 200", "max_steps: -1"),
        ("episodes: 20", "episodes: 0"),
        ("episodes: 20", f"episodes: {2**70}"),
        ("episodes: 20", f"episodes: {'9' * 5000}"),
        ("truncation:", "nothing:"),
        ("name: stand_in", 'name: "../../x"'),
        ("reward:", 'reward: {alive: \'__import__("os").system("touch pwned")\'}\nrewards:'),
        ("reward:", "reward: !!python/object/apply:os.system [touch pwned]\nrewards:"),
        ("- wheel_*", "- 'x'"),
        ("10 N*m", "-1e300 N*m"),
        ("deepbots: 1", "deepbots: 99"),
        ("deepbots: 1", "extends: resolved.yaml\ndeepbots: 1"),
        ("deepbots: 1", "extends: /etc/passwd\ndeepbots: 1"),
        ("deepbots: 1", "include: ../../secret.yaml\ndeepbots: 1"),
        ("inputs/robots/urdf/cartpole.urdf", "/etc/passwd"),
        ("inputs/robots/urdf/cartpole.urdf", "inputs/../../secret.urdf"),
        ("inputs/robots/urdf/cartpole.urdf", "package://os/../../etc/passwd"),
        ("inputs/robots/urdf/cartpole.urdf", "inputs"),
    ],
)
def test_a_forged_scenario_is_refused_in_a_sentence(
    run_copy: Path, old: str, new: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("secret.yaml", "secret.urdf"):
        (run_copy.parent / name).write_text("secret: 1\n")
    (run_copy.parent / "deepbots.toml").touch()  # what looks like a project around a run is not its project
    opened = watched(monkeypatch)
    rewrite_scenario(run_copy, old, new)
    assert "does not compile" in (message := refusal_to_open(run_copy))
    assert "\n" not in message
    assert len(message) < 1000
    assert not [path for path in opened() if path.name.startswith("secret") or path == Path("/etc/passwd")]


@pytest.mark.parametrize("name", ["resolved.yaml", "inputs", "inputs/robots/urdf/cartpole.urdf"])
def test_a_run_without_one_of_its_files_is_refused_in_a_sentence(run_copy: Path, name: str) -> None:
    (run_copy / name).rename(run_copy / "lost")
    assert name.partition("/")[0] in (message := refusal_to_open(run_copy))
    assert "\n" not in message


@pytest.mark.parametrize(
    "name", ["resolved.yaml", "inputs", "inputs/robots", "inputs/robots/urdf/cartpole.urdf"]
)
def test_a_link_out_of_the_run_is_not_followed(run_copy: Path, tmp_path: Path, name: str) -> None:
    (run_copy / name).rename(tmp_path / "elsewhere")
    os.symlink(tmp_path / "elsewhere", run_copy / name)
    assert "is a symbolic link" in refusal_to_open(run_copy)
    assert (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize("name", ["monitor.csv", ".lock"])
def test_a_symbolic_link_in_a_run_is_not_followed(run_copy: Path, tmp_path: Path, name: str) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (run_copy / name).unlink(missing_ok=True)
    os.symlink(victim, run_copy / name)
    with pytest.raises(RunError, match="symbolic link"):
        resume(run_copy, total_timesteps=100_000, build=stand_in.build)
    assert victim.read_text() == "precious"


def test_an_evaluation_is_kept_with_its_episodes(run_copy: Path) -> None:
    run = Run.open(run_copy)
    result = evaluate(run, episodes=2, build=stand_in.build).model_dump(mode="json")
    first, second = run.write_evaluation(result), run.write_evaluation(result)
    assert [first.name, second.name] == ["0001.json", "0002.json"]
    assert len(json.loads(first.read_text())["outcomes"]) == 2
    (run.evaluations / "9999.json").write_text("{}")
    assert [run.write_evaluation(result).name for _ in range(2)] == ["10000.json", "10001.json"]
    shutil.rmtree(run.evaluations)
    run.evaluations.write_text("no folder")
    with pytest.raises(RunError, match=r"evaluations.* cannot be written"):
        run.write_evaluation(result)


def test_a_run_whose_project_is_gone_finds_its_meshes_in_its_own_copies(tmp_path: Path) -> None:
    project = tmp_path / "project"
    project.mkdir()
    (project / "part.obj").write_bytes(
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    robot = (
        shipped.robot_path("cartpole")
        .read_text()
        .replace('<box size="0.20 0.05 0.08"/>', '<mesh filename="part.obj"/>', 1)
    )
    (project / "mine.urdf").write_text(robot)
    scenario = (
        shipped.scenario_path("cartpole").read_text().replace("../robots/urdf/cartpole.urdf", "mine.urdf")
    )
    (project / "mine.yaml").write_text(scenario)
    compiled = api.compile(project / "mine.yaml")
    result = train(compiled, run=tmp_path / "run", total_timesteps=512, build=stand_in.build)
    shutil.rmtree(project)
    shutil.move(result.run, tmp_path / "moved")
    run = Run.open(tmp_path / "moved")
    assert (run.digest, run.notes()) == (run.record.digest, [])
    links = run.program.world.robots[0].model.links
    meshes = [
        part.shape.path
        for link in links
        for part in (*link.visuals, *link.collisions)
        if isinstance(part.shape, Mesh)
    ]
    assert meshes == [str(tmp_path / "moved" / "inputs" / "part.obj")]
    with closing(api.build(run.program)) as environment:
        environment.reset(seed=0)
    (tmp_path / "moved" / "inputs" / "part.obj").write_bytes(b"v 0 0 0\nf 1 1 999\n")
    assert "does not compile" in refusal_to_open(tmp_path / "moved")


@pytest.mark.parametrize("name", ["monitor.csv", "models/agent/last.zip", "resolved.yaml"])
def test_a_pipe_in_a_run_is_not_waited_for(run_copy: Path, name: str) -> None:
    (run_copy / name).unlink()
    os.mkfifo(run_copy / name)
    with pytest.raises(RunError, match="neither a file nor a directory"):
        Run.open(run_copy)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[" * 100_000,
        b"\xff\xfe\x00",
        b"NaN",
        b'{"format": 1e400}',
        b'{"format": ' + b"9" * 10_000 + b"}",
        b"[]",
        b" " * 5_000_000,
    ],
)
def test_content_that_is_not_a_record_or_not_a_scenario_is_refused(run_copy: Path, content: bytes) -> None:
    for name in ("run.json", "resolved.yaml"):
        shutil.copy(run_copy / name, run_copy / "kept")
        (run_copy / name).write_bytes(content)
        with pytest.raises(RunError) as caught:
            Run.open(run_copy)
        assert "\n" not in str(caught.value)
        shutil.move(run_copy / "kept", run_copy / name)


def refusal_to_open(path: Path) -> str:
    """Why a run is refused; nothing if it opens."""
    try:
        Run.open(path)
    except RunError as error:
        return str(error)
    return ""


def rewrite_scenario(path: Path, old: str, new: str) -> None:
    """Change the scenario of the run; what was quoted there need not be in `old`."""
    resolved = path / "resolved.yaml"
    text = resolved.read_text().replace('"', "")
    assert old in text
    resolved.write_text(text.replace(old, new, 1))


def watched(monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[Path]]:
    """A function that returns the files that were opened since, links followed."""
    opened: list[Path] = []
    plain = Path.open

    def watching(path: Path, *arguments: Any, **settings: Any) -> Any:
        opened.append(path.resolve())
        return plain(path, *arguments, **settings)

    monkeypatch.setattr(Path, "open", watching)
    return lambda: opened


def edit(path: Path, **changes: object) -> None:
    (path / "run.json").write_text(json.dumps(json.loads((path / "run.json").read_text()) | changes))


def test_the_folder_of_runs_may_not_be_a_file(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("")
    with pytest.raises(UsageError, match="runs cannot be written: file exists"):
        new_directory(None, tmp_path / "runs", "Cart Pole", 0)


@pytest.mark.parametrize("begin", [Path.touch, lambda path: path.symlink_to("nowhere")])
def test_an_empty_numbered_file_or_a_broken_link_is_passed_over_and_never_overwritten(
    tmp_path: Path, begin: Callable[[Path], None]
) -> None:
    """It belongs to a process that writes it now, or was killed before it wrote it."""
    begin(tmp_path / "0001.json")
    assert numbered_files(tmp_path) == []
    path = write_numbered(tmp_path, "{}")
    assert (path.name, numbered_files(tmp_path)) == ("0002.json", [(2, path)])


class Remark(BaseModel):
    text: str


def test_a_record_may_escape_a_quotation_mark_before_a_line_break(tmp_path: Path) -> None:
    (tmp_path / "remark.json").write_text(r'{"text": "\u0022\u000a"}')
    assert read_json(tmp_path / "remark.json", Remark, 100).text == r'"\u{a}'


def test_a_lock_that_is_free_after_a_moment_is_waited_for(tmp_path: Path) -> None:
    """`is_training` takes the lock for a moment, to find out whether it is free."""
    lock = FileLock(tmp_path / ".lock", thread_local=False)
    lock.acquire()
    release = Timer(0.2, lock.release)
    release.start()
    try:
        with run_lock(tmp_path):
            pass
    finally:
        release.join()


State = dict[str, Any]


def files(run: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(run)): path.read_bytes()
        for path in run.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


def refusal_to_resume(run: Path) -> str:
    """What resuming the run is refused with; nothing in the run changes."""
    before = files(run)
    with pytest.raises(RunError) as caught:
        resume(run, total_timesteps=100_000, build=stand_in.build)
    assert files(run) == before
    assert "\n" not in str(caught.value)
    return caught.value.full_message


def with_state(run: Path, change: Callable[[State], object]) -> None:
    (path,) = (run / "checkpoints").glob("0*/state.json")
    state = json.loads(path.read_text())
    change(state)
    path.write_text(json.dumps(state))


def with_arrays(run: Path, arrays: Mapping[str, np.ndarray[Any, Any]]) -> None:
    (path,) = (run / "checkpoints").glob("0*/arrays.npz")
    content = members(path)
    for name, array in arrays.items():
        stream = io.BytesIO()
        np.lib.format.write_array(stream, array, version=(1, 0), allow_pickle=False)
        content[f"{name}.npy"] = stream.getvalue()
    rewrite(path, content)


HUGE_TEXT = {"dtype": "S2000000000", "value": ["x", "y", "z"]}
STATES: dict[str, Callable[[State], object]] = {
    "a position beyond the numbers of the generator": lambda state: state.update(
        numpy=[1_000_000_000, 0, 0.0]
    ),
    "a text of 2 GB as a number": lambda state: state["infos"].insert(0, {"r": HUGE_TEXT, "l": 1}),
    "an object as a number": lambda state: state["pending"][0].update(x={"dtype": "O", "value": 1}),
    "a number that its type does not have": lambda state: state["pending"][0].update(
        x={"dtype": "int8", "value": 300}
    ),
    "steps below zero": lambda state: state["counts"].update(num_timesteps=-(10**12)),
    "steps that the statistics do not have": lambda state: state["counts"].update(num_timesteps=10**9),
    "steps without end": lambda state: (
        state["counts"].update(num_timesteps=10**25),
        state["statistics"].update(steps=10**25),
    ),
    "steps of another checkpoint": lambda state: (
        state["counts"].update(num_timesteps=4),
        state["statistics"].update(steps=4),
    ),
    "a seed below zero": lambda state: state["starts"].__setitem__(0, -5),
    "a generator of another kind": lambda state: state["action_space"].update(bit_generator="MT19937"),
    "too many worlds": lambda state: (state["starts"].append(1), state["stages"].append(0)),
    "no worlds": lambda state: state.update(starts=[], stages=[]),
    "a stage that is not there": lambda state: state["stages"].__setitem__(0, 7),
    "an episode without end": lambda state: state["statistics"]["recent"][0].update(
        total_return=float("inf")
    ),
    "a generator of Python that is cut short": lambda state: state.update(python=[3, [1, 2, 3], None]),
    "an evaluation in the future": lambda state: state["callback"].update(evaluated_at=10**9),
    "a candidate whose return is not a number": lambda state: state["callback"].update(
        candidates=[{"steps": 4, "episodes": 20, "success_rate": 0.5, "mean_return": float("nan")}]
    ),
    "segments of a replay buffer in disorder": lambda state: state.update(segments=[[0, 10**12], [5, 6]]),
}


@pytest.mark.parametrize("name", STATES)
def test_a_forged_state_of_a_checkpoint_is_damaged(run_copy: Path, name: str) -> None:
    with_state(run_copy, STATES[name])
    message = refusal_to_resume(run_copy)
    assert "damaged" in message
    assert f"deepbots train {run_copy}/resolved.yaml --initialize-from {run_copy}" in message


def torch_generator(run: Path) -> np.ndarray[Any, Any]:
    """A state that torch accepts, from which it would read 600 numbers beyond its own."""
    (path,) = (run / "checkpoints").glob("0*/arrays.npz")
    state = bytearray(np.load(path)["torch"].tobytes())
    struct.pack_into("<i4xQ", state, 8, 624, 600)
    return np.frombuffer(bytes(state), np.uint8)


ARRAYS: dict[str, Callable[[Path], Mapping[str, Any]]] = {
    "three million actions": lambda run: {"actions/0": np.zeros(3_000_000, np.int64)},
    "actions of text": lambda run: {"actions/0": np.full(5, "forward")},
    "actions that the scenario does not have": lambda run: {"actions/0": np.full(5, 99)},
    "actions that are not numbers": lambda run: {"actions/0": np.full(5, np.nan)},
    "an array of another shape": lambda run: {"torch": np.zeros((2, 2528), np.uint8)},
    "an array of another type": lambda run: {"torch": np.zeros(5056, np.int64)},
    "a generator that reads beyond its numbers": lambda run: {"torch": torch_generator(run)},
    "a generator of another size": lambda run: {"numpy": np.zeros(3, np.uint32)},
}


@pytest.mark.parametrize("name", ARRAYS)
def test_a_forged_array_of_a_checkpoint_is_damaged(run_copy: Path, name: str) -> None:
    with_arrays(run_copy, ARRAYS[name](run_copy))
    assert "damaged" in refusal_to_resume(run_copy)


def test_a_solved_run_stays_solved_when_the_world_fails_before_anything_is_learned(run_copy: Path) -> None:
    class Broken(stand_in.CartPole):
        def step(self, action: Any) -> Any:
            raise UsageError("the world is broken")

    before = Run.open(run_copy).record
    with_arrays(run_copy, {f"actions/{index}": np.zeros(0, np.int64) for index in range(4)})
    with pytest.raises(UsageError, match="broken"):
        resume(run_copy, total_timesteps=100_000, build=Broken)
    assert Run.open(run_copy).record == before


def test_a_refused_resume_leaves_files_in_logs_and_tensorboard(run_copy: Path) -> None:
    (run_copy / "logs").mkdir(exist_ok=True)
    (run_copy / "logs" / "notes.txt").write_text("mine")
    (run_copy / "tensorboard" / "events.out.tfevents.9.mine").write_text("mine")
    before = files(run_copy)
    with pytest.raises(UsageError, match="is complete"):
        resume(run_copy, total_timesteps=100, build=stand_in.build)
    assert files(run_copy) == before


def test_the_advice_for_a_damaged_checkpoint_works(
    run_copy: Path, trained: TrainingResult, tmp_path: Path
) -> None:
    result = train(
        run_copy / "resolved.yaml",
        run=tmp_path / "new",
        initialize_from=run_copy,
        total_timesteps=256,
        build=stand_in.build,
    )
    assert result.initialized_from is not None


DATA = '{"num_timesteps": 128, "agents": ["left"]}'


def archive_with(path: Path, compression: int = zipfile.ZIP_STORED, **members: str) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def test_a_model_tells_its_steps_and_whether_it_has_agents(tmp_path: Path) -> None:
    model = archive_with(tmp_path / "model.zip", data=DATA)
    assert (steps_of(model), has_agents(model)) == (128, True)


@pytest.mark.parametrize("data", ['"agents"', '["agents"]'])
def test_a_file_whose_data_is_no_mapping_has_no_agents(tmp_path: Path, data: str) -> None:
    with pytest.raises(RunError, match="is damaged, or was not written by deepbots"):
        has_agents(archive_with(tmp_path / "model.zip", data=data))
