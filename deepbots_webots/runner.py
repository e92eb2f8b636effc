"""Controllers as threads of one process, of which one runs at a time.

A controller that steps passes the turn to the next controller, in the order of the world, whose step has
ended. If there is none, the physics advances first. So a world runs the same every time, and a single
controller never changes threads.

Each controller has its own modules of the project, its own `__main__`, working directory, `sys.path` and
`sys.argv`; installed packages are shared, and so is the state of `random` and `numpy.random`.
"""

from __future__ import annotations

import importlib.machinery
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
import types
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field
from importlib.machinery import ModuleSpec
from importlib.metadata import distributions
from io import TextIOBase
from math import inf
from pathlib import Path
from typing import TextIO

from deepbots_cli.errors import UsageError
from deepbots_cli.records import dataclass
from deepbots_webots import supervisor
from deepbots_webots.nodes import texts
from deepbots_webots.project import Program
from deepbots_webots.project import programs as programs_of
from deepbots_webots.scene import Robot
from deepbots_webots.simulation import Pace, Simulation

SITE = Path(__file__).parent / "site"
"""The folder with the module `controller`."""
MAX_STEPS_AFTER_END = 100
"""The number of steps that a controller may make after the end; a further step ends the controller."""
CONTROLLER_ENVIRONMENT = {"MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1"}
"""Defaults of environment variables of controllers. Without them, Matplotlib opens windows, and small
networks lose more by several threads than they gain (29 instead of 158 steps/s of a training on a busy
machine)."""
_PACKAGE = str(Path(__file__).parent)
_BEFORE_1_0 = "deepbots before 1.0, such as the package deepbots==0.1.2"
WATCH_INTERVAL_S = 0.5
GRACE_S = 2.0
"""The time that controllers have to end after the end of the simulation."""


@dataclass(eq=False)
class Controller:
    """The program of a robot while it runs: when its step ends (ticks), and how it ended."""

    robot: Robot
    program: Path
    arguments: list[str]
    folder: str
    path: list[str]
    modules: dict[str, types.ModuleType]
    due: int = 0
    begins_again: bool = False  # once it has ended
    turn: threading.Lock = field(default_factory=threading.Lock)
    thread: threading.Thread | None = None
    private: set[str] = field(default_factory=set)
    has_ended: bool = False
    steps: int = 0
    steps_after_end: int = 0
    exit_code: int = 0


@dataclass(frozen=True)
class Outcome:
    """How a run of a world ended: the exit code, the simulated time (s), and a sentence for each thing that
    went wrong.

    `controllers` has robot, exit code and number of steps of each controller. `is_stuck` says that one still
    runs that only the end of the process ends.
    """

    exit_code: int
    seconds: float
    steps: int
    problems: tuple[str, ...]
    controllers: tuple[tuple[str, int, int], ...] = ()
    is_stuck: bool = False


class Runner:
    """Runs the controllers of a world."""

    def __init__(
        self,
        simulation: Simulation,
        programs: Sequence[tuple[Robot, Program]],
        *,
        steps: int | None = None,
        timeout: float | None = None,
        packages: Sequence[str] = (),
        output: TextIO | None = None,
        errors: TextIO | None = None,
        pace: Pace | None = None,
        after_step: Sequence[Callable[[], None]] = (),
    ) -> None:
        """Prepare a run.

        Args:
            simulation: The world.
            programs: The robots with the programs of their controllers.
            steps: The number of basic time steps after which the run ends.
            timeout: The time (s) after which a controller that does not step ends the run.
            packages: Further folders from which controllers import.
            output: Where controllers print, by default `sys.stdout`.
            errors: Where errors of controllers go, by default `sys.stderr`.
            pace: When the world may advance; by default, as fast as it can.
            after_step: Called after each basic time step.
        """
        self.simulation, self.timeout = simulation, timeout
        self.last_tick = None if steps is None else simulation.ticks + steps * simulation.basic_step
        self._path = [str(SITE), *packages, *sys.path]
        self.controllers: list[Controller] = []
        self._by_robot: dict[Robot, Controller] = {}
        for robot, program in programs:
            if program.path is not None:
                self._add(robot, program.path, len(self.controllers))
        self._robots = set(simulation.scene.robots)
        self.is_over = False
        self._current: Controller | None = None
        self._everything_ended = threading.Event()
        self._progress = 0
        self._problems: list[str] = []
        self._pace = pace or Pace(simulation, is_fast=True)
        self._after_step = after_step
        self._output, self._errors = output or sys.stdout, errors or sys.stderr

    def _add(self, robot: Robot, program: Path, place: int) -> None:
        """Set the controller at a place in the order of the world."""
        folder = str(program.parent)
        controller = self._by_robot[robot] = Controller(
            robot,
            program,
            texts(robot.node, "controllerArgs"),
            folder,
            [folder, *self._path],
            {"__main__": types.ModuleType("__main__")},
        )
        self.controllers[place : place + 1] = [controller]

    # The main thread

    def run(self) -> Outcome:
        """Run until the controllers end, a limit is reached, or a controller fails."""
        simulation = self.simulation
        if not self.controllers:
            raise UsageError("no robot of the world has a controller that can run")
        supervisor.activate(simulation)
        simulation.wait, simulation.on_restart = self._wait, self._restart
        simulation.on_change.append(self._start_new)
        try:
            with self._surroundings():
                for controller in self.controllers:
                    self._start(controller)
                self._give_turn(self.controllers[0])
                self._watch()
        finally:  # also if the person at the keyboard ends the run
            self.is_over = True
            supervisor.deactivate()
        return self._outcome()

    def _start(self, controller: Controller) -> None:
        # Locked before the thread starts, so that the thread waits until it gets the turn.
        controller.turn.acquire()
        controller.thread = threading.Thread(
            target=self._work, args=(controller,), daemon=True, name=controller.robot.name
        )
        controller.thread.start()

    def _start_new(self) -> None:
        """Start the controllers of robots that came into the world."""
        scene = self.simulation.scene
        for robot, program in programs_of(
            scene.files, [each for each in scene.robots if each not in self._robots]
        ):
            if program.path is not None:
                self._add(robot, program.path, len(self.controllers))
                self._start(self.controllers[-1])
        self._robots = set(scene.robots)

    def _restart(self, robot: Robot) -> None:
        """Start the program of a robot again, after the end of its present step if it runs."""
        controller = self._by_robot.get(robot)
        if controller is None:
            return
        controller.begins_again, controller.due = True, self.simulation.ticks
        if controller.has_ended:
            self._replace(controller)

    def _replace(self, controller: Controller) -> None:
        at = self.controllers.index(controller)
        self._add(controller.robot, controller.program, at)
        self._start(self.controllers[at])

    def _watch(self) -> None:
        """Wait for the end; a controller that does not step for too long ends the run."""
        timeout = inf if self.timeout is None else self.timeout
        last_progress, since = self._progress, time.monotonic()
        while not self._everything_ended.wait(min(timeout, WATCH_INTERVAL_S)):
            if self._progress != last_progress or self._pace.is_paused:
                last_progress, since = self._progress, time.monotonic()
            elif time.monotonic() - since >= timeout:
                name = self._current.robot.name if self._current is not None else "?"
                self._problems.append(f"the controller of '{name}' made no step for {timeout:g} s")
                self.is_over = True
                self._everything_ended.wait(GRACE_S)
                return

    def _outcome(self) -> Outcome:
        codes = [self.simulation.quit_status, *(controller.exit_code for controller in self.controllers)]
        code = next(filter(None, codes), int(bool(self._problems)))
        is_stuck = not all(controller.has_ended for controller in self.controllers)
        ends = tuple(
            (controller.robot.name, controller.exit_code, controller.steps) for controller in self.controllers
        )
        steps = self.simulation.ticks // self.simulation.basic_step
        return Outcome(code, self.simulation.ticks / 1000, steps, tuple(self._problems), ends, is_stuck)

    @contextmanager
    def _surroundings(self) -> Iterator[None]:
        """Give controllers their own surroundings, and restore those of the process."""
        path, argv, folder = sys.path[:], sys.argv, os.getcwd()
        stdout, stderr = sys.stdout, sys.stderr
        main, modules_before = sys.modules.get("__main__"), set(sys.modules)
        # Python searches the folder of a program first, so modules of the project hide installed ones.
        sys.meta_path.insert(0, self)
        targets = (self._output, self._errors)
        streams = tuple(
            _Prefixed(target, lambda: self._current.robot.name if self._current else "") for target in targets
        )
        sys.stdout, sys.stderr = streams
        added_variables = CONTROLLER_ENVIRONMENT.keys() - os.environ.keys()
        os.environ.update({variable: CONTROLLER_ENVIRONMENT[variable] for variable in added_variables})
        register = signal.signal
        signal.signal = _ignore_signal  # type: ignore[assignment]
        try:
            yield
        finally:
            for stream in streams:
                stream.end()
            signal.signal = register
            sys.meta_path.remove(self)
            sys.path[:], sys.argv = path, argv
            os.chdir(folder)
            sys.stdout, sys.stderr = stdout, stderr
            for variable in added_variables:
                os.environ.pop(variable, None)
            for module in {module for controller in self.controllers for module in controller.private}:
                sys.modules.pop(module, None)
            for module in set(sys.modules) - modules_before:
                # The next run imports the module anew: it belongs to another simulation.
                if module.partition(".")[0] == "controller":
                    del sys.modules[module]
            if main is not None:
                sys.modules["__main__"] = main

    # The threads of controllers

    def _work(self, controller: Controller) -> None:
        controller.turn.acquire()
        try:
            if not self.is_over:
                self._execute(controller)
        except SystemExit as error:  # a text is printed, and its code is 1
            if not isinstance(error.code, int | None):
                print(error.code, file=sys.stderr)
            controller.exit_code = error.code if isinstance(error.code, int) else int(error.code is not None)
        except BaseException as error:  # noqa: BLE001  # a failure of a program is reported
            controller.exit_code = 1
            _print_traceback(error)
            self._problems.append(f"the controller of '{controller.robot.name}' failed: {_described(error)}")
            self.is_over = True
        controller.has_ended = True
        if controller.begins_again and not self.is_over:
            self._replace(controller)
        self._end(controller)

    def _execute(self, controller: Controller) -> None:
        module = sys.modules["__main__"]
        module.__file__ = str(controller.program)
        module.__builtins__ = __builtins__  # type: ignore[attr-defined]
        # `compile` finds out the encoding of a program only from its bytes (PEP 263).
        code = compile(controller.program.read_bytes(), str(controller.program), "exec")
        exec(code, vars(module))  # after --allow-code

    def _end(self, controller: Controller) -> None:
        supervisors = [other for other in self.controllers if other.robot.is_supervisor]
        if all(other.has_ended for other in supervisors or self.controllers):
            self.is_over = True
        if all(other.has_ended for other in self.controllers):
            self._everything_ended.set()
            return
        if not (self.is_over or controller.begins_again):
            code = f" with exit code {controller.exit_code}" if controller.exit_code else ""
            self._errors.write(f"the controller of '{controller.robot.name}' ended{code}; the others go on\n")
        self._pass_on(controller)

    def _wait(self, robot: Robot, period: int) -> int:
        """Do the step of a controller; returns -1 at the end."""
        controller = self._by_robot[robot]
        if self.is_over:
            controller.steps_after_end += 1
            if controller.steps_after_end > MAX_STEPS_AFTER_END:
                raise SystemExit(0)  # the program does not heed the end
            return -1
        self._progress += 1
        basic = self.simulation.basic_step
        controller.due = self.simulation.ticks + max(1, -(-period // basic)) * basic
        self._pass_on(controller)
        if robot not in self._robots or controller.begins_again:
            raise SystemExit(0)  # a supervisor removed it, or starts it again
        controller.steps += not self.is_over
        return -1 if self.is_over else 0

    def _pass_on(self, controller: Controller) -> None:
        """Give the turn to the next controller, and wait for the next turn of this one."""
        following = self._next()
        if following is controller:
            return
        self._leave(controller)
        self._give_turn(following)
        if not controller.has_ended:
            controller.turn.acquire()

    def _next(self) -> Controller:
        """Advance the physics until the step of a controller ends, and return this controller; at the end of
        the run, return the first one that still runs."""
        simulation = self.simulation
        waiting = [controller for controller in self.controllers if not controller.has_ended]
        while not self.is_over:
            for controller in waiting:
                if controller.due <= simulation.ticks:
                    return controller
            at_limit = self.last_tick is not None and simulation.ticks >= self.last_tick
            if at_limit or simulation.quit_status is not None:
                self.is_over = True
            else:
                self._advance()
        return waiting[0]

    def _advance(self) -> None:
        if self._pace.wait():
            self._progress += 1  # a pause does not count as time of a controller
        try:
            self.simulation.run_step()
        except FloatingPointError as error:
            self._problems.append(f"{error}, after {self.simulation.time / 1000:g} s")
            self.is_over = True
            return
        for call in self._after_step:
            call()

    # Surroundings

    def _give_turn(self, controller: Controller) -> None:
        self._current = controller
        self.simulation.current = controller.robot
        self._enter(controller)
        controller.turn.release()

    def _enter(self, controller: Controller) -> None:
        """Install the modules, `sys.path`, arguments and working directory of a controller."""
        sys.path[:] = controller.path
        sys.argv = [str(controller.program), *controller.arguments]
        sys.modules.update(controller.modules)
        os.chdir(controller.folder)

    def _leave(self, controller: Controller) -> None:
        """Store the modules, `sys.path` and working directory of a controller, and remove its modules."""
        controller.path = sys.path[:]
        modules = sys.modules
        controller_modules = controller.modules
        controller_modules["__main__"] = modules["__main__"]
        for name in controller.private:
            module = modules.pop(name, None)
            if module is not None:
                controller_modules[name] = module
        if not controller.has_ended:
            controller.folder = os.getcwd()

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: types.ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a module in the folder of the controller that runs, and record whose it is."""
        controller = self._current
        # Threads of the page and of videos import too, while a controller has the turn.
        if controller is None or threading.current_thread() is not controller.thread:
            return None
        find = importlib.machinery.PathFinder.find_spec
        spec = find(name, [str(controller.program.parent)]) if path is None else None
        # A folder without modules, such as the `wandb` of earlier runs, hides no installed package.
        if spec is not None and spec.loader is None and (find(name) or spec).loader is not None:
            spec = None
        if spec is not None or name.partition(".")[0] in controller.private:
            controller.private.add(name)
        return spec


def _ignore_signal(number: int, _: object) -> object:
    """Take the place of `signal.signal`, which only the main thread of a process may call."""
    call = f"signal.signal({signal.Signals(number).name}, ...)"
    print(f"Warning: {call} has no effect: deepbots receives all signals", file=sys.stderr)
    return signal.getsignal(number)


class _Prefixed(TextIOBase):
    """A stream that begins each line with the name of the robot whose controller prints."""

    encoding, errors = "utf-8", "replace"

    def __init__(self, stream: TextIO, speaker: Callable[[], str]) -> None:
        """Create the stream; `speaker` returns the name of the robot."""
        self._stream, self._speaker = stream, speaker
        self._unfinished: dict[str, str] = {}

    def write(self, text: str) -> int:
        name = self._speaker()
        *lines, unfinished_line = (self._unfinished.pop(name, "") + text).split("\n")
        if lines:
            self._write(name, lines)
        if unfinished_line:
            self._unfinished[name] = unfinished_line
        return len(text)

    def _write(self, name: str, lines: Sequence[str]) -> None:
        # Whole lines in one call, so that lines of several controllers do not mix.
        self._stream.write("".join(f"[{name}] {line}\n" for line in lines))

    def flush(self) -> None:
        self._stream.flush()

    def end(self) -> None:
        """Write lines that have no end yet."""
        for name, unfinished_line in self._unfinished.items():
            self._write(name, [unfinished_line])
        self._unfinished.clear()
        self._stream.flush()

    def fileno(self) -> int:
        return self._stream.fileno()


def _print_traceback(error: BaseException) -> None:
    """Print a traceback of the program, without the frames of deepbots around and below it."""
    whole = traceback.TracebackException.from_exception(error)
    described: traceback.TracebackException | None = whole
    while described is not None:
        own = [frame for frame in described.stack if not frame.filename.startswith(_PACKAGE)]
        described.stack = traceback.StackSummary.from_list(own)
        described = described.__cause__ or described.__context__
    sys.stderr.write("".join(whole.format()))


def _described(error: BaseException) -> str:
    """Return the kind and the message of an error in a line, and what to do about a missing package."""
    message = " ".join(str(error).split())[:200]
    described = f"{type(error).__name__}: {message}" if message else type(error).__name__
    name = error.name if isinstance(error, ImportError) else None
    if name is not None and name.startswith("deepbots."):
        is_old = any(each.version.startswith("0.") for each in distributions(name="deepbots"))
        fitting = "deepbots 1.0, the package deepbots==1.0.0" if is_old else _BEFORE_1_0
        return f"{described}; the project is for {fitting}"
    if name is not None and isinstance(error, ModuleNotFoundError):
        package = name.partition(".")[0]
        # Version 1.0 of deepbots requires gym 0.21, which cannot be built any more.
        install = "pip install --no-deps deepbots==1.0.0 gym==0.26.2 gym-notices tensorboardX"
        way = f"`{install}`" if package == "deepbots" else f"the package of '{package}'"
        return f"{described}; install {way}, or name an environment with it by --python"
    return described


def packages_of(python: Path) -> list[str]:
    """Return the folders from which another interpreter imports packages.

    Raises:
        UsageError: It does not run, or has another version.
    """
    program = "import sys; print(*sys.version_info[:2]); print(*filter(None, sys.path), sep='\\n')"
    try:
        ran = subprocess.run([python, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    except (OSError, subprocess.SubprocessError) as error:
        reason = error.strerror.lower() if isinstance(error, OSError) and error.strerror else error
        raise UsageError(f"--python {python} does not run: {reason}") from error
    version, *folders = ran.stdout.splitlines()
    own_version = f"{sys.version_info[0]} {sys.version_info[1]}"
    if version != own_version:
        raise UsageError(
            f"--python {python} is Python {version.replace(' ', '.')}, and deepbots runs on Python"
            f" {own_version.replace(' ', '.')}; their packages do not mix"
        )
    return [folder for folder in folders if "site-packages" in folder or "dist-packages" in folder]
