"""The bases of generated classes: the supervisor and the robot controllers.

The supervisor is a Gymnasium environment: it sees and resets the whole world, scores, and exchanges messages
with robots. A robot controller reads its own sensors and acts on messages.
"""

from __future__ import annotations

import math
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from struct import Struct
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import EndsAtResetError, EvaluationError, MessageError, UsageError
from deepbots_cli.frames import Triple
from deepbots_cli.port import ZERO_VECTOR, Engine, MotorWriter, View
from deepbots_cli.program import Program, generated
from deepbots_cli.program.robots import Actuator, CustomActuator, Direction, MessageLayout, Motor, Robot
from deepbots_cli.runtime.actuation import CustomMotor, Site
from deepbots_cli.runtime.formulas import Memories, Memory, clip, memory_of_vector
from deepbots_cli.runtime.messages import Channel, FieldCodec, LossyChannel, excerpt, layout_error
from deepbots_cli.runtime.overview import follows_robot, moved_view, overview
from deepbots_cli.runtime.readers import sees
from deepbots_cli.runtime.sensing import Device, instrument
from deepbots_cli.runtime.spaces import (
    FrameStack,
    action_space,
    canonical_action,
    compose_action,
    frame_indices,
    is_canonical,
    mask_of_space,
    observation_space,
    recompute_rewards,
)
from deepbots_cli.runtime.streams import NOTHING_CHOSEN, Drawn, Streams, chosen_values

Observation = NDArray[np.float32]
Info = dict[str, Any]
C = TypeVar("C", bound="RobotController")
M = TypeVar("M", bound=Memory)

_CLOSED = "the environment is closed; make a new one"


class _WithMemories:
    """Memories of stateful functions, which a new episode clears; `timestep` is in s."""

    def __init__(self, timestep: float) -> None:
        self._timestep = timestep
        self._memories: list[Memory | Memories] = []

    def memory(self, kind: type[M], *, on_message: bool = False) -> M:
        """A memory that begins at the reset, or else with the first message (`on_message`)."""
        memory = kind(self._timestep, on_message=on_message)
        self._memories.append(memory)
        return memory

    def memories(self, kind: type[Memory], count: int, *, on_message: bool = False) -> Memory | Memories:
        """One memory for each component of a vector."""
        memory = memory_of_vector(kind, count, self._timestep, on_message=on_message)
        self._memories.append(memory)
        return memory

    def clear_memories(self) -> None:
        for memory in self._memories:
            memory.reset()


class Supervisor(_WithMemories, gym.Env[Observation, Any], ABC):
    """Base of the generated supervisor classes.

    A generated class adds `bind` (robots, channels, and readers from the engine), `_begin` (draws and placing
    at reset), `_start` and `_advance` (the first moment of an episode, and a step), `_observe`, which both of
    them call and which computes everything once per timestep, and the paper's methods, which only read what
    that left, so calling one twice changes nothing.
    """

    newest: int
    ended_by: str | None
    endings: tuple[str, ...]
    episode_values: dict[str, float]
    """The present values, in SI units, of what `options` of `reset` can set, by its names."""
    _followed_from: tuple[float, float] | None  # where the robot was that pictures follow

    def __init__(self, scenario: Program, engine: Engine, render_mode: str | None = None) -> None:
        """Takes over `engine`, which holds the scenario's world, and closes it with itself.

        Raises:
            UsageError: `render_mode` is neither None nor "rgb_array", or the engine cannot draw.
        """
        if render_mode not in (None, "rgb_array"):
            window = (
                "; for a window, wrap the environment in `gymnasium.wrappers.HumanRendering`"
                if render_mode == "human"
                else ""
            )
            raise UsageError(f"render mode {render_mode!r} is unknown; use 'rgb_array' or none{window}")
        if render_mode and "rendering" not in engine.capabilities:
            raise UsageError(
                f"the engine '{engine.name}' cannot render; use the engine 'pybullet' for pictures"
            )
        super().__init__(scenario.world.timestep)
        self.scenario = scenario
        self.agent = scenario.agent
        self.engine = engine
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": ["rgb_array"] if "rendering" in engine.capabilities else [],
            "render_fps": max(1, round(1 / scenario.period)),
        }
        self.observation_space = observation_space(self.agent)
        self.action_space = action_space(self.agent)
        self.world = scenario.world
        """What the engine holds: with copies of a robot, each under its own name."""
        self.agents: dict[str, Supervisor] = {self.agent.name: self}
        """The supervisor of each copy of the agent, by name; without copies this one, under the name of the
        agent."""
        self.streams = Streams(None)
        self.views = frame_indices(self.agent)
        self.depth = len(self.views)
        self.frame_stacks = {
            entry.key: FrameStack(entry.shape, entry.ages(self.agent.frame_stack), self.depth)
            for entry in self.agent.images
        }
        self.frames = np.zeros(self.depth * len(self.agent.numbers), np.float32)
        self._buffer = self.frames.data
        self._width = 4 * len(self.agent.numbers)
        self._pack = Struct(f"{len(self.agent.numbers)}f").pack_into
        self._ranges = len(self.agent.range_names)
        self.goal = np.zeros(2 * len(self.agent.goal.low) if self.agent.goal else 0, np.float32)
        self.physics = engine.step
        self.rebuild: Callable[[], Supervisor] | None = None
        self.fixed: tuple[str, ...] = ()  # parameters that no episode draws
        self._drawn: Drawn = {}
        self._closed = False
        self._go_on: Callable[[Any], None] = self._refuse
        self._forget()
        self.controllers: dict[str, RobotController] = {}
        self.channels: dict[tuple[str, Direction], Channel | LossyChannel] = {}
        """The paths of messages, by robot and direction."""
        self.bind(engine)

    # What `bind` makes

    def robot(self, name: str, controller: type[C]) -> C:
        """The controller of a robot."""
        robot_controller = controller(self._spec(name), self.scenario, self.engine)
        self.controllers[name] = robot_controller
        return robot_controller

    def channel(self, name: str, direction: Direction) -> Channel:
        """The path of messages to or from a robot, where it is direct."""
        spec = self._spec(name)
        channel = Channel(
            FieldCodec(
                spec.to_robot if direction == "to_robot" else spec.from_robot,
                self.scenario.format,
                self._rejected,
            )
        )
        self.channels[name, direction] = channel
        return channel

    def lossy_channel(self, name: str, direction: Direction) -> LossyChannel:
        """The path of messages to or from a robot, where messages come late or may be lost."""
        robot, to_robot = self._spec(name), direction == "to_robot"
        route, layout = (robot.to_route, robot.to_robot) if to_robot else (robot.from_route, robot.from_robot)
        channel = LossyChannel(
            f"{name}.{direction}",
            route,
            self.scenario.world.timestep,
            1 if self.scenario.timing == "delayed" else 0,
            self.engine.pose(name),
            FieldCodec(layout, self.scenario.format, self._rejected),
            first_at_once=not to_robot,
        )
        self.channels[name, direction] = channel
        return channel

    def _spec(self, name: str) -> Robot:
        return next(robot for robot in self.scenario.robots if robot.name == name)

    def begin_robots(self) -> None:
        """Controllers, channels and memories forget the last episode."""
        for part in (*self.controllers.values(), *self.channels.values()):
            part.begin(self.streams)
        self.clear_memories()

    # Gymnasium

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Begin an episode. A seed determines this episode and all following ones until the next seed.

        Args:
            seed: The root of all random streams, a whole number from 0.
            options: Values of this episode in place of draws, by the names of `drawn`: parameters (`mark.x`),
                poses and joints (`reset.place.block.x`), and all other draws. Numbers are in SI units, a
                vector (`mark`) is a sequence. Other draws do not change. `options=info["drawn"]` repeats the
                start of that episode.

        Returns:
            The observation, float32 in the observation space, and the info of a step. This info also contains
            `drawn`: the drawn values in SI units, a number or a word for each name. The name of a parameter
            is its own (`mark.x`), other names are paths in the scenario (`reset.joints.cart.pole_hinge`).
            Values that change within an episode, and noise, are left out.

        Raises:
            EvaluationError: An expression has no value, or the episode would end before its first step; the
                message names it.
            UsageError: `options` contains an unknown name, or a value that the episode cannot draw. The
                running episode continues.
        """
        if self._closed:
            raise UsageError(_CLOSED)
        chosen = self.require_drawable(options) if options else None
        super().reset(seed=seed)
        self._go_on = self._refuse
        if seed is not None:
            self.streams = Streams(seed)
            self.action_space.seed(seed)
        self._choose(chosen)
        self._forget()
        try:
            self._begin()
            self._drawn = self._noted()
            self.begin_robots()
            self._start()
            self._fill_frames()
        except (ArithmeticError, ValueError, NameError) as error:
            raise self._no_value(error) from error
        if self.terminated:
            raise EndsAtResetError(
                f"the ending '{self.ended_by}' is already true at reset (seed {self.streams.root}); change"
                " the start or the ending"
            )
        self._go_on = self._advance
        return self.get_observations(), {**self.get_info(), "drawn": self.drawn()}

    def drawn(self) -> Drawn:
        """What the last reset drew, by name; see `reset`."""
        return dict(self._drawn)

    def present_values(self) -> Drawn:
        """What the last reset drew, and the present values of parameters that change within the episode."""
        return self._drawn | self.episode_values

    def require_drawable(self, options: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        """The values of `options` of `reset`, for each copy of a robot.

        Raises:
            UsageError: They hold an unknown name, or a value that an episode could not have drawn.
        """
        return chosen_values(self.scenario, options, self.fixed, self._copies())

    def _copies(self) -> Sequence[str]:
        """The names of the copies of a robot, if there are some."""
        return ()

    def _choose(self, chosen: Mapping[str, Mapping[str, Any]] | None) -> None:
        """Begin the streams of an episode, with what `options` of `reset` chose."""
        self.streams.begin(chosen[""] if chosen else NOTHING_CHOSEN)

    def _noted(self) -> Drawn:
        """What the streams have drawn since the episode began."""
        drawn = self.streams.drawn
        return {entry.name: drawn[entry.key] for entry in self.scenario.draws.noted if entry.key in drawn}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, Info]:
        """One step of the agent: act, advance the world by a timestep, observe and score.

        Raises:
            UsageError: Before the first reset, or with an action outside the action space.
            EngineError: The state of the world contains infinite or NaN values.
            EvaluationError: An expression has no value, or the reward is not finite; the message shows which.
            MessageError: A message does not fit its layout.
        """
        try:
            self._go_on(action)
        except (ArithmeticError, ValueError, LookupError, NameError, TypeError, AttributeError) as error:
            self._try_again(action, error)
        terminated, truncated = self.is_done()
        return self.get_observations(), self.get_reward(), terminated, truncated, self.get_info()

    def random_state(self) -> dict[str, Any]:
        """The states of all random streams, as values for JSON.

        The same states and the same actions give the same episode.
        """
        return self.streams.state()

    def set_random_state(self, state: Mapping[str, Any]) -> None:
        """Restore the result of `random_state`; the next reset begins from it."""
        self.streams = Streams.restored(state)

    def render(self) -> Any:
        """An image of the world (uint8, height x width x 3), or None without a render mode."""
        if self.render_mode is None:
            return None
        return self.engine.render(self.view())

    def view(self, width: int = 480, height: int = 320) -> View:
        """The view of `render` in another size: it shows the whole scene, and follows a robot that may leave
        it."""
        return moved_view(overview(self.scenario, width, height), self._view_shift())

    def _view_shift(self) -> Triple:
        """How far the view follows: nowhere within an arena or on terrain, else as far as the first free
        robot went."""
        world = self.scenario.world
        if not follows_robot(world):
            return ZERO_VECTOR
        x, y, _ = self.engine.pose(next(robot.name for robot in world.robots if not robot.fixed_base))()[0]
        self._followed_from = self._followed_from or (x, y)
        return x - self._followed_from[0], y - self._followed_from[1], 0.0

    def close(self) -> None:
        """Release the engine; may be called twice."""
        if not self._closed:
            self._closed = True
            self._go_on = self._refuse
            self.engine.close()

    def action_masks(self) -> NDArray[np.bool_]:
        """Which options may be chosen next: the truth values of all choices in a row, as sb3-contrib wants
        them.

        Raises:
            UsageError: The action holds no choice.
        """
        masks = self.allowed()
        if not masks:
            raise UsageError("action masks need an action with `choices`, but this scenario has none")
        return np.array([may for mask in masks for may in mask])

    def action_mask(self) -> Any:
        """The masks of `action_masks` in the form that `action_space.sample` takes."""
        return mask_of_space(self.action_space, [np.array(mask, np.int8) for mask in self.allowed()])

    def reward_for(self, achieved_goal: Any, desired_goal: Any) -> Any:
        """The reward for goals as the policy sees them: for arrays (n, k) an array of n, for arrays (k,) a
        number.

        Where a scenario has a goal, `compute_reward` gives it; others do not have that method, by which a
        learner tells them.

        Raises:
            UsageError: The scenario has no goal, or the arrays do not fit it.
        """
        achieved, desired = np.asarray(achieved_goal), np.asarray(desired_goal)
        if achieved.ndim == 1:
            return recompute_rewards(self.agent, achieved[None], np.atleast_2d(desired)).item()
        return recompute_rewards(self.agent, achieved, desired)

    def script(self, name: str) -> Any:
        """The next action of a script of the scenario, in the action space; asking changes nothing.

        Raises:
            UsageError: There is no such script, or no episode has begun.
            EvaluationError: An expression of it has no value; shows which.
        """
        self.scenario.script(name)
        if self._go_on == self._refuse:
            raise UsageError(_CLOSED if self._closed else "call reset() before script()")
        try:
            return self.scripted(name)
        except (ArithmeticError, ValueError, NameError) as error:
            raise self._no_value(error) from error

    def scripted(self, name: str) -> Any:
        """The next action of a script, without a check that the script exists."""
        return getattr(self, generated.script(name))()

    def tested(self, test: str, question: generated.TestQuestion) -> tuple[Any, ...]:
        """Whether each condition of a test holds after the last step, or the values that the conditions
        compare, in SI units.

        Raises:
            EvaluationError: An expression has no value; shows which.
        """
        try:
            values: tuple[Any, ...] = getattr(self, generated.test(test, question))()
        except (ArithmeticError, ValueError, NameError) as error:
            raise self._no_value(error) from error
        return values

    def make_action(self, choices: Sequence[int], ranges: Sequence[float]) -> Any:
        """An action of these options, by number, and these values from -1 to 1."""
        return compose_action(self.action_space, choices, ranges)

    # What the compiler prints

    def bind(self, engine: Engine) -> None:
        """Take readers from the engine."""

    def allowed(self) -> tuple[tuple[bool, ...], ...]:
        """Which options of each choice may be chosen next; all of them unless the scenario forbids some."""
        return tuple((True,) * len(part.options) for part in self.agent.choices)

    @abstractmethod
    def get_observations(self) -> Observation:
        """The observation, float32 in [-1, 1]; a copy."""

    def get_reward(self) -> float:
        """The reward of the last step: the sum of its terms."""
        return self.reward

    def is_done(self) -> tuple[bool, bool]:
        """Whether the task ended (success or failure), and whether a limit cut the episode short."""
        return self.terminated, self.truncated

    @abstractmethod
    def get_info(self) -> Info:
        """`is_success`, `ended_by` (the first ending, or the limit), all `endings` that hold, `reward_terms`
        by name."""

    @abstractmethod
    def _begin(self) -> None:
        """Draw the random values of the episode, and set the world to its initial state."""

    @abstractmethod
    def _start(self) -> None:
        """Observe the first moment of an episode."""

    @abstractmethod
    def _advance(self, action: Any) -> Any:
        """One step: act, advance the world, and observe.

        Where there are copies of the robot it is a generator, which waits where the world goes on
        (`copies.py`).
        """

    # What generated code calls

    def ranges(self, action: Any) -> list[float]:
        """The numbers of an array from the action space, each within [-1, 1].

        Raises:
            ValueError: There are more or fewer than the action has.
            FloatingPointError: One is not a number.
        """
        values = [x if -1.0 <= x <= 1.0 else clip(x) for x in action.tolist()]
        if len(values) != self._ranges:
            raise ValueError(f"{len(values)} numbers")
        return values

    def set_observation(self, *numbers: float) -> None:
        """Let the policy see these numbers, in the newest frame, as float32; a truth value is 0 or 1."""
        self._pack(self._buffer, self._width * self.newest, *numbers)

    def next_frame(self) -> None:
        """Make room for what the policy sees after this step, where it sees several steps."""
        self.newest = (self.newest + 1) % self.depth

    def seen(self) -> NDArray[np.float32]:
        """The numbers that the policy sees; a copy."""
        return self.frames.copy() if self.depth == 1 else self.frames.take(self.views[self.newest])

    def set_goal_observation(
        self, achieved: Sequence[float], desired: Sequence[float]
    ) -> tuple[list[float], list[float]]:
        """Let the policy see what is achieved and desired, and give both back as it sees them.

        Both are mapped to [-1, 1], clipped and rounded to float32, and mapped back: a reward that is
        recomputed from what was seen is then the same reward.

        Raises:
            FloatingPointError: A number is not a number.
        """
        goal = self.agent.goal
        assert goal is not None
        halves = [(high - low) / 2 for low, high in zip(goal.low, goal.high, strict=True)]
        middles = [(high + low) / 2 for low, high in zip(goal.low, goal.high, strict=True)]
        size = len(halves)
        mapped = [
            (value - middle) / half
            for value, middle, half in zip((*achieved, *desired), middles * 2, halves * 2, strict=True)
        ]
        self.goal[:] = [x if -1.0 <= x <= 1.0 else clip(x) for x in mapped]
        meant = [
            middle + half * seen
            for middle, half, seen in zip(middles * 2, halves * 2, self.goal.tolist(), strict=True)
        ]
        return meant[:size], meant[size:]

    def episode_value(self, name: str, drawn: float) -> float:
        """The value of this episode: what `options` of `reset` set, or else what was drawn."""
        value = self.episode_values[name] = self.streams.take(name, drawn)
        return value

    def vary_sensor(self, robot: str, sensor: str, fault: str, values: Sequence[float]) -> None:
        """Set the values of a sensor fault for this episode. A sensor that nothing reads has no device."""
        controller = self.controllers[robot]
        if sensor in controller.devices:
            controller.devices[sensor].vary(fault, values)

    def set_joints(
        self, robot: str, joints: Sequence[str], positions: Sequence[float], velocities: Sequence[float] = ()
    ) -> None:
        """Let joints start at positions (rad or m) and velocities (rad/s or m/s), at rest without them."""
        for joint, position, velocity in zip(
            joints, positions, velocities or (0.0,) * len(joints), strict=True
        ):
            self.engine.set_joint(robot, joint, position, velocity)

    def set_walls(self, bodies: Sequence[str], friction: float) -> None:
        """Let several bodies, such as the walls around an arena, have the same coefficient of friction."""
        for body in bodies:
            self.engine.set_parameter("lateral_friction", (body, ""), friction)

    # The end of an episode, and failures: off the fast path

    def _terminate(self, endings: Mapping[str, bool], *, success: bool = False) -> None:
        """End the task by the endings that hold; the first of them is `ended_by`."""
        self.terminated = True
        self.is_success = success
        self.endings = tuple(name for name, holds in endings.items() if holds)
        self.ended_by = self.endings[0]

    def _truncate(self, limit: str) -> None:
        """Cut the episode short at a limit."""
        self.truncated = True
        self.ended_by = limit
        self.endings = (limit,)

    def _fill_frames(self) -> None:
        """Let every frame be as the newest, which is in place 0: before an episode there was nothing else."""
        width = len(self.agent.numbers)
        self.frames.reshape(self.depth, width)[1:] = self.frames[:width]
        for stack in self.frame_stacks.values():
            stack.frames[1:] = stack.frames[0]

    def _nothing_allowed(self, choice: str) -> None:
        """Called when every option of a choice is forbidden while the episode goes on."""
        options = next(part.options for part in self.agent.choices if part.name == choice)
        names = ", ".join(option.name for option in options)
        raise EvaluationError(f"step {self.step_count}: every option of '{choice}' is forbidden: {names}")

    def _forget(self) -> None:
        self.step_count = self.timestep_count = self.newest = 0
        self.reward = self.previous_reward = self.episode_return = 0.0
        self.terminated = self.truncated = self.is_success = False
        self.ended_by = None
        self.endings = ()
        self.episode_values = {}
        self._followed_from = None

    def _refuse(self, action: Any) -> None:
        """Stands in for `_advance` while no episode runs."""
        raise UsageError(_CLOSED if self._closed else "call reset() before step()")

    def _not_finite(self) -> None:
        """Called when the reward is not finite."""
        self.engine.require_finite()
        terms = [name for name, value in self.get_info()["reward_terms"].items() if not math.isfinite(value)]
        culprit = f"the reward term '{terms[0]}'" if terms else "the sum of the reward terms"
        raise EvaluationError(f"step {self.step_count}: {culprit} is not finite")

    def _rejected(self, layout: MessageLayout, message: Any) -> MessageError:
        self.engine.require_finite()  # not every format can carry what a world that blew up gives
        return layout_error(layout, self.scenario.format, message, self.step_count)

    def _try_again(self, action: Any, error: Exception) -> None:
        """Advance by an action in a form that the fast path does not take, or raise what was wrong.

        A list, or the array without axes that a policy predicts, fails there before anything has changed.
        """
        fitting = canonical_action(self.action_space, action)
        if fitting is None:
            raise UsageError(f"action {excerpt(action)} does not fit {self.action_space}") from None
        if is_canonical(fitting, action):
            raise self._no_value(error) from error
        try:
            self._go_on(fitting)
        except (ArithmeticError, ValueError) as second:
            raise self._no_value(second) from second

    def _no_value(self, error: Exception) -> Exception:
        """An `EvaluationError` that shows the generated line, or the error itself where it is a fault of
        ours."""
        frames = [
            frame
            for frame in traceback.extract_tb(error.__traceback__)
            if frame.filename.startswith("<deepbots")
        ]
        if not frames or not isinstance(error, (ArithmeticError, ValueError, NameError)):
            return error
        self.engine.require_finite()  # a world that blew up is the engine's failure, not the expression's
        statement = generated.as_written(frames[-1].line or "")
        return EvaluationError(f"step {self.step_count}: no value for `{statement}`: {error}")

    def __reduce__(self) -> tuple[Any, ...]:
        if self.rebuild is None:
            raise UsageError("this environment was built by hand and cannot be copied to another process")
        return self.rebuild, ()


# Robot controllers


class RobotController(_WithMemories):
    """Base of the generated robot classes.

    A generated class adds `bind`, which takes its readers and writers from the engine, and the paper's
    pair: `use_message_data(message)` drives the actuators by the fields of a message, and `create_message()`
    reads the sensors into the fields of one. Channels encode and decode.
    """

    def __init__(self, spec: Robot, scenario: Program, engine: Engine) -> None:
        super().__init__(scenario.world.timestep)
        self.spec = spec
        self.devices: dict[str, Device] = {}
        self._world, self._engine = scenario.world, engine
        self.bind(engine)
        drives = [
            (actuator, getattr(self, generated.drive(actuator.name), None)) for actuator in spec.actuators
        ]
        driven = [(actuator, drive) for actuator, drive in drives if drive is not None]
        self._holds: list[Callable[[], object]] = [
            drive.hold if hasattr(drive, "hold") else partial(_hold, engine, spec.name, actuator, drive)
            for actuator, drive in driven
        ]
        self._releases = [
            drive.reset for _, drive in driven if hasattr(drive, "hold")
        ]  # actuators with a state of their own

    def bind(self, engine: Engine) -> None:
        """Take readers and writers from the engine; called once."""

    def device(self, name: str) -> Device:
        """The device behind a sensor, made when it is first asked for."""
        if name not in self.devices:
            sensor = next(sensor for sensor in self.spec.sensors if sensor.name == name)
            device = instrument(sensor, self.spec.name, self._world, self._engine)
            self.devices[name] = Device(sensor, self.spec.name, device, self._world.timestep)
        return self.devices[name]

    def actuator(self, name: str) -> CustomMotor:
        """An actuator of a plug-in's kind."""
        actuator = next(actuator for actuator in self.spec.actuators if actuator.name == name)
        assert isinstance(actuator, CustomActuator)  # generated code asks for no other
        return CustomMotor(
            Site(self._engine, self.spec.name, actuator, self._world.timestep / self._world.substeps)
        )

    def sees(self, sensor: str, body: str) -> Callable[[], bool]:
        """Whether the newest picture of a camera shows the body."""
        return sees(self.device(sensor), body)

    def begin(self, streams: Streams) -> None:
        """Begin an episode: discard earlier readings and take the first ones."""
        for device in self.devices.values():
            device.reset(streams)
        self.clear_memories()
        self.reset()

    def reset(self) -> None:
        """Begin what is computed on board with the first readings, and with actions of zeros."""

    def observe(self) -> None:
        """Sample what is sampled once per timestep."""

    def release(self) -> None:
        """Set the values of the actuators for this episode and discard their commands: they exert nothing
        until `hold`."""
        for release in self._releases:
            release()

    def hold(self) -> None:
        """Hold all driven joints in their reset state until the first command takes effect."""
        for hold in self._holds:
            hold()


def _hold(engine: Engine, robot: str, actuator: Actuator, drive: MotorWriter) -> None:
    """Keep what a plain motor drives where it is; one that commands torques lets its joints go."""
    if isinstance(actuator, Motor) and actuator.kind == "velocity_motor":
        drive((0.0,) * len(actuator.joints))
    elif isinstance(actuator, Motor) and actuator.kind == "position_motor":
        drive([state[0] for state in engine.joint_states(robot, actuator.joints)()])
