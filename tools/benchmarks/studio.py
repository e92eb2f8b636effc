"""What the studio costs, and how soon it answers.

    python -m tools.benchmarks.studio [PART ...] [--json] [--letters 50] [--saves 10] [--pairs 3]
        [--steps 30000]

Without a part, all are measured. Every wait has a limit, after which the part ends with a message.

keystroke   a letter of an unknown name is typed into a scenario of 400 lines, until the name with this letter
            is underlined; in Chromium
save        a scenario is saved with another value, until the robot has read it
curve       an episode is written by a training, until the session shows it
training    timesteps per second with the page open or hidden, as a ratio to those of the same training from the
            shell, in pairs; Chromium itself runs at nice 19
idle        CPU time and memory of the server and the process of the robot while no page is open
page        an address is opened, until the text is there

The load of the machine counts in all of them but memory and idle, so the first row says it.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from statistics import median

from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.studio.session import Session
from tests.studio.served import BACKSPACE, Served, StudioTab, served
from tests.studio.test_studio_page import SCENARIO
from tests.view.browser import browser
from tools.benchmarks.lsp_cost import cpu_milliseconds
from tools.benchmarks.report import Row, options, show

LINES = 400
_IDLE_S = 20.0
_LOADING_S = 15.0
"""The time in s after which the robot is loaded."""
_TRAINING_S = 600.0
"""The time in s after which a training has failed."""
_KEY = "q"
_WATCH = """(() => {
  window.begun = 0; window.answer = null;
  const text = document.querySelector('.cm-content');
  text.addEventListener('beforeinput', () => { window.begun = performance.now(); }, true);
  const look = () => {
    if (!window.wanted || window.answer !== null) return;
    if ([...document.querySelectorAll('.studio-error')].some(one => one.textContent == window.wanted))
      window.answer = performance.now() - window.begun;
  };
  new MutationObserver(look).observe(text, {childList: true, subtree: true, attributes: true}); })()"""


def long_scenario() -> str:
    """Return a scenario of 400 lines, most of which are expressions."""
    head, _, tail = SCENARIO.partition("reward:\n  alive: 1\n")
    rows = LINES - len(SCENARIO.splitlines())
    parameters = rows // 3
    terms = rows - 2 * parameters
    names = "".join(f"  weight_{number}: 0.{number + 1:03d}\n" for number in range(parameters))
    rewards = "".join(
        f"  term_{number}: weight_{number % parameters} * cos(cart.pole_angle) - {number} * weight_0^2\n"
        for number in range(terms)
    )
    failures = "".join(
        f"    lean_{number}: abs(cart.pole_angle) > fall_angle + {(number + 1) / 10} deg\n"
        for number in range(parameters)
    )
    head = head.replace("parameters:\n", f"parameters:\n{names}")
    head = head.replace("-20 .. 20 deg", "-60 .. 60 deg")
    tail = tail.replace("  failure:\n", f"  failure:\n{failures}")
    # The rewards come first: the editor draws the lines that are in view.
    return head.replace("parameters:\n", f"reward:\n  alive: 1\n{rewards}parameters:\n") + tail


@contextmanager
def folder_with(text: str) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        (Path(name) / "mine.yaml").write_text(text, encoding="utf-8")
        yield Path(name)


# In a browser


def wait(page: StudioTab, script: str, seconds: float, what: str) -> None:
    """Wait until a script is true.

    Raises:
        SystemExit: It is false for `seconds`; `what` says what it stands for.
    """
    try:
        page.wait(script, seconds)
    except AssertionError as error:
        raise SystemExit(f"within {seconds:g} s there was no {what}\n{error}") from None


def wait_for_robot(page: StudioTab) -> None:
    status = "document.querySelector('.studio-robot .studio-status').innerText"
    wait(page, f"/^driven by/.test({status})", 90, "running robot on the page")


def keystrokes(page: StudioTab, count: int) -> list[float]:
    """Seconds from each letter to its underline."""
    page.click_line("  alive: 1")
    page.type(" + ")
    # Chromium draws by software, and its first picture of the robot blocks the page for about 3 s.
    time.sleep(6)
    page.tab.run(_WATCH)
    seconds = []
    for number in range(count):
        letters = _KEY * (number + 1)
        page.tab.run(f"window.wanted = '{letters}'; window.answer = null")
        page.type(_KEY)
        wait(page, "window.answer !== null", 30, f"underline of {letters!r}")
        seconds.append(float(page.tab.run("window.answer")) / 1000)
    page.press(BACKSPACE, count + 3)
    return seconds


def keystroke_rows(letters: int) -> Iterator[Row]:
    text = long_scenario()
    with folder_with(text) as folder, served(folder, "mine.yaml") as studio, browser() as new_tab:
        page = StudioTab(new_tab(), studio.address)
        wait_for_robot(page)
        seconds = keystrokes(page, letters)
    yield Row(f"keystroke: median of {letters}, {len(text.splitlines())} lines", median(seconds), "s", 0.4)
    yield Row(f"keystroke: worst of {letters}", max(seconds), "s", 0.8)


def page_rows() -> Iterator[Row]:
    with folder_with(long_scenario()) as folder, served(folder, "mine.yaml") as studio:
        time.sleep(_LOADING_S)
        with browser() as new_tab:
            tab = new_tab()
            begin = time.monotonic()
            StudioTab(tab, studio.address)
            yield Row("page: load", time.monotonic() - begin, "s", 3.0)


# Processes


def children(process: int) -> list[int]:
    """Return a process with those that it has started."""
    paths = Path(f"/proc/{process}/task").glob("*/children")
    return [process, *(int(child) for path in paths for child in path.read_text().split())]


def set_priority(process: int, nice: int) -> None:
    """Give all threads of a process a priority."""
    for path in Path(f"/proc/{process}/task").glob("*"):
        with suppress(OSError):  # it has just ended
            os.setpriority(os.PRIO_PROCESS, int(path.name), nice)


def memory(process: int) -> float:
    """Megabytes of a process; pages that several processes share are divided among them."""
    text = Path(f"/proc/{process}/smaps_rollup").read_text()
    return int(text.partition("Pss:")[2].split()[0]) * 1024 / 1e6


def idle_rows() -> Iterator[Row]:
    with folder_with(long_scenario()) as folder, served(folder, "mine.yaml") as studio:
        time.sleep(_LOADING_S)
        yield from idle_costs(studio)


def idle_costs(studio: Served) -> Iterator[Row]:
    processes = children(studio.process.pid)
    before = [cpu_milliseconds(process) for process in processes]
    time.sleep(_IDLE_S)
    used = [
        (cpu_milliseconds(process) - start) / 10 / _IDLE_S
        for process, start in zip(processes, before, strict=True)
    ]
    sizes = [memory(process) for process in processes]
    yield Row("idle: CPU of the server", used[0], "%", 3.0)
    yield Row("idle: CPU of the robot", sum(used[1:]), "%")
    yield Row("idle: memory of the server", sizes[0], "MB", 400.0)
    yield Row("idle: memory of the robot", sum(sizes[1:]), "MB")


# The session


async def until(condition: Callable[[], bool], what: str, seconds: float = 120.0) -> float:
    """Return the seconds until a condition is true.

    Raises:
        SystemExit: It is false for `seconds`; `what` says what it stands for.
    """
    begin = time.monotonic()
    while not condition():
        if time.monotonic() > begin + seconds:
            raise SystemExit(f"within {seconds:g} s there was no {what}")
        await asyncio.sleep(0.002)
    return time.monotonic() - begin


async def restarts(folder: Path, count: int) -> list[float]:
    """Seconds from a save to the robot that has read it."""
    session = Session(folder)
    session.show(Path("mine.yaml"))
    robot = session.robot
    seconds = []
    try:
        await until(lambda: robot.state is not None and robot.state.state == "running", "running robot")
        (file,) = session.files.values()
        text = file.text
        for number in range(count):
            assert robot.state is not None
            loaded = robot.state.loaded
            session.change(file, file.revision, f"{text}# {number}\n")
            session.save(file)

            def is_loaded(loaded: int = loaded) -> bool:
                return robot.state is not None and robot.state.loaded > loaded

            seconds.append(await until(is_loaded, f"robot of the save number {number + 1}"))
            await asyncio.sleep(0.3)
    finally:
        await session.close()
    return seconds


def save_rows(count: int) -> Iterator[Row]:
    for name, bar in (("cartpole", 1.2), ("quadruped", 2.5)):
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            command = python_command("deepbots_cli", "new", "mine", "--from", name)
            subprocess.run(command, cwd=folder, env=python_environment(), check=True, capture_output=True)
            seconds = asyncio.run(restarts(Path(folder), count))
        yield Row(f"save: {name}, median of {count}", median(seconds), "s", bar)
        yield Row(f"save: {name}, worst of {count}", max(seconds), "s")


async def curve_delays(folder: Path, steps: int) -> list[float]:
    """Seconds from the first episode that a curve does not show yet to the next curve."""
    session = Session(folder)
    session.listen(lambda topic: None)
    watching = asyncio.create_task(session.run_forever())
    delays: list[float] = []
    words = ["train", "mine.yaml", "--run", "runs/a", "--timesteps", str(steps)]
    task = session.commands.run(words, Path("runs/a"))
    try:
        log = folder / "runs" / "a" / "monitor.csv"
        shown, waiting_since = session.shown.training.log if session.shown.training else None, 0.0
        size = 0
        begin = time.monotonic()
        while task.is_running:
            now = time.monotonic()
            if now > begin + _TRAINING_S:
                raise SystemExit(f"the training did not end within {_TRAINING_S:g} s")
            if session.shown.training is not None and session.shown.training.log != shown:
                shown = session.shown.training.log
                if waiting_since:
                    delays.append(now - waiting_since)
                waiting_since = 0.0
            with suppress(OSError):
                grown = log.stat().st_size
                if grown > size and not waiting_since:
                    waiting_since = now
                size = grown
            await asyncio.sleep(0.02)
    finally:
        watching.cancel()
        task.stop()
        await session.close()
    if not delays:
        raise SystemExit(f"the training wrote no episode: {task.output()}")
    return delays


def curve_rows(steps: int) -> Iterator[Row]:
    with folder_with(SCENARIO) as folder:
        delays = asyncio.run(curve_delays(folder, steps))
    yield Row(f"curve: median of {len(delays)} delays", median(delays), "s")
    yield Row("curve: longest delay", max(delays), "s", 2.0)


# Trainings


def speed(folder: Path, steps: int) -> float:
    """Timesteps per second of a training from the shell."""
    run = folder / "runs" / f"speed-{time.monotonic_ns()}"
    command = python_command(
        "deepbots_cli", "train", "mine.yaml", "--run", str(run), "--timesteps", str(steps)
    )
    environment = python_environment()
    try:
        subprocess.run(
            command, cwd=folder, env=environment, check=True, capture_output=True, timeout=_TRAINING_S
        )
    except subprocess.TimeoutExpired:
        raise SystemExit(f"the training did not end within {_TRAINING_S:g} s") from None
    rows = [line.split(",") for line in (run / "monitor.csv").read_text("utf-8").splitlines()[2:]]
    taken = float(rows[-1][2]) - float(rows[0][2])
    return sum(float(row[1]) for row in rows[1:]) / taken


def be_nice(process: int) -> None:
    """Give a process and those that it has started what the others leave of the cores."""
    set_priority(process, 19)
    for child in children(process)[1:]:
        with suppress(OSError):  # it has just ended
            be_nice(child)


def training_rows(count: int, steps: int) -> Iterator[Row]:
    ratios: dict[str, list[float]] = {"open": [], "hidden": []}
    with folder_with(SCENARIO) as folder:
        for _ in range(count):
            alone = speed(folder, steps)
            with served(folder, "mine.yaml") as studio, browser() as new_tab:
                wait_for_robot(StudioTab(new_tab(), studio.address))
                for process in children(os.getpid())[1:]:
                    if process != studio.process.pid:
                        be_nice(process)  # Chromium
                ratios["open"].append(speed(folder, steps) / alone)
                other = new_tab()
                other.call("Page.bringToFront")
                time.sleep(1)
                ratios["hidden"].append(speed(folder, steps) / alone)
    for name, bar in (("open", 0.9), ("hidden", 0.97)):
        yield Row(f"training: page {name}, median of {count}", median(ratios[name]), "", bar, at_least=True)


def main() -> None:
    names = ("page", "keystroke", "save", "curve", "training", "idle")
    arguments = options(__doc__, parts=names, letters=50, saves=10, pairs=3, steps=30_000)
    parts: dict[str, Callable[[], Iterator[Row]]] = {
        "page": page_rows,
        "keystroke": lambda: keystroke_rows(arguments.letters),
        "save": lambda: save_rows(arguments.saves),
        "curve": lambda: curve_rows(arguments.steps),
        "training": lambda: training_rows(arguments.pairs, arguments.steps),
        "idle": idle_rows,
    }
    rows = [Row("load of the machine", os.getloadavg()[0], "")]
    for name in arguments.parts:
        rows += parts[name]()
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()
