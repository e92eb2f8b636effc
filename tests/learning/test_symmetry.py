"""`train.symmetry`: mirror images of observations and actions, and trainings that learn from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO

from deepbots_cli import api
from deepbots_cli.learning import resume, train
from deepbots_cli.learning.sb3.networks import (
    mirrored_actions,
    mirrored_experience,
    mirrored_observations,
)
from deepbots_cli.program.task import Mirror, Symmetry
from deepbots_cli.runtime.spaces import action_space
from tests.learning.interruption import At, outcome

CART = """
deepbots: 1
extends: cartpole_continuous
name: MirroredCart
remove: [reset.joints]
world: {engine: mujoco}
evaluation: {episodes: 4}
solved: mean_return >= 1000000 over 2 episodes
train:
  algorithm: PPO
  total_timesteps: 512
  environments: 4
  n_steps: 32
  batch_size: 64
  symmetry: {flip: [x, speed, tip_speed, cart.pole_angle, drive]}
"""
DOG = """
deepbots: 1
extends: quadruped
name: MirroredDog
observation: {vx: -1 .. 3 m/s}
critic: {time: 0 .. 10 s, w: -6 .. 6 rad/s}
train:
  symmetry:
    swap: {FL: FR, RL: RR}
    flip: ["*_hip_joint", wz, v.y, "clock.*", dog.down.y, dog.gyro.x, dog.gyro.z, w.x, w.z]
"""
CHOICES = """
deepbots: 1
extends: cartpole
name: MirroredChoices
action:
  drive: {choices: {left: -1, stay: 0, right: 1}}
  left_arm: {choices: {up: 1, down: 0}}
  right_arm: {choices: {down: 0, up: 1}}
observation: {previous_action: auto}
signals: {arms: left_arm + right_arm}
reward: {arms: arms}
train: {algorithm: PPO, total_timesteps: 512, symmetry: {swap: {left: right}, flip: [x, "*speed", "*_angle"]}}
"""


def compiled(folder: Path, text: str) -> Any:
    path = folder / "mirrored.yaml"
    path.write_text(text)
    return api.compile(path).program


def symmetry_of(program: Any) -> Symmetry:
    symmetry: Symmetry = program.agent.training.symmetry
    assert symmetry is not None
    return symmetry


@pytest.mark.parametrize("text", [CART, DOG, CHOICES], ids=["cart", "dog", "choices"])
def test_the_mirror_image_of_a_mirror_image_is_the_original(tmp_path: Path, text: str) -> None:
    program = compiled(tmp_path, text)
    symmetry = symmetry_of(program)
    space = action_space(program.agent)
    random = np.random.default_rng(1)
    observations = random.uniform(-1.0, 1.0, (20, len(program.with_critic.agent.inputs)))
    image = mirrored_observations(symmetry, observations)
    np.testing.assert_allclose(mirrored_observations(symmetry, image), observations, atol=1e-12)
    space.seed(2)
    actions = np.array([space.sample() for _ in range(20)]).reshape(20, -1)
    once = mirrored_actions(symmetry, space, actions)
    np.testing.assert_array_equal(mirrored_actions(symmetry, space, once), actions)


def test_sides_change_places_and_values_change_their_signs_in_their_units(tmp_path: Path) -> None:
    program = compiled(tmp_path, DOG)
    wide = program.with_critic.agent
    places = {observation.name: place for place, observation in enumerate(wide.inputs)}
    values = {
        "vx": 0.5,
        "wz": 0.3,
        "v.y": -0.2,
        "dog.q.FL_hip_joint": 0.7,
        "dog.q.RL_upper_joint": 0.4,
        "w.z": 2.0,
    }
    observation = np.zeros(len(wide.inputs))
    for name, value in values.items():
        entry = wide.inputs[places[name]]
        observation[places[name]] = (value - (entry.low + entry.high) / 2) / ((entry.high - entry.low) / 2)
    image = mirrored_observations(symmetry_of(program), observation)

    def value_of(name: str) -> float:
        entry = wide.inputs[places[name]]
        return float((entry.low + entry.high) / 2 + image[places[name]] * (entry.high - entry.low) / 2)

    mirrored = {
        "vx": 0.5,
        "wz": -0.3,
        "v.y": 0.2,
        "dog.q.FR_hip_joint": -0.7,
        "dog.q.RR_upper_joint": 0.4,
        "w.z": -2.0,
    }
    assert {name: value_of(name) for name in mirrored} == pytest.approx(mirrored)
    assert value_of("dog.q.FL_hip_joint") == pytest.approx(0.0)


def test_options_have_mirror_images(tmp_path: Path) -> None:
    program = compiled(tmp_path, CHOICES)
    forward, left, stay, right = 0, 2, 3, 4
    up_and_down, down_and_up = [0, 0], [1, 1]  # the options of the arms stand in another order
    actions = np.array([[left, *up_and_down], [stay, *down_and_up], [right, 0, 1], [forward, 1, 0]])
    image = mirrored_actions(symmetry_of(program), action_space(program.agent), actions)
    np.testing.assert_array_equal(
        image, [[right, *down_and_up], [stay, *up_and_down], [left, 0, 1], [forward, 1, 0]]
    )


def test_a_mirrored_episode_is_the_mirror_image_of_the_episode(tmp_path: Path) -> None:
    program = compiled(tmp_path, CART)
    symmetry = symmetry_of(program)
    actions = np.random.default_rng(4).uniform(-0.5, 0.5, (40, 1)).astype(np.float32)

    def played(acts: Any) -> Any:
        with api.make(tmp_path / "mirrored.yaml", engine="pybullet") as world:
            world.reset(seed=0)
            return np.array([world.step(act)[0] for act in acts])

    observations = played(actions)
    image = played(mirrored_actions(symmetry, action_space(program.agent), actions))
    assert np.abs(observations).max() > 0.05
    np.testing.assert_allclose(
        image, mirrored_observations(symmetry, observations), atol=0.01
    )  # contacts are solved in another order


def test_an_update_has_each_sample_and_its_mirror_image() -> None:
    model = PPO("MlpPolicy", gym.make("Pendulum-v1"), n_steps=8, batch_size=4)
    buffer = model.rollout_buffer
    buffer.observations[...] = np.random.default_rng(5).uniform(-1, 1, buffer.observations.shape)
    buffer.advantages[...] = np.arange(8)[:, None]
    mirror = Mirror((1, 0, 2), (1.0, 1.0, -1.0), (0.0, 0.0, 0.5))
    with mirrored_experience(model, Symmetry(mirror, Mirror((0,), (-1.0,), (0.0,)))):
        both = model.rollout_buffer
        assert model.batch_size == 8
        np.testing.assert_array_equal(both.observations[:, 0], buffer.observations[:, 0])
        np.testing.assert_allclose(
            both.observations[:, 1], buffer.observations[:, 0][:, [1, 0, 2]] * [1, 1, -1] + [0, 0, 0.5]
        )
        np.testing.assert_array_equal(both.advantages[:, 0], both.advantages[:, 1])
        assert sum(len(batch.advantages) for batch in both.get(model.batch_size)) == 16
    assert (model.rollout_buffer, model.batch_size) == (buffer, 4)


@pytest.mark.slow
def test_a_training_with_mirror_images_continues_to_the_bit(tmp_path: Path) -> None:
    path = tmp_path / "cart.yaml"
    path.write_text(CART)
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    train(path, run=whole, engine="pybullet")
    train(path, run=parts, engine="pybullet", progress=At(200))
    resume(parts)
    assert outcome(parts)["models"] == outcome(whole)["models"]


def test_the_previous_action_has_the_sign_of_the_action(tmp_path: Path) -> None:
    text = CART.replace("deepbots: 1\n", "deepbots: 1\nobservation: {previous_action: auto}\n", 1)
    program = compiled(tmp_path, text)
    names = [entry.name for entry in program.agent.inputs]
    symmetry = symmetry_of(program)
    assert symmetry.ranges.factors == (-1.0,)
    assert symmetry.observation.factors[names.index("previous_action.drive")] == -1.0


def test_the_previous_action_has_the_sign_of_a_component_that_is_named_with_its_action(
    tmp_path: Path,
) -> None:
    text = DOG.replace('flip: ["*_hip_joint"', 'flip: ["dog.*_hip_joint", "stride.*_hip_joint"')
    program = compiled(tmp_path, text)
    names = [entry.name for entry in program.with_critic.agent.inputs]
    factors = symmetry_of(program).observation.factors
    assert factors[names.index("previous_action.FL_hip_joint")] == -1.0
    assert factors[names.index("previous_action.FL_upper_joint")] == 1.0
