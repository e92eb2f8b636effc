"""Episodes to show: what is opened (a scenario or a run), who acts, and the frames of an episode step by
step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gymnasium.vector.utils import batch_space

from deepbots_cli import api
from deepbots_cli.diagnostics import Finding
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import EngineError, MissingExtraError, RunError, ScenarioError, UsageError
from deepbots_cli.files import file_stamps
from deepbots_cli.learning.episodes import read_log_tail
from deepbots_cli.learning.records import RunRecord
from deepbots_cli.learning.run import ModelName, ModelRef, Run
from deepbots_cli.port import View
from deepbots_cli.program import Program, identity
from deepbots_cli.rollout import Driver, Start, Step, steps
from deepbots_cli.rollout.drivers import (
    HAND,
    POLICY,
    RANDOM,
    RECORDED,
    ROBOT,
    ZERO,
    action_from_values,
    named_driver,
)
from deepbots_cli.rollout.robot_logs import RobotLog, is_robot_log
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.batch import BatchSupervisor
from deepbots_cli.runtime.paths import Ways
from deepbots_cli.view.frames import FrameReader, WorldFrame

SHOWN_KINDS = (SourceKind.SCENARIO, SourceKind.RUN, SourceKind.CHECKPOINT, SourceKind.RECORDING)
_TAIL_BYTES = 20_000  # of a log, which hold its last episode


@dataclass(frozen=True)
class Showing:
    """A scenario, a run or a recording to show, and how."""

    reference: str
    overrides: Sequence[str] = ()
    permissions: Permissions = Permissions()
    engine: str | None = None
    case: str | None = None
    stage: str | None = None
    worlds: int = 0
    """Of a batch; 0 for a single world."""
    start: Mapping[str, Any] = field(default_factory=dict, hash=False)
    """The `options` of every reset."""
    model: ModelName = "best"
    """Of a run that has ended, which model acts; while it is trained, the newest one does. A model that
    `reference` names acts always."""
    deterministic: bool = True
    """Whether the policy takes its likeliest action, or samples."""

    def open(self) -> ShowingState:
        """Compile it; findings are returned and not raised.

        Raises:
            UsageError: There is no such file, run, case or stage.
        """
        source = Source.open(self.reference, self.permissions, *SHOWN_KINDS)
        if source.kind is SourceKind.RECORDING:
            return self._open_recording(source.path, is_log=is_robot_log(source.path))
        run, shown, overrides = None, self, self.overrides
        if source.kind in (SourceKind.RUN, SourceKind.CHECKPOINT):
            ref = ModelRef.open(source, model=self.model)
            run, shown = ref.run, replace(self, model=ref.name)
        else:
            overrides = with_engine(overrides, self.engine)
        checked = source.checked(overrides=overrides)
        files = (
            frozenset({checked.document.path, *checked.document.files}) if run is None else frozenset[Path]()
        )
        try:
            compiled = api.compile(checked)
        except ScenarioError as error:
            return ShowingState(None, error.findings, files, shown, run)
        files |= frozenset(checked.inputs.names) if run is None else files
        parameters = (
            {name: str(value) for name, value in checked.spec.parameters.items()} if checked.spec else {}
        )
        chosen = compiled.program.variant(self.case, self.stage)
        return ShowingState(
            chosen, compiled.findings, files, shown, run, compiled=compiled, parameters=parameters
        )

    def _open_recording(self, path: Path, *, is_log: bool) -> ShowingState:
        from deepbots_cli.rollout.recordings import Recording

        if self.overrides or self.case or self.stage or self.engine or self.worlds or self.start:
            raise UsageError(
                "a recording already contains its scenario, case, stage, engine and start; "
                "leave out --set, --case, --stage, --engine, --worlds and --start"
            )
        recording = RobotLog.read(path) if is_log else Recording.read(path)
        compiled = api.compile(Source.kept(recording.folder, self.permissions))
        metadata = recording.metadata
        shown = replace(
            self,
            engine=metadata.get("engine") or None,
            case=metadata.get("case") or None,
            stage=metadata.get("stage") or None,
        )
        return ShowingState(
            compiled.program.variant(shown.case, shown.stage),
            (),
            frozenset(),
            shown,
            recording=recording,
            compiled=compiled,
        )


@dataclass(frozen=True, eq=False)
class ShowingState:
    """What is shown as it is now.

    `program` is None where `findings` at error level leave nothing to run; `files` are those that were read.
    """

    program: Program | None
    findings: Sequence[Finding]
    files: frozenset[Path]
    shown: Showing
    run: Run | None = None
    recording: Any = None
    compiled: api.Compiled | None = None
    parameters: Mapping[str, str] = field(default_factory=dict)
    """The parameters of a scenario as they are written."""

    @property
    def drivers(self) -> tuple[str, ...]:
        """What may act, the default first."""
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
        """The compiled scenario.

        Raises:
            ScenarioError: It has errors.
        """
        if self.compiled is None:
            raise ScenarioError(self.findings)
        return self.compiled


class RunDriver(Driver):
    """The policy of a run, which acts as in an evaluation; while the run is trained, the newest one of each
    episode."""

    def __init__(
        self,
        run: Run,
        env: Supervisor,
        batch: BatchSupervisor | None = None,
        *,
        model: ModelName = "best",
        deterministic: bool = True,
    ) -> None:
        """In a `batch`, one forward pass acts in all worlds."""
        try:
            from deepbots_cli.learning import evaluation
            from deepbots_cli.learning.learner import steps_of
            from deepbots_cli.rollout.policies import PolicyDriver
        except ModuleNotFoundError as error:
            raise MissingExtraError("train", "showing the policy of a run") from error
        if differences := identity.differences(run.program, env.scenario):
            raise RunError(
                f"the policy of {run.path} does not fit the changed scenario:\n  " + "\n  ".join(differences)
            )
        self._load, self._driver = evaluation.load_model, PolicyDriver
        self._steps_of = steps_of
        self._run, self._env, self._batch = run, env, batch
        self._model, self._deterministic = model, deterministic
        self._policy: Driver | None = None
        self._stamp: tuple[int, int] | None = None
        self.begin(Start())

    def begin(self, start: Start) -> None:
        running = RunRecord.read(self._run.path).status == "running"
        names = {"best": ("best", "last"), "last": ("last", "best")}.get(self._model, (self._model,))
        stamps = {
            name: stamp
            for name in names
            if (stamp := file_stamps([path := self._run.model(name)])[path]) is not None
        }
        name = next(
            iter(stamps if not running else sorted(stamps, key=stamps.__getitem__, reverse=True)), None
        )
        if name is not None and stamps[name] != self._stamp:
            model = self._load(self._run, name, self._env)
            acting = self._driver(model, self._env, batch=self._batch, deterministic=self._deterministic)
            self._policy, self._stamp = acting, stamps[name]
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

    def _stage(self) -> str:
        """The stage of the curriculum that the training is in, as its newest episodes say."""
        rows = read_log_tail(self._run.monitor, _TAIL_BYTES)
        return f", the training is in stage {rows[-1]['stage']}" if rows and rows[-1].get("stage") else ""

    def act(self, observation: Any) -> Any:
        return self._space.sample() if self._policy is None else self._policy.act(observation)


class Player:
    """One environment, who drives it, and its newest frame.

    Episode k of a seed begins as episode k of an evaluation with this seed does.
    """

    world, worlds = 0, 1
    """The world that is shown, and how many there are."""

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
        """What a person commands, as `action_from_values` takes it."""
        self.driver = self._make_driver(self.env, HAND)
        self.observation: Any = None
        self.action: Any = None
        """What the last step of the environment returned and took."""
        self.actions: list[Any] = []
        """Those of the episode."""
        self._steps: Iterator[Step] = iter(())
        self._by_hand = False
        try:
            self.reader = self._reader()
            self.set_driver(driver or opened.drivers[0])
        except BaseException:
            self.close()
            raise

    def _make(self, program: Program) -> Supervisor:
        run, shown = self.opened.run, self.opened.shown
        return api.build(
            program,
            engine=shown.engine or (run.engine_for(program) if run else None),
            permissions=shown.permissions,
        )

    def _reader(self) -> FrameReader:
        return FrameReader(self.env, self.opened.checked().units)

    def set_driver(self, name: str) -> None:
        """Let another driver act from the next step on.

        Raises:
            UsageError: There is no such script, or no policy.
        """
        if name != POLICY:
            self.driver = self._make_driver(self.env, name)
        elif self.opened.run is None:
            raise UsageError("only a run has a policy")
        else:
            shown = self.opened.shown
            self.driver = RunDriver(
                self.opened.run, self.env, model=shown.model, deterministic=shown.deterministic
            )
        self.driver_name = name

    def _make_driver(self, env: Supervisor, name: str) -> Driver:
        return (
            Driver(lambda _: action_from_values(env, self.manual_values))
            if name == HAND
            else named_driver(env, name)
        )

    def begin(self, seed: int, episode: int) -> WorldFrame:
        """Reset to an episode; its first frame."""
        return self.start(Start.of_evaluation(seed, episode, self.opened.shown.start))

    def start(self, start: Start) -> WorldFrame:
        """Reset to an episode; its first frame."""
        self.seed, self.actions = start.seed or 0, []
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
        """The number of the next episode."""
        return episode + 1

    def step(self, *, by_hand: bool = False) -> WorldFrame:
        """The frame after the next step of an episode that has not ended; `by_hand` lets a person act instead
        of the driver."""
        self._by_hand = by_hand
        frame = self._next_frame()
        self.actions.append(self.action)
        return frame

    @property
    def note(self) -> str:
        """What a person should know, in words."""
        return self.driver.note

    def view(self, width: int, height: int) -> View:
        """The view that holds the scene, or follows the robot."""
        return self.env.view(width, height)

    def render(self, view: View) -> Any:
        """A picture of the world in the newest frame: uint8 (height, width, 3).

        Raises:
            EngineError: The engine cannot draw.
        """
        engine = self.env.engine
        if "rendering" not in engine.capabilities:
            raise EngineError(
                f"the engine '{engine.name}' cannot draw; use the engine 'pybullet' for pictures, or an"
                " offline page (.html)"
            )
        return engine.render(view)

    def shortest_paths(self) -> list[list[tuple[float, float]]]:
        """The shortest paths (points in m) whose lengths the scenario reads with `path_distance`."""
        planners = (getattr(agent, "ways", None) for agent in self.env.agents.values())
        return [points for ways in planners if isinstance(ways, Ways) for points in ways.last_read_paths()]

    def episode(self, seed: int, episode: int, steps: int | None = None) -> Iterator[WorldFrame]:
        """The frames of an episode, at most those of so many steps."""
        yield self.begin(seed, episode)
        while self.frame.ended_by is None and (steps is None or self.frame.step < steps):
            yield self.step()

    def close(self) -> None:
        self.env.close()
