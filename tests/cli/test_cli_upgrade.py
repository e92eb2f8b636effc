"""`deepbots upgrade`: files that name no version, the current one, or one that is still to come."""

from __future__ import annotations

import os
from textwrap import indent

import pytest

from deepbots_cli import api
from deepbots_cli.cli.commands.rewriting import STEPS
from deepbots_cli.document import shipped
from deepbots_cli.scenario.scenario import VERSION

WHOLE = shipped.scenario_path("cartpole").read_text(encoding="utf-8").replace("../robots/urdf/cartpole.urdf", "cartpole")
UNNAMED = WHOLE.replace("deepbots: 1\n", "")


def test_there_is_a_step_from_every_version_to_the_next():
    assert list(STEPS) == list(range(VERSION))


@pytest.mark.parametrize(
    ("text", "after"),
    [
        (UNNAMED, WHOLE),
        ("# mine\n\n" + UNNAMED, "# mine\n\n" + WHOLE),
        ("---\n" + UNNAMED, "---\n" + WHOLE),
        ("\ufeff" + UNNAMED, "\ufeff" + WHOLE),
        (UNNAMED.replace("\n", "\r\n"), WHOLE.replace("\n", "\r\n")),
        ("{extends: cartpole.yaml}\n", "{deepbots: 1, extends: cartpole.yaml}\n"),
        (indent(UNNAMED, "  "), indent(WHOLE, "  ")),
    ],
    ids=[
        "plain",
        "below a comment",
        "below a document mark",
        "with a byte order mark",
        "with line ends of Windows",
        "in braces",
        "indented",
    ],
)
def test_a_file_without_a_version_gets_the_line_and_keeps_everything_else(deepbots, tmp_path, text, after):
    file = tmp_path / "old.yaml"
    file.write_bytes(text.encode())
    shown = deepbots("upgrade", "old.yaml", "--diff")
    assert shown.code == 1
    assert "deepbots: 1" in shown.out
    assert file.read_bytes() == text.encode()
    ran = deepbots("upgrade", "old.yaml")
    assert ran.code == 0, ran.err
    assert file.read_bytes() == after.encode()
    assert "deepbots lint old.yaml" in ran.err
    again = deepbots("upgrade", "old.yaml", "--diff")
    assert (again.code, again.err) == (0, "")
    assert "is up to date" in again.out


def test_what_was_upgraded_is_what_lint_asks_for(deepbots, tmp_path):
    (tmp_path / "old.yaml").write_text(UNNAMED, encoding="utf-8")
    assert [finding.code for finding in api.lint(tmp_path / "old.yaml")] == ["DB102"]
    deepbots("upgrade", "old.yaml")
    assert api.lint(tmp_path / "old.yaml") == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("deepbots: 2\n", "pip install --upgrade deepbots-cli"),
        ("deepbots: v1\n", "write `deepbots: 1`"),
        ("deepbots: 1.0\n", "write `deepbots: 1`"),
        ("deepbots: true\n", "write `deepbots: 1`"),
        ("deepbots: 0\n", "write `deepbots: 1`"),
        ("deepbots: [1]\n", "write `deepbots: 1`"),
        ("urdf: urdf/epuck.urdf\n", "has no version"),
        ("- a list\n", "has no keys"),
    ],
)
def test_what_cannot_be_upgraded_is_left_alone_and_one_is_told_what_to_do(deepbots, tmp_path, text, said):
    file = tmp_path / "odd.yaml"
    file.write_text(text, encoding="utf-8")
    ran = deepbots("upgrade", "odd.yaml")
    assert (ran.code, ran.out) == (2, "")
    assert said in ran.err
    assert file.read_text(encoding="utf-8") == text


def test_a_file_that_is_no_yaml_is_shown_with_its_place(deepbots, tmp_path):
    (tmp_path / "broken.yaml").write_text("robots: [\n", encoding="utf-8")
    ran = deepbots("upgrade", "broken.yaml")
    assert ran.code == 1
    assert "broken.yaml:" in ran.err


def test_neither_a_folder_nor_a_pipe_nor_nothing_is_waited_for(deepbots, tmp_path):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name in ("folder", "pipe", "nowhere.yaml"):
        assert deepbots("upgrade", name).code == 2


def test_a_link_stays_a_link(deepbots, tmp_path):
    (tmp_path / "old.yaml").write_text(UNNAMED, encoding="utf-8")
    (tmp_path / "link.yaml").symlink_to("old.yaml")
    assert deepbots("upgrade", "link.yaml").code == 0
    assert (tmp_path / "link.yaml").is_symlink()
    assert (tmp_path / "old.yaml").read_text(encoding="utf-8") == WHOLE


@pytest.mark.parametrize("name", shipped.scenario_names())
def test_shipped_scenarios_are_current(deepbots, name):
    assert "is up to date" in deepbots("upgrade", shipped.scenario_path(name)).out


OLD = """extends: base.yaml  # mine
name: Old
robots: {cart: {sensors: {pole_angle: {quantise: 0.1 deg}}}}
signals:
  near: smooth(gap(cart.body, cart.pole), 0.1 s)
"""


def test_old_names_are_replaced_also_in_files_that_are_included(deepbots, tmp_path):
    (tmp_path / "base.yaml").write_text(WHOLE.replace("{format: csv}", "{format: csv, timing: paper}"), encoding="utf-8")
    file = tmp_path / "old.yaml"
    file.write_text("deepbots: 1\n" + OLD, encoding="utf-8")
    shown = deepbots("upgrade", "old.yaml", "--diff")
    assert shown.code == 1
    assert "+++ base.yaml" in shown.out
    ran = deepbots("upgrade", "old.yaml")
    assert ran.code == 0, ran.err
    assert ran.out.splitlines() == ["quantise -> resolution", "smooth -> low_pass", "gap -> clearance", "paper -> delayed"]
    mended = OLD.replace("quantise", "resolution").replace("smooth", "low_pass").replace("gap", "clearance")
    assert file.read_text(encoding="utf-8") == "deepbots: 1\n" + mended
    assert "timing: delayed" in (tmp_path / "base.yaml").read_text(encoding="utf-8")
    assert "is up to date" in deepbots("upgrade", "old.yaml").out


def test_a_file_without_a_version_may_hold_old_names(deepbots, tmp_path):
    (tmp_path / "base.yaml").write_text(WHOLE, encoding="utf-8")
    (tmp_path / "old.yaml").write_text(OLD, encoding="utf-8")
    assert deepbots("upgrade", "old.yaml").code == 0
    assert (tmp_path / "old.yaml").read_text(encoding="utf-8").startswith("deepbots: 1\nextends: base.yaml  # mine\n")
    assert {finding.code for finding in api.lint(tmp_path / "old.yaml")} <= {"DB205"}
