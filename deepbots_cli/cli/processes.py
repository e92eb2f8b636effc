"""The processes that `--workers` and `--cluster` name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from deepbots_cli.cli import terminal
from deepbots_cli.errors import UsageError

if TYPE_CHECKING:
    from deepbots_cli.cluster import Cluster


@contextmanager
def cluster(workers: int | None, address: str | None, *, quiet: bool) -> Iterator[Cluster | None]:
    """The workers, which end with the block; None if no option names any.

    Raises:
        UsageError: Both options are given, or the cluster does not answer.
    """
    if workers is not None and address is not None:
        raise UsageError("--workers and --cluster cannot be combined")
    if workers is None and address is None:
        yield None
        return
    from deepbots_cli.cluster import Cluster

    found = Cluster(workers=workers, address=address)
    with terminal.transient_line("" if quiet else "starting workers ..." if workers else f"joining {address} ..."):
        found.__enter__()
    try:
        yield found
    finally:
        found.__exit__()
