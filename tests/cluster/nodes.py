"""Clusters of several nodes on this machine."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def cluster_of_nodes(head_cpus: int = 0) -> Iterator[Any]:
    """A Ray cluster on this machine; `head_cpus` is the number of CPUs of its head."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster as Nodes

    folder = tempfile.mkdtemp(prefix="nodes-", dir="/tmp")  # sockets need a short path
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("RAY_TMPDIR", folder)
        nodes = Nodes(
            initialize_head=True, head_node_args={"num_cpus": head_cpus, "object_store_memory": 150 << 20}
        )
        try:
            yield nodes
        finally:
            nodes.shutdown()
            shutil.rmtree(folder, ignore_errors=True)
