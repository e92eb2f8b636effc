"""Damaged files of a run: a number becomes a change of one file, and a process of its own does what a user
would do with the run.

    echo '{"run": "/tmp/runs/ppo", "file": "run.json", "number": 7}' | python -m tests.fuzz.run_files --serve

The process answers each line with what is wrong, or with nothing. One that is taken down by a file has not
answered its line.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import resource
import shutil
import signal
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from tests.fuzz.harness import answers, peak_memory, serve
from tests.fuzz.mutations import damaged

ROOT = Path(__file__).parents[2]
MOST_MEMORY = 1 << 30
MOST_SECONDS = 60
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


def files_of(run: Path) -> list[str]:
    """The files of a run that are damaged, from its folder on."""
    names = [path.relative_to(run).as_posix() for path in sorted(run.rglob("*")) if path.is_file()]
    return [
        name
        for name in names
        if not name.endswith((".lock", "environment.py")) and not name.startswith("inputs/")
    ]


COMMANDS = [
    ("runs", "."),
    ("runs", "run"),
    ("eval", "run", "--episodes", "1"),
    ("report", "run", "--no-clips", "--episodes", "1"),
    ("diagnose", "run", "--only-logs"),
    ("plot", "run"),
    ("export", "run"),
    ("compare", "run", "other", "--episodes", "2"),
    ("inspect", "run"),
]
READERS = {
    "evaluations": (0, 1, 3, 4, 5, 6, 8),
    "monitor.csv": (0, 1, 4, 5, 3),
    "tensorboard": (1, 4, 5),
    "models": (2, 6, 7),
}
"""The commands that read a file, where not all do."""


def problem(run: Path, file: str, number: int) -> str:
    """The problem after a file was damaged; empty where there is none."""
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
        copy = Path(shutil.copytree(run, "run"))
        before = (copy / file).read_bytes()
        (copy / file).write_bytes(mutated(file, before, number))
        resumes = file.startswith("checkpoints/") or (file == "run.json" and number % 4 == 0)
        return _resumed(copy) if resumes else _commanded(file, number, run)


def _resumed(run: Path) -> str:
    import stand_in

    from deepbots_cli.errors import DeepbotsError
    from deepbots_cli.learning import resume

    before = _content(run)
    steps = max(int(path.name) for path in (run / "checkpoints").iterdir() if path.name.isdecimal())
    try:
        resume(run, total_timesteps=steps + 1, build=stand_in.build)
    except DeepbotsError as error:
        # Weights of another size are weights too: such a training begins, and ends when they become infinite.
        is_refused = "the training diverged" not in str(error)
        return "the run has changed" if is_refused and _content(run) != before else ""
    return ""


def _content(run: Path) -> dict[str, bytes]:
    return {
        str(path): path.read_bytes() for path in run.rglob("*") if path.is_file() and path.name != ".lock"
    }


def _commanded(file: str, number: int, run: Path) -> str:
    from deepbots_cli.cli import main

    folder = file.partition("/")[0]
    places = READERS.get(folder, range(len(COMMANDS)))
    words = COMMANDS[places[number % len(places)]]
    if "other" in words and not Path("other").exists():
        shutil.copytree(run, "other")
    before = _content(Path("run"))
    err = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
        code = main(list(words))
    errors = err.getvalue()
    if code not in (0, 1, 2) or "Traceback" in errors:
        return f"{' '.join(words)} ended with {code}: {errors[-600:]}"
    return "the run has changed" if code == 2 and _content(Path("run")) != before else ""


def main() -> None:
    os.environ["DEEPBOTS_DEBUG"] = "1"
    signal.signal(signal.SIGALRM, _late)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    serve(_answer)


def _answer(request: dict[str, Any]) -> str:
    signal.alarm(MOST_SECONDS)
    try:
        reason = problem(Path(request["run"]), request["file"], request["number"])
    except TimeoutError:  # a scenario may have episodes of any length
        reason = "" if request["file"] == "resolved.yaml" else f"it takes longer than {MOST_SECONDS} s"
    except Exception as error:  # an error of deepbots  # noqa: BLE001
        reason = f"{type(error).__name__}: {error}"[:600]
    finally:
        signal.alarm(0)
    return f"it takes {peak_memory() >> 20} MiB" if not reason and peak_memory() > MOST_MEMORY else reason


def _late(number: int, frame: FrameType | None) -> None:
    raise TimeoutError


def problems(run: Path, cases: Iterable[tuple[str, int]]) -> Iterator[str]:
    """What is wrong with changes, each a file and a number, by a process of its own; a further one after one
    that was taken down."""
    requests = ({"run": str(run), "file": file, "number": number} for file, number in cases)
    for request, reason in answers("tests.fuzz.run_files", requests, quiet=True):
        if reason != "":
            yield f"{request['file']} {request['number']}: {reason or 'the process ended'}"


if __name__ == "__main__":
    main()
