"""The processes that `--workers` and `--cluster` name."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from deepbots_cli.cli import terminal
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.words import counted


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    # `cpu_count` has all cores of the machine, also those that a container or `taskset` excludes.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_dividable(workers: int | None, address: str | None, count: int, reason: str) -> None:
    """Check that there are several parts for the workers.

    Raises:
        UsageError: There are workers for `count` parts, fewer than two; `reason` is the cause.
    """
    if workers is not None:
        option = "--workers"
    elif address is not None:
        option = "--cluster"
    else:
        option = None
    if option is not None and count < 2:
        raise UsageError(f"{option} has nothing to divide, since {reason}")


@contextmanager
def executor(
    workers: int | None, address: str | None, count: int | None = None, *, quiet: bool = False
) -> Iterator[Executor]:
    """Context with the executor of at most `count` calls or shards: this process, unless an option names
    workers, which end with the block.

    Raises:
        UsageError: Both options are given, or the cluster does not answer.
    """
    if workers is not None and address is not None:
        raise UsageError("--workers and --cluster cannot be combined")
    if workers is None and address is None:
        yield SERIAL
        return
    from deepbots_cli.cluster import Cluster

    if workers is not None:
        workers = workers if count is None else min(workers, count)
        if workers > (cores := available_cores()) and not quiet:
            terminal.note(
                f"{workers} workers share {counted(cores, 'core')}; more workers than cores are not faster"
            )
    with ExitStack() as stack:
        with terminal.transient_line("" if quiet or address is None else f"joining {address} ..."):
            cluster = stack.enter_context(Cluster(workers=workers, address=address))
        yield cluster
