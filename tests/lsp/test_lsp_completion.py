"""Completion: keys, words, names, parts of the world, functions, units and files, also in a text
that cannot be parsed."""

from __future__ import annotations

import pytest

from deepbots_cli.lsp.completion import completion
from deepbots_cli.lsp.workspace import Document, Workspace, analyze, uri_of
from tests.lsp.client import TABLES, edited


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
    client.close(uri)


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


def test_behind_an_emoji_the_right_letters_are_replaced(typing, client, pit):
    assert "accelerometer" in typing("gyro: {type: gyro, link: ball}", '"😀": {noise: 0, type: acc¦}')
    (item,) = [
        item
        for item in client.ask("completion", pit, "type: acc¦}")["items"]
        if item["label"] == "accelerometer"
    ]
    assert '"😀": {noise: 0, type: accelerometer}' in edited(client.texts[pit], [item["textEdit"]])


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
    client.close(piece)


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
    client.close(uri)


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
    uri = client.open(project / "scenarios" / "begun.yaml", BEGUN + "    emit:\n      - ")
    assert client.labels_at(uri, len(client.texts[uri])) == ["pole_angle"]
    client.change(uri, BEGUN + "    apply:\n      ")
    assert "wheels" in client.labels_at(uri, len(client.texts[uri]))
    client.change(
        uri,
        BEGUN + "action: {go: {range: -1 .. 1, each: cart.wheels}}\nsignals: {far: 1 m}\nreward:\n  near: f",
    )
    assert "far" in client.labels_at(uri, len(client.texts[uri]))
    client.close(uri)


def test_where_a_new_name_is_expected_an_example_is_offered_and_nothing_else(client, pit):
    client.change(pit, client.texts[pit] + "disturbances:\n  ")
    (example,) = client.labels_at(pit, len(client.texts[pit]))
    assert example.startswith("{gust: {body:")


def test_among_entries_no_example_of_the_whole_section_is_offered(client, project):
    text = BEGUN + "signals:\n  far: 1 m\n  "
    uri = client.open(project / "scenarios" / "entries.yaml", text)
    assert not [label for label in client.labels_at(uri, len(text)) if label.startswith("{")]
    client.close(uri)


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
def test_names_written_since_the_last_analysis_are_offered_where_they_have_a_value(
    tmp_path, changes, offered, not_offered
):
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
    before = completion(workspace.view(analyzed.uri, position))
    assert before.is_incomplete  # so that an editor asks again at the next letter
    assert {*offered} <= labels(before)
    assert not labels(before) & {*not_offered}
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
    client.close(uri)
