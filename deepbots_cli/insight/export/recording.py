"""Steps of a simulation for an exported policy: the raw values of its inputs, and the commands that robots
applied."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import api
from deepbots_cli.expressions.types import Constant, ValueType
from deepbots_cli.insight.export.readings import Reading
from deepbots_cli.program import Program, generated
from deepbots_cli.program.values import Expression
from deepbots_cli.rollout import Start, steps
from deepbots_cli.rollout.episode import Driver
from deepbots_cli.runtime import Supervisor
from deepbots_robot.model import Output

if TYPE_CHECKING:
    # A simulated robot has no policy, and does not need torch.
    from deepbots_cli.insight.export.control import (
        ControlStep,
    )

_PREFIX = "export_"
_SEED = 20_000
_NUMPY_TYPES = {"float64": np.float64, "bool": np.bool_, "uint8": np.uint8}
Array = NDArray[Any]


class RecordedStep(NamedTuple):
    """A call of a policy: the value of each input before it, the commands during it, and the action. `first`
    begins an episode."""

    first: bool
    inputs: Mapping[str, Array]
    commands: Mapping[str, Array]
    action: Any


def recorded_steps(
    step: ControlStep, make_driver: Callable[[Supervisor], Driver], *, engine: str | None = None
) -> Generator[RecordedStep, None, None]:
    """Yield the steps of episodes without end, one after the other. For copies of a robot, these are the
    steps of the first copy.

    Args:
        make_driver: Returns the driver for the environment.
    """
    readings = [*step.readings.values()]
    with closing(api.build(with_probes(_as_exported(step.program), readings), engine=engine)) as world:
        agent = next(iter(world.agents.values()))
        watch = Watch(agent, readings, step.outputs)
        noted = _noted_observations(agent, watch)
        driver = make_driver(world)
        number = 0
        while True:
            inputs: Mapping[str, Array] = {}
            for recorded in steps(world, driver, Start(_SEED + number)):
                observed = [*noted]
                noted.clear()
                if recorded.number:
                    action = recorded.action if agent is world else recorded.action[0]
                    between = observed[:-1] if step.repeat > 1 else []
                    for index, step_inputs in enumerate([inputs, *between]):
                        yield RecordedStep(
                            recorded.number == 1 and index == 0, step_inputs, watch.commands(), action
                        )
                inputs = observed[-1]
            number += 1


def with_probes(program: Program, readings: Sequence[Reading]) -> Program:
    """Return the program whose supervisor stores the readings of the world."""
    probes = []
    for number, reading in enumerate(readings):
        if reading.device is None:
            first_value = program.agent.observation[0].value
            count = len(reading.trees)
            components = tuple(f"c{index}" for index in range(count)) if count > 1 else None
            typed = Constant(
                ValueType(components=components, boolean=reading.info.dtype == "bool"), 0, 0, (0.0,) * count
            )
            name = f"{_PREFIX}{number}"
            probe = Expression(
                name,
                first_value.span,
                reading.info.name,
                typed,
                f"signals.{name}",
                lowered=tuple(reading.trees),
            )
            probes.append(probe)
    stored = program.stored_signals | {probe.name for probe in probes}
    return replace(program, signals=(*program.signals, *probes), stored_signals=stored)


def _as_exported(program: Program) -> Program:
    """Return the program without the noise that the supervisor adds, which a bundle leaves out. Rewards and
    endings in Python are removed too, because they are not needed."""
    agent, others = program.agent, program.others
    if others is not None:
        program = replace(program, others=replace(others, world=_as_exported(others.world)))
    program = program.with_agent(
        observation=tuple(replace(entry, noise=None) for entry in agent.observation),
        goal=agent.goal and replace(agent.goal, achieved=replace(agent.goal.achieved, noise=None)),
        reward=tuple(term for term in agent.reward if term.foreign is None),
    )
    signals = tuple(replace(signal, noise=None) for signal in program.signals)
    return replace(
        program,
        endings=tuple(ending for ending in program.endings if ending.foreign is None),
        signals=signals,
    )


def _noted_observations(agent: Supervisor, watch: Watch) -> list[dict[str, Array]]:
    """Return a list that gets the inputs of each further timestep, after which the supervisor observes."""
    noted: list[dict[str, Array]] = []
    world: Any = getattr(agent, "supervisor", agent)  # that of several agents observes for all of them
    observe = world._observe

    def observing(*action: Any) -> None:
        observe(*action)
        noted.append(watch.inputs())

    world._observe = observing
    return noted


class Watch:
    """Reads inputs from a supervisor, and records the commands that its robots apply."""

    def __init__(self, agent: Supervisor, readings: Sequence[Reading], outputs: Sequence[Output]) -> None:
        self._readers = {
            reading.info.name: self._reader(agent, number, reading) for number, reading in enumerate(readings)
        }
        self._infos = {reading.info.name: reading.info for reading in readings}
        self._commands: dict[str, Array] = {}
        self.drives: list[_Drive] = []
        """The actuators that record their commands."""
        for output in outputs:
            controller, attribute = agent.controllers[output.robot], generated.drive(output.actuator)
            drive = _Drive(getattr(controller, attribute), partial(self._note, output.name))
            setattr(controller, attribute, drive)
            self.drives.append(drive)
        for robot in {output.robot for output in outputs}:
            if not agent.scenario.is_direct(
                next(entry for entry in agent.scenario.robots if entry.name == robot), "to_robot"
            ):
                self._apply_when_sent(agent, robot)

    def _apply_when_sent(self, agent: Supervisor, robot: str) -> None:
        """Record the commands of a message when it is sent, because it may be late or be lost on the way."""
        channel, controller = agent.channels[robot, "to_robot"], agent.controllers[robot]
        drives = [drive for drive in vars(controller).values() if isinstance(drive, _Drive)]
        send = channel.send
        for drive in drives:
            drive.switch(notes=False, acts=True)

        def sending(values: Sequence[Any]) -> Any:
            for drive in drives:
                drive.switch(notes=True, acts=False)
            controller.use_message_data(values)  # type: ignore[attr-defined]
            for drive in drives:
                drive.switch(notes=False, acts=True)
            return send(values)

        channel.send = sending  # type: ignore[method-assign, assignment]

    def _note(self, name: str, targets: Sequence[float]) -> None:
        self._commands[name] = np.array([*targets], np.float64)

    @staticmethod
    def _reader(agent: Supervisor, number: int, reading: Reading) -> Callable[[], Any]:
        if reading.device is None:
            return lambda: getattr(agent, generated.last(f"{_PREFIX}{number}"))
        robot, sensor = reading.device
        device = agent.controllers[robot].device(sensor)
        return lambda: device.reading

    def inputs(self) -> dict[str, Array]:
        """Return the value of each input now."""
        inputs: dict[str, Array] = {}
        for name, read in self._readers.items():
            info, value = self._infos[name], read()
            if info.dtype == "uint8":
                value = value[0] if isinstance(value, tuple | list) else value
            inputs[name] = np.array(value, _NUMPY_TYPES[info.dtype]).reshape(info.shape)
        return inputs

    def commands(self) -> dict[str, Array]:
        """Return the commands of this step."""
        return dict(self._commands)


class _Drive:
    """An actuator that records its commands; for everything else the actuator itself."""

    def __init__(
        self, drive: Callable[[Sequence[float]], object], note: Callable[[Sequence[float]], None]
    ) -> None:
        # `__setattr__` passes each attribute on to the actuator, so the attributes of this object bypass it.
        vars(self).update(drive=drive, note=note, notes=True, acts=True)

    def __call__(self, targets: Sequence[float]) -> None:
        targets = [*targets]
        if self.notes:
            self.note(targets)
        if self.acts:
            self.drive(targets)

    def __getattr__(self, name: str) -> Any:
        return getattr(vars(self)["drive"], name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(vars(self)["drive"], name, value)

    def switch(self, *, notes: bool, acts: bool) -> None:
        """Set whether the actuator records commands, and whether it passes them on."""
        vars(self).update(notes=notes, acts=acts)
