"""The YAML language server, which VS Code and Neovim use, as a process of its own; `make editors` says where
it is."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.compiler.inventory import scenario_names
from deepbots_cli.scenario.json_schema import FILE_NAME, schema_text
from tests.lsp.client import Client, Message, position

ROOT = Path(__file__).parents[2]
CARTPOLE = (ROOT / "scenarios" / "cartpole.yaml").read_text(encoding="utf-8")
CURSOR = "§"


@dataclass(frozen=True)
class Typed:
    """What an editor shows while one types: the cursor is at `place` of the document at `uri`."""

    client: Client
    uri: str
    place: Message
    problems: list[Message]

    def _asked(self, method: str) -> Message:
        answer: Message = self.client.request(
            f"textDocument/{method}", {"textDocument": {"uri": self.uri}, "position": self.place}
        )
        return answer

    @property
    def hover(self) -> str:
        return str(self._asked("hover")["contents"]["value"])

    @property
    def offers(self) -> dict[str, Message]:
        return {item["label"]: item for item in self._asked("completion")["items"]}

    @property
    def messages(self) -> list[tuple[str, str]]:
        """The underlined text and the message of each problem."""
        lines = self.client.texts[self.uri].splitlines()
        return [(_underlined(lines, problem["range"]), problem["message"]) for problem in self.problems]


Type = Callable[[str, str], Typed]


def _underlined(lines: list[str], span: Message) -> str:
    start, end = span["start"], span["end"]
    line = lines[start["line"]]
    return line[start["character"] : end["character"] if end["line"] == start["line"] else None]


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the schemas; below `general` and `own` a comment leads to them."""
    root = tmp_path_factory.mktemp("scenarios")
    (root / FILE_NAME).write_text(schema_text(), encoding="utf-8")
    (root / "cartpole.schema.json").write_text(
        schema_text(scenario_names(api.load("cartpole"))), encoding="utf-8"
    )
    return root


@pytest.fixture(scope="session")
def client(folder: Path) -> Iterator[Client]:
    """The server, without its catalogs in the net."""
    server = os.environ.get("YAML_LANGUAGE_SERVER")
    if server is None:
        pytest.skip("`make editors` installs the server and runs this")
    settings = {
        "validate": True,
        "hover": True,
        "completion": True,
        "schemas": {(folder / FILE_NAME).as_uri(): "*.scenario.yaml"},
        "schemaStore": {"enable": False},
        "kubernetesCRDStore": {"enable": False},
    }
    capabilities = {
        "textDocument": {
            "hover": {"contentFormat": ["markdown"]},
            "completion": {"completionItem": {"snippetSupport": True, "documentationFormat": ["markdown"]}},
        },
        "workspace": {"configuration": True},
    }
    command = ["node", str(Path(server).resolve()), "--stdio"]
    with Client(folder, capabilities=capabilities, command=command, settings={"yaml": settings}) as connected:
        yield connected


def _typing(client: Client, folder: Path, ending: str, comment: str) -> Type:
    def typed(old: str, new: str) -> Typed:
        assert old in CARTPOLE
        text = comment + CARTPOLE.replace(old, new, 1)
        before, _, after = text.partition(CURSOR)
        uri = client.open(folder / f"case{len(client.texts)}{ending}", before + after)
        return Typed(client, uri, position(text, len(before)), client.published(uri))

    return typed


@pytest.fixture
def typed(client: Client, folder: Path) -> Type:
    """CartPole with a change, in a file that settings give the general schema; where the change has a `§`,
    the cursor is."""
    return _typing(client, folder, ".scenario.yaml", "")


@pytest.fixture
def typed_for(client: Client, folder: Path) -> Type:
    """The same in a file whose first line names the schema made for CartPole."""
    return _typing(client, folder, ".yaml", "# yaml-language-server: $schema=cartpole.schema.json\n")
