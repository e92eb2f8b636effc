"""The examples of docs/editors.md about the language server are true, and its settings can be read."""

from __future__ import annotations

import json
import re
import tomllib

import pytest

from tests.lsp.client import ROOT

PAGE = (ROOT / "docs" / "editors.md").read_text(encoding="utf-8")
TABLE = PAGE[PAGE.index("| you write |") : PAGE.index("The text may be invalid")]
ROWS = re.findall(r"^\| (`.*?`(?:, \w+)?) \| (.*) \|$", TABLE.replace("\\|", "¦"), re.MULTILINE)

PLACES = {
    "`joint: ¦`": ("joint: pitch", "joint: ¦"),
    "`sensors: {gyro: {type: ¦`": ("{gyro: {type: gyro, link: ball}", "{gyro: {type: ¦, link: ball}"),
    "`norm(position(¦`": ("norm(position(roller).xy)", "norm(position(¦"),
    "`radius: 2.7 ¦`": ("radius: 2.7 m", "radius: 2.7 ¦"),
}
"""What stands in PitEscape, and what is written in its place."""


def quoted(text: str) -> list[str]:
    return re.findall(r"`([^`]+)`", text)


def test_the_table_has_examples():
    assert len(ROWS) == 10
    assert set(PLACES) <= {row for row, _ in ROWS}


@pytest.mark.parametrize("row", PLACES)
def test_an_example_of_completion_is_what_the_page_says(client, pit, row):
    old, new = PLACES[row]
    start = client.texts[pit].index(old)
    client.change(pit, client.texts[pit].replace(old, new.replace("¦", "")))
    expected = quoted(dict(ROWS)[row])
    assert expected
    assert set(expected) <= set(client.labels_at(pit, start + new.index("¦")))


def test_the_example_of_a_finding_is_what_the_page_says(client, pit):
    client.change(pit, client.texts[pit].replace("world: {timestep", "world: {timestop"))
    (finding,) = client.findings(pit)
    (action,) = client.actions(pit, "time¦stop")
    example = dict(ROWS)["`world: {timestop: 32 ms`"]
    assert finding["code"] in example
    assert f'"{action["title"]}"' in example


@pytest.mark.parametrize("row", [row for row, _ in ROWS if row.endswith("hover")])
def test_an_example_of_hover_is_what_the_page_says(client, pit, row):
    text = client.hover(pit, quoted(row)[0])
    words = quoted(dict(ROWS)[row]) or dict(ROWS)[row].split(", ")
    assert [word for word in words if word not in text] == []


@pytest.mark.parametrize("row", [row for row, _ in ROWS if row.endswith("definition")])
def test_an_example_of_a_definition_is_what_the_page_says(client, pit, ball, row):
    uri = ball if "include" in row else pit
    ((file, line, _),) = client.definition(uri, quoted(row)[0])
    if "include" in row:
        assert (file, dict(ROWS)[row]) == ("epuck.yaml", "that file")
    else:
        assert dict(ROWS)[row] == f"line {line + 1} of `{file}`"


def test_the_example_of_references_is_what_the_page_says(client, pit):
    ((uses, text),) = [row for row in ROWS if row[0].endswith("references")]
    assert text == f"the {len(client.references(pit, quoted(uses)[0]))} places that use it"


def test_the_settings_of_editors_can_be_read_and_start_the_server():
    (toml,) = re.findall(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    helix = tomllib.loads(toml)["language-server"]["deepbots"]
    assert [helix["command"], *helix["args"]] == ["deepbots", "lsp"]
    settings = [
        json.loads(text) for text in re.findall(r"^```json\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    ]
    (code,) = [editor for editor in settings if "glspc.serverCommand" in editor]
    assert [code["glspc.serverCommand"], *code["glspc.serverCommandArguments"]] == ["deepbots", "lsp"]
    assert 'cmd = { "deepbots", "lsp" }' in PAGE
