"""Hover and definitions: the text under the cursor, and its origin."""

from __future__ import annotations

import pytest

from tests.lsp.client import TABLES, offset, place_of


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
    "around", ["# one ac¦tion every 256 ms", "  # ou¦t: the sooner", "signals:¦\n  reach", "# that is¦ \n"]
)
def test_nothing_is_made_up_about_comments_and_what_is_empty(client, pit, around):
    if "that is" in around:
        client.change(pit, client.texts[pit] + "# that is \n")
    assert client.hover(pit, around) == ""


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
    text = client.texts[pit]
    client.change(pit, "# a new line\n" + text.replace("solved: ", "solved: {{"))
    assert [finding["code"] for finding in client.findings(pit)] == ["DB001"]
    assert "a length (m)" in client.hover(pit, "reach > rad¦ius")
    assert client.definition(pit, "reach > rad¦ius") == [place_of("pit_escape.yaml", "¦radius: 2.7 m")]


@pytest.mark.parametrize(("around", "file", "place"), TABLES["definitions"])
def test_a_name_leads_to_its_definition(client, pit, around, file, place):
    assert client.definition(pit, around) == [place_of(file, place)]


@pytest.mark.parametrize("around", ["{rad¦ius: 2.7 m", "reach > rad¦ius"])
def test_the_uses_of_a_name_are_listed_at_its_definition_and_at_a_use(client, pit, around):
    places = ("reach / ¦radius if", "reach < ¦radius  ", "reach > ¦radius}", "reach < ¦radius}}")
    assert sorted(client.references(pit, around)) == sorted(
        place_of("pit_escape.yaml", place) for place in places
    )


@pytest.mark.parametrize(("around", "file", "place"), TABLES["included"])
def test_definitions_are_found_in_included_files_by_aliases_and_by_paths_of_settings(
    client, ball, around, file, place
):
    assert client.definition(ball, around) == [place_of(file, place)]


def test_an_included_piece_answers_as_the_part_of_the_scenario_that_it_is(client, ball, project):
    piece = client.open(project / "robots" / "epuck.yaml")
    assert client.findings(piece) == []
    assert client.definition(piece, "link: base_l¦ink") == [("epuck.urdf", 14, 14)]
    assert "`infrared`" in client.hover(piece, "ty¦pe: infrared")
    client.close(piece)


def test_a_shipped_name_leads_to_the_robot_file_or_the_scenario_that_it_names(client, project):
    uri = client.open(
        project / "scenarios" / "mine.yaml",
        "deepbots: 1\nextends: cartpole\nrobots: {cart: {urdf: cartpole}}\n",
    )
    assert client.definition(uri, "extends: cart¦pole") == [("cartpole.yaml", 0, 0)]
    assert client.definition(uri, "urdf: cart¦pole") == [("cartpole.urdf", 0, 0)]
    client.close(uri)


def test_an_alias_leads_to_the_last_anchor_of_its_name_before_it(client, project):
    uri = client.open(project / "scenarios" / "mine.yaml", "deepbots: 1\na: &x 1\nb: &x 2\nc: *x\nd: &x 3\n")
    assert client.definition(uri, "c: *¦x") == [("mine.yaml", 2, 3)]
    client.close(uri)


def test_a_pattern_leads_to_all_that_it_fits(client, project):
    uri = client.open(project / "scenarios" / "cartpole_wireless.yaml")
    assert client.findings(uri) == []
    places = client.definition(uri, '"¦*": {mass')
    assert len(places) >= 2
    assert {file for file, _, _ in places} == {"cartpole.urdf"}
    client.close(uri)
