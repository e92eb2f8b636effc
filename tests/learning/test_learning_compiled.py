"""Compiled scenarios of every kind of observation, learned from in the engine: for a moment, to see that all
of it fits together."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.learning import evaluate, evaluate_cases, resume, train
from tests.few import few

KINDS = {
    "goal": """
remove: [reward.alive, solved]
parameters: {place: uniform(-0.3 .. 0.3 m)}
action: {drive: -1 .. 1}
goal: {achieved: x, desired: place, tolerance: 2 cm, range: -0.4 .. 0.4 m}
reward:
  near: 0 if goal_reached else -1
truncation: {max_steps: 40}
train: {algorithm: SAC, total_timesteps: 200, environments: 2, replay: her, network: {hidden: [8]}, learning_starts: 80}
""",
    "picture": """
robots:
  cart:
    sensors:
      eye: {type: camera, link: body, pose: {z: 5 cm}, resolution: 40 36}
    emit: [pole_angle, eye]
messages: {format: struct}
observation:
  cart.eye: {range: auto, history: 2}
train: {total_timesteps: 100, environments: 2, n_steps: 32, batch_size: 32, n_epochs: 1}
""",
    "memory": """
train: {algorithm: RecurrentPPO, lstm: 8, total_timesteps: 200, environments: 2, n_steps: 32, batch_size: 32, n_epochs: 1}
""",
    "team": """
robots: {cart: {count: 3, spacing: 0 0.5 0 m}}
agent: {each: cart}
world: {arena: {size: 4 4 m}}
train: {total_timesteps: 300, environments: 2, n_steps: 32, batch_size: 32, n_epochs: 1}
""",
    "masks": """
action:
  drive:
    choices: {forward: 1, backward: -1}
    forbid: {forward: x > 0.2 m}
train: {algorithm: MaskablePPO, total_timesteps: 200, environments: 2, n_steps: 32, batch_size: 32, n_epochs: 1}
""",
    "stages": """
curriculum:
  - {name: near, set: {track: 0.2 m}, until: 100 steps}
  - {name: late, set: {messages.timing: delayed}, until: mean_return >= 5 over 2 episodes}
  - {name: usual}
evaluation:
  cases:
    steep: {set: {fall_angle: 5 deg}, episodes: 2}
train: {total_timesteps: 400, environments: 2, n_steps: 32, batch_size: 32, n_epochs: 1}
""",
}


@pytest.mark.parametrize(
    "kind",
    [
        "goal",
        *(pytest.param(kind, marks=pytest.mark.slow) for kind in few(KINDS, ["stages"]) if kind != "goal"),
    ],
)
def test_it_is_trained_evaluated_and_gone_on_with(tmp_path: Path, kind: str) -> None:
    base = shipped.scenario_path("cartpole")
    assert base is not None
    scenario = tmp_path / f"{kind}.yaml"
    scenario.write_text(f"deepbots: 1\nextends: {base}\nname: Kind\n{KINDS[kind]}", encoding="utf-8")
    compiled = api.compile(scenario, overrides=["world.engine=mujoco"])  # which is the faster
    result = train(compiled, run=tmp_path / "run")
    first, again = (evaluate(result.run, episodes=2) for _ in range(2))
    assert first == again
    assert first.success_defined == (kind == "goal")
    assert [case.case for case in evaluate_cases(result.run)] == [
        case.name for case in compiled.program.cases
    ]
    assert result.stage == ("usual" if kind == "stages" else None)
    goal = result.steps + 64
    assert resume(result.run, total_timesteps=goal).steps >= goal
