"""The files that `lint --watch`, `view --watch` and the studio watch, against those that the interpreter
opens."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deepbots_cli.cli.commands.lint import LintOptions
from deepbots_cli.files import recorded_reads
from deepbots_cli.lint.settings import settings as project_settings
from deepbots_cli.lsp.workspace import Document, analyze, uri_of
from deepbots_cli.view.episodes import Showing
from tests.worlds import CART

PARTS = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="part" params="name">
  <link name="${name}"><visual><geometry>%s</geometry></visual>
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
</xacro:macro></robot>"""
LINK = PARTS.partition("<link")[2].partition("</xacro")[0]
ROBOT = """<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">%s
  <joint name="slider" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2" effort="%s" velocity="3"/></joint>
  <joint name="hinge" type="continuous"><parent link="cart"/><child link="pole"/><axis xyz="0 1 0"/></joint>
</robot>"""
NAMES = ("base", "cart", "pole")
KINDS = {
    "robot": ["urdf", "xacro"],
    "mesh": ["none", "stl", "glb", "gltf"],
    "terrain": ["none", "hills.png"],
    "included": [False, True],
    "extended": [False, True],
}

_OPENED: list[str] | None = None


def _note(event: str, arguments: tuple[object, ...]) -> None:
    if event == "open" and _OPENED is not None and isinstance(arguments[0], str | os.PathLike):
        _OPENED.append(os.fspath(arguments[0]))


sys.addaudithook(_note)


@contextmanager
def opened_below(folder: Path) -> Iterator[set[Path]]:
    """Collect the files below a folder that the interpreter opens."""
    global _OPENED
    paths: set[Path] = set()
    _OPENED = []
    try:
        yield paths
    finally:
        opened, _OPENED = map(Path, _OPENED), None
        paths |= {path.resolve() for path in opened if path.resolve().is_relative_to(folder.resolve())}


def written(folder: Path, kinds: dict[str, object]) -> tuple[Path, Path]:
    """Write a project of these kinds of files; return its scenario and its robot file."""
    import trimesh
    from PIL import Image

    shape = '<box size="1 1 1"/>'
    if kinds["mesh"] != "none":
        shape = f'<mesh filename="body.{kinds["mesh"]}"/>'
        box = trimesh.creation.box()
        files = {
            "body.stl": box.export(file_type="stl"),
            "body.glb": trimesh.Scene(box).export(file_type="glb"),
        }
        if kinds["mesh"] == "gltf":
            exported = trimesh.Scene(box).export(file_type="gltf")
            files = {name.replace("model.gltf", "body.gltf"): data for name, data in exported.items()}
        for name, data in files.items():
            (folder / name).write_bytes(data)
    if kinds["robot"] == "xacro":
        (folder / "parts.xacro").write_text(PARTS % shape)
        (folder / "limits.yaml").write_text("effort: 10\n")
        links = "".join(f'<xacro:part name="{name}"/>' for name in NAMES)
        head = '<xacro:include filename="parts.xacro"/><xacro:property name="l" value="${xacro.load_yaml(\'limits.yaml\')}"/>'
        robot = ROBOT % (head + links, "${l['effort']}")
    else:
        links = "".join(f"<link{LINK.replace('${name}', name) % shape}" for name in NAMES)
        robot = ROBOT % (links, "10")
    robot_file = folder / f"bot.{kinds['robot']}"
    robot_file.write_text(robot)
    text = CART.replace("cartpole_rail", robot_file.name) + "reward: {alive: 1}\n"
    if kinds["included"]:
        text = text.replace(f"urdf: {robot_file.name}\n    base: fixed", "include: bot.yaml")
        (folder / "bot.yaml").write_text(f"urdf: {robot_file.name}\nbase: fixed\n")
    if kinds["terrain"] != "none":
        Image.fromarray(np.zeros((8, 8), np.uint8)).save(folder / "hills.png")
        terrain = "terrain: {type: heightfield, file: hills.png, size: 4 4 m, height: 1 m}"
        text = text.replace("substeps: 4}", f"substeps: 4, {terrain}}}")
    (folder / "mine.yaml").write_text(text)
    if kinds["extended"]:
        (folder / "base.yaml").write_text(text)
        (folder / "mine.yaml").write_text("deepbots: 1\nextends: base.yaml\nname: Mine\n")
    (folder / "deepbots.toml").write_text("[lint]\npreview = true\n")
    return folder / "mine.yaml", robot_file


@given(
    st.fixed_dictionaries({name: st.sampled_from(choices) for name, choices in KINDS.items()}),
    st.sampled_from(
        ["", "bot.urdf", "bot.xacro", "parts.xacro", "body.gltf", "hills.png", "bot.yaml", "mine.yaml"]
    ),
)
@example({"robot": "xacro", "mesh": "gltf", "terrain": "hills.png", "included": True, "extended": True}, "")
@example(
    {"robot": "urdf", "mesh": "none", "terrain": "none", "included": False, "extended": False}, "bot.urdf"
)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_every_file_that_lint_view_or_the_studio_opens_is_watched_also_with_an_error_in_one(
    kinds: dict[str, object], faulty: str
) -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        scenario, robot_file = written(folder, kinds)
        if faulty and (folder / faulty).exists():
            (folder / faulty).write_text("<: [")
        for reference in (str(scenario), str(robot_file)):
            with opened_below(folder) as opened, recorded_reads() as watched:
                project_settings(folder)
                findings = LintOptions().findings(reference)
            assert opened <= {path.resolve() for path in watched}
            if not (faulty and (folder / faulty).exists()):
                assert not [finding for finding in findings if finding.severity == "error"]
                assert robot_file.resolve() in opened
        with opened_below(folder) as opened:
            state = Showing(str(scenario)).open()
        assert opened <= {path.resolve() for path in state.files}
        document = Document(uri_of(scenario), 1, scenario.read_text(), scenario)
        with opened_below(folder) as opened:
            analysis = analyze(document, {})
        assert opened <= {path.resolve() for path in analysis.reads}


@pytest.mark.parametrize("missing", ["bot.yaml", "bot.xacro", "parts.xacro", "limits.yaml", "body.stl"])
def test_watching_lints_again_when_a_missing_file_comes(deepbots, tmp_path, monkeypatch, missing):
    written(
        tmp_path, {"robot": "xacro", "mesh": "stl", "terrain": "none", "included": True, "extended": False}
    )
    contents = [(tmp_path / missing).read_bytes()]
    (tmp_path / missing).unlink()

    def save_or_interrupt(_):
        if not contents:
            raise KeyboardInterrupt
        (tmp_path / missing).write_bytes(contents.pop())

    monkeypatch.setattr("time.sleep", save_or_interrupt)
    ran = deepbots("lint", "mine.yaml", "--watch")
    assert ran.err.count("Ctrl-C ends it") == 2


@pytest.mark.parametrize("jobs", [1, 2])
def test_watching_lints_again_for_each_file_of_a_robot(deepbots, tmp_path, monkeypatch, jobs):
    scenario, _ = written(
        tmp_path, {"robot": "xacro", "mesh": "stl", "terrain": "none", "included": True, "extended": False}
    )
    (tmp_path / "other.yaml").write_text(scenario.read_text())
    names = ["mine.yaml", "bot.yaml", "bot.xacro", "parts.xacro", "limits.yaml", "body.stl", "deepbots.toml"]
    changed = iter(names)

    def save_or_interrupt(_):
        name = next(changed, None)
        if name is None:
            raise KeyboardInterrupt
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes() + b"\n")

    monkeypatch.setattr("time.sleep", save_or_interrupt)
    ran = deepbots("lint", "mine.yaml", "other.yaml", "--watch", "--jobs", str(jobs))
    assert ran.err.count("Ctrl-C ends it") == 1 + len(names)
