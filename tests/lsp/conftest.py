"""A project with copies of the shipped scenarios and robots, and one server for all tests that leave its
settings alone."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.lsp.client import ROOT, Client


@pytest.fixture(scope="session")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    for name in ("scenarios", "robots"):
        shutil.copytree(ROOT / name, folder / name)
    (folder / "deepbots.toml").write_text("")
    return folder


@pytest.fixture(scope="session")
def server(project: Path) -> Iterator[Client]:
    """The server ends by itself, and writes nothing to standard error."""
    with Client(project) as started:
        yield started
    assert (started.code, started.errors, started.logged) == (0, "", [])


@pytest.fixture
def client(server: Client, project: Path) -> Iterator[Client]:
    """The server; what a test opens is closed after it, but for what `pit` and `ball` open."""
    yield server
    kept = {(project / "scenarios" / f"{name}.yaml").as_uri() for name in ("pit_escape", "find_ball_random")}
    for uri in server.texts.keys() - kept:
        server.close(uri)


@pytest.fixture
def pit(client: Client, project: Path) -> Iterator[str]:
    """The address of PitEscape, opened and analyzed; changes of a test are undone."""
    yield from _shown(client, project / "scenarios" / "pit_escape.yaml")


@pytest.fixture
def ball(client: Client, project: Path) -> Iterator[str]:
    """The same of FindBallRandom, which includes the e-puck."""
    yield from _shown(client, project / "scenarios" / "find_ball_random.yaml")


def _shown(client: Client, path: Path) -> Iterator[str]:
    uri = client.open(path) if path.as_uri() not in client.texts else path.as_uri()
    client.restore(path)
    assert client.findings(uri) == []
    yield uri
    client.restore(path)
