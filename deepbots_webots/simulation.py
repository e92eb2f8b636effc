"""Time, messages and sampling of a world that runs; its pace.

The clock counts basic time steps. In each one, the messages that controllers sent before leave, the physics
advances, these messages arrive, a reset that a supervisor asked for happens, and the sensors that are due
measure. So a message needs one basic time step, a reset happens at the end of the step, and a sensor measures
first when its first sampling period has passed, all as in Webots.

Unlike in Webots, a reset empties the queues of messages. In Webots, the messages of a supervisor that reads
one in each step are one step older after each reset.
"""

from __future__ import annotations

import random
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from math import hypot, inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepbots_cli import frames
from deepbots_cli.records import dataclass
from deepbots_webots.nodes import text
from deepbots_webots.physics import Physics
from deepbots_webots.sensors import Device as DeviceObject
from deepbots_webots.sensors import Sampled

if TYPE_CHECKING:
    from deepbots_cli.diagnostics import Span
    from deepbots_cli.frames import Quaternion, Triple
    from deepbots_webots.rendering import Pictures
    from deepbots_webots.scene import Device, Robot, Scene
    from deepbots_webots.syntax import Node


@dataclass(eq=False)
class Packet:
    """A message on its way or in a queue.

    Once it arrived, `offset` is the vector from the receiver to the emitter in the world (m), and `rotation`
    is the rotation of the receiver. `noise` is the factor of its signal strength.
    """

    data: bytes
    emitter: Device
    channel: int
    range: float
    offset: Triple = (0.0, 0.0, 0.0)
    rotation: Quaternion = frames.IDENTITY_ROTATION
    noise: float = 1.0

    @property
    def distance(self) -> float:
        return hypot(*self.offset)

    @property
    def strength(self) -> float:
        """The signal strength, 1 at 1 m."""
        return self.noise / self.distance**2 if self.distance else inf

    @property
    def direction(self) -> Triple:
        """The direction of the emitter in the frame of the receiver."""
        length = self.distance or 1.0
        return frames.rotate_back(self.rotation, frames.scaled(self.offset, 1 / length))


class Simulation:
    """A world that runs. Times are in ms.

    `ticks` is the time since the start, `time` that since the last reset, and `physics_seconds` the CPU time
    of the physics (s). `current` is the robot whose controller runs now. `wait` is what a controller's step
    of some ms does; it returns -1 at the end of the simulation. `objects` are those of the devices that
    controllers asked for, and `states` those that supervisors saved, by name. `held_keys` returns the codes
    of the keys that a person holds, the newest first; it is None without a page. `reset_is_due` says that the
    world is reset at the end of the next basic time step. `on_change` is called after nodes came or went, and
    `on_restart` with a robot whose controller begins again.
    """

    def __init__(self, scene: Scene, span: Span) -> None:
        """Build the world.

        Raises:
            WorldError: MuJoCo refuses the world.
        """
        self.scene = scene
        self.source, self.world_path = span.source, str(Path(span.source.name).resolve())
        self.physics = Physics(scene, span)
        self.basic_step = scene.basic_step
        self.ticks = self.time = 0
        self.random = random.Random(scene.seed)
        self.current: Robot | None = None
        self.quit_status: int | None = None
        self.custom_data: dict[Node, str] = {}
        self.physics_seconds = 0.0
        self.wait: Callable[[Robot, int], int] = self._advance_alone
        self.objects: dict[Device, DeviceObject] = {}
        self.states: dict[str, Any] = {}
        self.held_keys: Callable[[], Sequence[int]] | None = None
        self._outbox: list[Packet] = []
        self._sensors: list[Sampled] = []
        self.reset_is_due = False
        self.on_change: list[Callable[[], None]] = []
        self.on_restart: Callable[[Robot], None] = lambda robot: None
        self._warnings: set[str] = set()
        self._begin(scene.robots)

    def _begin(self, robots: Iterable[Robot]) -> None:
        self.custom_data |= {robot.node: text(robot.node, "customData") for robot in robots}

    def change(self, change: Callable[[], None]) -> None:
        """Let a function change the nodes of the world; forgets saved states.

        Raises:
            WorldError: The world has an error after the change.
        """
        before = self.scene.robots[:]
        self.physics.rebuild(change)
        now = self.scene.robots
        self._keep({device for robot in now for device in robot.devices.values()})
        self._begin(robot for robot in now if robot not in before)
        self.states.clear()
        self.__dict__.pop("pictures", None)
        for call in self.on_change:
            call()

    def _keep(self, devices: set[Device]) -> None:
        """Forget the objects of all other devices, and what they measure."""
        self._sensors = [
            sensor
            for sensor in self._sensors
            if not isinstance(sensor, DeviceObject) or sensor._spec in devices
        ]
        self.objects = {device: each for device, each in self.objects.items() if device in devices}

    def restart(self, robot: Robot) -> None:
        """Let the controller of a robot begin again, with devices that are as at the start."""
        self._keep(self.objects.keys() - robot.devices.values())
        self.on_restart(robot)

    def warn_once(self, message: str) -> None:
        if message not in self._warnings:
            self._warnings.add(message)
            print(f"Warning: {message}", file=sys.stderr)

    # Steps

    def run_step(self) -> None:
        """Advance by one basic time step."""
        outbox, self._outbox = self._outbox, []
        started = time.thread_time()
        self.physics.step()
        # CPU time of this thread: that of others, such as the page's, is left out.
        self.physics_seconds += time.thread_time() - started
        self.ticks += self.basic_step
        self.time += self.basic_step
        if self.reset_is_due:
            self._reset()
        else:
            for packet in outbox:
                for sensor in self._sensors:
                    sensor.hear(packet)
        for sensor in self._sensors:
            if sensor.due <= self.ticks:
                sensor.due += sensor.period
                sensor.sample()

    @cached_property
    def pictures(self) -> Pictures:
        """Draws the world."""
        from deepbots_webots.rendering import Pictures

        return Pictures(self.physics)

    def _advance_alone(self, robot: Robot, period: int) -> int:
        for _ in range(max(1, -(-period // self.basic_step))):
            self.run_step()
        return 0

    def _reset(self) -> None:
        self.reset_is_due = False
        self.physics.reset()
        self.time = 0
        self._outbox.clear()
        self._begin(self.scene.robots)
        for sensor in (*self._sensors, *self.objects.values()):
            if isinstance(sensor, Sampled):
                sensor.forget()

    # Sensors

    def enable(self, sensor: Sampled, period: int) -> None:
        """Let a device measure in every `period` ms, in whole basic time steps; first after one period."""
        steps = max(1, -(-period // self.basic_step))  # rounded up
        sensor.period = steps * self.basic_step
        sensor.due = self.ticks + sensor.period
        if sensor not in self._sensors:
            self._sensors.append(sensor)

    def disable(self, sensor: Sampled) -> None:
        if sensor in self._sensors:
            self._sensors.remove(sensor)
        sensor.period = 0

    # Messages

    def waiting_bytes(self, emitter: Device) -> int:
        """Return the size of the messages of an emitter that are sent in the next basic time step."""
        return sum(len(packet.data) for packet in self._outbox if packet.emitter is emitter)

    def send(self, emitter: Device, data: bytes, channel: int, reach: float) -> None:
        """Send a message in the next basic time step; `reach` is in m, negative without a limit."""
        self._outbox.append(Packet(data, emitter, channel, reach))


# Pace: as fast as it can, at the pace of a clock, or by single steps

MAX_DELAY_S = 0.1
"""The maximum delay of the world behind the clock that it catches up, s."""


class Pace:
    """The pace of a world. Any thread may change it while the world waits.

    `on_pause` is called in the thread of the world before it stands still.
    """

    def __init__(self, simulation: Simulation, *, is_fast: bool) -> None:
        """Let the world run from now on: as fast as it can if `is_fast`, else at the pace of a clock."""
        self._simulation = simulation
        self._changed = threading.Condition()
        self._single_steps = 0
        self.on_pause: Callable[[], None] = lambda: None
        self.run(is_fast=is_fast)

    def run(self, *, is_fast: bool) -> None:
        with self._changed:
            self.is_fast, self.is_paused = is_fast, False
            self._begin = time.monotonic() - self._simulation.ticks / 1000
            self._changed.notify_all()

    def pause(self) -> None:
        with self._changed:
            self.is_paused, self._single_steps = True, 0

    def step_once(self) -> None:
        """Pause, and make one basic time step."""
        with self._changed:
            self.is_paused = True
            self._single_steps += 1
            self._changed.notify_all()

    def wait(self) -> bool:
        """Wait until the next basic time step may begin; returns whether the world was paused."""
        if self.is_paused:
            self.on_pause()
            with self._changed:
                self._changed.wait_for(lambda: self._single_steps > 0 or not self.is_paused)
                self._single_steps = max(0, self._single_steps - 1)
            return True
        if not self.is_fast:
            left = self._begin + self._simulation.ticks / 1000 - time.monotonic()
            self._begin += max(0.0, -left - MAX_DELAY_S)
            time.sleep(max(0.0, left))
        return False
