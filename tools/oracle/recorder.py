"""Records what one checkout of the package does.

`__main__` runs this file as a script, in a process whose working directory and PYTHONPATH are the checkout.
The script uses only the command line of deepbots and `deepbots_cli.make`, which older and newer versions
share.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import io
import json
import os
import runpy
import sys
import traceback
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

STEPS, STEPS_OF_GOLDEN, SAMPLE_EVERY, PREFIX = 300, 30, 50, 8
INFO = ("is_success", "ended_by", "endings", "action_mask", "each", "reward_terms")
LAYOUT = ("messages", "message_fields", "observation", "action", "timing")


def command(*arguments: str) -> tuple[Any, str]:
    """Run `python -m deepbots_cli` in this process. Returns the JSON that it prints and an empty text, or
    None and what went wrong."""
    out, errors = io.StringIO(), io.StringIO()
    code: object = None
    sys.argv = ["deepbots", *arguments]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        try:
            runpy.run_module("deepbots_cli", run_name="__main__")
        except SystemExit as left:
            code = left.code
        except Exception as error:  # noqa: BLE001  # a fault of the package is part of the record
            code = _failure(error)
    try:
        return json.loads(out.getvalue()), ""
    except ValueError:
        return None, f"exit {code}: {errors.getvalue().strip()[:300]}"


def findings(inputs: Path) -> dict[str, Any]:
    """Each input with its findings: code, severity, line, column, and the file relative to the folder of the
    input."""
    os.chdir(inputs)
    columns = (
        json.loads(Path("columns.json").read_text(encoding="utf-8")) if Path("columns.json").exists() else {}
    )
    record: dict[str, Any] = {}
    for number, name in enumerate(json.loads(Path("inputs.json").read_text(encoding="utf-8"))):
        told, failure = command("lint", "--format", "json", "--preview", "--fail-on", "never", name)
        if failure:
            record[name] = [["exception", failure, 0, 0, ""]]
        else:
            record[name] = sorted(
                [
                    entry["code"],
                    entry["severity"],
                    *_place(entry["start"], columns.get(entry["file"], {})),
                    _beside(name, entry["file"]),
                ]
                for entry in told["findings"]
            )
        if number % 50 == 0:
            gc.collect()
    return record


def _place(start: dict[str, int], columns: dict[str, list[list[int]]]) -> list[int]:
    """Line and column; of inputs under new names (`renamed.py`) the column in the old text."""
    line, column = start["line"], start["column"]
    new, old = max((pair for pair in columns.get(str(line), [[1, 1]]) if pair[0] <= column), default=[1, 1])
    return [line, old + column - new]


def _beside(name: str, file: str) -> str:
    """The path of a file relative to the folder of the input; of a file outside the inputs only its name."""
    here = Path.cwd()
    inside = Path(os.path.abspath(file)).is_relative_to(here)
    return Path(os.path.relpath(file, here / Path(name).parent)).as_posix() if inside else Path(file).name


def motion(inputs: Path) -> dict[str, Any]:
    """Each shipped scenario of the checkout, and each golden input without findings, with its spaces, layouts
    and motion."""
    cases = [(f"scenarios/{path.name}", path, STEPS) for path in sorted(Path("scenarios").glob("*.yaml"))]
    golden = sorted((inputs / "golden/lint/ok").glob("*.yaml"))
    cases += [(path.relative_to(inputs).as_posix(), path, STEPS_OF_GOLDEN) for path in golden]
    record: dict[str, Any] = {}
    for name, path, steps in cases:
        record[name] = {}
        if steps == STEPS:
            told, failure = command("inspect", str(path), "--json")
            record[name] = (
                {"error": failure} if failure else {key: told[key] for key in LAYOUT if key in told}
            )
            record[name]["digest"] = "" if failure else told["scenario"].get("digest", "")
        try:
            record[name] |= _moved(name, path, steps)
        except Exception as error:  # noqa: BLE001  # a fault of the package is part of the record
            record[name]["error"] = _failure(error)
        gc.collect()
    return record


def _moved(name: str, path: Path, steps: int) -> dict[str, Any]:
    import numpy as np

    import deepbots_cli

    environment = deepbots_cli.make(str(path))
    try:
        seed = zlib.crc32(name.encode())
        generator, episode, whole = np.random.default_rng(seed), 0, hashlib.sha256()
        observation, info = environment.reset(seed=seed)
        whole.update(exact(observation) + b"|" + exact({key: info[key] for key in INFO if key in info}))
        start, taken, samples = whole.hexdigest()[:12], [], {}
        for step in range(1, steps + 1):
            action = _action(environment.action_space, generator, info.get("action_mask"))
            observation, reward, terminated, truncated, info = environment.step(action)
            ending = exact({key: info[key] for key in INFO if key in info})
            content = exact(observation)
            outcome = f"{float(reward).hex()} {terminated} {truncated} {info.get('ended_by')}"
            whole.update(b"%b|%b|%b|" % (content, outcome.encode(), ending))
            taken.append(f"{_short(content)} {_short(ending)} {outcome}")
            if step % SAMPLE_EVERY == 0:
                samples[str(step)] = {"reward": repr(float(reward)), "observation": _prefix(observation)}
            if terminated or truncated:
                episode += 1
                observation, info = environment.reset(seed=seed + episode)
                whole.update(exact(observation))
        spaces = {
            "observation_space": str(environment.observation_space),
            "action_space": str(environment.action_space),
        }
        return {
            **spaces,
            "start": start,
            "steps": taken,
            "samples": samples,
            "episodes_ended": episode,
            "sha256": whole.hexdigest(),
        }
    finally:
        environment.close()


def _action(space: Any, generator: Any, mask: Any) -> Any:
    """A random action, among those that the mask allows."""
    import numpy as np
    from gymnasium import spaces

    match space:
        case spaces.Discrete():
            allowed = np.arange(space.n) if mask is None else np.flatnonzero(mask)
            return int(space.start + generator.choice(allowed))
        case spaces.MultiDiscrete():
            return generator.integers(space.nvec).astype(space.dtype)
        case spaces.Dict():
            return {key: _action(part, generator, None) for key, part in space.items()}
        case spaces.Box():
            return generator.uniform(space.low, space.high).astype(space.dtype)
    raise TypeError(f"no random action for {space}")


def exact(value: Any) -> bytes:
    """All bytes of a value, with the types and shapes of arrays; a dictionary by its sorted keys."""
    import numpy as np

    if isinstance(value, Mapping):
        return b"{%b}" % b",".join(
            str(key).encode() + b":" + exact(value[key]) for key in sorted(value, key=str)
        )
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}".encode() + value.tobytes()
    return repr(value.item() if isinstance(value, np.generic) else value).encode()


def _prefix(observation: Any) -> Any:
    """The first numbers of an observation, exactly."""
    if isinstance(observation, Mapping):
        return {str(key): _prefix(observation[key]) for key in sorted(observation)}
    return [float(number).hex() for number in observation.ravel()[:PREFIX]]


def _short(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:12]


def _failure(error: Exception) -> str:
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {str(error)[:300]} ({Path(place.filename).name}:{place.name})"


def main() -> None:
    part, inputs, target = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    import deepbots_cli

    if Path.cwd() not in Path(str(deepbots_cli.__file__)).resolve().parents:
        sys.exit(f"{deepbots_cli.__file__} is not the package in {Path.cwd()}")
    record = {"motion": motion, "findings": findings}[part](inputs)
    lines = (f"{json.dumps(name)}: {json.dumps(record[name], sort_keys=True)}" for name in sorted(record))
    target.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
