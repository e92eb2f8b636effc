"""Shards on the nodes of a Ray cluster: the same result on one node, on two, and after nodes were lost and
others joined."""

from __future__ import annotations

import os
import random
import re
import signal
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any, ClassVar

import pytest
from test_cluster_fleet import act_at, outcomes
from test_cluster_shards import outcome, trained

from deepbots_cli import api
from deepbots_cli.cluster import Cluster
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import resume, train_group
from deepbots_cli.learning.calls import Watcher
from deepbots_cli.learning.executor import SERIAL
from tests.cluster.calls import square
from tests.cluster.nodes import cluster_of_nodes
from tests.learning.interruption import At

pytest.importorskip("ray")


@pytest.fixture
def nodes() -> Iterator[Any]:
    with cluster_of_nodes() as started:
        yield started


def add(nodes: Any) -> Any:
    return nodes.add_node(num_cpus=1, object_store_memory=100 << 20)


@pytest.mark.slow
def test_to_join_a_cluster_leaves_us_our_handler_of_sigterm(nodes: Any) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with Cluster(address=nodes.address):
        assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.slow
@pytest.mark.parametrize("name", ["PPO", "SAC"])
def test_a_node_that_is_lost_and_one_that_joins_change_nothing(nodes: Any, tmp_path: Path, name: str) -> None:
    living = [add(nodes), add(nodes)]
    generator = random.Random(0)

    def replace_a_node() -> None:
        nodes.remove_node(living.pop(generator.randrange(2)), allow_graceful=False)
        living.append(add(nodes))

    events = At(150, replace_a_node)
    with Cluster(address=nodes.address) as cluster:
        result = trained(name, tmp_path / "nodes", cluster, progress=events)
    assert events.is_done
    assert result == trained(name, tmp_path / "here", SERIAL)


@pytest.mark.slow
def test_a_training_that_stops_on_a_cluster_goes_on_in_this_process(nodes: Any, tmp_path: Path) -> None:
    add(nodes)
    stop = At(300, lambda: os.kill(os.getpid(), signal.SIGINT))
    with Cluster(address=nodes.address) as cluster:
        trained("PPO", tmp_path / "run", cluster, progress=stop)
    resume(tmp_path / "run")
    assert outcome(tmp_path / "run") == trained("PPO", tmp_path / "here", SERIAL)


@pytest.mark.slow
def test_a_node_without_deepbots_that_joins_gets_no_work(nodes: Any, tmp_path: Path) -> None:
    class Notes(Watcher):
        texts: ClassVar[list[str]] = []

        def on_note(self, item: int, text: str) -> None:
            self.texts.append(text)

    (tmp_path / "deepbots_cli.py").write_text("raise ImportError")
    add(nodes)
    with Cluster(address=nodes.address) as cluster:

        def items() -> Iterator[int]:
            yield 0
            nodes.add_node(num_cpus=1, object_store_memory=100 << 20, env_vars={"PYTHONPATH": str(tmp_path)})
            yield from takewhile(lambda _: not Notes.texts, range(4, 5_000))
            yield from (1, 2)

        first, *_, last = cluster.map(square, items(), watcher=Notes())
    assert (first, last) == (0, 4)
    (note,) = Notes.texts
    assert re.fullmatch(
        r"a node that joined gets no work: the worker on .* cannot import deepbots; install the same version"
        r" there",
        note,
    )


@pytest.mark.slow
def test_trainings_go_on_when_a_node_is_lost_and_one_joins(
    nodes: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    living = [add(nodes), add(nodes)]
    compiled = api.compile("cartpole", overrides=["train.n_steps=64"])

    def replace_a_node() -> None:
        nodes.remove_node(living.pop(0), allow_graceful=False)
        living.append(add(nodes))

    replaced = act_at(monkeypatch, 1_000, 1, replace_a_node)
    with Cluster(address=nodes.address) as cluster:
        training = train_group(
            compiled,
            (0, 1, 2),
            group=tmp_path / "nodes",
            total_timesteps=4_000,
            progress=True,
            executor=cluster,
        )
    assert replaced
    assert not training.failed
    train_group(compiled, (0, 1, 2), group=tmp_path / "here", total_timesteps=4_000)
    assert outcomes(tmp_path / "nodes") == outcomes(tmp_path / "here")


@pytest.mark.slow
def test_a_node_without_deepbots_is_refused(
    nodes: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "other" / "deepbots_cli"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("raise ImportError('it is not installed')")
    with monkeypatch.context() as patched:
        patched.setenv("PYTHONPATH", str(package.parent))
        add(nodes)
    with (
        Cluster(address=nodes.address) as cluster,
        pytest.raises(UsageError, match="a worker cannot import deepbots"),
    ):
        trained("PPO", tmp_path / "run", cluster)


def test_an_address_at_which_nobody_answers_is_refused() -> None:
    with pytest.raises(UsageError, match=r"nobody answers at 127\.0\.0\.1:9"), Cluster(address="127.0.0.1:9"):
        pass
    with pytest.raises(UsageError, match="is not an address of a Ray cluster"), Cluster(address="nowhere"):
        pass
