"""Completion: keys, words, names, parts of the world, functions, units and files, also in a text
that cannot be parsed.

What can be done about findings: fixes as they are, guesses called so, all safe fixes at
once; formatting.

Hover and definitions: the text under the cursor, and its origin.

Where a place is: positions of the protocol, and the path of a place in a text that may be broken.

The examples of docs/editors.md about the language server are true, and its settings can be read.

Findings as one types: the same as of `deepbots lint`, at places of the protocol, of the newest text
only.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lsprotocol.types import Position
from pygls.workspace import PositionCodec

from deepbots_cli import api
from deepbots_cli.compiler.inventory import scenario_names
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import MappingNode, ScalarNode, walk
from deepbots_cli.document.parse import parse
from deepbots_cli.lsp.completion import completion
from deepbots_cli.lsp.cursor import cursor_at
from deepbots_cli.lsp.workspace import Document, Lines, Workspace, analyze, uri_of
from tests.few import every
from tests.lsp.client import OURS, ROOT, TABLES, Client, edited, offset, place_of, position


@pytest.fixture
def typing(client, pit, project):
    """Replaces a piece of PitEscape, and asks for completion at the mark; `pit` restores the text."""
    original = (project / "scenarios" / "pit_escape.yaml").read_text(encoding="utf-8")

    def labels(old: str, new: str) -> list[str]:
        assert original.count(old) == 1
        start = original.index(old)
        client.change(pit, original.replace(old, new.replace("¦", "")))
        return client.labels_at(pit, start + new.index("¦"))

    return labels


@pytest.mark.parametrize(
    ("old", "new", "offered", "not_offered"),
    [row for part in ("keys", "words", "names", "expressions") for row in TABLES[part]],
)
def test_a_place_is_offered_what_fits_and_nothing_else(typing, old, new, offered, not_offered):
    completions = set(typing(old, new))
    assert {*offered} <= completions
    assert completions.isdisjoint(not_offered)
    assert not_offered or not offered


@pytest.mark.parametrize(
    "broken",
    [
        "reward:      {progress: delta(me¦",
        'reward:      {progress: "delta(me¦',
        "reward:\n  progress: [ delta(me¦",
        "reward:\n\tprogress: {{\nreward:\n  progress: delta(me¦",
        "reward: }\nreward:\n  progress: |\n    delta(me¦",
    ],
)
def test_a_document_that_is_not_yaml_at_the_moment_is_completed_from_what_was_known(typing, broken):
    assert {"metric", "reach", "delta("} <= set(typing("reward:      {progress: delta(metric)}", broken))


def test_a_name_that_was_never_compiled_is_not_offered_but_the_language_is(client, project):
    uri = client.open(project / "scenarios" / "new.yaml", "deepbots: 1\nworld: {")
    answer = client.request(
        "textDocument/completion", {"textDocument": {"uri": uri}, "position": {"line": 1, "character": 8}}
    )
    assert {"timestep", "gravity"} <= {item["label"] for item in answer["items"]}
    client.change(uri, "deepbots: 1\nparameters: {radius: 2 ")
    assert "m" in client.labels(uri, "radius: 2 ¦")


def test_an_item_says_what_it_is_and_writes_no_more_than_is_missing(client, pit):
    items = client.ask("completion", pit, "times¦tep: 32 ms")["items"]
    (timestep,) = [item for item in items if item["label"] == "timestep"]
    assert "duration" in timestep["detail"]
    assert "Duration of one control step" in timestep["documentation"]["value"]
    assert "timestep: 32 ms" in timestep["documentation"]["value"]
    assert timestep["textEdit"]["newText"] == "timestep"
    assert edited(client.texts[pit], [timestep["textEdit"]]) == client.texts[pit].replace(
        "timestep: 32", "timesteptep: 32"
    )
    (gravity,) = [item for item in items if item["label"] == "gravity"]
    assert gravity["textEdit"]["newText"] == "gravity"  # the colon is there


@pytest.mark.parametrize(
    ("around", "inserted"), [("progress: delta¦(metric)", "delta"), ("progress: de¦lta(metric)", "delta(")]
)
def test_a_function_brings_its_bracket_unless_it_is_there(client, pit, around, inserted):
    (delta,) = [item for item in client.ask("completion", pit, around)["items"] if item["label"] == "delta("]
    assert delta["textEdit"]["newText"] == inserted


def test_paths_are_completed_within_the_project_and_nowhere_else(typing):
    assert "../robots/urdf/" in typing("urdf: ../robots/urdf/roller.urdf", "urdf: ../robots/¦")
    assert "../robots/urdf/rover.urdf" in typing("urdf: ../robots/urdf/roller.urdf", "urdf: ../robots/urdf/¦")
    assert "cartpole" in typing("urdf: ../robots/urdf/roller.urdf", "urdf: ¦")
    assert "cartpole_long" in typing("summary:", "extends: ¦\nsummary:")
    assert typing("urdf: ../robots/urdf/roller.urdf", "urdf: ../../¦") == []
    assert typing("urdf: ../robots/urdf/roller.urdf", "urdf: /¦") == []


def test_an_included_piece_is_completed_as_the_part_of_the_scenario_that_it_is(client, ball, project):
    piece = client.open(project / "robots" / "epuck.yaml")
    assert client.findings(piece) == []
    assert {"base_link", "left_wheel"} <= set(client.labels(piece, "link: b¦ase_link"))
    text = client.texts[piece]
    client.change(piece, text.replace("type: infrared", "type: infrared\n    no"))
    assert {"noise", "range"} <= set(client.labels(piece, "type: infrared\n    no¦"))
    client.change(piece, text)
    assert client.findings(piece) == []


def test_a_comment_that_suppresses_is_completed_with_the_warnings(typing):
    completions = typing("# one action every 256 ms", "# deepbots: ignore[DB2¦]")
    assert "DB205" in completions
    assert "DB402" not in completions
    assert typing("# one action every 256 ms", "# one ac¦") == []


@pytest.mark.parametrize(
    ("old", "new", "first"),
    [
        ("timestep: 32 ms", "timestep: 32 ¦", ["s", "ms", "us", "min", "h"]),
        ("max_torque: 10 N*m}\n      yaw", "max_torque: 10 ¦}\n      yaw", ["N*m", "N"]),
        ("noise: 0.15", "height: 1 ¦", ["m", "mm", "cm", "km"]),
    ],
)
def test_units_of_the_field_come_first(typing, old, new, first):
    assert typing(old, new)[: len(first)] == first


def test_behind_a_unit_and_a_factor_names_come_and_no_units(typing):
    completions = typing(
        "{roll: {backward: roller.gyro.y < 0 rad/s", "{roll: {backward: 5 rad/s * roller.gyro.¦"
    )
    assert {"roller.gyro.x", "roller.gyro.y", "roller.gyro.z"} <= set(completions)
    assert "m" not in typing("{roll: {backward: roller.gyro.y < 0 rad/s", "{roll: {backward: 5 rad/s * ¦")


def test_a_file_that_begins_is_offered_its_first_line_and_then_its_sections(client, project):
    uri = client.open(project / "scenarios" / "first.yaml", "")
    assert client.labels_at(uri, 0) == ["deepbots: 1"]
    client.change(uri, "# mine\ndee")
    assert client.labels_at(uri, len("# mine\ndee")) == ["deepbots: 1"]
    client.change(uri, "deepbots: ")
    assert client.labels(uri, "deepbots: ¦") == ["1"]
    client.change(uri, "deepbots: 1\n")
    assert client.labels_at(uri, 12)[:3] == ["name", "summary", "parameters"]
    client.change(uri, "deepbots: 1\nworld: {timestep: ")
    assert client.labels(uri, "timestep: ¦")[0] == "32 ms"


BEGUN = """\
deepbots: 1
name: Begun
world: {timestep: 20 ms}
robots:
  cart:
    urdf: cartpole
    sensors: {pole_angle: {type: joint_position, joint: pole_hinge}}
    actuators: {wheels: {type: velocity_motor, joints: ['wheel_*'], max_torque: 10 N*m}}
"""


def test_a_scenario_that_was_never_whole_offers_the_names_that_stand_in_it(client, project):
    uri = client.open(project / "scenarios" / "begun.yaml", BEGUN)
    client.findings(uri)
    client.change(uri, BEGUN + "    emit:\n      - ")
    assert client.labels_at(uri, len(client.texts[uri])) == ["pole_angle"]
    client.change(uri, BEGUN + "    apply:\n      ")
    client.findings(uri)
    assert "wheels" in client.labels_at(uri, len(client.texts[uri]))
    client.change(
        uri,
        BEGUN + "action: {go: {range: -1 .. 1, each: cart.wheels}}\nsignals: {far: 1 m}\nreward:\n  near: f",
    )
    client.findings(uri)
    assert "far" in client.labels_at(uri, len(client.texts[uri]))


def test_where_a_new_name_is_expected_an_example_is_offered_and_nothing_else(client, pit):
    client.change(pit, client.texts[pit] + "disturbances:\n  ")
    (example,) = client.labels_at(pit, len(client.texts[pit]))
    assert example.startswith("{gust: {body:")


def test_among_entries_no_example_of_the_whole_section_is_offered(client, project):
    text = BEGUN + "signals:\n  far: 1 m\n  "
    uri = client.open(project / "scenarios" / "entries.yaml", text)
    assert not [label for label in client.labels_at(uri, len(text)) if label.startswith("{")]


def test_while_a_robot_has_a_mistake_its_joints_are_still_offered(client, pit):
    client.change(pit, client.texts[pit].replace("    apply: {", "    receive:\n    apply: {"))
    assert client.findings(pit) != []
    assert {"pitch", "yaw"} <= set(client.labels(pit, "joint: p¦itch"))


WHOLE = f"""\
{BEGUN}    emit: [pole_angle]
    apply: {{wheels: go}}
action: {{go: {{range: -5 .. 5 rad/s, each: cart.wheels}}}}
observation: {{cart.pole_angle: -1 .. 1 rad}}
signals: {{old: 1 m}}
reward: {{time: 1}}
truncation: {{max_steps: 100}}
scripts:
  still: {{go: 0 rad/s}}
"""


@pytest.mark.parametrize(("changes", "offered", "not_offered"), TABLES["written"])
def test_names_written_just_now_are_offered_where_they_have_a_value(tmp_path, changes, offered, not_offered):
    path = tmp_path / "a.yaml"
    workspace = Workspace()
    analyzed = Document(uri_of(path), 1, WHOLE, path)
    workspace.put(analyzed)
    workspace.record(analyze(analyzed, workspace.drafts))
    text = WHOLE
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    latest = Document(analyzed.uri, 2, text.replace("¦", ""), path)
    position = latest.lines.position(text.index("¦"))
    workspace.put(latest)
    # An editor asks again at the next letter.
    assert completion(workspace.view(analyzed.uri, position)).is_incomplete
    workspace.record(analyze(latest, workspace.drafts))
    after = completion(workspace.view(analyzed.uri, position))
    assert not after.is_incomplete
    assert {*offered} <= labels(after)
    assert not labels(after) & {*not_offered}


def labels(completions):
    return {item.label for item in completions.items}


def test_a_script_is_offered_the_components_of_its_action(client, project):
    text = WHOLE
    uri = client.open(project / "scenarios" / "begun.yaml", text)
    assert [finding["code"] for finding in client.findings(uri) if finding["severity"] == 1] == []
    client.change(uri, text.replace("{go: 0 rad/s}", "{go: {"))
    assert {"wheel_front_left", "wheel_rear_right"} <= set(client.labels(uri, "still: {go: {¦"))


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


def test_all_safe_fixes_are_one_action_and_guesses_are_left(client, pit, changed):
    original = client.texts[pit]
    changed(
        ("timestep: 32", "timestop: 32"),
        ("{type: gyro,", "{type: gyros,"),
        ("delta(metric)", "delta(metrik)"),
    )
    (action,) = client.actions(pit, "time¦stop", only=FIX_ALL)
    assert text_after(client, pit, action) == original.replace("delta(metric)", "delta(metrik)")


@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_all_safe_fixes_leave_line_ends_and_a_byte_order_mark_as_they_are(client, pit, mark):
    original = mark + client.texts[pit].replace("\n", "\r\n")
    client.change(pit, original.replace("timestep: 32", "timestop: 32"))
    client.findings(pit)
    (action,) = client.actions(pit, "time¦stop", only=FIX_ALL)
    assert text_after(client, pit, action) == original


@pytest.mark.slow
def test_a_client_that_can_take_versions_gets_them_with_an_edit(project):
    able = {"workspace": {"workspaceEdit": {"documentChanges": True}}}
    with Client(project, capabilities=able) as own:
        path = project / "scenarios" / "pit_escape.yaml"
        uri = own.open(path, path.read_text().replace("timestep: 32", "timestop: 32"))
        own.findings(uri)
        (action,) = own.actions(uri, "time¦stop", only=["source"])
        (change,) = action["edit"]["documentChanges"]
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


def test_formatting_makes_what_fmt_makes_and_leaves_broken_text_alone(client, pit, changed):
    original = client.texts[pit]
    options = {"textDocument": {"uri": pit}, "options": {"tabSize": 4, "insertSpaces": True}}
    assert client.request("textDocument/formatting", options) == []
    client.change(pit, original.replace("world: {timestep: 32 ms,", "world:    {timestep:   32 ms ,"))
    assert edited(client.texts[pit], client.request("textDocument/formatting", options)) == original
    client.change(pit, original.replace("world: {", "world: {{"))
    assert client.request("textDocument/formatting", options) == []


def test_the_server_writes_nothing(client, project):
    def state() -> dict[str, str]:
        return {
            str(path): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(Path(project).rglob("*"))
            if path.is_file()
        }

    before = state()
    path = project / "scenarios" / "quadrotor.yaml"
    uri = client.open(path, path.read_text().replace("timestep:", "timestop:"))
    client.findings(uri)
    client.actions(uri, "time¦stop", only=FIX_ALL)
    client.request(
        "textDocument/formatting",
        {"textDocument": {"uri": uri}, "options": {"tabSize": 2, "insertSpaces": True}},
    )
    client.close(uri)
    assert state() == before


@pytest.mark.parametrize(("around", "expected"), TABLES["hover"])
def test_the_hover_of_expressions_keys_and_words_says_what_they_are(client, pit, around, expected):
    text = client.hover(pit, around)
    assert [part for part in expected if part not in text] == []


@pytest.mark.parametrize("around", ["running_m¦ax(norm", "no¦rm(position", "ho¦ld(0.5 * reach"])
def test_the_hover_of_a_function_shows_its_signature_and_meaning(client, pit, around):
    name = around.replace("¦", "").partition("(")[0]
    text = client.hover(pit, around)
    assert f"{name}(" in text
    assert "For example" in text
    assert "Here it is" in text


def test_the_hover_of_a_code_in_a_comment_is_its_page(client, pit):
    text = client.texts[pit]
    client.change(
        pit, text.replace("# one action every 256 ms", "# deepbots: ignore[DB205] one action every 256 ms")
    )
    assert "unused-definition" in client.hover(pit, "ignore[DB2¦05]")


@pytest.mark.parametrize(
    "around",
    [
        "# one ac¦tion every 256 ms",
        "  # ou¦t: the sooner",
        "signals:¦\n  reach",
        "# that is¦ \n",
        "reward: ¦     {progress",
        "n_steps:¦ 64",
        "¦# rocking by",
        "# rocking¦ by",
    ],
)
def test_nothing_is_made_up_about_comments_and_what_is_empty(client, pit, around):
    if "that is" in around:
        client.change(pit, client.texts[pit] + "# that is \n")
    assert client.hover(pit, around) == ""


def test_the_hover_of_a_number_in_a_vector_has_the_unit_of_the_vector(client, pit):
    vector = "roller.accel: -15 -14 -13 .. 15 16 17 m/s^2"
    client.change(pit, client.texts[pit].replace("roller.accel: -15 .. 15 m/s^2", vector))
    client.findings(pit)
    assert "an acceleration (m/s^2), -14" in client.hover(pit, "-15 -1¦4 -13")
    assert "an acceleration (m/s^2), 16" in client.hover(pit, "15 1¦6 17")


def test_the_range_of_a_hover_is_the_piece_that_it_is_about_also_behind_an_emoji(client, pit):
    text = client.texts[pit]
    client.change(
        pit, text.replace("  metric: |\n", "  metric: |\n    # 😀 ü 𝄞\n").replace("inside\n", "😀 inside\n")
    )
    client.findings(pit)
    place = client.ask("hover", pit, "0.5 * re¦ach / radius")["range"]
    now = client.texts[pit]
    assert now[offset(now, place["start"]) : offset(now, place["end"])] == "reach"


def test_while_the_text_is_broken_elsewhere_hover_and_definition_go_on(client, pit):
    client.change(pit, "# a new line\n" + client.texts[pit].replace("solved: ", "solved: {{"))
    assert [finding["code"] for finding in client.findings(pit)] == ["DB001"]
    assert "a length (m)" in client.hover(pit, "reach > rad¦ius")
    assert client.definition(pit, "reach > rad¦ius") == [place_of("pit_escape.yaml", "¦radius: 2.7 m")]


@pytest.mark.parametrize(
    ("opened", "around", "file", "place"),
    [*(("pit", *row) for row in TABLES["definitions"]), *(("ball", *row) for row in TABLES["included"])],
)
def test_a_name_leads_to_its_definition_also_in_included_files(client, request, opened, around, file, place):
    assert client.definition(request.getfixturevalue(opened), around) == [place_of(file, place)]


def test_an_included_piece_answers_as_the_part_of_the_scenario_that_it_is(client, ball, project):
    piece = client.open(project / "robots" / "epuck.yaml")
    assert (client.findings(piece), client.definition(piece, "link: base_l¦ink")) == (
        [],
        [("epuck.urdf", 14, 14)],
    )
    assert "`infrared`" in client.hover(piece, "ty¦pe: infrared")


def test_a_shipped_name_leads_to_the_robot_file_or_the_scenario_that_it_names(client, project):
    uri = client.open(
        project / "scenarios" / "mine.yaml",
        "deepbots: 1\nextends: cartpole\nrobots: {cart: {urdf: cartpole}}\n",
    )
    assert client.definition(uri, "extends: cart¦pole") == [("cartpole.yaml", 0, 0)]
    assert client.definition(uri, "urdf: cart¦pole") == [("cartpole.urdf", 0, 0)]


def test_the_section_of_an_agent_is_answered_with_the_names_of_this_agent(client, project):
    own = "augment: {hiding: 2 * apart, angle: 'bearing(prey, hunter)'}"
    text = (project / "scenarios" / "tag.yaml").read_text(encoding="utf-8")
    text = text.replace(
        "    like: hunter\n",
        f"    like: hunter\n    {own}\n    observation: {{hiding: 0 .. 9 m, angle: auto}}\n",
    ).replace("free:    0.05", "free: hiding / m")
    file = project / "scenarios" / "hiding.yaml"
    file.write_text(text, encoding="utf-8")
    uri = client.open(file, text)
    assert [finding for finding in client.findings(uri) if finding["severity"] == 1] == []
    ((name, line, _),) = client.definition(uri, "free: hid¦ing")
    assert (name, text.splitlines()[line].strip()) == (file.name, own)
    assert "hiding" in client.labels(uri, "free: hid¦ing")
    assert "hiding" not in client.labels(uri, "closer: -10 * delta(a¦part)")
    offered = scenario_names(api.load(file)).shared["reward expression"].names
    assert {"hiding", "gap"} <= {*offered}
    file.unlink()


def test_a_pattern_leads_to_all_that_it_fits(client, project):
    uri = client.open(project / "scenarios" / "cartpole_wireless.yaml")
    assert client.findings(uri) == []
    places = client.definition(uri, '"¦*": {mass')
    assert len(places) >= 2
    assert {file for file, _, _ in places} == {"cartpole.urdf"}


FILES = [
    *sorted((ROOT / "scenarios").glob("*.yaml")),
    *sorted((ROOT / "robots").glob("*.yaml")),
    *sorted((ROOT / "tests" / "golden" / "lint" / "ok").glob("*.yaml")),
]
TEXTS = st.text(st.sampled_from("ab\n\r😀𝄞ü \t")) | st.text()
ENCODINGS = {"utf-8": 1, "utf-16": 2, "utf-32": 4}


@given(
    TEXTS.filter(lambda text: not any("\ud800" <= letter <= "\udfff" for letter in text)),
    st.sampled_from(sorted(ENCODINGS)),
)
def test_each_offset_has_a_position_that_leads_back_to_it(text, encoding):
    lines = Lines(text, PositionCodec(encoding))
    mark = text.startswith("\ufeff")
    for index in range(mark, len(text) + 1):
        if text[index - 1 : index + 1] == "\r\n":
            continue  # between the two there is no place
        position = lines.position(index - mark)
        before = text[:index]
        start = max(before.rfind("\n"), before.rfind("\r")) + 1
        assert position.line == len(before.replace("\r\n", "\n").replace("\r", "\n").split("\n")) - 1
        name = "utf-8" if encoding == "utf-8" else f"{encoding}-le"
        assert position.character == len(text[start:index].encode(name)) // ENCODINGS[encoding]
        assert lines.offset(position) == index - mark


@pytest.mark.parametrize(
    ("position", "offset"),
    [
        (Position(0, 2), 1),
        (Position(0, 3), 2),
        (Position(0, 99), 3),
        (Position(1, 99), 5),
        (Position(99, 0), 5),
        (Position(1, 0), 4),
    ],
)
def test_what_lies_inside_of_a_character_or_beyond_a_line_is_taken_to_the_nearest_place(position, offset):
    assert Lines("a😀b\nc").offset(position) == offset


@pytest.mark.parametrize("file", every(12, FILES, lambda file: file.name))
def test_the_reader_of_broken_text_finds_the_paths_that_the_parser_finds(file):
    text = file.read_text(encoding="utf-8")
    root = parse(Source(file.name, text), Findings())
    visited = set()
    for path, node in walk(root):
        if (
            isinstance(node, ScalarNode) and node.span not in visited
        ):  # what an alias repeats stands in one place
            visited.add(node.span)
            cursor = cursor_at(text, node.span.end)
            assert cursor.path == path
            assert cursor.role == "value" or isinstance(path[-1], int)
        for entry in node.entries.values() if isinstance(node, MappingNode) else ():
            if entry.key.span not in visited:
                visited.add(entry.key.span)
                cursor = cursor_at(text, entry.key.span.end)
                assert (cursor.path, cursor.role) == (path, "key")


@pytest.mark.parametrize(
    ("text", "path", "role"),
    [
        ("world: {", ("world",), "key"),
        ("world: {timestep: 32 ms, ", ("world",), "key"),
        ("world: {timestep: ", ("world", "timestep"), "value"),
        ("world:\n  timestep: 32 ms\n  ", ("world",), "key"),
        ("world:\n  timestep: 32 ms\n", (), "key"),
        ("robots:\n  cart:\n    sensors: {a: {type: gyro, l", ("robots", "cart", "sensors", "a"), "key"),
        ("curriculum:\n- name: a\n  se", ("curriculum", 0), "key"),
        ("emit: [a, ", ("emit", 1), "value"),
        ("signals:\n  x: |\n    foo(ba", ("signals", "x"), "value"),
        ("summary: 'it''s ", ("summary",), "value"),
        ("summary: a  # on", ("summary",), "aside"),
        ("world: {{\nreward:\n  x: ", ("reward", "x"), "value"),
        ('summary: "open\nreward:\n  x: ', ("reward", "x"), "value"),
        ("a: ]\nreward: {x: ", ("reward", "x"), "value"),
        ("", (), "key"),
    ],
)
def test_a_text_that_is_being_written_has_a_path_all_the_same(text, path, role):
    cursor = cursor_at(text, len(text))
    assert (cursor.path, cursor.role) == (path, role)


@given(st.text(st.sampled_from("ab:-[]{},\"'#|>&*!% \n\t😀")), st.integers(0, 200))
def test_any_text_whatever_has_a_path(text, offset):
    assert cursor_at(text, min(offset, len(text))).start <= max(len(text), 0)


@pytest.mark.parametrize(
    "piece", ["[", "{a: ", "- ", "a:\n", "\n", '"', " ", ":", "# ", "[x ", "'", "a: |\n"]
)
def test_a_hostile_text_is_read_to_its_end(piece):
    text = piece * 50_000
    assert len(cursor_at(text, len(text)).path) <= 100


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
    assert len(ROWS) == 9
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


def test_columns_count_units_of_utf_16_behind_emoji_and_other_letters(client, world):
    summary = 'summary: "Ä 😀", parameters'
    uri = client.open(
        world(
            "pit_escape", ("parameters: {radius: 2.7 m,", "parameters: {radius: 2.7 m,  # 😀\n  ü😀: 1 m, ")
        )
    )
    (only,) = client.findings(uri)
    assert (underlined_text(client, uri, only), only["range"]["end"]) == ("ü😀", {"line": 4, "character": 5})
    client.close(uri)
    assert position(summary, summary.index("parameters"))["character"] == summary.index("parameters") + 1


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


def test_a_second_place_that_explains_a_finding_comes_with_it(client, world):
    uri = client.open(world("pit_escape", ("signals:\n", "signals:\n  radius: time\n")))
    (only,) = [finding for finding in client.findings(uri) if finding["code"] == "DB202"]
    (first,) = only["relatedInformation"]
    assert (first["message"], first["location"]["range"]["start"]) == (
        "first defined here",
        {"line": 3, "character": 13},
    )


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
