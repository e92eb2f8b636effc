"""What can be done about findings: fixes as they are, guesses called so, suppressions, all safe fixes at
once; formatting and outline."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from deepbots_cli.document.layout import canonical_text
from deepbots_cli.lsp.server import minimal_edits
from deepbots_cli.lsp.workspace import Document
from tests.lsp.client import Client, edited

FIX_ALL = ["source.fixAll.deepbots"]


@pytest.fixture
def changed(client, pit):
    """Changes PitEscape, and waits for the findings."""

    def change(*changes: tuple[str, str]) -> list:
        text = client.texts[pit]
        for old, new in changes:
            assert text.count(old) == 1
            text = text.replace(old, new)
        client.change(pit, text)
        return client.findings(pit)

    return change


def text_after(client, uri, action):
    """The text after an action."""
    changes = action["edit"]["changes"]
    assert set(changes) == {uri}
    return edited(client.texts[uri], changes[uri])


@pytest.mark.parametrize(
    ("right", "wrong", "title", "safe"),
    [
        ("timestep: 32", "timest¦op: 32", "Replace `timestop` with `timestep`", True),
        ("{type: gyro,", "{type: gyro¦s,", "Replace `gyros` with `gyro`", True),
        ("delta(metric)", "delta(¦metrik)", "Replace `metrik` with `metric` (check it)", False),
        ("timestep: 32 ms", "timestep: 32 mil¦liseconds", "Replace `milliseconds` with `ms`", True),
    ],
)
def test_a_fix_is_offered_where_its_finding_is_and_puts_it_right(
    client, pit, changed, right, wrong, title, safe
):
    original = client.texts[pit]
    changed((right, wrong.replace("¦", "")))
    (action,) = client.actions(pit, wrong)
    assert (action["title"], action["kind"], action.get("isPreferred", False)) == (title, "quickfix", safe)
    assert text_after(client, pit, action) == original
    assert [finding["code"] for finding in action["diagnostics"]] == [
        finding["code"] for finding in client.diagnostics[pit]["diagnostics"]
    ]
    assert client.actions(pit, "sum¦mary") == []


def test_a_fix_behind_an_emoji_replaces_just_its_word(client, pit, changed):
    changed(("gyro: {type: gyro, link: ball}", '"😀𝄞ü": {type: gyros, link: ball}'))
    (action,) = client.actions(pit, "type: gyr¦os")
    assert text_after(client, pit, action) == client.texts[pit].replace("gyros", "gyro")


def test_a_warning_can_be_suppressed_on_its_line_and_is_gone_then(client, pit, changed):
    changed(("signals:\n", "signals:\n  spare: time  # not yet\n"))
    (action,) = [
        offer for offer in client.actions(pit, "spa¦re: time") if offer["title"].startswith("Suppress")
    ]
    assert action["title"] == "Suppress DB205 (unused-definition) on this line"
    client.change(pit, text_after(client, pit, action))
    assert "  spare: time  # not yet  # deepbots: ignore[DB205]\n" in client.texts[pit]
    assert client.findings(pit) == []


def test_a_second_code_goes_into_the_comment_that_is_there(client, pit, changed):
    changed(("signals:\n", "signals:\n  spare: 1 / (time - 1 s)  # deepbots: ignore[DB405]\n"))
    (action,) = [offer for offer in client.actions(pit, "spa¦re: 1") if offer["title"].startswith("Suppress")]
    assert "# deepbots: ignore[DB405, DB205]\n" in text_after(client, pit, action)


def test_an_error_cannot_be_suppressed(client, pit, changed):
    changed(("timestep: 32", "timestop: 32"))
    assert [
        offer["title"] for offer in client.actions(pit, "time¦stop") if "Suppress" in offer["title"]
    ] == []


def test_a_suppression_that_would_become_part_of_a_text_is_not_offered(client, pit, changed):
    changed(("signals:\n", 'signals:\n  spare: "time\n    + 1 s"\n'))
    assert [entry["code"] for entry in client.diagnostics[pit]["diagnostics"]] == ["DB205"]
    assert [entry for entry in client.actions(pit, "spa¦re") if entry["title"].startswith("Suppress")] == []


def test_all_safe_fixes_are_one_action_and_guesses_are_left(client, pit, changed):
    original = client.texts[pit]
    changed(
        ("timestep: 32", "timestop: 32"),
        ("{type: gyro,", "{type: gyros,"),
        ("delta(metric)", "delta(metrik)"),
    )
    (action,) = client.actions(pit, "time¦stop", only=FIX_ALL)
    assert text_after(client, pit, action) == original.replace("delta(metric)", "delta(metrik)")
    (edit,) = action["edit"]["changes"][pit]
    first, last = (
        client.texts[pit].count("\n", 0, client.texts[pit].index(word)) for word in ("timestop", "gyros")
    )
    assert edit["range"]["start"]["line"] == first
    assert edit["range"]["end"]["line"] == last  # the cursor elsewhere stays where it is
    assert client.actions(pit, "time¦stop", only=["refactor"]) == []


@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_all_safe_fixes_leave_line_ends_and_a_byte_order_mark_as_they_are(client, pit, mark):
    original = mark + client.texts[pit].replace("\n", "\r\n")
    client.change(pit, original.replace("timestep: 32", "timestop: 32"))
    client.findings(pit)
    (action,) = client.actions(pit, "time¦stop", only=FIX_ALL)
    assert text_after(client, pit, action) == original


@pytest.mark.slow
def test_a_client_that_can_ask_later_gets_the_edit_when_it_asks_and_versions_with_it(project):
    able = {
        "textDocument": {"codeAction": {"resolveSupport": {"properties": ["edit"]}}},
        "workspace": {"workspaceEdit": {"documentChanges": True}},
    }
    with Client(project, capabilities=able) as own:
        path = project / "scenarios" / "pit_escape.yaml"
        uri = own.open(path, path.read_text().replace("timestep: 32", "timestop: 32"))
        own.findings(uri)
        (action,) = own.actions(uri, "time¦stop", only=["source"])
        assert "edit" not in action
        (change,) = own.request("codeAction/resolve", action)["edit"]["documentChanges"]
        assert change["textDocument"] == {"uri": uri, "version": 1}
        assert edited(own.texts[uri], change["edits"]) == path.read_text()


def test_fixes_of_a_text_that_is_gone_are_not_offered(client, pit, changed):
    changed(("timestep: 32", "timestop: 32"))
    client.change(pit, "# one line more\n" + client.texts[pit])
    assert client.actions(pit, "time¦stop") == []


def test_a_fix_in_an_included_file_is_offered_there(client, ball, project):
    path = project / "robots" / "epuck.yaml"
    piece = client.open(path, path.read_text().replace("infrared", "infrard"))
    while not client.published(piece):
        pass
    (action,) = client.actions(piece, "infr¦ard")
    assert text_after(client, piece, action) == path.read_text()
    client.close(piece)


def test_formatting_makes_what_fmt_makes_and_leaves_broken_text_alone(client, pit, changed):
    original = client.texts[pit]
    options = {"textDocument": {"uri": pit}, "options": {"tabSize": 4, "insertSpaces": True}}
    assert client.request("textDocument/formatting", options) == []
    client.change(pit, original.replace("world: {timestep: 32 ms,", "world:    {timestep:   32 ms ,"))
    assert edited(client.texts[pit], client.request("textDocument/formatting", options)) == original
    client.change(pit, original.replace("world: {", "world: {{"))
    assert client.request("textDocument/formatting", options) == []


@pytest.mark.parametrize(
    "text",
    [
        "name:  a\r\nsummary: b\n",
        "name: a  \nsummary: b   \n\n\n\r\n",
        "name: a\r\n\r\n\r\n\r\nsummary: b",
        "a: 1\nb: 2\r\n",
    ],
)
def test_an_edit_never_begins_or_ends_within_a_line_end(text):
    document = Document("untitled:a", 1, f"deepbots: 1\r\n{text}", Path("a.yaml"))
    for after in (
        canonical_text(document.text),
        document.text.replace("\r\n", "\n"),
        document.text.replace("\r\n", "\r\n\r\n"),
    ):
        for edit in minimal_edits(document, after):
            start, end = document.lines.offset(edit.range.start), document.lines.offset(edit.range.end)
            assert document.text[:start] + edit.new_text + document.text[end:] == after


def test_the_outline_shows_sections_and_the_names_in_them(client, pit):
    symbols = client.request("textDocument/documentSymbol", {"textDocument": {"uri": pit}})
    names = {symbol["name"]: [inner["name"] for inner in symbol.get("children", [])] for symbol in symbols}
    assert names["signals"] == ["reach", "metric"]
    assert names["parameters"] == ["radius", "time_limit", "speed"]
    assert list(names)[:3] == ["deepbots", "name", "summary"]


def test_the_server_writes_nothing(project, tmp_path):
    def state() -> dict[str, str]:
        return {
            str(path): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(Path(project).rglob("*"))
            if path.is_file()
        }

    before = state()
    with Client(project) as own:
        path = project / "scenarios" / "pit_escape.yaml"
        uri = own.open(path, path.read_text().replace("timestep: 32", "timestop: 32"))
        own.findings(uri)
        own.actions(uri, "time¦stop", only=FIX_ALL)
        own.request(
            "textDocument/formatting",
            {"textDocument": {"uri": uri}, "options": {"tabSize": 2, "insertSpaces": True}},
        )
    assert state() == before
