"""Model files: those of Stable-Baselines3, of which only tensors that fit are read."""

from __future__ import annotations

import base64
import io
import json
import math
import pickle
import re
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import stable_baselines3
import stand_in
import torch
from stable_baselines3 import PPO

from deepbots_cli import api
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.insight.export.network import policy_graph
from deepbots_cli.learning import TrainingResult, evaluate, learner, load_policy, resume, train
from deepbots_cli.learning.evaluation import load_model
from deepbots_cli.learning.model_files import steps_of
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3.networks import sampled_actions
from deepbots_cli.program.task import Hyperparameter, Network, Schedule, Training
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
        (torch.zeros(3, 64), "shape"),
        (torch.zeros(2, 64, dtype=torch.float64), "float64"),
        (torch.full((2, 64), math.nan), "infinite or NaN"),
        (torch.full((2, 64), math.inf), "infinite or NaN"),
        (torch.zeros(1).expand(2, 10**12), "shape"),
        ("text", "is not a tensor"),
    ],
)
def test_a_tensor_that_does_not_fit_is_refused(run_copy: Path, tensor: Any, reason: str) -> None:
    changed(run_copy / BEST, "policy", lambda state: state.update({WEIGHT: tensor}))
    assert_refused(run_copy, reason)


def test_missing_and_strange_tensors_are_named(run_copy: Path) -> None:
    path = run_copy / BEST
    whole = members(run_copy / BEST)
    changed(path, "policy", lambda state: state.pop(WEIGHT))
    assert_refused(run_copy, "lacks 'policy/action_net.weight'")
    rewrite(path, whole)
    changed(path, "policy", lambda state: state.update(backdoor=torch.zeros(1)))
    assert_refused(run_copy, "policy/backdoor")
    rewrite(path, whole | {"backdoor.pth": saved({"x": torch.zeros(1)})})
    assert_refused(run_copy, "contains 'backdoor'")


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


@pytest.mark.parametrize(("place", "value"), [(6, 1), (8, 99)], ids=["encrypted", "unknown compression"])
def test_a_model_that_is_encrypted_or_packed_otherwise_is_refused(
    run_copy: Path, place: int, value: int
) -> None:
    path = run_copy / "models" / "agent" / "last.zip"
    content = bytearray(path.read_bytes())
    for mark, further in (
        (b"PK\x03\x04", 0),
        (b"PK\x01\x02", 2),
    ):  # a local header, and its entry in the directory
        for match in re.finditer(re.escape(mark), bytes(content)):
            content[match.start() + place + further] = value
    path.write_bytes(content)
    with pytest.raises(RunError, match="damaged, or was not written by deepbots"):
        steps_of(path)
    with pytest.raises(RunError, match="damaged, or was not written by deepbots"):
        evaluate(run_copy, model="last", build=stand_in.build)


def test_a_truncated_or_shuffled_file_is_refused_or_read(run_copy: Path) -> None:
    path = run_copy / BEST
    content = path.read_bytes()
    generator = np.random.default_rng(0)
    for _ in range(60):
        spoiled = bytearray(
            content[: generator.integers(len(content))] if generator.random() < 0.5 else content
        )
        for position in generator.integers(len(spoiled), size=3) if spoiled else ():
            spoiled[position] = generator.integers(256)
        path.write_bytes(bytes(spoiled))
        assert "\n" not in refusal(run_copy)


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
    with pytest.raises(RunError, match=r"shape|lacks|contains"):
        resume(run_copy, total_timesteps=100_000, build=stand_in.build)


@pytest.mark.parametrize("moment", ["step", "exp_avg", "exp_avg_sq"])
def test_a_checkpoint_whose_optimizer_lacks_a_tensor_is_refused(run_copy: Path, moment: str) -> None:
    (path,) = (run_copy / "checkpoints").glob("0*/model.zip")
    changed(path, "policy.optimizer", lambda state: state["state"][2].pop(moment))
    with pytest.raises(RunError, match=f"lacks 'policy.optimizer/2/{moment}'"):
        resume(run_copy, total_timesteps=3_000, build=stand_in.build)


def test_an_optimizer_that_counts_below_zero_is_refused(run_copy: Path) -> None:
    (path,) = (run_copy / "checkpoints").glob("0*/model.zip")
    changed(path, "policy.optimizer", lambda state: state["state"][0].update(step=torch.tensor(-1.0)))
    with pytest.raises(RunError, match=r"'policy\.optimizer/0/step' counts below zero"):
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
    values = {"x": 0.2, "speed": -0.4, "cart.pole_angle": 0.35, "tip_speed": 9.0}
    observation = policy.observe(values)
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
