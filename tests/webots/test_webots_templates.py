"""PROTOs that are templates of JavaScript."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from deepbots_cli.webots.nodes import child, children, number, numbers, real, text
from deepbots_cli.webots.project import World, read_world
from tests.webots.worlds_of_webots import HEADER

needs_v8 = pytest.mark.skipif(
    importlib.util.find_spec("py_mini_racer") is None, reason="mini-racer is not installed"
)
HEAD = "PROTO Thing [ field SFVec3f size 1 2 3 field MFFloat list [ 1 2 ] field SFNode part NULL ]"


def world(
    folder: Path, body: str, node: str = "Thing { }", *, allow_code: bool = True, head: str = HEAD
) -> World:
    """Return the world of a node, whose PROTO has a body; a copy of Webots is in the folder `webots`."""
    for name in ("worlds", "protos"):
        (folder / name).mkdir(exist_ok=True)
    (folder / "protos" / "Thing.proto").write_text(f"{HEADER}{head} {{ {body} }}", encoding="utf-8")
    path = folder / "worlds" / "w.wbt"
    path.write_text(f'{HEADER}EXTERNPROTO "../protos/Thing.proto"\n{node}', encoding="utf-8")
    return read_world(
        path, [folder / "webots"] if (folder / "webots").is_dir() else (), allow_code=allow_code
    )


def problem(made: World) -> str:
    (finding,) = made.findings.errors
    return finding.headline


@needs_v8
def test_a_template_makes_nodes_of_the_values_of_its_fields(tmp_path: Path):
    made = world(
        tmp_path,
        """%< // a statement
          const size = fields.size.value;
          let sum = fields.list.value.reduce((before, now) => before + now);
          if (fields.part.value === undefined) { sum += 100; }
        >%
        # a comment %< }}} >%
        Solid { translation %<= size.x * 2 // twice >% 0 %<= fields.size.defaultValue.z >%
          name "%<= sum + " " + context.os >%"
          children [ %< for (let k = 0; k < 3; ++k) { >% Pose { translation %<= k >% 0 0 } %< } >% ] }""",
        "Thing { size 5 5 5 list [ 3 4 ] }",
    )
    assert not made.findings.errors
    solid = real(made.nodes[0])
    assert numbers(solid, "translation") == [10, 0, 3]
    assert text(solid, "name") == "107 linux"
    assert [numbers(pose, "translation")[0] for pose in children(solid)] == [0, 1, 2]


@needs_v8
def test_a_template_reads_nodes_in_its_fields_and_keeps_is(tmp_path: Path):
    made = world(
        tmp_path,
        """Solid { translation IS size
          boundingObject Sphere { radius %<= fields.part.value.fields.radius.value * 2 >% }
          name "%<= fields.part.value.node_name >%" }""",
        "Thing { size 7 8 9 part Sphere { radius 0.25 } }",
    )
    solid = real(made.nodes[0])
    assert numbers(solid, "translation") == [7, 8, 9]
    assert text(solid, "name") == "Sphere"
    sphere = child(solid, "boundingObject")
    assert sphere is not None
    assert number(sphere, "radius") == 0.5


@needs_v8
def test_a_template_imports_modules_of_a_copy_of_webots(tmp_path: Path):
    modules = tmp_path / "webots" / "resources" / "javascript" / "modules" / "webots"
    modules.mkdir(parents=True)
    (modules / "outer.js").write_text(
        "import * as inner from 'inner.js';\nexport function twice(x) { return inner.two * x; }\n",
        encoding="utf-8",
    )
    (modules / "inner.js").write_text("export const two = 2;\nlet hidden = 1;\n", encoding="utf-8")
    made = world(
        tmp_path,
        """%< import * as outer from 'outer.js';
             import {two as pair} from 'inner.js'; >%
        Solid { translation %<= outer.twice(4) >% %<= pair >% %<= typeof inner >% }""".replace(
            "%<= typeof inner >%", "%<= typeof inner === 'undefined' ? 1 : 0 >%"
        ),
    )
    assert not made.findings.errors
    assert numbers(real(made.nodes[0]), "translation") == [8, 2, 1]


@needs_v8
@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("%< while (true) {} >% Solid { }", "fails: JavaScript was terminated by timeout"),
        (
            "%< let a = []; while (true) { a.push(new Array(1e6).fill(a)); } >% Solid { }",
            "fails: JavaScript memory limit",
        ),
        ("%< undefinedName(); >% Solid { }", "fails: ReferenceError: undefinedName is not defined"),
        ("%< if ( >% Solid { }", "fails: SyntaxError"),
        (
            "%< wbfile.readTextFile('/etc/passwd'); >% Solid { }",
            "fails: ReferenceError: wbfile is not defined",
        ),
        ("%< require('fs'); >% Solid { }", "fails: ReferenceError: require is not defined"),
        (
            "%< import * as wbrandom from 'wbrandom.js'; >% Solid { }",
            "imports wbrandom.js, which is not available",
        ),
        ("%<= 'x'.repeat(2 ** 24) >%", "makes more than 8 MiB"),
        ("%< return 'x'.repeat(2 ** 28); >%", "makes more than 8 MiB"),
        ("%< throw 'x'.repeat(2 ** 28); >%", "fails: its error has a long text"),
        ("%< new Uint8Array(2 ** 30).fill(1); >% Solid { }", "fails: ReferenceError: Uint8Array"),
        ("%< new WebAssembly.Memory({initial: 9}); >% Solid { }", "fails: ReferenceError: WebAssembly"),
        ("%< return ''; })(); (() => { >% Solid { }", "fails: SyntaxError"),
        ("%< return 5; >% Solid { }", "returns before its end"),
        ("Solid { name '%<= '%' + '< 1 >' + '%' >%' }", "makes another template"),
    ],
)
def test_a_template_that_fails_is_a_finding(tmp_path: Path, monkeypatch, body: str, words: str):
    if "timeout" in words:  # on a busy machine, the memory is not full after 2 s
        monkeypatch.setattr("deepbots_cli.webots.proto_templates.MAX_SECONDS", 2.0)
    assert problem(world(tmp_path, body)).startswith(f"the template of PROTO Thing {words}")


def test_no_template_runs_without_permission(tmp_path: Path):
    assert problem(world(tmp_path, "Solid { name %<= 1 >% }", allow_code=False)) == (
        "PROTO Thing is a template of JavaScript, which deepbots webots runs with --allow-code"
    )


def test_a_template_of_lua_is_named(tmp_path: Path):
    assert problem(world(tmp_path, "Solid { name %{= 1 }% }")) == (
        "PROTO Thing is a template of Lua, which deepbots cannot run"
    )


@pytest.mark.skipif(importlib.util.find_spec("py_mini_racer") is not None, reason="mini-racer is installed")
def test_without_the_engine_the_extra_is_named(tmp_path: Path):
    assert "pip install 'deepbots-cli[webots-js]'" in problem(world(tmp_path, "Solid { name %<= 1 >% }"))
