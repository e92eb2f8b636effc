"""The workers that the user requests: some processes of this machine, or a Ray cluster that runs already."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack
from functools import partial
from shlex import quote
from typing import TYPE_CHECKING, Self, Unpack

from deepbots_cli.api import build as api_build
from deepbots_cli.cluster.local_processes import LocalProcesses
from deepbots_cli.cluster.ray_cluster import RayCluster
from deepbots_cli.cluster.tasks import Tasks
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.learning.calls import Attempt
from deepbots_cli.learning.executor import CallOptions, Item, Result

if TYPE_CHECKING:  # these modules import torch, which tests of scenarios do not need
    from deepbots_cli.learning.environments import WorldFactory
    from deepbots_cli.learning.runs.run import Run
    from deepbots_cli.program.task import Training
    from deepbots_cli.rollout.sharded_collector import ShardPool

MAX_WORKERS = 1024


class Cluster:
    """Workers for the shards of a training, and for several trainings, evaluations or tests (`map`); a
    context manager.

    Args:
        workers: Use this number of processes on this machine. They start when there is work, and end with the
            block.
        address: Join the Ray cluster at `HOST:PORT`, or the one of this machine (`auto`).
    """

    is_here = False

    def __init__(self, *, workers: int | None = None, address: str | None = None) -> None:
        if (workers is None) == (address is None):
            raise UsageError("name either a number of workers or the address of a cluster")
        if workers is not None and not 1 <= workers <= MAX_WORKERS:
            raise UsageError(f"the number of workers must be from 1 to {MAX_WORKERS}, not {workers}")
        self._pool: RayCluster | LocalProcesses = (
            RayCluster(address) if address is not None else LocalProcesses(workers or 1)
        )

    def __enter__(self) -> Self:
        self._pool.__enter__()
        self._pool.set_message_if_lost("to continue a training, use `deepbots resume`")
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.__exit__()

    @property
    def workers(self) -> int:
        """The number of workers: the requested one, or the number of CPUs of the cluster."""
        return self._pool.workers

    def shards(
        self, stack: ExitStack, run: Run, training: Training, build: WorldFactory, note: Callable[[str], None]
    ) -> ShardPool:
        """Return the shards of a training on the workers.

        Raises:
            UsageError: A worker does not see the run, or has another version of deepbots or of its libraries.
        """
        from deepbots_cli.cluster.shards import RemoteShards
        from deepbots_cli.learning.shards import world_numbers

        if not isinstance(build, partial) or build.func is not api_build:
            raise UsageError("the argument `build` makes worlds in this process only; leave out the workers")
        pool = RemoteShards(self._pool, run, build.keywords["permissions"], world_numbers(training), note)
        stack.callback(pool.close)
        self._pool.set_message_if_lost(f"to continue: deepbots resume {quote(str(run.path))}")
        return pool

    def map(
        self,
        function: Callable[[Item, Attempt], Result],
        items: Iterable[Item],
        **options: Unpack[CallOptions],
    ) -> Generator[Result | DeepbotsError | None]:
        """Call a function with each item on the workers, as many at a time as there are workers; see
        `Executor.map`."""
        return Tasks(self._pool, options).run(function, items)
