"""Copies of a robot in one world, under one policy: a supervisor for each, and one that keeps them together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector.utils import batch_space

from deepbots_cli.frames import Triple
from deepbots_cli.port import Engine
from deepbots_cli.program import Program
from deepbots_cli.program.task import RobotCopies
from deepbots_cli.program.world import WorldModel
from deepbots_cli.runtime.share import Share, copy_name
from deepbots_cli.runtime.streams import Streams
from deepbots_cli.runtime.supervisor import Info, Supervisor

_FINISHED = object()


def populated(world: WorldModel, copies: RobotCopies) -> WorldModel:
    """The world with the copies in place of the robot."""
    one = next(robot for robot in world.robots if robot.name == copies.robot)
    others = tuple(robot for robot in world.robots if robot is not one)
    return replace(world, robots=(*others, *(replace(one, name=copy_name(copies, k + 1)) for k in range(copies.count))))


def assemble(
    kind: type[Supervisor], scenario: Program, create: Callable[[WorldModel], Engine], render_mode: str | None = None
) -> Supervisor:
    """The environment of a scenario whose generated supervisor is `kind`: one of these, or a team of them."""
    copies = scenario.agent.each
    if copies is None:
        return kind(scenario, create(scenario.world), render_mode)
    return Team(kind, scenario, copies, create(populated(scenario.world, copies)), render_mode)


class Team(Supervisor):
    """A Gymnasium environment over all copies: observations and actions have a row for each.

    Each of `members` is the supervisor of one copy, with rewards, endings and channels of its own; draws are its own
    too, but for parameters, which have one value for all. The episode ends for all when it ends for one. The reward is
    the mean over the copies; `info["each"]` holds what each has got, and whether it was the one that ended.
    """

    def __init__(
        self, kind: type[Supervisor], scenario: Program, copies: RobotCopies, engine: Engine, render_mode: str | None = None
    ) -> None:
        self.copies = copies
        shares = [Share(engine, copies, number + 1) for number in range(copies.count)]
        self.members = [kind(scenario, share) for share in shares]
        self._shares = shares
        self._divided: Streams | None = None
        super().__init__(scenario, engine, render_mode)
        self.observation_space = batch_space(self.members[0].observation_space, copies.count)
        self.action_space = batch_space(self.members[0].action_space, copies.count)

    def begin_robots(self) -> None:
        for member in self.members:
            member.begin_robots()

    def _begin(self) -> None:
        if self._divided is not self.streams:
            self._divided = self.streams
            for number, member in enumerate(self.members):
                member.streams = Streams(self.streams.root, copy_name(self.copies, number + 1))
        self.engine.reset()
        for member in self.members:
            member._forget()
            member.chosen = self.chosen
            member._begin()
        if self._shares[0].settling:
            self.engine.step(self._shares[0].settling)

    def _start(self) -> None:
        for member in self.members:
            member._start()
            member._fill_frames()
        self._gather()

    def _fill_frames(self) -> None:
        """Frames are those of the members."""

    def _advance(self, action: Any) -> None:
        if not _takes(self.action_space, action):
            raise ValueError("no action of this space")
        self.step_count += 1
        rows = (
            [{key: part[row] for key, part in action.items()} for row in range(len(self.members))] if isinstance(action, dict) else action
        )
        turns = [member._advance(row) for member, row in zip(self.members, rows, strict=True)]
        for turn in turns:
            next(turn)
        running = True
        while running:
            self.engine.step(self.scenario.world.substeps)
            running = not [turn for turn in turns if next(turn, _FINISHED) is _FINISHED]
        for turn in turns:
            turn.close()
        self._gather()

    def _gather(self) -> None:
        """What the team has come to by what its members have."""
        members = self.members
        self.step_count, self.tick_count = members[0].step_count, members[0].tick_count
        self.reward = sum(member.reward for member in members) / len(members)
        ended = [member for member in members if member.terminated]
        over = ended or [member for member in members if member.truncated]
        self.terminated, self.truncated = bool(ended), bool(over) and not ended
        self.is_success = bool(ended) and all(member.is_success for member in ended)
        self.endings = tuple(dict.fromkeys(name for member in over for name in member.endings))
        failed = [member for member in over if not member.is_success]
        self.ended_by = (failed or over)[0].ended_by if over else None

    def scripted(self, name: str) -> Any:
        """Every copy follows the script."""
        rows = [member.scripted(name) for member in self.members]
        if isinstance(rows[0], dict):
            return {key: np.stack([row[key] for row in rows]) for key in rows[0]}
        return np.stack(rows)

    def get_observations(self) -> Any:
        rows = [member.get_observations() for member in self.members]
        if isinstance(rows[0], dict):
            return {key: np.stack([row[key] for row in rows]) for key in rows[0]}
        return np.stack(rows)

    def get_reward(self) -> float:
        return self.reward

    def is_done(self) -> tuple[bool, bool]:
        return self.terminated, self.truncated

    def get_info(self) -> Info:
        infos = [member.get_info() for member in self.members]
        terms = {name: sum(info["reward_terms"][name] for info in infos) / len(infos) for name in infos[0]["reward_terms"]}
        each = {
            "reward": tuple(member.reward for member in self.members),
            "terminated": tuple(member.terminated for member in self.members),
            "is_success": tuple(member.is_success for member in self.members),
        }
        return {
            "is_success": self.is_success,
            "ended_by": self.ended_by,
            "endings": self.endings,
            "reward_terms": terms,
            "each": each,
        }

    def _strayed(self) -> Triple:
        return self.members[0]._strayed()

    def allowed(self) -> tuple[tuple[bool, ...], ...]:
        return tuple(mask for member in self.members for mask in member.allowed())


def _takes(space: gym.Space[Any], action: Any) -> bool:
    """Whether every row can be acted on; a team that has half acted could not go back."""
    if isinstance(space, gym.spaces.Dict):
        return isinstance(action, dict) and set(action) == set(space.spaces) and all(_takes(space[key], action[key]) for key in action)
    if isinstance(space, gym.spaces.Box):
        return isinstance(action, np.ndarray) and action.shape == space.shape and bool(np.isfinite(action).all())
    return space.contains(action)
