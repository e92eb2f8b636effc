"""Makes the scenario of a failure smaller than Hypothesis can: entries are left out one by one, while the law
fails in the same way."""

from __future__ import annotations

import copy
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml
from hypothesis.errors import HypothesisDeprecationWarning

MAX_SECONDS = 60
Check = Callable[[dict[str, Any], Path], None]


def reduced(data: dict[str, Any], check: Check) -> str | None:
    """Return the text of the smallest scenario with which `check` fails as it does with `data`; None if it
    does not fail with `data` itself."""
    way = failure(data, check)
    end = time.monotonic() + MAX_SECONDS
    if way is None:
        return None
    is_smaller = True
    while is_smaller:
        is_smaller = False
        for path in list(paths(data)):
            smaller = without(data, path)
            if time.monotonic() < end and smaller is not None and failure(smaller, check) == way:
                data, is_smaller = smaller, True
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=110, default_flow_style=None)


def failure(data: dict[str, Any], check: Check) -> tuple[type[BaseException], str, int | None] | None:
    """Return how a check fails: the exception, and the line that raises it; None if it does not."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", HypothesisDeprecationWarning)  # `reject` outside of Hypothesis
        try:
            check(copy.deepcopy(data), Path(folder))
        except Exception as error:  # noqa: BLE001 - whatever a law meets is its result
            last = traceback.extract_tb(error.__traceback__)[-1]
            return type(error), last.filename, last.lineno
    return None


def paths(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all entries and items, an outer one before those in it."""
    steps: Sequence[Any] = ()
    if isinstance(data, dict):
        steps = list(data)
    elif isinstance(data, list):
        steps = range(len(data))
    for step in steps:
        yield (*path, step)
        yield from paths(data[step], (*path, step))


def without(data: dict[str, Any], path: tuple[Any, ...]) -> dict[str, Any] | None:
    """Return a copy without an entry; None if it is not there."""
    smaller = copy.deepcopy(data)
    holder: Any = smaller
    try:
        for step in path[:-1]:
            holder = holder[step]
        del holder[path[-1]]
    except (KeyError, IndexError, TypeError):
        return None
    return smaller
