"""Old names of the language: one finding each, with a fix that gives the document under the new names."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import Edit, Findings, Source
from deepbots_cli.diagnostics.nearest import RENAMES, Rename
from deepbots_cli.document.nodes import MappingNode, ScalarNode, to_data, walk
from deepbots_cli.document.parse import parse
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.lint.fixes import Fixer
from deepbots_cli.scenario.base import Kinds, shape_at, walk_sections
from deepbots_cli.scenario.scenario import Scenario

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*(ROOT / "golden/lint/ok").glob("*.yaml"), *(ROOT / "data/scenarios").glob("*.yaml"), *(ROOT / "world").glob("*.yaml")])
MODELS = {model.__name__: model for _, part, _ in walk_sections(Scenario) if isinstance(part, type) for model in part.__mro__}


@cache
def renamed_in(path: Path) -> tuple[tuple[Edit, Rename], ...]:
    """What turns the document into one with old names only."""
    source = Source(str(path), path.read_bytes().decode())
    root = parse(source, Findings())
    assert root is not None
    found = []
    for place, node in walk(root):
        section = shape_at(Scenario, to_data(root), place)
        if isinstance(node, MappingNode) and isinstance(section, type):
            for key, entry in node.entries.items():
                for rename in RENAMES:
                    if (
                        rename.section
                        and issubclass(section, MODELS[rename.section])
                        and not section.__name__ == "Camera" != rename.section
                    ):
                        if rename.key == key and isinstance(entry.value, ScalarNode) and entry.value.text == rename.new:
                            found.append((Edit(entry.value.span, rename.old), rename))
                        elif not rename.key and rename.new == key:
                            found.append((Edit(entry.key.span, rename.old), rename))
        elif isinstance(node, ScalarNode) and node.style == "plain":
            for rename in (rename for rename in RENAMES if not rename.section):
                calls = re.finditer(rf"\b{rename.new}(?=\()", node.span.text)
                found += [(Edit(node.part(call.start(), call.end()), rename.old), rename) for call in calls]
    return tuple(found)


def with_old_names(path: Path) -> str:
    text = path.read_bytes().decode()
    for edit, _ in sorted(renamed_in(path), key=lambda entry: entry[0].span.start, reverse=True):
        text = text[: edit.span.start] + edit.text + text[edit.span.end :]
    return text


@pytest.mark.parametrize("path", [path for path in DOCUMENTS if renamed_in(path)], ids=lambda path: path.stem)
def test_the_fix_of_a_document_with_old_names_gives_the_document_with_the_new_ones(path: Path) -> None:
    """The same text is the same program."""
    drafts = {path: with_old_names(path).encode()}
    found = api.load(path, drafts=drafts).findings
    assert {finding.code for finding in found.errors} == {"DB109"}
    assert all(finding.fix is not None and finding.fix.safe for finding in found.errors)
    fixer = Fixer([str(path)], api.load, drafts=drafts)
    fixer.fix()
    assert fixer.drafts[path] == path.read_bytes()


def test_every_rename_occurs_in_a_document() -> None:
    assert {rename for path in DOCUMENTS for _, rename in renamed_in(path)} == set(RENAMES)


@pytest.mark.parametrize("rename", RENAMES, ids=str)
def test_the_language_knows_the_new_name_and_not_the_old_one(rename: Rename) -> None:
    if not rename.section:
        assert rename.new in FUNCTIONS
        assert rename.old not in FUNCTIONS
    elif not rename.key:
        assert rename.new in MODELS[rename.section].model_fields
        assert rename.old not in MODELS[rename.section].model_fields
    else:
        kinds = [set(part.names) for _, part, _ in walk_sections(Scenario) if isinstance(part, Kinds) and part.key == rename.key]
        words = [
            set(shape.words) for _, part, _ in walk_sections(Scenario) if isinstance(part, type) for shape in shapes_of(part, rename.key)
        ]
        assert any(rename.new in known for known in (*kinds, *words))
        assert not any(rename.old in known for known in (*kinds, *words))


def shapes_of(section: type, key: str) -> list:
    from deepbots_cli.scenario.base import section_fields
    from deepbots_cli.scenario.fields import Word

    return [shape for name, shape in section_fields(section).items() if name == key and isinstance(shape, Word)]


def load(tmp_path: Path, **texts: str) -> api.CheckedScenario:
    (tmp_path / "deepbots.toml").touch()
    for name, text in texts.items():
        (tmp_path / f"{name}.yaml").write_text(text, encoding="utf-8")
    return api.load(tmp_path / f"{next(iter(texts))}.yaml")


BASE = (ROOT / "golden/lint/cartpole.yaml").read_text(encoding="utf-8")


def test_old_and_new_name_in_one_section_are_told_to_be_one_key(tmp_path: Path) -> None:
    part = "robots: {cart: {sensors: {pole_angle: {quantise: 0.1 deg, resolution: 0.2 deg}}}}"
    (found,) = load(tmp_path, copy=f"deepbots: 1\nextends: base.yaml\nname: Copy\n{part}\n", base=BASE).findings
    assert (found.code, found.fix) == ("DB109", None)
    assert found.help == "keep one of `quantise` and `resolution`, under the new name"


@pytest.mark.parametrize(("above", "below"), [("quantise", "resolution"), ("resolution", "quantise")])
def test_the_file_that_extends_another_wins_whatever_the_names(tmp_path: Path, above: str, below: str) -> None:
    part = "extends: {}.yaml\nname: Copy\nrobots: {{cart: {{sensors: {{pole_angle: {{{}: {} deg}}}}}}}}\n"
    checked = load(
        tmp_path,
        copy="deepbots: 1\n" + part.format("middle", below, 0.2),
        middle="deepbots: 1\n" + part.format("base", above, 0.1),
        base=BASE,
    )
    assert [finding.code for finding in checked.findings] == ["DB109"]
    assert checked.spec is not None
    assert checked.spec.robots["cart"].sensors["pole_angle"].resolution == "0.2 deg"


def test_names_of_the_scenario_itself_may_be_old_ones(tmp_path: Path) -> None:
    part = "signals: {gap: abs(cart.pole_angle), stack: gap * 2}\nreward: {repeat: -0.1 * stack / rad}"
    assert list(load(tmp_path, copy=f"deepbots: 1\nextends: base.yaml\nname: Copy\n{part}\n", base=BASE).findings) == []


def test_a_camera_has_a_resolution_of_its_own_and_never_had_the_old_key(tmp_path: Path) -> None:
    part = "robots: {cart: {sensors: {eye: {type: camera, link: body, resolution: 64 48, quantise: 8}}, emit: [pole_angle, eye]}}"
    (found,) = load(tmp_path, copy=f"deepbots: 1\nextends: base.yaml\nname: Copy\n{part}\n", base=BASE).findings
    assert found.code == "DB101"


def test_an_old_name_among_the_settings_of_a_case_is_mended(tmp_path: Path) -> None:
    part = "evaluation: {cases: {late: {set: {messages.timing: paper, robots.cart.sensors.pole_angle.quantise: 0.1 deg}}}}"
    load(tmp_path, copy=f"deepbots: 1\nextends: base.yaml\nname: Copy\n{part}\n", base=BASE)
    path = tmp_path / "copy.yaml"
    (rewrite,) = Fixer([str(path)], api.load).fix()
    assert rewrite.after.decode() == path.read_text(encoding="utf-8").replace("paper", "delayed").replace("quantise", "resolution")


def test_an_old_name_in_a_path_to_remove_is_mended(tmp_path: Path) -> None:
    base = BASE.replace("joint: pole_hinge}", "joint: pole_hinge, resolution: 0.1 deg}")
    assert base != BASE
    removed = "remove: [robots.cart.sensors.pole_angle.quantise, agent.repeat]\n"
    checked = load(tmp_path, copy=f"deepbots: 1\nextends: base.yaml\nname: Copy\n{removed}", base=f"{base}agent: {{action_repeat: 2}}\n")
    assert [(found.code, found.span.text) for found in checked.findings] == [("DB109", "quantise"), ("DB109", "repeat")]
    assert checked.spec is not None
    assert checked.spec.robots["cart"].sensors["pole_angle"].resolution == 0
    path = tmp_path / "copy.yaml"
    (rewrite,) = Fixer([str(path)], api.load).fix()
    assert rewrite.after.decode() == path.read_text(encoding="utf-8").replace("quantise", "resolution").replace("repeat", "action_repeat")
