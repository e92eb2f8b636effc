"""Findings as one types: the same as of `deepbots lint`, at places of the protocol, of the newest text
only."""

from __future__ import annotations

import shutil

import pytest

from tests.lsp.client import OURS, Client, position

RED, WARNING = 1, 2


@pytest.fixture
def world(client, project, tmp_path):
    """A scenario of its own for each test, in a project of its own."""
    shutil.copytree(project / "scenarios", tmp_path / "scenarios")
    shutil.copytree(project / "robots", tmp_path / "robots")
    (tmp_path / "deepbots.toml").write_text("")

    def write(name: str, *changes: tuple[str, str]):
        path = tmp_path / "scenarios" / f"{name}.yaml"
        text = path.read_text(encoding="utf-8")
        for old, new in changes:
            assert text.count(old) == 1
            text = text.replace(old, new)
        path.write_text(text, encoding="utf-8")
        return path

    return write


def codes_of(findings):
    return [finding["code"] for finding in findings]


def underlined_text(client, uri, finding):
    """The text that a finding underlines."""
    lines = client.texts[uri].split("\n")
    start, end = finding["range"]["start"], finding["range"]["end"]
    assert start["line"] == end["line"]
    piece = lines[start["line"]].encode("utf-16-le")[2 * start["character"] : 2 * end["character"]]
    return piece.decode("utf-16-le")


@pytest.mark.parametrize(
    ("old", "new", "code", "underlined"),
    [
        ("timestep:", "timestop:", "DB101", "timestop"),
        ("delta(metric)", "delta(metrik)", "DB402", "metrik"),
        ("32 ms", "32 msek", "DB501", "msek"),
        ("joint: pitch", "joint: pich", "DB302", "pich"),
    ],
)
def test_a_finding_has_its_code_its_severity_and_its_exact_place(client, world, old, new, code, underlined):
    uri = client.open(world("pit_escape", (old, new)))
    (only,) = client.findings(uri)
    assert (only["code"], only["severity"], only["source"]) == (code, RED, "deepbots")
    assert underlined_text(client, uri, only) == underlined
    client.close(uri)


def test_columns_count_units_of_utf_16_behind_emoji_and_other_letters(client, world):
    summary = 'summary: "Ä 😀", parameters'
    uri = client.open(
        world(
            "pit_escape", ("parameters: {radius: 2.7 m,", "parameters: {radius: 2.7 m,  # 😀\n  ü😀: 1 m, ")
        )
    )
    (only,) = client.findings(uri)
    assert underlined_text(client, uri, only) == "ü😀"
    assert only["range"]["end"] == {"line": 4, "character": 5}
    client.close(uri)
    assert position(summary, summary.index("parameters"))["character"] == summary.index("parameters") + 1


def test_a_finding_behind_an_emoji_of_its_line_is_where_the_editor_shows_it(client, world):
    uri = client.open(
        world("pit_escape", ("gyro: {type: gyro, link: ball}", 'gyro: {type: "😀😀", link: bal}'))
    )
    findings = client.findings(uri)
    assert "DB104" in codes_of(findings)
    assert (
        underlined_text(client, uri, next(finding for finding in findings if finding["code"] == "DB104"))
        == '"😀😀"'
    )
    client.close(uri)


def test_each_change_of_the_text_is_looked_at_and_the_last_word_is_about_the_last_text(client, world):
    uri = client.open(world("pit_escape"))
    text = client.texts[uri]
    assert client.findings(uri) == []
    for number in range(10):
        client.change(uri, text.replace("timestep", f"timestep{number}"))
    client.change(uri, text.replace("delta(metric)", "delta(metrics)"))
    (only,) = client.findings(uri)
    assert underlined_text(client, uri, only) == "metrics"
    client.change(uri, text)
    assert client.findings(uri) == []
    client.close(uri)


def test_a_mistake_in_an_included_file_is_reported_there_with_the_place_of_the_include(client, world):
    path = world("find_ball_random")
    piece = path.parents[1] / "robots" / "epuck.yaml"
    piece.write_text(piece.read_text().replace("link: base_link", "link: base_lin"))
    uri = client.open(path)
    assert client.findings(uri) == []
    (only,) = client.diagnostics[piece.as_uri()]["diagnostics"]
    assert only["code"] == "DB201"
    (chain,) = only["relatedInformation"]
    assert (chain["location"]["uri"], chain["message"]) == (uri, "included from here")
    client.close(uri)
    assert client.published(piece.as_uri()) == []


def test_of_an_open_included_file_the_text_in_the_editor_counts(client, world):
    path = world("find_ball_random")
    uri = client.open(path)
    assert client.findings(uri) == []
    piece = client.open(path.parents[1] / "robots" / "epuck.yaml")
    assert client.findings(piece) == []
    client.change(piece, client.texts[piece].replace("infrared", "infrarot"))
    for _ in range(3):  # whatever is published of a text is of that text
        (only,) = client.findings(piece)
        assert (only["code"], underlined_text(client, piece, only)) == ("DB104", "infrarot")
        client.change(piece, "# one line more\n" + client.texts[piece])
    client.close(piece)
    client.close(uri)


def test_yaml_that_is_neither_a_scenario_nor_a_piece_of_an_open_one_is_left_alone(client, project):
    uri = client.open(project / "workflow.yaml", "on: [push]\njobs: {\n")
    assert client.findings(uri) == []
    assert client.ask("completion", uri, "jobs: {¦") is None
    assert client.ask("hover", uri, "o¦n: [push]") is None
    assert client.actions(uri, "o¦n: [push]") == []
    assert (
        client.request(
            "textDocument/formatting",
            {"textDocument": {"uri": uri}, "options": {"tabSize": 2, "insertSpaces": True}},
        )
        is None
    )
    client.close(uri)


def test_a_second_place_that_explains_a_finding_comes_with_it(client, world):
    uri = client.open(world("pit_escape", ("signals:\n", "signals:\n  radius: time\n")))
    (only,) = [finding for finding in client.findings(uri) if finding["code"] == "DB202"]
    (first,) = only["relatedInformation"]
    assert first["message"] == "first defined here"
    assert first["location"]["range"]["start"] == {"line": 3, "character": 13}
    client.close(uri)


def test_a_comment_suppresses_a_finding_and_without_it_the_finding_is_reported(client, world):
    unused = ("signals:\n", "signals:\n  spare: time  # deepbots: ignore[DB205]\n")
    uri = client.open(world("pit_escape", unused))
    assert client.findings(uri) == []
    client.change(uri, client.texts[uri].replace("spare: time  # deepbots: ignore[DB205]", "spare: time"))
    (only,) = client.findings(uri)
    assert only["code"] == "DB205"
    assert only["severity"] == WARNING
    assert only["tags"] == [1]
    client.close(uri)


def test_the_settings_of_the_project_of_the_file_count(client, world):
    path = world("pit_escape", ("signals:\n", "signals:\n  spare: time\n"))
    settings = path.parents[1] / "deepbots.toml"
    settings.write_text('[lint]\nignore = ["DB205"]\n')
    uri = client.open(path)
    assert client.findings(uri) == []
    settings.write_text("")
    client.notify("textDocument/didSave", {"textDocument": {"uri": uri}})
    while not (findings := client.published(uri)):
        pass
    assert codes_of(findings) == ["DB205"]
    client.close(uri)


@pytest.mark.slow
def test_invalid_settings_are_reported_once_and_the_file_is_linted_without_them(project, world):
    path = world("pit_escape", ("timestep:", "timestop:"))
    (path.parents[1] / "deepbots.toml").write_text("[lint]\nignore = 3\n")
    with Client(project) as own:
        uri = own.open(path)
        assert codes_of(own.findings(uri)) == ["DB101"]
        own.change(uri, own.texts[uri] + "\n")
        own.findings(uri)
        assert len(own.logged) == 1
        assert "'ignore' must be a list of codes" in own.logged[0]


@pytest.mark.slow
def test_a_client_that_counts_in_bytes_is_answered_in_bytes(project, world):
    capabilities = {"general": {"positionEncodings": ["utf-8", "utf-16"]}}
    path = world(
        "pit_escape", ("parameters: {radius: 2.7 m,", "parameters: {radius: 2.7 m,  # 😀\n  ü😀: 1 m, ")
    )
    with Client(project, capabilities=capabilities) as own:
        assert own.server["capabilities"]["positionEncoding"] == "utf-8"
        (only,) = own.findings(own.open(path))
        assert only["range"]["end"] == {"line": 4, "character": 2 + len("ü😀".encode())}


def test_a_document_without_a_file_is_linted_in_the_folder_of_the_editor(client):
    uri = "untitled:Untitled-1"
    document = {
        "uri": uri,
        "languageId": "yaml",
        "version": 1,
        "text": "deepbots: 1\nname: New\nrobots: {cart: {urdf: cartpole}}\n",
    }
    client.notify("textDocument/didOpen", {"textDocument": document})
    client.versions[uri] = 1
    assert "DB102" in codes_of(client.findings(uri))
    client.notify("textDocument/didClose", {"textDocument": {"uri": uri}})


def test_two_documents_that_are_not_files_yet_have_findings_of_their_own(client):
    texts = {"untitled:One": "deepbots: 1\nwrold: {}\n", "untitled:Two": "deepbots: 1\nrobot: {}\n"}
    for uri, text in texts.items():
        client.notify(
            "textDocument/didOpen",
            {"textDocument": {"uri": uri, "languageId": "yaml", "version": 1, "text": text}},
        )
        client.texts[uri] = text
        client.versions[uri] = 1
    for uri, key in zip(texts, ("wrold", "robot"), strict=True):
        assert [
            underlined_text(client, uri, finding)
            for finding in client.findings(uri)
            if finding["code"] == "DB101"
        ] == [key]
    for uri in texts:
        client.close(uri)


@pytest.mark.parametrize(
    "text",
    [
        '"deepbots": 1\nwrold: {}\n',
        "{deepbots: 1, wrold: {}}\n",
        "# JSON\n{\n  'deepbots': 1,\n  wrold: {}}\n",
    ],
)
def test_a_scenario_whose_first_key_is_quoted_or_in_brackets_has_findings_too(client, project, text):
    uri = client.open(project / "scenarios" / "odd.yaml", text)
    assert "DB101" in codes_of(client.findings(uri))
    client.close(uri)


def test_findings_of_a_closed_document_are_taken_back(client, world):
    uri = client.open(world("pit_escape", ("timestep:", "timestop:")))
    assert codes_of(client.findings(uri)) == ["DB101"]
    client.close(uri)
    assert client.published(uri) == []


def test_a_robot_file_that_changes_on_the_disk_is_read_again(project, world):
    path = world("pit_escape")
    with Client(
        project, capabilities={"workspace": {"didChangeWatchedFiles": {"dynamicRegistration": True}}}
    ) as own:
        uri = own.open(path)
        assert own.findings(uri) == []
        (registered,) = own.registered
        assert registered["method"] == "workspace/didChangeWatchedFiles"
        assert any("urdf" in watcher["globPattern"] for watcher in registered["registerOptions"]["watchers"])
        robot = path.parents[1] / "robots" / "urdf" / "roller.urdf"
        robot.write_text(robot.read_text().replace('<joint name="pitch"', '<joint name="nod"'))
        own.notify("workspace/didChangeWatchedFiles", {"changes": [{"uri": robot.as_uri(), "type": 2}]})
        while not (findings := own.published(uri)):
            pass
        assert codes_of(findings) == ["DB302"]


def test_what_is_allowed_to_lint_is_allowed_to_the_server(client, project, world, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "roller.urdf"
    path = world("pit_escape")
    shutil.copy(path.parents[1] / "robots" / "urdf" / "roller.urdf", elsewhere)
    path.write_text(path.read_text().replace("../robots/urdf/roller.urdf", str(elsewhere)))
    uri = client.open(path)
    assert codes_of(client.findings(uri)) == ["DB204"]
    client.close(uri)
    with Client(project, command=(*OURS, "--allow-path", str(elsewhere.parent))) as own:
        assert own.findings(own.open(path)) == []
