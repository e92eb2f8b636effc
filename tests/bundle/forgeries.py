"""Forge bundles for as long as it takes, and judge what `load` makes of them.

    python -m tests.bundle.forgeries [--count 500] [--seed 1] [--start 0] [--only NUMBER] [--keep FOLDER]
    [--json]

Three attackers. `changes` changes files and no digests: the bundle is refused. `digests` also computes
digests, the metadata of the graph and the recorded steps again: the bundle is refused in one sentence, or its
policy gives finite commands within its ranges and rates whatever it is given. `signed` does the same to a
bundle with a signature, and `load` has the trusted key: the bundle is refused.

Each case runs in a process of its own with limits: 2 s of CPU for `load`, 500 MB beyond what was there
before. The same seed and number are the same forgery. What fails is printed with its number and kept in
FOLDER; the exit code is then 1.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

import deepbots_robot
from deepbots_robot import BundleError, bundle, onnx_file, signature
from deepbots_robot.link import Arrival
from deepbots_robot.server import Commands, Server
from deepbots_robot.serving import ServeError, inputs_of, mapped, outputs_of
from deepbots_robot.topics import Topic
from tests.bundle.forged import Forged
from tests.bundle.forging import AREAS, SIGNATURE_AREAS

BASES: Mapping[str, tuple[str, ...]] = {
    "balancer": ("balancer",),
    "cartpole": ("cartpole",),
    "panda_reach": ("panda_reach",),
    "recurrent": ("cartpole_continuous", "train.algorithm=RecurrentPPO"),
    "normalized": ("find_ball_random",),
    "picture": ("see_ball",),
}
"""Continuous with a memory, discrete, with rates, recurrent, normalized with a history, and with a
picture."""
QUICK = ("balancer", "cartpole", "panda_reach")
ATTACKERS = ("changes", "digests", "digests", "signed")
MAX_SECONDS, MAX_MEMORY = 2.0, 500e6
_KILLED_AFTER = 60.0
"""Seconds of wall time, for a load that hangs."""
_MAX_SENTENCE = 1_500
_STEPS = 40


@dataclass
class Outcome:
    """What became of a forgery.

    Attributes:
        area: What was forged: an area of `forging.AREAS`.
        way: The name of the way.
        end: `refused`, `loaded`, `unchanged` (the dice left the files as they were), or `failed`.
        text: The sentence of a refusal, or what failed.
        stopped: How many steps the policy of a loaded bundle refused.
    """

    number: int
    attacker: str
    base: str
    area: str
    way: str
    end: str = ""
    text: str = ""
    seconds: float = 0.0
    megabytes: float = 0.0
    stopped: int = 0


class FailedError(Exception):
    """A bar is missed."""


# The bundles that are forged


def prepare(folder: Path, names: Sequence[str] = tuple(BASES)) -> Path:
    """Write the bundles and a key to sign them with; needs what trains."""
    from tests.bundle.untrained import write_bundle

    folder.mkdir(exist_ok=True)
    if not (folder / "key").exists():
        signature.write_key(folder / "key")
    for name in names:
        if not (folder / name).exists():
            write_bundle(folder / name, *BASES[name])
            forged = Forged.of(folder / name)
            forged.files |= {
                bundle.README_NAME: b"Limits of the commands: 5 rad/s\n" * 9,
                bundle.SCENARIO_NAME: b"deepbots: 1\n",
            }
            shutil.rmtree(folder / name)
            forged.write(folder / name, digests=True)
        content = signature.sign((folder / name / bundle.BUNDLE_NAME).read_bytes(), folder / "key")
        (folder / name / bundle.SIGNATURE_NAME).write_bytes(content)
    return folder


# One case


def forge(number: int, seed: int, bases: Path, folder: Path) -> Outcome:
    """Write the forgery of this number into `folder`, which is then a bundle."""
    rng = random.Random(f"{seed} {number}")
    attacker = ATTACKERS[number % len(ATTACKERS)]
    areas = SIGNATURE_AREAS if attacker == "signed" else AREAS
    base = rng.choice(sorted(path.name for path in bases.iterdir() if path.is_dir()))
    area = list(areas)[number // len(ATTACKERS) % len(areas)]
    way = rng.choice(areas[area])
    forged = Forged.of(bases / base)
    if attacker != "signed":
        del forged.files[bundle.SIGNATURE_NAME]
    way(rng, forged)
    with_digests = attacker != "changes"
    if with_digests and isinstance(forged.description, dict) and area in ("json", "behavior"):
        with suppress(Exception):  # a graph that onnx cannot read keeps its metadata
            forged.fit_graph()
    if with_digests and area in ("graph", "behavior", "cost"):
        _record_again(forged)
    forged.write(folder, digests=with_digests)
    return Outcome(number, attacker, base, area, getattr(way, "__qualname__", "").partition(".")[0])


def _record_again(forged: Forged) -> None:
    """The steps of parity.npz as the forged graph computes them, without any check of ours but those against
    work without an end."""
    with suppress(Exception):
        content = forged.files[bundle.GRAPH_NAME]
        if onnx_file.require_plain(content) > 20_000_000:
            return
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 4
        options.intra_op_num_threads = 1
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        arrays = forged.arrays
        names = [entry.name for entry in session.get_outputs()]
        initial = {entry["name"]: entry for entry in forged.tree["memory"]}
        steps = min(20, len(arrays["output/action"]))
        arrays = {name: rows[:steps].copy() for name, rows in arrays.items()} | {"starts": np.array([0])}
        memory: dict[str, Any] = {}
        for step in range(steps):
            feeds: dict[str, Any] = {}
            for entry in session.get_inputs():
                if entry.name in initial:
                    start = np.broadcast_to(np.array(initial[entry.name]["initial"]), entry.shape)
                    feeds[entry.name] = memory.get(
                        entry.name, start.astype(bundle._NUMPY_TYPES[initial[entry.name]["dtype"]])
                    )
                else:
                    feeds[entry.name] = arrays[f"input/{entry.name}"][step]
            outputs = dict(zip(names, session.run(None, feeds), strict=True))
            memory = {name: outputs[f"{name}_next"] for name in initial}
            for name, value in outputs.items():
                if f"output/{name}" in arrays:
                    arrays[f"output/{name}"][step] = value
        forged.set_arrays(arrays)


def examine(outcome: Outcome, folder: Path, trusted: Path, same_as: Path) -> None:
    """Load a forgery, and let its policy act if it loads; fills in the outcome. Runs in a process of its
    own."""
    before = _memory("VmRSS")
    _clear_peak()
    started = time.process_time()
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            loaded = deepbots_robot.load(folder, trusted=trusted if outcome.attacker == "signed" else None)
        except BundleError as error:
            outcome.end = "refused"
            outcome.text = str(error).removeprefix(f"{folder}: ")
        outcome.seconds = time.process_time() - started
        outcome.megabytes = (_memory("VmHWM") - before) / 1e6
        if outcome.end != "refused":
            if _is_same(folder, same_as):
                outcome.end = "unchanged"
                return
            if outcome.attacker != "digests":
                raise FailedError(f"it loads for the attacker '{outcome.attacker}'")
            outcome.end = "loaded"
            outcome.stopped = _act(loaded, outcome.number)
    if not outcome.text.isprintable() or len(outcome.text) > _MAX_SENTENCE:
        raise FailedError(f"the refusal is not a sentence: {outcome.text[:300]!r}")
    if outcome.seconds > MAX_SECONDS:
        raise FailedError(f"{outcome.seconds:.2f} s of CPU until: {outcome.text or outcome.end}")
    if outcome.megabytes > MAX_MEMORY / 1e6:
        raise FailedError(f"{outcome.megabytes:.0f} MB until: {outcome.text or outcome.end}")
    if warned:
        raise FailedError(f"a warning: {warned[0].category.__name__}: {warned[0].message}")


def _is_same(folder: Path, other: Path) -> bool:
    """Whether all files of a bundle are those of another one, with nothing reached by a link."""
    names = {path.relative_to(other) for path in other.rglob("*")} - {Path(bundle.SIGNATURE_NAME)}
    return all(
        (folder / name).is_file() and (folder / name).read_bytes() == (other / name).read_bytes()
        for name in names
    )


class _Line:
    """A link of a server, on which the values lie that the robot sends next."""

    name = "a line"

    def __init__(self) -> None:
        self.coming: list[Arrival] = []
        self.sent: list[Mapping[str, Any]] = []

    def take(self) -> Sequence[Arrival]:
        coming = self.coming
        self.coming = []
        return coming

    def send(self, values: Mapping[str, Any], stamp: float) -> None:
        self.sent.append(values)

    def wait(self, timeout: float) -> None: ...
    def reset(self, number: int, stamp: float) -> None: ...
    def connected(self) -> bool:
        return True

    def remarks(self) -> Sequence[Any]:
        return []

    def others(self) -> Sequence[Any]:
        return []

    def close(self) -> None: ...


def _act(loaded: deepbots_robot.Bundle, number: int) -> int:
    """Let a policy act on random and extreme values, alone and in a server; how many steps it refused."""
    info = loaded.info
    rng = np.random.default_rng(number)
    inputs = inputs_of(info)
    outputs = outputs_of(info)
    with suppress(ServeError):
        topics = {name: Topic(topic.topic, topic.type, topic.part) for name, topic in info.ros.items()}
        mapped([each.field for each in inputs], topics)
        mapped([each.field for each in outputs], topics, commands=True)
    policy = loaded.start()
    limits = Commands(outputs)
    line = _Line()
    now = 100.0
    server = Server(loaded.start(), inputs, outputs, line, info.rate_hz, clock=lambda: now)
    last: dict[str, Any] | None = None
    stopped = 0
    for step in range(_STEPS):
        if step % 15 == 14:
            policy.reset()
        values = {entry.name: _value(entry, rng, step) for entry in info.inputs}
        now += info.timestep_s
        line.coming.append(Arrival("robot", dict(values), now))
        server.turn()
        try:
            commands = policy.step(values)
        except BundleError:
            stopped += 1
            continue
        _check_ranges(info, commands)
        limited = limits.limit(commands, info.timestep_s)
        if limited is None:
            raise FailedError("a command of the policy is not one that a server sends")
        _check_ranges(info, limited)
        for output in info.outputs if last else ():
            most = np.array([np.inf if each is None else each for each in output.max_rate]) * info.timestep_s
            if last and (np.abs(limited[output.name] - last[output.name]) > most * (1 + 1e-9) + 1e-12).any():
                raise FailedError(f"'{output.name}' changes faster than its rate")
        last = limited
    for sent in line.sent:
        _check_ranges(info, sent)
    return stopped


def _check_ranges(info: deepbots_robot.BundleInfo, commands: Mapping[str, Any]) -> None:
    for output in info.outputs:
        if output.name not in commands:
            continue
        for value, low, high in zip(commands[output.name].tolist(), *output.range, strict=True):
            if (
                not np.isfinite(value)
                or (low is not None and value < low)
                or (high is not None and value > high)
            ):
                raise FailedError(f"'{output.name}' is {value}, and its range {low} .. {high}")


def _value(entry: Any, rng: np.random.Generator, step: int) -> Any:
    """A value of an input: within its range, at its ends, or as large as its type has it."""
    if entry.dtype == "bool":
        return rng.random(entry.shape) < 0.5
    if entry.dtype in ("uint8", "int64"):
        return rng.integers(0, 256, entry.shape).astype(entry.dtype)
    extreme = [0.0, -0.0, 1e-310, 1e300, -1e300, 1.7e308, 1e30, -1e6, 3.4e38][step % 9]
    match step % 4:
        case 0:
            value = rng.normal(0.0, 1.0, entry.shape)
        case 1:
            value = rng.normal(0.0, 100.0, entry.shape)
        case 2:
            value = np.full(entry.shape, extreme)
        case _:
            value = np.where(rng.random(entry.shape) < 0.5, extreme, rng.normal(0.0, 1.0, entry.shape))
    return np.clip(value, -3.4e38, 3.4e38).astype(entry.dtype)


def _memory(key: str) -> float:
    """Bytes of this process, as Linux counts them."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{key}:"):
            return 1024.0 * int(line.split()[1])
    return 0.0


def _clear_peak() -> None:
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def judged(number: int, seed: int, bases: Path, keep: Path | None = None) -> Outcome:
    """The outcome of a number, in a process of its own."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "bundle"
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            _in_child(number, seed, bases, folder, writer)
        os.close(writer)
        content = _read_all(reader, _KILLED_AFTER)
        os.close(reader)
        if content is None:
            os.kill(child, signal.SIGKILL)
        status = os.waitpid(child, 0)[1]
        outcome = Outcome(**json.loads(content)) if content else Outcome(number, "", "", "", "", "failed")
        if content is None:
            outcome.text = f"no end within {_KILLED_AFTER:g} s"
        elif not content:
            outcome.text = (
                f"the process ends by signal {os.WTERMSIG(status)}"
                if os.WIFSIGNALED(status)
                else "the process ends"
            )
        if outcome.end == "failed" and keep is not None and folder.exists():
            keep.mkdir(parents=True, exist_ok=True)
            shutil.copytree(
                folder, keep / str(number), symlinks=True, dirs_exist_ok=True, copy_function=_copied
            )
    return outcome


def _copied(source: str, target: str) -> None:
    if os.path.isfile(source) and os.path.getsize(source) < 200_000_000:
        shutil.copy2(source, target, follow_symlinks=False)


def _read_all(reader: int, seconds: float) -> bytes | None:
    """The output of a process until it ends; None if it does not end within `seconds`."""
    content = b""
    until = time.monotonic() + seconds
    while True:
        if not select.select([reader], [], [], max(0.0, until - time.monotonic()))[0]:
            return None
        part = os.read(reader, 1 << 16)
        if not part:
            return content
        content += part


def _in_child(number: int, seed: int, bases: Path, folder: Path, writer: int) -> None:
    """Examine a case and end."""
    outcome = Outcome(number, "", "", "", "", "failed", "it cannot be forged")
    try:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        os.chdir(folder.parent)
        terminal = os.open(folder.parent / "terminal", os.O_CREAT | os.O_RDWR)
        outcome = forge(number, seed, bases, folder)
        os.dup2(terminal, 2)
        os.dup2(terminal, 1)
        examine(outcome, folder, bases / "key.pub", bases / outcome.base)
        shown = Path(folder.parent / "terminal").read_text(errors="replace")
        if shown:
            outcome.end = "failed"
            outcome.text = f"the terminal shows: {shown[:300]}"
    except FailedError as error:
        outcome.end = "failed"
        outcome.text = str(error)
    except BaseException:  # noqa: BLE001  whatever it is, it is what is looked for
        outcome.end = "failed"
        outcome.text = traceback.format_exc()
    os.write(writer, json.dumps(asdict(outcome)).encode())
    os._exit(0)


# All of them


def run(count: int, seed: int, bases: Path, *, start: int = 0, keep: Path | None = None) -> list[Outcome]:
    """The outcomes of a range of numbers."""
    return [judged(number, seed, bases, keep) for number in range(start, start + count)]


def summary(outcomes: Sequence[Outcome]) -> str:
    """Counts by attacker and area, and what cost most."""
    lines = []
    for attacker in dict.fromkeys(ATTACKERS):
        own = [each for each in outcomes if each.attacker == attacker]
        ends = Counter(each.end for each in own)
        lines.append(
            f"{attacker:8} {len(own):5}  "
            + ", ".join(f"{count} {end}" for end, count in sorted(ends.items()))
        )
    slowest = max(outcomes, key=lambda each: each.seconds)
    largest = max(outcomes, key=lambda each: each.megabytes)
    lines.append(
        f"slowest load {slowest.seconds:.2f} s of CPU ({slowest.number}), largest {largest.megabytes:.0f} MB"
        f" ({largest.number})"
    )
    loaded = [each for each in outcomes if each.end == "loaded"]
    lines.append(f"of {len(loaded)} that load, {sum(each.stopped > 0 for each in loaded)} refuse a step")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bundle.forgeries", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--count", type=int, default=500, help="forgeries, by default 500")
    parser.add_argument("--seed", type=int, default=1, help="of the random numbers, by default 1")
    parser.add_argument("--start", type=int, default=0, help="the first number, by default 0")
    parser.add_argument("--only", type=int, help="one number alone")
    parser.add_argument(
        "--keep", type=Path, default=Path("build/forgeries"), help="where forgeries that fail are kept"
    )
    parser.add_argument(
        "--bases", type=Path, help="the folder of the bundles that are forged, by default a new one"
    )
    parser.add_argument("--json", action="store_true", help="print an outcome a line")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        bases = options.bases or Path(place) / "bases"
        if options.bases is None:  # in a process of its own: torch has threads, and what forks must have none
            code = (
                "from pathlib import Path; from tests.bundle.forgeries import prepare;"
                f" prepare(Path({str(bases)!r}))"
            )
            subprocess.run([sys.executable, "-c", code], check=True)
        start, count = (options.start, options.count) if options.only is None else (options.only, 1)
        outcomes = []
        for number in range(start, start + count):
            outcome = judged(number, options.seed, bases.resolve(), options.keep.resolve())
            outcomes.append(outcome)
            if options.json or options.only is not None:
                print(json.dumps(asdict(outcome)), flush=True)
            elif outcome.end == "failed":
                print(
                    f"{number} ({outcome.attacker}, {outcome.base}, {outcome.area}, {outcome.way}):"
                    f" {outcome.text}",
                    flush=True,
                )
        if not options.json:
            print(summary(outcomes))
    return int(any(outcome.end == "failed" for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
