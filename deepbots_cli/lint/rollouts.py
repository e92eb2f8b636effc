"""Resets and episodes of `lint --deep`, with their measurements. They run in a process of their own
(`simulation_process`).

Every result is written at once: if an engine crashes, the last line shows how far the simulation got.
"""

from __future__ import annotations

import functools
import math
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from itertools import count, islice, repeat
from math import acos, atan2, dist, hypot, inf, radians, remainder, tau
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import api, footprint, frames
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, EngineError, EvaluationError
from deepbots_cli.frames import Triple
from deepbots_cli.lint.simulation import (
    ARENA,
    HELD_RANDOM,
    HOLD_STEPS,
    IDLE,
    MAX_SINK,
    RANDOM,
    TOPPLING_S,
    Clearance,
    End,
    Rolling,
    Rollout,
    UnreachedPose,
    casts_rays,
    driven_wheels,
    simulation_plan,
    variant_plan,
)
from deepbots_cli.port import Engine, JointReader, MotionReader, PoseReader, cast_rays
from deepbots_cli.program import Program, generated
from deepbots_cli.program.robots import Cartesian as CartesianActuator
from deepbots_cli.program.robots import Sensor
from deepbots_cli.program.task import idle_action
from deepbots_cli.program.world import ObjectBody
from deepbots_cli.robots.model import RobotModel
from deepbots_cli.rollout import Driver, Start, Step, steps
from deepbots_cli.rollout.source import Source
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.actuation import Cartesian

_ROUNDING = 1e-6
"""The difference of numbers of the observation, from -1 to 1, below which they are equal."""
_MIN_TERM_SIZE = 1e-9
"""The same for a term of the reward."""
_FIRST_EPISODES, _FIRST_STEPS = 2, 10
"""The number of episodes in which the first command of each arm is checked, and the steps within which it
must arrive."""
_VARIANTS_LABEL = "cases and stages"


class StoppedError(Exception):
    """The error that ends the plan; its reason has been written."""


def compiled(folder: Path) -> Program:
    """Compile the scenario whose files were copied into a folder."""
    return api.compile(Source.kept(folder)).program


class Simulator:
    """Carries out the plan of a scenario. `write` takes a result, `begin_step` the number of the next
    step."""

    def __init__(
        self,
        program: Program,
        write: Callable[[dict[str, Any]], None],
        begin_step: Callable[[int], None],
        permissions: Permissions,
    ) -> None:
        self._program = program
        self._write = write
        self._begin_step = begin_step
        self._permissions = permissions
        self._plan = simulation_plan(program)
        self._counters: dict[str, Counter] = {}
        self._rays = RayWatch(program)
        self._wheels = WheelWatch(program)
        self._tilts = TiltWatch(program)

    def run(self) -> None:
        """Carry out the plan, until an error stops it."""
        try:
            self._check_starts()
            with closing(self._build(self._program)) as environment:
                for seed in range(self._plan.resets if self._program.reset.settle else 0):
                    self._reset(environment, seed, report=True)
                arms = ArmWatch(environment)
                if arms.actuators:
                    self._check_first_commands(environment, arms)
                self._run_episodes(environment, self._plan.rollouts, arms)
            self._run_variants()
        except StoppedError:
            return
        self._write(
            {
                "measured": {
                    by: counter.rows_by_part()
                    for by, counter in self._counters.items()
                    if by != _VARIANTS_LABEL
                }
            }
        )
        self._write({"still": self._constant_numbers(), "silent": self._silent()})
        depths = [[*both, depth] for both, depth in self._rays.depths.items() if 0.0 < depth < inf]
        self._write(
            {
                "clearances": [[*both, *clearance] for both, clearance in self._rays.clearances.items()],
                "depths": depths,
            }
        )
        self._write({"rolling": self._wheels.robots})
        self._write({"tilts": {name: tilt for name, (_, tilt) in self._tilts.tilts.items()}})

    def _build(self, program: Program) -> Supervisor:
        self._write({"at": ["build", 0]})
        try:
            return api.build(program, permissions=self._permissions)
        except DeepbotsError as error:
            self._write({"stop": {"kind": "build", "text": str(error)}})
            raise StoppedError from None

    # Starts

    def _check_starts(self) -> None:
        """Find bodies that overlap before anything moves, thus before the world settles."""
        deepest: dict[tuple[str, str], dict[str, Any]] = {}
        program = replace(self._program, reset=replace(self._program.reset, settle=0.0))
        with closing(self._build(program)) as environment:
            for seed in range(self._plan.resets):
                self._reset(environment, seed, report=not self._program.reset.settle)
                for pair in environment.engine.overlaps():
                    deepest_here = deepest.setdefault((pair.one[0], pair.other[0]), {"depth": 0.0})
                    if pair.depth > deepest_here["depth"]:
                        deepest_here |= {
                            "one": list(pair.one),
                            "other": list(pair.other),
                            "depth": pair.depth,
                            "seed": seed,
                        }
        for overlap in deepest.values():
            self._write({"overlap": overlap})

    def _reset(self, environment: Supervisor, seed: int, *, report: bool) -> None:
        """Reset; with `report`, write whether an ending already holds."""
        self._write({"at": ["reset", seed]})
        try:
            environment.reset(seed=seed)
        except DeepbotsError as error:
            if not (isinstance(error, EvaluationError) and environment.terminated):
                raise self._stopped(environment, error) from None
            if report:
                self._write({"early": [environment.ended_by, seed]})

    def _check_first_commands(self, environment: Supervisor, arms: ArmWatch) -> None:
        """Check whether arms reach their first commanded pose. Every choice should lead to one; the end of a
        range need not."""
        by = IDLE if idle_action(self._program.agent.action) is not None else RANDOM
        if by == RANDOM and self._program.agent.ranges:
            return
        for seed in range(_FIRST_EPISODES):
            arms.is_watching = True
            self._write({"at": [by, seed]})
            try:
                for _ in self._steps(environment, Rollout(by, seed, _FIRST_STEPS)):
                    if arms.commands:
                        break
            except DeepbotsError:  # reported by the episodes that follow
                pass
            self._write_misses(arms, by, seed)

    def _write_misses(self, arms: ArmWatch, by: str, seed: int) -> None:
        arms.is_watching = False
        for miss in arms.take_misses(by, seed):
            self._write({"miss": asdict(miss)})

    # Episodes

    def _run_episodes(
        self,
        environment: Supervisor,
        rollouts: tuple[Rollout, ...],
        arms: ArmWatch | None = None,
        counted_as: str | None = None,
    ) -> None:
        for rollout in rollouts:
            done = sum(counter.steps for by, counter in self._counters.items() if by in (RANDOM, HELD_RANDOM))
            if (
                counted_as is None
                and rollout.policy in (RANDOM, HELD_RANDOM)
                and done >= self._plan.min_random_steps
            ):
                continue
            counter = self._counters.setdefault(counted_as or rollout.policy, Counter(self._program))
            self._write({"at": [rollout.policy, rollout.seed]})
            if arms is not None:
                arms.is_watching = rollout.script is not None
            try:
                self._episode(environment, rollout, counter, report=counted_as is None)
            except DeepbotsError as error:
                if (
                    isinstance(error, EvaluationError)
                    and environment.step_count == 0
                    and environment.terminated
                ):
                    continue  # reported by its reset
                raise self._stopped(environment, error) from None
            finally:
                if arms is not None:
                    self._write_misses(arms, rollout.policy, rollout.seed)

    def _episode(self, environment: Supervisor, rollout: Rollout, counter: Counter, *, report: bool) -> None:
        taken = self._steps(environment, rollout)
        next(taken)
        speeds, check_rays = SpeedWatch(environment), self._rays.watch(environment.engine)
        # A case may have another robot file, whose wheels are not those of `_wheels`.
        check_wheels = self._wheels.watch(environment.engine) if report else lambda: None
        if report:
            self._tilts.begin(environment.engine, is_idle=rollout.policy == IDLE)
        rewards: list[float] = []
        for step in taken:
            rewards.append(step.reward)
            counter.add(step.observation, step.info["reward_terms"])
            check_rays()
            check_wheels()
            self._tilts.check(step.number * environment.scenario.period)
            violation = speeds.check(step.number * environment.scenario.period)
            if speeds.new_maximum:
                self._write({"fast": speeds.new_maximum})
            if violation:
                self._write({"stop": {"kind": "speed", **violation}})
                raise StoppedError
            if not environment.observation_space.contains(step.observation):
                self._write({"stop": {"kind": "space", "entries": _outside(environment, step.observation)}})
                raise StoppedError
        self._tilts.close()
        if report:
            result = episode_result(step, rewards, self._program.agent.discount)
            self._write({"episode": {"policy": rollout.policy, "seed": rollout.seed, **result}})

    def _steps(self, environment: Supervisor, rollout: Rollout) -> Iterator[Step]:
        """Return the steps of an episode; the number of each is written before it begins."""
        actions = _actions(environment, rollout)
        numbers = count(1)

        def act(_: Any) -> Any:
            self._begin_step(next(numbers))
            return next(actions)

        return islice(steps(environment, Driver(act), Start(rollout.seed)), rollout.steps + 1)

    # Observation numbers and terms that are constant

    def _constant_numbers(self) -> list[int]:
        """Return the places of the numbers of the observation that were the same in every step of every
        episode; pictures after them."""
        whole = functools.reduce(Counter.joined, self._counters.values(), Counter(self._program))
        return [
            place
            for place in range(len(self._program.agent.numbers) + len(self._program.agent.images))
            if not whole.varies(place)
        ]

    def _silent(self) -> list[int]:
        """Return the places of the terms of the reward that were always 0."""
        places = range(len(self._program.agent.reward))
        return [
            place for place in places if not any(counter.fired[place] for counter in self._counters.values())
        ]

    def _run_variants(self) -> None:
        """Run cases and stages, which may vary values that are constant in the scenario itself."""
        own = self._program
        for program in (*(case.program for case in own.cases), *(stage.program for stage in own.curriculum)):
            if not self._constant_numbers() and not self._silent():
                return
            sizes = [
                (len(each.numbers) + len(each.images), len(each.reward))
                for each in (own.agent, program.agent)
            ]
            if sizes[0] == sizes[1]:
                with closing(self._build(program)) as environment:
                    self._run_episodes(environment, variant_plan(program), counted_as=_VARIANTS_LABEL)

    def _stopped(self, environment: Supervisor, error: DeepbotsError) -> StoppedError:
        """Write the reason why an episode stopped, and return the exception to raise."""
        entry: dict[str, Any] = {"text": str(error), "step": environment.step_count}
        lost = SpeedWatch(environment).lost()
        if lost:
            entry |= {"kind": "lost", "body": lost[0]}
        elif isinstance(error, EngineError):
            entry |= {"kind": "engine"}
        else:
            entry |= {"kind": "value", "lines": _lines(error), "terms": _infinite(environment)}
        self._write({"stop": entry})
        return StoppedError()


class Counter:
    """Statistics over the episodes of one policy, per number of the observation and per term of the
    reward."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._columns = program.agent.newest
        self._pictures = [entry.key for entry in program.agent.images]
        self._first: dict[str, NDArray[np.uint8]] = {}
        self._changed: set[str] = set()
        numbers, terms = len(program.agent.numbers), len(program.agent.reward)
        self.steps = 0
        self.rows = 0
        self.low, self.high = np.full(numbers, np.inf), np.full(numbers, -np.inf)
        self.at_low, self.at_high = np.zeros(numbers, int), np.zeros(numbers, int)
        self.sums, self.sizes, self.fired = np.zeros(terms), np.zeros(terms), np.zeros(terms, bool)
        self.least, self.greatest = np.full(terms, np.inf), np.full(terms, -np.inf)

    def add(self, observation: Any, terms: dict[str, float]) -> None:
        """Count one step; of a team there is a row for each copy."""
        self.steps += 1
        self._add_terms(np.array(list(terms.values())))
        if isinstance(observation, dict):
            for key in self._pictures:
                if (
                    key not in self._changed
                    and (observation[key] != self._first.setdefault(key, observation[key])).any()
                ):
                    self._changed.add(key)
            observation = observation.get("observation", np.zeros((1, 0)))
        for row in np.atleast_2d(observation)[:, self._columns]:
            self.rows += 1
            np.minimum(self.low, row, out=self.low)
            np.maximum(self.high, row, out=self.high)
            self.at_low += row <= -1.0
            self.at_high += row >= 1.0

    def _add_terms(self, values: NDArray[np.float64]) -> None:
        self.sums += values
        self.sizes += np.abs(values)
        self.fired |= np.abs(values) > _MIN_TERM_SIZE
        np.minimum(self.least, values, out=self.least)
        np.maximum(self.greatest, values, out=self.greatest)

    def joined(self, other: Counter) -> Counter:
        """Join the ranges of both. A number that is constant in each, but at different values, then counts as
        varying."""
        both = Counter(self._program)
        both.low, both.high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        both._changed = self._changed | other._changed
        return both

    def varies(self, place: int) -> bool:
        """Return whether an entry was not the same throughout."""
        numbers = len(self._columns)
        return (
            bool(self.high[place] - self.low[place] > _ROUNDING)
            if place < numbers
            else self._pictures[place - numbers] in self._changed
        )

    def rows_by_part(self) -> list[Any]:
        """Return steps, rows, and the statistics of numbers and terms for `simulation.PolicyStatistics`."""
        if not self.steps:
            return [0, 0, [], []]
        numbers = zip(
            *(part.tolist() for part in (self.low, self.high, self.at_low, self.at_high)), strict=True
        )
        terms = zip(
            *(part.tolist() for part in (self.sums, self.sizes, self.least, self.greatest)), strict=True
        )
        return [self.steps, self.rows, list(numbers), list(terms)]


def episode_result(
    last: Step, rewards: Sequence[float] | NDArray[np.float64], discount: float
) -> dict[str, Any]:
    """Return the result of an episode in a report, from its last step and the reward of each step."""
    end: End = "limit" if last.truncated else "left"
    if last.terminated or last.info["is_success"]:
        end = "success" if last.info["is_success"] else "failure"
    discounted = float(np.dot(rewards, discount ** np.arange(len(rewards))))
    return {"steps": len(rewards), "discounted_return": discounted, "end": end}


def _actions(environment: Supervisor, rollout: Rollout) -> Iterator[Any]:
    """Return an endless sequence of actions, none of them forbidden."""
    if rollout.script is not None:
        return (environment.script(rollout.script) for _ in count())
    if rollout.policy == IDLE:
        wanted = idle_action(environment.scenario.agent.action)
        assert wanted is not None  # the plan has only episodes with an action
        return repeat(environment.make_action(*wanted))
    return _random(environment, HOLD_STEPS if rollout.policy == HELD_RANDOM else 1)


def _random(environment: Supervisor, hold: int) -> Iterator[Any]:
    agent = environment.scenario.agent
    masked = agent.copies is None and any(
        option.forbidden for part in agent.action for option in getattr(part, "options", ())
    )
    for number in count():
        if number % hold == 0 or masked:
            action = (
                environment.action_space.sample(environment.action_mask())
                if masked
                else environment.action_space.sample()
            )
        yield action


def _outside(environment: Supervisor, observation: Any) -> list[str]:
    """Return the numbers of an observation that are outside of its space, by name."""
    numbers = np.atleast_2d(observation["observation"] if isinstance(observation, dict) else observation)
    return [
        entry.name
        for entry, column in zip(environment.scenario.agent.inputs, numbers.T, strict=True)
        if not np.isfinite(column).all() or (entry.clipped and (np.abs(column) > 1.0).any())
    ]


def _infinite(environment: Supervisor) -> list[str]:
    if not environment.step_count:
        return []
    return [
        name for name, value in environment.get_info()["reward_terms"].items() if not math.isfinite(value)
    ]


def _lines(error: BaseException) -> list[str]:
    """Return the lines of the generated module in which an expression had no value, the innermost first."""
    raised = [error.__cause__, error] if error.__cause__ else [error]
    frames = [frame for each in raised for frame in reversed(traceback.extract_tb(each.__traceback__))]
    return [frame.line or "" for frame in frames if frame.filename.startswith("<deepbots")]


_MAX_SPEED = 300.0
"""The largest plausible speed, in m/s; near the speed of sound. A falling body may become faster."""
_HALF_TURN = math.pi
"""Half a turn, in rad in one physics step; beyond it, an engine cannot determine the direction of a turn."""
_MAX_SPIN = 1000.0
"""The rotation, in rad/s, below which turns are plausible, however long the physics step."""
_MIN_SPEED_GROWTH = 4.0


class _WatchedBody(NamedTuple):
    body: str
    motion: MotionReader
    joints: tuple[str, ...]
    revolute: tuple[bool, ...]
    states: JointReader | None


class SpeedWatch:
    """Checks the speeds of robots and of movable objects. `new_maximum` is the fastest body, when its speed
    has grown a lot."""

    def __init__(self, environment: Supervisor) -> None:
        world, engine = environment.world, environment.engine
        self._substep = world.timestep / world.substeps
        self._fall = math.hypot(*engine.gravity)
        self._watched = []
        for robot in world.robots:
            moving = robot.model.moving_joints
            names = tuple(joint.name for joint in moving)
            reader = engine.joint_states(robot.name, names) if names else None
            turns = tuple(joint.type != "prismatic" for joint in moving)
            self._watched.append(_WatchedBody(robot.name, engine.motion(robot.name), names, turns, reader))
        self._watched += [
            _WatchedBody(thing.name, engine.motion(thing.name), (), (), None)
            for thing in world.objects
            if not thing.fixed
        ]
        self._fastest = 1.0
        self.new_maximum: list[Any] = []

    def check(self, time: float) -> dict[str, Any]:
        """Return the first implausible speed after `time` seconds; empty if there is none."""
        self.new_maximum = []
        for watched in self._watched:
            velocity, spin = (math.hypot(*part) for part in watched.motion()[1])
            if not math.isfinite(velocity + spin):
                return {"body": watched.body, "what": "nan"}
            if velocity > self._fastest * _MIN_SPEED_GROWTH:
                self._fastest, self.new_maximum = velocity, [watched.body, velocity]
            if velocity > _MAX_SPEED + self._fall * time:
                return {"body": watched.body, "what": "velocity", "value": velocity}
            if spin > _MAX_SPIN and spin * self._substep > _HALF_TURN:
                return {"body": watched.body, "what": "spin", "value": spin}
            speed = self._joint(watched)
            if speed:
                return speed
        return {}

    def _joint(self, watched: _WatchedBody) -> dict[str, Any]:
        states: Sequence[Sequence[float]] = watched.states() if watched.states else ()
        for name, turns, state in zip(watched.joints, watched.revolute, states, strict=True):
            speed = abs(state[1])
            if not math.isfinite(state[0] + speed):
                return {"body": watched.body, "joint": name, "what": "nan"}
            if speed > (max(_MAX_SPIN, _HALF_TURN / self._substep) if turns else _MAX_SPEED):
                return {"body": watched.body, "joint": name, "what": "joint", "value": speed}
        return {}

    def lost(self) -> list[str]:
        """Return the bodies whose motion is no longer a number."""
        return [
            watched.body
            for watched in self._watched
            if not math.isfinite(sum(map(sum, (*watched.motion()[0], *watched.motion()[1]))))
        ]


class WheelWatch:
    """Measures the motion of robots on driven wheels. `robots` maps each to its largest motion so far; it is
    empty for teams."""

    def __init__(self, scenario: Program) -> None:
        models = {
            body.name: body.model
            for body in scenario.world.robots
            if not body.fixed_base and scenario.agent.copies is None
        }
        self._wheels = {
            robot.name: driven_wheels(robot, models[robot.name])
            for robot in scenario.robots
            if robot.name in models
        }
        self.robots = {name: Rolling(0.0, 0.0, 0.0) for name, wheels in self._wheels.items() if wheels}

    def watch(self, engine: Engine) -> Callable[[], None]:
        """Return a function that compares with the present state of an engine, to be called in each step."""
        checks = [self._watched(engine, robot) for robot in self.robots]

        def check() -> None:
            for each in checks:
                each()

        return check

    def _watched(self, engine: Engine, robot: str) -> Callable[[], None]:
        pose, states = engine.pose(robot), engine.joint_states(robot, self._wheels[robot])
        (x, y, _), attitude = pose()
        heading, positions = frames.roll_pitch_yaw(attitude)[2], [state[0] for state in states()]

        def check() -> None:
            place, attitude = pose()
            turn = abs(remainder(frames.roll_pitch_yaw(attitude)[2] - heading, tau))
            wheel = max(abs(state[0] - before) for state, before in zip(states(), positions, strict=True))
            rolling = self.robots[robot]
            self.robots[robot] = Rolling(
                max(rolling.distance, hypot(place[0] - x, place[1] - y)),
                max(rolling.turn, turn),
                max(rolling.wheel, wheel),
            )

        return check


class TiltWatch:
    """Measures how far robots with a free base tilt while no action moves them. Teams are not watched.

    `tilts` maps each to the time (s) for which it was watched, and to how far it tilted (rad) from its
    attitude at the reset. Both are taken from the episode with the smallest tilt, among the longest ones: an
    episode counts for `TOPPLING_S` at most.
    """

    def __init__(self, scenario: Program) -> None:
        is_free = {body.name: not body.fixed_base for body in scenario.world.robots}
        robots = [robot for robot in scenario.robots if is_free[robot.name] and scenario.agent.copies is None]
        self._robots = {robot.name: bool(robot.variables or robot.receive) for robot in robots}
        """Whether the action moves each robot."""
        self.tilts: dict[str, tuple[float, float]] = {}
        self._watched: dict[str, tuple[PoseReader, Triple]] = {}
        """The pose of each robot, and the direction of up in its frame at the reset."""
        self._time = 0.0
        self._now: dict[str, float] = {}

    def begin(self, engine: Engine, *, is_idle: bool) -> None:
        """Watch an episode from its present state on."""
        poses = {
            name: engine.pose(name) for name, is_moved in self._robots.items() if is_idle or not is_moved
        }
        self._watched = {
            name: (pose, frames.rotate_back(pose()[1], (0.0, 0.0, 1.0))) for name, pose in poses.items()
        }
        self._now = dict.fromkeys(poses, 0.0)

    def check(self, time: float) -> None:
        """Compare with the state after a step, which ended so long (s) after the reset."""
        if time > TOPPLING_S:
            return
        self._time = time
        for name, (pose, upward) in self._watched.items():
            tilt = acos(max(-1.0, min(1.0, frames.rotate(pose()[1], upward)[2])))
            self._now[name] = max(self._now[name], tilt)

    def close(self) -> None:
        """End the episode."""
        for name, tilt in self._now.items():
            longest, smallest = self.tilts.get(name, (0.0, inf))
            if self._time == longest:
                tilt = min(tilt, smallest)
            if self._time >= longest:
                self.tilts[name] = self._time, tilt
        self._watched, self._now, self._time = {}, {}, 0.0


_DISTANCE = 0.005  # m
_ANGLE = radians(1.0)
"""The tolerance of the angle of a pose, in rad. A search that succeeds ends within 0.1 um."""
_LARGE_TURN = radians(90.0)
_MAX_TURNING_DISTANCE_M = 0.2
"""The distance (m) beyond which the start of an arm, such as stretched out, makes it turn on its way."""
_LIMIT_TOLERANCE = 1e-6  # rad or m; the search clips positions to the limits exactly


class ArmWatch:
    """Watches the commands to the `cartesian` actuators of an environment."""

    def __init__(self, environment: Supervisor) -> None:
        self.is_watching = False
        self.commands: dict[tuple[str, str], int] = {}
        """The number of commands since the last `take_misses`, by robot and actuator."""
        self._misses: dict[tuple[str, str], UnreachedPose] = {}
        self.actuators = [arm for world in environment.agents.values() for arm in self._watched(world)]

    def _watched(self, world: Supervisor) -> Iterator[str]:
        """Watch the commands of a supervisor; yields the names of the actuators."""
        models = {body.name: body.model for body in world.scenario.world.robots}
        for robot in world.scenario.robots:
            for actuator in robot.actuators:
                drive = getattr(world.controllers[robot.name], generated.drive(actuator.name), None)
                if isinstance(actuator, CartesianActuator) and isinstance(drive, Cartesian):
                    drive.watch = partial(self._check, world, robot.name, models[robot.name], actuator, drive)
                    yield actuator.name

    def take_misses(self, by: str, seed: int) -> list[UnreachedPose]:
        """Return the first miss of each actuator since the last call; later misses start from where it
        brought the arm."""
        misses = [
            replace(miss, policy=by, seed=seed, commands=self.commands[key])
            for key, miss in self._misses.items()
        ]
        self.commands.clear()
        self._misses.clear()
        return misses

    def _check(
        self,
        world: Supervisor,
        robot: str,
        model: RobotModel,
        actuator: CartesianActuator,
        drive: Cartesian,
        target: Triple,
        solution: Sequence[float],
    ) -> None:
        if not self.is_watching:
            return
        key = (robot, actuator.name)
        self.commands[key] = self.commands.get(key, 0) + 1
        positions = dict(zip(actuator.joints, solution, strict=True))
        others = [
            joint.name
            for joint in model.moving_joints
            if joint.name not in positions and joint.name not in model.followers
        ]
        now = (
            {
                name: state[0]
                for name, state in zip(others, world.engine.joint_states(robot, others)(), strict=True)
            }
            if others
            else {}
        )
        place, turned = frames.compose(
            world.engine.pose(robot)(), footprint.link_frames(model, now | positions)[actuator.link]
        )
        distance = dist(place, target)
        angle = (
            0.0 if drive.attitude is None else _angle(frames.multiply(drive.attitude, frames.inverse(turned)))
        )
        if distance <= _DISTANCE and angle <= _ANGLE:
            self._check_turn(world, key, actuator, drive, target)
            return
        if key not in self._misses:
            limits = {name: model.joint(name).limit for name in positions}
            ends = {
                name: [end for end in (limit.lower, limit.upper) if end is not None]
                for name, limit in limits.items()
            }
            at_limit = {
                name: end
                for name, limit_ends in ends.items()
                for end in limit_ends
                if abs(positions[name] - end) < _LIMIT_TOLERANCE
            }
            self._misses[key] = UnreachedPose(
                robot, actuator.name, distance, angle, at_limit, step=world.step_count
            )
        self._misses[key] = replace(
            self._misses[key], unreached_commands=self._misses[key].unreached_commands + 1
        )

    def _check_turn(
        self,
        world: Supervisor,
        key: tuple[str, str],
        actuator: CartesianActuator,
        drive: Cartesian,
        target: Triple,
    ) -> None:
        """Check whether the first command of an episode turns a link in place."""
        if drive.attitude is None or self.commands[key] > 1 or key in self._misses:
            return
        place, attitude = world.engine.pose(key[0], actuator.link)()
        turn = _angle(frames.multiply(drive.attitude, frames.inverse(attitude)))
        if turn > _LARGE_TURN and dist(place, target) < _MAX_TURNING_DISTANCE_M:
            start = frames.roll_pitch_yaw(attitude)
            self._misses[key] = UnreachedPose(
                *key, 0.0, 0.0, {}, turn=turn, start=start, step=world.step_count
            )


def _angle(q: frames.Quaternion) -> float:
    """Return the angle of a rotation, rad from 0 to half a turn."""
    return 2.0 * atan2(hypot(q[0], q[1], q[2]), abs(q[3]))


class RayWatch:
    """Finds sensors whose rays have met nothing so far, because they pass above all solid bodies or begin
    below the ground.

    `clearances` maps robot and sensor to where their rays pass, `depths` to the smallest depth (m) at which
    they began; both are empty for teams and above terrain.
    """

    def __init__(self, scenario: Program) -> None:
        self._world = scenario.world
        is_asked = scenario.world.terrain is None and scenario.agent.copies is None
        asked = [
            (robot.name, sensor)
            for robot in scenario.robots
            for sensor in robot.sensors
            if is_asked and casts_rays(sensor)
        ]
        self._sensors = {(robot, sensor.name): sensor for robot, sensor in asked}
        self.clearances: dict[tuple[str, str], Clearance] = dict.fromkeys(
            self._sensors, Clearance(inf, -inf, "")
        )
        self.depths: dict[tuple[str, str], float] = dict.fromkeys(
            self._sensors if scenario.world.ground is not None else (), inf
        )

    def watch(self, engine: Engine) -> Callable[[], None]:
        """Return a function that checks the world of an engine, to be called in each step."""
        if not self.clearances and not self.depths:
            return lambda: None
        tops = {thing.name: _top_of(engine, thing) for thing in self._world.objects if thing.solid}
        tops |= {
            body.name: _top_of_robot(engine, body.name, footprint.robot_bounds(body.model))
            for body in self._world.robots
        }
        if self._world.arena is not None:
            wall = self._world.arena.wall_height
            tops[ARENA] = lambda: wall
        heights = {
            both: _ray_heights(engine, both[0], self._sensors[both])
            for both in self.clearances.keys() | self.depths.keys()
        }

        def check() -> None:
            top_heights = [(top(), name) for name, top in tops.items()] if self.clearances else []
            for both in [both for both in self._sensors if both in self.clearances or both in self.depths]:
                highest = max((top for top in top_heights if top[1] != both[0]), default=(inf, ""))
                low, begin = heights[both]()
                if both in self.clearances and low > highest[0] + MAX_SINK:
                    before = self.clearances[both]
                    self.clearances[both] = Clearance(
                        min(low, before.lowest), *max(highest, (before.top, before.tallest))
                    )
                else:
                    self.clearances.pop(both, None)
                if both in self.depths and begin < -MAX_SINK:
                    self.depths[both] = min(self.depths[both], -begin)
                else:
                    self.depths.pop(both, None)

        return check


def _top_of(engine: Engine, thing: ObjectBody) -> Callable[[], float]:
    shapes = [variant.shape for variant in thing.variants] or [thing.shape]
    pose = engine.pose(thing.name)
    return lambda: max(footprint.bounds_of_shape(shape, pose())[1][2] for shape in shapes)


def _top_of_robot(engine: Engine, name: str, box: footprint.Bounds) -> Callable[[], float]:
    """Return a reader of an upper bound of the height in any attitude of the root, m."""
    pose, reach = engine.pose(name), hypot(*(max(-low, high) for low, high in zip(*box, strict=True)))
    return lambda: pose()[0][2] + reach


def _ray_heights(engine: Engine, robot: str, sensor: Sensor) -> Callable[[], tuple[float, float]]:
    """Return a reader of the lowest point of any ray within its range, and the highest at which one begins,
    in m; (-inf, inf) while a ray meets something."""
    assert sensor.beams is not None  # only sensors with rays are watched
    mount, reach, part = frames.frame(sensor.mount), sensor.beams.reach, (robot, sensor.subjects[0])
    rays = [frames.compose(mount, frames.frame(ray)) for ray in sensor.beams.rays]
    begins = [ray[0] for ray in rays]
    ends = [*begins, *(frames.compose(ray, ((reach, 0.0, 0.0), frames.IDENTITY_ROTATION))[0] for ray in rays)]
    upright = sensor.beams.upright
    pose, cast = engine.pose(*part), cast_rays(engine, part, rays, reach, upright=upright)

    def measured() -> tuple[float, float]:
        (_, _, height), turn = pose()
        turn = frames.leveled(turn) if upright else turn
        if min(cast()) < reach:
            return -inf, inf
        return height + min(frames.rotate(turn, end)[2] for end in ends), height + max(
            frames.rotate(turn, begin)[2] for begin in begins
        )

    return measured
