"""Trainings are equal to the bit wherever their shards run: in this process, on workers, and on one or two
nodes of a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from test_cluster_shards import CASES, trained

from deepbots_cli import api
from deepbots_cli.cluster import Cluster
from deepbots_cli.learning.executor import SERIAL
from tests.cluster.nodes import cluster_of_nodes

NODES = {"one node": (2,), "two nodes": (1, 1)}
"""The CPUs of each node."""


@pytest.fixture(scope="module", params=["workers", *NODES])
def executor(request: pytest.FixtureRequest) -> Iterator[Cluster]:
    """The workers for all cases of an executor."""
    if request.param == "workers":
        with Cluster(workers=2) as started:
            yield started
        return
    pytest.importorskip("ray")
    head, *others = NODES[request.param]
    with cluster_of_nodes(head) as nodes:
        for cpus in others:
            nodes.add_node(num_cpus=cpus, object_store_memory=100 << 20)
        with Cluster(address=nodes.address) as started:
            yield started


@pytest.fixture(scope="module")
def in_this_process(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Any]:
    """What a training makes in this process."""

    @cache
    def of(name: str, shards: int) -> Any:
        return trained(name, tmp_path_factory.mktemp("here") / "run", SERIAL, shards)

    return of


def check(
    executor: Cluster, in_this_process: Callable[[str, int], Any], folder: Path, name: str, shards: int
) -> None:
    whole = result, episodes, evaluations = trained(name, folder / "run", executor, shards)
    assert whole == in_this_process(name, shards)
    assert len(episodes) >= 20
    assert evaluations
    assert bool(result["stages"]) == ("curriculum" in name)


@pytest.mark.slow
@pytest.mark.parametrize("shards", [2, 4])
@pytest.mark.parametrize("name", list(CASES)[:5])
def test_a_training_is_the_same_on_workers_and_nodes(
    executor: Cluster, in_this_process: Callable[[str, int], Any], tmp_path: Path, name: str, shards: int
) -> None:
    check(executor, in_this_process, tmp_path, name, shards)


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["workers"], indirect=True)
@pytest.mark.parametrize("name", list(CASES)[5:])
def test_so_is_that_of_other_algorithms(
    executor: Cluster, in_this_process: Callable[[str, int], Any], tmp_path: Path, name: str
) -> None:
    check(executor, in_this_process, tmp_path, name, 4)


@pytest.mark.parametrize("scenario", ["cartpole", "pit_escape"])
def test_one_shard_is_the_training_without_shards(scenario: str) -> None:
    assert api.compile(scenario, overrides=["train.shards=1"]).digest == api.compile(scenario).digest
