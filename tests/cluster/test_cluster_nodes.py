"""Shards on the nodes of a Ray cluster: the same result on one node, on two, and after nodes were lost and others joined."""

from __future__ import annotations

import os
import random
import shutil
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from test_cluster_fleet import act_at, outcomes
from test_cluster_shards import At, outcome, trained

from deepbots_cli import api
from deepbots_cli.cluster import Cluster
from deepbots_cli.learning import resume, train_group
from deepbots_cli.learning.shards import THIS_PROCESS

pytest.importorskip("ray")


@pytest.fixture
def nodes(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A Ray cluster on this machine, whose head has no CPU for workers."""
    from ray.cluster_utils import Cluster as Nodes

    folder = tempfile.mkdtemp(prefix="nodes-", dir="/tmp")  # sockets need a short path
    monkeypatch.setenv("RAY_TMPDIR", folder)
    found = Nodes(initialize_head=True, head_node_args={"num_cpus": 0, "object_store_memory": 150 << 20})
    try:
        yield found
    finally:
        found.shutdown()
        shutil.rmtree(folder, ignore_errors=True)


def add(nodes: Any) -> Any:
    return nodes.add_node(num_cpus=1, object_store_memory=100 << 20)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["PPO", "SAC"])
def test_a_node_that_is_lost_and_one_that_joins_change_nothing(nodes: Any, tmp_path: Path, name: str) -> None:
    living = [add(nodes), add(nodes)]
    generator = random.Random(0)

    def replace_a_node() -> None:
        nodes.remove_node(living.pop(generator.randrange(2)), allow_graceful=False)
        living.append(add(nodes))

    events = At(300, replace_a_node)
    with Cluster(address=nodes.address) as cluster:
        found = trained(name, tmp_path / "nodes", cluster, progress=events)
    assert events.is_done
    assert found == trained(name, tmp_path / "here", THIS_PROCESS)


@pytest.mark.slow
def test_a_training_that_stops_on_a_cluster_goes_on_in_this_process(nodes: Any, tmp_path: Path) -> None:
    add(nodes)
    stop = At(300, lambda: os.kill(os.getpid(), signal.SIGINT))
    with Cluster(address=nodes.address) as cluster:
        trained("PPO", tmp_path / "run", cluster, progress=stop)
    resume(tmp_path / "run")
    assert outcome(tmp_path / "run") == trained("PPO", tmp_path / "here", THIS_PROCESS)


@pytest.mark.slow
def test_trainings_go_on_when_a_node_is_lost_and_one_joins(nodes: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    living = [add(nodes), add(nodes)]
    compiled = api.compile("cartpole", overrides=["train.n_steps=64"])

    def replace_a_node() -> None:
        nodes.remove_node(living.pop(0), allow_graceful=False)
        living.append(add(nodes))

    replaced = act_at(monkeypatch, 1_000, 1, replace_a_node)
    with Cluster(address=nodes.address) as cluster:
        found = train_group(compiled, (0, 1, 2), group=tmp_path / "nodes", total_timesteps=4_000, progress=True, spread=cluster)
    assert replaced
    assert not found.failed
    train_group(compiled, (0, 1, 2), group=tmp_path / "here", total_timesteps=4_000)
    assert outcomes(tmp_path / "nodes") == outcomes(tmp_path / "here")
