"""One agent in a batch of worlds, beside agents that act by themselves: the same as in single worlds."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.document import Permissions
from deepbots_cli.learning.environments import stepping_text, supervisor_factory
from deepbots_cli.learning.evaluation import load_model
from deepbots_cli.learning.held_out import EvaluationWorlds
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.program import Program
from deepbots_cli.rollout.batch_worlds import BatchWorlds
from deepbots_cli.rollout.worlds import SingleWorlds, observation_digest
from tests.agents.test_agents import SEVERAL
from tests.agents.test_multi_agent_training import SHARED, write_scenario
from tests.few import every, few

pytest.importorskip("deepbots_cli.engines.mujoco")
WORLDS = 9
"""One more than a forward pass has rows."""
CHOOSING = (
    SEVERAL.replace(
        "  right: {like: left, robots: [right]}\n",
        """\
  right:
    robots: [right]
    action:
      go: {choices: {ahead: 1, back: -1, rest: 0}, forbid: {ahead: apart < 0.95 m}}
    augment: {gap: apart}
    observation: {right.angle: -1 .. 1 rad, gap: 0 .. 2 m}
    reward: {upright: cos(right.angle)}
    scripts:
      lean: {go: {ahead: right.angle > 1 deg, rest: right.angle > -1 deg, back: true}}
    train:
      {algorithm: MaskablePPO, total_timesteps: 64, n_steps: 64, n_epochs: 1, batch_size: 32,
       network: {hidden: [8]}}
""",
    )
    .replace("apply: {wheels: drive * 5 rad/s}", "apply: {wheels: go * 5 rad/s}", 2)
    .replace("apply: {wheels: go * 5 rad/s}", "apply: {wheels: drive * 5 rad/s}", 1)
)
"""The right agent chooses between options, one of which may be forbidden."""
ROLES = {
    "script": "agent: left, others: {right: lean}",
    "random": "agent: left, others: {right: random}",
    "zero": "agent: left, others: {right: zero}",
    "chooser": "agent: right, others: {left: lean}",
}


def compare(program: Program, steps: int = 80) -> int:
    """Assert that a batch and single worlds show the same, also after they are brought back. Return the
    number of episodes."""
    single = SingleWorlds([api.build(program, engine="mujoco") for _ in range(WORLDS)], range(WORLDS))
    batch = BatchWorlds(lambda stage: api.build_batch(program, WORLDS), range(WORLDS))
    single.action_space.seed(1)
    episodes = 0
    with closing(single), closing(batch):
        assert observation_digest(single.reset()) == observation_digest(batch.reset())
        for step in range(steps + 20):
            masks = single.action_masks() if program.agent.choices else None
            if masks is not None:
                assert masks.tolist() == batch.action_masks().tolist()
                actions = np.array([np.random.default_rng(step).choice(np.flatnonzero(row)) for row in masks])
            else:
                actions = np.stack([single.action_space.sample() for _ in range(WORLDS)])
            of_single, of_batch = single.step_all(actions), batch.step_all(actions)
            assert observation_digest(of_single.observations) == observation_digest(of_batch.observations)
            assert of_single.rewards.tolist() == of_batch.rewards.tolist()
            assert [(end.row, end.episode) for end in of_single.endings] == [
                (end.row, end.episode) for end in of_batch.endings
            ]
            episodes += len(of_single.endings)
            if step == steps:
                kept = batch.histories()
                seen = observation_digest(of_batch.observations)
                assert observation_digest(batch.repeat(kept)) == seen
    return episodes


@pytest.mark.parametrize("text", [SEVERAL, CHOOSING], ids=["ranges", "choices"])
@pytest.mark.parametrize("role", every(3, ROLES))
def test_an_agent_beside_others_sees_the_same_in_a_batch(tmp_path: Path, role: str, text: str) -> None:
    program = api.compile(write_scenario(tmp_path, text), overrides=[f"role={{{ROLES[role]}}}"]).program
    assert compare(program) > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    few(
        [
            "tag: {agent: hunter, others: {prey: stroll}}",
            "tag: {agent: prey, others: {hunter: chase}}",
            "carry: {agent: left, others: {right: push}}",
            "sumo: {agent: red, others: {blue: push}}",
        ],
        ["carry: {agent: left, others: {right: push}}"],
    ),
)
def test_scripts_of_shipped_scenarios_act_the_same_in_a_batch(case: str) -> None:
    scenario, role = case.split(": ", 1)
    compare(api.compile(scenario, overrides=[f"role={role}"]).program, steps=40)


@pytest.fixture(scope="module", params=["PPO", pytest.param("RecurrentPPO", marks=pytest.mark.slow)])
def trained(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which both agents have learned, beside its scenario."""
    if request.param == "RecurrentPPO":
        pytest.importorskip("sb3_contrib")
    folder = tmp_path_factory.mktemp("policies")
    text = SHARED.replace("algorithm: PPO", f"algorithm: {request.param}")
    deepbots_cli.train(write_scenario(folder, text), run=folder / "run", seed=1, total_timesteps=128)
    return folder / "run"


def scenario_with_rival(trained: Path, *overrides: str) -> api.Compiled:
    role = f"role={{agent: left, others: {{right: {json.dumps(str(trained))}}}}}"
    return api.compile(
        trained.parent / "several.yaml",
        overrides=[role, "world.engine=mujoco", *overrides],
        permissions=Permissions(folders=(trained,)),
    )


@pytest.mark.slow
def test_a_policy_beside_the_agent_acts_the_same_in_a_batch(trained: Path) -> None:
    assert compare(scenario_with_rival(trained).program) > 0


@pytest.mark.slow
def test_a_policy_that_takes_masks_acts_the_same_in_a_batch(tmp_path: Path) -> None:
    pytest.importorskip("sb3_contrib")
    scenario = write_scenario(tmp_path, CHOOSING)
    deepbots_cli.train(api.compile(scenario, overrides=["role.agent=right"]), run=tmp_path / "run")
    role = f"role={{agent: left, others: {{right: {json.dumps(str(tmp_path / 'run'))}}}}}"
    allowed = Permissions(folders=(tmp_path,))
    compare(api.compile(scenario, overrides=[role], permissions=allowed).program)


@pytest.mark.slow
def test_an_evaluation_beside_a_policy_is_the_same_in_a_batch(trained: Path, tmp_path: Path) -> None:
    program = scenario_with_rival(trained).program
    deepbots_cli.train(scenario_with_rival(trained), run=tmp_path / "run", total_timesteps=64)
    model = load_model(Run.open(tmp_path / "run"), "last")
    build = supervisor_factory("mujoco")
    played = []
    for setting in ({"engine": "mujoco", "batch": 20}, {"singles": 1}, {"singles": 3}):
        worlds = EvaluationWorlds(build, **setting)  # type: ignore[arg-type]  # the settings of each
        with closing(worlds):
            worlds.enter(program)
            assert worlds.has_batch_for(20) == ("batch" in setting)
            played.append(worlds.play(model, range(20)))
    assert played[0] == played[1] == played[2]


def test_a_training_beside_others_steps_its_worlds_together(tmp_path: Path) -> None:
    overrides = ["role={agent: left, others: {right: lean}}", "world.engine=mujoco"]
    program = api.compile(write_scenario(tmp_path, SEVERAL), overrides=overrides).program
    text = stepping_text(program, 8, "mujoco", supervisor_factory("mujoco"))
    assert text == "Carts steps its 8 worlds together, as a batch"
