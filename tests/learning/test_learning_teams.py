"""Several copies of a robot in one world, under one policy."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import stand_in
from stand_in import hyper

from deepbots_cli.learning import evaluate, resume, train
from deepbots_cli.program import Program
from deepbots_cli.program.task import Network, Training
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.worlds import SingleWorlds
from tests.few import few

SIZE = 3


class Member(stand_in.CartPole):
    """A cart-pole whose last step can be asked for again."""

    def reset(self, **settings: Any) -> tuple[Any, dict[str, Any]]:
        self.outcome = (*super().reset(**settings), 0.0, False, False)
        return self.outcome[0], self.outcome[1]

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = super().step(action)
        self.outcome = (observation, info, reward, terminated, truncated)
        return observation, reward, terminated, truncated, info

    def get_observations(self) -> Any:
        return self.outcome[0]

    def get_reward(self) -> float:
        return self.outcome[2]

    def get_info(self) -> dict[str, Any]:
        return self.outcome[1]

    def is_done(self) -> tuple[bool, bool]:
        return self.outcome[3], self.outcome[4]


class Team(gym.Env[Any, Any]):
    """Three of them; the episode ends for all when it ends for one."""

    def __init__(self, program: Program, render_mode: str | None = None) -> None:
        self.agents = {f"cart#{number}": Member(program) for number in range(1, SIZE + 1)}
        self.observation_space = gym.spaces.Box(-1, 1, (SIZE, 4), np.float32)
        self.action_space = gym.spaces.MultiDiscrete([2] * SIZE)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        for member in self.agents.values():
            member.reset(seed=int(self.np_random.integers(2**31)))
        return self._rows(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert np.shape(action) == (SIZE,)
        outcomes = [member.step(int(row)) for member, row in zip(self.agents.values(), action, strict=True)]
        ended = [info for _, _, terminated, _, info in outcomes if terminated]
        info = ended[0] if ended else outcomes[0][4]
        return (
            self._rows(),
            float(np.mean([o[1] for o in outcomes])),
            bool(ended),
            not ended and outcomes[0][3],
            info,
        )

    def _rows(self) -> Any:
        return np.stack([member.get_observations() for member in self.agents.values()])


def test_a_team_is_unrolled_into_a_row_for_each_copy() -> None:
    program = stand_in.scenario()
    episodes: list[tuple[int, Episode]] = []
    copies = SingleWorlds(
        [Team(program), Team(program)],
        [1, 2],
        on_episode=lambda world, episode: episodes.append((world, episode)),
    )
    alone = [Team(program), Team(program)]
    first = np.concatenate([team.reset(seed=seed)[0] for team, seed in zip(alone, (1, 2), strict=True)])
    assert copies.rows == 6
    assert copies.observation_space.shape == (4,)
    assert (copies.reset() == first).all()
    dones = np.zeros(6, bool)
    count = 0
    while (
        not dones.any()
    ):  # the first team drives on, the second back and forth, which holds the poles up for longer
        actions = np.array([0, 1, 1] + [count % 2] * 3)
        count = count + 1
        before = np.concatenate(
            [team.step(rows)[0] for team, rows in zip(alone, (actions[:3], actions[3:]), strict=True)]
        )
        step = copies.step_all(actions)
        observations, rewards, dones, endings = step.observations, step.rewards, step.ended, step.endings
        assert (rewards == 1.0).all()
    world = int(np.argmax(dones)) // SIZE
    rows = range(world * SIZE, world * SIZE + SIZE)
    assert dones.tolist() == [row in rows for row in range(6)]
    ended = {ending.row: ending for ending in endings}
    own = [row for row in rows if not ended[row].timed_out]
    assert own  # whoever ended it did so itself; for the others it was cut short
    assert list(ended) == list(rows)
    assert all((ended[row].observation == before[row]).all() for row in rows)
    assert all((observations[row] != before[row]).any() for row in rows)  # of the next episode
    assert [(world, episode.ended_by) for world, episode in episodes] == [
        (world, "fallen" if row in own else "another_copy") for row in rows
    ]


@pytest.mark.parametrize("algorithm", few(["PPO", "RecurrentPPO"], ["PPO"]))
def test_a_team_is_trained_evaluated_and_gone_on_with(tmp_path: Path, algorithm: str) -> None:
    training = Training(
        algorithm,
        600,
        2,
        hyper(n_steps=32, batch_size=32),
        Network((8,)),
    )
    result = train(stand_in.compiled(training=training), run=tmp_path / "run", build=Team)
    assert result.steps == 768  # updates of 32 steps of six rows
    log = list(csv.DictReader((result.run / "monitor.csv").read_text().splitlines()[1:]))
    assert {row["ended_by"] for row in log} == {"fallen", "another_copy"}
    first, again = (evaluate(result.run, episodes=5, build=Team) for _ in range(2))
    assert first == again
    assert first.episodes == 5
    assert first.mean_return == pytest.approx(first.mean_length)
    assert resume(result.run, total_timesteps=800, build=Team).steps >= 800
