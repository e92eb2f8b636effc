"""Random episodes as bytes; run as a program, it prints their digests for the cases that it reads from
stdin."""

from __future__ import annotations

import hashlib
import json
import struct
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from deepbots_cli import api
from deepbots_cli.runtime import Supervisor

Transition = tuple[Any, float, bool, bool, dict[str, Any]]


def actions(environment: Supervisor, seed: int) -> Iterator[Any]:
    """An endless row of random actions, the same for the same seed whatever the environment went through."""
    environment.action_space.seed(seed)
    while True:
        yield environment.action_space.sample()


def script_actions(environment: Supervisor, script: str) -> Iterator[Any]:
    """An endless row of the actions of a script of the scenario."""
    while True:
        yield environment.script(script)


def episode(
    environment: Supervisor, seed: int, steps: int, script: str | None = None
) -> Iterator[Transition]:
    """What `reset` and up to `steps` steps return, until the episode ends; with random actions, or by a
    script."""
    observation, info = environment.reset(seed=seed)
    del info["drawn"]  # of a reset alone
    yield observation, 0.0, False, False, info
    chosen = actions(environment, seed) if script is None else script_actions(environment, script)
    for _, action in zip(range(steps), chosen, strict=False):
        transition = environment.step(action)
        yield transition
        if transition[2] or transition[3]:
            return


def as_bytes(transition: Transition) -> bytes:
    observation, reward, terminated, truncated, info = transition
    terms = struct.pack(f"<{len(info['reward_terms'])}d", *info["reward_terms"].values())
    outcome = json.dumps(
        [
            terminated,
            truncated,
            info["is_success"],
            info["ended_by"],
            info["endings"],
            list(info["reward_terms"]),
        ]
    )
    parts = observation.values() if isinstance(observation, dict) else [observation]
    return (
        b"".join(np.asarray(part).tobytes() for part in parts)
        + struct.pack("<d", reward)
        + terms
        + outcome.encode()
    )


def record(environment: Supervisor, seed: int, steps: int = 40) -> list[bytes]:
    return [as_bytes(transition) for transition in episode(environment, seed, steps)]


def digest(environment: Supervisor, seed: int) -> str:
    """Of an episode and of the one after it, which takes no seed of its own."""
    first = record(environment, seed)
    environment.reset()
    second = list[bytes]()
    for _, action in zip(range(20), actions(environment, 5), strict=False):
        transition = environment.step(action)
        second.append(as_bytes(transition))
        if transition[2] or transition[3]:
            break
    return hashlib.sha256(b"".join([*first, *second])).hexdigest()


def main() -> None:
    """Cases on stdin: [[source, sets], ...]; digests on stdout, in that order."""
    digests = []
    for source, overrides in json.load(sys.stdin):
        environment = api.make(source, overrides=overrides)
        digests.append([digest(environment, 0)])
        environment.close()
    json.dump(digests, sys.stdout)


if __name__ == "__main__":
    main()
