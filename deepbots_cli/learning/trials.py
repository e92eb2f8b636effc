"""Trials: what the networks of a moment do by themselves, which decides about the best model and about stopping.

The mean of past episodes tells of the networks before, with noise on their actions. Those of TD3 and DDPG change much from one
moment to the next: of three trainings of FindBall that stopped at a mean of 95 %, one held a network that found the ball in 32 %
of its episodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from stable_baselines3.common.base_class import BaseAlgorithm

from deepbots_cli.learning.environments import BuildWorld, World
from deepbots_cli.learning.episodes import Episode
from deepbots_cli.learning.interruption import Interruption
from deepbots_cli.learning.rollout import rollout
from deepbots_cli.learning.summary import Summary
from deepbots_cli.program import Program
from deepbots_cli.runtime.streams import derive

EPISODES = 20
"""Starts of a trial, the same each time: two networks differ by what they do there, not by their luck."""

PROOF = 50
"""Starts of the trial that ends a training of an off-policy algorithm: of 20 episodes, a network that succeeds in 85 % of all
loses at most one in 18 % of the cases; of 50, at most two in 1 %. With the small updates of PPO, past episodes tell enough."""

SHARE, OVERTIME_SHARE, AT_ONCE = 0.1, 0.5, math.inf
"""What trials may take of the steps that are trained: little as a rule, half when only a trial is missing to end the training.
Counted in steps, for the clock would make the best model a matter of the machine's mood."""


class Trials:
    """Runs candidates without noise, in a world of their own, from starts that neither training nor evaluation has."""

    def __init__(self, build: BuildWorld, seed: int, steps: int = 0) -> None:
        """`steps` are those of the trials before, in a resumed training."""
        self.steps = steps
        self._build = build
        self._seeds: Sequence[int] = [derive(seed, "trial", k) for k in range(PROOF)]
        self._scenario: Program | None = None
        self._world: World | None = None

    def due(self, trained: int, length: float, share: float) -> bool:
        """Whether another one fits into this share of `trained` steps, if its episodes are of that length."""
        return self.steps + EPISODES * length <= share * trained

    def hold(self, model: BaseAlgorithm, scenario: Program, interruption: Interruption, episodes: int = EPISODES) -> Summary | None:
        """What the networks do in `scenario`; None if somebody wants the work to end. The training's random numbers stay as they were."""
        world = self._world_of(scenario)
        state = torch.get_rng_state()
        done: list[Episode] = []
        try:
            for seed in self._seeds[:episodes]:
                if interruption.requested:
                    return None
                done += rollout(model, [world], [seed], deterministic=True)
                self.steps += done[-1].length
        finally:
            torch.set_rng_state(state)
        return Summary.of(done)

    def _world_of(self, scenario: Program) -> World:
        if self._world is None or scenario is not self._scenario:
            self.close()
            self._world, self._scenario = self._build(scenario), scenario
        return self._world

    def close(self) -> None:
        if self._world is not None:
            self._world.close()
            self._world = None
