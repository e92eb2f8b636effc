"""Makes what the tests of a cluster share importable, and has workers for those of a module."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from deepbots_cli.cluster import Cluster
from tests.cluster.nodes import cluster_of_nodes

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    """Two workers on this machine."""
    with Cluster(workers=2) as started:
        yield started


@pytest.fixture(scope="module", params=["processes", pytest.param("ray", marks=pytest.mark.slow)])
def either(request: pytest.FixtureRequest) -> Iterator[Cluster]:
    """Two workers of each kind."""
    if request.param == "processes":
        with Cluster(workers=2) as started:
            yield started
        return
    pytest.importorskip("ray")
    with cluster_of_nodes(2) as nodes, Cluster(address=nodes.address) as started:
        yield started
