"""Run folders that mean harm: a number becomes a change of a run, and a process with limits does with it what
a user would do.

    python -m tests.hostile.runs RUN 0 200

A server imports everything once and forks a process for each command, which takes at most `MOST_SECONDS` of
CPU and `MOST_MEMORY` more than the server.
"""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import random
import resource
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from tests.fuzz.harness import SERVE, answers, in_fork, rise_of_memory, serve
from tests.fuzz.mutations import damaged

ROOT = Path(__file__).parents[2]
MOST_SECONDS = 10
MOST_MEMORY = 500 * 10**6
COMMANDS = [
    ("runs", "."),
    ("report", "run", "--no-clips", "--episodes", "1"),
    ("plot", "run"),
    ("diagnose", "run", "--only-logs"),
    ("export", "run", "--force"),
]
READERS = [
    ("runs", "run"),
    ("eval", "run", "--episodes", "1"),
    ("compare", "run", "run", "--episodes", "2"),
    ("inspect", "run"),
    ("resume",),
]
"""Further commands, on a run with damaged bytes."""
RECORDS = ("run.json", "evaluations/0001.json")
FOREIGN = "met: the task is solved"
"""A line that no command may print."""

HOSTILE: list[Any] = [
    *(
        None,
        True,
        -1,
        0,
        1,
        2**31,
        2**63,
        -(10**12),
        10**12,
        10**25,
        0.5,
        1e308,
        -1e308,
        float("nan"),
        float("inf"),
    ),
    *("", "x", "x" * 100_000, [], {}, [[[]]], [0] * 1_000, "../../x", "\u0000\u202e"),
    *({"dtype": "S2000000000", "value": ["x", "y"]}, {"dtype": "O", "value": 1}),
]
HEADERS = [b"<f4", b"<f8", b"<i8", b"|O'", b"|S9", b"(3,", b"(4,", b"(99999999999,", b"(-1,", b"()", b"True"]


def damaged_json(data: bytes, chance: random.Random) -> bytes:
    """One value replaced, removed or repeated, or a change of the text."""
    if chance.random() < 0.3:
        return damaged(data, chance)
    value = json.loads(data)
    inner = value
    while True:
        keys = list(inner) if isinstance(inner, dict) else list(range(len(inner)))
        key = chance.choice(keys)
        if not isinstance(inner[key], dict | list) or not inner[key] or chance.random() < 0.3:
            break
        inner = inner[key]
    match chance.randrange(6):
        case 0:
            del inner[key]
        case 1 if isinstance(inner, list):
            inner *= chance.choice((2, 1_000))
        case _:
            inner[key] = chance.choice(HOSTILE)
    return json.dumps(value).encode()


def flipped(data: bytes, chance: random.Random) -> bytes:
    """Some bytes changed, or the file cut off."""
    changed = bytearray(data)
    for _ in range(chance.choice((1, 1, 3, 30))):
        if changed:
            changed[chance.randrange(len(changed))] = chance.randrange(256)
    return bytes(changed[: chance.randrange(len(changed) + 1)] if chance.random() < 0.2 else changed)


def damaged_zip(data: bytes, chance: random.Random) -> bytes:
    """One member changed, removed, renamed or packed, with sums that are right; or the archive itself
    changed."""
    if chance.random() < 0.3:
        return flipped(data, chance)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = chance.choice(sorted(members))
    way = chance.randrange(6)
    stream = io.BytesIO()
    match way:
        case 0:
            del members[name]
        case 1:
            members["more.npy"] = members.pop(name)
        case 2:
            head, tail = members[name][:128], members[name][128:]
            members[name] = head.replace(chance.choice(HEADERS), chance.choice(HEADERS), 1) + tail
        case 3 if name == "data":
            members[name] = damaged_json(members[name], chance)
        case _:
            members[name] = flipped(members[name], chance)
    with zipfile.ZipFile(
        stream, "w", zipfile.ZIP_DEFLATED if way == 4 and chance.random() < 0.2 else zipfile.ZIP_STORED
    ) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    return stream.getvalue()


def mutated(file: str, data: bytes, number: int) -> bytes:
    """The file after the change of a number."""
    chance = random.Random(f"{file.partition('.out.tfevents')[0]} {number}")  # without the time in the name
    if file.endswith((".npz", ".zip")):
        return damaged_zip(data, chance)
    if file.endswith(".json"):
        return damaged_json(data, chance)
    return flipped(data, chance) if "tfevents" in file else damaged(data, chance)


Change = Callable[[Path, random.Random], None]


def _files(run: Path) -> list[Path]:
    return sorted(path for path in run.rglob("*") if path.is_file() and not path.is_symlink())


def damaged_bytes(run: Path, chance: random.Random) -> None:
    for _ in range(chance.choice((1, 1, 3))):
        file = chance.choice(_files(run))
        file.write_bytes(mutated(str(file.relative_to(run)), file.read_bytes(), chance.randrange(10**6)))


def _changed_record(run: Path, chance: random.Random, change: Callable[[dict[str, Any]], None]) -> None:
    file = run / chance.choice(RECORDS)
    record = json.loads(file.read_text())
    change(record)
    file.write_text(json.dumps(record))


def _inner(record: Any, chance: random.Random) -> tuple[Any, Any]:
    """A container in a record and one of its keys, as often at its root as inside."""
    while True:
        keys = list(record) if isinstance(record, dict) else range(len(record))
        key = chance.choice(keys)
        if not isinstance(record[key], dict | list) or not record[key] or chance.random() < 0.3:
            return record, key
        record = record[key]


def filling(chance: random.Random) -> Any:
    """Up to 2 MB of many small values."""
    value, size = chance.choice(
        [
            (0, 3),
            ({}, 4),
            ([], 4),
            ([0], 5),
            ({"a": 0}, 10),
            ("", 4),
            (None, 6),
            ([[]], 6),
            ({"steps": 1}, 14),
        ]
    )
    count = chance.choice((200_000, 2_000_000)) // size
    return [value] * count if chance.random() < 0.6 else {f"{index:x}": value for index in range(count // 2)}


def unknown_keys(run: Path, chance: random.Random) -> None:
    def change(record: dict[str, Any]) -> None:
        inner, key = _inner(record, chance)
        if isinstance(inner, list):
            inner.append(filling(chance))
        else:
            inner[chance.choice(("x", "unknown", key))] = filling(chance)

    _changed_record(run, chance, change)


def many_keys(run: Path, chance: random.Random) -> None:
    (run / chance.choice(RECORDS)).write_text(json.dumps(filling(chance)))


def huge_numbers(run: Path, chance: random.Random) -> None:
    numbers = [
        10**30,
        -(10**30),
        2**63 - 1,
        2**53 + 1,
        10**400,
        1e308,
        -1e308,
        1e-320,
        -1,
        10**18,
        float("nan"),
    ]

    def change(record: dict[str, Any]) -> None:
        for _ in range(chance.choice((1, 1, 5))):
            inner, key = _inner(record, chance)
            inner[key] = chance.choice(numbers)

    _changed_record(run, chance, change)


def wrong_types(run: Path, chance: random.Random) -> None:
    def change(record: dict[str, Any]) -> None:
        for _ in range(chance.choice((1, 2, 10))):
            inner, key = _inner(record, chance)
            inner[key] = chance.choice(HOSTILE)

    _changed_record(run, chance, change)


def deep_nesting(run: Path, chance: random.Random) -> None:
    sign, end = chance.choice([("[", "]"), ('{"a":', "}"), ('[{"a":', "}]")])
    depth = chance.choice((100, 3_000, 300_000))
    deep = sign * depth + "0" + end * depth
    file = run / chance.choice((*RECORDS, "evaluations/training.jsonl"))
    text = file.read_text()
    at = text.index(":") + 1
    file.write_text(text[:at] + deep + "," + text[at:] if chance.random() < 0.5 else deep)


def long_lines(run: Path, chance: random.Random) -> None:
    file = run / "evaluations" / "training.jsonl"
    if chance.random() < 0.4:
        file = run / "monitor.csv"
        head, _, row = file.read_text().partition("\n")
        file.write_text(head + "\n" + row + "x" * chance.choice((10**5, 10**6, 10**7)) + "\n")
        return
    length = chance.choice((250, 2_000, 100_000))
    returns = [chance.gauss(0, 1) for _ in range(length)]
    lines = chance.choice((20, 2_000))
    line = {"stage": None, "is_best": False, "returns": returns, "successes": [False] * length}
    with file.open("w") as stream:
        for number in range(min(lines, 40_000_000 // (30 * length))):
            stream.write(json.dumps({"steps": 100 * number, **line}) + "\n")


def links(run: Path, chance: random.Random) -> None:
    match chance.randrange(4):
        case 0:  # the run itself
            run.rename(run.with_name("of_another"))
            run.symlink_to("of_another")
        case 1:
            file = chance.choice(_files(run))
            file.rename(run.parent / "kept")
            file.symlink_to(run.parent / "kept")
        case 2:
            file = chance.choice(_files(run))
            file.unlink()
            os.mkfifo(file)
        case _:
            folder = run / chance.choice(("models", "evaluations", "tensorboard", "inputs"))
            shutil.rmtree(folder)
            folder.symlink_to("/")


def missing_files(run: Path, chance: random.Random) -> None:
    for file in chance.sample(_files(run), chance.choice((1, 1, 3))):
        file.unlink()


def exchanged(run: Path, chance: random.Random) -> None:
    first, second = chance.sample(_files(run), 2)
    data = first.read_bytes()
    first.write_bytes(second.read_bytes())
    second.write_bytes(data)


def foreign_lines(run: Path, chance: random.Random) -> None:
    """Texts with line breaks, commands to a terminal, and signs that turn a line around."""
    text = chance.choice(("\n", "\r\n", "\u2028", "\x1b[2J\n", "\u202e\n", "\x85")) + FOREIGN + "\n"

    def change(record: dict[str, Any]) -> None:
        for key, value in record.items():
            if isinstance(value, str) and key not in ("status", "digest", "evaluated", "started", "updated"):
                if chance.random() < 0.3:
                    record[key] = value + text
            elif isinstance(value, dict) and value and chance.random() < 0.2:
                record[key] = {name + text: entry for name, entry in value.items()}

    _changed_record(run, chance, change)


CHANGES: tuple[Change, ...] = (
    damaged_bytes,
    unknown_keys,
    many_keys,
    huge_numbers,
    wrong_types,
    deep_nesting,
    long_lines,
    links,
    missing_files,
    exchanged,
    foreign_lines,
)


def changed(run: Path, number: int) -> str:
    """Change a run in place; return the kind of the change."""
    change = CHANGES[number % len(CHANGES)]
    change(run, random.Random(number))
    return change.__name__


def tried(run: Path, number: int) -> dict[str, Any]:
    """Change a copy of a run and apply each command; the CPU seconds, bytes and problems of the worst."""
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
        shutil.copytree(run, "run")
        kind = changed(Path("run"), number)
        is_damaged = kind == damaged_bytes.__name__
        outcomes = [outcome_of(words) for words in (*COMMANDS, *(READERS if is_damaged else ()))]
    return {
        "kind": kind,
        "seconds": max(seconds for seconds, _, _ in outcomes),
        "memory": max(memory for _, memory, _ in outcomes),
        "problems": [f"{kind} {number}: {problem}" for *_, problem in outcomes if problem],
    }


def outcome_of(words: tuple[str, ...]) -> tuple[float, int, str]:
    """Run a command in a forked process; the CPU seconds and bytes that it took, and what is wrong."""
    answer, seconds, signal = in_fork(lambda: _commanded(words), 20 * MOST_SECONDS)
    if answer is None:
        return seconds, 0, f"{' '.join(words)} was ended by signal {signal} after {seconds:.1f} s"
    return seconds, *answer


def _commanded(words: tuple[str, ...]) -> tuple[int, str]:
    from deepbots_cli.cli import main

    resource.setrlimit(resource.RLIMIT_CPU, (MOST_SECONDS, MOST_SECONDS))
    codes = list[int]()
    before = _content(Path("run")) if words in READERS else {}
    run = _resumed if words == ("resume",) else partial(main, list(words))
    with Path("output").open("w+") as output:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            memory = rise_of_memory(lambda: codes.append(run()))
        output.seek(0)
        text = output.read(10**7)
    (code,) = codes
    label = " ".join(words)
    if code not in (0, 1, 2) or "Traceback" in text:
        return memory, f"{label} ended with {code}: {text[-600:]}"
    if words in READERS and code == 2 and _content(Path("run")) != before:
        return memory, f"{label} is refused, and has changed the run"
    if any(line.startswith(FOREIGN) for line in text.splitlines()) or "\x1b[2J" in text or "\u202e" in text:
        return memory, f"{label} prints a line of the run"
    if len(text) > 10**6:
        return memory, f"{label} prints {len(text)} letters"
    return memory, f"{label} takes {memory / 1e6:.0f} MB" if memory > MOST_MEMORY else ""


def _resumed() -> int:
    """Continue the run for a step; the exit code. Weights of another size are weights too: such a training
    begins, and ends when they become infinite."""
    import stand_in

    from deepbots_cli.errors import DeepbotsError
    from deepbots_cli.learning import resume

    steps = max(int(path.name) for path in Path("run/checkpoints").iterdir() if path.name.isdecimal())
    try:
        resume(Path("run"), total_timesteps=steps + 1, build=stand_in.build)
    except DeepbotsError as error:
        return 1 if "the training diverged" in str(error) else 2
    return 0


def _content(run: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in _files(run) if path.name != ".lock"}


def main() -> None:
    """Answer each line, a run and a number, with what came of it."""
    import matplotlib.figure  # noqa: F401
    import mujoco  # noqa: F401
    import stable_baselines3  # noqa: F401
    import tensorboard.backend.event_processing.event_accumulator  # noqa: F401
    import torch

    from deepbots_cli.cli import main  # noqa: F401

    os.environ["DEEPBOTS_DEBUG"] = "1"
    torch.set_num_threads(1)  # a pool of threads is lost in a fork
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    gc.freeze()  # copies look for garbage among their own objects alone
    serve(lambda request: tried(Path(request["run"]), request["number"]))


def outcomes(run: Path, numbers: range) -> Iterator[dict[str, Any]]:
    """The outcomes of the changes of these numbers, by a server."""
    requests = ({"run": str(run), "number": number} for number in numbers)
    return (outcome for _, outcome in answers("tests.hostile.runs", requests))


if __name__ == "__main__":
    if sys.argv[1:] == [SERVE]:
        main()
    else:
        for outcome in outcomes(Path(sys.argv[1]).resolve(), range(*map(int, sys.argv[2:]))):
            print(json.dumps(outcome), flush=True)
