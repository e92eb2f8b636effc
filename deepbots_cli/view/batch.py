"""A batch of worlds on the page: all of them are stepped together on arrays, and one at a time is read and
shown."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from deepbots_cli import api
from deepbots_cli.errors import UsageError
from deepbots_cli.program import Program
from deepbots_cli.program.members import RANDOM, ZERO
from deepbots_cli.rollout import Driver, Start
from deepbots_cli.rollout.batch_worlds import BatchEpisodes
from deepbots_cli.rollout.drivers import HAND, POLICY, action_from_values
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.batch_parts import BatchChannel, columns_array
from deepbots_cli.runtime.spaces import joined
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.view.episodes import Player
from deepbots_cli.view.frames import (
    AgentFrame,
    FrameReader,
    ReceivedMessage,
    WorldFrame,
    successful_agents,
    value_of_row,
)


class BatchPlayer(Player):
    """Steps a batch of worlds, and reads frames of one of them, `world`.

    World k plays episode `episode + k` of an evaluation, with the same result as in a single world. After its
    episode it is not stepped until the next episodes begin.
    """

    def _make(self, program: Program) -> Supervisor:
        self.batch = api.build_batch(
            program, self.opened.shown.worlds, engine=self.opened.shown.engine or "mujoco"
        )
        self.worlds = len(self.batch.singles)
        self._readers: dict[int, FrameReader] = {}
        return self.batch.singles[0]

    def make_reader(self) -> FrameReader:
        if self.world not in self._readers:
            self._readers[self.world] = FrameReader(self.env, self.opened.checked().units)
        return self._readers[self.world]

    def set_driver(self, name: str) -> None:
        """Set the driver that acts in all worlds from the next step on.

        Raises:
            UsageError: The driver is a script, which reads values that only a single world computes.
        """
        if name == POLICY and self.opened.run is not None:
            self.driver = self.run_driver(self.opened.run, self.batch)
        elif name in (HAND, RANDOM, ZERO):
            drivers = [self.make_driver(single, name) for single in self.batch.singles]
            self.driver = Driver(
                lambda _: self.batch.rows.by_row(joined([driver.act(None) for driver in drivers]))
            )
        else:
            raise UsageError(
                f"'{name}' cannot drive a batch of worlds; use {', '.join(self.opened.drivers)}, or leave"
                " out --worlds"
            )
        self.driver_name = name

    def choose(self, world: int) -> WorldFrame:
        """Show another world of the batch. Returns its newest frame."""
        self._turn_to(world)
        return self._read()

    def _turn_to(self, world: int) -> None:
        self.world = world
        self.env = self.batch.singles[world]
        self.seed = self._seeds[world]
        self.reader = self.make_reader()

    def begin(self, seed: int, episode: int) -> WorldFrame:
        self._seeds = [derive_seed(seed, "evaluation", episode + world) for world in range(self.worlds)]
        self._running = BatchEpisodes(self.batch, by_copy=True)
        self._endings: dict[int, dict[str, Any]] = {}
        """The endings of the episodes of worlds, as fields of a frame."""
        self._rewards = np.zeros(self.batch.count)
        self._terms = np.zeros((len(self.batch.TERMS), self.batch.count))
        self.action = None
        self.driver.begin(Start())
        self._turn_to(self.world)  # the reader keeps the messages of the reset
        self.observation = self.batch.reset(self._seeds, dict(self.opened.shown.start))
        return self._read()

    def next_episode(self, episode: int) -> int:
        return episode + self.worlds

    def step(self, *, by_hand: bool = False) -> WorldFrame:
        if by_hand:
            self.action = self.batch.rows.by_row(
                joined([action_from_values(self.env, self.manual_values)] * self.worlds)
            )
        else:
            self.action = self.driver.act(self.observation)
        acting = (~self._running.resting).repeat(self.batch.copies)
        outcome = self._running.step_all(self.action)
        self._rewards[acting] = outcome.rewards[acting]
        self._terms[:, acting] = outcome.terms[:, acting]
        self.observation = outcome.observations
        outcome = self.batch.rows.step_by_world(outcome)
        self._running.resting[outcome.done] = True
        for world, info in zip(outcome.done.tolist(), outcome.infos, strict=True):
            ended = {name: info[name] for name in ("ended_by", "is_success")}
            self._endings[world] = {
                **ended,
                "truncated": bool(outcome.truncated[world]),
                "succeeded": successful_agents(self.program, info["endings"], info.get("agent_endings", {})),
            }
        return self._read()

    @property
    def note(self) -> str:
        """The number of running worlds, and how others have ended."""
        running = self.worlds - len(self._endings)
        ended = Counter(str(ending["ended_by"]) for ending in self._endings.values())
        counts = [f"running {running}"] * (running > 0) + [
            f"{name} {count}" for name, count in ended.most_common()
        ]
        state = f"world {self.world} of {self.worlds} ({', '.join(counts)})"
        return f"{state}; {self.driver.note}" if self.driver.note else state

    def close(self) -> None:
        self.batch.close()

    def _read(self) -> WorldFrame:
        """Read the frame of the world: its poses, rays and contacts, and the columns of the batch."""
        batch, world = self.batch, self.world
        action = None if self.action is None else batch.rows.by_world(self.action)
        frame = self.reader.read(
            value_of_row(batch.rows.by_world(self.observation), world), value_of_row(action, world)
        )
        # Before the first step, the single world has all values.
        if step := int(batch.step_count[world * batch.copies]):
            frame = replace(
                frame,
                step=step,
                time=step * self.program.period,
                readings={key: self._reading(key) for key in frame.readings},
                messages={key: self._message(key, message) for key, message in frame.messages.items()},
                agents={name: self._agent(agent, self._row(name)) for name, agent in frame.agents.items()},
                **self._endings.get(world, {}),
            )
        self.frame = frame
        return frame

    def _row(self, name: str) -> int:
        """Return the row of an agent or robot of the world, given its name there."""
        return self.world * self.batch.copies + int(name.partition("#")[2] or 1) - 1

    def _agent(self, agent: AgentFrame, row: int) -> AgentFrame:
        batch = self.batch
        terms = dict(zip(batch.TERMS, self._terms[:, row].tolist(), strict=True))
        goes_on = batch.forbids_options and not (batch.terminated[row] or batch.truncated[row])
        allowed = tuple(batch.action_masks()[row].tolist()) if goes_on else ()
        return replace(
            agent,
            reward=float(self._rewards[row]),
            episode_return=float(self._running.returns[row]),
            terms=terms,
            allowed=() if all(allowed) else allowed,
        )

    def _reading(self, key: str) -> tuple[float, ...]:
        name, _, sensor = key.partition(".")
        reading = self.batch.controllers[name.partition("#")[0]].devices[sensor].reading
        return tuple(map(float, reading[:, self._row(name)]))

    def _message(self, key: str, message: ReceivedMessage) -> ReceivedMessage:
        """Return the newest message. A message that may be late or lost passed through the channel of the
        single world."""
        name, _, direction = key.partition("/")
        channel = self.batch.channels[name.partition("#")[0], direction]
        if not isinstance(channel, BatchChannel):
            return message
        columns = [columns_array(value, self.batch.count) for value in channel.receive()]
        return ReceivedMessage(
            tuple(float(x) for column in columns for x in np.atleast_1d(column[..., self._row(name)])),
            0.0,
            True,
        )
