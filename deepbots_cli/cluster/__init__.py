"""Work on processes of this machine, or over a Ray cluster.

session.py       the workers that the user requests; calls of a function, and the shards of a training, on
                 them
worker_pool.py   `WorkerPool`, the interface of both kinds of workers, and workers as processes of this
                 machine
worker.py        the side of a worker: its checks, a call, and the process
ray_cluster.py   workers of a Ray cluster; only this module imports Ray

The result of a training does not depend on where its parts run: shards and trainings are functions of the
scenario, the seed and their number. The results of a worker therefore may be lost, and are computed again
elsewhere.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepbots_cli.cluster.session import Cluster

__all__ = ["Cluster"]


def __getattr__(name: str) -> Any:
    """Import the cluster lazily: a worker needs none of it."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from deepbots_cli.cluster import session

    return getattr(session, name)
