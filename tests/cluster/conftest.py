"""Makes what the tests of a cluster share importable, and starts a Ray for those of a module."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from deepbots_cli.cluster import Cluster

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    """Two workers on this machine; for one module, since others join a cluster of several nodes in this process."""
    with Cluster(workers=2) as found:
        yield found
