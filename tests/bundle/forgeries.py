"""Forge bundles for as long as it takes, and judge what `load` makes of them.

    python -m tests.bundle.forgeries BASES COUNT SEED

Four attackers. `changes` changes files and no digests: the bundle is refused. `damage` computes the digests
of damaged files again: the bundle is refused, or its policy acts as the one that was exported. `digests`
computes digests, the metadata of the graph and the recorded steps again: the bundle is refused in one
sentence, or its policy gives finite commands within its ranges and rates whatever it is given. `signed` does
the same to a bundle with a signature, and `load` has the trusted key: the bundle is refused. With 0 for
COUNT, each way of `ways.py` with an expectation is forged once. `prepare` writes BASES, in another process:
torch has threads, and what forks must have none.

Each case runs in a process of its own with limits: 2 s of CPU for `load`, 500 MB beyond what was there
before. The same seed and number are the same forgery. What fails is printed with its number; the exit code
is then 1.
"""

from __future__ import annotations

import os
import random
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
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
from tests.bundle.ways import ACTS, WAYS, Way
from tests.fuzz.harness import in_fork

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
ATTACKERS = ("changes", "damage", "digests", "digests", "signed")
DAMAGED = ("bytes", "wire", "graph", "json", "parity")
MAX_SECONDS, MAX_MEMORY = 2.0, 500e6
_KILLED_AFTER = 60
"""Seconds of wall time, for a load that hangs."""
_MAX_SENTENCE = 1_500
_STEPS = 40


@dataclass
class Outcome:
    """What became of a forgery.

    Attributes:
        area: What was forged, of `WAYS`.
        way: The name of the way.
        end: `refused`, `loaded`, `unchanged` (the dice left the files as they were), or `failed`.
        text: The sentence of a refusal, by `load` or of the first refused step, or what failed.
        stopped: How many steps the policy of a loaded bundle refused.
    """

    number: int
    attacker: str = ""
    base: str = ""
    area: str = ""
    way: str = ""
    end: str = "failed"
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
    signature.write_key(folder / "key")
    for name in names:
        forged = Forged.of(write_bundle(folder / name, *BASES[name]))
        forged.files |= {
            bundle.README_NAME: b"Limits of the commands: 5 rad/s\n" * 9,
            bundle.SCENARIO_NAME: b"deepbots: 1\n",
        }
        forged.write(folder / name, digests=True)
        content = signature.sign((folder / name / bundle.BUNDLE_NAME).read_bytes(), folder / "key")
        (folder / name / bundle.SIGNATURE_NAME).write_bytes(content)
    return folder


# One case


def drawn(number: int, seed: int, bases: Sequence[str]) -> tuple[Outcome, Way]:
    """The attacker, the bundle and the way of a number."""
    rng = random.Random(f"{seed} {number}")
    attacker = ATTACKERS[number % len(ATTACKERS)]
    areas = {"damage": DAMAGED, "signed": tuple(WAYS)}.get(attacker, tuple(WAYS)[:-1])
    area = areas[number // len(ATTACKERS) % len(areas)]
    name = rng.choice([name for name, way in WAYS[area].items() if not (way.says and attacker == "damage")])
    way = WAYS[area][name]
    return Outcome(number, attacker, way.base if way.says else rng.choice(bases), area, name), way


def each_way() -> Iterator[tuple[Outcome, Way]]:
    """Each way with an expectation, by the attacker whom it is about."""
    rows = [(area, name, way) for area, ways in WAYS.items() for name, way in ways.items() if way.says]
    for number, (area, name, way) in enumerate(rows):
        attacker = "signed" if area == "signature" else "digests"
        yield Outcome(number, attacker, way.base, area, name), way


def forge(outcome: Outcome, way: Way, seed: int, bases: Path, folder: Path) -> None:
    """Write the forgery into `folder`, which is then a bundle."""
    forged = Forged.of(bases / outcome.base)
    if outcome.attacker != "signed":
        del forged.files[bundle.SIGNATURE_NAME]
    way.change(random.Random(f"{seed} {outcome.number} way"), forged)
    if outcome.attacker in ("digests", "signed"):
        if outcome.area in ("json", "behavior", "links", "signature"):
            forged.fit_graph()
        if outcome.area in ("graph", "behavior", "cost"):
            _record_again(forged)
    forged.write(folder, digests=outcome.attacker != "changes")


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
        names = [entry.name for entry in session.get_outputs()]
        arrays = forged.arrays
        steps = min(12, len(arrays["output/action"]))
        arrays = {name: rows[:steps].copy() for name, rows in arrays.items()} | {"starts": np.array([0])}
        memory = {
            entry["name"]: np.broadcast_to(entry["initial"], entry["shape"]).astype(entry["dtype"])
            for entry in forged.description["memory"]
        }
        for step in range(steps):
            feeds = {name[6:]: rows[step] for name, rows in arrays.items() if name.startswith("input/")}
            outputs = dict(zip(names, session.run(None, feeds | memory), strict=True))
            memory = {name: outputs[f"{name}_next"] for name in memory}
            for name in {f"output/{name}" for name in outputs} & arrays.keys():
                arrays[name][step] = outputs[name[7:]]
        forged.set_arrays(arrays)


def examine(outcome: Outcome, way: Way, folder: Path, bases: Path) -> None:
    """Load a forgery, and let its policy act if it loads; fills in the outcome. Runs in a process of its
    own."""
    before = _memory("VmRSS")
    _clear_peak()
    started = time.process_time()
    loaded = None
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            trusted = bases / "key.pub" if outcome.attacker == "signed" else None
            loaded = deepbots_robot.load(folder, trusted=trusted)
        except BundleError as error:
            outcome.end, outcome.text = "refused", str(error).removeprefix(f"{folder}: ")
        outcome.seconds = time.process_time() - started
        outcome.megabytes = (_memory("VmHWM") - before) / 1e6
        if loaded is not None:
            base = bases / outcome.base
            outcome.end = "unchanged" if _is_same(folder, base) else "loaded"
            if outcome.end == "loaded" and outcome.attacker not in ("damage", "digests"):
                raise FailedError(f"it loads for the attacker '{outcome.attacker}'")
            _act(loaded, deepbots_robot.load(base) if outcome.attacker == "damage" else loaded, outcome)
    is_meant = outcome.attacker == "digests" or outcome.area == "signature"
    what = outcome.text or outcome.end
    is_expected = what == "loaded" if way.says == ACTS else way.says in outcome.text
    for is_missed, text in (
        (
            not what.isprintable() or len(what) > _MAX_SENTENCE,
            f"the refusal is not a sentence: {what[:300]!r}",
        ),
        (outcome.seconds > MAX_SECONDS, f"{outcome.seconds:.2f} s of CPU until: {what}"),
        (outcome.megabytes > MAX_MEMORY / 1e6, f"{outcome.megabytes:.0f} MB until: {what}"),
        (warned, f"a warning: {warned and warned[0].message}"),
        (is_meant and not is_expected, f"expected '{way.says}', and it is {outcome.end}: {outcome.text}"),
    ):
        if is_missed:
            raise FailedError(text)


def _is_same(folder: Path, other: Path) -> bool:
    """Whether all files of a bundle are those of another one, with nothing reached by a link."""
    names = {path.relative_to(other) for path in other.rglob("*")} - {Path(bundle.SIGNATURE_NAME)}
    return all(
        (folder / name).is_file() and (folder / name).read_bytes() == (other / name).read_bytes()
        for name in names
    )


def _act(loaded: deepbots_robot.Bundle, like: deepbots_robot.Bundle, outcome: Outcome) -> None:
    """Let a policy act on random and extreme values, alone and in a server. It commands what one of `like`
    does, which gets no values that the policy refuses."""
    info, rng = loaded.info, np.random.default_rng(outcome.number)
    inputs, outputs = inputs_of(info), outputs_of(info)
    with suppress(ServeError):
        topics = {name: Topic(topic.topic, topic.type, topic.part) for name, topic in info.ros.items()}
        mapped([each.field for each in inputs], topics)
        mapped([each.field for each in outputs], topics, commands=True)
    policy, twin, limits = loaded.start(), like.start(), Commands(outputs)
    coming, sent, now, last = list[Arrival](), list[Any](), 100.0, dict[str, Any]()
    line: Any = SimpleNamespace(take=lambda: [coming.pop()], send=lambda values, stamp: sent.append(values))
    server = Server(loaded.start(), inputs, outputs, line, info.rate_hz, clock=lambda: now)
    for step in range(_STEPS if len(inputs) < 100 else 2):  # with thousands, onnxruntime takes 0.4 s for one
        if step % 15 == 14:
            policy.reset()
            twin.reset()
        values = {entry.name: _value(entry, rng, step) for entry in info.inputs}
        now += info.timestep_s
        coming.append(Arrival("robot", dict(values), now))
        server.turn()
        try:
            commands = policy.step(values)
        except BundleError as error:
            outcome.text = outcome.text or str(error)
            outcome.stopped += 1
            continue
        limited = limits.limit(commands, info.timestep_s)
        if limited is None:
            raise FailedError("a command of the policy is not one that a server sends")
        _check(info, commands)
        _check(info, limited, last)
        last, same = limited, twin.step(values)
        for output in info.outputs:
            if not np.allclose(same[output.name], commands[output.name], 0, 1e-5 * bundle.span_of(output)):
                raise FailedError(f"'{output.name}' is {commands[output.name]} and was {same[output.name]}")
    for each in sent:
        _check(info, each)


def _check(
    info: deepbots_robot.BundleInfo, commands: Mapping[str, Any], last: Mapping[str, Any] = {}
) -> None:
    """Commands are finite, within the ranges, and after `last` within the rates."""
    for output in info.outputs:
        low, high = np.array(output.range, float)
        value = commands.get(output.name, np.where(np.isnan(low), 0.0, low))
        if not np.isfinite(value).all() or (value < low).any() or (value > high).any():
            raise FailedError(f"'{output.name}' is {value}, and its range {low} .. {high}")
        reach = np.array(output.max_rate, float) * info.timestep_s * (1 + 1e-9) + 1e-12
        if last and (np.abs(value - last[output.name]) > reach).any():
            raise FailedError(f"'{output.name}' changes faster than its rate")


def _value(entry: Any, rng: np.random.Generator, step: int) -> Any:
    """A value of an input: within its range, at its ends, or as large as its type has it."""
    if entry.dtype == "bool":
        return rng.random(entry.shape) < 0.5
    if entry.dtype in ("uint8", "int64"):
        return rng.integers(0, 256, entry.shape).astype(entry.dtype)
    extreme = [0.0, -0.0, 1e-310, 1e300, -1e300, 1.7e308, 1e30, -1e6, 3.4e38][step % 9]
    value = rng.normal(0.0, [1.0, 100.0, 1.0, 1.0][step % 4], entry.shape)
    is_extreme = rng.random(entry.shape) < [0.0, 0.0, 1.0, 0.5][step % 4]
    return np.clip(np.where(is_extreme, extreme, value), -3.4e38, 3.4e38).astype(entry.dtype)


def _memory(key: str) -> float:
    """Bytes of this process, as Linux counts them."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next((1024.0 * int(line.split()[1]) for line in lines if line.startswith(f"{key}:")), 0.0)


def _clear_peak() -> None:
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def judged(outcome: Outcome, way: Way, seed: int, bases: Path) -> Outcome:
    """The outcome of a case, in a process of its own."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "bundle"
        result, _, ended_by = in_fork(partial(_in_child, outcome, way, seed, bases, folder), _KILLED_AFTER)
    outcome.text = f"the process ends by signal {ended_by}"
    return outcome if result is None else result


def _in_child(outcome: Outcome, way: Way, seed: int, bases: Path, folder: Path) -> Outcome:
    """Examine a case."""
    outcome.text = "it cannot be forged"
    terminal = folder.with_name("terminal")
    try:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        folder.mkdir()
        os.chdir(folder.parent)
        forge(outcome, way, seed, bases, folder)
        outcome.text = ""
        for stream in (1, 2):
            os.dup2(os.open(terminal, os.O_CREAT | os.O_RDWR | os.O_APPEND), stream)
        examine(outcome, way, folder, bases)
        if shown := terminal.read_text(errors="replace"):
            raise FailedError(f"the terminal shows: {shown[:300]}")
    except BaseException as error:  # noqa: BLE001  whatever it is, it is what is looked for
        outcome.end = "failed"
        outcome.text = str(error) if isinstance(error, FailedError) else traceback.format_exc()
    return outcome


# All of them


def main(bases: Path, count: int, seed: int) -> int:
    """Print what fails, and how many forgeries of each attacker are refused and loaded."""
    names = sorted(path.name for path in bases.iterdir() if path.is_dir())
    cases = (drawn(number, seed, names) for number in range(count)) if count else each_way()
    ends: Counter[str] = Counter()
    for case, way in cases:
        outcome = judged(case, way, seed, bases)
        ends[outcome.end] += 1
        if outcome.end == "failed":
            print(outcome, flush=True)
    print(", ".join(f"{number} {end}" for end, number in sorted(ends.items())))
    return int(ends["failed"] > 0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).resolve(), *map(int, sys.argv[2:])))
