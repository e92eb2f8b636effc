"""Worlds that mean harm: small texts that stand for much, and texts at the limits of size."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.cli import main
from deepbots_cli.diagnostics import Source
from deepbots_cli.webots.findings import WorldError, WorldFindings
from deepbots_cli.webots.project import Files
from deepbots_cli.webots.protos import MAX_LEVELS, Expander, Scope
from deepbots_cli.webots.scene_builder import MAX_POINTS, build_scene
from deepbots_cli.webots.syntax import MAX_DEPTH, MAX_NODES, MAX_NUMBERS, MAX_TOKENS, Node, parse
from tests.webots.worlds_of_webots import HEADER, read

SECONDS = 4.0
"""CPU time of the slowest world: 1 s on an idle core."""
BOX = "Shape { geometry Box { } }"
PAIR = "PROTO Pair [ field MFNode x [ ] ] { Group { children [ Group { children IS x } Group { children IS x } ] } } "
MANY_NODES = f"the world has more than {MAX_NODES:,} nodes, each as often as USE and PROTO repeat it"
MANY_POINTS = f"the world has more than {MAX_POINTS:,} points of meshes and grids"
MANY_LEVELS = f"the world has more than {MAX_LEVELS} levels of nodes"


def doubled(levels: int, leaf: str = BOX) -> str:
    """Return a text in which each definition uses the previous one twice."""
    first = f"DEF A0 Group {{ children [ {leaf} ] }} "
    return first + "".join(
        f"DEF A{i} Group {{ children [ USE A{i - 1} USE A{i - 1} ] }} " for i in range(1, levels)
    )


def protos(count: int, uses: int, body: str = "Group { children [ %s ] }") -> str:
    """Return PROTOs that each contain the previous one, and a node of the last one."""
    texts = [f"PROTO P{i} [ ] {{ {body % (f'P{i - 1} {{ }} ' * uses if i else '')} }} " for i in range(count)]
    return "".join(texts) + f"P{count - 1} {{ }}"


def errors(text: str) -> list[tuple[str, str]]:
    """Return the errors of a world, each with the text that it points to."""
    try:
        world = read(HEADER + text)
        build_scene(world)
        findings = world.findings.errors
    except WorldError as error:
        findings = error.findings
    return [(each.headline, each.span.source.text[each.span.start : each.span.end]) for each in findings]


@pytest.mark.parametrize(
    ("text", "headline", "place"),
    [
        pytest.param(doubled(18), MANY_NODES, "Group", id="USE that doubles"),
        pytest.param(doubled(14, "Solid { }"), MANY_NODES, "Group", id="USE that doubles solids"),
        pytest.param(doubled(1000), f"nodes are more than {MAX_DEPTH} levels deep", "USE", id="USE in USE"),
        pytest.param("DEF A Group { children [ USE A ] }", "USE of 'A' within itself", "USE", id="USE of itself"),
        pytest.param(
            "DEF A Group { } DEF A Group { children [ Group { children USE A } ] }",
            "USE of 'A' within itself",
            "USE",
            id="USE of itself, after another of its name",
        ),
        pytest.param(
            "PROTO P [ ] { DEF A Solid { boundingObject USE A } } P { }",
            "USE of 'A' within itself",
            "USE",
            id="USE of itself in a PROTO",
        ),
        pytest.param(
            "PROTO A [ ] { Group { children [ A { } A { } ] } } A { }",
            "PROTO A contains itself",
            "A",
            id="PROTO of itself",
        ),
        pytest.param(
            "PROTO A [ field SFNode x A { } ] { Group { children IS x } } A { }",
            "PROTO A contains itself",
            "A",
            id="PROTO in its default",
        ),
        pytest.param(
            "PROTO A [ ] { Group { children B { } } } PROTO B [ ] { Group { children [ A { } A { } ] } } B { }",
            "PROTO B contains itself",
            "B",
            id="PROTOs of each other",
        ),
        pytest.param(protos(17, 2), MANY_NODES, "P2", id="PROTO that doubles"),
        pytest.param(protos(300, 1), MANY_LEVELS, "P224", id="PROTO in PROTO"),
        pytest.param(
            protos(19, 1, "Solid { children [ " * 30 + "%s" + "] } " * 30), MANY_LEVELS, "Solid", id="deep PROTOs"
        ),
        pytest.param(
            f"{PAIR}{'Pair { x [ ' * 30}{BOX}{' ] }' * 30}", MANY_NODES, "Group", id="IS that doubles"
        ),
        pytest.param(
            "".join(
                f"PROTO P{i} [ field SFNode x DEF D{i} Group {{ children [ {f'USE D{i - 1} ' * 2 if i else ''} ] }} ]"
                " { Group { children IS x } } "
                for i in range(25)
            )
            + "P24 { }",
            MANY_NODES,
            "Group",
            id="USE in defaults that doubles",
        ),
        pytest.param("Group { }" * (MAX_NODES + 1), f"the file has more than {MAX_NODES:,} nodes", "Group", id="nodes"),
        pytest.param(
            "Solid { boundingObject Group { children [ DEF G ElevationGrid { xDimension 1000 yDimension 1000 }"
            + "USE G " * 100
            + "] } }",
            MANY_POINTS,
            "ElevationGrid",
            id="USE of a grid",
        ),
        pytest.param(
            "".join(f"Pit {{ xDimension 400 yDimension 400 randomSeed {i} }}" for i in range(100)),
            "the PROTOs of the world are larger than 4 MiB",
            "Pit",
            id="large PROTOs of the library",
        ),
    ],
)  # fmt: skip
def test_a_small_text_that_stands_for_much_is_a_finding_at_its_place(text: str, headline: str, place: str):
    start = time.process_time()
    assert errors(text) == [(headline, place)]
    assert time.process_time() - start < SECONDS


NUMBERS = "1 1 1 " * (MAX_NUMBERS // 3)


@pytest.mark.parametrize(
    "text",
    [
        pytest.param('WorldInfo { title "' + r"\a" * 4_000_000 + '" }', id="escapes"),
        pytest.param("#\n" * 4_000_000, id="comments"),
        pytest.param("Group { " + " ".join(f"childrem{i} 1" for i in range(MAX_TOKENS // 2 - 9)) + "}", id="unknown fields"),
        pytest.param(" ".join(f"Groupp{i} {{ }}" for i in range(MAX_NODES)), id="unknown nodes"),
        pytest.param("Groupp { } " * MAX_NODES, id="one unknown node"),
        pytest.param("".join(f"PROTO A{i} [ ] {{ Group {{ }} }} " for i in range(MAX_NODES)), id="PROTOs"),
        pytest.param(
            "PROTO A [ field MFFloat x [ ] ] { Group { } } PROTO B [ ] { A { x [ " + NUMBERS + "] } }"
            + "B { }" * (MAX_NODES // 6),
            id="numbers in a field of a PROTO",
        ),
        pytest.param(
            "PROTO A [ ] { Shape { geometry PointSet { coord Coordinate { point [ " + NUMBERS + "] } } } }"
            + "A { }" * (MAX_NODES // 5),
            id="numbers in the body of a PROTO",
        ),
        pytest.param("Solid { boundingObject Sphere { } physics Physics { } }" * 1990, id="bodies"),
        pytest.param("E-puck { }" * 280, id="robots of the library"),
    ],
)  # fmt: skip
def test_a_world_at_the_limits_of_size_is_read_in_a_second(text: str):
    start = time.process_time()
    errors(text)
    assert time.process_time() - start < SECONDS


def test_an_error_after_a_hundred_warnings_is_reported():
    fields = " ".join(f"field{i} 1" for i in range(200))
    assert errors(f"Solid {{ {fields} }} Robt {{ }}") == [("there is no node Robt", "Robt")]


def test_new_from_a_world_that_uses_itself_is_a_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "worlds").mkdir()
    world = tmp_path / "worlds" / "w.wbt"
    world.write_text(f"{HEADER}DEF A Group {{ children [ USE A ] }}", encoding="utf-8")
    assert main(["new", "t", "--webots", str(world)]) == 1
    assert "USE of 'A' within itself" in capsys.readouterr().err


# The count


@st.composite
def trees(draw: st.DrawFn) -> tuple[str, int]:
    """Draw the text of nodes with DEF, USE and PROTO, and the number of nodes that it stands for."""
    sizes: dict[str, int] = {}

    def node(depth: int) -> tuple[str, int]:
        if sizes and draw(st.booleans()):
            used = draw(st.sampled_from(sorted(sizes)))
            return f"USE {used} ", sizes[used]
        name = draw(st.sampled_from(["", *"ABCDEF"]))
        sizes.pop(name, None)  # it cannot be used before its end
        inner = [node(depth + 1) for _ in range(draw(st.integers(0, 3 if depth < 4 else 0)))]
        text, size = "".join(text for text, _ in inner), sum(size for _, size in inner)
        # A Pair is its node and the three of its body, with its field in two of them.
        is_pair = draw(st.booleans())
        written = f"Pair {{ x [ {text}] }} " if is_pair else f"Group {{ children [ {text}] }} "
        total = 4 + 2 * size if is_pair else 1 + size
        if name:
            sizes[name] = total
            written = f"DEF {name} {written}"
        return written, total

    nodes = [node(0) for _ in range(draw(st.integers(1, 3)))]
    return "".join(text for text, _ in nodes), sum(size for _, size in nodes)


def expanded_size(node: Node) -> int:
    """Return the size of the tree of a node, written out."""
    inner = [node.body] if node.body else [each for value in node.fields.values() for each in value.nodes]
    return 1 + sum(map(expanded_size, inner))


@given(trees())
def test_the_count_of_nodes_is_the_size_of_the_expanded_tree(tree: tuple[str, int]):
    text, size = tree
    document = parse(Source("w.wbt", f"{HEADER}{PAIR}{text}"))
    findings = WorldFindings()
    expander = Expander(Files(Path("/n")), findings)
    if size > MAX_NODES:
        with pytest.raises(Exception, match="more than"):
            expander.expand(document.nodes, Scope.of_document(document))
        return
    assert expander.expand(document.nodes, Scope.of_document(document)) == size
    assert sum(map(expanded_size, document.nodes)) == size
    assert not findings.errors
