"""Episodes to show: the opened scenario or run, the driver, and the frames of an episode step by step; of
one world, or of a batch.

All worlds of a batch are stepped together on arrays, and one at a time is read and shown.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector.utils import batch_space

from deepbots_cli import api
from deepbots_cli.diagnostics import Finding
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import EngineError, MissingExtraError, RunError, ScenarioError, UsageError
from deepbots_cli.expressions.types import referenced_names
from deepbots_cli.files import Stamps, file_stamps, recorded_reads
from deepbots_cli.learning.runs.episodes import read_log_tail
from deepbots_cli.learning.runs.run import ModelName, ModelRef, Run, RunRecord, steps_of
from deepbots_cli.port import View
from deepbots_cli.program import RANDOM, ZERO, Program, identity
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Driver, Start, Step, steps
from deepbots_cli.rollout.drivers import (
    HAND,
    POLICY,
    POLICY_OF,
    RECORDED,
    ROBOT,
    action_from_values,
    named_driver,
)
from deepbots_cli.rollout.recordings import Recording, RobotLog, is_robot_log
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.rollout.worlds import BatchEpisodes
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.batch import BatchSupervisor
from deepbots_cli.runtime.batch_parts import BatchChannel, columns_array
from deepbots_cli.runtime.paths import Ways
from deepbots_cli.runtime.spaces import apply_to_parts, joined
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.scenario.quantities import Quantity
from deepbots_cli.view.frames import (
    AgentFrame,
    FrameReader,
    ReceivedMessage,
    WorldFrame,
    recorded_channels,
    successful_agents,
    value_of_row,
)

SHOWN_KINDS = (SourceKind.SCENARIO, SourceKind.RUN, SourceKind.CHECKPOINT, SourceKind.RECORDING)
_TAIL_BYTES = 20_000  # bytes at the end of a log that contain its last episode


@dataclass(frozen=True)
class Showing:
    """A scenario, a run or a recording to show, with the options for showing it."""

    reference: str
    overrides: Sequence[str] = ()
    permissions: Permissions = Permissions()
    engine: str | None = None
    case: str | None = None
    stage: str | None = None
    worlds: int = 0
    """The number of worlds of a batch; 0 for a single world."""
    start: Mapping[str, Any] = field(default_factory=dict, hash=False)
    """The `options` of every reset."""
    model: ModelName = "best"
    """The model that acts for a run that has ended; while a run is trained, the newest one acts."""
    is_model_named: bool = False
    """Whether `model` acts always, as it does if `reference` is its file."""
    deterministic: bool = True
    """Whether the policy takes its likeliest action, or samples."""

    def open(self) -> ShowingState:
        """Compile the source; findings are returned and not raised.

        Raises:
            UsageError: There is no such file, run, case or stage.
        """
        source = Source.open(self.reference, self.permissions, *SHOWN_KINDS)
        if source.kind is SourceKind.RECORDING:
            return self._open_recording(source.path, is_log=is_robot_log(source.path))
        with recorded_reads() as files:
            state = self._open_scenario(source)
        return replace(state, files=files if state.run is None else {})

    def _open_scenario(self, source: Source) -> ShowingState:
        run = None
        showing = self
        overrides = self.overrides
        if source.kind in (SourceKind.RUN, SourceKind.CHECKPOINT):
            ref = ModelRef.open(source, model=self.model)
            run = ref.run
            showing = replace(self, model=ref.name, is_model_named=self.is_model_named or ref.is_named)
        else:
            overrides = with_engine(overrides, self.engine)
        checked = source.checked(overrides=overrides)
        try:
            compiled = api.compile(checked)
        except ScenarioError as error:
            return ShowingState(None, error.findings, {}, showing, run)
        parameters = (
            {name: str(value) for name, value in checked.spec.parameters.items()} if checked.spec else {}
        )
        whole = frozenset(
            name
            for reading in (checked.namespace.values.readings if checked.namespace else ())
            if isinstance(reading.text.kind, Quantity) and reading.text.kind.whole
            for tree in reading.trees
            for name in referenced_names(tree)
        )
        variant = compiled.program.variant(self.case, self.stage)
        if run is not None and run.program.members and variant.others is not None:
            run = run.of_agent(variant.others.agent)
        return ShowingState(
            variant,
            compiled.findings,
            {},
            showing,
            run,
            compiled=compiled,
            parameters=parameters,
            whole_parameters=whole,
        )

    def _open_recording(self, path: Path, *, is_log: bool) -> ShowingState:
        if self.overrides or self.case or self.stage or self.engine or self.worlds or self.start:
            raise UsageError(
                "a recording already contains its scenario, case, stage, engine and start; "
                "leave out --set, --case, --stage, --engine, --worlds and --start"
            )
        recording = RobotLog.read(path) if is_log else Recording.read(path)
        compiled = api.compile(Source.kept(recording.folder, self.permissions))
        metadata = recording.metadata
        showing = replace(
            self,
            engine=metadata.get("engine") or None,
            case=metadata.get("case") or None,
            stage=metadata.get("stage") or None,
        )
        return ShowingState(
            compiled.program.variant(showing.case, showing.stage),
            (),
            {},
            showing,
            recording=recording,
            compiled=compiled,
        )


@dataclass(frozen=True, eq=False)
class ShowingState:
    """The present state of the shown source.

    `program` is None if `findings` have the level error; `files` are the files that were read, none for a
    run, whose copies nobody edits.
    """

    program: Program | None
    findings: Sequence[Finding]
    files: Stamps
    shown: Showing
    run: Run | None = None
    recording: Any = None
    compiled: api.Compiled | None = None
    parameters: Mapping[str, str] = field(default_factory=dict)
    """The parameters of a scenario as they are written."""
    whole_parameters: frozenset[str] = frozenset()
    """Those of numbers that have to be whole, such as a `count`."""

    @property
    def drivers(self) -> tuple[str, ...]:
        """The possible drivers, the default first."""
        if isinstance(self.recording, RobotLog):
            return (ROBOT,)
        if self.recording is not None:
            return (RECORDED,)
        scripts = (
            [script.name for script in self.program.agent.scripts]
            if self.program and not self.shown.worlds
            else []
        )
        return (*([POLICY] if self.run else []), *scripts, RANDOM, ZERO, HAND)

    def checked(self) -> api.Compiled:
        """Return the compiled scenario.

        Raises:
            ScenarioError: It has errors.
        """
        if self.compiled is None:
            raise ScenarioError(self.findings)
        return self.compiled


_LONG_S = 10.0
"""The time from which an episode is so long that a newer policy does not wait for the next one."""
_LOOK_ACTS = 25


class RunDriver(Driver):
    """The policy of a run, which acts as in an evaluation; while the run is trained, the first one as soon as
    there is one, and then the newest one of each episode, in a long episode also from then on."""

    def __init__(
        self,
        run: Run,
        env: Supervisor,
        batch: BatchSupervisor | None = None,
        *,
        model: ModelName = "best",
        is_model_named: bool = False,
        deterministic: bool = True,
    ) -> None:
        """Load the policy; if `is_model_named`, no other model of the run acts. In a `batch`, one forward
        pass acts in all worlds."""
        try:
            from deepbots_cli.learning.policy import load_model
            from deepbots_cli.rollout.policies import PolicyDriver
        except ModuleNotFoundError as error:
            raise MissingExtraError("train", "showing the policy of a run") from error
        if differences := identity.differences(run.program, env.scenario):
            raise RunError(
                f"the policy of {run.path} does not fit the changed scenario:\n  " + "\n  ".join(differences)
            )
        self._load = load_model
        self._driver = PolicyDriver
        self._steps_of = steps_of
        self._run = run
        self._env = env
        self._batch = batch
        self._models = (
            (model,) if is_model_named else (model, *{"best": ("last",), "last": ("best",)}.get(model, ()))
        )
        self._deterministic = deterministic
        self._policy: Driver | None = None
        self._stamp: tuple[int, int] | None = None
        self.begin(Start())

    def begin(self, start: Start) -> None:
        self._start, self._acts = start, 0
        running = RunRecord.read(self._run.path).state(self._run.path) == "training"
        stamps = self._stamps()
        name = next(
            iter(stamps if not running else sorted(stamps, key=stamps.__getitem__, reverse=True)), None
        )
        if name is not None and stamps[name] != self._stamp:
            model = self._load(self._run, name, self._env)
            acting = self._driver(model, self._env, batch=self._batch, deterministic=self._deterministic)
            self._policy = acting
            self._stamp = stamps[name]
            self.note = (
                f"policy after {self._steps_of(self._run.model(name)):,} steps{self._stage()}"
                if running
                else ""
            )
        if self._policy is not None:
            self._policy.begin(start)
        elif running:
            self._space = (
                batch_space(self._batch.action_space, self._batch.count)
                if self._batch
                else self._env.action_space
            )
            self.note = "the training has saved no policy yet: random actions"
        else:
            raise RunError(f"{self._run.path} has no model yet; continue its training, or show its scenario")

    def _stamps(self) -> dict[ModelName, tuple[int, int]]:
        """Return the stamp of each model that has been saved."""
        stamps = {name: file_stamps([path := self._run.model(name)])[path] for name in self._models}
        return {name: stamp for name, stamp in stamps.items() if stamp is not None}

    def _stage(self) -> str:
        """Return a text about the stage of the curriculum of the training, according to its newest
        episodes."""
        rows = read_log_tail(self._run.monitor, _TAIL_BYTES)
        return f", the training is in stage {rows[-1]['stage']}" if rows and rows[-1].get("stage") else ""

    def act(self, observation: Any) -> Any:
        self._acts += 1
        # An episode may last minutes: random actions, and those of the first policy, end with the next one.
        is_long = self._acts % _LOOK_ACTS == 0 and self._acts * self._env.scenario.period > _LONG_S
        if self._policy is None or (self.note and is_long):
            stamps = self._stamps().values()
            if stamps and (self._stamp is None or max(stamps) > self._stamp):
                self.begin(self._start)
        return self._space.sample() if self._policy is None else self._policy.act(observation)


class Player:
    """An environment, its driver, and its newest frame.

    Episode k of a seed has the start of episode k of an evaluation with this seed.
    """

    world, worlds = 0, 1
    """The world that is shown, and the number of worlds."""

    def __init__(self, opened: ShowingState, driver: str | None = None) -> None:
        """Make the environment and begin nothing.

        Raises:
            ScenarioError, EngineError, UsageError: As for `api.make`, or there is no such driver.
        """
        if opened.program is None:
            raise ScenarioError(opened.findings)
        self.opened = opened
        self.env = self._make(opened.program)
        self.program = self.env.scenario
        self.manual_values: Mapping[str, float] = {}
        """The commands of a person, in the format of `action_from_values`."""
        self.driver = self.make_driver(self.env, HAND)
        self.observation: Any = None
        self.action: Any = None
        """The result and the action of the last step of the environment."""
        self.actions: list[Any] = []
        """The actions of the episode."""
        self._steps: Iterator[Step] = iter(())
        self._by_hand = False
        try:
            self.reader = self.make_reader()
            self.set_driver(driver or opened.drivers[0])
        except BaseException:
            self.close()
            raise

    def _make(self, program: Program) -> Supervisor:
        run, showing = self.opened.run, self.opened.shown
        return api.build(
            program,
            engine=showing.engine or (run.engine_for(program) if run else None),
            permissions=showing.permissions,
        )

    def make_reader(self) -> FrameReader:
        """Return the reader of the shown world."""
        return FrameReader(self.env, self.opened.checked().units)

    def set_driver(self, name: str) -> None:
        """Set the driver that acts from the next step on.

        Raises:
            UsageError: There is no such script, or no policy that fits.
        """
        run = self.opened.run if name == POLICY else None
        if name.startswith(POLICY_OF):
            run = Run.open(
                Source.open(name.removeprefix(POLICY_OF), self.opened.shown.permissions, SourceKind.RUN)
            )
        self.driver = self.make_driver(self.env, name) if run is None else self.run_driver(run)
        self.driver_name = name

    def run_driver(self, run: Run, batch: BatchSupervisor | None = None) -> RunDriver:
        """Return the policy of a run as driver of the world, or of a batch."""
        showing = self.opened.shown
        return RunDriver(
            run,
            self.env,
            batch,
            model=showing.model,
            is_model_named=showing.is_model_named and run is self.opened.run,
            deterministic=showing.deterministic,
        )

    def make_driver(self, env: Supervisor, name: str) -> Driver:
        """Return a driver without a policy; that of a person takes `manual_values`."""
        return (
            Driver(lambda _: action_from_values(env, self.manual_values))
            if name == HAND
            else named_driver(env, name)
        )

    def begin(self, seed: int, episode: int) -> WorldFrame:
        """Reset to an episode. Returns its first frame."""
        return self.start(Start.of_evaluation(seed, episode, self.opened.shown.start))

    def start(self, start: Start) -> WorldFrame:
        """Reset to an episode. Returns its first frame."""
        self.seed = start.seed or 0
        self.actions = []
        self.driver.begin(start)
        self._steps = steps(self.env, Driver(self._act), start)
        return self._next_frame()

    def _act(self, observation: Any) -> Any:
        return (
            action_from_values(self.env, self.manual_values)
            if self._by_hand
            else self.driver.act(observation)
        )

    def _next_frame(self) -> WorldFrame:
        step = next(self._steps)
        self.observation, self.action = step.observation, step.action
        self.frame = self.reader.read(step.observation, step.action)
        return self.frame

    def next_episode(self, episode: int) -> int:
        """Return the number of the next episode."""
        return episode + 1

    def step(self, *, by_hand: bool = False) -> WorldFrame:
        """Make the next step of an episode that has not ended, and return its frame. With `by_hand`, a person
        acts instead of the driver."""
        self._by_hand = by_hand
        frame = self._next_frame()
        self.actions.append(self.action)
        return frame

    @property
    def note(self) -> str:
        """A note for the user: on the driver, and on a run that was trained with other physics."""
        notes = self.opened.run.notes_on_physics() if self.opened.run else []
        return "; ".join(filter(None, (self.driver.note, *notes)))

    def view(self, width: int, height: int) -> View:
        """Return the view of the whole scene, or the one that follows the robot."""
        return self.env.view(width, height)

    def render(self, view: View) -> Any:
        """Return a picture of the world in the newest frame: uint8 (height, width, 3).

        Raises:
            EngineError: The engine cannot draw.
        """
        engine = self.env.engine
        if "rendering" not in engine.capabilities:
            raise EngineError(
                f"the engine '{engine.name}' cannot draw, because this machine has no OpenGL; install EGL"
                " (`libegl1` of Debian), use the engine 'pybullet' for pictures, or write an offline page"
                " (.html)"
            )
        return engine.render(view)

    def shortest_paths(self) -> list[list[tuple[float, float]]]:
        """Return the shortest paths (points in m) whose lengths the scenario reads with `path_distance`."""
        planners = (getattr(agent, "ways", None) for agent in self.env.agents.values())
        return [points for ways in planners if isinstance(ways, Ways) for points in ways.last_read_paths()]

    def episode(self, seed: int, episode: int, steps: int | None = None) -> Iterator[WorldFrame]:
        """Yield the frames of an episode, at most those of `steps` steps."""
        yield self.begin(seed, episode)
        while self.frame.ended_by is None and (steps is None or self.frame.step < steps):
            yield self.step()

    def close(self) -> None:
        self.env.close()


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
        self._recorders = [
            recorder
            for world in self.batch.singles
            for _, (_, recorder) in recorded_channels(world, self.opened.checked().units)
        ]
        """All worlds keep their messages, because each may be shown later."""
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
        self._frames: dict[int, WorldFrame] = {}
        """The newest frames that were read; those of ended worlds stay."""
        self._rewards = np.zeros(self.batch.count)
        self._terms = np.zeros((len(self.batch.TERMS), self.batch.count))
        self.action = None
        self.driver.begin(Start())
        self._turn_to(self.world)
        for recorder in self._recorders:
            recorder.forget()
        self.observation = self.batch.reset(self._seeds, dict(self.opened.shown.start))
        return self._read()

    def next_episode(self, episode: int) -> int:
        return episode + self.worlds

    def step(self, *, by_hand: bool = False) -> WorldFrame:
        last_action = self.action
        if by_hand:
            self.action = self.batch.rows.by_row(
                joined([action_from_values(self.env, self.manual_values)] * self.worlds)
            )
        else:
            self.action = self.driver.act(self.observation)
        acting = (~self._running.resting).repeat(self.batch.copies)
        if not acting.all():  # a world that has ended shows its last action
            self.action = apply_to_parts(
                lambda new, last: np.where(acting.reshape(-1, *[1] * (new.ndim - 1)), new, last),
                self.action,
                last_action,
            )
        outcome = self._running.step_all(self.action)
        self._rewards[acting] = outcome.rewards[acting]
        self._terms[:, acting] = outcome.terms[:, acting]
        self.observation = outcome.observations
        outcome = self.batch.rows.step_by_world(outcome)
        self._running.resting[outcome.done] = True
        self._frames = {world: frame for world, frame in self._frames.items() if world in self._endings}
        shown = self.world
        for world, info in zip(outcome.done.tolist(), outcome.infos, strict=True):
            self._endings[world] = {
                "ended_by": info["ended_by"],
                "is_success": info["is_success"],
                "truncated": bool(outcome.truncated[world]),
                "succeeded": successful_agents(self.program, info["endings"], info.get("agent_endings", {})),
            }
            self.choose(world)  # its messages go on in further steps
        return self.choose(shown)

    @property
    def note(self) -> str:
        """The number of running worlds, and how others have ended."""
        running = self.worlds - len(self._endings)
        ended = Counter(str(ending["ended_by"]) for ending in self._endings.values())
        counts = [f"running {running}"] * (running > 0) + [
            f"{name} {count}" for name, count in ended.most_common()
        ]
        notes = (f"world {self.world} of {self.worlds} ({', '.join(counts)})", super().note)
        return "; ".join(filter(None, notes))

    def close(self) -> None:
        self.batch.close()

    def _read(self) -> WorldFrame:
        """Read the frame of the world: its poses, rays and contacts, and the columns of the batch. A second
        reading would lack its messages."""
        batch, world = self.batch, self.world
        if world in self._frames:
            self.frame = self._frames[world]
            return self.frame
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
        self.frame = self._frames[world] = frame
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
